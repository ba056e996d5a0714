use crate::api::sessions::{csv, rows, scored, with_noise};
use crate::app::{TestApp, text};
use crate::simulation::Normal;
use serde_json::json;

#[tokio::test]
async fn history_tells_what_moved_and_comparison_where_the_tool_did() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.identified().await;
    let set = app.upload(&robot, "followup_collision.csv").await;
    let second = app
        .run(
            &robot,
            &json!({"measurement_set_id": set, "method": "least_squares"}),
        )
        .await;
    let ids = [
        text(&first["parameter_set_id"]),
        text(&second["parameter_set_id"]),
    ];
    let history = app.get(&format!("{robot}/history")).await.ok(200);
    let items = history["items"].as_array().unwrap();
    assert_eq!(
        items
            .iter()
            .map(|item| text(&item["parameter_set_id"]))
            .collect::<Vec<_>>(),
        [ids[1], ids[0]]
    );
    assert_eq!(items[1]["changed"], json!([]));
    let changed = items[0]["changed"].as_array().unwrap();
    assert!(
        !changed.is_empty() && changed.iter().all(|c| c["sigmas"].as_f64().unwrap() > 1.0),
        "{changed:?}"
    );
    assert_eq!(items[0]["parameters"].as_array().unwrap().len(), 39);
    assert!(items[0]["verify_rms_mm"].as_f64().unwrap() < 0.1);
    assert_eq!(history["trend"]["rms_mm_per_day"], json!(null));
    assert!(text(&history["trend"]["detail"]).starts_with("not enough data"));
    let page = app.get(&format!("{robot}/history?limit=1")).await.ok(200);
    let next = app
        .get(&format!(
            "{robot}/history?limit=1&cursor={}",
            text(&page["next_cursor"])
        ))
        .await
        .ok(200);
    assert_eq!(next["items"][0]["parameter_set_id"], ids[0]);

    let compare = async |with: &str| {
        app.get(&format!(
            "/v1/parameter-sets/{}/compare?with={with}",
            ids[1]
        ))
        .await
    };
    let differences = compare(ids[0]).await.ok(200);
    assert_eq!(differences["map"].as_array().unwrap().len(), 200);
    let length = |point: &serde_json::Value| {
        point["difference_mm"]
            .as_array()
            .unwrap()
            .iter()
            .map(|v| v.as_f64().unwrap().powi(2))
            .sum::<f64>()
            .sqrt()
    };
    let lengths: Vec<f64> = differences["map"]
        .as_array()
        .unwrap()
        .iter()
        .map(length)
        .collect();
    assert!(
        (differences["mean_mm"].as_f64().unwrap() - lengths.iter().sum::<f64>() / 200.0).abs()
            < 1e-9
    );
    assert!(differences["max_mm"].as_f64().unwrap() > 0.1);
    assert!(
        differences["sessions"]["probability"].as_f64().unwrap() < 1e-3,
        "{}",
        differences["sessions"]
    );
    let itself = compare(ids[1]).await.ok(200);
    assert_eq!(
        (&itself["max_mm"], &itself["sessions"]),
        (&json!(0.0), &json!(null))
    );
    // PostgreSQL does not accept this text, so it is never looked up.
    for nobodys in [
        "par_1",
        "%00",
        "par_%00",
        "%F0%9F%A4%96",
        "'%20or%201=1",
        "",
    ] {
        compare(nobodys).await.problem(422, "unknown_reference");
    }

    app.post_json(
        &format!("/v1/parameter-sets/{}/release", ids[1]),
        &json!({"reason": "after the collision"}),
    )
    .await
    .ok(200);
    let verify = json!({"kind": "verify", "measurement_set_id": set, "parameter_set_id": ids[1]});
    for _ in 0..2 {
        assert_eq!(app.run(&robot, &verify).await["status"], "succeeded");
    }
    let trend = app.get(&format!("{robot}/history?limit=1")).await.ok(200)["trend"].clone();
    // The set's own upload, scored repeatedly, counts as one session.
    assert!(
        text(&trend["detail"]).starts_with("not enough data: 1 session;"),
        "{trend}"
    );
}

