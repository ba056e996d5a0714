//! Beside sqlx's own driver: the same rows, numbers and errors.

use super::{Connection, Pool};
use crate::store::connection::Connection as On;
use crate::store::{Store, StoreLocation};
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, Row};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_millis(300);

/// A database with one table, opened by sqlx and here.
async fn both(directory: &tempfile::TempDir) -> (Store, Pool, AnyConnection, Connection) {
    let store = Store::open(StoreLocation::Sqlite {
        data_dir: directory.path().to_owned(),
    })
    .await
    .unwrap();
    let mut sqlx = store.pool().acquire().await.unwrap().detach();
    for sql in [
        "create table parent (id integer primary key)",
        "create table t (id integer primary key, name text not null unique, parent bigint references parent (id), check (name <> 'bad'))",
        "create trigger refuse before delete on t begin select raise(abort, 'not this one'); end",
        "insert into t (name) values ('there')",
    ] {
        sqlx::query(sql).execute(&mut sqlx).await.unwrap();
    }
    let pool = Pool::new(
        directory.path().join(crate::store::open::DATABASE),
        crate::store::open::SQLITE_PRAGMAS,
        PATIENCE,
        2,
    );
    let here = pool.connect().unwrap();
    (store, pool, sqlx, here)
}

fn columns(row: &AnyRow) -> Vec<String> {
    let integers = ["big", "small"].map(|name| format!("{:?}", row.try_get::<i64, _>(name)));
    let texts = ["word", "empty", "nul", "first", "again"]
        .map(|name| format!("{:?}", row.try_get::<String, _>(name)));
    let blobs = ["bytes", "no_bytes"].map(|name| format!("{:?}", row.try_get::<Vec<u8>, _>(name)));
    let absent = [
        format!("{:?}", row.try_get::<Option<i64>, _>("absent")),
        format!("{:?}", row.try_get::<Option<String>, _>("third")),
    ];
    let real = format!("{:?}", row.try_get::<f64, _>("real"));
    let wrong = [
        format!("{:?}", row.try_get::<i64, _>("no such").is_err()),
        format!("{:?}", row.try_get::<i64, _>("word").is_err()),
    ];
    [
        integers.as_slice(),
        &texts,
        &blobs,
        &absent,
        &[real],
        &wrong,
    ]
    .concat()
}

#[tokio::test(flavor = "multi_thread")]
async fn rows_and_what_was_changed_are_as_by_sqlx() {
    let directory = tempfile::tempdir().unwrap();
    let (_store, _pool, mut sqlx, mut here) = both(&directory).await;
    let sql = "select 9223372036854775807 as big, $2 as small, 'a ß 中' as word, '' as empty, 'a' || char(0) || 'b' as nul, $1 as first,
               x'00ff' as bytes, x'' as no_bytes, null as absent, 1.5 as real, $3 as third, $1 as again";
    let query = || sqlx::query(sql).bind("one").bind(-2_i64).bind(None::<&str>);
    let theirs = query().fetch_one(&mut sqlx).await.unwrap();
    let ours = query().fetch_one(On::sqlite(&mut here)).await.unwrap();
    assert_eq!(columns(&ours), columns(&theirs));
    assert_eq!(ours.columns().len(), theirs.columns().len());

    for (sql, expected) in [
        ("insert into t (name) values ('a'), ('b'), ('c')", 3),
        (
            "insert into t (name) values ('a') on conflict do nothing",
            0,
        ),
        ("update t set parent = null where name in ('a', 'b')", 2),
        ("update t set parent = null where name = 'nobody'", 0),
    ] {
        assert_eq!(
            sqlx::query(sql)
                .execute(On::sqlite(&mut here))
                .await
                .unwrap()
                .rows_affected(),
            expected,
            "{sql}"
        );
    }
    // of the rows that it returns one is asked for; all are there
    let first: Option<i64> =
        sqlx::query_scalar("insert into t (name) values ('d'), ('e'), ('f') returning id")
            .fetch_optional(On::sqlite(&mut here))
            .await
            .unwrap();
    let n: i64 = sqlx::query_scalar("select count(*) from t")
        .fetch_one(&mut sqlx)
        .await
        .unwrap();
    assert_eq!((first, n), (Some(5), 7));
    let none: Option<i64> = sqlx::query_scalar("select id from t where id < 0")
        .fetch_optional(On::sqlite(&mut here))
        .await
        .unwrap();
    assert_eq!(none, None);
    let names: Vec<String> = sqlx::query_scalar("select name from t order by id")
        .fetch_all(On::sqlite(&mut here))
        .await
        .unwrap();
    assert_eq!(names, ["there", "a", "b", "c", "d", "e", "f"]);
}

