//! The schema's migrations.

use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::{Connection, Executor, SqlSafeStr};

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
    step!(23, "0023", "browser_sessions"),
];

/// No timeouts while a node migrates the schema, because the node may have to wait for another node that runs the same migration.
const POSTGRES_SETTINGS_TO_MIGRATE: &str =
    "set lock_timeout = 0; set idle_in_transaction_session_timeout = 0";

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
        return migrator.run(store.writers()).await.map_err(failed);
    }
    let mut connection = store.writers().acquire().await?.detach();
    connection.execute(POSTGRES_SETTINGS_TO_MIGRATE).await?;
    migrator.run(&mut connection).await.map_err(failed)?;
    Ok(connection.close().await?)
}
