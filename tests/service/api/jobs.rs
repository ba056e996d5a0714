use crate::app::{TestApp, paper, text};
use kincal::kinematics::{Link, t_base_flange};
use kincal::wire::job_answer::Stage;
use nalgebra::{Matrix3, Point3, Vector3};
use serde_json::{Value, json};

#[tokio::test]
async fn a_job_is_queued_at_once_and_succeeds_with_a_report() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": set, "method": "pso", "seed": 7}),
        )
        .await;
    assert_eq!(
        (
            &job["status"],
            &job["method"],
            &job["kind"],
            &job["attempt"]
        ),
        (
            &json!("succeeded"),
            &json!("pso"),
            &json!("identify"),
            &json!(1)
        )
    );
    let report = app.report(&job).await;
    assert_eq!(
        (
            &report["job_id"],
            &report["method"],
            &report["seed"],
            &report["model"]
        ),
        (&job["id"], &json!("pso"), &json!(7), &json!("complete"))
    );
    assert_eq!(
        (
            &report["identify"]["n_points"],
            &report["verify"]["n_points"]
        ),
        (&json!(50), &json!(50))
    );
    assert!(
        report["verify"]["after"]["rms_mm"].as_f64()
            < report["verify"]["before"]["rms_mm"].as_f64()
    );
    assert_eq!(report["per_point"].as_array().unwrap().len(), 100);
    assert_eq!(report["evidence"], "same_upload");
    assert_eq!(text(&report["result_sha256"]).len(), 64);
    assert!(
        report["comparison"]
            .as_array()
            .unwrap()
            .iter()
            .any(|other| other["method"] == "least_squares"),
        "{}",
        report["comparison"]
    );
    assert!(report["duration_ms"].as_f64() > Some(0.0));
    assert!(job["parameter_set_id"].is_string() && job["network_id"].is_string());
}

#[tokio::test]
async fn a_search_box_in_which_nothing_can_be_seen_is_refused_when_the_job_is_posted() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let request = |mm: f64, deg: f64, preset: &str| {
        let options =
            json!({"search_half_width_mm": mm, "search_half_width_deg": deg, "n_iterations": 10});
        json!({"measurement_set_id": set, "method": "pso", "preset": preset, "refine": false, "options": options})
    };
    let problem = app
        .post_json(&format!("{robot}/jobs"), &request(1e-6, 1e-6, "default"))
        .await
        .problem(422, "search_box_too_small");
    assert!(
        text(&problem["detail"]).contains("make them larger, or leave them out"),
        "{problem}"
    );
    // The preset searches raw parameters even if they have no effect.
    for request in [
        request(1e-4, 1e-4, "default"),
        request(1e-6, 1.0, "default"),
        request(1e-6, 1e-6, "paper"),
    ] {
        assert_eq!(
            app.run(&robot, &request).await["status"],
            "succeeded",
            "{request}"
        );
    }
}

#[tokio::test]
async fn the_convergence_curve_begins_at_0_never_rises_and_ends_at_the_last_iteration() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app.run(&robot, &json!({"measurement_set_id": set, "method": "pso", "refine": false, "options": {"n_iterations": 25}})).await;
    let path = format!("/v1/jobs/{}", text(&job["id"]));
    let curve = app.get(&format!("{path}/convergence")).await.ok(200);
    let report = app.get(&format!("{path}/report")).await.ok(200);
    let costs: Vec<f64> = curve["best_cost_mm2"]
        .as_array()
        .unwrap()
        .iter()
        .map(|cost| cost.as_f64().unwrap())
        .collect();
    assert_eq!(curve["iteration"], json!((0..=25).collect::<Vec<_>>()));
    assert_eq!(report["n_iterations"], 25);
    assert!(costs.windows(2).all(|pair| pair[1] <= pair[0]));
}

