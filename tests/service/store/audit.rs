//! The audit chain: it has every action, and an edit, a deletion or a changed order is detected.

use kincal::store::verify::{Check, Options, verify};
use kincal::store::{
    AuditEntryId, AuditEvent, AuditRow, Engine, NewApiKey, Store, api_keys, audit, jobs,
    parameter_sets,
};
use kincal::wire::canonical::sha256_hex;
use serde_json::json;
use sqlx::AssertSqlSafe;

use crate::engines::for_each_engine;
use crate::fixtures::{a_candidate, a_job, a_robot, a_set, in_transaction};

async fn entries(store: &Store) -> Vec<AuditRow> {
    audit::list(store, 0, 1000).await.unwrap()
}

async fn chain(store: &Store, known_head: Option<AuditEntryId>) -> Check {
    let checks = verify(
        store,
        &Options {
            known_head,
            is_served: false,
        },
    )
    .await
    .unwrap();
    checks.into_iter().find(|check| check.id == "I8").unwrap()
}

/// Runs a statement without the triggers, as somebody with the database's password could.
async fn forge(store: &Store, sql: &str) {
    let (off, on) = match store.engine() {
        Engine::Sqlite => (
            vec![
                "drop trigger audit_entry_stays",
                "drop trigger audit_entry_is_kept",
            ],
            vec![
                "create trigger audit_entry_stays before update on audit begin select raise(abort, 'x'); end",
                "create trigger audit_entry_is_kept before delete on audit begin select raise(abort, 'x'); end",
            ],
        ),
        Engine::Postgres => (
            vec!["alter table audit disable trigger user"],
            vec!["alter table audit enable trigger user"],
        ),
    };
    let mut connection = store.readers().acquire().await.unwrap();
    for sql in off.into_iter().chain([sql]).chain(on) {
        let done = sqlx::raw_sql(AssertSqlSafe(sql))
            .execute(&mut *connection)
            .await;
        done.unwrap_or_else(|error| panic!("{sql}: {error}"));
    }
}

#[test]
fn what_is_done_is_in_the_chain_with_who_did_it() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let set = a_set(store, &robot).await;
        let candidate = a_candidate(store, &set).await;
        let waiting = a_job(store, &set, "{}").await;
        let new = NewApiKey {
            name: "n".into(),
            key_sha256: "00".into(),
            scopes_json: "[]".into(),
            robots_json: None,
        };
        let key = in_transaction(store, async |tx| {
            tx.act_as("command line");
            let key = api_keys::insert(tx, &new).await?;
            api_keys::revoke(tx, &key.id).await
        });
        let key = key.await;
        in_transaction(store, async |tx| {
            tx.act_as("key_7");
            jobs::cancel(tx, &waiting.id).await?;
            parameter_sets::withdraw(tx, &candidate.id, "no", "key_7").await
        })
        .await;
        let found = entries(store).await;
        let found: Vec<(&str, &str, &str)> = found
            .iter()
            .map(|row| (row.actor.as_str(), row.event.as_str(), row.subject.as_str()))
            .collect();
        let expected = [
            ("kincal", "robot_created", robot.id.as_str()),
            ("key_uploader", "measurement_set_created", &set.id),
            ("kincal", "job_created", &candidate.job_id),
            ("kincal", "parameter_set_created", &candidate.id),
            ("kincal", "job_created", &waiting.id),
            ("command line", "key_created", &key.id),
            ("command line", "key_revoked", &key.id),
            ("key_7", "job_cancelled", &waiting.id),
            ("key_7", "parameter_set_withdrawn", &candidate.id),
        ];
        assert_eq!(found, expected);
        assert_eq!(chain(store, None).await.violations, [""; 0]);
        assert_eq!(
            audit::actor(store, &set.id, AuditEvent::MeasurementSetCreated)
                .await
                .unwrap()
                .as_deref(),
            Some("key_uploader")
        );
    });
}

#[test]
fn what_was_rolled_back_is_not_in_the_chain() {
    for_each_engine(async |database| {
        let store = &database.store;
        let new = kincal::store::NewRobot {
            name: "r".into(),
            body_json: "{}".into(),
        };
        let mut tx = store.begin().await.unwrap();
        kincal::store::robots::insert(&mut tx, &new).await.unwrap();
        tx.rollback().await.unwrap();
        drop(store.begin().await.unwrap());
        a_robot(store, "kept").await;
        assert_eq!(entries(store).await.len(), 1);
        assert_eq!(chain(store, None).await.n_violations, 0);
    });
}

