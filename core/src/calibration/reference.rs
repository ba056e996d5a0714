//! Scale error of an instrument, from lengths with a certificate that it measured: a scale bar, an interferometer, gauge blocks.

use crate::identification::statistics::workspace::ToolUncertainty;
use crate::kinematics::{Link, reach_mm};

/// A known length, and the instrument's measurement of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceLength {
    /// Length of the certificate, mm.
    pub nominal_mm: f64,
    /// Measured length, mm.
    pub measured_mm: f64,
    /// Standard uncertainty of their difference, mm: of certificate and measurement together.
    pub std_mm: f64,
}

/// Relative error of all lengths that an instrument measures: it measures (1 + `error`) times a length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstrumentScale {
    /// The relative error.
    pub error: f64,
    /// Its standard uncertainty.
    pub std: f64,
}

/// The reference shows a scale error if the error exceeds this multiple of its standard uncertainty. By chance, one in twenty correct
/// instruments exceeds it.
const COVERAGE: f64 = 2.0;

impl InstrumentScale {
    /// Weighted least squares of measured − nominal = error · nominal + noise. If the lengths scatter more than their uncertainties say, the standard
    /// uncertainty is multiplied by the Birge ratio √(χ²/(n − 1)) [Birge 1932]. `None` without lengths.
    pub fn of(lengths: &[ReferenceLength]) -> Option<Self> {
        let sum = |of: &dyn Fn(&ReferenceLength) -> f64| lengths.iter().map(of).sum::<f64>();
        let weight = |l: &ReferenceLength| 1.0 / (l.std_mm * l.std_mm);
        let information = sum(&|l| weight(l) * l.nominal_mm * l.nominal_mm);
        if lengths.is_empty() {
            return None;
        }
        let error =
            sum(&|l| weight(l) * l.nominal_mm * (l.measured_mm - l.nominal_mm)) / information;
        let alone = Self {
            error,
            std: 1.0 / information.sqrt(),
        };
        let chi_square = sum(&|l| alone.residual_stds(l) * alone.residual_stds(l));
        let birge = match lengths.len() {
            1 => 1.0,
            n => (chi_square / (n - 1) as f64).sqrt().max(1.0),
        };
        Some(Self {
            std: birge * alone.std,
            ..alone
        })
    }

    /// Difference of the measured length from the certified one after the scale error is removed, in standard uncertainties.
    pub fn residual_stds(&self, length: &ReferenceLength) -> f64 {
        (length.measured_mm - length.nominal_mm * (1.0 + self.error)) / length.std_mm
    }

    /// Whether the reference shows an error of the instrument.
    pub fn is_off(&self) -> bool {
        self.error.abs() > COVERAGE * self.std
    }

    /// Standard uncertainty of a length of `length_mm` measured with the instrument, mm. Positions are not corrected for the scale error,
    /// so the error itself is included.
    pub fn std_mm(&self, length_mm: f64) -> f64 {
        libm::hypot(self.error, self.std) * length_mm
    }

    /// Whether a relative error `scale` of all lengths of a robot comes mostly from the instrument.
    pub fn explains(&self, scale: f64) -> bool {
        (scale - self.error).abs() <= 0.5 * scale.abs()
    }
}

/// The scale of the instrument that measured a robot, and its effect at the arm's reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleAtReach {
    /// The scale.
    pub scale: InstrumentScale,
    /// [`InstrumentScale::std_mm`] at the reach, mm.
    pub std_mm: f64,
}

impl ScaleAtReach {
    /// The scale for a robot with these nominal links.
    pub fn new(scale: InstrumentScale, nominal: &[Link]) -> Self {
        Self {
            scale,
            std_mm: scale.std_mm(reach_mm(nominal)),
        }
    }

    /// Adds the uncertainty of the scale to that of a tool, as the root of the sum of squares.
    pub fn added_to(&self, tool: ToolUncertainty) -> ToolUncertainty {
        ToolUncertainty {
            mean_mm: libm::hypot(tool.mean_mm, self.std_mm),
            max_mm: libm::hypot(tool.max_mm, self.std_mm),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{InstrumentScale, ReferenceLength};

    fn length(nominal_mm: f64, error: f64, std_mm: f64) -> ReferenceLength {
        ReferenceLength {
            nominal_mm,
            measured_mm: nominal_mm * (1.0 + error),
            std_mm,
        }
    }

    #[test]
    fn one_length_gives_its_own_relative_error_and_uncertainty() {
        let scale = InstrumentScale::of(&[length(2000.0, 20e-6, 0.01)]).unwrap();
        assert!((scale.error - 20e-6).abs() < 1e-15);
        assert!((scale.std - 5e-6).abs() < 1e-15);
        assert!(scale.is_off() && scale.explains(20e-6) && !scale.explains(200e-6));
        // 3 m: 0.06 mm of error and 0.015 mm of uncertainty
        assert!((scale.std_mm(3000.0) - libm::hypot(0.06, 0.015)).abs() < 1e-12);
    }

    #[test]
    fn lengths_that_scatter_more_than_stated_are_less_certain() {
        // errors of +2 and −2 standard uncertainties of equal lengths: mean 0, χ² = 8 with one degree of freedom
        let both = [length(1000.0, 20e-6, 0.01), length(1000.0, -20e-6, 0.01)];
        let scale = InstrumentScale::of(&both).unwrap();
        assert!(scale.error.abs() < 1e-15 && !scale.is_off());
        assert!((scale.residual_stds(&both[0]) - 2.0).abs() < 1e-9);
        assert!((scale.std - 8.0_f64.sqrt() * 1e-5 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(InstrumentScale::of(&[]), None);
    }
}
