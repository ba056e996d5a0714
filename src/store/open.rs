//! Opening the database: where it is, its settings, its lock and its schema.

use std::fs::{DirBuilder, File, Permissions, TryLockError};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use sqlx::any::{AnyConnectOptions, AnyPoolOptions};
use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::{AnyConnection, AnyPool, Connection, Executor, SqlSafeStr};
use tokio::sync::Semaphore;

use super::database::{DATABASE, Inner, LOCK, RESERVE_BYTES, WRITER_TIMEOUT};
use super::{Engine, Error, Result, Store, leases};

/// Where the database is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoreLocation {
    /// The embedded database, in this directory, which is made if it is missing.
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

/// The schema's steps, the same numbers on both engines: (version, name, SQLite, PostgreSQL).
const MIGRATIONS: &[(i64, &str, &str, &str)] = &[
    (
        1,
        "initial",
        include_str!("../../migrations/sqlite/0001_initial.sql"),
        include_str!("../../migrations/postgres/0001_initial.sql"),
    ),
    (
        2,
        "trust",
        include_str!("../../migrations/sqlite/0002_trust.sql"),
        include_str!("../../migrations/postgres/0002_trust.sql"),
    ),
    (
        3,
        "turns",
        include_str!("../../migrations/sqlite/0003_turns.sql"),
        include_str!("../../migrations/postgres/0003_turns.sql"),
    ),
    (
        4,
        "release",
        include_str!("../../migrations/sqlite/0004_release.sql"),
        include_str!("../../migrations/postgres/0004_release.sql"),
    ),
    (
        5,
        "residual_networks",
        include_str!("../../migrations/sqlite/0005_residual_networks.sql"),
        include_str!("../../migrations/postgres/0005_residual_networks.sql"),
    ),
    (
        6,
        "results",
        include_str!("../../migrations/sqlite/0006_results.sql"),
        include_str!("../../migrations/postgres/0006_results.sql"),
    ),
    (
        7,
        "documents_last",
        include_str!("../../migrations/sqlite/0007_documents_last.sql"),
        include_str!("../../migrations/postgres/0007_documents_last.sql"),
    ),
    (
        8,
        "verification",
        include_str!("../../migrations/sqlite/0008_verification.sql"),
        include_str!("../../migrations/postgres/0008_verification.sql"),
    ),
    (
        9,
        "insisted",
        include_str!("../../migrations/sqlite/0009_insisted.sql"),
        include_str!("../../migrations/postgres/0009_insisted.sql"),
    ),
    (
        10,
        "far_off",
        include_str!("../../migrations/sqlite/0010_far_off.sql"),
        include_str!("../../migrations/postgres/0010_far_off.sql"),
    ),
];

/// Version of the migration that rewrites the job table on SQLite, so that reports are the last columns.
const JOB_TABLE_REWRITE: i64 = 7;

pub(super) const QUERIES_SQLITE: &[&str] = &[HAS_JOBS, JOB_BYTES];

const HAS_JOBS: &str = "select max(rootpage) from sqlite_master where name = 'job'";
const JOB_BYTES: &str = "
    select coalesce(sum(1024 + octet_length(request_json) + coalesce(octet_length(report_json), 0) + coalesce(octet_length(convergence_json), 0)), 0)
    from job";

/// Permissions of the data directory: the owner's only.
const PRIVATE_DIR: u32 = 0o700;
/// Permissions of the files in it.
const PRIVATE_FILE: u32 = 0o600;
/// Permissions of everybody but the owner.
const OTHERS: u32 = 0o077;
/// Oldest version that is accepted: older ones can corrupt a database in WAL mode.
const OLDEST_SQLITE: (u32, u32, u32) = (3, 51, 3);
/// Connections that read. SQLite's readers do not wait for each other; more connections only cost memory.
const SQLITE_READERS: u32 = 8;
/// Connections per process. A PostgreSQL server accepts 100 by default.
const POSTGRES_CONNECTIONS: u32 = 16;
/// Most connections that write at once, so that writers that wait for a lock leave some connections for readers.
const POSTGRES_WRITERS: usize = 12;
/// Timeouts with which a node that is frozen, paused or cut off stops the writes of the other nodes for less than 10 s.
///
/// - `lock_timeout`: longest wait for one lock; then the request fails, and the client tries again. A write to a row may wait for two locks, the
///   row's queue and the row itself: 4 s in all.
/// - `idle_in_transaction_session_timeout`: longest time for which a frozen node's transaction keeps its locks. It is longer than 4 s: when the
///   transaction ends, the frozen node's other requests for the same row have failed, so none of them holds the row for another 5 s. If one of
///   them gets the row from another node just before 4 s are over, the row is locked until 9 s after the freeze. Receiving counts as idle, so the
///   network must carry the largest upload, 32 MiB, within 5 s.
/// - TCP: detects a node that does not read its answer (8 s), or whose machine does not respond (5 s and three probes 1 s apart).
const POSTGRES_SETTINGS: &str = "set lock_timeout = '2s'; set idle_in_transaction_session_timeout = '5s'; \
    set tcp_keepalives_idle = 5; set tcp_keepalives_interval = 1; set tcp_keepalives_count = 3; set tcp_user_timeout = '8s'";
