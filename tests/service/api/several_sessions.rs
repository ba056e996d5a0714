//! One job of several sessions: what it answers, what it refuses, and that no gate counts a session that was fitted.

use crate::app::{Answer, TestApp, paper, text};
use serde_json::{Value, json};
use std::process::Command;

/// Uploads bytes with this query. Returns the set's id.
async fn upload(app: &TestApp, robot: &str, query: &str, bytes: Vec<u8>) -> String {
    let path = format!("{robot}/measurement-sets?{query}");
    let answer = app.post(&path, "text/csv", bytes).await.ok(201);
    text(&answer["id"]).to_owned()
}

/// The halves of a file, each with its header: two sessions of other poses.
fn halves(name: &str) -> [Vec<u8>; 2] {
    let text = String::from_utf8(paper(name)).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    let rows: Vec<&str> = rows.lines().collect();
    let half = |rows: &[&str]| format!("{header}\n{}\n", rows.join("\n")).into_bytes();
    let (first, second) = rows.split_at(rows.len() / 2);
    [half(first), half(second)]
}

/// A robot with three sessions in its base frame, all of one state.
async fn robot_with_sessions(app: &TestApp) -> (String, [String; 3]) {
    let (robot, first) = app.robot_with_set("first.csv").await;
    let [second, third] = halves("followup_unchanged.csv");
    let second = upload(app, &robot, "frame=base", second).await;
    let third = upload(app, &robot, "frame=base", third).await;
    (robot, [first, second, third])
}

/// A job of these sessions; halves of a file have no subset of their own, so a fraction is held out.
fn pooled(ids: &[&str]) -> Value {
    json!({"measurement_set_ids": ids, "method": "least_squares", "corrections": "off",
        "verify": {"source": "fraction", "fraction": 0.5}})
}

async fn report(app: &TestApp, job: &Value) -> Value {
    assert_eq!(job["status"], "succeeded", "{job}");
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    app.get(&path).await.ok(200)
}

#[tokio::test]
async fn sessions_of_one_robot_become_one_parameter_set_and_the_report_says_what_each_was() {
    let app = TestApp::with_workers(1).await;
    let (robot, [first, second, _]) = robot_with_sessions(&app).await;
    let request = pooled(&[&first, &second]);
    let job = app.run(&robot, &request).await;
    let report_1 = report(&app, &job).await;
    assert_eq!(job["measurement_set_id"], json!(first));
    assert_eq!(
        job["request"]["measurement_set_ids"],
        json!([first, second])
    );
    assert!(job["parameter_set_id"].is_string());
    let found = &report_1["pooled"];
    let sessions = found["sessions"].as_array().unwrap();
    let points = report_1["per_point"].as_array().unwrap();
    let n_first = sessions[0]["n_points"].as_u64().unwrap();
    assert_eq!(sessions[0]["first_row"], json!(0));
    assert_eq!(sessions[1]["first_row"], json!(n_first));
    assert_eq!(
        n_first + sessions[1]["n_points"].as_u64().unwrap(),
        points.len() as u64
    );
    assert!(found["probability"].as_f64().unwrap() > 0.01, "{found}");
    let page = format!("/v1/jobs/{}/report.html", text(&job["id"]));
    let page = app.get(&page).await.text();
    let n_points = points.len();
    let measured = format!("2 sessions that were fitted together, {n_points} points");
    for said in [
        measured.as_str(),
        "in the same sessions",
        "as far as these points tell",
    ] {
        assert!(page.contains(said), "the page does not say {said}");
    }
    // The same request gives the same bits, and a job of one set has nothing of this.
    let again = report(&app, &app.run(&robot, &request).await).await;
    assert_eq!(report_1["result_sha256"], again["result_sha256"]);
    let single =
        json!({"measurement_set_id": first, "method": "least_squares", "corrections": "off"});
    let single = report(&app, &app.run(&robot, &single).await).await;
    assert!(single.get("pooled").is_none());
}

#[tokio::test]
async fn a_robot_that_changed_between_the_sessions_is_named_and_has_no_result() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.robot_with_set("first.csv").await;
    let second = app.upload(&robot, "followup_collision.csv").await;
    let job = app.run(&robot, &pooled(&[&first, &second])).await;
    assert_eq!(job["status"], "failed", "{job}");
    assert_eq!(job["error"]["code"], "sessions_differ");
    let detail = text(&job["error"]["detail"]);
    assert!(detail.contains("theta_offset_2 by 0.2"), "{detail}");
    assert!(detail.contains(" standard deviations)"), "{detail}");
    assert!(job.get("parameter_set_id").is_none());
    let sets = app.get(&format!("{robot}/parameter-sets")).await.ok(200);
    assert_eq!(sets["items"], json!([]));
}

