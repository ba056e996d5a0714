//! Request body of a job. The status and the answer of a job are in [`crate::wire::job_answer`].

use crate::calibration::corrections_are_wanted;
use crate::calibration::request::{self, CalibrationRequest, PreviousSession, VerifySource};
pub use crate::calibration::request::{After, CorrectionsChoice, FinalFit, Method, Model, Preset};
use crate::identification::TrainedNetwork;
use crate::kinematics::{ResidualNetwork, Robot};
use crate::measurement::MeasurementSet;
use crate::measurement::sessions::joined;
use crate::wire::corrections::PayloadBody;
use crate::wire::id;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::measurement::Frame;
use crate::wire::names;
use crate::wire::options::OptionsBody;
pub use crate::wire::parameters::{ParametersBody, Rest};
use crate::wire::prior;
pub use crate::wire::prior::{MAX_NAMES, MAX_PARAMETER_NAME, Prior};
use crate::wire::sessions;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Highest priority of a job. The lowest priority is `-MAX_PRIORITY`.
pub const MAX_PRIORITY: i64 = 10;

names! {
    /// Kind of a job.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
    #[serde(rename_all = "snake_case")]
    pub enum Kind {
        /// Identifies parameters.
        #[default]
        Identify = "identify",
        /// Scores a parameter set on all points. No parameters are identified.
        Verify = "verify",
        /// Checks with a few configurations (five to ten, or more) whether the released parameter set is still valid. No parameters are identified.
        Check = "check",
    }
}

impl Kind {
    /// True if a job of this kind scores a parameter set and does not identify parameters.
    pub fn scores(self) -> bool {
        self != Self::Identify
    }
}

/// A calibration to run. The only required field is `measurement_set_id`, or `measurement_set_ids` for several sessions.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobRequestBody {
    /// The measurement set of a single session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_set_id: Option<String>,
    /// Instead of `measurement_set_id`: the measurement sets of several sessions of one robot. Each session has its own base, targets and noise. The
    /// sessions are compared first. They are fitted together only if the robot did not change between them; otherwise the job fails with
    /// `sessions_differ`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_set_ids: Option<Vec<String>>,
    /// Kind of job.
    #[serde(default)]
    pub kind: Kind,
    /// `kind: verify`: the parameter set to score; default: the active set, or the nominal robot if there is none. `kind: check`: the parameter set
    /// to check; default: the active set. `kind: identify`: the parameter set whose session the new session is compared with; default: the robot's
    /// last parameter set from another upload.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter_set_id: Option<String>,
    /// Method of identification.
    #[serde(default)]
    pub method: Method,
    /// Kinematic model. Default: `complete`; but `paper` with `frames_id`, and for a set in the base frame with preset `paper`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<Model>,
    /// The preset, which sets the default values of options.
    #[serde(default)]
    pub preset: Preset,
    /// Choice of free parameters; default: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameters: Option<ParametersBody>,
    /// Base and tool frame that were computed from sweeps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_id: Option<String>,
    /// The network for method `bpnn_pso`. Method `auto` uses it if least squares from the nominal parameters fails. Default: the newest network with
    /// the same model, preset and parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network_id: Option<String>,
    /// The residual network from which training continues, if the job searches for corrections. Default: the robot's newest residual network that was
    /// not trained on these points. The network is chosen when the job is posted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_network_id: Option<String>,
    /// Seed of all random numbers of the job.
    #[serde(default)]
    pub seed: u64,
    /// Whether Levenberg-Marquardt refines the result of the swarm. Default: true; false in preset `paper`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refine: Option<bool>,
    /// Source of the points that are held out for verification.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verify: Option<VerifyBody>,
    /// The points to which the delivered parameters are fitted after the verification. Default: `all`; but `identify_subset` in preset `paper` and
    /// with `refine: false`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub final_fit: Option<FinalFit>,
    /// Priority, -10 to 10. Jobs with a higher priority run first. A priority above 0 requires a key with the scope `admin`.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schema(minimum = -10, maximum = 10)]
    pub priority: i64,
    /// Corrections in addition to link parameters. Default: `auto`; `off` in preset `paper`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrections: Option<CorrectionsChoice>,
    /// Payload on the flange while the set was measured. If it is given, the corrections are also valid for other payloads.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<PayloadBody>,
    /// Search options.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub options: Option<OptionsBody>,
    /// `kind: check`: what happened to the robot before the check. Parameters that this event may have changed are suspected first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<After>,
}

/// Source of the points that are held out for verification.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "source", rename_all = "snake_case", deny_unknown_fields)]
pub enum VerifyBody {
    /// The set's `subset` column.
    Subset,
    /// A random share of the configurations, chosen with the seed.
    Fraction {
        /// The share, between 0 and 1.
        fraction: f64,
    },
    /// Another measurement set of the same robot.
    Set {
        /// Id of that set.
        measurement_set_id: String,
    },
}

