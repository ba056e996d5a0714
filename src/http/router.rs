//! The whole service: the routes and the middleware around them.

use crate::http::index::Contract;
use crate::http::limits::response_memory;
use crate::http::routes::{ROUTES, routes};
use crate::http::{App, auth, document, host, layers};
use axum::middleware::{from_fn_with_state, map_response_with_state};
use axum::{Extension, Router};

/// The routes with their middleware.
pub fn router(app: App) -> Router {
    let (router, _) = routes().split_for_parts();
    let router = router
        .fallback(layers::no_such_route)
        .method_not_allowed_fallback(layers::method_not_allowed);
    let contract = Contract {
        yaml: document::yaml,
        json: document::json,
    };
    let guarded = router
        .layer(Extension(contract))
        .layer(map_response_with_state(app.clone(), response_memory::count))
        .layer(from_fn_with_state((app.clone(), ROUTES), auth::authorize))
        .layer(from_fn_with_state(app.clone(), host::check));
    layers::with_middleware(guarded, app.metrics.clone()).with_state(app)
}
