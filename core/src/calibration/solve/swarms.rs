//! The swarms of a calibration: their start and their search box.

use crate::calibration::problem::Problem;
use crate::calibration::settings::{box_too_small, half_widths};
use crate::calibration::solve::solution::Found;
use crate::calibration::{Error, Event, Monitor};
use crate::identification::KinematicModel;
use crate::identification::model::objective::Observation;
use crate::identification::model::search_space::SearchSpace;
use crate::identification::search::bpnn_pso;
use crate::identification::search::bpnn_pso::links_from_nominal;
use crate::identification::search::swarm::run_swarm;
use crate::solvers::pso;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Standard deviation of the plain warm start's particles about the last answer, as a share of the half-width.
const WARM_START_SPREAD: f64 = 0.05;

/// Start of a swarm.
#[derive(Clone, Copy, PartialEq)]
pub enum Start {
    /// Uniform in the box.
    Cold,
    /// The stored network moves the particles once, before the first evaluation (our reading of figure 5).
    Network,
    /// A Gaussian ball around the last answer, for comparison.
    WarmBall,
}

/// Runs a swarm in the box around a reference.
pub fn swarm(
    problem: &Problem<'_>,
    reference: &KinematicModel,
    start: Start,
    monitor: &mut Monitor<'_>,
) -> Result<Found, Error> {
    // The kernel has one weight per point.
    let even = problem.identify.iter().map(Observation::with_even_noise);
    let identify: Vec<Observation> = even.collect();
    let space = search_space(problem, &identify, reference);
    if space.n_coordinates() == 0 {
        return Err(box_too_small(problem.decomposition.visible_mm));
    }
    let mut move_particles = |iteration: usize, positions: &mut pso::Positions| match (
        iteration,
        start,
        problem.network(),
    ) {
        (0, Start::Network, Some(network)) => {
            bpnn_pso::move_particles(&space, &problem.nominal, network, positions)
        }
        (0, Start::WarmBall, Some(_)) => warm_ball(problem, &space, positions),
        _ => {}
    };
    let mut watch = |i: pso::Iteration| {
        monitor(Event::Iteration {
            iteration: i.iteration,
            n_iterations: i.n_iterations,
            best_cost_mm2: i.best_cost,
        })
    };
    let summary = run_swarm(
        &space,
        &identify,
        problem.loss.bound(),
        &problem.settings.pso,
        Some(&mut move_particles),
        &mut watch,
    );
    let termination = match summary.termination {
        pso::Termination::Stopped => return Err(Error::Cancelled),
        pso::Termination::CostReached => "cost_reached",
        pso::Termination::IterationLimit => "iteration_limit",
    };
    Ok(Found {
        station_motions: vec![],
        model: space.model(&summary.best_position),
        n_iterations: summary.n_iterations,
        n_evaluations: summary.n_evaluations,
        convergence: summary.convergence.clone(),
        termination,
        swarm: Some((space, summary)),
    })
}

/// The search space around a reference: along directions that the points or the priors determine, or in raw parameters.
fn search_space(
    problem: &Problem<'_>,
    identify: &[Observation],
    reference: &KinematicModel,
) -> SearchSpace {
    let (parameters, scale) = (
        problem.parameters.clone(),
        half_widths(&problem.settings, &problem.parameters),
    );
    let reference = reference.clone();
    match (
        problem.settings.singular_directions,
        problem.priors.as_ref().map(|known| &known.priors),
    ) {
        (true, None) => SearchSpace::singular(reference, parameters, scale, identify),
        (true, Some(priors)) => {
            SearchSpace::singular_with_priors(reference, parameters, scale, identify, priors)
        }
        (false, priors) => {
            let known = priors
                .map(|priors| priors.from(&reference))
                .unwrap_or_default();
            SearchSpace::raw(reference, parameters, scale).with_priors(known)
        }
    }
}

/// Normally distributed particles around the last answer (Box and Muller 1958).
fn warm_ball(problem: &Problem<'_>, space: &SearchSpace, positions: &mut pso::Positions) {
    let middle = links_from_nominal(space, &problem.nominal);
    let answer: Vec<f64> = problem
        .answer_deviation()
        .iter()
        .zip(&middle)
        .map(|(answer, middle)| answer - middle)
        .collect();
    let centre = space.coordinates(&answer);
    let mut random = ChaCha8Rng::seed_from_u64(problem.request.seed);
    let mut normal = || {
        let (u, v): (f64, f64) = (1.0 - random.random::<f64>(), random.random());
        (-2.0 * libm::log(u)).sqrt() * libm::cos(std::f64::consts::TAU * v)
    };
    for particle in 0..positions.n_particles {
        let position: Vec<f64> = centre
            .iter()
            .map(|c| c + WARM_START_SPREAD * normal())
            .collect();
        positions.set_particle(particle, &position);
    }
}
