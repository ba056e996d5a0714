//! Uncertainty of a corrected tool's position relative to its target, from the covariance of the identification.
//!
//! With d = tool − target at fixed joint values, the links' errors δ change it by ∂d/∂δ. Effects that links cannot describe change it by the features
//! of [`misfit`](crate::identification::statistics::misfit). Both errors have the root R of their mean square error from the identification. One standard
//! deviation of d (3-D: the root of the sum of three variances) is |∂d/∂(δ, u) · R|. Derivatives are central differences, because base and flange
//! depend on the links. Measured positions do not show theta_offset and d of the last link. Where they count, their usual errors are added in squares
//! (see [`ToolPoint::Tcp`] and [`HeldReflector`]).

use crate::compensation::anchor::{
    Anchor, HeldReflector, anchor_in, contains_tool, usual_error_of_last_d_mm,
};
use crate::compensation::mode::Base;
use crate::compensation::targets::Tool;
use crate::identification::KinematicModel;
use crate::identification::least_squares::problem::USUAL_OFFSET_RAD;
use crate::identification::model::parameters::{Parameter, Quantity, apply};
use crate::identification::statistics::changes::Estimate;
use crate::kinematics::{Robot, reach_mm, t_base_flange};
use nalgebra::{DMatrix, IsometryMatrix3, Matrix3xX, Point3, Vector3};

/// Step of an angle, rad. Both its square and the rounding error are negligible.
const STEP_RAD: f64 = 1e-6;

/// The target of the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToolGoal<'a> {
    /// The tool's position on the nominal robot at these joint values, rad, in the controller's convention.
    AsNominal(&'a [f64]),
    /// A fixed position in the frame in which targets are met. It does not depend on the robot.
    Fixed,
}

/// A robot with changed parameters: links, base, flange and targets.
#[derive(Clone, Debug)]
struct PerturbedRobot {
    model: KinematicModel,
    anchor: Anchor,
}

impl PerturbedRobot {
    fn new(model: KinematicModel, nominal: &Robot, base: Base, has_tool: bool) -> Self {
        let anchor = anchor_in(base, &model, &nominal.links, has_tool);
        Self { model, anchor }
    }

    /// The tool's centre relative to the anchored flange, mm.
    fn tool_mm(&self, tool: &ToolPoint) -> Vector3<f64> {
        match *tool {
            ToolPoint::Target(target) => {
                (self.anchor.t_anchored_flange * Point3::from(self.model.targets_mm[target])).coords
            }
            ToolPoint::Tcp { flange_mm, .. } => flange_mm,
        }
    }

    /// Tool minus target, mm, in the frame in which targets are met, up to a constant.
    fn miss_mm(&self, nominal: &Robot, tool: &ToolPoint, q: &Poses) -> Vector3<f64> {
        let tool_mm = Point3::from(self.tool_mm(tool));
        let flange = self
            .anchor
            .anchored(&t_base_flange(&self.model.links, &q.corrected_rad));
        let there = (flange * tool_mm).coords;
        match &q.nominal_rad {
            Some(q_rad) => there - (t_base_flange(&nominal.links, q_rad) * tool_mm).coords,
            None => there,
        }
    }
}

/// The tool's centre: an identified target by its number, or a point of the nominal flange, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToolPoint {
    /// 0-based.
    Target(usize),
    /// A tool centre point that was not identified.
    Tcp {
        /// Position in the nominal flange frame, mm.
        flange_mm: Vector3<f64>,
        /// Standard uncertainty of one coordinate of this position, mm, if it was measured with this robot, that is relative to its calibrated axes. `None`
        /// for a position relative to the flange, as from a drawing: the flange misses by the usual errors of theta_offset and d of the last link, which
        /// measured positions of a reflector do not show.
        std_mm: Option<f64>,
    },
}

impl ToolPoint {
    /// The centre of a tool. `target` is the number of [`Tool::Target`], `std_mm` is that of a [`Tool::Tcp`].
    pub fn of(tool: &Tool, target: usize, std_mm: Option<f64>) -> Self {
        match tool {
            Tool::Target(_) => Self::Target(target),
            Tool::Tcp(pose) => Self::Tcp {
                flange_mm: pose.translation.vector,
                std_mm,
            },
        }
    }
}

/// Error of the flange at the tool that the covariance does not contain (3-D), mm. Along the last axis it is that of d of the last link: the
/// [`anchor`](crate::compensation::anchor) leaves d nominal, or the reflector was held at the flange. About the last axis it is that of theta_offset of
/// the last link, times the tool's distance from the axis. An identified target does not depend on either, unless it was held at the flange.
fn flange_error_mm(nominal: &Robot, estimate: &Estimate, base: Base, tool: &ToolPoint) -> f64 {
    let links = &nominal.links;
    let held = HeldReflector::of(&estimate.model, links).filter(|_| base == Base::Measured);
    let held_mm = held.map(|held| held.flange_error_mm());
    match *tool {
        ToolPoint::Target(_) => held_mm.unwrap_or(0.0),
        ToolPoint::Tcp {
            std_mm: Some(std_mm),
            ..
        } => libm::hypot(3f64.sqrt() * std_mm, held_mm.unwrap_or(0.0)),
        ToolPoint::Tcp { flange_mm, .. } => {
            let last_d = Parameter::Link(links.len() - 1, Quantity::D);
            let is_in_estimate = base == Base::Measured
                && !contains_tool(&estimate.model.links, links)
                && estimate.parameters.contains(&last_d);
            let along_mm = match held_mm {
                None if is_in_estimate => 0.0,
                None => usual_error_of_last_d_mm(links),
                Some(held_mm) => held_mm,
            };
            let off_axis_mm = libm::hypot(flange_mm.x, flange_mm.y);
            libm::hypot(along_mm, USUAL_OFFSET_RAD * off_axis_mm)
        }
    }
}

