//! Posting a job. Requests that cannot succeed are refused here, not later by a worker.

use crate::calibration::{self, CalibrationRequest};
use crate::http::creation::{Submission, stored_json};
use crate::http::extract::Id;
use crate::http::job_sources::{ResidualSource, Sources, load};
use crate::http::{Error, access};
use crate::jobs::{MeasurementSetInput, queue};
use crate::release::independence::{is_independent_of_training, is_of_other_uploads};
use crate::store::{NetworkWeights, NewJob, ParameterSetRow, Tx};
use crate::wire::job::{JobParts, JobRequestBody, Kind, Method};
use crate::wire::job_answer::JobAnswer;
use crate::wire::key::Scope;
use crate::wire::measurement::MeasurementSet;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::robot::Robot;
use crate::wire::safetensors;
use axum::response::Response;

/// The networks that a job starts from.
struct ChosenNetworks {
    network_id: Option<String>,
    residual_network_id: Option<String>,
}

/// Queues a calibration and answers at once. Poll the job with `wait_s`, or listen to its events.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/jobs", tag = "jobs", operation_id = "createJob",
    params(("robot_id" = String, Path, description = "The robot")), request_body = JobRequestBody,
    responses((status = 202, description = "The job, queued", body = JobAnswer, headers(("Location" = String, description = "Its path"))))
)]
pub async fn create(Id(robot_id): Id, submission: Submission) -> Result<Response, Error> {
    let app = &submission.app;
    access::robot(app, &submission.caller, &robot_id).await?;
    let request = parse_request(&submission)?;
    // The permit is taken before the uploads are read, so that waiting requests hold no upload in memory.
    let permit = app.limits.compute_permit(submission.caller.class).await?;
    let sources = load(app, &submission.caller, &robot_id, &request).await?;
    let mut new = new_job(&request, &sources, &submission.caller.holder)?;
    let chosen = permit.run(move || check(&request, sources)).await?;
    (new.network_input_id, new.residual_network_input_id) =
        (chosen.network_id, chosen.residual_network_id);
    let effect = async |tx: &mut Tx| {
        let row = queue::enqueue(tx, &new).await?;
        stored_json(
            202,
            Some(format!("/v1/jobs/{}", row.id)),
            &JobAnswer::try_from(&row)?,
        )
    };
    let answer = submission.create(effect).await?;
    app.signals.job_enqueued();
    Ok(answer)
}

fn parse_request(submission: &Submission) -> Result<JobRequestBody, Error> {
    let request: JobRequestBody = submission.json()?;
    request.check()?;
    if request.priority > 0 && !submission.caller.has(Scope::Admin) {
        return Err(Error::InsufficientScope {
            scope: Scope::Admin.as_str(),
            what: "a priority above 0",
        });
    }
    Ok(request)
}

fn new_job(request: &JobRequestBody, sources: &Sources, client: &str) -> Result<NewJob, Error> {
    Ok(NewJob {
        robot_id: sources.robot.id.clone(),
        robot_version: sources.robot.version,
        set_ids: sources.sets.iter().map(|set| set.row.id.clone()).collect(),
        verify_set_id: sources.verify_set.as_ref().map(|set| set.row.id.clone()),
        frames_id: request.frames_id.clone(),
        network_input_id: None,
        residual_network_input_id: None,
        parameter_set_input_id: sources.parameter_set.as_ref().map(|row| row.id.clone()),
        holds_parameter_set: request.holds_parameter_set(),
        kind: request.kind,
        method: request.method,
        request_json: serde_json::to_string(request)?,
        priority: request.priority,
        client: client.into(),
    })
}

