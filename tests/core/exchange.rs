//! Conversions from and to other descriptions: each is compared with a second implementation at random configurations.

use crate::data::{oracles_python, paper_robot, urdfs};
use crate::simulation::{Normal, poses, true_robot};
use kincal::compensation::Base;
use kincal::exchange::refit::{mastering, without_beta};
use kincal::exchange::transplant::{Mismatch, transplanted};
use kincal::exchange::{
    Chain, ChainJoint, dh::links_of_distal, links_of_chain, origin_of, pose_of,
};
use kincal::identification::KinematicModel;
use kincal::identification::model::parameters::rotation_exp;
use kincal::kinematics::{JointMap, Link, Robot, t_base_flange};
use kincal::measurement::Frame;
use kincal::operations::export::{self, Source};
use kincal::operations::import::import;
use kincal::operations::urdf::Urdf;
use kincal::wire::compensate::ErrorFrame;
use kincal::wire::export::{BetaChoice, ExportFormat, MasteringDocument};
use kincal::wire::import::ImportFormat;
use kincal::wire::parameter_set::{IdentifiedLink, ParameterSetContent, Provenance};
use kincal::wire::robot::RobotBody;
use nalgebra::{
    DMatrix, IsometryMatrix3, Matrix4, Rotation3, Translation3, Unit, Vector3, Vector4,
};
use rand::RngExt;
use serde_json::json;
use std::f64::consts::{FRAC_PI_2, PI};

fn turn(axis: usize, angle: f64) -> Matrix4<f64> {
    let (s, c) = angle.sin_cos();
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m = Matrix4::identity();
    (m[(j, j)], m[(j, k)], m[(k, j)], m[(k, k)]) = (c, -s, s, c);
    m
}

fn shift(x: f64, y: f64, z: f64) -> Matrix4<f64> {
    Matrix4::new_translation(&Vector3::new(x, y, z))
}

/// Largest difference of two poses in mm; rotations count at a metre.
fn apart(a: &Matrix4<f64>, b: &Matrix4<f64>) -> f64 {
    (a - b)
        .fixed_view::<3, 1>(0, 3)
        .norm()
        .max((a - b).fixed_view::<3, 3>(0, 0).amax() * 1e3)
}

fn random_joints(n: usize, random: &mut Normal) -> Vec<f64> {
    (0..n)
        .map(|_| PI * (2.0 * random.0.random::<f64>() - 1.0))
        .collect()
}

#[test]
fn roll_pitch_yaw_come_back_also_where_roll_and_yaw_turn_about_the_same_axis() {
    let mut random = Normal::new(1);
    for i in 0..2_000 {
        let pitch = match i % 4 {
            0 => FRAC_PI_2,
            1 => -FRAC_PI_2,
            2 => FRAC_PI_2 - 1e-9 * random.draw(),
            _ => random.draw(),
        };
        let (roll, yaw) = (random.draw(), random.draw());
        let meant = turn(2, yaw) * turn(1, pitch) * turn(0, roll);
        let rotation = Rotation3::from_matrix_unchecked(meant.fixed_view::<3, 3>(0, 0).into());
        let origin = origin_of(&IsometryMatrix3::from_parts(
            Translation3::new(1.0, 2.0, 3.0),
            rotation,
        ));
        let [roll, pitch, yaw] = origin.rpy_rad;
        let back = turn(2, yaw) * turn(1, pitch) * turn(0, roll);
        assert!(
            (back - meant).amax() < 2e-15,
            "{i}: {:.1e}",
            (back - meant).amax()
        );
        assert!((pose_of(&origin).rotation.matrix() - rotation.matrix()).amax() < 2e-15);
    }
}

#[test]
fn distal_tables_become_links_with_the_same_kinematics() {
    let mut random = Normal::new(2);
    for _ in 0..50 {
        let n = 1 + random.0.random_range(0..7usize);
        let row = |random: &mut Normal| Link {
            a_mm: 300.0 * random.draw(),
            alpha_rad: random.draw(),
            d_mm: 200.0 * random.draw(),
            theta_offset_rad: random.draw(),
            beta_rad: 0.0,
        };
        let rows: Vec<Link> = (0..n).map(|_| row(&mut random)).collect();
        let imported = links_of_distal(&rows);
        let q = random_joints(n, &mut random);
        let meant = rows.iter().zip(&q).fold(Matrix4::identity(), |t, (r, q)| {
            t * turn(2, q + r.theta_offset_rad)
                * shift(0.0, 0.0, r.d_mm)
                * shift(r.a_mm, 0.0, 0.0)
                * turn(0, r.alpha_rad)
        });
        let found =
            (imported.t_root_base * t_base_flange(&imported.links, &q) * imported.t_flange_tip)
                .to_homogeneous();
        assert!(apart(&meant, &found) < 1e-9, "{}", apart(&meant, &found));
    }
}

/// A chain with every relation of neighbouring axes: random, parallel, nearly parallel, intersecting, collinear.
fn random_chain(n: usize, random: &mut Normal) -> Chain {
    let mut joints = Vec::new();
    for i in 0..n {
        let kind = random.0.random_range(0..6);
        let rotation = match kind {
            0 => Rotation3::identity(),
            1 => rotation_exp(&(random.vector() * 1e-3)),
            2 => rotation_exp(&Vector3::new(PI, 0.0, 0.0)),
            3 => rotation_exp(&Vector3::new(FRAC_PI_2, 0.0, 0.0)),
            _ => rotation_exp(&random.vector()),
        };
        let along = match random.0.random_range(0..4) {
            0 => Vector3::zeros(),
            1 => Vector3::new(0.0, 0.0, 200.0 * random.draw()),
            _ => random.vector() * 300.0,
        };
        let axis = if kind < 4 {
            Vector3::z()
        } else {
            Unit::new_normalize(random.vector()).into_inner()
        };
        joints.push(ChainJoint {
            name: format!("j{i}"),
            t_parent_joint: IsometryMatrix3::from_parts(Translation3::from(along), rotation),
            axis: Some(axis),
            limits_rad: None,
        });
        if random.0.random_range(0..3) == 0 {
            let fixed = IsometryMatrix3::from_parts(
                Translation3::from(random.vector() * 50.0),
                rotation_exp(&random.vector()),
            );
            joints.push(ChainJoint {
                name: format!("f{i}"),
                t_parent_joint: fixed,
                axis: None,
                limits_rad: None,
            });
        }
    }
    Chain { joints }
}

