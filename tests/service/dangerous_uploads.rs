//! Seven uploads that fit as well as a correct one but would move the robot wrongly. None is released if the robot's policy
//! requires an independent session, a second person and a tolerance. Without such a policy each carries a warning.

use crate::app::{TestApp, paper, text};
use crate::people::{Person, guarded};
use crate::simulation::{Normal, poses};
use kincal::identification::KinematicModel;
use kincal::identification::model::parameters::{Parameter, apply, paper_parameters};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Vector3};
use serde_json::{Value, json};
use std::fmt::Write;

/// Tolerance of the robot's process, mm.
const TOLERANCE_MM: f64 = 0.3;
/// Noise of a laser tracker, each coordinate, mm.
const NOISE_MM: f64 = 0.03;
/// Largest residual that looks good, mm: noise of 0.03 mm gives 0.05 mm (3-D), and twice that an operator would notice.
const LOOKS_GOOD_MM: f64 = 0.1;
const POINTS: usize = 100;

/// A robot with typical errors of some tenths of a millimetre, with its target on the flange.
fn true_robot(seed: u64) -> KinematicModel {
    let nominal = KinematicModel::nominal(&crate::data::paper_robot().links, 1);
    let parameters = paper_parameters(6);
    let mut random = Normal::new(seed);
    let error = |p: &Parameter| {
        random.draw()
            * if p.is_angle() {
                0.03f64.to_radians()
            } else {
                0.2
            }
    };
    let errors: Vec<f64> = parameters.iter().map(error).collect();
    apply(&nominal, &parameters, &errors)
}

fn csv(
    robot: &KinematicModel,
    poses: &[Vec<f64>],
    seed: u64,
    distort: impl Fn(Vector3<f64>) -> Vector3<f64>,
) -> String {
    let mut random = Normal::new(seed);
    let mut text =
        "configuration,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n".to_owned();
    for (row, q) in poses.iter().enumerate() {
        write!(text, "{row},").unwrap();
        let p = distort(robot.position(q, 0)) + random.vector() * NOISE_MM;
        q.iter()
            .for_each(|q| write!(text, "{:.6},", q.to_degrees()).unwrap());
        writeln!(text, "{:.6},{:.6},{:.6}", p.x, p.y, p.z).unwrap();
    }
    text
}

fn spread(seed: u64) -> Vec<Vec<f64>> {
    poses(POINTS, &mut Normal::new(seed))
}

fn same(p: Vector3<f64>) -> Vector3<f64> {
    p
}

/// Each mistake with the file that results from it.
fn dangerous() -> Vec<(&'static str, String)> {
    let truth = true_robot(1);
    // A displacement that link 1 can absorb: any other would show in the fit.
    let moved = IsometryMatrix3::from_parts(
        Translation3::new(0.9, 0.0, 0.6),
        Rotation3::new(Vector3::new(3e-4, 0.0, 5e-4)),
    );
    let longer_tool = KinematicModel {
        targets_mm: vec![Vector3::new(0.0, 0.0, 10.0)],
        ..truth.clone()
    };
    // Each repetition has its own label, so that the pose is on both sides of the split.
    let few = poses(9, &mut Normal::new(4));
    let repeated: Vec<Vec<f64>> = (0..POINTS).map(|i| few[i % few.len()].clone()).collect();
    let frozen: Vec<Vec<f64>> = spread(5)
        .into_iter()
        .map(|q| [&q[..3], &[0.3, 0.5, -0.2]].concat())
        .collect();
    let narrow: Vec<Vec<f64>> = spread(6)
        .into_iter()
        .map(|q| q.iter().map(|q| 0.4 + 0.03 * q).collect())
        .collect();
    vec![
        (
            "stale base",
            csv(&truth, &spread(2), 12, |p| {
                moved.rotation * p + moved.translation.vector
            }),
        ),
        (
            "another robot of the same model",
            csv(&true_robot(99), &spread(3), 13, same),
        ),
        (
            "a scale of 0.1 %",
            csv(&truth, &spread(2), 14, |p| p * 1.001),
        ),
        ("wrong tool", csv(&longer_tool, &spread(2), 15, same)),
        ("duplicate poses", csv(&truth, &repeated, 16, same)),
        ("frozen wrist", csv(&truth, &frozen, 17, same)),
        ("narrow cloud", csv(&truth, &narrow, 18, same)),
    ]
}

