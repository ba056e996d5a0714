use crate::app::{TestApp, paper};
use serde_json::{Value, json};

#[tokio::test]
async fn a_plan_keeps_to_the_limits_and_adds_to_what_was_measured() {
    let app = TestApp::spawn().await;
    let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    for (link, limit) in body["links"]
        .as_array_mut()
        .unwrap()
        .iter_mut()
        .zip([170.0, 80.0, 90.0, 180.0, 115.0, 300.0])
    {
        link["joint_limits_deg"] = json!([-limit, limit]);
    }
    let robot = app.post_json("/v1/robots", &body).await.ok(201);
    let path = format!("/v1/robots/{}", robot["id"].as_str().unwrap());
    let request = json!({"n_configurations": 12, "seed": 4, "n_candidates": 500, "floor_z_mm": 0, "base_cylinder": {"radius_mm": 200, "height_mm": 500}});
    let plan = app.post_json(&format!("{path}/pose-plans"), &request).await;
    let (bytes, plan) = (plan.bytes.clone(), plan.ok(200));
    assert_eq!(plan["configurations"].as_array().unwrap().len(), 12);
    let mut repeating = request.clone();
    repeating["n_repeats"] = json!(2);
    let repeating = app
        .post_json(&format!("{path}/pose-plans"), &repeating)
        .await
        .ok(200);
    assert_eq!(repeating["configurations"][10]["repeats"], 0);
    assert_eq!(
        repeating["configurations"][11]["q_deg"],
        repeating["configurations"][1]["q_deg"]
    );
    for configuration in plan["configurations"].as_array().unwrap() {
        for (q, link) in configuration["q_deg"]
            .as_array()
            .unwrap()
            .iter()
            .zip(body["links"].as_array().unwrap())
        {
            assert!(q.as_f64().unwrap().abs() <= link["joint_limits_deg"][1].as_f64().unwrap());
        }
    }
    let std = |plan: &Value, of: &str| plan[of]["mean"].as_f64().unwrap();
    assert!(std(&plan, "predicted_std_mm") < std(&plan, "predicted_std_mm_random"));
    assert!(plan["observability_index_o1"].as_f64().unwrap() > 0.0);
    assert_eq!(
        bytes,
        app.post_json(&format!("{path}/pose-plans"), &request)
            .await
            .bytes,
        "the same request, the same bytes"
    );
    let set = app.upload(&path, "first.csv").await;
    let mut more = request.clone();
    more["measured"] = json!([set]);
    let after = app
        .post_json(&format!("{path}/pose-plans"), &more)
        .await
        .ok(200);
    assert!(std(&after, "predicted_std_mm") < std(&plan, "predicted_std_mm"));
}

#[tokio::test]
async fn a_plan_that_cannot_be_is_refused() {
    let app = TestApp::spawn().await;
    let path = format!("{}/pose-plans", app.paper_robot().await);
    for (body, code, pointer) in [
        (
            json!({"n_configurations": 0}),
            "invalid_plan",
            "/n_configurations",
        ),
        (
            json!({"n_configurations": 301}),
            "invalid_plan",
            "/n_configurations",
        ),
        (
            json!({"n_configurations": 10, "n_repeats": 6}),
            "invalid_plan",
            "/n_repeats",
        ),
        (
            json!({"n_configurations": 10, "noise_std_mm": 0}),
            "invalid_plan",
            "/noise_std_mm",
        ),
        (
            json!({"n_configurations": 10, "boxes": [{"min_mm": [0, 0, 0], "max_mm": [1, 0, 1]}]}),
            "invalid_plan",
            "/boxes/0",
        ),
        (
            json!({"n_configurations": 10, "n_candidates": 100, "boxes": [{"min_mm": [9000, 0, 0], "max_mm": [9001, 1, 1]}]}),
            "too_little_room",
            "/boxes",
        ),
        (
            json!({"n_configurations": 10, "kind": "pose", "model": "paper"}),
            "invalid_plan",
            "/kind",
        ),
        (
            json!({"n_configurations": 10, "kind": "pose", "n_candidates": 25_001}),
            "invalid_plan",
            "/n_candidates",
        ),
        (
            json!({"n_configurations": 10, "target_axis": [0, 0, 1]}),
            "invalid_plan",
            "/target_axis",
        ),
        (
            json!({"n_configurations": 10, "instrument_mm": [3000, 0, 1000], "target_axis": [0, 0, 0.0]}),
            "invalid_plan",
            "/target_axis",
        ),
        (
            json!({"n_configurations": 10, "target_half_angle_deg": 20}),
            "invalid_plan",
            "/target_half_angle_deg",
        ),
        (
            json!({"n_configurations": 10, "set_ups": [{"name": "A"}, {"name": "B"}]}),
            "invalid_plan",
            "/set_ups",
        ),
        (
            json!({"n_configurations": 12, "set_ups": [{"name": "A"}, {"name": "A"}]}),
            "invalid_plan",
            "/set_ups/1/name",
        ),
        (
            json!({"n_configurations": 12, "instrument_mm": [3000, 0, 1000], "set_ups": [{"name": "A"}, {"name": "B"}]}),
            "invalid_plan",
            "/instrument_mm",
        ),
        (
            json!({"n_configurations": 12, "keep_out": [{"min_mm": [0, 0, 0], "max_mm": [1, 0, 1]}]}),
            "invalid_plan",
            "/keep_out/0",
        ),
        (
            json!({"n_configurations": 12, "n_candidates": 100, "keep_out": [{"min_mm": [-5000, -5000, -5000], "max_mm": [5000, 5000, 5000]}]}),
            "too_little_room",
            "/boxes",
        ),
        (
            json!({"n_configurations": 12, "n_candidates": 100, "set_ups": [{"name": "A"}, {"name": "B", "boxes": [{"min_mm": [9000, 0, 0], "max_mm": [9001, 1, 1]}]}]}),
            "too_little_room",
            "/set_ups/1",
        ),
        (
            json!({"n_configurations": 10, "measured": ["set_1"]}),
            "unknown_reference",
            "/measured/0",
        ),
        (
            json!({"n_configurations": 10, "measured": ["set_\u{0}1"]}),
            "unknown_reference",
            "/measured/0",
        ),
        (
            json!({"n_configurations": 10, "poses": 3}),
            "invalid_body",
            "/poses",
        ),
    ] {
        let problem = app.post_json(&path, &body).await.problem(422, code);
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
    }
}

