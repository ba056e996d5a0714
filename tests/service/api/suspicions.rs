//! Uploads that are refused as suspect, the remedies in the refusals, and uploads that are accepted with `insist`.

use crate::app::{Answer, TestApp, paper, text};
use crate::people::{Person, guarded};
use crate::process::{Printed, run_beside};
use serde_json::{Value, json};

/// One of the paper's files with each row changed.
pub fn changed(name: &str, change: impl Fn(&mut [f64], &mut [f64])) -> String {
    let file = String::from_utf8(paper(name)).unwrap();
    let mut lines = file.lines();
    let mut text = lines.next().unwrap().to_owned() + "\n";
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let mut numbers: Vec<f64> = cells[2..11].iter().map(|c| c.parse().unwrap()).collect();
        let (q, p) = numbers.split_at_mut(6);
        change(q, p);
        let numbers: Vec<String> = numbers.iter().map(f64::to_string).collect();
        text += &format!("{},{},{}\n", cells[0], cells[1], numbers.join(","));
    }
    text
}

/// Position in the frame of a levelled tracker, 2.7 m away and turned by 53°.
pub fn by_a_tracker(name: &str) -> String {
    let (sin, cos) = 53.0f64.to_radians().sin_cos();
    changed(name, |_, p| {
        let (x, y) = (p[0], p[1]);
        p[0] = cos * x - sin * y + 2300.0;
        p[1] = sin * x + cos * y - 1400.0;
        p[2] += 350.0;
    })
}

/// Positions that are unrelated to the joint values.
fn unrelated_positions(name: &str) -> String {
    let row = std::cell::Cell::new(0.0);
    changed(name, |_, p| {
        row.set(row.get() + 1.0);
        let turn = |by: f64| ((row.get() * by).sin() * 1e4).sin() * 1200.0;
        p.copy_from_slice(&[turn(1.1), turn(2.3), turn(3.7)]);
    })
}

pub async fn upload(app: &TestApp, robot: &str, query: &str, csv: &str) -> Answer {
    let path = format!("{robot}/measurement-sets?{query}");
    app.post(&path, "text/csv", csv.to_owned()).await
}

