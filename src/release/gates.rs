//! The gates a parameter set passes before it may move a robot.

use crate::calibration::{MAX_FLANGE_ROTATION_STD_RAD, implausible_changes};
use crate::release::facts::{Facts, INSISTED, MIN_VERIFY_POINTS, Session};
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::release::Gate;
use crate::wire::report_shape::Evidence;
use crate::wire::verification::{Fit, Verification};
use std::collections::BTreeSet;

/// Two parameter sets whose errors differ by less are equally good, mm: a tenth of what a laser tracker resolves over an arm's reach.
const SAME_MM: f64 = 0.001;
/// Nominal values in a report may have gone through degrees and back.
const SAME_NOMINAL: f64 = 1e-6;
/// The active set's errors on new points, in units of the candidate's, from which on something must have happened to the robot.
const CHANGED: f64 = 3.0;

/// How somebody says why a robot is well, as HTTP has it.
const CHECKED: &str = "POST /v1/robots/{robot_id}/checked";

/// Every gate, passed or not.
pub fn gates(facts: &Facts<'_>) -> Vec<Gate> {
    let mut gates = vec![
        verified(facts),
        errors_improved(facts),
        all_finite(facts.content),
        not_insisted(facts),
        fits(facts),
        robot_is_well(facts),
        measured_since_check(facts),
        sessions_fit(facts),
        better_than_nominal(facts),
    ];
    gates.extend([
        better_than_active(facts),
        evidence(facts),
        uncertainty(facts),
        errors_within_tolerance(facts),
    ]);
    gates.extend([
        identity(facts),
        change(facts),
        orientation(facts),
        second_person(facts),
    ]);
    if facts.is_withdrawn {
        gates.insert(
            0,
            Gate::new(
                "withdrawn",
                false,
                "the set was withdrawn, which is for good: identify anew, or release another set",
            ),
        );
    }
    gates
}

fn verified(facts: &Facts<'_>) -> Gate {
    let n = facts.identification.n_points;
    let passed = facts.evidence() != Evidence::None;
    let detail = match passed {
        true => format!(
            "{n} points were held out to verify, {} scored",
            sessions(facts.sessions.len())
        ),
        false => format!(
            "{n} points were held out to verify, and at least {MIN_VERIFY_POINTS} configurations that fit are needed: post a job with verify, or of kind verify"
        ),
    };
    Gate::new("verified", passed, detail)
}

fn errors_improved(facts: &Facts<'_>) -> Gate {
    let name = "verify_errors_improved";
    if facts.identification.n_points > 0 {
        let detail = format!("rms on the verify points: {}", both(facts.identification));
        return Gate::new(name, facts.identification.is_better, detail);
    }
    match facts
        .sessions
        .iter()
        .any(|session| supports(&session.found))
    {
        true => Gate::new(name, true, "see the sessions"),
        false => Gate::new(name, false, "without verify points nobody knows"),
    }
}

fn sessions(n: usize) -> String {
    match n {
        1 => "1 session".into(),
        n => format!("{n} sessions"),
    }
}

/// Errors of the nominal robot and of the set, in words.
fn both(found: &Verification) -> String {
    let mm = |rms_mm: Option<f64>| rms_mm.map_or("unknown".into(), |rms| format!("{rms:.4} mm"));
    format!(
        "{} before, {} after",
        mm(found.before_rms_mm),
        mm(found.after_rms_mm)
    )
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
    Gate::new("all_finite", finite, "every number is finite")
}

/// The triggers of the schema keep this too.
fn not_insisted(facts: &Facts<'_>) -> Gate {
    let name = "upload_not_insisted";
    let mut warnings = facts.report.warnings.iter();
    match warnings.find(|warning| warning.code == INSISTED) {
        None => Gate::new(name, true, "no upload that it rests on was insisted on"),
        Some(warning) => Gate::new(
            name,
            false,
            format!("{}: measure again, or mend the file", warning.detail),
        ),
    }
}

/// Where everything is noise, the identified robot is better than the nominal one half of the time.
fn fits(facts: &Facts<'_>) -> Gate {
    match facts.identification.fit {
        Fit::Fits => Gate::new("fits", true, "the identified robot comes near the points"),
        Fit::DoesNotFit => Gate::new(
            "fits",
            true,
            "the file to verify on does not fit the robot, so it says nothing of the set",
        )
        .warned(true),
        Fit::SetFarOff => Gate::new(
            "fits",
            false,
            "the identified robot does not fit the points of its job, or fits them for a wrong reason: its report's warnings say which, and why",
        ),
    }
}

