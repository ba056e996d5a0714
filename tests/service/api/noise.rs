//! Noise of the instrument by HTTP and command line: by axis, by range and angle, as a covariance; and bad input of each kind.

use crate::app::{Answer, TestApp, paper, text};
use crate::simulation::limited;
use crate::trackers::{Instrument, measured};
use kincal::kinematics::Robot;
use kincal::wire::robot::RobotBody;
use serde_json::{Value, json};
use std::process::Command;

/// What the simulated tracker states, as a query.
const TRACKER: &str = "&range_std_mm=0.01&angle_std_deg=0.001432394";

/// A row of a simulated set: joint values, degrees, and position, mm.
fn rows(instrument: Instrument, seed: u64) -> Vec<(Vec<f64>, [f64; 3])> {
    let body: RobotBody = serde_json::from_slice(&paper("robot.json")).unwrap();
    let nominal = limited(Robot::try_from(&body).unwrap());
    let points = measured(&nominal, instrument, 0.0, seed).set.points;
    let row = |p: kincal::measurement::Point| {
        let q_deg = p.q_rad.iter().map(|q| q.to_degrees()).collect();
        (q_deg, p.position_mm.into())
    };
    points.into_iter().map(row).collect()
}

/// The lengths and angles of links, as a list.
fn numbers(links: &Value) -> Vec<f64> {
    let links = links.as_array().unwrap().iter();
    links
        .flat_map(|link| link.as_object().unwrap().values())
        .filter_map(Value::as_f64)
        .collect()
}

/// A file with the same further cells in every row.
fn csv(rows: &[(Vec<f64>, [f64; 3])], columns: &str, cells: &str) -> String {
    let mut text = format!("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm{columns}\n");
    for (q_deg, position_mm) in rows {
        let numbers = q_deg.iter().chain(position_mm).map(f64::to_string);
        text += &(numbers.collect::<Vec<_>>().join(",") + cells + "\n");
    }
    text
}

/// A set in JSON with the same further fields at every point.
fn points(rows: &[(Vec<f64>, [f64; 3])], more: &Value) -> Value {
    let point = |(q_deg, position_mm): &(Vec<f64>, [f64; 3])| {
        let mut point = json!({"q_deg": q_deg, "position_mm": position_mm});
        for (name, value) in more.as_object().into_iter().flatten() {
            point[name] = value.clone();
        }
        point
    };
    json!({"points": rows.iter().map(point).collect::<Vec<_>>()})
}

async fn upload(app: &TestApp, robot: &str, query: &str, csv: String) -> Answer {
    let path = format!("{robot}/measurement-sets?{query}");
    app.post(&path, "text/csv", csv).await
}

/// The links that a job identifies from a set.
async fn links(app: &TestApp, robot: &str, set: &Value) -> Value {
    let job = app
        .run(robot, &json!({"measurement_set_id": set["id"]}))
        .await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let path = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    app.get(&path).await.ok(200)["links"].clone()
}

#[tokio::test]
async fn a_trackers_noise_is_stated_beside_a_file_or_in_a_body_and_shown_and_used() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let rows = rows(Instrument::Tracker, 1);
    let frame = "frame=instrument";
    let query = format!("{frame}{TRACKER}");
    let file = csv(&rows, "", "");
    let of_query = upload(&app, &robot, &query, file.clone()).await.ok(201);
    let stated = json!({"range_std_mm": 0.01, "angle_std_deg": 0.001432394});
    assert_eq!(of_query["instrument"], stated, "{of_query}");
    let path = format!("/v1/measurement-sets/{}", text(&of_query["id"]));
    assert_eq!(app.get(&path).await.ok(200)["instrument"], stated);

    let mut body = points(&rows, &json!({}));
    let path = format!("{robot}/measurement-sets?{frame}");
    body["instrument"] = stated.clone();
    let of_body = app.post_json(&path, &body).await.ok(201);
    assert_eq!(of_body["instrument"], stated);
    body.as_object_mut().unwrap().remove("instrument");
    let beside = app
        .post_json(&format!("{robot}/measurement-sets?{query}"), &body)
        .await
        .ok(201);
    assert_eq!(beside["instrument"], stated);

    let without = upload(&app, &robot, frame, file).await.ok(201);
    assert!(without["instrument"].is_null(), "{without}");
    let with = links(&app, &robot, &of_query).await;
    assert_eq!(links(&app, &robot, &of_body).await, with);
    assert_eq!(links(&app, &robot, &beside).await, with);
    assert_ne!(links(&app, &robot, &without).await, with);
}

