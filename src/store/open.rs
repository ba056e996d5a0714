//! Opens the database: location, settings and lock.

use std::convert::Infallible;
use std::fs::{DirBuilder, File, Permissions, TryLockError};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use sqlx::any::{AnyConnectOptions, AnyPoolOptions};
use sqlx::{AnyConnection, AnyPool, Connection, Executor};
use tokio::time::sleep;

use super::database::{DATABASE, Inner, LOCK, WRITER_TIMEOUT};
use super::migration::migrate;
use super::writes::Writes;
use super::{Engine, Error, Result, Store, leases};

/// Where the database is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoreLocation {
    /// The embedded database in this directory. The directory is created if it is missing.
    Sqlite {
        /// The directory.
        data_dir: PathBuf,
    },
    /// A database server.
    Postgres {
        /// `postgres://user:password@host:port/database`.
        url: String,
    },
}

/// Parses a PostgreSQL URL; any other text is a data directory.
impl FromStr for StoreLocation {
    type Err = Infallible;

    fn from_str(text: &str) -> std::result::Result<Self, Infallible> {
        Ok(
            match text.starts_with("postgres://") || text.starts_with("postgresql://") {
                true => StoreLocation::Postgres { url: text.into() },
                false => StoreLocation::Sqlite {
                    data_dir: text.into(),
                },
            },
        )
    }
}

/// Permissions of the data directory: only the owner has access.
const PRIVATE_DIR: u32 = 0o700;
/// Permissions of the files in it.
const PRIVATE_FILE: u32 = 0o600;
const GROUP_AND_OTHERS_MASK: u32 = 0o077;
/// Oldest accepted SQLite version. Older versions can corrupt a database in WAL mode.
const OLDEST_SQLITE: (u32, u32, u32) = (3, 51, 3);
/// Number of connections that read. SQLite's readers do not wait for each other; more connections would only cost memory.
const SQLITE_READERS: u32 = 8;
/// Number of connections that read, per process. A PostgreSQL server accepts 100 connections by default.
const POSTGRES_READERS: u32 = 8;
/// Number of connections that write, per process. They are separate from the readers, so that writers that wait for a lock do not block readers.
const POSTGRES_WRITERS: u32 = 8;
/// Timeouts of a session. With them, a node that is frozen, paused or disconnected blocks the writes of the other nodes for less than 10 s.
///
/// - `lock_timeout`: longest wait for one lock. Then the request fails, and the client tries again. A write to a row may wait for two locks, the
///   row's queue and the row itself, which makes 4 s in total.
/// - `idle_in_transaction_session_timeout`: longest time for which the transaction of a frozen node keeps its locks. It must be longer than 4 s. The
///   worst case is 9 s: a request of the frozen node waits 4 s for the row, gets it, and its transaction then holds the row for 5 s. The time for
///   receiving data counts as idle, so the network must transfer the largest upload, 32 MiB, within 5 s.
/// - TCP: detects a node that does not read its answer (8 s), or whose machine does not respond (5 s and three probes 1 s apart).
const POSTGRES_SETTINGS: &str = "set lock_timeout = '2s'; set idle_in_transaction_session_timeout = '5s'; \
    set tcp_keepalives_idle = 5; set tcp_keepalives_interval = 1; set tcp_keepalives_count = 3; set tcp_user_timeout = '8s'";

/// Longest wait of a request for a connection that reads. After that the answer is 503.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(5);
/// Attempts of a server to lock its data directory, and the pause between them.
const LOCK_ATTEMPTS: usize = 10;
const LOCK_RETRY_DELAY: Duration = Duration::from_millis(50);
/// Settings of an SQLite connection. With WAL and FULL, an acknowledged write survives a power loss. The busy timeout (ms) is for locks of other
/// programs, such as `kincal key`. The server's own writers queue for one connection, for at most [`WRITER_TIMEOUT`].
pub(super) const SQLITE_PRAGMAS: &str = "pragma busy_timeout = 3000; pragma journal_mode = wal; pragma synchronous = full; pragma foreign_keys = on";

impl Store {
    /// Opens the database for a server and migrates its schema. On SQLite, also locks the data directory and ends the leases of the previous process,
    /// which no longer runs.
    ///
    /// # Errors
    /// [`Error::Open`] (data directory in use, SQLite too old, …), [`Error::Database`].
    pub async fn open(location: StoreLocation) -> Result<Store> {
        match location {
            StoreLocation::Sqlite { data_dir } => {
                let data_dir = make_data_dir(&data_dir)?;
                make_private(&data_dir);
                let lock_file = lock_as_server(&data_dir).await?;
                let store = connect_sqlite(&data_dir, Some(lock_file), true).await?;
                migrate(&store).await?;
                leases::expire_all(&store).await?;
                Ok(store)
            }
            StoreLocation::Postgres { url } => open_postgres(&url).await,
        }
    }

