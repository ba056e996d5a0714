//! The least-squares problem that every estimate solves: variables with their priors, and blocks of rows that depend on them.
//!
//! Coordinate x_j is the deviation of variable j from the reference, in units of its width, so that all coordinates are of similar size. A
//! block has the rows of one measurement; only the block knows their number. A row is sqrt(weight) · W · (measured − predicted), in mm,
//! where W whitens noise that differs between directions. A pose has three more rows: the rotation vector between the predicted and the
//! measured target, times a length in mm/rad. The priors are rows too; [`crate::identification::least_squares::estimate`] adds them.

use crate::identification::KinematicModel;
use crate::identification::model::objective::{Observation, posed_targets};
use crate::identification::model::parameters::{
    Parameter, Quantity, apply_into, deviation_from, left_jacobian, placement_parameters,
    target_rotation_parameters,
};
use crate::identification::model::pose_rows::{
    MeasuredRotation, MovedBy, rotation_residual_rad, rows_by_turn,
};
use crate::kinematics::{Link, PositionJacobian, placement_jacobian, position_jacobian};
use crate::solvers::median::median;
use nalgebra::{DMatrix, IsometryMatrix3, Matrix3, Rotation3, Vector3};
use std::ops::Range;

/// Prior of a link's length as a share of the reach (one standard deviation): 0.5 mm on an arm of 1.7 m.
const LENGTH_PER_REACH: f64 = 0.5 / 1700.0;
/// Prior of an angle between two axes, rad (0.05°).
const ANGLE_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// Prior of a joint offset, rad (0.3°): joints are mastered on the shop floor.
const OFFSET_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// Prior of the position of a measured base frame, mm (one standard deviation): a frame that was set up with probes and sweeps.
pub const BASE_MM: f64 = 1.0;
/// Prior of the rotation of a measured base frame, rad (0.05°).
pub const BASE_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;

/// Usual error of a link's length, mm. It is also the expected scatter of positions.
pub fn usual_length_mm(reach_mm: f64) -> f64 {
    LENGTH_PER_REACH * reach_mm
}

/// Usual error of an angle between two axes, rad.
pub const USUAL_ANGLE_RAD: f64 = ANGLE_RAD;

/// Usual error of a joint offset, rad.
pub const USUAL_OFFSET_RAD: f64 = OFFSET_RAD;

/// Length that converts a pose's angles to mm before its noise is known, mm/rad: the ratio of the usual errors of link lengths and angles.
pub fn usual_mm_per_rad(reach_mm: f64) -> f64 {
    usual_length_mm(reach_mm) / ANGLE_RAD
}

/// Minimum of σ as a share of the reach: a picometre on an arm of a metre, the last digit of any file.
pub const MIN_SIGMA: f64 = 1e-12;

/// Kinds of variables. Variables of a kind have similar errors, and their priors are widened together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// a and d.
    Length,
    /// alpha and beta.
    Angle,
    /// theta_offset.
    Offset,
    /// Position of a measured base frame.
    BasePosition,
    /// Rotation of a measured base frame.
    BaseRotation,
}

/// All kinds, in the order in which their widths are stored.
pub const KINDS: [Kind; 5] = [
    Kind::Length,
    Kind::Angle,
    Kind::Offset,
    Kind::BasePosition,
    Kind::BaseRotation,
];

/// Prior of a variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// Normal about the reference. The standard deviation is one width at the start, and grows with the deviations of all variables of its
    /// kind.
    OfKind(Kind),
    /// Normal about `mean` with the standard deviation `std`, both in units of the width; never widened.
    Stated {
        /// Expected coordinate.
        mean: f64,
        /// One standard deviation of the coordinate.
        std: f64,
    },
    /// No prior knowledge.
    Flat,
}

/// A variable of the problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variable {
    /// The parameter that it moves.
    pub parameter: Parameter,
    /// Unit of the coordinate, mm or rad.
    pub width: f64,
    /// Its prior.
    pub prior: Prior,
}

/// The rows of one measurement.
#[derive(Clone, Debug)]
struct Block<'a> {
    rows: Range<usize>,
    measured: &'a Observation,
    /// Flange in the base frame, if it is known; otherwise it is computed from the links.
    flange: Option<&'a IsometryMatrix3<f64>>,
}