async fn report(app: &TestApp, robot: &str, set: &Value) -> (Value, Value) {
    let request = json!({"measurement_set_id": set["id"], "method": "least_squares"});
    let job = app.run(robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    (job, app.get(&path).await.ok(200))
}

pub fn codes(warnings: &Value) -> Vec<&str> {
    let warnings = warnings.as_array().unwrap();
    warnings
        .iter()
        .map(|warning| text(&warning["code"]))
        .collect()
}

#[tokio::test]
async fn a_tracker_file_read_as_base_frame_is_refused_with_the_remedy_and_calibrates_when_it_is_followed()
 {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let csv = by_a_tracker("first_noisy.csv");
    let refused = upload(&app, &robot, "frame=base", &csv).await;
    let problem = refused.problem(422, "frame_suspect");
    let detail = text(&problem["detail"]);
    assert!(detail.contains("in the frame instrument"), "{detail}");
    assert!(detail.contains("insist on frame_suspect"), "{detail}");
    let set = upload(&app, &robot, "frame=instrument", &csv).await.ok(201);
    assert_eq!(set["warnings"], json!([]));
    let (_, report) = report(&app, &robot, &set).await;
    let verify_mm = report["verify"]["after"]["rms_mm"].as_f64().unwrap();
    // The file's noise is 0.05 mm in each coordinate.
    assert!(verify_mm < 0.2, "{verify_mm} mm");
}

#[tokio::test]
async fn the_robot_that_a_file_was_measured_on_is_found_behind_many_newer_ones() {
    let app = TestApp::spawn().await;
    app.paper_robot().await;
    let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let own_name = text(&body["name"]).to_owned();
    body["name"] = json!("another model");
    for link in body["links"].as_array_mut().unwrap() {
        link["a_mm"] = json!(link["a_mm"].as_f64().unwrap() * 1.3);
    }
    let mut robot = String::new();
    for _ in 0..60 {
        let created = app.post_json("/v1/robots", &body).await.ok(201);
        robot = format!("/v1/robots/{}", text(&created["id"]));
    }
    let csv = String::from_utf8(paper("first.csv")).unwrap();
    let refused = upload(&app, &robot, "frame=base", &csv).await;
    assert_eq!(refused.status, 422, "{}", refused.text());
    assert!(
        refused
            .text()
            .contains(&format!("measured on \\\"{own_name}")),
        "{}",
        refused.text()
    );
}

#[tokio::test]
async fn a_controllers_joint_convention_is_refused_and_accepted_on_a_robot_with_the_joint_map_of_the_refusal()
 {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let kuka: fn(&mut [f64], &mut [f64]) = |q, _| [0, 3, 5].iter().for_each(|j| q[*j] = -q[*j]);
    let plus: fn(&mut [f64], &mut [f64]) = |q, _| q[2] -= q[1];
    let minus: fn(&mut [f64], &mut [f64]) = |q, _| q[2] += q[1];
    let turned: fn(&mut [f64], &mut [f64]) = |q, _| q[1] -= 90.0;
    let none = json!([1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
    for (change, sign, coupling, offset_deg) in [
        (kuka, json!([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0]), 0.0, 0.0),
        (plus, none.clone(), 1.0, 0.0),
        (minus, none.clone(), -1.0, 0.0),
        (turned, none, 0.0, 90.0),
    ] {
        let csv = changed("first.csv", change);
        let refused = upload(&app, &robot, "frame=base", &csv).await;
        let problem = refused.problem(422, "joint_map_suspect");
        let map = &problem["errors"][0]["joint_map"];
        assert_eq!(map["sign"], sign, "{problem}");
        assert_eq!(map["coupling"][2][1], json!(coupling), "{problem}");
        assert_eq!(map["offset_deg"][1], json!(offset_deg), "{problem}");
        let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
        body["joint_map"] = map.clone();
        let created = app.post_json("/v1/robots", &body).await.ok(201);
        let robot_with_map = format!("/v1/robots/{}", text(&created["id"]));
        let set = upload(&app, &robot_with_map, "frame=base", &csv)
            .await
            .ok(201);
        assert_eq!(set["warnings"], json!([]), "{map}");
    }
}

#[tokio::test]
async fn an_upload_that_was_insisted_on_is_kept_shown_and_never_released() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let csv = by_a_tracker("first.csv");
    let other = upload(&app, &robot, "frame=base&insist=unit_suspect", &csv).await;
    other.problem(422, "frame_suspect");
    let set = upload(&app, &robot, "frame=base&insist=frame_suspect", &csv)
        .await
        .ok(201);
    assert_eq!(set["insisted_on"], "frame_suspect");
    assert!(codes(&set["warnings"]).contains(&"frame_suspect"), "{set}");
    let path = format!("/v1/measurement-sets/{}", text(&set["id"]));
    assert_eq!(app.get(&path).await.ok(200), set);
    let (job, report) = report(&app, &robot, &set).await;
    assert!(
        codes(&report["warnings"]).contains(&"insisted_upload"),
        "{report}"
    );
    let page = format!("/v1/jobs/{}/report.html", text(&job["id"]));
    assert!(
        app.get(&page)
            .await
            .text()
            .contains("the uploader insisted")
    );
    let path = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    // nothing of it reaches a controller or a later job
    let export = app.get(&format!("{path}/export?format=mastering")).await;
    assert_eq!(export.status, 422, "{}", export.text());
    let networks = app.get(&format!("{robot}/networks")).await.ok(200);
    assert_eq!(networks["items"], json!([]), "{networks}");
    let gates = app.get(&format!("{path}/gates")).await.ok(200);
    let mut gate = gates["gates"].as_array().unwrap().iter();
    let gate = gate.find(|gate| gate["gate"] == "upload_not_insisted");
    assert_eq!(gate.unwrap()["passed"], false, "{gates}");
    let release = json!({"reason": "r", "change_reason": "r"});
    let refused = app.post_json(&format!("{path}/release"), &release).await;
    let problem = refused.problem(409, "release_refused");
    assert!(
        codes(&problem["errors"]).contains(&"upload_not_insisted"),
        "{problem}"
    );
    // Insisting on a set that needs no insisting is not stored.
    let fine = upload(&app, &robot, "frame=instrument&insist=frame_suspect", &csv)
        .await
        .ok(201);
    assert!(fine["insisted_on"].is_null(), "{fine}");
}

#[tokio::test]
async fn a_session_that_was_insisted_on_supports_no_release() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let csv = by_a_tracker("followup_unchanged.csv");
    let set = upload(&app, &robot, "frame=base&insist=frame_suspect", &csv)
        .await
        .ok(201);
    let verify = json!({"kind": "verify", "measurement_set_id": set["id"], "parameter_set_id": job["parameter_set_id"]});
    assert_eq!(app.run(&robot, &verify).await["status"], "succeeded");
    let path = format!(
        "/v1/parameter-sets/{}/gates",
        text(&job["parameter_set_id"])
    );
    assert_eq!(app.get(&path).await.ok(200)["evidence"], "same_upload");
}

#[tokio::test]
async fn of_a_file_that_was_insisted_on_the_advice_is_that_of_its_refusal() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let csv = by_a_tracker("followup_unchanged.csv");
    let set = upload(&app, &robot, "frame=base&insist=frame_suspect", &csv)
        .await
        .ok(201);
    for request in [
        json!({"kind": "verify", "measurement_set_id": set["id"], "parameter_set_id": job["parameter_set_id"]}),
        json!({"kind": "verify", "measurement_set_id": set["id"]}),
        json!({"measurement_set_id": set["id"], "method": "least_squares"}),
    ] {
        let job = app.run(&robot, &request).await;
        let path = format!("/v1/jobs/{}/report", text(&job["id"]));
        let report = app.get(&path).await.ok(200);
        let misfits = ["session_does_not_fit", "joint_map_suspect", "no_fit"];
        let warnings = report["warnings"].as_array().unwrap().iter();
        let mut told = warnings.filter(|told| misfits.contains(&text(&told["code"])));
        let detail = text(&told.next().expect("a warning that it does not fit")["detail"]);
        assert!(
            detail.contains("refused as frame_suspect") && detail.contains("the frame instrument"),
            "{detail}"
        );
        assert!(
            !detail.contains("joint_map") && !detail.contains("counted otherwise"),
            "{detail}"
        );
        let page = app.get(&format!("{path}.html")).await.text();
        assert!(page.contains("the frame instrument") && !page.contains("joint map"));
    }
}

