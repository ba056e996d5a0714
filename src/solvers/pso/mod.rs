//! Particle swarm optimisation [Gao 2018, section 3.1].
//!
//! One iteration moves every particle,
//!
//! ```text
//! v <- w v + c1 r1 (own best - x) + c2 r2 (swarm best - x)     [Gao 2018, eq. 9]
//! x <- x + v                                                   [Gao 2018, eq. 10]
//! ```
//!
//! then evaluates all of them at once and keeps the best (a synchronous swarm: within one iteration every particle
//! sees the same swarm best, so the order of evaluation does not matter).
//!
//! The paper prints w, c1, c2 and the number of particles. It does not print the bounds, what happens at them, a limit
//! of the velocity, the first velocities, how r1 and r2 are drawn, or when to stop: each is an option here, and its
//! default is the closest reading.

mod swarm;

use super::random::LaneRandom;
use std::ops::ControlFlow;
use swarm::Swarm;

/// Separate uses of one seed.
const STREAM_INITIAL: u64 = 1;
const STREAM_UPDATE: u64 = 2;

/// Positions of a swarm, coordinate-major: all particles' first coordinate, then all particles' second, …
#[derive(Clone, Debug, PartialEq)]
pub struct Positions {
    /// Number of particles.
    pub n_particles: usize,
    /// Number of coordinates of each.
    pub n_coordinates: usize,
    /// Coordinate j of particle i is `values[j * n_particles + i]`.
    pub values: Vec<f64>,
}

impl Positions {
    /// All zero.
    pub fn zeros(n_particles: usize, n_coordinates: usize) -> Self {
        Self {
            n_particles,
            n_coordinates,
            values: vec![0.0; n_particles * n_coordinates],
        }
    }

    /// Coordinate j of all particles.
    pub fn coordinate(&self, j: usize) -> &[f64] {
        &self.values[j * self.n_particles..(j + 1) * self.n_particles]
    }

    /// Coordinate j of all particles, to be changed.
    pub fn coordinate_mut(&mut self, j: usize) -> &mut [f64] {
        &mut self.values[j * self.n_particles..(j + 1) * self.n_particles]
    }

    /// Coordinate j of particle i.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.coordinate(j)[i]
    }

    /// Sets coordinate j of particle i.
    pub fn set(&mut self, i: usize, j: usize, value: f64) {
        self.coordinate_mut(j)[i] = value;
    }

    /// All coordinates of particle i, gathered.
    pub fn particle(&self, i: usize) -> Vec<f64> {
        (0..self.n_coordinates).map(|j| self.get(i, j)).collect()
    }

    /// Sets all coordinates of particle i.
    ///
    /// # Panics
    /// When `position` has another number of coordinates.
    pub fn set_particle(&mut self, i: usize, position: &[f64]) {
        assert_eq!(
            position.len(),
            self.n_coordinates,
            "one value per coordinate"
        );
        for (j, &value) in position.iter().enumerate() {
            self.set(i, j, value);
        }
    }
}

/// Where the first positions are drawn, uniformly: centre ± half width. Whether the swarm may leave it is
/// [`Options::boundary`].
#[derive(Clone, Debug, PartialEq)]
pub struct SearchBox {
    /// Centre, one value per coordinate.
    pub centre: Vec<f64>,
    /// Half width, one value per coordinate, not negative.
    pub half_width: Vec<f64>,
}

/// How r1 and r2 of [Gao 2018, eq. 9] are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RandomNumbers {
    /// Anew for every coordinate of every particle: the usual reading of the formula.
    PerCoordinate,
    /// Once per particle and iteration: each pull is then along a straight line.
    PerParticle,
}

/// First velocities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitialVelocity {
    /// All zero.
    Zero,
    /// Uniform within ± `fraction` of the half width.
    Uniform {
        /// Fraction of the half width.
        fraction: f64,
    },
}