/// The parsed documents that a job refers to.
#[derive(Clone, Debug)]
pub struct JobParts {
    /// The robot.
    pub robot: Robot,
    /// The measurement sets, in the order of the request: one for each session.
    pub sets: Vec<MeasurementSet>,
    /// The set of `verify: {source: "set"}`.
    pub verify_set: Option<MeasurementSet>,
    /// The frames of `frames_id`.
    pub frames: Option<crate::frames::PreliminaryFrames>,
    /// The network that was chosen when the job was posted.
    pub network: Option<TrainedNetwork>,
    /// The residual network that was chosen when the job was posted. Training continues from this network.
    pub residual_network: Option<ResidualNetwork>,
    /// The session of the robot's last identification, to compare with.
    pub previous: Option<PreviousSession>,
}

impl JobRequestBody {
    /// A request for one measurement set, with defaults for all other fields.
    pub fn for_set(measurement_set_id: &str) -> Self {
        Self {
            measurement_set_id: Some(measurement_set_id.into()),
            ..Self::default()
        }
    }

    /// A request for several sessions, with defaults for all other fields.
    pub fn for_sets(measurement_set_ids: Vec<String>) -> Self {
        Self {
            measurement_set_ids: Some(measurement_set_ids),
            ..Self::default()
        }
    }

    /// The measurement sets that are fitted or scored, in order.
    pub fn set_ids(&self) -> Vec<&str> {
        let several = self.measurement_set_ids.iter().flatten();
        let all = self.measurement_set_id.iter().chain(several);
        all.map(String::as_str).collect()
    }

    /// JSON pointer to the measurement set with this index.
    pub fn set_pointer(&self, place: usize) -> String {
        match self.measurement_set_ids {
            Some(_) => format!("/measurement_set_ids/{place}"),
            None => "/measurement_set_id".into(),
        }
    }

    /// Makes all checks that need only the request.
    ///
    /// # Errors
    /// [`Invalid`]: `invalid_job` for values that are out of range and for fields that the job would ignore, `unknown_reference` for texts that
    /// cannot be ids.
    pub fn check(&self) -> Result<(), Invalid> {
        sessions::check(
            self.measurement_set_id.as_ref(),
            self.measurement_set_ids.as_deref(),
        )?;
        self.check_of_one_session()?;
        self.check_ids()?;
        let mut checker = Checker::default();
        self.options.unwrap_or_default().check(&mut checker);
        if let Some(VerifyBody::Fraction { fraction }) = self.verify
            && !(fraction > 0.0 && fraction < 1.0)
        {
            checker.add(
                "/verify/fraction",
                "out_of_range",
                format!("{fraction} is not between 0 and 1, e.g. 0.5"),
            );
        }
        if let Some(parameters) = &self.parameters {
            parameters.check(&mut checker);
        }
        if let Some(payload) = &self.payload {
            payload.check("/payload", &mut checker);
        }
        let priorities = -MAX_PRIORITY..=MAX_PRIORITY;
        checker.within("/priority", self.priority, priorities, "a priority");
        if self.holds_parameter_set() && self.parameter_set_id.is_none() {
            let detail =
                "the rest is held at the values of a parameter set: name it in parameter_set_id";
            checker.add("/parameters/rest", "parameter_set_missing", detail);
        }
        checker.finish("invalid_job")?;
        self.check_applicable()
    }

    /// For a job with several sessions: refuses fields that are only possible with one session.
    fn check_of_one_session(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        let cases = [
            (
                self.kind.scores(),
                "/measurement_set_ids",
                "only kind \"identify\" takes several sessions: post a job for each set, or leave kind out",
            ),
            (
                self.holds_parameter_set(),
                "/parameters/rest",
                "a partial recalibration takes one session: name it in measurement_set_id, or leave rest out",
            ),
            (
                self.frames_id.is_some(),
                "/frames_id",
                "sweeps give one base, and each session has its own: leave frames_id out",
            ),
            (
                self.model == Some(Model::Paper),
                "/model",
                "model \"paper\" knows one base and one target, and each session has its own: ask for model \"complete\"",
            ),
        ];
        let refused = cases.iter().filter(|(is_asked_for, ..)| *is_asked_for);
        for (_, pointer, detail) in refused.filter(|_| self.measurement_set_ids.is_some()) {
            checker.add(*pointer, "not_applicable", *detail);
        }
        checker.finish("invalid_job")
    }

    fn check_ids(&self) -> Result<(), Invalid> {
        let verify_set = match &self.verify {
            Some(VerifyBody::Set { measurement_set_id }) => Some(measurement_set_id),
            _ => None,
        };
        for (place, id) in self.set_ids().into_iter().enumerate() {
            id::check(&self.set_pointer(place), id, "measurement set")?;
        }
        let named = [
            ("/verify/measurement_set_id", verify_set, "measurement set"),
            (
                "/parameter_set_id",
                self.parameter_set_id.as_ref(),
                "parameter set",
            ),
            ("/frames_id", self.frames_id.as_ref(), "frames"),
            ("/network_id", self.network_id.as_ref(), "network"),
            (
                "/residual_network_id",
                self.residual_network_id.as_ref(),
                "residual network",
            ),
        ];
        named
            .into_iter()
            .try_for_each(|(at, id, what)| id.map_or(Ok(()), |id| id::check(at, id, what)))
    }

