//! Poses by HTTP: upload, job, report, parameter set, corrected poses; and bad input of each kind.

use crate::app::{Answer, TestApp, paper, text};
use kincal::identification::KinematicModel;
use kincal::kinematics::rotation::rotation_exp;
use kincal::measurement::RotationConvention;
use nalgebra::{IsometryMatrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use serde_json::{Value, json};

/// Errors of the simulated robot's lengths, mm, and angles, degrees.
const OFF: (f64, f64) = (0.4, 0.06);
/// Noise of each coordinate of a simulated pose, mm and rad.
const NOISE: (f64, f64) = (0.02, 2e-4);
/// The held-out errors are those of the noise, twice over for the fit's own: mm and degrees, three coordinates each.
const MOST: (f64, f64) = (0.07, 0.04);

/// Joint values, degrees, position and rotation of each pose.
type Pose = (Vec<f64>, Vector3<f64>, Rotation3<f64>);

/// Poses of the paper's robot with errors, as a tracker sees them.
fn measured(n: usize) -> Vec<Pose> {
    let limits = [150.0, 60.0, 60.0, 150.0, 100.0, 150.0];
    measured_of(n, Vector3::new(40.0, -20.0, 90.0), limits, NOISE)
}

/// The same poses of a fixed board, as a camera on the arm sees it: its noise is that of the board in the camera's frame.
fn seen_by_a_carried_camera(n: usize) -> Vec<Pose> {
    let mut random = ChaCha8Rng::seed_from_u64(25);
    let mut vector = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..size));
    let limits = [150.0, 60.0, 60.0, 150.0, 100.0, 150.0];
    measured_of(n, Vector3::new(40.0, -20.0, 90.0), limits, (0.0, 0.0))
        .into_iter()
        .map(|(q_deg, position_mm, rotation)| {
            let back = rotation.inverse();
            let board_mm = -(back * position_mm) + vector(NOISE.0);
            (q_deg, board_mm, back * rotation_exp(&vector(NOISE.1)))
        })
        .collect()
}

/// Poses of a target at joint values up to some limits, degrees.
fn measured_of(
    n: usize,
    target_mm: Vector3<f64>,
    limits: [f64; 6],
    noise: (f64, f64),
) -> Vec<Pose> {
    let mut random = ChaCha8Rng::seed_from_u64(24);
    let body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let mut of =
        |value: &Value, off: f64| value.as_f64().unwrap_or(0.0) + random.random_range(-off..off);
    let links = body["links"]
        .as_array()
        .unwrap()
        .iter()
        .map(|l| kincal::kinematics::Link {
            a_mm: of(&l["a_mm"], OFF.0),
            alpha_rad: of(&l["alpha_deg"], OFF.1).to_radians(),
            d_mm: of(&l["d_mm"], OFF.0),
            theta_offset_rad: of(&l["theta_offset_deg"], OFF.1).to_radians(),
            beta_rad: 0.0,
        });
    let truth = KinematicModel {
        t_instrument_base: IsometryMatrix3::from_parts(
            Translation3::new(2300.0, -1400.0, 350.0),
            rotation_exp(&Vector3::new(0.1, -0.3, 0.9)),
        ),
        links: links.collect(),
        targets_mm: vec![target_mm],
        target_rotations: vec![rotation_exp(&Vector3::new(0.4, 1.1, -0.7))],
    };
    let mut vector = |size: f64| Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)) * size;
    (0..n)
        .map(|_| {
            let (a, b) = (vector(1.0), vector(1.0));
            let q_deg: Vec<f64> = a
                .iter()
                .chain(b.iter())
                .zip(limits)
                .map(|(x, limit)| x * limit)
                .collect();
            let q_rad: Vec<f64> = q_deg.iter().map(|q| q.to_radians()).collect();
            let turned = rotation_exp(&vector(noise.1));
            (
                q_deg,
                truth.position(&q_rad, 0) + vector(noise.0),
                truth.rotation(&q_rad, 0).unwrap() * turned,
            )
        })
        .collect()
}

