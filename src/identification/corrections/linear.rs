//! Residuals of a robot with corrections, and their derivatives by links and by corrections.

use super::{Term, across_gravity};
use crate::identification::KinematicModel;
use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, Quantity};
use crate::kinematics::compliance::{first_moments, rigid_chain};
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::jacobian::{LinkColumns, link_columns};
use crate::kinematics::rotation::{left_jacobian, rotation_exp};
use crate::kinematics::{Corrections, Mounting};
use nalgebra::{DMatrix, DVector, IsometryMatrix3, Matrix3, Vector3};

/// sqrt(weight) · (measured − predicted), 3·N, and the derivatives of the prediction by `parameters` and by `terms`, 3·N × each, weighted
/// alike. That a link moves the masses on it is left out of its own derivative: it is a thousandth of it.
pub fn linearise(
    model: &KinematicModel,
    corrections: &Corrections,
    mounting: &Mounting,
    (parameters, terms): (&[Parameter], &[Term]),
    observations: &[Observation],
) -> (DVector<f64>, DMatrix<f64>, DMatrix<f64>) {
    let n = 3 * observations.len();
    let mut residuals = DVector::zeros(n);
    let (mut by_parameter, mut by_term) = (
        DMatrix::zeros(n, parameters.len()),
        DMatrix::zeros(n, terms.len()),
    );
    for (i, o) in observations.iter().enumerate() {
        let pose = Pose::new(model, corrections, o);
        let root = o.weight.sqrt();
        let put = |to: &mut DMatrix<f64>, column: usize, v: Vector3<f64>| {
            (0..3).for_each(|axis| to[(3 * i + axis, column)] = root * v[axis])
        };
        for (column, parameter) in parameters.iter().enumerate() {
            put(
                &mut by_parameter,
                column,
                pose.by_parameter(parameter, o.target),
            );
        }
        for (column, term) in terms.iter().enumerate() {
            put(
                &mut by_term,
                column,
                pose.by_term(term, &corrections.compliance.gravity_in_base, mounting),
            );
        }
        residuals
            .fixed_rows_mut::<3>(3 * i)
            .copy_from(&((o.position_mm - pose.position_mm) * root));
    }
    (residuals, by_parameter, by_term)
}

/// One pose, in the measuring frame.
struct Pose<'a> {
    q_rad: &'a [f64],
    position_mm: Vector3<f64>,
    links: Vec<LinkColumns>,
    /// ∂p/∂(turn of the whole robot about its base's origin).
    base_rotation: Matrix3<f64>,
    flange_rotation: Matrix3<f64>,
    /// ∂p/∂w for the rotation vector w = K∘M of each joint, and of the base.
    by_turn: Vec<Matrix3<f64>>,
    by_base_turn: Matrix3<f64>,
    /// Frames without corrections, in the base frame, and the moments there.
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
        // the network displaces the end of the chain without turning anything
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
            position_mm,
            links: (0..n)
                .map(|i| link_columns(&model.links[i], &before[i], &after[i], &tip))
                .collect(),
            base_rotation: -(position_mm - base.translation.vector).cross_matrix(),
            flange_rotation: *at.rotation.matrix(),
            by_turn: (0..n)
                .map(|i| lever(&after[i]) * after[i].rotation.matrix() * left_jacobian(&turns[i]))
                .collect(),
            by_base_turn: lever(&base) * base.rotation.matrix() * left_jacobian(&base_turn),
            chain,
            first: first.joints,
            first_base: first.base,
            corrections,
        }
    }

    fn by_parameter(&self, parameter: &Parameter, own_target: usize) -> Vector3<f64> {
        match *parameter {
            Parameter::Link(link, Quantity::A) => self.links[link].a,
            Parameter::Link(link, Quantity::Alpha) => self.links[link].alpha,
            Parameter::Link(link, Quantity::D) => self.links[link].d,
            Parameter::Link(link, Quantity::ThetaOffset) => self.links[link].theta_offset,
            Parameter::Link(link, Quantity::Beta) => self.links[link].beta,
            Parameter::BaseTranslation(axis) => Vector3::ith(axis, 1.0),
            Parameter::BaseRotation(axis) => self.base_rotation.column(axis).into(),
            Parameter::Target(target, axis) if target == own_target => {
                self.flange_rotation.column(axis).into()
            }
            Parameter::Target(..) | Parameter::TargetRotation(..) => Vector3::zeros(),
        }
    }

    fn by_term(&self, term: &Term, g: &Vector3<f64>, mounting: &Mounting) -> Vector3<f64> {
        match *term {
            Term::Joint(joint, axis) => {
                let moment = self.chain[joint].rotation.inverse() * self.first[joint].cross(g);
                self.by_turn[joint].column(axis) * moment[axis]
            }
            Term::Base(axis) => self.by_base_turn.column(axis) * self.first_base.cross(g)[axis],
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
                // the direction is made a unit vector again
                let turned = (across - g * g.dot(&across)) * g.dot(&mounting.gravity_in_base);
                self.turned_by(&self.first_base, &self.first, &turned)
            }
            Term::Harmonic(joint, order, phase) => {
                let (s, c) = libm::sincos((order + 1) as f64 * self.q_rad[joint]);
                self.links[joint].theta_offset * if phase == 0 { s } else { c }
            }
        }
    }

    /// Displacement by a first moment, given about each frame's origin (mm), that the first `n_joints` joints and the base carry.
    fn bent(
        &self,
        n_joints: usize,
        about: impl Fn(&Vector3<f64>) -> Vector3<f64>,
        g: &Vector3<f64>,
    ) -> Vector3<f64> {
        let joints: Vec<Vector3<f64>> = self.chain[..n_joints]
            .iter()
            .map(|frame| about(&frame.translation.vector))
            .collect();
        self.turned_by(&about(&Vector3::zeros()), &joints, g)
    }

    /// Displacement when the moments change by `first` × `g`.
    fn turned_by(
        &self,
        base: &Vector3<f64>,
        joints: &[Vector3<f64>],
        g: &Vector3<f64>,
    ) -> Vector3<f64> {
        let compliance = &self.corrections.compliance;
        let mut sum = self.by_base_turn * compliance.base_rad.component_mul(&base.cross(g));
        for (i, first) in joints.iter().enumerate() {
            sum += self.by_turn[i]
                * compliance.joints_rad[i]
                    .component_mul(&(self.chain[i].rotation.inverse() * first.cross(g)));
        }
        sum
    }
}
