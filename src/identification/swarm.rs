//! The swarm on a search space: F of all particles through the fast kernel.

use crate::identification::KinematicModel;
use crate::identification::objective::Observation;
use crate::identification::parameters::apply_into;
use crate::identification::search_space::SearchSpace;
use crate::kinematics::batch::{LANES, LaneRobots, PreparedPoses, sum_of_squares};
use crate::solvers::pso::{self, Positions};

/// F of a swarm's particles, with everything prepared that does not change between iterations.
pub struct SwarmCost<'a> {
    space: &'a SearchSpace,
    poses: PreparedPoses,
    lanes: LaneRobots,
    coordinates: Vec<f64>,
    deviation: Vec<f64>,
    model: KinematicModel,
}

impl<'a> SwarmCost<'a> {
    /// Prepares the poses of `observations`.
    pub fn new(space: &'a SearchSpace, observations: &[Observation]) -> Self {
        let n_links = space.reference.links.len();
        let mut poses = PreparedPoses::new(n_links);
        for o in observations {
            poses.push(&o.q_rad, o.position_mm, o.weight, o.target);
        }
        Self {
            space,
            poses,
            lanes: LaneRobots::new(n_links, space.reference.targets_mm.len()),
            coordinates: vec![0.0; space.n_coordinates()],
            deviation: vec![0.0; space.parameters.len()],
            model: space.reference.clone(),
        }
    }

    /// F of every particle, mm². Positions are coordinates of the search space.
    pub fn evaluate(&mut self, positions: &Positions, costs: &mut [f64]) {
        let n = positions.n_particles;
        for first in (0..n).step_by(LANES) {
            self.lanes.clear();
            for lane in 0..LANES {
                // a last chunk that is not full repeats its last particle
                self.load(positions, (first + lane).min(n - 1));
                self.lanes.set_lane(lane, &self.model.links, &self.model.t_instrument_base, &self.model.targets_mm);
            }
            let sums = sum_of_squares(&self.lanes, &self.poses);
            let in_chunk = LANES.min(n - first);
            costs[first..first + in_chunk].copy_from_slice(&sums[..in_chunk]);
        }
    }

    fn load(&mut self, positions: &Positions, particle: usize) {
        for (j, z) in self.coordinates.iter_mut().enumerate() {
            *z = positions.get(particle, j);
        }
        self.space.deviation_into(&self.coordinates, &mut self.deviation);
        apply_into(&self.space.reference, &self.space.parameters, &self.deviation, &mut self.model);
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
    let n = space.n_coordinates();
    let search_box = pso::SearchBox { centre: vec![0.0; n], half_width: vec![1.0; n] };
    let mut cost = SwarmCost::new(space, observations);
    pso::minimize(&mut |positions, costs| cost.evaluate(positions, costs), &search_box, options, move_particles, monitor)
}
