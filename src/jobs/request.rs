//! Builds the core's request for a job from the job's stored inputs.

use crate::calibration::reference::InstrumentScale;
use crate::calibration::request::PreviousSession;
use crate::calibration::{CalibrationRequest, HeldOut};
use crate::jobs::estimate::{joined_sessions, stored_estimate};
use crate::jobs::{JobFailure, JobInputs, MeasurementSetInput};
use crate::wire::frames::FramesContent;
use crate::wire::job::{JobParts, JobRequestBody, Kind};
use crate::wire::measurement::MeasurementSet;
use crate::wire::reference::ReferenceBody;
use crate::wire::robot::{Robot, RobotBody};
use crate::wire::{Invalid, Problem, json, safetensors};

/// The request of the core.
///
/// # Errors
/// [`JobFailure::Failed`] if a stored document cannot be read.
pub fn parse_request(inputs: &JobInputs) -> Result<CalibrationRequest, JobFailure> {
    parse_requests(inputs).map(|(_, request)| request)
}

/// The request as it was posted, and the core's request.
pub(super) fn parse_requests(
    inputs: &JobInputs,
) -> Result<(JobRequestBody, CalibrationRequest), JobFailure> {
    let posted: JobRequestBody =
        json::parse(inputs.job.request_json.as_bytes()).map_err(JobFailure::internal)?;
    let body: RobotBody =
        json::parse(inputs.robot.body_json.as_bytes()).map_err(JobFailure::internal)?;
    let robot = Robot::try_from(&body).map_err(JobFailure::internal)?;
    let n_joints = robot.links.len();
    let frames = inputs
        .frames
        .as_ref()
        .map(|row| serde_json::from_str::<FramesContent>(&row.result_json));
    let network = inputs
        .network
        .as_ref()
        .map(|network| safetensors::read(&network.weights));
    let residual_network = inputs
        .residual_network
        .as_ref()
        .map(|network| safetensors::read_residual(&network.weights));
    let parts = JobParts {
        sets: inputs
            .sets
            .iter()
            .map(|set| set.parse(n_joints).map_err(JobFailure::internal))
            .collect::<Result<_, _>>()?,
        verify_set: inputs
            .verify_set
            .as_ref()
            .map(|set| set.parse(n_joints))
            .transpose()
            .map_err(JobFailure::internal)?,
        frames: frames
            .transpose()
            .map_err(JobFailure::internal)?
            .map(|content| (&content).into()),
        network: network.transpose().map_err(JobFailure::internal)?,
        residual_network: residual_network.transpose().map_err(JobFailure::internal)?,
        previous: previous_session(&posted, inputs, n_joints),
        robot,
    };
    let mut request = posted
        .calibration_request(parts)
        .map_err(|invalid: Invalid| {
            JobFailure::failed(Problem::new(422, invalid.code, invalid.summary()))
        })?;
    request.held_out = held_out(inputs);
    request.instrument_scale = instrument_scale(inputs)?;
    request.refused_as = insisted_on(inputs).map(str::to_owned);
    request.unread_labels = inputs.unread_labels();
    let scored = inputs.parameter_set.as_ref();
    request.scored_frame = scored.and_then(|input| Some(input.sets.first()?.row.frame));
    Ok((posted, request))
}

/// The scale of the instrument from the reference that the set names. With several sessions, the scale with the largest error counts.
fn instrument_scale(inputs: &JobInputs) -> Result<Option<InstrumentScale>, JobFailure> {
    let mut scales = Vec::new();
    for row in &inputs.references {
        let body: ReferenceBody =
            serde_json::from_str(&row.content_json).map_err(JobFailure::internal)?;
        scales.extend(body.scale());
    }
    let of_one_mm = |scale: &InstrumentScale| scale.std_mm(1.0);
    Ok(scales
        .into_iter()
        .max_by(|a, b| of_one_mm(a).total_cmp(&of_one_mm(b))))
}

/// Errors of the verified parameter set on the points that were held out when it was identified.
fn held_out(inputs: &JobInputs) -> Option<HeldOut> {
    let found = &inputs.parameter_set.as_ref()?.verification.as_ref()?.found;
    Some(HeldOut {
        nominal_rms_mm: found.before_rms_mm?,
        identified_rms_mm: found.after_rms_mm?,
    })
}

/// The session that the robot was last identified from; `None` if it cannot be read.
fn previous_session(
    request: &JobRequestBody,
    inputs: &JobInputs,
    n_joints: usize,
) -> Option<PreviousSession> {
    let input = inputs
        .parameter_set
        .as_ref()
        .filter(|_| request.kind == Kind::Identify)?;
    let frames = input
        .frames
        .as_ref()
        .map(|row| serde_json::from_str::<FramesContent>(&row.result_json))
        .transpose()
        .ok()?;
    let uploads = input.sets.iter().map(|set| set.parse(n_joints));
    let uploads: Result<Vec<_>, _> = uploads.collect();
    let set = joined_sessions(uploads.ok()?)?;
    let model = request.model_for(inputs.sets.first()?.row.frame);
    let estimate =
        stored_estimate(input.estimate_json.as_deref(), &inputs.robot, Some(model)).ok()?;
    Some(PreviousSession {
        set,
        frames: frames.map(|content| (&content).into()),
        estimate,
    })
}

/// The points of uploads that were measured on the request's robot.
pub(super) fn parse_uploads<'a>(
    uploads: impl IntoIterator<Item = &'a MeasurementSetInput>,
    request: &CalibrationRequest,
) -> Result<Vec<MeasurementSet>, JobFailure> {
    let n_joints = request.robot.links.len();
    let uploads = uploads.into_iter();
    uploads
        .map(|input| input.parse(n_joints).map_err(JobFailure::internal))
        .collect()
}

/// Code of the suspicion that an uploader overrode with `insist`: for a set of the job, the set to verify on, or a set on which the result is based.
pub(super) fn insisted_on(inputs: &JobInputs) -> Option<&str> {
    inputs
        .sets
        .iter()
        .chain(&inputs.verify_set)
        .chain(&inputs.sources)
        .find_map(|input| input.row.insisted_on.as_deref())
}
