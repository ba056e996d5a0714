//! The inner loop: F of eight particles over all poses.
//!
//! Several poses go through one stage before the next stage begins. Each multiply-add has to wait some cycles for the previous one; the
//! other poses use this time. The number of poses is limited by the registers.

use super::lane_link::{Between, Circle};
use super::lanes::{InstructionSet, Lanes, Vector};
use super::poses::PreparedPoses;
use super::robots::{BaseStage, LaneRobots};
use multiversion::multiversion;
use nalgebra::Vector3;
use std::ops::Range;

/// Number of poses side by side with 32 registers.
const POSES_OF_32_REGISTERS: usize = 4;
/// Number of poses side by side with 16 registers.
const POSES_OF_16_REGISTERS: usize = 2;

/// F = Σ weight · |measured − predicted|² of eight particles [Gao 2018, eq. 8, 11], mm².
///
/// # Panics
/// When the poses are of a robot with another number of links, or of a target that the robots do not have.
pub fn sum_of_squares(robots: &LaneRobots, poses: &PreparedPoses) -> Lanes {
    add_squares(robots, poses, 0..poses.len(), Lanes::ZERO)
}

/// As [`sum_of_squares`] over some of the poses, added to the sums of the poses before. Computing in parts gives the same bits as at once.
pub(super) fn add_squares(
    robots: &LaneRobots,
    poses: &PreparedPoses,
    range: Range<usize>,
    sums: Lanes,
) -> Lanes {
    assert_eq!(
        poses.n_links,
        robots.n_links(),
        "poses and robots have the same number of links"
    );
    match robots.instructions {
        InstructionSet::Avx512 => on_avx512(robots, poses, range, sums),
        InstructionSet::Avx2 => on_avx2(robots, poses, range, sums),
        InstructionSet::Baseline => on_baseline(robots, poses, range, sums),
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+fma"))]
fn on_avx512(
    robots: &LaneRobots,
    poses: &PreparedPoses,
    range: Range<usize>,
    sums: Lanes,
) -> Lanes {
    SumOfSquares { robots, poses }.of::<8, POSES_OF_32_REGISTERS>(range, sums)
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn on_avx2(robots: &LaneRobots, poses: &PreparedPoses, range: Range<usize>, sums: Lanes) -> Lanes {
    SumOfSquares { robots, poses }.of::<4, POSES_OF_16_REGISTERS>(range, sums)
}

fn on_baseline(
    robots: &LaneRobots,
    poses: &PreparedPoses,
    range: Range<usize>,
    sums: Lanes,
) -> Lanes {
    SumOfSquares { robots, poses }.of::<2, POSES_OF_32_REGISTERS>(range, sums)
}

#[derive(Clone, Copy)]
struct SumOfSquares<'a> {
    robots: &'a LaneRobots,
    poses: &'a PreparedPoses,
}

impl SumOfSquares<'_> {
    #[inline(always)]
    fn of<const W: usize, const P: usize>(self, range: Range<usize>, sums: Lanes) -> Lanes {
        match (
            self.robots.base_stage,
            self.poses.is_unweighted,
            self.poses.bound,
        ) {
            (BaseStage::Known, _, Some(_)) => self.sums::<W, P, KNOWN, BOUNDED>(range, sums),
            (BaseStage::Any, _, Some(_)) => self.sums::<W, P, ANY, BOUNDED>(range, sums),
            (BaseStage::None, _, Some(_)) => self.sums::<W, P, NONE, BOUNDED>(range, sums),
            (BaseStage::Known, true, None) => self.sums::<W, P, KNOWN, UNWEIGHTED>(range, sums),
            (BaseStage::Known, false, None) => self.sums::<W, P, KNOWN, WEIGHTED>(range, sums),
            (BaseStage::Any, true, None) => self.sums::<W, P, ANY, UNWEIGHTED>(range, sums),
            (BaseStage::Any, false, None) => self.sums::<W, P, ANY, WEIGHTED>(range, sums),
            (BaseStage::None, _, None) => self.sums::<W, P, NONE, WEIGHTED>(range, sums),
        }
    }

    #[inline(always)]
    fn sums<const W: usize, const P: usize, const BASE: u8, const LOSS: u8>(
        self,
        range: Range<usize>,
        mut sums: Lanes,
    ) -> Lanes {
        for part in 0..Vector::<W>::PER_CHUNK {
            let mut sum = Vector::<W>::load(&sums, part);
            let mut first = range.start;
            while first + P <= range.end {
                self.add::<W, P, BASE, LOSS>(part, first, &mut sum);
                first += P;
            }
            while first < range.end {
                self.add::<W, 1, BASE, LOSS>(part, first, &mut sum);
                first += 1;
            }
            sum.store(&mut sums, part);
        }
        sums
    }

    /// Adds the poses `first` … `first + P - 1`, from the target to the base, stage by stage.
    #[inline(always)]
    fn add<const W: usize, const P: usize, const BASE: u8, const LOSS: u8>(
        self,
        part: usize,
        first: usize,
        sum: &mut Vector<W>,
    ) {
        let Self { robots, poses } = self;
        let n = poses.n_links;
        let cos_sin = &poses.cos_sin_q[first * n..(first + P) * n];
        let mut points = [[Vector::<W>::splat(0.0); 3]; P];
        for i in 0..P {
            points[i] = robots.circles[poses.target[first + i]]
                .at(cos_sin[i * n + robots.n_joints - 1], part);
        }
        for joint in (1..robots.between.len()).rev() {
            let between = &robots.between[joint];
            if between.is_tilted {
                for i in 0..P {
                    points[i] =
                        between.apply::<W, true>(turn(points[i], cos_sin[i * n + joint]), part);
                }
            } else {
                for i in 0..P {
                    points[i] =
                        between.apply::<W, false>(turn(points[i], cos_sin[i * n + joint]), part);
                }
            }
        }
        for i in 0..P {
            let measured = &poses.measured_mm[first + i];
            let [x, y, z] = match BASE {
                KNOWN => {
                    robots.between[0].error_at_known_base(points[i], cos_sin[i * n], measured, part)
                }
                ANY => minus(
                    robots.between[0].apply::<W, true>(turn(points[i], cos_sin[i * n]), part),
                    measured,
                ),
                _ => minus(points[i], measured),
            };
            let square = x.mul_add(x, y.mul_add(y, z * z));
            // 1 · square + sum has the same bits as square + sum
            *sum = match (LOSS, poses.bound) {
                (UNWEIGHTED, _) => square + *sum,
                (BOUNDED, Some(bound)) => {
                    bound.of(Vector::splat(poses.weight[first + i]) * square) + *sum
                }
                _ => Vector::splat(poses.weight[first + i]).mul_add(square, *sum),
            };
        }
    }
}

/// [`BaseStage`] as a constant of the compiled loop.
const KNOWN: u8 = 0;
const ANY: u8 = 1;
const NONE: u8 = 2;

/// How an error is weighted, as a constant of the compiled loop.
const UNWEIGHTED: u8 = 0;
const WEIGHTED: u8 = 1;
const BOUNDED: u8 = 2;

/// x, y, z of one target of as many robots as a register holds.
type Point<const W: usize> = [Vector<W>; 3];

/// Rz(q) · point.
#[inline(always)]
fn turn<const W: usize>([x, y, z]: Point<W>, (cos, sin): (f64, f64)) -> Point<W> {
    let (c, s) = (Vector::splat(cos), Vector::splat(sin));
    [c.mul_add(x, -(s * y)), s.mul_add(x, c * y), z]
}

#[inline(always)]
fn minus<const W: usize>([x, y, z]: Point<W>, measured: &Vector3<f64>) -> Point<W> {
    [
        x - Vector::splat(measured.x),
        y - Vector::splat(measured.y),
        z - Vector::splat(measured.z),
    ]
}

impl Circle {
    /// The point for one commanded angle.
    #[inline(always)]
    fn at<const W: usize>(&self, (cos, sin): (f64, f64), part: usize) -> Point<W> {
        let (c, s) = (Vector::splat(cos), Vector::splat(sin));
        let mut point = [c; 3];
        for (row, coordinate) in point.iter_mut().enumerate() {
            let (a, b, k) = (&self.cos[row], &self.sin[row], &self.centre[row]);
            *coordinate = c.mul_add(
                Vector::load(a, part),
                s.mul_add(Vector::load(b, part), Vector::load(k, part)),
            );
        }
        point
    }
}

impl Between {
    /// M · point. Without `TILTED` the rotation's r20 is 0.
    #[inline(always)]
    fn apply<const W: usize, const TILTED: bool>(
        &self,
        [x, y, z]: Point<W>,
        part: usize,
    ) -> Point<W> {
        let mut moved = [x; 3];
        for (row, coordinate) in moved.iter_mut().enumerate() {
            let [r0, r1, r2] = &self.rotation[row];
            let yz = Vector::load(r1, part).mul_add(
                y,
                Vector::load(r2, part).mul_add(z, Vector::load(&self.translation[row], part)),
            );
            *coordinate = if row < 2 || TILTED {
                Vector::load(r0, part).mul_add(x, yz)
            } else {
                yz
            };
        }
        moved
    }

    /// Rx(alpha_1) · Dx(a_1) · Rz(q_1) · point − measured.
    #[inline(always)]
    fn error_at_known_base<const W: usize>(
        &self,
        [x, y, z]: Point<W>,
        (cos, sin): (f64, f64),
        measured: &Vector3<f64>,
        part: usize,
    ) -> Point<W> {
        let (c, s) = (Vector::splat(cos), Vector::splat(sin));
        let (mx, my, mz) = (
            Vector::splat(measured.x),
            Vector::splat(measured.y),
            Vector::splat(measured.z),
        );
        let (cos_alpha, sin_alpha) = (
            Vector::load(&self.rotation[1][1], part),
            Vector::load(&self.rotation[2][1], part),
        );
        let v = s.mul_add(x, c * y);
        [
            c.mul_add(
                x,
                (-s).mul_add(y, Vector::load(&self.translation[0], part) - mx),
            ),
            cos_alpha.mul_add(v, -sin_alpha.mul_add(z, my)),
            sin_alpha.mul_add(v, cos_alpha.mul_add(z, -mz)),
        ]
    }
}
