//! Comparison of a set with the robot's active one on the same points.

use crate::calibration::request::VerifySource;
use crate::calibration::{self, CalibrationRequest, robust_comparison};
use crate::measurement::MeasurementSet;
use crate::release::sessions::Session;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::verification::Verification;

/// Errors of the set and of the robot's active one on the same points.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Description of the points.
    pub points: String,
    /// Errors of both sets on these points, or the reason why there are no errors.
    pub rms: Result<ComparedRms, String>,
}

/// rms of the errors of two parameter sets on the same points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComparedRms {
    /// Of the set that may be released, mm.
    pub set_mm: f64,
    /// Of the robot's active one, mm.
    pub active_mm: f64,
    /// Standard error of their difference, from the scatter of the points, mm.
    pub std_mm: f64,
}

impl ComparedRms {
    /// True if the set is not worse than the active one beyond chance: by at most two standard errors, and by at most a tenth.
    pub fn is_as_good(&self) -> bool {
        let chance_mm = (2.0 * self.std_mm).min(MAX_CHANCE_SHARE * self.active_mm);
        self.set_mm <= self.active_mm + chance_mm.max(SAME_MM)
    }
}

/// Largest difference between the errors of two sets that count as equally good, mm: a tenth of a laser tracker's uncertainty over an arm's reach.
pub const SAME_MM: f64 = 0.001;
/// Upper limit of the difference that counts as chance, as a share of the active set's error. It applies even with few points.
const MAX_CHANCE_SHARE: f64 = 0.1;
/// Minimum number of points for an estimate of their scatter. With fewer points the scatter counts as 0.
const MIN_POINTS_FOR_SCATTER: usize = 12;
/// Points with errors above this multiple of the rms are left out of the scatter.
const MAX_ERROR_PER_RMS: f64 = 4.0;

/// Points held out at the identification. A set is compared with the active one on them if there is no suitable session.
#[derive(Clone, Debug, PartialEq)]
pub enum HeldOutPoints {
    /// The points of the other upload on which the set was verified when it was identified.
    VerifySet,
    /// The points of the set's own upload that were held out when it was identified.
    VerifySubset {
        /// Whether the active set was identified from the same upload, as far as this is known. It may then have been fitted to these
        /// points.
        is_fitted_by_active: bool,
    },
    /// No points.
    None,
}

/// The independent sessions that show the robot as it is now, each upload once. Only independent points can decide between two sets: points
/// to which a set was fitted favour that set.
pub fn sessions_to_compare(sessions: &[Session]) -> Vec<Session> {
    let mut chosen: Vec<Session> = Vec::new();
    for session in sessions {
        let is_new = chosen
            .iter()
            .all(|other| other.measurement_set_id != session.measurement_set_id);
        if session.is_independent() && is_new {
            chosen.push(session.clone());
        }
    }
    chosen
}

/// The points held out when the set was identified.
pub fn held_out_points(
    identification: &Verification,
    verify: &VerifySource,
    is_active_of_same_points: bool,
) -> HeldOutPoints {
    if identification.n_points == 0 {
        HeldOutPoints::None
    } else if matches!(verify, VerifySource::Set(_)) {
        HeldOutPoints::VerifySet
    } else {
        HeldOutPoints::VerifySubset {
            is_fitted_by_active: is_active_of_same_points,
        }
    }
}

/// A set and the robot's active one.
#[derive(Clone, Copy, Debug)]
pub struct Compared<'a> {
    /// The request of the job that identified the set.
    pub request: &'a CalibrationRequest,
    /// The set.
    pub content: &'a ParameterSetContent,
    /// The active set.
    pub active: &'a ParameterSetContent,
}

/// Compares the two sets on the points of an upload. `points` describes them.
pub fn compare_on_set(compared: Compared<'_>, points: String, set: &MeasurementSet) -> Comparison {
    let errors_mm = |content: &ParameterSetContent| {
        calibration::errors_mm(compared.request, set, &content.identified_robot(None))
            .map_err(|error| error.to_string())
    };
    let both = || {
        let errors_mm = errors_mm(compared.active)?
            .into_iter()
            .zip(errors_mm(compared.content)?);
        Ok(robust_rms(
            errors_mm.map(|(active, own)| [active, own, own]),
        ))
    };
    Comparison {
        points,
        rms: both(),
    }
}

/// Compares the two sets on the verify subset of the set's own upload. `verified_mm` has the errors of the fit that did not use these
/// points, as pairs: with links alone, and with corrections. It is `None` if the active set was identified from these points too; then both
/// sets are scored as delivered.
pub fn compare_on_verify_subset(
    compared: Compared<'_>,
    points: String,
    verified_mm: Option<Vec<[f64; 2]>>,
) -> Comparison {
    let errors_mm = |content: &ParameterSetContent| {
        let robot = content.identified_robot(None);
        calibration::errors_on_verify_subset_mm(compared.request, &robot)
            .map_err(|error| error.to_string())
    };
    let both = || {
        let active_mm = errors_mm(compared.active)?;
        let own_mm = match verified_mm {
            Some(verified_mm) => verified_mm,
            None => errors_mm(compared.content)?
                .into_iter()
                .map(|e| [e, e])
                .collect(),
        };
        let pairs = active_mm.into_iter().zip(own_mm);
        Ok(robust_rms(pairs.map(|(active, [links, corrected])| {
            [active, links, corrected]
        })))
    };
    Comparison {
        points,
        rms: both(),
    }
}

/// Robust rms from the errors of each point, as triples: of the active set, of the set's links alone, and of the set with corrections.
fn robust_rms(errors_mm: impl Iterator<Item = [f64; 3]>) -> ComparedRms {
    let errors_mm: Vec<[f64; 3]> = errors_mm.collect();
    let comparison = robust_comparison(&errors_mm);
    let (set_mm, active_mm) = (comparison.after_rms_mm, comparison.before_rms_mm);
    let largest_mm = MAX_ERROR_PER_RMS * set_mm.max(active_mm);
    let mut differences: Vec<f64> = errors_mm
        .iter()
        .map(|[active, links, corrected]| (*active, links.max(*corrected)))
        .filter(|(active, own)| active.max(*own) <= largest_mm)
        .map(|(active, own)| own * own - active * active)
        .collect();
    if differences.len() < MIN_POINTS_FOR_SCATTER {
        differences.clear();
    }
    ComparedRms {
        set_mm,
        active_mm,
        std_mm: standard_error(&differences) / (set_mm + active_mm).max(f64::MIN_POSITIVE),
    }
}

/// Standard error of the mean; 0 for fewer than two values.
fn standard_error(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    if values.len() < 2 {
        return 0.0;
    }
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (n - 1.0) / n).sqrt()
}
