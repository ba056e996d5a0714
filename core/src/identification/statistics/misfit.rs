//! Misfit: effects that the fitted parameters cannot describe, as a random function of the joint values. It covers joints that deflect under gravity,
//! joints with eccentric transmissions, wrists whose joints follow each other, and held parameters of a larger model. Nothing is identified here. The
//! misfit gives the robot's errors at poses that were not measured, and the resulting errors of the fitted parameters.

use crate::identification::KinematicModel;
use crate::identification::model::identifiability::{PRIOR_ANGLE_RAD, prior_scales};
use crate::identification::model::objective::{Observation, weighted_jacobian};
use crate::identification::model::parameters::Parameter;
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::reach_mm;
use nalgebra::{DMatrix, IsometryMatrix3, Vector3};
use std::f64::consts::PI;

/// Orders of the harmonics that a misfit covers. Harmonics of higher orders look like noise.
pub const HARMONICS: [usize; 4] = [1, 2, 3, 4];
/// A joint may follow each of this many joints before it.
const FOLLOWED: usize = 2;
/// Minimum range of a joint, rad, for being followed. If it does not move, the effect is that of the other joint's zero.
const MIN_FOLLOWED_RANGE_RAD: f64 = 0.2;

/// A joint that rotates by a share of another joint's value, in addition to its own: wrist gears that the controller does not compensate.
/// Joints count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Following {
    /// The joint.
    pub joint: usize,
    /// The joint that it follows.
    pub followed: usize,
}

impl Following {
    /// Each joint of an arm with each of the two joints before it, if that one moves between the observations.
    pub fn of_arm(n_links: usize, observations: &[Observation]) -> Vec<Self> {
        let moves = |joint: &usize| {
            let values = observations.iter().map(|o| o.q_rad[*joint]);
            let least = values.clone().fold(f64::INFINITY, f64::min);
            values.fold(f64::NEG_INFINITY, f64::max) - least >= MIN_FOLLOWED_RANGE_RAD
        };
        let of_joint = |joint: usize| {
            let before = joint.saturating_sub(FOLLOWED)..joint;
            before
                .filter(&moves)
                .map(move |followed| Self { joint, followed })
        };
        (0..n_links).flat_map(of_joint).collect()
    }
}

/// The sources of a misfit.
#[derive(Clone, Debug, PartialEq)]
pub struct Misfit {
    /// Joints that follow other joints. Their features come first.
    pub followings: Vec<Following>,
    /// Orders of harmonics of each joint's own value. The features of orders above 1 come second.
    pub harmonics: Vec<usize>,
    /// Directions of gravity, in the base frame.
    pub gravity: Vec<Vector3<f64>>,
    /// Parameters of the complete model that are not fitted.
    pub held: Vec<Parameter>,
}

