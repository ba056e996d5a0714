//! The flow chart of a calibration, stage by stage.

use crate::calibration::arrangement::Arrangement;
use crate::calibration::changes::changes;
use crate::calibration::check::check;
use crate::calibration::choice::{Choice, choose};
use crate::calibration::corrections;
use crate::calibration::final_fit::{self, final_fit};
use crate::calibration::known::{KnownBefore, known_before};
use crate::calibration::larger_model;
use crate::calibration::motions::parameters_of;
use crate::calibration::observe::{Observed, observe};
use crate::calibration::outcome::{Answer, report, verify_layout, vetoed};
use crate::calibration::report::{CalibrationReport, MethodComparison};
use crate::calibration::request::{CalibrationRequest, Method, Model};
use crate::calibration::robust::PointLoss;
use crate::calibration::screening::{Screening, screen};
use crate::calibration::settings::{Settings, settings};
use crate::calibration::swarms::{Start, swarm};
use crate::calibration::{Error, Event, Monitor, unusable};
use crate::identification::identifiability::{Decomposition, prior_scale};
use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, Quantity, quantity_mut};
use crate::identification::search_space::{SearchSpace, decomposition_at};
use crate::identification::start::{fit_base_and_targets, fit_targets};
use crate::identification::{KinematicModel, TrainedNetwork, bpnn_pso};
use crate::kinematics::Link;
use crate::measurement::{Frame, Subset};
use crate::solvers::{least_squares, pso};
use std::collections::BTreeSet;
use std::f64::consts::TAU;
use std::ops::ControlFlow;

/// Everything that does not change while methods run on a request.
pub struct Problem<'a> {
    /// The request.
    pub request: &'a CalibrationRequest,
    /// Resolved options.
    pub settings: Settings,
    /// All points as they are fitted, with their subsets.
    pub observed: Observed,
    /// Which points do not belong, and what moved.
    pub screening: Screening,
    /// Segments and set-ups of the points.
    pub arrangement: Arrangement,
    /// How a residual counts.
    pub loss: PointLoss,
    /// What is fitted.
    pub identify: Vec<Observation>,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// The nominal robot, with base and targets fitted where they are unknown: "before", and what least squares starts from.
    pub nominal: KinematicModel,
    /// What the identify subset can see, at the nominal robot, scaled by the stated priors.
    pub decomposition: Decomposition,
    /// What is known of the parameters beforehand.
    pub priors: Option<KnownBefore>,
}

/// A method's answer.
pub struct Found {
    /// The identified model.
    pub model: KinematicModel,
    /// Iterations done.
    pub n_iterations: usize,
    /// Cost evaluations done.
    pub n_evaluations: usize,
    /// Smallest F after each iteration.
    pub convergence: Vec<f64>,
    /// Why it stopped.
    pub termination: &'static str,
    /// The swarm behind it and the space it ran in, for the network.
    pub swarm: Option<(SearchSpace, pso::Summary)>,
}

