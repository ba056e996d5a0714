//! Whether points are independent of those that a parameter set or a network was fitted to.

use crate::calibration::request::VerifySource;
use crate::calibration::{CalibrationRequest, is_anew};
use crate::measurement::{Frame, MeasurementSet};
use crate::release::facts::repeats;

/// Whether a session cannot show an error of the set's base: the set was identified from positions in the base frame, and those of the session
/// are in the instrument's, so that the base is placed anew.
pub fn hides_base(identified_in: Frame, session_in: Frame) -> bool {
    identified_in == Frame::Base && session_in == Frame::Instrument
}

/// Whether the points to verify come from another session than the fitted ones, and would show a wrong base too. The same points uploaded again
/// count as the same session.
pub fn is_verified_anew(request: &CalibrationRequest) -> bool {
    matches!(&request.verify, VerifySource::Set(set)
        if !hides_base(request.set.frame, set.frame) && is_of_no(request, request.uploads(), set))
}

/// Whether the points come from another session than all that the scored set was identified from; none for the nominal robot.
pub fn is_another_session(
    request: &CalibrationRequest,
    identified_from: &[MeasurementSet],
) -> bool {
    is_of_no(request, identified_from, &request.set)
}

/// Whether the points are those of none of these sessions, and were not put together from several of them.
fn is_of_no(
    request: &CalibrationRequest,
    sessions: &[MeasurementSet],
    points: &MeasurementSet,
) -> bool {
    !repeats(&request.robot, sessions, points)
}

/// Whether a network was trained on none of these uploads. `trained_on` has those of its predecessors too; `None` if not all are known.
pub fn is_of_other_uploads(trained_on: Option<&[String]>, uploads_sha256: &[&str]) -> bool {
    let is_other = |sha256: &String| !uploads_sha256.contains(&sha256.as_str());
    trained_on.is_some_and(|trained_on| trained_on.iter().all(is_other))
}

/// Whether the points that a job fits and verifies were measured anew after those that a network was trained on. Otherwise neither cross-validation
/// nor verification would show whether the network helps.
pub fn is_independent_of_training(
    request: &CalibrationRequest,
    trained_on: &MeasurementSet,
) -> bool {
    let is_new = |set: &MeasurementSet| is_anew(&request.robot, trained_on, set);
    let to_verify = match &request.verify {
        VerifySource::Set(set) => Some(set),
        _ => None,
    };
    request.uploads().iter().all(is_new) && to_verify.is_none_or(is_new)
}
