//! Documents that a robot has under a name (mappings of columns, work frames, tools): their list, the newest version, and a new version.

use crate::http::auth::Caller;
use crate::http::creation::{Submission, stored_json};
use crate::http::{App, Error, access};
use crate::store::named_documents::{self, NamedDocumentKind, NewNamedDocument};
use crate::store::{self, NamedDocumentRow, StoredResponse, Tx};
use axum::Json;
use axum::response::Response;
use serde::Serialize;

/// The answer for documents of one kind.
pub trait DocumentAnswer: for<'r> TryFrom<&'r NamedDocumentRow, Error = Error> + Serialize {
    /// The kind.
    const KIND: NamedDocumentKind;
}

/// The newest version of a document.
pub async fn get<A: DocumentAnswer>(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    name: &str,
) -> Result<Json<A>, Error> {
    access::robot(app, caller, robot_id).await?;
    let row = newest(app, robot_id, A::KIND, name).await?;
    Ok(Json(A::try_from(&row)?))
}

/// Stores the checked body of a request as the new version of a document. `answer` makes the response.
pub async fn store<A: DocumentAnswer>(
    robot_id: &str,
    name: &str,
    submission: &Submission,
    body: impl Serialize,
    answer: impl Fn(&A) -> Result<StoredResponse, Error>,
) -> Result<Response, Error> {
    let new = NewNamedDocument {
        robot_id,
        kind: A::KIND,
        name,
        content_json: &serde_json::to_string(&body)?,
        by: &submission.caller.holder,
    };
    let effect = async |tx: &mut Tx| {
        let row = named_documents::insert(tx, new).await?;
        answer(&A::try_from(&row)?)
    };
    submission.create(effect).await
}

/// As [`store`], for a document whose path is known to the client.
pub async fn put<A: DocumentAnswer>(
    robot_id: &str,
    name: &str,
    submission: &Submission,
    body: impl Serialize,
) -> Result<Response, Error> {
    let answer = |stored: &A| stored_json(200, None, stored);
    store(robot_id, name, submission, body, answer).await
}

/// The row of the newest version.
pub async fn newest(
    app: &App,
    robot_id: &str,
    kind: NamedDocumentKind,
    name: &str,
) -> Result<NamedDocumentRow, Error> {
    let row = named_documents::newest(&app.store, robot_id, kind, name).await;
    row.map_err(|error| match error {
        store::Error::NotFound => Error::NotFound(kind_name(kind)),
        other => other.into(),
    })
}

fn kind_name(kind: NamedDocumentKind) -> &'static str {
    match kind {
        NamedDocumentKind::Columns => "mapping of columns",
        NamedDocumentKind::WorkFrame => "work frame",
        NamedDocumentKind::Tool => "tool",
        NamedDocumentKind::Reference => "reference",
    }
}