/// Second implementation of the chain: homogeneous matrices and Rodrigues' formula.
fn naive_chain(chain: &Chain, q: &[f64]) -> Matrix4<f64> {
    let mut q = q.iter();
    chain.joints.iter().fold(Matrix4::identity(), |t, joint| {
        let t = t * joint.t_parent_joint.to_homogeneous();
        let Some(axis) = joint.axis else { return t };
        let (s, c) = q.next().unwrap().sin_cos();
        let mut r = Matrix4::identity();
        for column in 0..3 {
            let e = Vector3::ith(column, 1.0);
            let turned = e * c + axis.cross(&e) * s + axis * axis.dot(&e) * (1.0 - c);
            r.set_column(column, &Vector4::new(turned.x, turned.y, turned.z, 0.0));
        }
        t * r
    })
}

#[test]
fn chains_of_any_axes_become_links_with_the_same_kinematics() {
    let mut random = Normal::new(3);
    let mut worst = 0.0f64;
    for _ in 0..500 {
        let n = 1 + random.0.random_range(0..7usize);
        let chain = random_chain(n, &mut random);
        let imported = links_of_chain(&chain);
        assert_eq!(imported.links.len(), n);
        for _ in 0..5 {
            let q = random_joints(n, &mut random);
            let found =
                (imported.t_root_base * t_base_flange(&imported.links, &q) * imported.t_flange_tip)
                    .to_homogeneous();
            worst = worst.max(apart(&naive_chain(&chain, &q), &found));
        }
    }
    println!("largest difference {worst:.1e} mm");
    assert!(worst < 1e-9, "{worst:.1e}");
}

/// The nominal paper robot as a URDF with arbitrary frames: turned and shifted on each link, other axes, fixed joints in between.
fn with_arbitrary_frames(nominal: &[Link], random: &mut Normal) -> (Chain, IsometryMatrix3<f64>) {
    let t_root_base = IsometryMatrix3::from_parts(
        Translation3::new(10.0, -20.0, 300.0),
        rotation_exp(&Vector3::new(0.0, 0.0, 0.4)),
    );
    let mut joints = Vec::new();
    let mut from = t_root_base;
    for (i, link) in nominal.iter().enumerate() {
        if i == 2 {
            // A fixed joint before joint 3; the following frames start behind it.
            let fixed = IsometryMatrix3::from_parts(
                Translation3::new(1.0, 2.0, 3.0),
                rotation_exp(&Vector3::new(0.1, 0.2, 0.3)),
            );
            joints.push(ChainJoint {
                name: "mount".into(),
                t_parent_joint: fixed,
                axis: None,
                limits_rad: None,
            });
            from = fixed.inverse() * from;
        }
        let tilted = [
            Vector3::zeros(),
            Vector3::new(FRAC_PI_2, 0.0, 0.0),
            Vector3::new(0.0, FRAC_PI_2, 0.0),
        ][i % 3];
        let slid = Link {
            theta_offset_rad: random.draw(),
            d_mm: 40.0 * random.draw(),
            ..Link::default()
        };
        let on_link = t_base_flange(&[slid], &[0.0])
            * IsometryMatrix3::from_parts(Translation3::identity(), rotation_exp(&tilted));
        let axis = on_link.rotation.inverse() * Vector3::z();
        let t_parent_joint = from * t_base_flange(&[*link], &[0.0]) * on_link;
        joints.push(ChainJoint {
            name: format!("joint_{}", i + 1),
            t_parent_joint,
            axis: Some(axis),
            limits_rad: Some((-3.0, 3.0)),
        });
        from = on_link.inverse();
    }
    let tool = IsometryMatrix3::from_parts(
        Translation3::new(0.0, 0.0, 30.0),
        rotation_exp(&Vector3::new(0.0, FRAC_PI_2, 0.0)),
    );
    joints.push(ChainJoint {
        name: "tool".into(),
        t_parent_joint: tool,
        axis: None,
        limits_rad: None,
    });
    let behind = from * tool;
    (Chain { joints }, behind)
}

