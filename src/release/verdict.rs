//! Whether the result of a report can be used, and why its verification is no evidence.

use crate::calibration::quick_check::{CHECK_CANNOT_TELL, CHECK_CHANGED};
use crate::calibration::report::{BASE_NOT_CHECKED, SHOWS_LITTLE};
use crate::calibration::upload_checks::alignment::SUSPICIONS;
use crate::calibration::{
    CalibrationReport, DOES_NOT_FIT, JOINT_MAP, MODEL_TOO_SMALL, NO_BETTER, NO_FIT,
    POSITIONS_COMPUTED, SET_FAR_OFF,
};
use crate::wire::report_shape::Report;
use crate::wire::warning::Warning;

/// Warnings that the identified robot is wrong. Such a set must not correct targets and cannot be released.
pub const WRONG_ROBOT: [&str; 3] = [MODEL_TOO_SMALL, NO_FIT, JOINT_MAP];

/// Warnings with which a result cannot be used. If a report has several, the first in this order counts.
pub const UNUSABLE_WARNINGS: [&str; 7] = {
    let [model_too_small, no_fit, joint_map] = WRONG_ROBOT;
    [
        model_too_small,
        no_fit,
        joint_map,
        POSITIONS_COMPUTED,
        DOES_NOT_FIT,
        SET_FAR_OFF,
        NO_BETTER,
    ]
};

/// Warning of so many outliers that a person has to check the file first.
pub const TOO_MANY_OUTLIERS: &str = "outliers_review";

/// Text for the warning [`POSITIONS_COMPUTED`].
pub const NOTHING_MEASURED: &str =
    "the positions look computed by the controller, and nothing was measured";

/// Warning of a report whose upload was accepted with `insist`. Such a report is no evidence.
pub const INSISTED: &str = "insisted_upload";

/// Beginning of the text of [`INSISTED`]; the code of the refusal follows.
const REFUSED_AS: &str = "the points were refused as ";

/// The warning [`INSISTED`]; `code` is that of the suspicion that the uploader overrode.
pub fn insisted_warning(code: &str) -> Warning {
    Warning {
        code: INSISTED.into(),
        detail: format!(
            "{REFUSED_AS}{code} and kept because the uploader insisted: no release rests on them"
        ),
        rows: Vec::new(),
        points: Vec::new(),
    }
}

/// Whether a report has this warning.
pub fn has_warning(report: &Report, code: &str) -> bool {
    report.warnings.iter().any(|warning| warning.code == code)
}

/// Code of the warning because of which the result cannot be used, if there is one.
pub fn unusable_because(report: &Report) -> Option<&'static str> {
    UNUSABLE_WARNINGS
        .into_iter()
        .find(|code| has_warning(report, code))
}

/// Code of the suspicion that the uploader overrode, if the report's upload was insisted on. A report has this code only at the beginning of the
/// text of its warning ([`REFUSED_AS`]).
pub fn insisted_code(report: &Report) -> Option<&'static str> {
    let mut warnings = report.warnings.iter();
    let insisted = warnings.find(|warning| warning.code == INSISTED)?;
    let refused = insisted.detail.strip_prefix(REFUSED_AS)?.split(' ').next();
    SUSPICIONS.into_iter().find(|code| Some(*code) == refused)
}

/// As [`unusable_because`], for the headline of a report. An upload that was insisted on gives the code [`INSISTED`], unless a warning explains the
/// result better. This also applies if the points fit, because the result is no evidence.
pub fn headline(report: &Report) -> Option<&'static str> {
    let (code, refused) = (unusable_because(report), insisted_code(report));
    let is_explained = code.is_none_or(|code| [JOINT_MAP, NO_FIT].contains(&code));
    match refused {
        // The refusal `poor_alignment` names no cause, so a warning that does is preferred.
        Some("poor_alignment") if code.is_some() => code,
        Some(refused) if is_explained && Some(refused) != code => Some(INSISTED),
        _ => code,
    }
}

/// Whether a result can be used: it fits, and is better than nominal. Only then are its estimate and its networks stored.
pub fn is_usable(core: &CalibrationReport) -> bool {
    let mut warnings = core.warnings.iter();
    warnings.all(|warning| !UNUSABLE_WARNINGS.contains(&warning.code))
}

/// Reason why the verification counts as evidence of the same upload only.
pub fn why_same_upload(report: &Report) -> &'static str {
    if report.identify.n_points == 0 {
        "these poses repeat those that the set was identified from, and nothing in their noise shows that they were measured anew: measure other poses"
    } else if has_warning(report, BASE_NOT_CHECKED) {
        "the base was fitted again to the scored upload, so a wrong base would not show"
    } else if report.pooled.is_some() {
        "checked on points that were not fitted but measured in the same sessions; a wrong tool, base or scale would not show"
    } else {
        "checked on points that were not fitted but measured in the same session; a wrong tool, base or scale would not show"
    }
}

/// Reason why the verification is no evidence.
pub fn why_no_evidence(report: &Report) -> &'static str {
    if has_warning(report, POSITIONS_COMPUTED) {
        NOTHING_MEASURED
    } else if report.verify.is_none_or(|verify| verify.n_points == 0) {
        "no point was held out: these are the errors of the fitted points"
    } else if has_warning(report, DOES_NOT_FIT) {
        "this file does not fit this robot"
    } else if report.identify.n_points == 0 && report.parameter_set_from.is_none() {
        "only the nominal robot was scored: no parameter set was named, and none is released"
    } else if has_warning(report, CHECK_CHANGED) {
        "the robot, its base or its tool has changed since"
    } else if has_warning(report, CHECK_CANNOT_TELL) {
        "these poses cannot tell whether the set still holds"
    } else if report.check.is_some() {
        "a quick check can be evidence against a set, never for a release"
    } else if has_warning(report, NO_FIT) {
        "the identified robot does not fit the points"
    } else if has_warning(report, TOO_MANY_OUTLIERS) {
        "so many points are outliers that somebody has to look at the file first"
    } else if has_warning(report, INSISTED) {
        "these points were refused, and kept because the uploader insisted"
    } else if has_warning(report, SHOWS_LITTLE) {
        "the poses show too little of the robot"
    } else if has_warning(report, BASE_NOT_CHECKED) {
        "a wrong base would not show in these points"
    } else {
        "there are too few configurations"
    }
}
