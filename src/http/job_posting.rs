//! Posting a job. Requests that cannot succeed are refused here, not later by a worker.

use crate::calibration::request::VerifySource;
use crate::calibration::{self, CalibrationRequest, is_anew};
use crate::http::auth::{Caller, Scope};
use crate::http::creation::{Submission, stored_json};
use crate::http::extract::Id;
use crate::http::request_class::RequestClass;
use crate::http::{App, Error, access};
use crate::jobs::queue;
use crate::store::jobs as stored;
use crate::store::{
    self, MeasurementSetRow, NetworkRow, NewJob, ParameterSetRow, RobotRow, Tx, frames,
    measurement_sets, networks, parameter_sets,
};
use crate::wire::frames::FramesContent;
use crate::wire::id;
use crate::wire::job::{JobAnswer, JobParts, JobRequestBody, Kind, Method, VerifyBody};
use crate::wire::measurement::{Frame, MeasurementSet, from_upload};
use crate::wire::network::NetworkKind;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::robot::Robot;
use crate::wire::safetensors::{self, NetworkMetadata};
use axum::extract::State;
use axum::response::Response;

/// Most networks, newest first, among which one with the same parameters is searched.
const MAX_NETWORKS: i64 = 8;
/// Most residual networks, newest first, among which one is searched that was not trained on these points. Each is read with its measurement set.
const MAX_RESIDUAL_NETWORKS: i64 = 3;
/// Longest chain of residual networks of which each continued the training of the one before.
const LONGEST_CHAIN: usize = 64;

/// Stored rows that a job refers to.
struct Sources {
    robot: RobotRow,
    set: SetSource,
    verify_set: Option<SetSource>,
    frames: Option<FramesContent>,
    networks: Vec<(String, Vec<u8>)>,
    residual_networks: Vec<ResidualSource>,
    parameter_set: Option<ParameterSetRow>,
    /// The frame that a verify job's parameter set was identified in.
    scored_frame: Option<Frame>,
}

/// A stored set and its bytes.
struct SetSource {
    row: MeasurementSetRow,
    bytes: Vec<u8>,
}

impl SetSource {
    async fn read(app: &App, id: &str) -> Result<Self, store::Error> {
        let (row, bytes) = measurement_sets::get_with_body(&app.store, id).await?;
        Ok(Self { row, bytes })
    }

    fn set(&self, n_joints: usize) -> Result<MeasurementSet, Error> {
        let frame = frame_of(&self.row)?;
        from_upload(&self.row.content_type, &self.bytes, frame, n_joints).map_err(Error::Invalid)
    }
}

/// A residual network with the uploads that it was trained on.
struct ResidualSource {
    id: String,
    weights: Vec<u8>,
    set: SetSource,
    /// Hashes of the uploads that it and its predecessors were trained on; none if the chain is too long.
    trained_on_sha256: Option<Vec<String>>,
}

/// The networks that a job starts from.
struct Chosen {
    network_id: Option<String>,
    residual_network_id: Option<String>,
}

/// Queues a calibration and answers at once. Poll the job with `wait_s`, or listen to its events.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/jobs", tag = "jobs", operation_id = "createJob",
    params(("robot_id" = String, Path, description = "The robot")), request_body = JobRequestBody,
    responses((status = 202, description = "The job, queued", body = JobAnswer, headers(("Location" = String, description = "Its path"))))
)]
pub async fn create(
    State(app): State<App>,
    Id(robot_id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    if submission.has_key() {
        // The robot is checked first: looking up an Idempotency-Key needs the database's writer.
        access::robot(&app, &submission.caller, &robot_id).await?;
        if let Some(answer) = submission.replay(&app.store).await? {
            return Ok(answer);
        }
    }
    access::visible_robot(&submission.caller, &robot_id)?;
    let request = match asked(&submission) {
        Ok(request) => request,
        Err(refusal) => {
            // A missing robot is reported before other errors.
            access::robot(&app, &submission.caller, &robot_id).await?;
            return Err(refusal);
        }
    };
    // Before the uploads are read, so that waiting requests hold none in memory.
    let permit = app.compute_permit(RequestClass::Write).await?;
    let sources = load(&app, &submission.caller, &robot_id, &request).await?;
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
    let answer = submission.create(&app.store, effect).await?;
    app.signals.job_enqueued();
    Ok(answer)
}

/// Parses and checks the request body.
fn asked(submission: &Submission) -> Result<JobRequestBody, Error> {
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
        measurement_set_id: request.measurement_set_id.clone(),
        verify_set_id: sources.verify_set.as_ref().map(|set| set.row.id.clone()),
        frames_id: request.frames_id.clone(),
        network_input_id: None,
        residual_network_input_id: None,
        parameter_set_input_id: sources.parameter_set.as_ref().map(|row| row.id.clone()),
        kind: match request.kind {
            Kind::Identify => "identify".into(),
            Kind::Verify => "verify".into(),
        },
        method: request.method.as_str().into(),
        request_json: serde_json::to_string(request)?,
        priority: request.priority,
        client: client.into(),
    })
}

