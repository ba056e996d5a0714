//! From a job's stored inputs to `calibration::calibrate` and back: the same inputs give the same outcome on any worker,
//! but for the durations.

use crate::calibration::partial::{Held, calibrate_partially};
use crate::calibration::request::{PreviousSession, VerifySource};
use crate::calibration::{self, CalibrationReport, CalibrationRequest, Event, calibrate};
use crate::jobs::{
    JobFailure, JobInputs, JobOutcome, MeasurementSetInput, ParameterSetInput, Progress,
};
use crate::store::{NewNetwork, NewParameterSet};
use crate::wire::frames::FramesContent;
use crate::wire::job::{JobParts, JobRequestBody, Kind, Model, Preset};
use crate::wire::measurement::{Frame, MeasurementSet, from_upload, n_shared_points};
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::report::{self, RunContext};
use crate::wire::report_shape::{Convergence, Report};
use crate::wire::robot::RobotBody;
use crate::wire::safetensors::{self, ResidualOrigin, StoredNetwork};
use crate::wire::{Invalid, Problem, json};
use std::ops::ControlFlow;
use std::time::Instant;

/// Stages whose name begins so belong to the report's comparison and not to its duration.
const COMPARISON: &str = "compare_";

/// A session that shares more than this part of its points with the identification was not measured anew.
const SHARED: f64 = 0.1;

