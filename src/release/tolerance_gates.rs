//! The gates that compare with the tolerance of the robot's policy.

use crate::release::gate_facts::StoredFacts;
use crate::release::guard_band::{MIN_CONFIGURATIONS, Within, within};
use crate::wire::policy::DecisionRule;
use crate::wire::release::Gate;
use crate::wire::verification::Verification;

/// The predicted uncertainty of the tool must be within the tolerance.
pub fn uncertainty(facts: &StoredFacts<'_>) -> Gate {
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
            let details = found.map_or_else(
                || format!("is not stated: {why}"),
                |found| format!("is {found:.4} mm"),
            );
            Gate::new(
                name,
                true,
                format!("the robot's policy has no tolerance; the uncertainty {details}"),
            )
            .with_warning(found.is_none())
        }
    }
}

/// An rms error that is compared with the tolerance.
struct Figure<'a> {
    /// Description of its points.
    points: String,
    rms_mm: f64,
    expanded_mm: Option<f64>,
    rule: DecisionRule,
    found: &'a Verification,
}

/// The measured errors must also be within the tolerance: on the held-out points, and in every session that fits the robot, whether or not
/// it was measured anew. Under the guarded rule their uncertainty counts too, and an error without a stated uncertainty is refused.
/// Exception: for a session that is no evidence, e.g. because of few points, the error alone counts. The schema's triggers enforce this
/// too.
pub fn errors_within_tolerance(facts: &StoredFacts<'_>) -> Gate {
    let name = "verify_errors_within_tolerance";
    let rule = facts.policy.decision_rule;
    let Some(tolerance) = facts.policy.tolerance_mm else {
        return Gate::new(name, true, "the robot's policy has no tolerance");
    };
    let figure = |points: String, found, rule| Figure {
        points,
        rms_mm: rms_mm_or_infinite(found),
        expanded_mm: found.after_expanded_mm,
        rule,
        found,
    };
    let sessions = facts.counted_sessions().map(|session| {
        let rule = match session.is_evidence {
            true => rule,
            false => DecisionRule::SimpleAcceptance,
        };
        figure(
            format!("in the session of job {}", session.job_id),
            &session.verification,
            rule,
        )
    });
    let own = Some(facts.identification).filter(|found| found.n_points > 0);
    let own = own.map(|found| figure("on the points held out".into(), found, rule));
    let compare =
        |figure: &Figure<'_>| within(figure.rms_mm, figure.expanded_mm, tolerance, figure.rule);
    let severity = |figure: &Figure<'_>| match compare(figure) {
        Within::Yes => 0,
        Within::InGuardBand => 1,
        Within::Unknown => 2,
        Within::No => 3,
    };
    let upper_mm = |figure: &Figure<'_>| figure.rms_mm + figure.expanded_mm.unwrap_or(0.0);
    let worst = own.into_iter().chain(sessions).max_by(|a, b| {
        let by_size = upper_mm(a).total_cmp(&upper_mm(b));
        severity(a).cmp(&severity(b)).then(by_size)
    });
    let Some(worst) = worst else {
        return Gate::new(
            name,
            false,
            format!(
                "there are no verify points, and the tolerance is {tolerance} mm ({})",
                name_of(rule)
            ),
        );
    };
    let within = compare(&worst);
    Gate::new(
        name,
        within == Within::Yes,
        in_words(&worst, within, tolerance),
    )
}

/// The name of a decision rule in a text (ILAC-G8).
fn name_of(rule: DecisionRule) -> &'static str {
    match rule {
        DecisionRule::SimpleAcceptance => "simple acceptance",
        DecisionRule::GuardedAcceptance => "guarded acceptance",
    }
}

/// An unknown error exceeds every tolerance.
fn rms_mm_or_infinite(found: &Verification) -> f64 {
    found.after_rms_mm.unwrap_or(f64::INFINITY)
}

fn in_words(figure: &Figure<'_>, within: Within, tolerance: f64) -> String {
    let rule = figure.rule;
    let interval = figure.expanded_mm.map_or(
        " with an uncertainty that is not stated".into(),
        |expanded| format!(" ± {expanded:.4} mm (expanded uncertainty, 95 %)"),
    );
    let compared = match rule {
        DecisionRule::SimpleAcceptance => "the figure alone counts",
        DecisionRule::GuardedAcceptance => "figure and uncertainty together must be within it",
    };
    let said = format!(
        "largest rms on verify points, {}: {:.4} mm{interval}; the tolerance is {tolerance} mm, {}: {compared}",
        figure.points,
        figure.rms_mm,
        name_of(rule)
    );
    match within {
        Within::Yes | Within::No => said,
        Within::InGuardBand => format!(
            "{said}. It lies in the guard band: verify on more configurations, so that the uncertainty becomes smaller"
        ),
        Within::Unknown if figure.found.n_points < MIN_CONFIGURATIONS => format!(
            "{said}. {} points are too few to state one: verify on at least {MIN_CONFIGURATIONS} configurations",
            figure.found.n_points
        ),
        Within::Unknown => format!(
            "{said}. There are too few configurations or degrees of freedom, or an older version did not compute the uncertainty: verify on more \
             configurations, identify again a set of an older version, or choose simple acceptance in the policy of releases"
        ),
    }
}
