//! Misfit: effects that the fitted parameters cannot describe, as a random function of the joint values. It covers joints that deflect under gravity,
//! joints with eccentric transmissions, and held parameters of a larger model. Nothing is identified here. The misfit gives the robot's errors at
//! poses that were not measured, and the resulting errors of the fitted parameters.

use crate::identification::KinematicModel;
use crate::identification::identifiability::{PRIOR_ANGLE_RAD, prior_scales};
use crate::identification::objective::{Observation, weighted_jacobian};
use crate::identification::parameters::Parameter;
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::reach_mm;
use nalgebra::{DMatrix, IsometryMatrix3, Vector3};

/// The sources of a misfit.
#[derive(Clone, Debug, PartialEq)]
pub struct Misfit {
    /// Directions of gravity, in the base frame.
    pub gravity: Vec<Vector3<f64>>,
    /// Parameters of the complete model that are not fitted.
    pub held: Vec<Parameter>,
}

impl Misfit {
    /// The features at some poses, one column each: those of [`features`], and the effects of the held parameters. Lengths and angles are scaled by
    /// the ratio of their errors in new robots.
    pub fn features<'a>(
        &self,
        model: &KinematicModel,
        poses: impl ExactSizeIterator<Item = (&'a [f64], usize, f64)> + Clone,
    ) -> DMatrix<f64> {
        let of_joints = features(model, poses.clone(), &self.gravity);
        if self.held.is_empty() {
            return of_joints;
        }
        let poses: Vec<Observation> = poses
            .map(|(q_rad, target, weight)| Observation {
                weight,
                ..Observation::at(q_rad.to_vec(), Vector3::zeros(), target)
            })
            .collect();
        let mut of_held = weighted_jacobian(model, &self.held, &poses, &Vector3::zeros());
        let scales = prior_scales(&self.held, reach_mm(&model.links));
        for (mut column, scale) in of_held.column_iter_mut().zip(scales) {
            column *= scale / PRIOR_ANGLE_RAD;
        }
        let n_of_joints = of_joints.ncols();
        let mut all = of_joints.resize_horizontally(n_of_joints + self.held.len(), 0.0);
        all.columns_mut(n_of_joints, self.held.len())
            .copy_from(&of_held);
        all
    }
}

impl Misfit {
    /// As [`Self::features`], for the three rotation rows of a measured pose.
    pub fn turns(&self, model: &KinematicModel, pose: &Observation) -> DMatrix<f64> {
        let n_of_joints = count(model.links.len(), self.gravity.len());
        let mut all = DMatrix::zeros(3, n_of_joints + self.held.len());
        let measured = pose.rotation.as_ref();
        let Some((measured, predicted)) = measured.zip(model.rotation(&pose.q_rad, pose.target))
        else {
            return all;
        };
        let root_mm = pose.weight.sqrt() * measured.mm_per_rad;
        let reach_mm = reach_mm(&model.links).max(f64::MIN_POSITIVE);
        let target = model.targets_mm[pose.target];
        let turned = turns_of_joints(model, &pose.q_rad, &target, &self.gravity, reach_mm);
        for (column, turn) in turned.into_iter().enumerate() {
            let row = predicted.inverse_transform_vector(&turn) * root_mm;
            all.column_mut(column).copy_from(&row);
        }
        if !self.held.is_empty() {
            let here = std::slice::from_ref(pose);
            let of_held = weighted_jacobian(model, &self.held, here, &Vector3::zeros());
            let scales = prior_scales(&self.held, reach_mm);
            for (k, scale) in scales.into_iter().enumerate() {
                let column = of_held.fixed_view::<3, 1>(3, k) * (scale / PRIOR_ANGLE_RAD);
                all.column_mut(n_of_joints + k).copy_from(&column);
            }
        }
        all
    }
}

