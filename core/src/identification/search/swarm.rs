//! The swarm in a search space: F of all particles, computed by the fast kernel.

use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::moved;
use crate::identification::model::search_space::SearchSpace;
use crate::identification::search::anchor::Anchor;
use crate::identification::search::parallel::{in_parallel, n_cores};
use crate::kinematics::batch::{
    Bound, Elimination, LANES, LaneRobots, Lanes, LowerBound, Moved, PreparedPoses,
};
use crate::solvers::pso::{self, Positions};
use multiversion::multiversion;

/// F of a swarm's particles, with everything prepared that does not change between iterations.
pub struct SwarmCost<'a> {
    space: &'a SearchSpace,
    poses: PreparedPoses,
    bound_test: Option<BoundTest>,
    n_skipped: usize,
    /// One for each thread.
    lanes: Vec<SwarmLanes>,
}

/// Tests a lower bound before F is computed, and keeps the anchor of this bound. The test saves evaluations of F and does not change the
/// result.
struct BoundTest {
    anchor: Anchor,
    /// Number of evaluations since the anchor was last checked.
    n_evaluations: usize,
    /// Number of evaluations for which the bound is not used, because most particles improved or are too far from the anchor.
    n_paused: usize,
    coordinates: Vec<f64>,
    deviation: Vec<f64>,
}

/// The anchor is checked once in this many evaluations.
const EVALUATIONS_PER_ANCHOR_CHECK: usize = 8;
/// The anchor moves to a particle whose cost is smaller by this factor, because the bound's loss grows with the square of the distance.
const ANCHOR_COST_RATIO: f64 = 4.0;
/// Minimum share of the particles for which the bound saves F. Below it, the bound is not worth its time, which is a tenth of that of F.
const MIN_SAVED_SHARE: f64 = 0.2;
/// Number of evaluations without the bound if it saves too little.
const PAUSE: usize = 4;

/// Eight particles at a time.
#[derive(Clone)]
struct SwarmLanes {
    robots: LaneRobots,
    elimination: Elimination,
    /// One per parameter.
    deviations: Vec<Lanes>,
    scratch: Vec<Lanes>,
    /// Particles whose F is needed, collected until there are eight.
    waiting: Vec<Lanes>,
    particles: [usize; LANES],
    n_waiting: usize,
    n_excluded: usize,
}

impl<'a> SwarmCost<'a> {
    /// Prepares the poses of `observations`.
    pub fn new(space: &'a SearchSpace, observations: &[Observation]) -> Self {
        Self::bounded(space, observations, None)
    }

    /// As [`Self::new`], with a loss that bounds the cost of one pose.
    pub fn bounded(
        space: &'a SearchSpace,
        observations: &[Observation],
        bound: Option<Bound>,
    ) -> Self {
        let (poses, robots) = (
            prepared_poses(space, observations).bounded(bound),
            lane_robots(space),
        );
        let elimination = Elimination::new(&robots, &poses);
        // The lower bound is valid for squares only.
        let anchor = if bound.is_none() {
            Anchor::at_reference(space, observations)
        } else {
            None
        };
        let bound_test = anchor.map(|anchor| BoundTest {
            anchor,
            n_evaluations: 0,
            n_paused: 0,
            coordinates: vec![0.0; space.n_coordinates()],
            deviation: vec![0.0; space.parameters.len()],
        });
        let deviations = vec![Lanes::ZERO; space.parameters.len()];
        let lanes = SwarmLanes {
            robots,
            elimination,
            scratch: deviations.clone(),
            waiting: deviations.clone(),
            deviations,
            particles: [0; LANES],
            n_waiting: 0,
            n_excluded: 0,
        };
        Self {
            space,
            poses,
            bound_test,
            n_skipped: 0,
            lanes: vec![lanes],
        }
    }

    /// Evaluates on several threads if there is enough work; the results are the same to the last bit.
    pub fn on_threads(mut self, n_threads: usize) -> Self {
        self.lanes.resize(n_threads.max(1), self.lanes[0].clone());
        self
    }

    /// F of every particle, mm². Positions are coordinates of the search space.
    pub fn evaluate(&mut self, positions: &Positions, costs: &mut [f64]) {
        costs.fill(f64::INFINITY);
        self.evaluate_below(positions, costs);
    }

    /// Number of particles so far whose F was not computed, because its lower bound exceeded the particle's bound.
    pub fn n_skipped(&self) -> usize {
        self.n_skipped
    }

