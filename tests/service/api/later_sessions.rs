//! Sessions count for every set whose points are older, whatever jobs ran in between; and a set is compared with the active one on points that neither
//! was fitted to.

use crate::api::sessions::{
    Row, codes, csv, failed_gates, rows, scored, seen_by_a_tracker, set_policy, upload, with_noise,
};
use crate::app::{TestApp, text};
use crate::simulation::Normal;
use serde_json::{Value, json};

/// The parameter set of a job that identifies a measurement set.
async fn identified(app: &TestApp, robot: &str, set: &str) -> Value {
    let request = json!({"measurement_set_id": set, "method": "least_squares"});
    let job = app.run(robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    job["parameter_set_id"].clone()
}

async fn release(app: &TestApp, set: &Value) {
    let path = format!("/v1/parameter-sets/{}/release", text(set));
    let reasons = json!({"reason": "looked at", "change_reason": "looked at"});
    app.post_json(&path, &reasons).await.ok(200);
}

async fn withdraw(app: &TestApp, set: &Value) {
    let path = format!("/v1/parameter-sets/{}/withdraw", text(set));
    let reason = json!({"reason": "it drilled the fixture"});
    app.post_json(&path, &reason).await.ok(200);
}

async fn fails(app: &TestApp, set: &Value, gate: &str) -> bool {
    let (failed, _) = failed_gates(app, set).await;
    failed.contains(&gate.to_owned())
}

#[tokio::test]
async fn an_old_upload_that_is_identified_again_is_as_old_as_it_was() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let before = app.upload(&robot, "first_noisy.csv").await;
    release(&app, &identified(&app, &robot, &before).await).await;
    let after = app.upload(&robot, "followup_collision.csv").await;
    let right = identified(&app, &robot, &after).await;
    release(&app, &right).await;
    // the upload from before the collision, once more: another set, of the robot as it was
    let old = identified(&app, &robot, &before).await;
    assert!(fails(&app, &old, "scored_on_later_sessions").await);
    let path = format!("/v1/parameter-sets/{}/release", text(&old));
    let reasons = json!({"reason": "looked at", "change_reason": "looked at"});
    app.post_json(&path, &reasons)
        .await
        .problem(409, "release_refused");
    // nor do the same bytes get younger by being uploaded again
    let copied = app.upload(&robot, "first_noisy.csv").await;
    assert_ne!(copied, before);
    let copied = identified(&app, &robot, &copied).await;
    assert!(fails(&app, &copied, "scored_on_later_sessions").await);
    // and it is no later session for the right one
    assert!(!fails(&app, &right, "scored_on_later_sessions").await);
}

#[tokio::test]
async fn the_same_upload_identified_again_meets_the_same_sessions_and_the_same_withdrawal() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(31);
    set_policy(&app, &robot, json!({"tolerance_mm": 0.3})).await;
    let own = app.upload(&robot, "first_noisy.csv").await;
    let set = identified(&app, &robot, &own).await;
    // a session that misses the set by more than the tolerance
    let coarse = with_noise(&rows("followup_unchanged.csv"), 0.25, &mut random);
    let session = upload(&app, &robot, &coarse).await;
    scored(&app, &robot, &session, &set).await;
    assert!(fails(&app, &set, "verify_errors_within_tolerance").await);
    let again = identified(&app, &robot, &own).await;
    assert!(fails(&app, &again, "scored_on_later_sessions").await);
    scored(&app, &robot, &session, &again).await;
    assert!(fails(&app, &again, "verify_errors_within_tolerance").await);
    // a withdrawal is of what the set says, not of its id alone
    let path = format!("/v1/parameter-sets/{}/withdraw", text(&again));
    app.post_json(&path, &json!({"reason": "it drilled the fixture"}))
        .await
        .ok(200);
    let third = identified(&app, &robot, &own).await;
    assert!(fails(&app, &third, "source_withdrawn").await);
}