async fn load(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    request: &JobRequestBody,
) -> Result<Sources, Error> {
    // Concurrently; of several errors the first in this order is returned.
    let (robot, set, verify_set, frames, parameter_set) = tokio::join!(
        access::robot(app, caller, robot_id),
        set(
            app,
            robot_id,
            &request.measurement_set_id,
            "/measurement_set_id"
        ),
        verify_set(app, robot_id, request),
        frames(app, robot_id, request),
        parameter_set(app, robot_id, request),
    );
    let (robot, set, verify_set, frames, parameter_set) =
        (robot?, set?, verify_set?, frames?, parameter_set?);
    let (networks, residual_networks, scored_frame) = tokio::join!(
        networks(app, robot_id, request, &set.row),
        residual_networks(app, robot_id, request, &set.row),
        scored_frame(app, request, parameter_set.as_ref())
    );
    Ok(Sources {
        set,
        verify_set,
        frames,
        networks: networks?,
        residual_networks: residual_networks?,
        parameter_set,
        scored_frame: scored_frame?,
        robot,
    })
}

async fn set(app: &App, robot_id: &str, id: &str, at: &str) -> Result<SetSource, Error> {
    require_own(
        SetSource::read(app, id).await,
        |set| set.row.robot_id == robot_id,
        at,
        "measurement set",
    )
}

async fn verify_set(
    app: &App,
    robot_id: &str,
    request: &JobRequestBody,
) -> Result<Option<SetSource>, Error> {
    match &request.verify {
        Some(VerifyBody::Set { measurement_set_id }) => set(
            app,
            robot_id,
            measurement_set_id,
            "/verify/measurement_set_id",
        )
        .await
        .map(Some),
        _ => Ok(None),
    }
}

async fn frames(
    app: &App,
    robot_id: &str,
    request: &JobRequestBody,
) -> Result<Option<FramesContent>, Error> {
    let Some(id) = &request.frames_id else {
        return Ok(None);
    };
    let row = require_own(
        frames::get(&app.store, id).await,
        |row| row.robot_id == robot_id,
        "/frames_id",
        "frames",
    )?;
    Ok(Some(serde_json::from_str(&row.result_json)?))
}

/// Chooses the parameter set of the job now, so that every attempt uses the same. It is the one that the request names. By default a `verify` job
/// scores the active set, and an `identify` job is compared with the robot's last set from another upload.
async fn parameter_set(
    app: &App,
    robot_id: &str,
    request: &JobRequestBody,
) -> Result<Option<ParameterSetRow>, Error> {
    Ok(match (&request.parameter_set_id, request.kind) {
        (Some(id), _) => Some(require_own(
            parameter_sets::get(&app.store, id).await,
            |row| row.robot_id == robot_id,
            "/parameter_set_id",
            "parameter set",
        )?),
        (None, Kind::Verify) => parameter_sets::active(&app.store, robot_id).await?,
        (None, Kind::Identify) => {
            parameter_sets::of_another_session(&app.store, robot_id, &request.measurement_set_id)
                .await?
        }
    })
}