/// Runs one calibration. Pure: the same request gives the same report, bit for bit.
///
/// # Errors
/// [`Error::Unusable`] for a request that cannot be identified from, [`Error::Cancelled`] when the monitor breaks.
pub fn calibrate(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    let (problem, choice) = stage(monitor, "screening", |_| {
        check(request)?;
        let problem = Problem::new(request)?;
        let choice = choose(&problem);
        Ok((problem, choice))
    })?;
    let method = choice.method;
    let mut found = stage(monitor, method.as_str(), |monitor| match method {
        Method::Pso => swarm(&problem, &choice.start, Start::Cold, monitor),
        Method::BpnnPso => swarm(&problem, &choice.start, Start::Network, monitor),
        Method::Auto | Method::LeastSquares => least_squares_from(
            &problem,
            &choice.start,
            problem.settings.pso.stop_at_cost,
            monitor,
        ),
    })?;
    let own = comparison_row(&problem, method.as_str(), method.as_str(), &found);
    let network = match (&found.swarm, method) {
        // a network speaks of link parameters; where none is free there is nothing for it to learn
        (Some((space, summary)), Method::Pso)
            if problem.parameters.iter().any(Parameter::is_link) =>
        {
            let train = || {
                bpnn_pso::train(
                    space,
                    &problem.nominal,
                    summary,
                    request.seed,
                    request.model(),
                    request.preset,
                )
            };
            Some(stage(monitor, "train_network", |_| Ok(train()))?)
        }
        _ => None,
    };
    if problem.settings.refine && method != Method::LeastSquares {
        let refined = stage(monitor, "refine", |monitor| {
            least_squares_from(&problem, &found.model, None, &mut quiet(monitor))
        })?;
        found.model = refined.model;
    }
    found.model.links = unwound(found.model.links, &problem.nominal.links);
    let too_small = larger_model::remark(&problem, &found.model, &mut quiet(monitor))?;
    let are_wanted = corrections::are_wanted(request.corrections, request.preset);
    let corrections = match are_wanted && problem.priors.is_none() {
        true => stage(monitor, "corrections", |monitor| {
            Ok(Some(corrections::corrections(
                &problem,
                &found.model,
                monitor,
            )))
        })?,
        false => None,
    };
    let comparison = compare(&problem, &choice, own, monitor)?;
    let problem = problem.with_tool_of(&found.model);
    let layout = verify_layout(&problem, &found.model)?;
    let (corrections, vetoed) = vetoed(&problem, &found.model, layout.as_ref(), corrections)?;
    let (delivered, subsets_differ) = match final_fit::is_wanted(&problem) {
        true => stage(monitor, "final_fit", |monitor| {
            final_fit(&problem, &found.model, corrections.as_ref(), monitor)
        })?,
        false => (None, None),
    };
    let mut report = stage(monitor, "uncertainty", |_| {
        report(
            &problem,
            Answer {
                method,
                method_reason: choice.reason,
                found,
                comparison,
                network,
                corrections,
                delivered: delivered.as_ref(),
            },
            layout.as_ref(),
        )
    })?;
    report.warnings.extend(vetoed);
    report.warnings.extend(subsets_differ);
    report.warnings.extend(too_small);
    report
        .warnings
        .extend((are_wanted && problem.priors.is_some()).then(corrections::left_out_for_priors));
    if request.previous.is_some() {
        report.changes = stage(monitor, "compare_sessions", |monitor| {
            let fitted = delivered.as_ref().filter(|_| request.priors.is_empty());
            changes(request, fitted, &mut quiet(monitor))
        })?;
        report.warnings.extend(
            report
                .changes
                .iter()
                .flat_map(|changes| changes.warnings.iter().cloned()),
        );
    }
    Ok(report)
}

/// The same robot with each angle within half a turn of its nominal value: a fit that came from afar may have gone round.
fn unwound(mut links: Vec<Link>, nominal: &[Link]) -> Vec<Link> {
    for (link, nominal) in links.iter_mut().zip(nominal) {
        for quantity in [Quantity::Alpha, Quantity::ThetaOffset, Quantity::Beta] {
            let expected = *quantity_mut(&mut nominal.clone(), quantity);
            let angle = quantity_mut(link, quantity);
            let turns = ((*angle - expected) / TAU).round();
            if turns != 0.0 {
                *angle -= turns * TAU;
            }
        }
    }
    links
}

impl<'a> Problem<'a> {
    /// The same with what the points see taken at the nominal robot with its tool: in the paper's model the reflector's height is part of
    /// the last d, of which nominal values know nothing, and on it depends what a reflector shows.
    pub fn with_tool_of(self, model: &KinematicModel) -> Self {
        match self.request.model() {
            Model::Complete => self,
            Model::Paper => self.decomposed_with_tool_of(model),
        }
    }

    /// The same for any model: the complete one has its tool in the targets.
    pub fn decomposed_with_tool_of(self, model: &KinematicModel) -> Self {
        let mut tooled = self.nominal.clone();
        if let (Model::Paper, Some(last)) = (self.request.model(), tooled.links.last_mut()) {
            last.d_mm = model.links[model.links.len() - 1].d_mm;
        }
        let decomposition = decomposition_at(
            &tooled,
            &self.parameters,
            &self.decomposition.scale,
            &self.identify,
        );
        Self {
            decomposition,
            ..self
        }
    }

