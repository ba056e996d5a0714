//! Uncertainty of a corrected tool's position relative to its target, from the covariance of the identification.
//!
//! With d = tool − target at fixed joint values, the links' errors δ change d by ∂d/∂δ. Effects that links cannot describe change it by the
//! features of [`misfit`](crate::identification::statistics::misfit). The identification gives the root R of the mean square error of both.
//! One standard deviation of d (3-D: the root of the sum of three variances) is |∂d/∂(δ, u) · R|. With corrections, δ includes their terms.
//! Derivatives are central differences, because base and flange depend on the links. Measured positions do not show theta_offset and d of
//! the last link. If these matter, their usual errors are added in squares (see [`ToolPoint::Tcp`] and [`HeldReflector`]).

use crate::compensation::anchor::{
    Anchor, HeldReflector, anchor_in, contains_tool, usual_error_of_last_d_mm,
};
use crate::compensation::mode::Base;
use crate::compensation::targets::Tool;
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::{CorrectedModel, IdentifiedRobot};
use crate::identification::least_squares::problem::USUAL_OFFSET_RAD;
use crate::identification::model::parameters::{Parameter, Quantity, apply};
use crate::identification::statistics::estimate::CorrectedErrors;
use crate::identification::statistics::estimate::Estimate;
use crate::identification::statistics::estimate::faded;
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::kinematics::{Robot, reach_mm, t_base_flange};
use nalgebra::{DMatrix, IsometryMatrix3, Point3, Vector3};

/// Step of an angle, rad. For this step, both its square and the rounding error are negligible.
const STEP_RAD: f64 = 1e-6;

/// The target of the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToolGoal<'a> {
    /// The tool's position on the nominal robot at these joint values, rad, in the controller's convention.
    AsNominal(&'a [f64]),
    /// A fixed position in the frame of the targets. It does not depend on the robot.
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

    /// Tool minus target, mm, in the frame of the targets, up to a constant.
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
        /// Standard uncertainty of one coordinate of this position, mm, if it was measured with this robot and is thus relative to its
        /// calibrated axes. `None` if the position is relative to the flange, e.g. from a drawing. The flange then has the usual errors of
        /// theta_offset and d of the last link, which measured positions of a reflector do not show.
        std_mm: Option<f64>,
    },
}

impl ToolPoint {
    /// The centre of a tool. `target` is the number of a [`Tool::Target`] or [`Tool::TargetPose`], `std_mm` is that of a [`Tool::Tcp`].
    pub fn of(tool: &Tool, target: usize, std_mm: Option<f64>) -> Self {
        match tool {
            Tool::Target(_) | Tool::TargetPose(_) => Self::Target(target),
            Tool::Tcp(pose) => Self::Tcp {
                flange_mm: pose.translation.vector,
                std_mm,
            },
        }
    }
}

/// Error of the flange at the tool that the covariance does not contain (3-D), mm. It has two parts. Along the last axis it is the error of
/// d of the last link, because the [`anchor`](crate::compensation::anchor) keeps d nominal or the reflector was held at the flange. About
/// the last axis it is the error of the last link's theta_offset, times the tool's distance from the axis. An identified target depends on
/// neither, unless it was held at the flange.
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

/// Errors of an identified robot's tool about the identified parameters: of its links alone, or of links with corrections.
#[derive(Clone, Debug)]
struct ToolErrors<'a> {
    uncertainty: &'a Uncertainty,
    identified: PerturbedRobot,
    /// For each parameter: its step, mm or rad, and the robot with this step to both sides.
    moved: Vec<(f64, [PerturbedRobot; 2])>,
    corrections: Option<(&'a CorrectedErrors, &'a CorrectedModel)>,
}

/// The uncertainty of a tool that is corrected with an identified robot.
#[derive(Clone, Debug)]
pub struct ToolError<'a> {
    nominal: &'a Robot,
    estimate: &'a Estimate,
    identified: &'a IdentifiedRobot,
    tool: ToolPoint,
    of_links: ToolErrors<'a>,
    with_corrections: Option<ToolErrors<'a>>,
    /// Error of the flange that the estimate does not contain (3-D), mm; see [`flange_error_mm`].
    flange_error_mm: f64,
}

impl<'a> ToolErrors<'a> {
    /// `model` is perturbed by each of the parameters; `perturbed` anchors it.
    fn new(
        nominal: &Robot,
        (model, parameters): (&KinematicModel, &[Parameter]),
        uncertainty: &'a Uncertainty,
        perturbed: impl Fn(KinematicModel) -> PerturbedRobot,
    ) -> Self {
        let step_mm = STEP_RAD * reach_mm(&nominal.links);
        let moved = |parameter: &Parameter| {
            let step = match parameter.is_angle() {
                true => STEP_RAD,
                false => step_mm,
            };
            let sides = [step, -step].map(|by| perturbed(apply(model, &[*parameter], &[by])));
            (step, sides)
        };
        Self {
            uncertainty,
            identified: perturbed(model.clone()),
            moved: parameters.iter().map(moved).collect(),
            corrections: None,
        }
    }