fn quaternion(rotation: &Rotation3<f64>) -> [f64; 4] {
    let q = UnitQuaternion::from_rotation_matrix(rotation);
    [q.w, q.i, q.j, q.k]
}

/// A file with the rotation of each pose in some columns.
fn csv(poses: &[Pose], columns: &str, cells: impl Fn(&Rotation3<f64>) -> Vec<f64>) -> String {
    let mut text = format!("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm,{columns}\n");
    for (q_deg, position_mm, rotation) in poses {
        let numbers = q_deg.iter().chain(position_mm.iter()).copied();
        let cells: Vec<String> = numbers
            .chain(cells(rotation))
            .map(|x| x.to_string())
            .collect();
        text += &(cells.join(",") + "\n");
    }
    text
}

const QUATERNION: &str = "quat_w,quat_x,quat_y,quat_z";
const ANGLES: &str = "rx_deg,ry_deg,rz_deg";

fn with_quaternions(poses: &[Pose]) -> String {
    csv(poses, QUATERNION, |r| quaternion(r).to_vec())
}

/// Angles of Rx·Ry·Rz, degrees.
fn xyz(r: &Rotation3<f64>) -> Vec<f64> {
    let m = r.matrix();
    let (rx, rz) = ((-m[(1, 2)]).atan2(m[(2, 2)]), (-m[(0, 1)]).atan2(m[(0, 0)]));
    [rx, m[(0, 2)].asin(), rz].map(f64::to_degrees).to_vec()
}

async fn upload(app: &TestApp, robot: &str, query: &str, csv: &str) -> Answer {
    let path = format!("{robot}/measurement-sets?frame=instrument{query}");
    app.post(&path, "text/csv", csv.to_owned()).await
}

/// A camera on the arm states how a fixed board stands to it: each pose is the inverse of the camera's in the board's frame.
#[tokio::test]
async fn poses_of_a_fixed_board_seen_by_a_carried_camera_are_named_and_taken() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let seen = seen_by_a_carried_camera(80);
    let file = with_quaternions(&seen);
    let refused = upload(&app, &robot, "", &file).await;
    let refused = refused.problem(422, "rotation_suspect");
    assert!(
        text(&refused["errors"][0]["detail"]).contains("inverse_poses=true"),
        "{refused}"
    );
    let angles = csv(&seen, ANGLES, xyz);
    let refused = upload(&app, &robot, "", &angles).await;
    let refused = refused.problem(422, "invalid_measurements");
    assert!(
        text(&refused["errors"][0]["detail"]).contains("No convention fits this robot"),
        "{refused}"
    );
    let taken = upload(&app, &robot, "&inverse_poses=true", &file).await;
    let set = taken.ok(201);
    assert_eq!(set["inverse_poses"], true);
    let request = json!({"measurement_set_id": set["id"]});
    let job = app.run(&robot, &request).await;
    let report = format!("/v1/jobs/{}/report", text(&job["id"]));
    let after = &app.get(&report).await.ok(200)["verify"]["after"];
    assert!(after["rms_mm"].as_f64().unwrap() < 2.0 * MOST.0, "{after}");
    for (query, code) in [
        (
            "frame=base&inverse_poses=true",
            "inverse_poses_in_base_frame",
        ),
        ("frame=instrument&inverse_poses=true", "no_poses"),
    ] {
        let path = format!("{robot}/measurement-sets?{query}");
        let body = match code {
            "no_poses" => paper("first.csv"),
            _ => file.clone().into_bytes(),
        };
        let refused = app.post(&path, "text/csv", body).await;
        refused.problem(422, code);
    }
}