/// The frame of the upload that a verify job's parameter set was identified from.
async fn scored_frame(
    app: &App,
    request: &JobRequestBody,
    scored: Option<&ParameterSetRow>,
) -> Result<Option<Frame>, Error> {
    let Some(set) = scored.filter(|_| request.kind == Kind::Verify) else {
        return Ok(None);
    };
    let job = stored::get(&app.store, &set.job_id).await?;
    let upload = measurement_sets::get(&app.store, &job.measurement_set_id).await?;
    Ok(Some(frame_of(&upload)?))
}

/// The networks that the job may start from: the one that the request names, or for `bpnn_pso` and `auto` the newest.
async fn networks(
    app: &App,
    robot_id: &str,
    request: &JobRequestBody,
    set: &MeasurementSetRow,
) -> Result<Vec<(String, Vec<u8>)>, Error> {
    if let Some(id) = &request.network_id {
        let row = require_own(
            networks::get(&app.store, id).await,
            |row| is_of(row, robot_id, NetworkKind::LinkParameters),
            "/network_id",
            "network",
        )?;
        return Ok(vec![(
            row.id.clone(),
            networks::weights(&app.store, &row.id).await?,
        )]);
    }
    if !matches!(request.method, Method::BpnnPso | Method::Auto) || request.kind == Kind::Verify {
        return Ok(vec![]);
    }
    let model = request.model_for(frame_of(set)?);
    Ok(networks::newest(
        &app.store,
        robot_id,
        model.as_str(),
        request.preset.as_str(),
        MAX_NETWORKS,
    )
    .await?)
}

/// The residual networks from which training may continue, with the points that they were trained on.
async fn residual_networks(
    app: &App,
    robot_id: &str,
    request: &JobRequestBody,
    set: &MeasurementSetRow,
) -> Result<Vec<ResidualSource>, Error> {
    if !request.may_train_residual_network() {
        return Ok(vec![]);
    }
    let found = match &request.residual_network_id {
        Some(id) => {
            let is_own = |row: &NetworkRow| is_of(row, robot_id, NetworkKind::Residual);
            let row = require_own(
                networks::get(&app.store, id).await,
                is_own,
                "/residual_network_id",
                "residual network",
            )?;
            let job = stored::get(&app.store, &row.job_id).await?;
            vec![(
                row.id,
                networks::weights(&app.store, id).await?,
                job.measurement_set_id,
            )]
        }
        None => {
            networks::newest_residual(&app.store, robot_id, &set.sha256, MAX_RESIDUAL_NETWORKS)
                .await?
        }
    };
    let mut sources = Vec::with_capacity(found.len());
    for (id, weights, set_id) in found {
        let set = SetSource::read(app, &set_id).await?;
        let trained_on_sha256 = uploads_trained_on(app, &id).await?;
        sources.push(ResidualSource {
            id,
            weights,
            set,
            trained_on_sha256,
        });
    }
    Ok(sources)
}

/// Hashes of the uploads that a residual network and its predecessors were trained on; `None` if the chain is too long.
async fn uploads_trained_on(app: &App, network_id: &str) -> Result<Option<Vec<String>>, Error> {
    let (mut line, mut next) = (Vec::new(), Some(network_id.to_owned()));
    while let Some(id) = next {
        if line.len() == LONGEST_CHAIN {
            return Ok(None);
        }
        let network = networks::get(&app.store, &id).await?;
        let job = stored::get(&app.store, &network.job_id).await?;
        line.push(
            measurement_sets::get(&app.store, &job.measurement_set_id)
                .await?
                .sha256,
        );
        next = job.residual_network_input_id;
    }
    Ok(Some(line))
}

fn is_of(row: &NetworkRow, robot_id: &str, kind: NetworkKind) -> bool {
    row.robot_id == robot_id
        && serde_json::from_str::<NetworkMetadata>(&row.metadata_json)
            .is_ok_and(|metadata| metadata.kind == kind)
}

