//! Everything that is kept, and all SQL: one file per table, on SQLite or PostgreSQL.
//!
//! Reads take `&Store`. Writes take `&mut Tx`, so that several of them become one effect; [`Store::create_idempotent`]
//! makes such an effect happen once per `Idempotency-Key`. The store does not look into documents (`*_json`) and keeps
//! uploads as the bytes that came. Times are epoch milliseconds by the database's clock.
//!
//! SQL is `&'static str`, the same text for both engines wherever possible, and limited to the column types that pass
//! through sqlx's `Any`: text, bigint, blob. [`all_queries`] lists it so that a test can prepare every one on both. A limit that
//! is bound is written `limit cast($1 as bigint)`: into a bare one SQLite looks when it plans, and so it plans at every use.

pub mod api_keys;
pub mod audit;
pub mod backup;
mod connection;
pub mod copy;
mod error;
pub mod frames;
mod idempotency;
pub mod jobs;
pub mod leases;
pub mod measurement_sets;
pub mod networks;
pub mod notices;
mod open;
mod page;
pub mod parameter_sets;
pub mod policies;
pub mod robots;
pub mod sessions;
mod sqlite;
pub mod statistics;
pub mod verify;
mod writer;

pub use api_keys::{ApiKeyRow, NewApiKey};
pub use audit::{AuditHead, AuditRow};
pub use error::{Conflict, Error, Result};
pub use frames::{FramesRow, NewFrames};
pub use idempotency::{IdempotencyScope, IdempotentOutcome, StoredResponse};
pub use jobs::{JobRow, JobStatus, NewJob};
pub use leases::{Expired, Heartbeat, Lease};
pub use measurement_sets::{MeasurementSetRow, NewMeasurementSet};
pub use networks::{NetworkRow, NewNetwork};
pub use open::StoreLocation;
pub use page::{Cursor, InvalidCursor, MAX_PAGE_SIZE, Page, PageRequest};
pub use parameter_sets::{Checked, NewParameterSet, ParameterSetRow, ParameterSetStatus, Release};
pub use policies::PolicyRow;
pub use robots::{NewRobot, RobotRow};
pub use sessions::SessionRow;
pub(crate) use sqlite::aside;

use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::Arc;

use sqlx::{Any, AnyPool, Transaction};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use audit::Note;
use connection::Connection;
use writer::{Member, Writer};

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
    data_dir: Option<PathBuf>,
    is_served: bool,
    postgres_url: Option<String>,
    /// SQLite's connections, but for those that open and copy it.
    sqlite: Option<Arc<sqlite::Pool>>,
    /// SQLite has one writer at a time; those who wait for it share a commit.
    writer: Option<Writer>,
    /// On PostgreSQL: which of its connections may be waiting for locks.
    writers: Option<Arc<Semaphore>>,
    /// Held as long as the store is open, so that two servers never share a data directory.
    lock_file: Option<File>,
}

/// An open transaction; dropping it rolls everything back.
#[derive(Debug)]
pub struct Tx {
    kind: TxKind,
    actor: String,
    notes: Vec<Note>,
    store: Store,
}

#[derive(Debug)]
enum TxKind {
    /// On PostgreSQL: a transaction on a connection of its own.
    Own(Transaction<'static, Any>, Option<OwnedSemaphorePermit>),
    /// On SQLite: a share of the group that is committed together.
    Shared(Member),
}

/// This much of the disk is kept free: twice the largest upload in the WAL and its copy in the database.
const RESERVE_BYTES: u64 = 64 << 20;

/// Who wrote, where nobody says: the process itself.
const NOBODY: &str = "kincal";

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

