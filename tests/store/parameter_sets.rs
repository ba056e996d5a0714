//! Release and withdrawal of parameter sets.

use kincal::store::{
    Checked, Conflict, Engine, Error, MeasurementSetRow, NewJob, NewParameterSet, ParameterSetRow,
    ParameterSetStatus, PolicyRow, Release, Result, Store, jobs, leases, measurement_sets,
    parameter_sets, policies, sessions,
};
use std::time::Duration;

use crate::engines::for_each_engine;
use crate::fixtures::{a_candidate, a_job, a_robot, a_set, in_transaction, new_job, new_set};

/// What a release keeps of its gates.
const PASSED: &str = r#"[{"gate":"x","passed":true}]"#;

async fn release(
    store: &Store,
    set: &ParameterSetRow,
    active: Option<&ParameterSetRow>,
) -> Result<ParameterSetRow> {
    let release = Release {
        id: set.id.clone(),
        checked: Checked {
            active: active.map(|active| active.id.clone()),
            ..Checked::default()
        },
        reason: "after the collision".into(),
        checks_json: PASSED.into(),
        released_by: "key_1".into(),
        evidence: "same_upload".into(),
        uncertainty_mm: Some(0.1),
    };
    let mut tx = store.begin().await?;
    let released = parameter_sets::release(&mut tx, &release).await?;
    tx.commit().await?;
    Ok(released)
}

async fn status(store: &Store, set: &ParameterSetRow) -> ParameterSetStatus {
    parameter_sets::get(store, &set.id).await.unwrap().status
}

#[test]
fn a_release_supersedes_the_one_before_and_can_be_rolled_back_in_one_call() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let set = a_set(store, &robot).await;
        let (first, second) = (
            a_candidate(store, &set).await,
            a_candidate(store, &set).await,
        );
        assert_eq!(first.status, ParameterSetStatus::Candidate);
        assert_eq!(
            parameter_sets::active(store, &robot.id).await.unwrap(),
            None
        );
        let released = release(store, &first, None).await.unwrap();
        assert_eq!(
            released.release_reason.as_deref(),
            Some("after the collision")
        );
        assert!(released.released_at_ms.unwrap() >= first.created_at_ms);
        assert_eq!(
            release(store, &first, None).await.unwrap(),
            released,
            "releasing it again changes nothing"
        );
        release(store, &second, Some(&first)).await.unwrap();
        assert_eq!(status(store, &first).await, ParameterSetStatus::Superseded);
        assert_eq!(
            parameter_sets::active(store, &robot.id)
                .await
                .unwrap()
                .unwrap()
                .id,
            second.id
        );
        release(store, &first, Some(&second)).await.unwrap();
        assert_eq!(
            parameter_sets::active(store, &robot.id)
                .await
                .unwrap()
                .unwrap()
                .id,
            first.id
        );
        assert_eq!(status(store, &second).await, ParameterSetStatus::Superseded);
    });
}

#[test]
fn a_release_is_refused_when_another_was_released_since_its_checks() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let (first, second) = (
            a_candidate(store, &set).await,
            a_candidate(store, &set).await,
        );
        release(store, &first, None).await.unwrap();
        let refused = release(store, &second, None).await;
        assert!(
            matches!(refused, Err(Error::Conflict(Conflict::ActiveChanged))),
            "{refused:?}"
        );
        assert_eq!(status(store, &first).await, ParameterSetStatus::Released);
        assert_eq!(status(store, &second).await, ParameterSetStatus::Candidate);
    });
}

#[test]
fn a_withdrawn_set_is_not_active_and_cannot_be_released() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let candidate = a_candidate(store, &a_set(store, &robot).await).await;
        release(store, &candidate, None).await.unwrap();
        let withdrawn = in_transaction(store, async |tx| {
            parameter_sets::withdraw(tx, &candidate.id, "wrong tool", "key_2").await
        })
        .await;
        assert_eq!(
            (withdrawn.status, withdrawn.withdraw_reason.as_deref()),
            (ParameterSetStatus::Withdrawn, Some("wrong tool"))
        );
        assert_eq!(
            parameter_sets::active(store, &robot.id).await.unwrap(),
            None
        );
        let again = in_transaction(store, async |tx| {
            parameter_sets::withdraw(tx, &candidate.id, "again", "key_3").await
        })
        .await;
        assert_eq!(again, withdrawn, "withdrawing it again changes nothing");
        let refused = release(store, &candidate, None).await;
        assert!(
            matches!(refused, Err(Error::Conflict(Conflict::Withdrawn))),
            "{refused:?}"
        );
    });
}