#[tokio::test]
async fn a_swarms_network_is_stored_and_moves_the_next_swarm() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.robot_with_set("first.csv").await;
    let follow_up = app.upload(&robot, "followup_unchanged.csv").await;
    let request = json!({"measurement_set_id": follow_up, "method": "bpnn_pso"});
    app.post_json(&format!("{robot}/jobs"), &request)
        .await
        .problem(409, "no_network");
    let automatic = json!({"measurement_set_id": first, "method": "auto"});
    let result = async |app: &TestApp| {
        let job = app.run(&robot, &automatic).await;
        app.report(&job).await["result_sha256"].clone()
    };
    let before = result(&app).await;
    let trained = app
        .run(
            &robot,
            &json!({"measurement_set_id": first, "method": "pso"}),
        )
        .await;
    let network = app
        .get(&format!("/v1/networks/{}", text(&trained["network_id"])))
        .await
        .ok(200);
    assert_eq!(
        (&network["job_id"], &network["model"], &network["preset"]),
        (&trained["id"], &json!("complete"), &json!("default"))
    );
    assert_eq!(
        app.get(&format!("{robot}/networks")).await.ok(200)["items"],
        json!([network])
    );
    let weights = app
        .get(&format!(
            "/v1/networks/{}/weights",
            text(&trained["network_id"])
        ))
        .await;
    assert_eq!(
        weights.header("content-type"),
        Some("application/octet-stream")
    );
    let read = kincal::wire::safetensors::read(&weights.bytes).unwrap();
    assert_eq!(json!(read.parameter_names), network["parameter_names"]);
    assert_eq!(
        kincal::wire::safetensors::write(&read).unwrap().sha256,
        text(&network["sha256"])
    );
    let job = app.run(&robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    app.post_json(
        &format!("{robot}/jobs"),
        &json!({"measurement_set_id": follow_up, "method": "bpnn_pso", "preset": "paper"}),
    )
    .await
    .problem(409, "no_network");
    let other = json!({"measurement_set_id": follow_up, "method": "bpnn_pso", "model": "paper", "network_id": trained["network_id"]});
    app.post_json(&format!("{robot}/jobs"), &other)
        .await
        .problem(409, "network_mismatch");
    // If least squares converges, a network changes nothing. A requested network that does not fit the job is refused.
    assert_eq!(result(&app).await, before);
    let other = json!({"measurement_set_id": follow_up, "method": "auto", "model": "paper", "network_id": trained["network_id"]});
    app.post_json(&format!("{robot}/jobs"), &other)
        .await
        .problem(409, "network_mismatch");
    let without = json!({"measurement_set_id": follow_up, "method": "auto", "model": "paper"});
    assert_eq!(app.run(&robot, &without).await["status"], "succeeded");
}

