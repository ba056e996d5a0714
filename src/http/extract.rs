//! Extractors whose errors are problem documents.

use crate::http::auth::Caller;
use crate::http::limits::{BodyBudget, LARGE_BODY_BYTES, MAX_BODY_BYTES, MIN_BYTES_PER_S};
use crate::http::{App, Error};
use crate::wire::{id, json};
use axum::body::{Body, Bytes};
use axum::extract::{FromRequestParts, Path, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use serde::de::DeserializeOwned;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::{Instant, timeout_at};

/// Largest JSON document that is parsed without a permit to compute. Measurement sets may be larger and are parsed with one.
pub const MAX_JSON_BYTES: usize = 4 * 1024 * 1024;

/// The id in a path. A text that cannot be an id answers 404 without a query to the database.
pub struct Id(pub String);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = Error;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Error> {
        let Path(id) = Path::<String>::from_request_parts(parts, state)
            .await
            .map_err(|_| Error::NotFound("resource"))?;
        if id::is_plausible(&id) {
            Ok(Self(id))
        } else {
            Err(Error::NotFound("resource"))
        }
    }
}

/// The query. Unknown names are refused, because a mistyped `frame` must not be ignored.
pub struct Query<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Query<T> {
    type Rejection = Error;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Error> {
        let query = axum::extract::Query::<T>::try_from_uri(&parts.uri);
        let axum::extract::Query(value) = query.map_err(|e| {
            // Only the cause: the prefix of axum's text does not help the client.
            let text = e.body_text();
            let detail = text
                .split_once("query string: ")
                .map_or(text.as_str(), |(_, cause)| cause);
            Error::invalid_query(format!("the query: {detail}"))
        })?;
        Ok(Self(value))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = Error;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Error> {
        Self::from_extensions(&parts.extensions)
    }
}

/// A request about one item: the state of the server, the caller, and the id in the path.
pub struct Item {
    /// The state of the server.
    pub app: App,
    /// The caller.
    pub caller: Caller,
    /// The id of the item, in the path.
    pub id: String,
}

impl FromRequestParts<App> for Item {
    type Rejection = Error;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Error> {
        Ok(Self {
            app: app.clone(),
            caller: Caller::from_request_parts(parts, app).await?,
            id: Id::from_request_parts(parts, app).await?.0,
        })
    }
}

/// The media type of a request, without its parameters, in lower case.
pub fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(
        value
            .split(';')
            .next()
            .unwrap_or(value)
            .trim()
            .to_ascii_lowercase(),
    )
}

/// The whole body of a request in JSON.
pub async fn json_body(request: Request, app: &App) -> Result<Bytes, Error> {
    let found = media_type(request.headers());
    if found.as_deref() != Some("application/json") {
        let found = found.unwrap_or_else(|| "without a Content-Type".into());
        return Err(Error::UnsupportedMediaType {
            found,
            expected: "application/json",
        });
    }
    whole_body(request, app).await
}

/// The whole body, within the limits of size, time and memory. Its permits are released when the bytes are dropped.
pub async fn whole_body(request: Request, app: &App) -> Result<Bytes, Error> {
    let headers = request.headers();
    let declared = headers
        .get(header::CONTENT_LENGTH)
        .and_then(|value| value.to_str().ok()?.parse::<usize>().ok());
    if declared.is_some_and(|bytes| bytes > MAX_BODY_BYTES) {
        return Err(too_large());
    }
    if let Some(encoding) = headers
        .get(header::CONTENT_ENCODING)
        .filter(|value| *value != "identity")
    {
        return Err(Error::UnsupportedMediaType {
            found: format!("{encoding:?}-encoded"),
            expected: "bodies without Content-Encoding",
        });
    }
    let class = Caller::from_extensions(request.extensions())?.class;
    let mut budget = app.limits.body_budget(class, declared)?;
    let client_timeout = app.limits.client_timeout();
    let bytes = read_body(request.into_body(), declared, &mut budget, client_timeout).await?;
    Ok(Bytes::from_owner(Received {
        bytes,
        _permits: budget.take_class_permit()?,
    }))
}

fn too_large() -> Error {
    Error::TooLarge {
        limit: MAX_BODY_BYTES,
        advice: "split what it holds, a measurement set for instance",
    }
}

/// Parses a JSON document of at most [`MAX_JSON_BYTES`].
///
/// # Errors
/// [`Error::TooLarge`], or those of parsing.
pub fn parse_small<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Error> {
    if bytes.len() > MAX_JSON_BYTES {
        return Err(Error::TooLarge {
            limit: MAX_JSON_BYTES,
            advice: "documents of this kind are small: check it for repeated content",
        });
    }
    Ok(json::parse(bytes)?)
}

/// A body and its permits.
struct Received {
    bytes: Vec<u8>,
    _permits: Vec<OwnedSemaphorePermit>,
}

impl AsRef<[u8]> for Received {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Reads a body as it arrives. A client that sends too slowly is disconnected, because its body holds memory that others need.
async fn read_body(
    mut body: Body,
    declared: Option<usize>,
    budget: &mut BodyBudget,
    client_timeout: Duration,
) -> Result<Vec<u8>, Error> {
    let begun = Instant::now();
    let mut bytes = Vec::with_capacity(declared.unwrap_or(0).min(
        if declared > Some(LARGE_BODY_BYTES) {
            MAX_BODY_BYTES
        } else {
            64 * 1024
        },
    ));
    loop {
        let deadline =
            begun + client_timeout + Duration::from_secs_f64(bytes.len() as f64 / MIN_BYTES_PER_S);
        let frame = timeout_at(deadline, body.frame())
            .await
            .map_err(|_| Error::RequestTimeout)?;
        let Some(frame) = frame else { return Ok(bytes) };
        let frame =
            frame.map_err(|error| Error::bad_request("unreadable_body", error.to_string()))?;
        // Trailers are ignored.
        let Ok(data) = frame.into_data() else {
            continue;
        };
        let length = bytes.len() + data.len();
        if length > MAX_BODY_BYTES {
            return Err(too_large());
        }
        budget.grow(length)?;
        bytes.extend_from_slice(&data);
    }
}
