//! Rows: they read back as written, transactions are atomic, and lists are paged.

use std::collections::HashSet;

use kincal::store::archive::{self, Archivable};
use kincal::store::stuck::stuck_writers;
use kincal::store::{
    Conflict, Cursor, Error, ListRequest, NewApiKey, NewFrames, NewJob, NewMeasurementSet,
    NewNetwork, NewRobot, Page, api_keys, frames, jobs, measurement_sets, networks, robots,
};
use kincal::wire::job::{Model, Preset};

use crate::engines::for_each_engine;
use crate::fixtures::{a_job, a_robot, a_set, everything, in_transaction, new_job, new_set};

fn every_byte() -> Vec<u8> {
    (0..=255).cycle().take(100_000).collect()
}

#[test]
fn uploads_read_back_byte_for_byte() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        for body in [every_byte(), Vec::new(), b"q1_deg\r\n1\r\n".to_vec()] {
            let new = NewMeasurementSet {
                name: Some("n".into()),
                ..new_set(&robot, &body)
            };
            let row =
                in_transaction(store, async |tx| measurement_sets::insert(tx, &new).await).await;
            assert_eq!(measurement_sets::get(store, &row.id).await.unwrap(), row);
            assert!(measurement_sets::body(store, &row.id).await.unwrap() == body);
            let new = NewFrames {
                robot_id: robot.id.clone(),
                content_type: "text/csv".into(),
                body: body.clone().into(),
                result_json: "{}".into(),
            };
            let row = in_transaction(store, async |tx| frames::insert(tx, &new).await).await;
            assert_eq!(frames::get(store, &row.id).await.unwrap(), row);
            let stored: Vec<u8> = sqlx::query_scalar("select body from frames where id = $1")
                .bind(&row.id)
                .fetch_one(store.readers())
                .await
                .unwrap();
            assert!(stored == body);
        }
    });
}

#[test]
fn names_with_markup_quotes_and_control_characters_round_trip() {
    for_each_engine(async |database| {
        for name in [
            "<script>alert(1)</script>",
            "'; drop table robot; --",
            "a\tb\r\n\u{1}\u{7f}",
            "Prüfstand № 7 🤖",
            "%_$1?",
            "",
        ] {
            let robot = a_robot(&database.store, name).await;
            assert_eq!(
                robots::get(&database.store, &robot.id).await.unwrap().name,
                name
            );
        }
    });
}

#[test]
fn a_network_reads_back_and_the_newest_of_its_kind_is_found() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let set = a_set(store, &robot).await;
        let mut rows = Vec::new();
        for (model, preset) in [
            (Model::Paper, Preset::Paper),
            (Model::Paper, Preset::Default),
            (Model::Paper, Preset::Paper),
            (Model::Complete, Preset::Paper),
        ] {
            let job = a_job(store, &set, "{}").await;
            let new = NewNetwork {
                model,
                preset,
                metadata_json: "{}".into(),
                weights: every_byte().into(),
                weights_sha256: "00".into(),
            };
            let row =
                in_transaction(store, async |tx| networks::insert(tx, &job.id, &new).await).await;
            assert_eq!(networks::get(store, &row.id).await.unwrap(), row);
            assert!(networks::weights(store, &row.id).await.unwrap() == every_byte());
            assert_eq!(
                jobs::get(store, &job.id).await.unwrap().network_id.as_ref(),
                Some(&row.id)
            );
            let mut tx = store.begin().await.unwrap();
            let again = networks::insert(&mut tx, &job.id, &new).await;
            assert!(
                matches!(again, Err(Error::Conflict(Conflict::Duplicate))),
                "{again:?}"
            );
            tx.rollback().await.unwrap();
            rows.push(row);
        }
        let newest = networks::newest(store, &robot.id, Model::Paper, Preset::Paper, 2)
            .await
            .unwrap();
        let ids: Vec<&str> = newest.iter().map(|network| network.id.as_str()).collect();
        assert_eq!(
            ids,
            [&rows[2].id, &rows[0].id],
            "newest first, of this model and preset"
        );
        assert_eq!(
            networks::newest(store, &robot.id, Model::Complete, Preset::Default, 9)
                .await
                .unwrap(),
            []
        );
        rows.reverse();
        assert_eq!(
            networks::search(store, &robot.id, &everything())
                .await
                .unwrap()
                .items,
            rows
        );
    });
}

