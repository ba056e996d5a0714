//! A target of a robot with corrections at one pose, and its motions by links, base, target, and the terms of the corrections.

use crate::identification::KinematicModel;
use crate::identification::model::correction_terms::{Term, across_gravity};
use crate::identification::model::pose_rows::Moved;
use crate::kinematics::PositionJacobian;
use crate::kinematics::compliance::{first_moments, rigid_chain};
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::jacobian::link_columns;
use crate::kinematics::rotation::{left_jacobian, rotation_exp};
use crate::kinematics::{Corrections, Mounting};
use nalgebra::{IsometryMatrix3, Matrix3, Vector3};

/// A rotation of a frame. `axes` transforms a rotation vector from the frame to the measuring frame. `lever` transforms that vector to the
/// target's shift.
struct Turn {
    lever: Matrix3<f64>,
    axes: Matrix3<f64>,
}

impl Turn {
    fn by(&self, rotation: &Vector3<f64>) -> Moved {
        let turn = self.axes * rotation;
        Moved::new(self.lever * turn, turn)
    }
}

/// A target at one pose, in the measuring frame.
pub struct CorrectedPose<'a> {
    q_rad: &'a [f64],
    /// Position and its derivatives by links, base and target. The base turns the whole robot. A link's derivative neglects that the link moves
    /// the masses on it, which is a thousandth of the derivative.
    pub at: PositionJacobian,
    /// Effects of the rotation vector w = K∘M of each joint and of the base.
    by_turn: Vec<Turn>,
    by_base_turn: Turn,
    /// Frames without corrections in the base frame, and the first moments in that frame.
    chain: Vec<IsometryMatrix3<f64>>,
    first: Vec<Vector3<f64>>,
    first_base: Vector3<f64>,
    corrections: &'a Corrections,
}

impl<'a> CorrectedPose<'a> {
    /// The pose at some joint values.
    pub fn new(
        model: &KinematicModel,
        corrections: &'a Corrections,
        q_rad: &'a [f64],
        target: usize,
    ) -> Self {
        let compliance = &corrections.compliance;
        let g = &compliance.gravity_in_base;
        let chain = rigid_chain(&model.links, q_rad);
        let first = first_moments(&chain, compliance);
        let base_turn = compliance.base_rad.component_mul(&first.base.cross(g));
        let base = model.t_instrument_base;
        let mut at = base;
        at.rotation *= rotation_exp(&base_turn);
        let n = model.links.len();
        let (mut before, mut after, mut turns) = (
            Vec::with_capacity(n),
            Vec::with_capacity(n),
            Vec::with_capacity(n),
        );
        for (i, (link, q)) in model.links.iter().zip(q_rad).enumerate() {
            before.push(at);
            at *= t_previous_link(link, q + corrections.joint_error_rad(i, q_rad));
            after.push(at);
            let turn = compliance.joints_rad[i]
                .component_mul(&(chain[i].rotation.inverse() * first.joints[i].cross(g)));
            at.rotation *= rotation_exp(&turn);
            turns.push(turn);
        }
        // The network displaces the end of the chain without a rotation.
        let tip = at.rotation * model.targets_mm[target] + at.translation.vector;
        let net = corrections
            .residual
            .as_ref()
            .map_or_else(Vector3::zeros, |network| {
                base.rotation * network.displacement_mm(q_rad)
            });
        let lever = |from: &IsometryMatrix3<f64>| -(tip - from.translation.vector).cross_matrix();
        let position_mm = tip + net;
        Self {
            q_rad,
            at: PositionJacobian {
                position_mm,
                links: (0..n)
                    .map(|i| link_columns(&model.links[i], &before[i], &after[i], &tip))
                    .collect(),
                base_rotation: -(position_mm - base.translation.vector).cross_matrix(),
                target: *at.rotation.matrix(),
            },
            by_turn: (0..n)
                .map(|i| Turn {
                    lever: lever(&after[i]),
                    axes: after[i].rotation.matrix() * left_jacobian(&turns[i]),
                })
                .collect(),
            by_base_turn: Turn {
                lever: lever(&base),
                axes: base.rotation.matrix() * left_jacobian(&base_turn),
            },
            chain,
            first: first.joints,
            first_base: first.base,
            corrections,
        }
    }

    /// Motion of the target per unit of a term.
    pub fn by_term(&self, term: &Term, mounting: &Mounting) -> Moved {
        let g = &self.corrections.compliance.gravity_in_base;
        let turned_joint = |joint: usize, share: f64| {
            let by = &self.at.links[joint];
            Moved::new(by.theta_offset * share, by.d * share)
        };
        match *term {
            Term::Joint(joint, axis) => {
                let moment = self.chain[joint].rotation.inverse() * self.first[joint].cross(g);
                self.by_turn[joint].by(&Vector3::ith(axis, moment[axis]))
            }
            Term::Base(axis) => {
                let moment = self.first_base.cross(g)[axis];
                self.by_base_turn.by(&Vector3::ith(axis, moment))
            }
            Term::Mass(link) => {
                let origin = self.chain[link].translation.vector;
                self.bent(link + 1, |from| (origin - from) / 1e3, g)
            }
            Term::FirstMoment(link, axis) => {
                let along: Vector3<f64> = self.chain[link].rotation.matrix().column(axis).into();
                self.bent(link + 1, |_| along, g)
            }
            Term::Gravity(axis) => {
                let across = across_gravity(mounting)[axis];
                // The gravity direction is normalised to a unit vector.
                let turned = (across - g * g.dot(&across)) * g.dot(&mounting.gravity_in_base);
                self.turned_by(&self.first_base, &self.first, &turned)
            }
            Term::Coupling(joint, followed) => turned_joint(joint, self.q_rad[followed]),
            Term::Harmonic(joint, order, phase) => {
                let (s, c) = libm::sincos((order + 1) as f64 * self.q_rad[joint]);
                let size = if phase == 0 { s } else { c };
                turned_joint(joint, size)
            }
        }
    }

    /// Effect of a first moment that loads the first `n_joints` joints and the base. `about` returns it about each frame's origin (mm).
    fn bent(
        &self,
        n_joints: usize,
        about: impl Fn(&Vector3<f64>) -> Vector3<f64>,
        g: &Vector3<f64>,
    ) -> Moved {
        let joints: Vec<Vector3<f64>> = self.chain[..n_joints]
            .iter()
            .map(|frame| about(&frame.translation.vector))
            .collect();
        self.turned_by(&about(&Vector3::zeros()), &joints, g)
    }

    /// Effect of a change of the moments by `first` × `g`.
    fn turned_by(&self, base: &Vector3<f64>, joints: &[Vector3<f64>], g: &Vector3<f64>) -> Moved {
        let compliance = &self.corrections.compliance;
        let of_base = compliance.base_rad.component_mul(&base.cross(g));
        let mut sum = self.by_base_turn.by(&of_base);
        for (i, first) in joints.iter().enumerate() {
            let moment = self.chain[i].rotation.inverse() * first.cross(g);
            let moved = self.by_turn[i].by(&compliance.joints_rad[i].component_mul(&moment));
            sum.shift += moved.shift;
            sum.turn += moved.turn;
        }
        sum
    }
}
