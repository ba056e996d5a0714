//! The gates a parameter set passes before it may move a robot.

use crate::calibration::{Judged, implausible_changes};
use crate::kinematics::Robot;
use crate::wire::issue::{Checker, Invalid, Issue};
use crate::wire::parameter_set::{MAX_REASON, ParameterSetContent};
use crate::wire::policy::PolicyBody;
use crate::wire::report_shape::{Evidence, Report};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use utoipa::ToSchema;

/// Fewer points than this prove nothing.
const MIN_VERIFY_POINTS: usize = 5;
/// Two parameter sets whose errors differ by less are equally good, mm: a tenth of what a laser tracker resolves over an arm's reach.
const SAME_MM: f64 = 0.001;
/// Nominal values in a report may have gone through degrees and back.
const SAME_NOMINAL: f64 = 1e-6;
/// The active set's errors on new points, in units of the candidate's, from which on something must have happened to the robot.
const CHANGED: f64 = 3.0;

/// One gate and how it came out; kept with the release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Gate {
    /// Its name.
    pub gate: String,
    /// Whether it was passed.
    pub passed: bool,
    /// What was found.
    pub detail: String,
    /// True where it was passed and somebody should look all the same.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub warning: bool,
}

impl Gate {
    fn new(gate: &str, passed: bool, detail: impl Into<String>) -> Self {
        Self {
            gate: gate.into(),
            passed,
            detail: detail.into(),
            warning: false,
        }
    }

    fn warned(self, warning: bool) -> Self {
        Self {
            warning: warning && self.passed,
            ..self
        }
    }

    /// As it is listed in a refusal.
    pub fn issue(&self) -> Issue {
        Issue {
            code: self.gate.clone(),
            detail: self.detail.clone(),
            ..Issue::default()
        }
    }
}

/// What a release would find.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct GatesAnswer {
    /// The set.
    pub parameter_set_id: String,
    /// Whether every gate is passed: then a release by the same key succeeds, unless something changes meanwhile.
    pub releasable: bool,
    /// How strong the verification is.
    pub evidence: Evidence,
    /// The tool's largest predicted uncertainty over the workspace, mm; none where it cannot be stated.
    pub uncertainty_mm: Option<f64>,
    /// All of them; with `warning`, passed and worth a look.
    pub gates: Vec<Gate>,
}

/// Why a set is released.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReleaseBody {
    /// In words, for those who come after.
    #[schema(min_length = 1, max_length = 2000)]
    pub reason: String,
    /// Why parameters changed by more than can be expected, e.g. `collision on Monday`; needed only then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 2000)]
    pub change_reason: Option<String>,
}

impl ReleaseBody {
    /// Reasons are sentences, not nothing and not books.
    ///
    /// # Errors
    /// [`Invalid`] for an empty or overlong one.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.text("/reason", &self.reason, MAX_REASON);
        self.change_reason
            .iter()
            .for_each(|reason| checker.text("/change_reason", reason, MAX_REASON));
        checker.finish("invalid_reason")
    }
}

/// A session that the set was scored on by a job of kind `verify`.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// The job.
    pub job_id: String,
    /// Points.
    pub n_points: usize,
    /// Errors of the nominal robot and of the set; not numbers, and so no better, where there are none.
    pub judged: Judged,
    /// Measured anew, with enough points, and none of them from the session that the set was identified from.
    pub is_independent: bool,
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
    /// The report of the job that identified the set.
    pub report: &'a Report,
    /// Whether that job's verify points are another session's.
    pub verified_elsewhere: bool,
    /// The set.
    pub content: &'a ParameterSetContent,
    /// The active set, if there is one.
    pub active: Option<&'a ParameterSetContent>,
    /// What it was scored on since: the newest sessions.
    pub sessions: &'a [Session],
    /// Of all sessions, the job that showed it to be no better than nominal.
    pub no_better_than_nominal: Option<&'a str>,
    /// Against the active set.
    pub comparisons: &'a [Comparison],
    /// It was taken back for good.
    pub is_withdrawn: bool,
    /// It was released before, and is to come back in the place of what is active, which is withdrawn.
    pub is_rollback: bool,
    /// Serial number of the robot, and as the uploader stated it.
    pub serial_numbers: (Option<&'a str>, Option<&'a str>),
    /// Who uploaded the points and the sweeps, and who releases.
    pub people: (&'a [Option<String>], &'a str),
    /// Why it changed so much.
    pub change_reason: Option<&'a str>,
    /// What the robot asks.
    pub policy: &'a PolicyBody,
}

impl Facts<'_> {
    /// How strong the verification is.
    pub fn evidence(&self) -> Evidence {
        let independent = self.sessions.iter().any(|session| session.is_independent)
            || (self.verified_elsewhere && self.has_own_points());
        match (independent, self.has_own_points()) {
            (true, _) => Evidence::IndependentSession,
            (false, true) => Evidence::SameUpload,
            (false, false) => Evidence::None,
        }
    }

    /// The tool's largest predicted uncertainty, mm.
    pub fn uncertainty_mm(&self) -> Option<f64> {
        self.report.tool_uncertainty_mm.map(|tool| tool.max)
    }

    fn has_own_points(&self) -> bool {
        self.report
            .verify
            .is_some_and(|verify| verify.n_points >= MIN_VERIFY_POINTS)
    }
}