#[tokio::test]
async fn a_level_is_stated_beside_a_file_or_in_a_body_shown_and_used() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    // a robot that is said to hang from the ceiling, and an instrument that was levelled say different things
    let mut hanging: Value = serde_json::from_slice(&crate::app::paper("robot.json")).unwrap();
    hanging["mounting"] = json!("ceiling");
    let hanging = app.post_json("/v1/robots", &hanging).await.ok(201);
    let hanging = format!("/v1/robots/{}", text(&hanging["id"]));
    let rows = rows(Instrument::Tracker, 1);
    let query = "frame=instrument&instrument_levelled=true";
    let of_query = upload(&app, &robot, query, csv(&rows, "", ""))
        .await
        .ok(201);
    assert_eq!(of_query["instrument"], json!({"levelled": true}));
    let mut body = points(&rows, &json!({}));
    body["instrument"] = json!({"levelled": true});
    let path = format!("{hanging}/measurement-sets?frame=instrument");
    let of_body = app.post_json(&path, &body).await.ok(201);
    assert_eq!(of_body["instrument"], json!({"levelled": true}));
    let warned = async |robot: &str, set: &Value| {
        let job = app
            .run(robot, &json!({"measurement_set_id": set["id"]}))
            .await;
        let path = format!("/v1/jobs/{}/report", text(&job["id"]));
        let report = app.get(&path).await.ok(200);
        let page = app.get(&format!("{path}.html")).await.text();
        assert!(
            page.contains("levelled: gravity is −z of its frame"),
            "{page}"
        );
        let warnings = report["warnings"].as_array().unwrap().clone();
        warnings.iter().any(|told| {
            told["code"] == "mounting_contradicted"
                && text(&told["detail"]).contains("by the level")
        })
    };
    // the simulated base lies askew in the tracker's frame: that a mounting is stated makes the difference
    assert!(!warned(&robot, &of_query).await);
    assert!(warned(&hanging, &of_body).await);
}

#[tokio::test]
async fn noise_along_the_axes_and_as_a_covariance_count_alike() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let rows = rows(Instrument::Camera, 2);
    let frame = "frame=instrument";
    let file = csv(&rows, ",std_x_mm,std_y_mm,std_z_mm", ",0.02,0.2,0.02");
    let by_axis = upload(&app, &robot, frame, file).await.ok(201);
    let path = format!("{robot}/measurement-sets?{frame}");
    let axes = points(&rows, &json!({"std_axes_mm": [0.02, 0.2, 0.02]}));
    let in_json = app.post_json(&path, &axes).await.ok(201);
    let covariance = [[0.0004, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.0004]];
    let covariance = points(&rows, &json!({ "covariance_mm2": covariance }));
    let as_covariance = app.post_json(&path, &covariance).await.ok(201);
    let plain = upload(&app, &robot, frame, csv(&rows, "", ""))
        .await
        .ok(201);
    let expected = links(&app, &robot, &by_axis).await;
    assert_eq!(links(&app, &robot, &in_json).await, expected);
    let near = numbers(&links(&app, &robot, &as_covariance).await);
    for (a, b) in near.iter().zip(numbers(&expected)) {
        // the same rows in another order
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }
    assert_ne!(links(&app, &robot, &plain).await, expected);
}

