//! Priors of parameters in a job.

use crate::calibration::prior_faults;
use crate::calibration::request::{CalibrationRequest, ParameterPrior};
use crate::wire::issue::{Checker, Invalid};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of names in `hold`, `identify` or `priors`. No model has as many parameters.
pub const MAX_NAMES: usize = 500;
/// Maximum length of a parameter name, characters.
pub const MAX_PARAMETER_NAME: usize = 64;
/// Largest standard deviation and largest absolute value, mm or degrees.
pub(super) const MAX_VALUE: f64 = 1e6;
/// Smallest standard deviation, mm or degrees. For lengths this is a nanometre. A parameter that is known better should be held.
pub(super) const MIN_STD: f64 = 1e-6;

/// Prior of a free parameter: expected value `mean` ± `std`, and bounds `min` and `max`. All values are in the unit of the report
/// (`parameters[].unit`: mm or deg).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// The parameter: `a_1`, `theta_offset_3`, `target_0_z`, …. All names in the report's `parameters` are allowed, except the rotation of the base.
    pub name: String,
    /// Standard deviation; above 0.
    pub std: f64,
    /// Expected value; default: `nominal` in the report. For base and targets this is their first estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean: Option<f64>,
    /// Smallest value allowed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Largest value allowed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

impl From<&Prior> for ParameterPrior {
    fn from(prior: &Prior) -> Self {
        let Prior {
            name,
            std,
            mean,
            min,
            max,
        } = prior.clone();
        Self {
            name,
            std,
            mean,
            min,
            max,
        }
    }
}

/// Makes the checks of each prior that do not need the robot and the model.
pub fn check(priors: &[Prior], checker: &mut Checker) {
    checker.count("/parameters/priors", priors.len(), 0..=MAX_NAMES, "priors");
    for (i, prior) in priors.iter().take(MAX_NAMES).enumerate() {
        let at = |field: &str| format!("/parameters/priors/{i}/{field}");
        checker.text(&at("name"), &prior.name, MAX_PARAMETER_NAME);
        let hint = "a standard deviation is above 0; hold the parameter to keep it exactly";
        checker.within(at("std"), prior.std, MIN_STD..=MAX_VALUE, hint);
        for (field, value) in [("mean", prior.mean), ("min", prior.min), ("max", prior.max)] {
            checker.magnitude(at(field), value.unwrap_or(0.0), MAX_VALUE, "mm or degrees");
        }
        if let (Some(min), Some(max)) = (prior.min, prior.max)
            && min > max
        {
            checker.add(
                at("min"),
                "out_of_range",
                format!("min {min} is above max {max}"),
            );
        }
    }
}

/// Refuses priors that do not fit the request's robot and model.
pub fn check_applicable(request: &CalibrationRequest) -> Result<(), Invalid> {
    let faults = prior_faults(request);
    let Some(code) = faults.first().map(|fault| fault.code) else {
        return Ok(());
    };
    let mut checker = Checker::default();
    for fault in &faults {
        checker.add(
            format!("/parameters/priors/{}/{}", fault.index, fault.field),
            fault.code,
            fault.detail.clone(),
        );
    }
    checker.finish(if faults.iter().all(|fault| fault.code == code) {
        code
    } else {
        "invalid_job"
    })
}