/// Every gate, passed or not.
pub fn gates(facts: &Facts<'_>) -> Vec<Gate> {
    let mut gates = vec![
        verified(facts),
        errors_improved(facts),
        all_finite(facts.content),
        fits(facts),
        better_than_nominal(facts),
    ];
    gates.extend([
        better_than_active(facts),
        evidence(facts),
        uncertainty(facts),
        errors_within_tolerance(facts),
    ]);
    gates.extend([identity(facts), change(facts), second_person(facts)]);
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
    let n = facts.report.verify.map_or(0, |verify| verify.n_points);
    let passed = facts.evidence() != Evidence::None;
    let detail = match passed {
        true => format!(
            "{n} points were held out to verify, {} sessions scored",
            facts.sessions.len()
        ),
        false => format!(
            "{n} points were held out to verify; {MIN_VERIFY_POINTS} are needed: post a job with verify, or of kind verify"
        ),
    };
    Gate::new("verified", passed, detail)
}

fn errors_improved(facts: &Facts<'_>) -> Gate {
    let name = "verify_errors_improved";
    match &facts.report.verify {
        Some(_) => {
            let judged = facts.report.judged();
            let (before, after, remark) =
                (judged.before_rms_mm, judged.after_rms_mm, judged.remark());
            Gate::new(
                name,
                judged.is_better(),
                format!(
                    "rms on the verify points{remark}: {before:.4} mm before, {after:.4} mm after"
                ),
            )
        }
        None if facts.sessions.iter().any(|session| session.is_independent) => {
            Gate::new(name, true, "see the sessions")
        }
        None => Gate::new(name, false, "without verify points nobody knows"),
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
    Gate::new("all_finite", finite, "every number is finite")
}

/// Where everything is noise, the identified robot is better than the nominal one half of the time.
fn fits(facts: &Facts<'_>) -> Gate {
    match facts
        .report
        .warnings
        .iter()
        .find(|warning| warning.code == "no_fit")
    {
        Some(warning) => Gate::new("fits", false, warning.detail.clone()),
        None => Gate::new("fits", true, "the identified robot comes near the points"),
    }
}

/// Fails closed: an error that cannot be compared is not smaller.
fn better_than_nominal(facts: &Facts<'_>) -> Gate {
    let name = "sessions_better_than_nominal";
    let worse = facts
        .sessions
        .iter()
        .find(|session| !session.judged.is_better());
    match worse {
        Some(s) => {
            let detail = format!(
                "job {} scored the set on another session: {:.4} mm rms, the nominal robot {:.4} mm{}; it is no better than nominal, so it is never released",
                s.job_id,
                s.judged.after_rms_mm,
                s.judged.before_rms_mm,
                s.judged.remark()
            );
            Gate::new(name, false, detail)
        }
        None if facts.no_better_than_nominal.is_some() => {
            let job = facts.no_better_than_nominal.unwrap_or_default();
            let detail = format!(
                "job {job} showed on another session that the set is no better than nominal, so it is never released"
            );
            Gate::new(name, false, detail)
        }
        None if facts.sessions.is_empty() => {
            Gate::new(name, true, "no other session has been scored on it")
        }
        None => Gate::new(
            name,
            true,
            format!(
                "{} sessions, each better than nominal",
                facts.sessions.len()
            ),
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
    match (facts.uncertainty_mm(), facts.policy.tolerance_mm) {
        (Some(found), Some(tolerance)) => {
            let detail = format!(
                "predicted uncertainty of the tool over the workspace: at most {found:.4} mm, the tolerance is {tolerance} mm"
            );
            Gate::new(name, found <= tolerance, detail)
        }
        (None, Some(tolerance)) => Gate::new(
            name,
            false,
            format!("the uncertainty cannot be stated; the tolerance is {tolerance} mm"),
        ),
        (found, None) => {
            let said = found.map_or("cannot be stated".to_owned(), |found| {
                format!("is {found:.4} mm")
            });
            Gate::new(
                name,
                true,
                format!("the robot's policy has no tolerance; the uncertainty {said}"),
            )
            .warned(found.is_none())
        }
    }
}

/// What was measured has to be within the tolerance too: on other sessions where there are any, else on the points held out.
fn errors_within_tolerance(facts: &Facts<'_>) -> Gate {
    let name = "verify_errors_within_tolerance";
    let Some(tolerance) = facts.policy.tolerance_mm else {
        return Gate::new(name, true, "the robot's policy has no tolerance");
    };
    let elsewhere = facts
        .sessions
        .iter()
        .filter(|s| s.is_independent)
        .map(|s| s.judged.after_rms_mm);
    let found: Vec<f64> = elsewhere
        .chain(
            facts
                .report
                .verify
                .map(|_| facts.report.judged().after_rms_mm),
        )
        .collect();
    let largest = found.iter().fold(f64::NEG_INFINITY, |largest, rms| {
        if rms.is_nan() {
            f64::INFINITY
        } else {
            largest.max(*rms)
        }
    });
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
        Some(active) => (active.links_to_core(), "the active set"),
        None => (facts.robot.links.clone(), "the nominal robot"),
    };
    let changes = implausible_changes(&facts.content.links_to_core(), &reference);
    if changes.is_empty() {
        return Gate::new(
            "change_plausible",
            true,
            format!("no parameter is far from {name}"),
        );
    }
    let found = format!("against {name} it changes {}", changes.join(", "));
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
