//! Work frames and tools of a robot, and Cartesian targets in them.

use crate::api::compensate::parameter_set;
use crate::app::{TestApp, text};
use kincal::wire::compensate::CompensateAnswer;
use reqwest::Method;
use serde_json::{Value, json};

async fn put(app: &TestApp, path: &str, body: &Value) -> crate::app::Answer {
    let request = app
        .request(Method::PUT, path)
        .header("content-type", "application/json")
        .body(body.to_string());
    crate::app::Answer::of(request).await
}

fn mm(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|k| value[k].as_f64().unwrap())
}

fn apart(a: &Value, b: &Value) -> f64 {
    let (a, b) = (mm(a), mm(b));
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

#[tokio::test]
async fn cartesian_targets_in_a_work_frame_are_corrected_with_a_named_tool() {
    let app = TestApp::with_workers(1).await;
    let set = parameter_set(&app).await;
    let robot = app.get(&set).await.ok(200)["robot_id"].clone();
    let robot = format!("/v1/robots/{}", text(&robot));
    let q = [10.0, -30.0, 20.0, 15.0, 40.0, 5.0];
    // where the nominal robot has a tool at these joint values: an oracle that does not correct anything
    let tool = json!({"translation_mm": [10.0, 20.0, 150.0], "quaternion": [0.9689124217106447, 0.0, 0.24740395925452294, 0.0]});
    let path = format!("{robot}/posture");
    let posture = app
        .post_json(&path, &json!({"q_deg": q, "tool": tool}))
        .await
        .ok(200);
    let path = format!("{robot}/tools/gripper%201");
    let stored = put(&app, &path, &tool).await.ok(200);
    assert_eq!(stored["name"], "gripper 1");
    assert_eq!(app.get(&path).await.ok(200), stored);
    // a fixture whose origin is at 500, 0, 300, turned by 90° about z; its points are measured without noise
    let path = format!("{robot}/work-frames/fixture");
    let point =
        |x: f64, y: f64| json!({"nominal_mm": [x, y, 0.0], "measured_mm": [500.0 - y, x, 300.0]});
    let body =
        json!({"points": [point(0.0, 0.0), point(200.0, 0.0), point(0.0, 100.0)], "std_mm": 0.02});
    let frame = put(&app, &path, &body).await.ok(200);
    assert!(frame["rms_mm"].as_f64().unwrap() < 1e-9, "{frame}");
    assert!(
        apart(
            &frame["t_reference_work"]["translation_mm"],
            &json!([500.0, 0.0, 300.0])
        ) < 1e-9
    );
    assert!(
        (0.02..0.06).contains(&frame["origin_std_mm"].as_f64().unwrap()),
        "{frame}"
    );
    for list in ["work-frames", "tools"] {
        let found = app.get(&format!("{robot}/{list}")).await.ok(200);
        assert_eq!(
            (&found["total"], found["items"].as_array().unwrap().len()),
            (&json!(1), 1)
        );
    }
    let near: Vec<f64> = q.iter().map(|q| q + 4.0).collect();
    let correct = async |frame: &str, position: [f64; 3], quaternion: &Value| {
        let target = json!({"position_mm": position, "quaternion": quaternion, "q_near_deg": near});
        let body =
            json!({"targets": [target], "frame": frame, "tool_name": "gripper 1", "base": "robot"});
        app.post_json(&format!("{set}/compensate"), &body)
            .await
            .ok(200)
    };
    let joints = json!({"q_deg": [q], "tool": tool, "base": "robot"});
    let by_joints = app
        .post_json(&format!("{set}/compensate"), &joints)
        .await
        .ok(200);
    let position = mm(&posture["position_mm"]);
    let in_base = correct("base", position, &posture["quaternion"]).await;
    for joint in 0..6 {
        let of = |answer: &Value| answer["q_deg"][0][joint].as_f64().unwrap();
        assert!(
            (of(&in_base) - of(&by_joints)).abs() < 1e-4,
            "{in_base} {by_joints}"
        );
    }
    assert_eq!(in_base["status"], json!(["ok"]));
    let std_mm = in_base["position_std_mm"][0].as_f64().unwrap();
    assert!(std_mm > 0.0 && std_mm < 1.0, "{in_base}");
    // the pose that a controller has to be given is what the nominal robot has at the corrected joint values
    let told = &in_base["poses"][0]["position_mm"];
    let body = json!({"q_deg": in_base["q_deg"][0], "tool": tool});
    let nominal = app
        .post_json(&format!("{robot}/posture"), &body)
        .await
        .ok(200);
    assert!(apart(told, &nominal["position_mm"]) < 1e-6);
    assert!(apart(told, &posture["position_mm"]) > 0.05, "corrected");
    let codes = in_base["warnings"].as_array().unwrap().iter();
    let codes: Vec<&str> = codes.map(|told| text(&told["code"])).collect();
    assert_eq!(codes, ["pose_not_seen"]);
    far_from_near_joint_values_is_told(&app, &set, &posture, q).await;
    // the same target in the work frame: x there is y of the base
    let in_work = [position[1], 500.0 - position[0], position[2] - 300.0];
    // Rz(90°)⁻¹ · q: quaternion product with (√½, 0, 0, −√½)
    let half = 0.5f64.sqrt();
    let [w, x, y, z] = [0, 1, 2, 3].map(|k| posture["quaternion"][k].as_f64().unwrap());
    let turned = json!([
        half * (w + z),
        half * (x + y),
        half * (y - x),
        half * (z - w)
    ]);
    let by_frame = correct("fixture", in_work, &turned).await;
    for joint in 0..6 {
        let of = |answer: &Value| answer["q_deg"][0][joint].as_f64().unwrap();
        assert!((of(&by_frame) - of(&in_base)).abs() < 1e-4, "{by_frame}");
    }
    // its own uncertainty counts
    assert!(by_frame["position_std_mm"][0].as_f64().unwrap() > std_mm);
    // a new frame of the same name takes the place of the old one
    let typed = json!({"translation_mm": [0.0, 0.0, 0.0]});
    put(&app, &path, &typed).await.ok(200);
    let moved = correct("fixture", position, &posture["quaternion"]).await;
    assert!(apart(&moved["poses"][0]["position_mm"], told) < 1e-6);
}

/// A target near its joint values, and one whose last joint has to turn by 120°.
async fn far_from_near_joint_values_is_told(
    app: &TestApp,
    set: &str,
    posture: &Value,
    q_deg: [f64; 6],
) {
    let mut far = q_deg;
    far[5] += 120.0;
    let target = |near: [f64; 6]| json!({"position_mm": posture["position_mm"], "quaternion": posture["quaternion"], "q_near_deg": near});
    let body =
        json!({"targets": [target(q_deg), target(far)], "tool_name": "gripper 1", "base": "robot"});
    let path = format!("{set}/compensate");
    let answer = app.post_json(&path, &body).await.ok(200);
    let part: CompensateAnswer = serde_json::from_value(answer).unwrap();
    let far_rows = |answer: &CompensateAnswer| {
        let told = answer.warnings.iter();
        let mut told = told.filter(|told| told.code == "far_from_q_near");
        let rows = told.next().unwrap().rows.clone();
        assert!(told.next().is_none());
        rows
    };
    assert_eq!(far_rows(&part), [1]);
    // of a program in two parts
    let mut whole = part.clone();
    whole.extend(part);
    assert_eq!(far_rows(&whole), [1, 3]);
}

/// The fixture of an outside tester.
#[tokio::test]
async fn a_work_frame_whose_points_do_not_fit_is_refused() {
    let app = TestApp::with_workers(1).await;
    let set = parameter_set(&app).await;
    let robot = app.get(&set).await.ok(200)["robot_id"].clone();
    let path = format!("/v1/robots/{}/work-frames/fixture", text(&robot));
    let drawn = [
        [0.0, 0.0, 0.0],
        [200.0, 0.0, 0.0],
        [0.0, 150.0, 0.0],
        [100.0, 100.0, 50.0],
    ];
    // turned by 90° about z
    let measured = |[x, y, z]: [f64; 3]| [800.0 - y, x - 300.0, z + 150.0];
    let body = |nominal: &dyn Fn([f64; 3]) -> [f64; 3], order: [usize; 4]| {
        let point = |k: usize| json!({"nominal_mm": nominal(drawn[k]), "measured_mm": measured(drawn[order[k]])});
        let points = [0, 1, 2, 3].map(point);
        json!({"points": points, "std_mm": 0.05})
    };
    for (wrong, said) in [
        (
            body(&|p| p, [1, 0, 2, 3]),
            "points 0 and 1 exchanged (0 is the first)",
        ),
        (
            body(&|[x, y, z]| [x, y, -z], [0, 1, 2, 3]),
            "one axis of the drawing mirrored",
        ),
        (
            body(&|p| p.map(|x| x / 25.4), [0, 1, 2, 3]),
            "the drawing read in inches",
        ),
    ] {
        let answer = put(&app, &path, &wrong).await;
        let problem = answer.problem(422, "work_frame_does_not_fit");
        let issue = &problem["errors"][0];
        assert_eq!(issue["pointer"], "/points", "{problem}");
        let detail = text(&issue["detail"]);
        println!("{detail}");
        assert!(detail.contains(said), "{detail}");
    }
    app.get(&path).await.problem(404, "not_found");
    put(&app, &path, &body(&|p| p, [0, 1, 2, 3])).await.ok(200);
}

#[tokio::test]
async fn predictions_carry_a_standard_uncertainty() {
    let app = TestApp::with_workers(1).await;
    let set = parameter_set(&app).await;
    let body = json!({"q_deg": [[10.0, -30.0, 20.0, 15.0, 40.0, 5.0]]});
    let answer = app
        .post_json(&format!("{set}/predict"), &body)
        .await
        .ok(200);
    let std_mm = answer["position_std_mm"][0].as_f64().unwrap();
    assert!(std_mm > 0.0 && std_mm < 1.0, "{answer}");
}

#[tokio::test]
async fn faults_of_frames_tools_and_cartesian_targets_are_told_with_their_place() {
    let app = TestApp::with_workers(1).await;
    let set = parameter_set(&app).await;
    let robot = app.get(&set).await.ok(200)["robot_id"].clone();
    let robot = format!("/v1/robots/{}", text(&robot));
    let point = |x: f64| json!({"nominal_mm": [x, 0.0, 0.0], "measured_mm": [x, 0.0, 0.0]});
    for (body, pointer, code) in [
        (json!({}), "", "no_frame"),
        (
            json!({"points": [point(0.0), point(1.0)]}),
            "/points",
            "points_give_no_frame",
        ),
        (
            json!({"points": [point(0.0), point(1.0), point(2.0)]}),
            "/points",
            "points_give_no_frame",
        ),
        (
            json!({"translation_mm": [0, 0, 0], "quaternion": [1, 1, 0, 0]}),
            "/quaternion",
            "quaternion_not_normalised",
        ),
        (
            json!({"translation_mm": [0, 0, 0], "points": [point(0.0)]}),
            "/points",
            "typed_and_measured",
        ),
        (
            json!({"translation_mm": [0, 0, 0], "reference": "measuring"}),
            "/measurement_set_id",
            "missing",
        ),
    ] {
        let problem = put(&app, &format!("{robot}/work-frames/f"), &body)
            .await
            .problem(
                422,
                if pointer == "/points" && code == "points_give_no_frame" {
                    code
                } else {
                    "invalid_work_frame"
                },
            );
        assert_eq!(problem["errors"][0]["code"], code, "{problem}");
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
    }
    for name in ["base", "measuring", "%20x"] {
        let path = format!("{robot}/work-frames/{name}");
        put(&app, &path, &json!({"translation_mm": [0, 0, 0]}))
            .await
            .problem(422, "invalid_name");
    }
    let target = json!({"position_mm": [500, 0, 500], "q_near_deg": [0, 0, 0, 0, 30, 0]});
    for (body, status, code) in [
        (
            json!({"targets": [target], "tool_name": "none", "mode": "position"}),
            422,
            "unknown_reference",
        ),
        (
            json!({"targets": [target], "frame": "none", "mode": "position"}),
            422,
            "unknown_reference",
        ),
        (json!({"targets": [target]}), 422, "invalid_poses"),
        (
            json!({"targets": [target], "q_deg": [[0, 0, 0, 0, 0, 0]], "mode": "position"}),
            422,
            "invalid_poses",
        ),
        (
            json!({"q_deg": [[0, 0, 0, 0, 0, 0]], "frame": "base"}),
            422,
            "invalid_poses",
        ),
    ] {
        app.post_json(&format!("{set}/compensate"), &body)
            .await
            .problem(status, code);
    }
}

#[tokio::test]
async fn a_work_frame_is_measured_from_the_station_of_the_parameters() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let table = String::from_utf8(crate::app::paper("first.csv")).unwrap();
    let stations = |n: usize| {
        let mut lines = table.lines().enumerate();
        let (_, header) = lines.next().unwrap();
        lines.fold(format!("{header},station\n"), |text, (i, line)| {
            format!("{text}{line},{}\n", ["left", "right"][usize::from(i > n)])
        })
    };
    let path = format!("{robot}/measurement-sets?frame=instrument");
    let set = app.post(&path, "text/csv", stations(60)).await.ok(201);
    let path = format!("{robot}/work-frames/table");
    let typed = |more: Value| {
        let mut body = json!({"reference": "measuring", "measurement_set_id": set["id"], "translation_mm": [1.0, 2.0, 3.0]});
        for (field, value) in more.as_object().unwrap() {
            body[field] = value.clone();
        }
        body
    };
    for station in [json!({}), json!({"station": "left"})] {
        let refused = put(&app, &path, &typed(station))
            .await
            .problem(422, "other_station");
        let issue = &refused["errors"][0];
        assert_eq!(issue["pointer"], "/station");
        assert!(
            text(&issue["detail"]).contains("station: \"right\""),
            "{issue}"
        );
    }
    put(&app, &path, &typed(json!({"station": "right"})))
        .await
        .ok(200);
    for (unknown, code) in [
        ("set_0", "unknown_reference"),
        ("no id\0", "invalid_work_frame"),
    ] {
        let refused = put(&app, &path, &typed(json!({"measurement_set_id": unknown})))
            .await
            .problem(422, code);
        assert_eq!(refused["errors"][0]["pointer"], "/measurement_set_id");
    }
    // the instrument came back to its first place: the base is that of the last point
    let back: String = stations(60)
        .lines()
        .enumerate()
        .map(|(i, line)| match i > 90 {
            true => format!("{}\n", line.replace("right", "left")),
            false => format!("{line}\n"),
        })
        .collect();
    let sets = format!("{robot}/measurement-sets?frame=instrument");
    let back = app.post(&sets, "text/csv", back).await.ok(201);
    for (station, status) in [("left", 200), ("right", 422)] {
        let body = json!({"reference": "measuring", "measurement_set_id": back["id"], "translation_mm": [1.0, 2.0, 3.0], "station": station});
        assert_eq!(put(&app, &path, &body).await.status, status, "{station}");
    }
    // the uncertainty of a typed frame would be passed over in silence
    let refused = put(
        &app,
        &path,
        &json!({"translation_mm": [1.0, 2.0, 3.0], "std_mm": 0.5}),
    )
    .await
    .problem(422, "mixed_kinds");
    assert_eq!(refused["errors"][0]["pointer"], "/std_mm");
}