#[test]
fn of_concurrent_releases_exactly_one_wins() {
    for_each_engine(async |database| {
        let robot = a_robot(&database.store, "r").await;
        let set = a_set(&database.store, &robot).await;
        let mut attempts = Vec::new();
        for _ in 0..8 {
            let (store, candidate) = (
                database.store.clone(),
                a_candidate(&database.store, &set).await,
            );
            attempts.push(tokio::spawn(async move {
                release(&store, &candidate, None).await
            }));
        }
        let mut won = 0;
        for attempt in attempts {
            match attempt.await.unwrap() {
                Ok(_) => won += 1,
                Err(error) => assert!(
                    matches!(error, Error::Conflict(Conflict::ActiveChanged)),
                    "{error:?}"
                ),
            }
        }
        assert_eq!(won, 1);
    });
}

#[test]
fn the_schema_itself_refuses_a_second_released_set() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let (first, second) = (
            a_candidate(store, &set).await,
            a_candidate(store, &set).await,
        );
        release(store, &first, None).await.unwrap();
        let sql = "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = $2 where id = $1";
        let error = sqlx::query(sql)
            .bind(&second.id)
            .bind(PASSED)
            .execute(store.pool())
            .await
            .unwrap_err();
        assert!(
            error.as_database_error().unwrap().is_unique_violation(),
            "{error}"
        );
        // Another robot has its own.
        let elsewhere =
            a_candidate(store, &a_set(store, &a_robot(store, "other").await).await).await;
        sqlx::query(sql)
            .bind(&elsewhere.id)
            .bind(PASSED)
            .execute(store.pool())
            .await
            .unwrap();
    });
}

#[test]
fn the_schema_itself_refuses_a_release_without_checks_and_states_that_do_not_exist() {
    for_each_engine(async |database| {
        let store = &database.store;
        let candidate = a_candidate(store, &a_set(store, &a_robot(store, "r").await).await).await;
        for sql in [
            "update parameter_set set status = 'released', released_at_ms = 1 where id = $1",
            "update parameter_set set status = 'released', release_checks_json = '[{\"passed\":true}]' where id = $1",
            "update parameter_set set status = 'approved' where id = $1",
            "update parameter_set set status = 'withdrawn' where id = $1",
        ] {
            let error = sqlx::query(sql)
                .bind(&candidate.id)
                .execute(store.pool())
                .await
                .unwrap_err();
            assert!(
                error.as_database_error().unwrap().is_check_violation(),
                "{sql}: {error}"
            );
        }
    });
}

#[test]
fn a_job_has_at_most_one_parameter_set() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_job(store, &a_set(store, &a_robot(store, "r").await).await, "{}").await;
        let new = NewParameterSet {
            body_json: "{}".into(),
            sha256: "00".into(),
        };
        let first = in_transaction(store, async |tx| {
            parameter_sets::insert(tx, &job.id, &new).await
        })
        .await;
        let mut tx = store.begin().await.unwrap();
        let second = parameter_sets::insert(&mut tx, &job.id, &new).await;
        assert!(
            matches!(second, Err(Error::Conflict(Conflict::Duplicate))),
            "{second:?}"
        );
        tx.rollback().await.unwrap();
        assert_eq!(
            jobs::get(store, &job.id).await.unwrap().parameter_set_id,
            Some(first.id)
        );
    });
}

#[test]
fn the_schema_itself_refuses_a_release_in_spite_of_a_failed_gate_or_without_any() {
    for_each_engine(async |database| {
        let store = &database.store;
        let candidate = a_candidate(store, &a_set(store, &a_robot(store, "r").await).await).await;
        for checks in [
            "[]",
            "{}",
            r#"[{"gate":"x","passed":false}]"#,
            r#"[{"gate":"x","passed":true},{"gate":"y","passed":false}]"#,
        ] {
            let sql = "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = $2 where id = $1";
            let error = sqlx::query(sql)
                .bind(&candidate.id)
                .bind(checks)
                .execute(store.pool())
                .await
                .unwrap_err();
            assert!(
                error.to_string().contains("all of them passed"),
                "{checks}: {error}"
            );
        }
    });
}