#[tokio::test]
async fn the_trend_stands_at_the_times_of_measurement_not_of_the_uploads() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(61);
    let mut session = async |name: &str, day: u32| {
        let csv = csv(&with_noise(&rows(name), 0.03, &mut random));
        let query = format!("frame=base&measured_at=2026-03-{day:02}T08:00:00Z");
        app.upload_csv(&robot, &query, csv).await["id"].clone()
    };
    let request =
        json!({"measurement_set_id": session("first.csv", 1).await, "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    let set = job["parameter_set_id"].clone();
    app.post_json(
        &format!("/v1/parameter-sets/{}/release", text(&set)),
        &json!({"reason": "first"}),
    )
    .await
    .ok(200);
    for day in [6, 11, 16, 25] {
        let upload = session("followup_unchanged.csv", day).await;
        scored(&app, &robot, text(&upload), &set).await;
    }
    let trend = app.get(&format!("{robot}/history")).await.ok(200)["trend"].clone();
    assert_eq!(trend["n_sessions"], 5, "{trend}");
    assert!(trend["rms_mm_per_day"].is_number(), "{trend}");
    let overview = app.get("/v1/overview").await.ok(200);
    assert_eq!(
        overview["items"][0]["session"]["measured_at"],
        "2026-03-25T08:00:00.000Z"
    );
}

#[test]
fn a_trend_is_a_line_with_its_interval_or_says_what_is_missing() {
    use kincal::release::{ScoredSession, trend};
    let scored: Vec<ScoredSession> = [(0.0, 0.10), (10.0, 0.12), (20.0, 0.13), (30.0, 0.16)]
        .map(|(day, rms_mm)| ScoredSession { day, rms_mm })
        .to_vec();
    let line = trend(&scored, Some(0.2));
    // by hand: Sxx = 500, Sxy = 0.95, residual variance 3.5e-5 with 2 degrees of freedom, t = 4.30265
    let near = |found: Option<f64>, expected: f64| {
        assert!(
            (found.unwrap() - expected).abs() < 1e-6 * expected.abs().max(1.0),
            "{found:?} {expected}"
        )
    };
    near(line.rms_mm_per_day, 0.0019);
    near(
        line.interval_95.map(|i| i[0]),
        0.0019 - 4.302_653 * (3.5e-5_f64 / 500.0).sqrt(),
    );
    near(line.days_to_limit, (0.2 - 0.156) / 0.0019);
    assert!(line.detail.contains("23 days"), "{}", line.detail);
    // The sessions differ by noise alone.
    let flat: Vec<ScoredSession> = [(0.0, 0.10), (10.0, 0.12), (20.0, 0.09), (30.0, 0.11)]
        .map(|(day, rms_mm)| ScoredSession { day, rms_mm })
        .to_vec();
    assert_eq!(trend(&flat, Some(0.2)).days_to_limit, None);
    assert!(
        trend(&scored[..3], Some(0.2))
            .detail
            .starts_with("not enough data: 3 sessions")
    );
    assert!(trend(&[], None).detail.starts_with("not enough data"));
    let over: Vec<ScoredSession> = scored
        .iter()
        .map(|s| ScoredSession {
            rms_mm: s.rms_mm + 0.1,
            ..*s
        })
        .collect();
    assert!(trend(&over, Some(0.2)).detail.contains("calibrate now"));
}

#[tokio::test]
async fn after_a_collision_only_what_is_named_is_identified_anew() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.identified().await;
    let set = app.upload(&robot, "followup_collision.csv").await;
    let named = ["theta_offset_2", "theta_offset_3", "a_3"];
    let partial = |rest: &str, id: Option<&str>| {
        let mut request = json!({"measurement_set_id": set, "method": "least_squares", "parameters": {"identify": named, "rest": rest}});
        if let Some(id) = id {
            request["parameter_set_id"] = json!(id);
        }
        request
    };
    let refused = app
        .post_json(&format!("{robot}/jobs"), &partial("parameter_set", None))
        .await
        .problem(422, "invalid_job");
    assert_eq!(refused["errors"][0]["pointer"], "/parameters/rest");
    let before = text(&first["parameter_set_id"]);
    let job = app
        .run(&robot, &partial("parameter_set", Some(before)))
        .await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let links = async |id: &str| {
        app.get(&format!("/v1/parameter-sets/{id}")).await.ok(200)["links"].clone()
    };
    let (old, new) = (
        links(before).await,
        links(text(&job["parameter_set_id"])).await,
    );
    for (i, (old, new)) in old
        .as_array()
        .unwrap()
        .iter()
        .zip(new.as_array().unwrap())
        .enumerate()
    {
        for name in ["a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "beta_deg"] {
            let is_named =
                (i == 1 || i == 2) && name == "theta_offset_deg" || i == 2 && name == "a_mm";
            let change = (old[name].as_f64().unwrap() - new[name].as_f64().unwrap()).abs();
            assert!(is_named || change < 1e-12, "{name}_{}: {change}", i + 1);
        }
    }
    let report = app.report(&job).await;
    // Base and target are identified together with the named parameters.
    let parameters = report["parameters"].as_array().unwrap();
    let parameters: Vec<_> = parameters
        .iter()
        .filter(|p| p["link"].is_number())
        .collect();
    assert_eq!(parameters.len(), 3);
    assert!(
        parameters.iter().all(|p| p["std_uncertainty"].is_number()),
        "{parameters:?}"
    );
    // "before" is the set that it began with, and the page says so
    let page = format!("/v1/jobs/{}/report.html", text(&job["id"]));
    let page = app.get(&page).await.text();
    assert!(
        page.contains("Before: the held parameter set.")
            && page.contains("before (the held parameter set)"),
        "{page}"
    );
    let nominal = app.run(&robot, &partial("nominal", None)).await;
    let from_nominal = app.report(&nominal).await;
    let rms = |report: &serde_json::Value| report["verify"]["after"]["rms_mm"].as_f64().unwrap();
    assert!(
        rms(&report) < rms(&from_nominal),
        "{} {}",
        rms(&report),
        rms(&from_nominal)
    );
}

/// Whoever changes a report outside the service does not change these answers: they do not read it.
#[tokio::test]
async fn history_gates_and_export_read_a_reports_summary_and_not_the_report() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let answers = async || {
        let mut answers = Vec::new();
        for path in [
            format!("{robot}/history"),
            format!("{set}/gates"),
            format!("{set}/export"),
        ] {
            answers.push(app.get(&path).await.ok(200));
        }
        answers
    };
    let before = answers().await;
    for sql in [
        "drop trigger job_report_stays",
        "update job set report_json = 'no report'",
    ] {
        let done = sqlx::query(sql).execute(app.server.store.readers()).await;
        done.unwrap();
    }
    assert_eq!(answers().await, before);
}
