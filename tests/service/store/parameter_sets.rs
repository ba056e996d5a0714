//! Release and withdrawal of parameter sets.

use kincal::jobs::queue;
use kincal::release::facts::UNUSABLE_FIT;
use kincal::store::robot_versions::{self, RobotEdit};
use kincal::store::{
    CheckedState, Conflict, Engine, Error, JobResult, MeasurementSetRow, NewJob, NewMeasurementSet,
    NewParameterSet, ParameterSetRow, ParameterSetStatus, PolicyRow, Release, Result, RobotCheck,
    Store, job_sources, jobs, leases, measurement_sets, parameter_sets, policies, robots,
    verifications, withdrawals,
};
use kincal::wire::canonical;
use kincal::wire::policy::{DecisionRule, PolicyBody};
use kincal::wire::report_shape::Evidence;
use kincal::wire::verification::{Fit, Verification, VerificationKind};
use std::time::Duration;

use crate::engines::for_each_engine;
use crate::fixtures::{
    a_candidate, a_job, a_lone_job, a_robot, a_set, claim, in_transaction, new_job, new_set,
};

/// The gate results that a release stores.
const PASSED: &str = r#"[{"gate":"x","passed":true}]"#;

async fn release(
    store: &Store,
    set: &ParameterSetRow,
    active: Option<&ParameterSetRow>,
) -> Result<ParameterSetRow> {
    let release = Release {
        id: set.id.clone(),
        checked: CheckedState {
            active: active.map(|active| active.id.clone()),
            robot: RobotCheck {
                version: 1,
                ..RobotCheck::default()
            },
            n_withdrawn: withdrawals::count(store, &set.robot_id).await?,
            ..CheckedState::default()
        },
        reason: "after the collision".into(),
        checks_json: PASSED.into(),
        n_passed: 1,
        n_failed: 0,
        released_by: "key_1".into(),
        evidence: Evidence::SameUpload,
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
        let sql = "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = $2, release_n_passed = 1, release_n_failed = 0
            where id = $1";
        let error = sqlx::query(sql)
            .bind(&second.id)
            .bind(PASSED)
            .execute(store.readers())
            .await
            .unwrap_err();
        assert!(
            error.as_database_error().unwrap().is_unique_violation(),
            "{error}"
        );
        // Another robot has its own active set.
        let elsewhere =
            a_candidate(store, &a_set(store, &a_robot(store, "other").await).await).await;
        sqlx::query(sql)
            .bind(&elsewhere.id)
            .bind(PASSED)
            .execute(store.readers())
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
            "update parameter_set set status = 'released', released_at_ms = 1, release_n_passed = 1, release_n_failed = 0 where id = $1",
            "update parameter_set set status = 'released', release_checks_json = '[{\"passed\":true}]', release_n_passed = 1, release_n_failed = 0 where id = $1",
            "update parameter_set set status = 'approved' where id = $1",
            "update parameter_set set status = 'withdrawn' where id = $1",
        ] {
            let error = sqlx::query(sql)
                .bind(&candidate.id)
                .execute(store.readers())
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
        let job = a_lone_job(store, "{}").await;
        let new = NewParameterSet {
            body_json: "{}".into(),
            sha256: "00".into(),
            estimate_json: None,
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
        // The stored texts do not matter.
        for (n_passed, n_failed) in [
            ("null", "null"),
            ("0", "0"),
            ("0", "1"),
            ("1", "1"),
            ("1", "null"),
        ] {
            let sql = format!(
                "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '{PASSED}', release_n_passed = {n_passed},
                    release_n_failed = {n_failed} where id = '{}'",
                candidate.id
            );
            let error = sqlx::query(sqlx::AssertSqlSafe(sql))
                .execute(store.readers())
                .await
                .unwrap_err();
            assert!(
                error.to_string().contains("all of them passed"),
                "{n_passed} {n_failed}: {error}"
            );
        }
    });
}

