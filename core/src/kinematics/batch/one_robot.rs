//! One robot at many poses: residuals and their derivatives, eight poses side by side, without trigonometry per pose.
//!
//! `jacobian.rs` is its oracle, with the same columns: the axis itself for lengths, axis × lever arm for angles. Here lanes contain poses. The result
//! of a pose depends on that pose alone, so the bits are the same on every CPU.

use super::along::{Along, combine};
use super::lanes::{InstructionSet, Lanes, Vector};
use super::pose_lanes::{PoseLanes, ROWS};
use super::robots::Moved;
use crate::kinematics::model::Link;
use multiversion::multiversion;
use nalgebra::{IsometryMatrix3, Matrix3, Vector3};

/// The constants of a link that do not depend on the pose.
#[derive(Clone, Copy, Debug)]
struct Constants {
    a: f64,
    d: f64,
    alpha: (f64, f64),
    beta: (f64, f64),
    theta: (f64, f64),
}

/// Axes and points on them, in the measuring frame: x for a and alpha, y for beta, z for d and theta_offset.
#[derive(Clone, Copy, Debug)]
struct Axes {
    x: [[Lanes; 3]; 2],
    y: [[Lanes; 3]; 2],
    z: [[Lanes; 3]; 2],
}

/// A robot that changes from evaluation to evaluation, with its buffers.
#[derive(Clone, Debug)]
pub struct OneRobot {
    base: IsometryMatrix3<f64>,
    targets_mm: Vec<Vector3<f64>>,
    constants: Vec<Constants>,
    axes: Vec<Axes>,
    instructions: InstructionSet,
}

impl OneRobot {
    /// Allocates buffers for robots with `n_links` links.
    pub fn new(n_links: usize) -> Self {
        let still = Constants {
            a: 0.0,
            d: 0.0,
            alpha: (0.0, 1.0),
            beta: (0.0, 1.0),
            theta: (0.0, 1.0),
        };
        let at_origin = Axes {
            x: [[Lanes::ZERO; 3]; 2],
            y: [[Lanes::ZERO; 3]; 2],
            z: [[Lanes::ZERO; 3]; 2],
        };
        Self {
            base: IsometryMatrix3::identity(),
            targets_mm: vec![],
            constants: vec![still; n_links],
            axes: vec![at_origin; n_links],
            instructions: InstructionSet::fastest(),
        }
    }

    /// Selects another code path; the results are the same to the last bit.
    pub fn with_instructions(mut self, instructions: InstructionSet) -> Self {
        self.instructions = instructions;
        self
    }

    /// Sets the robot.
    ///
    /// # Panics
    /// When it has another number of links.
    pub fn set(
        &mut self,
        base: &IsometryMatrix3<f64>,
        links: &[Link],
        targets_mm: &[Vector3<f64>],
    ) {
        assert_eq!(
            links.len(),
            self.constants.len(),
            "as many links as there is room for"
        );
        self.base = *base;
        self.targets_mm.clear();
        self.targets_mm.extend_from_slice(targets_mm);
        for (to, link) in self.constants.iter_mut().zip(links) {
            let (alpha, theta) = (
                libm::sincos(link.alpha_rad),
                libm::sincos(link.theta_offset_rad),
            );
            *to = Constants {
                a: link.a_mm,
                d: link.d_mm,
                alpha,
                beta: libm::sincos(link.beta_rad),
                theta,
            };
        }
    }

    /// sqrt(weight) · (measured − predicted), `poses.n_rows()` values.
    pub fn residuals(&self, poses: &PoseLanes, residuals: &mut [f64]) {
        match self.instructions {
            InstructionSet::Avx512 => residuals_on_avx512(self, poses, residuals),
            InstructionSet::Avx2 => residuals_on_avx2(self, poses, residuals),
            InstructionSet::Baseline => residuals_of::<2>(self, poses, residuals),
        }
    }

