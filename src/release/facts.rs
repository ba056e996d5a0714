//! The facts that gates look at, and those of them that are told by one job.

use crate::calibration::{
    CalibrationRequest, DOES_NOT_FIT, Judged, SET_FAR_OFF, judged, repeated_rows,
};
use crate::kinematics::Robot;
use crate::measurement::MeasurementSet;
use crate::wire::measurement::Subset;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::policy::PolicyBody;
use crate::wire::report_shape::{Evidence, Report, WRONG_ROBOT};
use crate::wire::verification::{Fit, Verification};
use std::collections::BTreeSet;

/// Fewer points than this prove nothing.
pub const MIN_VERIFY_POINTS: usize = 5;
/// The warning of a report whose points were kept because the uploader insisted: they support nothing.
pub const INSISTED: &str = "insisted_upload";
/// Warning of more outliers than a robust loss may weigh down: somebody has to look at the file.
const TOO_MANY_OUTLIERS: &str = "outliers_review";
/// Fewer configurations than this in a session prove nothing, however often each was read.
const MIN_CONFIGURATIONS: usize = 5;
/// A session that repeats more than this share of its rows from uploads before the last one that did not fit is one of those.
const MAX_REPEATED: f64 = 0.1;

/// Whether points were measured since the robot's last session that did not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Since {
    /// The number of that session; 0 for none.
    pub check_seq: i64,
    /// [`repeats`] of what came before it, or it could not be told.
    pub is_repeat: bool,
}

/// A job that identified the set, or scored it on a session; sessions are in the order of the robot's counter.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// The job.
    pub job_id: String,
    /// Its place in the robot's counter.
    pub seq: i64,
    /// What it found.
    pub found: Verification,
}

impl Session {
    /// Whether it supports a release: another session, measured anew, that fits and in which the set is better than nominal.
    pub fn supports(&self) -> bool {
        self.found.is_session
            && self.found.evidence == Evidence::IndependentSession
            && self.found.fit == Fit::Fits
            && self.found.is_better
    }

    /// Whether it supports the set, and was measured after that number of the robot's counter.
    pub fn supports_since(&self, seq: i64) -> bool {
        self.seq > seq && self.supports() && !self.found.is_repeat
    }
}

/// The set and the robot's active one on the same points.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Which points, in words.
    pub points: String,
    /// rms of both, mm: of the set, of the active one; or why that cannot be told.
    pub rms_mm: Result<(f64, f64), String>,
}

/// All that the gates look at.
#[derive(Clone, Debug)]
pub struct Facts<'a> {
    /// The robot's nominal model.
    pub robot: &'a Robot,
    /// The session that does not fit the robot, if it is in the state `check_robot`.
    pub check_job_id: Option<&'a str>,
    /// The last session that did not fit the robot, also when that is over: its number and its job.
    pub last_check: Option<(i64, &'a str)>,
    /// What was found up to this number was looked at by whoever said last that the robot is well.
    pub checked_seq: i64,
    /// The report of the job that identified the set: whose nominal model it is of.
    pub report: &'a Report,
    /// What that job found.
    pub identification: &'a Verification,
    /// Its place in the robot's counter.
    pub identification_seq: i64,
    /// The set's id.
    pub parameter_set_id: &'a str,
    /// The set.
    pub content: &'a ParameterSetContent,
    /// The active set, if there is one.
    pub active: Option<&'a ParameterSetContent>,
    /// Every session that it was scored on since.
    pub sessions: &'a [Session],
    /// Against the active set.
    pub comparisons: &'a [Comparison],
    /// It was taken back for good.
    pub is_withdrawn: bool,
    /// It was released before, and is to come back in the place of what is active, which is withdrawn.
    pub is_rollback: bool,
    /// Serial number of the robot.
    pub serial_number: Option<&'a str>,
    /// Serial number that the uploader stated.
    pub stated_serial_number: Option<&'a str>,
    /// Keys that uploaded the points and the sweeps.
    pub uploaders: &'a [Option<String>],
    /// The key that releases.
    pub approver: &'a str,
    /// Why it changed so much.
    pub change_reason: Option<&'a str>,
    /// What the robot asks.
    pub policy: &'a PolicyBody,
}