#[tokio::test]
async fn a_later_session_that_differs_or_fits_no_robot_stands_against_an_older_set() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(35);
    let before = with_noise(&rows("first.csv"), 0.03, &mut random);
    let before = upload(&app, &robot, &before).await;
    let set = identified(&app, &robot, &before).await;
    assert!(!fails(&app, &set, "scored_on_later_sessions").await);
    // joint 3 by 1° after a collision: both sessions together are not one robot
    let turned_by = |deg: f64, random: &mut Normal| {
        let mut turned = with_noise(&rows("followup_unchanged.csv"), 0.03, random);
        turned.iter_mut().for_each(|row| row[2] += deg);
        turned
    };
    let after = upload(&app, &robot, &turned_by(1.0, &mut random)).await;
    let request = json!({"measurement_set_ids": [before, after], "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    assert_eq!(job["status"], "failed", "{job}");
    assert_eq!(job["error"]["code"], "sessions_differ", "{job}");
    assert!(fails(&app, &set, "scored_on_later_sessions").await);
    let path = format!("/v1/parameter-sets/{}/release", text(&set));
    let reasons = json!({"reason": "looked at", "change_reason": "looked at"});
    app.post_json(&path, &reasons)
        .await
        .problem(409, "release_refused");
    scored(&app, &robot, &after, &set).await;
    assert!(fails(&app, &set, "check_robot").await);
    // a motor that was exchanged and not mastered: nothing fits
    let other = app.paper_robot().await;
    let own = app.upload(&other, "first_noisy.csv").await;
    let set = identified(&app, &other, &own).await;
    let after = upload(&app, &other, &turned_by(100.0, &mut random)).await;
    let request = json!({"measurement_set_id": after, "method": "least_squares"});
    let job = app.run(&other, &request).await;
    let report = app
        .get(&format!("/v1/jobs/{}/report", text(&job["id"])))
        .await
        .ok(200);
    let told = codes(&report);
    let fits = !told.contains(&"no_fit") && !told.contains(&"joint_map_suspect");
    assert!(!fits, "{told:?}");
    assert!(fails(&app, &set, "scored_on_later_sessions").await);
}

#[tokio::test]
async fn sessions_that_are_explained_do_not_hide_a_later_one() {
    let app = TestApp::with_workers(2).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(36);
    let before = with_noise(&rows("first.csv"), 0.03, &mut random);
    let before = upload(&app, &robot, &before).await;
    let set = identified(&app, &robot, &before).await;
    for deg in [1.0, 2.0] {
        for _ in 0..12 {
            let mut turned = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
            turned.iter_mut().for_each(|row| row[2] += deg);
            let after = upload(&app, &robot, &turned).await;
            let request =
                json!({"measurement_set_ids": [before, after], "method": "least_squares"});
            assert_eq!(app.run(&robot, &request).await["status"], "failed");
        }
    }
    assert!(fails(&app, &set, "scored_on_later_sessions").await);
    let reason = json!({"reason": "a gripper was mounted during these measurements"});
    app.post_json(&format!("{robot}/checked"), &reason)
        .await
        .ok(200);
    assert!(!fails(&app, &set, "scored_on_later_sessions").await);
    let later = with_noise(&rows("followup_collision.csv"), 0.03, &mut random);
    let later = upload(&app, &robot, &later).await;
    identified(&app, &robot, &later).await;
    assert!(fails(&app, &set, "scored_on_later_sessions").await);
}

#[tokio::test]
async fn a_copy_of_an_old_upload_is_as_old_as_the_original() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(34);
    let original = with_noise(&rows("first.csv"), 0.03, &mut random);
    let before = upload(&app, &robot, &original).await;
    release(&app, &identified(&app, &robot, &before).await).await;
    let since = with_noise(&rows("followup_collision.csv"), 0.03, &mut random);
    let (some, others) = since.split_at(since.len() / 2);
    let after = upload(&app, &robot, some).await;
    release(&app, &identified(&app, &robot, &after).await).await;
    // the old file again, with a little noise: another set of bytes, and no new measurement
    let copy = with_noise(&original, 0.02, &mut random);
    upload(&app, &robot, &copy).await;
    // and a copy of the copy
    let copy = upload(&app, &robot, &copy).await;
    let old = identified(&app, &robot, &copy).await;
    assert!(fails(&app, &old, "scored_on_later_sessions").await);
    // or moved to where another tracker would see it
    let moved = csv(&seen_by_a_tracker(&original, &mut random));
    let path = format!("{robot}/measurement-sets?frame=instrument");
    let moved = app.post(&path, "text/csv", moved).await.ok(201);
    let old = identified(&app, &robot, text(&moved["id"])).await;
    assert!(fails(&app, &old, "scored_on_later_sessions").await);
    // a new measurement of the robot as it is has nothing to answer for
    let after = upload(&app, &robot, others).await;
    let set = identified(&app, &robot, &after).await;
    assert!(!fails(&app, &set, "scored_on_later_sessions").await);
}