    /// Opens the database for a short-lived tool (`kincal key …`), which may run at the same time as the server.
    ///
    /// # Errors
    /// As [`Store::open`], but a data directory that is in use is accepted.
    pub async fn open_for_command(location: StoreLocation) -> Result<Store> {
        match location {
            StoreLocation::Sqlite { data_dir } => {
                let data_dir = make_data_dir(&data_dir)?;
                let alone = lock(&data_dir)?;
                let store = connect_sqlite(&data_dir, None, alone.is_none()).await?;
                if alone.is_some() {
                    migrate(&store).await?;
                }
                Ok(store)
            }
            StoreLocation::Postgres { url } => open_postgres(&url).await,
        }
    }

    /// Opens an existing database without migrating its schema.
    pub async fn open_unmigrated(location: StoreLocation) -> Result<Store> {
        match location {
            StoreLocation::Sqlite { data_dir } => {
                if !data_dir.join(DATABASE).is_file() {
                    return Err(Error::open(format!(
                        "there is no database in {}",
                        data_dir.display()
                    )));
                }
                let is_served = lock(&data_dir)?.is_none();
                connect_sqlite(&data_dir, None, is_served).await
            }
            StoreLocation::Postgres { url } => connect_postgres(&url).await,
        }
    }
}

async fn open_postgres(url: &str) -> Result<Store> {
    let store = connect_postgres(url).await?;
    migrate(&store).await?;
    Ok(store)
}

async fn connect_postgres(url: &str) -> Result<Store> {
    if !url.starts_with("postgres://") && !url.starts_with("postgresql://") {
        return Err(Error::open("the database URL must begin with postgres://"));
    }
    let options = AnyPoolOptions::new().after_connect(|connection, _| {
        Box::pin(async move { connection.execute(POSTGRES_SETTINGS).await.map(drop) })
    });
    let readers = options
        .clone()
        .max_connections(POSTGRES_READERS)
        .acquire_timeout(ACQUIRE_TIMEOUT);
    let writers = options
        .max_connections(POSTGRES_WRITERS)
        .acquire_timeout(WRITER_TIMEOUT);
    let inner = Inner {
        readers: connect(readers, url, POSTGRES_SETTINGS).await?,
        writers: connect(writers, url, POSTGRES_SETTINGS).await?,
        writes: Writes::default(),
        engine: Engine::Postgres,
        data_dir: None,
        is_served: true,
        lock_file: None,
    };
    Ok(Store {
        inner: Arc::new(inner),
    })
}

async fn connect(options: AnyPoolOptions, url: &str, settings: &'static str) -> Result<AnyPool> {
    sqlx::any::install_default_drivers();
    let url = AnyConnectOptions::from_str(url)
        .map_err(|e| Error::open(format!("the database URL: {e}")))?;
    match options.connect_with(url.clone()).await {
        Ok(pool) => Ok(pool),
        Err(cause) => Err(Error::open(format!(
            "cannot open the database: {}",
            actual_error(cause, &url, settings).await
        ))),
    }
}

/// Connects once to get the actual error; the pool only reports a timeout.
async fn actual_error(
    cause: sqlx::Error,
    url: &AnyConnectOptions,
    settings: &'static str,
) -> sqlx::Error {
    if !matches!(cause, sqlx::Error::PoolTimedOut) {
        return cause;
    }
    let one = async {
        AnyConnection::connect_with(url)
            .await?
            .execute(settings)
            .await
    };
    one.await.err().unwrap_or(cause)
}

async fn connect_sqlite(
    data_dir: &Path,
    lock_file: Option<File>,
    is_served: bool,
) -> Result<Store> {
    let options = AnyPoolOptions::new()
        .acquire_timeout(ACQUIRE_TIMEOUT)
        .test_before_acquire(false)
        .after_connect(|connection, _| {
            Box::pin(async move { connection.execute(SQLITE_PRAGMAS).await.map(drop) })
        });
    let file = data_dir.join(DATABASE);
    make_private_file(&file)
        .map_err(|e| Error::open(format!("the database file {}: {e}", file.display())))?;
    let url = sqlite_url(data_dir)?;
    let readers = options.clone().max_connections(SQLITE_READERS);
    let readers = connect(readers, &url, SQLITE_PRAGMAS).await?;
    refuse_old_sqlite(&readers).await?;
    // If SQLite itself ended the transaction (disk full), sqlx still counts it as open. Such a connection is closed here. The ping first waits for
    // the rollback of a dropped transaction, which sqlx has queued.
    let writer = options
        .max_connections(1)
        .acquire_timeout(WRITER_TIMEOUT)
        .after_release(|connection, _| {
            Box::pin(async move {
                connection.ping().await?;
                Ok(!connection.is_in_transaction())
            })
        });
    let inner = Inner {
        readers,
        writers: connect(writer, &url, SQLITE_PRAGMAS).await?,
        writes: Writes::default(),
        engine: Engine::Sqlite,
        data_dir: Some(data_dir.to_owned()),
        is_served,
        lock_file,
    };
    Ok(Store {
        inner: Arc::new(inner),
    })
}

