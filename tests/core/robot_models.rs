//! The library of ready arms against the public descriptions and tables, by a walk of its own through 4×4 matrices.

use crate::data::{oracles_python, real_data, urdfs};
use crate::simulation::Normal;
use kincal::kinematics::{Robot, t_base_flange};
use kincal::operations::{posture, robot_models};
use kincal::wire::posture::{PostureAnswer, PostureBody, ShownOrientation};
use kincal::wire::robot_model::{RobotModel, RobotModelSource};
use nalgebra::{Matrix4, Vector3, Vector4};
use serde_json::Value;
use std::collections::BTreeSet;

/// What the library promises, mm.
const SAME_MM: f64 = 0.01;
/// Entries of rotations count as mm at this distance from the flange.
const AT_MM: f64 = 100.0;
/// A stated difference is the largest of 200 postures; other postures may be a bit worse.
const OTHER_POSTURES: f64 = 1.3;
const N_POSTURES: usize = 100;

fn library() -> &'static [RobotModel] {
    robot_models::all().unwrap()
}

fn shift(x: f64, y: f64, z: f64) -> Matrix4<f64> {
    Matrix4::new_translation(&Vector3::new(x, y, z))
}

/// A turn about any axis, by the formula for its nine entries.
fn turn(axis: [f64; 3], angle: f64) -> Matrix4<f64> {
    let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
    let [x, y, z] = axis.map(|v| v / length);
    let (s, c) = angle.sin_cos();
    let d = 1.0 - c;
    Matrix4::new(
        c + x * x * d,
        x * y * d - z * s,
        x * z * d + y * s,
        0.0,
        y * x * d + z * s,
        c + y * y * d,
        y * z * d - x * s,
        0.0,
        z * x * d - y * s,
        z * y * d + x * s,
        c + z * z * d,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
    )
}

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

fn numbers(text: &str) -> [f64; 3] {
    let all: Vec<f64> = text
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    all.try_into().unwrap()
}

/// One joint on the way: its origin, and its axis if it moves.
type Step = (Matrix4<f64>, Option<[f64; 3]>);

/// The joints from the root to a link.
fn way(document: &roxmltree::Document<'_>, link: &str) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut link = link.to_owned();
    let joint_to = |link: &str| {
        document.root_element().children().find(|joint| {
            joint.has_tag_name("joint")
                && joint
                    .children()
                    .any(|c| c.has_tag_name("child") && c.attribute("link") == Some(link))
        })
    };
    while let Some(joint) = joint_to(&link) {
        let child = |tag: &str| joint.children().find(|c| c.has_tag_name(tag));
        let three = |tag: &str, name: &str, default: [f64; 3]| {
            child(tag)
                .and_then(|c| c.attribute(name))
                .map_or(default, numbers)
        };
        let [x, y, z] = three("origin", "xyz", [0.0; 3]).map(|m| m * 1e3);
        let [roll, pitch, yaw] = three("origin", "rpy", [0.0; 3]);
        let origin = shift(x, y, z) * turn(Z, yaw) * turn(Y, pitch) * turn(X, roll);
        let moves = joint.attribute("type") != Some("fixed");
        steps.insert(0, (origin, moves.then(|| three("axis", "xyz", X))));
        link = child("parent")
            .unwrap()
            .attribute("link")
            .unwrap()
            .to_owned();
    }
    steps
}

fn walk(steps: &[Step], q_rad: &[f64]) -> Matrix4<f64> {
    let mut q = q_rad.iter();
    steps
        .iter()
        .fold(Matrix4::identity(), |t, (origin, axis)| match axis {
            Some(axis) => t * origin * turn(*axis, *q.next().unwrap()),
            None => t * origin,
        })
}

/// Joint values of the pendant, within the limits; a turn where there are none.
fn postures(robot: &Robot, random: &mut Normal) -> Vec<Vec<f64>> {
    let mut one = || {
        robot
            .joint_limits_rad
            .iter()
            .map(|limits| {
                let (low, high) = limits.unwrap_or((-3.0, 3.0));
                low + (high - low) * (0.5 + random.draw().clamp(-2.0, 2.0) / 4.0)
            })
            .collect()
    };
    (0..N_POSTURES).map(|_| one()).collect()
}

