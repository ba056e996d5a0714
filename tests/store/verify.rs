//! `verify` finds what it should, and nothing in a healthy database.

use kincal::store::verify::{Options, verify};
use kincal::store::{Engine, NewFrames, Store, frames};
use sqlx::AssertSqlSafe;

use crate::engines::for_each_engine;
use crate::fixtures::{a_candidate, a_job, a_robot, a_set, in_transaction};

async fn broken(store: &Store) -> Vec<&'static str> {
    let checks = verify(store, &Options { is_served: true, ..Options::default() }).await.unwrap();
    assert_eq!(checks.iter().map(|check| check.id).collect::<Vec<_>>(), ["I1", "I2", "I3", "I4", "I5", "I6", "I7", "I8", "I9"]);
    checks.into_iter().filter(|check| check.n_violations > 0).map(|check| check.id).collect()
}

#[test]
fn a_healthy_database_keeps_every_promise() {
    for_each_engine(async |database| {
        let store = &database.store;
        assert_eq!(broken(store).await, [""; 0]);
        let set = a_set(store, &a_robot(store, "r").await).await;
        a_job(store, &set, "{}").await;
        let new = NewFrames { robot_id: set.robot_id.clone(), content_type: "text/csv".into(), body: vec![0], result_json: "{}".into() };
        in_transaction(store, async |tx| frames::insert(tx, &new).await).await;
        assert_eq!(broken(store).await, [""; 0]);
    });
}

/// What breaks, and which checks have to tell.
const FAULTS: &[(&str, &[&str])] = &[
    ("drop trigger measurement_set_stays; update measurement_set set body = x'00'", &["I1", "I9"]),
    ("drop trigger robot_stays; update robot set body_json = '[]'", &["I1", "I9"]),
    ("delete from parameter_set; delete from job", &["I1"]),
    (
        "insert into idempotency (key_holder, method, path, idempotency_key, request_sha256, created_at_ms) values ('k', 'POST', '/', 'a', 's', 1)",
        &["I2"],
    ),
    (
        "insert into idempotency (key_holder, method, path, idempotency_key, request_sha256, created_at_ms, status, location)
         values ('k', 'POST', '/', 'a', 's', 1, 201, '/v1/measurement-sets/set_0')",
        &["I2"],
    ),
    ("update job set status = 'cancelled', finished_at_ms = 1 where status = 'queued'", &["I3"]),
    ("update job set status = 'running', owner = 'gone', lease_until_ms = 1", &["I3"]),
    ("drop index parameter_set_one_released", &["I9"]),
    (
        "drop trigger parameter_set_checks; update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[]'",
        &["I7", "I9"],
    ),
    (
        "drop trigger parameter_set_checks; update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[{\"passed\":false}]'",
        &["I7", "I9"],
    ),
    (
        "update parameter_set set status = 'released', released_at_ms = (select now_ms + 1000 from clock), release_checks_json = '[{\"passed\":true}]'",
        &["I7"],
    ),
    ("drop trigger audit_entry_is_kept; delete from audit where event = 'robot_created'", &["I8", "I9"]),
];

#[test]
fn each_fault_is_told_by_its_check() {
    for (faults, expected) in FAULTS {
        for_each_engine(async |database| {
            let store = &database.store;
            let set = a_set(store, &a_robot(store, "r").await).await;
            a_candidate(store, &set).await;
            for fault in faults.split("; ") {
                sqlx::query(AssertSqlSafe(in_the_words_of(store.engine(), fault))).execute(store.pool()).await.unwrap();
            }
            let found = broken(store).await;
            assert!(expected.iter().all(|id| found.contains(id)), "{faults}: told by {found:?}");
        });
    }
}

/// PostgreSQL names the table of a trigger, and writes bytes in another way.
fn in_the_words_of(engine: Engine, sql: &str) -> String {
    if engine == Engine::Sqlite {
        return sql.to_owned();
    }
    match sql.strip_prefix("drop trigger ") {
        Some(name) => {
            let table = ["measurement_set", "robot", "parameter_set", "audit"].into_iter().find(|table| name.starts_with(table));
            format!("drop trigger {name} on {}", table.unwrap())
        }
        None => sql.replace("x'00'", "'\\x00'"),
    }
}