fn urdf_text(chain: &Chain, decimals: usize) -> String {
    let mut text = String::from(
        "<?xml version='1.0'?>\n<!-- made by hand -->\n<robot name=\"cell &amp; robot\">\n  <link name=\"l0\"/>\n",
    );
    for (i, joint) in chain.joints.iter().enumerate() {
        let origin = origin_of(&joint.t_parent_joint);
        let [x, y, z] = origin.xyz_mm.map(|mm| format!("{:.decimals$}", mm / 1e3));
        let [roll, pitch, yaw] = origin.rpy_rad.map(|rad| format!("{rad:.decimals$}"));
        let kind = if joint.axis.is_some() {
            "revolute"
        } else {
            "fixed"
        };
        text += &format!(
            "  <link name=\"l{}\"><visual><origin xyz=\"1 2 3\" rpy=\"0 0 0\"/><geometry><mesh filename='a.stl'/></geometry></visual></link>\n",
            i + 1
        );
        text += &format!(
            "  <joint type='{kind}'\n     name=\"{}\"><!-- axis {i} --><parent link='l{i}'/><child link=\"l{}\"/>\n",
            joint.name,
            i + 1
        );
        // Every second joint has its attributes in reverse order.
        text += &if i % 2 == 0 {
            format!("    <origin  rpy = '{roll} {pitch} {yaw}'\txyz=\"{x}  {y} {z}\" />\n")
        } else {
            format!("    <origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"/>\n")
        };
        if let Some(axis) = joint.axis {
            text += &format!(
                "    <axis xyz='{} {} {}'/>\n    <limit lower=\"-3\" upper=\"3\" effort='1' velocity='2'/>\n",
                axis.x, axis.y, axis.z
            );
        }
        text += "  </joint>\n";
    }
    text + "  <gazebo reference=\"l1\"><material>Gazebo/Orange</material></gazebo>\n</robot>\n"
}

/// A URDF without the origin values of the named joints.
fn without_origins(text: &str, names: &[String]) -> String {
    let mut remaining = String::new();
    for (i, part) in text.split("<joint").enumerate() {
        let mut part = part.to_owned();
        if i > 0
            && names
                .iter()
                .any(|name| part.contains(&format!("name=\"{name}\"")))
        {
            let start = part.find("<origin").unwrap();
            let end = start + part[start..].find("/>").unwrap();
            let mut in_value = None;
            let masked: String = part[start..end]
                .chars()
                .filter(|c| match in_value {
                    Some(quote) if *c == quote => {
                        in_value = None;
                        true
                    }
                    Some(_) => false,
                    None => {
                        if *c == '"' || *c == '\'' {
                            in_value = Some(*c);
                        }
                        true
                    }
                })
                .collect();
            part.replace_range(start..end, &masked);
        }
        remaining += "<joint";
        remaining += &part;
    }
    remaining
}

#[test]
fn a_users_urdf_gets_the_identified_kinematics_and_nothing_else_of_it_changes() {
    let mut random = Normal::new(4);
    let nominal = paper_robot();
    let identified = true_robot(&nominal, 1, &mut random).links;
    let (chain, _) = with_arbitrary_frames(&nominal.links, &mut random);
    let text = urdf_text(&chain, 6);
    let urdf = Urdf::parse(text.as_bytes()).unwrap();
    let old = urdf.chain(None, Some(6)).unwrap();
    let new = transplanted(&old.chain, &nominal, &identified).unwrap();
    let patched = urdf.with_origins(&old, &new);
    let names: Vec<String> = (1..=6).map(|i| format!("joint_{i}")).collect();
    assert_ne!(text, patched);
    assert_eq!(
        without_origins(&text, &names),
        without_origins(&patched, &names)
    );
    // Frames stay where they were, except for the robot's errors.
    let back = Urdf::parse(patched.as_bytes())
        .unwrap()
        .chain(None, Some(6))
        .unwrap()
        .chain;
    for (a, b) in old.chain.joints.iter().zip(&back.joints) {
        assert!(
            (a.t_parent_joint.translation.vector - b.t_parent_joint.translation.vector).norm()
                < 3.0
        );
    }
    // X and Y from one configuration, then every other: T_urdf(q) = X·T(q)·Y
    let chains: Vec<Matrix4<f64>> = poses(40, &mut Normal::new(5))
        .iter()
        .map(|q| naive_chain(&back, q))
        .collect();
    let links: Vec<Matrix4<f64>> = poses(40, &mut Normal::new(5))
        .iter()
        .map(|q| t_base_flange(&identified, q).to_homogeneous())
        .collect();
    // X⁻¹·T_urdf(q)·Y⁻¹: X is known from the construction of the chain, up to the rounding of the text.
    let (x, y) = placed(&chains, &links);
    let worst = chains
        .iter()
        .zip(&links)
        .map(|(c, l)| apart(c, &(x * l * y)))
        .fold(0.0, f64::max);
    println!("a patched URDF is {worst:.1e} mm from the identified links");
    assert!(worst < 1e-8, "{worst:.1e}");
}

/// X and Y with A_i = X·B_i·Y, by alternating closest fits (a few hundred rounds end at rounding).
fn placed(a: &[Matrix4<f64>], b: &[Matrix4<f64>]) -> (Matrix4<f64>, Matrix4<f64>) {
    // from two relative motions: A_i·A_0⁻¹ = X·B_i·B_0⁻¹·X⁻¹, hand-eye calibration by axes (Park & Martin 1994)
    let relative = |m: &[Matrix4<f64>]| -> Vec<Matrix4<f64>> {
        m[1..]
            .iter()
            .map(|t| t * m[0].try_inverse().unwrap())
            .collect()
    };
    let (ra, rb) = (relative(a), relative(b));
    let log = |m: &Matrix4<f64>| {
        let r: nalgebra::Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into();
        let twice = Vector3::new(
            r[(2, 1)] - r[(1, 2)],
            r[(0, 2)] - r[(2, 0)],
            r[(1, 0)] - r[(0, 1)],
        );
        let angle = (twice.norm() / 2.0).atan2((r.trace() - 1.0) / 2.0);
        twice.normalize() * angle
    };
    let mut correlation = nalgebra::Matrix3::zeros();
    for (a, b) in ra.iter().zip(&rb) {
        correlation += log(a) * log(b).transpose();
    }
    let svd = correlation.svd(true, true);
    let rotation = svd.u.unwrap() * svd.v_t.unwrap();
    // (R_a − I)·t = R_x·t_b − t_a
    let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), Vector3::zeros());
    for (a, b) in ra.iter().zip(&rb) {
        let left = a.fixed_view::<3, 3>(0, 0) - nalgebra::Matrix3::identity();
        let known = rotation * b.fixed_view::<3, 1>(0, 3) - a.fixed_view::<3, 1>(0, 3);
        normal += left.transpose() * left;
        right += left.transpose() * known;
    }
    let translation = normal.try_inverse().unwrap() * right;
    let mut x = Matrix4::identity();
    x.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    x.fixed_view_mut::<3, 1>(0, 3).copy_from(&translation);
    let y = (x * b[0]).try_inverse().unwrap() * a[0];
    (x, y)
}

