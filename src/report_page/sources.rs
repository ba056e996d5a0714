//! Inputs of the page.

use crate::release::Session;
use crate::wire::instrument::InstrumentBody;
use crate::wire::job_answer::JobAnswer;
use crate::wire::measurement::{Frame, SetSummary};
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::policy::DecisionRule;
use crate::wire::report_shape::{Convergence, Report};
use crate::wire::robot::RobotBody;
use crate::wire::session_record::SessionRecord;

/// The measurement set.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredSet<'a> {
    /// Its name.
    pub name: Option<&'a str>,
    /// The frame of all positions.
    pub frame: Frame,
    /// Number of points.
    pub n_points: usize,
    /// Number of distinct arm configurations.
    pub n_configurations: usize,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: &'a str,
    /// The noise of the instrument, if it was stated.
    pub instrument: Option<InstrumentBody>,
    /// When, by whom and with what it was measured.
    pub record: Option<&'a SessionRecord>,
}

impl<'a> From<&'a SetSummary> for MeasuredSet<'a> {
    fn from(set: &'a SetSummary) -> Self {
        Self {
            name: set.name.as_deref(),
            frame: set.frame,
            n_points: set.n_points,
            n_configurations: set.n_configurations,
            sha256: &set.sha256,
            instrument: set.instrument,
            record: set.record.as_ref(),
        }
    }
}

/// A session that was scored with the identified parameter set.
#[derive(Clone, Debug)]
pub struct ScoredSession {
    /// Stated time of measurement, or the time of upload: RFC 3339.
    pub measured_at: String,
    /// The job that scored it, and the result.
    pub session: Session,
}

/// Inputs of the page.
#[derive(Clone, Copy, Debug)]
pub struct Sources<'a> {
    /// The robot.
    pub robot: &'a RobotBody,
    /// The measurement set of the job.
    pub set: MeasuredSet<'a>,
    /// Measurement sets of further sessions that were fitted together with it.
    pub further_sets: &'a [MeasuredSet<'a>],
    /// The job; none if the page is made without a server.
    pub job: Option<&'a JobAnswer>,
    /// The identified parameter set in its current state; none without a server, or if no parameters were identified.
    pub parameter_set: Option<&'a ParameterSetAnswer>,
    /// Sessions that were scored with this set, newest first.
    pub sessions: &'a [ScoredSession],
    /// Expanded uncertainty (95 %) of the error on the points to verify, as the release compares it, mm: stored when the job ended. None if it cannot be
    /// computed, if an older version ended the job, or without a server.
    pub verified_expanded_mm: Option<f64>,
    /// Tolerance in the robot's policy, mm; none without a server, or if the policy has no tolerance.
    pub tolerance_mm: Option<f64>,
    /// The rule by which an error is compared with the tolerance.
    pub decision_rule: DecisionRule,
    /// The report.
    pub report: &'a Report,
    /// The convergence curve.
    pub convergence: &'a Convergence,
}

impl<'a> Sources<'a> {
    /// All measurement sets of the job, in the order of its rows.
    pub(super) fn sets(&self) -> impl Iterator<Item = &MeasuredSet<'a>> {
        std::iter::once(&self.set).chain(self.further_sets)
    }

    /// True if the job only scored a parameter set.
    pub(super) fn is_verification(&self) -> bool {
        self.job.is_some_and(|job| job.kind.scores())
    }

    /// Name of the robot that the errors before refer to: a partial recalibration starts from an earlier parameter set.
    pub(super) fn before(&self) -> &'static str {
        match self
            .job
            .is_some_and(|job| job.request.holds_parameter_set())
        {
            true => "the held parameter set",
            false => "the nominal robot",
        }
    }

    /// The parameters that a verification scored.
    pub(super) fn verified(&self) -> String {
        match &self.report.parameter_set_from {
            Some(id) => format!("parameter set {id}"),
            None => "the nominal robot".into(),
        }
    }

    /// Serial number and id of the robot, if there are any.
    pub(super) fn which_robot(&self) -> Option<String> {
        let serial_number = self
            .robot
            .serial_number
            .as_ref()
            .map(|number| format!("serial number {number}"));
        let known: Vec<String> = serial_number
            .into_iter()
            .chain(self.job.map(|job| format!("robot {}", job.robot_id)))
            .collect();
        (!known.is_empty()).then(|| known.join(" · "))
    }

    /// Title of the page.
    pub(super) fn title(&self) -> String {
        let what = if self.is_verification() {
            "Verification"
        } else {
            "Calibration"
        };
        format!("{what} of {}", self.robot.name)
    }
}
