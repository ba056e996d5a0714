//! Effects of possible motions and errors during a measurement on each point, as columns of the linear problem.

use crate::identification::KinematicModel;
use crate::identification::least_squares::start::{centre_mm, spread_mm};
use crate::identification::model::objective::Observation;
use crate::kinematics::jacobian::{LinkColumns, position_jacobian};
use crate::kinematics::{Link, t_base_flange};
use nalgebra::{Matrix3, Matrix3xX, SMatrix, Vector3};

/// Effects on each point, weighted: of a motion of a target, of a motion of the base, of a joint, and of growing links.
pub struct Columns {
    pub(super) target: Vec<Matrix3<f64>>,
    pub(super) base: Vec<SMatrix<f64, 3, 6>>,
    /// Effect of one rad of each joint, 3 × n.
    joints: Vec<Matrix3xX<f64>>,
    /// Effect if each length grows in proportion to itself: the vector from base to flange, mm.
    growth: Vec<Vector3<f64>>,
    /// Centre of the base's rotation, mm, measuring frame.
    pub centre: Vector3<f64>,
    /// Unit of rotation: rad per unit of a column.
    unit_rad: f64,
}

impl Columns {
    /// The columns at a fitted model.
    pub fn new(model: &KinematicModel, observations: &[Observation]) -> Self {
        let centre = centre_mm(observations);
        let size = spread_mm(observations, &centre).max(f64::MIN_POSITIVE);
        let base = |o: &Observation| {
            let root = o.weight.sqrt();
            let arm = (o.position_mm - centre).cross_matrix() * (-1.0 / size);
            let mut block = SMatrix::<f64, 3, 6>::zeros();
            block
                .fixed_columns_mut::<3>(0)
                .copy_from(&(Matrix3::identity() * root));
            block.fixed_columns_mut::<3>(3).copy_from(&(arm * root));
            o.whitening.map_or(block, |w| w * block)
        };
        let target = |o: &Observation| {
            let flange = t_base_flange(&model.links, &o.q_rad);
            let block = model.t_instrument_base.rotation.matrix()
                * flange.rotation.matrix()
                * o.weight.sqrt();
            o.whitening.map_or(block, |w| w * block)
        };
        let by_links = |o: &Observation| {
            let target_mm = &model.targets_mm[o.target];
            let at = position_jacobian(&model.t_instrument_base, &model.links, &o.q_rad, target_mm);
            let weighted = |v: Vector3<f64>| o.whitened(v) * o.weight.sqrt();
            let joints: Vec<Vector3<f64>> =
                at.links.iter().map(|l| weighted(l.theta_offset)).collect();
            let of_link = |(by, link): (&LinkColumns, &Link)| by.a * link.a_mm + by.d * link.d_mm;
            let growth = at.links.iter().zip(&model.links).map(of_link).sum();
            (Matrix3xX::from_columns(&joints), weighted(growth))
        };
        let (joints, growth) = observations.iter().map(by_links).unzip();
        Self {
            joints,
            growth,
            target: observations.iter().map(target).collect(),
            base: observations.iter().map(base).collect(),
            centre,
            unit_rad: 1.0 / size,
        }
    }

    /// The columns of a motion of the base, 3 × 6: shift in mm, rotation in units of `unit_rad`.
    pub fn base(&self, point: usize) -> &SMatrix<f64, 3, 6> {
        &self.base[point]
    }

    /// Effect of one rad of each joint, 3 × n.
    pub fn joints(&self, point: usize) -> &Matrix3xX<f64> {
        &self.joints[point]
    }

    /// Effect if each length grows in proportion to itself, mm.
    pub fn growth(&self, point: usize) -> &Vector3<f64> {
        &self.growth[point]
    }

    /// The columns of a shift of the base without rotation, 3 × 3.
    pub fn base_shift(&self, point: usize) -> Matrix3<f64> {
        self.base[point].fixed_columns::<3>(0).into_owned()
    }

    /// Displacement by a unit of rotation at the points' radius, mm.
    pub fn size_mm(&self) -> f64 {
        1.0 / self.unit_rad
    }

    /// Shift and rotation (rad) of a solution along [`Self::base`].
    pub fn motion(&self, x: &[f64]) -> (Vector3<f64>, Vector3<f64>) {
        (
            Vector3::new(x[0], x[1], x[2]),
            Vector3::new(x[3], x[4], x[5]) * self.unit_rad,
        )
    }
}
