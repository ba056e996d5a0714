//! Runs a job: computes its request, and converts the result to rows. Except for durations, the same inputs give the same result on any worker.

use crate::calibration::partial::{Held, calibrate_partially};
use crate::calibration::{
    self, CalibrationReport, CalibrationRequest, Event, ReleasedSet, calibrate,
};
use crate::jobs::estimate::{estimate_json, stored_estimate};
use crate::jobs::measurement_age::measurement_age;
use crate::jobs::request::{insisted_on, parse_requests, parse_uploads};
use crate::jobs::{JobFailure, JobInputs, JobOutcome, ParameterSetInput};
use crate::release::facts::{FIT_DIVERGED, evidence_of, identification_facts, session_facts};
use crate::release::independence::{is_another_session, is_verified_anew};
use crate::release::{insisted_warning, is_usable};
use crate::store::{NewNetwork, NewParameterSet};
use crate::wire::Problem;
use crate::wire::job::{JobRequestBody, Kind};
use crate::wire::job_answer::{ProgressAnswer, Stage};
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::report::{self, RunContext};
use crate::wire::report_shape::{Convergence, Report};
use crate::wire::report_summary::summary_json;
use crate::wire::robot::MAX_LENGTH_MM;
use crate::wire::safetensors::{self, ResidualOrigin, StoredNetwork};
use crate::wire::verification::Verification;
use std::ops::ControlFlow;
use std::time::Instant;

/// The stages that compute the report's comparison of methods. Their time is not part of the job's duration.
const METHOD_COMPARISONS: [Stage; 3] = [
    Stage::CompareLeastSquares,
    Stage::ComparePso,
    Stage::CompareWarmStart,
];

/// Computes one job.
///
/// # Errors
/// [`JobFailure::Cancelled`] when `progress` breaks, [`JobFailure::Failed`] with the problem that the client gets.
pub fn compute(
    inputs: &JobInputs,
    progress: &mut dyn FnMut(ProgressAnswer) -> ControlFlow<()>,
) -> Result<JobOutcome, JobFailure> {
    let (body, request) = parse_requests(inputs)?;
    if body.kind.scores() {
        return run_verification(&body, &request, inputs, progress);
    }
    let calibrated = match held_values(&body, &request, inputs)? {
        Some(held) => run_timed(
            &|monitor| calibrate_partially(&request, &held, monitor),
            progress,
        )?,
        None => run_calibration(&request, progress)?,
    };
    let another = is_verified_anew(&request, &parse_uploads(&inputs.sources, &request)?);
    let age = measurement_age(inputs, &request);
    let facts = |report: &Report| identification_facts(&request, report, another, age);
    let outcome = outcome(inputs, &calibrated, another, facts)?;
    let content = calibrated.parameters();
    Ok(JobOutcome {
        parameter_set: Some(NewParameterSet {
            body_json: serde_json::to_string(&content).map_err(JobFailure::internal)?,
            sha256: content.sha256().map_err(JobFailure::internal)?,
            estimate_json: estimate_json(&calibrated.core, inputs).map_err(JobFailure::internal)?,
        }),
        residual_network: residual_network_file(&calibrated.core)?
            .filter(|_| request.refused_as.is_none())
            .map(NewNetwork::try_from)
            .transpose()
            .map_err(JobFailure::internal)?,
        network: calibrated
            .network
            .map(NewNetwork::try_from)
            .transpose()
            .map_err(JobFailure::internal)?,
        ..outcome
    })
}

/// The outcome of a job, without the parameter set and the networks, which only an identification stores.
fn outcome(
    inputs: &JobInputs,
    calibrated: &Calibrated,
    is_another_session: bool,
    facts: impl FnOnce(&Report) -> Verification,
) -> Result<JobOutcome, JobFailure> {
    let mut report = calibrated
        .report(
            &inputs.job.id,
            inputs.job.parameter_set_input_id.as_deref(),
            is_another_session,
            insisted_on(inputs),
        )
        .map_err(JobFailure::internal)?;
    report.measured_at = inputs.measured_at();
    let report_json = serde_json::to_string(&report).map_err(JobFailure::internal)?;
    Ok(JobOutcome {
        summary_json: summary_json(&report_json).map_err(JobFailure::internal)?,
        report_json: report_json.into(),
        convergence_json: serde_json::to_string(&calibrated.convergence())
            .map_err(JobFailure::internal)?
            .into(),
        verification: Some(facts(&report)),
        parameter_set: None,
        network: None,
        residual_network: None,
        result_sha256: report.result_sha256,
    })
}

