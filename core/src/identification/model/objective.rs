//! The cost F and its residuals [Gao 2018, eq. 8, 11], with the identification Jacobian.

use crate::identification::KinematicModel;
use crate::identification::model::parameters::{Parameter, left_jacobian};
use crate::identification::model::pose_rows::{
    MeasuredRotation, MovedBy, rotation_residual_rad, rows_by_turn,
};
use crate::kinematics::position_jacobian;
use nalgebra::{DMatrix, DVector, IsometryMatrix3, Matrix3, Point3, Rotation3, Vector3};
use std::collections::BTreeSet;

/// One measured pose in the form for fitting: joint values in the model's convention, position in the measuring frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Joint values of the model, rad.
    pub q_rad: Vec<f64>,
    /// Measured position, mm.
    pub position_mm: Vector3<f64>,
    /// Index of the target.
    pub target: usize,
    /// Weight of the squared residual; 1 unless the points carry their own uncertainties.
    pub weight: f64,
    /// W of the rows sqrt(weight) · W · (measured − predicted), if the position's noise differs between directions. Wᵀ·W is the inverse of its
    /// covariance times the mean of its three variances. `None` if all directions have the same noise, W = 1.
    pub whitening: Option<Matrix3<f64>>,
    /// Rotation of the target, for a pose.
    pub rotation: Option<MeasuredRotation>,
    /// Station of the instrument, from 0; `None` for the reference station. The measured values are already in the reference station's frame.
    pub station: Option<usize>,
}

impl Observation {
    /// A position of weight 1.
    pub fn at(q_rad: Vec<f64>, position_mm: Vector3<f64>, target: usize) -> Self {
        Self {
            q_rad,
            position_mm,
            target,
            weight: 1.0,
            whitening: None,
            rotation: None,
            station: None,
        }
    }

    /// The same observation without its rotation.
    pub fn position_alone(&self) -> Self {
        Self {
            rotation: None,
            ..self.clone()
        }
    }

    /// The same observation with isotropic noise.
    pub fn with_even_noise(&self) -> Self {
        Self {
            whitening: None,
            ..self.clone()
        }
    }

    /// The same observation in another frame.
    pub fn moved(&self, motion: &IsometryMatrix3<f64>) -> Self {
        let mut moved = self.clone();
        moved.position_mm = (motion * Point3::from(self.position_mm)).coords;
        moved.whitening = self
            .whitening
            .map(|w| w * motion.rotation.matrix().transpose());
        if let Some(measured) = &mut moved.rotation {
            measured.rotation = motion.rotation * measured.rotation;
        }
        moved
    }

    /// The same observation with its station moved. `motions` has the motion of each station except the reference; a station without one stays.
    pub fn with_station_moved(&self, motions: &[IsometryMatrix3<f64>]) -> Self {
        match self.station.and_then(|station| motions.get(station)) {
            Some(motion) => self.moved(motion),
            None => self.clone(),
        }
    }

    /// W·v of a vector in the measuring frame.
    pub fn whitened(&self, v: Vector3<f64>) -> Vector3<f64> {
        match &self.whitening {
            Some(w) => w * v,
            None => v,
        }
    }

    /// Matrix that transforms the rotation rows of a pose to an addition to its position rows. It is needed if the position noise is
    /// independent of the rotation noise at a lever ℓ and not at the target. At the lever, the position residual is e + R·(w × ℓ) = e −
    /// R·[ℓ]×·w, with w the rotation residual and R the measured rotation. `None` if the lever is zero.
    ///
    /// Example: a camera measures a board at c ± δc, rotated by R⁻¹. Inverted, the position is −R·c. Its error −R·δc is the error at the
    /// board, so ℓ = c.
    pub fn coupling(&self) -> Option<Matrix3<f64>> {
        let measured = self.rotation.as_ref();
        let measured = measured.filter(|measured| measured.lever_mm != Vector3::zeros())?;
        let lever = measured.lever_mm.cross_matrix() * (-1.0 / measured.mm_per_rad);
        let coupling = measured.rotation.matrix() * lever;
        Some(self.whitening.map_or(coupling, |w| w * coupling))
    }

    /// Number of rows in a model: three for a position, six for a pose.
    pub fn n_rows(&self, model: &KinematicModel) -> usize {
        let is_pose = self.rotation.is_some() && self.target < model.target_rotations.len();
        if is_pose { 6 } else { 3 }
    }
}

/// The observations with their stations moved ([`Observation::with_station_moved`]).
pub fn with_stations_moved(
    observations: &[Observation],
    motions: &[IsometryMatrix3<f64>],
) -> Vec<Observation> {
    let all = observations.iter();
    all.map(|o| o.with_station_moved(motions)).collect()
}

/// Motions of stations one after the other. An empty list has no motion.
pub fn composed_motions(
    first: &[IsometryMatrix3<f64>],
    second: &[IsometryMatrix3<f64>],
) -> Vec<IsometryMatrix3<f64>> {
    match (first, second) {
        ([], only) | (only, []) => only.to_vec(),
        _ => second.iter().zip(first).map(|(b, a)| b * a).collect(),
    }
}

/// The observations with a weight.
pub fn with_weight(observations: &[Observation]) -> Vec<Observation> {
    let weighted = observations.iter().filter(|o| o.weight > 0.0);
    weighted.cloned().collect()
}

