//! `Idempotency-Key`: one transaction claims the key, runs the effect and stores the answer.

use serde_json::{Value, json};
use sqlx::any::AnyRow;
use sqlx::{Any, Executor, FromRow, Row};

use super::sql::{self, values};
use super::{Error, Result, Store, Tx};
use crate::wire::canonical;

/// One use of an `Idempotency-Key`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct IdempotencyScope {
    /// Who sent the request: the id of an API key.
    pub holder: String,
    /// The request's method.
    pub method: String,
    /// The request's path. The query is covered by `request_sha256`.
    pub path: String,
    /// The client's key.
    pub key: String,
    /// SHA-256 of the request, hexadecimal. A different request must not use the same key.
    pub request_sha256: String,
}

/// An answer that a retry receives again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredResponse {
    /// The HTTP status.
    pub status: u16,
    /// The `Location` header.
    pub location: Option<String>,
    /// The `Content-Type` header.
    pub content_type: String,
    /// The body.
    pub body: Vec<u8>,
}

/// Result of an idempotent request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum IdempotentOutcome {
    /// The request took effect now.
    Fresh(StoredResponse),
    /// The request took effect earlier; this is the first answer.
    Replay(StoredResponse),
    /// The key was used for a different request, so this request had no effect.
    Reused,
}

/// Age at which keys are deleted: one week, so that the PC of a robot cell can be off for a weekend and still retry.
const KEY_LIFETIME_MS: i64 = 7 * 24 * 3600 * 1000;

pub(super) const ALL_QUERIES: &[&str] = &[CLAIM, ANSWER, FIND, FORGET_OLD];

// Waits if another open transaction claims the same key.
const CLAIM: &str = "
    insert into idempotency (key_holder, method, path, idempotency_key, request_sha256, created_at_ms)
    values ($1, $2, $3, $4, $5, (select now_ms from clock))
    on conflict do nothing";

const ANSWER: &str = "
    update idempotency set status = $5, location = $6, content_type = $7, response_body = $8
    where key_holder = $1 and method = $2 and path = $3 and idempotency_key = $4";

const FIND: &str = "
    select request_sha256, status, location, content_type, response_body from idempotency
    where key_holder = $1 and method = $2 and path = $3 and idempotency_key = $4";

const FORGET_OLD: &str =
    "delete from idempotency where created_at_ms < (select now_ms from clock) - $1";

type Found = (String, i64, Option<String>, String, Vec<u8>);

impl Store {
    /// The stored answer to this key, if a request with the key took effect. Only reads.
    pub async fn stored_answer(
        &self,
        scope: &IdempotencyScope,
    ) -> Result<Option<IdempotentOutcome>> {
        find(self.readers(), scope).await
    }

    /// Deletes expired Idempotency-Keys and their answers.
    pub async fn delete_expired_keys(&self) -> Result<()> {
        let mut tx = self.begin().await?;
        match sql::execute(tx.connection(), FORGET_OLD, values![KEY_LIFETIME_MS]).await? {
            0 => tx.rollback().await,
            _ => tx.commit().await,
        }
    }

    /// Runs `effect` in a transaction. With a scope, `effect` takes place at most once: a second request gets the first answer.
    /// If `effect` fails, the transaction is rolled back and the key can be used again.
    ///
    /// `effect` may wait only for the database, because on SQLite all other writers wait until the transaction ends.
    pub async fn create_idempotent<E, F>(
        &self,
        scope: Option<&IdempotencyScope>,
        effect: F,
    ) -> Result<IdempotentOutcome, E>
    where
        E: From<Error>,
        F: AsyncFnOnce(&mut Tx) -> Result<StoredResponse, E>,
    {
        let mut tx = self.begin().await?;
        if let Some(scope) = scope
            && !claim(&mut tx, scope).await?
        {
            let outcome = find(tx.connection(), scope).await?;
            tx.rollback().await?;
            return Ok(outcome.ok_or(Error::NotFound)?);
        }
        match effect(&mut tx).await {
            Ok(response) => {
                if let Some(scope) = scope {
                    answer(&mut tx, scope, &response).await?;
                }
                tx.commit().await?;
                Ok(IdempotentOutcome::Fresh(response))
            }
            Err(error) => {
                tx.rollback().await?;
                Err(error)
            }
        }
    }
}

