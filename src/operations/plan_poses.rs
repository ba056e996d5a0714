//! Pose planning: chooses the poses to measure next.

use crate::identification::objective::Observation;
use crate::kinematics::Robot;
use crate::measurement::{MeasurementSet, Point};
use crate::planning::{self, PlanRequest, Room};
use crate::wire::issue::Invalid;
use crate::wire::job::Model;
use crate::wire::pose_plan::{
    DEFAULT_CANDIDATES, PlannedConfiguration, PosePlanAnswer, PosePlanBody,
};
use crate::wire::report_shape::ToolUncertaintyReport;
use nalgebra::Vector3;

/// Default noise of one coordinate, mm. It includes the tracker and the repeatability of the arm.
const DEFAULT_NOISE_MM: f64 = 0.05;
/// Assumed position of the reflector with `model: complete`: off the flange's axis, so that the position depends on all joints.
const OFF_AXIS_MM: [f64; 3] = [80.0, 0.0, 100.0];
/// Assumed position of the reflector with `model: paper`: on the flange's axis.
const ON_AXIS_MM: [f64; 3] = [0.0, 0.0, 100.0];

/// Computes a pose plan. `measured` are the measurement sets that the request refers to.
///
/// # Errors
/// [`Invalid`] for values out of range, and if the allowed space contains too few configurations.
pub fn plan_poses(
    request: &PosePlanBody,
    robot: &Robot,
    measured: &[MeasurementSet],
) -> Result<PosePlanAnswer, Invalid> {
    request.check()?;
    let model = request.model.unwrap_or(Model::Complete);
    let target_mm = request.target_mm.unwrap_or(if model == Model::Paper {
        ON_AXIS_MM
    } else {
        OFF_AXIS_MM
    });
    let plan_request = PlanRequest {
        robot,
        model,
        target_mm: Vector3::from(target_mm),
        n_configurations: request.n_configurations,
        n_repeats: request.n_repeats.unwrap_or(match request.n_configurations {
            0..20 => 0,
            _ => 3,
        }),
        n_candidates: request.n_candidates.unwrap_or(DEFAULT_CANDIDATES),
        noise_std_mm: request.noise_std_mm.unwrap_or(DEFAULT_NOISE_MM),
        seed: request.seed,
        room: Room::from(request),
        measured: measured
            .iter()
            .map(|set| observations(robot, set))
            .collect(),
    };
    let plan = planning::plan(&plan_request)
        .map_err(|error| Invalid::at("/boxes", "too_little_room", error.to_string()))?;
    Ok(PosePlanAnswer {
        configurations: plan
            .configurations
            .iter()
            .map(PlannedConfiguration::from)
            .collect(),
        observability_index_o1: plan.observability_index_o1,
        predicted_std_mm: ToolUncertaintyReport::from(plan.predicted),
        predicted_std_mm_random: ToolUncertaintyReport::from(plan.predicted_random),
    })
}

fn observations(robot: &Robot, set: &MeasurementSet) -> Vec<Observation> {
    let observation = |point: &Point| Observation {
        q_rad: robot.q_model_rad(&point.q_rad),
        position_mm: point.position_mm,
        target: point.target,
        weight: 1.0,
        whitening: None,
        rotation: None,
    };
    set.points.iter().map(observation).collect()
}
