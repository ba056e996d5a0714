//! The result of a quick check, as part of a report.

pub use crate::calibration::CheckVerdict;
pub use crate::calibration::quick_check::{
    DetectableChange as DetectableReport, QuickCheck as CheckReport,
};
