//! Every route: its path and handler, who may call it, its limits, and what its documentation adds.

use crate::http::limits::RequestClass;
use crate::http::route::Route;
use crate::http::{
    App, archive, columns, compensate, dashboard, export, frames, history, index, job_events,
    job_posting, jobs, measurement_sets, metrics, named_frames, networks, overview, parameter_sets,
    policies, pose_plans, predict, references, release, report_html, robot_models, robots, session,
};
use crate::wire::key::Scope;
use axum::http::Method;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Makes [`ROUTES`]. A row has the method, the path, the handler, the scope (`Public` for a route without a key), the class, `key` if the route takes
/// an `Idempotency-Key`, and [`Route::problems`].
macro_rules! table {
    ($($method:ident $path:literal $file:ident::$handler:ident $scope:ident $class:ident $($key:ident)? $([$($problem:literal)+])?;)+) => {
        &[$(Route {
            method: Method::$method,
            path: $path,
            scope: table!(@scope $scope),
            class: RequestClass::$class,
            takes_idempotency_key: table!(@takes $($key)?),
            problems: &[$($($problem),+)?],
            mount: |router| router.routes(routes!($file::$handler)),
        }),+]
    };
    (@scope Public) => { None };
    (@scope $scope:ident) => { Some(Scope::$scope) };
    (@takes) => { false };
    (@takes key) => { true };
}