#[tokio::test]
async fn poses_are_uploaded_identified_reported_and_correct_whole_poses() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let poses = measured(80);
    let set = upload(&app, &robot, "", &with_quaternions(&poses))
        .await
        .ok(201);
    let job = app
        .run(&robot, &json!({"measurement_set_id": set["id"]}))
        .await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let report = app.report(&job).await;
    let verify = &report["verify"];
    let of = |when: &str| {
        (
            verify[when]["rms_mm"].as_f64().unwrap(),
            verify["rotation"][when]["rms_deg"].as_f64().unwrap(),
        )
    };
    let (before, after) = (of("before"), of("after"));
    assert!(after.0 < MOST.0 && after.1 < MOST.1, "{verify}");
    assert!(
        before.0 > 2.0 * after.0 && before.1 > 2.0 * after.1,
        "{verify}"
    );
    assert_eq!(report["identifiability"]["rank"], 30);
    assert!(report["per_point"][0]["after_rotation_deg"].is_number());
    let warnings = report["warnings"].to_string();
    assert!(!warnings.contains("pose_not_seen"), "{warnings}");
    assert!(!warnings.contains("orientation_not_known"), "{warnings}");
    let path = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let parameters = app.get(&path).await.ok(200);
    let q = parameters["targets"][0]["quaternion"].as_array().unwrap();
    let norm: f64 = q.iter().map(|x| x.as_f64().unwrap().powi(2)).sum();
    assert!((norm - 1.0).abs() < 1e-9, "{parameters}");
    let corrected = app
        .post_json(
            &format!("{path}/compensate"),
            &json!({"q_deg": [[10.0, -30.0, 20.0, 15.0, 40.0, 5.0]], "mode": "pose"}),
        )
        .await
        .ok(200);
    assert_eq!(corrected["status"], json!(["ok"]), "{corrected}");
    assert!(
        !corrected["warnings"].to_string().contains("pose_not_seen"),
        "{corrected}"
    );
    // the stored set verifies the parameter set, base and target placed anew
    let request = json!({"measurement_set_id": set["id"], "kind": "verify",
                         "parameter_set_id": job["parameter_set_id"]});
    let verified = app.run(&robot, &request).await;
    assert_eq!(verified["status"], "succeeded", "{verified}");
    let path = format!("/v1/jobs/{}/report", text(&verified["id"]));
    let report = app.get(&path).await.ok(200);
    let rms_deg = report["verify"]["rotation"]["after"]["rms_deg"]
        .as_f64()
        .unwrap();
    assert!(rms_deg < MOST.1, "{}", report["verify"]);
}

#[tokio::test]
async fn angles_need_their_convention_and_the_one_that_fits_is_named() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let poses = measured(30);
    let file = csv(&poses, ANGLES, xyz);
    let refused = upload(&app, &robot, "", &file)
        .await
        .problem(422, "invalid_measurements");
    let issue = &refused["errors"][0];
    assert_eq!(issue["code"], "rotation_required", "{refused}");
    assert_eq!(issue["column"], "rx_deg");
    assert!(
        text(&issue["detail"]).contains("rotation=intrinsic_xyz"),
        "{issue}"
    );
    let set = upload(&app, &robot, "&rotation=intrinsic_xyz", &file)
        .await
        .ok(201);
    assert_eq!(
        set["rotation"], "intrinsic_xyz",
        "the set says how it was read"
    );
    assert_eq!(set.get("inverse_poses"), None);
    upload(&app, &robot, "&rotation=extrinsic_zyx", &file)
        .await
        .ok(201);
    for wrong in [
        "intrinsic_zyx",
        "extrinsic_xyz",
        "rotation_vector",
        "intrinsic_zyz",
    ] {
        let query = format!("&rotation={wrong}");
        let refused = upload(&app, &robot, &query, &file)
            .await
            .problem(422, "rotation_suspect");
        let detail = text(&refused["errors"][0]["detail"]);
        assert!(
            detail.contains("rotation=intrinsic_xyz"),
            "{wrong}: {detail}"
        );
        let kept = upload(
            &app,
            &robot,
            &format!("{query}&insist=rotation_suspect"),
            &file,
        )
        .await;
        assert_eq!(kept.ok(201)["insisted_on"], "rotation_suspect");
    }
    upload(&app, &robot, "&rotation=xyz", &file)
        .await
        .problem(422, "unknown_rotation");
    let inverse: Vec<Pose> = poses
        .iter()
        .map(|(q, p, r)| (q.clone(), *p, r.inverse()))
        .collect();
    let refused = upload(&app, &robot, "", &with_quaternions(&inverse)).await;
    let refused = refused.problem(422, "rotation_suspect");
    assert!(
        text(&refused["errors"][0]["detail"]).contains("inverse"),
        "{refused}"
    );
    let other_order = csv(&poses, QUATERNION, |r| {
        let [w, x, y, z] = quaternion(r);
        vec![x, y, z, w]
    });
    let refused = upload(&app, &robot, "", &other_order)
        .await
        .problem(422, "rotation_suspect");
    assert!(
        text(&refused["errors"][0]["detail"]).contains("x, y, z, w"),
        "{refused}"
    );
}

