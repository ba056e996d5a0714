//! The flow chart of a calibration, stage by stage.

use crate::calibration::changes::changes;
use crate::calibration::check::check;
use crate::calibration::corrections;
use crate::calibration::known::{KnownBefore, known_before};
use crate::calibration::observe::{Observed, observe};
use crate::calibration::outcome::report;
use crate::calibration::report::{CalibrationReport, MethodComparison};
use crate::calibration::request::{CalibrationRequest, Method, Model, Preset};
use crate::calibration::robust::{PointLoss, robust_fit};
use crate::calibration::screening::{Screening, parameters_of, screen};
use crate::calibration::settings::{Settings, settings};
use crate::calibration::{Error, Event, Monitor, unusable};
use crate::identification::guide::GuidedSwarm;
use crate::identification::identifiability::{Decomposition, prior_scale};
use crate::identification::multistart::{FOUND_MM, best_start};
use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, apply};
use crate::identification::prior_fit::Fitting;
use crate::identification::search_space::{SearchSpace, decomposition_at};
use crate::identification::settle::settle;
use crate::identification::start::fit_base_and_targets;
use crate::identification::swarm::run_bounded_swarm;
use crate::identification::{KinematicModel, TrainedNetwork, bpnn_pso};
use crate::measurement::Subset;
use crate::solvers::{least_squares, pso};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// The plain warm start draws its particles around the last answer with this standard deviation, as a share of the half-width.
const WARM_START_SPREAD: f64 = 0.05;

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
pub fn calibrate(request: &CalibrationRequest, monitor: &mut Monitor<'_>) -> Result<CalibrationReport, Error> {
    check(request)?;
    let problem = Problem::new(request)?;
    let choice = choose(&problem);
    let (method, reason) = (choice.method, choice.reason);
    let mut found = stage(monitor, method.name(), |monitor| match method {
        Method::Pso => swarm(&problem, &choice.start, Start::Cold, monitor),
        Method::BpnnPso => swarm(&problem, &problem.predicted_start(), Start::Network, monitor),
        Method::Auto | Method::LeastSquares => least_squares_from(&problem, &choice.start, problem.settings.pso.stop_at_cost, monitor),
    })?;
    let own = comparison_row(&problem, method.name(), method.name(), &found);
    let network = match (&found.swarm, method) {
        // a network speaks of link parameters; where none is free there is nothing for it to learn
        (Some((space, summary)), Method::Pso) if problem.parameters.iter().any(Parameter::is_link) => {
            let train = || bpnn_pso::train(space, summary, request.seed, request.model(), request.preset);
            Some(stage(monitor, "train_network", |_| Ok(train()))?)
        }
        _ => None,
    };
    if problem.settings.refine && method != Method::LeastSquares {
        let refined = stage(monitor, "refine", |monitor| least_squares_from(&problem, &found.model, None, &mut quiet(monitor)))?;
        found.model = refined.model;
    }
    if request.preset == Preset::Default && problem.settings.refine {
        let counting = problem.loss.reweighted(&found.model, &problem.identify);
        found.model = settle(&found.model, &problem.nominal, problem.fitting(), &counting);
    }
    let corrections = match corrections::are_wanted(request.corrections, request.preset) && problem.priors.is_none() {
        true => stage(monitor, "corrections", |_| Ok(Some(corrections::corrections(&problem, &found.model))))?,
        false => None,
    };
    let comparison = compare(&problem, method, own, monitor)?;
    let mut report = report(&problem, method, reason, found, comparison, network, corrections)?;
    if request.previous.is_some() {
        report.changes = stage(monitor, "compare_sessions", |monitor| changes(request, &mut quiet(monitor)))?;
        report.warnings.extend(report.changes.iter().flat_map(|changes| changes.warnings.iter().cloned()));
    }
    Ok(report)
}

impl<'a> Problem<'a> {
    /// The problem of a request.
    pub fn new(request: &'a CalibrationRequest) -> Result<Self, Error> {
        Self::of(request, observe(request)?)
    }

    /// The problem of a request whose points are already split: screened, and arranged for the fit.
    pub fn of(request: &'a CalibrationRequest, mut observed: Observed) -> Result<Self, Error> {
        let screening = screen(request, &mut observed)?;
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
        let mut problem = Self { request, settings, observed, screening, loss, identify, parameters, nominal, decomposition, priors };
        problem.priors = known_before(&problem)?;
        Ok(problem)
    }

