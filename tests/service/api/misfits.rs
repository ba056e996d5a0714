//! Points that do not fit, and sets that are no better than nominal: reports, gates and terminal output.

use crate::api::suspicions::{by_a_tracker, changed, codes, kincal, upload};
use crate::app::{TestApp, paper, text};
use crate::people::{Person, guarded};
use kincal::kinematics::{Robot, t_base_flange};
use kincal::wire::robot::RobotBody;
use nalgebra::Vector3;
use serde_json::{Value, json};

fn paper_robot() -> Robot {
    let body: RobotBody = serde_json::from_slice(&paper("robot.json")).unwrap();
    Robot::try_from(&body).unwrap()
}

/// Position of a point of the flange of the nominal robot, mm.
fn nominal_mm(robot: &Robot, q_deg: &[f64], in_flange_mm: Vector3<f64>) -> Vector3<f64> {
    let q_rad: Vec<f64> = q_deg.iter().map(|q| q.to_radians()).collect();
    let flange = t_base_flange(&robot.links, &robot.q_model_rad(&q_rad));
    flange.rotation * in_flange_mm + flange.translation.vector
}

/// A set whose identify points have the robot's errors, and whose verify points have none.
fn worse_than_nominal() -> String {
    let robot = paper_robot();
    let file = changed("first.csv", |_, _| {});
    let without_errors = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        if cells[1] != "verify" {
            return line.to_owned();
        }
        let q_deg: Vec<f64> = cells[2..8].iter().map(|c| c.parse().unwrap()).collect();
        let p = nominal_mm(&robot, &q_deg, Vector3::zeros());
        format!("{},{},{},{}", cells[..8].join(","), p.x, p.y, p.z)
    };
    file.lines()
        .map(|line| without_errors(line) + "\n")
        .collect()
}

/// A set with a reflector off the flange's axis.
fn off_axis() -> String {
    let robot = paper_robot();
    let tool_mm = Vector3::new(90.0, -40.0, 0.0);
    changed("first_noisy.csv", |q, p| {
        let off = nominal_mm(&robot, q, tool_mm) - nominal_mm(&robot, q, Vector3::zeros());
        p.iter_mut().zip(off.iter()).for_each(|(p, off)| *p += off);
    })
}

/// A set with another base than the file states.
fn base_off() -> String {
    changed("first_noisy.csv", |_, p| {
        (p[0], p[1], p[2]) = (p[0] + 25.0, p[1] - 30.0, p[2] + 8.0);
    })
}

/// The values of joint 4 are read from a zero that is 60° away.
fn joint_4_from_another_zero() -> String {
    changed("first_noisy.csv", |q, _| q[3] += 60.0)
}

/// Joint 6 counts the other way round, and the reflector is 10 mm off its axis.
fn last_joint_reversed() -> String {
    let robot = paper_robot();
    let tool_mm = Vector3::new(10.0, 0.0, 0.0);
    changed("first_noisy.csv", |q, p| {
        let off = nominal_mm(&robot, q, tool_mm) - nominal_mm(&robot, q, Vector3::zeros());
        p.iter_mut().zip(off.iter()).for_each(|(p, off)| *p += off);
        q[5] = -q[5];
    })
}

/// The first rows of a file.
fn first_rows(csv: &str, n: usize) -> String {
    csv.lines()
        .take(1 + n)
        .map(|line| format!("{line}\n"))
        .collect()
}

async fn report_of(app: &TestApp, job: &Value) -> Value {
    assert_eq!(job["status"], "succeeded", "{job}");
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    app.get(&path).await.ok(200)
}

#[tokio::test]
async fn a_set_that_is_no_better_than_nominal_trains_no_network_and_is_not_released() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let set = upload(&app, &robot, "frame=base", &worse_than_nominal())
        .await
        .ok(201);
    let request = json!({"measurement_set_id": set["id"], "method": "pso", "options": {"n_particles": 20, "n_iterations": 5}});
    let job = app.run(&robot, &request).await;
    let report = report_of(&app, &job).await;
    let told = codes(&report["warnings"]);
    assert!(told.contains(&"no_better_than_nominal"), "{told:?}");
    assert!(job["network_id"].is_null(), "{job}");
    let page = format!("/v1/jobs/{}/report.html", text(&job["id"]));
    let page = app.get(&page).await.text();
    assert!(page.contains("no better than the nominal robot: do not use it"));
    let release = format!(
        "/v1/parameter-sets/{}/release",
        text(&job["parameter_set_id"])
    );
    let reasons = json!({"reason": "r", "change_reason": "r"});
    app.post_json(&release, &reasons)
        .await
        .problem(409, "release_refused");
}