/// A withdrawn set that moves the robot again.
const BACK_IN_FORCE: &str =
    "update parameter_set set status = 'released', withdrawn_at_ms = null, released_at_ms = 1,
    release_checks_json = '[{\"passed\":true}]' where id = $1";

#[test]
fn the_schema_itself_keeps_the_life_and_the_content_of_a_set() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let (first, second) = (
            a_candidate(store, &set).await,
            a_candidate(store, &set).await,
        );
        release(store, &first, None).await.unwrap();
        in_transaction(store, async |tx| {
            parameter_sets::withdraw(tx, &second.id, "no", "key_1").await
        })
        .await;
        let refused: [(&'static str, &str, &str); 9] = [
            (BACK_IN_FORCE, &second.id, "never back"),
            (
                "update parameter_set set status = 'candidate' where id = $1",
                &first.id,
                "never back",
            ),
            (
                "update parameter_set set status = 'candidate', withdrawn_at_ms = null where id = $1",
                &second.id,
                "never back",
            ),
            (
                "update parameter_set set status = 'superseded', withdrawn_at_ms = null where id = $1",
                &second.id,
                "never back",
            ),
            (
                "update parameter_set set body_json = '{}' where id = $1",
                &first.id,
                "never changed",
            ),
            (
                "delete from parameter_set where id = $1",
                &first.id,
                "never deleted",
            ),
            (
                "update measurement_set set body = x'00' where id = $1",
                &set.id,
                "never changed",
            ),
            (
                "update measurement_set set sha256 = '' where id = $1",
                &set.id,
                "never changed",
            ),
            (
                "update robot set body_json = '{}' where id = $1",
                &set.robot_id,
                "never changed",
            ),
        ];
        for (sql, id, expected) in refused {
            let sql = if sql.contains("x'00'") && store.engine() == Engine::Postgres {
                POSTGRES_BYTES
            } else {
                sql
            };
            let error = sqlx::query(sql)
                .bind(id)
                .execute(store.pool())
                .await
                .unwrap_err();
            assert!(error.to_string().contains(expected), "{sql}: {error}");
        }
    });
}

const POSTGRES_BYTES: &str = "update measurement_set set body = '' where id = $1";

/// What the code would write if it forgot to look.
const FORGETFUL: &str = "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[{\"passed\":true}]',
    release_evidence = $2, release_uncertainty_mm = nullif($3, cast(-1 as double precision)), released_by = $4 where id = $1";

#[test]
fn the_schema_itself_keeps_the_robots_policy() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let candidate = a_candidate(store, &a_set(store, &robot).await).await;
        let strict = PolicyRow {
            tolerance_mm: Some(0.2),
            independent_session_required: 1,
            second_person_required: 1,
            version: 0,
        };
        let set = in_transaction(store, async |tx| {
            policies::put(tx, &robot.id, &strict, "boss").await
        })
        .await;
        assert_eq!(
            set,
            PolicyRow {
                version: 1,
                ..strict.clone()
            }
        );
        let write = async |evidence: &str, uncertainty_mm: f64, by: &str| {
            sqlx::query(FORGETFUL)
                .bind(&candidate.id)
                .bind(evidence)
                .bind(uncertainty_mm)
                .bind(by)
                .execute(store.pool())
                .await
        };
        for (evidence, uncertainty_mm, by) in [
            ("same_upload", 0.1, "engineer"),
            ("independent_session", 0.21, "engineer"),
            ("independent_session", -1.0, "engineer"), // which stands for none
            ("independent_session", 0.1, "key_uploader"),
        ] {
            let error = write(evidence, uncertainty_mm, by).await.unwrap_err();
            assert!(
                error.to_string().contains("policy"),
                "{evidence} {uncertainty_mm} {by}: {error}"
            );
        }
        write("independent_session", 0.1, "engineer").await.unwrap();
    });
}