#[tokio::test]
async fn errors_are_as_by_sqlx() {
    let directory = tempfile::tempdir().unwrap();
    let (_store, _pool, mut sqlx, mut here) = both(&directory).await;
    for (sql, code) in [
        ("insert into t (name) values ('there')", "2067"),
        ("insert into t (id, name) values (1, 'x')", "1555"),
        ("insert into t (name, parent) values ('x', 77)", "787"),
        ("insert into t (name) values (null)", "1299"),
        ("insert into t (name) values ('bad')", "275"),
        ("delete from t", "1811"),
        ("select nothing from t", "1"),
        ("no sql", "1"),
    ] {
        let theirs = sqlx::query(sql).execute(&mut sqlx).await.unwrap_err();
        let ours = sqlx::query(sql)
            .execute(On::sqlite(&mut here))
            .await
            .unwrap_err();
        assert_eq!(ours.to_string(), theirs.to_string());
        let [ours, theirs] = [&ours, &theirs].map(|error| error.as_database_error().unwrap());
        assert_eq!(
            (ours.code(), ours.kind(), ours.message()),
            (theirs.code(), theirs.kind(), theirs.message()),
            "{sql}"
        );
        assert_eq!(ours.code().as_deref(), Some(code), "{sql}");
    }
}

#[tokio::test]
async fn each_connection_is_durable() {
    let directory = tempfile::tempdir().unwrap();
    let (_store, _pool, _sqlx, mut here) = both(&directory).await;
    for (sql, expected) in [
        ("pragma synchronous", 2_i64),
        ("pragma foreign_keys", 1),
        ("pragma busy_timeout", 5000),
    ] {
        let value: i64 = sqlx::query_scalar(sql)
            .fetch_one(On::sqlite(&mut here))
            .await
            .unwrap();
        assert_eq!(value, expected, "{sql}");
    }
    let journal: String = sqlx::query_scalar("pragma journal_mode")
        .fetch_one(On::sqlite(&mut here))
        .await
        .unwrap();
    assert_eq!(journal, "wal");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_lock_that_others_hold_is_waited_for_and_holds_nobody_up() {
    let directory = tempfile::tempdir().unwrap();
    let (_store, _pool, mut sqlx, mut here) = both(&directory).await;
    sqlx::query("begin immediate")
        .execute(&mut sqlx)
        .await
        .unwrap();
    let begun = Instant::now();
    let refused = tokio::spawn(async move { (here.begin_to_write(PATIENCE).unwrap_err(), here) });
    // the one thread of this runtime does other things meanwhile
    tokio::time::sleep(PATIENCE / 10).await;
    tokio::spawn(async {}).await.unwrap();
    assert!(begun.elapsed() < PATIENCE && !refused.is_finished());
    let (error, mut here) = refused.await.unwrap();
    assert_eq!(
        error.as_database_error().unwrap().code().as_deref(),
        Some("5")
    );
    assert!(begun.elapsed() >= PATIENCE);

    let waits = tokio::spawn(async move { here.begin_to_write(Duration::from_secs(20)) });
    tokio::time::sleep(PATIENCE / 10).await;
    sqlx::query("rollback").execute(&mut sqlx).await.unwrap();
    waits.await.unwrap().unwrap();
}
