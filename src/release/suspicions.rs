//! Uploads that do not fit their robot: which are refused, and which are kept with a warning.

use crate::calibration::upload_checks::alignment::{Explanation, ROTATION_SUSPECT, Suspicion};
use crate::calibration::upload_checks::rotations;
use crate::kinematics::Robot;
use crate::measurement::MeasurementSet;
use crate::wire::suspicion::Insist;
use crate::wire::warning::Warning;
use crate::wire::{Invalid, Issue};

/// An upload that does not fit, and is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AcceptedMisfit {
    /// The warning that the set keeps.
    pub warning: Warning,
    /// Code of the refusal that the caller overrode with `insist`, if there was one. Such a set cannot lead to a release.
    pub insisted_on: Option<Insist>,
}

/// Codes of refusals and warnings whose cause may be an unread column for the target or the station.
const EXPLAINED_BY_UNREAD_LABELS: [&str; 2] = ["poor_alignment", "frame_suspect"];

/// Adds the unread columns to an explanation, if they may be the cause.
fn with_unread(explanation: Explanation, unread: Option<&str>) -> Explanation {
    let Some(unread) = unread else {
        return explanation;
    };
    let added = |detail: String| {
        let end = if detail.ends_with('?') { "" } else { "." };
        format!("{detail}{end} {unread}")
    };
    match explanation {
        Explanation::Warning { code, detail } if EXPLAINED_BY_UNREAD_LABELS.contains(&code) => {
            Explanation::Warning {
                code,
                detail: added(detail),
            }
        }
        Explanation::Refusal(suspicion) if EXPLAINED_BY_UNREAD_LABELS.contains(&suspicion.code) => {
            Explanation::Refusal(Suspicion {
                detail: added(suspicion.detail),
                ..suspicion
            })
        }
        other => other,
    }
}

/// Keeps an upload whose misfit only deserves a warning, or on which the caller insists with the code of the suspicion.
///
/// `unread` names the columns of the upload that are not read although they may identify the reflector or the set-up of a row.
///
/// # Errors
/// [`Invalid`] with the suspicion for which the upload is refused.
pub fn accept_misfit(
    explanation: Explanation,
    insist: Option<Insist>,
    unread: Option<&str>,
) -> Result<AcceptedMisfit, Invalid> {
    let explanation = with_unread(explanation, unread);
    match explanation {
        Explanation::Warning { code, detail } => Ok(AcceptedMisfit {
            warning: Warning::new(code, detail),
            insisted_on: None,
        }),
        Explanation::Refusal(suspicion)
            if insist.is_some_and(|insist| insist.as_str() == suspicion.code) =>
        {
            let detail = format!(
                "{}. It was kept because the uploader insisted; no release rests on it",
                suspicion.detail
            );
            Ok(AcceptedMisfit {
                warning: Warning::new(suspicion.code, detail),
                insisted_on: insist,
            })
        }
        Explanation::Refusal(suspicion) => Err(Invalid {
            code: suspicion.code,
            issues: vec![Issue::from(&suspicion)],
        }),
    }
}

/// As [`accept_misfit`], for poses whose rotations do not fit the robot; `None` if they fit.
pub fn accept_rotations(
    robot: &Robot,
    set: &MeasurementSet,
    insist: Option<Insist>,
) -> Result<Option<AcceptedMisfit>, Invalid> {
    let refusal = rotations::suspicion(robot, set).map(|detail| {
        Explanation::Refusal(Suspicion {
            code: ROTATION_SUSPECT,
            columns: None,
            detail,
            joint_map: None,
        })
    });
    refusal
        .map(|refusal| accept_misfit(refusal, insist, None))
        .transpose()
}

#[cfg(test)]
mod tests {
    use super::accept_misfit;
    use crate::calibration::upload_checks::alignment::{Explanation, Suspicion};

    #[test]
    fn columns_that_are_not_read_are_named_where_they_may_be_the_cause() {
        let refusal = |code| {
            let suspicion = Suspicion {
                code,
                columns: None,
                detail: "nothing fits".into(),
                joint_map: None,
            };
            let explanation = Explanation::Refusal(suspicion);
            let refused = accept_misfit(explanation, None, Some("Not read: \"Target\""));
            refused.unwrap_err().issues[0].detail.clone()
        };
        let detail = refusal("poor_alignment");
        assert!(detail.starts_with("nothing fits. Not read: \"Target\""));
        assert!(!refusal("unit_suspect").contains("Not read"));
    }
}
