//! The schema's migrations.

use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::{Connection, Executor, SqlSafeStr};

use super::database::RESERVE_BYTES;
use super::{Engine, Error, Result, Store};

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
    (
        11,
        "report_summary",
        include_str!("../../migrations/sqlite/0011_report_summary.sql"),
        include_str!("../../migrations/postgres/0011_report_summary.sql"),
    ),
    (
        12,
        "mend_and_put_away",
        include_str!("../../migrations/sqlite/0012_mend_and_put_away.sql"),
        include_str!("../../migrations/postgres/0012_mend_and_put_away.sql"),
    ),
    (
        13,
        "columns",
        include_str!("../../migrations/sqlite/0013_columns.sql"),
        include_str!("../../migrations/postgres/0013_columns.sql"),
    ),
    (
        17,
        "estimate",
        include_str!("../../migrations/sqlite/0017_estimate.sql"),
        include_str!("../../migrations/postgres/0017_estimate.sql"),
    ),
    (
        18,
        "check",
        include_str!("../../migrations/sqlite/0018_check.sql"),
        include_str!("../../migrations/postgres/0018_check.sql"),
    ),
    (
        19,
        "named_documents",
        include_str!("../../migrations/sqlite/0019_named_documents.sql"),
        include_str!("../../migrations/postgres/0019_named_documents.sql"),
    ),
    (
        20,
        "sessions",
        include_str!("../../migrations/sqlite/0020_sessions.sql"),
        include_str!("../../migrations/postgres/0020_sessions.sql"),
    ),
];

/// Version of the migration that rewrites the job table on SQLite, so that reports are the last columns.
const JOB_TABLE_REWRITE: i64 = 7;

pub(super) const QUERIES_SQLITE: &[&str] = &[HAS_JOBS, JOB_BYTES];

const HAS_JOBS: &str = "select max(rootpage) from sqlite_master where name = 'job'";
const JOB_BYTES: &str = "
    select coalesce(sum(1024 + octet_length(request_json) + coalesce(octet_length(report_json), 0) + coalesce(octet_length(convergence_json), 0)), 0)
    from job";

/// No limits while a node migrates the schema: it may wait for another node that runs the same migration.
const POSTGRES_SETTINGS_TO_MIGRATE: &str =
    "set lock_timeout = 0; set idle_in_transaction_session_timeout = 0";

/// Checks the disk space for migration 7. It rewrites all jobs: twice into the WAL, and once into the database beside the old rows.
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

/// Brings the schema of a database to this version.
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
    let failed = |e: MigrateError| Error::Open {
        detail: format!("the database's schema: {e}"),
    };
    if store.engine() == Engine::Sqlite {
        check_space_for_rewrite(store).await?;
        return migrator.run(store.writers()).await.map_err(failed);
    }
    let mut connection = store.writers().acquire().await?.detach();
    connection.execute(POSTGRES_SETTINGS_TO_MIGRATE).await?;
    migrator.run(&mut connection).await.map_err(failed)?;
    Ok(connection.close().await?)
}