    /// What least squares fits.
    pub fn fitting(&self) -> Fitting<'_> {
        let priors = self.priors.as_ref().map(|known| &known.priors);
        Fitting { parameters: &self.parameters, scale: &self.decomposition.scale, priors }
    }

    /// F of a model, that of the priors included, mm².
    pub fn cost(&self, model: &KinematicModel) -> f64 {
        self.loss.cost(model, &self.identify) + self.fitting().prior_cost_mm2(model)
    }

    /// Half-width of the search box of each parameter; base and targets get as much more as their prior is wider.
    fn half_widths(&self) -> Vec<f64> {
        let half_width = |p: &Parameter| match (p.is_angle(), p.is_link()) {
            (true, _) => self.settings.half_width_rad,
            (false, true) => self.settings.half_width_mm,
            (false, false) => self.settings.half_width_mm * prior_scale(p) / crate::identification::identifiability::PRIOR_LENGTH_MM,
        };
        self.parameters.iter().map(half_width).collect()
    }

    /// The points to identify, those that do not belong without weight.
    pub fn trusted(&self) -> Vec<Observation> {
        let wild: BTreeSet<usize> = self.screening.wild.iter().map(|w| w.row).collect();
        let rows = (0..self.observed.all.len()).filter(|row| self.observed.subsets[*row] == Subset::Identify);
        let weight = |o: &Observation, row: usize| if wild.contains(&row) { 0.0 } else { o.weight };
        self.identify.iter().zip(rows).map(|(o, row)| Observation { weight: weight(o, row), ..o.clone() }).collect()
    }

    fn network(&self) -> Option<&TrainedNetwork> {
        self.request.network.as_ref()
    }

    /// Link deviations of the network's answer, spread over all parameters (base and targets: none).
    fn answer_deviation(&self) -> Vec<f64> {
        let mut answer = self.network().map(|n| n.answer.clone()).unwrap_or_default().into_iter();
        self.parameters.iter().map(|p| if p.is_link() { answer.next().unwrap_or(0.0) } else { 0.0 }).collect()
    }

    /// Nominal links, but base and targets fitted with the links that the network was trained on: the nominal robot would place them
    /// wrongly by as much as the robot errs.
    fn predicted_start(&self) -> KinematicModel {
        if self.request.model() == Model::Paper {
            return self.nominal.clone();
        }
        let links = apply(&self.nominal, &self.parameters, &self.answer_deviation()).links;
        let placed = fit_base_and_targets(&links, &self.identify, self.screening.targets.len());
        KinematicModel { links: self.nominal.links.clone(), ..placed }
    }
}

/// The nominal robot in the frame of the fit. With sweeps, z_t is merged into d of the last link [Gao 2018, section 2.2].
pub fn nominal_model(request: &CalibrationRequest, identify: &[Observation], n_targets: usize) -> KinematicModel {
    let links = &request.robot.links;
    match request.model() {
        Model::Complete => {
            let counting: Vec<Observation> = identify.iter().filter(|o| o.weight > 0.0).cloned().collect();
            fit_base_and_targets(links, &counting, n_targets)
        }
        Model::Paper => {
            let mut model = KinematicModel::nominal(links, n_targets);
            let last = model.links.len() - 1;
            model.links[last].d_mm += request.frames.as_ref().map_or(0.0, |frames| frames.z_tool_mm);
            model
        }
    }
}

/// What runs, from where, and why.
struct Choice {
    method: Method,
    start: KinematicModel,
    reason: String,
}

/// For `auto`: least squares where it finds the robot, from nominal or, where joints are far off, from the best of other joint offsets; a
/// swarm around that where it does not.
fn choose(problem: &Problem<'_>) -> Choice {
    let method = problem.request.method;
    if method != Method::Auto {
        return Choice { method, start: problem.nominal.clone(), reason: "asked for".into() };
    }
    let is_known = problem.request.model() == Model::Paper;
    let best = best_start(&problem.nominal, &problem.parameters, &problem.decomposition.scale, &problem.identify, is_known);
    let from_nominal = format!("least squares from nominal ended with half of the points within {:.3} mm", best.from_nominal_mm);
    let (method, reason) = match (best.n_starts, best.best_mm <= FOUND_MM) {
        (0, _) => (Method::LeastSquares, format!("{from_nominal}: it converges, in a few steps and to the same answer every time")),
        (n, true) => {
            let others = format!("with other joint offsets, placed anew, the {n}th start reached {:.3} mm", best.best_mm);
            (Method::LeastSquares, format!("{from_nominal}, which is no fit; {others}. Check the mastering of the joints"))
        }
        (n, false) => {
            let others = format!("{n} starts with other joint offsets came no nearer than {:.3} mm", best.best_mm);
            (Method::Pso, format!("{from_nominal}, which is no fit, and {others}: a swarm searches around the best of them"))
        }
    };
    Choice { method, start: best.model, reason }
}

