//! The stored documents that a posted job refers to.

use crate::calibration;
use crate::http::auth::Caller;
use crate::http::{App, Error, access};
use crate::jobs::MeasurementSetInput;
use crate::release::facts::UNUSABLE_FIT;
use crate::store::{
    self, MeasurementSetRow, NetworkRow, NetworkWeights, ParameterSetRow, RobotRow, frames,
    job_sources, jobs, measurement_sets, networks, parameter_sets,
};
use crate::wire::frames::FramesContent;
use crate::wire::id;
use crate::wire::issue::Invalid;
use crate::wire::job::{JobRequestBody, Kind, Method, VerifyBody};
use crate::wire::measurement::{Frame, MAX_POINTS, MAX_UPLOAD_BYTES};
use crate::wire::network::NetworkKind;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::safetensors::NetworkMetadata;

/// Maximum number of networks, newest first, that are searched for one with the same parameters.
const MAX_NETWORKS: i64 = 8;
/// Maximum number of residual networks, newest first, that are searched for one that was not trained on these points. Each is read with its
/// measurement sets.
const MAX_RESIDUAL_NETWORKS: i64 = 3;

/// Stored rows that a job refers to.
pub struct Sources {
    /// The robot.
    pub robot: RobotRow,
    /// The measurement sets to identify from, or to score: one for each session.
    pub sets: Vec<MeasurementSetInput>,
    /// Another upload to verify on.
    pub verify_set: Option<MeasurementSetInput>,
    /// Base and tool frame from sweeps.
    pub frames: Option<FramesContent>,
    /// Networks that the job may start from, newest first.
    pub networks: Vec<NetworkWeights>,
    /// Residual networks from which training may continue, newest first.
    pub residual_networks: Vec<ResidualSource>,
    /// The parameter set that the job scores, whose values it holds, or that it is compared with.
    pub parameter_set: Option<ParameterSetRow>,
    /// The frame that the scored parameter set was identified in.
    pub scored_frame: Option<Frame>,
}

/// A residual network with the uploads that it was trained on.
pub struct ResidualSource {
    /// Its id.
    pub id: String,
    /// The weights in safetensors format.
    pub weights: Vec<u8>,
    /// The measurement sets that it was trained on.
    pub sets: Vec<MeasurementSetInput>,
    /// Hashes of the uploads that it and its predecessors were trained on.
    pub trained_on_sha256: Vec<String>,
}

/// Reads the stored documents that a request refers to.
///
/// # Errors
/// [`Error::Invalid`] with a pointer to a document that does not exist or belongs to another robot; those of the store.
pub async fn load(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    request: &JobRequestBody,
) -> Result<Sources, Error> {
    // Reads concurrently. If several reads fail, the first error in this order is returned.
    let (robot, sets, verify_set, frames, parameter_set) = tokio::join!(
        access::robot(app, caller, robot_id),
        sets(app, robot_id, request),
        verify_set(app, robot_id, request),
        frames(app, robot_id, request),
        parameter_set(app, robot_id, request),
    );
    let (robot, sets, verify_set, frames, parameter_set) =
        (robot?, sets?, verify_set?, frames?, parameter_set?);
    access::require_in_use(&robot)?;
    for row in sets.iter().chain(verify_set.iter().map(|set| &set.row)) {
        if row.archived_at_ms.is_some() {
            return Err(access::archived("measurement set", &row.id));
        }
    }
    if let Some(set) = &parameter_set {
        check_parameter_set(set, &robot)?;
        if request.holds_parameter_set() && set.status == ParameterSetStatus::Withdrawn {
            return Err(held_set_withdrawn(&set.id));
        }
    }
    check_sessions(request, &sets)?;
    let sets = read_bodies(app, sets).await?;
    let first = &sets.first().ok_or(store::Error::NotFound)?.row;
    let (networks, residual_networks, scored_frame) = tokio::join!(
        networks(app, &robot, request, first),
        residual_networks(app, &robot, request, first),
        scored_frame(app, request, parameter_set.as_ref())
    );
    Ok(Sources {
        sets,
        verify_set,
        frames,
        networks: networks?,
        residual_networks: residual_networks?,
        parameter_set,
        scored_frame: scored_frame?,
        robot,
    })
}

/// The sets of the request, in its order, without their bytes.
async fn sets(
    app: &App,
    robot_id: &str,
    request: &JobRequestBody,
) -> Result<Vec<MeasurementSetRow>, Error> {
    let mut sets = Vec::new();
    for (place, id) in request.set_ids().into_iter().enumerate() {
        sets.push(require_own(
            measurement_sets::get(&app.store, id).await,
            |row| row.robot_id == robot_id,
            &request.set_pointer(place),
            "measurement set",
        )?);
    }
    Ok(sets)
}

