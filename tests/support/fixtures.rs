//! Rows that tests start with.

use kincal::jobs::queue;
use kincal::store::leases::{self, Eligible};
use kincal::store::{
    JobRow, Lease, ListRequest, MeasurementSetRow, NewJob, NewMeasurementSet, NewRobot,
    ParameterSetRow, RobotRow, Store, Tx, measurement_sets, parameter_sets, robots,
};
use kincal::wire::canonical;
use kincal::wire::job::Method;
use std::time::Duration;

pub async fn in_transaction<T>(
    store: &Store,
    write: impl AsyncFnOnce(&mut Tx) -> kincal::store::Result<T>,
) -> T {
    let mut tx = store.begin().await.expect("a transaction");
    let written = write(&mut tx).await.expect("the write is accepted");
    tx.commit().await.expect("it is committed");
    written
}

pub async fn a_robot(store: &Store, name: &str) -> RobotRow {
    let new = NewRobot {
        name: name.into(),
        body_json: "{}".into(),
    };
    in_transaction(store, async |tx| robots::insert(tx, &new).await).await
}

pub fn new_set(robot: &RobotRow, body: &[u8]) -> NewMeasurementSet {
    NewMeasurementSet {
        robot_id: robot.id.clone(),
        name: None,
        frame: kincal::wire::measurement::Frame::Base,
        content_type: "text/csv".into(),
        body: body.to_vec(),
        sha256: canonical::sha256_hex(body),
        n_points: 1,
        n_configurations: 1,
        n_targets: 1,
        warnings_json: "[]".into(),
        uploaded_by: Some("key_uploader".into()),
        serial_number: None,
        insisted_on: None,
        reading_json: None,
    }
}

pub async fn a_set(store: &Store, robot: &RobotRow) -> MeasurementSetRow {
    in_transaction(store, async |tx| {
        tx.act_as("key_uploader");
        measurement_sets::insert(tx, &new_set(robot, b"the bytes")).await
    })
    .await
}

pub fn new_job(set: &MeasurementSetRow, request_json: &str) -> NewJob {
    NewJob {
        robot_id: set.robot_id.clone(),
        set_ids: vec![set.id.clone()],
        kind: kincal::wire::job::Kind::Identify,
        method: Method::Auto,
        request_json: request_json.into(),
        ..NewJob::default()
    }
}

/// A job whose request states the behaviour of its computation.
pub async fn a_job(store: &Store, set: &MeasurementSetRow, request_json: &str) -> JobRow {
    in_transaction(store, async |tx| {
        queue::enqueue(tx, &new_job(set, request_json)).await
    })
    .await
}

/// As [`a_job`], with its own robot and set.
pub async fn a_lone_job(store: &Store, request_json: &str) -> JobRow {
    let set = a_set(store, &a_robot(store, "r").await).await;
    a_job(store, &set, request_json).await
}

/// Claims the next waiting job, suspects last.
#[allow(dead_code, reason = "each test binary uses its part")]
pub async fn claim(store: &Store, owner: &str, lease: Duration) -> Option<Lease> {
    for eligible in [Eligible::Unsuspected, Eligible::Suspect] {
        let claimed = in_transaction(store, async |tx| {
            leases::claim_in(tx, eligible, owner, lease).await
        });
        if let Some(job) = claimed.await {
            return Some(Lease::new(&job, owner));
        }
    }
    None
}

/// A list of all items, newest first.
#[allow(dead_code, reason = "each test binary uses its part")]
pub fn everything() -> ListRequest {
    ListRequest::all()
}

/// A candidate and the job that identified it.
#[allow(dead_code, reason = "each test binary uses its part")]
pub async fn a_candidate(store: &Store, set: &MeasurementSetRow) -> ParameterSetRow {
    let job = a_job(store, set, "{}").await;
    let body = format!("{{\"of\":\"{}\"}}", job.id);
    let new = kincal::store::NewParameterSet {
        sha256: canonical::sha256_hex(body.as_bytes()),
        body_json: body,
        estimate_json: None,
    };
    in_transaction(store, async |tx| {
        parameter_sets::insert(tx, &job.id, &new).await
    })
    .await
}