/// The export of a robot with these links.
fn ur_kinematics(body: &RobotBody, identified: &[Link]) -> Result<String, export::Error> {
    let identity =
        json!({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation_mm": [0, 0, 0]});
    let links: Vec<IdentifiedLink> = identified.iter().map(IdentifiedLink::from).collect();
    let content: ParameterSetContent = serde_json::from_value(
        json!({"links": links, "t_instrument_base": identity, "targets": []}),
    )
    .unwrap();
    let source = Source {
        id: "par_1",
        body,
        robot: &Robot::try_from(body).unwrap(),
        content: &content,
        provenance: &Provenance::default(),
    };
    export::export(&source, ExportFormat::UrKinematics, BetaChoice::Keep).map(|e| e.text)
}

/// Pose of tool0 in base_link by the description with the exported origins, read by docs/oracles/read_ur_description.py, with pinocchio if it
/// is installed.
fn read_by_the_oracle(urdf: &str, kinematics: &str, q: &[Vec<f64>]) -> Vec<Matrix4<f64>> {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let script = format!(
        "{}/docs/oracles/read_ur_description.py",
        env!("CARGO_MANIFEST_DIR")
    );
    let output = std::process::Command::new(oracles_python())
        .arg(script)
        .arg(file("robot.urdf", urdf))
        .arg(file("kinematics.yaml", kinematics))
        .arg(file("q.json", &json!(q).to_string()))
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let readers = answer["readers"].as_array().unwrap();
    assert!(
        readers.len() == 2 || std::env::var("KINCAL_ORACLES_PYTHON").is_err(),
        "pinocchio is not installed for KINCAL_ORACLES_PYTHON"
    );
    let pose = |pose: &serde_json::Value| Matrix4::from_fn(|i, j| pose[i][j].as_f64().unwrap());
    answer["t_base_link_tool0"]
        .as_array()
        .unwrap()
        .iter()
        .map(pose)
        .collect()
}

/// Errors in every parameter of every link, and Hayati's beta for parallel axes.
fn with_small_errors(nominal: &[Link], random: &mut Normal) -> Vec<Link> {
    let off = |link: &Link| Link {
        a_mm: link.a_mm + 0.5 * random.draw(),
        alpha_rad: link.alpha_rad + 1e-3 * random.draw(),
        d_mm: link.d_mm + 0.5 * random.draw(),
        theta_offset_rad: link.theta_offset_rad + 5e-3 * random.draw(),
        beta_rad: link.beta_rad + 1e-3 * random.draw(),
    };
    nominal.iter().map(off).collect()
}

/// The tables of the maker, in Base: d1, a2, a3, d4, d5, d6, mm. Row i holds a and alpha before axis i.
fn description_by_hand([d1, a2, a3, d4, d5, d6]: [f64; 6]) -> RobotBody {
    let row = |a: f64, alpha: f64, d: f64| json!({"a_mm": a, "alpha_deg": alpha, "d_mm": d, "theta_offset_deg": 0.0});
    let links = [
        row(0.0, 0.0, d1),
        row(0.0, 90.0, 0.0),
        row(a2, 0.0, 0.0),
        row(a3, 0.0, d4),
        row(0.0, 90.0, d5),
        row(0.0, -90.0, d6),
    ];
    serde_json::from_value(json!({"name": "UR10e by hand", "links": links})).unwrap()
}

#[test]
fn ur_kinematics_in_the_makers_description_move_as_the_identified_robot() {
    let mut random = Normal::new(71);
    let all: Vec<(String, String)> = urdfs()
        .into_iter()
        .filter(|(name, _)| name.contains("__ur"))
        .collect();
    let compare =
        |name: &str, urdf: &str, body: &RobotBody, base_link_links: f64, random: &mut Normal| {
            let nominal = Robot::try_from(body).unwrap();
            let identified = with_small_errors(&nominal.links, random);
            let q: Vec<Vec<f64>> = (0..20).map(|_| random_joints(6, random)).collect();
            let kinematics = ur_kinematics(body, &identified).unwrap();
            let found = read_by_the_oracle(urdf, &kinematics, &q);
            // By homogeneous matrices: the links in base_link; tool0 is the flange.
            let worst = q
                .iter()
                .zip(&found)
                .map(|(q, found)| {
                    let meant =
                        identified
                            .iter()
                            .zip(q)
                            .fold(turn(2, base_link_links), |t, (l, q)| {
                                t * turn(0, l.alpha_rad)
                                    * shift(l.a_mm, 0.0, 0.0)
                                    * turn(1, l.beta_rad)
                                    * turn(2, q + l.theta_offset_rad)
                                    * shift(0.0, 0.0, l.d_mm)
                            });
                    apart(&meant, found)
                })
                .fold(0.0, f64::max);
            println!("{name}: {worst:.1e} mm");
            assert!(worst < 1e-9, "{name}: {worst:.1e} mm");
        };
    for (name, urdf) in &all {
        let body = import(urdf.as_bytes(), ImportFormat::Urdf, name, None)
            .unwrap()
            .robot;
        compare(name, urdf, &body, 0.0, &mut random);
    }
    if let Some((name, urdf)) = all.iter().find(|(name, _)| name.ends_with("__ur10e")) {
        // The maker's Base is base_link turned by 180°.
        let body = description_by_hand([180.7, -612.7, -571.55, 174.15, 119.85, 116.55]);
        compare(&format!("{name} by hand"), urdf, &body, PI, &mut random);
        assert!(all.len() >= 18, "{}", all.len());
    }
}

#[test]
fn other_makers_robots_have_no_ur_kinematics() {
    let (mut refused, mut of_six) = (0, 0);
    for (name, urdf) in urdfs().iter().filter(|(name, _)| !name.contains("__ur")) {
        let Ok(imported) = import(urdf.as_bytes(), ImportFormat::Urdf, name, None) else {
            continue; // hands, and descriptions of two arms
        };
        let links = Robot::try_from(&imported.robot).unwrap().links;
        of_six += usize::from(links.len() == 6);
        match ur_kinematics(&imported.robot, &links) {
            Err(export::Error::Invalid(invalid)) => {
                assert_eq!(invalid.code, "not_a_universal_robot", "{name}");
                refused += 1;
            }
            other => panic!("{name}: {other:?}"),
        }
    }
    println!("{refused} robots of other makers refused, {of_six} of them with six joints");
    // An arm of the same structure with lengths of its own: a UR5e's are 162.5, -425, -392.2, 133.3, 99.7, 99.6.
    let clone = description_by_hand([120.1, -430.0, -368.5, 115.2, 113.0, 107.0]);
    let links = Robot::try_from(&clone).unwrap().links;
    match ur_kinematics(&clone, &links) {
        Err(export::Error::Invalid(invalid)) => {
            assert_eq!(invalid.code, "not_a_universal_robot");
            let told = &invalid.issues[0].detail;
            assert!(told.contains("d1 120.1 mm"), "{told}");
        }
        other => panic!("{other:?}"),
    }
    // The base of a UR in a custom frame cannot be located.
    let mut turned = description_by_hand([180.7, -612.7, -571.55, 174.15, 119.85, 116.55]);
    turned.links[0].theta_offset_deg = 30.0;
    let links = Robot::try_from(&turned).unwrap().links;
    assert!(ur_kinematics(&turned, &links).is_err());
}

#[test]
fn a_urdf_of_another_robot_is_refused_with_the_joint_that_differs() {
    let nominal = paper_robot();
    let mut other = nominal.clone();
    other.links[2].a_mm += 15.0;
    let (chain, _) = with_arbitrary_frames(&other.links, &mut Normal::new(6));
    match transplanted(&chain, &nominal, &nominal.links) {
        Err(Mismatch::Axis { distance_mm, .. }) => assert!(distance_mm > 3.0, "{distance_mm}"),
        other => panic!("{other:?}"),
    }
    let short = Chain {
        joints: chain.joints[..3].to_vec(),
    };
    assert!(matches!(
        transplanted(&short, &nominal, &nominal.links),
        Err(Mismatch::JointCount {
            found: 2,
            expected: 6
        })
    ));
}

#[test]
fn a_joint_that_mimics_another_matters_only_on_the_way_to_the_tip() {
    let joint = |name: &str, parent: &str, child: &str, inside: &str| {
        format!(
            "<joint name='{name}' type='revolute'><parent link='{parent}'/><child link='{child}'/><origin xyz='0 0.1 0.3'/><axis xyz='0 0 1'/>{inside}</joint>"
        )
    };
    let text = format!(
        "<robot name='x'>{}{}{}</robot>",
        joint("j1", "base", "link1", ""),
        joint("j2", "link1", "hand", ""),
        joint("finger", "hand", "finger2", "<mimic joint='j2'/>")
    );
    let imported = import(text.as_bytes(), ImportFormat::Urdf, "x", Some("hand")).unwrap();
    assert_eq!(imported.joints, ["j1", "j2"]);
    let refused = import(text.as_bytes(), ImportFormat::Urdf, "x", Some("finger2")).unwrap_err();
    assert_eq!(refused.code, "invalid_joint");
    assert!(refused.issues[0].detail.contains("mimics"), "{refused:?}");
}

#[test]
fn descriptions_in_another_unit_than_they_say_are_refused_with_the_unit() {
    let rows = "-90,0,127.3\n0,-612,0\n0,-572.3,0\n";
    let refused = |text: String| {
        let error = import(text.as_bytes(), ImportFormat::Dh, "x", None).unwrap_err();
        (
            error.issues[0].code.to_string(),
            error.issues[0].detail.clone(),
        )
    };
    let table = |header: &str, rows: &str| {
        let rows: String = rows.lines().map(|row| format!("{row},0\n")).collect();
        format!("{header},theta_offset_deg\n{rows}")
    };
    let good = table("alpha_deg,a_mm,d_mm", rows);
    assert!(import(good.as_bytes(), ImportFormat::Dh, "x", None).is_ok());
    let (code, detail) = refused(table(
        "alpha_deg,a_mm,d_mm",
        &rows.replace("-90", "-1.5708"),
    ));
    assert!(
        code == "not_in_degrees" && detail.contains("alpha_rad"),
        "{detail}"
    );
    let metres = "-90,0,0.1273\n0,-0.612,0\n0,-0.5723,0\n";
    let (code, detail) = refused(table("alpha_deg,a_mm,d_mm", metres));
    assert!(
        code == "not_in_millimetres" && detail.contains("a_m and d_m"),
        "{detail}"
    );
    let symbols = good.replace(",0\n", ",θ1+90°\n");
    let (code, detail) = refused(symbols);
    assert!(
        code == "not_a_number" && detail.contains("90 for θ1+90°"),
        "{detail}"
    );
    let urdf = "<robot name='x'><joint name='j' type='revolute'><parent link='a'/><child link='b'/><origin xyz='0 0.1 0.3' rpy='0 90 0'/><axis xyz='0 0 1'/></joint></robot>";
    let error = import(urdf.as_bytes(), ImportFormat::Urdf, "x", None).unwrap_err();
    assert_eq!(error.issues[0].code, "not_in_radians");
    assert!(
        error.issues[0].detail.contains("write 1.570796 for 90"),
        "{error:?}"
    );
    let turned = urdf.replace("90", "1.570796");
    assert!(import(turned.as_bytes(), ImportFormat::Urdf, "x", None).is_ok());
}

#[test]
fn faults_of_a_urdf_are_named() {
    let code = |text: &str| match Urdf::parse(text.as_bytes()) {
        Err(invalid) => invalid.code,
        Ok(urdf) => urdf
            .chain(None, None)
            .err()
            .map_or("", |invalid| invalid.code),
    };
    assert_eq!(code("<robot"), "not_xml");
    assert_eq!(code("<sdf/>"), "not_a_urdf");
    assert_eq!(code("<robot name='x'/>"), "no_joints");
    let joint = |inside: &str, kind: &str| {
        format!(
            "<robot><joint name='j' type='{kind}'><parent link='a'/><child link='b'/>{inside}</joint></robot>"
        )
    };
    assert_eq!(
        code(&joint("<origin xyz='${d} 0 0'/>", "revolute")),
        "invalid_joint"
    );
    assert_eq!(
        code(&joint("<axis xyz='0 0 0'/>", "revolute")),
        "invalid_joint"
    );
    assert_eq!(code(&joint("", "prismatic")), "unsupported_joint");
    assert_eq!(
        code("<robot><joint name='j' type='revolute'><child link='b'/></joint></robot>"),
        "invalid_joint"
    );
    assert_eq!(code("<!DOCTYPE r [<!ENTITY a 'b'>]><robot/>"), "not_xml");
    let circle = "<robot><joint name='j' type='revolute'><parent link='a'/><child link='b'/></joint><joint name='k' type='revolute'><parent link='b'/><child link='a'/></joint></robot>";
    assert_eq!(code(circle), "no_joints");
    let fork = "<robot><joint name='j' type='revolute'><parent link='a'/><child link='b'/></joint><joint name='k' type='revolute'><parent link='a'/><child link='c'/></joint></robot>";
    assert_eq!(code(fork), "several_chains");
}

#[test]
fn an_origin_that_is_not_there_is_put_in() {
    let text = "<robot><joint name='j' type='revolute'><parent link='a'/><child link='b'/><axis xyz='0 0 1'/></joint><joint name='k' type='revolute'><origin xyz='0.5 0 0'/><parent link='b'/><child link='c'/><axis xyz='0 0 1'/></joint></robot>";
    let urdf = Urdf::parse(text.as_bytes()).unwrap();
    let old = urdf.chain(None, None).unwrap();
    let mut new = old.chain.clone();
    new.joints[0].t_parent_joint = IsometryMatrix3::from_parts(
        Translation3::new(1.0, 0.0, 0.0),
        rotation_exp(&Vector3::new(0.0, 0.0, 0.5)),
    );
    new.joints[1].t_parent_joint = IsometryMatrix3::from_parts(
        Translation3::new(501.0, 0.0, 0.0),
        rotation_exp(&Vector3::new(0.0, 0.0, -0.25)),
    );
    let patched = urdf.with_origins(&old, &new);
    let back = Urdf::parse(patched.as_bytes())
        .unwrap()
        .chain(None, None)
        .unwrap()
        .chain;
    for (a, b) in new.joints.iter().zip(&back.joints) {
        assert!(
            (a.t_parent_joint.to_homogeneous() - b.t_parent_joint.to_homogeneous()).amax() < 1e-12,
            "{patched}"
        );
    }
}

#[test]
fn links_without_beta_are_no_worse_than_beta_left_out_and_say_how_far_they_are_off() {
    let nominal = paper_robot();
    let none = without_beta(&nominal, &nominal.links);
    assert!(none.max_mm < 1e-6, "{none:?}");
    let mut identified = nominal.links.clone();
    identified[2].beta_rad = 0.02f64.to_radians();
    let refit = without_beta(&nominal, &identified);
    assert!(refit.links.iter().all(|link| link.beta_rad == 0.0));
    let left_out: Vec<Link> = identified
        .iter()
        .map(|link| Link {
            beta_rad: 0.0,
            ..*link
        })
        .collect();
    // Evaluated at other configurations than those that were fitted, by a rougher second implementation.
    let off = |links: &[Link]| {
        let at = |q: &Vec<f64>| {
            let (a, b) = (t_base_flange(&identified, q), t_base_flange(links, q));
            (0..3)
                .map(|axis| {
                    ((a * nalgebra::Point3::from(Vector3::ith(axis, 100.0)))
                        - (b * nalgebra::Point3::from(Vector3::ith(axis, 100.0))))
                    .norm()
                })
                .sum::<f64>()
                / 3.0
        };
        let q: Vec<Vec<f64>> = {
            let mut random = Normal::new(9);
            (0..400)
                .map(|_| {
                    random_joints(6, &mut random)
                        .iter()
                        .map(|q| q / 2.0)
                        .collect()
                })
                .collect()
        };
        q.iter().map(at).sum::<f64>() / 400.0
    };
    println!(
        "beta of 0.02° left out: {:.4} mm, refitted: {:.4} mm, stated {:.4} mm",
        off(&left_out),
        off(&refit.links),
        refit.mean_mm
    );
    assert!(off(&refit.links) < off(&left_out));
    assert!(
        (off(&refit.links) / refit.mean_mm - 1.0).abs() < 0.15,
        "{} {}",
        off(&refit.links),
        refit.mean_mm
    );
}

#[test]
fn planted_mastering_errors_come_out_in_the_controllers_sign_and_coupling() {
    let nominal = paper_robot();
    let planted_deg = [0.0, 0.3, -0.2, 0.15, -0.4, 0.0];
    // by hand: with q3 of the model = -(q2 + q3) of the controller and -q5, the controller has to show
    // q2 + 0.3, then q3 so that -(0.3 + x) = -0.2, and q5 + 0.4
    let expected_deg = [0.0, 0.3, -0.1, 0.15, 0.4, 0.0];
    let mut coupling = DMatrix::identity(6, 6);
    coupling[(2, 1)] = -1.0;
    let map = JointMap {
        sign: vec![1.0, 1.0, -1.0, 1.0, -1.0, 1.0],
        offset_rad: vec![0.0; 6],
        coupling,
    };
    let robot = Robot {
        joint_map: Some(map),
        ..nominal.clone()
    };
    let mut identified = nominal.links.clone();
    identified
        .iter_mut()
        .zip(planted_deg)
        .for_each(|(link, deg)| link.theta_offset_rad += f64::to_radians(deg));
    let identified = KinematicModel::nominal(&identified, 1);
    let refit = mastering(&robot, &identified, Base::Robot);
    let document = export::mastering_document(&robot, &refit, Base::Robot);
    for (joint, expected) in document.joints.iter().zip(expected_deg) {
        assert!((joint.offset_deg - expected).abs() < 1e-7, "{document:?}");
    }
    assert_eq!(
        document
            .joints
            .iter()
            .map(|joint| joint.determined)
            .collect::<Vec<_>>(),
        [false, true, true, true, true, false]
    );
    assert!(document.remaining_error_mm.max < 1e-6);
}

#[test]
fn of_two_joints_none_has_an_offset_that_can_be_told_from_base_and_tool() {
    let mut robot = paper_robot();
    robot.links.truncate(2);
    robot.joint_limits_rad.truncate(2);
    let mut identified = robot.links.clone();
    identified[1].theta_offset_rad += 0.01;
    let identified = KinematicModel::nominal(&identified, 1);
    let refit = mastering(&robot, &identified, Base::Robot);
    let document = export::mastering_document(&robot, &refit, Base::Robot);
    assert!(
        document
            .joints
            .iter()
            .all(|joint| !joint.determined && joint.offset_deg == 0.0),
        "{document:?}"
    );
}

/// The mastering document of a set in which theta_offset of joint 1 and the base about its axis are off by so much, and other errors of the links.
fn mastering_of_joint_1(
    joint_deg: f64,
    base_deg: f64,
    frame: Frame,
) -> (MasteringDocument, Vec<Link>, IsometryMatrix3<f64>) {
    let file = format!("{}/data/paper/robot.json", env!("CARGO_MANIFEST_DIR"));
    let body: RobotBody = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let robot = paper_robot();
    let mut links = true_robot(&robot, 1, &mut Normal::new(5)).links;
    links[0] = Link {
        theta_offset_rad: joint_deg.to_radians(),
        ..robot.links[0]
    };
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), base_deg.to_radians());
    let t_base = IsometryMatrix3::from_parts(Translation3::identity(), turn);
    let content = ParameterSetContent {
        links: links.iter().map(IdentifiedLink::from).collect(),
        t_instrument_base: (&t_base).into(),
        targets: vec![],
        links_with_corrections: None,
        corrections: None,
    };
    let provenance = Provenance {
        measuring_frame: Some(frame),
        ..Provenance::default()
    };
    let source = Source {
        id: "set",
        body: &body,
        robot: &robot,
        content: &content,
        provenance: &provenance,
    };
    let exported = export::export(&source, ExportFormat::Mastering, BetaChoice::Keep).unwrap();
    let document = serde_json::from_str(&exported.text).unwrap();
    (document, links, t_base)
}

