//! API keys. The database has only the SHA-256 of a key.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::id_prefix::IdPrefix;
use super::listing::{self, ListQueries, list_row};
use super::sql::{self, rows_after, values};
use super::{AuditEvent, ListRequest, Page, Result, Store, Tx};

row! {
    /// An API key.
    #[derive(Clone, Debug, PartialEq)]
    pub struct ApiKeyRow {
        /// `key_…`
        pub id: String,
        /// Name of the holder; need not be unique.
        pub name: String,
        /// SHA-256 of the key, hexadecimal.
        pub key_sha256: String,
        /// JSON list of scopes.
        pub scopes_json: String,
        /// JSON list of the robots that the key is limited to; none for all robots.
        pub robots_json: Option<String>,
        /// When it was created.
        pub created_at_ms: i64,
        /// When it was revoked.
        pub revoked_at_ms: Option<i64>,
    }
}

list_row!(ApiKeyRow);

/// An API key to be stored, with fields of [`ApiKeyRow`].
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // as in the row
pub struct NewApiKey {
    pub name: String,
    pub key_sha256: String,
    pub scopes_json: String,
    pub robots_json: Option<String>,
}

macro_rules! columns {
    () => {
        "id, name, key_sha256, scopes_json, robots_json, created_at_ms, revoked_at_ms"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, FIND, GET, REVOKE, BY_ID];

const INSERT: &str = concat!(
    "insert into api_key (id, name, key_sha256, scopes_json, robots_json, created_at_ms)
     values ($1, $2, $3, $4, $5, (select now_ms from clock))
     returning ",
    columns!()
);

const FIND: &str = concat!(
    "select ",
    columns!(),
    " from api_key where key_sha256 = $1 and revoked_at_ms is null"
);

const GET: &str = concat!("select ", columns!(), " from api_key where id = $1");

pub(super) const LIST: ListQueries = ListQueries {
    columns: columns!(),
    from: "api_key",
    filter: "1 = 1",
    n_filters: 0,
    name: None,
};

const REVOKE: &str = concat!(
    "update api_key set revoked_at_ms = coalesce(revoked_at_ms, (select now_ms from clock))
     where id = $1
     returning ",
    columns!()
);

const BY_ID: &str = rows_after!(columns!(), "api_key");

fn created_detail(row: &ApiKeyRow) -> Value {
    json!({"name": row.name, "scopes": row.scopes_json, "robots": row.robots_json, "key_sha256": row.key_sha256,
        "created_at_ms": row.created_at_ms})
}

fn revoked_detail(row: &ApiKeyRow) -> Option<(i64, Value)> {
    row.revoked_at_ms
        .map(|at_ms| (at_ms, json!({"name": row.name, "revoked_at_ms": at_ms})))
}

audited!(ApiKeyRow, id, |row| vec![
    ExpectedEntry::at(
        AuditEvent::KeyCreated,
        row.created_at_ms,
        created_detail(row)
    ),
    ExpectedEntry::new(AuditEvent::KeyRevoked, revoked_detail(row)),
]);

/// Stores a key.
///
/// # Errors
/// [`super::Conflict::Duplicate`] if the key is stored already, [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: &NewApiKey) -> Result<ApiKeyRow> {
    let values = values![
        IdPrefix::Key.new_id(),
        new.name,
        new.key_sha256,
        new.scopes_json,
        new.robots_json
    ];
    let row: ApiKeyRow = sql::one(tx.connection(), INSERT, values).await?;
    tx.audit(AuditEvent::KeyCreated, &row.id, created_detail(&row));
    Ok(row)
}

/// The key with this hash; none if it is unknown or revoked.
pub async fn find(store: &Store, key_sha256: &str) -> Result<Option<ApiKeyRow>> {
    sql::first(store.readers(), FIND, values![key_sha256]).await
}

/// One key, revoked or not.
pub async fn get(store: &Store, id: &str) -> Result<ApiKeyRow> {
    sql::one(store.readers(), GET, values![id]).await
}

/// Keys, including revoked ones.
pub async fn list(store: &Store, request: &ListRequest) -> Result<Page<ApiKeyRow>> {
    listing::list(store, &LIST, &[], request).await
}

/// Revokes a key; revoking it again changes nothing.
pub async fn revoke(tx: &mut Tx, id: &str) -> Result<ApiKeyRow> {
    let row: ApiKeyRow = sql::one(tx.connection(), REVOKE, values![id]).await?;
    if let Some((_, detail)) = revoked_detail(&row) {
        tx.audit(AuditEvent::KeyRevoked, &row.id, detail);
    }
    Ok(row)
}