    /// F of every particle whose F is not above its bound, mm²; for the others some value above the bound. On entry, `costs` has the
    /// bounds.
    pub fn evaluate_below(&mut self, positions: &Positions, costs: &mut [f64]) {
        let (space, poses) = (self.space, &self.poses);
        // No F exceeds +∞, so infinite bounds need no test.
        let bound_test = self
            .bound_test
            .as_mut()
            .filter(|_| costs.iter().any(|cost| cost.is_finite()));
        let lower_bound = bound_test
            .as_ref()
            .filter(|bound_test| bound_test.n_paused == 0)
            .map(|bound_test| bound_test.anchor.bound());
        let n_threads = if costs.len() * poses.len() < MIN_WORK_FOR_THREADS {
            1
        } else {
            self.lanes.len()
        };
        let share = costs.len().div_ceil(n_threads).next_multiple_of(LANES);
        let parts = self
            .lanes
            .iter_mut()
            .zip(costs.chunks_mut(share))
            .enumerate();
        in_parallel(parts.map(|(part, (lanes, costs))| {
            move || lanes.evaluate(space, poses, lower_bound, positions, part * share, costs)
        }));
        if let Some(bound_test) = bound_test {
            let n_excluded = self
                .lanes
                .iter_mut()
                .map(|lanes| std::mem::take(&mut lanes.n_excluded))
                .sum();
            self.n_skipped += n_excluded;
            bound_test.update(space, positions, costs, n_excluded);
        }
    }
}

impl BoundTest {
    /// Updates the anchor and the pause after an evaluation in which `n_excluded` particles were excluded.
    fn update(
        &mut self,
        space: &SearchSpace,
        positions: &Positions,
        costs: &[f64],
        n_excluded: usize,
    ) {
        if self.n_paused > 0 {
            self.n_paused -= 1;
        } else if (n_excluded as f64) < MIN_SAVED_SHARE * costs.len() as f64 {
            self.n_paused = PAUSE;
        }
        self.n_evaluations += 1;
        if !self
            .n_evaluations
            .is_multiple_of(EVALUATIONS_PER_ANCHOR_CHECK)
        {
            return;
        }
        let best = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        if let Some(best) =
            best.filter(|best| costs[*best] * ANCHOR_COST_RATIO <= self.anchor.cost_mm2())
        {
            for (j, coordinate) in self.coordinates.iter_mut().enumerate() {
                *coordinate = positions.get(best, j);
            }
            space.deviation_into(&self.coordinates, &mut self.deviation);
            self.anchor.move_to(&self.deviation);
        }
    }
}

impl SwarmLanes {
    /// Evaluates the particles from `first` on, as many as there are costs.
    fn evaluate(
        &mut self,
        space: &SearchSpace,
        poses: &PreparedPoses,
        lower_bound: Option<&LowerBound>,
        positions: &Positions,
        first: usize,
        costs: &mut [f64],
    ) {
        for start in (0..costs.len()).step_by(LANES) {
            space.deviations_of_chunk(positions, first + start, &mut self.deviations);
            let particles: [usize; LANES] = std::array::from_fn(|lane| start + lane);
            let particles = &particles[..LANES.min(costs.len() - start)];
            match lower_bound {
                Some(lower_bound) => self.bound_test(lower_bound, poses, particles, costs),
                None => {
                    self.robots.set(&self.deviations);
                    self.elimination.add(&self.robots, poses, particles, costs);
                }
            }
        }
        self.evaluate_waiting(poses, costs);
        self.elimination.finish(poses, costs);
    }

    /// Adds the particles whose F is needed to the waiting ones.
    fn bound_test(
        &mut self,
        lower_bound: &LowerBound,
        poses: &PreparedPoses,
        particles: &[usize],
        costs: &mut [f64],
    ) {
        let mut limits = Lanes::splat(f64::INFINITY);
        limits.0[..particles.len()]
            .copy_from_slice(&costs[particles[0]..particles[0] + particles.len()]);
        let is_excluded = lower_bound.exceeds(&self.deviations, &limits, &mut self.scratch);
        for (lane, &particle) in particles.iter().enumerate() {
            if is_excluded[lane] {
                costs[particle] = f64::INFINITY;
                self.n_excluded += 1;
                continue;
            }
            for (to, from) in self.waiting.iter_mut().zip(&self.deviations) {
                to.0[self.n_waiting] = from.0[lane];
            }
            self.particles[self.n_waiting] = particle;
            self.n_waiting += 1;
            if self.n_waiting == LANES {
                self.evaluate_waiting(poses, costs);
            }
        }
    }

    fn evaluate_waiting(&mut self, poses: &PreparedPoses, costs: &mut [f64]) {
        let particles = &self.particles[..std::mem::take(&mut self.n_waiting)];
        if !particles.is_empty() {
            self.robots.set(&self.waiting);
            self.elimination.add(&self.robots, poses, particles, costs);
        }
    }
}

