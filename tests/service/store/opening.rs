//! Opening: settings, lock, schema.

use std::time::{Duration, SystemTime};

use kincal::store::{
    Engine, Error, Exhausted, ListRequest, NewJob, Store, StoreLocation, all_queries, jobs, leases,
    robots,
};
use sqlx::migrate::Migrator;
use sqlx::{AssertSqlSafe, Executor, SqlitePool, query_scalar};
use tempfile::TempDir;

use crate::engines::{for_each_engine, on_sqlite};
use crate::fixtures::{a_lone_job, a_robot, a_set, claim, in_transaction, new_job};
use crate::store::verify::{broken, insert_examples};

#[test]
fn each_engine_prepares_every_query() {
    for_each_engine(async |database| {
        let queries = all_queries(database.store.engine());
        assert!(
            queries.len() > 50,
            "the list of queries is incomplete: {}",
            queries.len()
        );
        let mut connection = database.store.readers().acquire().await.unwrap();
        for query in queries {
            // Otherwise SQLite would plan the query at every use.
            assert!(
                !query.contains("limit $"),
                "a limit that is bound is cast: {query}"
            );
            let prepared = (&mut *connection)
                .prepare(sqlx::SqlSafeStr::into_sql_str(sqlx::AssertSqlSafe(&*query)))
                .await;
            prepared.unwrap_or_else(|error| panic!("{error}: {query}"));
        }
    });
}

/// Constants of the store that are no statements, or belong to one engine's connections.
const NO_QUERIES: &[&str] = &[
    "SQLITE_PRAGMAS",
    "POSTGRES_SETTINGS",
    "POSTGRES_SETTINGS_TO_MIGRATE",
    "NOW",
    "SCHEMA_VERSION",
    "CHANNEL",
    "DATABASE",
    "DEFAULT_ACTOR",
    "CREATED",
    "REVOKED",
    "ANSWER_HASHES_FIELD",
];

#[test]
fn every_query_constant_of_the_store_is_listed() {
    // A constant that is missing from the list would not have been prepared above.
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/store");
    let files = [folder.clone(), folder.join("verify")]
        .into_iter()
        .flat_map(|folder| std::fs::read_dir(folder).unwrap());
    for path in files
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_file())
    {
        let text = std::fs::read_to_string(path).unwrap();
        let lists: String = text
            .split("QUERIES")
            .skip(1)
            .filter_map(|rest| rest.split_once("];"))
            .map(|(list, _)| list)
            .collect();
        for line in text.lines().filter_map(|line| line.strip_prefix("const ")) {
            let (name, definition) = line.split_once(':').unwrap();
            if definition.contains("&str =") && !NO_QUERIES.contains(&name) {
                assert!(lists.contains(name), "{name} is in no list");
            }
        }
    }
}

#[test]
fn every_pooled_connection_has_the_durable_settings() {
    on_sqlite(async |database| {
        let n = database.store.readers().options().get_max_connections();
        let mut connections = Vec::new();
        for _ in 0..n {
            connections.push(database.store.readers().acquire().await.unwrap());
        }
        for connection in &mut connections {
            let journal: String = query_scalar("pragma journal_mode")
                .fetch_one(&mut **connection)
                .await
                .unwrap();
            let synchronous: i64 = query_scalar("pragma synchronous")
                .fetch_one(&mut **connection)
                .await
                .unwrap();
            let foreign_keys: i64 = query_scalar("pragma foreign_keys")
                .fetch_one(&mut **connection)
                .await
                .unwrap();
            let busy_timeout: i64 = query_scalar("pragma busy_timeout")
                .fetch_one(&mut **connection)
                .await
                .unwrap();
            assert_eq!(
                (journal.as_str(), synchronous, foreign_keys, busy_timeout),
                ("wal", 2, 1, 3000)
            );
        }
        assert_eq!(connections.len(), 8);
    });
}