fn sqlite_url(data_dir: &Path) -> Result<String> {
    let file = data_dir.join(DATABASE);
    let path = file.to_str().ok_or_else(|| {
        Error::open(format!(
            "the data directory {} is not UTF-8",
            data_dir.display()
        ))
    })?;
    let mut url = String::from("sqlite://");
    for byte in path.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => {
                url.push(char::from(byte))
            }
            other => url.push_str(&format!("%{other:02X}")),
        }
    }
    Ok(url + "?mode=rwc")
}

async fn refuse_old_sqlite(pool: &AnyPool) -> Result<()> {
    let version: String = sqlx::query_scalar("select sqlite_version()")
        .fetch_one(pool)
        .await?;
    let mut numbers = version.split('.').map(|n| n.parse().unwrap_or(0));
    let mut next = || numbers.next().unwrap_or(0);
    if (next(), next(), next()) < OLDEST_SQLITE {
        return Err(Error::open(format!(
            "SQLite {version} can corrupt the database; 3.51.3 or later is needed"
        )));
    }
    Ok(())
}

fn make_data_dir(data_dir: &Path) -> Result<PathBuf> {
    let failed =
        |e: std::io::Error| Error::open(format!("the data directory {}: {e}", data_dir.display()));
    make_private_dir(data_dir).map_err(failed)?;
    data_dir.canonicalize().map_err(failed)
}

/// Creates a directory that only its owner can read, if it is missing. The directory will hold measurements, reports and hashes of keys.
pub(super) fn make_private_dir(dir: &Path) -> std::io::Result<()> {
    DirBuilder::new()
        .recursive(true)
        .mode(PRIVATE_DIR)
        .create(dir)
}

/// Creates an empty file that only its owner can read, if it is missing. SQLite gives its WAL and shared-memory files the same permissions.
pub(super) fn make_private_file(file: &Path) -> std::io::Result<()> {
    if file.exists() {
        return Ok(());
    }
    let mut options = File::options();
    match options
        .write(true)
        .create_new(true)
        .mode(PRIVATE_FILE)
        .open(file)
    {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => Err(error),
        _ => Ok(()),
    }
}

/// Removes the permissions of other users from a data directory that an older version created. This works only if the process owns the directory.
fn make_private(data_dir: &Path) {
    let mode = std::fs::metadata(data_dir).map_or(0, |data| data.permissions().mode());
    if mode & GROUP_AND_OTHERS_MASK == 0 {
        return;
    }
    let (directory, before) = (data_dir.display(), format!("{:04o}", mode & 0o7777));
    match std::fs::set_permissions(data_dir, Permissions::from_mode(PRIVATE_DIR)) {
        Ok(()) => tracing::info!(
            %directory,
            %before,
            "removed the permissions of other users from the data directory: it holds measurements, reports and the hashes of keys"
        ),
        Err(error) => tracing::warn!(
            %directory,
            mode = before,
            %error,
            "other users of this machine can read the data directory, and it belongs to another user: its owner should run `chmod 0700`"
        ),
    }
}

/// Locks the data directory for a server. Retries for a moment, because commands take the lock briefly to find out whether a server is
/// running.
async fn lock_as_server(data_dir: &Path) -> Result<File> {
    for _ in 0..LOCK_ATTEMPTS {
        if let Some(file) = lock(data_dir)? {
            return Ok(file);
        }
        sleep(LOCK_RETRY_DELAY).await;
    }
    Err(Error::open(format!(
        "the data directory {} is in use by another kincal server; stop that one or choose another",
        data_dir.display()
    )))
}

/// Locks the data directory; none if another process has locked it. The lock ends when the file is closed, at the latest with the process.
fn lock(data_dir: &Path) -> Result<Option<File>> {
    let path = data_dir.join(LOCK);
    let failed = |e: std::io::Error| Error::open(format!("the lock file {}: {e}", path.display()));
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .mode(PRIVATE_FILE)
        .open(&path)
        .map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(e)) => Err(failed(e)),
    }
}
