//! The facts that the gates read.

use crate::calibration::error_ratio;
use crate::kinematics::Robot;
use crate::release::comparison::Comparison;
use crate::release::sessions::{Session, UnscoredSession};
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::policy::PolicyBody;
use crate::wire::report_shape::Evidence;
use crate::wire::report_summary::ReportSummary;
use crate::wire::verification::{Fit, Verification};

/// A robot's last session that did not fit it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LastMisfit {
    /// Its number in the robot's counter.
    pub seq: i64,
    /// Its job.
    pub job_id: String,
}

/// A withdrawn parameter set that another set is based on: the other set holds its values or is equivalent to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WithdrawnSource {
    /// Its id.
    pub id: String,
    /// The uploads on which it was scored. They did not show that it had to be withdrawn, so they are no evidence for the other set.
    pub scored_sets: Vec<String>,
    /// Their ages, as numbers in the audit chain.
    pub scored_seq: Vec<i64>,
}

/// The holder of a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyHolder {
    /// Id of the key.
    pub id: String,
    /// Its name, which need not be unique.
    pub name: String,
}

/// An archived item that a release needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArchivedItem {
    /// The set itself.
    ParameterSet,
    /// Its robot.
    Robot,
}

/// The facts that are stored as columns, so that a list can read them for many robots.
#[derive(Clone, Debug)]
pub struct StoredFacts<'a> {
    /// The robot's nominal model.
    pub robot: &'a Robot,
    /// Job of the session that does not fit the robot, while the robot is in the state `check_robot`.
    pub check_job_id: Option<&'a str>,
    /// The last session that did not fit the robot, even if the state `check_robot` has ended.
    pub last_misfit: Option<&'a LastMisfit>,
    /// Number of the robot's counter at its last `checked` request, whose reason explains all sessions up to then; 0 if there is none.
    pub checked_seq: i64,
    /// Verification facts of the job that identified the set.
    pub identification: &'a Verification,
    /// Number of that job in the robot's counter.
    pub identification_seq: i64,
    /// Every session on which the set was scored after its identification, in order.
    pub sessions: &'a [Session],
    /// Whether the set was identified with a joint map that the robot no longer has.
    pub has_other_joint_map: bool,
    /// Code of the suspicion that was overridden with `insist`, for an upload that the set depends on: one that was fitted or held out, or on which its
    /// held values or its residual network are based.
    pub insisted_on: Option<&'a str>,
    /// The robot's release policy.
    pub policy: &'a PolicyBody,
    /// Summary of the report of the job that identified the set, with the nominal model of that job. It is not a column. A list leaves it
    /// empty; the gates that columns decide use it in their texts only.
    pub report: &'a ReportSummary,
}

/// All inputs of the gates.
#[derive(Clone, Debug)]
pub struct Facts<'a> {
    /// The facts that are stored as columns.
    pub stored: StoredFacts<'a>,
    /// Age of the separate upload that the job verified on, as a number in the audit chain; 0 for none.
    pub verify_set_seq: i64,
    /// The set.
    pub content: &'a ParameterSetContent,
    /// The active set, if there is one.
    pub active: Option<&'a ParameterSetContent>,
    /// A later session on which it was not scored, if there is one.
    pub unscored: Option<&'a UnscoredSession>,
    /// Comparisons with the active set.
    pub comparisons: &'a [Comparison],
    /// The archived item because of which the set cannot be released, if there is one.
    pub archived: Option<ArchivedItem>,
    /// Whether the set was withdrawn.
    pub is_withdrawn: bool,
    /// A withdrawn parameter set whose values this one holds, or that is equivalent to it on the same points.
    pub withdrawn_source: Option<&'a WithdrawnSource>,
    /// Whether this is a rollback: this set was released before, and replaces the active set, which is withdrawn.
    pub is_rollback: bool,
    /// Serial number of the robot.
    pub serial_number: Option<&'a str>,
    /// Serial numbers that the uploaders stated, one for each session of the identification.
    pub stated_serial_numbers: &'a [Option<&'a str>],
    /// Who uploaded the points and the sweeps.
    pub uploaders: &'a [Option<KeyHolder>],
    /// Who releases.
    pub approver: &'a KeyHolder,
    /// Stated reason for a large change.
    pub change_reason: Option<&'a str>,
}

impl Facts<'_> {
    /// Strength of the verification without the uploads on which a withdrawn set was scored, and without copies of these uploads.
    pub fn evidence_without(&self, withdrawn: &WithdrawnSource) -> Evidence {
        let counts = |session: &Session| {
            !withdrawn.scored_seq.contains(&session.measured_seq)
                && !withdrawn.scored_sets.contains(&session.measurement_set_id)
        };
        let verify_set_counts = !withdrawn.scored_seq.contains(&self.verify_set_seq);
        self.stored.evidence_of(counts, verify_set_counts)
    }
}

impl StoredFacts<'_> {
    /// Strength of the verification.
    pub fn evidence(&self) -> Evidence {
        self.evidence_of(|_| true, true)
    }

    /// Strength of the verification by the sessions for which `counts` is true.
    fn evidence_of(&self, counts: impl Fn(&Session) -> bool, verify_set_counts: bool) -> Evidence {
        let is_independent = |session: &Session| {
            session.verification.fit == Fit::Fits
                && session.is_independent()
                && counts(session)
                && (self.policy.tolerance_mm.is_some()
                    || !session.verification.is_worse && self.error_ratio(session).is_none())
        };
        match self.identification.evidence {
            _ if self.sessions.iter().any(is_independent) => Evidence::IndependentSession,
            Evidence::IndependentSession if !verify_set_counts => Evidence::SameUpload,
            evidence => evidence,
        }
    }

    /// Ratio of the set's error on a session to its error on the points held out at the identification; `None` if the increase is
    /// insignificant ([`error_ratio`]). The policy's tolerance decides whether the error is still acceptable. Without a tolerance, such a
    /// session supports nothing.
    pub fn error_ratio(&self, session: &Session) -> Option<f64> {
        let identified_mm = self.identification.after_rms_mm;
        let identified_mm = identified_mm.filter(|_| self.identification.n_points > 0)?;
        let session_mm = session.verification.after_rms_mm?;
        error_ratio(session_mm, identified_mm, &self.robot.links)
    }

    /// The sessions that are evidence for or against the set. A session in which the set is far off counts until two conditions hold:
    /// somebody has given a reason, and the set fits a session measured later, e.g. after a repair. The schema's triggers enforce this too.
    pub fn counted_sessions(&self) -> impl Iterator<Item = &Session> {
        let is_explained = |session: &Session| {
            let mut sessions = self.sessions.iter();
            session.seq <= self.checked_seq
                && sessions.any(|later| later.supports_since(session.seq))
        };
        self.sessions
            .iter()
            .filter(move |session| match session.verification.fit {
                Fit::Fits => true,
                Fit::DoesNotFit => false,
                Fit::SetFarOff => !is_explained(session),
            })
    }
}
