//! Sessions on which a set was scored after its identification.

use crate::calibration::ROBOT_CHANGED;
use crate::wire::report_shape::Evidence;
use crate::wire::report_summary::ReportSummary;
use crate::wire::verification::{Fit, Verification, VerificationKind};

/// A job that scored the set on another session. Lists are in the order of the robot's counter.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// The job.
    pub job_id: String,
    /// Its upload.
    pub measurement_set_id: String,
    /// Its number in the robot's counter.
    pub seq: i64,
    /// Whether the set's base was fitted anew to the session, so that an error of the base would not show.
    pub is_base_hidden: bool,
    /// Number in the audit chain of the upload in which its points appeared first.
    pub measured_seq: i64,
    /// Whether its points are older than the last event after which the robot may have changed ([`PointsSeq::is_outdated`]). It then does not show
    /// the robot as it is now.
    pub is_outdated: bool,
    /// Whether the session is evidence against the set. It is none if it has few points, or if its upload was refused and insisted on. A
    /// session that hides the base can be evidence against the set, but cannot support it.
    pub is_evidence: bool,
    /// Its verification facts.
    pub verification: Verification,
}

/// A session that was measured after the points of this set, and on which this set was not scored.
#[derive(Clone, Debug, PartialEq)]
pub struct UnscoredSession {
    /// The job that identified or scored another set.
    pub job_id: String,
    /// The session's upload.
    pub measurement_set_id: String,
    /// Whether that job found that the robot has changed, or that the points do not fit it.
    pub has_changed: bool,
}

/// Numbers of uploads in the audit chain. A higher number is a newer upload.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PointsSeq {
    /// Upload of the points that the set was identified from.
    pub own: i64,
    /// Upload of the points that the active set was identified from; 0 if there is no other active set.
    pub active: i64,
    /// Upload of the last session that did not fit the robot; 0 if there is none, or if somebody has explained it.
    pub last_misfit: i64,
}

impl PointsSeq {
    /// Sessions with a lower number are outdated; 0 if none is. If the set's points are newer than those of the active set, or than a session
    /// that did not fit the robot, older sessions are outdated: an old file, uploaded late, agrees with the robot as it was before.
    fn oldest_current(self) -> i64 {
        let changes = [self.active, self.last_misfit].into_iter();
        changes.filter(|seq| self.own > *seq).max().unwrap_or(0)
    }

    /// Whether a session of this age does not show the robot as it is now.
    pub fn is_outdated(self, measured_seq: i64) -> bool {
        measured_seq < self.oldest_current()
    }
}

/// Whether a job found that the robot has changed.
pub fn has_changed(report: &ReportSummary) -> bool {
    report
        .warnings
        .iter()
        .any(|warning| warning.code == ROBOT_CHANGED)
}

/// Whether a session shows that robot and set are in order. Its points must be measured anew and fit the robot, and the set must be better
/// than nominal on them and not several times worse than at its identification.
pub fn supports(session: &Verification) -> bool {
    session.kind == VerificationKind::Session
        && session.evidence == Evidence::IndependentSession
        && session.fit == Fit::Fits
        && session.is_better
        && !session.is_worse
}

/// Whether a session is evidence for or against a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionVerdict {
    /// It is independent evidence for the set.
    Supports,
    /// It is evidence against the set.
    SpeaksAgainst,
}

impl Session {
    /// Whether the session is evidence for or against the set; `None` if it is neither. With a tolerance, errors that are larger than at the
    /// identification may still be small enough.
    pub fn verdict(&self, has_tolerance: bool) -> Option<SessionVerdict> {
        let found = &self.verification;
        let is_as_good = found.is_better && (has_tolerance || !found.is_worse);
        match found.fit {
            Fit::DoesNotFit => None,
            Fit::SetFarOff => Some(SessionVerdict::SpeaksAgainst),
            Fit::Fits if is_as_good => self.is_independent().then_some(SessionVerdict::Supports),
            Fit::Fits => self.is_evidence.then_some(SessionVerdict::SpeaksAgainst),
        }
    }

    /// Whether the session is independent evidence for the robot as it is now.
    pub fn is_independent(&self) -> bool {
        self.verification.evidence == Evidence::IndependentSession && !self.is_outdated
    }

    /// Whether the session supports the set, comes after this number of the robot's counter, and repeats no earlier upload.
    pub fn supports_since(&self, seq: i64) -> bool {
        self.seq > seq && supports(&self.verification) && !self.verification.is_repeat
    }
}