#[tokio::test]
async fn every_convention_reads_what_it_wrote_in_another_way() {
    // a turn about one axis alone is the same in every convention that has the axis
    for convention in RotationConvention::all() {
        let read = convention.rotation(&Vector3::new(0.0, 0.0, 0.3));
        let about = read.axis_angle().unwrap();
        assert!((about.1 - 0.3).abs() < 1e-12, "{convention}");
        assert_eq!(convention.to_string().parse(), Ok(convention));
    }
}

#[tokio::test]
async fn bad_rotations_are_refused_with_row_column_and_hint() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let poses = measured(20);
    let cases: [(&str, String, &str, &str); 5] = [
        (
            "half a quaternion",
            csv(&poses, "quat_w,quat_x", |r| quaternion(r)[..2].to_vec()),
            "incomplete_quaternion",
            "quat_y",
        ),
        (
            "two of three angles",
            csv(&poses, "rx_deg,ry_deg", |r| xyz(r)[..2].to_vec()),
            "incomplete_rotation",
            "rz_deg",
        ),
        (
            "a length of 1.2",
            csv(&poses, QUATERNION, |r| {
                quaternion(r).map(|x| 0.8 * x).to_vec()
            }),
            "quaternion_not_normalised",
            "quat_w",
        ),
        (
            "both ways",
            csv(&poses, &format!("{QUATERNION},{ANGLES}"), |r| {
                [quaternion(r).to_vec(), xyz(r)].concat()
            }),
            "duplicate_column",
            "rx_deg",
        ),
        (
            "an empty cell",
            with_quaternions(&poses)
                .lines()
                .take(3)
                .collect::<Vec<_>>()
                .join("\n")
                + "\n0,0,0,0,0,0,1,2,3,1,0,0,\n",
            "empty_cell",
            "quat_z",
        ),
    ];
    for (what, file, code, column) in cases {
        let refused = upload(&app, &robot, "", &file)
            .await
            .problem(422, "invalid_measurements");
        let issue = &refused["errors"][0];
        assert_eq!(issue["code"], code, "{what}: {refused}");
        assert_eq!(issue["column"], column, "{what}");
    }
    let point = |(q_deg, p, r): &Pose, is_pose: bool| {
        let mut point = json!({"q_deg": q_deg, "position_mm": [p.x, p.y, p.z]});
        if is_pose {
            point["quaternion"] = json!(quaternion(r));
        }
        point
    };
    let points: Vec<Value> = poses
        .iter()
        .zip(0..)
        .map(|(p, i)| point(p, i != 7))
        .collect();
    let path = format!("{robot}/measurement-sets?frame=instrument");
    let refused = app.post_json(&path, &json!({"points": points})).await;
    let refused = refused.problem(422, "invalid_measurements");
    assert_eq!(refused["errors"][0]["code"], "mixed_kinds", "{refused}");
    assert_eq!(refused["errors"][0]["pointer"], "/points/7/quaternion");
    let points: Vec<Value> = poses.iter().map(|p| point(p, true)).collect();
    app.post_json(&path, &json!({"points": points}))
        .await
        .ok(201);
}

