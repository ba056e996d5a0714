//! Everything that is kept, and all SQL: one file per table, on SQLite or PostgreSQL.
//!
//! Reads take `&Store`. Writes take `&mut Tx`, so that several of them become one effect; [`Store::create_idempotent`]
//! makes such an effect happen once per `Idempotency-Key`. The store does not look into documents (`*_json`) and keeps
//! uploads as the bytes that came. Times are epoch milliseconds by the database's clock.
//!
//! SQL is `&'static str`, the same text for both engines wherever possible, and limited to the column types that pass
//! through sqlx's `Any`: text, bigint, blob. [`all_queries`] lists it so that a test can prepare every one on both.

pub mod api_keys;
mod error;
pub mod frames;
mod idempotency;
pub mod jobs;
pub mod leases;
pub mod measurement_sets;
pub mod networks;
mod open;
mod page;
pub mod parameter_sets;
pub mod robots;
pub mod statistics;

pub use api_keys::{ApiKeyRow, NewApiKey};
pub use error::{Conflict, Error, Result};
pub use frames::{FramesRow, NewFrames};
pub use idempotency::{IdempotencyScope, IdempotentOutcome, StoredResponse};
pub use jobs::{JobRow, JobStatus, NewJob};
pub use leases::{Expired, Heartbeat, Lease};
pub use measurement_sets::{MeasurementSetRow, NewMeasurementSet};
pub use networks::{NetworkRow, NewNetwork};
pub use open::StoreLocation;
pub use page::{Cursor, InvalidCursor, MAX_PAGE_SIZE, Page, PageRequest};
pub use parameter_sets::{NewParameterSet, ParameterSetRow, ParameterSetStatus, Release};
pub use robots::{NewRobot, RobotRow};

use std::fs::File;
use std::sync::Arc;

use sqlx::{Any, AnyConnection, AnyPool, Transaction};
use tokio::sync::{Mutex, OwnedMutexGuard};

/// Which database is behind a [`Store`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// The embedded one: one server process per data directory.
    Sqlite,
    /// A database server, which several servers and workers may share.
    Postgres,
}

/// A handle on the database; clones share its connections.
#[derive(Clone, Debug)]
pub struct Store {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    pool: AnyPool,
    engine: Engine,
    /// SQLite has one writer at a time; waiting here costs nothing, waiting in its busy handler costs a spin.
    write_lock: Arc<Mutex<()>>,
    /// Held as long as the store is open, so that two servers never share a data directory.
    _lock_file: Option<File>,
}

/// An open transaction; dropping it rolls everything back.
#[derive(Debug)]
pub struct Tx {
    // Before the guard: the rollback of a dropped transaction is on its way when the next writer is let in.
    transaction: Transaction<'static, Any>,
    _writer: Option<OwnedMutexGuard<()>>,
}

impl Store {
    /// Opens the database as a server does: brings its schema up to date and, on SQLite, takes the data directory
    /// for itself and ends the leases of the process that had it before, which is dead.
    ///
    /// # Errors
    /// [`Error::Open`] saying what is wrong (data directory in use, SQLite too old, …), [`Error::Database`].
    pub async fn open(location: StoreLocation) -> Result<Store> {
        open::as_server(location).await
    }

    /// Opens the database for a short-lived tool (`kincal key …`) that may run beside the server.
    ///
    /// # Errors
    /// As [`Store::open`], except that a data directory in use is no reason to refuse.
    pub async fn open_beside_a_server(location: StoreLocation) -> Result<Store> {
        open::beside_a_server(location).await
    }

    /// Begins a transaction that may write.
    ///
    /// # Errors
    /// [`Error::Database`].
    pub async fn begin(&self) -> Result<Tx> {
        let (writer, statement) = match self.inner.engine {
            Engine::Sqlite => (Some(Arc::clone(&self.inner.write_lock).lock_owned().await), "begin immediate"),
            Engine::Postgres => (None, "begin"),
        };
        let transaction = self.inner.pool.begin_with(statement).await?;
        Ok(Tx { transaction, _writer: writer })
    }

    /// The engine behind this store.
    pub fn engine(&self) -> Engine {
        self.inner.engine
    }

    /// The connections, for tests and tools that look at the database itself. Reads only; writes go through [`Store::begin`].
    pub fn pool(&self) -> &AnyPool {
        &self.inner.pool
    }

    /// The database's clock, ms since the epoch. Answers only if the database does: `/readyz` asks this.
    ///
    /// # Errors
    /// [`Error::Database`].
    pub async fn now_ms(&self) -> Result<i64> {
        Ok(sqlx::query_scalar(NOW).fetch_one(self.pool()).await?)
    }

    /// Closes all connections, after which SQLite's WAL is folded into the database file.
    pub async fn close(&self) {
        self.inner.pool.close().await;
    }
}

impl Tx {
    /// Makes everything done in this transaction last.
    ///
    /// # Errors
    /// [`Error::Database`]; then it is unknown whether it did, unless the engine says so.
    pub async fn commit(self) -> Result<()> {
        Ok(self.transaction.commit().await?)
    }

    /// Undoes everything done in this transaction, as dropping it does, but waits until that is done.
    ///
    /// # Errors
    /// [`Error::Database`].
    pub async fn rollback(self) -> Result<()> {
        Ok(self.transaction.rollback().await?)
    }

    pub(crate) fn connection(&mut self) -> &mut AnyConnection {
        &mut self.transaction
    }
}

const NOW: &str = "select now_ms from clock";

/// A new identifier: a prefix that says of what, and a UUID of version 7, so that ids of one process sort by age.
pub(crate) fn new_id(prefix: &str) -> String {
    format!("{prefix}_{}", uuid::Uuid::now_v7().simple())
}

/// Every SQL text of the store that the engine gets to see.
pub fn all_queries(engine: Engine) -> Vec<&'static str> {
    let own: &[&str] = match engine {
        Engine::Sqlite => leases::QUERIES_SQLITE,
        Engine::Postgres => leases::QUERIES_POSTGRES,
    };
    [
        &[NOW],
        own,
        api_keys::ALL_QUERIES,
        frames::ALL_QUERIES,
        idempotency::ALL_QUERIES,
        jobs::ALL_QUERIES,
        leases::ALL_QUERIES,
        measurement_sets::ALL_QUERIES,
        networks::ALL_QUERIES,
        parameter_sets::ALL_QUERIES,
        robots::ALL_QUERIES,
        statistics::ALL_QUERIES,
    ]
    .concat()
}
