//! Sessions of browsers that signed in with a key. The database has only the SHA-256 of a session's token.

use super::sql::{self, values};
use super::{ApiKeyRow, Result, Store, Tx};

/// Longest validity of a session: a shift and some hours. A session that began in the future has ended, too: the clock was set back.
pub const MAX_AGE_MS: i64 = 12 * 3600 * 1000;
/// Maximum number of sessions of a key. The oldest ends when one more begins, so that a key cannot fill the disk.
pub const MAX_OF_KEY: i64 = 100;

pub(super) const ALL_QUERIES: &[&str] = &[DELETE_ENDED, INSERT, FIND, DELETE];

// The sessions that ended, and the oldest of the key that has too many.
const DELETE_ENDED: &str = "
    delete from browser_session where created_at_ms < (select now_ms from clock) - $1 or created_at_ms > (select now_ms from clock) + 60000
        or key_id in (select id from api_key where revoked_at_ms is not null)
        or (key_id = $2 and (select count(*) from browser_session newer
            where newer.key_id = browser_session.key_id and newer.created_at_ms >= browser_session.created_at_ms) >= $3)";

const INSERT: &str = "
    insert into browser_session (token_sha256, key_id, created_at_ms) values ($1, $2, (select now_ms from clock))";

const FIND: &str = "
    select k.id as id, k.name as name, k.key_sha256 as key_sha256, k.scopes_json as scopes_json, k.robots_json as robots_json,
        k.created_at_ms as created_at_ms, k.revoked_at_ms as revoked_at_ms
    from browser_session s join api_key k on k.id = s.key_id
    where s.token_sha256 = $1 and s.created_at_ms between (select now_ms from clock) - $2 and (select now_ms from clock) + 60000
        and k.revoked_at_ms is null";

const DELETE: &str = "delete from browser_session where token_sha256 = $1";

/// Begins a session of a key, and deletes those that ended.
pub async fn begin(tx: &mut Tx, token_sha256: &str, key_id: &str) -> Result<()> {
    let values = values![MAX_AGE_MS, key_id, MAX_OF_KEY];
    sql::execute(tx.connection(), DELETE_ENDED, values).await?;
    sql::execute(tx.connection(), INSERT, values![token_sha256, key_id]).await?;
    Ok(())
}

/// The key of a session; none if there is no such session, or if it has ended.
pub async fn find(store: &Store, token_sha256: &str) -> Result<Option<ApiKeyRow>> {
    let values = values![token_sha256, MAX_AGE_MS];
    sql::first(store.readers(), FIND, values).await
}

/// Ends a session, if there is one.
pub async fn end(tx: &mut Tx, token_sha256: &str) -> Result<()> {
    sql::execute(tx.connection(), DELETE, values![token_sha256]).await?;
    Ok(())
}
