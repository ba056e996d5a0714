//! Sine and cosine of deviations, all lanes at once.
//!
//! Deviations are small. Below π/4 the polynomials of fdlibm's `k_sin.c` and `k_cos.c` (Sun Microsystems, 1993) are accurate to one ulp without range
//! reduction. `libm` computes larger angles, lane by lane. The result of a lane depends on its own angle alone.

use super::lanes::{LANES, Lanes, Vector};
use std::f64::consts::FRAC_PI_4;

/// sin x = x + x³·(S1 + x²·(S2 + …)), from the highest power down.
const SIN: [f64; 6] = [
    1.58969099521155e-10,
    -2.5050760253406863e-08,
    2.7557313707070068e-06,
    -0.0001984126982985795,
    0.00833333333332249,
    -0.16666666666666632,
];
/// cos x = 1 − x²/2 + x⁴·(C1 + x²·(C2 + …)), from the highest power down.
const COS: [f64; 6] = [
    -1.1359647557788195e-11,
    2.087572321298175e-09,
    -2.7557314351390663e-07,
    2.480158728947673e-05,
    -0.001388888888887411,
    0.0416666666666666,
];

/// Largest angle for which the polynomials are accurate.
pub(super) const LARGEST_RAD: f64 = FRAC_PI_4;

#[inline(always)]
fn series<const W: usize>(coefficients: &[f64; 6], square: Vector<W>) -> Vector<W> {
    let mut sum = Vector::splat(coefficients[0]);
    for c in &coefficients[1..] {
        sum = sum.mul_add(square, Vector::splat(*c));
    }
    sum
}

/// (sin x, cos x) for |x| ≤ [`LARGEST_RAD`].
#[inline(always)]
pub(super) fn sin_cos<const W: usize>(x: Vector<W>) -> (Vector<W>, Vector<W>) {
    let square = x * x;
    let sin = (series(&SIN, square) * square).mul_add(x, x);
    let below_one = series(&COS, square).mul_add(square, Vector::splat(-0.5));
    (sin, below_one.mul_add(square, Vector::splat(1.0)))
}

/// (sin |w| / |w|, (1 − cos |w|) / |w|²): the factors of Rodrigues' formula.
#[inline(always)]
pub(super) fn rotation_terms<const W: usize>(rotation_rad: &[Lanes; 3]) -> (Lanes, Lanes) {
    let (mut sine, mut versine, mut squares) = (Lanes::ZERO, Lanes::ZERO, Lanes::ZERO);
    for part in 0..Vector::<W>::PER_CHUNK {
        let [x, y, z] = Vector::<W>::load_all(rotation_rad, part);
        let square = x.mul_add(x, y.mul_add(y, z * z));
        square.store(&mut squares, part);
        series(&SIN, square)
            .mul_add(square, Vector::splat(1.0))
            .store(&mut sine, part);
        (-series(&COS, square))
            .mul_add(square, Vector::splat(0.5))
            .store(&mut versine, part);
    }
    for lane in (0..LANES).filter(|lane| squares.0[*lane] > LARGEST_RAD * LARGEST_RAD) {
        let angle = squares.0[lane].sqrt();
        let (s, c) = libm::sincos(angle);
        (sine.0[lane], versine.0[lane]) = (s / angle, (1.0 - c) / squares.0[lane]);
    }
    (sine, versine)
}