/// Every route. Nothing else is answered.
pub const ROUTES: &[Route] = table! {
    // Pages and state of the server
    GET    "/"                                                  dashboard::index                         Public   Read;
    GET    "/assets/{file}"                                     dashboard::asset                         Public   Read;
    GET    "/docs"                                              dashboard::docs                          Public   Read;
    GET    "/healthz"                                           index::healthz                           Public   Read;
    GET    "/metrics"                                           metrics::metrics                         Read     Read;
    GET    "/openapi.json"                                      index::openapi_json                      Public   Read;
    GET    "/openapi.yaml"                                      index::openapi_yaml                      Public   Read;
    GET    "/readyz"                                            index::readyz                            Public   Read;
    GET    "/v1/me"                                             session::me                              Read     Read;
    PUT    "/v1/session"                                        session::sign_in                         Read     Read;
    DELETE "/v1/session"                                        session::sign_out                        Read     Read;
    // Robots
    GET    "/v1/overview"                                       overview::list                           Read     Read;
    POST   "/v1/robot-imports"                                  export::import_robot                     Upload   Calculation;
    GET    "/v1/robot-models"                                   robot_models::list                       Read     Read;
    GET    "/v1/robot-models/{id}"                              robot_models::get                        Read     Read;
    GET    "/v1/robots"                                         robots::list                             Read     Read;
    POST   "/v1/robots"                                         robots::create                           Upload   Write       key [507];
    GET    "/v1/robots/{robot_id}"                              robots::get                              Read     Read;
    PATCH  "/v1/robots/{robot_id}"                              robots::edit                             Upload   Write       key [409 507];
    POST   "/v1/robots/{robot_id}/archive"                      archive::archive_robot                   Upload   Write       key;
    POST   "/v1/robots/{robot_id}/checked"                      robots::checked                          Release  Write       key [409];
    GET    "/v1/robots/{robot_id}/history"                      history::history                         Read     CostlyRead;
    GET    "/v1/robots/{robot_id}/policy"                       policies::get                            Read     Read;
    PUT    "/v1/robots/{robot_id}/policy"                       policies::put                            Admin    Write       key [409];
    POST   "/v1/robots/{robot_id}/pose-plans"                   pose_plans::create                       Read     Calculation;
    POST   "/v1/robots/{robot_id}/posture"                      robot_models::posture                    Read     Calculation;
    POST   "/v1/robots/{robot_id}/restore"                      archive::restore_robot                   Upload   Write       key;
    GET    "/v1/robots/{robot_id}/tools"                        named_frames::list_tools                 Read     Read;
    GET    "/v1/robots/{robot_id}/tools/{name}"                 named_frames::get_tool                   Read     Read;
    PUT    "/v1/robots/{robot_id}/tools/{name}"                 named_frames::put_tool                   Upload   Write       key [409 507];
    GET    "/v1/robots/{robot_id}/work-frames"                  named_frames::list_work_frames           Read     Read;
    GET    "/v1/robots/{robot_id}/work-frames/{name}"           named_frames::get_work_frame             Read     Read;
    PUT    "/v1/robots/{robot_id}/work-frames/{name}"           named_frames::put_work_frame             Upload   Write       key [409 507];
    // Measurement sets and frames
    GET    "/v1/frames/{id}"                                    frames::get                              Read     Read;
    GET    "/v1/measurement-sets/{id}"                          measurement_sets::get                    Read     Read;
    POST   "/v1/measurement-sets/{id}/archive"                  archive::archive_measurement_set         Upload   Write       key;
    GET    "/v1/measurement-sets/{id}/points"                   measurement_sets::points                 Read     CostlyRead;
    POST   "/v1/measurement-sets/{id}/restore"                  archive::restore_measurement_set         Upload   Write       key;
    GET    "/v1/robots/{robot_id}/columns"                      columns::list                            Read     Read;
    GET    "/v1/robots/{robot_id}/columns/{name}"               columns::get                             Read     Read        [422];
    PUT    "/v1/robots/{robot_id}/columns/{name}"               columns::put                             Upload   Write       key [409 507];
    POST   "/v1/robots/{robot_id}/frames"                       frames::create                           Upload   Write       key [409 507];
    GET    "/v1/robots/{robot_id}/measurement-sets"             measurement_sets::list                   Read     Read;
    POST   "/v1/robots/{robot_id}/measurement-sets"             measurement_sets::create                 Upload   Write       key [409 507];
    // A preview stores nothing, but comes before every upload in the dashboard: like an upload, it does not wait behind pose plans.
    POST   "/v1/robots/{robot_id}/measurement-sets/preview"     columns::preview                         Upload   Write;
    GET    "/v1/robots/{robot_id}/references"                   references::list                         Read     Read;
    POST   "/v1/robots/{robot_id}/references"                   references::create                       Upload   Write       key [409 507];
    GET    "/v1/robots/{robot_id}/references/{id}"              references::get                          Read     Read;
    // Jobs
    GET    "/v1/jobs"                                           jobs::list_all                           Read     Read        [404];
    GET    "/v1/jobs/{id}"                                      jobs::get                                Read     Read;
    POST   "/v1/jobs/{id}/archive"                              archive::archive_job                     Identify Write       key [409];
    POST   "/v1/jobs/{id}/cancel"                               jobs::cancel                             Identify Safety;
    GET    "/v1/jobs/{id}/convergence"                          jobs::convergence                        Read     CostlyRead  [409];
    GET    "/v1/jobs/{id}/events"                               job_events::events                       Read     Read;
    GET    "/v1/jobs/{id}/report"                               jobs::report                             Read     CostlyRead  [409];
    GET    "/v1/jobs/{id}/report.html"                          report_html::report_html                 Read     CostlyRead  [409];
    POST   "/v1/jobs/{id}/restore"                              archive::restore_job                     Identify Write       key;
    GET    "/v1/robots/{robot_id}/jobs"                         jobs::list                               Read     Read;
    POST   "/v1/robots/{robot_id}/jobs"                         job_posting::create                      Identify Write       key [409 429 507];
    // Parameter sets
    GET    "/v1/parameter-sets/{id}"                            parameter_sets::get                      Read     Read;
    POST   "/v1/parameter-sets/{id}/archive"                    archive::archive_parameter_set           Release  Write       key [409];
    GET    "/v1/parameter-sets/{id}/compare"                    history::compare                         Read     CostlyRead  [422];
    POST   "/v1/parameter-sets/{id}/compensate"                 compensate::compensate                   Read     Calculation;
    POST   "/v1/parameter-sets/{id}/compensate-program"         compensate::program                      Read     Calculation;
    GET    "/v1/parameter-sets/{id}/content"                    parameter_sets::get_content              Read     Read;
    GET    "/v1/parameter-sets/{id}/export"                     export::get                              Read     CostlyRead  [409 422];
    POST   "/v1/parameter-sets/{id}/export"                     export::patch_urdf                       Read     Calculation [409];
    GET    "/v1/parameter-sets/{id}/gates"                      release::gates                           Read     CostlyRead;
    POST   "/v1/parameter-sets/{id}/predict"                    predict::predict                         Read     Calculation;
    POST   "/v1/parameter-sets/{id}/release"                    release::release                         Release  Write       key [409];
    POST   "/v1/parameter-sets/{id}/restore"                    archive::restore_parameter_set           Release  Write       key;
    POST   "/v1/parameter-sets/{id}/withdraw"                   release::withdraw                        Release  Safety      key [409];
    GET    "/v1/robots/{robot_id}/parameter-sets"               parameter_sets::list                     Read     Read;
    GET    "/v1/robots/{robot_id}/parameter-sets/active"        parameter_sets::active                   Read     Read;
    POST   "/v1/robots/{robot_id}/parameter-sets/rollback"      release::roll_back                       Release  Safety      key [409];
    // Networks
    GET    "/v1/networks/{id}"                                  networks::get                            Read     Read;
    POST   "/v1/networks/{id}/archive"                          archive::archive_network                 Identify Write       key;
    POST   "/v1/networks/{id}/restore"                          archive::restore_network                 Identify Write       key;
    GET    "/v1/networks/{id}/weights"                          networks::weights                        Read     CostlyRead;
    GET    "/v1/robots/{robot_id}/networks"                     networks::list                           Read     Read;
};