    /// Opens the database to look at it: it must be there, and its schema is left as it is.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub async fn open_as_it_is(location: StoreLocation) -> Result<Store> {
        open::as_it_is(location).await
    }

    /// Whether a server is at work on this database, as far as can be told: on PostgreSQL one should be.
    pub fn is_served(&self) -> bool {
        self.inner.is_served
    }

    /// Begins a transaction that may write.
    ///
    /// # Errors
    /// [`Error::Database`].
    pub async fn begin(&self) -> Result<Tx> {
        self.is_in_place()?;
        let kind = match &self.inner.writer {
            Some(writer) => TxKind::Shared(writer.join().await?),
            None => {
                let permit = self.room_to_write().await?;
                TxKind::Own(self.inner.pool.begin().await?, permit)
            }
        };
        Ok(Tx {
            kind,
            actor: NOBODY.into(),
            notes: Vec::new(),
            store: self.clone(),
        })
    }

    async fn room_to_write(&self) -> Result<Option<OwnedSemaphorePermit>> {
        let Some(writers) = &self.inner.writers else {
            return Ok(None);
        };
        let permit = timeout(
            open::POSTGRES_WRITER_TIMEOUT,
            Arc::clone(writers).acquire_owned(),
        )
        .await;
        permit
            .map_err(|_| sqlx::Error::PoolTimedOut)?
            .map(Some)
            .map_err(|_| sqlx::Error::PoolClosed.into())
    }

    /// What is wrong if the disk has so little left that new things are refused.
    pub fn short_of_room(&self) -> Option<Error> {
        self.free_bytes()
            .filter(|free| *free < RESERVE_BYTES)
            .map(|free| Error::NoRoom {
                free_mib: free >> 20,
            })
    }

    /// What is left on the disk of an embedded database; none if that cannot be told.
    pub fn free_bytes(&self) -> Option<u64> {
        let disk = rustix::fs::statvfs(self.inner.data_dir.as_ref()?).ok()?;
        Some(disk.f_bavail.saturating_mul(disk.f_frsize))
    }

    /// Whether the data directory is still the one that was opened: files that were removed take writes until they are closed, and then all
    /// of it is gone.
    fn is_in_place(&self) -> Result<()> {
        let (Some(data_dir), Some(held)) = (&self.inner.data_dir, &self.inner.lock_file) else {
            return Ok(());
        };
        let which = |file: std::fs::Metadata| (file.dev(), file.ino());
        let there = std::fs::metadata(data_dir.join(open::LOCK)).map(which).ok();
        match there == held.metadata().map(which).ok() && data_dir.join(open::DATABASE).exists() {
            true => Ok(()),
            false => Err(sqlx::Error::Io(std::io::ErrorKind::NotFound.into()).into()),
        }
    }

    /// The engine behind this store.
    pub fn engine(&self) -> Engine {
        self.inner.engine
    }

    /// For statements that only read, and little where it is one row: [`Store::reads_much`].
    pub(crate) fn reads(&self) -> Connection<'_> {
        match &self.inner.sqlite {
            Some(pool) => Connection::sqlite_pool(pool),
            None => Connection::SqlxPool(&self.inner.pool),
        }
    }

    /// For statements that read uploads, reports or weights, which may be tens of megabytes, or walk over many rows.
    pub(crate) fn reads_much(&self) -> Connection<'_> {
        self.reads().for_long()
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
        self.is_in_place()?;
        Ok(sqlx::query_scalar(NOW).fetch_one(self.reads()).await?)
    }

    /// Where the database server is, for a connection that listens.
    fn postgres_url(&self) -> Option<&str> {
        self.inner.postgres_url.as_deref()
    }

    /// The version of the schema, as far as this database's steps have gone.
    ///
    /// # Errors
    /// [`Error::Database`].
    pub async fn schema_version(&self) -> Result<i64> {
        Ok(sqlx::query_scalar(SCHEMA_VERSION)
            .fetch_one(self.reads())
            .await?)
    }

    /// Closes all connections, after which SQLite's WAL is folded into the database file.
    pub async fn close(&self) {
        let pool = self.inner.pool.close();
        if let Some(sqlite) = &self.inner.sqlite {
            sqlite.close().await;
        }
        if let Some(writer) = &self.inner.writer {
            writer.close().await;
        }
        pool.await;
    }
}

impl Tx {
    /// Says who writes, for the audit chain.
    pub fn act_as(&mut self, actor: &str) {
        actor.clone_into(&mut self.actor);
    }

