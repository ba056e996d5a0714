//! The rows of one measurement: residuals and their derivatives by the variables.

use crate::identification::KinematicModel;
use crate::identification::least_squares::variables::{Unknown, Variable};
use crate::identification::model::corrected_pose::CorrectedPose;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::{left_jacobian, rotation_exp};
use crate::identification::model::pose_rows::{
    Moved, MovedBy, rotation_residual_rad, rows_by_turn,
};
use crate::kinematics::{
    Corrections, Mounting, PositionJacobian, placement_jacobian, position_jacobian,
};
use nalgebra::{DMatrix, IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};
use std::ops::Range;

/// The rows of one measurement.
#[derive(Clone, Debug)]
pub(super) struct Block<'a> {
    pub(super) rows: Range<usize>,
    pub(super) measured: &'a Observation,
    /// Flange in the base frame, if it is known; otherwise it is computed from links and corrections.
    pub(super) flange: Option<&'a IsometryMatrix3<f64>>,
    /// The instrument's station; `None` for the reference station.
    pub(super) station: Option<usize>,
}

/// Everything that the rows depend on, at some coordinates.
pub(super) struct State {
    pub(super) model: KinematicModel,
    pub(super) base_rotation_rad: Vector3<f64>,
    pub(super) target_rotations_rad: Vec<Vector3<f64>>,
    pub(super) corrections: Option<(Corrections, Mounting)>,
    pub(super) stations: Vec<StationMotion>,
}

/// Motion of a station: it displaces what is predicted for its points, in the frame of the reference station.
#[derive(Clone, Copy, Debug)]
pub(super) struct StationMotion {
    pub(super) shift_mm: Vector3<f64>,
    pub(super) rotation_rad: Vector3<f64>,
    /// The point about which the station is rotated.
    pub(super) about_mm: Vector3<f64>,
}

impl StationMotion {
    pub(super) fn isometry(&self) -> IsometryMatrix3<f64> {
        let rotation = rotation_exp(&self.rotation_rad);
        let moved = self.about_mm + self.shift_mm - rotation * self.about_mm;
        IsometryMatrix3::from_parts(Translation3::from(moved), rotation)
    }

    /// Motion of a predicted position by a component of the station's motion.
    fn by_axis(&self, axis: usize, position_mm: &Vector3<f64>) -> Moved {
        if axis < 3 {
            return Moved::new(Vector3::ith(axis, 1.0), Vector3::zeros());
        }
        let turn: Vector3<f64> = left_jacobian(&self.rotation_rad).column(axis - 3).into();
        let from = position_mm - self.about_mm - self.shift_mm;
        Moved::new(turn.cross(&from), turn)
    }
}

impl Block<'_> {
    /// The predicted position and its derivatives, for a robot without corrections.
    fn jacobian(&self, model: &KinematicModel, target_mm: &Vector3<f64>) -> PositionJacobian {
        let base = &model.t_instrument_base;
        match self.flange {
            Some(flange) => placement_jacobian(base, &(base * flange), target_mm),
            None => position_jacobian(base, &model.links, &self.measured.q_rad, target_mm),
        }
    }

    /// Fills the rows' residuals and, if requested, their derivatives by the coordinates.
    pub(super) fn fill(
        &self,
        variables: &[Variable],
        state: &State,
        residuals: &mut [f64],
        jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let (o, model) = (self.measured, &state.model);
        let corrections = state.corrections.as_ref();
        let corrected = corrections
            .map(|(corrections, _)| CorrectedPose::new(model, corrections, &o.q_rad, o.target));
        let here = match &corrected {
            Some(pose) => pose.at.clone(),
            None => self.jacobian(model, &model.targets_mm[o.target]),
        };
        let station = self.station.map(|station| &state.stations[station]);
        let motion = station.map(|station| station.isometry());
        let position_mm = match &motion {
            Some(motion) => motion.rotation * here.position_mm + motion.translation.vector,
            None => here.position_mm,
        };
        let root = o.weight.sqrt();
        let left = o.position_mm - position_mm;
        let residuals = &mut residuals[self.rows.clone()];
        fill_rows(&mut residuals[..3], &(o.whitened(left) * root));
        // If the rotation has a lever, the position rows depend on the rotation rows.
        let coupling = o.coupling();
        let add_to_position = |rows: &mut [f64], of_rotation: &Vector3<f64>| {
            if let Some(coupling) = &coupling {
                let added = coupling * of_rotation;
                (0..3).for_each(|axis| rows[axis] += added[axis]);
            }
        };
        let pose = o
            .rotation
            .as_ref()
            .zip(model.target_rotations.get(o.target));
        let pose = pose.map(|(measured, of_target)| {
            let of_flange = Rotation3::from_matrix_unchecked(here.target);
            let predicted = of_flange * of_target;
            let moved = motion.map(|motion| motion.rotation * predicted);
            (measured, moved.unwrap_or(predicted))
        });
        if let Some((measured, predicted)) = &pose {
            let left = rotation_residual_rad(predicted, measured) * (root * measured.mm_per_rad);
            fill_rows(&mut residuals[3..], &left);
            add_to_position(residuals, &left);
        }
        let Some(jacobian) = jacobian else { return };
        let of_target = state.target_rotations_rad.get(o.target);
        let of_target = of_target.map_or_else(Matrix3::identity, left_jacobian);
        let of_base = left_jacobian(&state.base_rotation_rad);
        let by = MovedBy::new(&here, of_base, of_target, o.target);
        let by_turn = pose.map(|(measured, predicted)| {
            let root_mm = root * measured.mm_per_rad;
            (rows_by_turn(&predicted, measured), root_mm)
        });
        let with_station = |moved: Moved| match &motion {
            Some(motion) => Moved::new(motion.rotation * moved.shift, motion.rotation * moved.turn),
            None => moved,
        };
        for (j, variable) in variables.iter().enumerate() {
            let moved = match &variable.unknown {
                Unknown::Parameter(parameter) => with_station(by.parameter(parameter)),
                Unknown::Station(of, axis) => match station.filter(|_| self.station == Some(*of)) {
                    Some(station) => station.by_axis(*axis, &position_mm),
                    None => Moved::default(),
                },
                Unknown::Correction(term) => match corrected.as_ref().zip(corrections) {
                    Some((pose, (_, mounting))) => with_station(pose.by_term(term, mounting)),
                    None => Moved::default(),
                },
            };
            let column = &mut jacobian.column_mut(j);
            let rows = &mut column.as_mut_slice()[self.rows.clone()];
            let shift = o.whitened(moved.shift) * (-root * variable.width);
            fill_rows(&mut rows[..3], &shift);
            if let Some((by_turn, root_mm)) = &by_turn {
                let turn = by_turn * moved.turn * (-root_mm * variable.width);
                fill_rows(&mut rows[3..], &turn);
                add_to_position(rows, &turn);
            }
        }
    }
}

fn fill_rows(rows: &mut [f64], values: &Vector3<f64>) {
    rows.copy_from_slice(values.as_slice());
}