#[tokio::test]
async fn no_session_that_was_fitted_counts_as_an_independent_one() {
    let app = TestApp::with_workers(1).await;
    let (robot, [first, second, third]) = robot_with_sessions(&app).await;
    let job = app.run(&robot, &pooled(&[&first, &second])).await;
    let set = text(&job["parameter_set_id"]).to_owned();
    let evidence = async |points: &str| {
        let verify =
            json!({"kind": "verify", "measurement_set_id": points, "parameter_set_id": set});
        report(&app, &app.run(&robot, &verify).await).await["evidence"].clone()
    };
    assert_eq!(evidence(&first).await, "same_upload");
    assert_eq!(evidence(&second).await, "same_upload");
    // nor under another id
    let [copy, _] = halves("followup_unchanged.csv");
    let copy = upload(&app, &robot, "frame=base", copy).await;
    assert_eq!(evidence(&copy).await, "same_upload");
    assert_eq!(evidence(&third).await, "independent_session");
    // and a verify set that is one of them proves nothing
    let mut request = pooled(&[&first, &second]);
    request["verify"] = json!({"source": "set", "measurement_set_id": copy});
    app.post_json(&format!("{robot}/jobs"), &request)
        .await
        .problem(422, "verify_overlaps_identify");
}

#[tokio::test]
async fn an_earlier_set_has_to_be_scored_on_each_session_that_was_fitted_later() {
    let app = TestApp::with_workers(1).await;
    let (robot, [first, second, _]) = robot_with_sessions(&app).await;
    let single =
        json!({"measurement_set_id": first, "method": "least_squares", "corrections": "off"});
    let earlier = app.run(&robot, &single).await;
    let earlier = text(&earlier["parameter_set_id"]).to_owned();
    report(&app, &app.run(&robot, &pooled(&[&first, &second])).await).await;
    let gate = async || {
        let gates = app
            .get(&format!("/v1/parameter-sets/{earlier}/gates"))
            .await;
        let gates = gates.ok(200);
        let mut all = gates["gates"].as_array().unwrap().iter();
        let found = all.find(|gate| gate["gate"] == "scored_on_later_sessions");
        found.unwrap().clone()
    };
    let refused = gate().await;
    assert_eq!(refused["passed"], json!(false), "{refused}");
    assert!(text(&refused["detail"]).contains(&second), "{refused}");
    let verify =
        json!({"kind": "verify", "measurement_set_id": second, "parameter_set_id": earlier});
    report(&app, &app.run(&robot, &verify).await).await;
    assert_eq!(gate().await["passed"], json!(true));
}

#[tokio::test]
async fn each_fault_of_a_request_for_several_sessions_is_named_where_it_stands() {
    let app = TestApp::spawn().await;
    let (robot, [first, second, third]) = robot_with_sessions(&app).await;
    let others = app.paper_robot().await;
    let others = app.upload(&others, "first.csv").await;
    let instrument = paper("followup_drifted.csv");
    let instrument = upload(&app, &robot, "frame=instrument", instrument).await;
    let copy = app.upload(&robot, "first.csv").await;
    let post = async |request: Value| app.post_json(&format!("{robot}/jobs"), &request).await;
    let at = |answer: Answer, code: &str| {
        let problem = answer.problem(422, code);
        let first = problem["errors"][0].clone();
        assert!(text(&first["detail"]).len() > 20, "{problem}");
        (
            text(&first["pointer"]).to_owned(),
            text(&first["code"]).to_owned(),
        )
    };
    let is = |pointer: &str, code: &str| (pointer.to_owned(), code.to_owned());
    let ids = "/measurement_set_ids";
    let with = |field: &str, value: Value| {
        let mut request = pooled(&[&first, &second]);
        request[field] = value;
        request
    };

    // an unknown set, another robot's set, and what cannot be an id
    for unknown in ["set_0", &others, "%00"] {
        let answer = post(pooled(&[&first, unknown])).await;
        assert_eq!(
            at(answer, "unknown_reference"),
            is(&format!("{ids}/1"), "unknown_reference")
        );
    }
    // the same set twice, one set, none, too many
    let answer = post(pooled(&[&first, &second, &first])).await;
    assert_eq!(
        at(answer, "invalid_job"),
        is(&format!("{ids}/2"), "same_set")
    );
    let many: Vec<String> = (0..9).map(|k| format!("set_{k}")).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    for wrong in [&[][..], &[first.as_str()], &many] {
        assert_eq!(
            at(post(pooled(wrong)).await, "invalid_job"),
            is(ids, "out_of_range")
        );
    }
    // both fields, or neither
    let both = with("measurement_set_id", json!(third));
    assert_eq!(
        at(post(both).await, "invalid_job"),
        is("/measurement_set_id", "not_applicable")
    );
    let answer = post(json!({"method": "least_squares"})).await;
    assert_eq!(
        at(answer, "invalid_body"),
        is("/measurement_set_id", "invalid_body")
    );
    // two frames
    assert_eq!(
        at(post(pooled(&[&first, &instrument])).await, "mixed_frames"),
        is(&format!("{ids}/1"), "mixed_frames")
    );
    // fields that do not go with several sessions
    for (field, value, pointer) in [
        ("kind", json!("verify"), ids),
        ("kind", json!("check"), ids),
        ("model", json!("paper"), "/model"),
        ("frames_id", json!("frames_1"), "/frames_id"),
    ] {
        let mut request = with(field, value);
        request.as_object_mut().unwrap().remove("verify");
        assert_eq!(
            at(post(request).await, "invalid_job"),
            is(pointer, "not_applicable")
        );
    }
    let verify = json!({"source": "set", "measurement_set_id": second});
    assert_eq!(
        at(post(with("verify", verify)).await, "invalid_job"),
        is("/verify/measurement_set_id", "same_set")
    );
    // the same points under another id
    post(pooled(&[&first, &copy]))
        .await
        .problem(422, "session_repeated");
    // sets that were uploaded for two robots
    let [one, other] = halves("followup_unchanged.csv");
    let one = upload(&app, &robot, "frame=base&serial_number=A", one).await;
    let other = upload(&app, &robot, "frame=base&serial_number=B", other).await;
    assert_eq!(
        at(
            post(pooled(&[&first, &one, &other])).await,
            "robot_mismatch"
        ),
        is(&format!("{ids}/2"), "robot_mismatch")
    );
    // an archived set
    app.post(&format!("/v1/measurement-sets/{third}/archive"), "", "")
        .await
        .ok(200);
    post(pooled(&[&first, &third]))
        .await
        .problem(409, "archived");
    // nothing of all this was queued
    let jobs = app.get(&format!("{robot}/jobs")).await.ok(200);
    assert_eq!(jobs["items"], json!([]));
}

