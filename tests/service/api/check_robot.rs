//! The state `check_robot`: what a session that does not fit blocks, for how long, and what ends it.

use crate::api::sessions::{
    Row, codes, failed_gates, identified_from_noisy_points, rows, scored, seen_by_a_tracker,
    upload, with_noise,
};
use crate::app::{Answer, TestApp, text};
use crate::simulation::Normal;
use serde_json::{Value, json};

/// Texts without readable characters.
const BLANKS: [&str; 7] = [
    " \t\n ",
    "\u{a0}\u{2003}",
    "\u{200b}\u{2060}\u{feff}",
    "\u{ad}\u{34f}",
    "\u{2800}",
    "\u{3164}\u{115f}\u{1160}\u{ffa0}",
    "– …",
];

/// Every other row of one of the paper's files, unchanged.
fn half(name: &str, which: usize, random: &mut Normal) -> Vec<Row> {
    let half: Vec<Row> = rows(name).into_iter().skip(which).step_by(2).collect();
    with_noise(&half, 0.03, random)
}

async fn identified(app: &TestApp, robot: &str, set: &str, verify: Option<&str>) -> Value {
    let mut request = json!({"measurement_set_id": set, "method": "least_squares"});
    if let Some(id) = verify {
        request["verify"] = json!({"source": "set", "measurement_set_id": id});
    }
    let job = app.run(robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    job
}

async fn release(app: &TestApp, set: &Value) -> Answer {
    let path = format!("/v1/parameter-sets/{}/release", text(set));
    let body = json!({"reason": "it fits", "change_reason": "the collision"});
    app.post_json(&path, &body).await
}

async fn state(app: &TestApp, robot: &str) -> (String, Value) {
    let robot = app.get(robot).await.ok(200);
    (
        text(&robot["state"]).to_owned(),
        robot["check_job_id"].clone(),
    )
}

#[tokio::test]
async fn a_set_to_verify_on_that_does_not_fit_asks_for_a_look_at_the_robot() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(23);
    let fresh = rows("followup_unchanged.csv");
    let collided = half("followup_collision.csv", 0, &mut random);
    let misplaced = seen_by_a_tracker(&fresh[..40], &mut random);
    for (name, wrong) in [("a collision", collided), ("another frame", misplaced)] {
        let (robot, set) = app.robot_with_set("first_noisy.csv").await;
        let wrong = upload(&app, &robot, &wrong).await;
        let job = identified(&app, &robot, &set, Some(&wrong)).await;
        let report = app.report(&job).await;
        assert!(
            codes(&report).contains(&"session_does_not_fit"),
            "{name}: {:?}",
            report["warnings"]
        );
        assert_eq!(report["evidence"], "none", "{name}");
        assert_eq!(
            state(&app, &robot).await,
            ("check_robot".into(), job["id"].clone()),
            "{name}"
        );
        let parameter_set = &job["parameter_set_id"];
        release(&app, parameter_set)
            .await
            .problem(409, "release_refused");
        // The session is no evidence about the set: a session that fits ends the state.
        let good = upload(&app, &robot, &with_noise(&fresh, 0.03, &mut random)).await;
        scored(&app, &robot, &good, parameter_set).await;
        assert_eq!(state(&app, &robot).await.0, "ok", "{name}");
        let (failed, evidence) = failed_gates(&app, parameter_set).await;
        assert_eq!(evidence, "independent_session", "{name}");
        let insisted = failed == ["upload_not_insisted"];
        assert!(failed.is_empty() || insisted, "{name}: {failed:?}");
    }
}