/// The model cannot fit these points, or fits them with a link turned over: the set is not released and corrects no target.
#[tokio::test]
async fn an_identified_robot_that_is_wrong_corrects_no_target_and_is_not_released() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    for (csv, query, model, code) in [
        (base_off(), "frame=base", "paper", "model_too_small"),
        (
            last_joint_reversed(),
            "frame=base",
            "complete",
            "joint_map_suspect",
        ),
        (
            joint_4_from_another_zero(),
            "frame=base&insist=joint_map_suspect",
            "complete",
            "joint_map_suspect",
        ),
    ] {
        let set = upload(&app, &robot, query, &csv).await.ok(201);
        let request =
            json!({"measurement_set_id": set["id"], "method": "least_squares", "model": model});
        let job = app.run(&robot, &request).await;
        let report = report_of(&app, &job).await;
        assert!(
            codes(&report["warnings"]).contains(&code),
            "{code}: {}",
            report["warnings"]
        );
        assert!(job["network_id"].is_null(), "{job}");
        let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
        let reasons = json!({"reason": "r", "change_reason": "r"});
        let refused = app.post_json(&format!("{set}/release"), &reasons).await;
        let refused = refused.problem(409, "release_refused");
        assert!(
            codes(&refused["errors"]).contains(&"fits"),
            "{code}: {refused}"
        );
        // no controller gets it; the document with its warnings is still there
        for format in ["csv", "urdf", "mastering"] {
            let path = format!("{set}/export?format={format}");
            app.get(&path).await.problem(422, code);
        }
        app.get(&format!("{set}/export")).await.ok(200);
        for mode in ["position", "pose"] {
            let body = json!({"q_deg": [[10.0, -30.0, 20.0, 15.0, 40.0, 5.0]], "mode": mode});
            let answer = app.post_json(&format!("{set}/compensate"), &body).await;
            answer.problem(422, code);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn in_a_terminal_the_remedy_is_named_where_one_fits_and_nothing_invites_to_release() {
    let dir = tempfile::tempdir().unwrap();
    let (app, _data) = guarded(1).await;
    let person = Person::new(&app, &["read", "upload", "identify"]).await;
    let body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = person.post("/v1/robots", &body).await.ok(201);
    let robot_file = format!("{}/data/paper/robot.json", env!("CARGO_MANIFEST_DIR"));
    let calibrate = ["calibrate".to_owned(), robot_file];
    let submit = ["submit", "--wait", "--robot", text(&robot["id"])].map(str::to_owned);
    let environment = vec![
        ("KINCAL_SERVER", app.server.url()),
        ("KINCAL_KEY", person.key.clone()),
    ];
    for (name, csv, remedy) in [
        ("worse", worse_than_nominal(), None),
        ("off axis", off_axis(), Some("--model complete")),
        ("base off", base_off(), Some("--model complete")),
    ] {
        let path = dir.path().join(format!("{name}.csv"));
        std::fs::write(&path, csv).unwrap();
        let path = path.display().to_string();
        for command in [calibrate.to_vec(), submit.to_vec()] {
            let run = async |more: &[&str]| {
                let more = more.iter().map(|argument| (*argument).to_owned());
                let all = command.iter().cloned().chain([path.clone()]).chain(more);
                kincal(all.collect(), environment.clone()).await
            };
            let (code, told, complaints) =
                run(&["--method", "least_squares", "--model", "paper"]).await;
            assert_eq!(code, Some(1), "{name}: {told} {complaints}");
            assert!(
                !told.contains("kincal release") && !complaints.contains("kincal release"),
                "{name}: {told} {complaints}"
            );
            let Some(remedy) = remedy else {
                assert!(
                    complaints.contains("(no_better_than_nominal)"),
                    "{complaints}"
                );
                continue;
            };
            let (_, next) = complaints.split_once("next: ").expect(&complaints);
            assert!(next.contains(remedy), "{name}: {complaints}");
            let followed: Vec<&str> = remedy.split(' ').collect();
            let (code, told, complaints) = run(&followed).await;
            assert_eq!(code, Some(0), "{name}: {told} {complaints}");
        }
    }
}

#[tokio::test]
async fn a_few_points_are_no_evidence_and_a_wrong_file_is_told_however_few_they_are() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let set_id = &job["parameter_set_id"];
    let right = changed("followup_unchanged.csv", |_, _| {});
    let verified = async |robot: &str, query: &str, csv: &str, set: &Value| {
        let first = upload(&app, robot, query, csv).await.json();
        let upload = match first["status"].as_u64() {
            Some(422) => {
                let insisting = format!("{query}&insist={}", text(&first["code"]));
                upload(&app, robot, &insisting, csv).await.ok(201)
            }
            _ => first,
        };
        let mut verify = json!({"kind": "verify", "measurement_set_id": upload["id"]});
        if !set.is_null() {
            verify["parameter_set_id"] = set.clone();
        }
        report_of(&app, &app.run(robot, &verify).await).await
    };
    for n in 1..=4 {
        let report = verified(&robot, "frame=base", &first_rows(&right, n), set_id).await;
        assert_eq!(report["evidence"], "none", "{n} points");
        let told = codes(&report["warnings"]);
        assert!(
            told.iter().all(|code| *code == "session_shows_little"),
            "{n} points: {told:?}"
        );
    }
    let report = verified(&robot, "frame=base", &first_rows(&right, 5), set_id).await;
    assert_eq!(report["evidence"], "independent_session");
    // Nothing is identified from this set.
    let nominal = app.paper_robot().await;
    let kuka = |q: &mut [f64], _: &mut [f64]| [0, 3, 5].iter().for_each(|j| q[*j] = -q[*j]);
    let of_kuka = changed("followup_unchanged.csv", kuka);
    let wrong = by_a_tracker("followup_unchanged.csv");
    for (what, query, csv) in [
        ("a tracker's file", "frame=base", &wrong),
        ("a maker's signs", "frame=base", &of_kuka),
        ("a maker's signs", "frame=instrument", &of_kuka),
    ] {
        for n in 5..=7 {
            let report = verified(&nominal, query, &first_rows(csv, n), &Value::Null).await;
            let told = codes(&report["warnings"]);
            assert!(
                told.contains(&"session_does_not_fit") && report["evidence"] == "none",
                "{what}, {query}, {n} points: {told:?}, {}",
                report["evidence"]
            );
            let state = app.get(&nominal).await.ok(200)["state"].clone();
            assert_eq!(state, "check_robot", "{what}, {query}, {n} points");
        }
    }
    // Correct sets fit, with the reflector and in both frames.
    for query in ["frame=base", "frame=instrument"] {
        for n in [5, 7, 20] {
            let csv = first_rows(&off_axis(), n);
            let report = verified(&nominal, query, &csv, &Value::Null).await;
            let told = codes(&report["warnings"]);
            assert!(
                !told.contains(&"session_does_not_fit"),
                "{query}, {n}: {told:?}"
            );
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn collision_texts_name_every_gate() {
    let dir = tempfile::tempdir().unwrap();
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let path = dir.path().join("collision.csv");
    std::fs::write(&path, paper("followup_collision.csv")).unwrap();
    let robot_id = text(&app.get(&robot).await.ok(200)["id"]).to_owned();
    let arguments = [
        "submit",
        "--wait",
        "--verify",
        "--parameters",
        text(&job["parameter_set_id"]),
        "--robot",
        &robot_id,
        &path.display().to_string(),
    ];
    let (code, told, complaints) = kincal(
        arguments.map(str::to_owned).to_vec(),
        vec![("KINCAL_SERVER", app.server.url())],
    )
    .await;
    assert_eq!(code, Some(1), "{told} {complaints}");
    assert!(
        told.contains("evidence: none; this file does not fit this robot"),
        "{told}"
    );
    let gates = format!(
        "/v1/parameter-sets/{}/gates",
        text(&job["parameter_set_id"])
    );
    let gates = app.get(&gates).await.ok(200);
    let detail = |name: &str| {
        let mut all = gates["gates"].as_array().unwrap().iter();
        let gate = all.find(|gate| gate["gate"] == name).unwrap();
        text(&gate["detail"]).to_owned()
    };
    assert!(detail("verified").contains("1 session scored"), "{gates}");
    assert_eq!(
        detail("sessions_better_than_nominal"),
        "no session that fits the robot has been scored on it"
    );
}