/// Variables and blocks.
#[derive(Clone, Debug)]
pub struct Problem<'a> {
    /// Reference of the deviations: nominal links, and base and targets as first placed.
    pub reference: KinematicModel,
    /// The variables.
    pub variables: Vec<Variable>,
    /// Radius of the workspace, mm.
    pub reach_mm: f64,
    /// Minimum noise of a row of weight 1, mm: the file's resolution, or the instrument's stated noise.
    pub least_sigma_mm: f64,
    /// Prior for the noise of a row, mm; only for poses. A few poses are fitted without residuals, which then show nothing about the noise.
    pub usual_sigma_mm: Option<f64>,
    parameters: Vec<Parameter>,
    blocks: Vec<Block<'a>>,
}

/// Radius of the workspace, mm: the sum of the links' lengths. For a robot whose links have no length, it is the median distance of the
/// measured points from their centre, if that is larger.
pub fn reach_mm<'a>(
    links: &[Link],
    observations: impl Iterator<Item = &'a Observation> + Clone,
) -> f64 {
    let of_links: f64 = links.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum();
    let positions = observations.map(|o| o.position_mm);
    let along = |axis: usize| median(positions.clone().map(|p| p[axis]));
    let middle = Vector3::from_fn(|axis, _| along(axis).unwrap_or(0.0));
    let of_points = median(positions.clone().map(|p| (p - middle).norm())).unwrap_or(0.0);
    of_links.max(of_points).max(f64::MIN_POSITIVE)
}

/// A variable with its own prior: links by their kind, base and targets flat.
pub fn variable(parameter: Parameter, reach_mm: f64) -> Variable {
    let (width, prior) = match parameter {
        Parameter::Link(_, Quantity::A | Quantity::D) => {
            (LENGTH_PER_REACH * reach_mm, Prior::OfKind(Kind::Length))
        }
        Parameter::Link(_, Quantity::Alpha | Quantity::Beta) => {
            (ANGLE_RAD, Prior::OfKind(Kind::Angle))
        }
        Parameter::Link(_, Quantity::ThetaOffset) => (OFFSET_RAD, Prior::OfKind(Kind::Offset)),
        Parameter::BaseRotation(_) | Parameter::TargetRotation(..) => (1.0, Prior::Flat),
        Parameter::BaseTranslation(_) | Parameter::Target(..) => (reach_mm, Prior::Flat),
    };
    Variable {
        parameter,
        width,
        prior,
    }
}