#[tokio::test]
async fn bad_noise_is_refused_with_its_place_and_a_hint() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let rows = rows(Instrument::Tracker, 3);
    let of_query = [
        (
            "range_std_mm=-0.01&angle_std_deg=0.001",
            "out_of_range",
            "range_std_mm",
        ),
        (
            "range_std_mm=0&angle_std_deg=0.001",
            "out_of_range",
            "range_std_mm",
        ),
        (
            "range_std_mm=NaN&angle_std_deg=0.001",
            "out_of_range",
            "range_std_mm",
        ),
        (
            "range_std_mm=0.01&angle_std_deg=0",
            "out_of_range",
            "angle_std_deg",
        ),
        (
            "range_std_mm=0.01&angle_std_deg=-1",
            "out_of_range",
            "angle_std_deg",
        ),
        (
            "range_std_mm=0.01&angle_std_deg=0.001&range_std_mm_per_m=-1",
            "out_of_range",
            "range_std_mm_per_m",
        ),
        (
            "angle_std_deg=0.001",
            "incomplete_instrument",
            "range_std_mm",
        ),
        (
            "range_std_mm=0.01",
            "incomplete_instrument",
            "angle_std_deg",
        ),
    ];
    for (query, code, column) in of_query {
        let query = format!("frame=instrument&{query}");
        let refused = upload(&app, &robot, &query, csv(&rows, "", "")).await;
        let refused = refused.problem(422, "invalid_instrument");
        let issue = &refused["errors"][0];
        assert_eq!(issue["code"], code, "{query}: {refused}");
        assert_eq!(issue["column"], column, "{query}");
    }
    for level in [
        "frame=base&instrument_levelled=true",
        "instrument_levelled=true",
    ] {
        let query = format!("{level}&insist=frame_suspect");
        let refused = upload(&app, &robot, &query, csv(&rows, "", "")).await;
        let refused = refused.problem(422, "invalid_instrument");
        assert_eq!(refused["errors"][0]["code"], "instrument_in_base_frame");
        assert_eq!(refused["errors"][0]["column"], "instrument_levelled");
    }
    let query = format!("frame=base&insist=frame_suspect{TRACKER}");
    let refused = upload(&app, &robot, &query, csv(&rows, "", "")).await;
    let refused = refused.problem(422, "invalid_instrument");
    let issue = &refused["errors"][0];
    assert_eq!(issue["code"], "instrument_in_base_frame", "{refused}");
    assert!(text(&issue["detail"]).contains("the frame instrument"));

    let of_file = [
        (
            ",std_x_mm,std_y_mm",
            ",0.1,0.1",
            "incomplete_std",
            "std_z_mm",
        ),
        (
            ",std_mm,std_x_mm,std_y_mm,std_z_mm",
            ",0.1,0.1,0.1,0.1",
            "duplicate_column",
            "std_x_mm",
        ),
        (
            ",std_x_mm,std_y_mm,std_z_mm",
            ",0.1,-0.1,0.1",
            "out_of_range",
            "std_y_mm",
        ),
        (
            ",std_x_mm,std_y_mm,std_z_mm",
            ",0,0.1,0.1",
            "out_of_range",
            "std_x_mm",
        ),
    ];
    for (columns, cells, code, column) in of_file {
        let file = csv(&rows, columns, cells);
        let refused = upload(&app, &robot, "frame=instrument", file).await;
        let refused = refused.problem(422, "invalid_measurements");
        let issue = &refused["errors"][0];
        assert_eq!(issue["code"], code, "{columns} {cells}: {refused}");
        assert_eq!(issue["column"], column, "{columns} {cells}");
    }
    let file = csv(&rows, ",std_x_mm,std_y_mm,std_z_mm", ",0.1,nan,0.1");
    let refused = upload(&app, &robot, "frame=instrument", file).await;
    let refused = refused.problem(422, "invalid_measurements");
    assert_eq!(refused["errors"][0]["column"], "std_y_mm", "{refused}");

    // an instrument beside points that state their own
    let query = format!("frame=instrument{TRACKER}");
    let file = csv(&rows, ",std_mm", ",0.1");
    let refused = upload(&app, &robot, &query, file).await;
    let refused = refused.problem(422, "invalid_instrument");
    let issue = &refused["errors"][0];
    assert_eq!(issue["code"], "noise_stated_twice", "{refused}");
    assert_eq!(issue["column"], "std_mm");
}

