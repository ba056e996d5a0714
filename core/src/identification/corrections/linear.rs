//! Residuals of a robot with corrections, and their derivatives with respect to links and corrections.

use super::{Term, across_gravity};
use crate::identification::KinematicModel;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::Parameter;
use crate::identification::model::pose_rows::{
    Moved, MovedBy, rotation_residual_rad, rows_by_turn,
};
use crate::kinematics::PositionJacobian;
use crate::kinematics::compliance::{first_moments, rigid_chain};
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::jacobian::link_columns;
use crate::kinematics::rotation::{left_jacobian, rotation_exp};
use crate::kinematics::{Corrections, Mounting};
use nalgebra::{DMatrix, DVector, IsometryMatrix3, Matrix3, Rotation3, Vector3};

/// sqrt(weight) · W · (measured − predicted), 3·N + 3·M, and the derivatives of the prediction with respect to `parameters` and `terms`, weighted in
/// the same way. The positions of all observations come first, then the rotation rows of the M poses among them ([`rotation_rows`]). A link's
/// derivative neglects that the link moves the masses on it, which is a thousandth of the derivative.
pub fn linearise(
    model: &KinematicModel,
    corrections: &Corrections,
    mounting: &Mounting,
    (parameters, terms): (&[Parameter], &[Term]),
    observations: &[Observation],
) -> (DVector<f64>, DMatrix<f64>, DMatrix<f64>) {
    let rotation_rows = rotation_rows(model, observations);
    let n = 3 * observations.len() + 3 * rotation_rows.iter().flatten().count();
    let mut residuals = DVector::zeros(n);
    let (mut by_parameter, mut by_term) = (
        DMatrix::zeros(n, parameters.len()),
        DMatrix::zeros(n, terms.len()),
    );
    for (i, o) in observations.iter().enumerate() {
        let pose = Pose::new(model, corrections, o);
        let root = o.weight.sqrt();
        residuals
            .fixed_rows_mut::<3>(3 * i)
            .copy_from(&(o.whitened(o.position_mm - pose.at.position_mm) * root));
        // Converts a small rotation of the prediction to the change of its rotation rows.
        let turned = rotation_rows[i].map(|row| {
            let measured = o.rotation.as_ref();
            let predicted =
                Rotation3::from_matrix_unchecked(pose.at.target) * model.target_rotations[o.target];
            let (left, by_turn) = measured.map_or_else(Default::default, |measured| {
                let root = root * measured.mm_per_rad;
                let left = rotation_residual_rad(&predicted, measured) * root;
                (left, rows_by_turn(&predicted, measured) * root)
            });
            residuals.fixed_rows_mut::<3>(row).copy_from(&left);
            let coupling = o.coupling();
            if let Some(coupling) = &coupling {
                let mut here = residuals.fixed_rows_mut::<3>(3 * i);
                here += coupling * left;
            }
            (row, by_turn, coupling)
        });
        let put = |to: &mut DMatrix<f64>, column: usize, moved: Moved| {
            let shift = o.whitened(moved.shift) * root;
            to.fixed_view_mut::<3, 1>(3 * i, column).copy_from(&shift);
            if let Some((row, by_turn, coupling)) = turned {
                let turn = by_turn * moved.turn;
                to.fixed_view_mut::<3, 1>(row, column).copy_from(&turn);
                if let Some(coupling) = coupling {
                    let mut here = to.fixed_view_mut::<3, 1>(3 * i, column);
                    here += coupling * turn;
                }
            }
        };
        let identity = Matrix3::identity();
        let by = MovedBy::new(&pose.at, identity, identity, o.target);
        for (column, parameter) in parameters.iter().enumerate() {
            put(&mut by_parameter, column, by.parameter(parameter));
        }
        for (column, term) in terms.iter().enumerate() {
            let gravity = &corrections.compliance.gravity_in_base;
            put(&mut by_term, column, pose.by_term(term, gravity, mounting));
        }
    }
    (residuals, by_parameter, by_term)
}

/// First rotation row of each observation that is a pose and whose target has a rotation in the model.
pub fn rotation_rows(model: &KinematicModel, observations: &[Observation]) -> Vec<Option<usize>> {
    let mut next = 3 * observations.len();
    let mut row_of = |o: &Observation| {
        let is_pose = o.n_rows(model) > 3;
        let row = is_pose.then_some(next);
        next += if is_pose { 3 } else { 0 };
        row
    };
    observations.iter().map(&mut row_of).collect()
}

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

/// One pose, in the measuring frame.
struct Pose<'a> {
    q_rad: &'a [f64],
    /// Position and its derivatives by links, base and target. The base turns the whole robot.
    at: PositionJacobian,
    /// Effects of the rotation vector w = K∘M of each joint and of the base.
    by_turn: Vec<Turn>,
    by_base_turn: Turn,
    /// Frames without corrections in the base frame, and the first moments in that frame.
    chain: Vec<IsometryMatrix3<f64>>,
    first: Vec<Vector3<f64>>,
    first_base: Vector3<f64>,
    corrections: &'a Corrections,
}

impl<'a> Pose<'a> {
    fn new(model: &KinematicModel, corrections: &'a Corrections, o: &'a Observation) -> Self {
        let compliance = &corrections.compliance;
        let g = &compliance.gravity_in_base;
        let chain = rigid_chain(&model.links, &o.q_rad);
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
        for (i, (link, q)) in model.links.iter().zip(&o.q_rad).enumerate() {
            before.push(at);
            at *= t_previous_link(link, q + corrections.harmonic_rad(i, *q));
            after.push(at);
            let turn = compliance.joints_rad[i]
                .component_mul(&(chain[i].rotation.inverse() * first.joints[i].cross(g)));
            at.rotation *= rotation_exp(&turn);
            turns.push(turn);
        }
        // The network displaces the end of the chain without a rotation.
        let tip = at.rotation * model.targets_mm[o.target] + at.translation.vector;
        let net = corrections
            .residual
            .as_ref()
            .map_or_else(Vector3::zeros, |network| {
                base.rotation * network.displacement_mm(&o.q_rad)
            });
        let lever = |from: &IsometryMatrix3<f64>| -(tip - from.translation.vector).cross_matrix();
        let position_mm = tip + net;
        Self {
            q_rad: &o.q_rad,
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

    fn by_term(&self, term: &Term, g: &Vector3<f64>, mounting: &Mounting) -> Moved {
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
            Term::Harmonic(joint, order, phase) => {
                let (s, c) = libm::sincos((order + 1) as f64 * self.q_rad[joint]);
                let size = if phase == 0 { s } else { c };
                Moved::new(
                    self.at.links[joint].theta_offset * size,
                    self.at.links[joint].d * size,
                )
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
