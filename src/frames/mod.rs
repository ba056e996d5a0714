//! Preliminary base and tool frame from single-joint sweeps [Gao 2018, section 2.2].

pub mod base_frame;
pub mod circle_fit;
pub mod sweep;
pub mod tool_frame;

use crate::kinematics::Robot;
use crate::kinematics::forward::forward_kinematics;
use crate::measurement::{MeasurementSet, Point};
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use std::collections::BTreeSet;

/// A circle fitted to one sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepCircle {
    /// The joint that moved, 1-based.
    pub joint: usize,
    /// Centre in the instrument frame, mm.
    pub centre_mm: Vector3<f64>,
    /// Unit normal, along the joint's positive axis, instrument frame.
    pub normal: Vector3<f64>,
    /// Radius, mm.
    pub radius_mm: f64,
    /// Root mean square distance of the points from the circle, mm.
    pub rms_mm: f64,
}

/// What the sweeps of joints 1, 2 and 5 tell.
#[derive(Clone, Debug, PartialEq)]
pub struct PreliminaryFrames {
    /// Base frame in the instrument frame, mm.
    pub t_instrument_base: IsometryMatrix3<f64>,
    /// Target's distance from the flange along its axis, mm.
    pub z_tool_mm: f64,
    /// The circles behind it.
    pub circles: Vec<SweepCircle>,
}

/// Why sweeps cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The robot has too few joints for the method.
    #[error(
        "base and tool frame need sweeps of joints 1, 2 and n-1, so at least 3 joints; the robot has {n_joints}"
    )]
    TooFewJoints {
        /// The robot's joints.
        n_joints: usize,
    },
    /// No rows for a joint.
    #[error(
        "there is no sweep of joint {joint}: add rows with sweep_joint {joint} in which only that joint moves"
    )]
    MissingSweep {
        /// 1-based joint.
        joint: usize,
    },
    /// Not enough rows for a joint.
    #[error("the sweep of joint {joint} has {found} points, at least {needed} are needed")]
    TooFewPoints {
        /// 1-based joint.
        joint: usize,
        /// Rows found.
        found: usize,
        /// Rows needed.
        needed: usize,
    },
    /// A joint moved that should stand still.
    #[error("joint {other} moved during the sweep of joint {joint}; only the swept joint may move")]
    OtherJointMoved {
        /// 1-based joint of the sweep.
        joint: usize,
        /// 1-based joint that moved.
        other: usize,
    },
    /// The arc is too short to fix an axis.
    #[error(
        "the sweep of joint {joint} covers {arc_deg:.1}°, at least {needed_deg:.0}° are needed to find its axis"
    )]
    ShortArc {
        /// 1-based joint.
        joint: usize,
        /// What it covers, degrees.
        arc_deg: f64,
        /// What is needed, degrees.
        needed_deg: f64,
    },
    /// Points do not span a circle.
    #[error("the points of the sweep of joint {joint} do not lie on a circle")]
    DegenerateSweep {
        /// 1-based joint.
        joint: usize,
    },
    /// The points do not lie on one circle.
    #[error(
        "the points of the sweep of joint {joint} lie {rms_mm:.2} mm rms off one circle, at most {limit_mm:.2} mm are allowed; look for a wild point, a \
         reflector that slipped, or two reflectors in one sweep"
    )]
    PoorCircle {
        /// 1-based joint.
        joint: usize,
        /// Distance of the points from the circle, rms, mm.
        rms_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// More than one reflector.
    #[error(
        "the sweeps are of several reflectors ({targets:?}); measure one reflector, on the flange's axis, in all three sweeps"
    )]
    SeveralTargets {
        /// The targets named.
        targets: Vec<usize>,
    },
    /// The measured arc is not the one the joint made.
    #[error(
        "the points of the sweep of joint {joint} turn by {measured_deg:.1}°, the joint by {arc_deg:.1}°; is sweep_joint right?"
    )]
    ArcMismatch {
        /// 1-based joint.
        joint: usize,
        /// The joint's arc, degrees.
        arc_deg: f64,
        /// The points' arc, degrees.
        measured_deg: f64,
    },
    /// Axes 1 and 2 are parallel.
    #[error(
        "axes 1 and 2 stand at {angle_deg:.1}°; they must cross at 10° or more for the base frame to be found from them"
    )]
    ParallelAxes {
        /// Angle between them, degrees.
        angle_deg: f64,
    },
    /// The robot does not come near its sweeps, base and tool placed by them.
    #[error(
        "the points lie {rms_mm:.1} mm rms from where the nominal robot would be with the base and the tool found from them, at most {limit_mm} mm are \
         allowed: check the unit and the axes of the positions, the mastering of the joints, and that it is this robot"
    )]
    FarFromNominal {
        /// Root mean square distance, mm.
        rms_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// The tool sweep says nothing about z_t.
    #[error("the sweep of joint {joint} cannot show the target's distance from the flange")]
    ToolNotVisible {
        /// 1-based joint.
        joint: usize,
    },
}

impl Error {
    /// Stable code for the client.
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
    if rms_mm.is_nan() || rms_mm > NEAR_MM {
        return Err(Error::FarFromNominal {
            rms_mm,
            limit_mm: NEAR_MM,
        });
    }
    Ok(PreliminaryFrames {
        t_instrument_base,
        z_tool_mm,
        circles: vec![sweep_1.circle, sweep_2.circle, sweep_tool.circle],
    })
}

/// How far points may lie from where the nominal robot would be, rms, mm: several times what robots are off, and far below what a wrong unit,
/// axis or robot does.
const NEAR_MM: f64 = 20.0;

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
