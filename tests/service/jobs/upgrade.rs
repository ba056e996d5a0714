//! Upgrade of a database from commit d61237a, with a clock that was 30 days ahead and a tracker's file read as base frame: `data/d61237a.json`.

use kincal::jobs::backfill::backfill_missing;
use kincal::store::named_documents::{NamedDocumentKind, NewNamedDocument};
use kincal::store::verify::{Options, verify};
use kincal::store::{
    Archivable, CheckedState, Conflict, Engine, Error, ListRequest, Release, RobotEdit, Store,
    StoreLocation, archive, jobs, named_documents, parameter_sets, report_summaries,
    robot_versions, robots, verifications,
};
use kincal::wire::page::ArchivedFilter;
use kincal::wire::report_shape::Evidence;
use kincal::wire::report_summary::ReportSummary;
use kincal::wire::verification::Fit;
use serde_json::Value;
use sqlx::migrate::Migrator;
use sqlx::{AnyPool, AssertSqlSafe};
use std::path::Path;

use crate::engines::{TestDatabase, for_each_engine};
use crate::fixtures::in_transaction;

const MADE: &str = include_str!("../../data/d61237a.json");
/// Schema version of that commit.
const VERSION: i64 = 7;
/// Tables, each after those that it refers to.
const TABLES: [&str; 6] = [
    "robot",
    "measurement_set",
    "job",
    "parameter_set",
    "audit",
    "audit_head",
];
/// Columns with references to rows that are inserted later.
const LATER: &str = "parameter_set_input_id";

/// Migrates to a version of the schema.
async fn migrate(engine: Engine, pool: &AnyPool, version: i64) {
    let folder = match engine {
        Engine::Sqlite => "migrations/sqlite",
        Engine::Postgres => "migrations/postgres",
    };
    let steps = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let steps = Migrator::new(steps).await.unwrap();
    let until = steps.iter().filter(|step| step.version <= version);
    let until = Migrator::with_migrations(until.cloned().collect());
    until.run(pool).await.unwrap();
}

/// Creates the schema of that commit and inserts its rows.
async fn create_old_database(engine: Engine, url: &str, made: &Value) {
    let pool = AnyPool::connect(url).await.unwrap();
    migrate(engine, &pool, VERSION).await;
    sqlx::query("delete from audit_head")
        .execute(&pool)
        .await
        .unwrap();
    let mut later = Vec::new();
    for table in TABLES {
        for row in made["tables"][table].as_array().unwrap() {
            let row = row.as_object().unwrap();
            if let Some(input) = row.get(LATER) {
                later.push((row["id"].clone(), input.clone()));
            }
            let columns: Vec<&str> = row.keys().map(String::as_str).collect();
            let columns: Vec<&str> = columns.into_iter().filter(|c| *c != LATER).collect();
            let places: Vec<String> = (1..=columns.len()).map(|n| format!("${n}")).collect();
            let (names, places) = (columns.join(", "), places.join(", "));
            let sql = format!("insert into {table} ({names}) values ({places})");
            let mut query = sqlx::query(AssertSqlSafe(sql));
            for column in columns {
                let value = &row[column];
                query = match value {
                    Value::String(text) if column == "body" => query.bind(text.as_bytes().to_vec()),
                    Value::String(text) => query.bind(text.clone()),
                    Value::Number(number) if number.is_i64() => query.bind(number.as_i64()),
                    other => query.bind(other.as_f64()),
                };
            }
            query.execute(&pool).await.unwrap();
        }
    }
    for (id, input) in later {
        sqlx::query("update job set parameter_set_input_id = $2 where id = $1")
            .bind(id.as_str().unwrap().to_owned())
            .bind(input.as_str().unwrap().to_owned())
            .execute(&pool)
            .await
            .unwrap();
    }
    pool.close().await;
}

/// Compares each summary with its report without lists over points, removed here by hand. Returns the number of succeeded jobs.
async fn n_summaries_like_their_reports(store: &Store) -> usize {
    let rows: Vec<(String, String, String)> = sqlx::query_as(
        "select j.id, j.report_json, s.summary_json from job j left join report_summary s on s.job_id = j.id where j.status = 'succeeded'",
    )
    .fetch_all(store.readers())
    .await
    .unwrap();
    for (id, report, summary) in &rows {
        let mut expected: Value = serde_json::from_str(report).unwrap();
        assert!(expected["per_point"].as_array().unwrap().len() > 1, "{id}");
        expected.as_object_mut().unwrap().remove("per_point");
        for warning in expected["warnings"].as_array_mut().unwrap() {
            warning.as_object_mut().unwrap().remove("rows");
        }
        if let Some(repeatability) = expected.get_mut("repeatability") {
            repeatability.as_object_mut().unwrap().remove("poses");
        }
        let found: Value = serde_json::from_str(summary).unwrap();
        assert_eq!(found, expected, "{id}");
        // A job that a node of the older version ends now is read from its report.
        let [of_summary, of_report] = [summary, report].map(|text| {
            let mut read: ReportSummary = serde_json::from_str(text).unwrap();
            read.warnings
                .iter_mut()
                .for_each(|warning| warning.rows.clear());
            read
        });
        assert_eq!(of_summary, of_report, "{id}");
        assert_eq!(&report_summaries::of_job(store, id).await.unwrap(), summary);
    }
    rows.len()
}

