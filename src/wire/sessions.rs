//! Jobs with several sessions: checks of the request, and the part of the report about each session.

pub use crate::calibration::report::PooledSessions as PooledReport;
use crate::measurement::sessions::MAX_SESSIONS;
use crate::wire::issue::{Checker, Invalid};

/// Refuses a request with no measurement set, with the same set twice, or with too few or too many sets. `one` is `measurement_set_id`, `several` are
/// `measurement_set_ids`.
///
/// # Errors
/// [`Invalid`]: `invalid_body` if no set is given, otherwise `invalid_job`.
pub fn check(one: Option<&String>, several: Option<&[String]>) -> Result<(), Invalid> {
    let Some(ids) = several else {
        return match one {
            Some(_) => Ok(()),
            None => Err(Invalid::at(
                "/measurement_set_id",
                "invalid_body",
                "missing field `measurement_set_id`: name a measurement set, or those of several sessions in measurement_set_ids",
            )),
        };
    };
    let mut checker = Checker::default();
    let at = "/measurement_set_ids";
    if one.is_some() {
        let detail = "measurement_set_id names one set and measurement_set_ids those of several sessions: leave one of the two out";
        checker.add("/measurement_set_id", "not_applicable", detail);
    }
    if !(2..=MAX_SESSIONS).contains(&ids.len()) {
        let detail = format!(
            "{} sets; 2 to {MAX_SESSIONS} sessions are fitted together, and one set is named in measurement_set_id",
            ids.len()
        );
        checker.add(at, "out_of_range", detail);
    }
    for (place, id) in ids.iter().enumerate() {
        if let Some(first) = ids[..place].iter().position(|other| other == id) {
            let detail =
                format!("the same set as {at}/{first}, and no set counts twice: leave it out");
            checker.add(format!("{at}/{place}"), "same_set", detail);
        }
    }
    checker.finish("invalid_job")
}
