//! Quick checks through the interface: whether the released set still holds, and what that does to the robot.

use crate::api::sessions::{
    codes, csv, failed_gates, identified_from_noisy_points, rows, set_policy, upload, with_noise,
};
use crate::app::{TestApp, text};
use crate::engines::for_each_engine;
use crate::simulation::Normal;
use kincal::config::ServeConfig;
use kincal::store::verify::{Options, verify};
use kincal::store::{Store, StoreLocation};
use serde_json::{Value, json};

/// As coarse as what first_noisy.csv was measured with (0.061 mm rms of three coordinates, held out), mm. A coarser instrument that does not say so
/// looks like a change.
const NOISE_MM: f64 = 0.03;

async fn released(app: &TestApp) -> (String, Value) {
    let (robot, set) = identified_from_noisy_points(app).await;
    let path = format!("/v1/parameter-sets/{}/release", text(&set));
    app.post_json(&path, &json!({"reason": "it fits"}))
        .await
        .ok(200);
    (robot, set)
}

/// The job of a check, and its report.
async fn checked(app: &TestApp, robot: &str, set: &str, more: Value) -> (Value, Value) {
    let mut request = json!({"kind": "check", "measurement_set_id": set});
    for (field, value) in more.as_object().unwrap() {
        request[field] = value.clone();
    }
    let job = app.run(robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    (job, app.get(&path).await.ok(200))
}

/// Every so many rows of a file, with noise.
fn some(name: &str, n: usize, random: &mut Normal) -> Vec<[f64; 9]> {
    let all = rows(name);
    let some: Vec<_> = all.iter().copied().step_by(all.len() / n).take(n).collect();
    with_noise(&some, NOISE_MM, random)
}

async fn play(app: &TestApp) {
    let mut random = Normal::new(81);
    let (robot, parameter_set) = released(app).await;
    let fresh = upload(
        app,
        &robot,
        &some("followup_unchanged.csv", 10, &mut random),
    )
    .await;
    let (job, report) = checked(app, &robot, &fresh, json!({})).await;
    let check = &report["check"];
    assert_eq!(check["verdict"], "holds", "{check}");
    assert_eq!(job["parameter_set_from"], parameter_set);
    assert!(
        job["parameter_set_id"].is_null() && job["network_id"].is_null(),
        "{job}"
    );
    let detectable = check["detectable"].as_array().unwrap();
    assert_eq!(detectable.len(), 6 + 1 + 1, "{check}");
    // the paper's reflector is on the last axis: turning joint 6 does not move it
    assert!(detectable[5]["change"].is_null(), "{check}");
    let seen = detectable
        .iter()
        .filter(|row| row["name"] != "theta_offset_6");
    for row in seen {
        assert!(
            row["change"].as_f64().unwrap() > 0.0 && row["tool_mm"].as_f64().unwrap() > 0.0,
            "{row}"
        );
    }
    assert_eq!(check["test"]["n_combinations"], 30);
    assert!(check["verified_rms_mm"].as_f64().unwrap() > 0.0);
    let state = |robot: &Value| text(&robot["state"]).to_owned();
    assert_eq!(state(&app.get(&robot).await.ok(200)), "ok");
    let (_, evidence) = failed_gates(app, &parameter_set).await;
    assert_eq!(
        evidence, "same_upload",
        "a check is no evidence for a release"
    );
    // the same points again, and a copy of another upload, were not measured since
    app.run(
        &robot,
        &json!({"kind": "verify", "measurement_set_id": fresh, "parameter_set_id": parameter_set}),
    )
    .await;
    let (_, report) = checked(app, &robot, &fresh, json!({"after": "collision"})).await;
    let check = &report["check"];
    assert_eq!(check["verdict"], "cannot_tell", "{check}");
    assert!(
        text(&check["reason"]).contains("repeat an earlier upload")
            && text(&check["next"]).contains("measure 10 poses now"),
        "{check}"
    );

    // A joint that moved by 0.008° is far too little for a session that does not fit, and nothing else stops releases.
    let mut slight = with_noise(
        &rows("followup_unchanged.csv")[3..23],
        NOISE_MM,
        &mut random,
    );
    slight.iter_mut().for_each(|row| row[2] += 0.008);
    let slight = upload(app, &robot, &slight).await;
    let (_, report) = checked(app, &robot, &slight, json!({})).await;
    assert_eq!(report["check"]["verdict"], "changed", "{}", report["check"]);
    assert_eq!(codes(&report), ["check_changed"]);
    assert_eq!(state(&app.get(&robot).await.ok(200)), "check_robot");
    // the same points are no later session by being scored, and they do fit
    let verify =
        json!({"kind": "verify", "measurement_set_id": slight, "parameter_set_id": parameter_set});
    let job = app.run(&robot, &verify).await;
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    let report = app.get(&path).await.ok(200);
    assert_eq!(codes(&report), [""; 0]);
    let (failed, _) = failed_gates(app, &parameter_set).await;
    assert!(failed.contains(&"check_robot".to_owned()), "{failed:?}");

    let collided = upload(
        app,
        &robot,
        &some("followup_collision.csv", 10, &mut random),
    )
    .await;
    let (job, report) = checked(app, &robot, &collided, json!({"after": "collision"})).await;
    let check = &report["check"];
    assert_eq!(check["verdict"], "changed", "{check}");
    assert_eq!(check["after"], "collision");
    assert!(
        !check["likeliest"].as_array().unwrap().is_empty(),
        "{check}"
    );
    assert!(text(&check["next"]).contains("poses"), "{check}");
    assert_eq!(report["evidence"], "none");
    assert_eq!(codes(&report)[0], "check_changed");
    let now = app.get(&robot).await.ok(200);
    assert_eq!(
        (state(&now).as_str(), &now["check_job_id"]),
        ("check_robot", &job["id"])
    );
    let path = format!("/v1/parameter-sets/{}/release", text(&parameter_set));
    let again = app.post_json(&path, &json!({"reason": "once more"})).await;
    assert_ne!(again.status, 200, "{}", again.text());

    // the same points are no later session by being scored again, and a reason alone does not bring the set back
    app.run(
        &robot,
        &json!({"kind": "verify", "measurement_set_id": collided, "parameter_set_id": parameter_set}),
    )
    .await;
    let (failed, _) = failed_gates(app, &parameter_set).await;
    assert!(failed.contains(&"check_robot".to_owned()), "{failed:?}");

    // the list of jobs knows the kind
    let listed = app.get(&format!("{robot}/jobs?kind=check")).await.ok(200);
    assert_eq!(listed["total"], 4, "{listed}");
    assert!(
        listed["items"]
            .as_array()
            .unwrap()
            .iter()
            .all(|job| job["kind"] == "check")
    );
}

#[tokio::test]
async fn a_check_says_whether_the_released_set_holds_and_a_change_stops_releases() {
    play(&TestApp::with_workers(1).await).await;
}

#[test]
fn a_check_is_the_same_on_both_engines_and_the_store_verifies() {
    for_each_engine(async |database| {
        // the embedded database has one server at a time, and the test's own store is open on its own
        let own = tempfile::tempdir().unwrap();
        let location = match &database.location {
            StoreLocation::Sqlite { .. } => StoreLocation::Sqlite {
                data_dir: own.path().join("data"),
            },
            shared @ StoreLocation::Postgres { .. } => shared.clone(),
        };
        let mut config = ServeConfig::loopback(own.path().join("data"), 1);
        if let StoreLocation::Postgres { url } = &location {
            config.database.database_url = Some(url.clone());
        }
        let app = TestApp::with_config(config).await;
        play(&app).await;
        app.server.shutdown().await;
        let store = Store::open_for_command(location).await.unwrap();
        for check in verify(&store, &Options::default()).await.unwrap() {
            assert_eq!(check.violations, [""; 0], "{}", check.id);
        }
        store.close().await;
    });
}

#[tokio::test]
async fn what_cannot_be_checked_is_refused_when_it_is_posted() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(82);
    let (robot, parameter_set) = identified_from_noisy_points(&app).await;
    let set = upload(
        &app,
        &robot,
        &some("followup_unchanged.csv", 10, &mut random),
    )
    .await;
    let post = async |request: Value| app.post_json(&format!("{robot}/jobs"), &request).await;
    let request = json!({"kind": "check", "measurement_set_id": set});
    let problem = post(request).await.problem(409, "no_active_parameter_set");
    assert!(
        text(&problem["detail"]).contains("release one"),
        "{problem}"
    );
    let four = upload(
        &app,
        &robot,
        &some("followup_unchanged.csv", 4, &mut random),
    )
    .await;
    let request =
        json!({"kind": "check", "measurement_set_id": four, "parameter_set_id": parameter_set});
    let problem = post(request).await.problem(422, "under_determined");
    let detail = text(&problem["detail"]);
    assert!(
        detail.contains("at least 5") && detail.contains("has 4"),
        "{detail}"
    );
    for (field, value) in [
        ("verify", json!({"source": "subset"})),
        ("parameters", json!({"hold": ["a_1"]})),
        ("network_id", json!("net_1")),
    ] {
        let mut request =
            json!({"kind": "check", "measurement_set_id": set, "parameter_set_id": parameter_set});
        request[field] = value;
        let problem = post(request).await.problem(422, "invalid_job");
        assert_eq!(problem["errors"][0]["code"], "not_applicable", "{problem}");
    }
    let request = json!({"kind": "verify", "measurement_set_id": set, "after": "motor"});
    let problem = post(request).await.problem(422, "invalid_job");
    assert_eq!(problem["errors"][0]["pointer"], "/after", "{problem}");
}

