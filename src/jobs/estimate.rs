//! The stored estimate of a job's result, with which later sessions are compared.

use crate::calibration::CalibrationReport;
use crate::calibration::request::Estimate;
use crate::jobs::JobInputs;
use crate::release::is_usable;
use crate::store::{Hashed, RobotRow};
use crate::wire::estimate::{StoredEstimate, geometry_sha256};
use crate::wire::job::Model;
use crate::wire::json;
use crate::wire::measurement::{MeasurementSet, joined};
use crate::wire::robot::RobotBody;

/// A stored document that cannot be read. It was written by this program, so this does not happen.
pub type Unreadable = Box<dyn std::error::Error + Send + Sync>;

/// The estimate of a result as it is stored, for comparisons with later sessions. `None` if the result cannot be used.
pub(super) fn estimate_json(
    core: &CalibrationReport,
    inputs: &JobInputs,
) -> Result<Option<Hashed<String>>, Unreadable> {
    let Some(estimate) = core.estimate.as_ref().filter(|_| is_usable(core)) else {
        return Ok(None);
    };
    let stored = StoredEstimate::new(estimate, core.model, &parse_robot(&inputs.robot)?)?;
    let text = serde_json::to_string(&stored)?;
    Ok(Some(text.into()))
}

/// Reads a stored estimate. `None` if there is none, if it belongs to another model than this, or if the robot's links or joint map have changed since.
pub fn stored_estimate(
    estimate_json: Option<&str>,
    robot: &RobotRow,
    model: Option<Model>,
) -> Result<Option<Estimate>, Unreadable> {
    let found = estimate_of(estimate_json, &parse_robot(robot)?)?;
    let alike = found.filter(|(stored, _)| model.is_none_or(|model| model == *stored));
    Ok(alike.map(|(_, estimate)| estimate))
}

/// As [`stored_estimate`], with its model.
pub fn estimate_of(
    estimate_json: Option<&str>,
    robot: &RobotBody,
) -> Result<Option<(Model, Estimate)>, Unreadable> {
    let Some(text) = estimate_json else {
        return Ok(None);
    };
    let stored: StoredEstimate = serde_json::from_str(text)?;
    if stored.geometry_sha256 != geometry_sha256(robot)? {
        return Ok(None);
    }
    Ok(Some((stored.model, Estimate::try_from(&stored)?)))
}

/// The points that a set was identified from: those of a single upload, or the joined points of several sessions that were fitted together.
pub(super) fn joined_sessions(mut uploads: Vec<MeasurementSet>) -> Option<MeasurementSet> {
    match uploads.len() {
        1 => uploads.pop(),
        _ => Some(joined(&uploads)),
    }
}

fn parse_robot(robot: &RobotRow) -> Result<RobotBody, Unreadable> {
    Ok(json::parse(robot.body_json.as_bytes())?)
}