fn of_library(robot: &Robot, q_controller: &[f64]) -> Matrix4<f64> {
    t_base_flange(&robot.links, &robot.q_model_rad(q_controller)).to_homogeneous()
}

/// Distance of the origins, or of points [`AT_MM`] beside them.
fn apart_mm(a: &Matrix4<f64>, b: &Matrix4<f64>) -> f64 {
    let points = [
        Vector4::new(0.0, 0.0, 0.0, 1.0),
        Vector4::new(AT_MM, 0.0, 0.0, 1.0),
        Vector4::new(0.0, AT_MM, 0.0, 1.0),
    ];
    points
        .iter()
        .map(|p| ((a - b) * p).norm())
        .fold(0.0, f64::max)
}

/// The description's joint values for the pendant's. Only two kinds of arms show a joint that depends on another.
fn described(model: &RobotModel, pendant: &[f64]) -> Vec<f64> {
    let mut q = pendant.to_vec();
    if model.maker == "FANUC" {
        q[2] += q[1];
    } else if model.id == "abb_irb_2400_16_155" {
        q[2] -= q[1];
    }
    q
}

#[test]
fn the_library_has_the_makers_and_every_entry_says_where_it_comes_from() {
    let all = library();
    let ids: BTreeSet<&str> = all.iter().map(|model| model.id.as_str()).collect();
    assert_eq!(ids.len(), all.len(), "an id is there twice");
    assert!(all.len() >= 60, "{}", all.len());
    for maker in [
        "ABB",
        "FANUC",
        "KUKA",
        "Yaskawa",
        "Stäubli",
        "Universal Robots",
        "Kawasaki",
        "DENSO",
        "Mitsubishi Electric",
        "Epson",
        "Franka Robotics",
        "Doosan Robotics",
        "UFACTORY",
    ] {
        assert!(all.iter().any(|model| model.maker == maker), "{maker}");
    }
    for model in all {
        let id = &model.id;
        let robot = Robot::try_from(&model.robot).unwrap_or_else(|e| panic!("{id}: {e}"));
        assert_eq!(robot.links.len(), model.joints.len(), "{id}");
        for text in [&model.joint_map_source, &model.base, &model.flange] {
            assert!(!text.is_empty(), "{id}");
        }
        let is_read = model.sources.iter().any(|s| s.document.is_some());
        assert!(is_read || model.sources.len() >= 2, "{id} has one source");
        for source in &model.sources {
            let is_named = source.largest_difference_mm <= SAME_MM
                || source.cause.is_some()
                || model
                    .notes
                    .iter()
                    .any(|note| note.contains("second source differ"));
            assert!(
                is_named,
                "{id} differs from {} and does not say why",
                source.title
            );
        }
    }
}

#[test]
fn arms_move_as_the_public_descriptions() {
    let documents = urdfs();
    let mut random = Normal::new(25);
    let (mut n, mut worst) = (0, 0.0f64);
    for model in library() {
        let read = |source: &'static RobotModelSource| {
            let name = source.document.as_ref()?;
            Some((source, documents.iter().find(|(found, _)| found == name)?))
        };
        for (source, (_, text)) in model.sources.iter().filter_map(read) {
            let document = roxmltree::Document::parse(text).unwrap();
            let to_tip = way(&document, source.tip_link.as_ref().unwrap());
            let to_base = way(&document, source.base_link.as_ref().unwrap());
            let base_root = walk(&to_base, &[]).try_inverse().unwrap();
            let robot = Robot::try_from(&model.robot).unwrap();
            let apart = postures(&robot, &mut random)
                .iter()
                .map(|q| {
                    let theirs = base_root * walk(&to_tip, &described(model, q));
                    apart_mm(&of_library(&robot, q), &theirs)
                })
                .fold(0.0, f64::max);
            match &source.cause {
                None => {
                    assert!(apart < SAME_MM, "{}: {apart} mm", model.id);
                    worst = worst.max(apart);
                }
                Some(cause) => {
                    println!("{}: {apart:.3} mm ({cause})", model.id);
                    assert!(
                        apart <= source.largest_difference_mm * OTHER_POSTURES,
                        "{}: {apart} mm, stated {}",
                        model.id,
                        source.largest_difference_mm
                    );
                }
            }
            n += 1;
        }
    }
    println!("{n} arms moved beside their descriptions; worst {worst:.4} mm");
    assert!(documents.is_empty() || n >= 60, "{n}");
}

