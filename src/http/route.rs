//! Description of one route. The table of all routes is in `routes.rs`.

use crate::http::App;
use crate::http::limits::RequestClass;
use crate::wire::key::Scope;
use axum::http::Method;
use utoipa_axum::router::OpenApiRouter;

/// A row of the table of routes.
#[derive(Debug)]
pub struct Route {
    /// Its method. A GET answers HEAD, too.
    pub method: Method,
    /// Its path, as a template.
    pub path: &'static str,
    /// The scope that the key needs; `None` if the route needs no key.
    pub scope: Option<Scope>,
    /// Its class for limits.
    pub class: RequestClass,
    /// Whether it takes an `Idempotency-Key`.
    pub takes_idempotency_key: bool,
    /// Statuses of its problems, beyond those that follow from the other fields.
    pub problems: &'static [u16],
    /// Adds its handler and the handler's documentation to a router.
    pub(super) mount: fn(OpenApiRouter<App>) -> OpenApiRouter<App>,
}

impl Route {
    /// Whether a method asks for this route.
    pub fn matches_method(&self, method: &Method) -> bool {
        self.method == method || (self.method == Method::GET && method == Method::HEAD)
    }

    /// Whether a path fits the template.
    fn matches_path(&self, path: &str) -> bool {
        let mut segments = path.split('/');
        let is_same = |template: &str| {
            let segment = segments.next();
            segment.is_some_and(|segment| segment == template || template.starts_with('{'))
        };
        self.path.split('/').all(is_same) && segments.next().is_none()
    }
}

/// The class of a request. A request without a route has a class too, so that a flood of such requests is refused before routing.
pub fn class_of(routes: &[Route], method: &Method, path: &str) -> RequestClass {
    let route = routes
        .iter()
        .find(|route| route.matches_method(method) && route.matches_path(path));
    match (route, method) {
        (Some(route), _) => route.class,
        (None, &Method::GET | &Method::HEAD | &Method::OPTIONS) => RequestClass::Read,
        (None, _) => RequestClass::Write,
    }
}