/// Until a session fits, or somebody says why, nobody knows what robot a set would move.
fn robot_is_well(facts: &Facts<'_>) -> Gate {
    let name = "check_robot";
    match facts.check_job_id {
        None => Gate::new(name, true, "no session is in doubt"),
        Some(job_id) => Gate::new(
            name,
            false,
            format!(
                "the file of job {job_id} does not fit this robot: was it in another frame, or has the robot changed? Look at the robot, then measure \
                 a new session and score a set on it: {}, or say why all is well: {CHECKED}",
                verify_it(facts)
            ),
        ),
    }
}

/// Whether a job supports a release: another session, measured anew, that fits and in which the set is better than nominal.
fn supports(found: &Verification) -> bool {
    found.is_session
        && found.evidence == Evidence::IndependentSession
        && found.fit == Fit::Fits
        && found.is_better
}

/// Whether it supports the set, and was measured after that number of the robot's counter.
fn supports_since(session: &Session, seq: i64) -> bool {
    session.seq > seq && supports(&session.found) && !session.found.is_repeat
}

/// A session that did not fit the robot may mean that it changed. A set of before, or one that was identified from points of before, speaks of
/// another robot then: another set that fits the robot since says nothing of this one. The triggers of the schema keep this too.
fn measured_since_check(facts: &Facts<'_>) -> Gate {
    let name = "measured_since_check";
    let Some((seq, job_id)) = facts.last_check else {
        return Gate::new(name, true, "no session did not fit the robot");
    };
    if seq <= facts.checked_seq {
        let detail = "somebody has said why a session did not fit the robot";
        return Gate::new(name, true, detail);
    }
    if facts.check_job_id.is_some() {
        return Gate::new(name, true, "see check_robot");
    }
    if facts.identification_seq > seq && !facts.identification.is_repeat {
        let detail = format!(
            "identified from what was measured since the file of job {job_id} did not fit the robot"
        );
        return Gate::new(name, true, detail);
    }
    let mut sessions = facts.sessions.iter();
    match sessions.find(|session| supports_since(session, seq)) {
        Some(session) => Gate::new(
            name,
            true,
            format!(
                "fits the session of job {}, measured since the file of job {job_id} did not fit the robot",
                session.job_id
            ),
        ),
        None => Gate::new(
            name,
            false,
            format!(
                "the set was identified from points of before the file of job {job_id} did not fit the robot, and no session since shows that it                  still holds: measure one, and score it: {}, or say why the set still holds: {CHECKED}",
                verify_it(facts)
            ),
        ),
    }
}

/// How the set is scored, as HTTP has it.
fn verify_it(facts: &Facts<'_>) -> String {
    format!(
        "post a job of kind verify with parameter_set_id {}",
        facts.parameter_set_id
    )
}

/// A session that the set missed by far speaks against it until somebody says why, whatever came later. One that did not fit the robot at all
/// does so until the set fits a later one.
fn sessions_fit(facts: &Facts<'_>) -> Gate {
    let name = "sessions_fit";
    let is_answered = |session: &Session| match session.found.fit {
        Fit::Fits => true,
        Fit::SetFarOff => false,
        Fit::DoesNotFit => {
            let mut sessions = facts.sessions.iter();
            sessions.any(|later| supports_since(later, session.seq))
        }
    };
    let is_open = |session: &&Session| session.seq > facts.checked_seq && !is_answered(session);
    match facts.sessions.iter().rev().find(is_open) {
        None => Gate::new(name, true, "no session missed the set by far"),
        Some(session) => Gate::new(
            name,
            false,
            format!(
                "in the session of job {} rms on its points: {}; when the set was identified: {}. Identify anew, or say why all is well: {CHECKED}",
                session.job_id,
                both(&session.found),
                both(facts.identification)
            ),
        ),
    }
}

/// Fails closed: an error that cannot be compared is not smaller.
fn better_than_nominal(facts: &Facts<'_>) -> Gate {
    let name = "sessions_better_than_nominal";
    let n = facts.telling().count();
    match facts.telling().find(|session| !session.found.is_better) {
        Some(session) => {
            let detail = format!(
                "job {} scored the set on another session: {}; it is no better than nominal, so it is never released",
                session.job_id,
                both(&session.found)
            );
            Gate::new(name, false, detail)
        }
        None if facts.sessions.is_empty() => {
            Gate::new(name, true, "no other session has been scored on it")
        }
        None if n == 0 => Gate::new(
            name,
            true,
            "no session that fits the robot has been scored on it",
        ),
        None => Gate::new(
            name,
            true,
            format!("{}, each better than nominal", sessions(n)),
        ),
    }
}

