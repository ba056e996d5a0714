//! Sessions as evidence about a parameter set and about the robot.

use crate::app::{Answer, TestApp, paper, text};
use crate::simulation::Normal;
use rand::RngExt;
use reqwest::Method;
use serde_json::{Value, json};
use std::f64::consts::TAU;

/// Placements of a tracker that are tried.
const N_PLACEMENTS: usize = 24;
/// Poses of each placement: as many as a factory measures.
const N_POSES: usize = 40;
const HEADER: &str = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n";

pub type Row = [f64; 9];

/// Joints in degrees and positions in mm of a set of the paper's robot.
pub fn rows(name: &str) -> Vec<Row> {
    let file = String::from_utf8(paper(name)).unwrap();
    let numbers = |line: &str| {
        let cells = line.split(',').skip(2);
        let cells: Vec<f64> = cells.map(|cell| cell.parse().unwrap()).collect();
        cells.try_into().unwrap()
    };
    file.lines().skip(1).map(numbers).collect()
}

pub fn csv(rows: &[Row]) -> String {
    let lines = rows.iter().map(|row| {
        let (q, p) = row.split_at(6);
        let q: Vec<String> = q.iter().map(|q| format!("{q:.4}")).collect();
        let p: Vec<String> = p.iter().map(|p| format!("{p:.3}")).collect();
        format!("{},{}\n", q.join(","), p.join(","))
    });
    HEADER.to_owned() + &lines.collect::<String>()
}

/// Normal noise on every coordinate.
pub fn with_noise(rows: &[Row], std_mm: f64, random: &mut Normal) -> Vec<Row> {
    let mut rows = rows.to_vec();
    for p in rows.iter_mut().flat_map(|row| &mut row[6..]) {
        *p += std_mm * random.draw();
    }
    rows
}

/// Positions in the frame of a levelled tracker that stands somewhere in the cell.
pub fn seen_by_a_tracker(rows: &[Row], random: &mut Normal) -> Vec<Row> {
    let mut share = || random.0.random::<f64>();
    let (sin, cos) = (TAU * share()).sin_cos();
    let shift: [f64; 3] = std::array::from_fn(|_| 3000.0 * (share() - 0.5));
    let seen = |row: &Row| {
        let [.., x, y, z] = *row;
        let mut row = *row;
        row[6] = cos * x - sin * y + shift[0];
        row[7] = sin * x + cos * y + shift[1];
        row[8] = z + shift[2];
        row
    };
    rows.iter().map(seen).collect()
}

/// Uploads a set; insists if it is refused as suspect.
pub async fn upload(app: &TestApp, robot: &str, rows: &[Row]) -> String {
    let path = format!("{robot}/measurement-sets?frame=base");
    let first = app.post(&path, "text/csv", csv(rows)).await.json();
    let set = match first["status"].as_u64() {
        Some(422) => {
            let insisting = format!("{path}&insist={}", text(&first["code"]));
            app.post(&insisting, "text/csv", csv(rows)).await.ok(201)
        }
        _ => first,
    };
    text(&set["id"]).to_owned()
}

/// Scores a parameter set on a set: the job and its report.
pub async fn scored(
    app: &TestApp,
    robot: &str,
    set: &str,
    parameter_set: &Value,
) -> (String, Value) {
    let verify =
        json!({"kind": "verify", "measurement_set_id": set, "parameter_set_id": parameter_set});
    let job = app.run(robot, &verify).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let id = text(&job["id"]).to_owned();
    let report = app.get(&format!("/v1/jobs/{id}/report")).await.ok(200);
    (id, report)
}

pub async fn set_policy(app: &TestApp, robot: &str, policy: Value) {
    let put = app
        .request(Method::PUT, &format!("{robot}/policy"))
        .header("content-type", "application/json")
        .body(policy.to_string());
    Answer::of(put).await.ok(200);
}

pub fn codes(report: &Value) -> Vec<&str> {
    let warnings = report["warnings"].as_array().unwrap();
    warnings.iter().map(|w| text(&w["code"])).collect()
}

