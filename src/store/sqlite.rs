//! SQLite on the thread that asks. sqlx gives each connection a thread of its own; to wake that thread and to be woken by it takes longer
//! than most statements. Here a statement runs where it is awaited, and what may take long (a commit, a lock that others hold, long lists,
//! large uploads) leaves the thread's other tasks to other threads meanwhile.
//!
//! Texts, arguments, rows and errors are those of sqlx's `Any`, so that all above this module is the same on both engines. sqlx has no
//! public way to make such rows: hence `sqlx-core`, whose version is pinned.

use std::borrow::Cow;
use std::collections::HashMap;
use std::error::Error as StdError;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rusqlite::types::{ToSqlOutput, ValueRef};
use rusqlite::{OpenFlags, Statement};
use sqlx::any::{AnyArguments, AnyRow, AnyTypeInfo, AnyTypeInfoKind, AnyValue};
use sqlx::error::{DatabaseError, ErrorKind};
use sqlx_core::any::{AnyColumn, AnyValueKind};
use sqlx_core::ext::ustr::UStr;
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::Semaphore;
use tokio::time::timeout;

/// Where the columns of a statement stand, by name.
type Columns = Arc<sqlx_core::HashMap<UStr, usize>>;

/// More statements than this are prepared anew now and then: the store has about 150.
const STATEMENTS: usize = 200;
/// Statements that take longer are worth a line in the log.
const SLOW: Duration = Duration::from_secs(1);
/// How long somebody waits for others who read what takes long.
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// SQLite's primary codes of a lock that somebody else holds.
const LOCKED: [i32; 2] = [5, 6];

/// One connection.
#[derive(Debug)]
pub(crate) struct Connection {
    handle: rusqlite::Connection,
    columns: HashMap<String, Columns>,
}

/// What a statement did, and its rows.
pub(super) struct Done {
    pub(super) n_changed: u64,
    pub(super) rows: Vec<AnyRow>,
}

impl Connection {
    /// Opens a database that is there.
    fn open(file: &Path, settings: &str) -> sqlx::Result<Self> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let handle = rusqlite::Connection::open_with_flags(file, flags).map_err(failure)?;
        handle.execute_batch(settings).map_err(failure)?;
        handle.set_prepared_statement_cache_capacity(STATEMENTS);
        Ok(Self {
            handle,
            columns: HashMap::new(),
        })
    }

    /// Takes the write lock: at once, or when those have ended who hold it, within the time that the settings give.
    pub(super) fn begin_to_write(&mut self, patience: Duration) -> sqlx::Result<()> {
        const BEGIN: &str = "begin immediate";
        self.handle.busy_timeout(Duration::ZERO).map_err(failure)?;
        let begun = self.run(BEGIN, None, 0);
        self.handle.busy_timeout(patience).map_err(failure)?;
        match begun {
            Err(error) if is_locked(&error) => aside(|| self.run(BEGIN, None, 0)).map(drop),
            begun => begun.map(drop),
        }
    }

    /// Runs statements that take nothing and give nothing.
    pub(super) fn run_all(&mut self, statements: &[&str]) -> sqlx::Result<()> {
        statements
            .iter()
            .try_for_each(|statement| self.run(statement, None, 0).map(drop))
    }

    /// Runs one statement: to its end, or of one that only reads until there are so many rows. The log has its text, never what is in it.
    pub(super) fn run(
        &mut self,
        sql: &str,
        arguments: Option<AnyArguments>,
        most: usize,
    ) -> sqlx::Result<Done> {
        let begun = Instant::now();
        let done = self.step(sql, arguments, most);
        let elapsed = begun.elapsed();
        match elapsed >= SLOW {
            true => tracing::warn!(statement = sql, ?elapsed, "slow statement"),
            false => tracing::debug!(statement = sql, ?elapsed, "statement"),
        }
        done
    }

    fn step(
        &mut self,
        sql: &str,
        arguments: Option<AnyArguments>,
        most: usize,
    ) -> sqlx::Result<Done> {
        let mut statement = self.handle.prepare_cached(sql).map_err(failure)?;
        bind(&mut statement, arguments)?;
        let columns = match self.columns.get(sql) {
            Some(columns) => Arc::clone(columns),
            None => {
                let names = statement
                    .column_names()
                    .into_iter()
                    .enumerate()
                    .map(|(at, name)| (UStr::new(name), at));
                let columns: Columns = Arc::new(names.collect());
                if self.columns.len() >= STATEMENTS {
                    self.columns.clear();
                }
                self.columns.insert(sql.to_owned(), Arc::clone(&columns));
                columns
            }
        };
        let reads = statement.readonly();
        let (mut rows, mut found) = (statement.raw_query(), Vec::new());
        while let Some(row) = rows.next().map_err(failure)? {
            if found.len() < most {
                found.push(any_row(row, &columns)?);
            }
            if reads && found.len() == most {
                break;
            }
        }
        drop(rows);
        drop(statement);
        Ok(Done {
            n_changed: if reads { 0 } else { self.handle.changes() },
            rows: found,
        })
    }
}

