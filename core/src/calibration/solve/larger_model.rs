//! Checks whether the paper's model is too small for a set: it has a known base, and a target on the flange axis.

use crate::calibration::preparation::check::check;
use crate::calibration::problem::Problem;
use crate::calibration::report::Warning;
use crate::calibration::request::{CalibrationRequest, Method, Model, Preset};
use crate::calibration::solve::solution::least_squares_from;
use crate::calibration::stages::watched;
use crate::calibration::validation::verdict::no_fit_mm;
use crate::calibration::{Error, Monitor};
use crate::identification::KinematicModel;
use crate::identification::least_squares::problem::reach_mm;
use crate::identification::model::objective::{Observation, weighted_residuals};

/// The models are compared if the rms exceeds this share of the reach: 0.17 mm on an arm of 1.7 m. Measured robots leave 0.1 to 0.4 mm.
const COMPARED_PER_REACH: f64 = 1e-4;
/// The complete model must fit better by this factor.
const MIN_IMPROVEMENT: f64 = 5.0;

/// Code of the warning.
pub const MODEL_TOO_SMALL: &str = "model_too_small";

/// Warning if the paper's model fits the points poorly and the complete model fits them well.
pub fn warning(
    problem: &Problem<'_>,
    found: &KinematicModel,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Warning>, Error> {
    let request = problem.request;
    let fit_mm = rms_mm(found, &problem.identify);
    let compared_mm = COMPARED_PER_REACH * reach_mm(&request.robot.links, problem.identify.iter());
    let is_asked_for =
        request.frames.is_some() || request.preset == Preset::Paper || !request.priors.is_empty();
    if request.model() != Model::Paper || is_asked_for || fit_mm < compared_mm {
        return Ok(None);
    }
    let larger = CalibrationRequest {
        model: Some(Model::Complete),
        method: Method::LeastSquares,
        network: None,
        residual_network: None,
        previous: None,
        ..request.clone()
    };
    // If the complete model cannot be identified, that is no fault of the request.
    let problem = check(&larger)
        .and_then(|()| watched(monitor, |watch| Problem::new(&larger, watch)).flatten());
    let complete = match problem {
        Ok(complete) => complete,
        Err(Error::Unusable { .. }) => return Ok(None),
        Err(cancelled) => return Err(cancelled),
    };
    let found = least_squares_from(&complete, &complete.nominal, None, monitor)?;
    let (fit, complete) = (
        found.model,
        complete.with_stations_moved(&found.station_motions),
    );
    let complete_mm = rms_mm(&fit, &complete.identify);
    // If the paper's model does not fit at all, it is sufficient that the complete model fits.
    let limit_mm = no_fit_mm(request);
    let is_remedy = fit_mm > limit_mm && complete_mm < 0.5 * limit_mm;
    if complete_mm * MIN_IMPROVEMENT > fit_mm && !is_remedy {
        return Ok(None);
    }
    let target = fit.targets_mm.first().copied().unwrap_or_default();
    let detail = format!(
        "model paper leaves {fit_mm:.3} mm (rms) where model complete leaves {complete_mm:.3} mm: the target is not on the flange axis (model complete \
         has it at {:.1}, {:.1}, {:.1} mm of the flange), or the positions are not in the robot's base frame. Choose model complete; if they are in \
         an instrument's frame, read them in the frame instrument",
        target.x, target.y, target.z
    );
    Ok(Some(Warning::new(MODEL_TOO_SMALL, detail)))
}

/// Root mean square of the weighted residuals, mm.
fn rms_mm(model: &KinematicModel, observations: &[Observation]) -> f64 {
    (weighted_residuals(model, observations).norm_squared() / observations.len().max(1) as f64)
        .sqrt()
}
