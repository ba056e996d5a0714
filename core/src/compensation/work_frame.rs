//! A work frame from measured points of a fixture. The points are known in the fixture's frame and were measured in another frame.

use crate::identification::least_squares::start::rigid_motion;
use nalgebra::{IsometryMatrix3, Matrix3, Matrix6, SMatrix, Vector3};

/// Minimum number of points: three, not on a line.
pub const MIN_POINTS: usize = 3;
/// Points count as on a line if the second largest spread is below this share of the largest. The rotation about the line would then be ten
/// times more uncertain than the other rotations.
const ON_A_LINE: f64 = 0.1;
/// Points count as in a plane if the smallest spread is below this share of the middle one. A mirrored drawing would then differ by less
/// than the errors of most drawings.
const FLAT_SPREAD: f64 = 0.01;
/// Heights above this multiple of the noise would show a mirrored drawing.
const SHOWN: f64 = 3.0;
/// Heights below this share of the middle spread are rounding.
const ROUNDING: f64 = 1e-9;

/// A point of a fixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixturePoint {
    /// Position in the work frame, as drawn, mm.
    pub nominal_mm: Vector3<f64>,
    /// Position in the frame that it was measured in, mm.
    pub measured_mm: Vector3<f64>,
}

/// A work frame and its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkFrame {
    /// The work frame in the frame in which it was measured or entered, mm.
    pub t_reference_work: IsometryMatrix3<f64>,
    /// Distance of each measured point from its position in the fitted frame, mm; empty for an entered frame.
    pub residuals_mm: Vec<f64>,
    /// Noise of one coordinate of a point, mm, and the covariance of small motions of the frame for unit noise: translation, then rotation vector
    /// about the points' centre.
    spread: Option<Spread>,
}

#[derive(Clone, Debug, PartialEq)]
struct Spread {
    noise_std_mm: f64,
    centre_mm: Vector3<f64>,
    covariance: Matrix6<f64>,
}

/// Why the points do not determine a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WorkFrameError {
    /// Fewer than three points.
    #[error("a frame needs at least {MIN_POINTS} points")]
    TooFew,
    /// The points are on a line, or at one place.
    #[error("the points lie on a line, so the turn about it is unknown: add a point beside it")]
    OnALine,
}

impl WorkFrame {
    /// A frame that was entered; it is taken as exact.
    pub fn typed(t_reference_work: IsometryMatrix3<f64>) -> Self {
        Self {
            t_reference_work,
            residuals_mm: vec![],
            spread: None,
        }
    }

    /// The frame that best fits the points (Kabsch 1976). The noise of a coordinate is the larger of `std_mm` and the noise from the residuals:
    /// sqrt(Σ|r|² / (3·n − 6)).
    ///
    /// # Errors
    /// [`WorkFrameError`] for fewer than three points, or points on a line.
    pub fn measured(points: &[FixturePoint], std_mm: f64) -> Result<Self, WorkFrameError> {
        let n = points.len();
        if n < MIN_POINTS {
            return Err(WorkFrameError::TooFew);
        }
        let (nominal, measured): (Vec<_>, Vec<_>) =
            points.iter().map(|p| (p.nominal_mm, p.measured_mm)).unzip();
        if is_on_a_line(&nominal) || is_on_a_line(&measured) {
            return Err(WorkFrameError::OnALine);
        }
        let t_reference_work = rigid_motion(&nominal, &measured);
        let fitted =
            |p: &Vector3<f64>| t_reference_work.rotation * p + t_reference_work.translation.vector;
        let residuals_mm: Vec<f64> = nominal
            .iter()
            .zip(&measured)
            .map(|(nominal, measured)| (measured - fitted(nominal)).norm())
            .collect();
        let squares_mm2: f64 = residuals_mm.iter().map(|r| r * r).sum();
        let shown_mm = (squares_mm2 / (3 * n - 6) as f64).sqrt();
        let centre_mm = measured.iter().sum::<Vector3<f64>>() / n as f64;
        let normal: Matrix6<f64> = measured
            .iter()
            .map(|p| by_motion(&(p - centre_mm)))
            .map(|j| j.transpose() * j)
            .sum();
        let covariance = normal.try_inverse().ok_or(WorkFrameError::OnALine)?;
        Ok(Self {
            t_reference_work,
            residuals_mm,
            spread: Some(Spread {
                noise_std_mm: shown_mm.max(std_mm),
                centre_mm,
                covariance,
            }),
        })
    }

    /// Root mean square of the residuals, mm; 0 for an entered frame.
    pub fn rms_mm(&self) -> f64 {
        let squares: f64 = self.residuals_mm.iter().map(|r| r * r).sum();
        (squares / self.residuals_mm.len().max(1) as f64).sqrt()
    }

    /// Standard deviation (3-D) of the position of a point in the work frame, mm.
    pub fn position_std_mm(&self, p_work_mm: &Vector3<f64>) -> f64 {
        let Some(spread) = &self.spread else {
            return 0.0;
        };
        let t = &self.t_reference_work;
        let there = t.rotation * p_work_mm + t.translation.vector;
        let j = by_motion(&(there - spread.centre_mm));
        spread.noise_std_mm * (j * spread.covariance * j.transpose()).trace().sqrt()
    }
}

/// ∂(point)/∂(translation, rotation vector) for a point at `arm` from the centre of rotation.
fn by_motion(arm: &Vector3<f64>) -> SMatrix<f64, 3, 6> {
    let mut j = SMatrix::<f64, 3, 6>::zeros();
    j.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&Matrix3::identity());
    j.fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&-arm.cross_matrix());
    j
}

fn is_on_a_line(points: &[Vector3<f64>]) -> bool {
    let [_, middle, largest] = spreads(points);
    middle <= ON_A_LINE * largest
}

/// True if the points of a drawing lie in one plane within their noise.
pub fn is_flat(points: &[FixturePoint], noise_mm: f64) -> bool {
    let nominal: Vec<Vector3<f64>> = points.iter().map(|p| p.nominal_mm).collect();
    let [smallest, middle, _] = spreads(&nominal);
    let shown_mm = SHOWN * noise_mm * (points.len() as f64).sqrt();
    smallest <= (FLAT_SPREAD * middle).min(shown_mm.max(ROUNDING * middle))
}

/// Spread of points along their principal axes, ascending, mm.
fn spreads(points: &[Vector3<f64>]) -> [f64; 3] {
    let centre = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let scatter: Matrix3<f64> = points
        .iter()
        .map(|p| (p - centre) * (p - centre).transpose())
        .sum();
    let mut widths = scatter.symmetric_eigenvalues().map(|v| v.max(0.0).sqrt());
    widths.as_mut_slice().sort_by(f64::total_cmp);
    widths.into()
}
