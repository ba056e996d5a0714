//! Extractors whose refusals are problems.

use crate::http::auth::Caller;
use crate::http::{Error, MAX_BODY_BYTES};
use crate::store::{Cursor, PageRequest};
use crate::wire::page::{DEFAULT_PAGE, MAX_PAGE};
use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Path, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::time::Duration;
use utoipa::IntoParams;

/// Longest id that is looked up; ours have 36 characters.
const MAX_ID: usize = 100;
/// How long a body may take to arrive.
const BODY_TIMEOUT: Duration = Duration::from_secs(60);

/// The id in a path. Anything that cannot be one of ours is not looked up.
pub struct Id(pub String);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = Error;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Error> {
        let Path(id) = Path::<String>::from_request_parts(parts, state).await.map_err(|_| Error::NotFound("resource"))?;
        let plausible = id.len() <= MAX_ID && id.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
        if plausible { Ok(Self(id)) } else { Err(Error::NotFound("resource")) }
    }
}

/// The query; unknown names are refused, because a mistyped `frame` must not be ignored.
pub struct Query<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Query<T> {
    type Rejection = Error;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Error> {
        let query = axum::extract::Query::<T>::try_from_uri(&parts.uri);
        let axum::extract::Query(value) = query.map_err(|e| Error::BadRequest { code: "invalid_query", detail: e.body_text() })?;
        Ok(Self(value))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = Error;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Error> {
        parts.extensions.get::<Self>().cloned().ok_or_else(|| Error::Internal("a route without authorisation".into()))
    }
}

/// Query of every list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ListQuery {
    /// Items on the page.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

impl ListQuery {
    /// The store's request.
    pub fn page(self) -> Result<PageRequest, Error> {
        let limit = self.limit.unwrap_or(DEFAULT_PAGE);
        if !(1..=MAX_PAGE).contains(&limit) {
            return Err(Error::BadRequest { code: "invalid_query", detail: format!("limit is {limit}; 1 to {MAX_PAGE} is allowed") });
        }
        let cursor = self.cursor.map(|text| text.parse::<Cursor>()).transpose();
        let cursor =
            cursor.map_err(|e| Error::BadRequest { code: "invalid_cursor", detail: format!("{e}: pass next_cursor on as it is") })?;
        Ok(PageRequest { limit, cursor })
    }
}

/// The media type of a request, without its parameters, in lower case.
pub fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next().unwrap_or(value).trim().to_ascii_lowercase())
}

/// The whole body, within size and time.
pub async fn whole_body<S: Send + Sync>(request: Request, state: &S) -> Result<Bytes, Error> {
    let headers = request.headers();
    let length = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<usize>().ok());
    if length.is_some_and(|length| length > MAX_BODY_BYTES) {
        return Err(Error::TooLarge { limit: MAX_BODY_BYTES });
    }
    if let Some(encoding) = headers.get(header::CONTENT_ENCODING).filter(|value| *value != "identity") {
        return Err(Error::UnsupportedMediaType { found: format!("{encoding:?}-encoded"), expected: "bodies without Content-Encoding" });
    }
    let body = tokio::time::timeout(BODY_TIMEOUT, Bytes::from_request(request, state)).await.map_err(|_| Error::RequestTimeout)?;
    body.map_err(|rejection| match rejection.status().as_u16() {
        413 => Error::TooLarge { limit: MAX_BODY_BYTES },
        _ => Error::BadRequest { code: "unreadable_body", detail: rejection.body_text() },
    })
}
