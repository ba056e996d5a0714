//! The OpenAPI document: the documentation of each route, and what all routes have in common.

use crate::http::auth::{PUBLIC_ROUTES, REQUIRED_SCOPES};
use crate::http::document_examples::Examples;
use crate::http::routes::routes;
use crate::wire::problem::PROBLEM_JSON;
use crate::wire::{Problem, bounds};
use axum::http::Method;
use std::sync::LazyLock;
use utoipa::OpenApi;
use utoipa::openapi::header::Header;
use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn, PathItem};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::server::ServerBuilder;
use utoipa::openapi::tag::TagBuilder;
use utoipa::openapi::{Content, Ref, RefOr, Response, ResponseBuilder};

/// Operations without a body that may answer 422, because of their query.
const UNPROCESSABLE: [&str; 2] = ["compareParameterSets", "exportParameterSet"];

/// Name of the key scheme in the document.
const KEY_SCHEME: &str = "key";
/// Operations that accept an `Idempotency-Key`.
const IDEMPOTENT: &[&str] = &[
    "createRobot",
    "checkedRobot",
    "createMeasurementSet",
    "createFrames",
    "createJob",
    "releaseParameterSet",
    "withdrawParameterSet",
    "rollBackParameterSet",
    "putPolicy",
    "editRobot",
    "archiveRobot",
    "restoreRobot",
    "archiveMeasurementSet",
    "restoreMeasurementSet",
    "archiveJob",
    "restoreJob",
    "archiveParameterSet",
    "restoreParameterSet",
    "archiveNetwork",
    "restoreNetwork",
];
/// Operations that may answer 409.
const CONFLICTS: &[&str] = &[
    "createMeasurementSet",
    "createFrames",
    "editRobot",
    "archiveJob",
    "archiveParameterSet",
    "createJob",
    "getReport",
    "getReportPage",
    "getConvergence",
    "releaseParameterSet",
    "withdrawParameterSet",
    "rollBackParameterSet",
];

/// The server that `kincal serve` starts.
const SERVER: &str = "http://127.0.0.1:8080";
/// Groups of operations.
const TAGS: &[(&str, &str)] = &[
    ("robots", "Nominal robots, their edits, states and policies"),
    ("measurement sets", "Uploads, kept byte for byte"),
    ("frames", "Base and tool frame from sweeps of single joints"),
    (
        "jobs",
        "Identifications and verifications, and their reports",
    ),
    (
        "parameter sets",
        "Identified parameters: release, use, export and comparison",
    ),
    ("networks", "Networks that later jobs start from"),
    ("pose plans", "Which poses to measure next"),
    ("service", "State of the server, its contract and its pages"),
];

const DESCRIPTION: &str = "Calibrates industrial robots: upload measured poses, post a job, fetch the compensated parameters. \
    Every answer that is not a success is a problem (RFC 9457) with a stable `code`. Lists are paged by `limit` and `cursor`, newest first unless `sort` says otherwise. \
    Times are RFC 3339 UTC, identifiers opaque; lengths are millimetres, angles degrees.";

#[derive(OpenApi)]
#[openapi(info(title = "kincal", description = DESCRIPTION, license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")), components(schemas(Problem)))]
struct Base;

static YAML: LazyLock<Result<String, String>> = LazyLock::new(|| {
    let text = openapi().to_yaml().map_err(|error| error.to_string())?;
    Ok(format!(
        "# Made by `kincal openapi`; a test holds it to the code.\n{text}"
    ))
});

/// The document in YAML: `openapi.yaml`, `/openapi.yaml` and `kincal openapi`.
///
/// # Errors
/// If it cannot be serialised; does not happen.
pub fn yaml() -> Result<&'static str, &'static str> {
    YAML.as_deref().map_err(String::as_str)
}

static JSON: LazyLock<Result<String, String>> =
    LazyLock::new(|| openapi().to_json().map_err(|error| error.to_string()));

/// The document in JSON: `/openapi.json`, which `/docs` reads.
///
/// # Errors
/// If it cannot be serialised; does not happen.
pub fn json() -> Result<&'static str, &'static str> {
    JSON.as_deref().map_err(String::as_str)
}

/// The whole contract.
pub fn openapi() -> utoipa::openapi::OpenApi {
    let mut document = Base::openapi();
    document.merge(routes().into_openapi());
    bounds::write(&mut document);
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in operations(item) {
            complete(&method, path, operation);
        }
    }
    let scheme = HttpBuilder::new()
        .scheme(HttpAuthScheme::Bearer)
        .description(Some("`kincal key create` makes one"))
        .build();
    let components = document.components.get_or_insert_default();
    components.add_security_scheme(KEY_SCHEME, SecurityScheme::Http(scheme));
    document.servers = Some(vec![
        ServerBuilder::new()
            .url(SERVER)
            .description(Some("`kincal serve` on this machine"))
            .build(),
    ]);
    document.tags = Some(
        TAGS.iter()
            .map(|(name, description)| {
                TagBuilder::new()
                    .name(*name)
                    .description(Some(*description))
                    .build()
            })
            .collect(),
    );
    let examples = Examples::new(&document);
    for item in document.paths.paths.values_mut() {
        operations(item).for_each(|(_, operation)| examples.write(operation));
    }
    document
}