/// Runs one stage between its two events.
fn stage<T>(monitor: &mut Monitor<'_>, name: &str, run: impl FnOnce(&mut Monitor<'_>) -> Result<T, Error>) -> Result<T, Error> {
    tell(monitor, Event::StageStarted(name))?;
    let result = run(monitor)?;
    tell(monitor, Event::StageEnded(name))?;
    Ok(result)
}

fn tell(monitor: &mut Monitor<'_>, event: Event<'_>) -> Result<(), Error> {
    if monitor(event).is_break() { Err(Error::Cancelled) } else { Ok(()) }
}

/// Passes on nothing but the question whether to stop: iterations of later stages are not the main method's progress.
fn quiet<'m>(monitor: &'m mut Monitor<'_>) -> impl FnMut(Event<'_>) -> ControlFlow<()> + 'm {
    |event| match event {
        Event::Iteration { .. } => monitor(Event::Heartbeat),
        event => monitor(event),
    }
}

/// Levenberg-Marquardt along the directions that the data see; what they do not see stays at `start`. With another loss than squares,
/// again and again with the weights that it gives. `stop_at_cost_mm2` is the main method's; to refine and to compare, least squares goes on
/// to its end.
pub fn least_squares_from(
    problem: &Problem<'_>,
    start: &KinematicModel,
    stop_at_cost_mm2: Option<f64>,
    monitor: &mut Monitor<'_>,
) -> Result<Found, Error> {
    let stop_at = stop_at_cost_mm2.unwrap_or(0.0);
    let mut watch = |i: least_squares::Iteration| {
        monitor(Event::Iteration { iteration: i.iteration, n_iterations: i.max_iterations, best_cost_mm2: i.cost })
    };
    let fit = match problem.loss {
        PointLoss::Squares => problem.fitting().run(start, &problem.identify, stop_at, &mut watch),
        PointLoss::Bounded { .. } => robust_fit(start, problem.fitting(), &problem.identify, &problem.trusted(), problem.loss, &mut watch),
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

/// What a swarm starts from.
#[derive(Clone, Copy, PartialEq)]
enum Start {
    /// Uniform in the box.
    Cold,
    /// The stored network moves the particles once, before the first evaluation (our reading of figure 5); in the default preset a part
    /// of them, and the network of `guide` moves them on.
    Network,
    /// A Gaussian ball around the last answer, for comparison.
    WarmBall,
}

fn swarm(problem: &Problem<'_>, reference: &KinematicModel, start: Start, monitor: &mut Monitor<'_>) -> Result<Found, Error> {
    let space = search_space(problem, reference);
    let mut guided = guided_swarm(problem, &space).filter(|_| start == Start::Network);
    let mut move_particles = |iteration: usize, positions: &mut pso::Positions| match (iteration, start, problem.network()) {
        (_, Start::Network, Some(network)) if guided.is_some() => {
            if iteration == 0 {
                remember(&space, network, positions);
            }
            guided.iter_mut().for_each(|guided| guided.move_particles(positions));
        }
        (0, Start::Network, Some(network)) => bpnn_pso::move_particles(&space, network, positions),
        (0, Start::WarmBall, Some(_)) => warm_ball(&space, &problem.answer_deviation(), problem.request.seed, positions),
        _ => {}
    };
    let mut watch =
        |i: pso::Iteration| monitor(Event::Iteration { iteration: i.iteration, n_iterations: i.n_iterations, best_cost_mm2: i.best_cost });
    let summary =
        run_bounded_swarm(&space, &problem.identify, problem.loss.bound(), &problem.settings.pso, Some(&mut move_particles), &mut watch);
    let termination = match summary.termination {
        pso::Termination::Stopped => return Err(Error::Cancelled),
        pso::Termination::CostReached => "cost_reached",
        pso::Termination::IterationLimit => "iteration_limit",
    };
    Ok(Found {
        model: space.model(&summary.best_position),
        n_iterations: summary.n_iterations,
        n_evaluations: summary.n_evaluations,
        convergence: summary.convergence.clone(),
        termination,
        swarm: Some((space, summary)),
    })
}

/// The space around a reference: along what the points see, or the priors say something of, or of raw parameters.
fn search_space(problem: &Problem<'_>, reference: &KinematicModel) -> SearchSpace {
    let (parameters, scale) = (problem.parameters.clone(), problem.half_widths());
    let reference = reference.clone();
    match (problem.settings.singular_directions, problem.fitting().priors) {
        (true, None) => SearchSpace::singular(reference, parameters, scale, &problem.identify),
        (true, Some(priors)) => SearchSpace::singular_knowing(reference, parameters, scale, &problem.identify, priors),
        (false, priors) => {
            let known = priors.map(|priors| priors.from(&reference)).unwrap_or_default();
            SearchSpace::raw(reference, parameters, scale).knowing(known)
        }
    }
}

/// In the default preset a second network, trained on what the swarm sees, shows a part of it the way.
fn guided_swarm<'s>(problem: &Problem<'_>, space: &'s SearchSpace) -> Option<GuidedSwarm<'s>> {
    let n_particles = problem.settings.pso.n_particles;
    if !problem.settings.singular_directions || !GuidedSwarm::is_possible(space, n_particles) {
        return None;
    }
    let effects_mm = match problem.priors {
        None => {
            let decomposition = decomposition_at(&space.reference, &space.parameters, &space.scale, &problem.identify);
            decomposition.singular_values[..space.n_coordinates()].to_vec()
        }
        Some(_) => space.effects_mm(&problem.identify),
    };
    Some(GuidedSwarm::new(space, &problem.identify, &effects_mm, problem.request.seed))
}

/// The stored network moves the particles that remember; the others stay where they were drawn.
fn remember(space: &SearchSpace, network: &TrainedNetwork, positions: &mut pso::Positions) {
    let mut predicted = positions.clone();
    bpnn_pso::move_particles(space, network, &mut predicted);
    for particle in GuidedSwarm::remembering(positions.n_particles) {
        positions.set_particle(particle, &predicted.particle(particle));
    }
}

/// Normal numbers around the last answer (Box and Muller 1958).
fn warm_ball(space: &SearchSpace, answer: &[f64], seed: u64, positions: &mut pso::Positions) {
    let centre = space.coordinates(answer);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || {
        let (u, v): (f64, f64) = (1.0 - random.random::<f64>(), random.random());
        (-2.0 * libm::log(u)).sqrt() * libm::cos(std::f64::consts::TAU * v)
    };
    for particle in 0..positions.n_particles {
        let position: Vec<f64> = centre.iter().map(|c| c + WARM_START_SPREAD * normal()).collect();
        positions.set_particle(particle, &position);
    }
}

/// The other methods on the same points: always least squares; for BPNN-PSO also the cold swarm and the plain warm start.
fn compare(
    problem: &Problem<'_>,
    method: Method,
    own: MethodComparison,
    monitor: &mut Monitor<'_>,
) -> Result<Vec<MethodComparison>, Error> {
    let mut rows = vec![own];
    if method != Method::LeastSquares {
        let other =
            stage(monitor, "compare_least_squares", |monitor| least_squares_from(problem, &problem.nominal, None, &mut quiet(monitor)))?;
        rows.push(comparison_row(problem, "least_squares", "compare_least_squares", &other));
    }
    if method == Method::BpnnPso {
        let cold = stage(monitor, "compare_pso", |monitor| swarm(problem, &problem.nominal, Start::Cold, &mut quiet(monitor)))?;
        rows.push(comparison_row(problem, "pso", "compare_pso", &cold));
        let start = problem.predicted_start();
        let warm = stage(monitor, "compare_warm_start", |monitor| swarm(problem, &start, Start::WarmBall, &mut quiet(monitor)))?;
        rows.push(comparison_row(problem, "warm_start", "compare_warm_start", &warm));
    }
    Ok(rows)
}

fn comparison_row(problem: &Problem<'_>, method: &'static str, stage: &'static str, found: &Found) -> MethodComparison {
    MethodComparison {
        method,
        stage,
        n_iterations: found.n_iterations,
        n_evaluations: found.n_evaluations,
        cost_mm2: problem.cost(&found.model),
        verify_after: crate::calibration::outcome::verify_errors(problem, &found.model),
    }
}