#[tokio::test]
async fn a_request_for_several_sessions_is_posted_once_under_one_key() {
    let app = TestApp::spawn().await;
    let (robot, [first, second, _]) = robot_with_sessions(&app).await;
    let post = async |request: &Value| {
        let path = format!("{robot}/jobs");
        let request = app
            .request(reqwest::Method::POST, &path)
            .header("idempotency-key", "pool-1")
            .header("content-type", "application/json")
            .body(request.to_string());
        Answer::of(request).await
    };
    let job = post(&pooled(&[&first, &second])).await.ok(202);
    assert_eq!(post(&pooled(&[&first, &second])).await.ok(202), job);
    post(&pooled(&[&second, &first]))
        .await
        .problem(422, "idempotency_key_reused");
    let listed = app.get(&format!("{robot}/jobs")).await.ok(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 1);
}

/// Runs the binary, without blocking the server's threads.
async fn kincal(app: &TestApp, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
    command
        .args(arguments)
        .env("KINCAL_SERVER", app.server.url());
    let output = tokio::task::spawn_blocking(move || command.output().unwrap());
    let output = output.await.unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_takes_several_sessions_and_finds_what_the_server_finds() {
    let app = TestApp::with_workers(1).await;
    let (robot, [first, second, _]) = robot_with_sessions(&app).await;
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let robot_json = file("robot.json", &paper("robot.json"));
    let files = [
        file("first.csv", &paper("first.csv")),
        file("second.csv", &halves("followup_unchanged.csv")[0]),
    ];
    let options = [
        "--method",
        "least_squares",
        "--corrections",
        "off",
        "--verify-fraction",
        "0.5",
    ];
    let sessions = [files[0].as_str(), "--session", &files[1]];
    let by_server = report(&app, &app.run(&robot, &pooled(&[&first, &second])).await).await;

    let offline = [
        &["calibrate", &robot_json][..],
        &sessions,
        &options,
        &["--json"],
    ]
    .concat();
    let (code, stdout, stderr) = kincal(&app, &offline).await;
    assert_eq!(code, Some(0), "{stderr}");
    let offline: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(offline["result_sha256"], by_server["result_sha256"]);

    let id = robot.rsplit('/').next().unwrap();
    let submit = ["submit", "--robot", id];
    let submitted = [&submit[..], &sessions, &options, &["--json", "--wait"]].concat();
    let (code, stdout, stderr) = kincal(&app, &submitted).await;
    assert_eq!(code, Some(0), "{stderr}");
    let submitted: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(submitted["pooled"], by_server["pooled"]);

    // sessions that differ, one file twice, and what scores one set at a time
    let changed = file("changed.csv", &paper("followup_collision.csv"));
    let differ = ["calibrate", &robot_json, &files[0], "--session", &changed];
    let (code, _, stderr) = kincal(&app, &[&differ[..], &options].concat()).await;
    assert_ne!(code, Some(0));
    assert!(
        stderr.contains("sessions_differ") && stderr.contains("theta_offset_2"),
        "{stderr}"
    );
    let twice = ["calibrate", &robot_json, &files[0], "--session", &files[0]];
    let (code, _, stderr) = kincal(&app, &[&twice[..], &options].concat()).await;
    assert_eq!(code, Some(2), "{stderr}");
    assert!(stderr.contains("session_repeated"), "{stderr}");
    let (code, _, stderr) = kincal(&app, &[&submit[..], &sessions, &["--verify"]].concat()).await;
    assert_eq!(code, Some(2));
    assert!(stderr.contains("one set at a time"), "{stderr}");
}