    /// Makes everything done in this transaction last, with its entries in the audit chain.
    ///
    /// # Errors
    /// [`Error::Database`], [`Error::NotCommitted`]; then it is unknown whether it did, unless the engine says so.
    pub async fn commit(self) -> Result<()> {
        match self.kind {
            TxKind::Shared(member) => member.commit(self.actor, self.notes).await,
            TxKind::Own(mut transaction, _room) => {
                if !self.notes.is_empty() {
                    audit::append(&mut transaction, &self.actor, self.notes).await?;
                }
                Ok(transaction.commit().await?)
            }
        }
    }

    /// Undoes everything done in this transaction, as dropping it does, but waits until that is done.
    ///
    /// # Errors
    /// [`Error::Database`], [`Error::NotCommitted`]: then nothing that was read in it is certain either.
    pub async fn rollback(self) -> Result<()> {
        match self.kind {
            TxKind::Shared(member) => member.rollback().await,
            TxKind::Own(transaction, _room) => Ok(transaction.rollback().await?),
        }
    }

    pub(crate) fn connection(&mut self) -> Result<Connection<'_>> {
        match &mut self.kind {
            TxKind::Shared(member) => member
                .connection()
                .map(Connection::sqlite)
                .ok_or(Error::Database(sqlx::Error::WorkerCrashed)),
            TxKind::Own(transaction, _) => Ok(Connection::Sqlx(transaction)),
        }
    }

    pub(crate) fn engine(&self) -> Engine {
        self.store.engine()
    }

    /// Refuses what can wait while the disk is nearly full, so that what cannot (ending jobs, withdrawing) still goes.
    ///
    /// # Errors
    /// [`Error::NoRoom`].
    pub(crate) fn needs_room(&self) -> Result<()> {
        self.store.short_of_room().map_or(Ok(()), Err)
    }

    /// Adds an entry to the audit chain, if this transaction is committed.
    fn note(&mut self, event: &'static str, subject: &str, detail: serde_json::Value) {
        self.notes.push(Note {
            event,
            subject: subject.into(),
            detail,
        });
    }

    /// Adds a field to the last of the entries, if there is one.
    fn note_also(&mut self, field: &str, value: serde_json::Value) {
        if let Some(detail) = self
            .notes
            .last_mut()
            .and_then(|note| note.detail.as_object_mut())
        {
            detail.insert(field.into(), value);
        }
    }
}

const NOW: &str = "select now_ms from clock";

const SCHEMA_VERSION: &str = "select coalesce(max(version), 0) from _sqlx_migrations where success";

/// A new identifier: a prefix that says of what, and a UUID of version 7, so that ids of one process sort by age.
pub(crate) fn new_id(prefix: &str) -> String {
    format!("{prefix}_{}", uuid::Uuid::now_v7().simple())
}

/// Every SQL text of the store that the engine gets to see.
pub fn all_queries(engine: Engine) -> Vec<&'static str> {
    let own = match engine {
        Engine::Sqlite => [
            leases::QUERIES_SQLITE,
            backup::QUERIES_SQLITE,
            open::QUERIES_SQLITE,
            verify::QUERIES_SQLITE,
        ]
        .concat(),
        Engine::Postgres => [
            leases::QUERIES_POSTGRES,
            notices::QUERIES_POSTGRES,
            audit::QUERIES_POSTGRES,
            verify::QUERIES_POSTGRES,
        ]
        .concat(),
    };
    [
        &[NOW, SCHEMA_VERSION][..],
        own.as_slice(),
        audit::ALL_QUERIES,
        api_keys::ALL_QUERIES,
        frames::ALL_QUERIES,
        idempotency::ALL_QUERIES,
        jobs::ALL_QUERIES,
        leases::ALL_QUERIES,
        measurement_sets::ALL_QUERIES,
        networks::ALL_QUERIES,
        parameter_sets::ALL_QUERIES,
        policies::ALL_QUERIES,
        robots::ALL_QUERIES,
        sessions::ALL_QUERIES,
        statistics::ALL_QUERIES,
        verify::ALL_QUERIES,
    ]
    .concat()
}