/// The earlier identification, for a partial recalibration: the parameters that the request does not name keep its values.
fn held_values(
    body: &JobRequestBody,
    request: &CalibrationRequest,
    inputs: &JobInputs,
) -> Result<Option<Held>, JobFailure> {
    if !body.holds_parameter_set() {
        return Ok(None);
    }
    let (Some(input), Some(session)) = (&inputs.parameter_set, &request.previous) else {
        return Err(JobFailure::internal(
            "a partial recalibration without its parameter set",
        ));
    };
    let content: ParameterSetContent =
        serde_json::from_str(&input.row.body_json).map_err(JobFailure::internal)?;
    Ok(Some(Held {
        links: content.kinematic_links(),
        session: session.clone(),
    }))
}

/// Verifies or checks a parameter set, or verifies the nominal robot; identifies nothing.
pub(super) fn run_verification(
    body: &JobRequestBody,
    request: &CalibrationRequest,
    inputs: &JobInputs,
    progress: &mut dyn FnMut(ProgressAnswer) -> ControlFlow<()>,
) -> Result<JobOutcome, JobFailure> {
    let parse = |input: &ParameterSetInput| {
        serde_json::from_str::<ParameterSetContent>(&input.row.body_json)
    };
    let identified = inputs
        .parameter_set
        .as_ref()
        .map(parse)
        .transpose()
        .map_err(JobFailure::internal)?
        .map(|content| content.identified_robot(None));
    let checked = identified.as_ref().filter(|_| body.kind == Kind::Check);
    let estimate_json = inputs.parameter_set.as_ref().filter(|_| checked.is_some());
    let estimate_json = estimate_json.and_then(|input| input.estimate_json.as_deref());
    let estimate =
        stored_estimate(estimate_json, &inputs.robot, None).map_err(JobFailure::internal)?;
    let identified_from = match &inputs.parameter_set {
        Some(input) => parse_uploads(input.sets.iter().chain(&input.sources), request)?,
        None => vec![],
    };
    let another = is_another_session(&request.robot, &request.set, &identified_from);
    let age = measurement_age(inputs, request);
    let scored = |monitor: &mut calibration::Monitor<'_>| match checked {
        Some(robot) => {
            let released = ReleasedSet {
                robot,
                estimate: estimate.as_ref(),
                after: body.after,
                is_measured_anew: another && !age.is_repeat,
                is_insisted_on: insisted_on(inputs).is_some(),
            };
            calibration::check_released(request, &released, monitor)
        }
        None => calibration::verify(request, identified.as_ref(), monitor),
    };
    let calibrated = run_timed(&scored, progress)?;
    let facts = |report: &Report| session_facts(request, report, age);
    outcome(inputs, &calibrated, another, facts)
}

/// A finished calibration: the core's report and the durations of its stages.
pub struct Calibrated {
    core: CalibrationReport,
    network: Option<StoredNetwork>,
    clock: StageClock,
}

impl Calibrated {
    /// The report as it is stored and answered.
    pub fn report(
        &self,
        job_id: &str,
        parameter_set_from: Option<&str>,
        is_another_session: bool,
        insisted_on: Option<&str>,
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
            evidence: evidence_of(&self.core, insisted_on.is_some(), is_another_session),
            network_sha256: self.network.as_ref().map(|network| network.sha256.as_str()),
            insisted: insisted_on.map(insisted_warning),
        };
        report::build(&self.core, &run)
    }

    /// The identified parameters, as they are stored and exported.
    pub fn parameters(&self) -> ParameterSetContent {
        ParameterSetContent::from(&self.core)
    }

    /// The convergence curve.
    pub fn convergence(&self) -> Convergence {
        report::convergence(&self.core)
    }
}

/// Runs the core, times its stages and passes its progress on.
pub fn run_calibration(
    request: &CalibrationRequest,
    progress: &mut dyn FnMut(ProgressAnswer) -> ControlFlow<()>,
) -> Result<Calibrated, JobFailure> {
    let mut calibrated = run_timed(&|monitor| calibrate(request, monitor), progress)?;
    if request.refused_as.is_some() {
        // A later job could start from this network without any hint that its upload was insisted on.
        calibrated.network = None;
    }
    Ok(calibrated)
}

