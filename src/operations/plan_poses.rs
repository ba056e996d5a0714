//! Pose planning: chooses the poses to measure next.

use crate::calibration::DEFAULT_VERIFY_FRACTION;
use crate::identification::model::objective::Observation;
use crate::identification::model::pose_rows::MeasuredRotation;
use crate::identification::statistics::workspace::ToolUncertainty;
use crate::kinematics::Robot;
use crate::measurement::{MeasurementSet, Point};
use crate::planning::{
    self, AcceptanceCone, LineOfSight, Noise, Plan, PlanRequest, Room, SetUp, TooLittleRoom,
};
use crate::wire::issue::Invalid;
use crate::wire::job::Model;
use crate::wire::pose_plan::{
    BoxBody, PlanKind, PlannedConfiguration, PlannedSetUp, PosePlanAnswer, PosePlanBody, SetUpBody,
};
use crate::wire::report_shape::ToolUncertaintyReport;
use crate::wire::warning::Warning;
use nalgebra::{Unit, Vector3};
use std::collections::BTreeMap;

/// Default noise of one coordinate, mm. It includes the tracker and the repeatability of the arm.
const DEFAULT_NOISE_MM: f64 = 0.05;
/// Default noise of one component of the rotation vector of a pose, degrees. It includes the instrument and the repeatability of the arm.
const DEFAULT_NOISE_ROTATION_DEG: f64 = 0.02;
/// Default number of candidates.
const DEFAULT_CANDIDATES: usize = 10_000;
/// Default number of repeats of a set-up with at least [`FEWEST_WITH_REPEATS`] configurations. A smaller one has none.
const DEFAULT_REPEATS: usize = 3;
const FEWEST_WITH_REPEATS: usize = 20;
/// Half angle of the acceptance cone, if only its axis is stated: that of most reflectors, degrees.
const DEFAULT_HALF_ANGLE_DEG: f64 = 30.0;
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
    let rotation_std_deg = request
        .noise_std_rotation_deg
        .unwrap_or(DEFAULT_NOISE_ROTATION_DEG);
    let set_ups: Vec<SetUp> = allowed_spaces(request)
        .into_iter()
        .zip(request.shares())
        .map(|(room, n_configurations)| SetUp {
            n_configurations,
            n_repeats: request.n_repeats.unwrap_or(match n_configurations {
                ..FEWEST_WITH_REPEATS => 0,
                _ => DEFAULT_REPEATS,
            }),
            room,
        })
        .collect();
    let plan = planning::plan(&PlanRequest {
        robot,
        model,
        target_mm: Vector3::from(target_mm),
        n_candidates: request.n_candidates.unwrap_or(DEFAULT_CANDIDATES) / set_ups.len(),
        noise: Noise {
            position_std_mm: request.noise_std_mm.unwrap_or(DEFAULT_NOISE_MM),
            rotation_std_rad: rotation_std_deg.to_radians(),
        },
        is_of_poses: request.kind.unwrap_or_default() == PlanKind::Pose,
        seed: request.seed,
        measured: measured
            .iter()
            .flat_map(|set| of_each_station(robot, set))
            .collect(),
        set_ups,
    })
    .map_err(|error| too_little_room(request, &error))?;
    Ok(answer(request, &plan))
}

/// The space in which the robot may move, one for each set-up; a single space without set-ups.
fn allowed_spaces(request: &PosePlanBody) -> Vec<Room> {
    if request.set_ups.is_empty() {
        return vec![allowed_space(
            request,
            &request.boxes,
            request.instrument_mm,
        )];
    }
    let of_set_up = |set_up: &SetUpBody| {
        let own = Some(&set_up.boxes).filter(|boxes| !boxes.is_empty());
        allowed_space(request, own.unwrap_or(&request.boxes), set_up.instrument_mm)
    };
    request.set_ups.iter().map(of_set_up).collect()
}

fn allowed_space(
    request: &PosePlanBody,
    boxes: &[BoxBody],
    instrument_mm: Option<[f64; 3]>,
) -> Room {
    let half_angle_deg = request
        .target_half_angle_deg
        .unwrap_or(DEFAULT_HALF_ANGLE_DEG);
    let cone = request.target_axis.map(|axis| AcceptanceCone {
        axis: Unit::new_normalize(Vector3::from(axis)).into_inner(),
        half_angle_rad: half_angle_deg.to_radians(),
    });
    Room {
        boxes_mm: boxes.iter().map(Into::into).collect(),
        keep_out_mm: request.keep_out.iter().map(Into::into).collect(),
        floor_z_mm: request.floor_z_mm,
        base_cylinder: request.base_cylinder.as_ref().map(Into::into),
        line_of_sight: instrument_mm.map(|at| LineOfSight {
            instrument_mm: Vector3::from(at),
            cone,
        }),
    }
}