    /// Refuses fields that the job would ignore.
    fn check_applicable(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        let mut unused =
            |pointer: &str, detail: &str| checker.add(pointer, "not_applicable", detail);
        if self.network_id.is_some() && !matches!(self.method, Method::BpnnPso | Method::Auto) {
            unused(
                "/network_id",
                "only methods \"bpnn_pso\" and \"auto\" start from a network: ask for one of them, or leave network_id out",
            );
        }
        if self.frames_id.is_some() && self.model == Some(Model::Complete) {
            unused(
                "/frames_id",
                "model \"complete\" identifies base and targets itself: leave frames_id out, or ask for model \"paper\"",
            );
        }
        if self.kind.scores() {
            let kind = self.kind.as_str();
            let given = [
                (
                    self.verify.is_some(),
                    "/verify",
                    "scores all points of measurement_set_id: leave verify out",
                ),
                (
                    self.parameters.is_some(),
                    "/parameters",
                    "identifies nothing: leave parameters out",
                ),
                (
                    self.payload.is_some(),
                    "/payload",
                    "scores the robot with what it carried when it was identified: leave payload out",
                ),
                (
                    self.network_id.is_some(),
                    "/network_id",
                    "identifies nothing: leave network_id out",
                ),
            ];
            for (_, pointer, detail) in given.iter().filter(|(is_given, ..)| *is_given) {
                unused(pointer, &format!("kind \"{kind}\" {detail}"));
            }
        }
        if self.after.is_some() && self.kind != Kind::Check {
            unused(
                "/after",
                "only kind \"check\" takes after: set kind \"check\", or leave after out",
            );
        }
        if self.residual_network_id.is_some() && !self.may_train_residual_network() {
            unused(
                "/residual_network_id",
                "this job looks for no corrections, and so trains no residual network: leave it out",
            );
        }
        if matches!(&self.verify, Some(VerifyBody::Set { measurement_set_id }) if self.set_ids().contains(&measurement_set_id.as_str()))
        {
            let detail = "a set cannot verify what was identified from it: name another set, or leave verify out to keep a part of this one";
            checker.add("/verify/measurement_set_id", "same_set", detail);
        }
        checker.finish("invalid_job")
    }

    /// True if the job searches for corrections. The last of these corrections is the residual network.
    pub fn may_train_residual_network(&self) -> bool {
        let has_priors = self
            .parameters
            .as_ref()
            .is_some_and(|p| p.priors.as_ref().is_some_and(|priors| !priors.is_empty()));
        let are_wanted = corrections_are_wanted(self.corrections, self.preset);
        self.kind == Kind::Identify && are_wanted && !has_priors && !self.holds_parameter_set()
    }

    /// True for a partial recalibration: all parameters that are not identified keep the values of a parameter set.
    pub fn holds_parameter_set(&self) -> bool {
        self.kind == Kind::Identify
            && self
                .parameters
                .as_ref()
                .is_some_and(|p| p.rest == Some(Rest::ParameterSet))
    }

    /// The model that is identified from a set in this frame: the requested model, or the default.
    pub fn model_for(&self, frame: Frame) -> Model {
        self.model
            .unwrap_or_else(|| request::default_model(self.preset, frame, self.frames_id.is_some()))
    }

    /// Converts this body, and the documents that it refers to, to a request of the core.
    ///
    /// # Errors
    /// As [`JobRequestBody::check`], and for priors that do not fit the robot and the model.
    pub fn calibration_request(&self, parts: JobParts) -> Result<CalibrationRequest, Invalid> {
        self.check()?;
        let priors = self
            .parameters
            .iter()
            .flat_map(|parameters| parameters.priors.iter().flatten());
        let (set, sessions) = match <[MeasurementSet; 1]>::try_from(parts.sets) {
            Ok([set]) => (set, vec![]),
            Err(sessions) => (joined(&sessions), sessions),
        };
        let request = CalibrationRequest {
            sessions,
            method: self.method,
            model: self.model,
            preset: self.preset,
            parameters: self.parameters.clone().unwrap_or_default().into(),
            priors: priors.map(Into::into).collect(),
            frames: parts.frames,
            network: parts.network,
            seed: self.seed,
            refine: self.refine,
            verify: match (&self.verify, parts.verify_set) {
                (Some(VerifyBody::Set { .. }), Some(set)) => VerifySource::Set(set),
                (Some(VerifyBody::Fraction { fraction }), _) => VerifySource::Fraction(*fraction),
                (Some(VerifyBody::Subset), _) => VerifySource::Subset,
                _ => VerifySource::Default,
            },
            options: self.options.unwrap_or_default().into(),
            final_fit: self.final_fit,
            corrections: self.corrections,
            payload: self.payload.map(Into::into),
            residual_network: parts.residual_network,
            previous: parts.previous,
            ..CalibrationRequest::new(parts.robot, set)
        };
        prior::check_applicable(&request)?;
        Ok(request)
    }
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde hands a reference")]
fn is_zero(value: &i64) -> bool {
    *value == 0
}
