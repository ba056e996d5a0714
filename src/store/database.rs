//! The open database and the transactions that write to it.

use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use sqlx::{Any, AnyConnection, AnyPool, Transaction};
use tokio::time::Instant;

use super::audit_chain::{self, AuditNote};
use super::sql::{self, values};
use super::writes::Writes;
use super::{AuditEvent, Engine, Error, Result};

/// A handle on the database; clones share its connections.
#[derive(Clone, Debug)]
pub struct Store {
    pub(super) inner: Arc<Inner>,
}

#[derive(Debug)]
pub(super) struct Inner {
    /// Connections that read.
    pub(super) readers: AnyPool,
    /// Connections that write, and so may wait for locks. SQLite allows one writer at a time, so its pool has one connection, for which writers
    /// queue.
    pub(super) writers: AnyPool,
    /// Whether the writes of this process succeed.
    pub(super) writes: Writes,
    pub(super) engine: Engine,
    pub(super) data_dir: Option<PathBuf>,
    pub(super) is_served: bool,
    /// Lock on the data directory, held as long as the store is open, so that two servers never share the directory.
    pub(super) lock_file: Option<File>,
}

/// An open transaction; dropping it rolls everything back.
#[derive(Debug)]
pub struct Tx {
    transaction: Transaction<'static, Any>,
    actor: String,
    notes: Vec<AuditNote>,
    store: Store,
    begun: Instant,
}

/// Disk space kept free: twice the size of the largest upload, because an upload is written to the WAL and to the database.
pub(super) const RESERVE_BYTES: u64 = 64 << 20;

/// The database's file in the data directory.
pub(super) const DATABASE: &str = "kincal.sqlite";
/// File in the data directory that the server locks, so that only one process uses the directory.
pub(super) const LOCK: &str = "lock";

/// Longest wait for a connection that may write.
pub(super) const WRITER_TIMEOUT: Duration = Duration::from_secs(2);

/// Default actor: the process itself.
const DEFAULT_ACTOR: &str = "kincal";

impl Store {
    /// Whether a server uses this database; always assumed on PostgreSQL.
    pub fn is_served(&self) -> bool {
        self.inner.is_served
    }

    /// Begins a transaction that may write.
    pub async fn begin(&self) -> Result<Tx> {
        self.require_data_dir()?;
        let begun = Instant::now();
        self.inner.writes.requested();
        let transaction = self.begin_write_transaction().await;
        Ok(Tx {
            transaction: transaction.inspect_err(|_| self.inner.writes.failed(begun))?,
            actor: DEFAULT_ACTOR.into(),
            notes: Vec::new(),
            store: self.clone(),
            begun,
        })
    }