#[tokio::test]
async fn a_job_whose_points_do_not_fit_leaves_no_network() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let csv = unrelated_positions("first.csv");
    upload(&app, &robot, "frame=base", &csv)
        .await
        .problem(422, "poor_alignment");
    let set = upload(&app, &robot, "frame=base&insist=poor_alignment", &csv)
        .await
        .ok(201);
    let request = json!({"measurement_set_id": set["id"], "method": "pso", "options": {"n_particles": 20, "n_iterations": 5}});
    let job = app.run(&robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let report = app.report(&job).await;
    assert!(codes(&report["warnings"]).contains(&"no_fit"), "{report}");
    // No figure is shown for a result that does not fit.
    assert_eq!(report["tool_uncertainty_mm"], Value::Null);
    assert_eq!(report["flange_rotation_std_deg"], Value::Null);
    let why = text(&report["tool_uncertainty_absent_because"]);
    assert!(why.contains("no_fit"), "{why}");
    assert_eq!(report["evidence"], "none");
    assert!(job["network_id"].is_null(), "{job}");
    let networks = app.get(&format!("{robot}/networks")).await.ok(200);
    assert_eq!(networks["items"], json!([]));
    // The next calibration is not compared with it.
    let set = upload(&app, &robot, "frame=base", &changed("first.csv", |_, _| {})).await;
    let (_, report) = self::report(&app, &robot, &set.ok(201)).await;
    assert!(report.get("changed").is_none(), "{}", report["changed"]);
    assert!(
        !codes(&report["warnings"]).contains(&"robot_changed"),
        "{report}"
    );
}

/// Runs the binary; exit code, standard output, standard error.
pub async fn kincal(arguments: Vec<String>, environment: Vec<(&'static str, String)>) -> Printed {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    run_beside(&arguments, &environment).await
}

#[tokio::test(flavor = "multi_thread")]
async fn in_a_terminal_nothing_that_does_not_fit_is_a_success_or_invites_to_release() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, csv: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, csv).unwrap();
        path.display().to_string()
    };
    let tracker = file("tracker.csv", &by_a_tracker("first_noisy.csv"));
    let nothing = file("nothing.csv", &unrelated_positions("first.csv"));
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
    for command in [calibrate.to_vec(), submit.to_vec()] {
        let run = async |more: &[&str]| {
            let more = more.iter().map(|argument| (*argument).to_owned());
            kincal(
                command.iter().cloned().chain(more).collect(),
                environment.clone(),
            )
            .await
        };
        let (code, _, stderr) = run(&[&tracker]).await;
        assert_eq!(code, Some(2), "{stderr}");
        assert!(stderr.contains("--frame instrument"), "{stderr}");
        assert!(stderr.contains("--insist frame_suspect"), "{stderr}");
        let (code, stdout, stderr) = run(&[&tracker, "--frame", "instrument"]).await;
        assert_eq!(code, Some(0), "{stdout} {stderr}");
        let (code, stdout, stderr) = run(&[
            &nothing,
            "--insist",
            "poor_alignment",
            "--method",
            "least_squares",
        ])
        .await;
        assert_eq!(code, Some(1), "{stdout} {stderr}");
        assert!(
            stderr.contains("(no_fit)") && stderr.contains("check the file"),
            "{stderr}"
        );
        assert!(
            !stdout.contains("kincal release") && !stderr.contains("kincal release"),
            "{stdout} {stderr}"
        );
    }
}