    /// As [`Self::residuals`], with their derivatives: rows × r, column-major. `raw` is a buffer with one entry per moved quantity.
    pub fn linearise(
        &mut self,
        poses: &PoseLanes,
        along: &Along<'_>,
        raw: &mut [[Lanes; 3]],
        residuals: &mut [f64],
        jacobian: &mut [f64],
    ) {
        match self.instructions {
            InstructionSet::Avx512 => {
                linearise_on_avx512(self, poses, along, raw, residuals, jacobian)
            }
            InstructionSet::Avx2 => linearise_on_avx2(self, poses, along, raw, residuals, jacobian),
            InstructionSet::Baseline => {
                linearise_of::<2>(self, poses, along, raw, residuals, jacobian)
            }
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+fma"))]
fn residuals_on_avx512(robot: &OneRobot, poses: &PoseLanes, residuals: &mut [f64]) {
    residuals_of::<8>(robot, poses, residuals);
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn residuals_on_avx2(robot: &OneRobot, poses: &PoseLanes, residuals: &mut [f64]) {
    residuals_of::<4>(robot, poses, residuals);
}

#[multiversion(targets("x86_64+avx512f+avx512vl+fma"))]
fn linearise_on_avx512(
    robot: &mut OneRobot,
    poses: &PoseLanes,
    along: &Along<'_>,
    raw: &mut [[Lanes; 3]],
    residuals: &mut [f64],
    jacobian: &mut [f64],
) {
    linearise_of::<8>(robot, poses, along, raw, residuals, jacobian);
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn linearise_on_avx2(
    robot: &mut OneRobot,
    poses: &PoseLanes,
    along: &Along<'_>,
    raw: &mut [[Lanes; 3]],
    residuals: &mut [f64],
    jacobian: &mut [f64],
) {
    linearise_of::<4>(robot, poses, along, raw, residuals, jacobian);
}

#[inline(always)]
fn residuals_of<const W: usize>(robot: &OneRobot, poses: &PoseLanes, residuals: &mut [f64]) {
    for (chunk, rows) in residuals.chunks_exact_mut(ROWS).enumerate() {
        for part in 0..Vector::<W>::PER_CHUNK {
            let frame = walk::<W>(robot, poses, chunk, part, |_, _, _, _| {});
            poses.weigh::<W>(
                chunk,
                part,
                &frame.tip(&robot.targets_mm[poses.target[chunk]]),
                rows,
            );
        }
    }
}

#[inline(always)]
fn linearise_of<const W: usize>(
    robot: &mut OneRobot,
    poses: &PoseLanes,
    along: &Along<'_>,
    raw: &mut [[Lanes; 3]],
    residuals: &mut [f64],
    jacobian: &mut [f64],
) {
    let n_rows = poses.n_rows();
    let mut axes = std::mem::take(&mut robot.axes);
    for (chunk, rows) in residuals.chunks_exact_mut(ROWS).enumerate() {
        for part in 0..Vector::<W>::PER_CHUNK {
            let frame = walk::<W>(robot, poses, chunk, part, |link, which, axis, origin| {
                let at = &mut axes[link];
                let to = match which {
                    Axis::X => &mut at.x,
                    Axis::Y => &mut at.y,
                    Axis::Z => &mut at.z,
                };
                (0..3).for_each(|row| axis[row].store(&mut to[0][row], part));
                (0..3).for_each(|row| origin[row].store(&mut to[1][row], part));
            });
            let tip = frame.tip(&robot.targets_mm[poses.target[chunk]]);
            poses.weigh::<W>(chunk, part, &tip, rows);
            for (to, moved) in raw.iter_mut().zip(along.moved) {
                let column = column(
                    robot,
                    &axes,
                    *moved,
                    poses.target[chunk],
                    along.left_jacobian,
                    &frame,
                    &tip,
                    part,
                );
                (0..3).for_each(|row| column[row].store(&mut to[row], part));
            }
        }
        combine::<W>(
            &poses.root_weight[chunk],
            along,
            raw,
            chunk * ROWS,
            n_rows,
            jacobian,
        );
    }
    robot.axes = axes;
}

/// An axis of a link's chain.
enum Axis {
    X,
    Y,
    Z,
}

/// Axes (columns of the rotation) and origin of as many frames as a register has lanes.
#[derive(Clone, Copy)]
struct Frame<const W: usize> {
    axes: [[Vector<W>; 3]; 3],
    origin: [Vector<W>; 3],
}

impl<const W: usize> Frame<W> {
    /// A target in the measuring frame.
    #[inline(always)]
    fn tip(&self, target: &Vector3<f64>) -> [Vector<W>; 3] {
        let mut tip = self.origin;
        for (axis, length) in self.axes.iter().zip(target.iter()) {
            tip = along(*axis, *length, tip);
        }
        tip
    }
}

/// origin + length · axis.
#[inline(always)]
fn along<const W: usize>(
    axis: [Vector<W>; 3],
    length: f64,
    origin: [Vector<W>; 3],
) -> [Vector<W>; 3] {
    let length = Vector::splat(length);
    [
        length.mul_add(axis[0], origin[0]),
        length.mul_add(axis[1], origin[1]),
        length.mul_add(axis[2], origin[2]),
    ]
}

/// (c·a + s·b, c·b − s·a): two axes rotated about the third.
#[inline(always)]
fn turned<const W: usize>(
    a: [Vector<W>; 3],
    b: [Vector<W>; 3],
    c: Vector<W>,
    s: Vector<W>,
) -> ([Vector<W>; 3], [Vector<W>; 3]) {
    let (mut to_a, mut to_b) = (a, b);
    for row in 0..3 {
        to_a[row] = c.mul_add(a[row], s * b[row]);
        to_b[row] = c.mul_add(b[row], -(s * a[row]));
    }
    (to_a, to_b)
}

/// Computes the chain from the base to the flange; `keep` receives each axis and a point on it.
#[inline(always)]
fn walk<const W: usize>(
    robot: &OneRobot,
    poses: &PoseLanes,
    chunk: usize,
    part: usize,
    mut keep: impl FnMut(usize, Axis, &[Vector<W>; 3], &[Vector<W>; 3]),
) -> Frame<W> {
    let base = robot.base.rotation.matrix();
    let column = |k: usize| {
        [
            Vector::splat(base[(0, k)]),
            Vector::splat(base[(1, k)]),
            Vector::splat(base[(2, k)]),
        ]
    };
    let ([mut x, mut y, mut z], t) = (
        [column(0), column(1), column(2)],
        robot.base.translation.vector,
    );
    let mut origin = [Vector::splat(t.x), Vector::splat(t.y), Vector::splat(t.z)];
    let cos_sin_q = &poses.cos_sin_q[chunk * poses.n_links..(chunk + 1) * poses.n_links];
    for (link, (constants, [cos_q, sin_q])) in robot.constants.iter().zip(cos_sin_q).enumerate() {
        keep(link, Axis::X, &x, &origin);
        let (sa, ca) = constants.alpha;
        (y, z) = turned(y, z, Vector::splat(ca), Vector::splat(sa));
        origin = along(x, constants.a, origin);
        keep(link, Axis::Y, &y, &origin);
        let (sb, cb) = constants.beta;
        if sb != 0.0 {
            (z, x) = turned(z, x, Vector::splat(cb), Vector::splat(sb));
        }
        // sine and cosine of q + theta_offset
        let (cos_q, sin_q) = (Vector::load(cos_q, part), Vector::load(sin_q, part));
        let (st, ct) = (
            Vector::splat(constants.theta.0),
            Vector::splat(constants.theta.1),
        );
        let (c, s) = (
            ct.mul_add(cos_q, -(st * sin_q)),
            ct.mul_add(sin_q, st * cos_q),
        );
        (x, y) = turned(x, y, c, s);
        origin = along(z, constants.d, origin);
        keep(link, Axis::Z, &z, &origin);
    }
    Frame {
        axes: [x, y, z],
        origin,
    }
}

/// ∂(predicted)/∂(one quantity).
#[inline(always)]
#[allow(clippy::too_many_arguments)] // these are the arguments that the derivative depends on
fn column<const W: usize>(
    robot: &OneRobot,
    axes: &[Axes],
    moved: Moved,
    target: usize,
    left_jacobian: &Matrix3<f64>,
    flange: &Frame<W>,
    tip: &[Vector<W>; 3],
    part: usize,
) -> [Vector<W>; 3] {
    match moved {
        Moved::A(link) => Vector::load_all(&axes[link].x[0], part),
        Moved::Alpha(link) => about(&axes[link].x, tip, part),
        Moved::D(link) => Vector::load_all(&axes[link].z[0], part),
        Moved::ThetaOffset(link) => about(&axes[link].z, tip, part),
        Moved::Beta(link) => about(&axes[link].y, tip, part),
        Moved::BaseTranslation(axis) => splat(Vector3::ith(axis, 1.0)),
        Moved::BaseRotation(axis) => cross(
            splat(left_jacobian.column(axis).into()),
            splat(robot.base.translation.vector),
            tip,
        ),
        Moved::Target(of, axis) if of == target => flange.axes[axis],
        Moved::Target(..) | Moved::Nothing => splat(Vector3::zeros()),
    }
}

// Functions, because closures would be compiled for the baseline instruction set.
#[inline(always)]
fn splat<const W: usize>(v: Vector3<f64>) -> [Vector<W>; 3] {
    [Vector::splat(v.x), Vector::splat(v.y), Vector::splat(v.z)]
}

#[inline(always)]
fn about<const W: usize>(
    [axis, origin]: &[[Lanes; 3]; 2],
    tip: &[Vector<W>; 3],
    part: usize,
) -> [Vector<W>; 3] {
    cross(
        Vector::load_all(axis, part),
        Vector::load_all(origin, part),
        tip,
    )
}

/// axis × (tip − origin).
#[inline(always)]
fn cross<const W: usize>(
    axis: [Vector<W>; 3],
    origin: [Vector<W>; 3],
    tip: &[Vector<W>; 3],
) -> [Vector<W>; 3] {
    let ([ax, ay, az], [x, y, z]) = (
        axis,
        [tip[0] - origin[0], tip[1] - origin[1], tip[2] - origin[2]],
    );
    [
        ay.mul_add(z, -(az * y)),
        az.mul_add(x, -(ax * z)),
        ax.mul_add(y, -(ay * x)),
    ]
}