/// A withdrawn set that is released again.
const BACK_IN_FORCE: &str =
    "update parameter_set set status = 'released', withdrawn_at_ms = null, released_at_ms = 1,
    release_checks_json = '[{\"passed\":true}]', release_n_passed = 1, release_n_failed = 0 where id = $1";

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
                .execute(store.readers())
                .await
                .unwrap_err();
            assert!(error.to_string().contains(expected), "{sql}: {error}");
        }
    });
}

const POSTGRES_BYTES: &str = "update measurement_set set body = '' where id = $1";

/// The update that faulty code without checks would write.
pub(super) const UNCHECKED_UPDATE: &str = "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[{\"passed\":true}]', release_n_passed = 1, release_n_failed = 0,
    release_evidence = $2, release_uncertainty_mm = nullif($3, cast(-1 as double precision)), released_by = $4 where id = $1";

#[test]
fn the_schema_itself_keeps_the_robots_policy() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let set_row = a_set(store, &robot).await;
        let candidate = a_candidate(store, &set_row).await;
        let strict = PolicyBody {
            tolerance_mm: Some(0.2),
            decision_rule: DecisionRule::GuardedAcceptance,
            independent_session_required: true,
            second_person_required: true,
        };
        let set = in_transaction(store, async |tx| {
            policies::put(tx, &robot.id, &strict, "boss").await
        })
        .await;
        assert_eq!(
            set,
            PolicyRow {
                tolerance_mm: Some(0.2),
                decision_rule: Some(DecisionRule::GuardedAcceptance),
                independent_session_required: true,
                second_person_required: true,
                version: 1,
            }
        );
        let write = async |evidence: &str, uncertainty_mm: f64, by: &str| {
            sqlx::query(UNCHECKED_UPDATE)
                .bind(&candidate.id)
                .bind(evidence)
                .bind(uncertainty_mm)
                .bind(by)
                .execute(store.readers())
                .await
        };
        for (evidence, uncertainty_mm, by) in [
            ("same_upload", 0.1, "engineer"),
            ("independent_session", 0.21, "engineer"),
            ("independent_session", -1.0, "engineer"), // equals no tolerance
            ("independent_session", 0.1, "key_uploader"),
        ] {
            let error = write(evidence, uncertainty_mm, by).await.unwrap_err();
            assert!(
                error.to_string().contains("policy"),
                "{evidence} {uncertainty_mm} {by}: {error}"
            );
        }
        // Nor if the code claims an independent session that does not exist.
        let error = write("independent_session", 0.1, "engineer")
            .await
            .unwrap_err();
        assert!(error.to_string().contains("policy"), "{error}");
        scored(store, &set_row, &candidate, &good_session()).await;
        write("independent_session", 0.1, "engineer").await.unwrap();
    });
}

/// A set that holds values of another one is released neither by who uploaded that one's points nor if somebody insisted on them.
#[test]
fn the_schema_itself_looks_at_the_uploads_that_a_set_rests_on() {
    for_each_engine(async |database| {
        let store = &database.store;
        for (insisted_on, by, is_released) in [
            (None, "engineer", true),
            (Some("poor_alignment"), "engineer", false),
            (None, "key_uploader", false),
        ] {
            let robot = a_robot(store, "r").await;
            let policy = PolicyBody {
                second_person_required: true,
                ..PolicyBody::default()
            };
            let first = NewMeasurementSet {
                insisted_on: insisted_on.map(str::to_owned),
                ..new_set(&robot, b"first")
            };
            let second = NewMeasurementSet {
                uploaded_by: Some("another".into()),
                ..new_set(&robot, b"second")
            };
            let (first, second) = in_transaction(store, async |tx| {
                policies::put(tx, &robot.id, &policy, "boss").await?;
                tx.act_as("key_uploader");
                let first = measurement_sets::insert(tx, &first).await?;
                Ok((first, measurement_sets::insert(tx, &second).await?))
            })
            .await;
            let held = a_candidate(store, &first).await;
            let new = NewJob {
                parameter_set_input_id: Some(held.id.clone()),
                holds_parameter_set: true,
                ..new_job(&second, "{}")
            };
            let of_job = NewParameterSet {
                body_json: "{}".into(),
                sha256: canonical::sha256_hex(b"{}"),
                estimate_json: None,
            };
            let candidate = in_transaction(store, async |tx| {
                let job = queue::enqueue(tx, &new).await?;
                parameter_sets::insert(tx, &job.id, &of_job).await
            })
            .await;
            let sources = job_sources::uploads(store, &candidate.job_id).await;
            let expected = job_sources::SourceUpload {
                measurement_set_id: first.id,
                is_held: true,
            };
            assert_eq!(sources.unwrap(), [expected]);
            let released = sqlx::query(UNCHECKED_UPDATE)
                .bind(&candidate.id)
                .bind("same_upload")
                .bind(0.1)
                .bind(by)
                .execute(store.readers())
                .await;
            match released {
                Ok(_) => assert!(is_released, "{insisted_on:?} {by}"),
                Err(error) => assert!(
                    !is_released && error.to_string().contains("rests on"),
                    "{insisted_on:?} {by}: {error}"
                ),
            }
        }
    });
}