    /// Standard deviation (3-D) of the tool, mm, without that of the flange.
    fn std_mm(&self, nominal: &Robot, tool: &ToolPoint, poses: &Poses) -> f64 {
        let slopes = self.moved.iter().flat_map(|(step, sides)| {
            let [plus, minus] = sides
                .each_ref()
                .map(|side| side.miss_mm(nominal, tool, poses));
            <[f64; 3]>::from((plus - minus) / (2.0 * step))
        });
        let by_parameter = DMatrix::from_iterator(3, self.moved.len(), slopes);
        let [by_term, by_feature] = self.by_terms_and_features(tool, &poses.corrected_rad);
        self.uncertainty
            .displacements_mm([&by_parameter, &by_term, &by_feature])
            .norm()
    }

    /// Displacement of the tool by the terms of the corrections and by the features of the misfit, mm per unit: 3 × t and 3 × m, in the
    /// frame of the targets.
    fn by_terms_and_features(&self, tool: &ToolPoint, q_rad: &[f64]) -> [DMatrix<f64>; 2] {
        let PerturbedRobot { model, anchor } = &self.identified;
        // The tool is added as another target, in the flange frame of the identified links.
        let tool_mm =
            anchor.t_anchored_flange.inverse() * Point3::from(self.identified.tool_mm(tool));
        let mut with_tool = model.clone();
        with_tool.targets_mm.push(tool_mm.coords);
        let target = model.targets_mm.len();
        let pose = [(q_rad, target, 1.0)].into_iter();
        let by_feature = self.uncertainty.features.features(&with_tool, pose);
        let by_term = self.corrections.map(|(errors, corrected)| {
            let with_tool = CorrectedModel {
                model: with_tool,
                ..corrected.clone()
            };
            errors.by_terms_mm(&with_tool, q_rad, target)
        });
        let by_term = by_term.unwrap_or_else(|| DMatrix::zeros(3, 0));
        let t_measuring_anchored: IsometryMatrix3<f64> =
            model.t_instrument_base * anchor.t_base_anchored;
        let turned = t_measuring_anchored.rotation.inverse();
        let turned = DMatrix::from_column_slice(3, 3, turned.matrix().as_slice());
        [by_term, by_feature].map(|in_measuring_frame| &turned * in_measuring_frame)
    }
}

impl<'a> ToolError<'a> {
    /// Prepares the uncertainty of a tool in the frame of `base`. The estimate belongs to `nominal` and `identified`, and contains the target if the tool
    /// is one.
    pub fn new(
        nominal: &'a Robot,
        estimate: &'a Estimate,
        identified: &'a IdentifiedRobot,
        base: Base,
        tool: ToolPoint,
    ) -> Self {
        let has_tool = contains_tool(&estimate.model.links, &nominal.links);
        let perturbed = |model| PerturbedRobot::new(model, nominal, base, has_tool);
        let about = |model: &KinematicModel, uncertainty| {
            let identified = (model, estimate.parameters.as_slice());
            ToolErrors::new(nominal, identified, uncertainty, perturbed)
        };
        let corrections = estimate
            .corrected
            .as_ref()
            .zip(identified.corrected.as_ref());
        let with_corrections = corrections.map(|(errors, corrected)| ToolErrors {
            corrections,
            ..about(&corrected.model, &errors.uncertainty)
        });
        Self {
            of_links: about(&estimate.model, &estimate.uncertainty),
            with_corrections,
            flange_error_mm: flange_error_mm(nominal, estimate, base, &tool),
            nominal,
            estimate,
            identified,
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
        let of = |with_corrections: bool| {
            let corrected = self.with_corrections.as_ref().filter(|_| with_corrections);
            let errors = corrected.unwrap_or(&self.of_links);
            errors.std_mm(self.nominal, &self.tool, &poses)
        };
        let std_mm = faded(self.estimate, self.identified, &poses.corrected_rad, of);
        // A fixed position of the reflector itself does not depend on the flange.
        let is_of_flange = wanted != ToolGoal::Fixed || matches!(self.tool, ToolPoint::Tcp { .. });
        let flange_error_mm = if is_of_flange {
            self.flange_error_mm
        } else {
            0.0
        };
        libm::hypot(std_mm, flange_error_mm)
    }
}
