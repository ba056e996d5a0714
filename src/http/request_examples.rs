//! Examples in the OpenAPI document that belong to an operation or a shape, for the robot of `data/paper`. A test sends each request.

use serde_json::{Value, json};

const ROBOT: &str = include_str!("../../data/paper/robot.json");
const SWEEPS: &str = include_str!("../../data/paper/sweeps_instrument.csv");
/// Takes every fourth pose of the sweeps. Each joint then has at least five poses, the minimum.
const SWEEP_STEP: usize = 4;

/// Joint values of the examples, degrees, and where the reflector was measured, mm.
const Q_DEG: [f64; 6] = [10.0, -20.0, 30.0, 0.0, 45.0, 0.0];
const POSITION_MM: [f64; 3] = [710.9412, 125.3701, -131.3868];
const SET: &str = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n10,-20,30,0,45,0,710.9412,125.3701,-131.3868\n";
const PROGRAM: &str =
    "name,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\nP1,10,-20,30,0,45,0\nP2,15,-25,35,0,40,0\n";
/// A robot's log and an instrument's export.
const LOG: &str =
    "Point,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\nP1,10,-20,30,0,45,0\n";
const EXPORT: &str = "Name,X [mm],Y [mm],Z [mm]\nP1,710.9412,125.3701,-131.3868\n";
const LINKS: &str = "a_mm,alpha_deg,d_mm,theta_offset_deg\n0,0,504,0\n166.605,-90,0,0\n782.27,0,0,0\n138.826,-90,761.35,0\n0,90,0,0\n0,-90,125,0\n";
const URDF: &str = r#"<?xml version="1.0"?>
<robot name="cell_4">
  <joint name="joint_1" type="revolute"><parent link="base"/><child link="link_1"/><origin xyz="0 0 0.504" rpy="0 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="joint_2" type="revolute"><parent link="link_1"/><child link="link_2"/><origin xyz="0.166605 0 0" rpy="-1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="joint_3" type="revolute"><parent link="link_2"/><child link="link_3"/><origin xyz="0.78227 0 0" rpy="0 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="joint_4" type="revolute"><parent link="link_3"/><child link="link_4"/><origin xyz="0.138826 0.76135 0" rpy="-1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="joint_5" type="revolute"><parent link="link_4"/><child link="link_5"/><origin xyz="0 0 0" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="joint_6" type="revolute"><parent link="link_5"/><child link="flange"/><origin xyz="0 0.125 0" rpy="-1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>
</robot>
"#;

/// The example of a body whose type is not JSON, or of a request whose JSON has no schema.
pub fn example_of_operation(operation_id: &str, media_type: &str) -> Option<Value> {
    Some(match (operation_id, media_type) {
        ("createFrames", "text/csv") => sweeps().into(),
        ("compensateProgram", "text/csv") => PROGRAM.into(),
        ("importRobot" | "exportParameterSet", "text/csv") => LINKS.into(),
        ("importRobot", "application/json") => json!([
            {"a_mm": 0.0, "alpha_deg": 0.0, "d_mm": 504.0, "theta_offset_deg": 0.0},
            {"a_mm": 166.605, "alpha_deg": -90.0, "d_mm": 0.0, "theta_offset_deg": 0.0}
        ]),
        (_, "application/xml") => URDF.into(),
        (_, "text/csv") => SET.into(),
        ("createMeasurementSet" | "previewMeasurementSet", "multipart/form-data") => {
            json!({"instrument": EXPORT, "robot": LOG})
        }
        _ => return None,
    })
}

fn sweeps() -> String {
    let rows = SWEEPS.lines().skip(1).step_by(SWEEP_STEP);
    let lines = SWEEPS.lines().take(1).chain(rows);
    lines.map(|line| format!("{line}\n")).collect()
}

/// Examples of shapes whose fields are all optional, or whose values belong together.
pub fn example_of_shape(name: &str) -> Option<Value> {
    Some(match name {
        "RobotBody" => serde_json::from_str(ROBOT).ok()?,
        "RobotPatchBody" => json!({"name": "Cell 4, left", "serial_number": "ER20-0117"}),
        "ReleaseBody" | "ReasonBody" => json!({"reason": "verified on a second session"}),
        "PolicyBody" => {
            json!({"tolerance_mm": 0.3, "decision_rule": "guarded_acceptance", "independent_session_required": true, "second_person_required": false})
        }
        "MeasurementSetBody" => {
            json!({"frame": "base", "points": [{"q_deg": Q_DEG, "position_mm": POSITION_MM}]})
        }
        "JobRequestBody" => json!({"measurement_set_id": "set_0199b6a4c1d27a10b5e43c7f9d2e6a81"}),
        "PredictBody" => json!({"q_deg": [Q_DEG]}),
        "CompensateBody" => {
            json!({"q_deg": [Q_DEG], "tool": {"translation_mm": [0.0, 0.0, 100.0]}})
        }
        "PostureBody" => {
            json!({"q_deg": Q_DEG, "shown_position_mm": [791.6, 139.6, -74.0], "shown_orientation": {"kuka_abc_deg": [10.0, 55.0, 180.0]}})
        }
        "PosePlanBody" => json!({"n_configurations": 30, "n_candidates": 1000}),
        "ColumnsBody" => json!({"q1_deg": "J1 [deg]", "x_mm": "X (mm)"}),
        "WorkFrameBody" => {
            json!({"translation_mm": [900.0, -200.0, 300.0], "quaternion": [1.0, 0.0, 0.0, 0.0]})
        }
        "ToolBody" => json!({"translation_mm": [30.0, -45.0, 160.0]}),
        "NewReference" => {
            json!({"name": "scale bar 1", "items": [{"name": "A to B", "nominal_mm": 1000.0, "measured_mm": 1000.012, "std_mm": 0.005}]})
        }
        _ => return None,
    })
}