/// Threads are used if particles times poses is at least this, in every iteration: about 2 ms of work, compared with some 20 µs for a thread.
const MIN_WORK_FOR_THREADS: usize = 1_000_000;

/// The measured poses in the form of the kernel.
pub fn prepared_poses(space: &SearchSpace, observations: &[Observation]) -> PreparedPoses {
    let mut poses = PreparedPoses::new(space.reference.links.len());
    for o in observations {
        poses.push(&o.q_rad, o.position_mm, o.weight, o.target);
    }
    poses
}

/// Eight robots at the space's reference, to be changed by its parameters.
pub fn lane_robots(space: &SearchSpace) -> LaneRobots {
    let moved: Vec<Moved> = space.parameters.iter().map(moved).collect();
    let reference = &space.reference;
    LaneRobots::new(
        &reference.t_instrument_base,
        &reference.links,
        &reference.targets_mm,
        &moved,
    )
}

impl SearchSpace {
    /// As [`SearchSpace::deviation`] for the eight particles from `first` on, with the same bits. An incomplete chunk repeats its last particle.
    pub fn deviations_of_chunk(
        &self,
        positions: &Positions,
        first: usize,
        deviations: &mut [Lanes],
    ) {
        if self.is_raw() {
            scale_coordinates(&self.scale, positions, first, deviations);
        } else {
            combine_coordinates(self.directions().as_slice(), positions, first, deviations);
        }
        for prior in &self.prior_rows().all {
            let of_parameter = &mut deviations[prior.parameter];
            of_parameter
                .0
                .iter_mut()
                .for_each(|deviation| *deviation = prior.within(*deviation));
        }
    }
}

/// Calls `work` with coordinate j of the eight particles from `first` on, without copying. If there are fewer, the last particle is repeated.
#[inline(always)]
fn with_lanes(positions: &Positions, j: usize, first: usize, work: impl FnOnce(&[f64; LANES])) {
    let values = &positions.coordinate(j)[first..];
    match values.first_chunk() {
        Some(full) => work(full),
        None => work(&repeated(values)),
    }
}

#[cold]
fn repeated(values: &[f64]) -> [f64; LANES] {
    std::array::from_fn(|lane| values[lane.min(values.len() - 1)])
}

/// deviation = z · scale.
#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma"))]
fn scale_coordinates(scale: &[f64], positions: &Positions, first: usize, deviations: &mut [Lanes]) {
    for (j, (deviation, scale)) in deviations.iter_mut().zip(scale).enumerate() {
        with_lanes(positions, j, first, |z| {
            for (deviation, z) in deviation.0.iter_mut().zip(z) {
                *deviation = z * scale;
            }
        });
    }
}

/// deviations = directions · z, row by row. With the rows in the inner loop, the compiler would gather them one lane after the other.
#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma"))]
fn combine_coordinates(
    directions: &[f64],
    positions: &Positions,
    first: usize,
    deviations: &mut [Lanes],
) {
    let n_rows = deviations.len();
    for (row, deviation) in deviations.iter_mut().enumerate() {
        let mut sum = [0.0; LANES];
        for (j, v) in directions.iter().skip(row).step_by(n_rows).enumerate() {
            with_lanes(positions, j, first, |z| {
                for (sum, z) in sum.iter_mut().zip(z) {
                    *sum = v.mul_add(*z, *sum);
                }
            });
        }
        deviation.0 = sum;
    }
}

/// Runs the swarm [Gao 2018, eq. 9, 10] in a search space; `move_particles` as in [`pso::minimize`]. `bound` bounds the cost of one pose, for a
/// robust loss.
pub fn run_swarm(
    space: &SearchSpace,
    observations: &[Observation],
    bound: Option<Bound>,
    options: &pso::Options,
    move_particles: Option<&mut pso::MoveParticles<'_>>,
    monitor: &mut pso::Monitor<'_>,
) -> pso::Summary {
    let n = space.n_coordinates();
    let search_box = pso::SearchBox {
        centre: vec![0.0; n],
        half_width: vec![1.0; n],
    };
    let mut cost = SwarmCost::bounded(space, observations, bound).on_threads(n_cores());
    let mut of_swarm = |positions: &Positions, costs: &mut [f64]| {
        if space.prior_rows().all.is_empty() {
            return cost.evaluate_below(positions, costs);
        }
        // The bounds are for F with the priors, so an early exit by F alone would not be exact.
        cost.evaluate(positions, costs);
        for (particle, cost) in costs.iter_mut().enumerate() {
            *cost += space
                .prior_rows()
                .cost_mm2(&space.deviation(&positions.particle(particle)));
        }
    };
    pso::minimize(&mut of_swarm, &search_box, options, move_particles, monitor)
}