#[tokio::test]
async fn set_ups_share_the_configurations_and_boxes_are_kept_out_of() {
    let app = TestApp::spawn().await;
    let path = app.paper_robot().await;
    let request = json!({
        "n_configurations": 25, "n_candidates": 1000, "kind": "pose", "floor_z_mm": 0,
        "keep_out": [{"min_mm": [800, -400, 0], "max_mm": [1200, 400, 1200]}],
        "target_axis": [0, 0, 1], "target_half_angle_deg": 60,
        "set_ups": [{"name": "left", "instrument_mm": [2500, 2000, 1000]}, {"name": "right", "instrument_mm": [2500, -2000, 1000]}],
    });
    let plan = app
        .post_json(&format!("{path}/pose-plans"), &request)
        .await
        .ok(200);
    let names: Vec<&str> = plan["configurations"]
        .as_array()
        .unwrap()
        .iter()
        .map(|configuration| configuration["set_up"].as_str().unwrap())
        .collect();
    assert_eq!(names.len(), 25);
    assert_eq!(names[..13], ["left"; 13]);
    assert_eq!(names[13..], ["right"; 12]);
    let set_ups = plan["set_ups"].as_array().unwrap();
    assert_eq!(
        (
            &set_ups[0]["n_configurations"],
            &set_ups[1]["n_configurations"]
        ),
        (&json!(13), &json!(12))
    );
    for value in ["mean", "max"] {
        let of = |of: &Value| of["predicted_std_mm"][value].as_f64().unwrap();
        assert_eq!(
            of(&plan),
            of(&set_ups[0]).max(of(&set_ups[1])),
            "the larger {value} counts"
        );
    }
    // 17 different positions can be identified from, but not from half of them; 24 poses can.
    assert!(plan.get("warnings").is_none(), "{}", plan["warnings"]);
    for (n, remedy) in [
        // one number: with 9 poses a job would be refused, because it holds out half of them
        (5, "measure 18 or more, or hold parameters"),
        (14, "measure 18 or more"),
        (14, "a verify fraction of at most 0.35"),
    ] {
        let few = json!({"n_configurations": n, "n_candidates": 500});
        let few = app
            .post_json(&format!("{path}/pose-plans"), &few)
            .await
            .ok(200);
        assert_eq!(few["warnings"][0]["code"], "under_determined", "{few}");
        let detail = few["warnings"][0]["detail"].as_str().unwrap();
        assert!(detail.contains(remedy), "{detail}");
    }
    // A single place is no set-up.
    let one =
        json!({"n_configurations": 20, "n_candidates": 500, "instrument_mm": [2500, 0, 1000]});
    let one = app
        .post_json(&format!("{path}/pose-plans"), &one)
        .await
        .ok(200);
    assert!(one.get("set_ups").is_none());
    assert!(one["configurations"][0].get("set_up").is_none());
}