#[tokio::test]
async fn a_job_says_what_changed_since_the_robots_last_identification_and_its_hash_does_not_depend_on_that()
 {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.robot_with_set("first.csv").await;
    let collided = app.upload(&robot, "followup_collision.csv").await;
    let report_of = async |set: &str| {
        let job = app
            .run(
                &robot,
                &json!({"measurement_set_id": set, "method": "least_squares"}),
            )
            .await;
        app.report(&job).await
    };
    let (new, after_collision, back) = (
        report_of(&first).await,
        report_of(&collided).await,
        report_of(&first).await,
    );
    assert_eq!(new.get("changed"), None, "there is nothing to compare with");
    let first_names = |report: &Value| -> Vec<String> {
        let mut names: Vec<String> = report["changed"].as_array().unwrap()[..3]
            .iter()
            .map(|c| text(&c["name"]).into())
            .collect();
        names.sort_unstable();
        names
    };
    assert_eq!(
        first_names(&after_collision),
        ["a_3", "theta_offset_2", "theta_offset_3"]
    );
    assert_eq!(first_names(&back), first_names(&after_collision));
    let warned = |report: &Value| {
        report["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .any(|w| w["code"] == "robot_changed")
    };
    assert!(!warned(&new) && warned(&after_collision) && warned(&back));
    assert_eq!(new["result_sha256"], back["result_sha256"]);
}

#[tokio::test]
async fn the_same_request_gives_the_same_result_also_after_a_restart_and_with_other_workers() {
    let mut app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first_noisy.csv").await;
    let request = json!({"measurement_set_id": set, "method": "pso", "seed": 3, "options": {"n_iterations": 40}});
    let mut hashes = Vec::new();
    for workers in [1, 3] {
        for _ in 0..2 {
            let job = app.run(&robot, &request).await;
            let report = app.report(&job).await;
            let set = app.parameter_set(&job).await;
            hashes.push((report["result_sha256"].clone(), set["sha256"].clone()));
        }
        app.config.workers = Some(workers + 2);
        app = app.restart().await;
    }
    assert!(
        hashes.windows(2).all(|pair| pair[0] == pair[1]),
        "{hashes:?}"
    );
    let other = app.run(&robot, &json!({"measurement_set_id": set, "method": "pso", "seed": 4, "options": {"n_iterations": 40}})).await;
    let report = app.report(&other).await;
    assert_ne!(
        report["result_sha256"], hashes[0].0,
        "another seed is another result"
    );
}

#[tokio::test]
async fn a_waiting_job_has_no_result_and_can_be_cancelled() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app
        .post_json(
            &format!("{robot}/jobs"),
            &json!({"measurement_set_id": set}),
        )
        .await
        .ok(202);
    let path = format!("/v1/jobs/{}", text(&job["id"]));
    assert_eq!(
        (&job["status"], &job["attempt"]),
        (&json!("queued"), &json!(0))
    );
    app.get(&format!("{path}/report"))
        .await
        .problem(409, "not_finished");
    app.get(&format!("{path}/convergence"))
        .await
        .problem(409, "not_finished");
    app.get(&format!("{path}/report.html"))
        .await
        .problem(409, "not_finished");
    let cancelled = app
        .post(&format!("{path}/cancel"), "application/json", "")
        .await
        .ok(200);
    assert_eq!(cancelled["status"], "cancelled");
    assert!(cancelled["finished_at"].is_string());
    assert_eq!(
        app.post(&format!("{path}/cancel"), "application/json", "")
            .await
            .ok(200),
        cancelled,
        "cancelling again changes nothing"
    );
    app.get(&format!("{path}/report"))
        .await
        .problem(409, "no_result");
    assert_eq!(
        app.get(&format!("{robot}/jobs")).await.ok(200)["items"][0],
        cancelled
    );
}

#[tokio::test]
async fn a_long_poll_answers_at_once_when_the_job_is_cancelled() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app
        .post_json(
            &format!("{robot}/jobs"),
            &json!({"measurement_set_id": set}),
        )
        .await
        .ok(202);
    let path = format!("/v1/jobs/{}", text(&job["id"]));
    let (waiting, cancel) = (format!("{path}?wait_s=30"), format!("{path}/cancel"));
    let (polled, _) = tokio::join!(app.get(&waiting), app.post(&cancel, "application/json", ""));
    assert_eq!(polled.ok(200)["status"], "cancelled");
    app.get(&format!("{path}?wait_s=31"))
        .await
        .problem(400, "invalid_query");
    app.get(&format!("{path}?wait_s=-1"))
        .await
        .problem(400, "invalid_query");
    app.get("/v1/jobs/job_0").await.problem(404, "not_found");
}