#[tokio::test]
async fn a_misplaced_file_scored_on_the_nominal_robot_is_no_evidence() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(24);
    let points = with_noise(&rows("first.csv")[..40], 0.03, &mut random);
    for n_points in [40, 6] {
        let robot = app.paper_robot().await;
        let misplaced = seen_by_a_tracker(&points[..n_points], &mut random);
        let set = upload(&app, &robot, &misplaced).await;
        let (job, report) = scored(&app, &robot, &set, &Value::Null).await;
        assert_eq!(report["evidence"], "none", "{n_points}: {report}");
        assert_eq!(
            state(&app, &robot).await,
            ("check_robot".into(), json!(job)),
            "{n_points}"
        );
        // A correct session says nothing against the robot.
        let robot = app.paper_robot().await;
        let set = upload(&app, &robot, &points[..n_points]).await;
        scored(&app, &robot, &set, &Value::Null).await;
        assert_eq!(state(&app, &robot).await.0, "ok", "{n_points}");
    }
}

#[tokio::test]
async fn a_set_from_before_a_collision_takes_a_session_since_or_somebody_who_says_why() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = identified_from_noisy_points(&app).await;
    let old_upload = app.upload(&robot, "first_noisy.csv").await;
    let second = identified(&app, &robot, &old_upload, None).await;
    let second = &second["parameter_set_id"];
    release(&app, &first).await.ok(200);
    release(&app, second).await.ok(200);
    // The robot collides. A session of the first set shows it; a set that is identified afterwards ends the state.
    let mut random = Normal::new(25);
    let collided = upload(
        &app,
        &robot,
        &half("followup_collision.csv", 0, &mut random),
    )
    .await;
    scored(&app, &robot, &collided, &first).await;
    assert_eq!(state(&app, &robot).await.0, "check_robot");
    let new = identified(&app, &robot, &collided, None).await;
    let new = &new["parameter_set_id"];
    let again = upload(
        &app,
        &robot,
        &half("followup_collision.csv", 1, &mut random),
    )
    .await;
    scored(&app, &robot, &again, new).await;
    assert_eq!(state(&app, &robot).await.0, "ok");

    // The second set was never scored on points measured since. A set that is identified now from the old upload counts as old, too.
    let of_old_points = identified(&app, &robot, &old_upload, None).await;
    for old in [second, &of_old_points["parameter_set_id"]] {
        let (failed, _) = failed_gates(&app, old).await;
        assert!(
            failed.contains(&"measured_since_check".into()),
            "{failed:?}"
        );
    }
    release(&app, new).await.ok(200);
    let refused = release(&app, second).await.problem(409, "release_refused");
    assert!(codes_of(&refused).contains(&"measured_since_check".into()));
    let rollback = format!("{robot}/parameter-sets/rollback");
    let why = json!({"reason": "scrap"});
    let refused = app.post_json(&rollback, &why).await;
    let refused = refused.problem(409, "release_refused");
    assert_eq!(
        codes_of(&refused),
        ["measured_since_check", "scored_on_later_sessions"],
        "{refused}"
    );
    let detail = text(&refused["errors"][0]["detail"]);
    assert!(
        detail.contains("verify this set") && detail.contains("mark the robot as checked"),
        "{detail}"
    );
    assert_eq!(
        app.get(&format!("{robot}/parameter-sets/active"))
            .await
            .ok(200)["id"],
        *new
    );
    // The schema refuses it, too.
    let sql = "update parameter_set set status = 'released', released_at_ms = 1, release_n_passed = 1, release_n_failed = 0 where id = $1";
    let withdraw = format!("/v1/parameter-sets/{}/withdraw", text(new));
    app.post_json(&withdraw, &why).await.ok(200);
    let error = sqlx::query(sql)
        .bind(text(second))
        .execute(app.server.store.readers())
        .await
        .unwrap_err();
    assert!(error.to_string().contains("session"), "{error}");
    // A set that is identified from points measured since needs no further session.
    let newer = identified(&app, &robot, &again, None).await;
    let (failed, _) = failed_gates(&app, &newer["parameter_set_id"]).await;
    assert_eq!(failed, [""; 0]);
    // The emergency exit: somebody vouches for the set.
    let why = json!({"reason": "the arm was put back as it was before"});
    app.post_json(&format!("{robot}/checked"), &why)
        .await
        .ok(200);
    let (failed, _) = failed_gates(&app, second).await;
    assert_eq!(failed, [""; 0]);
}