/// Two parameter sets of the same points, by different seeds.
async fn with_two_seeds(app: &TestApp) -> [Value; 2] {
    let robot = app.paper_robot().await;
    let own = app.upload(&robot, "first_noisy.csv").await;
    let mut sets = [Value::Null, Value::Null];
    for (seed, set) in sets.iter_mut().enumerate() {
        let request = json!({"measurement_set_id": own, "method": "pso", "seed": seed});
        let job = app.run(&robot, &request).await;
        assert_eq!(job["status"], "succeeded", "{job}");
        *set = job["parameter_set_id"].clone();
    }
    sets
}

#[tokio::test]
async fn a_withdrawn_set_does_not_return_with_another_seed() {
    let app = TestApp::with_workers(1).await;
    let [withdrawn, other] = with_two_seeds(&app).await;
    withdraw(&app, &withdrawn).await;
    assert!(fails(&app, &other, "source_withdrawn").await);
    // The gate is about other sets.
    assert!(!fails(&app, &withdrawn, "source_withdrawn").await);
}

#[tokio::test]
async fn a_withdrawn_set_does_not_return_as_a_set_that_was_active_before_it() {
    let app = TestApp::with_workers(1).await;
    let [before, withdrawn] = with_two_seeds(&app).await;
    release(&app, &before).await;
    release(&app, &withdrawn).await;
    assert!(!fails(&app, &before, "source_withdrawn").await);
    withdraw(&app, &withdrawn).await;
    assert!(fails(&app, &before, "source_withdrawn").await);
}

#[tokio::test]
async fn a_rollback_may_return_to_the_values_of_the_set_that_it_withdraws() {
    let app = TestApp::with_workers(1).await;
    let [before, withdrawn] = with_two_seeds(&app).await;
    release(&app, &before).await;
    release(&app, &withdrawn).await;
    let set = app
        .get(&format!("/v1/parameter-sets/{}", text(&withdrawn)))
        .await
        .ok(200);
    let path = format!(
        "/v1/robots/{}/parameter-sets/rollback",
        text(&set["robot_id"])
    );
    let reason = json!({"reason": "it drilled the fixture"});
    app.post_json(&path, &reason).await.ok(200);
    // Releasing the active set again changes nothing.
    assert!(!fails(&app, &before, "source_withdrawn").await);
    release(&app, &before).await;
}