    async fn begin_write_transaction(&self) -> Result<Transaction<'static, Any>> {
        let writers = self.writers();
        Ok(match self.inner.engine {
            // `begin immediate` takes the write lock at once. A transaction that starts as a reader may fail to get the lock at its first write.
            Engine::Sqlite => writers.begin_with("begin immediate").await?,
            Engine::Postgres => writers.begin().await?,
        })
    }

    /// The error to return if the disk is nearly full, in which case new data is refused; none if there is enough space.
    pub fn low_disk_space(&self) -> Option<Error> {
        self.free_bytes()
            .filter(|free| *free < RESERVE_BYTES)
            .map(|free| Error::LowDiskSpace {
                free_mib: free >> 20,
            })
    }

    /// Free disk space of an embedded database; none if unknown.
    pub fn free_bytes(&self) -> Option<u64> {
        let disk = rustix::fs::statvfs(self.inner.data_dir.as_ref()?).ok()?;
        Some(disk.f_bavail.saturating_mul(disk.f_frsize))
    }

    /// Fails if the data directory was removed or replaced. Writes to removed files would succeed, but the data would be lost when the files are
    /// closed.
    fn require_data_dir(&self) -> Result<()> {
        let (Some(data_dir), Some(held)) = (&self.inner.data_dir, &self.inner.lock_file) else {
            return Ok(());
        };
        let which = |file: std::fs::Metadata| (file.dev(), file.ino());
        let there = std::fs::metadata(data_dir.join(LOCK)).map(which).ok();
        match there == held.metadata().map(which).ok() && data_dir.join(DATABASE).exists() {
            true => Ok(()),
            false => Err(sqlx::Error::Io(std::io::ErrorKind::NotFound.into()).into()),
        }
    }

    /// The engine behind this store.
    pub fn engine(&self) -> Engine {
        self.inner.engine
    }

    /// The connections for statements that only read; writes go through [`Store::begin`].
    pub fn readers(&self) -> &AnyPool {
        &self.inner.readers
    }

    /// The connections that write. Writes on them bypass the audit chain, and `/readyz` does not see them.
    pub(super) fn writers(&self) -> &AnyPool {
        &self.inner.writers
    }

    /// The database's clock, ms since the epoch. `/readyz` uses it to check that the database answers.
    pub async fn now_ms(&self) -> Result<i64> {
        self.require_data_dir()?;
        sql::value(self.readers(), NOW, values![]).await
    }

    /// Version of the schema.
    pub async fn schema_version(&self) -> Result<i64> {
        sql::value(self.readers(), SCHEMA_VERSION, values![]).await
    }

    /// Closes all connections. SQLite then moves its WAL into the database file.
    pub async fn close(&self) {
        self.writers().close().await;
        self.readers().close().await;
    }
}

impl Tx {
    /// Sets the actor for the audit chain.
    pub fn act_as(&mut self, actor: &str) {
        actor.clone_into(&mut self.actor);
    }

    /// Commits this transaction and its entries in the audit chain.
    ///
    /// # Errors
    /// [`Error::Database`]. Unless the engine reports a rollback, the commit may have happened.
    pub async fn commit(self) -> Result<()> {
        let engine = self.engine();
        let Tx {
            mut transaction,
            actor,
            notes,
            store,
            begun,
        } = self;
        let committed = async {
            if !notes.is_empty() {
                audit_chain::append(&mut transaction, engine, &actor, notes).await?;
            }
            Ok(transaction.commit().await?)
        };
        let committed = committed.await;
        match &committed {
            Ok(()) => store.inner.writes.committed(),
            Err(_) => store.inner.writes.failed(begun),
        }
        committed
    }

    /// Rolls this transaction back and waits for the rollback. Dropping it does not wait.
    pub async fn rollback(self) -> Result<()> {
        Ok(self.transaction.rollback().await?)
    }

    pub(crate) fn connection(&mut self) -> &mut AnyConnection {
        &mut self.transaction
    }

    pub(crate) fn engine(&self) -> Engine {
        self.store.engine()
    }

    /// Fails while the disk is nearly full. Ending jobs, releasing and withdrawing do not call this function, because they must work even then.
    pub(crate) fn require_disk_space(&self) -> Result<()> {
        self.store.low_disk_space().map_or(Ok(()), Err)
    }

    /// Adds an entry to the audit chain. The entry is written when this transaction is committed.
    pub(super) fn audit(&mut self, event: AuditEvent, subject: &str, detail: serde_json::Value) {
        self.notes.push(AuditNote {
            event,
            subject: subject.into(),
            detail,
        });
    }

    /// Adds a field to the last audit entry of this transaction, if there is one.
    pub(super) fn audit_field(&mut self, field: &str, value: serde_json::Value) {
        if let Some(detail) = self
            .notes
            .last_mut()
            .and_then(|note| note.detail.as_object_mut())
        {
            detail.insert(field.into(), value);
        }
    }
}

pub(super) const NOW: &str = "select now_ms from clock";

pub(super) const SCHEMA_VERSION: &str =
    "select coalesce(max(version), 0) from _sqlx_migrations where success";