impl Facts<'_> {
    /// How strong the verification is.
    pub fn evidence(&self) -> Evidence {
        let is_independent = |session: &Session| {
            session.found.fit == Fit::Fits && session.found.evidence == Evidence::IndependentSession
        };
        if self.sessions.iter().any(is_independent) {
            Evidence::IndependentSession
        } else {
            self.identification.evidence
        }
    }

    /// The sessions that say something of the set, for or against it.
    pub fn telling(&self) -> impl Iterator<Item = &Session> {
        self.sessions
            .iter()
            .filter(|session| session.found.fit != Fit::DoesNotFit)
    }
}

/// What a job says that identified a set, by its report. A set to verify on that does not fit the robot says nothing of the parameter set: then
/// it is as if nothing was held out.
pub fn of_identification(report: &Report, is_verified_anew: bool, since: Since) -> Verification {
    let is_misfit = has_warning(report, DOES_NOT_FIT);
    let n_points = report.verify.filter(|_| !is_misfit);
    let n_points = n_points.map_or(0, |verify| verify.n_points);
    let judged = match n_points {
        0 => judged_on_fitted(report),
        _ => report.judged(),
    };
    let is_far_off = has_warning(report, SET_FAR_OFF)
        || WRONG_ROBOT.iter().any(|code| has_warning(report, code));
    Verification {
        is_session: false,
        n_points,
        before_rms_mm: Some(judged.before_rms_mm),
        after_rms_mm: Some(judged.after_rms_mm),
        is_better: n_points > 0 && judged.is_better(),
        fit: if is_misfit {
            Fit::DoesNotFit
        } else if is_far_off {
            Fit::SetFarOff
        } else {
            Fit::Fits
        },
        evidence: match n_points {
            ..MIN_VERIFY_POINTS => Evidence::None,
            _ if report.evidence == Evidence::None => Evidence::None,
            _ if is_far_off || has_warning(report, INSISTED) => Evidence::None,
            _ if is_verified_anew => Evidence::IndependentSession,
            _ => Evidence::SameUpload,
        },
        is_repeat: since.is_repeat,
        check_seq: since.check_seq,
        uncertainty_mm: report.tool_uncertainty_mm.map(|tool| tool.max),
    }
}

/// What a job of kind `verify` says, by its report.
pub fn of_session(request: &CalibrationRequest, report: &Report, since: Since) -> Verification {
    let judged = report.judged();
    let fit = if has_warning(report, DOES_NOT_FIT) {
        Fit::DoesNotFit
    } else if has_warning(report, SET_FAR_OFF) {
        Fit::SetFarOff
    } else {
        Fit::Fits
    };
    let is_small = request.set.configurations().len() < MIN_CONFIGURATIONS
        || has_warning(report, "few_verify_points");
    // Without what was found at the identification nobody can tell whether the session fits.
    let counts = request.held_out.is_some()
        && !is_small
        && fit != Fit::DoesNotFit
        && !has_warning(report, INSISTED)
        && !has_warning(report, TOO_MANY_OUTLIERS);
    Verification {
        is_session: true,
        n_points: report.verify.map_or(0, |verify| verify.n_points),
        before_rms_mm: Some(judged.before_rms_mm),
        after_rms_mm: Some(judged.after_rms_mm),
        is_better: judged.is_better(),
        fit,
        evidence: if counts {
            report.evidence
        } else {
            Evidence::None
        },
        is_repeat: since.is_repeat,
        check_seq: since.check_seq,
        uncertainty_mm: None,
    }
}

/// Whether a session repeats rows of earlier uploads, where nothing shows that they were measured anew.
pub fn repeats(robot: &Robot, earlier: &[MeasurementSet], session: &MeasurementSet) -> bool {
    let repeated: BTreeSet<usize> = earlier
        .iter()
        .flat_map(|earlier| repeated_rows(robot, earlier, session))
        .collect();
    repeated.len() as f64 > MAX_REPEATED * session.points.len() as f64
}

fn judged_on_fitted(report: &Report) -> Judged {
    let fitted = report
        .per_point
        .iter()
        .filter(|p| p.subset == Subset::Identify);
    let errors_mm: Vec<[f64; 3]> = fitted
        .map(|p| {
            let corrected_mm = p.corrected_mm.unwrap_or(p.after_mm);
            [p.before_mm, p.after_mm, corrected_mm]
        })
        .collect();
    judged(&errors_mm)
}

fn has_warning(report: &Report, code: &str) -> bool {
    report.warnings.iter().any(|warning| warning.code == code)
}
