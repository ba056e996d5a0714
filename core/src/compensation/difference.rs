//! Difference between the tools of two identified robots over the workspace.

use crate::compensation::{Base, Compensation};
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::statistics::workspace::random_configurations;
use crate::kinematics::{Robot, t_base_flange};
use nalgebra::{Point3, Vector3};

/// Number of configurations at which the two robots are compared.
const N_CONFIGURATIONS: usize = 200;
/// Seed of these configurations: the same for every comparison.
const SEED: u64 = 0;

/// Differences at seeded configurations within the joint limits.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolDifferences {
    /// One per configuration.
    pub points: Vec<ToolDifference>,
    /// Mean length of the differences, mm.
    pub mean_mm: f64,
    /// The largest, mm.
    pub max_mm: f64,
}

/// The difference at one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolDifference {
    /// Joint values in the controller's convention, rad.
    pub q_controller_rad: Vec<f64>,
    /// Tool of the nominal robot, nominal base frame, mm.
    pub position_mm: Vector3<f64>,
    /// Tool of the first robot − tool of the second, base frame, mm.
    pub difference_mm: Vector3<f64>,
}

/// Compares two robots that were identified from the same nominal `robot`. Base and flange of both are anchored to their own axes, so the positions
/// of instrument and reflector do not matter. The tool is target 0 of the first robot.
pub fn tool_differences(
    robot: &Robot,
    first: &IdentifiedRobot,
    second: &IdentifiedRobot,
) -> ToolDifferences {
    let (of_first, of_second) = (
        Compensation::of(robot, first, Base::Robot),
        Compensation::of(robot, second, Base::Robot),
    );
    let tool = Point3::from(of_first.p_anchored_mm(&first.target_mm(0)));
    let difference = |q_controller_rad: Vec<f64>| {
        let q_rad = robot.q_model_rad(&q_controller_rad);
        ToolDifference {
            q_controller_rad,
            position_mm: (t_base_flange(&robot.links, &q_rad) * tool).coords,
            difference_mm: of_first.t_base_flange(&q_rad) * tool
                - of_second.t_base_flange(&q_rad) * tool,
        }
    };
    let points: Vec<ToolDifference> = random_configurations(robot, N_CONFIGURATIONS, SEED)
        .into_iter()
        .map(difference)
        .collect();
    let lengths = points.iter().map(|point| point.difference_mm.norm());
    let (sum, max_mm) = lengths.fold((0.0, 0.0f64), |(sum, max), length| {
        (sum + length, max.max(length))
    });
    ToolDifferences {
        mean_mm: sum / points.len().max(1) as f64,
        max_mm,
        points,
    }
}