/// By the guarded rule the uncertainty of a figure counts, and a figure without one is not accepted.
#[test]
fn the_schema_itself_counts_the_uncertainty_by_the_guarded_rule() {
    for_each_engine(async |database| {
        let store = &database.store;
        for (expanded_mm, rule, is_accepted) in [
            (Some(0.09), DecisionRule::GuardedAcceptance, true),
            (Some(0.11), DecisionRule::GuardedAcceptance, false),
            (None, DecisionRule::GuardedAcceptance, false),
            (Some(0.11), DecisionRule::SimpleAcceptance, true),
            (None, DecisionRule::SimpleAcceptance, true),
        ] {
            let robot = a_robot(store, "r").await;
            let set = a_set(store, &robot).await;
            let candidate = a_candidate(store, &set).await;
            let policy = PolicyBody {
                tolerance_mm: Some(0.2),
                decision_rule: rule,
                ..PolicyBody::default()
            };
            in_transaction(store, async |tx| {
                policies::put(tx, &robot.id, &policy, "boss").await
            })
            .await;
            let session = Verification {
                after_expanded_mm: expanded_mm,
                ..good_session()
            };
            scored(store, &set, &candidate, &session).await;
            let released = sqlx::query(UNCHECKED_UPDATE)
                .bind(&candidate.id)
                .bind("independent_session")
                .bind(0.1)
                .bind("engineer")
                .execute(store.readers())
                .await;
            assert_eq!(released.is_ok(), is_accepted, "{expanded_mm:?} {rule:?}");
        }
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
            parameter_sets::of_another_upload(store, &robot.id, &set.id, UNUSABLE_FIT)
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
        // Sets of another robot do not count.
        let strange = a_set(store, &a_robot(store, "s").await).await;
        assert_eq!(
            parameter_sets::of_another_upload(store, &strange.robot_id, &strange.id, UNUSABLE_FIT)
                .await
                .unwrap(),
            None
        );
    });
}

/// A new session that fits, in which the set is better than nominal.
fn good_session() -> Verification {
    Verification {
        measured_seq: 0,
        kind: VerificationKind::Session,
        n_points: 50,
        before_rms_mm: Some(1.0),
        after_rms_mm: Some(0.1),
        after_expanded_mm: Some(0.01),
        is_better: true,
        fit: Fit::Fits,
        evidence: Evidence::IndependentSession,
        is_repeat: false,
        is_worse: false,
        misfit_seq: 0,
        uncertainty_mm: None,
    }
}

/// A session that scored the set, with its results.
async fn scored(
    store: &Store,
    set: &MeasurementSetRow,
    candidate: &ParameterSetRow,
    found: &Verification,
) -> String {
    let new = NewJob {
        kind: kincal::wire::job::Kind::Verify,
        parameter_set_input_id: Some(candidate.id.clone()),
        priority: 1,
        ..new_job(set, "{}")
    };
    in_transaction(store, async |tx| jobs::insert(tx, &new, None).await).await;
    let lease = claim(store, "worker_1", Duration::from_secs(60))
        .await
        .unwrap();
    in_transaction(store, async |tx| {
        let empty = "{}".to_owned().into();
        let result = JobResult {
            report_json: &empty,
            summary_json: "{}",
            convergence_json: &empty,
            result_sha256: "00",
        };
        leases::succeed(tx, &lease, &result).await?;
        queue::record_facts(tx, &lease.job_id, found).await
    })
    .await;
    lease.job_id
}

