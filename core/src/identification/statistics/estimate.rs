//! The estimate of one session: the identified robot with its errors, which predictions, later sessions and checks use.

use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::{CorrectedModel, IdentifiedRobot};
use crate::identification::least_squares::evidence::Noise;
use crate::identification::model::corrected_pose::CorrectedPose;
use crate::identification::model::correction_terms::Term;
use crate::identification::model::parameters::Parameter;
use crate::identification::model::pose_rows::MovedBy;
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::kinematics::Mounting;
use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};

/// The estimate of one session.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// The identified model.
    pub model: KinematicModel,
    /// Its uncertainty.
    pub uncertainty: Uncertainty,
    /// Errors of the robot with corrections, if some were kept and their errors are known.
    pub corrected: Option<CorrectedErrors>,
    /// Noise of the session about the model.
    pub noise: Noise,
}

impl Estimate {
    /// The same estimate with the numbers of two targets exchanged. A number that has no target gets one.
    pub(super) fn with_exchanged_targets(&self, a: usize, b: usize) -> Self {
        let mut estimate = self.clone();
        let model = &mut estimate.model;
        let n_targets = model.targets_mm.len().max(a + 1).max(b + 1);
        model.targets_mm.resize(n_targets, Vector3::zeros());
        model.targets_mm.swap(a, b);
        if !model.target_rotations.is_empty() {
            model
                .target_rotations
                .resize(n_targets, Rotation3::identity());
            model.target_rotations.swap(a, b);
        }
        let exchanged = |target: usize| match target {
            _ if target == a => b,
            _ if target == b => a,
            _ => target,
        };
        for parameter in &mut estimate.parameters {
            match parameter {
                Parameter::Target(target, _) | Parameter::TargetRotation(target, _) => {
                    *target = exchanged(*target);
                }
                _ => {}
            }
        }
        estimate
    }

    /// Standard deviation (3-D: the root of the sum of three variances) of a target position predicted by `robot`, mm.
    pub fn predicted_std_mm(&self, robot: &IdentifiedRobot, q_rad: &[f64], target: usize) -> f64 {
        let parameters = &self.parameters;
        faded(self, robot, q_rad, |with_corrections| {
            let corrected = self.corrected.as_ref().zip(robot.corrected.as_ref());
            match corrected.filter(|_| with_corrections) {
                Some((errors, model)) => errors.position_std_mm(model, parameters, q_rad, target),
                None => (self.uncertainty).position_std_mm(&self.model, parameters, q_rad, target),
            }
        })
    }
}

/// The standard deviation at a pose where the corrections have a weight between 0 and 1. It is computed from the standard deviations with
/// corrections (`std_mm(true)`) and of the links alone (`std_mm(false)`): that of a weighted mean of two predictions is at most the
/// weighted mean of theirs.
pub fn faded(
    estimate: &Estimate,
    robot: &IdentifiedRobot,
    q_rad: &[f64],
    std_mm: impl Fn(bool) -> f64,
) -> f64 {
    let weight = match estimate.corrected {
        Some(_) => robot.weight(q_rad),
        None => 0.0,
    };
    let part = |weight: f64, with_corrections| match weight > 0.0 {
        true => weight * std_mm(with_corrections),
        false => 0.0,
    };
    part(weight, true) + part(1.0 - weight, false)
}

/// Errors of links and corrections that were identified together.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectedErrors {
    /// The terms of the corrections.
    pub terms: Vec<Term>,
    /// The direction of gravity that was used.
    pub mounting: Mounting,
    /// Errors of the estimate's parameters, of the terms, and of the features of the remaining misfit.
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
        let CorrectedModel {
            model, corrections, ..
        } = corrected;
        let pose = CorrectedPose::new(model, corrections, q_rad, target);
        let by = MovedBy::new(&pose.at, Matrix3::identity(), Matrix3::identity(), target);
        let columns: Vec<Vector3<f64>> = parameters.iter().map(|p| by.parameter(p).shift).collect();
        let by_parameter = DMatrix::from_fn(3, columns.len(), |axis, j| columns[j][axis]);
        let of_term = |term| pose.by_term(term, &self.mounting).shift;
        let columns: Vec<Vector3<f64>> = self.terms.iter().map(of_term).collect();
        let by_term = DMatrix::from_fn(3, columns.len(), |axis, j| columns[j][axis]);
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