/// A computation of the core that reports to a monitor.
type Computation<'a> =
    dyn Fn(&mut calibration::Monitor<'_>) -> Result<CalibrationReport, calibration::Error> + 'a;

fn run_timed(
    computation: &Computation<'_>,
    progress: &mut dyn FnMut(ProgressAnswer) -> ControlFlow<()>,
) -> Result<Calibrated, JobFailure> {
    let mut clock = StageClock::start();
    let mut last = ProgressAnswer {
        stage: None,
        iteration: 0,
        n_iterations: 0,
        best_cost_mm2: None,
    };
    let mut monitor = |event: Event<'_>| {
        clock.note(event);
        match event {
            Event::StageStarted(name) => last.stage = Stage::parse(name),
            Event::Iteration {
                iteration,
                n_iterations,
                best_cost_mm2,
            } => {
                last = ProgressAnswer {
                    iteration: iteration as u64,
                    n_iterations: n_iterations as u64,
                    best_cost_mm2: best_cost_mm2.is_finite().then_some(best_cost_mm2),
                    ..last
                }
            }
            Event::Heartbeat | Event::StageEnded(_) => {}
        }
        progress(last)
    };
    let core = computation(&mut monitor).map_err(|error| match error {
        calibration::Error::Cancelled => JobFailure::Cancelled,
        calibration::Error::Unusable { code, detail } => {
            JobFailure::failed(Problem::new(422, code, detail))
        }
    })?;
    clock.stop();
    if !is_finite(&core) {
        let detail = "the result holds a number that is not finite; nothing was stored. Look for a row with an extreme value in the set";
        return Err(JobFailure::failed(Problem::new(
            422,
            "result_not_finite",
            detail,
        )));
    }
    if !has_plausible_size(&core) {
        let detail = "the fit diverged: links or targets of more than 10 m; nothing was stored. Look for rows whose joints and position do not belong \
                      together";
        return Err(JobFailure::failed(Problem::new(422, FIT_DIVERGED, detail)));
    }
    // The network of a result that cannot be used is not stored.
    let network = core
        .network
        .as_ref()
        .filter(|_| is_usable(&core))
        .map(safetensors::write)
        .transpose()
        .map_err(JobFailure::internal)?;
    Ok(Calibrated {
        core,
        network,
        clock,
    })
}

/// The safetensors file of the residual network, if the corrections use one.
fn residual_network_file(core: &CalibrationReport) -> Result<Option<StoredNetwork>, JobFailure> {
    let Some(network) = core
        .corrected
        .as_ref()
        .filter(|_| is_usable(core))
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
        model: core.model,
        preset: core.preset,
        training_error: core
            .identify
            .corrected
            .map_or(0.0, |errors| square(errors.rms_mm)),
        validation_error: evidence.map_or(0.0, |evidence| {
            square(evidence.cross_validated_rms_mm_after)
        }),
    };
    safetensors::write_residual(network, origin)
        .map(Some)
        .map_err(JobFailure::internal)
}

/// Measures how long stages take.
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

    /// Duration without the comparison of methods.
    fn duration_ms(&self) -> f64 {
        let compared = METHOD_COMPARISONS.map(|stage| self.stage_ms(stage.as_str()));
        self.whole_ms - compared.iter().sum::<f64>()
    }
}

/// Milliseconds since an instant, with microsecond resolution.
fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_micros() as f64 / 1e3
}

/// Whether links and targets have plausible sizes. A fit to rows that do not belong together may diverge.
fn has_plausible_size(core: &CalibrationReport) -> bool {
    let links = core.links.iter().flat_map(|l| [l.a_mm, l.d_mm]);
    let targets = core.targets_mm.iter().flat_map(|t| [t.x, t.y, t.z]);
    links.chain(targets).all(|mm| mm.abs() <= MAX_LENGTH_MM)
}

/// Whether all numbers of the result are finite. JSON cannot represent other numbers.
fn is_finite(core: &CalibrationReport) -> bool {
    let subsets = [Some(&core.identify), core.verify.as_ref()];
    let errors = subsets
        .into_iter()
        .flatten()
        .flat_map(|s| [Some(s.before), Some(s.after), s.corrected])
        .flatten();
    let compared = core.comparison.iter().filter_map(|c| c.verify_after);
    let statistics = errors
        .chain(compared)
        .flat_map(|e| [e.mean_mm, e.std_mm, e.rms_mm, e.max_mm]);
    let parameters = core
        .parameters
        .iter()
        .flat_map(|p| [p.nominal, p.identified, p.delta]);
    let points = core.per_point.iter().flat_map(|p| {
        [
            p.before_mm,
            p.after_mm,
            p.corrected_vector_mm.map_or(0.0, |v| v.norm()),
        ]
    });
    let links = core
        .links
        .iter()
        .flat_map(|l| [l.a_mm, l.alpha_rad, l.d_mm, l.theta_offset_rad, l.beta_rad]);
    let base = core.t_instrument_base.to_homogeneous();
    let targets = core.targets_mm.iter().flat_map(|t| [t.x, t.y, t.z]);
    let costs = core
        .comparison
        .iter()
        .map(|c| c.cost_mm2)
        .chain(core.convergence_mm2.iter().copied())
        .chain([core.cost_mm2]);
    statistics
        .chain(parameters)
        .chain(points)
        .chain(links)
        .chain(base.iter().copied())
        .chain(targets)
        .chain(costs)
        .all(f64::is_finite)
}
