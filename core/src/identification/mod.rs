//! Identification of parameters from measured points: parameters, scales, cost, and search methods.

pub mod corrections;
pub mod least_squares;
pub mod model;
pub mod screening;
pub mod search;
pub mod statistics;

pub use model::{Model, Preset};

use crate::kinematics::model::USUAL_REACH_MM;
use crate::kinematics::{Link, forward_kinematics, t_base_flange};
use nalgebra::{IsometryMatrix3, Rotation3, Vector3};

/// A measured robot: base in the measuring frame, links, and targets.
#[derive(Clone, Debug, PartialEq)]
pub struct KinematicModel {
    /// Base in the measuring frame, mm; identity if positions are given in the base frame.
    pub t_instrument_base: IsometryMatrix3<f64>,
    /// Links 1..n.
    pub links: Vec<Link>,
    /// Target offsets in the flange frame, mm.
    pub targets_mm: Vec<Vector3<f64>>,
    /// Rotation of each target in the flange frame; empty unless poses are measured. A model without them predicts positions only, and of a
    /// measured pose only the position is used.
    pub target_rotations: Vec<Rotation3<f64>>,
}

impl KinematicModel {
    /// A model with the base at the measuring frame and the targets at the flange.
    pub fn nominal(links: &[Link], n_targets: usize) -> Self {
        Self {
            t_instrument_base: IsometryMatrix3::identity(),
            links: links.to_vec(),
            targets_mm: vec![Vector3::zeros(); n_targets],
            target_rotations: vec![],
        }
    }

    /// Length of the arm along its links, mm, but at least the length of its longest target, for a robot whose links have no length.
    pub fn reach_mm(&self) -> f64 {
        let of_links: f64 = self.links.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum();
        let of_targets = self.targets_mm.iter().map(Vector3::norm);
        match of_targets.fold(of_links, f64::max) {
            0.0 => USUAL_REACH_MM,
            reach_mm => reach_mm,
        }
    }

    /// Position of a target in the measuring frame, mm [Gao 2018, eq. 1; the measuring frame is the paper's world frame].
    pub fn position(&self, q_rad: &[f64], target: usize) -> Vector3<f64> {
        let p = forward_kinematics(&self.links, q_rad, &self.targets_mm[target]);
        self.t_instrument_base.rotation * p + self.t_instrument_base.translation.vector
    }

    /// Rotation of a target in the measuring frame; `None` if the model has no rotation of the target in the flange frame.
    pub fn rotation(&self, q_rad: &[f64], target: usize) -> Option<Rotation3<f64>> {
        let of_target = self.target_rotations.get(target)?;
        let flange = t_base_flange(&self.links, q_rad);
        Some(self.t_instrument_base.rotation * flange.rotation * of_target)
    }
}

/// The network of [Gao 2018, section 3.2], stored per robot between calibrations. Its inputs and outputs are deviations of link parameters in
/// physical units (mm, rad), not base poses or search coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedNetwork {
    /// Names of inputs and outputs, in order (`a_1`, `alpha_1`, …).
    pub parameter_names: Vec<String>,
    /// Scale of each input and output: the half-width of the search box, mm or rad.
    pub scale: Vec<f64>,
    /// Hidden layer: n_hidden × n_inputs weights, row-major.
    pub hidden_weights: Vec<f64>,
    /// Hidden thresholds T_j, n_hidden.
    pub hidden_thresholds: Vec<f64>,
    /// Output layer: n_outputs × n_hidden weights, row-major.
    pub output_weights: Vec<f64>,
    /// Output thresholds, n_outputs.
    pub output_thresholds: Vec<f64>,
    /// The optimum that it was trained on: deviations from nominal, mm or rad, in the order of the names.
    pub answer: Vec<f64>,
    /// Mean squared training error, in scaled units.
    pub training_error: f64,
    /// Mean squared error on the held-out particles, in scaled units.
    pub validation_error: f64,
    /// Model that it belongs to.
    pub model: Model,
    /// Preset that it belongs to.
    pub preset: Preset,
}
