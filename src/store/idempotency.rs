//! `Idempotency-Key`: the claim on the key, the effect and the answer are one transaction.

use super::{Error, Result, Store, Tx};

/// One use of an `Idempotency-Key`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdempotencyScope {
    /// Whose request it is.
    pub holder: String,
    /// The request's method.
    pub method: String,
    /// The request's path and query.
    pub path: String,
    /// The client's key.
    pub key: String,
    /// Of the request's body, hexadecimal: another body must not use the key again.
    pub request_sha256: String,
}

/// An answer, as it is given again.
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

/// What became of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum IdempotentOutcome {
    /// It took effect now.
    Fresh(StoredResponse),
    /// It had taken effect before; this is the answer of that time.
    Replay(StoredResponse),
    /// The key was used for another body; nothing was done.
    Reused,
}

/// Keys are forgotten after a week: long enough for a cell PC that was switched off over a weekend.
const KEPT_MS: i64 = 7 * 24 * 3600 * 1000;

pub(super) const ALL_QUERIES: &[&str] = &[CLAIM, ANSWER, FIND, FORGET_OLD];

// With a claim in another open transaction this waits until that one ends.
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

const FORGET_OLD: &str = "delete from idempotency where created_at_ms < (select now_ms from clock) - $1";

type Found = (String, i64, Option<String>, String, Vec<u8>);

impl Store {
    /// Forgets the Idempotency-Keys of long ago, with the answers that were kept for them.
    ///
    /// # Errors
    /// [`Error::Database`].
    pub async fn forget_old_keys(&self) -> Result<()> {
        let mut tx = self.begin().await?;
        sqlx::query(FORGET_OLD).bind(KEPT_MS).execute(tx.connection()?).await?;
        tx.commit().await
    }

    /// Runs `effect` in a transaction, and with a scope at most once for it: a second request gets the first one's answer.
    /// If `effect` fails, nothing was done and the key is free.
    ///
    /// `effect` must not wait for anything but the database: on SQLite other writers wait for it.
    ///
    /// # Errors
    /// What `effect` returns, [`Error::Database`].
    pub async fn create_idempotent<E, F>(&self, scope: Option<&IdempotencyScope>, effect: F) -> Result<IdempotentOutcome, E>
    where
        E: From<Error>,
        F: AsyncFnOnce(&mut Tx) -> Result<StoredResponse, E>,
    {
        let mut tx = self.begin().await?;
        if let Some(scope) = scope
            && !claim(&mut tx, scope).await?
        {
            let outcome = answer_again(&mut tx, scope).await?;
            tx.rollback().await?;
            return Ok(outcome);
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
    let query = sqlx::query(CLAIM).bind(&scope.holder).bind(&scope.method).bind(&scope.path).bind(&scope.key);
    Ok(query.bind(&scope.request_sha256).execute(tx.connection()?).await?.rows_affected() == 1)
}

async fn answer(tx: &mut Tx, scope: &IdempotencyScope, response: &StoredResponse) -> Result<()> {
    let query = sqlx::query(ANSWER).bind(&scope.holder).bind(&scope.method).bind(&scope.path).bind(&scope.key);
    let query = query.bind(i64::from(response.status)).bind(response.location.as_deref()).bind(&response.content_type);
    query.bind(response.body.as_slice()).execute(tx.connection()?).await?;
    Ok(())
}

async fn answer_again(tx: &mut Tx, scope: &IdempotencyScope) -> Result<IdempotentOutcome> {
    let query = sqlx::query_as(FIND).bind(&scope.holder).bind(&scope.method).bind(&scope.path).bind(&scope.key);
    let (request_sha256, status, location, content_type, body): Found = query.fetch_one(tx.connection()?).await?;
    if request_sha256 != scope.request_sha256 {
        return Ok(IdempotentOutcome::Reused);
    }
    let status = u16::try_from(status).map_err(|e| Error::Database(sqlx::Error::Decode(e.into())))?;
    Ok(IdempotentOutcome::Replay(StoredResponse { status, location, content_type, body }))
}
