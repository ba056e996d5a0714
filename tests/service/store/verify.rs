//! `verify` reports each planted fault, and nothing in a healthy database.

use kincal::store::named_documents::{self, NamedDocumentKind, NewNamedDocument};
use kincal::store::verify::{Options, verify};
use kincal::store::{
    CheckedState, Engine, JobResult, Lease, MeasurementSetRow, NewApiKey, NewFrames, NewNetwork,
    NewParameterSet, ParameterSetRow, Release, Result, RobotCheck, Store, Tx, api_keys, frames,
    leases, networks, parameter_sets, policies, verifications,
};
use kincal::wire::canonical::sha256_hex;
use kincal::wire::job::{Model, Preset};
use kincal::wire::policy::PolicyBody;
use kincal::wire::report_shape::Evidence;
use kincal::wire::verification::{Fit, Verification, VerificationKind};
use sqlx::AssertSqlSafe;
use std::time::Duration;

use crate::engines::for_each_engine;
use crate::fixtures::{a_job, a_robot, a_set, claim, in_transaction};
use crate::store::idempotency::{make_a_robot, scope};

pub async fn broken(store: &Store) -> Vec<&'static str> {
    let checks = verify(
        store,
        &Options {
            is_served: true,
            ..Options::default()
        },
    )
    .await
    .unwrap();
    assert_eq!(
        checks.iter().map(|check| check.id).collect::<Vec<_>>(),
        ["I1", "I2", "I3", "I4", "I5", "I6", "I7", "I8", "I9"]
    );
    checks
        .into_iter()
        .filter(|check| check.n_violations > 0)
        .map(|check| check.id)
        .collect()
}

/// Ends a job with its documents.
async fn succeed(tx: &mut Tx, lease: &Lease) -> Result<()> {
    let report_json = r#"{"per_point":[1],"result_sha256":"r","version":"1"}"#.to_owned();
    let result = JobResult {
        report_json: &report_json.into(),
        summary_json: r#"{"result_sha256":"r","version":"1"}"#,
        convergence_json: &"{}".to_owned().into(),
        result_sha256: "r",
    };
    leases::succeed(tx, lease, &result).await.map(drop)
}

/// A running job.
async fn a_running_job(store: &Store, set: &MeasurementSetRow) -> Lease {
    a_job(store, set, "{}").await;
    claim(store, "worker_1", Duration::from_secs(60))
        .await
        .unwrap()
}

/// Stores a parameter set as a worker does.
async fn an_identified_set(store: &Store, set: &MeasurementSetRow) -> ParameterSetRow {
    let lease = a_running_job(store, set).await;
    let new = NewParameterSet {
        body_json: "{}".into(),
        sha256: sha256_hex(b"{}"),
        estimate_json: Some("{}".to_owned().into()),
    };
    in_transaction(store, async |tx| {
        succeed(tx, &lease).await?;
        let row = parameter_sets::insert(tx, &lease.job_id, &new).await?;
        verifications::insert(tx, &lease.job_id, &as_identified()).await?;
        Ok(row)
    })
    .await
}

/// The findings of a job that identified a set.
fn as_identified() -> Verification {
    Verification {
        measured_seq: 0,
        kind: VerificationKind::Identification,
        n_points: 50,
        before_rms_mm: Some(1.0),
        after_rms_mm: Some(0.1),
        after_expanded_mm: Some(0.01),
        is_better: true,
        fit: Fit::SetFarOff,
        evidence: Evidence::SameUpload,
        is_repeat: false,
        is_worse: false,
        misfit_seq: 0,
        uncertainty_mm: Some(0.1),
    }
}

