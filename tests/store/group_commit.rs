//! Writers that share a commit on SQLite: each for itself, all answered after it.

use std::time::Duration;

use kincal::store::{Error, NewRobot, PageRequest, Store, Tx, audit, robots};
use sqlx::{Connection, Executor};

use crate::engines::{for_each_engine, on_sqlite};
use crate::fixtures::a_robot;

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
    let mut names: Vec<String> = robots::list(store, None, &PageRequest::default())
        .await
        .unwrap()
        .items
        .into_iter()
        .map(|robot| robot.name)
        .collect();
    names.sort();
    names
}

/// A writer of each kind, all waiting behind `first`; what each of them heard.
async fn behind(store: &Store, first: Tx) -> (Result<(), Error>, Vec<Result<(), Error>>) {
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
    let mut heard = Vec::new();
    for writer in writers {
        heard.push(writer.await.unwrap());
    }
    (first, heard)
}

#[test]
fn a_writer_that_rolls_back_or_goes_away_takes_no_other_with_it() {
    for_each_engine(async |database| {
        let store = &database.store;
        let mut first = store.begin().await.unwrap();
        insert(&mut first, "first").await;
        let (first, heard) = behind(store, first).await;
        first.unwrap();
        heard.into_iter().for_each(|result| result.unwrap());
        assert_eq!(names(store).await, ["0", "3", "6", "first"]);
        a_robot(store, "later").await;
        assert_eq!(names(store).await.len(), 5);
    });
}

#[test]
fn what_a_writer_sees_of_its_group_is_kept_from_readers_until_the_commit() {
    on_sqlite(async |database| {
        let store = &database.store;
        let mut tx = store.begin().await.unwrap();
        insert(&mut tx, "r").await;
        assert_eq!(names(store).await, [""; 0]);
        tx.commit().await.unwrap();
        assert_eq!(names(store).await, ["r"]);
    });
}

#[test]
fn an_engine_that_gives_up_the_transaction_fails_everybody_in_it_and_nobody_after() {
    on_sqlite(async |database| {
        let store = &database.store;
        let mut first = store.begin().await.unwrap();
        insert(&mut first, "first").await;
        // A constraint with `on conflict rollback` gives up the whole transaction, as a full disk does.
        let mut saboteur = sqlx::AnyConnection::connect(&url(database)).await.unwrap();
        first.rollback().await.unwrap();
        saboteur
            .execute("create table strict (n bigint unique on conflict rollback)")
            .await
            .unwrap();
        saboteur
            .execute("create trigger sabotage after insert on robot when new.name = 'bad' begin insert into strict values (1); end")
            .await
            .unwrap();
        saboteur
            .execute("insert into strict values (1)")
            .await
            .unwrap();
        let mut first = store.begin().await.unwrap();
        insert(&mut first, "first").await;
        let bad = tokio::spawn({
            let store = store.clone();
            async move {
                let mut tx = store.begin().await?;
                robots::insert(
                    &mut tx,
                    &NewRobot {
                        name: "bad".into(),
                        body_json: "{}".into(),
                    },
                )
                .await?;
                tx.commit().await
            }
        });
        let first = tokio::time::timeout(Duration::from_secs(20), first.commit())
            .await
            .expect("it is answered");
        let bad = bad.await.unwrap();
        assert!(bad.is_err());
        // Whether the two shared a commit depends on who came when; what counts: an answer of success is kept, one of failure is not there.
        let kept = names(store).await;
        assert_eq!(kept, if first.is_ok() { vec!["first"] } else { vec![] });
        a_robot(store, "after").await;
        assert!(names(store).await.contains(&"after".to_owned()));
    });
}