#[tokio::test]
async fn events_tell_progress_and_end_with_finished() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app
        .post_json(
            &format!("{robot}/jobs"),
            &json!({"measurement_set_id": set, "method": "pso"}),
        )
        .await
        .ok(202);
    let stream = app
        .get(&format!("/v1/jobs/{}/events", text(&job["id"])))
        .await;
    assert_eq!(
        (stream.status, stream.header("content-type")),
        (200, Some("text/event-stream"))
    );
    let all = stream.text();
    let events: Vec<(&str, Value)> = all
        .split("\n\n")
        .filter_map(|event| {
            let (name, data) = event.strip_prefix("event: ")?.split_once("\ndata: ")?;
            Some((name, serde_json::from_str(data).unwrap()))
        })
        .collect();
    let (last, before) = events.split_last().unwrap();
    assert_eq!(
        (last.0, &last.1["status"], &last.1["id"]),
        ("finished", &json!("succeeded"), &job["id"])
    );
    assert!(before.iter().all(|(name, _)| *name == "progress"));
    let answered = app
        .get(&format!("/v1/jobs/{}", text(&job["id"])))
        .await
        .ok(200);
    let known = |stage: &Value| Stage::parse(stage.as_str().unwrap_or("no stage")).is_some();
    assert!(
        events
            .iter()
            .map(|(_, job)| job)
            .chain([&answered])
            .filter_map(|job| job.get("progress"))
            .all(|progress| known(&progress["stage"])),
        "progress always says what the job is at: {all}"
    );
    app.get("/v1/jobs/job_0/events")
        .await
        .problem(404, "not_found");
}

#[tokio::test]
async fn a_verify_job_scores_the_named_set_else_the_active_one_else_the_nominal_robot() {
    let app = TestApp::with_workers(1).await;
    let (robot, identified) = app.identified().await;
    let other = app.upload(&robot, "followup_unchanged.csv").await;
    let request = json!({"measurement_set_id": other, "kind": "verify"});
    let report = async |request: &Value| {
        let job = app.run(&robot, request).await;
        assert_eq!(
            (&job["status"], &job["kind"], &job["parameter_set_id"]),
            (&json!("succeeded"), &json!("verify"), &Value::Null),
            "{job}"
        );
        app.report(&job).await
    };
    let nominal = report(&request).await;
    assert_eq!(nominal["verify"]["before"], nominal["verify"]["after"]);
    assert!(
        text(&nominal["method_reason"]).contains("nominal robot was scored"),
        "{}",
        nominal["method_reason"]
    );

    let mut named = request.clone();
    named["parameter_set_id"] = identified["parameter_set_id"].clone();
    let scored = report(&named).await;
    assert_eq!(
        (
            &scored["evidence"],
            &scored["verify"]["n_points"],
            &scored["n_evaluations"]
        ),
        (&json!("independent_session"), &json!(100), &json!(0))
    );
    // Planted without noise, and without a change in between.
    assert!(
        scored["verify"]["after"]["rms_mm"].as_f64() < Some(1e-6),
        "{}",
        scored["verify"]
    );
    // The nominal links, with the reflector at its identified position.
    let before = |report: &Value| report["verify"]["before"]["rms_mm"].as_f64().unwrap();
    assert!((before(&scored) / before(&nominal) - 1.0).abs() < 0.01);
    assert_eq!(scored["warnings"], json!([]));
    named["measurement_set_id"] = identified["measurement_set_id"].clone();
    assert_eq!(report(&named).await["evidence"], "same_upload");

    let release = format!(
        "/v1/parameter-sets/{}/release",
        text(&identified["parameter_set_id"])
    );
    app.post_json(&release, &json!({"reason": "verified on another session"}))
        .await
        .ok(200);
    assert_eq!(report(&request).await["verify"], scored["verify"]);
}