#[tokio::test]
async fn what_poses_cannot_be_used_for_yet_is_refused() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let set = upload(&app, &robot, "", &with_quaternions(&measured(60)))
        .await
        .ok(201);
    for request in [json!({"method": "pso"}), json!({"model": "paper"})] {
        let mut request = request;
        request["measurement_set_id"] = set["id"].clone();
        app.post_json(&format!("{robot}/jobs"), &request)
            .await
            .problem(422, "poses_not_supported");
    }
}

/// Angles of Rz·Ry·Rz, degrees.
fn zyz(r: &Rotation3<f64>) -> Vec<f64> {
    let m = r.matrix();
    let (first, last) = (m[(1, 2)].atan2(m[(0, 2)]), m[(2, 1)].atan2(-m[(2, 0)]));
    [first, m[(2, 2)].acos(), last]
        .map(f64::to_degrees)
        .to_vec()
}

#[tokio::test]
async fn rotations_that_do_not_belong_to_the_positions_are_refused() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let poses = measured(60);
    // xyx and zxz fit as well if the base may turn, too: the positions say how it stands
    let file = csv(&poses, ANGLES, zyz);
    let refused = upload(&app, &robot, "", &file)
        .await
        .problem(422, "invalid_measurements");
    let detail = text(&refused["errors"][0]["detail"]);
    assert!(detail.contains("rotation=intrinsic_zyz"), "{detail}");
    let refused = upload(&app, &robot, "&rotation=intrinsic_xyx", &file)
        .await
        .problem(422, "rotation_suspect");
    let detail = text(&refused["errors"][0]["detail"]);
    assert!(detail.contains("rotation=intrinsic_zyz"), "{detail}");
    upload(&app, &robot, "&rotation=intrinsic_zyz", &file)
        .await
        .ok(201);
    let rotated = |change: &dyn Fn(usize) -> Rotation3<f64>| -> Vec<Pose> {
        let change = |(i, (q, p, _)): (usize, &Pose)| (q.clone(), *p, change(i));
        poses.iter().enumerate().map(change).collect()
    };
    let quarter = rotation_exp(&Vector3::new(std::f64::consts::FRAC_PI_2, 0.0, 0.0));
    for (what, wrong) in [
        (
            "of the next row",
            rotated(&|i| poses[(i + 1) % poses.len()].2),
        ),
        ("in another frame", rotated(&|i| quarter * poses[i].2)),
    ] {
        let refused = upload(&app, &robot, "", &with_quaternions(&wrong))
            .await
            .problem(422, "rotation_suspect");
        let detail = text(&refused["errors"][0]["detail"]);
        assert!(detail.contains("no other convention"), "{what}: {detail}");
    }
    // a joint whose zero is off by 20° turns the flange, and is no reason to refuse
    let unmastered: Vec<Pose> = poses
        .iter()
        .map(|(q, p, r)| {
            let mut q = q.clone();
            q[3] -= 20.0;
            (q, *p, *r)
        })
        .collect();
    upload(&app, &robot, "", &with_quaternions(&unmastered))
        .await
        .ok(201);
}