#[tokio::test]
async fn a_withdrawn_set_does_not_return_with_other_options_or_by_the_sessions_that_it_passed() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(37);
    let own = app.upload(&robot, "first_noisy.csv").await;
    let withdrawn = identified(&app, &robot, &own).await;
    let fresh = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
    let (known, unknown) = fresh.split_at(fresh.len() / 2);
    let known = upload(&app, &robot, known).await;
    scored(&app, &robot, &known, &withdrawn).await;
    withdraw(&app, &withdrawn).await;
    let request = json!({"measurement_set_id": own, "options": {"loss": "huber"}});
    let job = app.run(&robot, &request).await;
    let again = job["parameter_set_id"].clone();
    assert!(fails(&app, &again, "source_withdrawn").await, "{job}");
    scored(&app, &robot, &known, &again).await;
    assert!(fails(&app, &again, "source_withdrawn").await);
    let unknown = upload(&app, &robot, unknown).await;
    scored(&app, &robot, &unknown, &again).await;
    assert!(!fails(&app, &again, "source_withdrawn").await);
    // whoever corrects with the withdrawn set is told
    let path = format!("/v1/parameter-sets/{}/predict", text(&withdrawn));
    let pose = json!({"q_deg": [[0, 0, 0, 0, 0, 0]]});
    let told = app.post_json(&path, &pose).await.ok(200);
    assert!(codes(&told).contains(&"set_withdrawn"), "{told}");
    // and no controller gets it
    let path = format!("/v1/parameter-sets/{}", text(&withdrawn));
    for format in ["json", "csv", "urdf"] {
        app.get(&format!("{path}/export?format={format}"))
            .await
            .problem(409, "parameter_set_withdrawn");
    }
    app.get(&path).await.ok(200);
}

#[tokio::test]
async fn an_old_file_that_is_uploaded_late_is_not_verified_by_old_sessions() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(38);
    set_policy(&app, &robot, json!({"independent_session_required": true})).await;
    let mut before = with_noise(&rows("first.csv"), 0.03, &mut random);
    let late = before.split_off(before.len() / 2);
    let own = upload(&app, &robot, &before).await;
    let first = identified(&app, &robot, &own).await;
    let fresh = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
    let session = upload(&app, &robot, &fresh).await;
    scored(&app, &robot, &session, &first).await;
    release(&app, &first).await;
    // after a collision another set is released, verified on a session of its own
    let since = with_noise(&rows("followup_collision.csv"), 0.03, &mut random);
    let (points, verify) = since.split_at(since.len() / 2);
    let points = upload(&app, &robot, points).await;
    let right = identified(&app, &robot, &points).await;
    let verify = upload(&app, &robot, verify).await;
    scored(&app, &robot, &verify, &right).await;
    release(&app, &right).await;
    // a file from before the collision, which nobody has uploaded yet
    let late = upload(&app, &robot, &late).await;
    let wrong = identified(&app, &robot, &late).await;
    scored(&app, &robot, &session, &wrong).await;
    assert!(fails(&app, &wrong, "evidence").await);
    // the session shows nothing of how the robot is now
    let path = format!("/v1/parameter-sets/{}/gates", text(&wrong));
    let gates = app.get(&path).await.ok(200);
    let gates = gates["gates"].as_array().unwrap().iter();
    let evidence = gates.clone().find(|gate| gate["gate"] == "evidence");
    let detail = text(&evidence.unwrap()["detail"]);
    assert!(
        detail.contains("does not show the robot as it is now"),
        "{detail}"
    );
}

#[tokio::test]
async fn a_session_of_few_points_needs_no_stated_uncertainty() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(35);
    let policy = json!({"tolerance_mm": 0.3, "decision_rule": "guarded_acceptance"});
    set_policy(&app, &robot, policy).await;
    let own = app.upload(&robot, "first_noisy.csv").await;
    let set = identified(&app, &robot, &own).await;
    assert!(!fails(&app, &set, "verify_errors_within_tolerance").await);
    let four = &rows("followup_unchanged.csv")[..4];
    let good = upload(&app, &robot, &with_noise(four, 0.03, &mut random)).await;
    let (_, report) = scored(&app, &robot, &good, &set).await;
    assert_eq!(report["evidence"], "none", "{report}");
    assert!(!fails(&app, &set, "verify_errors_within_tolerance").await);
    release(&app, &set).await;
    // their errors themselves still count
    let bad = upload(&app, &robot, &with_noise(four, 0.4, &mut random)).await;
    scored(&app, &robot, &bad, &set).await;
    assert!(fails(&app, &set, "verify_errors_within_tolerance").await);
}