/// The gates that a release would fail now, and the strength of the evidence.
pub async fn failed_gates(app: &TestApp, parameter_set: &Value) -> (Vec<String>, String) {
    let path = format!("/v1/parameter-sets/{}/gates", text(parameter_set));
    let answer = app.get(&path).await.ok(200);
    let gates = answer["gates"].as_array().unwrap().iter();
    let failed = gates.filter(|gate| gate["passed"] == false);
    let failed = failed.map(|gate| text(&gate["gate"]).to_owned()).collect();
    (failed, text(&answer["evidence"]).to_owned())
}

pub async fn identified_from_noisy_points(app: &TestApp) -> (String, Value) {
    let (robot, set) = app.robot_with_set("first_noisy.csv").await;
    let request = json!({"measurement_set_id": set, "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    (robot, job["parameter_set_id"].clone())
}

#[tokio::test]
async fn a_session_that_does_not_fit_is_no_evidence() {
    let app = TestApp::with_workers(1).await;
    let (robot, parameter_set) = identified_from_noisy_points(&app).await;
    set_policy(&app, &robot, json!({"independent_session_required": true})).await;
    let mut random = Normal::new(20);
    let fresh = &rows("followup_unchanged.csv")[..N_POSES];
    let release = format!("/v1/parameter-sets/{}/release", text(&parameter_set));
    for placement in 0..N_PLACEMENTS {
        let points = with_noise(fresh, 0.03, &mut random);
        let set = upload(&app, &robot, &seen_by_a_tracker(&points, &mut random)).await;
        let (job, report) = scored(&app, &robot, &set, &parameter_set).await;
        assert!(
            codes(&report).contains(&"session_does_not_fit")
                && !codes(&report).contains(&"no_better_than_nominal"),
            "placement {placement}: {:?}",
            report["warnings"]
        );
        assert_eq!(report["evidence"], "none");
        assert!(text(&report["method_reason"]).contains("this file does not fit this robot"));
        let (failed, evidence) = failed_gates(&app, &parameter_set).await;
        assert_eq!(
            (failed, evidence.as_str()),
            (
                vec![
                    "check_robot".into(),
                    "sessions_fit".into(),
                    "evidence".into()
                ],
                "same_upload"
            )
        );
        let now = app.get(&robot).await.ok(200);
        assert_eq!(
            (&now["state"], &now["check_job_id"]),
            (&json!("check_robot"), &json!(job))
        );
    }
    // Every release is refused, whatever the set.
    app.post_json(&release, &json!({"reason": "it fits"}))
        .await
        .problem(409, "release_refused");
    // No set is condemned: a session that fits ends the state and is evidence.
    let set = upload(&app, &robot, &with_noise(fresh, 0.03, &mut random)).await;
    let (_, report) = scored(&app, &robot, &set, &parameter_set).await;
    assert_eq!(codes(&report), [""; 0]);
    assert_eq!(app.get(&robot).await.ok(200)["state"], "ok");
    assert_eq!(
        failed_gates(&app, &parameter_set).await,
        (vec![], "independent_session".into())
    );
    app.post_json(&release, &json!({"reason": "it fits"}))
        .await
        .ok(200);
}

#[tokio::test]
async fn a_session_that_scatters_more_than_the_set_could_miss_is_no_evidence() {
    let app = TestApp::with_workers(1).await;
    let (robot, parameter_set) = identified_from_noisy_points(&app).await;
    set_policy(&app, &robot, json!({"independent_session_required": true})).await;
    let mut random = Normal::new(21);
    let fresh = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
    let whole_degrees = fresh.iter().map(|row| {
        let mut row = *row;
        row[..6].iter_mut().for_each(|q| *q = q.round());
        row
    });
    let files = [
        ("joints in whole degrees", whole_degrees.collect()),
        ("noise of 1.5 mm", with_noise(&fresh, 1.5, &mut random)),
        ("noise of 5 mm", with_noise(&fresh, 5.0, &mut random)),
    ];
    for (name, file) in files {
        let set = upload(&app, &robot, &file).await;
        let (_, report) = scored(&app, &robot, &set, &parameter_set).await;
        let answer = codes(&report);
        assert!(
            answer.contains(&"session_does_not_fit"),
            "{name}: {answer:?}"
        );
        let (failed, evidence) = failed_gates(&app, &parameter_set).await;
        assert_eq!(evidence, "same_upload", "{name}");
        let condemned = "sessions_better_than_nominal".to_owned();
        assert!(failed.contains(&"check_robot".into()) && !failed.contains(&condemned));
    }
    // A correct session afterwards: the set is releasable again.
    let set = upload(&app, &robot, &fresh).await;
    scored(&app, &robot, &set, &parameter_set).await;
    let (failed, evidence) = failed_gates(&app, &parameter_set).await;
    assert_eq!(
        (failed.len(), evidence.as_str()),
        (0, "independent_session"),
        "{failed:?}"
    );
}

#[tokio::test]
async fn a_robot_under_check_is_released_with_a_reason() {
    let app = TestApp::with_workers(1).await;
    let (robot, parameter_set) = identified_from_noisy_points(&app).await;
    // The robot after a collision.
    let mut random = Normal::new(21);
    let collided = with_noise(&rows("followup_collision.csv"), 0.03, &mut random);
    let set = upload(&app, &robot, &collided).await;
    let (_, report) = scored(&app, &robot, &set, &parameter_set).await;
    assert!(
        codes(&report).contains(&"session_does_not_fit"),
        "{:?}",
        report["warnings"]
    );
    // An earlier session that is uploaded again with noise does not end the state; nor do the fitted points.
    let again = upload(&app, &robot, &rows("first_noisy.csv")).await;
    scored(&app, &robot, &again, &parameter_set).await;
    assert_eq!(app.get(&robot).await.ok(200)["state"], "check_robot");
    let rollback = format!("{robot}/parameter-sets/rollback");
    app.post_json(&rollback, &json!({"reason": "scrap"}))
        .await
        .problem(409, "nothing_to_roll_back_to");
    let checked = format!("{robot}/checked");
    app.post_json(&checked, &json!({"reason": ""}))
        .await
        .problem(422, "invalid_reason");
    let why = json!({"reason": "that file is of the robot beside it"});
    let well = app.post_json(&checked, &why).await.ok(200);
    assert_eq!(
        (&well["state"], &well["checked"]["reason"]),
        (&json!("ok"), &why["reason"])
    );
    assert_eq!(
        failed_gates(&app, &parameter_set).await,
        (vec![], "same_upload".into())
    );
}

#[tokio::test]
async fn every_session_counts_and_a_copy_with_noise_is_no_other_session() {
    let app = TestApp::with_workers(1).await;
    let (robot, parameter_set) = identified_from_noisy_points(&app).await;
    let policy = json!({"tolerance_mm": 0.3, "independent_session_required": true});
    set_policy(&app, &robot, policy).await;
    let mut random = Normal::new(22);
    // Copies of the identified upload, with noise of any size, support nothing.
    let first = rows("first_noisy.csv");
    for std_mm in [0.005, 0.02, 0.05, 0.1] {
        let copy = upload(&app, &robot, &with_noise(&first, std_mm, &mut random)).await;
        let (_, report) = scored(&app, &robot, &copy, &parameter_set).await;
        assert_eq!(report["evidence"], "same_upload", "{std_mm} mm");
        let (failed, evidence) = failed_gates(&app, &parameter_set).await;
        assert_eq!(
            (failed, evidence.as_str()),
            (vec!["evidence".into()], "same_upload"),
            "{std_mm} mm"
        );
    }
    // A correct session in which the set is 0.4 mm off, measured while the clock was two days behind.
    let mut off = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
    off.iter_mut()
        .enumerate()
        .for_each(|(i, row)| row[6] += if i % 2 == 0 { 0.4 } else { -0.4 });
    let off = upload(&app, &robot, &off).await;
    let (job, report) = scored(&app, &robot, &off, &parameter_set).await;
    assert_eq!(report["evidence"], "independent_session");
    sqlx::query("update job set created_at_ms = created_at_ms - 172800000 where id = $1")
        .bind(&job)
        .execute(app.server.store.readers())
        .await
        .unwrap();
    // Nine good sessions after it, each from another upload, do not outweigh it.
    for left_out in 0..9 {
        let mut good = rows("followup_unchanged.csv");
        good.remove(left_out);
        let good = upload(&app, &robot, &with_noise(&good, 0.02, &mut random)).await;
        scored(&app, &robot, &good, &parameter_set).await;
    }
    let (failed, _) = failed_gates(&app, &parameter_set).await;
    assert_eq!(failed, ["verify_errors_within_tolerance"]);
    // The schema keeps it, too.
    let sql = "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[{\"passed\":true}]', release_n_passed = 1, release_n_failed = 0,
        release_evidence = 'independent_session', release_uncertainty_mm = 0.01 where id = $1";
    let error = sqlx::query(sql)
        .bind(text(&parameter_set))
        .execute(app.server.store.readers())
        .await
        .unwrap_err();
    assert!(error.to_string().contains("policy"), "{error}");
}

#[tokio::test]
async fn a_rollback_goes_to_what_was_superseded_whatever_the_clock_said() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.identified().await;
    let mut sets = vec![first["parameter_set_id"].clone()];
    for seed in [1, 2] {
        let request = json!({"measurement_set_id": first["measurement_set_id"], "method": "least_squares", "seed": seed});
        sets.push(app.run(&robot, &request).await["parameter_set_id"].clone());
    }
    for (at, set) in sets.iter().enumerate() {
        let path = format!("/v1/parameter-sets/{}/release", text(set));
        app.post_json(&path, &json!({"reason": "better"}))
            .await
            .ok(200);
        if at == 0 {
            // The clock was 30 days ahead and is corrected.
            sqlx::query("update parameter_set set released_at_ms = released_at_ms + 2592000000 where id = $1")
                .bind(text(set))
                .execute(app.server.store.readers())
                .await
                .unwrap();
        }
    }
    let rollback = format!("{robot}/parameter-sets/rollback");
    for back_to in [1, 0] {
        let active = app
            .post_json(&rollback, &json!({"reason": "scrap"}))
            .await
            .ok(200);
        assert_eq!(active["id"], sets[back_to]);
    }
}

/// A collision is often seen first by an identification of the new session. Sets from before it were not scored on that session, and are off by what
/// it found.
#[tokio::test]
async fn a_set_is_released_only_after_it_was_scored_on_later_sessions_of_other_sets() {
    let app = TestApp::with_workers(1).await;
    let (robot, before) = identified_from_noisy_points(&app).await;
    let mut random = Normal::new(31);
    let after = with_noise(&rows("followup_collision.csv"), 0.03, &mut random);
    let collision = upload(&app, &robot, &after).await;
    let request = json!({"measurement_set_id": collision, "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    let report = format!("/v1/jobs/{}/report", text(&job["id"]));
    let report = app.get(&report).await.ok(200);
    assert!(codes(&report).contains(&"robot_changed"), "{report}");
    let set = format!("/v1/parameter-sets/{}", text(&before));
    let reason = json!({"reason": "it was verified"});
    let (failed, _) = failed_gates(&app, &before).await;
    assert_eq!(failed, ["scored_on_later_sessions"]);
    let refused = app.post_json(&format!("{set}/release"), &reason).await;
    refused.problem(409, "release_refused");
    // once it was scored there, the session itself decides: the set does not fit it
    scored(&app, &robot, &collision, &before).await;
    let (failed, _) = failed_gates(&app, &before).await;
    assert!(!failed.contains(&"scored_on_later_sessions".to_owned()));
    assert!(!failed.is_empty(), "the collision passes unseen");
    let refused = app.post_json(&format!("{set}/release"), &reason).await;
    refused.problem(409, "release_refused");
}

/// As above, of a rollback: the new set was released, and the one that it superseded would come back.
#[tokio::test]
async fn a_rollback_to_a_set_from_before_a_collision_is_refused() {
    let app = TestApp::with_workers(1).await;
    let (robot, before) = identified_from_noisy_points(&app).await;
    let release = |set: &Value| format!("/v1/parameter-sets/{}/release", text(set));
    let reason = json!({"reason": "it was verified", "change_reason": "after the collision"});
    app.post_json(&release(&before), &reason).await.ok(200);
    let mut random = Normal::new(32);
    let after = with_noise(&rows("followup_collision.csv"), 0.03, &mut random);
    let collision = upload(&app, &robot, &after).await;
    let request = json!({"measurement_set_id": collision, "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    app.post_json(&release(&job["parameter_set_id"]), &reason)
        .await
        .ok(200);
    let path = format!("{robot}/parameter-sets/rollback");
    let back = app.post_json(&path, &json!({"reason": "back"})).await;
    let refused = back.problem(409, "release_refused");
    let failed: Vec<&str> = refused["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|error| text(&error["code"]))
        .collect();
    assert!(failed.contains(&"scored_on_later_sessions"), "{refused}");
}
