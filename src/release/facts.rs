//! Derives verification facts from a job's report.

use crate::calibration::quick_check::CHECK_CHANGED;
use crate::calibration::report::{BASE_NOT_CHECKED, MIN_TO_PROVE};
use crate::calibration::request::VerifySource;
use crate::calibration::{
    CalibrationReport, CalibrationRequest, DOES_NOT_FIT, HeldOut, MISSES_SESSION,
    POSITIONS_COMPUTED, RobustComparison, SESSIONS_DIFFER, SET_FAR_OFF, WORSE_THAN_IDENTIFIED,
    after_errors_mm, n_placed, n_placed_where, robust_comparison, session_fit,
};
use crate::measurement::{Frame, MeasurementSet};
use crate::release::guard_band::{ConfigurationErrors, expanded_mm};
use crate::release::verdict::{INSISTED, TOO_MANY_OUTLIERS, WRONG_ROBOT, has_warning};
use crate::wire::measurement::Subset;
use crate::wire::report_shape::{Evidence, PointReport, Report};
use crate::wire::verification::{Fit, Verification, VerificationKind};
use crate::wire::warning::Warning;
use std::collections::{BTreeMap, BTreeSet};

/// Minimum number of points of a verification; fewer are no evidence.
pub const MIN_VERIFY_POINTS: usize = 5;

/// Fit of an identification whose set is unusable. Later sessions are not compared with such a set.
pub const UNUSABLE_FIT: Fit = Fit::SetFarOff;

/// Code of a job that failed because its fit diverged.
pub const FIT_DIVERGED: &str = "fit_diverged";

/// When a job's points were measured, as far as the robot's other uploads show it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeasurementAge {
    /// Number of the last session that did not fit, in the robot's counter; 0 if there is none.
    pub misfit_seq: i64,
    /// Whether the points repeat uploads from before that session ([`crate::calibration::repeats`]), or this could not be decided.
    pub is_repeat: bool,
    /// Number in the audit chain of the upload in which the points appeared first; 0 if it is unknown ([`Verification::measured_seq`]).
    pub measured_seq: i64,
}

/// Strength of a report's verification. Its points are evidence if they show the robot's errors and nobody overrode a refusal of its uploads. They
/// are strong evidence if they also come from another session.
pub fn evidence_of(
    core: &CalibrationReport,
    is_insisted_on: bool,
    is_another_session: bool,
) -> Evidence {
    // Only the nominal robot was scored, so there is no set that could be verified.
    let is_nominal =
        core.identify.n_points == 0 && core.verify.is_some_and(|v| v.after == v.before);
    let is_for_review = core.warnings.iter().any(|w| w.code == TOO_MANY_OUTLIERS);
    let hides_base = core.warnings.iter().any(|w| w.code == BASE_NOT_CHECKED);
    if is_insisted_on || is_for_review || is_nominal || !core.is_evidence() {
        Evidence::None
    } else if is_another_session && !hides_base {
        Evidence::IndependentSession
    } else {
        Evidence::SameUpload
    }
}

/// The points from which an rms error is computed.
#[derive(Clone, Copy, Debug)]
struct ScoredPoints<'a> {
    set: &'a MeasurementSet,
    /// Number of base and target parameters that were fitted to these points.
    n_fitted: usize,
}

impl<'a> ScoredPoints<'a> {
    /// The points on which an identification was verified.
    fn of_identification(request: &'a CalibrationRequest) -> Self {
        match &request.verify {
            VerifySource::Set(set) => Self {
                set,
                n_fitted: n_placed(request, set),
            },
            _ => Self {
                set: &request.set,
                n_fitted: 0,
            },
        }
    }

    /// The points of a job that scores a set. Base and targets are fitted to these points if the points or the set are in the instrument's frame, or
    /// if the points come from several stations.
    fn of_session(request: &'a CalibrationRequest) -> Self {
        let set = &request.set;
        let is_placed_anew =
            set.frame == Frame::Instrument || request.scored_frame == Some(Frame::Instrument);
        Self {
            set,
            n_fitted: n_placed_where(is_placed_anew, set),
        }
    }

    /// Standard deviation that the instrument states for a coordinate of a point, rms, mm; 0 if it states none.
    fn instrument_std_mm(&self) -> f64 {
        let points = &self.set.points;
        let stated = points.iter().filter_map(|p| p.position_std_mm());
        let squares: f64 = stated.map(|std_mm| std_mm * std_mm).sum();
        (squares / points.len().max(1) as f64).sqrt()
    }
}

