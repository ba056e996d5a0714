//! Particle swarm optimisation [Gao 2018, section 3.1].
//!
//! One iteration moves every particle,
//!
//! ```text
//! v <- w v + c1 r1 (own best - x) + c2 r2 (swarm best - x)     [Gao 2018, eq. 9]
//! x <- x + v                                                   [Gao 2018, eq. 10]
//! ```
//!
//! then evaluates all of them at once and keeps the best. The swarm is synchronous: within one iteration every particle sees the same swarm best, so
//! the order of evaluation does not matter.
//!
//! The paper prints w, c1, c2 and the number of particles. It does not print the bounds, the behaviour at the bounds, a velocity limit, the initial
//! velocities, how r1 and r2 are drawn, or when to stop. [`Options`] has the closest reading of each.

mod options;
mod swarm;

pub use options::{Cost, Options, Positions, SearchBox};

use super::random::LaneRandom;
use std::ops::ControlFlow;
use swarm::Swarm;

/// Streams that separate the uses of one seed.
const STREAM_INITIAL: u64 = 1;
const STREAM_UPDATE: u64 = 2;

/// The information for the monitor, once for the first swarm (iteration 0) and once after each iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Swarm updates done.
    pub iteration: usize,
    /// Maximum number of swarm updates.
    pub n_iterations: usize,
    /// Smallest cost so far.
    pub best_cost: f64,
}

/// Why the search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// All iterations were done.
    IterationLimit,
    /// The best cost reached [`Options::stop_at_cost`].
    CostReached,
    /// The monitor stopped the search.
    Stopped,
}

/// Result of the search.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// The best position that was evaluated.
    pub best_position: Vec<f64>,
    /// Its cost; +∞ if no position had a finite cost.
    pub best_cost: f64,
    /// Swarm updates done.
    pub n_iterations: usize,
    /// Costs evaluated: particles × (iterations + 1).
    pub n_evaluations: usize,
    /// Best cost so far after the first swarm (index 0) and after each iteration; never rises.
    pub convergence: Vec<f64>,
    /// Positions as drawn, before `move_particles` changed them.
    pub initial_positions: Positions,
    /// Each particle's own best position.
    pub own_best_positions: Positions,
    /// Each particle's own best cost.
    pub own_best_costs: Vec<f64>,
    /// Why the search ended.
    pub termination: Termination,
}

/// Changes the positions before they are evaluated. It is called with 0 before the first evaluation, and with k ≥ 1 after update k. It decides itself
/// when to act; velocities and bests stay as they are.
pub type MoveParticles<'a> = dyn FnMut(usize, &mut Positions) + 'a;

/// Receives each iteration; `Break` stops the search.
pub type Monitor<'a> = dyn FnMut(Iteration) -> ControlFlow<()> + 'a;

/// The first swarm as drawn: uniform in the box. [`minimize`] starts from these positions, and the network of [Gao 2018, section 3.2] is trained on
/// them.
///
/// # Panics
/// When centre and half width differ in length.
pub fn initial_positions(search_box: &SearchBox, options: &Options) -> Positions {
    let SearchBox { centre, half_width } = search_box;
    assert_eq!(
        centre.len(),
        half_width.len(),
        "a box has one centre and one half width per coordinate"
    );
    let mut random = LaneRandom::new(options.seed, STREAM_INITIAL);
    let mut positions = Positions::zeros(options.n_particles, centre.len());
    for j in 0..centre.len() {
        let x = positions.coordinate_mut(j);
        random.fill(x);
        for x in x {
            *x = half_width[j].mul_add(2.0 * *x - 1.0, centre[j]);
        }
    }
    positions
}

/// Searches for the minimum of `cost`.
///
/// # Panics
/// When there are no particles, or the box has no coordinates or unequal lengths.
pub fn minimize(
    cost: &mut Cost<'_>,
    search_box: &SearchBox,
    options: &Options,
    mut move_particles: Option<&mut MoveParticles<'_>>,
    monitor: &mut Monitor<'_>,
) -> Summary {
    assert!(
        options.n_particles > 0 && !search_box.centre.is_empty(),
        "a swarm needs particles and coordinates"
    );
    let initial_positions = initial_positions(search_box, options);
    let mut swarm = Swarm::new(&initial_positions);
    let mut random = LaneRandom::new(options.seed, STREAM_UPDATE);
    let mut convergence = Vec::with_capacity(options.n_iterations + 1);
    let mut iteration = 0;
    let termination = loop {
        if let Some(move_particles) = &mut move_particles {
            move_particles(iteration, &mut swarm.positions);
        }
        swarm.evaluate(cost);
        convergence.push(swarm.best_cost);
        let told = Iteration {
            iteration,
            n_iterations: options.n_iterations,
            best_cost: swarm.best_cost,
        };
        if monitor(told).is_break() {
            break Termination::Stopped;
        }
        if options
            .stop_at_cost
            .is_some_and(|target| swarm.best_cost <= target)
        {
            break Termination::CostReached;
        }
        if iteration == options.n_iterations {
            break Termination::IterationLimit;
        }
        swarm.update(options, &mut random);
        iteration += 1;
    };
    Summary {
        best_position: swarm.best_position,
        best_cost: swarm.best_cost,
        n_iterations: iteration,
        n_evaluations: options.n_particles * (iteration + 1),
        convergence,
        initial_positions,
        own_best_positions: swarm.own_best_positions,
        own_best_costs: swarm.own_best_costs,
        termination,
    }
}