#[tokio::test]
async fn bad_noise_in_json_is_refused_with_its_pointer() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let rows = rows(Instrument::Tracker, 3);
    let path = format!("{robot}/measurement-sets?frame=instrument");
    let of_points = [
        (
            json!({"std_axes_mm": [0.1, 0.0, 0.1]}),
            "out_of_range",
            "/points/0/std_axes_mm/1",
        ),
        (
            json!({"covariance_mm2": [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}),
            "not_a_covariance",
            "/points/0/covariance_mm2",
        ),
        (
            json!({"std_mm": 0.1, "std_axes_mm": [0.1, 0.1, 0.1]}),
            "noise_stated_twice",
            "/points/0/std_axes_mm",
        ),
    ];
    for (more, code, pointer) in of_points {
        let refused = app.post_json(&path, &points(&rows, &more)).await;
        let refused = refused.problem(422, "invalid_measurements");
        let issue = &refused["errors"][0];
        assert_eq!(issue["code"], code, "{more}: {refused}");
        assert_eq!(issue["pointer"], pointer, "{more}");
    }
    let mut mixed = points(&rows, &json!({"std_axes_mm": [0.1, 0.2, 0.1]}));
    mixed["points"][4]
        .as_object_mut()
        .unwrap()
        .remove("std_axes_mm");
    let refused = app.post_json(&path, &mixed).await;
    let refused = refused.problem(422, "invalid_measurements");
    assert_eq!(refused["errors"][0]["pointer"], "/points/4/std_axes_mm");

    let mut body = points(&rows, &json!({}));
    body["instrument"] = json!({"angle_std_deg": 0.001});
    let refused = app.post_json(&path, &body).await;
    let refused = refused.problem(422, "invalid_instrument");
    let issue = &refused["errors"][0];
    assert_eq!(issue["code"], "incomplete_instrument", "{refused}");
    assert_eq!(issue["pointer"], "/instrument/range_std_mm");
    let twice = app.post_json(&format!("{path}{TRACKER}"), &body).await;
    twice.problem(422, "noise_stated_twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_states_an_instrument_offline_and_to_a_server() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("tracker.csv");
    std::fs::write(&file, csv(&rows(Instrument::Tracker, 5), "", "")).unwrap();
    let robot_file = format!("{}/data/paper/robot.json", env!("CARGO_MANIFEST_DIR"));
    let url = app.server.url();
    let id = robot.rsplit('/').next().unwrap().to_owned();
    let run = async |arguments: Vec<String>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
        command.args(arguments).env("KINCAL_SERVER", &url);
        let output = tokio::task::spawn_blocking(move || command.output().unwrap());
        output.await.unwrap()
    };
    let of = |command: &[&str], more: &[&str]| -> Vec<String> {
        let file = file.to_str().unwrap();
        let common = [file, "--frame", "instrument", "--json"];
        let all = command.iter().chain(&common).chain(more);
        all.map(|argument| (*argument).to_owned()).collect()
    };
    let noise = ["--range-std-mm", "0.01", "--angle-std-deg", "0.001432394"];
    let calibrate = ["calibrate", robot_file.as_str()];
    let with = run(of(&calibrate, &noise)).await;
    let without = run(of(&calibrate, &[])).await;
    assert!(with.status.success() && without.status.success());
    let sha = |output: &std::process::Output| {
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        report["parameters"].clone()
    };
    assert_ne!(sha(&with), sha(&without));
    let half = run(of(&calibrate, &noise[2..])).await;
    let message = String::from_utf8_lossy(&half.stderr).into_owned();
    assert_eq!(half.status.code(), Some(2), "{message}");
    assert!(message.contains("range_std_mm is missing"), "{message}");

    let submit = ["submit", "--robot", id.as_str(), "--wait"];
    let submitted = run(of(&submit, &noise)).await;
    let message = String::from_utf8_lossy(&submitted.stderr).into_owned();
    assert!(submitted.status.success(), "{message}");
    assert_eq!(sha(&submitted), sha(&with), "offline and by the server");
    let sets = app.get(&format!("{robot}/measurement-sets")).await.ok(200);
    assert_eq!(
        sets["items"][0]["instrument"]["range_std_mm"], 0.01,
        "{sets}"
    );
}
