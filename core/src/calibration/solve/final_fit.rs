//! The delivered fit: links, base, targets and corrections fitted to all points of the upload, after the fit to the identify subset was
//! verified.
//!
//! The held-out points are no longer needed for judging the result, and they improve it. All choices stay the same: free parameters,
//! segments, points without weight, loss and kinds of corrections. The errors in the report are those of the verified fit.

use crate::calibration::outcome::delivery::delivered;
use crate::calibration::outcome::stated_uncertainty::{
    estimated, misfit, why_not_stated, without_redundancy,
};
use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::loss::PointLoss;
use crate::calibration::preparation::motions::fit_motions;
use crate::calibration::preparation::row_weights::weigh;
use crate::calibration::preparation::stated_priors::stated_priors;
use crate::calibration::problem::Problem;
use crate::calibration::report::{FinalErrors, Warning};
use crate::calibration::request::{FinalFit, Preset};
use crate::calibration::solve::corrections::{self, Points, setting};
use crate::calibration::solve::solution::least_squares_from;
use crate::calibration::stages::{quiet, watched};
use crate::calibration::{Error, Monitor};
use crate::compensation::tool_differences;
use crate::identification::KinematicModel;
use crate::identification::corrections::Fitted;
use crate::identification::corrections::corrected::{CorrectedModel, IdentifiedRobot};
use crate::identification::least_squares::problem::CorrectionWidths;
use crate::identification::model::objective::{rms_mm, with_stations_moved, with_weight};
use crate::identification::statistics::estimate::{CorrectedErrors, Estimate};
use crate::identification::statistics::uncertainty::{Session, Uncertainty, uncertainty};
use crate::identification::statistics::workspace::{ToolUncertainty, tool_uncertainty};
use crate::kinematics::reach_mm;
use crate::measurement::Subset;
use crate::solvers::watch::Watch;

/// The delivered robot, in the frame of the fit.
pub struct Final<'a> {
    /// The problem with all points as identify points.
    pub problem: Problem<'a>,
    /// Base, links and targets.
    pub model: KinematicModel,
    /// The same with corrections, if any was kept.
    pub corrected: Option<CorrectedModel>,
    /// Its uncertainty, whether or not it can be stated.
    pub uncertainty: Option<Uncertainty>,
    /// The estimate for comparison with other sessions and for predictions, if its uncertainty can be stated.
    pub estimate: Option<Estimate>,
    /// Its errors, for the report.
    pub errors: FinalErrors,
}

impl Final<'_> {
    /// Uncertainty of the tool's position that is predicted with corrections; `None` without corrections.
    pub fn corrected_tool_uncertainty(&self) -> Option<ToolUncertainty> {
        let estimate = self.estimate.as_ref()?;
        estimate.corrected.as_ref()?;
        let robot = IdentifiedRobot {
            plain: self.model.clone(),
            corrected: self.corrected.clone(),
        };
        let n_targets = self.model.targets_mm.len();
        let (nominal, points) = (&self.problem.request.robot, &self.problem.identify);
        let std_mm = |q_rad: &[f64], target| estimate.predicted_std_mm(&robot, q_rad, target);
        Some(tool_uncertainty(nominal, points, n_targets, std_mm))
    }
}

/// True if the delivered parameters are fitted to all points. With more outliers than were left out, a person has to review them first.
pub fn is_wanted(problem: &Problem<'_>) -> bool {
    let request = problem.request;
    let default = match request.preset == Preset::Default && problem.settings.refine {
        true => FinalFit::All,
        false => FinalFit::IdentifySubset,
    };
    let screening = &problem.screening;
    request.final_fit.unwrap_or(default) == FinalFit::All
        && (screening.is_down_weighted || !screening.is_for_review)
}

/// Maximum ratio of two standard deviations of a coordinate: in the fit to all points, and in the fit to the identify subset. Above it the
/// two subsets do not belong together, provided that the difference is significant. Each standard deviation takes the degrees of freedom of
/// its fit into account.
const MAX_SCATTER: f64 = 3.0;
/// Differences below this share of the robot's reach are rounding.
const ROUNDING_PER_REACH: f64 = 1e-6;

