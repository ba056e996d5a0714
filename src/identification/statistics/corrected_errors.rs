//! Errors of a robot with corrections.

use crate::identification::corrections::corrected::CorrectedModel;
use crate::identification::corrections::{Term, linearise};
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::Parameter;
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::kinematics::Mounting;
use nalgebra::{DMatrix, Vector3};

/// Errors of links and corrections that were identified together.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectedErrors {
    /// The terms of the corrections.
    pub terms: Vec<Term>,
    /// Gravity as it was known.
    pub mounting: Mounting,
    /// Errors of the estimate's parameters, of the terms, and of the features of what both leave.
    pub uncertainty: Uncertainty,
}

impl CorrectedErrors {
    /// Displacement of a target by the terms, mm per unit of each: 3 × t, in the measuring frame.
    pub fn by_terms_mm(
        &self,
        corrected: &CorrectedModel,
        q_rad: &[f64],
        target: usize,
    ) -> DMatrix<f64> {
        let (_, by_term) = self.derivatives_mm(corrected, &[], (q_rad, target));
        by_term
    }

    /// Derivatives of a target's position by parameters and by the terms.
    fn derivatives_mm(
        &self,
        corrected: &CorrectedModel,
        parameters: &[Parameter],
        (q_rad, target): (&[f64], usize),
    ) -> (DMatrix<f64>, DMatrix<f64>) {
        let here = [Observation::at(q_rad.to_vec(), Vector3::zeros(), target)];
        let unknowns = (parameters, self.terms.as_slice());
        let CorrectedModel {
            model, corrections, ..
        } = corrected;
        let (_, by_parameter, by_term) =
            linearise(model, corrections, &self.mounting, unknowns, &here);
        (by_parameter, by_term)
    }

    /// Standard deviation (3-D) of the target position predicted by links and corrections, mm.
    pub fn position_std_mm(
        &self,
        corrected: &CorrectedModel,
        parameters: &[Parameter],
        q_rad: &[f64],
        target: usize,
    ) -> f64 {
        let (by_parameter, by_term) = self.derivatives_mm(corrected, parameters, (q_rad, target));
        let pose = [(q_rad, target, 1.0)].into_iter();
        let by_feature = self.uncertainty.features.features(&corrected.model, pose);
        self.uncertainty
            .displacements_mm([&by_parameter, &by_term, &by_feature])
            .norm()
    }
}