/// `$1` takes the first argument wherever it stands.
fn bind(statement: &mut Statement<'_>, arguments: Option<AnyArguments>) -> sqlx::Result<()> {
    let values = arguments
        .map(|arguments| arguments.values.0)
        .unwrap_or_default();
    for index in 1..=statement.parameter_count() {
        let number = statement
            .parameter_name(index)
            .and_then(|name| name.get(1..)?.parse().ok())
            .unwrap_or(index);
        let Some(value) = number.checked_sub(1).and_then(|at: usize| values.get(at)) else {
            continue;
        };
        let value = match value {
            AnyValueKind::Null(_) => ValueRef::Null,
            AnyValueKind::Bool(value) => ValueRef::Integer(i64::from(*value)),
            AnyValueKind::SmallInt(value) => ValueRef::Integer(i64::from(*value)),
            AnyValueKind::Integer(value) => ValueRef::Integer(i64::from(*value)),
            AnyValueKind::BigInt(value) => ValueRef::Integer(*value),
            AnyValueKind::Real(value) => ValueRef::Real(f64::from(*value)),
            AnyValueKind::Double(value) => ValueRef::Real(*value),
            AnyValueKind::Text(value) => ValueRef::Text(value.as_bytes()),
            AnyValueKind::TextSlice(value) => ValueRef::Text(value.as_bytes()),
            AnyValueKind::Blob(value) => ValueRef::Blob(value),
            other => {
                return Err(sqlx::Error::AnyDriverError(
                    format!("SQLite does not take {other:?}").into(),
                ));
            }
        };
        statement
            .raw_bind_parameter(index, ToSqlOutput::Borrowed(value))
            .map_err(failure)?;
    }
    Ok(())
}

fn any_row(row: &rusqlite::Row<'_>, columns: &Columns) -> sqlx::Result<AnyRow> {
    let n_columns = row.as_ref().column_count();
    let mut out = AnyRow {
        column_names: Arc::clone(columns),
        columns: Vec::with_capacity(n_columns),
        values: Vec::with_capacity(n_columns),
    };
    for at in 0..n_columns {
        let (kind, value) = match row.get_ref(at).map_err(failure)? {
            ValueRef::Null => (
                AnyTypeInfoKind::Null,
                AnyValueKind::Null(AnyTypeInfoKind::Null),
            ),
            ValueRef::Integer(value) => (AnyTypeInfoKind::BigInt, AnyValueKind::BigInt(value)),
            ValueRef::Real(value) => (AnyTypeInfoKind::Double, AnyValueKind::Double(value)),
            ValueRef::Text(text) => {
                let text =
                    std::str::from_utf8(text).map_err(|error| sqlx::Error::Decode(error.into()))?;
                (
                    AnyTypeInfoKind::Text,
                    AnyValueKind::Text(Arc::new(text.to_owned())),
                )
            }
            ValueRef::Blob(bytes) => (
                AnyTypeInfoKind::Blob,
                AnyValueKind::Blob(Arc::new(bytes.to_vec())),
            ),
        };
        out.columns.push(AnyColumn {
            ordinal: at,
            name: UStr::Static(""),
            type_info: AnyTypeInfo { kind },
        });
        out.values.push(AnyValue { kind: value });
    }
    Ok(out)
}

/// How to connect, and connections that read.
#[derive(Debug)]
pub(crate) struct Pool {
    file: PathBuf,
    settings: &'static str,
    patience: Duration,
    /// The one used last is taken first: it knows most of what is in the database.
    idle: Mutex<Vec<Connection>>,
    /// For what may take long: so many at a time; closed with the pool.
    room: Semaphore,
    most: u32,
}