#[test]
fn a_data_directory_serves_one_server_at_a_time() {
    on_sqlite(async |database| {
        let error = Store::open(database.location.clone()).await.unwrap_err();
        assert!(
            matches!(&error, Error::Open { detail } if detail.contains("in use by another kincal server")),
            "{error}"
        );
        let tool = Store::open_for_command(database.location.clone())
            .await
            .unwrap();
        assert_eq!(
            robots::search(&tool, None, &ListRequest::all())
                .await
                .unwrap()
                .items,
            []
        );
    });
}

/// Commands beside a server take the lock for a moment.
#[tokio::test]
async fn a_server_waits_for_a_lock_that_is_held_for_a_moment() {
    let directory = TempDir::new().unwrap();
    let location = StoreLocation::Sqlite {
        data_dir: directory.path().to_owned(),
    };
    let lock = std::fs::File::create(directory.path().join("lock")).unwrap();
    lock.lock().unwrap();
    // The first attempt of the server comes before the lock is given back.
    let (opened, ()) = tokio::join!(Store::open(location), async { drop(lock) });
    opened.unwrap();
}

#[test]
fn a_data_directory_is_free_again_when_its_server_is_gone_and_keeps_its_rows() {
    let directory = TempDir::new().unwrap();
    let location = StoreLocation::Sqlite {
        data_dir: directory.path().join("kept"),
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let tool = Store::open_for_command(location.clone()).await.unwrap();
        let robot = a_robot(&tool, "made by a tool before any server ran").await;
        drop(tool);
        let first = Store::open(location.clone()).await.unwrap();
        assert_eq!(robots::get(&first, &robot.id).await.unwrap(), robot);
        drop(first);
        let second = Store::open(location).await.unwrap();
        assert_eq!(robots::get(&second, &robot.id).await.unwrap(), robot);
    });
}

#[test]
fn a_file_that_is_no_database_is_said_to_be_none() {
    let directory = TempDir::new().unwrap();
    std::fs::write(directory.path().join("kincal.sqlite"), [7_u8; 9000]).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let error = runtime
        .block_on(Store::open(StoreLocation::Sqlite {
            data_dir: directory.path().to_owned(),
        }))
        .unwrap_err();
    assert!(
        matches!(&error, Error::Open { detail } if detail.contains("file is not a database")),
        "{error}"
    );
}

#[test]
fn a_server_that_opens_a_data_directory_ends_the_leases_of_the_dead_one() {
    let directory = TempDir::new().unwrap();
    let location = StoreLocation::Sqlite {
        data_dir: directory.path().to_owned(),
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let dead = Store::open(location.clone()).await.unwrap();
        let job = a_lone_job(&dead, "{}").await;
        claim(&dead, "dead", Duration::from_secs(3600))
            .await
            .unwrap();
        drop(dead);
        let store = Store::open(location.clone()).await.unwrap();
        let beside = Store::open_for_command(location).await.unwrap();
        assert_eq!(
            leases::expire(&store, 3, &Exhausted::default())
                .await
                .unwrap()
                .queued,
            std::slice::from_ref(&job.id)
        );
        let mine = claim(&store, "alive", Duration::from_secs(3600))
            .await
            .unwrap();
        // A tool does not touch the leases of a running server.
        assert!(
            jobs::get(&beside, &job.id)
                .await
                .unwrap()
                .lease_until_ms
                .unwrap()
                > store.now_ms().await.unwrap()
        );
        // The death was not the job's fault: three attempts that it ends itself are left, and no more.
        let mut lease = mine;
        for used_up in 1..=3 {
            let mut tx = store.begin().await.unwrap();
            leases::give_up(&mut tx, &lease).await.unwrap();
            tx.commit().await.unwrap();
            let expired = leases::expire(&store, 3, &Exhausted::default())
                .await
                .unwrap();
            let ended = (expired.queued.len(), expired.failed.len());
            assert_eq!(ended, if used_up < 3 { (1, 0) } else { (0, 1) });
            if used_up < 3 {
                lease = claim(&store, "alive", Duration::from_secs(3600))
                    .await
                    .unwrap();
            }
        }
    });
}

#[test]
fn opening_again_changes_nothing() {
    for_each_engine(async |database| {
        let robot = a_robot(&database.store, "r").await;
        let again = Store::open_for_command(database.location.clone())
            .await
            .unwrap();
        assert_eq!(robots::get(&again, &robot.id).await.unwrap(), robot);
        again.close().await;
    });
}

