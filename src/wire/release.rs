//! The gates a parameter set passes before it may move a robot.

use crate::wire::issue::Issue;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::report_shape::Report;
use serde::{Deserialize, Serialize};

/// One gate and how it came out; kept with the release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gate {
    /// Its name.
    pub gate: String,
    /// Whether it was passed.
    pub passed: bool,
    /// What was found.
    pub detail: String,
}

impl Gate {
    fn new(gate: &str, passed: bool, detail: String) -> Self {
        Self { gate: gate.into(), passed, detail }
    }

    /// As it is listed in a refusal.
    pub fn issue(&self) -> Issue {
        Issue { code: self.gate.clone(), detail: self.detail.clone(), ..Issue::default() }
    }
}

/// Every gate, passed or not: points held out, errors on them improved, all numbers finite, the content as it was hashed.
pub fn gates(report: &Report, content: &ParameterSetContent) -> Vec<Gate> {
    let verified = match &report.verify {
        Some(verify) => (verify.n_points > 0, format!("{} points were held out to verify", verify.n_points)),
        None => (false, "no points were held out to verify: post a job with verify".into()),
    };
    let improved = match &report.verify {
        Some(verify) => {
            let (before, after) = (verify.before.rms_mm, verify.after.rms_mm);
            (after < before, format!("rms on the verify points: {before:.4} mm before, {after:.4} mm after"))
        }
        None => (false, "without verify points nobody knows".into()),
    };
    let links = content.links.iter().flat_map(|l| [l.a_mm, l.alpha_deg, l.d_mm, l.theta_offset_deg, l.beta_deg]);
    let base = content.t_instrument_base;
    let frame = base.rotation.into_iter().flatten().chain(base.translation_mm);
    let finite = links.chain(frame).chain(content.targets.iter().flat_map(|t| t.position_mm)).all(f64::is_finite);
    vec![
        Gate::new("verified", verified.0, verified.1),
        Gate::new("verify_errors_improved", improved.0, improved.1),
        Gate::new("all_finite", finite, "every number is finite".into()),
    ]
}