/// A row of a table: alpha, a, d, theta.
fn row(row: &Value, convention: &str, q: f64) -> Matrix4<f64> {
    let [alpha, a, d, theta] = [0usize, 1, 2, 3].map(|i| row[i].as_f64().unwrap());
    let about_z = turn(Z, q + theta.to_radians()) * shift(0.0, 0.0, d);
    let about_x = shift(a, 0.0, 0.0) * turn(X, alpha.to_radians());
    match convention {
        "mdh" => about_x * about_z,
        _ => about_z * about_x,
    }
}

#[test]
fn arms_without_a_description_move_as_their_second_source() {
    let tables: Value =
        serde_json::from_str(include_str!("../data/robot_models_second_source.json")).unwrap();
    let mut random = Normal::new(26);
    let without: BTreeSet<&str> = library()
        .iter()
        .filter(|model| model.sources.iter().all(|s| s.document.is_none()))
        .map(|model| model.id.as_str())
        .collect();
    let with_table: BTreeSet<&str> = tables
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    assert_eq!(without, with_table);
    for (id, table) in tables.as_object().unwrap() {
        let model = robot_models::get(id).unwrap().unwrap();
        let title = table["title"].as_str().unwrap();
        assert!(model.sources.iter().any(|s| s.title == title), "{id}");
        let number = |name: &str| table[name].as_f64().unwrap();
        let before =
            turn(Z, number("base_turn_deg").to_radians()) * shift(0.0, 0.0, number("base_up_mm"));
        let behind = turn(Z, number("flange_turn_deg").to_radians());
        let convention = table["convention"].as_str().unwrap();
        let rows = table["rows_alpha_deg_a_mm_d_mm_theta_deg"]
            .as_array()
            .unwrap();
        let robot = Robot::try_from(&model.robot).unwrap();
        for q in postures(&robot, &mut random) {
            let arm = rows.iter().zip(&q).enumerate().map(|(i, (numbers, q))| {
                row(numbers, convention, q * table["sign"][i].as_f64().unwrap())
            });
            let theirs = before * arm.fold(Matrix4::identity(), |t, step| t * step) * behind;
            let apart = apart_mm(&of_library(&robot, &q), &theirs);
            assert!(apart < SAME_MM, "{id}: {apart} mm");
        }
        // what only the tables say otherwise is told
        let says = |word: &str| model.notes.iter().any(|note| note.contains(word));
        assert!(
            number("flange_turn_deg") == 0.0 || convention == "dh" || says("flange"),
            "{id}"
        );
        assert!(number("base_up_mm") == 0.0 || says("base"), "{id}");
    }
}

/// A reading of a real FANUC R-1000iA, from ros-industrial/fanuc_experimental issue 17: pendant and description at the same moment.
#[test]
fn the_fanuc_coupling_is_what_a_pendant_showed() {
    let model = robot_models::get("fanuc_r_1000ia_80f").unwrap().unwrap();
    let robot = Robot::try_from(&model.robot).unwrap();
    let (j2, j3, described_j3) = (
        0.546_711_564_064_025_9,
        -33.342f64.to_radians(),
        -0.035_214_9,
    );
    let q = robot.q_model_rad(&[0.0, j2, j3, 0.0, 0.0, 0.0]);
    assert!((-q[2] - described_j3).abs() < 1e-4, "{q:?}");
    assert!((q[1] - j2).abs() < 1e-12);
}