/// The handlers with their documentation.
pub fn routes() -> OpenApiRouter<App> {
    ROUTES
        .iter()
        .fold(OpenApiRouter::new(), |router, route| (route.mount)(router))
}

#[cfg(test)]
mod tests {
    use super::ROUTES;
    use crate::http::limits::RequestClass;
    use crate::http::route::class_of;
    use crate::wire::key::Scope;
    use utoipa_axum::router::OpenApiRouter;

    #[test]
    fn each_row_has_the_method_and_the_path_of_its_handler() {
        for route in ROUTES {
            let (_, document) = (route.mount)(OpenApiRouter::new()).split_for_parts();
            let document = serde_json::to_value(document).unwrap();
            let (path, methods) = document["paths"]
                .as_object()
                .unwrap()
                .iter()
                .next()
                .unwrap();
            let method = methods.as_object().unwrap().keys().next().unwrap();
            assert_eq!(
                (method.to_uppercase().as_str(), path.as_str()),
                (route.method.as_str(), route.path)
            );
        }
    }

    #[test]
    fn each_request_has_the_class_of_its_route() {
        for route in ROUTES {
            let path = route
                .path
                .replace("{robot_id}", "rob_1")
                .replace("{id}", "x_1");
            assert_eq!(
                class_of(ROUTES, &route.method, &path),
                route.class,
                "{} {path}",
                route.method
            );
        }
    }

    #[test]
    fn requests_of_the_scope_read_take_no_permits_of_writes() {
        for route in ROUTES {
            // An import has a body but stores nothing.
            let only_reads = matches!(route.scope, None | Some(Scope::Read))
                || route.path == "/v1/robot-imports";
            let is_read = matches!(
                route.class,
                RequestClass::Read | RequestClass::CostlyRead | RequestClass::Calculation
            );
            assert_eq!(only_reads, is_read, "{} {}", route.method, route.path);
        }
    }
}
