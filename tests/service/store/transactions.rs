//! Transactions: a writer that commits, fails or is dropped does not affect others.

use std::time::Duration;

use kincal::store::archive::{self, Archivable};
use kincal::store::named_documents::{self, NamedDocumentKind, NewNamedDocument};
use kincal::store::robot_versions::{self, RobotEdit};
use kincal::store::stuck::stuck_writers;
use kincal::store::{Conflict, Error, ListRequest, NewRobot, Store, Tx, audit, policies, robots};
use kincal::wire::policy::PolicyBody;
use sqlx::{Connection, Executor};

use crate::engines::{for_each_engine, on_sqlite};
use crate::fixtures::{a_robot, in_transaction};

async fn insert(tx: &mut Tx, name: &str) {
    robots::insert(
        tx,
        &NewRobot {
            name: name.into(),
            body_json: "{}".into(),
        },
    )
    .await
    .unwrap();
}

async fn names(store: &Store) -> Vec<String> {
    let mut names: Vec<String> = robots::search(store, None, &ListRequest::all())
        .await
        .unwrap()
        .items
        .into_iter()
        .map(|robot| robot.name)
        .collect();
    names.sort();
    names
}

/// Runs a writer of each kind, all waiting behind `first`; returns the result of each.
async fn run_behind(store: &Store, first: Tx) -> (Result<(), Error>, Vec<Result<(), Error>>) {
    let writers: Vec<_> = (0..9)
        .map(|i| {
            let store = store.clone();
            tokio::spawn(async move {
                let mut tx = store.begin().await?;
                insert(&mut tx, &format!("{i}")).await;
                match i % 3 {
                    0 => tx.commit().await,
                    1 => tx.rollback().await,
                    _ => {
                        drop(tx);
                        Ok(())
                    }
                }
            })
        })
        .collect();
    let first = first.commit().await;
    let mut results = Vec::new();
    for writer in writers {
        results.push(writer.await.unwrap());
    }
    (first, results)
}

#[test]
fn a_writer_that_rolls_back_or_goes_away_takes_no_other_with_it() {
    for_each_engine(async |database| {
        let store = &database.store;
        let mut first = store.begin().await.unwrap();
        insert(&mut first, "first").await;
        let (first, results) = run_behind(store, first).await;
        first.unwrap();
        results.into_iter().for_each(|result| result.unwrap());
        assert_eq!(names(store).await, ["0", "3", "6", "first"]);
        a_robot(store, "later").await;
        assert_eq!(names(store).await.len(), 5);
    });
}

#[test]
fn readers_see_nothing_of_a_transaction_before_its_commit() {
    for_each_engine(async |database| {
        let store = &database.store;
        let mut tx = store.begin().await.unwrap();
        insert(&mut tx, "r").await;
        assert_eq!(names(store).await, [""; 0]);
        tx.commit().await.unwrap();
        assert_eq!(names(store).await, ["r"]);
    });
}

#[test]
fn a_transaction_that_the_engine_gives_up_fails_and_harms_nobody_after() {
    on_sqlite(async |database| {
        let store = &database.store;
        // A constraint with `on conflict rollback` ends the whole transaction, as a full disk does.
        let mut connection = sqlx::AnyConnection::connect(&url(database)).await.unwrap();
        for statement in [
            "create table strict (n bigint unique on conflict rollback)",
            "insert into strict values (1)",
            "create trigger fails_on_a_row after insert on robot when new.name = 'bad row'
             begin insert into strict values (1); end",
            "create trigger fails_on_an_entry after insert on audit when (select name from robot where id = new.subject) = 'bad entry'
             begin insert into strict values (1); end",
        ] {
            connection.execute(statement).await.unwrap();
        }
        let before = audit::head(store).await.unwrap().seq;
        for name in ["bad row", "bad entry"] {
            let written = async {
                let mut tx = store.begin().await?;
                let new = |name: &str| NewRobot {
                    name: name.into(),
                    body_json: "{}".into(),
                };
                robots::insert(&mut tx, &new("earlier in the same transaction")).await?;
                robots::insert(&mut tx, &new(name)).await?;
                tx.commit().await
            };
            assert!(written.await.is_err(), "{name}");
            assert_eq!(names(store).await, [""; 0], "{name}");
        }
        let entries = audit::list(store, before, 100).await.unwrap();
        assert_eq!(entries.len(), 0, "{entries:?}");
        a_robot(store, "after").await;
        assert_eq!(names(store).await, ["after"]);
    });
}