fn better_than_active(facts: &Facts<'_>) -> Gate {
    let name = "improved_on_active";
    if facts.active.is_none() {
        return Gate::new(name, true, "the robot has no active set");
    }
    if facts.is_rollback {
        return Gate::new(name, true, "not compared: the set was active before").warned(true);
    }
    let mut said = Vec::new();
    let (mut passed, mut changed) = (!facts.comparisons.is_empty(), false);
    for comparison in facts.comparisons {
        match &comparison.rms_mm {
            Ok((own, active)) => {
                passed &= *own <= active + SAME_MM;
                changed |= *active > CHANGED * own + SAME_MM;
                said.push(format!(
                    "{}: {own:.4} mm rms, the active set {active:.4} mm",
                    comparison.points
                ));
            }
            Err(why) => {
                passed = false;
                said.push(format!(
                    "{}: cannot be compared with the active set: {why}",
                    comparison.points
                ));
            }
        }
    }
    if changed {
        said.push("the active set is far off on these points: the robot, its tool or its base changed, or it is another robot".into());
    }
    if said.is_empty() {
        said.push("without verify points it cannot be compared with the active set".into());
    }
    Gate::new(name, passed, said.join("; ")).warned(changed)
}

fn evidence(facts: &Facts<'_>) -> Gate {
    let evidence = facts.evidence();
    let detail = match evidence {
        Evidence::IndependentSession => {
            "independent_session: another session, measured anew, was scored"
        }
        Evidence::SameUpload => {
            "same_upload: only points of the same upload were held out; a wrong base, tool or scale would not show. Measure another session, and post a job of kind verify"
        }
        Evidence::None => "none: nothing was held out",
    };
    let passed =
        !facts.policy.independent_session_required || evidence == Evidence::IndependentSession;
    Gate::new("evidence", passed, detail).warned(evidence != Evidence::IndependentSession)
}

fn uncertainty(facts: &Facts<'_>) -> Gate {
    let name = "uncertainty_within_tolerance";
    let why = &facts.report.tool_uncertainty_absent_because;
    let why = why.as_deref().unwrap_or("the report has none");
    match (
        facts.identification.uncertainty_mm,
        facts.policy.tolerance_mm,
    ) {
        (Some(found), Some(tolerance)) => {
            let detail = format!(
                "predicted uncertainty of the tool over the workspace: at most {found:.4} mm, the tolerance is {tolerance} mm"
            );
            Gate::new(name, found <= tolerance, detail)
        }
        (None, Some(tolerance)) => Gate::new(
            name,
            false,
            format!("no uncertainty is stated, and the tolerance is {tolerance} mm: {why}"),
        ),
        (found, None) => {
            let said = found.map_or_else(
                || format!("is not stated: {why}"),
                |found| format!("is {found:.4} mm"),
            );
            Gate::new(
                name,
                true,
                format!("the robot's policy has no tolerance; the uncertainty {said}"),
            )
            .warned(found.is_none())
        }
    }
}

/// What was measured has to be within the tolerance too: on the points held out, and in every session, whether or not it was measured anew.
fn errors_within_tolerance(facts: &Facts<'_>) -> Gate {
    let name = "verify_errors_within_tolerance";
    let Some(tolerance) = facts.policy.tolerance_mm else {
        return Gate::new(name, true, "the robot's policy has no tolerance");
    };
    let sessions = facts.telling().map(|session| &session.found);
    let own = Some(facts.identification).filter(|found| found.n_points > 0);
    let found: Vec<f64> = sessions
        .chain(own)
        .map(|found| found.after_rms_mm.unwrap_or(f64::INFINITY))
        .collect();
    let largest = found.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let detail =
        format!("largest rms on verify points: {largest:.4} mm, the tolerance is {tolerance} mm");
    Gate::new(name, !found.is_empty() && largest <= tolerance, detail)
}