fn too_little_room(request: &PosePlanBody, error: &TooLittleRoom) -> Invalid {
    let Some(set_up) = request.set_ups.get(error.set_up) else {
        return Invalid::at("/boxes", "too_little_room", error.to_string());
    };
    let at = format!("/set_ups/{}", error.set_up);
    Invalid::at(
        &at,
        "too_little_room",
        format!("set-up {:?}: {error}", set_up.name),
    )
}

/// Warns if a job cannot identify from the plan. Gives no warning if earlier measurements are named, because they can be fitted together
/// with it.
fn warnings(request: &PosePlanBody, plan: &Plan) -> Vec<Warning> {
    if !request.measured.is_empty() {
        return vec![];
    }
    let n_rows = match request.kind.unwrap_or_default() {
        PlanKind::Position => 3,
        PlanKind::Pose => 6,
    };
    let n_configurations = plan.n_equations / n_rows;
    let n_needed = plan.n_combinations.div_ceil(n_rows);
    let warning = |code: &str, detail: String| {
        vec![Warning {
            code: code.into(),
            detail,
            rows: vec![],
            points: vec![],
        }]
    };
    let given = format!(
        "{n_configurations} different configurations give {} equations, and the parameters have {} independent combinations",
        plan.n_equations, plan.n_combinations
    );
    // Half of them are fitted, and that half must be sufficient.
    let n_enough = 2 * n_needed;
    if n_configurations < n_needed {
        let detail = format!(
            "{given}. A job holds out half of the configurations to verify: measure {n_enough} or more, or hold parameters in the job"
        );
        return warning("under_determined", detail);
    }
    let n_identified =
        n_configurations - (n_configurations as f64 * DEFAULT_VERIFY_FRACTION) as usize;
    if n_identified < n_needed {
        let most = 1.0 - n_needed as f64 / n_configurations as f64;
        let detail = format!(
            "{given}. A job holds out half of the configurations to verify and could not identify from the rest: measure {n_enough} or more, or post the job \
             with a verify fraction of at most {:.2}",
            (most * 100.0).floor() / 100.0
        );
        return warning("under_determined", detail);
    }
    vec![]
}

fn answer(request: &PosePlanBody, plan: &Plan) -> PosePlanAnswer {
    let name = |set_up: usize| Some(request.set_ups.get(set_up)?.name.clone());
    PosePlanAnswer {
        configurations: plan
            .configurations
            .iter()
            .map(|planned| PlannedConfiguration {
                q_deg: planned
                    .q_controller_rad
                    .iter()
                    .map(|rad| rad.to_degrees())
                    .collect(),
                set_up: name(planned.set_up),
                repeats: planned.repeats,
            })
            .collect(),
        observability_index_o1: plan.observability_index_o1,
        predicted_std_mm: of_all_set_ups(&plan.predicted),
        predicted_std_mm_random: of_all_set_ups(&plan.predicted_random),
        warnings: warnings(request, plan),
        set_ups: request
            .set_ups
            .iter()
            .zip(request.shares())
            .zip(&plan.predicted)
            .map(|((set_up, n_configurations), predicted)| PlannedSetUp {
                name: set_up.name.clone(),
                n_configurations,
                predicted_std_mm: ToolUncertaintyReport::from(*predicted),
            })
            .collect(),
    }
}

/// The largest mean and the largest maximum of all set-ups; the two may be from different set-ups.
fn of_all_set_ups(predicted: &[ToolUncertainty]) -> ToolUncertaintyReport {
    let largest =
        |value: fn(&ToolUncertainty) -> f64| predicted.iter().map(value).fold(0.0, f64::max);
    ToolUncertaintyReport::from(ToolUncertainty {
        mean_mm: largest(|tool| tool.mean_mm),
        max_mm: largest(|tool| tool.max_mm),
    })
}

/// The points of each station. Each station may have another base.
fn of_each_station(robot: &Robot, set: &MeasurementSet) -> Vec<Vec<Observation>> {
    let observation = |point: &Point| Observation {
        rotation: point.rotation.map(|rotation| MeasuredRotation {
            rotation,
            mm_per_rad: 1.0,
            lever_mm: point.lever_mm,
        }),
        ..Observation::at(
            robot.q_model_rad(&point.q_rad),
            point.position_mm,
            point.target,
        )
    };
    let mut stations: BTreeMap<Option<&str>, Vec<Observation>> = BTreeMap::new();
    for point in &set.points {
        let station = stations.entry(point.station.as_deref()).or_default();
        station.push(observation(point));
    }
    stations.into_values().collect()
}