#[tokio::test]
async fn priors_and_bounds_are_kept_and_stand_in_the_report() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first_noisy.csv").await;
    // Positions do not depend on the last joint's offset. The true error of a_3 is 0.065 mm.
    let priors = json!([{"name": "theta_offset_6", "mean": 0.07, "std": 0.01}, {"name": "a_3", "std": 1.0, "max": A_3_MM + 0.03}]);
    let request =
        json!({"measurement_set_id": set, "parameters": {"hold": ["a_1"], "priors": priors}});
    let mut hashes = Vec::new();
    for method in ["least_squares", "least_squares", "pso"] {
        let mut request = request.clone();
        request["method"] = json!(method);
        let job = app.run(&robot, &request).await;
        assert_eq!(
            (&job["status"], &job["request"]["parameters"]["priors"]),
            (&json!("succeeded"), &priors),
            "{job}"
        );
        let report = app.report(&job).await;
        let of = |name: &str| {
            report["parameters"]
                .as_array()
                .unwrap()
                .iter()
                .find(|p| p["name"] == name)
                .unwrap()
                .clone()
        };
        let (sixth, third) = (of("theta_offset_6"), of("a_3"));
        let number = |value: &Value| value.as_f64().unwrap();
        assert!(
            (number(&sixth["identified"]) - 0.07).abs() < 1e-6 && sixth["identifiable"] == false,
            "{sixth}"
        );
        assert!(
            (number(&sixth["std_uncertainty"]) - 0.01).abs() < 1e-4
                && number(&sixth["prior"]["share"]) > 0.99,
            "{sixth}"
        );
        assert!(
            number(&third["identified"]) <= A_3_MM + 0.03 + 1e-9,
            "{third}"
        );
        assert_eq!(
            (
                &third["prior"]["at_bound"],
                &third["prior"]["min"],
                &third["std_uncertainty"]
            ),
            (&json!("max"), &Value::Null, &Value::Null)
        );
        assert_eq!(
            (
                &report["identifiability"]["rank"],
                &report["identifiability"]["n_by_priors"]
            ),
            (&json!(25), &json!(1))
        );
        assert!(
            report["parameters"]
                .as_array()
                .unwrap()
                .iter()
                .all(|p| p["name"] != "a_1")
        );
        assert!(
            report["warnings"]
                .as_array()
                .unwrap()
                .iter()
                .any(|w| w["code"] == "at_bound"),
            "{}",
            report["warnings"]
        );
        hashes.push(report["result_sha256"].clone());
    }
    assert!(hashes[0] == hashes[1] && hashes[1] != hashes[2]);
}

/// Nominal a of the paper's third link, mm (Table 1).
const A_3_MM: f64 = 782.27;

#[tokio::test]
async fn priors_that_cannot_be_used_are_refused_by_pointer() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    for (prior, code, pointer) in [
        (
            json!({"name": "a_99", "std": 0.1}),
            "unknown_parameter",
            "/parameters/priors/0/name",
        ),
        (
            json!({"name": "a_2", "std": 0.1}),
            "parameter_held",
            "/parameters/priors/0/name",
        ),
        (
            json!({"name": "a_1", "std": 0.0}),
            "invalid_job",
            "/parameters/priors/0/std",
        ),
        (
            json!({"name": "a_1", "std": -1.0}),
            "invalid_job",
            "/parameters/priors/0/std",
        ),
        (
            json!({"name": "", "std": 1.0}),
            "invalid_job",
            "/parameters/priors/0/name",
        ),
        (
            json!({"name": "a_1", "std": 1.0, "min": 2.0, "max": 1.0}),
            "invalid_job",
            "/parameters/priors/0/min",
        ),
        (
            json!({"name": "a_1", "std": 1.0, "max": 1e300}),
            "invalid_job",
            "/parameters/priors/0/max",
        ),
        (
            json!({"name": "a_1", "std": 1.0, "max": -5000.0}),
            "out_of_bounds",
            "/parameters/priors/0/max",
        ),
        (
            json!({"name": "a_1", "std": 1.0, "mean": 7.0, "min": 8.0, "max": 9.0}),
            "out_of_bounds",
            "/parameters/priors/0/min",
        ),
    ] {
        let request =
            json!({"measurement_set_id": set, "parameters": {"hold": ["a_2"], "priors": [prior]}});
        let problem = app
            .post_json(&format!("{robot}/jobs"), &request)
            .await
            .problem(422, code);
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
    }
    let twice = json!([{"name": "a_1", "std": 1.0}, {"name": "a_1", "std": 2.0}]);
    let problem = app
        .post_json(
            &format!("{robot}/jobs"),
            &json!({"measurement_set_id": set, "parameters": {"priors": twice}}),
        )
        .await
        .problem(422, "duplicate");
    assert_eq!(problem["errors"][0]["pointer"], "/parameters/priors/1/name");
    for prior in [
        json!({"name": "a_1"}),
        json!({"name": "a_1", "std": "0.1"}),
        json!({"name": "a_1", "std": 0.1, "mode": 3}),
    ] {
        let request = json!({"measurement_set_id": set, "parameters": {"priors": [prior]}});
        app.post_json(&format!("{robot}/jobs"), &request)
            .await
            .problem(422, "invalid_body");
    }
    // The rotation of the base is relative to its first estimate.
    let complete = json!({"measurement_set_id": set, "model": "complete", "parameters": {"priors": [{"name": "base_rz", "std": 1.0}]}});
    app.post_json(&format!("{robot}/jobs"), &complete)
        .await
        .problem(422, "not_applicable");
}

