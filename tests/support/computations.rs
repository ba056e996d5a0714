//! Computation of test jobs. The job's request states its behaviour, so one function serves all tests.
//!
//! A computation can wait at a gate, which the test opens, so no test depends on durations.

use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::{Arc, Condvar, LazyLock, Mutex};
use std::time::Duration;

use kincal::jobs::{JobFailure, JobInputs, JobOutcome, JobSignals, WorkerContext};
use kincal::store::{JobRow, NewNetwork, NewParameterSet, Store, jobs};
use kincal::wire::Problem;
use kincal::wire::job::{Model, Preset};
use kincal::wire::job_answer::{ProgressAnswer, Stage};

/// Lease of tests that are not about expired leases.
pub const LONG: Duration = Duration::from_secs(60);
/// Timeout after which a test fails.
const PATIENCE: Duration = Duration::from_secs(30);

pub type Monitor<'a> = &'a mut dyn FnMut(ProgressAnswer) -> ControlFlow<()>;
pub type Computed = Result<JobOutcome, JobFailure>;

/// The problem of a computation that fails.
pub fn problem() -> Box<Problem> {
    Box::new(Problem::new(422, "under_determined", "too few poses"))
}

/// Runs the behaviour in the request.
pub fn run_scripted(inputs: &JobInputs, monitor: Monitor<'_>) -> Computed {
    match inputs.job.request_json.as_str() {
        "succeed" => Ok(outcome(inputs)),
        "fail" => Err(JobFailure::Failed(problem())),
        "panic" => panic!("the computation met something it did not expect"),
        "give up" => Err(JobFailure::Cancelled),
        "report progress, wait at the gate" => {
            for iteration in 1..=3 {
                let _ = monitor(ProgressAnswer {
                    stage: Some(Stage::Corrections),
                    iteration,
                    n_iterations: 10,
                    best_cost_mm2: Some(0.5),
                });
            }
            gate(&inputs.job.id).pass();
            Ok(outcome(inputs))
        }
        "run until stopped" => loop {
            gate(&inputs.job.id).arrive();
            if monitor(ProgressAnswer {
                stage: None,
                iteration: 1,
                n_iterations: 10,
                best_cost_mm2: None,
            })
            .is_break()
            {
                return Err(JobFailure::Cancelled);
            }
            std::thread::park_timeout(Duration::from_millis(1));
        },
        other => panic!("no such computation: {other}"),
    }
}

/// Result of a successful computation; it depends on the inputs alone.
fn outcome(inputs: &JobInputs) -> JobOutcome {
    let report_json = format!(r#"{{"n_bytes":{}}}"#, inputs.sets[0].body.len());
    JobOutcome {
        summary_json: report_json.clone(),
        report_json: report_json.into(),
        convergence_json: r#"{"iteration":[0],"best_cost_mm2":[1.5]}"#.to_owned().into(),
        result_sha256: "abcd".into(),
        parameter_set: Some(NewParameterSet {
            body_json: r#"{"links":[]}"#.into(),
            sha256: "ef".into(),
            estimate_json: None,
        }),
        network: Some(NewNetwork {
            model: Model::Paper,
            preset: Preset::Paper,
            metadata_json: "{}".into(),
            weights: vec![0, 1, 255].into(),
            weights_sha256: "01".into(),
        }),
        residual_network: None,
        verification: None,
    }
}

/// The gate of one job.
#[derive(Default)]
pub struct Gate {
    state: Mutex<(bool, bool)>,
    changed: Condvar,
}

static GATES: LazyLock<Mutex<HashMap<String, Arc<Gate>>>> = LazyLock::new(Mutex::default);

pub fn gate(job_id: &str) -> Arc<Gate> {
    Arc::clone(GATES.lock().unwrap().entry(job_id.to_owned()).or_default())
}

impl Gate {
    fn arrive(&self) {
        self.state.lock().unwrap().0 = true;
        self.changed.notify_all();
    }

    /// Called by the computation.
    fn pass(&self) {
        self.arrive();
        let guard = self.state.lock().unwrap();
        let (_guard, result) = self
            .changed
            .wait_timeout_while(guard, PATIENCE, |(_, open)| !*open)
            .unwrap();
        assert!(!result.timed_out(), "nobody opened the gate");
    }

    /// Called by the test.
    pub fn open(&self) {
        self.state.lock().unwrap().1 = true;
        self.changed.notify_all();
    }
}

/// Waits until the job's computation has reached its gate.
pub async fn arrived(job_id: &str) {
    let gate = gate(job_id);
    let arrived = tokio::task::spawn_blocking(move || {
        let guard = gate.state.lock().unwrap();
        !gate
            .changed
            .wait_timeout_while(guard, PATIENCE, |(arrived, _)| !*arrived)
            .unwrap()
            .1
            .timed_out()
    });
    assert!(arrived.await.unwrap(), "the computation did not begin");
}

/// Polls the job until it satisfies the predicate.
pub async fn until(store: &Store, job_id: &str, wanted: impl Fn(&JobRow) -> bool) -> JobRow {
    let mut looks = tokio::time::interval(Duration::from_millis(5));
    let looking = async {
        loop {
            looks.tick().await;
            let job = jobs::get(store, job_id).await.unwrap();
            if wanted(&job) {
                return job;
            }
        }
    };
    tokio::time::timeout(PATIENCE, looking)
        .await
        .expect("the job never became as wanted")
}

pub fn a_worker(lease: Duration) -> WorkerContext {
    WorkerContext::new(run_scripted, lease, JobSignals::default())
}