async fn claim(tx: &mut Tx, scope: &IdempotencyScope) -> Result<bool> {
    let IdempotencyScope {
        holder,
        method,
        path,
        key,
        request_sha256,
    } = scope;
    let values = values![holder, method, path, key, request_sha256];
    Ok(sql::execute(tx.connection(), CLAIM, values).await? == 1)
}

async fn answer(tx: &mut Tx, scope: &IdempotencyScope, response: &StoredResponse) -> Result<()> {
    let values = values![
        scope.holder,
        scope.method,
        scope.path,
        scope.key,
        i64::from(response.status),
        response.location,
        response.content_type,
        response.body
    ];
    sql::execute(tx.connection(), ANSWER, values).await?;
    let (request, answer) = hashes(scope, response);
    tx.audit_field(ANSWER_HASHES_FIELD, json!([request, answer]));
    Ok(())
}

/// Field of the effect's last audit entry that holds both [`hashes`].
const ANSWER_HASHES_FIELD: &str = "answered";

/// Hash of the key with its holder, method and path; hash of the request with its answer.
pub(super) fn hashes(scope: &IdempotencyScope, response: &StoredResponse) -> (String, String) {
    let request = json!([scope.holder, scope.method, scope.path, scope.key]);
    let body_sha256 = canonical::sha256_hex(&response.body);
    let answer = json!([
        scope.request_sha256,
        response.status,
        response.location,
        response.content_type,
        body_sha256
    ]);
    (
        canonical::sha256_hex(request.to_string().as_bytes()),
        canonical::sha256_hex(answer.to_string().as_bytes()),
    )
}

/// Reads both [`hashes`] from the detail of an audit entry.
pub(super) fn answer_hashes(detail: &Value) -> Option<(String, String)> {
    let hash = |at: usize| {
        detail
            .get(ANSWER_HASHES_FIELD)?
            .get(at)?
            .as_str()
            .map(str::to_owned)
    };
    Some((hash(0)?, hash(1)?))
}

/// A key with its answer. The answer is none if the request began and was not answered.
#[derive(Debug)]
pub(super) struct AnsweredKey {
    pub(super) scope: IdempotencyScope,
    pub(super) answer: Option<StoredResponse>,
}

impl FromRow<'_, AnyRow> for AnsweredKey {
    fn from_row(row: &AnyRow) -> sqlx::Result<Self> {
        let scope = IdempotencyScope {
            holder: row.try_get("key_holder")?,
            method: row.try_get("method")?,
            path: row.try_get("path")?,
            key: row.try_get("idempotency_key")?,
            request_sha256: row.try_get("request_sha256")?,
        };
        let answer = match row.try_get::<Option<i64>, _>("status")? {
            // A number that is not an HTTP status becomes 0, so that the hash differs from the hash of the answer that was sent.
            Some(status) => Some(StoredResponse {
                status: u16::try_from(status).unwrap_or_default(),
                location: row.try_get("location")?,
                content_type: row
                    .try_get::<Option<_>, _>("content_type")?
                    .unwrap_or_default(),
                // In SQLite an edit may have put text into this column. Text is read as an empty body, so that the hash differs.
                body: row
                    .try_get::<Option<_>, _>("response_body")
                    .ok()
                    .flatten()
                    .unwrap_or_default(),
            }),
            None => None,
        };
        Ok(AnsweredKey { scope, answer })
    }
}

async fn find(
    connection: impl Executor<'_, Database = Any>,
    scope: &IdempotencyScope,
) -> Result<Option<IdempotentOutcome>> {
    let values = values![scope.holder, scope.method, scope.path, scope.key];
    let found: Option<Found> = sql::first(connection, FIND, values).await?;
    let Some((request_sha256, status, location, content_type, body)) = found else {
        return Ok(None);
    };
    if request_sha256 != scope.request_sha256 {
        return Ok(Some(IdempotentOutcome::Reused));
    }
    let status =
        u16::try_from(status).map_err(|e| Error::Database(sqlx::Error::Decode(e.into())))?;
    Ok(Some(IdempotentOutcome::Replay(StoredResponse {
        status,
        location,
        content_type,
        body,
    })))
}