/// Expanded uncertainty (95 %) of the rms of the set's errors on these points, mm. There are two such rms values: of the links, and of the links with
/// corrections. The result is the larger upper end of their intervals minus the larger rms.
fn after_expanded_mm(report: &Report, measured: ScoredPoints<'_>) -> Option<f64> {
    let points: Vec<&PointReport> = counted(&report.per_point, Subset::Verify).collect();
    let errors_mm = errors_mm(&report.per_point, Subset::Verify);
    let numbers = measured.set.distinct_configurations();
    let std_mm = measured.instrument_std_mm();
    let mut largest = (0.0_f64, 0.0_f64);
    for of in [1, 2] {
        let alone: Vec<[f64; 3]> = errors_mm
            .iter()
            .map(|errors| [errors[0], errors[of], errors[of]])
            .collect();
        let mut found: BTreeMap<usize, ConfigurationErrors> = BTreeMap::new();
        for (point, error_mm) in points.iter().zip(after_errors_mm(&alone)) {
            let Some(error_mm) = error_mm else { continue };
            let own = found.entry(*numbers.get(point.configuration.as_str())?);
            let own = own.or_default();
            own.n_points += 1;
            own.sum_mm2 += error_mm * error_mm;
        }
        let found: Vec<ConfigurationErrors> = found.into_values().collect();
        let rms_mm = robust_comparison(&alone).after_rms_mm;
        let upper_mm = rms_mm + expanded_mm(&found, measured.n_fitted, std_mm)?;
        largest = (largest.0.max(rms_mm), largest.1.max(upper_mm));
    }
    Some(largest.1 - largest.0)
}

/// Facts of a job that identified a set, from its report. If the separate verify set does not fit the robot, its points are no evidence,
/// and the job counts as one without held-out points.
pub fn identification_facts(
    request: &CalibrationRequest,
    report: &Report,
    is_verified_anew: bool,
    age: MeasurementAge,
) -> Verification {
    let is_misfit = has_warning(report, DOES_NOT_FIT);
    let is_measured = !has_warning(report, POSITIONS_COMPUTED);
    let n_points = report.verify.filter(|_| !is_misfit && is_measured);
    let n_points = n_points.map_or(0, |verify| verify.n_points);
    let comparison = match n_points {
        0 => comparison_on(report, Subset::Identify),
        _ => comparison_on(report, Subset::Verify),
    };
    let is_far_off = has_warning(report, SET_FAR_OFF)
        || WRONG_ROBOT.iter().any(|code| has_warning(report, code));
    Verification {
        kind: VerificationKind::Identification,
        n_points,
        before_rms_mm: Some(comparison.before_rms_mm),
        after_rms_mm: Some(comparison.after_rms_mm),
        after_expanded_mm: (n_points > 0)
            .then(|| after_expanded_mm(report, ScoredPoints::of_identification(request)))
            .flatten(),
        is_better: n_points > 0 && comparison.is_better(),
        fit: if is_misfit {
            Fit::DoesNotFit
        } else if is_far_off {
            Fit::SetFarOff
        } else {
            Fit::Fits
        },
        evidence: match n_points {
            ..MIN_VERIFY_POINTS => Evidence::None,
            _ if n_verified_configurations(request, report) < MIN_TO_PROVE => Evidence::None,
            _ if report.evidence == Evidence::None => Evidence::None,
            _ if is_far_off || has_warning(report, INSISTED) => Evidence::None,
            _ if is_verified_anew
                && !has_warning(report, BASE_NOT_CHECKED)
                && !has_warning(report, MISSES_SESSION) =>
            {
                Evidence::IndependentSession
            }
            _ => Evidence::SameUpload,
        },
        is_repeat: age.is_repeat,
        measured_seq: age.measured_seq,
        is_worse: false,
        misfit_seq: age.misfit_seq,
        uncertainty_mm: report.tool_uncertainty_mm.map(|tool| tool.max),
    }
}

/// Facts of a job that failed with this code because its points do not fit one robot. Older sets are not released until they are scored on these
/// points. `None` for a code that is not about the robot.
pub fn failure_facts(code: &str, misfit_seq: i64) -> Option<Verification> {
    [SESSIONS_DIFFER, FIT_DIVERGED]
        .contains(&code)
        .then_some(Verification {
            kind: VerificationKind::Identification,
            n_points: 0,
            before_rms_mm: None,
            after_rms_mm: None,
            after_expanded_mm: None,
            is_better: false,
            fit: UNUSABLE_FIT,
            evidence: Evidence::None,
            is_repeat: false,
            measured_seq: 0,
            is_worse: false,
            misfit_seq,
            uncertainty_mm: None,
        })
}

/// Different configurations among the points to verify.
fn n_verified_configurations(request: &CalibrationRequest, report: &Report) -> usize {
    let numbers = ScoredPoints::of_identification(request).set;
    let numbers = numbers.distinct_configurations();
    let points = report.per_point.iter();
    let points = points.filter(|point| point.subset == Subset::Verify);
    let of_points: BTreeSet<_> = points
        .filter_map(|point| numbers.get(point.configuration.as_str()))
        .collect();
    of_points.len()
}

