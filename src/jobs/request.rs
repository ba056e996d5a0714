//! Builds the core's request for a job from the job's stored inputs.

use crate::calibration::request::PreviousSession;
use crate::calibration::{CalibrationRequest, HeldOut, RepeatedRows};
use crate::jobs::estimate::{as_one, stored_estimate};
use crate::jobs::{JobFailure, JobInputs, MeasurementSetInput};
use crate::release::facts::MeasuredSince;
use crate::store::verifications::KnownUpload;
use crate::wire::frames::FramesContent;
use crate::wire::job::{JobParts, JobRequestBody, Kind};
use crate::wire::measurement::MeasurementSet;
use crate::wire::robot::{Robot, RobotBody};
use crate::wire::{Invalid, Problem, json, safetensors};

/// The request of the core.
///
/// # Errors
/// [`JobFailure::Failed`] if a stored document cannot be read.
pub fn request_of(inputs: &JobInputs) -> Result<CalibrationRequest, JobFailure> {
    requests_of(inputs).map(|(_, request)| request)
}

/// The request as it was posted, and the core's request.
pub(super) fn requests_of(
    inputs: &JobInputs,
) -> Result<(JobRequestBody, CalibrationRequest), JobFailure> {
    let posted: JobRequestBody =
        json::parse(inputs.job.request_json.as_bytes()).map_err(JobFailure::broken)?;
    let body: RobotBody =
        json::parse(inputs.robot.body_json.as_bytes()).map_err(JobFailure::broken)?;
    let robot = Robot::try_from(&body).map_err(JobFailure::broken)?;
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
        set: inputs.set.parse(n_joints).map_err(JobFailure::broken)?,
        further_sets: inputs
            .further_sets
            .iter()
            .map(|set| set.parse(n_joints).map_err(JobFailure::broken))
            .collect::<Result<_, _>>()?,
        verify_set: inputs
            .verify_set
            .as_ref()
            .map(|set| set.parse(n_joints))
            .transpose()
            .map_err(JobFailure::broken)?,
        frames: frames
            .transpose()
            .map_err(JobFailure::broken)?
            .map(|content| (&content).into()),
        network: network.transpose().map_err(JobFailure::broken)?,
        residual_network: residual_network.transpose().map_err(JobFailure::broken)?,
        previous: previous_session(&posted, inputs, n_joints),
        robot,
    };
    let mut request = posted
        .calibration_request(parts)
        .map_err(|invalid: Invalid| {
            JobFailure::failed(&Problem::new(422, invalid.code, invalid.summary()))
        })?;
    request.held_out = held_out(inputs);
    request.refused_as = insisted_on(inputs).map(str::to_owned);
    let scored = inputs.parameter_set.as_ref();
    request.scored_frame = scored.map(|input| input.set.row.frame);
    Ok((posted, request))
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
    let uploads: Result<Vec<_>, _> = input.uploads().map(|set| set.parse(n_joints)).collect();
    let set = as_one(uploads.ok()?)?;
    let model = request.model_for(inputs.set.row.frame);
    let estimate = stored_estimate(input.estimate_json.as_deref(), &inputs.robot, model).ok()?;
    Some(PreviousSession {
        set,
        frames: frames.map(|content| (&content).into()),
        estimate,
    })
}

/// When a job's own points were measured, as far as the robot's other uploads show it: in which upload they appeared first, and whether that was before
/// the robot's last session that did not fit. The points of a check must repeat no earlier upload at all.
pub(super) fn measured_since(
    inputs: &JobInputs,
    request: &CalibrationRequest,
) -> Result<MeasuredSince, JobFailure> {
    let is_check = inputs.job.kind == Kind::Check;
    let known = &inputs.known;
    let points = points_of(known.uploads.iter().map(|(_, input)| input), request)?;
    let mut since = MeasuredSince {
        check_seq: known.check_seq,
        is_repeat: known.exceeds_limits && known.check_seq > 0 && !is_check,
        measured_seq: 0,
    };
    let own = inputs.uploads().zip(request.uploads()).zip(&known.own_seq);
    for ((input, upload), own_seq) in own {
        let is_own = |upload: &KnownUpload| upload.id == input.row.id;
        let is_earlier = |upload: &KnownUpload| upload.uploaded_seq < *own_seq;
        let is_forbidden = |upload: &KnownUpload| match is_check {
            true => is_earlier(upload) || (is_own(upload) && upload.is_used),
            false => upload.is_before_check,
        };
        let all = known.uploads.iter().zip(&points);
        let others: Vec<_> = all
            .clone()
            .filter(|((known, _), _)| !is_own(known) && (is_earlier(known) || is_forbidden(known)))
            .collect();
        let repeated = RepeatedRows::find(
            &request.robot,
            others.iter().map(|(_, points)| *points),
            upload,
        );
        let places = |counts: &dyn Fn(&KnownUpload) -> bool| -> Vec<usize> {
            let places = 0..others.len();
            places.filter(|place| counts(&others[*place].0.0)).collect()
        };
        let itself = all.map(|((known, _), _)| known).find(|known| is_own(known));
        since.is_repeat |=
            itself.is_some_and(is_forbidden) || repeated.repeats(places(&is_forbidden));
        // few points that cannot be compared are still a copy if the bytes are the same
        let earlier = places(&is_earlier);
        let mut same_bytes = earlier.iter().copied();
        let same_bytes = same_bytes.find(|place| others[*place].0.1.row.sha256 == input.row.sha256);
        let first = repeated.first(earlier).into_iter().chain(same_bytes).min();
        let measured_seq = first.map_or(*own_seq, |place| others[place].0.0.uploaded_seq);
        since.measured_seq = since.measured_seq.max(measured_seq);
    }
    Ok(since)
}

/// The points of uploads that were measured on the request's robot.
pub(super) fn points_of<'a>(
    uploads: impl IntoIterator<Item = &'a MeasurementSetInput>,
    request: &CalibrationRequest,
) -> Result<Vec<MeasurementSet>, JobFailure> {
    let n_joints = request.robot.links.len();
    let uploads = uploads.into_iter();
    uploads
        .map(|input| input.parse(n_joints).map_err(JobFailure::broken))
        .collect()
}

/// Code of the suspicion that an uploader overrode with `insist`: for a set of the job, the set to verify on, or a set on which the result is based.
pub(super) fn insisted_on(inputs: &JobInputs) -> Option<&str> {
    inputs
        .uploads()
        .chain(&inputs.verify_set)
        .chain(&inputs.sources)
        .find_map(|input| input.row.insisted_on.as_deref())
}