/// The newest residual network for this robot that was trained, predecessors included, on no point that is fitted or verified here. Otherwise
/// cross-validation and verification would prove nothing.
fn choose_residual(
    request: &JobRequestBody,
    calibration_request: &CalibrationRequest,
    (sources, sets_sha256): (&[ResidualSource], &[&str]),
    parse: impl Fn(&SetSource) -> Result<MeasurementSet, Error>,
) -> Result<Option<String>, Error> {
    let to_verify = match &calibration_request.verify {
        VerifySource::Set(set) => Some(set),
        _ => None,
    };
    for source in sources {
        let fits = match safetensors::read_residual(&source.weights) {
            Ok(network) => network.centre_rad.len() == calibration_request.robot.links.len(),
            Err(error) => {
                tracing::error!(network_id = source.id, %error, "a stored residual network cannot be read; it is skipped");
                false
            }
        };
        let is_of_others = |line: &Vec<String>| {
            line.iter()
                .all(|sha256| !sets_sha256.contains(&sha256.as_str()))
        };
        if fits && source.trained_on_sha256.as_ref().is_some_and(is_of_others) {
            let trained_on = parse(&source.set)?;
            if is_anew(
                &calibration_request.robot,
                &trained_on,
                &calibration_request.set,
            ) && to_verify
                .is_none_or(|set| is_anew(&calibration_request.robot, &trained_on, set))
            {
                return Ok(Some(source.id.clone()));
            }
        }
    }
    if request.residual_network_id.is_some() {
        let detail = "the residual network, or one that its training went on from, has seen points of these sets: whether it helps could not be told \
                      from them. Leave residual_network_id out, or name one of other sessions";
        return Err(calibration::Error::Unusable {
            code: "network_mismatch",
            detail: detail.into(),
        }
        .into());
    }
    Ok(None)
}

/// The frame of a stored set.
pub fn frame_of(set: &MeasurementSetRow) -> Result<Frame, Error> {
    Frame::parse(&set.frame)
        .ok_or_else(|| Error::Internal(format!("set {} has frame {:?}", set.id, set.frame)))
}

/// A document that the request names must exist and belong to the robot; both failures give the same error.
pub fn require_own<T>(
    found: Result<T, crate::store::Error>,
    is_own: impl Fn(&T) -> bool,
    at: &str,
    what: &str,
) -> Result<T, Error> {
    match found {
        Ok(row) if is_own(&row) => Ok(row),
        Ok(_) | Err(crate::store::Error::NotFound) => Err(id::unknown(at, what).into()),
        Err(error) => Err(error.into()),
    }
}

/// Runs every check of the core, and chooses the networks that the job starts from.
fn check(request: &JobRequestBody, sources: Sources) -> Result<Chosen, Error> {
    let robot = Robot::try_from(&access::robot_body(&sources.robot)?)?;
    let n_joints = robot.links.len();
    let parse = |source: &SetSource| source.set(n_joints);
    let parts = JobParts {
        set: parse(&sources.set)?,
        verify_set: sources.verify_set.as_ref().map(parse).transpose()?,
        frames: sources.frames.as_ref().map(Into::into),
        network: None,
        residual_network: None,
        previous: None,
        robot,
    };
    let mut calibration_request = request.calibration_request(parts)?;
    let readable = |(id, bytes): (String, Vec<u8>)| match safetensors::read(&bytes) {
        Ok(network) => Some((id, network)),
        Err(error) => {
            tracing::error!(network_id = id, %error, "a stored network cannot be read; it is skipped");
            None
        }
    };
    let mut networks: Vec<_> = sources.networks.into_iter().filter_map(readable).collect();
    // The newest with the same parameters. If there is none, `auto` uses no network; if the request needs one, the check refuses the newest.
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
        Kind::Verify => {
            let parse =
                |row: &ParameterSetRow| serde_json::from_str::<ParameterSetContent>(&row.body_json);
            let content = sources.parameter_set.as_ref().map(parse).transpose()?;
            calibration_request.scored_frame = sources.scored_frame;
            let identified = content.map(|content| (&content).into());
            calibration::check_verify(&calibration_request, identified.as_ref())?;
        }
    }
    let sets_sha256: Vec<&str> = std::iter::once(&sources.set)
        .chain(&sources.verify_set)
        .map(|set| set.row.sha256.as_str())
        .collect();
    let residual_network_id = choose_residual(
        request,
        &calibration_request,
        (&sources.residual_networks, &sets_sha256),
        parse,
    )?;
    Ok(Chosen {
        network_id,
        residual_network_id,
    })
}
