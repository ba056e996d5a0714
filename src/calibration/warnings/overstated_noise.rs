//! Stated noise of the instrument that is much larger than the scatter of the points.

use crate::calibration::problem::Problem;
use crate::calibration::report::Warning;
use crate::identification::KinematicModel;
use crate::measurement::Subset;

/// Warning and refusal code.
pub const NOISE_OVERSTATED: &str = "noise_overstated";

/// The stated noise is overstated if it is more than this many times the scatter. Model errors only add to the scatter.
const OVERSTATED: f64 = 3.0;
/// Minimum number of redundant equations for the comparison. With them, right statements are this far off by chance in fewer than one of 10⁶ files.
const FEWEST_REDUNDANT: usize = 20;

/// Stated noise and scatter, one standard deviation of a coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverstatedNoise {
    /// The stated noise, rms over the points, mm.
    pub stated_mm: f64,
    /// The scatter about the fit, mm.
    pub scatter_mm: f64,
}

impl OverstatedNoise {
    /// Compares the stated noise of the fitted positions with their residuals. `None` if nothing is stated, if it is about right or too small, or if
    /// there are too few equations.
    pub fn of(problem: &Problem<'_>, model: &KinematicModel) -> Option<Self> {
        let observed = &problem.observed;
        let points = problem.request.set.points.iter();
        let fitted = points.zip(&observed.all).zip(&observed.subsets);
        let (mut n, mut stated, mut scatter, mut ratio) = (0, 0.0, 0.0, 0.0);
        for ((point, o), subset) in fitted {
            let std_mm = point.position_std_mm().filter(|std_mm| *std_mm > 0.0);
            let (Some(std_mm), Subset::Identify, true) = (std_mm, *subset, o.weight > 0.0) else {
                continue;
            };
            let square = (o.position_mm - model.position(&o.q_rad, o.target)).norm_squared();
            n += 1;
            stated += std_mm * std_mm;
            scatter += square;
            ratio += square / (std_mm * std_mm);
        }
        let redundant = (3 * n as usize).checked_sub(problem.parameters.len())?;
        let is_overstated = ratio * OVERSTATED * OVERSTATED < redundant as f64;
        (redundant >= FEWEST_REDUNDANT && is_overstated).then(|| Self {
            stated_mm: (stated / f64::from(n)).sqrt(),
            scatter_mm: (scatter / redundant as f64).sqrt(),
        })
    }

    /// The comparison in words.
    pub fn in_words(&self) -> String {
        format!(
            "a noise of {:.3} mm is stated for the instrument, and the points scatter by {:.3} mm about the fit (one standard deviation of a coordinate)",
            self.stated_mm, self.scatter_mm
        )
    }

    /// The warning of a job.
    pub fn warning(&self) -> Warning {
        Warning {
            code: NOISE_OVERSTATED,
            detail: format!(
                "{}. A stated noise is a lower bound: the stated uncertainty is too large, and changes of the robot stay hidden. State the instrument's noise in mm, \
                 or leave it out",
                self.in_words()
            ),
            rows: vec![],
        }
    }
}
