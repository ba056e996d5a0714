//! The delivered fit: links, base, targets and corrections fitted to all points of the upload, after the fit to the identify subset was verified.
//!
//! Half of the points is not needed any more to tell how good the answer is, and makes it better. Nothing is chosen again: free parameters,
//! segments, points that do not count, loss and kinds of corrections stay as they are. What the report says of errors is that of the verified fit.

use crate::calibration::arrangement::Arrangement;
use crate::calibration::corrections;
use crate::calibration::identify::{Problem, least_squares_from, quiet};
use crate::calibration::known::known_before;
use crate::calibration::motions::fit_motions;
use crate::calibration::outcome::delivered;
use crate::calibration::report::FinalErrors;
use crate::calibration::request::{FinalFit, Preset};
use crate::calibration::{Error, Monitor};
use crate::compensation::tool_differences;
use crate::identification::KinematicModel;
use crate::identification::corrected::{CorrectedModel, IdentifiedRobot};
use crate::identification::objective::residuals;
use crate::measurement::Subset;
use nalgebra::Vector3;

/// The delivered robot, in the frame of the fit.
pub struct Final<'a> {
    /// The problem with all points to identify from.
    pub problem: Problem<'a>,
    /// Base, links and targets.
    pub model: KinematicModel,
    /// The same with corrections, if any was kept.
    pub corrected: Option<CorrectedModel>,
    /// For the report.
    pub errors: FinalErrors,
}

/// True if the delivered parameters are fitted to all points.
pub fn is_wanted(problem: &Problem<'_>) -> bool {
    let request = problem.request;
    let default = match request.preset == Preset::Default && problem.settings.refine {
        true => FinalFit::All,
        false => FinalFit::IdentifySubset,
    };
    request.final_fit.unwrap_or(default) == FinalFit::All
}

/// Fits all points, from the verified fit on.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn final_fit<'a>(
    verified: &Problem<'a>,
    model: &KinematicModel,
    corrections: Option<&corrections::Found>,
    monitor: &mut Monitor<'_>,
) -> Result<Final<'a>, Error> {
    let before = IdentifiedRobot {
        plain: delivered(verified, model),
        corrected: corrections.and_then(|found| found.corrected.clone()),
    };
    let problem = verified.over_all_points(model)?;
    let (model, corrected) = match verified.observed.subsets.contains(&Subset::Verify) {
        false => (model.clone(), before.corrected.clone()),
        true => {
            let fit = least_squares_from(&problem, model, None, &mut quiet(monitor))?;
            let refit = |found| corrections::refit(&problem, &fit.model, found);
            let corrected = corrections.and_then(refit);
            (fit.model, corrected)
        }
    };
    let after = IdentifiedRobot {
        plain: delivered(&problem, &model),
        corrected,
    };
    let counting: Vec<_> = problem.trusted();
    let counting: Vec<_> = counting.into_iter().filter(|o| o.weight > 0.0).collect();
    let squares = residuals(&model, &counting);
    let sum: f64 = squares.iter().map(Vector3::norm_squared).sum();
    let moved = tool_differences(&verified.request.robot, &before, &after);
    let errors = FinalErrors {
        n_points: counting.len(),
        rms_mm: (sum / counting.len().max(1) as f64).sqrt(),
        moved_mm: moved.mean_mm,
    };
    Ok(Final {
        problem,
        model,
        corrected: after.corrected,
        errors,
    })
}

impl<'a> Problem<'a> {
    /// The same problem with all points of the upload to identify from, but those that do not count or stand in a segment without points to
    /// identify from. Motions between set-ups are fitted to all points.
    pub fn over_all_points(&self, model: &KinematicModel) -> Result<Self, Error> {
        let mut observed = self.observed.clone();
        observed.subsets.fill(Subset::Identify);
        let wild = self.screening.wild.iter().map(|wild| wild.row);
        let without_weight = wild.filter(|_| self.screening.is_down_weighted);
        let unfitted = self.screening.unfitted_rows.iter().copied();
        for row in without_weight.chain(unfitted) {
            observed.all[row].weight = 0.0;
        }
        let mut arrangement: Arrangement = self.arrangement.clone();
        if arrangement.motions.len() > 1 {
            fit_motions(self.request, &mut observed, &mut arrangement, None)?;
            arrangement.apply(&mut observed);
        }
        let mut problem = Self {
            request: self.request,
            settings: self.settings.clone(),
            screening: self.screening.clone(),
            arrangement,
            loss: self.loss,
            identify: observed.all.clone(),
            observed,
            parameters: self.parameters.clone(),
            nominal: self.nominal.clone(),
            decomposition: self.decomposition.clone(),
            priors: None,
        };
        problem.priors = known_before(&problem)?;
        Ok(problem.decomposed_with_tool_of(model))
    }
}