#[test]
fn an_edit_a_deletion_another_order_and_a_cut_end_show() {
    for sql in [
        "update audit set actor = 'somebody else' where seq = 2",
        "update audit set at_ms = at_ms - 1 where seq = 2",
        "update audit set detail_json = '{}' where seq = 3",
        "delete from audit where seq = 2",
        "delete from audit where seq = 5",
        "delete from audit where seq > 3",
        "update audit set seq = case seq when 2 then -3 when 3 then -2 end where seq in (2, 3)",
        "insert into audit (seq, at_ms, actor, event, subject, detail_json, sha256) values (6, 0, 'a', 'robot_created', 'rob_0', '{}', '00')",
    ] {
        for_each_engine(async |database| {
            let store = &database.store;
            for i in 0..5 {
                a_robot(store, &i.to_string()).await;
            }
            assert_eq!(chain(store, None).await.n_violations, 0);
            forge(store, sql).await;
            forge(store, "update audit set seq = -seq where seq < 0").await;
            let check = chain(store, None).await;
            assert!(check.n_violations > 0, "{sql} does not show");
        });
    }
}

/// The hash as documented: of the JSON list of the previous hash and all fields.
fn documented(before: &str, row: &AuditRow) -> String {
    let list = json!([
        before,
        row.seq,
        row.at_ms,
        row.actor,
        row.event,
        row.subject,
        row.detail_json
    ]);
    sha256_hex(list.to_string().as_bytes())
}

#[test]
fn an_entry_forged_together_with_its_own_hash_shows_in_the_next_one() {
    for_each_engine(async |database| {
        let store = &database.store;
        for i in 0..4 {
            a_robot(store, &i.to_string()).await;
        }
        let rows = entries(store).await;
        for pair in rows.windows(2) {
            assert_eq!(
                pair[1].sha256,
                documented(&pair[0].sha256, &pair[1]),
                "the chain is made as documented"
            );
        }
        let forged = AuditRow {
            actor: "somebody else".into(),
            ..rows[2].clone()
        };
        let hash = documented(&rows[1].sha256, &forged);
        forge(
            store,
            &format!(
                "update audit set actor = '{}', sha256 = '{hash}' where seq = {}",
                forged.actor, forged.seq
            ),
        )
        .await;
        let check = chain(store, None).await;
        assert_eq!(check.n_violations, 1, "the entry after it: {check:?}");
    });
}

#[test]
fn a_chain_computed_anew_does_not_have_the_head_that_was_kept_elsewhere() {
    for_each_engine(async |database| {
        let store = &database.store;
        a_robot(store, "r").await;
        let known_head = audit::head(store).await.unwrap().entry();
        a_robot(store, "r").await;
        assert_eq!(chain(store, Some(known_head.clone())).await.n_violations, 0);
        let other_hash = AuditEntryId {
            sha256: "00".into(),
            ..known_head.clone()
        };
        assert_eq!(chain(store, Some(other_hash)).await.n_violations, 1);
        let other_number = AuditEntryId {
            seq: 9,
            ..known_head
        };
        assert_eq!(chain(store, Some(other_number)).await.n_violations, 1);
    });
}

#[test]
fn the_schema_itself_refuses_to_touch_an_entry() {
    for_each_engine(async |database| {
        let store = &database.store;
        a_robot(store, "r").await;
        for sql in ["update audit set actor = 'x'", "delete from audit"] {
            let error = sqlx::query(sql).execute(store.readers()).await.unwrap_err();
            assert!(
                error.to_string().contains("an audit entry is never"),
                "{error}"
            );
        }
    });
}

#[test]
fn writers_at_once_make_one_chain() {
    for_each_engine(async |database| {
        let writers: Vec<_> = (0..40)
            .map(|i| {
                let store = database.store.clone();
                tokio::spawn(async move { a_robot(&store, &i.to_string()).await.id })
            })
            .collect();
        let mut ids = Vec::new();
        for writer in writers {
            ids.push(writer.await.unwrap());
        }
        let check = chain(&database.store, None).await;
        assert_eq!((check.n_examined, check.n_violations), (40, 0));
        let mut subjects: Vec<String> = entries(&database.store)
            .await
            .into_iter()
            .map(|row| row.subject)
            .collect();
        subjects.sort();
        ids.sort();
        assert_eq!(subjects, ids);
    });
}