impl Pool {
    /// Connections with these settings, which wait so long for locks that others hold; so many at most read what may take long.
    pub(super) fn new(
        file: PathBuf,
        settings: &'static str,
        patience: Duration,
        most: u32,
    ) -> Self {
        Self {
            file,
            settings,
            patience,
            idle: Mutex::default(),
            room: Semaphore::new(most as usize),
            most,
        }
    }

    /// Another connection.
    pub(super) fn connect(&self) -> sqlx::Result<Connection> {
        match self.is_closed() {
            true => Err(sqlx::Error::PoolClosed),
            false => Connection::open(&self.file, self.settings),
        }
    }

    /// Reads here and now. As many connections as threads do so at a time.
    pub(super) fn run(
        &self,
        sql: &str,
        arguments: Option<AnyArguments>,
        most: usize,
    ) -> sqlx::Result<Done> {
        let idle = self.idle().pop();
        let mut connection = idle.map_or_else(|| aside(|| self.connect()), Ok)?;
        let done = connection.run(sql, arguments, most)?;
        let mut idle = self.idle();
        // asked while nobody closes, or it would stay open
        if !self.is_closed() {
            idle.push(connection);
        }
        Ok(done)
    }

    /// Reads what may take long, when not too many others do.
    pub(super) async fn run_aside(
        &self,
        sql: &str,
        arguments: Option<AnyArguments>,
        most: usize,
    ) -> sqlx::Result<Done> {
        let room = timeout(LONGEST_WAIT, self.room.acquire())
            .await
            .map_err(|_| sqlx::Error::PoolTimedOut)?;
        let _room = room.map_err(|_| sqlx::Error::PoolClosed)?;
        aside(|| self.run(sql, arguments, most))
    }

    /// How long its connections wait for locks that others hold.
    pub(super) fn patience(&self) -> Duration {
        self.patience
    }

    pub(super) fn is_closed(&self) -> bool {
        self.room.is_closed()
    }

    /// Waits for what may take long, though not for ever, and closes what nobody uses; the rest is closed where it ends.
    pub(super) async fn close(&self) {
        let _all = timeout(LONGEST_WAIT, self.room.acquire_many(self.most)).await;
        let mut idle = self.idle();
        self.room.close();
        idle.clear();
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Connection>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Runs what may take long, and leaves this thread's other tasks to other threads, where there are some.
pub(crate) fn aside<T>(work: impl FnOnce() -> T) -> T {
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => tokio::task::block_in_place(work),
        _ => work(),
    }
}

/// What SQLite says.
#[derive(Debug, thiserror::Error)]
#[error("(code: {code}) {message}")]
struct Failure {
    code: i32,
    message: String,
}

fn is_locked(error: &sqlx::Error) -> bool {
    let code = error.as_database_error().and_then(DatabaseError::code);
    code.and_then(|code| code.parse::<i32>().ok())
        .is_some_and(|code| LOCKED.contains(&(code & 0xff)))
}

fn failure(error: rusqlite::Error) -> sqlx::Error {
    let (code, message) = match error {
        rusqlite::Error::SqliteFailure(error, message) => (
            error.extended_code,
            message.unwrap_or_else(|| error.to_string()),
        ),
        other => return sqlx::Error::AnyDriverError(other.into()),
    };
    sqlx::Error::Database(Box::new(Failure { code, message }))
}

impl DatabaseError for Failure {
    fn message(&self) -> &str {
        &self.message
    }

    fn code(&self) -> Option<Cow<'_, str>> {
        Some(self.code.to_string().into())
    }

    fn as_error(&self) -> &(dyn StdError + Send + Sync + 'static) {
        self
    }

    fn as_error_mut(&mut self) -> &mut (dyn StdError + Send + Sync + 'static) {
        self
    }

    fn into_error(self: Box<Self>) -> Box<dyn StdError + Send + Sync + 'static> {
        self
    }

    fn kind(&self) -> ErrorKind {
        match self.code {
            rusqlite::ffi::SQLITE_CONSTRAINT_UNIQUE
            | rusqlite::ffi::SQLITE_CONSTRAINT_PRIMARYKEY => ErrorKind::UniqueViolation,
            rusqlite::ffi::SQLITE_CONSTRAINT_FOREIGNKEY => ErrorKind::ForeignKeyViolation,
            rusqlite::ffi::SQLITE_CONSTRAINT_NOTNULL => ErrorKind::NotNullViolation,
            rusqlite::ffi::SQLITE_CONSTRAINT_CHECK => ErrorKind::CheckViolation,
            _ => ErrorKind::Other,
        }
    }
}

#[cfg(test)]
mod tests;
