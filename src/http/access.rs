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
    require_plausible_id(id, "robot")?;
    require_visible(caller, id, "robot")?;
    robots::get(&app.store, id)
        .await
        .map_err(|error| not_found_as(error, "robot"))
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

/// Generates one function per entry that reads a row belonging to a robot. An entry states the doc comment, the function's name, the
/// table's module, the row type, and the name of the item for error messages.
macro_rules! rows_of_robots {
    ($($(#[$doc:meta])+ $name:ident: $table:ident $row:ident, $what:tt;)+) => {$(
        $(#[$doc])+
        pub async fn $name(app: &App, caller: &Caller, id: &str) -> Result<$row, Error> {
            require_plausible_id(id, $what)?;
            let row = $table::get(&app.store, id).await;
            let row = row.map_err(|error| not_found_as(error, $what))?;
            require_visible(caller, &row.robot_id, $what)?;
            Ok(row)
        }
    )+};
}

rows_of_robots! {
    /// The measurement set, if this key may see it.
    measurement_set: measurement_sets MeasurementSetRow, "measurement set";
    /// The frames, if this key may see them.
    frames: frames FramesRow, "frames";
    /// The job, if this key may see it.
    job: jobs JobRow, "job";
    /// The parameter set, if this key may see it.
    parameter_set: parameter_sets ParameterSetRow, "parameter set";
    /// The network, if this key may see it.
    network: networks NetworkRow, "network";
}

/// Refuses a text from a query or a body that cannot be an id. Does not query the database.
fn require_plausible_id(id: &str, what: &'static str) -> Result<(), Error> {
    if id::is_plausible(id) {
        Ok(())
    } else {
        Err(Error::NotFound(what))
    }
}

fn require_visible(caller: &Caller, robot_id: &str, what: &'static str) -> Result<(), Error> {
    if caller.may_see(robot_id) {
        Ok(())
    } else {
        Err(Error::NotFound(what))
    }
}

fn not_found_as(error: store::Error, what: &'static str) -> Error {
    match error {
        store::Error::NotFound => Error::NotFound(what),
        other => other.into(),
    }
}
