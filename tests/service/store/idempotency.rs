//! One effect per `Idempotency-Key`.

use kincal::store::{
    Error, IdempotencyScope, IdempotentOutcome, ListRequest, NewRobot, Result, Store,
    StoredResponse, Tx, robots,
};

use tokio::sync::Notify;

use crate::engines::for_each_engine;

pub fn scope(key: &str, request_sha256: &str) -> IdempotencyScope {
    IdempotencyScope {
        holder: "key_1".into(),
        method: "POST".into(),
        path: "/v1/robots".into(),
        key: key.into(),
        request_sha256: request_sha256.into(),
    }
}

pub async fn make_a_robot(tx: &mut Tx) -> Result<StoredResponse> {
    let robot = robots::insert(
        tx,
        &NewRobot {
            name: "r".into(),
            body_json: "{}".into(),
        },
    )
    .await?;
    let location = Some(format!("/v1/robots/{}", robot.id));
    Ok(StoredResponse {
        status: 201,
        location,
        content_type: "application/json".into(),
        body: robot.id.into_bytes(),
    })
}

async fn n_robots(store: &Store) -> usize {
    robots::search(store, None, &ListRequest::all())
        .await
        .unwrap()
        .items
        .len()
}

#[test]
fn of_sixteen_requests_at_once_with_one_key_one_takes_effect_and_all_get_its_answer() {
    for_each_engine(async |database| {
        let requests: Vec<_> = (0..16)
            .map(|_| {
                let store = database.store.clone();
                // Spawned: what a handler awaits must be Send.
                tokio::spawn(async move {
                    store
                        .create_idempotent(Some(&scope("k", "s")), async |tx| {
                            make_a_robot(tx).await
                        })
                        .await
                })
            })
            .collect();
        let (mut fresh, mut replays) = (Vec::new(), Vec::new());
        for request in requests {
            match request.await.unwrap().unwrap() {
                IdempotentOutcome::Fresh(response) => fresh.push(response),
                IdempotentOutcome::Replay(response) => replays.push(response),
                IdempotentOutcome::Reused => panic!("the body was the same"),
            }
        }
        assert_eq!((fresh.len(), replays.len()), (1, 15));
        assert!(replays.iter().all(|replay| *replay == fresh[0]));
        assert_eq!(n_robots(&database.store).await, 1);
    });
}

#[test]
fn another_body_under_the_same_key_does_nothing() {
    for_each_engine(async |database| {
        let store = &database.store;
        store
            .create_idempotent(Some(&scope("k", "one")), make_a_robot)
            .await
            .unwrap();
        let outcome = store
            .create_idempotent(Some(&scope("k", "another")), make_a_robot)
            .await
            .unwrap();
        assert_eq!(outcome, IdempotentOutcome::Reused);
        assert_eq!(n_robots(store).await, 1);
    });
}

#[test]
fn the_same_key_of_another_holder_or_for_another_path_is_another_key() {
    for_each_engine(async |database| {
        let store = &database.store;
        let others = [
            scope("k", "s"),
            scope("l", "s"),
            IdempotencyScope {
                holder: "key_2".into(),
                ..scope("k", "s")
            },
            IdempotencyScope {
                path: "/v1/else".into(),
                ..scope("k", "s")
            },
            IdempotencyScope {
                method: "PUT".into(),
                ..scope("k", "s")
            },
        ];
        for scope in &others {
            let outcome = store
                .create_idempotent(Some(scope), make_a_robot)
                .await
                .unwrap();
            assert!(matches!(outcome, IdempotentOutcome::Fresh(_)), "{scope:?}");
        }
        assert_eq!(n_robots(store).await, others.len());
    });
}

#[test]
fn a_failed_effect_leaves_nothing_and_its_key_free() {
    for_each_engine(async |database| {
        let store = &database.store;
        let failed = store
            .create_idempotent(
                Some(&scope("k", "s")),
                async |tx: &mut Tx| -> Result<StoredResponse> {
                    make_a_robot(tx).await?;
                    Err(Error::NotFound)
                },
            )
            .await;
        assert!(matches!(failed, Err(Error::NotFound)));
        assert_eq!(n_robots(store).await, 0);
        let outcome = store
            .create_idempotent(Some(&scope("k", "s")), make_a_robot)
            .await
            .unwrap();
        assert!(matches!(outcome, IdempotentOutcome::Fresh(_)));
    });
}

#[test]
fn without_a_key_every_request_takes_effect() {
    for_each_engine(async |database| {
        for _ in 0..3 {
            let outcome = database
                .store
                .create_idempotent(None, make_a_robot)
                .await
                .unwrap();
            assert!(matches!(outcome, IdempotentOutcome::Fresh(_)));
        }
        assert_eq!(n_robots(&database.store).await, 3);
    });
}

#[test]
fn a_request_that_is_cut_off_before_its_end_can_be_made_again() {
    for_each_engine(async |database| {
        let store = &database.store;
        let written = Notify::new();
        let scope = scope("k", "s");
        let request = store.create_idempotent(Some(&scope), async |tx: &mut Tx| {
            make_a_robot(tx).await?;
            written.notify_one();
            std::future::pending::<Result<StoredResponse>>().await
        });
        // The client hangs up once the row is written: the handler's future is dropped.
        tokio::select! {
            _ = request => panic!("it never ends"),
            () = written.notified() => {}
        }
        let outcome = store
            .create_idempotent(Some(&scope), make_a_robot)
            .await
            .unwrap();
        assert!(matches!(outcome, IdempotentOutcome::Fresh(_)));
        assert_eq!(n_robots(store).await, 1);
    });
}
