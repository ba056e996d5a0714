//! Whether points are independent of those that a parameter set or a network was fitted to.

use crate::calibration::request::VerifySource;
use crate::calibration::{CalibrationRequest, is_anew, repeats};
use crate::kinematics::Robot;
use crate::measurement::{Frame, MeasurementSet};
use crate::wire::report_shape::Evidence;
use crate::wire::verification::{Verification, VerificationKind};

/// Whether a session cannot show an error of the set's base: the set was identified from positions in the base frame, and those of the session
/// are in the instrument's, so that the base is placed anew.
pub fn hides_base(identified_in: Frame, session_in: Frame) -> bool {
    identified_in == Frame::Base && session_in == Frame::Instrument
}

/// Evidence of a session or of an identification as it was stored, without what its base does not show. Versions that did not ask whether the base
/// was checked stored more.
pub fn shown_evidence(found: &Verification, is_base_hidden: bool) -> Evidence {
    match (is_base_hidden, found.kind, found.evidence) {
        (true, VerificationKind::Session, _) => Evidence::None,
        (true, VerificationKind::Identification, Evidence::IndependentSession) => {
            Evidence::SameUpload
        }
        (_, _, evidence) => evidence,
    }
}

/// Whether the points to verify come from another session than the fitted ones and the `sources` of what was held, and would show a wrong base too.
/// The same points uploaded again count as the same session.
pub fn is_verified_anew(request: &CalibrationRequest, sources: &[MeasurementSet]) -> bool {
    matches!(&request.verify, VerifySource::Set(set)
        if !hides_base(request.set.frame, set.frame)
            && is_another_session(&request.robot, set, request.uploads())
            && is_another_session(&request.robot, set, sources))
}

/// Whether the points of `session` are those of none of the sessions that a set was identified from, and were not put together from several of them.
/// There are none for the nominal robot.
pub fn is_another_session(
    robot: &Robot,
    session: &MeasurementSet,
    identified_from: &[MeasurementSet],
) -> bool {
    !repeats(robot, identified_from, session)
}

/// Whether a network was trained on none of these uploads. `trained_on` has those of its predecessors too.
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