/// The features at some poses: displacement of the target, mm, per rad of each feature, times sqrt(weight); 3·N × m.
///
/// Every joint rotates by a sum of features. These are the moments about its axis of unit masses at each later link's origin and at the target, under
/// each direction of `gravity` (divided by the arm's reach, so that a feature is at most about 1), and the sine and cosine of the joint's own value.
pub fn features<'a>(
    model: &KinematicModel,
    poses: impl ExactSizeIterator<Item = (&'a [f64], usize, f64)>,
    gravity: &[Vector3<f64>],
) -> DMatrix<f64> {
    let reach_mm = reach_mm(&model.links).max(f64::MIN_POSITIVE);
    let n_features = count(model.links.len(), gravity.len());
    let mut all = DMatrix::zeros(3 * poses.len(), n_features);
    for (row, (q_rad, target, weight)) in poses.enumerate() {
        let columns = displacements(model, q_rad, target, gravity, reach_mm);
        for (column, displacement) in columns.into_iter().enumerate() {
            for axis in 0..3 {
                all[(3 * row + axis, column)] = weight.sqrt() * displacement[axis];
            }
        }
    }
    all
}

/// Number of features of an arm: each joint has one per later mass and gravity direction, and two harmonics.
fn count(n_links: usize, n_gravity: usize) -> usize {
    n_gravity * n_links * (n_links + 1) / 2 + 2 * n_links
}

/// Displacement of the target per rad of each feature, in the measuring frame, mm.
fn displacements(
    model: &KinematicModel,
    q_rad: &[f64],
    target: usize,
    gravity: &[Vector3<f64>],
    reach_mm: f64,
) -> Vec<Vector3<f64>> {
    let target_mm = &model.targets_mm[target];
    of_joints(model, (q_rad, target_mm), gravity, reach_mm, |axis, arm| {
        axis.cross(arm)
    })
}

/// Rotation of the flange per rad of each feature, in the measuring frame, in the order of [`features`].
fn turns_of_joints(
    model: &KinematicModel,
    q_rad: &[f64],
    target_mm: &Vector3<f64>,
    gravity: &[Vector3<f64>],
    reach_mm: f64,
) -> Vec<Vector3<f64>> {
    of_joints(model, (q_rad, target_mm), gravity, reach_mm, |axis, _| {
        *axis
    })
}

/// The effect of each feature, in the measuring frame. `per_rad` has the effect of one rad of a joint in the base frame, from its axis and the vector
/// from its origin to the target.
fn of_joints(
    model: &KinematicModel,
    (q_rad, target_mm): (&[f64], &Vector3<f64>),
    gravity: &[Vector3<f64>],
    reach_mm: f64,
    per_rad: impl Fn(&Vector3<f64>, &Vector3<f64>) -> Vector3<f64>,
) -> Vec<Vector3<f64>> {
    let mut t_base_link = IsometryMatrix3::identity();
    let mut origins = Vec::with_capacity(q_rad.len() + 1);
    let mut axes = Vec::with_capacity(q_rad.len());
    for (link, q) in model.links.iter().zip(q_rad) {
        t_base_link *= t_previous_link(link, *q);
        origins.push(t_base_link.translation.vector);
        axes.push(Vector3::from(t_base_link.rotation.matrix().column(2)));
    }
    let tip = t_base_link.rotation * target_mm + t_base_link.translation.vector;
    origins.push(tip);
    let mut effects = Vec::with_capacity(count(q_rad.len(), gravity.len()));
    for (joint, axis) in axes.iter().enumerate() {
        let of_joint = per_rad(axis, &(tip - origins[joint]));
        let effect = model.t_instrument_base.rotation * of_joint;
        for g in gravity {
            let moment = |o: &Vector3<f64>| axis.dot(&(o - origins[joint]).cross(g)) / reach_mm;
            effects.extend(origins[joint + 1..].iter().map(|o| effect * moment(o)));
        }
        let (s, c) = libm::sincos(q_rad[joint]);
        effects.extend([effect * s, effect * c]);
    }
    effects
}

/// The directions of gravity in the base frame: that of the mounting, or three axes if it is unknown.
pub fn gravity_directions(known: Option<&Vector3<f64>>) -> Vec<Vector3<f64>> {
    match known {
        Some(direction) => vec![*direction],
        None => (0..3).map(|axis| Vector3::ith(axis, 1.0)).collect(),
    }
}
