//! Every route with its documentation.

use crate::http::{
    App, archive, columns, compensate, dashboard, export, frames, history, index, job_events, jobs,
    me, measurement_sets, metrics, named_frames, networks, overview, parameter_sets, policies,
    pose_plans, predict, release, report_html, robot_models, robots, session,
};
use utoipa_axum::router::OpenApiRouter;

/// Every route with its documentation.
pub fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .merge(robots::router())
        .merge(robot_models::router())
        .merge(measurement_sets::router())
        .merge(columns::router())
        .merge(frames::router())
        .merge(named_frames::router())
        .merge(jobs::router())
        .merge(job_events::router())
        .merge(report_html::router())
        .merge(parameter_sets::router())
        .merge(release::router())
        .merge(policies::router())
        .merge(predict::router())
        .merge(compensate::router())
        .merge(export::router())
        .merge(history::router())
        .merge(overview::router())
        .merge(pose_plans::router())
        .merge(networks::router())
        .merge(archive::router())
        .merge(me::router())
        .merge(session::router())
        .merge(index::router())
        .merge(dashboard::router())
        .merge(metrics::router())
}