#[test]
fn the_set_to_compare_with_is_the_newest_from_another_upload() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let upload = async |bytes: &[u8]| {
            in_transaction(store, async |tx| {
                measurement_sets::insert(tx, &new_set(&robot, bytes)).await
            })
            .await
        };
        let other = async |set: &MeasurementSetRow| {
            parameter_sets::of_another_session(store, &robot.id, &set.id)
                .await
                .unwrap()
                .map(|found| found.id)
        };
        let (first, again) = (upload(b"monday").await, upload(b"monday").await);
        let on_monday = a_candidate(store, &first).await;
        a_candidate(store, &again).await;
        assert_eq!((other(&first).await, other(&again).await), (None, None));
        let next = upload(b"tuesday").await;
        assert_eq!(other(&first).await, None);
        assert!(
            other(&next)
                .await
                .is_some_and(|found| found != on_monday.id)
        );
        let (older, newer) = (
            a_candidate(store, &next).await,
            a_candidate(store, &next).await,
        );
        assert!(older.id < newer.id);
        assert_eq!(
            (other(&first).await, other(&again).await),
            (Some(newer.id.clone()), Some(newer.id))
        );
        // another robot's sets are none of this one's
        let strange = a_set(store, &a_robot(store, "s").await).await;
        assert_eq!(
            parameter_sets::of_another_session(store, &strange.robot_id, &strange.id)
                .await
                .unwrap(),
            None
        );
    });
}

/// A session that scored the set, with this report.
async fn scored(
    store: &Store,
    set: &MeasurementSetRow,
    candidate: &ParameterSetRow,
    report_json: &str,
) -> String {
    let new = NewJob {
        kind: "verify".into(),
        parameter_set_input_id: Some(candidate.id.clone()),
        priority: 1,
        ..new_job(set, "{}")
    };
    in_transaction(store, async |tx| jobs::insert(tx, &new, None).await).await;
    let lease = leases::claim(store, "worker_1", Duration::from_secs(60))
        .await
        .unwrap()
        .unwrap();
    in_transaction(store, async |tx| {
        leases::succeed(tx, &lease, report_json, "{}", "00").await
    })
    .await;
    lease.job_id
}

#[test]
fn a_set_once_shown_to_be_no_better_than_nominal_is_refused_as_a_conflict_however_many_sessions_came_since()
 {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let candidate = a_candidate(store, &set).await;
        assert_eq!(
            sessions::no_better_than_nominal(store, &candidate.id)
                .await
                .unwrap(),
            None
        );
        let job_id = scored(
            store,
            &set,
            &candidate,
            r#"{"warnings":[{"code":"no_better_than_nominal"}]}"#,
        )
        .await;
        for _ in 0..9 {
            scored(store, &set, &candidate, r#"{"warnings":[]}"#).await;
        }
        assert_eq!(
            sessions::no_better_than_nominal(store, &candidate.id)
                .await
                .unwrap(),
            Some(job_id)
        );
        // What a server would write if it forgot to look.
        let release = Release {
            id: candidate.id.clone(),
            checked: Checked {
                n_sessions: 10,
                ..Checked::default()
            },
            reason: "it fits".into(),
            checks_json: PASSED.into(),
            released_by: "key_1".into(),
            evidence: "same_upload".into(),
            uncertainty_mm: None,
        };
        let mut tx = store.begin().await.unwrap();
        let refused = parameter_sets::release(&mut tx, &release).await;
        tx.rollback().await.unwrap();
        match refused {
            Err(Error::Conflict(Conflict::RefusedBySchema { why })) => {
                assert!(why.contains("no better than nominal"), "{why}")
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(
            status(store, &candidate).await,
            ParameterSetStatus::Candidate
        );
    });
}

#[test]
fn a_release_is_refused_when_the_policy_changed_since_its_checks() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let candidate = a_candidate(store, &a_set(store, &robot).await).await;
        let loose = PolicyRow {
            tolerance_mm: Some(10.0),
            ..PolicyRow::default()
        };
        in_transaction(store, async |tx| {
            policies::put(tx, &robot.id, &loose, "boss").await
        })
        .await;
        let refused = release(store, &candidate, None).await;
        assert!(
            matches!(refused, Err(Error::Conflict(Conflict::ChecksOutdated))),
            "{refused:?}"
        );
        assert_eq!(
            status(store, &candidate).await,
            ParameterSetStatus::Candidate
        );
    });
}