#[tokio::test]
async fn both_choices_of_corrections_are_taken() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    for corrections in ["off", "auto"] {
        app.post_json(
            &format!("{robot}/jobs"),
            &json!({"measurement_set_id": set, "corrections": corrections}),
        )
        .await
        .ok(202);
    }
}

#[tokio::test]
async fn options_out_of_range_are_refused_by_pointer() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    for (options, pointer) in [
        (json!({"n_particles": 1}), "/options/n_particles"),
        (json!({"n_particles": 100_001}), "/options/n_particles"),
        (json!({"n_iterations": 100_001}), "/options/n_iterations"),
        (
            json!({"n_particles": 100_000, "n_iterations": 100_000}),
            "/options/n_iterations",
        ),
        (
            json!({"search_half_width_mm": 0.0}),
            "/options/search_half_width_mm",
        ),
        (
            json!({"search_half_width_deg": -1.0}),
            "/options/search_half_width_deg",
        ),
        (json!({"inertia_weight": -0.1}), "/options/inertia_weight"),
        (
            json!({"stop_at_cost_mm2": -1.0}),
            "/options/stop_at_cost_mm2",
        ),
    ] {
        let problem = app
            .post_json(
                &format!("{robot}/jobs"),
                &json!({"measurement_set_id": set, "options": options}),
            )
            .await
            .problem(422, "invalid_job");
        assert_eq!(problem["errors"][0]["pointer"], pointer);
    }
    for verify in [
        json!({"source": "fraction", "fraction": 1.0}),
        json!({"source": "fraction", "fraction": 0.0}),
    ] {
        app.post_json(
            &format!("{robot}/jobs"),
            &json!({"measurement_set_id": set, "verify": verify}),
        )
        .await
        .problem(422, "invalid_job");
    }
    for request in [
        json!({"seed": -1}),
        json!({"method": "guess"}),
        json!({"verify": {"source": "moon"}}),
        json!({"options": {"n_particle": 9}}),
    ] {
        let mut request = request;
        request["measurement_set_id"] = json!(set);
        app.post_json(&format!("{robot}/jobs"), &request)
            .await
            .problem(422, "invalid_body");
    }
    app.post_json(
        &format!("{robot}/jobs"),
        &json!({"measurement_set_id": set, "parameters": {"identify": ["a_99"]}}),
    )
    .await
    .problem(422, "unknown_parameter");
}