#[test]
fn what_is_not_there_is_not_found() {
    for_each_engine(async |database| {
        let store = &database.store;
        assert!(matches!(
            robots::get(store, "rob_0").await,
            Err(Error::NotFound)
        ));
        assert!(matches!(
            measurement_sets::body(store, "set_0").await,
            Err(Error::NotFound)
        ));
        assert!(matches!(
            jobs::report(store, "job_0").await,
            Err(Error::NotFound)
        ));
        let robot = a_robot(store, "r").await;
        let set = a_set(store, &robot).await;
        let mut nobodys = new_set(&robot, b"");
        nobodys.robot_id = "rob_0".into();
        let mut tx = store.begin().await.unwrap();
        let inserted = measurement_sets::insert(&mut tx, &nobodys).await;
        assert!(matches!(inserted, Err(Error::NotFound)), "{inserted:?}");
        tx.rollback().await.unwrap();
        let mut without_network = new_job(&set, "{}");
        without_network.network_input_id = Some("net_0".into());
        let mut tx = store.begin().await.unwrap();
        let inserted = jobs::insert(&mut tx, &without_network, None).await;
        assert!(matches!(inserted, Err(Error::NotFound)), "{inserted:?}");
    });
}

#[test]
fn a_dropped_transaction_leaves_nothing() {
    for_each_engine(async |database| {
        let store = &database.store;
        for _ in 0..10 {
            let mut tx = store.begin().await.unwrap();
            robots::insert(
                &mut tx,
                &NewRobot {
                    name: "r".into(),
                    body_json: "{}".into(),
                },
            )
            .await
            .unwrap();
            drop(tx);
        }
        assert_eq!(
            robots::search(store, None, &ListRequest::all())
                .await
                .unwrap()
                .items,
            []
        );
        let kept = a_robot(store, "kept").await;
        assert_eq!(
            robots::search(store, None, &ListRequest::all())
                .await
                .unwrap()
                .items,
            [kept]
        );
    });
}

#[test]
fn many_writers_at_once_all_get_through() {
    for_each_engine(async |database| {
        let robot = a_robot(&database.store, "r").await;
        let writers: Vec<_> = (0..32)
            .map(|_| {
                let (store, robot) = (database.store.clone(), robot.clone());
                tokio::spawn(async move { a_set(&store, &robot).await.id })
            })
            .collect();
        let mut ids = HashSet::new();
        for writer in writers {
            ids.insert(writer.await.unwrap());
        }
        assert_eq!(ids.len(), 32);
        let listed = measurement_sets::search(&database.store, &robot.id, &everything())
            .await
            .unwrap();
        assert_eq!(
            listed
                .items
                .into_iter()
                .map(|row| row.id)
                .collect::<HashSet<_>>(),
            ids
        );
    });
}

#[test]
fn pages_are_complete_and_stable_while_rows_are_added() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let other = a_robot(store, "other").await;
        let mut expected = Vec::new();
        for _ in 0..23 {
            expected.push(a_set(store, &robot).await);
            a_set(store, &other).await;
        }
        expected.reverse();
        let mut listed = Vec::new();
        let mut request = ListRequest {
            limit: 5,
            ..ListRequest::all()
        };
        loop {
            let found = measurement_sets::search(store, &robot.id, &request).await;
            let Page {
                items, next_cursor, ..
            } = found.unwrap();
            assert!(items.len() <= 5);
            listed.extend(items);
            a_set(store, &robot).await;
            let Some(cursor) = next_cursor else { break };
            request.cursor = Some(cursor.to_string().parse::<Cursor>().unwrap());
        }
        assert_eq!(listed, expected);
    });
}

#[test]
fn rows_of_the_same_millisecond_come_once_each() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        for _ in 0..10 {
            a_set(store, &robot).await;
        }
        sqlx::query("update measurement_set set created_at_ms = 5")
            .execute(store.readers())
            .await
            .unwrap();
        let mut ids = Vec::new();
        let mut request = ListRequest {
            limit: 3,
            ..ListRequest::all()
        };
        loop {
            let found = measurement_sets::search(store, &robot.id, &request).await;
            let page = found.unwrap();
            ids.extend(page.items.into_iter().map(|row| row.id));
            request.cursor = page.next_cursor;
            if request.cursor.is_none() {
                break;
            }
        }
        assert_eq!(ids.iter().collect::<HashSet<_>>().len(), 10);
        assert_eq!(ids.len(), 10);
    });
}

