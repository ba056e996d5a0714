//! References: lengths with a certificate that the instrument measured.

use crate::api::sessions::{codes, csv, failed_gates, rows, with_noise};
use crate::app::{TestApp, text};
use crate::simulation::Normal;
use serde_json::{Value, json};

/// The scale bar of 2 m, measured `error` too long.
fn scale_bar(error: f64) -> Value {
    json!({"name": "bar", "instrument": "AT960, certificate 4711", "items": [
        {"name": "2 m", "nominal_mm": 2000.0, "measured_mm": 2000.0 * (1.0 + error), "std_mm": 0.01},
        {"name": "1 m", "nominal_mm": 1000.0, "measured_mm": 1000.0 * (1.0 + error), "std_mm": 0.01},
    ]})
}

async fn report_with(app: &TestApp, robot: &str, reference: &str) -> Value {
    let mut random = Normal::new(41);
    let points = csv(&with_noise(&rows("first.csv"), 0.03, &mut random));
    let path = format!("{robot}/measurement-sets?frame=base{reference}");
    let set = app.post(&path, "text/csv", points).await.ok(201);
    let request = json!({"measurement_set_id": set["id"], "method": "least_squares"});
    let job = app.run(robot, &request).await;
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    app.get(&path).await.ok(200)
}

#[tokio::test]
async fn a_reference_states_the_scale_of_the_instrument_and_counts_in_the_budget() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let path = format!("{robot}/references");
    let stored = app.post_json(&path, &scale_bar(2e-6)).await.ok(201);
    // by hand: the weights of both lengths are as their squares, 1/√(2000² + 1000²) · 0.01
    let std_ppm = 1e6 * 0.01 / 5e6_f64.sqrt();
    let ppm = |answer: &Value, field: &str| answer[field].as_f64().unwrap();
    assert!(
        (ppm(&stored, "scale_error_ppm") - 2.0).abs() < 1e-3,
        "{stored}"
    );
    assert!(
        (ppm(&stored, "scale_std_ppm") - std_ppm).abs() < 1e-6,
        "{stored}"
    );
    assert_eq!(
        (&stored["is_off"], &stored["version"]),
        (&json!(false), &json!(1))
    );
    // a length of another bar
    let mut mixed = scale_bar(2e-6);
    mixed["items"][1]["measured_mm"] = json!(1000.4);
    let refused = app
        .post_json(&path, &mixed)
        .await
        .problem(422, "contradictory_lengths");
    let issue = &refused["errors"][0];
    assert_eq!(
        (&issue["code"], &issue["pointer"]),
        (
            &json!("contradictory_lengths"),
            &json!("/items/1/measured_mm")
        )
    );
    // so short that the scale would be no number
    let short = json!({"items": [{"name": "0", "nominal_mm": 5e-324, "measured_mm": 5e-324, "std_mm": 1e-6}]});
    let refused = app.post_json(&path, &short).await;
    let refused = refused.problem(422, "invalid_reference");
    assert_eq!(refused["errors"][0]["pointer"], "/items/0/nominal_mm");
    let plain = report_with(&app, &robot, "").await;
    assert!(plain["reference"].is_null());
    let report = report_with(&app, &robot, "&reference=bar").await;
    let reference = &report["reference"];
    let at_reach_mm = ppm(reference, "at_reach_std_mm");
    let of_both = 2.0_f64.hypot(std_ppm) * 1e-6;
    assert!(
        at_reach_mm > 1500.0 * of_both && at_reach_mm < 4000.0 * of_both,
        "{reference}"
    );
    let tool = |report: &Value| report["tool_uncertainty_mm"]["max"].as_f64().unwrap();
    assert!((tool(&report) - tool(&plain).hypot(at_reach_mm)).abs() < 1e-9);
    assert!(!codes(&report).contains(&"instrument_scale"));
    // an instrument that is off is told
    let off = app.post_json(&path, &scale_bar(40e-6)).await.ok(201);
    assert_eq!((&off["is_off"], &off["version"]), (&json!(true), &json!(2)));
    let report = report_with(&app, &robot, "&reference=bar").await;
    assert!(codes(&report).contains(&"instrument_scale"), "{report}");
    // 2 mm at the arm's reach: such a set is not released, and whoever uses it is told
    app.post_json(&path, &scale_bar(1000e-6)).await.ok(201);
    let report = report_with(&app, &robot, "&reference=bar").await;
    let job = app
        .get(&format!("/v1/jobs/{}", text(&report["job_id"])))
        .await
        .ok(200);
    // the upload told it already, and no further pose would mend it
    let uploaded = format!("/v1/measurement-sets/{}", text(&job["measurement_set_id"]));
    let uploaded = app.get(&uploaded).await.ok(200);
    assert!(codes(&uploaded).contains(&"instrument_scale"), "{uploaded}");
    assert!(!codes(&report).contains(&"tool_uncertain"), "{report}");
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    app.post_json(&format!("{set}/release"), &json!({"reason": "it fits"}))
        .await
        .problem(409, "release_refused");
    let (failed, _) = failed_gates(&app, &job["parameter_set_id"]).await;
    assert_eq!(failed, ["instrument_scale"]);
    let corrected = app
        .post_json(
            &format!("{set}/compensate"),
            &json!({"q_deg": [[10.0, -30.0, 20.0, 15.0, 40.0, 5.0]], "mode": "position"}),
        )
        .await
        .ok(200);
    assert!(
        codes(&corrected).contains(&"instrument_scale"),
        "{corrected}"
    );
    // lists have the newest version; each version stays under its id
    let listed = app.get(&path).await.ok(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 1);
    assert_eq!(listed["items"][0]["version"], 3);
    let first = format!("{path}/{}", text(&stored["id"]));
    assert_eq!(app.get(&first).await.ok(200), stored);
}

#[tokio::test]
async fn what_is_no_reference_is_refused_with_its_place() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let path = format!("{robot}/references");
    let item = |nominal: f64, measured: f64, std: f64| json!({"items": [{"name": "a", "nominal_mm": nominal, "measured_mm": measured, "std_mm": std}]});
    for (body, at, code) in [
        (json!({"items": []}), "/items", "out_of_range"),
        (item(-1.0, 1.0, 0.01), "/items/0/nominal_mm", "out_of_range"),
        (
            item(1000.0, 1.0, 0.01),
            "/items/0/measured_mm",
            "implausible_length",
        ),
        (item(1000.0, 1000.0, 0.0), "/items/0/std_mm", "out_of_range"),
    ] {
        let refused = app.post_json(&path, &body).await;
        let problem = refused.problem(422, "invalid_reference");
        assert_eq!(
            (
                text(&problem["errors"][0]["pointer"]),
                text(&problem["errors"][0]["code"])
            ),
            (at, code)
        );
    }
    let upload = format!("{robot}/measurement-sets?frame=base&reference=unknown");
    let points = csv(&rows("first.csv"));
    app.post(&upload, "text/csv", points)
        .await
        .problem(422, "unknown_reference");
    app.get(&format!("{path}/ref_0"))
        .await
        .problem(404, "not_found");
    let id = text(&app.post_json(&path, &scale_bar(0.0)).await.ok(201)["id"]).to_owned();
    let other = app.paper_robot().await;
    app.get(&format!("{other}/references/{id}"))
        .await
        .problem(404, "not_found");
}