#[tokio::test]
async fn a_job_refers_only_to_things_of_its_own_robot() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let other = app.paper_robot().await;
    let problem = app
        .post_json(
            &format!("{other}/jobs"),
            &json!({"measurement_set_id": set}),
        )
        .await
        .problem(422, "unknown_reference");
    assert_eq!(problem["errors"][0]["pointer"], "/measurement_set_id");
    for (key, pointer) in [
        ("frames_id", "/frames_id"),
        ("network_id", "/network_id"),
        ("parameter_set_id", "/parameter_set_id"),
    ] {
        let problem = app
            .post_json(
                &format!("{robot}/jobs"),
                &json!({"measurement_set_id": set, "method": "bpnn_pso", key: "nothing"}),
            )
            .await
            .problem(422, "unknown_reference");
        assert_eq!(problem["errors"][0]["pointer"], pointer);
    }
    app.post_json("/v1/robots/rob_0/jobs", &json!({"measurement_set_id": set}))
        .await
        .problem(404, "not_found");
}

#[tokio::test]
async fn another_set_can_verify_and_is_stronger_evidence() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.robot_with_set("first.csv").await;
    let second = app.upload(&robot, "followup_unchanged.csv").await;
    let verify = json!({"source": "set", "measurement_set_id": second});
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": first, "method": "least_squares", "verify": verify}),
        )
        .await;
    let report = app.report(&job).await;
    assert_eq!(report["evidence"], "independent_session");
}

/// The first set's poses, measured from the instrument position of the sweeps, on the robot with the errors of Table 3 and the sweeps' target.
pub fn first_csv_seen_by_the_instrument() -> Vec<u8> {
    let json = |name: &str| serde_json::from_slice::<Value>(&paper(name)).unwrap();
    let (robot, errors, frames) = (
        json("robot.json"),
        json("true_errors.json"),
        json("sweeps_truth.json"),
    );
    let number = |value: &Value| value.as_f64().unwrap();
    let link = |(nominal, error): (&Value, &Value)| Link {
        a_mm: number(&nominal["a_mm"]) + number(&error["delta_a_mm"]),
        alpha_rad: (number(&nominal["alpha_deg"]) + number(&error["delta_alpha_deg"])).to_radians(),
        d_mm: number(&nominal["d_mm"]) + number(&error["delta_d_mm"]),
        theta_offset_rad: (number(&nominal["theta_offset_deg"])
            + number(&error["delta_theta_offset_deg"]))
        .to_radians(),
        beta_rad: 0.0,
    };
    let links: Vec<Link> = robot["links"]
        .as_array()
        .unwrap()
        .iter()
        .zip(errors["links"].as_array().unwrap())
        .map(link)
        .collect();
    let rotation = Matrix3::from_fn(|row, column| number(&frames["rotation"][row][column]));
    let translation = Vector3::from_fn(|axis, _| number(&frames["translation_mm"][axis]));
    let text = String::from_utf8(paper("first.csv")).unwrap();
    let mut rows = text.lines();
    let header: Vec<&str> = rows.next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let mut out = format!("{}\n", header.join(","));
    for row in rows {
        let mut cells: Vec<String> = row.split(',').map(String::from).collect();
        let q_rad: Vec<f64> = (1..=6)
            .map(|j| {
                cells[column(&format!("q{j}_deg"))]
                    .parse::<f64>()
                    .unwrap()
                    .to_radians()
            })
            .collect();
        let flange = t_base_flange(&links, &q_rad);
        let p_base = flange * Point3::new(0.0, 0.0, number(&frames["z_t_mm"]));
        let p_instrument = rotation * p_base.coords + translation;
        for (axis, name) in ["x_mm", "y_mm", "z_mm"].into_iter().enumerate() {
            cells[column(name)] = format!("{:.6}", p_instrument[axis]);
        }
        out += &format!("{}\n", cells.join(","));
    }
    out.into_bytes()
}

