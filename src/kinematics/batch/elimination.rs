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
/// So many of eight are moved to another rank; more go on where they are: the rest of the poses for eight costs as much as to move three and
/// to go on with them there.
const WORTH_MOVING: usize = 2;
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
        let close_at = if n >= FEWEST_POSES {
            close_at.max(SIDE_BY_SIDE)
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

    /// Evaluates particles, who are the first lanes of `robots`. `costs` holds everybody's bound, and for those who were evaluated gets F,
    /// or something above their bound. Some may still be under way until [`Self::finish`].
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
        if n_left > WORTH_MOVING {
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

/// Goes on until the last pose, or until all are out.
fn go_on(
    robots: &LaneRobots,
    poses: &PreparedPoses,
    range: Range<usize>,
    mut sums: Lanes,
    particles: &[usize],
    costs: &mut [f64],
) {
    for start in range.clone().step_by(LOOK_EVERY) {
        let end = range.end.min(start + LOOK_EVERY);
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

/// Never for a bound of +∞, nor for a sum that is not a number.
fn is_out(sum: f64, bound: f64) -> bool {
    sum > bound
}