#[tokio::test]
async fn a_set_whose_rotations_do_not_fit_is_not_released() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let poses = measured(60);
    let shifted: Vec<Pose> = (0..poses.len())
        .map(|i| {
            (
                poses[i].0.clone(),
                poses[i].1,
                poses[(i + 1) % poses.len()].2,
            )
        })
        .collect();
    let set = upload(
        &app,
        &robot,
        "&insist=rotation_suspect",
        &with_quaternions(&shifted),
    )
    .await
    .ok(201);
    let job = app
        .run(&robot, &json!({"measurement_set_id": set["id"]}))
        .await;
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    let report = app.get(&path).await.ok(200);
    let no_fit = report["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .find(|warning| warning["code"] == "no_fit")
        .unwrap();
    assert!(text(&no_fit["detail"]).contains("turned by"), "{no_fit}");
    assert_eq!(report["evidence"], "none");
}

#[tokio::test]
async fn turned_poses_are_named_and_left_out() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let half = rotation_exp(&Vector3::new(0.0, 0.0, std::f64::consts::PI));
    let slightly = rotation_exp(&Vector3::new(0.0, 5f64.to_radians(), 0.0));
    let verify_rms = async |turned: &[(usize, Rotation3<f64>)]| {
        let mut poses = measured(60);
        for (row, turn) in turned {
            poses[*row].2 *= turn;
        }
        let set = upload(&app, &robot, "", &with_quaternions(&poses))
            .await
            .ok(201);
        let request = json!({"measurement_set_id": set["id"], "verify": {"source": "fraction", "fraction": 0.3}});
        let job = app.run(&robot, &request).await;
        let path = format!("/v1/jobs/{}/report", text(&job["id"]));
        let report = app.get(&path).await.ok(200);
        let rows: Vec<usize> = report["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|warning| text(&warning["code"]).starts_with("outliers"))
            .flat_map(|warning| {
                serde_json::from_value::<Vec<usize>>(warning["rows"].clone()).unwrap()
            })
            .collect();
        assert_eq!(rows, turned.iter().map(|(row, _)| *row).collect::<Vec<_>>());
        let verify = match report["verify_without_outliers"].is_null() {
            true => &report["verify"],
            false => &report["verify_without_outliers"],
        };
        (
            verify["after"]["rms_mm"].as_f64().unwrap(),
            verify["rotation"]["after"]["rms_deg"].as_f64().unwrap(),
        )
    };
    let clean = verify_rms(&[]).await;
    for turned in [
        vec![(7, half)],
        vec![(20, slightly)],
        vec![(3, half), (19, slightly), (40, half)],
    ] {
        let with = verify_rms(&turned).await;
        println!("{} turned: {with:?}, none: {clean:?}", turned.len());
        assert!(
            with.0 < 1.15 * clean.0 && with.1 < 1.15 * clean.1,
            "{with:?}"
        );
    }
}

#[tokio::test]
async fn right_rotations_are_not_refused() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    // one target in ten was seen turned: an outlier of the job, not a reason to refuse the others
    let quarter = rotation_exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
    for n in [10, 20, 30] {
        let mut poses = measured(n);
        for pose in poses.iter_mut().take(n / 10) {
            pose.2 *= quarter;
        }
        upload(&app, &robot, "", &with_quaternions(&poses))
            .await
            .ok(201);
    }
    // the target stays at the centre of the wrist: positions do not say how the base is turned
    let wrist = Vector3::new(0.0, 0.0, -125.0);
    let still = measured_of(20, wrist, [1e-9, 1e-9, 1e-9, 60.0, 60.0, 60.0], NOISE);
    let kept = upload(&app, &robot, "", &with_quaternions(&still)).await;
    assert_ne!(kept.json()["code"], "rotation_suspect", "{}", kept.text());
    // a coarse instrument that says so
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut coarse = measured(60);
    for pose in &mut coarse {
        let turn = Vector3::from_fn(|_, _| random.random_range(-0.09..0.09));
        pose.2 *= rotation_exp(&turn);
    }
    let file: String = with_quaternions(&coarse)
        .lines()
        .enumerate()
        .map(|(i, line)| format!("{line},{}\n", if i == 0 { "std_rotation_deg" } else { "3" }))
        .collect();
    upload(&app, &robot, "", &file).await.ok(201);
}
