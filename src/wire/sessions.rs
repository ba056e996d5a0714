//! Jobs with several sessions: checks of the request, and the part of the report about each session.

use crate::calibration::report;
use crate::measurement::sessions::MAX_SESSIONS;
use crate::wire::issue::{Checker, Invalid};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

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

/// Sessions that were fitted together, and the comparison of the two sessions that differ most.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PooledReport {
    /// Each session, in the order of `measurement_set_ids`.
    pub sessions: Vec<PooledSessionReport>,
    /// Test statistic of the two sessions that differ most: squared difference, normalised by its covariance.
    pub chi_square: f64,
    /// Number of parameter combinations that both of these sessions determine.
    pub n_combinations: usize,
    /// p-value: probability that sessions of an unchanged robot differ at least as much.
    pub probability: f64,
}

/// One of the sessions that were fitted together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PooledSessionReport {
    /// Its first row in the report, 0-based. The rows of the report are numbered continuously over all sets.
    pub first_row: usize,
    /// Number of its points.
    pub n_points: usize,
    /// Noise of one coordinate in this session, mm. Its points are weighted with it. Absent if all sessions have the same weight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_std_mm: Option<f64>,
    /// Root mean square error of its identify points with the link parameters only, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identify_rms_mm: Option<f64>,
    /// Root mean square error of its verify points with the link parameters only, mm.
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