/// The sets with their bytes. Their total size is limited to that of one upload, because all are in memory at once.
async fn read_bodies(
    app: &App,
    rows: Vec<MeasurementSetRow>,
) -> Result<Vec<MeasurementSetInput>, Error> {
    let (mut sets, mut n_bytes) = (Vec::with_capacity(rows.len()), 0);
    for row in rows {
        let body = measurement_sets::body(&app.store, &row.id).await?;
        n_bytes += body.len();
        if n_bytes > MAX_UPLOAD_BYTES {
            let detail = format!(
                "the files of these sessions have more than {} MiB together: leave sessions out",
                MAX_UPLOAD_BYTES >> 20
            );
            return Err(Invalid::at("/measurement_set_ids", "too_large", detail).into());
        }
        sets.push(MeasurementSetInput { row, body });
    }
    Ok(sets)
}

async fn set(app: &App, robot_id: &str, id: &str, at: &str) -> Result<MeasurementSetInput, Error> {
    require_own(
        MeasurementSetInput::read(&app.store, id).await,
        |set| set.row.robot_id == robot_id,
        at,
        "measurement set",
    )
}

async fn verify_set(
    app: &App,
    robot_id: &str,
    request: &JobRequestBody,
) -> Result<Option<MeasurementSetInput>, Error> {
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

/// Chooses the parameter set when the job is posted, so that every attempt uses the same one. A request may name it. By default a `verify` or `check`
/// job scores the active set, and an `identify` job is compared with the robot's last set from another upload.
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
        (None, Kind::Check) => Some(
            parameter_sets::active(&app.store, robot_id)
                .await?
                .ok_or_else(no_released_set)?,
        ),
        (None, Kind::Identify) => {
            parameter_sets::of_another_upload(
                &app.store,
                robot_id,
                &request.set_ids().join(","),
                UNUSABLE_FIT,
            )
            .await?
        }
    })
}

fn no_released_set() -> Error {
    let detail = "a check says whether the released set still holds, and this robot has none: release one, or name a candidate in parameter_set_id";
    Error::conflict("no_active_parameter_set", detail)
}

fn held_set_withdrawn(id: &str) -> Error {
    let detail = format!(
        "the parameter set {id} was withdrawn, and what is identified here would keep its values: identify all parameters, or name another set"
    );
    Error::conflict("parameter_set_withdrawn", detail)
}

/// Refuses a parameter set that is archived, or that was identified with another joint map.
fn check_parameter_set(set: &ParameterSetRow, robot: &RobotRow) -> Result<(), Error> {
    if set.archived_at_ms.is_some() {
        return Err(access::archived("parameter set", &set.id));
    }
    if set.joint_map_version != robot.joint_map_version {
        let detail = format!(
            "the parameter set {} was identified with a joint map that the robot no longer has: identify anew from its upload",
            set.id
        );
        return Err(Error::conflict("joint_map_changed", detail));
    }
    Ok(())
}

/// Refuses a network that is archived, or that was trained with another joint map.
fn check_network(network: &NetworkRow, robot: &RobotRow) -> Result<(), Error> {
    if network.archived_at_ms.is_some() {
        return Err(access::archived("network", &network.id));
    }
    if network.joint_map_version != robot.joint_map_version {
        return Err(calibration::Error::Unusable {
            code: "network_mismatch",
            detail: format!(
                "the network {} was trained with a joint map that the robot no longer has: leave it out, or train another one by a pso job",
                network.id
            ),
        }
        .into());
    }
    Ok(())
}

/// The frame of the upload that a verify or check job's parameter set was identified from.
async fn scored_frame(
    app: &App,
    request: &JobRequestBody,
    scored: Option<&ParameterSetRow>,
) -> Result<Option<Frame>, Error> {
    let Some(set) = scored.filter(|_| request.kind.scores()) else {
        return Ok(None);
    };
    let job = jobs::get(&app.store, &set.job_id).await?;
    let upload = measurement_sets::get(&app.store, &job.measurement_set_id).await?;
    Ok(Some(upload.frame))
}

/// The networks that the job may start from: the one that the request names, or for `bpnn_pso` and `auto` the newest.
async fn networks(
    app: &App,
    robot: &RobotRow,
    request: &JobRequestBody,
    set: &MeasurementSetRow,
) -> Result<Vec<NetworkWeights>, Error> {
    if let Some(id) = &request.network_id {
        let row = require_own(
            networks::get(&app.store, id).await,
            |row| is_network_of_robot(row, &robot.id, NetworkKind::LinkParameters),
            "/network_id",
            "network",
        )?;
        check_network(&row, robot)?;
        return Ok(vec![NetworkWeights {
            weights: networks::weights(&app.store, &row.id).await?,
            id: row.id,
        }]);
    }
    if !matches!(request.method, Method::BpnnPso | Method::Auto) || request.kind.scores() {
        return Ok(vec![]);
    }
    let model = request.model_for(set.frame);
    Ok(networks::newest(&app.store, &robot.id, model, request.preset, MAX_NETWORKS).await?)
}