/// Computes one job.
///
/// # Errors
/// [`JobFailure::Cancelled`] when `progress` breaks, [`JobFailure::Failed`] with the problem that the client gets.
pub fn compute(
    inputs: &JobInputs,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<JobOutcome, JobFailure> {
    let body: JobRequestBody = json::parse(inputs.job.request_json.as_bytes()).map_err(broken)?;
    let request = request_of(inputs)?;
    if body.kind == Kind::Verify {
        return verified(&request, inputs, progress);
    }
    let calibrated = match held_of(&body, &request, inputs)? {
        Some(held) => timed(
            &|monitor| calibrate_partially(&request, &held, monitor),
            progress,
        )?,
        None => calibrated(&request, progress)?,
    };
    // the same points uploaded again are the same session
    let another = matches!(&request.verify, VerifySource::Set(set) if is_anew(&request.set, set));
    let report = calibrated
        .report(
            &inputs.job.id,
            inputs.job.parameter_set_input_id.as_deref(),
            another,
        )
        .map_err(broken)?;
    let content = ParameterSetContent::from_core(&calibrated.core);
    Ok(JobOutcome {
        report_json: serde_json::to_string(&report).map_err(broken)?,
        convergence_json: serde_json::to_string(&report::convergence(&calibrated.core))
            .map_err(broken)?,
        parameter_set: Some(NewParameterSet {
            body_json: serde_json::to_string(&content).map_err(broken)?,
            sha256: content.sha256().map_err(broken)?,
        }),
        residual_network: residual_of(&calibrated.core)?
            .map(new_network)
            .transpose()?,
        network: calibrated.network.map(new_network).transpose()?,
        result_sha256: report.result_sha256,
    })
}

/// The identification that a partial recalibration holds what it does not name at.
fn held_of(
    body: &JobRequestBody,
    request: &CalibrationRequest,
    inputs: &JobInputs,
) -> Result<Option<Held>, JobFailure> {
    if !body.holds_parameter_set() {
        return Ok(None);
    }
    let (Some(input), Some(session)) = (&inputs.parameter_set, &request.previous) else {
        return Err(broken("a partial recalibration without its parameter set"));
    };
    let content: ParameterSetContent =
        serde_json::from_str(&input.row.body_json).map_err(broken)?;
    Ok(Some(Held {
        links: content.links_to_core(),
        session: session.clone(),
    }))
}

/// Scores a parameter set, or the nominal robot; identifies nothing.
fn verified(
    request: &CalibrationRequest,
    inputs: &JobInputs,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<JobOutcome, JobFailure> {
    let parse = |input: &ParameterSetInput| {
        serde_json::from_str::<ParameterSetContent>(&input.row.body_json)
    };
    let identified = inputs
        .parameter_set
        .as_ref()
        .map(parse)
        .transpose()
        .map_err(broken)?
        .map(|content| content.robot_to_core(None));
    let scored = |monitor: &mut calibration::Monitor<'_>| {
        calibration::verify(request, identified.as_ref(), monitor)
    };
    let calibrated = timed(&scored, progress)?;
    let identified_from = inputs
        .parameter_set
        .as_ref()
        .map(|input| set_of(&input.set, request.robot.links.len()))
        .transpose()?;
    let another =
        identified_from.is_none_or(|identified_from| is_anew(&identified_from, &request.set));
    let report = calibrated
        .report(
            &inputs.job.id,
            inputs.job.parameter_set_input_id.as_deref(),
            another,
        )
        .map_err(broken)?;
    Ok(JobOutcome {
        report_json: serde_json::to_string(&report).map_err(broken)?,
        convergence_json: serde_json::to_string(&report::convergence(&calibrated.core))
            .map_err(broken)?,
        parameter_set: None,
        network: None,
        residual_network: None,
        result_sha256: report.result_sha256,
    })
}

/// A finished calibration: what the core found, and when its stages ran.
pub struct Calibrated {
    core: CalibrationReport,
    network: Option<StoredNetwork>,
    clock: StageClock,
}

impl Calibrated {
    /// The wire's report of it.
    ///
    /// # Errors
    /// If it cannot be serialised; does not happen for finite numbers, and only those come here.
    pub fn report(
        &self,
        job_id: &str,
        parameter_set_from: Option<&str>,
        verify_set_is_another: bool,
    ) -> Result<Report, serde_json::Error> {
        let run = RunContext {
            job_id,
            parameter_set_from,
            duration_ms: self.clock.duration_ms(),
            comparison_ms: self
                .core
                .comparison
                .iter()
                .map(|other| self.clock.stage_ms(other.stage))
                .collect(),
            verify_set_is_another,
            network_sha256: self.network.as_ref().map(|network| network.sha256.as_str()),
        };
        report::build(&self.core, &run)
    }

    /// How the cost fell.
    pub fn convergence(&self) -> Convergence {
        report::convergence(&self.core)
    }
}

/// Runs the core with its stages timed and its progress passed on.
///
/// # Errors
/// As [`compute`].
pub fn calibrated(
    request: &CalibrationRequest,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Calibrated, JobFailure> {
    timed(&|monitor| calibrate(request, monitor), progress)
}

/// What the core computes when it is given a monitor.
type Computation<'a> =
    dyn Fn(&mut calibration::Monitor<'_>) -> Result<CalibrationReport, calibration::Error> + 'a;

fn timed(
    computation: &Computation<'_>,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Calibrated, JobFailure> {
    let mut clock = StageClock::start();
    let mut last = Progress {
        iteration: 0,
        n_iterations: 0,
        best_cost_mm2: f64::INFINITY,
    };
    let mut monitor = |event: Event<'_>| {
        clock.note(event);
        if let Event::Iteration {
            iteration,
            n_iterations,
            best_cost_mm2,
        } = event
        {
            last = Progress {
                iteration: iteration as u64,
                n_iterations: n_iterations as u64,
                best_cost_mm2,
            };
        }
        progress(last)
    };
    let core = computation(&mut monitor).map_err(|error| match error {
        calibration::Error::Cancelled => JobFailure::Cancelled,
        calibration::Error::Unusable { code, detail } => failed(&Problem::new(422, code, detail)),
    })?;
    clock.stop();
    if !report::is_finite(&core) {
        let detail = "the result holds a number that is not finite; nothing was kept. Look for a row with a wild value in the set";
        return Err(failed(&Problem::new(422, "result_not_finite", detail)));
    }
    if !report::is_of_a_size(&core) {
        let detail = "the fit ran away to links or targets of more than 10 m; nothing was kept. Look for rows whose joints and position do not belong \
                      together";
        return Err(failed(&Problem::new(422, "fit_diverged", detail)));
    }
    let network = core
        .network
        .as_ref()
        .map(safetensors::write)
        .transpose()
        .map_err(broken)?;
    Ok(Calibrated {
        core,
        network,
        clock,
    })
}

/// The file of the residual network, where one was kept.
fn residual_of(core: &CalibrationReport) -> Result<Option<StoredNetwork>, JobFailure> {
    let Some(network) = core
        .corrected
        .as_ref()
        .and_then(|corrected| corrected.corrections.residual.as_ref())
    else {
        return Ok(None);
    };
    let square = |mm: f64| mm * mm;
    let evidence = core
        .corrections
        .iter()
        .flatten()
        .find(|tried| tried.kind == "residual_network");
    let origin = ResidualOrigin {
        model: Model::from_core(core.model),
        preset: Preset::from_core(core.preset),
        training_error: core
            .identify
            .corrected
            .map_or(0.0, |errors| square(errors.rms_mm)),
        validation_error: evidence.map_or(0.0, |evidence| square(evidence.after_mm)),
    };
    safetensors::write_residual(network, origin)
        .map(Some)
        .map_err(broken)
}

fn new_network(network: StoredNetwork) -> Result<NewNetwork, JobFailure> {
    Ok(NewNetwork {
        model: network.metadata.model.as_str().into(),
        preset: network.metadata.preset.as_str().into(),
        metadata_json: serde_json::to_string(&network.metadata).map_err(broken)?,
        weights: network.bytes,
        weights_sha256: network.sha256,
    })
}

/// The core's request from what is stored.
///
/// # Errors
/// [`JobFailure::Failed`] for what was accepted once and cannot be read any more.
pub fn request_of(inputs: &JobInputs) -> Result<CalibrationRequest, JobFailure> {
    let request: JobRequestBody =
        json::parse(inputs.job.request_json.as_bytes()).map_err(broken)?;
    let body: RobotBody = json::parse(inputs.robot.body_json.as_bytes()).map_err(broken)?;
    let robot = body.to_core().map_err(broken)?;
    let n_joints = robot.links.len();
    let frames = inputs
        .frames
        .as_ref()
        .map(|row| serde_json::from_str::<FramesContent>(&row.result_json));
    let network = inputs
        .network
        .as_ref()
        .map(|network| safetensors::read(&network.weights));
    let residual_network = inputs
        .residual_network
        .as_ref()
        .map(|network| safetensors::read_residual(&network.weights));
    let parts = JobParts {
        set: set_of(&inputs.set, n_joints)?,
        verify_set: inputs
            .verify_set
            .as_ref()
            .map(|set| set_of(set, n_joints))
            .transpose()?,
        frames: frames
            .transpose()
            .map_err(broken)?
            .map(|content| content.to_core()),
        network: network.transpose().map_err(broken)?,
        residual_network: residual_network.transpose().map_err(broken)?,
        previous: previous_of(&request, inputs, n_joints),
        robot,
    };
    request
        .to_core(parts)
        .map_err(|invalid: Invalid| failed(&Problem::new(422, invalid.code, invalid.summary())))
}

/// The session that the robot was last identified from. One that cannot be read any more is not compared with, and the job goes on.
fn previous_of(
    request: &JobRequestBody,
    inputs: &JobInputs,
    n_joints: usize,
) -> Option<PreviousSession> {
    let input = inputs
        .parameter_set
        .as_ref()
        .filter(|_| request.kind == Kind::Identify)?;
    let frames = input
        .frames
        .as_ref()
        .map(|row| serde_json::from_str::<FramesContent>(&row.result_json))
        .transpose()
        .ok()?;
    let set = set_of(&input.set, n_joints).ok()?;
    Some(PreviousSession {
        set,
        frames: frames.map(|content| content.to_core()),
    })
}

fn set_of(input: &MeasurementSetInput, n_joints: usize) -> Result<MeasurementSet, JobFailure> {
    let frame = Frame::parse(&input.row.frame)
        .ok_or_else(|| broken(format!("unknown frame {:?}", input.row.frame)))?;
    from_upload(&input.row.content_type, &input.body, frame, n_joints).map_err(broken)
}

/// Whether points were measured anew, and not taken from the session that something was identified from.
pub fn is_anew(identified_from: &MeasurementSet, points: &MeasurementSet) -> bool {
    n_shared_points(identified_from, points) as f64 <= SHARED * points.points.len() as f64
}

/// What was accepted once cannot be read any more: not the client's fault.
fn broken(cause: impl std::fmt::Display) -> JobFailure {
    tracing::error!(%cause, "a job's stored documents do not fit together");
    failed(&Problem::new(
        500,
        "internal",
        "something that this job needs cannot be read or written; the log has the cause",
    ))
}

fn failed(problem: &Problem) -> JobFailure {
    JobFailure::Failed {
        problem_json: serde_json::json!(problem).to_string(),
    }
}

/// When stages began and how long they took.
struct StageClock {
    begun: Instant,
    whole_ms: f64,
    running: Option<(String, Instant)>,
    ended_ms: Vec<(String, f64)>,
}

impl StageClock {
    fn start() -> Self {
        Self {
            begun: Instant::now(),
            whole_ms: 0.0,
            running: None,
            ended_ms: Vec::new(),
        }
    }

    fn stop(&mut self) {
        self.whole_ms = milliseconds(self.begun);
    }

    fn note(&mut self, event: Event<'_>) {
        match event {
            Event::StageStarted(name) => self.running = Some((name.into(), Instant::now())),
            Event::StageEnded(name) => {
                if let Some((running, since)) = self.running.take_if(|(running, _)| running == name)
                {
                    self.ended_ms.push((running, milliseconds(since)));
                }
            }
            Event::Iteration { .. } | Event::Heartbeat => {}
        }
    }

    fn stage_ms(&self, name: &str) -> f64 {
        self.ended_ms
            .iter()
            .filter(|(stage, _)| stage == name)
            .map(|(_, ms)| ms)
            .sum()
    }

    /// Everything but the comparison.
    fn duration_ms(&self) -> f64 {
        let compared: f64 = self
            .ended_ms
            .iter()
            .filter(|(stage, _)| stage.starts_with(COMPARISON))
            .map(|(_, ms)| ms)
            .sum();
        self.whole_ms - compared
    }
}

/// Microsecond resolution, so that reports stay readable.
fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_micros() as f64 / 1e3
}
