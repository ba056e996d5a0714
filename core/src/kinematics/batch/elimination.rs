//! F of a swarm's particles with early exit. A particle is dropped when its sum over the first poses exceeds its own best cost. The remaining particles
//! are packed into full lanes.
//!
//! The sum only grows from pose to pose, so a dropped particle would not have improved. The sums of the remaining particles run in pose order in
//! every lane, and so have the same bits as in `sum_of_squares`. In the paper's swarm a fifth of the work is left.

use super::kernel::add_squares;
use super::lanes::{LANES, Lanes};
use super::poses::PreparedPoses;
use super::robots::LaneRobots;
use std::ops::Range;

/// Share of the poses after which the remaining particles are packed. In the paper's swarm, one of five particles is left after 16 of 50
/// poses. Copying a particle takes as long as ten of its poses, so packing twice gains nothing.
const PACK_AFTER_SHARE: f64 = 0.33;
/// If at most this many of eight particles are left, they are copied to the packed ones. Otherwise they continue where they are, because
/// the remaining poses of eight particles take as long as copying three of them and continuing.
const MAX_MOVED: usize = 2;
/// Number of poses after which the last few particles are checked again.
const POSES_PER_CHECK: usize = 10;
/// Minimum number of poses for early exits.
const MIN_POSES: usize = 12;
/// Number of poses that the kernel computes side by side; packing happens at a multiple of it.
const POSES_AT_ONCE: usize = 4;

/// Particles that have been evaluated up to the same pose.
#[derive(Clone, Debug)]
struct PackedParticles {
    robots: LaneRobots,
    poses: Range<usize>,
    sums: Lanes,
    particles: [usize; LANES],
    n: usize,
}

/// The swarm's evaluation, with its buffers.
#[derive(Clone, Debug)]
pub struct Elimination {
    n_first_poses: usize,
    packed: PackedParticles,
}

impl Elimination {
    /// Allocates buffers for robots like these on these poses.
    pub fn new(robots: &LaneRobots, poses: &PreparedPoses) -> Self {
        let n = poses.len();
        let n_first_poses = (PACK_AFTER_SHARE * n as f64) as usize / POSES_AT_ONCE * POSES_AT_ONCE;
        let n_first_poses = if n >= MIN_POSES {
            n_first_poses.max(POSES_AT_ONCE)
        } else {
            n
        };
        let packed = PackedParticles {
            robots: robots.clone(),
            poses: n_first_poses..n,
            sums: Lanes::ZERO,
            particles: [0; LANES],
            n: 0,
        };
        Self {
            n_first_poses,
            packed,
        }
    }

    /// Evaluates particles, which are the first lanes of `robots`. On entry, `costs` has the bound of every particle. For an evaluated particle it
    /// becomes F, or some value above the bound. Some particles may remain unfinished until [`Self::finish`].
    pub fn add(
        &mut self,
        robots: &LaneRobots,
        poses: &PreparedPoses,
        particles: &[usize],
        costs: &mut [f64],
    ) {
        let sums = add_squares(robots, poses, 0..self.n_first_poses, Lanes::ZERO);
        let is_left = |(particle, sum): &(&usize, &f64)| !cannot_improve(**sum, costs[**particle]);
        let n_left = particles.iter().zip(&sums.0).filter(is_left).count();
        if n_left > MAX_MOVED {
            return evaluate_rest(
                robots,
                poses,
                self.packed.poses.clone(),
                sums,
                particles,
                costs,
            );
        }
        for (lane, (&particle, &sum)) in particles.iter().zip(&sums.0).enumerate() {
            if cannot_improve(sum, costs[particle]) {
                costs[particle] = sum;
                continue;
            }
            self.packed.push(robots, lane, sum, particle);
            if self.packed.n == LANES {
                self.packed.run(poses, costs);
            }
        }
    }

    /// Evaluates the particles that are still unfinished.
    pub fn finish(&mut self, poses: &PreparedPoses, costs: &mut [f64]) {
        if self.packed.n > 0 {
            self.packed.run(poses, costs);
        }
    }
}

impl PackedParticles {
    fn push(&mut self, robots: &LaneRobots, lane: usize, sum: f64, particle: usize) {
        self.robots.copy_lane(self.n, robots, lane);
        (self.sums.0[self.n], self.particles[self.n]) = (sum, particle);
        self.n += 1;
    }

    fn run(&mut self, poses: &PreparedPoses, costs: &mut [f64]) {
        let particles = &self.particles[..std::mem::take(&mut self.n)];
        evaluate_rest(
            &self.robots,
            poses,
            self.poses.clone(),
            self.sums,
            particles,
            costs,
        );
    }
}

/// Continues to the last pose, or until no particle can improve.
fn evaluate_rest(
    robots: &LaneRobots,
    poses: &PreparedPoses,
    range: Range<usize>,
    mut sums: Lanes,
    particles: &[usize],
    costs: &mut [f64],
) {
    for start in range.clone().step_by(POSES_PER_CHECK) {
        let end = range.end.min(start + POSES_PER_CHECK);
        sums = add_squares(robots, poses, start..end, sums);
        if particles
            .iter()
            .zip(&sums.0)
            .all(|(particle, sum)| cannot_improve(*sum, costs[*particle]))
        {
            break;
        }
    }
    for (particle, sum) in particles.iter().zip(&sums.0) {
        costs[*particle] = *sum;
    }
}

/// Never true for a bound of +∞ or a sum that is NaN.
fn cannot_improve(sum: f64, bound: f64) -> bool {
    sum > bound
}
