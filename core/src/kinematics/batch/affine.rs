//! The fixed transform between two commanded rotations, for as many robots as a register has lanes.

use super::lane_link::{Between, Circle, LaneLink};
use super::lanes::{LANES, Lanes, Vector};
use nalgebra::Matrix3;

/// Rotation and translation of as many robots as a register has lanes.
#[derive(Clone, Copy)]
pub(super) struct Affine<const W: usize> {
    pub rotation: [[Vector<W>; 3]; 3],
    pub translation: [Vector<W>; 3],
}

impl<const W: usize> Affine<W> {
    #[inline(always)]
    pub fn store(&self, to: &mut Between, part: usize) {
        for row in 0..3 {
            for column in 0..3 {
                self.rotation[row][column].store(&mut to.rotation[row][column], part);
            }
            self.translation[row].store(&mut to.translation[row], part);
        }
    }

    /// This · Rz(q) · point, as a function of q.
    #[inline(always)]
    pub fn store_circle(&self, [x, y, z]: [Vector<W>; 3], to: &mut Circle, part: usize) {
        for row in 0..3 {
            let [r0, r1, r2] = self.rotation[row];
            r2.mul_add(z, self.translation[row])
                .store(&mut to.centre[row], part);
            r0.mul_add(x, r1 * y).store(&mut to.cos[row], part);
            r1.mul_add(x, -(r0 * y)).store(&mut to.sin[row], part);
        }
    }
}

/// Rx(alpha) · Dx(a) · Ry(beta).
#[inline(always)]
pub(super) fn before_joint<const W: usize>(link: &LaneLink, part: usize) -> Affine<W> {
    let (zero, one) = (Vector::splat(0.0), Vector::splat(1.0));
    let (sa, ca) = (
        Vector::<W>::load(&link.alpha.sin, part),
        Vector::<W>::load(&link.alpha.cos, part),
    );
    let translation = [Vector::load(&link.a, part), zero, zero];
    if !link.has_beta() {
        return Affine {
            rotation: [[one, zero, zero], [zero, ca, -sa], [zero, sa, ca]],
            translation,
        };
    }
    let (sb, cb) = (
        Vector::<W>::load(&link.beta.sin, part),
        Vector::<W>::load(&link.beta.cos, part),
    );
    Affine {
        rotation: [
            [cb, zero, sb],
            [sa * sb, ca, -(sa * cb)],
            [-(ca * sb), sa, ca * cb],
        ],
        translation,
    }
}

/// M_i = Rz(theta_offset_i) · Dz(d_i) · Rx(alpha_{i+1}) · Dx(a_{i+1}) · Ry(beta_{i+1}), from links i and i+1.
#[inline(always)]
pub(super) fn between<const W: usize>(link: &LaneLink, next: &LaneLink, part: usize) -> Affine<W> {
    let (s, c) = (
        Vector::<W>::load(&link.theta.sin, part),
        Vector::<W>::load(&link.theta.cos, part),
    );
    let Affine {
        mut rotation,
        translation: [a, ..],
    } = before_joint(next, part);
    let [x, y, _] = rotation;
    for column in 0..3 {
        rotation[0][column] = c.mul_add(x[column], -(s * y[column]));
        rotation[1][column] = s.mul_add(x[column], c * y[column]);
    }
    Affine {
        rotation,
        translation: [c * a, s * a, Vector::load(&link.d, part)],
    }
}

/// As [`between`] for beta_{i+1} = 0, without the terms that are then 0.
#[inline(always)]
pub(super) fn store_untilted<const W: usize>(
    link: &LaneLink,
    next: &LaneLink,
    to: &mut Between,
    part: usize,
) {
    let (s, c) = (
        Vector::<W>::load(&link.theta.sin, part),
        Vector::<W>::load(&link.theta.cos, part),
    );
    let (sa, ca) = (
        Vector::<W>::load(&next.alpha.sin, part),
        Vector::<W>::load(&next.alpha.cos, part),
    );
    let a = Vector::<W>::load(&next.a, part);
    c.store(&mut to.rotation[0][0], part);
    (-(s * ca)).store(&mut to.rotation[0][1], part);
    (s * sa).store(&mut to.rotation[0][2], part);
    (c * a).store(&mut to.translation[0], part);
    s.store(&mut to.rotation[1][0], part);
    (c * ca).store(&mut to.rotation[1][1], part);
    (-(c * sa)).store(&mut to.rotation[1][2], part);
    (s * a).store(&mut to.translation[1], part);
    sa.store(&mut to.rotation[2][1], part);
    ca.store(&mut to.rotation[2][2], part);
    Vector::<W>::load(&link.d, part).store(&mut to.translation[2], part);
}

/// (I + a·[w]× + b·[w]×²) · R, with [w]×² = w·wᵀ − |w|². It loops over lanes: the compiler vectorises this loop, whereas with so many vectors at a
/// time it would shuffle between registers.
#[inline(always)]
pub(super) fn store_exponential(
    [x, y, z]: &[Lanes; 3],
    a: &Lanes,
    b: &Lanes,
    reference: &Matrix3<f64>,
    to: &mut [[Lanes; 3]; 3],
) {
    for lane in 0..LANES {
        let (x, y, z, a, b) = (x.0[lane], y.0[lane], z.0[lane], a.0[lane], b.0[lane]);
        let (ax, ay, az) = (a * x, a * y, a * z);
        let (bx, by) = (b * x, b * y);
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let exponential = [
            [1.0 - b * (yy + zz), bx.mul_add(y, -az), bx.mul_add(z, ay)],
            [bx.mul_add(y, az), 1.0 - b * (xx + zz), by.mul_add(z, -ax)],
            [bx.mul_add(z, -ay), by.mul_add(z, ax), 1.0 - b * (xx + yy)],
        ];
        for (row, [e0, e1, e2]) in exponential.into_iter().enumerate() {
            for column in 0..3 {
                let [r0, r1, r2] = [
                    reference[(0, column)],
                    reference[(1, column)],
                    reference[(2, column)],
                ];
                to[row][column].0[lane] = e0.mul_add(r0, e1.mul_add(r1, e2 * r2));
            }
        }
    }
}