/// A database of that commit, separate from the test's, which has the current version.
async fn old_database(database: &TestDatabase, made: &Value) -> (StoreLocation, String) {
    let engine = database.store.engine();
    let (location, url) = match &database.location {
        StoreLocation::Sqlite { data_dir } => {
            let data_dir = data_dir.parent().unwrap().join("of_d61237a");
            std::fs::create_dir(&data_dir).unwrap();
            let url = format!("sqlite://{}/kincal.sqlite?mode=rwc", data_dir.display());
            (StoreLocation::Sqlite { data_dir }, url)
        }
        StoreLocation::Postgres { url } => {
            let sql = "drop schema public cascade; create schema public";
            sqlx::raw_sql(sql)
                .execute(database.store.readers())
                .await
                .unwrap();
            (StoreLocation::Postgres { url: url.clone() }, url.clone())
        }
    };
    create_old_database(engine, &url, made).await;
    (location, url)
}

#[test]
fn a_database_of_d61237a_gets_its_facts_as_columns_once() {
    let made: Value = serde_json::from_str(MADE).unwrap();
    let id = |scene: &str, name: &str| made["scenes"][scene][name].as_str().unwrap().to_owned();
    for_each_engine(async |database| {
        let (location, _) = old_database(database, &made).await;
        let store = Store::open(location).await.unwrap();
        assert!(store.schema_version().await.unwrap() > VERSION);
        backfill_missing(&store).await.unwrap();
        assert!(
            verifications::jobs_without_facts(&store)
                .await
                .unwrap()
                .is_empty()
        );

        assert!(n_summaries_like_their_reports(&store).await > 5);

        // C superseded B, though A was released at a later time.
        let [a, b, c] =
            std::array::from_fn(|i| made["scenes"]["clock"]["a_b_c"][i].as_str().unwrap());
        let superseded =
            async |id: &str| parameter_sets::get(&store, id).await.unwrap().supersedes_id;
        assert_eq!(superseded(c).await.as_deref(), Some(b));
        assert_eq!(superseded(b).await.as_deref(), Some(a));
        assert_eq!(superseded(a).await, None);
        let before = parameter_sets::before_active(&store, &id("clock", "robot_id")).await;
        assert_eq!(before.unwrap().id, b);

        // The copy with noise is not another session, and the tracker's file is no evidence: the robot is in the state `check_robot`.
        let rows = verifications::of_set(&store, &id("frames", "parameter_set_id"))
            .await
            .unwrap();
        let found: Vec<_> = rows
            .iter()
            .map(|row| (row.found.fit, row.found.evidence))
            .collect();
        assert_eq!(
            found,
            [
                (Fit::Fits, Evidence::SameUpload),
                (Fit::Fits, Evidence::SameUpload),
                (Fit::DoesNotFit, Evidence::None)
            ]
        );
        let first = &rows[0].found;
        assert!(first.uncertainty_mm.is_some() && first.after_rms_mm < first.before_rms_mm);
        let robot = robots::get(&store, &id("frames", "robot_id"))
            .await
            .unwrap();
        assert_eq!(robot.check_job_id, Some(id("frames", "wrong_frame_job_id")));
        for check in verify(&store, &Options::default()).await.unwrap() {
            assert_eq!(check.violations, [""; 0], "{}", check.id);
        }

        // The set is not condemned: after somebody has given a reason, the schema allows its release.
        let checked = in_transaction(&store, async |tx| {
            robots::checked(tx, &robot.id, "a tracker's file", "key_1").await
        })
        .await;
        let set = id("frames", "parameter_set_id");
        let n_verifications = verifications::count(&store, &set).await.unwrap();
        let release = Release {
            id: set,
            checked: CheckedState {
                n_verifications,
                robot: checked.check(),
                ..CheckedState::default()
            },
            reason: "it fits".into(),
            checks_json: r#"[{"gate":"x","passed":true}]"#.into(),
            n_passed: 1,
            n_failed: 0,
            released_by: "key_1".into(),
            evidence: Evidence::SameUpload,
            uncertainty_mm: None,
        };
        in_transaction(&store, async |tx| {
            parameter_sets::release(tx, &release).await
        })
        .await;
        store.close().await;
    });
}

