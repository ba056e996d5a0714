//! The seam between the workers and what they compute.

use std::ops::ControlFlow;

use crate::store::{
    FramesRow, JobRow, MeasurementSetRow, NetworkRow, NewNetwork, NewParameterSet, ParameterSetRow,
    Result, RobotRow, Store, frames, jobs, measurement_sets, networks, parameter_sets, robots,
};

/// Computes a job from its inputs alone. Tells its progress at least once per iteration, and stops with
/// [`JobFailure::Cancelled`] when the answer is `Break`. Runs on a thread of its own; may panic.
pub type Compute = fn(
    &JobInputs,
    &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> std::result::Result<JobOutcome, JobFailure>;

/// Everything a job's result depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct JobInputs {
    /// The job, running.
    pub job: JobRow,
    /// Its robot.
    pub robot: RobotRow,
    /// The set to identify from, or to verify on.
    pub set: MeasurementSetInput,
    /// Another set to verify on.
    pub verify_set: Option<MeasurementSetInput>,
    /// Frames found from sweeps.
    pub frames: Option<FramesRow>,
    /// The network to start from.
    pub network: Option<NetworkInput>,
    /// The residual network whose training its own goes on from.
    pub residual_network: Option<NetworkInput>,
    /// The parameter set to verify, or the robot's last identification, to compare with.
    pub parameter_set: Option<ParameterSetInput>,
}

/// A parameter set, and what it was identified from.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterSetInput {
    /// The parameter set.
    pub row: ParameterSetRow,
    /// The points that it was identified from.
    pub set: MeasurementSetInput,
    /// The frames that they were identified with.
    pub frames: Option<FramesRow>,
}

/// A measurement set with its bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSetInput {
    /// What is known about it.
    pub row: MeasurementSetRow,
    /// The uploaded bytes.
    pub body: Vec<u8>,
}

/// A network with its weights.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkInput {
    /// What is known about it.
    pub row: NetworkRow,
    /// Safetensors.
    pub weights: Vec<u8>,
}

/// How far a computation is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Iterations done.
    pub iteration: u64,
    /// The limit.
    pub n_iterations: u64,
    /// Smallest F so far, mm²; not finite if there is none.
    pub best_cost_mm2: f64,
}

/// What a computation gives.
#[derive(Clone, Debug, PartialEq)]
pub struct JobOutcome {
    /// The whole report.
    pub report_json: String,
    /// The convergence curve.
    pub convergence_json: String,
    /// Of the result, hexadecimal.
    pub result_sha256: String,
    /// The parameter set, if one was identified.
    pub parameter_set: Option<NewParameterSet>,
    /// The network, if one was trained.
    pub network: Option<NewNetwork>,
    /// The residual network, if one was kept.
    pub residual_network: Option<NewNetwork>,
}

/// Why a computation gave nothing.
#[derive(Clone, Debug, PartialEq)]
pub enum JobFailure {
    /// Its monitor said `Break`.
    Cancelled,
    /// It cannot be computed, and trying again would not help.
    Failed {
        /// Problem details, as the client gets them.
        problem_json: String,
    },
}

impl Progress {
    /// As it is stored and answered.
    pub(super) fn to_json(self) -> String {
        let Progress {
            iteration,
            n_iterations,
            best_cost_mm2,
        } = self;
        // A number that is not finite becomes null.
        serde_json::json!({ "iteration": iteration, "n_iterations": n_iterations, "best_cost_mm2": best_cost_mm2 }).to_string()
    }
}

impl JobInputs {
    /// Reads a job, and what it names.
    pub async fn load(store: &Store, job_id: &str) -> Result<JobInputs> {
        JobInputs::of(store, jobs::get(store, job_id).await?).await
    }

    /// Reads what the job names.
    pub async fn of(store: &Store, job: JobRow) -> Result<JobInputs> {
        // at once, each on a connection of its own: a job of a few milliseconds should not wait for one after another
        let (robot, set, verify_set, frames, network, residual_network, parameter_set) = tokio::try_join!(
            robots::get(store, &job.robot_id),
            load_set(store, &job.measurement_set_id),
            load(job.verify_set_id.as_deref(), |id| load_set(store, id)),
            load(job.frames_id.as_deref(), |id| frames::get(store, id)),
            load(job.network_input_id.as_deref(), |id| load_network(
                store, id
            )),
            load(job.residual_network_input_id.as_deref(), |id| load_network(
                store, id
            )),
            load(job.parameter_set_input_id.as_deref(), |id| {
                load_parameter_set(store, id)
            }),
        )?;
        Ok(JobInputs {
            job,
            robot,
            set,
            verify_set,
            frames,
            network,
            residual_network,
            parameter_set,
        })
    }
}

/// What an optional reference names.
async fn load<'a, T, F: Future<Output = Result<T>>>(
    id: Option<&'a str>,
    get: impl FnOnce(&'a str) -> F,
) -> Result<Option<T>> {
    match id {
        Some(id) => get(id).await.map(Some),
        None => Ok(None),
    }
}

async fn load_network(store: &Store, id: &str) -> Result<NetworkInput> {
    Ok(NetworkInput {
        row: networks::get(store, id).await?,
        weights: networks::weights(store, id).await?,
    })
}

async fn load_parameter_set(store: &Store, id: &str) -> Result<ParameterSetInput> {
    let row = parameter_sets::get(store, id).await?;
    let job = jobs::get(store, &row.job_id).await?;
    let frames = load(job.frames_id.as_deref(), |id| frames::get(store, id)).await?;
    Ok(ParameterSetInput {
        row,
        set: load_set(store, &job.measurement_set_id).await?,
        frames,
    })
}

async fn load_set(store: &Store, id: &str) -> Result<MeasurementSetInput> {
    let (row, body) = measurement_sets::get_with_body(store, id).await?;
    Ok(MeasurementSetInput { row, body })
}
