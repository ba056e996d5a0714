//! Uploads that do not fit their robot: which are refused, and which are kept with a warning.

use crate::calibration::upload_checks::alignment::{Explanation, Suspicion};
use crate::wire::suspicion::Insist;
use crate::wire::warning::Warning;

/// An upload that does not fit, and is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AcceptedMisfit {
    /// The warning that the set keeps.
    pub warning: Warning,
    /// Code of the refusal that the caller overrode with `insist`, if there was one. Such a set cannot lead to a release.
    pub insisted_on: Option<Insist>,
}

/// Keeps an upload whose misfit only deserves a warning, or on which the caller insists with the code of the suspicion.
///
/// # Errors
/// The suspicion for which the upload is refused.
pub fn accept_misfit(
    explanation: Explanation,
    insist: Option<Insist>,
) -> Result<AcceptedMisfit, Box<Suspicion>> {
    let warning = |code: &str, detail: String| Warning {
        code: code.into(),
        detail,
        rows: Vec::new(),
    };
    match explanation {
        Explanation::Warning { code, detail } => Ok(AcceptedMisfit {
            warning: warning(code, detail),
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
                warning: warning(suspicion.code, detail),
                insisted_on: insist,
            })
        }
        Explanation::Refusal(suspicion) => Err(Box::new(suspicion)),
    }
}