fn identity(facts: &Facts<'_>) -> Gate {
    if let (Some(robots), Some(stated)) = facts.serial_numbers
        && robots != stated
    {
        let detail = format!("the upload says serial number {stated:?}, the robot has {robots:?}");
        return Gate::new("identity", false, detail);
    }
    let nominal = |link: usize, name: &str| {
        let link = facts.robot.links.get(link.checked_sub(1)?)?;
        Some(match name.rsplit_once('_')?.0 {
            "a" => link.a_mm,
            "alpha" => link.alpha_rad.to_degrees(),
            "d" => link.d_mm,
            "theta_offset" => link.theta_offset_rad.to_degrees(),
            "beta" => link.beta_rad.to_degrees(),
            _ => return None,
        })
    };
    let of_links = facts
        .report
        .parameters
        .iter()
        .filter_map(|p| Some((p, p.link?)));
    let other = of_links.clone().find(|(p, link)| {
        nominal(*link, &p.name).is_some_and(|expected| (expected - p.nominal).abs() > SAME_NOMINAL)
    });
    match other {
        Some((p, _)) => Gate::new(
            "identity",
            false,
            format!(
                "{} is nominally {} in the report, which is not the robot's",
                p.name, p.nominal
            ),
        ),
        None if facts.content.links.len() != facts.robot.links.len() => {
            Gate::new("identity", false, "another number of links")
        }
        None => match facts.serial_numbers {
            (Some(_), Some(stated)) => Gate::new(
                "identity",
                true,
                format!("serial number {stated:?}, the robot's nominal model"),
            ),
            _ => Gate::new(
                "identity",
                true,
                "the robot's nominal model; no serial number was stated with the upload",
            )
            .warned(true),
        },
    }
}

fn change(facts: &Facts<'_>) -> Gate {
    let (reference, name) = match facts.active {
        Some(active) => (active.kinematic_links(), "the active set"),
        None => (facts.robot.links.clone(), "the nominal robot"),
    };
    let changes = implausible_changes(&facts.content.kinematic_links(), &reference);
    if changes.is_empty() {
        return Gate::new(
            "change_plausible",
            true,
            format!("no parameter is far from {name}"),
        );
    }
    let found = format!("against {name} it changes {}", changes.join(", "));
    if let Some(std_deg) = orientation_unknown_deg(facts).filter(|_| !facts.is_rollback) {
        let detail = format!(
            "{found}, and the measured positions do not show how the flange is turned ({std_deg:.1}°, one standard deviation): no reason \
             makes up for that. Identify from a reflector off the last axis, or from two"
        );
        return Gate::new("change_plausible", false, detail);
    }
    match facts.change_reason {
        Some(reason) => Gate::new(
            "change_plausible",
            true,
            format!("{found}; the reason given: {reason}"),
        )
        .warned(true),
        None if facts.is_rollback => Gate::new(
            "change_plausible",
            true,
            format!("{found}; the set was active before"),
        )
        .warned(true),
        None => {
            let detail = format!(
                "{found}: a wrong tool, another robot? If it is right, say why in change_reason"
            );
            Gate::new("change_plausible", false, detail)
        }
    }
}

/// One standard deviation of the flange's rotation, degrees, where it is so large that the orientation counts as not known.
fn orientation_unknown_deg(facts: &Facts<'_>) -> Option<f64> {
    let std_deg = facts.report.flange_rotation_std_deg?;
    (std_deg.to_radians() > MAX_FLANGE_ROTATION_STD_RAD).then_some(std_deg)
}

/// Points of one upload fit as well with the flange turned wrongly. Another session shows at least that the reflector's positions are right.
fn orientation(facts: &Facts<'_>) -> Gate {
    let name = "orientation_known";
    let Some(std_deg) = orientation_unknown_deg(facts) else {
        return Gate::new(name, true, "the orientation of the flange is not in doubt");
    };
    let found = format!(
        "the measured positions do not show how the flange is turned ({std_deg:.1}°, one standard deviation)"
    );
    if facts.is_rollback {
        return Gate::new(name, true, format!("{found}; the set was active before")).warned(true);
    }
    match facts.evidence() {
        Evidence::IndependentSession => {
            let detail = format!(
                "{found}; another session shows that the position of the measured reflector is right: use the set for that alone"
            );
            Gate::new(name, true, detail).warned(true)
        }
        _ => {
            let detail = format!(
                "{found}: identify from a reflector off the last axis, or from two, or show by another session that the reflector's positions \
                 are right: {}",
                verify_it(facts)
            );
            Gate::new(name, false, detail)
        }
    }
}

fn second_person(facts: &Facts<'_>) -> Gate {
    let (uploaders, approver) = facts.people;
    let is_known = !uploaders.is_empty() && uploaders.iter().all(Option::is_some);
    let known: BTreeSet<&str> = uploaders.iter().flatten().map(String::as_str).collect();
    let other = is_known && !known.contains(approver);
    let detail = match (is_known, other) {
        (true, true) => format!(
            "uploaded by {}, released by {approver}",
            Vec::from_iter(known).join(" and ")
        ),
        (true, false) => format!("uploaded and released by {approver}"),
        (false, _) => "who uploaded it is not known".into(),
    };
    Gate::new(
        "second_person",
        other || !facts.policy.second_person_required,
        detail,
    )
}