/// Joint values of the model, rad.
struct Poses {
    corrected_rad: Vec<f64>,
    nominal_rad: Option<Vec<f64>>,
}

/// The uncertainty of a tool that is corrected with the links of an estimate.
#[derive(Clone, Debug)]
pub struct ToolError<'a> {
    nominal: &'a Robot,
    estimate: &'a Estimate,
    tool: ToolPoint,
    identified: PerturbedRobot,
    /// For each parameter: its step, mm or rad, and the robot with this step to both sides.
    moved: Vec<(f64, [PerturbedRobot; 2])>,
    /// Error of the flange that the estimate does not contain (3-D), mm; see [`flange_error_mm`].
    flange_error_mm: f64,
}

impl<'a> ToolError<'a> {
    /// Prepares the uncertainty of a tool in the frame of `base`. The estimate belongs to `nominal`, and contains the target if the tool is one.
    pub fn new(nominal: &'a Robot, estimate: &'a Estimate, base: Base, tool: ToolPoint) -> Self {
        let step_mm = STEP_RAD * reach_mm(&nominal.links);
        let has_tool = contains_tool(&estimate.model.links, &nominal.links);
        let moved = |parameter: &Parameter| {
            let step = if parameter.is_angle() {
                STEP_RAD
            } else {
                step_mm
            };
            let sides = [step, -step].map(|by| {
                let model = apply(&estimate.model, &[*parameter], &[by]);
                PerturbedRobot::new(model, nominal, base, has_tool)
            });
            (step, sides)
        };
        Self {
            identified: PerturbedRobot::new(estimate.model.clone(), nominal, base, has_tool),
            flange_error_mm: flange_error_mm(nominal, estimate, base, &tool),
            moved: estimate.parameters.iter().map(moved).collect(),
            nominal,
            estimate,
            tool,
        }
    }

    /// Standard deviation (3-D) of the tool's position, mm, at the controller's joint values `q_controller_rad`.
    pub fn std_mm(&self, q_controller_rad: &[f64], wanted: ToolGoal<'_>) -> f64 {
        let poses = Poses {
            corrected_rad: self.nominal.q_model_rad(q_controller_rad),
            nominal_rad: match wanted {
                ToolGoal::AsNominal(q_rad) => Some(self.nominal.q_model_rad(q_rad)),
                ToolGoal::Fixed => None,
            },
        };
        let by_parameters = Matrix3xX::from_columns(
            &self
                .moved
                .iter()
                .map(|m| self.slope(m, &poses))
                .collect::<Vec<_>>(),
        );
        let uncertainty = &self.estimate.uncertainty;
        let (root, p) = (&uncertainty.root, uncertainty.n_parameters);
        let mut errors: DMatrix<f64> =
            DMatrix::from_iterator(3, p, by_parameters.iter().copied()) * root.rows(0, p);
        if root.nrows() > p {
            errors += self.features(&poses.corrected_rad) * root.rows(p, root.nrows() - p);
        }
        // a fixed position of the reflector itself does not depend on where the flange is
        let is_of_flange = wanted != ToolGoal::Fixed || matches!(self.tool, ToolPoint::Tcp { .. });
        let flange_error_mm = if is_of_flange {
            self.flange_error_mm
        } else {
            0.0
        };
        libm::hypot(errors.norm(), flange_error_mm)
    }

    fn slope(&self, (step, sides): &(f64, [PerturbedRobot; 2]), poses: &Poses) -> Vector3<f64> {
        let [plus, minus] = sides
            .each_ref()
            .map(|side| side.miss_mm(self.nominal, &self.tool, poses));
        (plus - minus) / (2.0 * step)
    }

    /// Displacement of the tool by the features of the misfit, mm per rad: 3 × m, in the frame in which targets are met.
    fn features(&self, q_rad: &[f64]) -> DMatrix<f64> {
        let PerturbedRobot { model, anchor } = &self.identified;
        // the tool as an additional target, in the flange frame of the identified links
        let tool_mm =
            anchor.t_anchored_flange.inverse() * Point3::from(self.identified.tool_mm(&self.tool));
        let mut with_tool = model.clone();
        with_tool.targets_mm.push(tool_mm.coords);
        let pose = [(q_rad, model.targets_mm.len(), 1.0)];
        let misfit = &self.estimate.uncertainty.features;
        let in_measuring_frame = misfit.features(&with_tool, pose.into_iter());
        let t_measuring_anchored: IsometryMatrix3<f64> =
            model.t_instrument_base * anchor.t_base_anchored;
        let turned = t_measuring_anchored.rotation.inverse();
        DMatrix::from_fn(3, in_measuring_frame.ncols(), |axis, column| {
            let moved = in_measuring_frame.fixed_view::<3, 1>(0, column);
            (turned.matrix() * moved)[axis]
        })
    }
}