/// No limits while a node migrates the schema: it may wait for another node that runs the same migration.
const POSTGRES_SETTINGS_TO_MIGRATE: &str =
    "set lock_timeout = 0; set idle_in_transaction_session_timeout = 0";
/// Longest wait of a request for a connection that reads; then the answer is 503.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(5);
/// WAL and FULL: an acknowledged write survives power loss. The busy timeout (ms) is for locks of other programs, such as `kincal key`: the
/// server's own writers queue for one connection, for [`WRITER_TIMEOUT`] at most.
pub(super) const SQLITE_PRAGMAS: &str = "pragma busy_timeout = 3000; pragma journal_mode = wal; pragma synchronous = full; pragma foreign_keys = on";

impl Store {
    /// Opens the database for a server: updates its schema and, on SQLite, locks the data directory and ends the leases of the previous process,
    /// which is dead.
    ///
    /// # Errors
    /// [`Error::Open`] (data directory in use, SQLite too old, …), [`Error::Database`].
    pub async fn open(location: StoreLocation) -> Result<Store> {
        as_server(location).await
    }

    /// Opens the database for a short-lived tool (`kincal key …`) that may run beside the server.
    ///
    /// # Errors
    /// As [`Store::open`], but a data directory in use is accepted.
    pub async fn open_beside_a_server(location: StoreLocation) -> Result<Store> {
        beside_a_server(location).await
    }

    /// Opens an existing database without migrating its schema.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub async fn open_as_it_is(location: StoreLocation) -> Result<Store> {
        as_it_is(location).await
    }
}

async fn as_server(location: StoreLocation) -> Result<Store> {
    match location {
        StoreLocation::Sqlite { data_dir } => {
            let data_dir = make_data_dir(&data_dir)?;
            make_private(&data_dir);
            let lock_file = lock(&data_dir)?.ok_or_else(|| Error::Open {
                detail: format!(
                    "the data directory {} is in use by another kincal server; stop that one or choose another",
                    data_dir.display()
                ),
            })?;
            let store = connect_sqlite(&data_dir, Some(lock_file), true).await?;
            migrate(&store).await?;
            leases::end_all(&store).await?;
            Ok(store)
        }
        StoreLocation::Postgres { url } => open_postgres(&url).await,
    }
}