/// Chooses the newest residual network whose training used no point that this job fits or verifies. The training of its predecessors counts as well.
fn choose_residual(
    request: &JobRequestBody,
    calibration_request: &CalibrationRequest,
    sources: &[ResidualSource],
    sets_sha256: &[&str],
    parse: impl Fn(&MeasurementSetInput) -> Result<MeasurementSet, Error>,
) -> Result<Option<String>, Error> {
    for source in sources {
        let fits = match safetensors::read_residual(&source.weights) {
            Ok(network) => network.centre_rad.len() == calibration_request.robot.links.len(),
            Err(error) => {
                tracing::error!(network_id = source.id, %error, "a stored residual network cannot be read; it is skipped");
                false
            }
        };
        if fits
            && is_of_other_uploads(&source.trained_on_sha256, sets_sha256)
            && is_independent(calibration_request, source, &parse)?
        {
            return Ok(Some(source.id.clone()));
        }
    }
    if request.residual_network_id.is_some() {
        let detail = "the residual network, or one of its predecessors, has seen points of these sets, so they cannot show whether it helps. \
                      Leave residual_network_id out, or name a network of other sessions";
        return Err(calibration::Error::Unusable {
            code: "network_mismatch",
            detail: detail.into(),
        }
        .into());
    }
    Ok(None)
}

/// Whether the job's points are independent of every session that a network was trained on.
fn is_independent(
    request: &CalibrationRequest,
    source: &ResidualSource,
    parse: impl Fn(&MeasurementSetInput) -> Result<MeasurementSet, Error>,
) -> Result<bool, Error> {
    for set in &source.sets {
        if !is_independent_of_training(request, &parse(set)?) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Runs every check of the core, and chooses the networks that the job starts from.
fn check(request: &JobRequestBody, sources: Sources) -> Result<ChosenNetworks, Error> {
    let robot = Robot::try_from(&access::robot_body(&sources.robot)?)?;
    let n_joints = robot.links.len();
    let parse = |source: &MeasurementSetInput| source.parse(n_joints).map_err(Error::Invalid);
    let parts = JobParts {
        sets: sources.sets.iter().map(parse).collect::<Result<_, _>>()?,
        verify_set: sources.verify_set.as_ref().map(parse).transpose()?,
        frames: sources.frames.as_ref().map(Into::into),
        network: None,
        residual_network: None,
        previous: None,
        robot,
    };
    let mut calibration_request = request.calibration_request(parts)?;
    let readable = |stored: NetworkWeights| match safetensors::read(&stored.weights) {
        Ok(network) => Some((stored.id, network)),
        Err(error) => {
            tracing::error!(network_id = stored.id, %error, "a stored network cannot be read; it is skipped");
            None
        }
    };
    let mut networks: Vec<_> = sources.networks.into_iter().filter_map(readable).collect();
    // The newest network with the same parameters. If there is none, `auto` uses no network; a request that needs one gets the newest, and the check
    // refuses it.
    let fitting = networks
        .iter()
        .position(|(_, network)| calibration::network_fits(&calibration_request, network));
    let is_asked_for = request.network_id.is_some() || request.method == Method::BpnnPso;
    let chosen = fitting
        .or(is_asked_for.then_some(0))
        .filter(|chosen| *chosen < networks.len())
        .map(|chosen| networks.swap_remove(chosen));
    let (network_id, network) = chosen.unzip();
    calibration_request.network = network;
    match request.kind {
        Kind::Identify => calibration::check(&calibration_request)?,
        Kind::Verify | Kind::Check => {
            let parse =
                |row: &ParameterSetRow| serde_json::from_str::<ParameterSetContent>(&row.body_json);
            let content = sources.parameter_set.as_ref().map(parse).transpose()?;
            calibration_request.scored_frame = sources.scored_frame;
            let identified = content.map(|content| (&content).into());
            match identified.as_ref().filter(|_| request.kind == Kind::Check) {
                Some(released) => calibration::check_quick_check(&calibration_request, released)?,
                None => calibration::check_verify(&calibration_request, identified.as_ref())?,
            }
        }
    }
    let sets_sha256: Vec<&str> = sources
        .sets
        .iter()
        .chain(&sources.verify_set)
        .map(|set| set.row.sha256.as_str())
        .collect();
    let residual_network_id = choose_residual(
        request,
        &calibration_request,
        &sources.residual_networks,
        &sets_sha256,
        parse,
    )?;
    Ok(ChosenNetworks {
        network_id,
        residual_network_id,
    })
}
