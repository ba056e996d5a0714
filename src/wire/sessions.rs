//! Several sessions of one job: the checks of a request that names them, and what its report says of each.

use crate::calibration::report;
use crate::measurement::sessions::MAX_SESSIONS;
use crate::wire::issue::{Checker, Invalid};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Refuses requests that name no set, the same set twice, too few or too many: `one` is `measurement_set_id`, `several` are `measurement_set_ids`.
///
/// # Errors
/// [`Invalid`]: `invalid_job`, `invalid_body` where no set is named.
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
        checker.note("/measurement_set_id", "not_applicable", detail);
    }
    if !(2..=MAX_SESSIONS).contains(&ids.len()) {
        let detail = format!(
            "{} sets; 2 to {MAX_SESSIONS} sessions are fitted together, and one set is named in measurement_set_id",
            ids.len()
        );
        checker.note(at, "out_of_range", detail);
    }
    for (place, id) in ids.iter().enumerate() {
        if let Some(first) = ids[..place].iter().position(|other| other == id) {
            let detail =
                format!("the same set as {at}/{first}, and no set counts twice: leave it out");
            checker.note(format!("{at}/{place}"), "same_set", detail);
        }
    }
    checker.finish("invalid_job")
}

/// Sessions that were fitted together, and how alike the two are that are least alike.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PooledReport {
    /// Each session, in the order of `measurement_set_ids`.
    pub sessions: Vec<PooledSessionReport>,
    /// Difference of the two, in units of its covariance, squared.
    pub chi_square: f64,
    /// Combinations of parameters that both see.
    pub n_combinations: usize,
    /// Probability that sessions of an unchanged robot differ as much.
    pub probability: f64,
}

/// One of the sessions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PooledSessionReport {
    /// Its first row: rows of the report count on through the sets, from 0.
    pub first_row: usize,
    /// Number of its points.
    pub n_points: usize,
    /// Its own noise of a coordinate, mm, by which its points count; absent if all sessions count alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_std_mm: Option<f64>,
    /// Root mean square error of its points to identify from, by the links alone, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identify_rms_mm: Option<f64>,
    /// The same of its points to verify.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verify_rms_mm: Option<f64>,
}

impl From<&report::PooledSessions> for PooledReport {
    fn from(core: &report::PooledSessions) -> Self {
        Self {
            sessions: core.sessions.iter().map(Into::into).collect(),
            chi_square: core.chi_square,
            n_combinations: core.n_combinations,
            probability: core.probability,
        }
    }
}

impl From<&report::PooledSession> for PooledSessionReport {
    fn from(core: &report::PooledSession) -> Self {
        Self {
            first_row: core.first_row,
            n_points: core.n_points,
            noise_std_mm: core.noise_std_mm,
            identify_rms_mm: core.identify_rms_mm,
            verify_rms_mm: core.verify_rms_mm,
        }
    }
}