fn codes_of(problem: &Value) -> Vec<String> {
    let errors = problem["errors"].as_array().unwrap();
    let codes = errors.iter().map(|error| text(&error["code"]).to_owned());
    codes.collect()
}

#[tokio::test]
async fn a_session_that_the_set_missed_by_far_stays_until_somebody_says_why() {
    let app = TestApp::with_workers(1).await;
    let (robot, parameter_set) = identified_from_noisy_points(&app).await;
    let mut random = Normal::new(26);
    let fresh = rows("followup_unchanged.csv");
    let mut shifted = with_noise(&fresh, 0.03, &mut random);
    shifted.iter_mut().for_each(|row| row[6] += 1.0);
    let set = upload(&app, &robot, &shifted).await;
    let (_, report) = scored(&app, &robot, &set, &parameter_set).await;
    assert!(codes(&report).contains(&"set_far_off"), "{report}");
    let mut newest = String::new();
    // A later good session does not cancel this one.
    for left_out in 0..2 {
        let mut good = fresh.clone();
        good.remove(left_out);
        let good = upload(&app, &robot, &with_noise(&good, 0.03, &mut random)).await;
        newest = scored(&app, &robot, &good, &parameter_set).await.0;
        let (failed, _) = failed_gates(&app, &parameter_set).await;
        assert_eq!(failed, ["sessions_fit"]);
    }
    let why = json!({"reason": "the tripod was kicked in that session"});
    app.post_json(&format!("{robot}/checked"), &why)
        .await
        .ok(200);
    assert_eq!(
        failed_gates(&app, &parameter_set).await,
        (vec![], "independent_session".into())
    );
    // The printed report of the identification has all three sessions.
    let set = app
        .get(&format!("/v1/parameter-sets/{}", text(&parameter_set)))
        .await
        .ok(200);
    let page = format!("/v1/jobs/{}/report.html", text(&set["job_id"]));
    let page = app.get(&page).await.text();
    assert!(page.contains("Verified on other sessions"));
    assert!(page.contains("the set is far off"));
    assert_eq!(
        page.matches("the set holds: independent session").count(),
        2
    );
    // Its evidence is that of the newest of them, no longer that of its own upload.
    assert!(!page.contains("a wrong tool, base or scale would not show"));
    let newest = format!("(job {newest})");
    let evidence = page.split("<dt>Evidence</dt>").nth(1).unwrap();
    let evidence = evidence.split("</dd>").next().unwrap();
    assert!(
        evidence.contains("independent session") && evidence.contains(&newest),
        "{evidence}"
    );
}