/// The residual networks from which training may continue, with the points that they were trained on.
async fn residual_networks(
    app: &App,
    robot: &RobotRow,
    request: &JobRequestBody,
    set: &MeasurementSetRow,
) -> Result<Vec<ResidualSource>, Error> {
    if !request.may_train_residual_network() {
        return Ok(vec![]);
    }
    let found = match &request.residual_network_id {
        Some(id) => {
            let is_own =
                |row: &NetworkRow| is_network_of_robot(row, &robot.id, NetworkKind::Residual);
            let row = require_own(
                networks::get(&app.store, id).await,
                is_own,
                "/residual_network_id",
                "residual network",
            )?;
            check_network(&row, robot)?;
            vec![NetworkWeights {
                id: row.id,
                weights: networks::weights(&app.store, id).await?,
            }]
        }
        None => {
            networks::newest_residual(&app.store, &robot.id, &set.sha256, MAX_RESIDUAL_NETWORKS)
                .await?
        }
    };
    let mut sources = Vec::with_capacity(found.len());
    for network in found {
        let row = networks::get(&app.store, &network.id).await?;
        let job = jobs::get(&app.store, &row.job_id).await?;
        sources.push(ResidualSource {
            sets: MeasurementSetInput::read_of(&app.store, &job).await?,
            trained_on_sha256: uploads_trained_on(app, &network.id).await?,
            id: network.id,
            weights: network.weights,
        });
    }
    Ok(sources)
}

/// Hashes of the uploads on which a residual network is based: those of its job and of that job's sources.
async fn uploads_trained_on(app: &App, network_id: &str) -> Result<Vec<String>, Error> {
    let network = networks::get(&app.store, network_id).await?;
    let job = jobs::get(&app.store, &network.job_id).await?;
    let sources = job_sources::uploads(&app.store, &job.id).await?;
    let sources = sources
        .iter()
        .map(|upload| upload.measurement_set_id.as_str());
    let mut hashes = Vec::new();
    for id in job.set_ids().chain(sources) {
        hashes.push(measurement_sets::get(&app.store, id).await?.sha256);
    }
    Ok(hashes)
}

fn is_network_of_robot(row: &NetworkRow, robot_id: &str, kind: NetworkKind) -> bool {
    row.robot_id == robot_id
        && serde_json::from_str::<NetworkMetadata>(&row.metadata_json)
            .is_ok_and(|metadata| metadata.kind == kind)
}

/// Requires that a document that the request names exists and belongs to the robot. Both failures give the same error.
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

/// Refuses sets that cannot be fitted together: of different frames, with different serial numbers, or too many points in all.
///
/// # Errors
/// [`Invalid`]: `mixed_frames`, `robot_mismatch`, `too_many_points`.
fn check_sessions(request: &JobRequestBody, sets: &[MeasurementSetRow]) -> Result<(), Invalid> {
    let [first, further @ ..] = sets else {
        return Ok(());
    };
    let stated = sets.iter().find_map(|set| set.serial_number.as_ref());
    for (place, set) in (1..).zip(further) {
        let at = request.set_pointer(place);
        if set.frame != first.frame {
            let detail = format!(
                "this set is in the frame {} and the first in the frame {}: fit sessions of one frame together, or upload this one in the other frame",
                set.frame.as_str(),
                first.frame.as_str()
            );
            return Err(Invalid::at(&at, "mixed_frames", detail));
        }
        let own = set.serial_number.as_ref().zip(stated);
        if let Some((own, other)) = own.filter(|(own, other)| own != other) {
            let detail = format!(
                "this set was uploaded for the serial number {own:?} and an earlier one for {other:?}: two robots are never fitted together, leave one out"
            );
            return Err(Invalid::at(&at, "robot_mismatch", detail));
        }
    }
    let n_points: i64 = sets.iter().map(|set| set.n_points).sum();
    if sets.len() > 1 && n_points > MAX_POINTS as i64 {
        let detail = format!(
            "{n_points} points in all; {MAX_POINTS} are allowed in one job: leave sessions out"
        );
        return Err(Invalid::at(
            "/measurement_set_ids",
            "too_many_points",
            detail,
        ));
    }
    Ok(())
}
