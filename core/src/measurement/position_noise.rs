//! Anisotropic noise of a measured position: stated along the axes of the measuring frame, along and across the beam of an instrument, or as a
//! covariance.

use nalgebra::{Matrix3, Vector3};

/// Standard uncertainties that differ by less than this share count as equal. No calibration certificate states more digits.
const EQUAL_SHARE: f64 = 1e-9;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 1000;
/// Allowed asymmetry of a covariance, as a share of its largest entry. It allows for values with six digits in a file.
const SYMMETRIC: f64 = 1e-6;

/// Smallest standard uncertainty of a point, mm. No instrument is better than a nanometre. A limit is needed because weights are 1/std².
pub const MIN_STD_MM: f64 = 1.0e-6;
/// Largest standard uncertainty of a point, mm.
pub const MAX_STD_MM: f64 = 1000.0;
/// Code of the refusal of a matrix that is not the covariance of a position.
pub const NOT_A_COVARIANCE: &str = "not_a_covariance";

/// Noise of a position: standard uncertainties along three orthogonal axes. The covariance is A · diag(std²) · Aᵀ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionNoise {
    /// A: unit vectors of the axes in the measuring frame, one per column.
    pub axes: Matrix3<f64>,
    /// One standard deviation along each axis, mm.
    pub std_mm: Vector3<f64>,
}

/// Noise model of an instrument at the origin of the measuring frame that measures a range and two angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstrumentNoise {
    /// One standard deviation of the range, mm: the constant part.
    pub range_std_mm: f64,
    /// One standard deviation of the range: the part that grows with the range, mm per m.
    pub range_std_mm_per_m: f64,
    /// One standard deviation of each angle, rad.
    pub angle_std_rad: f64,
}

impl PositionNoise {
    /// Noise with these standard uncertainties along the axes of the measuring frame.
    pub fn of_axes(std_mm: Vector3<f64>) -> Self {
        Self {
            axes: Matrix3::identity(),
            std_mm,
        }
    }

    /// Noise with this covariance, mm². The axes are its eigenvectors. `None` if the matrix is not symmetric or an eigenvalue is not positive.
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

    /// Noise with a covariance that somebody stated, mm².
    ///
    /// # Errors
    /// What is wrong, if the matrix is no covariance or its standard uncertainties are not within the limits.
    pub fn of_stated_covariance(covariance_mm2: &Matrix3<f64>) -> Result<Self, String> {
        let range = MIN_STD_MM..=MAX_STD_MM;
        let noise = Self::of_covariance(covariance_mm2);
        let noise = noise.filter(|noise| noise.std_mm.iter().all(|std| range.contains(std)));
        noise.ok_or_else(|| {
            format!(
                "a covariance is symmetric, and the square roots of its eigenvalues are {MIN_STD_MM} to {MAX_STD_MM} mm"
            )
        })
    }

    /// Root mean square of the three standard uncertainties, mm.
    pub fn rms_mm(&self) -> f64 {
        self.std_mm.norm() / 3.0_f64.sqrt()
    }

    /// True if the noise is the same in all directions.
    pub fn is_isotropic(&self) -> bool {
        self.std_mm.max() - self.std_mm.min() <= EQUAL_SHARE * self.std_mm.max()
    }

    /// The covariance, mm².
    pub fn covariance_mm2(&self) -> Matrix3<f64> {
        let variances = self.std_mm.component_mul(&self.std_mm);
        self.axes * Matrix3::from_diagonal(&variances) * self.axes.transpose()
    }

    /// Whitening matrix W for this noise plus an independent isotropic part with standard deviation s = `beside_mm`. All rows of W · residual have
    /// the same variance, [`Self::rms_mm`]² + s². Row k is along axis k. Wᵀ·W is this variance times the inverse of the covariance.
    pub fn whitening(&self, beside_mm: f64) -> Matrix3<f64> {
        Matrix3::from_diagonal(&self.whitening_scales(beside_mm)) * self.axes.transpose()
    }

    /// Factor by which [`Self::whitening`] scales each axis.
    pub fn whitening_scales(&self, beside_mm: f64) -> Vector3<f64> {
        let beside_mm2 = beside_mm * beside_mm;
        let rms_mm = self.rms_mm();
        let row_mm = (rms_mm * rms_mm + beside_mm2).sqrt();
        self.std_mm
            .map(|std| row_mm / (std * std + beside_mm2).sqrt())
    }
}

impl InstrumentNoise {
    /// The noise at a position in the measuring frame (mm). The first axis is the beam. Across the beam, the standard uncertainty is the distance
    /// times the standard uncertainty of an angle, but at least `least_mm`.
    pub fn at(&self, position_mm: &Vector3<f64>, least_mm: f64) -> PositionNoise {
        let distance_mm = position_mm.norm();
        let range_mm = self.range_std_mm + self.range_std_mm_per_m * (distance_mm / 1000.0);
        let across_mm = (distance_mm * self.angle_std_rad).max(least_mm);
        // At the origin the direction of the beam is not defined, so z is used.
        let beam = position_mm.try_normalize(0.0).unwrap_or_else(Vector3::z);
        // The axis of the frame that is closest to perpendicular to the beam.
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
        assert!(alike.is_isotropic() && !noise.is_isotropic());
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