/// Stores one superseded, one released and one withdrawn parameter set.
async fn insert_history(store: &Store, set: &MeasurementSetRow) {
    let mut active = None;
    for _ in 0..2 {
        let id = an_identified_set(store, set).await.id;
        let n_verifications = verifications::count(store, &id).await.unwrap();
        let release = Release {
            id: id.clone(),
            checked: CheckedState {
                active: active.replace(id),
                robot: RobotCheck {
                    version: 1,
                    ..RobotCheck::default()
                },
                n_verifications,
                ..CheckedState::default()
            },
            reason: "better".into(),
            checks_json: r#"[{"passed":true}]"#.into(),
            n_passed: 1,
            n_failed: 0,
            released_by: "key_1".into(),
            evidence: Evidence::SameUpload,
            uncertainty_mm: Some(0.1),
        };
        in_transaction(store, async |tx| {
            tx.act_as("key_1");
            parameter_sets::release(tx, &release).await
        })
        .await;
    }
    let candidate = an_identified_set(store, set).await;
    in_transaction(store, async |tx| {
        tx.act_as("key_1");
        parameter_sets::withdraw(tx, &candidate.id, "no", "key_1").await
    })
    .await;
}

/// Frames, jobs with a report, with networks and with an error, parameter sets of every kind, a policy, an answer kept for its key, an API key
/// in force and one that is revoked: an example of everything that could be edited.
pub async fn insert_examples(store: &Store, set: &MeasurementSetRow) {
    let new = NewFrames {
        robot_id: set.robot_id.clone(),
        content_type: "text/csv".into(),
        body: vec![0].into(),
        result_json: "{}".into(),
    };
    in_transaction(store, async |tx| frames::insert(tx, &new).await).await;
    let robot = &set.robot_id;
    for kind in [
        NamedDocumentKind::Columns,
        NamedDocumentKind::Tool,
        NamedDocumentKind::Reference,
    ] {
        in_transaction(store, async |tx| {
            tx.act_as("key_0");
            let new = NewNamedDocument {
                robot_id: robot,
                kind,
                name: "n",
                content_json: "{}",
                by: "key_0",
            };
            named_documents::insert(tx, new).await
        })
        .await;
    }
    let failed = a_running_job(store, set).await;
    in_transaction(store, async |tx| leases::fail(tx, &failed, "{}").await).await;
    let lease = a_running_job(store, set).await;
    let network = NewNetwork {
        model: Model::Paper,
        preset: Preset::Paper,
        metadata_json: "{}".into(),
        weights: vec![1].into(),
        weights_sha256: "00".into(),
    };
    in_transaction(store, async |tx| {
        succeed(tx, &lease).await?;
        networks::insert_residual(tx, &lease.job_id, &network).await?;
        networks::insert(tx, &lease.job_id, &network).await
    })
    .await;
    let policy = PolicyBody {
        tolerance_mm: Some(0.1),
        independent_session_required: true,
        second_person_required: true,
        ..PolicyBody::default()
    };
    // Of another robot, so that it blocks no release.
    let other = a_robot(store, "other").await;
    in_transaction(store, async |tx| {
        tx.act_as("key_0");
        policies::put(tx, &other.id, &policy, "key_0").await
    })
    .await;
    insert_history(store, &a_set(store, &a_robot(store, "third").await).await).await;
    store
        .create_idempotent(Some(&scope("k", "s")), make_a_robot)
        .await
        .unwrap();
    let key = |hash: &str| NewApiKey {
        name: "n".into(),
        key_sha256: hash.into(),
        scopes_json: "[\"read\"]".into(),
        robots_json: None,
    };
    let (first, second) = (key("00"), key("01"));
    in_transaction(store, async |tx| {
        api_keys::insert(tx, &first).await?;
        let revoked = api_keys::insert(tx, &second).await?.id;
        api_keys::revoke(tx, &revoked).await
    })
    .await;
}

#[test]
fn a_healthy_database_keeps_every_promise() {
    for_each_engine(async |database| {
        let store = &database.store;
        assert_eq!(broken(store).await, [""; 0]);
        let set = a_set(store, &a_robot(store, "r").await).await;
        a_job(store, &set, "{}").await;
        assert_eq!(broken(store).await, [""; 0]);
    });
    for_each_engine(async |database| {
        let store = &database.store;
        insert_examples(store, &a_set(store, &a_robot(store, "r").await).await).await;
        assert_eq!(broken(store).await, [""; 0]);
    });
}

