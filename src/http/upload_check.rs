//! Checks whether an upload can have been measured on its robot. An upload that does not fit is refused if the cause is clear, else it gets a
//! warning.

use crate::calibration::upload_checks::alignment::{self, Alignment, Explanation};
use crate::http::auth::Caller;
use crate::http::{App, Error, access};
use crate::release::{AcceptedMisfit, accept_misfit};
use crate::store::{ListRequest, robots};
use crate::wire::measurement::MeasurementSet;
use crate::wire::robot::{Robot, RobotBody};
use crate::wire::suspicion::Insist;

/// Maximum number of other models with which the upload is compared.
const MAX_OTHERS: usize = 50;
/// Maximum number of pages of robots that are read to find other models.
const MAX_PAGES: usize = 10;

/// A measurement set that does not fit the nominal robot.
pub struct Misfit {
    robot: RobotBody,
    set: MeasurementSet,
    rms_mm: f64,
}

/// Compares an upload with the nominal robot; `None` if it fits or is too small to decide.
pub fn check_fit(robot: &RobotBody, set: MeasurementSet) -> Result<Option<Misfit>, Error> {
    Ok(match alignment::align(&Robot::try_from(robot)?, &set) {
        Alignment::Misses(rms_mm) => Some(Misfit {
            robot: robot.clone(),
            set,
            rms_mm,
        }),
        Alignment::Fits => None,
    })
}

/// Searches for the cause of a misfit.
///
/// # Errors
/// [`Error::Invalid`] with the cause, if it is clear and the caller does not insist.
pub async fn diagnose(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    misfit: Misfit,
    insist: Option<Insist>,
    unread: Option<String>,
) -> Result<AcceptedMisfit, Error> {
    let others = other_models(app, caller, robot_id, &misfit.robot).await?;
    let explain = move || explanation(&misfit, &others);
    let explanation = app.compute(caller.class, explain).await?;
    Ok(accept_misfit(explanation, insist, unread.as_deref())?)
}

/// The newest robot of each other model with as many joints.
async fn other_models(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    own: &RobotBody,
) -> Result<Vec<RobotBody>, Error> {
    let mut others: Vec<RobotBody> = Vec::new();
    let mut request = ListRequest::all();
    for _ in 0..MAX_PAGES {
        let page = robots::search(&app.store, caller.robots.as_deref(), &request).await?;
        let rows = page.items.iter().filter(|row| row.id != robot_id);
        for body in rows.filter_map(|row| access::robot_body(row).ok()) {
            let is_new =
                body.links != own.links && others.iter().all(|known| known.links != body.links);
            if is_new && body.links.len() == own.links.len() {
                others.push(body);
            }
        }
        request.cursor = page.next_cursor;
        if request.cursor.is_none() || others.len() >= MAX_OTHERS {
            break;
        }
    }
    others.truncate(MAX_OTHERS);
    Ok(others)
}

fn explanation(misfit: &Misfit, others: &[RobotBody]) -> Result<Explanation, Error> {
    let named = others
        .iter()
        .map(|body| Ok((body.name.clone(), Robot::try_from(body)?)));
    let others: Vec<_> = named.collect::<Result<_, Error>>()?;
    Ok(alignment::explain(
        &Robot::try_from(&misfit.robot)?,
        &misfit.set,
        misfit.rms_mm,
        &others,
    ))
}