/// What happens to a particle that would leave the box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boundary {
    /// Nothing: the box only says where the swarm starts.
    None,
    /// The coordinate is set to the wall and its velocity to zero. With an answer at a corner of the box this looks
    /// like very fast convergence and is an artefact.
    Clamp,
    /// The coordinate is mirrored at the wall and its velocity reversed; what overshoots by more than the whole box
    /// ends at the wall.
    Reflect,
}

/// How to search. The default is the closest reading of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Number of particles n: 200 [Gao 2018, section 3.1].
    pub n_particles: usize,
    /// Swarm updates at most: 492, what the paper's experiment took [Gao 2018, section 4].
    pub n_iterations: usize,
    /// Inertia weight w: 0.9 [Gao 2018, eq. 9].
    pub inertia_weight: f64,
    /// Cognitive factor c1, the pull to the particle's own best: 0.5 [Gao 2018, eq. 9].
    pub cognitive: f64,
    /// Social factor c2, the pull to the swarm's best: 1.25 [Gao 2018, eq. 9].
    pub social: f64,
    /// How r1 and r2 are drawn: per coordinate (not printed in the paper).
    pub random_numbers: RandomNumbers,
    /// First velocities: zero (not printed).
    pub initial_velocity: InitialVelocity,
    /// What happens at the walls of the box: nothing (not printed).
    pub boundary: Boundary,
    /// Largest velocity per coordinate, as a fraction of the half width: no limit (not printed).
    pub velocity_limit: Option<f64>,
    /// Stops as soon as the best cost is at or below this: never (not printed).
    pub stop_at_cost: Option<f64>,
    /// Seed of all random numbers: 0.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            n_particles: 200,
            n_iterations: 492,
            inertia_weight: 0.9,
            cognitive: 0.5,
            social: 1.25,
            random_numbers: RandomNumbers::PerCoordinate,
            initial_velocity: InitialVelocity::Zero,
            boundary: Boundary::None,
            velocity_limit: None,
            stop_at_cost: None,
            seed: 0,
        }
    }
}

/// What the monitor is told, once for the first swarm (iteration 0) and once after each iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Swarm updates done.
    pub iteration: usize,
    /// The limit.
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
    /// The monitor asked to stop.
    Stopped,
}

/// What the search found.
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
    /// Positions as drawn, before `move_particles` saw them.
    pub initial_positions: Positions,
    /// Each particle's own best position.
    pub own_best_positions: Positions,
    /// Each particle's own best cost.
    pub own_best_costs: Vec<f64>,
    /// Why the search ended.
    pub termination: Termination,
}

/// The cost of all positions at once: fills one cost per particle. A cost that is not finite counts as +∞. What comes in is each
/// particle's own best cost so far: a cost that is not below it may be left unfinished, with anything that is not below it either.
pub type Cost<'a> = dyn FnMut(&Positions, &mut [f64]) + 'a;

/// Changes the positions before they are evaluated: called with 0 before the first evaluation, and with k ≥ 1 after
/// update k. It decides itself when to act; velocities and bests stay as they are.
pub type MoveParticles<'a> = dyn FnMut(usize, &mut Positions) + 'a;

/// Gets each iteration; `Break` stops the search.
pub type Monitor<'a> = dyn FnMut(Iteration) -> ControlFlow<()> + 'a;

/// The first swarm as drawn: uniform in the box. [`minimize`] starts from these, and the network of
/// [Gao 2018, section 3.2] is trained on them.
///
/// # Panics
/// When centre and half width differ in length.
pub fn initial_positions(search_box: &SearchBox, options: &Options) -> Positions {
    draw_initial(search_box, options).0
}

/// First positions, and the generator, from which the first velocities are drawn next.
fn draw_initial(search_box: &SearchBox, options: &Options) -> (Positions, LaneRandom) {
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
    (positions, random)
}

/// Searches the minimum of `cost`.
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
    let (initial_positions, mut random) = draw_initial(search_box, options);
    let mut swarm = Swarm::new(&initial_positions, search_box, options, &mut random);
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
        swarm.update(search_box, options, &mut random);
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
