//! The swarm on a search space: F of all particles through the fast kernel.

use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, Quantity};
use crate::identification::search_space::SearchSpace;
use crate::kinematics::batch::{Bound, LANES, LaneRobots, Lanes, Moved, PreparedPoses, sum_of_squares};
use crate::solvers::pso::{self, Positions};
use multiversion::multiversion;

/// F of a swarm's particles, with everything prepared that does not change between iterations.
pub struct SwarmCost<'a> {
    space: &'a SearchSpace,
    poses: PreparedPoses,
    robots: LaneRobots,
    /// One per parameter.
    deviations: Vec<Lanes>,
}

impl<'a> SwarmCost<'a> {
    /// Prepares the poses of `observations`.
    pub fn new(space: &'a SearchSpace, observations: &[Observation]) -> Self {
        Self::bounded(space, observations, None)
    }

    /// With a loss that bounds what one pose adds.
    pub fn bounded(space: &'a SearchSpace, observations: &[Observation], bound: Option<Bound>) -> Self {
        Self {
            space,
            poses: prepared_poses(space, observations).bounded(bound),
            robots: lane_robots(space),
            deviations: vec![Lanes::ZERO; space.parameters.len()],
        }
    }

    /// F of every particle, mm². Positions are coordinates of the search space.
    pub fn evaluate(&mut self, positions: &Positions, costs: &mut [f64]) {
        for (chunk, costs) in costs.chunks_mut(LANES).enumerate() {
            self.space.deviations_of_chunk(positions, chunk * LANES, &mut self.deviations);
            self.robots.set(&self.deviations);
            let sums = sum_of_squares(&self.robots, &self.poses);
            costs.copy_from_slice(&sums.0[..costs.len()]);
        }
    }
}

/// The measured poses as the kernel wants them.
pub fn prepared_poses(space: &SearchSpace, observations: &[Observation]) -> PreparedPoses {
    let mut poses = PreparedPoses::new(space.reference.links.len());
    for o in observations {
        poses.push(&o.q_rad, o.position_mm, o.weight, o.target);
    }
    poses
}

/// Eight robots at the space's reference, to be moved by its parameters.
pub fn lane_robots(space: &SearchSpace) -> LaneRobots {
    let moved: Vec<Moved> = space.parameters.iter().map(moved).collect();
    let reference = &space.reference;
    LaneRobots::new(&reference.t_instrument_base, &reference.links, &reference.targets_mm, &moved)
}

/// A parameter as the kernels know it.
pub fn moved(parameter: &Parameter) -> Moved {
    match *parameter {
        Parameter::Link(link, Quantity::A) => Moved::A(link),
        Parameter::Link(link, Quantity::Alpha) => Moved::Alpha(link),
        Parameter::Link(link, Quantity::D) => Moved::D(link),
        Parameter::Link(link, Quantity::ThetaOffset) => Moved::ThetaOffset(link),
        Parameter::Link(link, Quantity::Beta) => Moved::Beta(link),
        Parameter::BaseTranslation(axis) => Moved::BaseTranslation(axis),
        Parameter::BaseRotation(axis) => Moved::BaseRotation(axis),
        Parameter::Target(target, axis) => Moved::Target(target, axis),
    }
}

impl SearchSpace {
    /// As [`SearchSpace::deviation`] for the eight particles from `first` on, to the same bits. A chunk that is not full repeats its
    /// last particle.
    pub fn deviations_of_chunk(&self, positions: &Positions, first: usize, deviations: &mut [Lanes]) {
        if self.is_raw() {
            scale_coordinates(&self.scale, positions, first, deviations);
        } else {
            combine_coordinates(self.directions().as_slice(), positions, first, deviations);
        }
    }
}

/// Coordinate j of the eight particles from `first` on; the last particle again where there are fewer.
#[inline(always)]
fn lanes_of(positions: &Positions, j: usize, first: usize) -> Lanes {
    let values = &positions.coordinate(j)[first..];
    match values.first_chunk() {
        Some(full) => Lanes(*full),
        None => repeated(values),
    }
}

#[cold]
fn repeated(values: &[f64]) -> Lanes {
    Lanes(std::array::from_fn(|lane| values[lane.min(values.len() - 1)]))
}

/// deviation = z · scale.
#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma"))]
fn scale_coordinates(scale: &[f64], positions: &Positions, first: usize, deviations: &mut [Lanes]) {
    for (j, (deviation, scale)) in deviations.iter_mut().zip(scale).enumerate() {
        let z = lanes_of(positions, j, first);
        for lane in 0..LANES {
            deviation.0[lane] = z.0[lane] * scale;
        }
    }
}

/// deviations = directions · z.
#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma"))]
fn combine_coordinates(directions: &[f64], positions: &Positions, first: usize, deviations: &mut [Lanes]) {
    deviations.fill(Lanes::ZERO);
    for (j, direction) in directions.chunks_exact(deviations.len()).enumerate() {
        let z = lanes_of(positions, j, first);
        for (deviation, v) in deviations.iter_mut().zip(direction) {
            for lane in 0..LANES {
                deviation.0[lane] = v.mul_add(z.0[lane], deviation.0[lane]);
            }
        }
    }
}

/// Runs the swarm [Gao 2018, eq. 9, 10] on a search space; `move_particles` as in [`pso::minimize`].
pub fn run_swarm(
    space: &SearchSpace,
    observations: &[Observation],
    options: &pso::Options,
    move_particles: Option<&mut pso::MoveParticles<'_>>,
    monitor: &mut pso::Monitor<'_>,
) -> pso::Summary {
    run_bounded_swarm(space, observations, None, options, move_particles, monitor)
}

/// As [`run_swarm`], with a loss that bounds what one pose adds to the cost.
pub fn run_bounded_swarm(
    space: &SearchSpace,
    observations: &[Observation],
    bound: Option<Bound>,
    options: &pso::Options,
    move_particles: Option<&mut pso::MoveParticles<'_>>,
    monitor: &mut pso::Monitor<'_>,
) -> pso::Summary {
    let n = space.n_coordinates();
    let search_box = pso::SearchBox { centre: vec![0.0; n], half_width: vec![1.0; n] };
    let mut cost = SwarmCost::bounded(space, observations, bound);
    pso::minimize(&mut |positions, costs| cost.evaluate(positions, costs), &search_box, options, move_particles, monitor)
}
