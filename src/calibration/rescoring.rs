//! A parameter set on the points that another one was verified on: what a release compares.

use crate::calibration::observe::observe;
use crate::calibration::report::PointErrors;
use crate::calibration::request::{CalibrationRequest, VerifySource};
use crate::calibration::verify::verify;
use crate::calibration::{Error, unusable};
use crate::identification::corrected::IdentifiedRobot;
use crate::measurement::{MeasurementSet, Subset};
use std::ops::ControlFlow;

/// The points that a request keeps to verify: another set, or its own verify subset.
///
/// # Errors
/// [`Error::Unusable`] for a set whose split cannot be made.
pub fn verify_points_of(request: &CalibrationRequest) -> Result<MeasurementSet, Error> {
    if let VerifySource::Set(set) = &request.verify {
        return Ok(set.clone());
    }
    let subsets = observe(request)?.subsets;
    let kept = request
        .set
        .points
        .iter()
        .zip(subsets)
        .filter(|(_, subset)| *subset == Subset::Verify);
    Ok(MeasurementSet {
        frame: request.set.frame,
        points: kept.map(|(point, _)| point.clone()).collect(),
    })
}

/// Each point's error, mm, of a robot on all points of `set`, base and targets placed anew as [`verify`] does it: of links alone or with
/// corrections, whichever are larger.
///
/// # Errors
/// As [`verify`].
pub fn errors_mm(
    request: &CalibrationRequest,
    set: &MeasurementSet,
    robot: &IdentifiedRobot,
) -> Result<Vec<f64>, Error> {
    let request = CalibrationRequest {
        set: set.clone(),
        verify: VerifySource::Default,
        ..request.clone()
    };
    let report = verify(&request, Some(robot), &mut |_| ControlFlow::Continue(()))?;
    let verify = report
        .verify
        .ok_or_else(|| unusable("under_determined", "there are no points to verify on"))?;
    let is_links = verify.worse() == verify.after;
    Ok(report
        .per_point
        .iter()
        .map(PointErrors::to_judge)
        .map(|[_, links, corrected]| if is_links { links } else { corrected })
        .collect())
}