/// A fifth of the poses, with noise.
fn few(name: &str, std_mm: f64, random: &mut Normal) -> Vec<Row> {
    let some: Vec<Row> = rows(name).into_iter().step_by(3).collect();
    with_noise(&some, std_mm, random)
}

#[tokio::test]
async fn a_set_is_compared_with_the_active_one_on_points_that_neither_was_fitted_to() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(32);
    let fine = upload(
        &app,
        &robot,
        &with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random),
    )
    .await;
    let good = identified(&app, &robot, &fine).await;
    release(&app, &good).await;
    // few coarse points: worse than the active set, also after it was scored on its own points
    let coarse = upload(&app, &robot, &few("first.csv", 0.4, &mut random)).await;
    let worse = identified(&app, &robot, &coarse).await;
    assert!(fails(&app, &worse, "improved_on_active").await);
    scored(&app, &robot, &coarse, &worse).await;
    assert!(fails(&app, &worse, "improved_on_active").await);
}

#[tokio::test]
async fn points_that_the_active_set_was_fitted_to_say_nothing_against_a_better_one() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(33);
    let first = upload(
        &app,
        &robot,
        &few("followup_unchanged.csv", 0.05, &mut random),
    )
    .await;
    let active = identified(&app, &robot, &first).await;
    release(&app, &active).await;
    let many = with_noise(&rows("first.csv"), 0.02, &mut random);
    let many = upload(&app, &robot, &many).await;
    let better = identified(&app, &robot, &many).await;
    assert!(!fails(&app, &better, "improved_on_active").await);
    scored(&app, &robot, &first, &better).await;
    assert!(!fails(&app, &better, "improved_on_active").await);
}

#[tokio::test]
async fn a_session_that_shows_little_condemns_no_set() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let own = app.upload(&robot, "first_noisy.csv").await;
    let set = identified(&app, &robot, &own).await;
    // joint 1 alone, in the instrument's frame: base and reflector take up whatever is measured
    let one = rows("followup_unchanged.csv")[0];
    let sweep: Vec<Row> = (0..11)
        .map(|step| {
            let turn = 10.0 * f64::from(step);
            let (sin, cos) = turn.to_radians().sin_cos();
            let mut row = one;
            row[0] += turn;
            (row[6], row[7]) = (
                cos * one[6] - sin * one[7] + 400.0,
                sin * one[6] + cos * one[7],
            );
            row
        })
        .collect();
    let mut random = Normal::new(36);
    let path = format!("{robot}/measurement-sets?frame=instrument");
    let mut n_worse = 0;
    for _ in 0..8 {
        let swept = csv(&with_noise(&sweep, 0.05, &mut random));
        let swept = app.post(&path, "text/csv", swept).await.ok(201);
        let (_, report) = scored(&app, &robot, text(&swept["id"]), &set).await;
        assert_eq!(report["evidence"], "none", "{report}");
        assert!(!codes(&report).contains(&"no_better_than_nominal"));
        let rms_mm = |which: &str| report["verify"][which]["rms_mm"].as_f64().unwrap();
        n_worse += usize::from(rms_mm("after") >= rms_mm("before"));
    }
    // by chance, the nominal robot is better in some of them
    assert!(n_worse > 0);
    assert!(!fails(&app, &set, "sessions_better_than_nominal").await);
}

#[tokio::test]
async fn of_the_nominal_robot_no_evidence_is_stated() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let set = app.upload(&robot, "followup_unchanged.csv").await;
    let job = app
        .run(
            &robot,
            &json!({"kind": "verify", "measurement_set_id": set}),
        )
        .await;
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    assert_eq!(app.get(&path).await.ok(200)["evidence"], "none");
}
