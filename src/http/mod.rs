//! The REST service: one file per resource; `routes.rs` has the table of all routes. A handler extracts its input, converts it, makes one
//! call and answers. `connection` handles TCP, TLS and timeouts, below the requests.

// Connections, and the table of routes. The OpenAPI document is made from this table.
mod connection;
mod document;
mod document_examples;
mod index;
mod request_examples;
mod route;
mod router;
mod routes;

// Middleware of every request, and what all handlers share.
mod access;
mod app;
pub mod auth;
mod counters;
mod creation;
mod error;
mod extract;
mod file_name;
mod headers;
mod host;
mod layers;
mod limits;
mod list_query;
mod session;
pub mod session_cookie;

// Robots, their documents and what is measured of them.
mod columns;
mod frames;
mod measurement_sets;
mod named_documents;
mod named_frames;
mod overview;
mod policies;
mod references;
mod robot_models;
mod robots;
mod table_upload;
mod upload_check;

// Jobs and what they found.
mod job_events;
mod job_posting;
mod job_sources;
mod jobs;
mod networks;
mod report_html;

// Parameter sets and computations with them.
mod compensate;
mod export;
mod history;
mod parameter_sets;
mod pose_plans;
mod predict;
mod release;

// The service itself.
mod archive;
mod dashboard;
mod metrics;

pub use app::App;
pub use connection::{server, tls};
pub use document::{json, openapi, yaml};
pub use error::Error;
pub use limits::MAX_BODY_BYTES;
pub use route::Route;
pub use router::router;
pub use routes::ROUTES;
