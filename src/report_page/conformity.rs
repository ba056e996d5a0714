//! Top of the page: whether the parameter set is still valid, and the comparison of its error with the tolerance.

use super::Sources;
use super::sources::ScoredSession;
use super::text::{error, number, time};
use crate::release::guard_band::{
    ConfigurationErrors, MIN_CONFIGURATIONS, Within, expanded_mm, within,
};
use crate::release::headline;
use crate::wire::job::VerifyBody;
use crate::wire::measurement::{Frame, Subset};
use crate::wire::parameter_set::{ParameterSetAnswer, ParameterSetStatus};
use crate::wire::policy::DecisionRule;
use crate::wire::report_shape::Report;
use maud::{Markup, html};
use std::collections::{BTreeMap, BTreeSet};

/// The set, if it was withdrawn.
fn withdrawn_set<'a>(sources: &Sources<'a>) -> Option<&'a ParameterSetAnswer> {
    let is_withdrawn = |set: &&ParameterSetAnswer| set.status == ParameterSetStatus::Withdrawn;
    sources.parameter_set.filter(is_withdrawn)
}

/// Whether the set was withdrawn. The style sheet says so at the top of each printed page.
pub fn is_withdrawn(sources: &Sources<'_>) -> bool {
    withdrawn_set(sources).is_some()
}

/// Says that the set was withdrawn: when, by whom and why.
pub fn withdrawn(sources: &Sources<'_>) -> Markup {
    let set = withdrawn_set(sources);
    html! {
        @if let Some(set) = set {
            p.withdrawn { strong { "WITHDRAWN" } " " (withdrawal(set)) " Do not use these parameters." }
        }
    }
}

/// Time, person and reason of a withdrawal.
fn withdrawal(set: &ParameterSetAnswer) -> String {
    let at = set.withdrawn_at.as_deref().map(time).unwrap_or_default();
    let by = set.withdrawn_by_name.as_ref().or(set.withdrawn_by.as_ref());
    let by = by.map_or(String::new(), |name| format!(" by {name}"));
    match &set.withdraw_reason {
        Some(reason) => format!("{at}{by}: {}.", reason.trim_end_matches('.')),
        None => format!("{at}{by}."),
    }
}

/// An rms error, and its expanded uncertainty (95 %) if it can be computed.
struct Figure {
    rms_mm: f64,
    expanded_mm: Option<f64>,
    /// A sentence that says why there is no uncertainty, if there is none.
    unknown_because: String,
    points: String,
}

/// What the figure behind ± is.
const EXPANDED: &str = "± is the expanded uncertainty (95 %): from the scatter over the arm configurations, with the noise that the instrument \
                        states and with what was fitted to the same points. A release compares the same figure.";

/// The comparison with the tolerance in one line. It is made with the policy of now. The figure is the one that is furthest from being within: of the
/// points to verify, and of the sessions that are evidence.
pub fn verdict(sources: &Sources<'_>) -> Markup {
    let Some(tolerance_mm) = sources.tolerance_mm else {
        return html! { p.conformity { "No tolerance is set in the robot's policy: no verdict." } };
    };
    let rule = match sources.decision_rule {
        DecisionRule::GuardedAcceptance => "guarded",
        DecisionRule::SimpleAcceptance => "simple",
    };
    let stated = format!("Tolerance {} mm ({rule})", number(tolerance_mm));
    if headline(sources.report).is_some() {
        return html! { p.conformity { (stated) ": the result cannot be used → " strong { "NOT WITHIN" } } };
    }
    let compare = |figure: &Figure| {
        within(
            figure.rms_mm,
            figure.expanded_mm,
            tolerance_mm,
            sources.decision_rule,
        )
    };
    let severity = |figure: &Figure| match compare(figure) {
        Within::Yes => 0,
        Within::InGuardBand => 1,
        Within::Unknown => 2,
        Within::No => 3,
    };
    let upper_mm = |figure: &Figure| figure.rms_mm + figure.expanded_mm.unwrap_or(0.0);
    let sessions = sources.sessions.iter().filter_map(of_session);
    let worst = own_figure(sources)
        .into_iter()
        .chain(sessions)
        .max_by(|a, b| {
            severity(a)
                .cmp(&severity(b))
                .then(upper_mm(a).total_cmp(&upper_mm(b)))
        });
    let Some(worst) = worst else {
        return html! { p.conformity { (stated) ": no points were kept to verify → " strong { "NOT SHOWN" } } };
    };
    let interval = worst
        .expanded_mm
        .map_or(String::new(), |expanded| format!(" ± {}", error(expanded)));
    let (said, why) = match compare(&worst) {
        Within::Yes => ("WITHIN", ""),
        Within::No => ("NOT WITHIN", ""),
        Within::InGuardBand => (
            "NOT WITHIN",
            ": figure and uncertainty together are above it",
        ),
        Within::Unknown => ("NOT SHOWN", ": the uncertainty of the figure is not known"),
    };
    let note = match worst.expanded_mm {
        Some(_) => EXPANDED.to_owned(),
        None => worst.unknown_because.clone(),
    };
    html! {
        p.conformity { (stated) ": rms " (error(worst.rms_mm)) (interval) " mm " (worst.points) " → " strong { (said) } (why) }
        p.note { (note) }
    }
}