/// The update that a faulty server would write without checking the gates.
pub(super) async fn release_without_checks(
    store: &Store,
    candidate: &ParameterSetRow,
) -> Result<ParameterSetRow> {
    let robot = robots::get(store, &candidate.robot_id).await?;
    let release = Release {
        id: candidate.id.clone(),
        checked: CheckedState {
            n_verifications: verifications::count(store, &candidate.id).await?,
            robot: robot.check(),
            n_withdrawn: withdrawals::count(store, &candidate.robot_id).await?,
            ..CheckedState::default()
        },
        reason: "it fits".into(),
        checks_json: PASSED.into(),
        n_passed: 1,
        n_failed: 0,
        released_by: "key_1".into(),
        evidence: Evidence::SameUpload,
        uncertainty_mm: None,
    };
    let mut tx = store.begin().await?;
    let released = parameter_sets::release(&mut tx, &release).await?;
    tx.commit().await?;
    Ok(released)
}

pub(super) fn is_refused_by_schema<T: std::fmt::Debug>(result: Result<T>, expected: &str) {
    match result {
        Err(Error::Conflict(Conflict::RefusedBySchema { why })) => {
            assert!(why.contains(expected), "{why}")
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_set_once_shown_to_be_no_better_than_nominal_is_refused_as_a_conflict_however_many_sessions_came_since()
 {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let candidate = a_candidate(store, &set).await;
        let worse = Verification {
            is_better: false,
            ..good_session()
        };
        // a session that is no evidence condemns no set
        let other = a_candidate(store, &set).await;
        let few_points = Verification {
            evidence: Evidence::None,
            ..worse.clone()
        };
        scored(store, &set, &other, &few_points).await;
        release_without_checks(store, &other).await.unwrap();
        withdrawn(store, &other).await;
        scored(store, &set, &candidate, &worse).await;
        for _ in 0..9 {
            scored(store, &set, &candidate, &good_session()).await;
        }
        is_refused_by_schema(
            release_without_checks(store, &candidate).await,
            "no better than nominal",
        );
        assert_eq!(
            status(store, &candidate).await,
            ParameterSetStatus::Candidate
        );
    });
}

#[test]
fn the_schema_itself_makes_no_release_for_a_robot_that_a_session_does_not_fit() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let set = a_set(store, &robot).await;
        let (first, second) = (
            a_candidate(store, &set).await,
            a_candidate(store, &set).await,
        );
        let check_job = async || {
            let row = robots::get(store, &robot.id).await.unwrap();
            row.check_job_id
        };
        let does_not_fit = Verification {
            fit: Fit::DoesNotFit,
            is_better: false,
            evidence: Evidence::None,
            ..good_session()
        };
        let job_id = scored(store, &set, &first, &does_not_fit).await;
        assert_eq!(check_job().await, Some(job_id));
        for candidate in [&first, &second] {
            is_refused_by_schema(
                release_without_checks(store, candidate).await,
                "check_robot",
            );
        }
        let since = Verification {
            misfit_seq: 1,
            ..good_session()
        };
        // A session that repeats an earlier one, or is no evidence, changes nothing.
        for silent in [
            Verification {
                is_repeat: true,
                ..since.clone()
            },
            Verification {
                evidence: Evidence::SameUpload,
                ..since.clone()
            },
            Verification {
                is_better: false,
                ..since.clone()
            },
            // Its job began before the session that did not fit.
            good_session(),
        ] {
            scored(store, &set, &second, &silent).await;
            assert!(check_job().await.is_some(), "{silent:?}");
        }
        // A session that fits ends the state. The session that did not fit is no evidence against a set.
        scored(store, &set, &first, &since).await;
        assert_eq!(check_job().await, None);
        release_without_checks(store, &first).await.unwrap();
        // A reason ends the state, too.
        scored(store, &set, &first, &does_not_fit).await;
        assert!(check_job().await.is_some());
        let checked = in_transaction(store, async |tx| {
            robots::checked(tx, &robot.id, "the tracker's file was mixed up", "key_2").await
        })
        .await;
        assert_eq!(
            (checked.check_job_id, checked.checked_seq),
            (None, 7),
            "everything so far was looked at"
        );
        for (sql, expected) in [
            (
                "update verification set fit = 'fits' where seq = 1",
                "never changed",
            ),
            ("delete from verification where seq = 1", "never deleted"),
        ] {
            let error = sqlx::query(sql).execute(store.readers()).await.unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
    });
}

