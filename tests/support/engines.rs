//! A separate database for each test, on each engine.

use std::io::Write;
use std::sync::Once;

use kincal::store::{Engine, Store, StoreLocation};
use sqlx::{AssertSqlSafe, Connection, PgConnection};
use tempfile::TempDir;

/// Set by CI: `postgres://user@host:port/database` of a server on which tests may create databases.
const POSTGRES_VARIABLE: &str = "TEST_POSTGRES_URL";

/// An empty database and the store on it.
pub struct TestDatabase {
    pub store: Store,
    #[allow(dead_code, reason = "each test binary uses its part")]
    pub location: StoreLocation,
    _home: Home,
}

/// Resources that are removed with the test.
enum Home {
    Directory(#[allow(dead_code)] TempDir),
    Database(PostgresDatabase),
}

struct PostgresDatabase {
    server: String,
    name: String,
}

/// Runs a test on SQLite, and on PostgreSQL if there is one.
pub fn for_each_engine(test: impl AsyncFn(&TestDatabase)) {
    on_sqlite(&test);
    match std::env::var(POSTGRES_VARIABLE) {
        Ok(server) => run(Engine::Postgres, &test, &server),
        Err(_) => report_missing_postgres(),
    }
}

/// Prints once per test binary that PostgreSQL is missing, directly to standard error, because the test harness hides the output of passing tests.
fn report_missing_postgres() {
    static SAID: Once = Once::new();
    SAID.call_once(|| {
        let _ = writeln!(
            std::io::stderr(),
            "!!! {POSTGRES_VARIABLE} IS NOT SET: THESE TESTS DO NOT RUN ON POSTGRESQL !!!"
        );
    });
}

/// Runs a test on SQLite alone.
pub fn on_sqlite(test: impl AsyncFn(&TestDatabase)) {
    run(Engine::Sqlite, &test, "");
}

fn run(engine: Engine, test: &impl AsyncFn(&TestDatabase), server: &str) {
    eprintln!("on {engine:?}");
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let (home, location) = match engine {
            Engine::Sqlite => {
                let directory = TempDir::new().expect("a temporary directory");
                let data_dir = directory.path().join("data 100%");
                (
                    Home::Directory(directory),
                    StoreLocation::Sqlite { data_dir },
                )
            }
            Engine::Postgres => {
                let database = PostgresDatabase::create(server).await;
                let url = database.url();
                (Home::Database(database), StoreLocation::Postgres { url })
            }
        };
        let store = Store::open(location.clone())
            .await
            .expect("the store opens");
        let database = TestDatabase {
            store,
            location,
            _home: home,
        };
        test(&database).await;
        database.store.close().await;
    });
}

impl PostgresDatabase {
    async fn create(server: &str) -> Self {
        let database = PostgresDatabase {
            server: server.to_owned(),
            name: format!("kincal_test_{}", uuid::Uuid::now_v7().simple()),
        };
        database.administer("create database").await;
        database
    }

    fn url(&self) -> String {
        let (server, _) = self.server.rsplit_once('/').expect("a URL with a database");
        format!("{server}/{}", self.name)
    }

    async fn administer(&self, what: &str) {
        let mut connection = PgConnection::connect(&self.server)
            .await
            .expect("PostgreSQL answers");
        sqlx::query(AssertSqlSafe(format!("{what} {}", self.name)))
            .execute(&mut connection)
            .await
            .expect("it may administer databases");
    }
}

impl Drop for Home {
    fn drop(&mut self) {
        if let Home::Database(database) = self {
            // On a separate thread, because a drop cannot await. Runs even if the test panics.
            std::thread::scope(|scope| {
                let drop_database = || {
                    let runtime = tokio::runtime::Builder::new_current_thread()
                        .enable_all()
                        .build()
                        .expect("a runtime");
                    runtime.block_on(async {
                        let mut connection = PgConnection::connect(&database.server)
                            .await
                            .expect("PostgreSQL answers");
                        let sql =
                            AssertSqlSafe(format!("drop database {} with (force)", database.name));
                        sqlx::query(sql)
                            .execute(&mut connection)
                            .await
                            .expect("it drops the database");
                    });
                };
                let _ = scope.spawn(drop_database).join();
            });
        }
    }
}
