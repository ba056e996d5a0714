//! Noise of a measured position that is not the same in all directions: along the axes of the measuring frame, along and across the beam of an
//! instrument, or as a covariance.

use nalgebra::{Matrix3, Vector3};

/// Axes whose standard uncertainties differ by less than this share are alike: no certificate states a digit more.
const ALIKE: f64 = 1e-9;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 1000;
/// A covariance is symmetric to this share of its largest entry: what six digits of a file leave.
const SYMMETRIC: f64 = 1e-6;

/// Standard uncertainties of a position along three axes that are at right angles to each other: the covariance is
/// A · diag(std²) · Aᵀ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionNoise {
    /// A: unit vectors of the axes, in the measuring frame; one per column.
    pub axes: Matrix3<f64>,
    /// One standard deviation along each of them, mm.
    pub std_mm: Vector3<f64>,
}

/// What an instrument at the origin of the measuring frame states: of the length of its beam, and of both of its angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstrumentNoise {
    /// One standard deviation of a length, mm; its constant part.
    pub range_std_mm: f64,
    /// The part that grows with the length, mm per m.
    pub range_std_mm_per_m: f64,
    /// One standard deviation of each angle, rad.
    pub angle_std_rad: f64,
}

impl PositionNoise {
    /// Along the axes of the measuring frame.
    pub fn of_axes(std_mm: Vector3<f64>) -> Self {
        Self {
            axes: Matrix3::identity(),
            std_mm,
        }
    }

    /// Of a covariance, mm²: its eigenvectors are the axes. `None` where it is not symmetric, or a variance is not positive.
    pub fn of_covariance(covariance_mm2: &Matrix3<f64>) -> Option<Self> {
        let largest = covariance_mm2.amax();
        let skew = covariance_mm2 - covariance_mm2.transpose();
        if !covariance_mm2.iter().all(|v| v.is_finite()) || skew.amax() > SYMMETRIC * largest {
            return None;
        }
        let symmetric = (covariance_mm2 + covariance_mm2.transpose()) * 0.5;
        let eigen = symmetric.try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS)?;
        eigen.eigenvalues.iter().all(|v| *v > 0.0).then(|| Self {
            axes: eigen.eigenvectors,
            std_mm: eigen.eigenvalues.map(f64::sqrt),
        })
    }

    /// Root mean square of the three standard uncertainties, mm.
    pub fn rms_mm(&self) -> f64 {
        self.std_mm.norm() / 3.0_f64.sqrt()
    }

    /// True if no direction differs from another.
    pub fn is_alike(&self) -> bool {
        self.std_mm.max() - self.std_mm.min() <= ALIKE * self.std_mm.max()
    }

    /// W of the rows W · residual that all have the variance [`Self::rms_mm`]² + s², s in mm: the noise with a part beside it that is the same in
    /// all directions. Row k is along axis k. Wᵀ·W is that variance times the inverse of the covariance.
    pub fn whitening(&self, beside_mm: f64) -> Matrix3<f64> {
        Matrix3::from_diagonal(&self.stretched(beside_mm)) * self.axes.transpose()
    }

    /// By how much [`Self::whitening`] stretches each axis.
    pub fn stretched(&self, beside_mm: f64) -> Vector3<f64> {
        let beside_mm2 = beside_mm * beside_mm;
        let rms_mm = self.rms_mm();
        let row_mm = (rms_mm * rms_mm + beside_mm2).sqrt();
        self.std_mm
            .map(|std| row_mm / (std * std + beside_mm2).sqrt())
    }
}

impl InstrumentNoise {
    /// At a position in the measuring frame, mm: the first axis is the beam. Across it the standard uncertainty is the distance times that of an
    /// angle, at least `least_mm`.
    pub fn at(&self, position_mm: &Vector3<f64>, least_mm: f64) -> PositionNoise {
        let distance_mm = position_mm.norm();
        let range_mm = self.range_std_mm + self.range_std_mm_per_m * (distance_mm / 1000.0);
        let across_mm = (distance_mm * self.angle_std_rad).max(least_mm);
        // at the origin the beam has any direction
        let beam = position_mm.try_normalize(0.0).unwrap_or_else(Vector3::z);
        // the axis of the frame that is farthest from the beam
        let farthest = Vector3::ith(beam.iamin(), 1.0);
        let across = beam.cross(&farthest).normalize();
        PositionNoise {
            axes: Matrix3::from_columns(&[beam, across, beam.cross(&across)]),
            std_mm: Vector3::new(range_mm, across_mm, across_mm),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a few products.
    const ROUNDING: f64 = 1e-12;

    fn covariance_mm2(noise: &PositionNoise) -> Matrix3<f64> {
        let variances = noise.std_mm.map(|std| std * std);
        noise.axes * Matrix3::from_diagonal(&variances) * noise.axes.transpose()
    }

    #[test]
    fn a_beam_is_noisy_across_by_its_length_times_the_angle() {
        let tracker = InstrumentNoise {
            range_std_mm: 0.01,
            range_std_mm_per_m: 0.001,
            angle_std_rad: 25e-6,
        };
        for position in [
            Vector3::new(4000.0, 0.0, 0.0),
            Vector3::new(-1000.0, 2000.0, 1500.0),
            Vector3::new(0.0, 0.0, -3000.0),
        ] {
            let noise = tracker.at(&position, 1e-6);
            let (r, u) = (position.norm(), position.normalize());
            // C = range²·u·uᵀ + (r·angle)²·(1 − u·uᵀ)
            let beam = u * u.transpose();
            let range = 0.01 + 1e-6 * r;
            let across = r * 25e-6;
            let expected =
                beam * (range * range) + (Matrix3::identity() - beam) * (across * across);
            let off = (covariance_mm2(&noise) - expected).amax();
            assert!(off < ROUNDING, "{position}: {off}");
            assert!((noise.axes.determinant() - 1.0).abs() < ROUNDING);
        }
        let at_origin = tracker.at(&Vector3::zeros(), 1e-6);
        assert!(at_origin.axes.iter().all(|v| v.is_finite()));
        assert_eq!(at_origin.std_mm, Vector3::new(0.01, 1e-6, 1e-6));
    }

    #[test]
    fn whitened_rows_have_one_variance_and_no_covariance() {
        let covariance = Matrix3::new(0.04, 0.01, -0.02, 0.01, 0.09, 0.03, -0.02, 0.03, 0.25);
        let noise = PositionNoise::of_covariance(&covariance).unwrap();
        assert!((covariance_mm2(&noise) - covariance).amax() < ROUNDING);
        for beside_mm in [0.0, 0.3] {
            let w = noise.whitening(beside_mm);
            let whole = covariance + Matrix3::identity() * (beside_mm * beside_mm);
            let rows = w * whole * w.transpose();
            let variance = whole.trace() / 3.0;
            assert!((rows - Matrix3::identity() * variance).amax() < ROUNDING);
        }
        let alike = PositionNoise::of_axes(Vector3::repeat(0.1));
        assert!(alike.is_alike() && !noise.is_alike());
        assert!((alike.whitening(0.0) - Matrix3::identity()).amax() < ROUNDING);
    }

    #[test]
    fn a_matrix_that_is_no_covariance_is_none() {
        let none = |m: Matrix3<f64>| PositionNoise::of_covariance(&m).is_none();
        assert!(none(Matrix3::new(
            1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
        )));
        assert!(none(Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1e-3))));
        assert!(none(Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0))));
        assert!(none(Matrix3::repeat(f64::NAN)));
    }
}
