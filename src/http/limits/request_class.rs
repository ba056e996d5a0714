//! Classes of requests with different limits.

use axum::http::Method;

/// Last path segments of [`RequestClass::Calculation`].
const CALCULATIONS: [&str; 6] = [
    "predict",
    "compensate",
    "export",
    "pose-plans",
    "posture",
    "robot-imports",
];
/// Last path segments of [`RequestClass::Safety`].
const SAFETY: [&str; 3] = ["withdraw", "rollback", "cancel"];
/// Last path segments of [`RequestClass::CostlyRead`].
const COSTLY_READS: [&str; 9] = [
    "points",
    "weights",
    "report",
    "convergence",
    "report.html",
    "history",
    "compare",
    "export",
    "gates",
];

/// Class of a request for limits. It follows from method and path alone, so that a flood can be refused before routing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestClass {
    /// Reads some rows.
    Read,
    /// Reads a whole document, or computes from what is stored.
    CostlyRead,
    /// Computes from its body and stores nothing.
    Calculation,
    /// Withdraw, rollback and cancel, which have permits of their own.
    Safety,
    /// All other requests that are not reads.
    Write,
}

impl RequestClass {
    /// The class of a request, even if its path does not exist.
    pub fn new(method: &Method, path: &str) -> Self {
        let last = path.rsplit('/').next().unwrap_or_default();
        match *method {
            Method::GET | Method::HEAD | Method::OPTIONS => {
                if COSTLY_READS.contains(&last) {
                    Self::CostlyRead
                } else {
                    Self::Read
                }
            }
            // signing in and out looks a key up and stores nothing
            Method::PUT | Method::DELETE if path == "/v1/session" => Self::Read,
            Method::POST if CALCULATIONS.contains(&last) => Self::Calculation,
            Method::POST if SAFETY.contains(&last) => Self::Safety,
            _ => Self::Write,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{CALCULATIONS, COSTLY_READS, RequestClass, SAFETY};
    use crate::http::auth::{REQUIRED_SCOPES, ScopedRoute};
    use crate::wire::key::Scope;
    use axum::http::Method;

    #[test]
    fn requests_of_the_scope_read_take_no_permits_of_writes() {
        for ScopedRoute {
            method,
            path,
            scope,
        } in REQUIRED_SCOPES
        {
            let class = RequestClass::new(method, path);
            // An import reads its body and stores nothing.
            let only_reads = *scope == Scope::Read || *path == "/v1/robot-imports";
            assert_eq!(
                only_reads,
                matches!(
                    class,
                    RequestClass::Read | RequestClass::CostlyRead | RequestClass::Calculation
                ),
                "{method} {path}: {class:?}"
            );
        }
    }

    #[test]
    fn each_path_segment_is_that_of_a_route() {
        let posts = CALCULATIONS
            .iter()
            .chain(&SAFETY)
            .map(|name| (Method::POST, name));
        let gets = COSTLY_READS.iter().map(|name| (Method::GET, name));
        for (method, name) in posts.chain(gets) {
            let is_routes = |route: &ScopedRoute| {
                route.method == method && route.path.ends_with(&format!("/{name}"))
            };
            assert!(REQUIRED_SCOPES.iter().any(is_routes), "{name}");
        }
    }
}
