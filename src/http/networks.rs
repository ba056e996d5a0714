//! Trained networks.

use crate::http::extract::Item;
use crate::http::list_query::{PlainListQuery, list_of_robot};
use crate::http::{Error, access, file_name};
use crate::store::{NetworkRow, networks};
use crate::wire::network::NetworkAnswer;
use crate::wire::page::Page;
use crate::wire::safetensors::NetworkMetadata;
use crate::wire::time::rfc3339;
use axum::Json;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};

list_of_robot! {
    /// A robot's networks.
    list: "/v1/robots/{robot_id}/networks" "networks" "listNetworks", PlainListQuery NetworkAnswer, networks::search
}

/// Metadata of a network.
#[utoipa::path(
    get, path = "/v1/networks/{id}", tag = "networks", operation_id = "getNetwork", params(("id" = String, Path, description = "The network")),
    responses((status = 200, description = "The network", body = NetworkAnswer))
)]
pub async fn get(Item { app, caller, id }: Item) -> Result<Json<NetworkAnswer>, Error> {
    let row = access::network(&app, &caller, &id).await?;
    Ok(Json((&row).try_into()?))
}

/// A network's weights, in the safetensors format.
#[utoipa::path(
    get, path = "/v1/networks/{id}/weights", tag = "networks", operation_id = "getNetworkWeights", params(("id" = String, Path, description = "The network")),
    responses((status = 200, description = "safetensors, 64-bit floats", body = Vec<u8>, content_type = "application/octet-stream"))
)]
pub async fn weights(Item { app, caller, id }: Item) -> Result<Response, Error> {
    let _permit = app.limits.compute_permit(caller.class).await?;
    let row = access::network(&app, &caller, &id).await?;
    let disposition =
        file_name::attachment(&app, &row.robot_id, &row.job_id, &id, "safetensors").await?;
    let content_type = HeaderValue::from_static("application/octet-stream");
    let headers = [
        (header::CONTENT_TYPE, content_type),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    Ok((headers, networks::weights(&app.store, &id).await?).into_response())
}

impl TryFrom<&NetworkRow> for NetworkAnswer {
    type Error = Error;

    fn try_from(row: &NetworkRow) -> Result<Self, Error> {
        let NetworkMetadata {
            kind,
            parameter_names,
            model,
            preset,
            n_hidden,
            training_error,
            validation_error,
        } = serde_json::from_str(&row.metadata_json)?;
        Ok(Self {
            id: row.id.clone(),
            kind,
            robot_id: row.robot_id.clone(),
            job_id: row.job_id.clone(),
            model,
            preset,
            parameter_names,
            n_hidden,
            training_error,
            validation_error,
            sha256: row.weights_sha256.clone(),
            created_at: rfc3339(row.created_at_ms),
            archived_at: row.archived_at_ms.map(rfc3339),
        })
    }
}