#[test]
fn positions_in_the_base_frame_determine_the_offset_of_joint_1() {
    let nominal = paper_robot();
    for (joint_deg, base_deg) in [(0.5, 0.0), (0.48, 0.02), (-0.3, 0.1)] {
        let (document, links, t_base) = mastering_of_joint_1(joint_deg, base_deg, Frame::Base);
        let first = document.joints[0];
        println!(
            "{joint_deg}° and {base_deg}°: {first:?}, {:?}",
            document.remaining_error_mm
        );
        assert!(first.determined && !document.joints[5].determined);
        assert_eq!(document.frame, ErrorFrame::Measuring);
        // the other links take a part of it
        assert!((first.offset_deg - joint_deg - base_deg).abs() < 0.1);
        // the error of the flange's origin in the base frame, by the true robot
        let offsets = document.offsets_rad();
        let missed_mm: Vec<f64> = poses(200, &mut Normal::new(6))
            .iter()
            .map(|q| {
                let shown: Vec<f64> = q.iter().zip(&offsets).map(|(q, o)| q + o).collect();
                let there = t_base * t_base_flange(&links, q);
                let nominal = t_base_flange(&nominal.links, &shown);
                (there.translation.vector - nominal.translation.vector).norm()
            })
            .collect();
        let mean_mm = missed_mm.iter().sum::<f64>() / missed_mm.len() as f64;
        let stated = document.remaining_error_mm;
        println!("off by {mean_mm:.3} mm");
        assert!(mean_mm < 1.5 * stated.mean && mean_mm > stated.mean / 2.0);
    }
    for (base_deg, frame) in [(0.0, Frame::Instrument), (1.0, Frame::Base)] {
        let (document, ..) = mastering_of_joint_1(0.5, base_deg, frame);
        assert_eq!(document.frame, ErrorFrame::RobotBase);
        assert!(!document.joints[0].determined && document.joints[0].offset_deg == 0.0);
    }
}