/// A planted fault, and the checks that must report it.
const FAULTS: &[(&str, &[&str])] = &[
    ("drop trigger measurement_set_stays; update measurement_set set body = x'00'", &["I1", "I9"]),
    ("drop trigger robot_stays; update robot set body_json = '[]'", &["I1", "I9"]),
    (
        "drop trigger parameter_set_is_kept; drop trigger verification_is_kept; drop trigger report_summary_is_kept; \
         drop trigger estimate_is_kept; delete from estimate; delete from report_summary; delete from verification; delete from network; delete from residual_network; delete from parameter_set; delete from job",
        &["I1"],
    ),
    ("delete from network", &["I1"]),
    ("delete from api_key where revoked_at_ms is null", &["I1"]),
    ("update api_key set scopes_json = '[\"admin\"]'", &["I1"]),
    ("update api_key set key_sha256 = 'ff' where revoked_at_ms is null", &["I1"]),
    ("update api_key set revoked_at_ms = null", &["I1"]),
    ("update robot_policy set second_person_required = 0", &["I1"]),
    ("delete from robot_policy", &["I1"]),
    (
        "drop trigger named_document_stays; update named_document set content_json = '[]' where kind = 'columns'",
        &["I1", "I9"],
    ),
    (
        "drop trigger named_document_stays; update named_document set version = 2 where kind = 'tool'",
        &["I1", "I9"],
    ),
    (
        "drop trigger named_document_stays; update named_document set version = 2 where kind = 'columns'",
        &["I1", "I9"],
    ),
    ("delete from named_document where kind = 'columns'", &["I1"]),
    ("delete from named_document where kind = 'tool'", &["I1"]),
    ("delete from named_document where kind = 'reference'", &["I1"]),
    ("drop trigger measurement_set_reading_stays", &["I9"]),
    ("drop trigger frames_stay; update frames set result_json = '[]'", &["I1", "I9"]),
    ("update job set request_json = '{\"seed\":1}' where status = 'succeeded'", &["I1"]),
    (
        "drop trigger job_report_stays; update job set report_json = replace(report_json, '\"per_point\":', '\"per_point\": ') where status = 'succeeded'",
        &["I1", "I9"],
    ),
    (
        "drop trigger report_summary_stays; update report_summary set summary_json = '{\"result_sha256\":\"r\",\"version\":\"1\",\"verify\":null}'",
        &["I1", "I9"],
    ),
    ("drop trigger report_summary_is_kept", &["I9"]),
    (
        "drop trigger estimate_stays; update estimate set estimate_json = '{\"a\":1}'",
        &["I1", "I9"],
    ),
    ("drop trigger estimate_is_kept", &["I9"]),
    ("drop trigger job_report_stays; update job set convergence_json = '[]' where status = 'succeeded'", &["I1", "I9"]),
    (
        "drop trigger job_report_stays; update job set report_json = '{\"result_sha256\":\"x\"}', result_sha256 = 'x' where status = 'succeeded'",
        &["I1", "I5", "I9"],
    ),
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
    ("update job set status = 'running', owner = 'gone', lease_until_ms = 1 where status = 'queued'", &["I3"]),
    ("drop index parameter_set_one_released", &["I9"]),
    ("drop trigger verification_stays; update verification set is_better = 0", &["I1", "I9"]),
    ("drop trigger verification_stays; update verification set fit = 'fits', evidence = 'independent_session'", &["I1", "I9"]),
    ("drop trigger verification_is_kept; delete from verification", &["I1", "I9"]),
    ("update robot set check_seq = check_seq + 1", &["I1"]),
    ("update parameter_set set release_n_passed = 9 where status = 'released'", &["I1", "I7"]),
    (
        "drop trigger parameter_set_checks; update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[]'
         where status = 'candidate'",
        &["I1", "I7", "I9"],
    ),
    (
        "drop trigger parameter_set_checks; update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[{\"passed\":false}]'
         where status = 'candidate'",
        &["I1", "I7", "I9"],
    ),
    (
        "update parameter_set set status = 'released', released_at_ms = (select now_ms + 1000 from clock), release_checks_json = '[{\"passed\":true}]', release_n_passed = 1, release_n_failed = 0
         where status = 'candidate'",
        &["I1", "I7"],
    ),
    ("drop trigger measurement_set_uploader_stays; update measurement_set set uploaded_by = 'key_0'", &["I1", "I9"]),
    ("update parameter_set set released_by = 'key_0' where status = 'released'", &["I1"]),
    ("update parameter_set set release_reason = 'other' where status = 'released'", &["I1"]),
    ("update parameter_set set withdrawn_by = 'key_0' where status = 'withdrawn'", &["I1"]),
    ("drop trigger parameter_set_stays; update parameter_set set sha256 = 'ff'", &["I1", "I9"]),
    ("update job set measurement_set_id = (select max(id) from measurement_set) where status = 'succeeded'", &["I1"]),
    ("update network set metadata_json = '[]'", &["I1"]),
    ("update robot_policy set changed_by = 'key_9'", &["I1"]),
    ("insert into robot_policy (robot_id, independent_session_required, second_person_required, version, changed_by, changed_at_ms)
         select max(id), 0, 0, 1, 'key_0', 1 from robot", &["I1"]),
    ("update idempotency set response_body = x'00'", &["I2"]),
    ("update idempotency set response_body = 'text'", &["I2"]),
    ("update idempotency set location = null", &["I2"]),
    ("drop trigger audit_entry_is_kept; delete from audit where event = 'robot_created'", &["I8", "I9"]),
];

#[test]
fn each_fault_is_told_by_its_check() {
    for (faults, expected) in FAULTS {
        for_each_engine(async |database| {
            let store = &database.store;
            let set = a_set(store, &a_robot(store, "r").await).await;
            insert_examples(store, &set).await;
            an_identified_set(store, &set).await;
            a_job(store, &set, "{}").await;
            assert_eq!(broken(store).await, [""; 0], "before {faults}");
            for fault in faults.split("; ") {
                sqlx::query(AssertSqlSafe(sql_for(store.engine(), fault)))
                    .execute(store.readers())
                    .await
                    .unwrap();
            }
            let found = broken(store).await;
            assert!(
                expected.iter().all(|id| found.contains(id)),
                "{faults}: told by {found:?}"
            );
        });
    }
}

#[test]
fn the_schema_itself_keeps_results_and_frames_as_they_were_found() {
    for_each_engine(async |database| {
        let store = &database.store;
        insert_examples(store, &a_set(store, &a_robot(store, "r").await).await).await;
        for sql in [
            "update job set report_json = '{}'",
            "update job set convergence_json = null",
            "update job set result_sha256 = 'x'",
            "update report_summary set summary_json = '{}'",
            "update estimate set estimate_json = '[]'",
            "update frames set result_json = '[]'",
            "update frames set body = x'00'",
            "update measurement_set set reading_json = '{}'",
            "update named_document set content_json = '[]'",
        ] {
            let refused = sqlx::query(AssertSqlSafe(sql_for(store.engine(), sql)))
                .execute(store.readers())
                .await;
            assert!(
                refused.unwrap_err().to_string().contains("never changed"),
                "{sql}"
            );
        }
        assert_eq!(broken(store).await, [""; 0]);
    });
}

/// Adapts a statement to PostgreSQL: triggers name their table, and bytes have another syntax.
fn sql_for(engine: Engine, sql: &str) -> String {
    if engine == Engine::Sqlite {
        return sql.to_owned();
    }
    match sql.strip_prefix("drop trigger ") {
        Some(name) => {
            let table = [
                "measurement_set",
                "robot",
                "parameter_set",
                "audit",
                "frames",
                "named_document",
                "job",
                "verification",
                "report_summary",
                "estimate",
            ]
            .into_iter()
            .find(|table| name.starts_with(table));
            format!("drop trigger {name} on {}", table.unwrap())
        }
        None => sql.replace("x'00'", "'\\x00'"),
    }
}