    /// The problem of a request.
    pub fn new(request: &'a CalibrationRequest) -> Result<Self, Error> {
        Self::of(request, observe(request)?)
    }

    /// The problem of a request whose points are already split: screened, and arranged for the fit.
    pub fn of(request: &'a CalibrationRequest, mut observed: Observed) -> Result<Self, Error> {
        let (screening, arrangement) = screen(request, &mut observed)?;
        let identify = observed.of(Subset::Identify);
        let parameters = parameters_of(request, &screening.targets)?;
        let nominal = nominal_model(request, &identify, screening.targets.len());
        let scale: Vec<f64> = parameters.iter().map(prior_scale).collect();
        let decomposition = decomposition_at(&nominal, &parameters, &scale, &identify);
        if decomposition.rank() == 0 {
            return Err(unusable(
                "nothing_to_identify",
                "the measured positions depend on none of the free parameters: free others as well",
            ));
        }
        let loss = PointLoss::of(request, &screening);
        let (settings, priors) = (settings(request), None);
        let mut problem = Self {
            request,
            settings,
            observed,
            screening,
            arrangement,
            loss,
            identify,
            parameters,
            nominal,
            decomposition,
            priors,
        };
        problem.priors = known_before(&problem)?;
        Ok(problem)
    }

    /// F of a model, that of the request's priors included, mm².
    pub fn cost(&self, model: &KinematicModel) -> f64 {
        let of_priors = self
            .priors
            .as_ref()
            .map_or(0.0, |known| known.priors.cost_mm2(model));
        self.loss.cost(model, &self.identify) + of_priors
    }

    /// The points to identify, those that do not belong without weight.
    pub fn trusted(&self) -> Vec<Observation> {
        let wild: BTreeSet<usize> = self.screening.wild.iter().map(|w| w.row).collect();
        let rows = (0..self.observed.all.len())
            .filter(|row| self.observed.subsets[*row] == Subset::Identify);
        let weight = |o: &Observation, row: usize| if wild.contains(&row) { 0.0 } else { o.weight };
        self.identify
            .iter()
            .zip(rows)
            .map(|(o, row)| Observation {
                weight: weight(o, row),
                ..o.clone()
            })
            .collect()
    }

    /// The network that the job may start from.
    pub fn network(&self) -> Option<&TrainedNetwork> {
        self.request.network.as_ref()
    }

    /// Link deviations of the network's answer from nominal, spread over all parameters (base and targets: none).
    pub fn answer_deviation(&self) -> Vec<f64> {
        let mut answer = self
            .network()
            .map(|n| n.answer.clone())
            .unwrap_or_default()
            .into_iter();
        self.parameters
            .iter()
            .map(|p| {
                if p.is_link() {
                    answer.next().unwrap_or(0.0)
                } else {
                    0.0
                }
            })
            .collect()
    }
}

/// The nominal robot in the frame of the fit. With sweeps, z_t is merged into d of the last link [Gao 2018, section 2.2].
pub fn nominal_model(
    request: &CalibrationRequest,
    identify: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    let mut links = request.robot.links.clone();
    let frames = request.frames.as_ref();
    if let (Model::Paper, Some(frames), Some(last)) = (request.model(), frames, links.last_mut()) {
        last.d_mm += frames.z_tool_mm;
    }
    let counting: Vec<Observation> = identify
        .iter()
        .filter(|o| o.weight > 0.0)
        .cloned()
        .collect();
    placed(request, links, &counting, n_targets)
}

/// A robot with these links: base and targets fitted where the request's model and frame leave them unknown.
pub fn placed(
    request: &CalibrationRequest,
    links: Vec<Link>,
    observations: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    match (request.model(), request.set.frame) {
        (Model::Paper, _) => KinematicModel::nominal(&links, n_targets),
        (Model::Complete, Frame::Base) => fit_targets(&links, observations, n_targets),
        (Model::Complete, Frame::Instrument) => {
            fit_base_and_targets(&links, observations, n_targets)
        }
    }
}