/// The error on the points to verify, without outliers, as a release counts it: the larger one of the links and of the links with corrections.
fn own_figure(sources: &Sources<'_>) -> Option<Figure> {
    let report = sources.report;
    let verify = report.verify.as_ref().filter(|half| half.n_points > 0)?;
    let half = report.verify_without_outliers.as_ref().unwrap_or(verify);
    let corrected_mm = half.corrected.as_ref().map_or(0.0, |errors| errors.rms_mm);
    let n_left_out = verify.n_points - half.n_points;
    let without = match n_left_out {
        0 => String::new(),
        n => format!(" without {n} outlying"),
    };
    Some(Figure {
        rms_mm: half.after.rms_mm.max(corrected_mm),
        expanded_mm: match sources.job {
            Some(_) => sources.verified_expanded_mm,
            None => is_placed_before(sources)
                .then(|| own_expanded_mm(report))
                .flatten(),
        },
        unknown_because: unknown_because(report),
        points: format!("on {} points to verify{without}", half.n_points),
    })
}

/// Why the uncertainty of the error on the points to verify is not known.
fn unknown_because(report: &Report) -> String {
    let points = report.per_point.iter();
    let verified = points.filter(|point| point.subset == Subset::Verify && !point.outlier);
    let configurations: BTreeSet<&str> =
        verified.map(|point| point.configuration.as_str()).collect();
    match configurations.len() {
        n if n < MIN_CONFIGURATIONS => format!(
            "No uncertainty is stated: the points to verify are of {n} arm configurations, and it takes {MIN_CONFIGURATIONS}."
        ),
        _ => "No uncertainty is stated: too few different poses are left beside what was fitted to them, or an older version of kincal made this \
              result. Verify the set on another session."
            .into(),
    }
}

/// Without a server, which computes the uncertainty when a job ends: whether neither base nor reflectors were fitted to the points to verify, and no
/// instrument states an error common to all of them. Otherwise the report does not have what the uncertainty is computed from.
fn is_placed_before(sources: &Sources<'_>) -> bool {
    let is_other_set = sources
        .job
        .is_some_and(|job| matches!(job.request.verify, Some(VerifyBody::Set { .. })));
    let is_placed_anew = sources.is_verification() && sources.set.frame == Frame::Instrument;
    !is_other_set && !is_placed_anew && sources.sets().all(|set| set.instrument.is_none())
}

/// Expanded uncertainty of the rms error, from the scatter over the configurations.
fn own_expanded_mm(report: &Report) -> Option<f64> {
    let mut found: BTreeMap<&str, ConfigurationErrors> = BTreeMap::new();
    let points = report.per_point.iter();
    for point in points.filter(|point| point.subset == Subset::Verify && !point.outlier) {
        let error_mm = point.corrected_mm.unwrap_or(0.0).max(point.after_mm);
        let own = found.entry(&point.configuration).or_default();
        own.n_points += 1;
        own.sum_mm2 += error_mm * error_mm;
    }
    let found: Vec<ConfigurationErrors> = found.into_values().collect();
    expanded_mm(&found, 0, 0.0)
}

/// The error in a session that is evidence for or against the set.
fn of_session(scored: &ScoredSession) -> Option<Figure> {
    scored.session.verdict(true)?;
    let found = &scored.session.verification;
    Some(Figure {
        rms_mm: found.after_rms_mm?,
        expanded_mm: found.after_expanded_mm,
        unknown_because:
            "No uncertainty is stated: the session has too few arm configurations, or an older version of kincal scored it."
                .into(),
        points: format!("in the session of {}", time(&scored.measured_at)),
    })
}
