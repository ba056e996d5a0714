//! The OpenAPI document: the documentation of each route, and what all routes have in common.

use crate::http::document_examples::Examples;
use crate::http::route::Route;
use crate::http::routes::{ROUTES, routes};
use crate::wire::key::Scope;
use crate::wire::problem::PROBLEM_JSON;
use crate::wire::{Problem, bounds};
use axum::http::Method;
use std::sync::LazyLock;
use utoipa::OpenApi;
use utoipa::openapi::header::Header;
use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::server::ServerBuilder;
use utoipa::openapi::tag::TagBuilder;
use utoipa::openapi::{Content, Ref, RefOr, Response, ResponseBuilder};

/// Name of the key scheme in the document.
const KEY_SCHEME: &str = "key";

/// The address at which `kincal serve` listens by default.
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
        "# Made by `kincal openapi`; a test compares it with the code.\n{text}"
    ))
});

/// The document in YAML: `openapi.yaml`, `/openapi.yaml` and `kincal openapi`.
pub fn yaml() -> Result<&'static str, &'static str> {
    YAML.as_deref().map_err(String::as_str)
}

static JSON: LazyLock<Result<String, String>> =
    LazyLock::new(|| openapi().to_json().map_err(|error| error.to_string()));

/// The document in JSON: `/openapi.json`, which `/docs` reads.
pub fn json() -> Result<&'static str, &'static str> {
    JSON.as_deref().map_err(String::as_str)
}

/// The whole contract.
pub fn openapi() -> utoipa::openapi::OpenApi {
    let mut document = Base::openapi();
    document.merge(routes().into_openapi());
    bounds::write(&mut document);
    for route in ROUTES {
        if let Some(operation) = operation(&mut document, route) {
            add_common_parts(route, operation);
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
    for route in ROUTES {
        if let Some(operation) = operation(&mut document, route) {
            examples.write(operation);
        }
    }
    document
}

fn operation<'d>(
    document: &'d mut utoipa::openapi::OpenApi,
    route: &Route,
) -> Option<&'d mut Operation> {
    let item = document.paths.paths.get_mut(route.path)?;
    match route.method {
        Method::GET => item.get.as_mut(),
        Method::POST => item.post.as_mut(),
        Method::PUT => item.put.as_mut(),
        Method::PATCH => item.patch.as_mut(),
        Method::DELETE => item.delete.as_mut(),
        _ => None,
    }
}

/// Adds to an operation the problems, headers and scope that follow from its row in the table of routes.
fn add_common_parts(route: &Route, operation: &mut Operation) {
    let summary = operation.summary.clone();
    operation.description = operation.description.take().or(summary);
    for status in problem_statuses(route, operation.request_body.is_some()) {
        let problem = || RefOr::T(problem(route, status));
        let answers = &mut operation.responses.responses;
        answers.entry(status.to_string()).or_insert_with(problem);
    }
    if route.takes_idempotency_key {
        operation
            .parameters
            .get_or_insert_default()
            .push(RefOr::T(idempotency_key()));
        add_replayed_header(operation);
    }
    let scope = route.scope.map(Scope::as_str);
    let required = scope.map(|scope| SecurityRequirement::new::<_, _, &str>(KEY_SCHEME, [scope]));
    operation.security = Some(required.into_iter().collect());
}

/// Statuses of the problems that a route answers.
fn problem_statuses(route: &Route, takes_body: bool) -> Vec<u16> {
    let mut statuses = vec![400, 500];
    statuses.extend(route.problems);
    if route.scope.is_some() {
        statuses.extend([401, 403, 429, 503]);
    }
    if route.scope.is_some() && route.path.contains('{') {
        statuses.push(404);
    }
    if takes_body {
        statuses.extend([408, 413, 415]);
    }
    if takes_body || route.takes_idempotency_key {
        statuses.push(422);
    }
    statuses
}

fn description(route: &Route, status: u16) -> &'static str {
    match status {
        400 if route.scope.is_none() => "The Host header cannot be read",
        400 => "Path, query, header or body cannot be read",
        401 => "A key is needed",
        403 => "The key lacks the scope",
        404 => "It does not exist, or this key may not see it",
        408 => "The body did not arrive in time",
        409 => "It conflicts with the current state",
        413 => "The body is too large",
        415 => "The body is of another type",
        422 => "The request was parsed, but values in it are invalid: see `errors`",
        429 if route.problems.contains(&429) => {
            "Too many jobs of this robot wait, or too many requests come with this key"
        }
        429 => "Too many requests come with this key",
        503 => "The database is busy: try again",
        507 => "The disk is nearly full, so nothing new is stored",
        _ => "Internal error; the log has the cause",
    }
}

fn problem(route: &Route, status: u16) -> Response {
    let mut response = ResponseBuilder::new()
        .description(description(route, status))
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
        401 | 403 => header("WWW-Authenticate", "How to authenticate"),
        429 | 503 | 507 => header("Retry-After", "Seconds to wait"),
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

fn add_replayed_header(operation: &mut Operation) {
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
