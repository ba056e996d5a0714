//! Scores a parameter set on the points that another one was verified on, for the comparison at a release.

use crate::calibration::point_errors::PointErrors;
use crate::calibration::preparation::observe::observe;
use crate::calibration::request::{CalibrationRequest, VerifySource};
use crate::calibration::validation::verify::verify;
use crate::calibration::{Error, unusable};
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::measurement::{MeasurementSet, Subset};
use std::ops::ControlFlow;

/// Errors of another robot at each verify point, mm, for a request whose verify points are from its own upload. Base and targets are placed by all
/// points of the upload, not by the verify points alone, as for the robot that the request identified.
pub fn errors_on_verify_subset_mm(
    request: &CalibrationRequest,
    robot: &IdentifiedRobot,
) -> Result<Vec<f64>, Error> {
    let subsets = observe(request)?.subsets;
    let errors = errors_mm(request, &request.set, robot)?.into_iter();
    let of_verify = errors.zip(subsets).filter(|(_, s)| *s == Subset::Verify);
    Ok(of_verify.map(|(error, _)| error).collect())
}

/// Errors of a robot at all points of `set`, mm, with base and targets placed anew as [`verify`] does. They are those of the links alone or with
/// corrections, whichever are larger.
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
        .map(PointErrors::errors_mm)
        .map(|[_, links, corrected]| if is_links { links } else { corrected })
        .collect())
}
