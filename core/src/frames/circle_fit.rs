//! A circle in space through the points of one sweep.

use crate::frames::error::Error;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Maximum number of Gauss-Newton steps of the plane circle fit; it converges quadratically from the algebraic fit.
const MAX_STEPS: usize = 50;
/// Iteration limit of a singular value decomposition of at most three columns.
const SVD_ITERATIONS: usize = 1000;

/// A circle in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Centre, mm.
    pub centre_mm: Vector3<f64>,
    /// Unit normal, with either sign.
    pub normal: Vector3<f64>,
    /// Radius, mm.
    pub radius_mm: f64,
    /// Root mean square distance of the points from the circle, mm.
    pub rms_mm: f64,
}

/// Least-squares circle. The plane is fitted by total least squares. In the plane, the algebraic fit (Kåsa 1976) is the start of a geometric fit
/// (Gauss-Newton on the distances).
///
/// # Errors
/// [`Error::DegenerateSweep`] if the points do not span a circle (fewer than three, on a line, all equal).
pub fn fit_circle(joint: usize, points_mm: &[Vector3<f64>]) -> Result<Circle, Error> {
    let degenerate = || Error::DegenerateSweep { joint };
    if points_mm.len() < 3 {
        return Err(degenerate());
    }
    let centroid = points_mm.iter().sum::<Vector3<f64>>() / points_mm.len() as f64;
    let offsets = DMatrix::from_fn(points_mm.len(), 3, |row, axis| {
        (points_mm[row] - centroid)[axis]
    });
    let svd = offsets
        .clone()
        .try_svd(false, true, f64::EPSILON, SVD_ITERATIONS)
        .ok_or_else(degenerate)?;
    let axes = svd.v_t.ok_or_else(degenerate)?;
    if svd.singular_values[1] <= 1e-6 * svd.singular_values[0] {
        return Err(degenerate());
    }
    let axis = |i: usize| Vector3::new(axes[(i, 0)], axes[(i, 1)], axes[(i, 2)]);
    let (u, v) = (axis(0), axis(1));
    let plane: Vec<(f64, f64)> = points_mm
        .iter()
        .map(|p| ((p - centroid).dot(&u), (p - centroid).dot(&v)))
        .collect();
    let (x, y, radius_mm) =
        geometric(&plane, algebraic(&plane).ok_or_else(degenerate)?).ok_or_else(degenerate)?;
    let centre_mm = centroid + u * x + v * y;
    let normal = u.cross(&v);
    Ok(Circle {
        centre_mm,
        normal,
        radius_mm,
        rms_mm: rms_distance(points_mm, &centre_mm, &normal, radius_mm),
    })
}

/// Kåsa's fit: least squares of x² + y² = 2·x0·x + 2·y0·y + c.
fn algebraic(points: &[(f64, f64)]) -> Option<(f64, f64, f64)> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (x, y) in points {
        let row = Vector3::new(*x, *y, 1.0);
        normal += row * row.transpose();
        right += row * (x * x + y * y);
    }
    let solution = normal.lu().solve(&right)?;
    let (x0, y0) = (solution[0] / 2.0, solution[1] / 2.0);
    Some((x0, y0, (solution[2] + x0 * x0 + y0 * y0).sqrt()))
}

/// Gauss-Newton on Σ (|p − centre| − radius)².
fn geometric(points: &[(f64, f64)], start: (f64, f64, f64)) -> Option<(f64, f64, f64)> {
    let (mut x0, mut y0, mut radius) = start;
    for _ in 0..MAX_STEPS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (x, y) in points {
            let distance = ((x - x0) * (x - x0) + (y - y0) * (y - y0)).sqrt();
            let row = Vector3::new((x - x0) / distance, (y - y0) / distance, 1.0);
            normal += row * row.transpose();
            right += row * (distance - radius);
        }
        let step = normal.lu().solve(&right)?;
        (x0, y0, radius) = (x0 + step[0], y0 + step[1], radius + step[2]);
        if step.norm() <= 1e-12 * radius.abs() {
            break;
        }
    }
    (x0.is_finite() && y0.is_finite() && radius.is_finite()).then_some((x0, y0, radius))
}

fn rms_distance(
    points_mm: &[Vector3<f64>],
    centre: &Vector3<f64>,
    normal: &Vector3<f64>,
    radius_mm: f64,
) -> f64 {
    let square = |p: &Vector3<f64>| {
        let height = (p - centre).dot(normal);
        let radial = (p - centre - normal * height).norm() - radius_mm;
        height * height + radial * radial
    };
    (points_mm.iter().map(square).sum::<f64>() / points_mm.len() as f64).sqrt()
}