/// The examples of docs/export.md, by the pendant's joint values: elevation of upper arm and forearm above the horizontal, and the direction that the robot faces.
mod joint_maps {
    use super::*;

    /// The paper's arm: with q2 = 0 the upper arm is level, with q2 = -90° upright; with q3 = 0 the forearm hangs at a right angle below.
    fn arm(map: JointMap) -> Robot {
        Robot {
            joint_map: Some(map),
            ..paper_robot()
        }
    }

    /// Degrees: azimuth of the arm, elevation of the upper arm, elevation of the forearm.
    fn posture(robot: &Robot, q_deg: [f64; 6]) -> [f64; 3] {
        let q = robot.q_model_rad(&q_deg.map(f64::to_radians));
        let frame = |n: usize| t_base_flange(&robot.links[..n], &q[..n]);
        let azimuth = {
            let x = frame(1).rotation * Vector3::x();
            x.y.atan2(x.x)
        };
        let upper = frame(2).rotation * Vector3::x();
        // The forearm is along the axis of joint 4.
        let forearm = frame(4).rotation * Vector3::z();
        [azimuth, upper.z.asin(), forearm.z.asin()].map(f64::to_degrees)
    }

    #[track_caller]
    fn shows(robot: &Robot, q_deg: [f64; 6], expected: [f64; 3]) {
        let found = posture(robot, q_deg);
        assert!(
            found
                .iter()
                .zip(&expected)
                .all(|(a, b)| (a - b).abs() < 1e-9),
            "{q_deg:?}: {found:?}, not {expected:?}"
        );
    }