/// Runs one stage between its two events.
pub fn stage<T>(
    monitor: &mut Monitor<'_>,
    name: &str,
    run: impl FnOnce(&mut Monitor<'_>) -> Result<T, Error>,
) -> Result<T, Error> {
    tell(monitor, Event::StageStarted(name))?;
    let result = run(monitor)?;
    tell(monitor, Event::StageEnded(name))?;
    Ok(result)
}

fn tell(monitor: &mut Monitor<'_>, event: Event<'_>) -> Result<(), Error> {
    if monitor(event).is_break() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}

/// Passes on nothing but the question whether to stop: iterations of later stages are not the main method's progress.
pub fn quiet<'m>(monitor: &'m mut Monitor<'_>) -> impl FnMut(Event<'_>) -> ControlFlow<()> + 'm {
    |event| match event {
        Event::Iteration { .. } => monitor(Event::Heartbeat),
        event => monitor(event),
    }
}

/// Least squares: the most probable robot. With another loss than squares, again and again with the weights that it gives.
/// `stop_at_cost_mm2` is the main method's; to refine and to compare, least squares goes on to its end.
pub fn least_squares_from(
    problem: &Problem<'_>,
    start: &KinematicModel,
    stop_at_cost_mm2: Option<f64>,
    monitor: &mut Monitor<'_>,
) -> Result<Found, Error> {
    let stop_at = stop_at_cost_mm2.unwrap_or(0.0);
    let mut watch = |i: least_squares::Iteration| {
        monitor(Event::Iteration {
            iteration: i.iteration,
            n_iterations: i.max_iterations,
            best_cost_mm2: i.cost,
        })
    };
    let fit = match problem.loss {
        PointLoss::Squares => problem.fit(start, stop_at, &mut watch),
        PointLoss::Bounded { .. } => problem.robust_fit(start, &mut watch),
    };
    if fit.termination == least_squares::Termination::Stopped {
        return Err(Error::Cancelled);
    }
    Ok(Found {
        model: fit.model,
        n_iterations: fit.n_iterations,
        n_evaluations: fit.n_evaluations,
        convergence: fit.convergence,
        termination: least_squares_termination(fit.termination),
        swarm: None,
    })
}

fn least_squares_termination(termination: least_squares::Termination) -> &'static str {
    match termination {
        least_squares::Termination::CostReached => "cost_reached",
        least_squares::Termination::IterationLimit => "iteration_limit",
        least_squares::Termination::NotFinite => "not_finite",
        t if t.converged() => "converged",
        _ => "stopped",
    }
}

/// The other methods on the same points: always least squares; for BPNN-PSO also the cold swarm and the plain warm start.
fn compare(
    problem: &Problem<'_>,
    choice: &Choice,
    own: MethodComparison,
    monitor: &mut Monitor<'_>,
) -> Result<Vec<MethodComparison>, Error> {
    let mut rows = vec![own];
    if choice.method != Method::LeastSquares {
        let other = stage(monitor, "compare_least_squares", |monitor| {
            least_squares_from(problem, &problem.nominal, None, &mut quiet(monitor))
        })?;
        rows.push(comparison_row(
            problem,
            "least_squares",
            "compare_least_squares",
            &other,
        ));
    }
    if choice.method == Method::BpnnPso {
        let cold = stage(monitor, "compare_pso", |monitor| {
            swarm(
                problem,
                &choice.cold_start,
                Start::Cold,
                &mut quiet(monitor),
            )
        })?;
        rows.push(comparison_row(problem, "pso", "compare_pso", &cold));
        let warm = stage(monitor, "compare_warm_start", |monitor| {
            swarm(problem, &choice.start, Start::WarmBall, &mut quiet(monitor))
        })?;
        rows.push(comparison_row(
            problem,
            "warm_start",
            "compare_warm_start",
            &warm,
        ));
    }
    Ok(rows)
}

fn comparison_row(
    problem: &Problem<'_>,
    method: &'static str,
    stage: &'static str,
    found: &Found,
) -> MethodComparison {
    MethodComparison {
        method,
        stage,
        n_iterations: found.n_iterations,
        n_evaluations: found.n_evaluations,
        cost_mm2: problem.cost(&found.model),
        verify_after: crate::calibration::outcome::verify_errors(problem, &found.model),
    }
}