#[test]
fn a_url_of_another_kind_is_refused_with_the_reason() {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        for url in ["mysql://localhost/x", "sqlite://x", "nonsense"] {
            let error = Store::open(StoreLocation::Postgres { url: url.into() })
                .await
                .unwrap_err();
            assert!(
                matches!(&error, Error::Open { detail } if detail.contains("postgres://")),
                "{error}"
            );
        }
    });
}

#[test]
fn the_databases_clock_tells_the_time() {
    for_each_engine(async |database| {
        let now = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .unwrap()
            .as_millis() as i64;
        let difference_ms = (database.store.now_ms().await.unwrap() - now).abs();
        assert!(difference_ms < 60_000, "{difference_ms} ms apart");
        // The clock has milliseconds: of 20 readings not all end in 000.
        let mut in_between = false;
        for _ in 0..20 {
            in_between |= database.store.now_ms().await.unwrap() % 1000 != 0;
        }
        assert!(in_between);
        assert!(matches!(
            database.store.engine(),
            Engine::Sqlite | Engine::Postgres
        ));
    });
}

#[test]
fn a_copy_of_the_database_takes_every_table() {
    for_each_engine(async |database| {
        let sql = match database.store.engine() {
            Engine::Sqlite => {
                "select name from sqlite_master where type = 'table' and name not like 'sqlite%' and name not like '\\_%' escape '\\'"
            }
            Engine::Postgres => {
                "select cast(table_name as text) from information_schema.tables
                 where table_schema = current_schema() and table_type = 'BASE TABLE' and table_name not like '\\_%'"
            }
        };
        let mut found: Vec<String> = query_scalar(sql)
            .fetch_all(database.store.readers())
            .await
            .unwrap();
        let mut copied: Vec<String> = kincal::store::copy::TABLES
            .iter()
            .map(ToString::to_string)
            .collect();
        found.sort();
        copied.sort();
        assert_eq!(found, copied);
    });
}

#[test]
fn a_node_of_the_first_version_works_on_beside_todays_schema() {
    // Its statements are unchanged: a step may only add.
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let run = async |sql: &'static str, texts: &[&str]| {
            let query = texts
                .iter()
                .fold(sqlx::query(sql), |query, text| query.bind(*text));
            assert_eq!(
                query
                    .execute(store.readers())
                    .await
                    .unwrap_or_else(|e| panic!("{e}: {sql}"))
                    .rows_affected(),
                1,
                "{sql}"
            );
        };
        run(
            "insert into measurement_set (id, robot_id, name, frame, content_type, body, sha256,
                 n_points, n_configurations, n_targets, warnings_json, created_at_ms)
             select 'set_old', $1, name, frame, content_type, body, sha256,
                 n_points, n_configurations, n_targets, warnings_json, (select now_ms from clock) from measurement_set",
            &[&set.robot_id],
        )
        .await;
        run(
            "insert into job (id, robot_id, measurement_set_id, verify_set_id, frames_id, network_input_id,
                 parameter_set_input_id, kind, method, request_json, priority, status, attempt, created_at_ms)
             values ('job_old', $1, 'set_old', null, null, null, null, 'identify', 'auto', '{}', 0, 'queued', 0, (select now_ms from clock))",
            &[&set.robot_id],
        )
        .await;
        run(
            "update job set status = 'running', owner = $1, attempt = attempt + 1,
                 lease_until_ms = (select now_ms from clock) + 1000, started_at_ms = (select now_ms from clock), progress_json = null
             where status = 'queued' and id = (
                 select id from job where status = 'queued' order by priority desc, created_at_ms, id limit 1)",
            &["worker_old"],
        )
        .await;
        run(
            "update job set status = 'succeeded', report_json = '{}', convergence_json = '{}', result_sha256 = 'x',
                 lease_until_ms = null, finished_at_ms = (select now_ms from clock)
             where id = 'job_old' and owner = $1 and attempt = 1 and status = 'running'",
            &["worker_old"],
        )
        .await;
        assert!(jobs::get(store, "job_old").await.unwrap().status.is_over());
    });
}