    fn map(sign: [f64; 6], offset_deg: [f64; 6], coupled: f64) -> JointMap {
        let mut coupling = DMatrix::identity(6, 6);
        coupling[(2, 1)] = coupled;
        JointMap {
            sign: sign.to_vec(),
            offset_rad: offset_deg.iter().map(|deg| deg.to_radians()).collect(),
            coupling,
        }
    }

    #[test]
    fn fanuc_j3_is_the_forearm_above_the_horizontal_whatever_j2_is() {
        let robot = arm(map(
            [1.0, 1.0, -1.0, -1.0, -1.0, -1.0],
            [0.0, -90.0, 0.0, 0.0, 0.0, 0.0],
            -1.0,
        ));
        shows(&robot, [0.0; 6], [0.0, 90.0, 0.0]);
        for j2 in [15.0, 0.0, 35.0] {
            shows(
                &robot,
                [10.0, j2, 25.0, 0.0, 0.0, 0.0],
                [10.0, 90.0 - j2, 25.0],
            );
        }
    }

    #[test]
    fn kuka_a1_turns_clockwise_and_the_cannon_position_is_0_minus90_90() {
        let robot = arm(map(
            [-1.0, 1.0, 1.0, -1.0, 1.0, -1.0],
            [0.0, 0.0, -90.0, 0.0, 0.0, 0.0],
            0.0,
        ));
        shows(&robot, [0.0, -90.0, 90.0, 0.0, 0.0, 0.0], [0.0, 90.0, 0.0]);
        shows(
            &robot,
            [30.0, -80.0, 90.0, 0.0, 0.0, 0.0],
            [-30.0, 80.0, -10.0],
        );
    }

    #[test]
    fn abb_with_a_linkage_keeps_the_forearms_elevation_when_axis_2_moves() {
        let robot = arm(map(
            [1.0, 1.0, 1.0, 1.0, 1.0, 1.0],
            [0.0, -90.0, 0.0, 0.0, 0.0, 0.0],
            -1.0,
        ));
        shows(&robot, [0.0; 6], [0.0, 90.0, 0.0]);
        for axis_2 in [30.0, 15.0, 40.0] {
            shows(
                &robot,
                [0.0, axis_2, 20.0, 0.0, 0.0, 0.0],
                [0.0, 90.0 - axis_2, -20.0],
            );
        }
    }

    #[test]
    fn yaskawa_u_counts_upwards_and_is_not_coupled() {
        let robot = arm(map(
            [1.0, 1.0, -1.0, -1.0, -1.0, -1.0],
            [0.0, -90.0, 0.0, 0.0, 0.0, 0.0],
            0.0,
        ));
        shows(&robot, [0.0; 6], [0.0, 90.0, 0.0]);
        shows(
            &robot,
            [-15.0, 30.0, 40.0, 0.0, 0.0, 0.0],
            [-15.0, 60.0, 10.0],
        );
    }
}