#[test]
fn arms_are_found_however_their_names_are_written() {
    let ids = |text: &str, maker: Option<&str>| -> Vec<&str> {
        let found = robot_models::find(text, maker).unwrap();
        found.iter().map(|model| model.id.as_str()).collect()
    };
    for (text, maker, id) in [
        ("m10ia", None, "fanuc_m_10ia"),
        ("Fanuc M-10iA", None, "fanuc_m_10ia"),
        ("KR 6 R900 sixx", None, "kuka_kr6_r900_sixx"),
        ("motoman gp8", None, "yaskawa_gp8"),
        ("staubli tx2-60L", None, "staubli_tx2_60l"),
        ("panda", None, "franka_fer"),
        ("ur10e", Some("universal robots"), "ur_ur10e"),
        ("IRB2400", None, "abb_irb_2400_16_155"),
    ] {
        assert!(ids(text, maker).contains(&id), "{text}");
    }
    assert!(ids("gp8", Some("abb")).is_empty());
    assert!(ids("no such arm", None).is_empty());
    assert_eq!(ids("", None).len(), library().len());
}

/// The same question to somebody else's reader, in another language.
#[test]
fn arms_move_as_pinocchio_moves_the_descriptions() {
    let Some(folder) = real_data().and_then(|real| Some(real.parent()?.join("urdf"))) else {
        return;
    };
    if !folder.is_dir() {
        return;
    }
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let output = std::process::Command::new(oracles_python())
        .arg(root.join("docs/oracles/robot_models.py"))
        .arg(folder)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}{complaint}");
    println!("{said}");
    assert!(
        said.contains("pinocchio") || std::env::var("KINCAL_ORACLES_PYTHON").is_err(),
        "pinocchio is not installed for KINCAL_ORACLES_PYTHON: {said}"
    );
}

#[test]
fn the_page_has_every_arm() {
    let page = include_str!("../../docs/robot-models.md");
    for model in library() {
        assert!(
            page.contains(&format!("`{}`", model.id)),
            "{}: make the table anew with docs/oracles/robot_models.py --write",
            model.id
        );
    }
}

fn shown_posture(q_deg: [f64; 6], shown_orientation: Option<ShownOrientation>) -> PostureAnswer {
    let model = robot_models::get("kuka_kr10_r1100_2").unwrap().unwrap();
    let request = PostureBody {
        q_deg: q_deg.to_vec(),
        tool: None,
        shown_position_mm: Some([700.2, -5.1, 790.6]),
        shown_orientation,
    };
    posture(&request, &Robot::try_from(&model.robot).unwrap()).unwrap()
}

/// The flange is on the axis of the last joint, so its position does not see a 300 that was typed for 30.
#[test]
fn a_posture_without_an_orientation_names_the_joints_that_it_does_not_check() {
    let right = [0.0, -80.0, 95.0, 10.0, 20.0, 30.0];
    let mut typed = right;
    typed[5] = 300.0;
    let unseen = shown_posture(typed, None);
    assert!(unseen.position_apart_mm.unwrap() < 1.0);
    assert_eq!(unseen.unchecked_joints, [6]);
    // straight on, joint 4 turns about the same axis
    assert_eq!(
        shown_posture([0.0, -80.0, 95.0, 10.0, 0.0, 30.0], None).unchecked_joints,
        [4, 6]
    );

    let is = shown_posture(right, None);
    let mut forms = [ShownOrientation::default(); 4];
    forms[0].kuka_abc_deg = Some(is.kuka_abc_deg);
    forms[1].fanuc_wpr_deg = Some(is.fanuc_wpr_deg);
    forms[2].ur_rotation_vector_rad = Some(is.ur_rotation_vector_rad);
    forms[3].quaternion = Some(is.quaternion);
    for shown in forms {
        let compared = shown_posture(right, Some(shown));
        assert!(compared.orientation_apart_deg.unwrap() < 1e-6, "{shown:?}");
        assert!(compared.unchecked_joints.is_empty());
        let compared = shown_posture(typed, Some(shown));
        let apart_deg = compared.orientation_apart_deg.unwrap();
        assert!((apart_deg - 90.0).abs() < 1e-6, "{shown:?}: {apart_deg}");
    }
}
