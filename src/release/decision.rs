//! The decision whether a parameter set may be released.

use crate::release::gate_facts::Facts;
use crate::release::gates::gates;
use crate::wire::release::Gate;
use crate::wire::report_shape::Evidence;

/// Results of the gates.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    /// Every gate, passed or not.
    pub gates: Vec<Gate>,
    /// Strength of the verification.
    pub evidence: Evidence,
    /// The tool's largest predicted uncertainty over the workspace, mm.
    pub uncertainty_mm: Option<f64>,
}

impl Decision {
    /// Whether every gate is passed.
    pub fn is_releasable(&self) -> bool {
        self.failed().next().is_none()
    }

    /// Number of gates that passed.
    pub fn n_passed(&self) -> usize {
        self.gates.len() - self.n_failed()
    }

    /// Number of gates that failed.
    pub fn n_failed(&self) -> usize {
        self.failed().count()
    }

    /// The gates that failed.
    pub fn failed(&self) -> impl Iterator<Item = &Gate> {
        self.gates.iter().filter(|gate| !gate.passed)
    }
}

/// Runs the gates.
pub fn decide(facts: &Facts<'_>) -> Decision {
    Decision {
        gates: gates(facts),
        evidence: facts.stored.evidence(),
        uncertainty_mm: facts.stored.identification.uncertainty_mm,
    }
}