#[test]
fn a_writer_that_gives_up_waiting_keeps_nobody_from_an_answer() {
    for_each_engine(async |database| {
        let store = &database.store;
        for i in 0..20 {
            let mut first = store.begin().await.unwrap();
            insert(&mut first, &format!("{i}")).await;
            let begin = || {
                let store = store.clone();
                tokio::spawn(async move { store.begin().await.unwrap() })
            };
            let [impatient, second] = [begin(), begin()];
            tokio::task::yield_now().await;
            let first = tokio::spawn(first.commit());
            impatient.abort();
            drop(impatient.await);
            drop(second.await);
            tokio::time::timeout(Duration::from_secs(20), first)
                .await
                .expect("it is answered")
                .unwrap()
                .unwrap();
        }
        assert_eq!(names(store).await.len(), 20);
    });
}

fn url(database: &crate::engines::TestDatabase) -> String {
    let kincal::store::StoreLocation::Sqlite { data_dir } = &database.location else {
        unreachable!()
    };
    format!(
        "sqlite://{}/kincal.sqlite",
        data_dir
            .to_str()
            .unwrap()
            .replace('%', "%25")
            .replace(' ', "%20")
    )
}

#[test]
fn a_client_that_goes_away_at_any_moment_leaves_no_transaction_open() {
    for_each_engine(async |database| {
        let store = &database.store;
        for polls in 0..60 {
            let mut write = Box::pin(async {
                let mut tx = store.begin().await.unwrap();
                insert(&mut tx, "cut off").await;
                tx.commit().await.unwrap();
            });
            for _ in 0..polls {
                if poll_once(&mut write).await {
                    break;
                }
            }
            drop(write);
        }
        tokio::time::timeout(Duration::from_secs(20), a_robot(store, "after"))
            .await
            .expect("the writer is free");
        let checks = kincal::store::verify::verify(store, &Default::default())
            .await
            .unwrap();
        assert!(
            checks.iter().all(|check| check.n_violations == 0),
            "{checks:?}"
        );
    });
}

/// Polls once, then yields. True if the future is ready.
async fn poll_once(future: &mut (impl Future<Output = ()> + Unpin)) -> bool {
    let done = std::future::poll_fn(|context| {
        std::task::Poll::Ready(std::pin::Pin::new(&mut *future).poll(context).is_ready())
    })
    .await;
    tokio::task::yield_now().await;
    done
}

/// A request may look at the robot before another archives it, and write after.
#[test]
fn nothing_is_written_of_a_robot_that_was_archived_in_the_meantime() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        in_transaction(store, async |tx| {
            archive::archive(tx, Archivable::Robot, &robot.id, &robot.id, "key_1").await
        })
        .await;
        let mut tx = store.begin().await.unwrap();
        let policy = PolicyBody::default();
        let of_policy = policies::put(&mut tx, &robot.id, &policy, "key_1").await;
        let tool = NewNamedDocument {
            robot_id: &robot.id,
            kind: NamedDocumentKind::Tool,
            name: "gripper",
            content_json: "{}",
            by: "key_1",
        };
        let of_tool = named_documents::insert(&mut tx, tool).await;
        let edit = RobotEdit {
            edited_version: 1,
            name: "edited".into(),
            body_json: "{}".into(),
            changes_joint_map: false,
            changed: vec!["name"],
        };
        let of_edit = robot_versions::edit(&mut tx, &robot.id, &edit, "key_1").await;
        tx.rollback().await.unwrap();
        for refused in [of_policy.err(), of_tool.err(), of_edit.err()] {
            assert!(
                matches!(refused, Some(Error::Conflict(Conflict::RobotArchived))),
                "{refused:?}"
            );
        }
    });
}

#[test]
fn after_a_write_that_was_not_committed_a_trial_shows_that_writes_succeed() {
    on_sqlite(async |database| {
        let store = &database.store;
        let mut tx = store.begin().await.unwrap();
        insert(&mut tx, "given up").await;
        drop(tx);
        // On a busy machine the trial takes longer than its caller waits.
        while stuck_writers(store).await.unwrap().is_some() {
            tokio::task::yield_now().await;
        }
        assert_eq!(names(store).await, [""; 0]);
    });
}