#[tokio::test]
async fn sweeps_and_a_set_in_the_instruments_frame_give_the_papers_model_and_a_network_that_follow_ups_find()
 {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let set = app
        .upload_csv(
            &robot,
            "frame=instrument",
            first_csv_seen_by_the_instrument(),
        )
        .await;
    let request = json!({"measurement_set_id": set["id"], "model": "paper", "method": "pso"});
    app.post_json(&format!("{robot}/jobs"), &request)
        .await
        .problem(422, "frames_required");
    let frames = app
        .post(
            &format!("{robot}/frames"),
            "text/csv",
            paper("sweeps_instrument.csv"),
        )
        .await
        .ok(201);
    // If no model is named, frames_id implies the paper's model, for the job and for the search for its network.
    for method in ["pso", "bpnn_pso"] {
        let request =
            json!({"measurement_set_id": set["id"], "frames_id": frames["id"], "method": method});
        let job = app.run(&robot, &request).await;
        assert_eq!(job["status"], "succeeded", "{job}");
        assert_eq!(job["request"]["frames_id"], frames["id"]);
        let report = app.report(&job).await;
        assert_eq!(
            (text(&report["method"]), text(&report["model"])),
            (method, "paper")
        );
        // The sweeps' noise of 0.005 mm shifts the base, which the fit cannot correct.
        let rms = |when: &str| report["verify"][when]["rms_mm"].as_f64().unwrap();
        assert!(
            rms("before") > 0.5 && rms("after") < 0.02,
            "{} {}",
            rms("before"),
            rms("after")
        );
        let parameter_set = app.parameter_set(&job).await;
        let z_mm = parameter_set["targets"][0]["position_mm"][2]
            .as_f64()
            .unwrap();
        assert!((z_mm - 87.5).abs() < 0.05, "z_t of the sweeps: {z_mm}");
    }
}

#[tokio::test]
async fn what_a_job_would_quietly_leave_unused_is_refused() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    for (extra, pointer, code) in [
        (
            json!({"network_id": "net_1", "method": "least_squares"}),
            "/network_id",
            "not_applicable",
        ),
        (
            json!({"frames_id": "frm_1", "model": "complete"}),
            "/frames_id",
            "not_applicable",
        ),
        (
            json!({"kind": "verify", "verify": {"source": "subset"}}),
            "/verify",
            "not_applicable",
        ),
        (
            json!({"kind": "verify", "parameters": {"hold": ["a_1"]}}),
            "/parameters",
            "not_applicable",
        ),
        (
            json!({"verify": {"source": "set", "measurement_set_id": set}}),
            "/verify/measurement_set_id",
            "same_set",
        ),
    ] {
        let mut request = extra;
        request["measurement_set_id"] = json!(set);
        let problem = app
            .post_json(&format!("{robot}/jobs"), &request)
            .await
            .problem(422, "invalid_job");
        assert_eq!(
            (
                text(&problem["errors"][0]["pointer"]),
                text(&problem["errors"][0]["code"])
            ),
            (pointer, code)
        );
    }
}

#[tokio::test]
async fn a_set_uploaded_twice_verifies_nothing() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let again = app.upload(&robot, "first.csv").await;
    let request = json!({"measurement_set_id": set, "verify": {"source": "set", "measurement_set_id": again}});
    app.post_json(&format!("{robot}/jobs"), &request)
        .await
        .problem(422, "verify_overlaps_identify");
}

#[tokio::test]
async fn a_swarm_that_would_take_hours_is_refused() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let options = json!({"n_particles": 100_000, "n_iterations": 500});
    let request = json!({"measurement_set_id": set, "method": "pso", "options": options});
    app.post_json(&format!("{robot}/jobs"), &request)
        .await
        .ok(202);
    let rows: String = (0..6000)
        .map(|i| {
            format!(
                "{},{},{},0,{},0,0.1,0.2,0.3\n",
                i % 170,
                i / 60,
                i % 50,
                i % 90
            )
        })
        .collect();
    let csv = format!("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n{rows}");
    let large = app
        .upload_csv(&robot, "frame=base&insist=poor_alignment", csv)
        .await;
    let request = json!({"measurement_set_id": large["id"], "method": "pso", "options": options});
    app.post_json(&format!("{robot}/jobs"), &request)
        .await
        .problem(422, "too_much_work");
}