impl Block<'_> {
    /// The predicted position and its derivatives.
    fn jacobian(&self, model: &KinematicModel, target_mm: &Vector3<f64>) -> PositionJacobian {
        let base = &model.t_instrument_base;
        match self.flange {
            Some(flange) => placement_jacobian(base, &(base * flange), target_mm),
            None => position_jacobian(base, &model.links, &self.measured.q_rad, target_mm),
        }
    }

    /// The measured rotation of a pose, and its prediction; `None` for a position.
    fn rotation(&self, model: &KinematicModel) -> Option<(&MeasuredRotation, Rotation3<f64>)> {
        let o = self.measured;
        let measured = o.rotation.as_ref()?;
        let of_target = model.target_rotations.get(o.target)?;
        let predicted = match self.flange {
            Some(flange) => model.t_instrument_base.rotation * flange.rotation * of_target,
            None => model.rotation(&o.q_rad, o.target)?,
        };
        Some((measured, predicted))
    }

    /// Fills the rows' residuals and, if requested, their derivatives by the coordinates.
    fn fill(
        &self,
        problem: &Problem<'_>,
        at: &At,
        residuals: &mut [f64],
        jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let (o, model) = (self.measured, &at.model);
        let here = self.jacobian(model, &model.targets_mm[o.target]);
        let root = o.weight.sqrt();
        let left = o.position_mm - here.position_mm;
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
        let pose = self.rotation(model);
        if let Some((measured, predicted)) = &pose {
            let left = rotation_residual_rad(predicted, measured) * (root * measured.mm_per_rad);
            fill_rows(&mut residuals[3..], &left);
            add_to_position(residuals, &left);
        }
        let Some(jacobian) = jacobian else { return };
        let of_target = at.target_rotations_rad.get(o.target);
        let of_target = of_target.map_or_else(Matrix3::identity, left_jacobian);
        let of_base = left_jacobian(&at.base_rotation_rad);
        let by = MovedBy::new(&here, of_base, of_target, o.target);
        let by_turn = pose.map(|(measured, predicted)| {
            let root_mm = root * measured.mm_per_rad;
            (rows_by_turn(&predicted, measured), root_mm)
        });
        for (j, variable) in problem.variables.iter().enumerate() {
            let moved = by.parameter(&variable.parameter);
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

/// A problem's model at some coordinates.
struct At {
    model: KinematicModel,
    base_rotation_rad: Vector3<f64>,
    target_rotations_rad: Vec<Vector3<f64>>,
}

impl<'a> Problem<'a> {
    /// The problem of the observations with nonzero weight, with the parameters' own priors.
    pub fn new(
        reference: KinematicModel,
        parameters: &[Parameter],
        observations: &'a [Observation],
    ) -> Self {
        Self::of_blocks(
            reference,
            parameters,
            observations.iter().map(|o| (o, None)),
        )
    }

    /// The problem of base and targets alone, for a robot whose flange is known in its base frame at each observation.
    pub fn of_placement(
        start: KinematicModel,
        flanges: &'a [IsometryMatrix3<f64>],
        observations: &'a [Observation],
    ) -> Self {
        let reference = KinematicModel {
            links: vec![],
            ..start
        };
        let mut parameters = placement_parameters(reference.targets_mm.len());
        if !reference.target_rotations.is_empty() {
            let posed = posed_targets(observations);
            parameters.extend(target_rotation_parameters(&posed));
        }
        let known = observations.iter().zip(flanges.iter().map(Some));
        Self::of_blocks(reference, &parameters, known)
    }

    fn of_blocks(
        reference: KinematicModel,
        parameters: &[Parameter],
        measured: impl Iterator<Item = (&'a Observation, Option<&'a IsometryMatrix3<f64>>)> + Clone,
    ) -> Self {
        let reach_mm = reach_mm(&reference.links, measured.clone().map(|(o, _)| o));
        let mut first = 0;
        let block = |(measured, flange): (&'a Observation, _)| {
            let rows = first..first + measured.n_rows(&reference);
            first = rows.end;
            Block {
                rows,
                measured,
                flange,
            }
        };
        let with_weight = measured.filter(|(o, _)| o.weight > 0.0);
        let blocks: Vec<Block<'a>> = with_weight.map(block).collect();
        let is_posed = blocks.iter().any(|block| block.rows.len() == 6);
        Self {
            reference,
            variables: parameters.iter().map(|p| variable(*p, reach_mm)).collect(),
            reach_mm,
            least_sigma_mm: MIN_SIGMA * reach_mm,
            usual_sigma_mm: is_posed.then(|| usual_length_mm(reach_mm)),
            parameters: parameters.to_vec(),
            blocks,
        }
    }

    /// The same problem with a base that is known to be at the reference, with standard deviations of 1 mm and 0.05°. Its prior has heavy
    /// tails like those of links: the error of a badly set up base frame may be centimetres, and link 1 must not absorb it.
    pub fn with_known_base(mut self) -> Self {
        for variable in &mut self.variables {
            let (width, kind) = match variable.parameter {
                Parameter::BaseTranslation(_) => (BASE_MM, Kind::BasePosition),
                Parameter::BaseRotation(_) => (BASE_RAD, Kind::BaseRotation),
                _ => continue,
            };
            (variable.width, variable.prior) = (width, Prior::OfKind(kind));
        }
        self
    }

    /// Removes the links' own priors. This gives plain least squares, in which unobservable combinations stay at the reference.
    pub fn without_own_priors(&mut self) {
        for variable in &mut self.variables {
            if variable.parameter.is_link() {
                variable.prior = Prior::Flat;
            }
        }
    }

    /// Makes a parameter's prior flat. In the paper's model, this is used for the last d, which contains the reflector's height above the
    /// flange.
    pub fn free(&mut self, parameter: Parameter) {
        let found = self.variables.iter_mut().find(|v| v.parameter == parameter);
        if let Some(variable) = found {
            (variable.width, variable.prior) = (self.reach_mm, Prior::Flat);
        }
    }

    /// States a normal prior of a variable: its mean as a deviation from the reference, and its standard deviation, mm or rad.
    pub fn state(&mut self, variable: usize, mean: f64, std: f64) {
        let variable = &mut self.variables[variable];
        variable.prior = Prior::Stated {
            mean: mean / variable.width,
            std: std / variable.width,
        };
    }

    /// Prior mean of a coordinate.
    pub fn expected(&self, variable: usize) -> f64 {
        match self.variables[variable].prior {
            Prior::Stated { mean, .. } => mean,
            Prior::OfKind(_) | Prior::Flat => 0.0,
        }
    }

    /// Number of blocks.
    pub fn n_blocks(&self) -> usize {
        self.blocks.len()
    }

    /// The rows of a block.
    pub fn rows_of(&self, block: usize) -> Range<usize> {
        self.blocks[block].rows.clone()
    }

    /// The same problem with only some of the blocks, in the given order.
    pub fn part(&self, blocks: impl Iterator<Item = usize>) -> Self {
        let mut n_rows = 0;
        let mut after_the_last = |i: usize| {
            let block = &self.blocks[i];
            let first = n_rows;
            n_rows += block.rows.len();
            Block {
                rows: first..n_rows,
                ..block.clone()
            }
        };
        Self {
            reference: self.reference.clone(),
            variables: self.variables.clone(),
            reach_mm: self.reach_mm,
            least_sigma_mm: self.least_sigma_mm,
            usual_sigma_mm: self.usual_sigma_mm,
            parameters: self.parameters.clone(),
            blocks: blocks.map(&mut after_the_last).collect(),
        }
    }

    /// Number of rows of all blocks.
    pub fn n_rows(&self) -> usize {
        self.blocks.last().map_or(0, |block| block.rows.end)
    }

    /// Coordinates of a model.
    pub fn coordinates(&self, model: &KinematicModel) -> Vec<f64> {
        self.variables
            .iter()
            .map(|v| deviation_from(&self.reference, model, &v.parameter) / v.width)
            .collect()
    }

    /// Deviations from the reference, mm or rad.
    pub fn deviation(&self, x: &[f64]) -> Vec<f64> {
        x.iter()
            .zip(&self.variables)
            .map(|(x, variable)| x * variable.width)
            .collect()
    }

    /// Scales the rows of a matrix, one per coordinate, to the units of the parameters, mm or rad.
    pub fn in_units(&self, mut of_coordinates: DMatrix<f64>) -> DMatrix<f64> {
        for (mut row, variable) in of_coordinates.row_iter_mut().zip(&self.variables) {
            row *= variable.width;
        }
        of_coordinates
    }

    /// The model at the given coordinates.
    pub fn model(&self, x: &[f64]) -> KinematicModel {
        self.at(x).model
    }

    fn at(&self, x: &[f64]) -> At {
        let deviation = self.deviation(x);
        let mut base_rotation_rad = Vector3::zeros();
        let n_turned = self.reference.target_rotations.len();
        let mut target_rotations_rad = vec![Vector3::zeros(); n_turned];
        for (parameter, value) in self.parameters.iter().zip(&deviation) {
            match parameter {
                Parameter::BaseRotation(axis) => base_rotation_rad[*axis] = *value,
                Parameter::TargetRotation(target, axis) => {
                    target_rotations_rad[*target][*axis] = *value;
                }
                _ => {}
            }
        }
        let mut model = self.reference.clone();
        apply_into(&self.reference, &self.parameters, &deviation, &mut model);
        At {
            model,
            base_rotation_rad,
            target_rotations_rad,
        }
    }

    /// Fills the residuals of all blocks, mm, into the first [`Self::n_rows`] rows. If requested, also fills their derivatives by the coordinates,
    /// one column of the Jacobian each.
    pub fn evaluate(
        &self,
        x: &[f64],
        residuals: &mut [f64],
        mut jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let at = self.at(x);
        for block in &self.blocks {
            block.fill(self, &at, residuals, jacobian.as_deref_mut());
        }
    }
}
