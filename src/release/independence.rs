//! Whether points are independent of those that a parameter set or a network was fitted to.

use crate::calibration::request::VerifySource;
use crate::calibration::{CalibrationRequest, is_anew, repeats};
use crate::kinematics::Robot;
use crate::measurement::{Frame, MeasurementSet};
use crate::wire::report_shape::Evidence;
use crate::wire::verification::{Verification, VerificationKind};

/// Whether a session cannot show an error of the set's base. This is so if the set was identified from positions in the base frame and the
/// session's positions are in the instrument's frame: the session then fits the base again.
pub fn hides_base(identified_in: Frame, session_in: Frame) -> bool {
    identified_in == Frame::Base && session_in == Frame::Instrument
}

/// The stored evidence of a session or an identification. It is reduced if an error of the base would not show; older versions did not
/// check this and stored stronger evidence.
pub fn effective_evidence(found: &Verification, is_base_hidden: bool) -> Evidence {
    match (is_base_hidden, found.kind, found.evidence) {
        (true, VerificationKind::Session, _) => Evidence::None,
        (true, VerificationKind::Identification, Evidence::IndependentSession) => {
            Evidence::SameUpload
        }
        (_, _, evidence) => evidence,
    }
}

/// Whether the verify points come from another session than the fitted points and the `sources` of the held values, and would also show an
/// error of the base. The same points uploaded again count as the same session.
pub fn is_verified_anew(request: &CalibrationRequest, sources: &[MeasurementSet]) -> bool {
    matches!(&request.verify, VerifySource::Set(set)
        if !hides_base(request.set.frame, set.frame)
            && is_another_session(&request.robot, set, request.uploads())
            && is_another_session(&request.robot, set, sources))
}

/// Whether `session` is a new session: its points do not repeat those that a set was identified from, nor were they put together from
/// several of those sessions. `identified_from` is empty for the nominal robot.
pub fn is_another_session(
    robot: &Robot,
    session: &MeasurementSet,
    identified_from: &[MeasurementSet],
) -> bool {
    !repeats(robot, identified_from, session)
}

/// Whether a network was trained on none of these uploads. `trained_on` includes the uploads of its predecessors.
pub fn is_of_other_uploads(trained_on: &[String], uploads_sha256: &[&str]) -> bool {
    let is_other = |sha256: &String| !uploads_sha256.contains(&sha256.as_str());
    trained_on.iter().all(is_other)
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