/// Fits all points, starting from the verified fit. If no single robot fits both subsets, returns a warning instead of a fit.
pub fn final_fit<'a>(
    verified: &Problem<'a>,
    model: &KinematicModel,
    corrections: Option<&corrections::Found>,
    monitor: &mut Monitor<'_>,
) -> Result<(Option<Final<'a>>, Option<Warning>), Error> {
    let before = IdentifiedRobot {
        plain: delivered(verified, model),
        corrected: corrections.and_then(|found| found.corrected.clone()),
    };
    let mut problem = watched(monitor, |watch| verified.over_all_points(model, watch)).flatten()?;
    let of_verified = corrections.and_then(|found| found.fitted.as_ref());
    let (model, corrected, fitted) = match verified.observed.subsets.contains(&Subset::Verify) {
        false => (
            model.clone(),
            before.corrected.clone(),
            of_verified.cloned(),
        ),
        true => {
            let fit = least_squares_from(&problem, model, None, &mut quiet(monitor))?;
            problem = problem.with_stations_moved(&fit.station_motions);
            let refit = |found| corrections::refit(&problem, &fit.model, found, monitor);
            let refitted = corrections.and_then(refit);
            // Compares both fits in the same way: by the links alone, if the corrections cannot be fitted again.
            let mut noises = [problem.noise(&fit.model), verified.noise(model)];
            if let (Some((_, all)), Some(verified)) = (&refitted, of_verified) {
                noises[0].std_mm = all.variance.sqrt();
                noises[1].std_mm = verified.variance.sqrt();
            }
            let [all, identify] = noises;
            let rounding_mm = ROUNDING_PER_REACH * reach_mm(&verified.request.robot.links);
            // A fit without redundancy follows its points exactly, so its scatter shows nothing.
            if without_redundancy(verified).is_none()
                && all.std_mm > MAX_SCATTER * identify.std_mm + rounding_mm
                && all.is_more_than(&identify)
            {
                return Ok((None, Some(subsets_differ(all.std_mm, identify.std_mm))));
            }
            let (corrected, fitted) = refitted.unzip();
            (fit.model, corrected, fitted)
        }
    };
    let after = IdentifiedRobot {
        plain: delivered(&problem, &model),
        corrected,
    };
    let with_weight = with_weight(&problem.trusted());
    let moved = tool_differences(&verified.request.robot, &before, &after);
    let errors = FinalErrors {
        n_points: with_weight.len(),
        rms_mm: rms_mm(&model, &with_weight),
        moved_mm: moved.mean_mm,
    };
    let uncertainty = watched(monitor, |watch| estimated(&problem, &model, watch))?;
    let with_corrections = |watch: &Watch<'_>| {
        let fitted = fitted.as_ref()?;
        corrected_errors(&problem, &model, fitted, watch)
    };
    let is_stated = why_not_stated(&problem, uncertainty.as_ref()).is_none();
    let stated = uncertainty.clone().filter(|_| is_stated);
    let corrected = watched(monitor, with_corrections)?;
    let estimate = stated.map(|uncertainty| Estimate {
        parameters: problem.parameters.clone(),
        model: model.clone(),
        uncertainty,
        corrected,
        noise: problem.noise(&model),
    });
    let fit = Final {
        uncertainty,
        estimate,
        problem,
        model,
        corrected: after.corrected,
        errors,
    };
    Ok((Some(fit), None))
}

fn subsets_differ(all_mm: f64, identify_mm: f64) -> Warning {
    let detail = format!(
        "points to identify from and points to verify do not belong together: fitted together they scatter by {all_mm:.4} mm (one standard deviation of \
         a coordinate), those to identify from alone by {identify_mm:.4} mm. Something may have changed between them (tool, base, a joint), or the points \
         to identify from show too little of the robot. The verified parameters are delivered as they are; see the errors on the points to verify, and \
         measure again, with the subsets mixed"
    );
    Warning::new("subsets_differ", detail)
}

impl<'a> Problem<'a> {
    /// The same problem with all points of the upload as identify points. Left-out outliers and points in segments without identify points have
    /// weight 0. Motions between set-ups are fitted to all points. Without points to verify, it is the verified problem itself.
    pub fn over_all_points(
        &self,
        model: &KinematicModel,
        watch: &Watch<'_>,
    ) -> Result<Self, Error> {
        if !self.observed.subsets.contains(&Subset::Verify) {
            return Ok(self.clone().decomposed_with_tool_of(model));
        }
        let mut observed = self.observed.clone();
        observed.subsets.fill(Subset::Identify);
        let outliers = self.screening.outliers.iter().map(|outlier| outlier.row);
        let without_weight = outliers.filter(|_| self.screening.is_down_weighted);
        let unfitted = self.screening.unfitted_rows.iter().copied();
        for row in without_weight.chain(unfitted) {
            observed.all[row].weight = 0.0;
        }
        let mut arrangement: Arrangement = self.arrangement.clone();
        if arrangement.motions.len() > 1 {
            fit_motions(self.request, &mut observed, &mut arrangement, None, watch)?;
            arrangement.apply(&mut observed);
        }
        let mut problem = Self {
            arrangement,
            identify: observed.all.clone(),
            observed,
            priors: None,
            ..self.clone()
        };
        // All points together determine the noise of positions and rotations better than the identify subset.
        weigh(&mut problem, watch)?;
        problem.priors = stated_priors(&problem, watch)?;
        Ok(problem.decomposed_with_tool_of(model))
    }
}

/// Errors of the corrections that were fitted to the points of a problem. `links_alone` is its fit without corrections. `None` if the
/// equations cannot be solved, or if the problem with corrections differs from the fitted one. It differs with a robust loss, whose
/// pseudo-points are those of the links alone, and with the frames of sweeps.
fn corrected_errors(
    problem: &Problem<'_>,
    links_alone: &KinematicModel,
    fitted: &Fitted,
    watch: &Watch<'_>,
) -> Option<CorrectedErrors> {
    if problem.loss != PointLoss::Squares || problem.request.frames.is_some() {
        return None;
    }
    let points = Points::new(problem, links_alone);
    let setting = setting(problem, &points);
    let placed = with_stations_moved(&points.observations, &fitted.station_motions);
    let mut rows = problem.rows(&placed, &[]);
    rows.reference = setting.links.reference.clone();
    let known = (setting.mounting, setting.payload);
    let rows = rows.with_corrections(known, &fitted.terms, CorrectionWidths::ByEvidence);
    let found = uncertainty(Session {
        model: &fitted.model,
        problem: &rows,
        observations: &placed,
        configurations: &points.clusters,
        corrections: Some(fitted),
        misfit: misfit(problem),
        watch,
    })?;
    Some(CorrectedErrors {
        terms: fitted.terms.clone(),
        mounting: setting.mounting,
        uncertainty: found,
    })
}
