//! Stated noise of the instrument that is much larger than the scatter of the points.

use crate::calibration::problem::Problem;
use crate::calibration::report::Warning;
use crate::identification::KinematicModel;
use crate::identification::model::objective::residual_mm;
use crate::identification::model::pose_rows::rotation_residual_rad;
use crate::measurement::Subset;

/// Warning and refusal code.
pub const NOISE_OVERSTATED: &str = "noise_overstated";

/// The stated noise is overstated if it exceeds this multiple of the scatter. Model errors can only increase the scatter.
const MIN_TIMES_SCATTER: f64 = 3.0;
/// Minimum number of redundant equations for the comparison. With this number, a correct statement exceeds the limit by chance in fewer
/// than one of 10⁶ files.
const MIN_REDUNDANT: usize = 20;

/// Stated noise and scatter, one standard deviation of a coordinate of the position, or of one component of the rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverstatedNoise {
    /// The stated noise, rms over the points, in `unit`.
    pub stated: f64,
    /// The scatter about the fit, in `unit`.
    pub scatter: f64,
    /// `mm` or `°`.
    pub unit: &'static str,
}

/// Stated variances and squared residuals of three components each, summed over the points.
#[derive(Default)]
struct Sums {
    n: usize,
    stated: f64,
    scatter: f64,
    ratio: f64,
}

impl Sums {
    fn add(&mut self, std: f64, square: f64) {
        self.n += 1;
        self.stated += std * std;
        self.scatter += square;
        self.ratio += square / (std * std);
    }

    /// The comparison, if the stated noise is overstated. `per_unit` converts a residual to `unit`.
    fn overstated(
        &self,
        n_parameters: usize,
        per_unit: f64,
        unit: &'static str,
    ) -> Option<OverstatedNoise> {
        let redundant = (3 * self.n).checked_sub(n_parameters)?;
        let is_overstated = self.ratio * MIN_TIMES_SCATTER * MIN_TIMES_SCATTER < redundant as f64;
        (redundant >= MIN_REDUNDANT && is_overstated).then(|| OverstatedNoise {
            stated: per_unit * (self.stated / self.n as f64).sqrt(),
            scatter: per_unit * (self.scatter / redundant as f64).sqrt(),
            unit,
        })
    }
}

impl OverstatedNoise {
    /// Compares the stated noise of the fitted points with their residuals: of positions, then of rotations. `None` if nothing is stated, if it is about
    /// right or too small, or if there are too few equations.
    pub fn of(problem: &Problem<'_>, model: &KinematicModel) -> Option<Self> {
        let observed = &problem.observed;
        let points = problem.request.set.points.iter();
        let fitted = points.zip(&observed.all).zip(&observed.subsets);
        let (mut of_positions, mut of_rotations) = (Sums::default(), Sums::default());
        for ((point, o), subset) in fitted {
            if *subset != Subset::Identify || o.weight <= 0.0 {
                continue;
            }
            if let Some(std_mm) = point.position_std_mm().filter(|std_mm| *std_mm > 0.0) {
                let residual_mm = residual_mm(model, o);
                of_positions.add(std_mm, residual_mm.norm_squared());
            }
            let std_rad = point.std_rotation_rad.filter(|std_rad| *std_rad > 0.0);
            if let (Some(std_rad), Some(measured)) = (std_rad, &o.rotation)
                && let Some(predicted) = model.rotation(&o.q_rad, o.target)
            {
                let residual_rad = rotation_residual_rad(&predicted, measured);
                of_rotations.add(std_rad, residual_rad.norm_squared());
            }
        }
        // Positions and rotations determine the parameters together. Each is compared as if it determined them alone, which assumes fewer
        // redundant equations.
        let n_parameters = problem.parameters.len() + problem.n_station_variables();
        let of_rotations = || of_rotations.overstated(n_parameters, 1f64.to_degrees(), "°");
        of_positions
            .overstated(n_parameters, 1.0, "mm")
            .or_else(of_rotations)
    }

    /// Text about the comparison.
    pub fn in_words(&self) -> String {
        let Self {
            stated,
            scatter,
            unit,
        } = self;
        let (space, of) = match *unit {
            "mm" => (" ", "a coordinate"),
            _ => ("", "a component of the rotation"),
        };
        format!(
            "a noise of {stated:.3}{space}{unit} is stated for the instrument, and the points scatter by {scatter:.3}{space}{unit} about the fit (one standard \
             deviation of {of})"
        )
    }

    /// The warning of a job.
    pub fn warning(&self) -> Warning {
        Warning::new(
            NOISE_OVERSTATED,
            format!(
                "{}. A stated noise is a lower bound: the stated uncertainty is too large, and changes of the robot stay hidden. State the instrument's noise in {}, \
                 or leave it out",
                self.in_words(),
                if self.unit == "mm" { "mm" } else { "degrees" }
            ),
        )
    }
}
