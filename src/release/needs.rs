//! The most urgent need of a robot, from facts that are stored as columns.

use crate::release::guard_band::{Within, within};
use crate::release::trend::GROWTH;
use crate::wire::job_answer::JobStatus;
use crate::wire::overview::Need;
use crate::wire::policy::DecisionRule;

/// A calibration is due if the limit is reached within this time, days.
const SOON_DAYS: f64 = 14.0;

/// Facts of one robot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NeedFacts {
    /// The robot is in the state `check_robot`.
    pub must_be_checked: bool,
    /// Tolerance of the robot's policy, mm.
    pub tolerance_mm: Option<f64>,
    /// Rule by which the policy compares an error with the tolerance.
    pub decision_rule: DecisionRule,
    /// Error of the released set when it was identified, mm.
    pub released_rms_mm: Option<f64>,
    /// The robot has a released set.
    pub is_released: bool,
    /// Error of the released set on the newest session, mm.
    pub session_rms_mm: Option<f64>,
    /// Expanded uncertainty of that error, mm, if it is stated.
    pub session_expanded_mm: Option<f64>,
    /// The newest session fits the robot, and the released set is far off on it.
    pub is_far_off: bool,
    /// Error of the nominal robot on the newest session, mm, if the released set is no better.
    pub no_better_than_mm: Option<f64>,
    /// The released set's error on the newest session is several times its error at the identification, or several times the error of a
    /// robot fitted to that session.
    pub is_worse: bool,
    /// A set that is not withdrawn is newer than the released set, or no set is released.
    pub has_newer: bool,
    /// A released set was withdrawn, and no other is released.
    pub is_withdrawn: bool,
    /// Measured points are stored.
    pub has_points: bool,
    /// The gate that refuses the newest set's release by stored facts.
    pub newest_refused_by: Option<String>,
    /// Status of the newest job.
    pub last_job: Option<JobStatus>,
    /// Days until the error reaches its limit.
    pub days_to_limit: Option<f64>,
}

/// The most urgent need, and the reason.
pub fn need(facts: &NeedFacts) -> (Need, String) {
    if facts.must_be_checked {
        return (
            Need::CheckRobot,
            "a session speaks against the robot; no release until a session fits or somebody states a reason".into(),
        );
    }
    if let Some(reason) = drift(facts) {
        return (Need::Drifted, reason);
    }
    if facts.is_withdrawn {
        let reason = match facts.has_newer {
            true => {
                "the active set was withdrawn, so the cell has no parameters; another result waits for a decision"
            }
            false => "the active set was withdrawn, so the cell has no parameters; calibrate again",
        };
        return (Need::Withdrawn, reason.into());
    }
    if facts.last_job == Some(JobStatus::Failed) {
        return (
            Need::JobFailed,
            "the newest job failed; its page says why".into(),
        );
    }
    if facts.has_newer {
        return (Need::Review, reason_of_newer_result(facts).into());
    }
    if let Some(days) = facts.days_to_limit.filter(|days| *days <= SOON_DAYS) {
        let when = if days < 1.0 {
            "now".to_owned()
        } else {
            format!("in {days:.0} days")
        };
        return (Need::Due, format!("the error reaches its limit {when}"));
    }
    if !facts.is_released {
        let reason = match facts.has_points {
            true => "it has no result; calibrate with the stored points",
            false => "it has no result; upload measured points",
        };
        return (Need::Calibrate, reason.into());
    }
    (Need::Nothing, String::new())
}

/// Text about a result that is newer than the released set. A result that a gate refuses does not wait for its release.
fn reason_of_newer_result(facts: &NeedFacts) -> &'static str {
    match (facts.newest_refused_by.as_deref(), facts.is_released) {
        (None, true) => "a newer result than the released set waits for a decision",
        (None, false) => "the first result waits for its release",
        (Some("fits"), true) => "a newer result does not fit the robot; the released set stays",
        (Some("fits"), false) => "the first result does not fit the robot",
        (Some(_), true) => "a newer result is not ready to be released",
        (Some(_), false) => "the first result is not ready to be released",
    }
}