/// Every row of every table as text, its columns by name.
async fn content(store: &Store) -> Vec<String> {
    let mut rows = Vec::new();
    for table in kincal::store::copy::TABLES {
        let columns = "select group_concat('quote(' || name || ')', '||'', ''||') from (select name from pragma_table_info($1) order by name)";
        let columns: String = query_scalar(columns)
            .bind(*table)
            .fetch_one(store.readers())
            .await
            .unwrap();
        let select = AssertSqlSafe(format!(
            "select '{table}: ' || {columns} from {table} order by 1"
        ));
        rows.append(
            &mut query_scalar(select)
                .fetch_all(store.readers())
                .await
                .unwrap(),
        );
    }
    rows
}

/// The statements of a migration that make triggers on the table of jobs.
fn triggers_on_job(sql: &str) -> Vec<String> {
    let statements = sql.split("create trigger ").skip(1);
    let whole = statements.filter_map(|text| Some(text.split_once("\nend;")?.0));
    whole
        .filter(|text| {
            text.lines()
                .next()
                .is_some_and(|line| line.ends_with(" on job"))
        })
        .map(|text| format!("create trigger {text}\nend"))
        .collect()
}

#[test]
fn a_database_whose_jobs_are_laid_out_anew_keeps_everything_in_it() {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let directory = TempDir::new().unwrap();
        let location = StoreLocation::Sqlite {
            data_dir: directory.path().to_owned(),
        };
        let url = format!(
            "sqlite://{}?mode=rwc",
            directory.path().join("kincal.sqlite").display()
        );
        let pool = SqlitePool::connect(&url).await.unwrap();
        let steps = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("migrations/sqlite");
        let steps = Migrator::new(steps).await.unwrap();
        let before = steps
            .iter()
            .filter(|step| step.version != 7)
            .cloned()
            .collect();
        Migrator::with_migrations(before).run(&pool).await.unwrap();
        pool.close().await;

        let store = Store::open_unmigrated(location.clone()).await.unwrap();
        let set = a_set(&store, &a_robot(&store, "r").await).await;
        insert_examples(&store, &set).await;
        let network: String = query_scalar("select id from network")
            .fetch_one(store.readers())
            .await
            .unwrap();
        let new = NewJob {
            network_input_id: Some(network),
            client: "key_1".into(),
            ..new_job(&set, "{}")
        };
        let job = in_transaction(&store, async |tx| jobs::insert(tx, &new, None).await).await;
        let more = "update job set turn = 7, deaths = 2 where id = $1";
        assert_eq!(
            sqlx::query(more)
                .bind(job.id)
                .execute(store.readers())
                .await
                .unwrap()
                .rows_affected(),
            1
        );
        let then = content(&store).await;
        store.close().await;

        let store = Store::open(location).await.unwrap();
        assert!(store.schema_version().await.unwrap() >= 7);
        let now = content(&store).await;
        assert!(then.len() > 40, "{}", then.len());
        assert_eq!(then, now);
        // Here step 7 ran after the later ones, whose triggers on the table went with the old one.
        for step in steps.iter().filter(|step| step.version > 7) {
            for trigger in triggers_on_job(step.sql.as_str()) {
                sqlx::query(AssertSqlSafe(trigger))
                    .execute(store.readers())
                    .await
                    .unwrap();
            }
        }
        assert_eq!(broken(&store).await, [""; 0]);
        // References to jobs are intact.
        let refused = sqlx::query("delete from job where status = 'succeeded'")
            .execute(store.readers())
            .await;
        assert!(refused.unwrap_err().to_string().contains("FOREIGN KEY"));
        // A job's row begins with its short columns.
        let columns = "select name from pragma_table_info('job') order by cid desc limit 4";
        let last: Vec<String> = query_scalar(columns)
            .fetch_all(store.readers())
            .await
            .unwrap();
        assert_eq!(
            last,
            [
                "report_json",
                "convergence_json",
                "error_json",
                "progress_json"
            ]
        );
        store.close().await;
    });
}
