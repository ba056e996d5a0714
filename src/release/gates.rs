//! The gates that a parameter set must pass before it may move a robot.

use crate::calibration::{INSTRUMENT_SCALE, POSITIONS_COMPUTED, TOOL_UNCERTAIN};
use crate::release::comparison::SAME_MM;
use crate::release::facts::MIN_VERIFY_POINTS;
use crate::release::gate_facts::{ArchivedItem, Facts, StoredFacts};
use crate::release::robot_gates::{change, identity, orientation};
use crate::release::session_gates::{
    better_than_nominal, check_robot, measured_since_check, scored_on_later_sessions, sessions_fit,
};
use crate::release::sessions::{Session, supports};
use crate::release::texts::{errors_in_words, sessions};
use crate::release::tolerance_gates::{errors_within_tolerance, uncertainty};
use crate::release::verdict::{NOTHING_MEASURED, TOO_MANY_OUTLIERS, insisted_warning};
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::release::Gate;
use crate::wire::report_shape::{Evidence, SubsetReport};
use crate::wire::verification::Fit;
use std::collections::BTreeMap;

/// The robot counts as changed if the active set's error on new points is more than this many times the candidate's.
const CHANGED_ERROR_RATIO: f64 = 3.0;

/// Largest ratio of two lengths: the mean movement of the tool by the final fit, and the rms error of the verified fit (corrections
/// included). The 64 simulated uploads of 25 and 60 poses in `docs/oracles/final_fit.py` have ratios from 0.31 to 1.58. A larger ratio
/// shows that the two halves of the upload do not belong together.
const MAX_MOVED_PER_ERROR: f64 = 2.0;

/// Largest ratio of the error of the instrument's scale at the arm's reach to the rms error on the verify points.
const MAX_SCALE_PER_ERROR: f64 = 3.0;

/// Every gate, passed or not.
pub fn gates(facts: &Facts<'_>) -> Vec<Gate> {
    let stored = &facts.stored;
    let unusable = [withdrawn(facts), joint_map(stored), archived(facts)];
    let mut gates: Vec<Gate> = unusable.into_iter().flatten().collect();
    gates.extend([
        verified(stored),
        errors_improved(stored),
        final_fit(stored),
        all_finite(facts.content),
        not_insisted(stored),
        fits(stored),
        check_robot(stored),
        measured_since_check(stored),
        sessions_fit(stored),
        scored_on_later_sessions(facts),
        better_than_nominal(stored),
        better_than_active(facts),
        evidence(stored),
        uncertainty(stored),
        errors_within_tolerance(stored),
        identity(facts),
        change(facts),
        orientation(facts),
        second_person(facts),
    ]);
    gates.extend(source_withdrawn(facts));
    gates.extend(instrument_scale(stored));
    gates
}

