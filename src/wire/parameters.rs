//! Selection of the parameters that a job identifies, and their priors.

use crate::calibration::request::ParameterChoice;
use crate::wire::issue::Checker;
use crate::wire::prior::{self, MAX_NAMES, MAX_PARAMETER_NAME, Prior};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Which of the model's parameters are free: all except those in `hold`, or only those in `identify`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ParametersBody {
    /// Names of the parameters to hold at their nominal values, e.g. `a_1`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold: Option<Vec<String>>,
    /// Names of the only parameters to identify, e.g. `theta_offset_3`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identify: Option<Vec<String>>,
    /// With `identify`: the values of all other parameters; default: nominal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest: Option<Rest>,
    /// Priors of free parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priors: Option<Vec<Prior>>,
}

/// Values of the parameters that are not identified.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rest {
    /// Their nominal values.
    Nominal,
    /// The values of `parameter_set_id`, with their uncertainty. This is a partial recalibration, for example after a collision.
    ParameterSet,
}

impl ParametersBody {
    /// Makes all checks that need only the body and not the robot.
    pub(super) fn check(&self, checker: &mut Checker) {
        if self.hold.is_some() && self.identify.is_some() {
            checker.add(
                "/parameters",
                "hold_and_identify",
                "give either hold or identify, not both",
            );
        }
        if self.rest == Some(Rest::ParameterSet) && self.identify.is_none() {
            checker.add(
                "/parameters/rest",
                "identify_missing",
                "name what is identified anew in identify; the rest is held",
            );
        }
        for (at, names) in [("hold", &self.hold), ("identify", &self.identify)] {
            let names = names.as_deref().unwrap_or_default();
            let pointer = format!("/parameters/{at}");
            checker.count(pointer, names.len(), 0..=MAX_NAMES, "names");
            for (i, name) in names.iter().take(MAX_NAMES).enumerate() {
                checker.text(&format!("/parameters/{at}/{i}"), name, MAX_PARAMETER_NAME);
            }
        }
        prior::check(self.priors.as_deref().unwrap_or_default(), checker);
    }
}

impl From<ParametersBody> for ParameterChoice {
    fn from(body: ParametersBody) -> Self {
        match (body.hold, body.identify) {
            (Some(hold), _) => Self::Hold(hold),
            (None, Some(identify)) => Self::Identify(identify),
            (None, None) => Self::All,
        }
    }
}
