//! F of a swarm's particles as far as it matters: a particle whose sum over the first poses is already above its own best is out, and
//! those that are left close ranks, so that all lanes work.
//!
//! The sum only grows from pose to pose, so whoever is out would not have improved; and whoever is left is summed in pose order, whatever
//! lane it moved to, to the same bits as by `sum_of_squares`. In the paper's swarm a fifth of the work is left.

use super::kernel::add_squares;
use super::lanes::{LANES, Lanes};
use super::poses::PreparedPoses;
use super::robots::LaneRobots;
use std::ops::Range;

/// Share of the poses after which ranks are closed. After 16 of 50 poses one of five particles is left in the paper's swarm; to copy
/// one costs as much as ten of its poses, so that closing twice gains nothing.
const RANKS_CLOSE_AT: f64 = 0.33;
/// Poses after which the last few are looked at again.
const LOOK_EVERY: usize = 10;
/// With fewer poses nobody drops out early.
const FEWEST_POSES: usize = 12;
/// Poses that the kernel pushes side by side: ranks close at a multiple.
const SIDE_BY_SIDE: usize = 4;

/// Particles that came as far as some pose.
#[derive(Clone, Debug)]
struct Rank {
    robots: LaneRobots,
    poses: Range<usize>,
    sums: Lanes,
    particles: [usize; LANES],
    n: usize,
}

/// The swarm's evaluation, with room to work in.
#[derive(Clone, Debug)]
pub struct Elimination {
    close_at: usize,
    rank: Rank,
}

impl Elimination {
    /// Room for robots like these on these poses.
    pub fn new(robots: &LaneRobots, poses: &PreparedPoses) -> Self {
        let n = poses.len();
        let close_at = (RANKS_CLOSE_AT * n as f64) as usize / SIDE_BY_SIDE * SIDE_BY_SIDE;
        let close_at = if n >= FEWEST_POSES { close_at.max(SIDE_BY_SIDE) } else { n };
        let rank = Rank { robots: robots.clone(), poses: close_at..n, sums: Lanes::ZERO, particles: [0; LANES], n: 0 };
        Self { close_at, rank }
    }

    /// Evaluates the particles `first` … `first + n - 1`, who are the first lanes of `robots`. `costs` holds everybody's bound, and for
    /// those who were evaluated gets F, or something above their bound. Some may still be under way until [`Self::finish`].
    pub fn add(&mut self, robots: &LaneRobots, poses: &PreparedPoses, first: usize, n: usize, costs: &mut [f64]) {
        let sums = add_squares(robots, poses, 0..self.close_at, Lanes::ZERO);
        for (lane, &sum) in sums.0[..n].iter().enumerate() {
            let particle = first + lane;
            if is_out(sum, costs[particle]) || self.rank.poses.is_empty() {
                costs[particle] = sum;
                continue;
            }
            self.rank.take(robots, lane, sum, particle);
            if self.rank.n == LANES {
                self.rank.run(poses, costs);
            }
        }
    }

    /// Evaluates who is still under way.
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

    /// Goes on until the last pose, or until all are out.
    fn run(&mut self, poses: &PreparedPoses, costs: &mut [f64]) {
        let particles = &self.particles[..std::mem::take(&mut self.n)];
        for start in self.poses.clone().step_by(LOOK_EVERY) {
            let end = self.poses.end.min(start + LOOK_EVERY);
            self.sums = add_squares(&self.robots, poses, start..end, self.sums);
            if particles.iter().zip(&self.sums.0).all(|(particle, sum)| is_out(*sum, costs[*particle])) {
                break;
            }
        }
        for (particle, sum) in particles.iter().zip(&self.sums.0) {
            costs[*particle] = *sum;
        }
    }
}

/// Never for a bound of +∞, nor for a sum that is not a number.
fn is_out(sum: f64, bound: f64) -> bool {
    sum > bound
}