#[test]
fn the_schema_itself_keeps_what_speaks_against_a_set_until_it_is_answered() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let set = a_set(store, &robot).await;
        let (old, new) = (
            a_candidate(store, &set).await,
            a_candidate(store, &set).await,
        );
        let checked = async |why: &str| {
            in_transaction(store, async |tx| {
                robots::checked(tx, &robot.id, why, "key_2").await
            })
            .await
            .checked_seq
        };
        // A session did not fit the robot, and a session of another set has ended that state: this set is unconfirmed.
        let does_not_fit = Verification {
            fit: Fit::DoesNotFit,
            evidence: Evidence::None,
            is_better: false,
            ..good_session()
        };
        scored(store, &set, &new, &does_not_fit).await;
        // A job that began before it cannot tell whether it repeats earlier points.
        scored(store, &set, &new, &good_session()).await;
        is_refused_by_schema(release_without_checks(store, &old).await, "check_robot");
        let since = Verification {
            misfit_seq: 1,
            ..good_session()
        };
        scored(store, &set, &new, &since).await;
        is_refused_by_schema(
            release_without_checks(store, &old).await,
            "none since supports",
        );
        let repeat = Verification {
            is_repeat: true,
            ..since.clone()
        };
        scored(store, &set, &old, &repeat).await;
        let worse = Verification {
            is_worse: true,
            ..since.clone()
        };
        scored(store, &set, &old, &worse).await;
        is_refused_by_schema(
            release_without_checks(store, &old).await,
            "none since supports",
        );
        release_without_checks(store, &new).await.unwrap();
        withdrawn(store, &new).await;
        // A set from points measured since needs no session; a set from earlier points does.
        for (is_repeat, is_refused) in [(true, true), (false, false)] {
            let identified = Verification {
                kind: VerificationKind::Identification,
                is_repeat,
                evidence: Evidence::SameUpload,
                ..since.clone()
            };
            let candidate = an_identified(store, &set, &identified).await;
            let released = release_without_checks(store, &candidate).await;
            match is_refused {
                true => is_refused_by_schema(released, "none since supports"),
                false => drop(released.unwrap()),
            }
            withdrawn(store, &candidate).await;
        }
        // Other sessions do not outweigh a session in which the set was far off.
        let far_off = Verification {
            fit: Fit::SetFarOff,
            ..since.clone()
        };
        let good_since_check = async || {
            let check = verifications::robot_counters(store, &robot.id)
                .await
                .unwrap();
            Verification {
                misfit_seq: check.misfit_seq,
                ..good_session()
            }
        };
        scored(store, &set, &old, &since).await;
        scored(store, &set, &old, &far_off).await;
        is_refused_by_schema(release_without_checks(store, &old).await, "check_robot");
        scored(store, &set, &old, &good_since_check().await).await;
        is_refused_by_schema(
            release_without_checks(store, &old).await,
            "none since supports",
        );
        assert!(checked("the tripod was kicked").await > 0);
        release_without_checks(store, &old).await.unwrap();
        // Where the set was no better than nominal as well, a reason alone is not enough: the set has to fit a later session.
        withdrawn(store, &old).await;
        let other = a_candidate(store, &set).await;
        let no_better = Verification {
            is_better: false,
            ..far_off
        };
        scored(store, &set, &other, &no_better).await;
        assert!(checked("joint 3 was mastered again").await > 0);
        is_refused_by_schema(
            release_without_checks(store, &other).await,
            "no better than nominal",
        );
        scored(store, &set, &other, &good_since_check().await).await;
        release_without_checks(store, &other).await.unwrap();
    });
}