#[test]
fn a_page_that_holds_all_has_no_next() {
    for_each_engine(async |database| {
        let store = &database.store;
        for _ in 0..3 {
            a_robot(store, "r").await;
        }
        for (limit, n, more) in [
            (0, 1, true),
            (2, 2, true),
            (3, 3, false),
            (u32::MAX, 3, false),
        ] {
            let request = ListRequest {
                limit,
                ..ListRequest::all()
            };
            let page = robots::search(store, None, &request).await.unwrap();
            assert_eq!(
                (page.items.len(), page.next_cursor.is_some()),
                (n, more),
                "limit {limit}"
            );
        }
    });
}

#[test]
fn a_list_limited_to_some_robots_has_only_those() {
    for_each_engine(async |database| {
        let store = &database.store;
        let (a, _b, c) = (
            a_robot(store, "a").await,
            a_robot(store, "b").await,
            a_robot(store, "c").await,
        );
        let only = [a.id.clone(), c.id.clone(), "rob_0".into()];
        let page = robots::search(store, Some(&only), &ListRequest::all())
            .await
            .unwrap();
        assert_eq!(page.items, [c, a]);
        assert_eq!(
            robots::search(store, Some(&[]), &ListRequest::all())
                .await
                .unwrap()
                .items,
            []
        );
    });
}

#[test]
fn text_that_is_no_cursor_is_refused() {
    for text in [
        "",
        "-",
        "5-",
        "x-rob_1",
        "5-rob 1",
        "5-'",
        "rob_1",
        "99999999999999999999-rob_1",
        "5-rob_1-",
    ] {
        assert!(text.parse::<Cursor>().is_err(), "{text}");
    }
    assert_eq!("5-rob_1".parse::<Cursor>().unwrap().to_string(), "5-rob_1");
}

#[test]
fn a_key_is_found_by_its_hash_until_it_is_revoked() {
    for_each_engine(async |database| {
        let store = &database.store;
        let new = NewApiKey {
            name: "cell-4".into(),
            key_sha256: "abcd".into(),
            scopes_json: "[]".into(),
            robots_json: None,
        };
        let key = in_transaction(store, async |tx| api_keys::insert(tx, &new).await).await;
        assert_eq!(
            api_keys::find(store, "abcd").await.unwrap().as_ref(),
            Some(&key)
        );
        assert_eq!(api_keys::find(store, "ABCD").await.unwrap(), None);
        let mut tx = store.begin().await.unwrap();
        assert!(matches!(
            api_keys::insert(&mut tx, &new).await,
            Err(Error::Conflict(Conflict::Duplicate))
        ));
        tx.rollback().await.unwrap();
        let revoked = in_transaction(store, async |tx| api_keys::revoke(tx, &key.id).await).await;
        assert!(revoked.revoked_at_ms.is_some());
        assert_eq!(api_keys::find(store, "abcd").await.unwrap(), None);
        assert_eq!(
            in_transaction(store, async |tx| api_keys::revoke(tx, &key.id).await).await,
            revoked
        );
        assert_eq!(
            api_keys::list(store, &ListRequest::all())
                .await
                .unwrap()
                .items,
            [revoked]
        );
    });
}

#[test]
fn a_job_that_is_posted_while_its_set_is_being_archived_is_refused() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let (set, verify_set) = (a_set(store, &robot).await, a_set(store, &robot).await);
        let new = NewJob {
            verify_set_id: Some(verify_set.id.clone()),
            ..new_job(&set, "{}")
        };
        for archived in [&set.id, &verify_set.id] {
            let mut archiving = store.begin().await.unwrap();
            let kind = Archivable::MeasurementSet;
            archive::archive(&mut archiving, kind, archived, &robot.id, "key_1")
                .await
                .unwrap();
            let (of_poster, posted) = (store.clone(), new.clone());
            let post = tokio::spawn(async move {
                let mut tx = of_poster.begin().await?;
                jobs::insert(&mut tx, &posted, None).await?;
                tx.commit().await
            });
            // The job waits for the other transaction, or has ended without.
            while !post.is_finished() && stuck_writers(store).await.unwrap().is_none() {
                tokio::task::yield_now().await;
            }
            archiving.commit().await.unwrap();
            let posted = post.await.unwrap();
            assert!(
                matches!(&posted, Err(Error::Conflict(Conflict::Archived { id, .. })) if id == archived),
                "{posted:?}"
            );
            let mut restoring = store.begin().await.unwrap();
            archive::restore(&mut restoring, kind, archived, &robot.id)
                .await
                .unwrap();
            restoring.commit().await.unwrap();
        }
        in_transaction(store, async |tx| jobs::insert(tx, &new, None).await).await;
    });
}
