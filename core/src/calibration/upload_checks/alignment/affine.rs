//! Distances of predicted points from measured ones before base and target are fitted: scatter, and the part that no affine map explains.

use crate::solvers::orthonormal::span;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// With a known base, one of this many compared points is left out, because it may be a gross row.
const LEFT_OUT: usize = 5;
/// Components below this share of a vector's length are rounding.
const ROUNDING_SHARE: f64 = 1e-9;

/// Rotation and origin of a link's frame, mm.
pub(super) type LinkFrame = (Matrix3<f64>, Vector3<f64>);

/// Sum of squared distances from the centre, mm². The points farthest from the centre of all points are left out.
pub(super) fn scatter_mm2(points: &[Vector3<f64>]) -> f64 {
    let sum: Vector3<f64> = points.iter().sum();
    let centre = sum / points.len() as f64;
    let mut kept: Vec<(f64, &Vector3<f64>)> = points
        .iter()
        .map(|p| ((p - centre).norm_squared(), p))
        .collect();
    kept.sort_by(|a, b| a.0.total_cmp(&b.0));
    kept.truncate(points.len() - points.len() / LEFT_OUT);
    let sum: Vector3<f64> = kept.iter().map(|(_, p)| *p).sum();
    let centre = sum / kept.len() as f64;
    kept.iter().map(|(_, p)| (*p - centre).norm_squared()).sum()
}

/// Projector onto the orthogonal complement of the measured coordinates and a constant. It leaves the remainder of the data after the best
/// affine function of the measured positions is subtracted.
pub(super) fn beyond_affine(positions: &[Vector3<f64>]) -> DMatrix<f64> {
    let n = positions.len();
    let columns = DMatrix::from_fn(n, 4, |row, column| match column {
        3 => 1.0,
        axis => positions[row][axis],
    });
    let all = DMatrix::identity(n, n);
    span(&columns).map_or(all.clone(), |affine| all - &affine * affine.transpose())
}

/// Σ |t + R·x − affine image of the measured positions|², minimised over the target x and the affine map, mm². The right base is such a map. A wrong
/// model may also come near, so candidates with a small cost are fitted afterwards.
pub(super) fn affine_cost_mm2(beyond_affine: &DMatrix<f64>, frames: &[LinkFrame]) -> f64 {
    let (mut normal, mut right, mut squares) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for row in beyond_affine.row_iter() {
        let (mut r, mut t) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
        for (weight, (rotation, origin)) in row.iter().zip(frames) {
            r += rotation * *weight;
            t += origin * *weight;
        }
        normal += r.tr_mul(&r);
        right += r.tr_mul(&t);
        squares += t.norm_squared();
    }
    // A small ridge, which only bounds unobservable components.
    let ridge = normal.trace() * ROUNDING_SHARE + f64::MIN_POSITIVE;
    let along = (normal + Matrix3::identity() * ridge)
        .cholesky()
        .map_or(0.0, |decomposed| right.dot(&decomposed.solve(&right)));
    (squares - along).max(0.0)
}