/// Writers that share one commit, in this order: each waits for the one before, and all for a first one.
async fn together(store: &Store, writers: &[(&'static str, bool)]) -> Vec<Result<(), Error>> {
    let first = store.begin().await.unwrap();
    let mut running = Vec::new();
    for &(name, commits) in writers {
        let store = store.clone();
        running.push(tokio::spawn(async move {
            let mut tx = store.begin().await?;
            insert(&mut tx, name).await;
            if commits {
                tx.commit().await
            } else {
                tx.rollback().await
            }
        }));
        // They stand in line as they came.
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    first.rollback().await.unwrap();
    let mut heard = Vec::new();
    for writer in running {
        heard.push(writer.await.unwrap());
    }
    heard
}

#[test]
fn nobody_is_answered_before_the_common_commit() {
    on_sqlite(async |database| {
        let store = &database.store;
        let first = store.begin().await.unwrap();
        let mut early = tokio::spawn({
            let store = store.clone();
            async move {
                let mut tx = store.begin().await?;
                insert(&mut tx, "early").await;
                tx.commit().await
            }
        });
        // They stand in line as they came.
        tokio::time::sleep(Duration::from_millis(50)).await;
        let late = tokio::spawn({
            let store = store.clone();
            async move { store.begin().await }
        });
        tokio::time::sleep(Duration::from_millis(50)).await;
        first.rollback().await.unwrap();
        // The group waits for the late one, and the early one with it.
        let mut late = late.await.unwrap().unwrap();
        let answered = tokio::time::timeout(Duration::from_millis(300), &mut early).await;
        assert!(answered.is_err(), "{answered:?}");
        assert_eq!(names(store).await, [""; 0]);
        insert(&mut late, "late").await;
        late.commit().await.unwrap();
        tokio::time::timeout(Duration::from_secs(20), early)
            .await
            .expect("it is answered")
            .unwrap()
            .unwrap();
        assert_eq!(names(store).await, ["early", "late"]);
    });
}

#[test]
fn who_gives_up_waiting_keeps_nobody_from_an_answer() {
    on_sqlite(async |database| {
        let store = &database.store;
        for i in 0..20 {
            let mut first = store.begin().await.unwrap();
            insert(&mut first, &format!("{i}")).await;
            let begin = || {
                let store = store.clone();
                tokio::spawn(async move { store.begin().await.unwrap() })
            };
            let [impatient, second] = [begin(), begin()];
            tokio::time::sleep(Duration::from_millis(10)).await;
            // the group is left to those who wait, and then all of them go away
            let first = tokio::spawn(first.commit());
            impatient.abort();
            drop(impatient.await);
            if let Ok(second) = second.await {
                drop(second);
            }
            tokio::time::timeout(Duration::from_secs(20), first)
                .await
                .expect("it is answered")
                .unwrap()
                .unwrap();
        }
        assert_eq!(names(store).await.len(), 20);
    });
}

#[test]
fn a_writer_that_rolls_back_between_two_that_commit_takes_neither_their_rows_nor_their_entries() {
    on_sqlite(async |database| {
        let store = &database.store;
        let before = audit::head(store).await.unwrap().seq;
        let heard = together(
            store,
            &[
                ("a", true),
                ("b", false),
                ("c", true),
                ("d", true),
                ("e", false),
            ],
        )
        .await;
        heard.into_iter().for_each(|result| result.unwrap());
        assert_eq!(names(store).await, ["a", "c", "d"]);
        let mut said = Vec::new();
        for entry in audit::list(store, before, 100).await.unwrap() {
            said.push((
                entry.event,
                robots::get(store, &entry.subject).await.unwrap().name,
            ));
        }
        assert_eq!(
            said,
            ["a", "c", "d"].map(|name| ("robot_created".to_owned(), name.to_owned()))
        );
        let checks = kincal::store::verify::verify(store, &Default::default())
            .await
            .unwrap();
        assert!(
            checks.iter().all(|check| check.n_violations == 0),
            "{checks:?}"
        );
    });
}

#[test]
fn a_group_whose_entries_cannot_be_written_is_gone_with_them() {
    on_sqlite(async |database| {
        let store = &database.store;
        let mut saboteur = sqlx::AnyConnection::connect(&url(database)).await.unwrap();
        for statement in [
            "create table strict (n bigint unique on conflict rollback)",
            "insert into strict values (1)",
            "create trigger sabotage after insert on audit when (select name from robot where id = new.subject) = 'bad'
             begin insert into strict values (1); end",
        ] {
            saboteur.execute(statement).await.unwrap();
        }
        let before = audit::head(store).await.unwrap();
        let heard = together(store, &[("good", true), ("bad", true), ("also good", true)]).await;
        assert!(heard.iter().all(|result| result.is_err()), "{heard:?}");
        assert_eq!(names(store).await, [""; 0]);
        let after = audit::head(store).await.unwrap();
        assert_eq!(
            (
                after.seq,
                audit::list(store, before.seq, 100).await.unwrap().len()
            ),
            (before.seq, 0)
        );
        a_robot(store, "after").await;
        assert_eq!(names(store).await, ["after"]);
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
                if futures_poll(&mut write).await {
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

/// Polls once, then lets others run; whether it is done.
async fn futures_poll(future: &mut (impl Future<Output = ()> + Unpin)) -> bool {
    let done = std::future::poll_fn(|context| {
        std::task::Poll::Ready(std::pin::Pin::new(&mut *future).poll(context).is_ready())
    })
    .await;
    tokio::task::yield_now().await;
    done
}