#[tokio::test]
async fn a_base_that_is_off_in_the_base_frame_is_not_verified_away_for_the_complete_model() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(27);
    let points = with_noise(&rows("first.csv"), 0.03, &mut random);
    let set = upload(&app, &robot, &points).await;
    let request =
        json!({"measurement_set_id": set, "model": "complete", "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    let parameter_set = &job["parameter_set_id"];
    let fresh = rows("followup_unchanged.csv");
    for (shift_mm, expected, expected_state) in [
        (0.0, "independent_session", "ok"),
        (5.0, "none", "check_robot"),
        (40.0, "none", "check_robot"),
    ] {
        let mut session = with_noise(&fresh, 0.02, &mut random);
        session.iter_mut().for_each(|row| row[6] += shift_mm);
        let session = upload(&app, &robot, &session).await;
        let (_, report) = scored(&app, &robot, &session, parameter_set).await;
        let after_mm = report["verify"]["after"]["rms_mm"].as_f64().unwrap();
        assert!(
            (after_mm - shift_mm).abs() < 0.5,
            "{shift_mm}: {}",
            report["verify"]
        );
        let (is_evidence, told) = (report["evidence"] == expected, codes(&report));
        assert!(
            is_evidence || told.contains(&"set_far_off"),
            "{shift_mm}: {told:?} {}",
            report["evidence"]
        );
        assert_eq!(state(&app, &robot).await.0, expected_state, "{shift_mm}");
    }
    let (failed, _) = failed_gates(&app, parameter_set).await;
    assert!(failed.contains(&"check_robot".to_owned()), "{failed:?}");
}

#[tokio::test]
async fn poses_that_lie_close_together_end_no_check_and_support_no_release() {
    let app = TestApp::with_workers(1).await;
    let (robot, parameter_set) = identified_from_noisy_points(&app).await;
    let mut random = Normal::new(28);
    let collided = half("followup_collision.csv", 0, &mut random);
    let set = upload(&app, &robot, &collided).await;
    scored(&app, &robot, &set, &parameter_set).await;
    assert_eq!(state(&app, &robot).await.0, "check_robot");
    // One pose, nudged: the placement of an instrument takes up whatever has changed.
    let near: Vec<Row> = (0..12)
        .map(|i| {
            let mut row = rows("followup_unchanged.csv")[3];
            row[i % 6] += 0.02 * f64::from(i32::try_from(i).unwrap());
            row
        })
        .collect();
    let near = upload(&app, &robot, &with_noise(&near, 0.03, &mut random)).await;
    let (_, report) = scored(&app, &robot, &near, &parameter_set).await;
    let told = codes(&report);
    assert!(
        told.contains(&"session_shows_little") && report["evidence"] == "none",
        "{told:?} {}",
        report["evidence"]
    );
    assert_eq!(state(&app, &robot).await.0, "check_robot");
}

#[tokio::test]
async fn a_change_that_less_than_doubles_the_nominal_error_stops_every_release_until_it_is_explained()
 {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = identified_from_noisy_points(&app).await;
    let mut random = Normal::new(29);
    let set = upload(
        &app,
        &robot,
        &with_noise(&rows("first.csv"), 0.03, &mut random),
    )
    .await;
    let second = identified(&app, &robot, &set, None).await["parameter_set_id"].clone();
    let fresh = rows("followup_unchanged.csv");
    // Everything 1.2 mm off: far for both sets, and no more than the nominal robot is off by.
    let mut changed = with_noise(&fresh, 0.03, &mut random);
    changed.iter_mut().for_each(|row| row[8] += 1.2);
    let changed = upload(&app, &robot, &changed).await;
    scored(&app, &robot, &changed, &first).await;
    assert_eq!(state(&app, &robot).await.0, "check_robot");
    for set in [&first, &second] {
        release(&app, set).await.problem(409, "release_refused");
    }
    // Repaired: a session in which the first set holds again, and a reason.
    let good = upload(&app, &robot, &with_noise(&fresh, 0.03, &mut random)).await;
    scored(&app, &robot, &good, &first).await;
    assert_eq!(state(&app, &robot).await.0, "ok");
    let why = json!({"reason": "the base was loose in that session and is bolted again"});
    app.post_json(&format!("{robot}/checked"), &why)
        .await
        .ok(200);
    let (failed, _) = failed_gates(&app, &first).await;
    assert!(failed.is_empty(), "{failed:?}");
}

#[tokio::test]
async fn a_reason_in_which_there_is_nothing_to_read_is_none() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    for blank in BLANKS {
        let nothing = json!({"reason": blank});
        let change = json!({"reason": "it fits", "change_reason": blank});
        for (path, body) in [
            (format!("{robot}/checked"), &nothing),
            (format!("{robot}/parameter-sets/rollback"), &nothing),
            (format!("{set}/release"), &nothing),
            (format!("{set}/release"), &change),
            (format!("{set}/withdraw"), &nothing),
        ] {
            let refused = app.post_json(&path, body).await;
            let problem = refused.problem(422, "invalid_reason");
            assert_eq!(problem["errors"][0]["code"], "blank", "{path} {blank:?}");
        }
    }
    let why = json!({"reason": "оператор 7 überprüfte ロボット"});
    app.post_json(&format!("{set}/release"), &why).await.ok(200);
}