/// The first gate that refuses the set, among those that columns decide. The other gates read points, reports and parameters, which takes
/// too long for a list. Never names a gate that a release would pass.
pub fn first_refusal(stored: &StoredFacts<'_>) -> Option<Gate> {
    let by_columns: [fn(&StoredFacts<'_>) -> Gate; 11] = [
        not_insisted,
        fits,
        check_robot,
        verified,
        errors_improved,
        uncertainty,
        errors_within_tolerance,
        sessions_fit,
        better_than_nominal,
        measured_since_check,
        evidence,
    ];
    let gates = by_columns.iter().map(|gate| gate(stored));
    let mut gates = joint_map(stored).into_iter().chain(gates);
    gates.find(|gate| !gate.passed)
}

fn withdrawn(facts: &Facts<'_>) -> Option<Gate> {
    let detail = "the set was withdrawn, which is final: identify again, or release another set";
    facts
        .is_withdrawn
        .then(|| Gate::new("withdrawn", false, detail))
}

fn joint_map(facts: &StoredFacts<'_>) -> Option<Gate> {
    let detail = "the set was identified with a joint map that the robot no longer has: identify anew from its upload";
    facts
        .has_other_joint_map
        .then(|| Gate::new("joint_map_changed", false, detail))
}

/// Refuses an archived set, and a set of an archived robot. For a rollback the robot may be archived, because the cell needs a known set.
fn archived(facts: &Facts<'_>) -> Option<Gate> {
    let detail = match facts.archived? {
        ArchivedItem::ParameterSet => "the set is archived: restore it first",
        ArchivedItem::Robot if facts.is_rollback => return None,
        ArchivedItem::Robot => "the robot is archived: restore it first",
    };
    Some(Gate::new("archived", false, detail))
}

fn source_withdrawn(facts: &Facts<'_>) -> Option<Gate> {
    let withdrawn = facts.withdrawn_source?;
    let id = &withdrawn.id;
    let detail = format!(
        "the set holds or repeats values of {id}, which was withdrawn: a session on which that set was not scored must show that this set is right"
    );
    let is_shown = facts.evidence_without(withdrawn) == Evidence::IndependentSession;
    Some(Gate::new("source_withdrawn", is_shown, detail).with_warning(true))
}

fn verified(facts: &StoredFacts<'_>) -> Gate {
    let n = facts.identification.n_points;
    let passed = facts.evidence() != Evidence::None;
    let detail = match passed {
        true => format!(
            "{n} points were held out to verify, {} scored",
            sessions(facts.sessions.len())
        ),
        false if has_warning(facts, POSITIONS_COMPUTED) => {
            format!("{NOTHING_MEASURED}: upload the positions of the instrument")
        }
        false if has_warning(facts, TOO_MANY_OUTLIERS) => "more than a twentieth of the points are outliers: look at them, take them out of the file and identify again, \
             or score another session"
            .to_owned(),
        false => format!(
            "{n} points were held out to verify, and at least {MIN_VERIFY_POINTS} configurations that fit are needed: hold out more points, or verify the set on another session"
        ),
    };
    Gate::new("verified", passed, detail)
}

/// Whether the identification has this warning.
fn has_warning(facts: &StoredFacts<'_>, code: &str) -> bool {
    let mut warnings = facts.report.warnings.iter();
    warnings.any(|warning| warning.code == code)
}

fn errors_improved(facts: &StoredFacts<'_>) -> Gate {
    let name = "verify_errors_improved";
    if facts.identification.n_points > 0 {
        let detail = format!(
            "rms on the verify points: {}{}",
            errors_in_words(facts.identification),
            with_and_without_outliers(facts)
        );
        return Gate::new(name, facts.identification.is_better, detail);
    }
    match facts
        .sessions
        .iter()
        .any(|session| supports(&session.verification))
    {
        true => Gate::new(name, true, "see the sessions"),
        false => Gate::new(name, false, "there are no verify points"),
    }
}

/// Errors of the verify points with and without outliers, if a warning names outliers.
fn with_and_without_outliers(facts: &StoredFacts<'_>) -> String {
    let (Some(all), Some(without)) = (facts.report.verify, facts.report.verify_without_outliers)
    else {
        return String::new();
    };
    format!(
        "; all {} points: {:.4} mm before, {:.4} mm after; without the {} that a warning names as outliers: {:.4} mm before, {:.4} mm after",
        all.n_points,
        all.before.rms_mm,
        delivered_rms_mm(&all),
        all.n_points - without.n_points,
        without.before.rms_mm,
        delivered_rms_mm(&without)
    )
}

/// Error of the delivered parameters: with corrections, if any was kept.
fn delivered_rms_mm(subset: &SubsetReport) -> f64 {
    subset.corrected.unwrap_or(subset.after).rms_mm
}

/// The verified errors are those of the fit to the identify subset. They apply to the delivered parameters only if both place the tool nearly
/// equally.
fn final_fit(facts: &StoredFacts<'_>) -> Gate {
    let name = "final_fit_near_verified";
    let Some(last) = facts.report.final_fit else {
        // Without a final fit, only the uncertainty shows whether the points determine the position of the tool.
        let is_open = facts.report.tool_uncertainty_absent_because.is_some();
        let mut warnings = facts.report.warnings.iter();
        return match warnings.find(|warning| is_open && warning.code == TOOL_UNCERTAIN) {
            Some(warning) => Gate::new(name, false, &*warning.detail),
            None => Gate::new(
                name,
                true,
                "the parameters that were verified are delivered",
            ),
        };
    };
    let verified = facts.report.verify_without_outliers.or(facts.report.verify);
    let Some(verified_mm) = verified
        .filter(|v| v.n_points > 0)
        .map(|v| delivered_rms_mm(&v))
    else {
        return Gate::new(name, true, "no points were held out");
    };
    let (moved_mm, n) = (last.moved_mm, last.n_points);
    let detail = format!(
        "the final fit to all {n} points moves the tool by {moved_mm:.4} mm on average over the workspace; the error of the verified fit is \
         {verified_mm:.4} mm rms"
    );
    match moved_mm <= MAX_MOVED_PER_ERROR * verified_mm + SAME_MM {
        true => Gate::new(name, true, detail),
        false => Gate::new(
            name,
            false,
            format!(
                "{detail}: the points do not determine the tool's position elsewhere. Measure poses spread over the workspace, with the wrist turned as well"
            ),
        ),
    }
}

fn all_finite(content: &ParameterSetContent) -> Gate {
    let links = content
        .links
        .iter()
        .flat_map(|l| [l.a_mm, l.alpha_deg, l.d_mm, l.theta_offset_deg, l.beta_deg]);
    let base = content.t_instrument_base;
    let frame = base
        .rotation
        .into_iter()
        .flatten()
        .chain(base.translation_mm);
    let finite = links
        .chain(frame)
        .chain(content.targets.iter().flat_map(|t| t.position_mm))
        .all(f64::is_finite);
    Gate::new("all_finite", finite, "every number must be finite")
}

/// Refuses a set that depends on an upload that was accepted with `insist`. The schema's triggers enforce this too.
fn not_insisted(facts: &StoredFacts<'_>) -> Gate {
    let name = "upload_not_insisted";
    match facts.insisted_on {
        None => Gate::new(name, true, "none of its uploads was insisted on"),
        Some(code) => {
            let refused = insisted_warning(code).detail;
            Gate::new(
                name,
                false,
                format!("{refused}: measure again, or mend the file"),
            )
        }
    }
}

/// Refuses a set that does not fit its points. A comparison with the nominal robot is not enough: on points that fit no robot, the
/// identified robot is better than nominal half of the time, by chance.
fn fits(facts: &StoredFacts<'_>) -> Gate {
    match facts.identification.fit {
        Fit::Fits => Gate::new("fits", true, "the identified robot fits the points"),
        Fit::DoesNotFit => Gate::new(
            "fits",
            true,
            "the file to verify on does not fit the robot, so it is no evidence about the set",
        )
        .with_warning(true),
        Fit::SetFarOff => Gate::new(
            "fits",
            false,
            "the identified robot does not fit the points of its job, or fits them for a wrong reason: see the warnings of its report",
        ),
    }
}

/// Refuses a set if the reference shows a scale error of the instrument far above the verified errors. Points measured with the same
/// instrument cannot show this error.
fn instrument_scale(facts: &StoredFacts<'_>) -> Option<Gate> {
    let reference = facts.report.reference.as_ref()?;
    let name = "instrument_scale";
    let mut warnings = facts.report.warnings.iter();
    let Some(warning) = warnings.find(|warning| warning.code == INSTRUMENT_SCALE) else {
        return Some(Gate::new(
            name,
            true,
            "the reference shows no error of the instrument's scale",
        ));
    };
    let found_mm = facts.identification.after_rms_mm.unwrap_or(0.0);
    let passes = reference.at_reach_std_mm <= MAX_SCALE_PER_ERROR * found_mm;
    Some(Gate::new(name, passes, warning.detail.clone()).with_warning(passes))
}

fn better_than_active(facts: &Facts<'_>) -> Gate {
    let name = "improved_on_active";
    if facts.active.is_none() {
        return Gate::new(name, true, "the robot has no other active set");
    }
    if facts.is_rollback {
        return Gate::new(name, true, "not compared: the set was active before").with_warning(true);
    }
    let mut details = Vec::new();
    let (mut passed, mut changed) = (!facts.comparisons.is_empty(), false);
    for comparison in facts.comparisons {
        match &comparison.rms {
            Ok(rms) => {
                let (own, active) = (rms.set_mm, rms.active_mm);
                passed &= rms.is_as_good();
                changed |= active > CHANGED_ERROR_RATIO * own + SAME_MM;
                let equal = match own > active && rms.is_as_good() {
                    true => {
                        ", which is as good within the scatter of these points and a micrometre"
                    }
                    false => "",
                };
                details.push(format!(
                    "{}: {own:.4} mm rms, the active set {active:.4} mm{equal}",
                    comparison.points
                ));
            }
            Err(why) => {
                passed = false;
                details.push(format!(
                    "{}: cannot be compared with the active set: {why}",
                    comparison.points
                ));
            }
        }
    }
    if changed {
        details.push("the active set is far off on these points: the robot, its tool or its base changed, or it is another robot".into());
    }
    if details.is_empty() {
        details.push("without verify points it cannot be compared with the active set".into());
    }
    Gate::new(name, passed, details.join("; ")).with_warning(changed)
}

fn evidence(facts: &StoredFacts<'_>) -> Gate {
    let evidence = facts.evidence();
    let limits = limits_of_sessions(facts);
    let detail = match evidence {
        Evidence::IndependentSession => {
            "independent_session: another session, measured anew, was scored"
        }
        Evidence::SameUpload => {
            "same_upload: only points of the same upload were held out; a wrong base, tool or scale would not show. Measure another session, and verify the set on it"
        }
        Evidence::None => "none: no held-out points count as evidence",
    };
    let passed =
        !facts.policy.independent_session_required || evidence == Evidence::IndependentSession;
    let is_doubtful = evidence != Evidence::IndependentSession || !limits.is_empty();
    Gate::new("evidence", passed, format!("{detail}{limits}")).with_warning(is_doubtful)
}

/// Reasons why sessions that fit are only weak evidence, or none.
fn limits_of_sessions(facts: &StoredFacts<'_>) -> String {
    let mut limits = String::new();
    let fits = |session: &&Session| session.verification.fit == Fit::Fits;
    let mut fitting = facts.sessions.iter().filter(fits);
    if let Some(session) = fitting.clone().find(|session| session.is_base_hidden) {
        limits += &format!(
            ". The base was not checked by the session of job {}: the set was identified from positions in the base frame, and in the instrument's \
             frame the base is placed anew. Measure a session in the base frame",
            session.job_id
        );
    }
    if let Some(session) = fitting.clone().find(|session| session.is_outdated) {
        limits += &format!(
            ". The session of job {} is older than the points of the active set or than a session that did not fit the robot, so it does not show the \
             robot as it is now: measure a session now, and score the set on it",
            session.job_id
        );
    }
    let is_repeat = |session: &&Session| session.verification.evidence == Evidence::SameUpload;
    if let Some(session) = fitting.clone().find(is_repeat) {
        limits += &format!(
            ". The session of job {} repeats the poses that the set was identified from, and nothing in its noise shows that they were measured anew: \
             measure other poses",
            session.job_id
        );
    }
    let misses =
        |session: &&Session| session.verification.is_worse && facts.error_ratio(session).is_none();
    if let Some(session) = fitting.clone().find(misses) {
        limits += &format!(
            ". On the session of job {} the set's errors are several times those of a robot fitted to that session alone ({}). Unless the policy's \
             tolerance allows it, that session is no evidence: identify again, with all parameters",
            session.job_id,
            errors_in_words(&session.verification)
        );
    }
    let worse = fitting.find_map(|session| Some((session, facts.error_ratio(session)?)));
    if let Some((session, times)) = worse {
        let by_tolerance = match facts.policy.tolerance_mm {
            Some(_) => "the tolerance decides whether that is good enough",
            None => {
                "the robot's policy has no tolerance that says whether that is good enough, so this session is no evidence for the set: identify anew, or state a tolerance in the policy of releases"
            }
        };
        limits += &format!(
            ". In the session of job {} the errors are {times:.1} times those of the points held out when the set was identified ({}; then {}): {by_tolerance}",
            session.job_id,
            errors_in_words(&session.verification),
            errors_in_words(facts.identification)
        );
    }
    limits
}

fn second_person(facts: &Facts<'_>) -> Gate {
    let approver = facts.approver;
    let is_known = !facts.uploaders.is_empty() && facts.uploaders.iter().all(Option::is_some);
    let uploaders: BTreeMap<&str, &str> = facts
        .uploaders
        .iter()
        .flatten()
        .map(|holder| (holder.id.as_str(), holder.name.as_str()))
        .collect();
    let other = is_known && !uploaders.contains_key(approver.id.as_str());
    let passed = other || !facts.stored.policy.second_person_required;
    // Adds the id if two keys have the same name.
    let named = |id: &str, name: &str| match other && name == approver.name {
        true => format!("{name} ({id})"),
        false => name.to_owned(),
    };
    let by: Vec<String> = uploaders.iter().map(|(id, name)| named(id, name)).collect();
    let by = by.join(" and ");
    let releases = &approver.name;
    let mut detail = match is_known {
        true => format!("uploaded by {by}, released by {releases}"),
        false => "who uploaded it is not known".into(),
    };
    if !passed {
        detail += match is_known {
            true => {
                ": somebody else has to release it, with a key of scope `release` that uploaded nothing of it"
            }
            false => ": upload its file again, identify from it, and have somebody else release",
        };
    }
    Gate::new("second_person", passed, detail)
}
