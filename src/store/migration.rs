//! The schema's migrations.

use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::{Connection, Executor, SqlSafeStr};

use super::database::RESERVE_BYTES;
use super::{Engine, Error, Result, Store};

/// One migration: its version, its name, and its SQL for SQLite and for PostgreSQL.
macro_rules! step {
    ($version:literal, $number:literal, $name:literal) => {
        (
            $version,
            $name,
            include_str!(concat!(
                "../../migrations/sqlite/",
                $number,
                "_",
                $name,
                ".sql"
            )),
            include_str!(concat!(
                "../../migrations/postgres/",
                $number,
                "_",
                $name,
                ".sql"
            )),
        )
    };
}

const MIGRATIONS: &[(i64, &str, &str, &str)] = &[
    step!(1, "0001", "initial"),
    step!(2, "0002", "trust"),
    step!(3, "0003", "turns"),
    step!(4, "0004", "release"),
    step!(5, "0005", "residual_networks"),
    step!(6, "0006", "results"),
    step!(7, "0007", "documents_last"),
    step!(8, "0008", "verification"),
    step!(9, "0009", "insisted"),
    step!(10, "0010", "far_off"),
    step!(11, "0011", "report_summary"),
    step!(12, "0012", "mend_and_put_away"),
    step!(13, "0013", "columns"),
    step!(17, "0017", "estimate"),
    step!(18, "0018", "check"),
    step!(19, "0019", "named_documents"),
    step!(20, "0020", "sessions"),
    step!(21, "0021", "job_sources"),
    step!(22, "0022", "age_and_references"),
];

/// Version of the migration that rewrites the job table on SQLite, so that reports are the last columns.
const JOB_TABLE_REWRITE: i64 = 7;

pub(super) const QUERIES_SQLITE: &[&str] = &[HAS_JOBS, JOB_BYTES];

const HAS_JOBS: &str = "select max(rootpage) from sqlite_master where name = 'job'";
const JOB_BYTES: &str = "
    select coalesce(sum(1024 + octet_length(request_json) + coalesce(octet_length(report_json), 0) + coalesce(octet_length(convergence_json), 0)), 0)
    from job";

/// No timeouts while a node migrates the schema, because the node may have to wait for another node that runs the same migration.
const POSTGRES_SETTINGS_TO_MIGRATE: &str =
    "set lock_timeout = 0; set idle_in_transaction_session_timeout = 0";

/// Checks the disk space for migration 7. This migration writes all jobs three times: twice into the WAL, and once into the database beside the old
/// rows.
async fn check_space_for_rewrite(store: &Store) -> Result<()> {
    let before: Option<i64> = sqlx::query_scalar(HAS_JOBS)
        .fetch_one(store.readers())
        .await?;
    let is_ahead =
        before.is_some() && (1..JOB_TABLE_REWRITE).contains(&store.schema_version().await?);
    if !is_ahead {
        return Ok(());
    }
    let bytes: i64 = sqlx::query_scalar(JOB_BYTES)
        .fetch_one(store.readers())
        .await?;
    let needed_bytes = u64::try_from(bytes).unwrap_or(0).saturating_mul(3) + RESERVE_BYTES;
    if let Some(free_bytes) = store.free_bytes().filter(|free| *free < needed_bytes) {
        let (needed_mib, free_mib) = (needed_bytes >> 20, free_bytes >> 20);
        return Err(Error::open(format!(
            "the migration of the job table needs {needed_mib} MiB of free disk space in the data directory, and there are {free_mib}; \
                 nothing was changed: free disk space and start again"
        )));
    }
    tracing::info!(
        mib = bytes >> 20,
        "rewriting the job table, once; this takes some seconds for each 100 MiB"
    );
    Ok(())
}

/// Migrates the schema of a database to the version of this program.
pub(super) async fn migrate(store: &Store) -> Result<()> {
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
    let failed = |e: MigrateError| Error::open(format!("the database's schema: {e}"));
    if store.engine() == Engine::Sqlite {
        check_space_for_rewrite(store).await?;
        return migrator.run(store.writers()).await.map_err(failed);
    }
    let mut connection = store.writers().acquire().await?.detach();
    connection.execute(POSTGRES_SETTINGS_TO_MIGRATE).await?;
    migrator.run(&mut connection).await.map_err(failed)?;
    Ok(connection.close().await?)
}
