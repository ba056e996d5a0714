//! Extractor for requests that create or change something: the body, and an `Idempotency-Key` that makes a retry harmless.

use crate::http::auth::Caller;
use crate::http::extract::{media_type, parse_small, whole_body};
use crate::http::headers::IDEMPOTENCY_KEY;
use crate::http::{App, Error};
use crate::store::{IdempotencyScope, IdempotentOutcome, StoredResponse, Tx};
use crate::wire::canonical;
use crate::wire::parameter_set::ReasonBody;
use axum::body::Bytes;
use axum::extract::{FromRequest, Request};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Longest Idempotency-Key, characters.
const MAX_KEY: usize = 200;
const IDEMPOTENCY_REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");

/// A request that creates or changes something. If the same request was answered before, its handler does not run. The stored answer is sent
/// again without any check.
pub struct Submission {
    /// The state of the server.
    pub app: App,
    /// The key that sent the request.
    pub caller: Caller,
    /// Its media type, without parameters.
    pub media_type: String,
    /// Its media type as sent.
    pub content_type: String,
    /// Its body.
    pub body: Bytes,
    scope: Option<IdempotencyScope>,
}

impl FromRequest<App> for Submission {
    type Rejection = Response;

    async fn from_request(request: Request, app: &App) -> Result<Self, Response> {
        let submission = Self::read(request, app).await;
        let submission = submission.map_err(IntoResponse::into_response)?;
        match submission.replay().await {
            Ok(None) => Ok(submission),
            Ok(Some(answer)) => Err(answer),
            Err(error) => Err(error.into_response()),
        }
    }
}

impl Submission {
    async fn read(request: Request, app: &App) -> Result<Self, Error> {
        let caller = Caller::from_extensions(request.extensions())?;
        let key = idempotency_key(request.headers())?;
        let uri = request.uri().clone();
        let method = request.method().to_string();
        let media_type = media_type(request.headers()).unwrap_or_default();
        let content_type = request
            .headers()
            .get(header::CONTENT_TYPE)
            .and_then(|v| v.to_str().ok())
            .unwrap_or_default()
            .to_owned();
        let body = whole_body(request, app).await?;
        let scope = match key {
            Some(key) => Some(IdempotencyScope {
                holder: caller.holder.clone(),
                method,
                path: uri.path().into(),
                key,
                request_sha256: fingerprint(&uri, &content_type, &body).await?,
            }),
            None => None,
        };
        Ok(Self {
            app: app.clone(),
            caller,
            media_type,
            content_type,
            body,
            scope,
        })
    }
}

fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Error> {
    let Some(value) = headers.get(IDEMPOTENCY_KEY) else {
        return Ok(None);
    };
    let text = value.to_str().unwrap_or_default();
    let is_printable = text.bytes().all(|byte| (b' '..=b'~').contains(&byte));
    if text.is_empty() || text.len() > MAX_KEY || !is_printable {
        let detail = format!("an Idempotency-Key has 1 to {MAX_KEY} printable ASCII characters");
        return Err(Error::bad_request("invalid_idempotency_key", detail));
    }
    Ok(Some(text.into()))
}

/// Hash of query, content type and body; a retry has the same. Runs on a blocking thread, because hashing 32 MiB takes some 50 ms. It needs no
/// compute permit: the memory for bodies admits only two bodies of this size at once.
async fn fingerprint(uri: &Uri, content_type: &str, body: &Bytes) -> Result<String, Error> {
    let body = body.clone();
    let body_sha256 = tokio::task::spawn_blocking(move || canonical::sha256_hex(&body))
        .await
        .map_err(|error| Error::Internal(error.to_string()))?;
    let query_sha256 = canonical::sha256_hex(uri.query().unwrap_or_default().as_bytes());
    let type_sha256 = canonical::sha256_hex(content_type.as_bytes());
    Ok(canonical::sha256_hex(
        [query_sha256, type_sha256, body_sha256].concat().as_bytes(),
    ))
}

impl Submission {
    /// The body as JSON of this shape.
    ///
    /// # Errors
    /// [`Error::UnsupportedMediaType`], [`Error::Syntax`], [`Error::Invalid`], [`Error::TooLarge`].
    pub fn json<T: DeserializeOwned>(&self) -> Result<T, Error> {
        if self.media_type != "application/json" {
            return Err(self.unsupported("application/json"));
        }
        parse_small(&self.body)
    }

    /// The reason in the body.
    ///
    /// # Errors
    /// Those of [`Self::json`]; [`Error::Invalid`] for a reason without a letter or a digit.
    pub fn reason(&self) -> Result<String, Error> {
        let body: ReasonBody = self.json()?;
        body.check()?;
        Ok(body.reason)
    }

    /// The error 415 for this body.
    pub fn unsupported(&self, expected: &'static str) -> Error {
        let found = if self.content_type.is_empty() {
            "without a Content-Type".into()
        } else {
            self.content_type.clone()
        };
        Error::UnsupportedMediaType { found, expected }
    }

    /// The stored answer, if the same request was done before.
    async fn replay(&self) -> Result<Option<Response>, Error> {
        match &self.scope {
            Some(scope) => self
                .app
                .store
                .stored_answer(scope)
                .await?
                .map(respond)
                .transpose(),
            None => Ok(None),
        }
    }

    /// Replaces an error with the stored answer, if the same request took effect meanwhile. A client may retry while its first request still runs.
    /// The checks of the retry then see the changes of the first request, and may fail because of them.
    pub async fn or_replay(&self, result: Result<Response, Error>) -> Result<Response, Error> {
        match result {
            Ok(answer) => Ok(answer),
            Err(error) => self.replay().await.ok().flatten().ok_or(error),
        }
    }

    /// Runs `effect` in a transaction, once for its Idempotency-Key, and answers.
    ///
    /// # Errors
    /// Those of `effect`, [`Error::IdempotencyKeyReused`], [`Error::Store`].
    pub async fn create<F>(&self, effect: F) -> Result<Response, Error>
    where
        F: AsyncFnOnce(&mut Tx) -> Result<StoredResponse, Error>,
    {
        let effect = async |tx: &mut Tx| {
            tx.act_as(&self.caller.holder);
            effect(tx).await
        };
        respond(
            self.app
                .store
                .create_idempotent(self.scope.as_ref(), effect)
                .await?,
        )
    }
}

fn respond(outcome: IdempotentOutcome) -> Result<Response, Error> {
    let (stored, replayed) = match outcome {
        IdempotentOutcome::Fresh(stored) => (stored, false),
        IdempotentOutcome::Replay(stored) => (stored, true),
        IdempotentOutcome::Reused => return Err(Error::IdempotencyKeyReused),
    };
    let status = StatusCode::from_u16(stored.status).map_err(|e| Error::Internal(e.to_string()))?;
    let mut response = (
        status,
        [(header::CONTENT_TYPE, stored.content_type)],
        stored.body,
    )
        .into_response();
    let location = stored
        .location
        .as_deref()
        .map(HeaderValue::from_str)
        .transpose()
        .map_err(|e| Error::Internal(e.to_string()))?;
    response
        .headers_mut()
        .extend(location.map(|value| (header::LOCATION, value)));
    if replayed {
        response
            .headers_mut()
            .insert(IDEMPOTENCY_REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// An answer in JSON that is stored with the Idempotency-Key.
pub fn stored_json(
    status: u16,
    location: Option<String>,
    answer: &impl Serialize,
) -> Result<StoredResponse, Error> {
    Ok(StoredResponse {
        status,
        location,
        content_type: "application/json".into(),
        body: serde_json::to_vec(answer)?,
    })
}
