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
/// Maximum number of robots of one model that are named.
const MAX_NAMES: usize = 5;
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

/// Robots of another model.
struct OtherModel {
    robot: RobotBody,
    /// Their names, the newest first.
    names: Vec<String>,
}

impl OtherModel {
    /// The names in quotes. These robots have the same links, so the upload cannot show which of them was measured.
    fn in_words(&self) -> String {
        let named = self.names.iter().take(MAX_NAMES);
        let named: Vec<String> = named.map(|name| format!("{name:?}")).collect();
        let more = match self.names.len() - named.len() {
            0 => String::new(),
            n => format!(" or {n} more robots with the same links"),
        };
        named.join(" or ") + &more
    }
}

/// The other models with as many joints.
async fn other_models(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    own: &RobotBody,
) -> Result<Vec<OtherModel>, Error> {
    let mut others: Vec<OtherModel> = Vec::new();
    let mut request = ListRequest::all();
    for _ in 0..MAX_PAGES {
        let page = robots::search(&app.store, caller.robots.as_deref(), &request).await?;
        let rows = page.items.iter().filter(|row| row.id != robot_id);
        for body in rows.filter_map(|row| access::robot_body(row).ok()) {
            if body.links == own.links || body.links.len() != own.links.len() {
                continue;
            }
            let is_known = |known: &&mut OtherModel| known.robot.links == body.links;
            match others.iter_mut().find(is_known) {
                Some(known) => known.names.push(body.name),
                None => others.push(OtherModel {
                    names: vec![body.name.clone()],
                    robot: body,
                }),
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

fn explanation(misfit: &Misfit, others: &[OtherModel]) -> Result<Explanation, Error> {
    let named = others
        .iter()
        .map(|other| Ok((other.in_words(), Robot::try_from(&other.robot)?)));
    let others: Vec<_> = named.collect::<Result<_, Error>>()?;
    Ok(alignment::explain(
        &Robot::try_from(&misfit.robot)?,
        &misfit.set,
        misfit.rms_mm,
        &others,
    ))
}