/// The warning that the separate verify set does not fit the robot, for reports of older versions, which lack it. They also lack the
/// scatter of the points, which counts as 0.
pub fn missing_misfit_warning(request: &CalibrationRequest, report: &Report) -> Option<Warning> {
    if !matches!(request.verify, VerifySource::Set(_)) {
        return None;
    }
    let points = report.per_point.iter();
    let points = points.filter(|point| point.subset == Subset::Verify);
    let errors_mm: Vec<[f64; 3]> = points
        .map(|p| {
            [
                p.before_mm,
                p.after_mm,
                p.corrected_mm.unwrap_or(p.after_mm),
            ]
        })
        .collect();
    let fitted = HeldOut {
        nominal_rms_mm: report.identify.before.rms_mm,
        identified_rms_mm: report.identify.after.rms_mm,
    };
    let code = match session_fit(&errors_mm, Some(&fitted), &request.robot, || 0.0) {
        Fit::Fits => return None,
        Fit::SetFarOff => SET_FAR_OFF,
        Fit::DoesNotFit => DOES_NOT_FIT,
    };
    Some(Warning {
        code: code.into(),
        detail: String::new(),
        rows: Vec::new(),
        points: Vec::new(),
    })
}

/// Facts of a job of kind `verify` or `check`, from its report.
pub fn session_facts(
    request: &CalibrationRequest,
    report: &Report,
    age: MeasurementAge,
) -> Verification {
    let comparison = comparison_on(report, Subset::Verify);
    let fit = if has_warning(report, DOES_NOT_FIT) {
        Fit::DoesNotFit
    } else if has_warning(report, SET_FAR_OFF) {
        Fit::SetFarOff
    } else if has_warning(report, CHECK_CHANGED) {
        // The check found a change. However small, it counts as `SetFarOff`, because the set is no longer valid.
        Fit::SetFarOff
    } else {
        Fit::Fits
    };
    let is_small = request.set.n_distinct_configurations() < MIN_TO_PROVE;
    // Without the errors at the identification it cannot be decided whether the session fits.
    // A check can be evidence against a set. Its few poses are no evidence for a release.
    let counts = request.held_out.is_some()
        && report.check.is_none()
        && !is_small
        && fit != Fit::DoesNotFit
        && !has_warning(report, INSISTED)
        && !has_warning(report, TOO_MANY_OUTLIERS);
    let evidence = match counts {
        true => report.evidence,
        false => Evidence::None,
    };
    Verification {
        kind: VerificationKind::Session,
        n_points: report.verify.map_or(0, |verify| verify.n_points),
        before_rms_mm: Some(comparison.before_rms_mm),
        after_rms_mm: Some(comparison.after_rms_mm),
        after_expanded_mm: after_expanded_mm(report, ScoredPoints::of_session(request)),
        is_better: comparison.is_better(),
        fit,
        evidence,
        is_repeat: age.is_repeat,
        measured_seq: age.measured_seq,
        is_worse: [WORSE_THAN_IDENTIFIED, MISSES_SESSION]
            .iter()
            .any(|code| has_warning(report, code)),
        misfit_seq: age.misfit_seq,
        uncertainty_mm: None,
    }
}

/// The facts as they are stored when the job ends. `misfit_seq` is the robot's last session that did not fit at that time. If that session came
/// after the job began, the points count as a repeat, because they were not compared with the uploads from before that session.
pub fn facts_at_end(found: &Verification, misfit_seq: i64) -> Verification {
    Verification {
        is_repeat: found.is_repeat || found.misfit_seq != misfit_seq,
        ..found.clone()
    }
}

/// Errors of each verify point that is no outlier, mm: of the nominal robot, of the links, and with corrections (of the links if none is used).
pub fn verify_errors_mm(per_point: &[PointReport]) -> Vec<[f64; 3]> {
    errors_mm(per_point, Subset::Verify)
}

fn counted(per_point: &[PointReport], subset: Subset) -> impl Iterator<Item = &PointReport> {
    let counts = move |point: &&PointReport| point.subset == subset && !point.outlier;
    per_point.iter().filter(counts)
}

fn errors_mm(per_point: &[PointReport], subset: Subset) -> Vec<[f64; 3]> {
    counted(per_point, subset)
        .map(|p| {
            let corrected_mm = p.corrected_mm.unwrap_or(p.after_mm);
            [p.before_mm, p.after_mm, corrected_mm]
        })
        .collect()
}

/// Robust comparison of the errors before and after on these points, without the points that are outliers both before and after.
fn comparison_on(report: &Report, subset: Subset) -> RobustComparison {
    robust_comparison(&errors_mm(&report.per_point, subset))
}