fn operations(item: &mut PathItem) -> impl Iterator<Item = (Method, &mut Operation)> {
    let methods = [
        Method::GET,
        Method::POST,
        Method::PUT,
        Method::DELETE,
        Method::PATCH,
    ];
    let operations = [
        &mut item.get,
        &mut item.post,
        &mut item.put,
        &mut item.delete,
        &mut item.patch,
    ];
    methods
        .into_iter()
        .zip(operations)
        .filter_map(|(method, operation)| Some((method, operation.as_mut()?)))
}

/// Adds to an operation the answers, headers and scope that come from layers and extractors.
fn complete(method: &Method, path: &str, operation: &mut Operation) {
    let id = operation.operation_id.clone().unwrap_or_default();
    let takes_body = operation.request_body.is_some();
    let mut add = |status: &str, description: &str| {
        operation
            .responses
            .responses
            .entry(status.into())
            .or_insert_with(|| RefOr::T(problem(status, description)));
    };
    add("500", "Internal error; the log has the cause");
    let summary = operation.summary.clone();
    operation.description = operation.description.take().or(summary);
    if PUBLIC_ROUTES.contains(&path) {
        let refused = problem("400", "The Host header cannot be read");
        let answers = &mut operation.responses.responses;
        answers.entry("400".into()).or_insert(RefOr::T(refused));
        operation.security = Some(Vec::new());
        return;
    }
    let mut add = |status: &str, description: &str| {
        operation
            .responses
            .responses
            .entry(status.into())
            .or_insert_with(|| RefOr::T(problem(status, description)));
    };
    add("400", "Path, query, header or body cannot be read");
    add("401", "A key is needed");
    add("403", "The key lacks the scope");
    // `listAllJobs` takes the robot as a filter
    if path.contains('{') || id == "listAllJobs" {
        add("404", "It does not exist, or this key may not see it");
    }
    add("503", "The database is busy: try again");
    if UNPROCESSABLE.contains(&id.as_str()) {
        add(
            "422",
            "The request was parsed, but values in it are invalid: see `errors`",
        );
    }
    if takes_body {
        add("408", "The body did not arrive in time");
        add("413", "The body is too large");
        add("415", "The body is of another type");
        add(
            "422",
            "The request was parsed, but values in it are invalid: see `errors`",
        );
    }
    if CONFLICTS.contains(&id.as_str()) {
        add("409", "It conflicts with the current state");
    }
    if id == "createJob" {
        add("429", "Too many jobs of this robot wait");
    }
    if IDEMPOTENT.contains(&id.as_str()) {
        operation
            .parameters
            .get_or_insert_default()
            .push(RefOr::T(idempotency_key()));
        replayed(operation);
    }
    let scope = REQUIRED_SCOPES
        .iter()
        .find(|route| route.method == method && route.path == path)
        .map(|route| route.scope.as_str())
        .unwrap_or_default();
    operation.security = Some(vec![SecurityRequirement::new::<_, _, &str>(
        KEY_SCHEME,
        [scope],
    )]);
}

fn problem(status: &str, description: &str) -> Response {
    let mut response = ResponseBuilder::new()
        .description(description)
        .content(
            PROBLEM_JSON,
            Content::new(Some(Ref::from_schema_name("Problem"))),
        )
        .build();
    let mut header = |name: &str, description: &str| {
        response
            .headers
            .insert(name.into(), RefOr::T(text_header(description)));
    };
    match status {
        "401" | "403" => header("WWW-Authenticate", "How to authenticate"),
        "429" | "503" => header("Retry-After", "Seconds to wait"),
        _ => {}
    }
    response
}

fn text_header(description: &str) -> Header {
    let mut header = Header::new(ObjectBuilder::new().schema_type(Type::String).build());
    header.description = Some(description.into());
    header
}

fn idempotency_key() -> Parameter {
    let schema = ObjectBuilder::new()
        .schema_type(Type::String)
        .min_length(Some(1))
        .max_length(Some(200))
        .pattern(Some("^[ -~]+$"))
        .build();
    ParameterBuilder::new()
        .name("Idempotency-Key")
        .parameter_in(ParameterIn::Header)
        .description(Some(
            "Makes a retry harmless: the same key and request give the first answer again",
        ))
        .schema(Some(schema))
        .build()
}

fn replayed(operation: &mut Operation) {
    for (status, response) in &mut operation.responses.responses {
        if let (true, RefOr::T(response)) = (status.starts_with('2'), response) {
            response.headers.insert(
                "Idempotency-Replayed".into(),
                RefOr::T(text_header(
                    "`true` if this is the answer of an earlier request",
                )),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::openapi;
    use crate::wire::bounds;

    #[test]
    fn every_field_whose_bounds_are_written_is_there() {
        assert_eq!(bounds::write(&mut openapi()), Vec::<String>::new());
    }
}