async fn beside_a_server(location: StoreLocation) -> Result<Store> {
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

async fn as_it_is(location: StoreLocation) -> Result<Store> {
    match location {
        StoreLocation::Sqlite { data_dir } => {
            if !data_dir.join(DATABASE).is_file() {
                return Err(Error::Open {
                    detail: format!("there is no database in {}", data_dir.display()),
                });
            }
            let is_served = lock(&data_dir)?.is_none();
            connect_sqlite(&data_dir, None, is_served).await
        }
        StoreLocation::Postgres { url } => connect_postgres(&url).await,
    }
}

async fn open_postgres(url: &str) -> Result<Store> {
    let store = connect_postgres(url).await?;
    migrate(&store).await?;
    Ok(store)
}

async fn connect_postgres(url: &str) -> Result<Store> {
    if !url.starts_with("postgres://") && !url.starts_with("postgresql://") {
        return Err(Error::Open {
            detail: "the database URL must begin with postgres://".into(),
        });
    }
    let options = AnyPoolOptions::new()
        .max_connections(POSTGRES_CONNECTIONS)
        .acquire_timeout(ACQUIRE_TIMEOUT)
        .after_connect(|connection, _| {
            Box::pin(async move { connection.execute(POSTGRES_SETTINGS).await.map(drop) })
        });
    let pool = connect(options, url, POSTGRES_SETTINGS).await?;
    let inner = Inner {
        pool,
        sqlite_writer: None,
        postgres_writers: Some(Arc::new(Semaphore::new(POSTGRES_WRITERS))),
        writes: Arc::default(),
        engine: Engine::Postgres,
        data_dir: None,
        is_served: true,
        postgres_url: Some(url.to_owned()),
        lock_file: None,
    };
    Ok(Store {
        inner: Arc::new(inner),
    })
}

async fn connect(options: AnyPoolOptions, url: &str, settings: &'static str) -> Result<AnyPool> {
    sqlx::any::install_default_drivers();
    let url = AnyConnectOptions::from_str(url).map_err(|e| Error::Open {
        detail: format!("the database URL: {e}"),
    })?;
    match options.connect_with(url.clone()).await {
        Ok(pool) => Ok(pool),
        Err(cause) => Err(Error::Open {
            detail: format!(
                "cannot open the database: {}",
                reason(cause, &url, settings).await
            ),
        }),
    }
}

/// Connects once to get the actual error; the pool only reports a timeout.
async fn reason(
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
    make_private_file(&file).map_err(|e| Error::Open {
        detail: format!("the database file {}: {e}", file.display()),
    })?;
    let url = sqlite_url(data_dir)?;
    let readers = options.clone().max_connections(SQLITE_READERS);
    let pool = connect(readers, &url, SQLITE_PRAGMAS).await?;
    refuse_old_sqlite(&pool).await?;
    // Closes the connection if SQLite itself ended the transaction (disk full), because sqlx still counts it as open. The ping first waits for the
    // rollback of a dropped transaction, which sqlx has queued.
    let writer = options
        .max_connections(1)
        .acquire_timeout(WRITER_TIMEOUT)
        .after_release(|connection, _| {
            Box::pin(async move {
                connection.ping().await?;
                Ok(!connection.is_in_transaction())
            })
        });
    let sqlite_writer = connect(writer, &url, SQLITE_PRAGMAS).await?;
    let inner = Inner {
        pool,
        sqlite_writer: Some(sqlite_writer),
        postgres_writers: None,
        writes: Arc::default(),
        engine: Engine::Sqlite,
        data_dir: Some(data_dir.to_owned()),
        is_served,
        postgres_url: None,
        lock_file,
    };
    Ok(Store {
        inner: Arc::new(inner),
    })
}

fn sqlite_url(data_dir: &Path) -> Result<String> {
    let file = data_dir.join(DATABASE);
    let path = file.to_str().ok_or_else(|| Error::Open {
        detail: format!("the data directory {} is not UTF-8", data_dir.display()),
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
        return Err(Error::Open {
            detail: format!("SQLite {version} can corrupt the database; 3.51.3 or later is needed"),
        });
    }
    Ok(())
}

fn make_data_dir(data_dir: &Path) -> Result<PathBuf> {
    let failed = |e: std::io::Error| Error::Open {
        detail: format!("the data directory {}: {e}", data_dir.display()),
    };
    make_private_dir(data_dir).map_err(failed)?;
    data_dir.canonicalize().map_err(failed)
}

/// Makes a directory that only its owner can read, if it is missing. It will hold measurements, reports and hashes of keys.
pub(super) fn make_private_dir(dir: &Path) -> std::io::Result<()> {
    DirBuilder::new()
        .recursive(true)
        .mode(PRIVATE_DIR)
        .create(dir)
}

/// Makes an empty file that only its owner can read, if it is missing. SQLite gives its log and index the same permissions.
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

/// Removes the permissions of others from a directory that an older version made. Only its owner can do that.
fn make_private(data_dir: &Path) {
    let mode = std::fs::metadata(data_dir).map_or(0, |data| data.permissions().mode());
    if mode & OTHERS == 0 {
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

/// Locks the data directory; none if another process has locked it. The lock ends with the process.
fn lock(data_dir: &Path) -> Result<Option<File>> {
    let path = data_dir.join(LOCK);
    let failed = |e: std::io::Error| Error::Open {
        detail: format!("the lock file {}: {e}", path.display()),
    };
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

/// Checks the disk space for migration 7. It rewrites all jobs: twice into the WAL, and once into the database beside the old rows.
async fn check_space_for_rewrite(store: &Store) -> Result<()> {
    let before: Option<i64> = sqlx::query_scalar(HAS_JOBS).fetch_one(store.pool()).await?;
    let is_ahead =
        before.is_some() && (1..JOB_TABLE_REWRITE).contains(&store.schema_version().await?);
    if !is_ahead {
        return Ok(());
    }
    let bytes: i64 = sqlx::query_scalar(JOB_BYTES)
        .fetch_one(store.pool())
        .await?;
    let needed_bytes = u64::try_from(bytes).unwrap_or(0).saturating_mul(3) + RESERVE_BYTES;
    if let Some(free_bytes) = store.free_bytes().filter(|free| *free < needed_bytes) {
        let (needed_mib, free_mib) = (needed_bytes >> 20, free_bytes >> 20);
        return Err(Error::Open {
            detail: format!(
                "the jobs in the database are to be laid out anew, which needs {needed_mib} MiB free on the disk of the data directory, and there are \
                 {free_mib}; nothing was changed: make room and start again"
            ),
        });
    }
    tracing::info!(
        mib = bytes >> 20,
        "rewriting the job table, once; this takes some seconds for each 100 MiB"
    );
    Ok(())
}

async fn migrate(store: &Store) -> Result<()> {
    let migrations = MIGRATIONS.iter().map(|&(version, name, sqlite, postgres)| {
        let sql = match store.engine() {
            Engine::Sqlite => sqlite,
            Engine::Postgres => postgres,
        };
        Migration::new(
            version,
            name.into(),
            MigrationType::Simple,
            sql.into_sql_str(),
            false,
        )
    });
    let migrator = Migrator::with_migrations(migrations.collect());
    let failed = |e: MigrateError| Error::Open {
        detail: format!("the database's schema: {e}"),
    };
    if store.engine() == Engine::Sqlite {
        check_space_for_rewrite(store).await?;
        return migrator.run(store.pool()).await.map_err(failed);
    }
    let mut connection = store.pool().acquire().await?.detach();
    connection.execute(POSTGRES_SETTINGS_TO_MIGRATE).await?;
    migrator.run(&mut connection).await.map_err(failed)?;
    Ok(connection.close().await?)
}