async fn withdrawn(store: &Store, set: &ParameterSetRow) {
    in_transaction(store, async |tx| {
        parameter_sets::withdraw(tx, &set.id, "no", "key_1").await
    })
    .await;
}

/// Stores a set as its job does when it ends, with the job's findings.
async fn an_identified(
    store: &Store,
    set: &MeasurementSetRow,
    found: &Verification,
) -> ParameterSetRow {
    let job = a_job(store, set, "{}").await;
    let body = format!("{{\"of\": \"{}\"}}", job.id);
    let candidate = NewParameterSet {
        sha256: kincal::wire::canonical::sha256_hex(body.as_bytes()),
        body_json: body,
        estimate_json: None,
    };
    in_transaction(store, async |tx| {
        let row = parameter_sets::insert(tx, &job.id, &candidate).await?;
        queue::record_facts(tx, &job.id, found).await?;
        Ok(row)
    })
    .await
}

#[test]
fn a_rollback_follows_what_a_release_superseded_and_no_clock() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let mut sets = Vec::new();
        for _ in 0..3 {
            sets.push(a_candidate(store, &set).await);
        }
        let [a, b, c] = &sets[..] else { unreachable!() };
        release(store, a, None).await.unwrap();
        // A was released while the clock was 30 days ahead, and B and C after it was corrected.
        sqlx::query(
            "update parameter_set set released_at_ms = released_at_ms + 2592000000 where id = $1",
        )
        .bind(&a.id)
        .execute(store.readers())
        .await
        .unwrap();
        let released = release(store, b, Some(a)).await.unwrap();
        assert_eq!(released.supersedes_id.as_ref(), Some(&a.id));
        release(store, c, Some(b)).await.unwrap();
        for back_to in [b, a] {
            let before = parameter_sets::before_active(store, &set.robot_id)
                .await
                .unwrap();
            assert_eq!(before.id, back_to.id);
            let active = parameter_sets::active(store, &set.robot_id).await.unwrap();
            let release = Release {
                id: back_to.id.clone(),
                checked: CheckedState {
                    active: active.map(|active| active.id),
                    robot: RobotCheck {
                        version: 1,
                        ..RobotCheck::default()
                    },
                    n_withdrawn: withdrawals::count(store, &set.robot_id).await.unwrap(),
                    ..CheckedState::default()
                },
                reason: "scrap".into(),
                checks_json: PASSED.into(),
                n_passed: 1,
                n_failed: 0,
                released_by: "key_1".into(),
                evidence: Evidence::SameUpload,
                uncertainty_mm: None,
            };
            in_transaction(store, async |tx| {
                parameter_sets::roll_back(tx, &release).await
            })
            .await;
        }
    });
}

#[test]
fn a_release_is_refused_when_the_policy_changed_since_its_checks() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let candidate = a_candidate(store, &a_set(store, &robot).await).await;
        let loose = PolicyBody {
            tolerance_mm: Some(10.0),
            ..PolicyBody::default()
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

#[test]
fn a_release_is_refused_when_the_robot_was_edited_since_its_checks() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let candidate = a_candidate(store, &a_set(store, &robot).await).await;
        let edit = RobotEdit {
            edited_version: 1,
            name: "r".into(),
            body_json: "{}".into(),
            changes_joint_map: false,
            changed: vec!["serial_number"],
        };
        in_transaction(store, async |tx| {
            robot_versions::edit(tx, &robot.id, &edit, "key_1").await
        })
        .await;
        let refused = release(store, &candidate, None).await;
        assert!(
            matches!(refused, Err(Error::Conflict(Conflict::ChecksOutdated))),
            "{refused:?}"
        );
    });
}