/// Targets with measured poses, in order.
pub fn posed_targets(observations: &[Observation]) -> Vec<usize> {
    let posed = observations.iter().filter(|o| o.rotation.is_some());
    let targets: BTreeSet<usize> = posed.map(|o| o.target).collect();
    targets.into_iter().collect()
}

/// residual = measured − predicted of each observation, mm, unweighted: of the target, or of the point at a pose's lever.
pub fn residuals(model: &KinematicModel, observations: &[Observation]) -> Vec<Vector3<f64>> {
    let residual = |o: &Observation| residual_mm(model, o);
    observations.iter().map(residual).collect()
}

/// As [`residuals`], of one observation.
pub fn residual_mm(model: &KinematicModel, o: &Observation) -> Vector3<f64> {
    let predicted = model.rotation(&o.q_rad, o.target);
    let left = o.position_mm - model.position(&o.q_rad, o.target);
    residual_at_lever(left, predicted.as_ref(), o)
}

/// Root mean square of [`residuals`], mm; 0 without observations.
pub fn rms_mm(model: &KinematicModel, observations: &[Observation]) -> f64 {
    let all = residuals(model, observations);
    let sum: f64 = all.iter().map(Vector3::norm_squared).sum();
    (sum / all.len().max(1) as f64).sqrt()
}

/// Position residual of a pose at its lever, from that of its target, mm.
pub fn residual_at_lever(
    left: Vector3<f64>,
    predicted: Option<&Rotation3<f64>>,
    o: &Observation,
) -> Vector3<f64> {
    let posed = o.rotation.as_ref().zip(predicted);
    match posed.filter(|(measured, _)| measured.lever_mm != Vector3::zeros()) {
        Some((measured, predicted)) => {
            let turn = rotation_residual_rad(predicted, measured);
            left + measured.rotation * turn.cross(&measured.lever_mm)
        }
        None => left,
    }
}

/// Rotation residual of a measured pose, times the length by which rotation rows are weighed, mm; `None` for a position.
fn rotation_rows_mm(model: &KinematicModel, o: &Observation) -> Option<Vector3<f64>> {
    let measured = o.rotation.as_ref()?;
    let predicted = model.rotation(&o.q_rad, o.target)?;
    Some(rotation_residual_rad(&predicted, measured) * measured.mm_per_rad)
}

/// Σ |row|² of an observation of weight 1, mm².
pub fn squared_rows_mm2(model: &KinematicModel, o: &Observation) -> f64 {
    let of_position = o.whitened(residual_mm(model, o)).norm_squared();
    of_position + rotation_rows_mm(model, o).map_or(0.0, |rows| rows.norm_squared())
}

/// F = Σ weight · |residual|², mm² [Gao 2018, eq. 8, 11], with whitened residuals if directions differ. For poses it includes the rotation rows.
pub fn cost(model: &KinematicModel, observations: &[Observation]) -> f64 {
    observations
        .iter()
        .map(|o| o.weight * squared_rows_mm2(model, o))
        .sum()
}

/// sqrt(weight) · W · residual: three rows per position, six per pose.
pub fn weighted_residuals(model: &KinematicModel, observations: &[Observation]) -> DVector<f64> {
    let mut rows = Vec::with_capacity(3 * observations.len());
    for (o, residual) in observations.iter().zip(residuals(model, observations)) {
        let root = o.weight.sqrt();
        rows.extend((o.whitened(residual) * root).iter());
        if let Some(turn) = rotation_rows_mm(model, o) {
            rows.extend((turn * root).iter());
        }
    }
    DVector::from_vec(rows)
}

/// The identification Jacobian: sqrt(weight) · W · ∂(predicted position)/∂(parameter), 3·N × p, in mm per mm or rad. The derivative of the residual
/// is its negative. `base_rotation_rad` is the rotation vector between `model`'s base and the reference of the deviations (zero at the reference).
/// For poses, the rotation rows follow those of the position; their targets have the reference's rotation.
pub fn weighted_jacobian(
    model: &KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
    base_rotation_rad: &Vector3<f64>,
) -> DMatrix<f64> {
    let n_rows = observations.iter().map(|o| o.n_rows(model)).sum();
    let mut jacobian = DMatrix::zeros(n_rows, parameters.len());
    let left = left_jacobian(base_rotation_rad);
    let mut row = 0;
    for observation in observations {
        let target = &model.targets_mm[observation.target];
        let at = position_jacobian(
            &model.t_instrument_base,
            &model.links,
            &observation.q_rad,
            target,
        );
        let by = MovedBy::new(&at, left, Matrix3::identity(), observation.target);
        let root = observation.weight.sqrt();
        let measured = observation.rotation.as_ref();
        let pose = measured.zip(model.rotation(&observation.q_rad, observation.target));
        let by_turn = pose.map(|(measured, predicted)| {
            rows_by_turn(&predicted, measured) * (root * measured.mm_per_rad)
        });
        let coupling = observation.coupling();
        for (column, parameter) in parameters.iter().enumerate() {
            let moved = by.parameter(parameter);
            let mut shift = observation.whitened(moved.shift) * root;
            let turn = by_turn.map(|by_turn| by_turn * moved.turn);
            if let Some((coupling, turn)) = coupling.as_ref().zip(turn) {
                shift += coupling * turn;
            }
            for axis in 0..3 {
                jacobian[(row + axis, column)] = shift[axis];
                if let Some(turn) = turn {
                    jacobian[(row + 3 + axis, column)] = turn[axis];
                }
            }
        }
        row += observation.n_rows(model);
    }
    jacobian
}