struct Users<'a> {
    admin: Person<'a>,
    cell: Person<'a>,
    engineer: Person<'a>,
}

/// A policy as it is stored: the usual decision rule where it names none.
fn with_rule(policy: &Value) -> Value {
    let mut policy = policy.clone();
    if policy["decision_rule"].is_null() {
        policy["decision_rule"] = json!("guarded_acceptance");
    }
    policy
}

impl<'a> Users<'a> {
    async fn new(app: &'a TestApp) -> Self {
        Self {
            admin: Person::new(app, &["admin"]).await,
            cell: Person::new(app, &["read", "upload", "identify", "release"]).await,
            engineer: Person::new(app, &["read", "release"]).await,
        }
    }

    async fn robot(&self, policy: &Value) -> String {
        let body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
        let robot = format!(
            "/v1/robots/{}",
            text(&self.admin.post("/v1/robots", &body).await.ok(201)["id"])
        );
        assert_eq!(
            self.admin
                .put(&format!("{robot}/policy"), policy)
                .await
                .ok(200),
            with_rule(policy)
        );
        robot
    }

    /// Uploads a set and identifies from it. Returns the path of the parameter set, the report, and the codes of all warnings so far.
    async fn identified(&self, robot: &str, csv: &str) -> (String, Value, Vec<String>) {
        self.identified_with(robot, csv, "all").await
    }

    /// With `final_fit` as given.
    async fn identified_with(
        &self,
        robot: &str,
        csv: &str,
        final_fit: &str,
    ) -> (String, Value, Vec<String>) {
        let set = self.cell.upload(robot, csv).await;
        let request = json!({"measurement_set_id": set["id"], "method": "least_squares", "final_fit": final_fit});
        let job = self.cell.job(robot, &request).await;
        let report = self
            .cell
            .get(&format!("/v1/jobs/{}/report", text(&job["id"])))
            .await
            .ok(200);
        let warnings = [&set["warnings"], &report["warnings"]]
            .into_iter()
            .flat_map(|list| list.as_array().unwrap());
        let codes = warnings
            .map(|warning| text(&warning["code"]).to_owned())
            .collect();
        (
            format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"])),
            report,
            codes,
        )
    }

    /// Uploads another, correct session and scores the parameter set on it.
    async fn verified(&self, robot: &str, parameter_set: &str, seed: u64) {
        let session = self
            .cell
            .upload(robot, &csv(&true_robot(1), &spread(seed), seed + 1, same))
            .await;
        let id = parameter_set.rsplit('/').next().unwrap();
        self.cell.job(robot, &json!({"kind": "verify", "measurement_set_id": session["id"], "parameter_set_id": id})).await;
    }
}

