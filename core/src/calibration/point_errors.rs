//! Errors of single points.

use crate::measurement::Subset;
use nalgebra::Vector3;

/// One point's error before and after.
#[derive(Clone, Debug, PartialEq)]
pub struct PointErrors {
    /// Its configuration.
    pub configuration: String,
    /// Its name in the file, if it has one.
    pub name: Option<String>,
    /// Its target.
    pub target: usize,
    /// Its subset.
    pub subset: Subset,
    /// |residual| of the nominal robot, mm.
    pub before_mm: f64,
    /// |residual| of the identified robot, mm.
    pub after_mm: f64,
    /// Measured position, in the measuring frame, mm.
    pub position_mm: Vector3<f64>,
    /// Residual (measured − predicted) of the nominal robot, in the measuring frame, mm.
    pub before_vector_mm: Vector3<f64>,
    /// Residual of the identified robot, in the measuring frame, mm.
    pub after_vector_mm: Vector3<f64>,
    /// Residual with corrections, if they were searched, in the measuring frame, mm; the same as without corrections if none was kept.
    pub corrected_vector_mm: Option<Vector3<f64>>,
    /// For a pose: angles between the measured target and its prediction by the nominal robot, the identified robot, and the robot with corrections,
    /// rad.
    pub rotation_rad: Option<[f64; 3]>,
    /// True if a warning names the point as an outlier, and outliers are few enough to be left out of comparisons.
    pub is_outlier: bool,
}

impl PointErrors {
    /// What it is called in texts: its name, or else its configuration.
    pub fn shown(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.configuration)
    }

    /// True if corrections change its residual.
    pub fn is_corrected(&self) -> bool {
        let corrected = self.corrected_vector_mm;
        corrected.is_some_and(|vector| vector != self.after_vector_mm)
    }

    /// Errors before, after, and with corrections, mm, as [`crate::calibration::robust_comparison`] takes them.
    pub fn errors_mm(&self) -> [f64; 3] {
        [
            self.before_mm,
            self.after_mm,
            self.corrected_vector_mm
                .map_or(self.after_mm, |vector| vector.norm()),
        ]
    }
}

/// [`PointErrors::errors_mm`] of the points that are not left out of comparisons.
pub fn counted_errors_mm(points: &[PointErrors]) -> Vec<[f64; 3]> {
    let counted = points.iter().filter(|point| !point.is_outlier);
    counted.map(PointErrors::errors_mm).collect()
}
