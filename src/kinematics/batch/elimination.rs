//! F of a swarm's particles with early exit. A particle is out when its sum over the first poses exceeds its own best cost. The remaining particles
//! are packed together, so that all lanes work.
//!
//! The sum only grows from pose to pose, so a particle that is out would not have improved. The sums of the remaining particles run in pose order in
//! every lane, and so have the same bits as in `sum_of_squares`. In the paper's swarm a fifth of the work is left.

use super::kernel::add_squares;
use super::lanes::{LANES, Lanes};
use super::poses::PreparedPoses;
use super::robots::LaneRobots;
use std::ops::Range;

/// Share of the poses after which the particles are packed. In the paper's swarm one of five particles is left after 16 of 50 poses. Copying one
/// takes as long as ten of its poses, so that packing twice gains nothing.
const PACK_AFTER_SHARE: f64 = 0.33;
/// If at most this many of eight particles are left, they are moved to another rank. Otherwise they continue where they are: the remaining poses of
/// eight particles take as long as moving three and continuing with them there.
const MAX_MOVED: usize = 2;
/// Number of poses after which the last few particles are checked again.
const POSES_PER_CHECK: usize = 10;
/// Minimum number of poses for early exits.
const MIN_POSES: usize = 12;
/// Number of poses that the kernel computes side by side; packing happens at a multiple of it.
const POSES_AT_ONCE: usize = 4;

/// Particles that have been evaluated up to the same pose.
#[derive(Clone, Debug)]
struct Rank {
    robots: LaneRobots,
    poses: Range<usize>,
    sums: Lanes,
    particles: [usize; LANES],
    n: usize,
}

/// The swarm's evaluation, with its buffers.
#[derive(Clone, Debug)]
pub struct Elimination {
    close_at: usize,
    rank: Rank,
}

impl Elimination {
    /// Allocates buffers for robots like these on these poses.
    pub fn new(robots: &LaneRobots, poses: &PreparedPoses) -> Self {
        let n = poses.len();
        let close_at = (PACK_AFTER_SHARE * n as f64) as usize / POSES_AT_ONCE * POSES_AT_ONCE;
        let close_at = if n >= MIN_POSES {
            close_at.max(POSES_AT_ONCE)
        } else {
            n
        };
        let rank = Rank {
            robots: robots.clone(),
            poses: close_at..n,
            sums: Lanes::ZERO,
            particles: [0; LANES],
            n: 0,
        };
        Self { close_at, rank }
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
        let sums = add_squares(robots, poses, 0..self.close_at, Lanes::ZERO);
        let is_left = |(particle, sum): &(&usize, &f64)| !is_out(**sum, costs[**particle]);
        let n_left = particles.iter().zip(&sums.0).filter(is_left).count();
        if n_left > MAX_MOVED {
            return go_on(
                robots,
                poses,
                self.rank.poses.clone(),
                sums,
                particles,
                costs,
            );
        }
        for (lane, (&particle, &sum)) in particles.iter().zip(&sums.0).enumerate() {
            if is_out(sum, costs[particle]) {
                costs[particle] = sum;
                continue;
            }
            self.rank.take(robots, lane, sum, particle);
            if self.rank.n == LANES {
                self.rank.run(poses, costs);
            }
        }
    }

    /// Evaluates the particles that are still unfinished.
    pub fn finish(&mut self, poses: &PreparedPoses, costs: &mut [f64]) {
        if self.rank.n > 0 {
            self.rank.run(poses, costs);
        }
    }
}

impl Rank {
    fn take(&mut self, robots: &LaneRobots, lane: usize, sum: f64, particle: usize) {
        self.robots.copy_lane(self.n, robots, lane);
        (self.sums.0[self.n], self.particles[self.n]) = (sum, particle);
        self.n += 1;
    }

    fn run(&mut self, poses: &PreparedPoses, costs: &mut [f64]) {
        let particles = &self.particles[..std::mem::take(&mut self.n)];
        go_on(
            &self.robots,
            poses,
            self.poses.clone(),
            self.sums,
            particles,
            costs,
        );
    }
}

/// Continues to the last pose, or until all particles are out.
fn go_on(
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
            .all(|(particle, sum)| is_out(*sum, costs[*particle]))
        {
            break;
        }
    }
    for (particle, sum) in particles.iter().zip(&sums.0) {
        costs[*particle] = *sum;
    }
}

/// Never true for a bound of +∞ or a sum that is NaN.
fn is_out(sum: f64, bound: f64) -> bool {
    sum > bound
}