#[test]
fn robots_and_results_of_d61237a_are_edited_and_archived_as_new_ones_are() {
    let made: Value = serde_json::from_str(MADE).unwrap();
    let id = |scene: &str, name: &str| made["scenes"][scene][name].as_str().unwrap().to_owned();
    let released = made["scenes"]["clock"]["a_b_c"][2].as_str().unwrap();
    for_each_engine(async |database| {
        let (location, _) = old_database(database, &made).await;
        let store = Store::open(location).await.unwrap();
        backfill_missing(&store).await.unwrap();
        let robot = robots::get(&store, &id("clock", "robot_id")).await.unwrap();
        assert_eq!((robot.version, robot.joint_map_version), (1, 1));
        let edit = |changes_joint_map| RobotEdit {
            edited_version: 1,
            name: "mended".into(),
            body_json: robot.body_json.replace(&robot.name, "mended"),
            changes_joint_map,
            changed: vec!["name"],
        };
        // Sets of this robot were released before there were edits.
        let mut tx = store.begin().await.unwrap();
        let refused = robot_versions::edit(&mut tx, &robot.id, &edit(true), "key_1").await;
        assert!(
            matches!(refused, Err(Error::Conflict(Conflict::JointMapReleased))),
            "{refused:?}"
        );
        tx.rollback().await.unwrap();
        let edited = in_transaction(&store, async |tx| {
            robot_versions::edit(tx, &robot.id, &edit(false), "key_1").await
        })
        .await;
        assert_eq!((edited.name.as_str(), edited.version), ("mended", 2));

        let mut tx = store.begin().await.unwrap();
        let kind = Archivable::ParameterSet;
        let refused = archive::archive(&mut tx, kind, released, &robot.id, "key_1").await;
        assert!(
            matches!(
                refused,
                Err(Error::Conflict(Conflict::NotArchivable { .. }))
            ),
            "{refused:?}"
        );
        tx.rollback().await.unwrap();
        let all = ListRequest {
            archived: ArchivedFilter::False,
            ..ListRequest::all()
        };
        let before = jobs::search(&store, &robot.id, &all).await.unwrap();
        let job = &before.items[0];
        assert_eq!((job.robot_version, job.archived_at_ms), (1, None));
        in_transaction(&store, async |tx| {
            archive::archive(tx, Archivable::Job, &job.id, &robot.id, "key_1").await
        })
        .await;
        let after = jobs::search(&store, &robot.id, &all).await.unwrap();
        assert_eq!(after.total, before.total - 1);
        let everywhere = jobs::search_all(&store, None, &all).await.unwrap();
        assert!(everywhere.total > after.total);
        for check in verify(&store, &Options::default()).await.unwrap() {
            assert_eq!(check.violations, [""; 0], "{}", check.id);
        }
        store.close().await;
    });
}

/// Mappings of columns were in a table of their own until version 18, the newest by its id. Since then a counter says which document is in force:
/// ids ascend with the clock, and clocks are set back.
#[test]
fn mappings_of_columns_keep_their_order_and_what_is_stored_next_is_in_force_whatever_the_clock_says()
 {
    let made: Value = serde_json::from_str(MADE).unwrap();
    for_each_engine(async |database| {
        let (location, url) = old_database(database, &made).await;
        let pool = AnyPool::connect(&url).await.unwrap();
        migrate(database.store.engine(), &pool, 18).await;
        let robot = made["scenes"]["clock"]["robot_id"].as_str().unwrap();
        // in the year 2096, the second in the year 2097
        for (id, name, json) in [
            ("col_03a1", "export", "{\"first\": 1}"),
            ("col_03a8", "export", "{\"second\": 1}"),
            ("col_03a2", "other", "{}"),
        ] {
            let sql = "insert into column_mapping (id, robot_id, name, columns_json, created_by, created_at_ms) values ($1, $2, $3, $4, 'key_1', 0)";
            sqlx::query(sql)
                .bind(id)
                .bind(robot.to_owned())
                .bind(name)
                .bind(json)
                .execute(&pool)
                .await
                .unwrap();
        }
        pool.close().await;
        let store = Store::open(location).await.unwrap();
        let newest = async |kind| {
            let row = named_documents::newest(&store, robot, kind, "export").await;
            row.map(|row| (row.version, row.content_json)).unwrap()
        };
        let columns = NamedDocumentKind::Columns;
        assert_eq!(newest(columns).await, (2, "{\"second\": 1}".into()));
        // now, which is earlier than both
        for kind in [columns, NamedDocumentKind::WorkFrame] {
            in_transaction(&store, async |tx| {
                tx.act_as("key_1");
                let new = NewNamedDocument {
                    robot_id: robot,
                    kind,
                    name: "export",
                    content_json: "{\"third\": 1}",
                    by: "key_1",
                };
                named_documents::insert(tx, new).await
            })
            .await;
        }
        assert_eq!(newest(columns).await, (3, "{\"third\": 1}".into()));
        assert_eq!(newest(NamedDocumentKind::WorkFrame).await.0, 1);
        let all = ListRequest::all();
        let listed = named_documents::list(&store, robot, columns, &all).await;
        let listed = listed.unwrap();
        let of_names = listed.items.iter().map(|row| (&*row.name, row.version));
        assert_eq!(of_names.collect::<Vec<_>>(), [("export", 3), ("other", 1)]);
        assert_eq!(listed.total, 2);
        for check in verify(&store, &Options::default()).await.unwrap() {
            assert_eq!(check.violations, [""; 0], "{}", check.id);
        }
        store.close().await;
    });
}