/// The gate's text has figure, interval, tolerance and rule; a figure whose uncertainty reaches beyond the tolerance is accepted by the simple rule
/// alone.
#[tokio::test]
async fn the_tolerance_counts_the_uncertainty_unless_the_policy_says_otherwise() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = identified_from_noisy_points(&app).await;
    let path = format!("/v1/parameter-sets/{}", text(&set));
    let gate = async || -> Value {
        let found = app.get(&format!("{path}/gates")).await.ok(200);
        let gates = found["gates"].as_array().unwrap().clone();
        let name = "verify_errors_within_tolerance";
        gates.into_iter().find(|gate| gate["gate"] == name).unwrap()
    };
    set_policy(&app, &robot, json!({"tolerance_mm": 10.0})).await;
    let policy = app.get(&format!("{robot}/policy")).await.ok(200);
    assert_eq!(policy["decision_rule"], "guarded_acceptance", "the default");
    let wide = gate().await;
    assert_eq!(wide["passed"], true, "{wide}");
    let detail = text(&wide["detail"]).to_owned();
    let number = |after: &str| -> f64 {
        let (_, rest) = detail
            .split_once(after)
            .unwrap_or_else(|| panic!("{detail}"));
        rest.split(' ').next().unwrap().parse().unwrap()
    };
    let (figure, expanded) = (number("held out: "), number("± "));
    assert!(expanded > 0.02 * figure && expanded < figure, "{detail}");
    assert!(
        detail.contains("tolerance is 10 mm") && detail.contains("guarded acceptance"),
        "{detail}"
    );
    // a tolerance between figure and figure + interval
    let between = figure + 0.5 * expanded;
    set_policy(&app, &robot, json!({"tolerance_mm": between})).await;
    let guarded = gate().await;
    assert_eq!(guarded["passed"], false, "{guarded}");
    assert!(text(&guarded["detail"]).contains("guard band"), "{guarded}");
    let release = app
        .post_json(&format!("{path}/release"), &json!({"reason": "it fits"}))
        .await;
    release.problem(409, "release_refused");
    let simple = json!({"tolerance_mm": between, "decision_rule": "simple_acceptance"});
    set_policy(&app, &robot, simple).await;
    let simple = gate().await;
    assert_eq!(simple["passed"], true, "{simple}");
    assert!(
        text(&simple["detail"]).contains("simple acceptance"),
        "{simple}"
    );
}

#[tokio::test]
async fn poses_of_a_coarse_instrument_cannot_tell() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(82);
    let (robot, _) = released(&app).await;
    let points = csv(&some("followup_unchanged.csv", 10, &mut random));
    let coarse: String = points
        .lines()
        .enumerate()
        .map(|(i, line)| format!("{line},{}\n", if i == 0 { "std_mm" } else { "2" }))
        .collect();
    let path = format!("{robot}/measurement-sets?frame=base");
    let set = app.post(&path, "text/csv", coarse).await.ok(201);
    let (_, report) = checked(&app, &robot, text(&set["id"]), json!({})).await;
    assert_eq!(report["check"]["verdict"], "cannot_tell", "{report}");
}