impl Misfit {
    /// The features at some poses: displacement of the target, mm, per rad of each feature, times sqrt(weight); 3·N × m.
    ///
    /// First come the joints that follow others: q/π of the followed joint. Then every joint rotates by the harmonics sin kq/k and cos kq/k
    /// of its own value, for orders above 1. Then every joint rotates by moments about its axis, of unit masses at each later link's origin
    /// and at the target, under each direction of gravity (divided by the arm's reach, so that a feature is at most about 1); and by the
    /// first harmonics. The held parameters come last, with lengths and angles scaled by the ratio of their errors in new robots.
    pub fn features<'a>(
        &self,
        model: &KinematicModel,
        poses: impl ExactSizeIterator<Item = (&'a [f64], usize, f64)> + Clone,
    ) -> DMatrix<f64> {
        let of_joints = self.of_joints(model, poses.clone());
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

    /// As [`Self::features`], for the three rotation rows of a measured pose.
    pub fn turns(&self, model: &KinematicModel, pose: &Observation) -> DMatrix<f64> {
        let n_of_joints = self.n_of_joints(model.links.len());
        let mut all = DMatrix::zeros(3, n_of_joints + self.held.len());
        let measured = pose.rotation.as_ref();
        let Some((measured, predicted)) = measured.zip(model.rotation(&pose.q_rad, pose.target))
        else {
            return all;
        };
        let root_mm = pose.weight.sqrt() * measured.mm_per_rad;
        let reach_mm = reach_mm(&model.links).max(f64::MIN_POSITIVE);
        let target = model.targets_mm[pose.target];
        // A rotation of a joint rotates the flange about its axis.
        let turned = self.effects(model, (&pose.q_rad, &target), reach_mm, |axis, _| *axis);
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

    /// The features of the joints at some poses, without those of held parameters.
    fn of_joints<'a>(
        &self,
        model: &KinematicModel,
        poses: impl ExactSizeIterator<Item = (&'a [f64], usize, f64)>,
    ) -> DMatrix<f64> {
        let reach_mm = reach_mm(&model.links).max(f64::MIN_POSITIVE);
        let mut all = DMatrix::zeros(3 * poses.len(), self.n_of_joints(model.links.len()));
        for (row, (q_rad, target, weight)) in poses.enumerate() {
            let at = (q_rad, &model.targets_mm[target]);
            let displacements = self.effects(model, at, reach_mm, |axis, arm| axis.cross(arm));
            for (column, displacement) in displacements.into_iter().enumerate() {
                for axis in 0..3 {
                    all[(3 * row + axis, column)] = weight.sqrt() * displacement[axis];
                }
            }
        }
        all
    }

    /// Number of features of the joints.
    fn n_of_joints(&self, n_links: usize) -> usize {
        let n_masses = self.gravity.len() * n_links * (n_links + 1) / 2;
        self.followings.len() + n_masses + 2 * self.harmonics.len() * n_links
    }

    /// Number of features that are harmonics of higher orders than the first.
    pub fn n_higher_harmonics(&self, n_links: usize) -> usize {
        2 * n_links * self.higher_orders().count()
    }

    fn higher_orders(&self) -> impl Iterator<Item = usize> {
        self.harmonics.iter().copied().filter(|k| *k > 1)
    }

    /// True if `other` has the same harmonics of higher orders than the first.
    pub fn has_same_higher_harmonics(&self, other: &Self) -> bool {
        self.higher_orders().eq(other.higher_orders())
    }

    /// True if all other sources are the same, apart from joints that follow others.
    pub fn has_same_usual_sources(&self, other: &Self) -> bool {
        let has_first = |of: &Self| of.harmonics.contains(&1);
        has_first(self) == has_first(other)
            && self.gravity == other.gravity
            && self.held == other.held
    }

    /// The effect of each feature of the joints, in the measuring frame. `per_rad` has the effect of one rad of a joint in the base frame, from its
    /// axis and the vector from its origin to the target.
    fn effects(
        &self,
        model: &KinematicModel,
        (q_rad, target_mm): (&[f64], &Vector3<f64>),
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
        let effect = |joint: usize| {
            let of_joint = per_rad(&axes[joint], &(tip - origins[joint]));
            model.t_instrument_base.rotation * of_joint
        };
        let mut effects = Vec::with_capacity(self.n_of_joints(q_rad.len()));
        let followings = self.followings.iter();
        effects.extend(followings.map(|f| effect(f.joint) * (q_rad[f.followed] / PI)));
        let harmonic = |joint: usize, order: usize| {
            let k = order as f64;
            let (s, c) = libm::sincos(k * q_rad[joint]);
            [effect(joint) * (s / k), effect(joint) * (c / k)]
        };
        for joint in 0..axes.len() {
            effects.extend(
                self.higher_orders()
                    .flat_map(|order| harmonic(joint, order)),
            );
        }
        for (joint, axis) in axes.iter().enumerate() {
            let effect = effect(joint);
            for g in &self.gravity {
                let moment = |o: &Vector3<f64>| axis.dot(&(o - origins[joint]).cross(g)) / reach_mm;
                effects.extend(origins[joint + 1..].iter().map(|o| effect * moment(o)));
            }
            if self.harmonics.contains(&1) {
                effects.extend(harmonic(joint, 1));
            }
        }
        effects
    }
}

/// The directions of gravity in the base frame: that of the mounting, or three axes if it is unknown.
pub fn gravity_directions(known: Option<&Vector3<f64>>) -> Vec<Vector3<f64>> {
    match known {
        Some(direction) => vec![*direction],
        None => (0..3).map(|axis| Vector3::ith(axis, 1.0)).collect(),
    }
}
