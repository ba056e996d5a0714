//! Reads rows that the key may see. A row that it may not see answers 404, as if the row did not exist.

use crate::http::auth::Caller;
use crate::http::{App, Error};
use crate::store::{
    self, FramesRow, JobRow, MeasurementSetRow, NetworkRow, ParameterSetRow, RobotRow,
};
use crate::store::{
    frames, jobs, measurement_sets, networks, parameter_sets, robot_versions, robots,
};
use crate::wire::robot::RobotBody;
use crate::wire::{id, json};

/// The robot, if it exists and this key may see it.
pub async fn robot(app: &App, caller: &Caller, id: &str) -> Result<RobotRow, Error> {
    plausible(id, "robot")?;
    visible(caller, id, "robot")?;
    robots::get(&app.store, id)
        .await
        .map_err(|error| absent(error, "robot"))
}

/// As [`robot`], for a request that changes the robot: refuses an archived one.
pub async fn robot_in_use(app: &App, caller: &Caller, id: &str) -> Result<RobotRow, Error> {
    let row = robot(app, caller, id).await?;
    require_in_use(&row)?;
    Ok(row)
}

/// Refuses an archived robot.
pub fn require_in_use(robot: &RobotRow) -> Result<(), Error> {
    match robot.archived_at_ms {
        Some(_) => Err(archived("robot", &robot.id)),
        None => Ok(()),
    }
}

/// The error for an archived item, with its remedy.
pub fn archived(what: &str, id: &str) -> Error {
    let detail = format!("the {what} {id} is archived: restore it first");
    Error::conflict("archived", detail)
}

/// The robot of a parameter set: the model that the set was identified with, and today's joint limits.
pub async fn robot_of_set(
    app: &App,
    caller: &Caller,
    set: &ParameterSetRow,
) -> Result<RobotBody, Error> {
    let row = robot(app, caller, &set.robot_id).await?;
    let now = robot_body(&row)?;
    if row.version == set.robot_version {
        return Ok(now);
    }
    let then = robot_versions::robot_at(&app.store, &set.robot_id, set.robot_version).await?;
    Ok(robot_body(&then)?.with_limits_of(&now))
}

/// The document of a stored robot.
pub fn robot_body(row: &RobotRow) -> Result<RobotBody, Error> {
    json::parse(row.body_json.as_bytes())
        .map_err(|error| Error::Internal(format!("robot {} cannot be read: {error}", row.id)))
}

/// The measurement set, if this key may see it.
pub async fn measurement_set(
    app: &App,
    caller: &Caller,
    id: &str,
) -> Result<MeasurementSetRow, Error> {
    let row = measurement_sets::get(&app.store, id);
    visible_row(caller, id, "measurement set", row, |row| &row.robot_id).await
}

/// The frames, if this key may see them.
pub async fn frames(app: &App, caller: &Caller, id: &str) -> Result<FramesRow, Error> {
    let row = frames::get(&app.store, id);
    visible_row(caller, id, "frames", row, |row| &row.robot_id).await
}

/// The job, if this key may see it.
pub async fn job(app: &App, caller: &Caller, id: &str) -> Result<JobRow, Error> {
    let row = jobs::get(&app.store, id);
    visible_row(caller, id, "job", row, |row| &row.robot_id).await
}

/// The parameter set, if this key may see it.
pub async fn parameter_set(app: &App, caller: &Caller, id: &str) -> Result<ParameterSetRow, Error> {
    let row = parameter_sets::get(&app.store, id);
    visible_row(caller, id, "parameter set", row, |row| &row.robot_id).await
}

/// The network, if this key may see it.
pub async fn network(app: &App, caller: &Caller, id: &str) -> Result<NetworkRow, Error> {
    let row = networks::get(&app.store, id);
    visible_row(caller, id, "network", row, |row| &row.robot_id).await
}

/// The row, if this key may see its robot. The query runs only for a text that can be an id.
async fn visible_row<R>(
    caller: &Caller,
    id: &str,
    what: &'static str,
    query: impl Future<Output = store::Result<R>>,
    robot_id: fn(&R) -> &str,
) -> Result<R, Error> {
    plausible(id, what)?;
    let row = query.await.map_err(|error| absent(error, what))?;
    visible(caller, robot_id(&row), what)?;
    Ok(row)
}

/// Refuses a text from a query or a body that cannot be an id. Does not query the database.
fn plausible(id: &str, what: &'static str) -> Result<(), Error> {
    if id::is_plausible(id) {
        Ok(())
    } else {
        Err(Error::NotFound(what))
    }
}

fn visible(caller: &Caller, robot_id: &str, what: &'static str) -> Result<(), Error> {
    if caller.may_see(robot_id) {
        Ok(())
    } else {
        Err(Error::NotFound(what))
    }
}

fn absent(error: store::Error, what: &'static str) -> Error {
    match error {
        store::Error::NotFound => Error::NotFound(what),
        other => other.into(),
    }
}