fn failed(refusal: &Value) -> Vec<&str> {
    refusal["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|issue| text(&issue["code"]))
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn no_dangerous_upload_is_released_under_the_strict_policy_and_a_clean_one_is() {
    let (app, _dir) = guarded(1).await;
    let users = Users::new(&app).await;
    let strict = json!({"tolerance_mm": TOLERANCE_MM, "independent_session_required": true, "second_person_required": true});
    let why = json!({"reason": "new calibration", "change_reason": "new calibration"});
    for (what, csv) in dangerous() {
        let robot = users.robot(&strict).await;
        let (set, report, _) = users.identified(&robot, &csv).await;
        let held_out = report["verify"]["after"]["rms_mm"].as_f64().unwrap();
        assert!(
            held_out < LOOKS_GOOD_MM,
            "{what} should look good to be dangerous: {held_out} mm"
        );
        let tool = &report["tool_uncertainty_mm"]["max"];
        let early = users
            .engineer
            .post(&format!("{set}/release"), &why)
            .await
            .problem(409, "release_refused");
        assert!(failed(&early).contains(&"evidence"), "{what}: {early}");
        users.verified(&robot, &set, 40).await;
        let late = users.engineer.post(&format!("{set}/release"), &why).await;
        let late = late.problem(409, "release_refused");
        eprintln!(
            "{what}: held out {held_out:.4} mm, tool {tool} mm; refused by {:?}, then by {:?}",
            failed(&early),
            failed(&late)
        );
        assert!(
            failed(&late).iter().any(|gate| *gate != "evidence"),
            "{what}: the other session shows it: {late}"
        );
        users
            .cell
            .get(&format!("{robot}/parameter-sets/active"))
            .await
            .problem(404, "no_active_parameter_set");
    }
    let robot = users.robot(&strict).await;
    let (set, _, _) = users
        .identified(&robot, &csv(&true_robot(1), &spread(2), 11, same))
        .await;
    users.verified(&robot, &set, 40).await;
    let alone = users
        .cell
        .post(&format!("{set}/release"), &why)
        .await
        .problem(409, "release_refused");
    assert_eq!(failed(&alone), ["second_person"]);
    assert_eq!(
        alone["errors"][0]["detail"],
        "uploaded by test, released by test: somebody else has to release it, with a key of scope `release` that uploaded nothing of it"
    );
    users
        .engineer
        .post(&format!("{set}/release"), &why)
        .await
        .ok(200);
    assert_eq!(
        users
            .cell
            .get(&format!("{robot}/parameter-sets/active"))
            .await
            .ok(200)["status"],
        "released"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn each_dangerous_upload_carries_a_warning_under_the_normal_policy() {
    let (app, _dir) = guarded(1).await;
    let users = Users::new(&app).await;
    let normal = json!({"tolerance_mm": null, "independent_session_required": false, "second_person_required": false});
    let expected: [(&str, &[&str]); 7] = [
        // refused until somebody says why the active set is far off
        ("stale base", &["change_plausible"]),
        ("another robot of the same model", &["change_plausible"]),
        ("a scale of 0.1 %", &["scale_suspect", "change_plausible"]),
        // The position of the reflector is identified, so a longer tool is no error of the robot.
        ("wrong tool", &["placement_changed"]),
        ("duplicate poses", &["duplicate_poses"]),
        ("frozen wrist", &["joint_hardly_moves", "tool_uncertain"]),
        (
            "narrow cloud",
            &[
                "poses_not_spread",
                "tool_uncertain",
                "final_fit_near_verified",
            ],
        ),
    ];
    for ((what, file), (name, expected)) in dangerous().into_iter().zip(expected) {
        assert_eq!(what, name);
        let robot = users.robot(&normal).await;
        // The robot has an earlier, correct calibration, so changes are visible.
        let (before, _, _) = users
            .identified(&robot, &csv(&true_robot(1), &spread(30), 31, same))
            .await;
        users
            .cell
            .post(&format!("{before}/release"), &json!({"reason": "first"}))
            .await
            .ok(200);
        let (set, _, mut codes) = users.identified(&robot, &file).await;
        let answer = users
            .cell
            .post(&format!("{set}/release"), &json!({"reason": "again"}))
            .await;
        if answer.status == 200 {
            let checks = answer.json()["release_checks"].clone();
            let warned = checks
                .as_array()
                .unwrap()
                .iter()
                .filter(|gate| gate["warning"] == true);
            codes.extend(warned.map(|gate| text(&gate["gate"]).to_owned()));
        } else {
            codes.extend(
                failed(&answer.problem(409, "release_refused"))
                    .into_iter()
                    .map(str::to_owned),
            );
        }
        eprintln!("{what}: {} with {codes:?}", answer.status);
        for code in expected {
            assert!(
                codes.iter().any(|found| found == code),
                "{what}: no {code} among {codes:?}"
            );
        }
    }
    // The clean one is released with the warnings that apply to it: no independent session, and no serial number.
    let robot = users.robot(&normal).await;
    let (set, _, codes) = users
        .identified(&robot, &csv(&true_robot(1), &spread(2), 11, same))
        .await;
    assert_eq!(
        codes,
        ["unidentifiable_parameters", "pose_not_seen"],
        "one reflector on the last axis"
    );
    let checks = users
        .cell
        .post(&format!("{set}/release"), &json!({"reason": "first"}))
        .await
        .ok(200)["release_checks"]
        .clone();
    let warned: Vec<&str> = checks
        .as_array()
        .unwrap()
        .iter()
        .filter(|g| g["warning"] == true)
        .map(|g| text(&g["gate"]))
        .collect();
    assert_eq!(warned, ["evidence", "identity"]);
}

/// Without a final fit there is nothing to compare with the verified fit: the same narrow cloud is refused because its tool is undetermined. A set of
/// spread poses is not.
#[tokio::test(flavor = "multi_thread")]
async fn a_narrow_cloud_is_refused_without_a_final_fit_too() {
    let (app, _dir) = guarded(1).await;
    let users = Users::new(&app).await;
    let normal = json!({"tolerance_mm": null, "independent_session_required": false, "second_person_required": false});
    let mut all = dangerous();
    let (_, narrow) = all
        .pop()
        .filter(|(what, _)| *what == "narrow cloud")
        .unwrap();
    let why = json!({"reason": "no final fit"});
    let robot = users.robot(&normal).await;
    let (set, report, _) = users
        .identified_with(&robot, &narrow, "identify_subset")
        .await;
    assert_eq!(report["final"], Value::Null);
    let refused = users.cell.post(&format!("{set}/release"), &why).await;
    let refused = refused.problem(409, "release_refused");
    assert!(
        failed(&refused).contains(&"final_fit_near_verified"),
        "{refused}"
    );
    assert!(
        !text(&refused["detail"]).contains("identify_subset"),
        "{refused}"
    );
    let robot = users.robot(&normal).await;
    let good = csv(&true_robot(1), &spread(2), 11, same);
    let (set, ..) = users
        .identified_with(&robot, &good, "identify_subset")
        .await;
    users
        .cell
        .post(&format!("{set}/release"), &why)
        .await
        .ok(200);
}

/// A log with the joint values and the tool position that the controller computed from them looks like a perfect calibration.
#[tokio::test(flavor = "multi_thread")]
async fn positions_that_the_controller_computed_are_told_and_never_released() {
    let (app, _dir) = guarded(1).await;
    let users = Users::new(&app).await;
    let normal = json!({"tolerance_mm": null, "independent_session_required": false, "second_person_required": false});
    let robot = users.robot(&normal).await;
    // the controller's drawing differs a little from the robot's description
    let mut controller = KinematicModel::nominal(&crate::data::paper_robot().links, 1);
    controller.links[0].d_mm += 0.1;
    controller.links[1].a_mm -= 0.05;
    controller.targets_mm = vec![Vector3::new(0.0, 0.0, 120.0)];
    let mut log = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n".to_owned();
    for q in spread(2) {
        let q = q.iter().map(|q| (q.to_degrees() * 1e3).round() / 1e3);
        let q_deg: Vec<f64> = q.collect();
        let q_rad: Vec<f64> = q_deg.iter().map(|q| q.to_radians()).collect();
        let p = controller.position(&q_rad, 0);
        q_deg.iter().for_each(|q| write!(log, "{q},").unwrap());
        writeln!(log, "{:.2},{:.2},{:.2}", p.x, p.y, p.z).unwrap();
    }
    let (set, _, codes) = users.identified(&robot, &log).await;
    assert!(
        codes.iter().any(|code| code == "positions_computed"),
        "{codes:?}"
    );
    let why = json!({"reason": "it fits very well", "change_reason": "first calibration"});
    let refused = users.cell.post(&format!("{set}/release"), &why).await;
    let refused = refused.problem(409, "release_refused");
    assert!(
        refused
            .to_string()
            .contains("look computed by the controller"),
        "{refused}"
    );
}
