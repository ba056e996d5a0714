//! Preliminary base and tool frame from single-joint sweeps [Gao 2018, section 2.2].

pub mod base_frame;
pub mod circle_fit;
mod error;
pub mod sweep;
pub mod tool_frame;

pub use error::Error;
pub use sweep::SweepCircle;

use crate::kinematics::forward::forward_kinematics;
use crate::kinematics::{Robot, reach_mm};
use crate::measurement::{MeasurementSet, Point};
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use std::collections::BTreeSet;

/// Result of the sweeps of joints 1, 2 and 5.
#[derive(Clone, Debug, PartialEq)]
pub struct PreliminaryFrames {
    /// Base frame in the instrument frame, mm.
    pub t_instrument_base: IsometryMatrix3<f64>,
    /// Target's distance from the flange along its axis, mm.
    pub z_tool_mm: f64,
    /// The fitted circles.
    pub circles: Vec<SweepCircle>,
}

impl Error {
    /// Machine-readable code; it never changes.
    pub fn code(&self) -> &'static str {
        match self {
            Self::TooFewJoints { .. } => "too_few_joints",
            Self::MissingSweep { .. } => "missing_sweep",
            Self::TooFewPoints { .. } => "too_few_points",
            Self::OtherJointMoved { .. } => "other_joint_moved",
            Self::ShortArc { .. } => "short_arc",
            Self::DegenerateSweep { .. } => "degenerate_sweep",
            Self::PoorCircle { .. } => "poor_circle",
            Self::SeveralTargets { .. } => "several_targets",
            Self::ArcMismatch { .. } => "arc_mismatch",
            Self::ParallelAxes { .. } => "parallel_axes",
            Self::FarFromNominal { .. } => "far_from_nominal",
            Self::ToolNotVisible { .. } => "tool_not_visible",
        }
    }
}

/// Base and tool frame from sweeps of joints 1, 2 and n-1 (5 on a six-axis robot) [Gao 2018, section 2.2].
///
/// # Errors
/// See [`Error`]: missing, short, degenerate or inconsistent sweeps, parallel axes.
pub fn preliminary_frames(
    robot: &Robot,
    sweeps: &MeasurementSet,
) -> Result<PreliminaryFrames, Error> {
    let n_joints = robot.links.len();
    if n_joints < 3 {
        return Err(Error::TooFewJoints { n_joints });
    }
    let targets: BTreeSet<usize> = sweeps.points.iter().map(|p| p.target).collect();
    if targets.len() > 1 {
        return Err(Error::SeveralTargets {
            targets: targets.into_iter().collect(),
        });
    }
    let sweep_1 = sweep::fit_sweep(robot, sweeps, 1)?;
    let sweep_2 = sweep::fit_sweep(robot, sweeps, 2)?;
    let sweep_tool = sweep::fit_sweep(robot, sweeps, n_joints - 1)?;
    let t_instrument_base = base_frame::base_frame(robot, &sweep_1, &sweep_2)?;
    let z_tool_mm = tool_frame::z_tool_mm(robot, &sweep_tool)?;
    let swept = sweeps.points.iter().filter(|p| {
        p.sweep_joint
            .is_some_and(|joint| [1, 2, n_joints - 1].contains(&joint))
    });
    let rms_mm = rms_from_nominal_mm(robot, swept, &t_instrument_base, z_tool_mm);
    let limit_mm = NEAR_PER_REACH * reach_mm(&robot.links);
    if rms_mm.is_nan() || rms_mm > limit_mm {
        return Err(Error::FarFromNominal { rms_mm, limit_mm });
    }
    Ok(PreliminaryFrames {
        t_instrument_base,
        z_tool_mm,
        circles: vec![sweep_1.circle, sweep_2.circle, sweep_tool.circle],
    })
}

/// Limit for the distance of points from the nominal robot's prediction, rms, as a share of the reach (20 mm on an arm of 2 m). It is several times
/// the errors of robots, and far below the effect of a wrong unit, axis or robot.
const NEAR_PER_REACH: f64 = 0.01;

fn rms_from_nominal_mm<'a>(
    robot: &Robot,
    points: impl Iterator<Item = &'a Point>,
    t_instrument_base: &IsometryMatrix3<f64>,
    z_tool_mm: f64,
) -> f64 {
    let target = Vector3::new(0.0, 0.0, z_tool_mm);
    let squares: Vec<f64> = points
        .map(|p| {
            let p_base_target =
                forward_kinematics(&robot.links, &robot.q_model_rad(&p.q_rad), &target);
            (t_instrument_base * Point3::from(p_base_target) - Point3::from(p.position_mm))
                .norm_squared()
        })
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}
