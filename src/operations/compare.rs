//! Compares two parameter sets of a robot.

use crate::calibration::request::{Estimate, PreviousSession};
use crate::calibration::session_comparison::{changes, estimate_of_request};
use crate::calibration::{self, CalibrationRequest, tool_differences};
use crate::wire::history::{CompareAnswer, MapPoint, SessionTest};
use crate::wire::parameter_set::ParameterSetContent;
use std::ops::ControlFlow;

/// A parameter set, and how it was identified.
#[derive(Clone, Debug)]
pub struct IdentifiedSet {
    /// `par_…`
    pub id: String,
    /// Content of the set.
    pub content: ParameterSetContent,
    /// The request of the job that identified it.
    pub request: CalibrationRequest,
    /// Hashes of its uploads.
    pub uploads_sha256: Vec<String>,
    /// Its estimate, if one was stored.
    pub estimate: Option<Estimate>,
}

/// Differences between the tool positions over the workspace and, if the two sets come from different uploads, a statistical test of their sessions.
///
/// # Errors
/// [`calibration::Error`] if the sessions cannot be compared.
pub fn compare(
    own: IdentifiedSet,
    with: IdentifiedSet,
) -> Result<CompareAnswer, calibration::Error> {
    let differences = tool_differences(
        &own.request.robot,
        &own.content.identified_robot(None),
        &with.content.identified_robot(None),
    );
    let is_own = |sha256| own.uploads_sha256.contains(sha256);
    let same_upload = with.uploads_sha256.iter().any(is_own);
    let monitor = &mut |_: calibration::Event<'_>| ControlFlow::Continue(());
    let mut request = own.request;
    request.previous = Some(PreviousSession {
        set: with.request.set,
        frames: with.request.frames,
        estimate: with.estimate,
    });
    let own_estimate = match (same_upload, own.estimate) {
        (true, _) => None,
        (false, Some(kept)) => Some(kept),
        (false, None) => estimate_of_request(&request, monitor)?,
    };
    let changes = match own_estimate {
        Some(own) => changes(&request, &own, monitor)?,
        None => None,
    };
    Ok(CompareAnswer {
        parameter_set_id: own.id,
        with: with.id,
        mean_mm: differences.mean_mm,
        max_mm: differences.max_mm,
        map: differences.points.iter().map(MapPoint::from).collect(),
        sessions: changes.as_ref().map(SessionTest::from),
    })
}
