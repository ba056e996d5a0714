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
                q_rad: q_rad.to_vec(),
                position_mm: Vector3::zeros(),
                target,
                weight,
                whitening: None,
                rotation: None,
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

fn displacements(
    model: &KinematicModel,
    q_rad: &[f64],
    target: usize,
    gravity: &[Vector3<f64>],
    reach_mm: f64,
) -> Vec<Vector3<f64>> {
    let mut chain: Vec<IsometryMatrix3<f64>> = Vec::with_capacity(q_rad.len());
    let mut t_base_link = IsometryMatrix3::identity();
    for (link, q) in model.links.iter().zip(q_rad) {
        t_base_link *= t_previous_link(link, *q);
        chain.push(t_base_link);
    }
    let tip = t_base_link.rotation * model.targets_mm[target] + t_base_link.translation.vector;
    let origins: Vec<Vector3<f64>> = chain
        .iter()
        .map(|t| t.translation.vector)
        .chain([tip])
        .collect();
    let mut displacements = Vec::with_capacity(count(q_rad.len(), gravity.len()));
    for (joint, t_base_joint) in chain.iter().enumerate() {
        let axis: Vector3<f64> = t_base_joint.rotation.matrix().column(2).into();
        // the target's displacement per rad of this joint, in the measuring frame
        let lever = model.t_instrument_base.rotation * axis.cross(&(tip - origins[joint]));
        for g in gravity {
            displacements.extend(
                origins[joint + 1..]
                    .iter()
                    .map(|o| lever * (axis.dot(&(o - origins[joint]).cross(g)) / reach_mm)),
            );
        }
        let (s, c) = libm::sincos(q_rad[joint]);
        displacements.extend([lever * s, lever * c]);
    }
    displacements
}

/// Rotation of the flange per rad of each feature, in the measuring frame, in the order of [`features`].
fn turns_of_joints(
    model: &KinematicModel,
    q_rad: &[f64],
    target_mm: &Vector3<f64>,
    gravity: &[Vector3<f64>],
    reach_mm: f64,
) -> Vec<Vector3<f64>> {
    let mut t_base_link = IsometryMatrix3::identity();
    let mut origins = Vec::with_capacity(q_rad.len() + 1);
    let mut axes = Vec::with_capacity(q_rad.len());
    for (link, q) in model.links.iter().zip(q_rad) {
        t_base_link *= t_previous_link(link, *q);
        origins.push(t_base_link.translation.vector);
        axes.push(Vector3::from(t_base_link.rotation.matrix().column(2)));
    }
    origins.push(t_base_link.rotation * target_mm + t_base_link.translation.vector);
    let mut turns = Vec::with_capacity(count(q_rad.len(), gravity.len()));
    for (joint, axis) in axes.iter().enumerate() {
        let turn = model.t_instrument_base.rotation * axis;
        for g in gravity {
            let moment = |o: &Vector3<f64>| axis.dot(&(o - origins[joint]).cross(g)) / reach_mm;
            turns.extend(origins[joint + 1..].iter().map(|o| turn * moment(o)));
        }
        let (s, c) = libm::sincos(q_rad[joint]);
        turns.extend([turn * s, turn * c]);
    }
    turns
}

/// The directions of gravity in the base frame: that of the mounting, or three axes if it is unknown.
pub fn gravity_directions(known: Option<&Vector3<f64>>) -> Vec<Vector3<f64>> {
    match known {
        Some(direction) => vec![*direction],
        None => (0..3).map(|axis| Vector3::ith(axis, 1.0)).collect(),
    }
}
