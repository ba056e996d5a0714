//! The dashboard: static files that use the public interface only. They are part of the binary, because factories are offline.

use crate::http::headers::matches_etag;
use crate::http::{App, Error};
use crate::wire::canonical;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::sync::LazyLock;

/// Allows only scripts, styles and requests of this server. Inline code is not allowed, and scripts cannot write strings as markup.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; trusted-types 'none'";
const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// Attribute of the start page that tells its scripts that the server requires a key.
const AUTH_MARK: &str = "data-auth=\"key\"";
const NO_AUTH_MARK: &str = "data-auth=\"none\"";

/// One file of `web/`.
struct Asset {
    name: &'static str,
    content_type: &'static str,
    text: &'static str,
}

macro_rules! assets {
    ($($name:literal: $content_type:expr),+ $(,)?) => {
        &[$(Asset { name: $name, content_type: $content_type, text: include_str!(concat!("../../web/", $name)) }),+]
    };
}

const INDEX: &str = include_str!("../../web/index.html");
const DOCS: &str = include_str!("../../web/docs.html");
const ASSETS: &[Asset] = assets! {
    "style.css": CSS,
    "icon.svg": SVG,
    "api.js": JAVASCRIPT,
    "app.js": JAVASCRIPT,
    "arm.js": JAVASCRIPT,
    "cell.js": JAVASCRIPT,
    "charts.js": JAVASCRIPT,
    "check.js": JAVASCRIPT,
    "columns.js": JAVASCRIPT,
    "contents.js": JAVASCRIPT,
    "compare.js": JAVASCRIPT,
    "correct.js": JAVASCRIPT,
    "csv.js": JAVASCRIPT,
    "docs.js": JAVASCRIPT,
    "dom.js": JAVASCRIPT,
    "figures.js": JAVASCRIPT,
    "format.js": JAVASCRIPT,
    "gate_texts.js": JAVASCRIPT,
    "history.js": JAVASCRIPT,
    "job.js": JAVASCRIPT,
    "job_form.js": JAVASCRIPT,
    "job_options.js": JAVASCRIPT,
    "jobs.js": JAVASCRIPT,
    "joint_maps.js": JAVASCRIPT,
    "kinematics.js": JAVASCRIPT,
    "leave_out.js": JAVASCRIPT,
    "manage.js": JAVASCRIPT,
    "new_robot.js": JAVASCRIPT,
    "next.js": JAVASCRIPT,
    "list_facts.js": JAVASCRIPT,
    "plan.js": JAVASCRIPT,
    "points.js": JAVASCRIPT,
    "polling.js": JAVASCRIPT,
    "poses.js": JAVASCRIPT,
    "posture.js": JAVASCRIPT,
    "references.js": JAVASCRIPT,
    "remedies.js": JAVASCRIPT,
    "residuals.js": JAVASCRIPT,
    "result.js": JAVASCRIPT,
    "result_points.js": JAVASCRIPT,
    "robot.js": JAVASCRIPT,
    "robot_file.js": JAVASCRIPT,
    "robots.js": JAVASCRIPT,
    "rotations.js": JAVASCRIPT,
    "rows.js": JAVASCRIPT,
    "save.js": JAVASCRIPT,
    "scene.js": JAVASCRIPT,
    "selection.js": JAVASCRIPT,
    "sessions.js": JAVASCRIPT,
    "sheets.js": JAVASCRIPT,
    "solids.js": JAVASCRIPT,
    "take_along.js": JAVASCRIPT,
    "upload.js": JAVASCRIPT,
    "verdicts.js": JAVASCRIPT,
    "words.js": JAVASCRIPT,
    "workspace.js": JAVASCRIPT,
};

/// One tag for all files: they change together, with the binary.
static ETAG: LazyLock<String> = LazyLock::new(|| {
    let all: Vec<&str> = ASSETS
        .iter()
        .map(|asset| asset.text)
        .chain([INDEX, DOCS])
        .collect();
    format!("\"{}\"", canonical::sha256_hex(all.concat().as_bytes()))
});

/// The dashboard.
#[utoipa::path(get, path = "/", tag = "service", operation_id = "index", responses((status = 200, description = "A page", body = String, content_type = "text/html")))]
pub async fn index(State(app): State<App>) -> Response {
    let page = if app.no_auth {
        INDEX.replace(AUTH_MARK, NO_AUTH_MARK)
    } else {
        INDEX.to_owned()
    };
    html(page)
}

fn html(page: impl IntoResponse) -> Response {
    let headers = [
        (header::CONTENT_TYPE, HTML),
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    (headers, page).into_response()
}

/// This contract as a page.
#[utoipa::path(get, path = "/docs", tag = "service", operation_id = "docs", responses((status = 200, description = "A page", body = String, content_type = "text/html")))]
pub async fn docs() -> Response {
    html(DOCS)
}

/// Scripts and styles of the pages.
#[utoipa::path(
    get, path = "/assets/{file}", tag = "service", operation_id = "asset", params(("file" = String, Path, description = "One of the files that the pages name")),
    responses(
        (status = 200, description = "The file", content((String = "text/css"), (String = "text/javascript"), (String = "image/svg+xml"))),
        (status = 304, description = "Still the file of that ETag"),
        (status = 404, description = "No such file", body = crate::wire::Problem, content_type = "application/problem+json")
    )
)]
pub async fn asset(Path(file): Path<String>, headers: HeaderMap) -> Result<Response, Error> {
    let asset = ASSETS
        .iter()
        .find(|asset| asset.name == file)
        .ok_or(Error::NotFound("file"))?;
    let fresh = [
        (header::ETAG, ETAG.as_str()),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    if matches_etag(&headers, &ETAG) {
        return Ok((StatusCode::NOT_MODIFIED, fresh).into_response());
    }
    Ok((
        fresh,
        [(header::CONTENT_TYPE, asset.content_type)],
        asset.text,
    )
        .into_response())
}

#[cfg(test)]
mod tests {
    use super::{ASSETS, AUTH_MARK, DOCS, INDEX};

    #[test]
    fn the_front_page_has_the_place_that_says_whether_a_key_is_needed() {
        assert_eq!(INDEX.matches(AUTH_MARK).count(), 1);
    }

    #[test]
    fn the_pages_hold_nothing_that_their_policy_would_refuse() {
        for (name, text) in ASSETS
            .iter()
            .map(|a| (a.name, a.text))
            .chain([("index.html", INDEX), ("docs.html", DOCS)])
        {
            for forbidden in [
                " style=",
                "<style",
                " onclick=",
                "innerHTML",
                "outerHTML",
                "insertAdjacentHTML",
                "document.write",
                "eval(",
                "//cdn",
            ] {
                assert!(!text.contains(forbidden), "{name} holds {forbidden}");
            }
        }
    }

    #[test]
    fn every_file_of_the_folder_is_served() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/web");
        for entry in std::fs::read_dir(folder).expect("web/ is there") {
            let name = entry
                .expect("web/ is readable")
                .file_name()
                .into_string()
                .expect("UTF-8");
            let page = name.ends_with(".html");
            assert!(
                page || ASSETS.iter().any(|asset| asset.name == name),
                "web/{name} is not in ASSETS"
            );
        }
    }
}
