//! The database (SQLite or PostgreSQL) and all SQL. There is one file per table.
//!
//! Functions that read take `&Store`. Functions that write take `&mut Tx`, so several writes can be one transaction. [`Store::create_idempotent`]
//! runs a transaction once per `Idempotency-Key`. The store does not parse documents (`*_json`) and stores uploads byte for byte. Times are
//! milliseconds since the epoch, by the database's clock. Any of these functions may fail with [`Error::Database`], and one that takes an id with
//! [`Error::NotFound`]; `# Errors` names the others.
//!
//! SQL is `&'static str`, the same text for both engines wherever possible. It uses only column types that sqlx's `Any` supports: text, bigint,
//! double, blob. [`all_queries`] lists all SQL texts, so that a test can prepare each of them on both engines. A bound limit is written `limit
//! cast($1 as bigint)`. With a bare `limit $1`, SQLite plans the query again at each use, because the plan depends on the value.

// The open database, its engines and its schema.
pub mod backup;
pub mod copy;
mod database;
mod engine;
mod error;
mod migration;
mod open;
pub mod stuck;
mod writes;

// Rows, lists and identifiers of every table.
mod from_row;
mod hashed;
mod id_prefix;
mod listing;
mod page;
mod sql;

// The audit chain, the checks of the promises, and idempotent requests.
pub mod audit;
mod audit_chain;
mod audit_event;
mod idempotency;
pub mod verify;

// Robots, keys and what is measured.
pub mod api_keys;
pub mod archive;
pub mod browser_sessions;
pub mod frames;
pub mod known_uploads;
pub mod measurement_sets;
pub mod named_documents;
pub mod overview;
pub mod policies;
pub mod robot_versions;
pub mod robots;

// Jobs.
pub mod job_sources;
pub mod jobs;
pub mod leases;
pub mod networks;
pub mod report_summaries;
pub mod statistics;

// Parameter sets, and the facts that decide about them.
mod parameter_set_row;
pub mod parameter_sets;
pub mod verifications;
pub mod withdrawals;

pub use api_keys::{ApiKeyRow, NewApiKey};
pub use archive::{Archivable, ArchivedRow};
pub use audit_chain::{AuditEntryId, AuditHead, AuditRow, NoAuditEntryId};
pub use audit_event::AuditEvent;
pub use database::{Store, Tx};
pub use engine::Engine;
pub use error::{Conflict, Error, Result};
pub use frames::{FramesRow, NewFrames};
pub use hashed::Hashed;
pub use idempotency::{IdempotencyScope, IdempotentOutcome, StoredResponse};
pub use jobs::{JobRow, NewJob};
pub use leases::{Exhausted, Expired, Heartbeat, JobResult, Lease};
pub use listing::ListRequest;
pub use measurement_sets::{MeasurementSetRow, NewMeasurementSet};
pub use named_documents::NamedDocumentRow;
pub use networks::{NetworkRow, NetworkWeights, NewNetwork};
pub use open::StoreLocation;
pub use page::{Cursor, InvalidCursor, Page};
pub use parameter_sets::{CheckedState, NewParameterSet, ParameterSetRow, Release};
pub use policies::PolicyRow;
pub use robot_versions::RobotEdit;
pub use robots::{NewRobot, RobotCheck, RobotRow};
pub use verifications::{ScoredRelease, VerificationRow};

pub use crate::wire::job_answer::JobStatus;
pub use crate::wire::parameter_set::ParameterSetStatus;

/// Every SQL text that the store uses on this engine.
pub fn all_queries(engine: Engine) -> Vec<String> {
    let own = match engine {
        Engine::Sqlite => [
            leases::QUERIES_SQLITE,
            backup::QUERIES_SQLITE,
            stuck::QUERIES_SQLITE,
            verify::QUERIES_SQLITE,
        ]
        .concat(),
        Engine::Postgres => [
            leases::QUERIES_POSTGRES,
            stuck::QUERIES_POSTGRES,
            audit_chain::QUERIES_POSTGRES,
            verify::QUERIES_POSTGRES,
        ]
        .concat(),
    };
    let texts = [
        &[database::NOW, database::SCHEMA_VERSION][..],
        own.as_slice(),
        audit::ALL_QUERIES,
        audit_chain::ALL_QUERIES,
        api_keys::ALL_QUERIES,
        archive::ALL_QUERIES,
        browser_sessions::ALL_QUERIES,
        named_documents::ALL_QUERIES,
        frames::ALL_QUERIES,
        idempotency::ALL_QUERIES,
        job_sources::ALL_QUERIES,
        jobs::ALL_QUERIES,
        known_uploads::ALL_QUERIES,
        leases::ALL_QUERIES,
        measurement_sets::ALL_QUERIES,
        networks::ALL_QUERIES,
        overview::ALL_QUERIES,
        parameter_sets::ALL_QUERIES,
        policies::ALL_QUERIES,
        report_summaries::ALL_QUERIES,
        robot_versions::ALL_QUERIES,
        robots::ALL_QUERIES,
        statistics::ALL_QUERIES,
        verifications::ALL_QUERIES,
        withdrawals::ALL_QUERIES,
        verify::ALL_QUERIES,
    ]
    .concat();
    let lists = [
        api_keys::LIST,
        named_documents::LIST,
        jobs::OF_ROBOT,
        jobs::OF_ROBOTS,
        measurement_sets::LIST,
        networks::LIST,
        parameter_sets::LIST,
        robots::LIST,
    ];
    let lists = lists.iter().flat_map(listing::ListQueries::texts);
    texts.into_iter().map(String::from).chain(lists).collect()
}