/// The base of an arm whose first axis points into the floor (KUKA) is upright, as the cell's frames, mounting and gravity are.
#[test]
fn the_base_of_a_description_is_upright() {
    let mut n_turned = 0;
    for (name, urdf) in &urdfs() {
        let Ok(imported) = import(urdf.as_bytes(), ImportFormat::Urdf, name, None) else {
            continue; // hands, and descriptions of two arms
        };
        let first = &imported.robot.links[0];
        let up = imported.t_root_base.rotation[2][2];
        if name.starts_with("kuka") {
            assert!((up - 1.0).abs() < 1e-12, "{name}: {up}");
        }
        n_turned += usize::from(first.alpha_deg == 180.0);
    }
    println!("{n_turned} arms whose first axis points downwards");
    assert!(n_turned > 0 || urdfs().is_empty());
}

/// An arm of two joints; `first` and `second` are put into the elements of its joints, `ends` behind them.
fn two_joints(first: &str, second: &str, ends: &str) -> String {
    format!(
        "<robot name='x'>
<joint name='j1' type='revolute'><parent link='base'/><child link='link1'/><axis xyz='0 0 1'/>{first}</joint>
<joint name='j2' type='revolute'><parent link='link1'/><child link='link2'/><axis xyz='0 1 0'/>{second}</joint>
{ends}</robot>"
    )
}

fn fixed(name: &str, parent: &str, child: &str, xyz: &str) -> String {
    format!(
        "<joint name='{name}' type='fixed'><parent link='{parent}'/><child link='{child}'/><origin xyz='{xyz}'/></joint>"
    )
}

fn imported(text: &str) -> Result<RobotBody, kincal::wire::Invalid> {
    import(text.as_bytes(), ImportFormat::Urdf, "x", None).map(|imported| imported.robot)
}

#[test]
fn a_urdf_in_other_units_is_refused_with_joint_value_and_unit() {
    let in_mm = two_joints("<origin xyz='0 0 300'/>", "<origin xyz='20000 0 0'/>", "");
    let refused = imported(&in_mm).unwrap_err();
    let told = &refused.issues[0].detail;
    assert!(
        told.starts_with("line 2: joint \"j1\" has xyz=\"0 0 300\"") && told.contains("metres"),
        "{told}"
    );
    assert_eq!(refused.issues.len(), 2, "{refused:?}");
    let in_degrees = two_joints(
        "<limit lower='-2.9671' upper='2.9671'/>",
        "<limit lower='-90' upper='170'/>",
        "",
    );
    let refused = imported(&in_degrees).unwrap_err();
    let told: Vec<&str> = refused.issues.iter().map(|i| i.detail.as_str()).collect();
    assert!(
        told[0].starts_with("line 3: joint \"j2\" has lower=-90: a URDF is in radians")
            && told[1].contains("upper=170")
            && told[1].contains("write 2.967060"),
        "{told:?}"
    );
}

#[test]
fn limits_of_a_urdf_are_rounded_by_their_digits_and_refused_in_the_wrong_order() {
    let limits = |lower: &str, upper: &str| {
        imported(&two_joints(
            &format!("<limit lower='{lower}' upper='{upper}'/>"),
            "<origin xyz='0 0 0.3'/>",
            "",
        ))
    };
    let found = limits("-2.9671", "2.0944").unwrap();
    assert_eq!(found.links[0].joint_limits_deg, Some([-170.0, 120.0]));
    assert_eq!(found.links[1].joint_limits_deg, None);
    let refused = limits("1", "-1").unwrap_err();
    let told = &refused.issues[0].detail;
    assert!(
        told.starts_with("line 2: joint \"j1\" has the limits lower=1 and upper=-1"),
        "{told}"
    );
    // equal limits are none
    assert_eq!(limits("0", "0").unwrap().links[0].joint_limits_deg, None);
}

#[test]
fn of_several_tips_at_different_places_one_has_to_be_named() {
    let arm = |ends: &str| two_joints("", "<origin xyz='0 0 0.3'/>", ends);
    let left = fixed("to_left", "link2", "left", "0.1 0 0");
    let refused = imported(&arm(
        &(left.clone() + &fixed("to_right", "link2", "right", "0 0.1 0"))
    ));
    let refused = refused.unwrap_err();
    assert_eq!(refused.code, "several_tips");
    assert!(
        refused.issues[0].detail.contains("left, right"),
        "{refused:?}"
    );
    // flange and tool0 are often at one place
    imported(&arm(
        &(left + &fixed("to_tool0", "link2", "tool0", "0.1 0 0"))
    ))
    .unwrap();
}

#[test]
fn the_links_before_the_fingers_of_a_hand_are_offered_as_tips() {
    let finger = |side: &str| {
        format!(
            "<joint name='{side}' type='prismatic'><parent link='hand'/><child link='{side}_finger'/></joint>"
        )
    };
    let ends = fixed("j8", "link2", "link8", "0 0 0.1")
        + &fixed("to_hand", "link8", "hand", "0 0 0")
        + &finger("left")
        + &finger("right");
    let refused = imported(&two_joints("", "<origin xyz='0 0 0.3'/>", &ends)).unwrap_err();
    let told = &refused.issues[0].detail;
    assert!(
        told.contains("left_finger, right_finger") && told.ends_with("as the tip: link8, hand"),
        "{told}"
    );
}

/// The first axis of KUKA's arms points down by a rotation of 3.1416.
#[test]
fn an_axis_that_points_down_but_for_rounded_digits_is_imported_exactly() {
    let text = two_joints(
        "<origin xyz='0 0 0.645' rpy='3.1416 0 0'/>",
        "<origin xyz='0.33 0.01 0' rpy='1.5708 0 0'/>",
        "",
    );
    let imported = import(text.as_bytes(), ImportFormat::Urdf, "x", None).unwrap();
    assert!(imported.largest_difference_mm < 1e-9, "{imported:?}");
    assert!((imported.robot.links[0].alpha_deg.abs() - 180.0).abs() > 1e-6);
    for (name, urdf) in &urdfs() {
        if let Err(refused) = import(urdf.as_bytes(), ImportFormat::Urdf, name, None) {
            assert_ne!(refused.code, "not_expressible", "{name}: {refused:?}");
        }
    }
}