fn drift(facts: &NeedFacts) -> Option<String> {
    if facts.is_far_off {
        return Some("the newest session misses the released set by far".into());
    }
    let now = facts.session_rms_mm?;
    if let Some(nominal) = facts.no_better_than_mm {
        return Some(format!(
            "the newest session has {now:.3} mm rms, no better than the nominal robot with {nominal:.3} mm"
        ));
    }
    if let Some(tolerance) = facts.tolerance_mm {
        let expanded = facts.session_expanded_mm;
        return match within(now, expanded, tolerance, facts.decision_rule) {
            // Without a stated uncertainty, the error alone decides.
            Within::Yes | Within::Unknown => None,
            Within::No => Some(format!(
                "the newest session has {now:.3} mm rms; the tolerance is {tolerance:.3} mm"
            )),
            Within::InGuardBand => Some(format!(
                "the newest session has {now:.3} ± {:.3} mm rms; the tolerance is {tolerance:.3} mm, and the policy counts the uncertainty",
                expanded.unwrap_or_default()
            )),
        };
    }
    match facts.released_rms_mm {
        Some(then) if now > GROWTH * then => Some(format!(
            "the newest session has {now:.3} mm rms; it was {then:.3} mm when the set was identified"
        )),
        _ if facts.is_worse => Some(format!(
            "the newest session has {now:.3} mm rms, several times what is left where a robot is fitted to it, or was left when the set was identified"
        )),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::{NeedFacts, need};
    use crate::wire::job_answer::JobStatus;
    use crate::wire::overview::Need;
    use crate::wire::policy::DecisionRule;

    fn released() -> NeedFacts {
        NeedFacts {
            is_released: true,
            released_rms_mm: Some(0.1),
            last_job: Some(JobStatus::Succeeded),
            ..NeedFacts::default()
        }
    }

    #[test]
    fn a_robot_needs_the_most_urgent_thing() {
        let session = |rms| NeedFacts {
            session_rms_mm: Some(rms),
            ..released()
        };
        let failed = NeedFacts {
            last_job: Some(JobStatus::Failed),
            ..released()
        };
        let all = NeedFacts {
            must_be_checked: true,
            is_far_off: true,
            has_newer: true,
            days_to_limit: Some(0.0),
            ..failed.clone()
        };
        for (facts, expected) in [
            (NeedFacts::default(), Need::Calibrate),
            (released(), Need::Nothing),
            (session(0.14), Need::Nothing),
            (session(0.16), Need::Drifted),
            (
                NeedFacts {
                    is_worse: true,
                    ..session(0.14)
                },
                Need::Drifted,
            ),
            (
                NeedFacts {
                    no_better_than_mm: Some(0.12),
                    tolerance_mm: Some(0.2),
                    ..session(0.14)
                },
                Need::Drifted,
            ),
            (
                NeedFacts {
                    tolerance_mm: Some(0.2),
                    ..session(0.16)
                },
                Need::Nothing,
            ),
            (
                NeedFacts {
                    tolerance_mm: Some(0.12),
                    ..session(0.13)
                },
                Need::Drifted,
            ),
            (
                NeedFacts {
                    tolerance_mm: Some(0.2),
                    session_expanded_mm: Some(0.05),
                    ..session(0.16)
                },
                Need::Drifted,
            ),
            (
                NeedFacts {
                    tolerance_mm: Some(0.2),
                    session_expanded_mm: Some(0.05),
                    decision_rule: DecisionRule::SimpleAcceptance,
                    ..session(0.16)
                },
                Need::Nothing,
            ),
            (
                NeedFacts {
                    is_withdrawn: true,
                    is_released: false,
                    ..failed.clone()
                },
                Need::Withdrawn,
            ),
            (failed, Need::JobFailed),
            (
                NeedFacts {
                    has_newer: true,
                    ..NeedFacts::default()
                },
                Need::Review,
            ),
            (
                NeedFacts {
                    has_newer: true,
                    newest_refused_by: Some("fits".into()),
                    ..NeedFacts::default()
                },
                Need::Review,
            ),
            (
                NeedFacts {
                    days_to_limit: Some(3.0),
                    ..released()
                },
                Need::Due,
            ),
            (
                NeedFacts {
                    days_to_limit: Some(90.0),
                    ..released()
                },
                Need::Nothing,
            ),
            (all, Need::CheckRobot),
        ] {
            let (found, reason) = need(&facts);
            assert_eq!(found, expected, "{facts:?}");
            assert_eq!(reason.is_empty(), found == Need::Nothing, "{reason}");
            let is_refused = facts.newest_refused_by.is_some();
            assert!(
                !is_refused || reason == "the first result does not fit the robot",
                "{reason}"
            );
        }
    }
}
