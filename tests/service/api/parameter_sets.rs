use crate::app::{Answer, TestApp, paper, text};
use kincal::kinematics::forward::t_base_flange;
use kincal::wire::robot::{Robot, RobotBody};
use nalgebra::Vector3;
use reqwest::Method;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

#[tokio::test]
async fn a_parameter_set_says_what_the_controller_needs() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let set = app.parameter_set(&job).await;
    assert_eq!(
        (&set["status"], &set["job_id"]),
        (&json!("candidate"), &job["id"])
    );
    assert_eq!(set["links"].as_array().unwrap().len(), 6);
    // Positions in the base frame: the base is where the file states it, within its prior.
    let base = &set["t_instrument_base"];
    for row in 0..3 {
        for column in 0..3 {
            let expected = f64::from(u8::from(row == column));
            let found = base["rotation"][row][column].as_f64().unwrap();
            assert!((found - expected).abs() < 1e-3, "{base}");
        }
        assert!(
            base["translation_mm"][row].as_f64().unwrap().abs() < 1.0,
            "{base}"
        );
    }
    assert_eq!(
        app.get(&format!("{robot}/parameter-sets")).await.ok(200)["items"],
        json!([set])
    );
    app.get("/v1/parameter-sets/par_0")
        .await
        .problem(404, "not_found");
}

/// RFC 8785 for this content, written independently: keys in order, numbers as ECMAScript prints them.
fn canonical(value: &Value) -> String {
    match value {
        Value::Object(map) => {
            let entries: std::collections::BTreeMap<_, _> = map.iter().collect();
            let entries: Vec<String> = entries
                .iter()
                .map(|(key, value)| format!("\"{key}\":{}", canonical(value)))
                .collect();
            format!("{{{}}}", entries.join(","))
        }
        Value::Array(items) => format!(
            "[{}]",
            items.iter().map(canonical).collect::<Vec<_>>().join(",")
        ),
        Value::Number(number) => {
            let number = number.as_f64().unwrap();
            let (plain, scientific) = (number.to_string(), format!("{number:e}"));
            let exponent: i32 = scientific.split_once('e').unwrap().1.parse().unwrap();
            match exponent {
                _ if number == 0.0 => "0".into(),
                -6..=20 => plain,
                _ => scientific
                    .replace("e-", "E-")
                    .replace('e', "e+")
                    .replace('E', "e"),
            }
        }
        other => other.to_string(),
    }
}

#[tokio::test]
async fn the_cell_pc_can_check_a_parameter_sets_hash() {
    let app = TestApp::with_workers(1).await;
    let (_, job) = app.identified().await;
    let set = app.parameter_set(&job).await;
    let content = json!({"links": set["links"], "t_instrument_base": set["t_instrument_base"], "targets": set["targets"]});
    let hash: String = Sha256::digest(canonical(&content))
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    assert_eq!(set["sha256"], hash);
    let covered = app
        .get(&format!("/v1/parameter-sets/{}/content", text(&set["id"])))
        .await;
    assert_eq!(covered.status, 200);
    assert_eq!(
        set["sha256"],
        kincal::wire::canonical::hex(&Sha256::digest(&covered.bytes)),
        "the bytes as they came"
    );
    assert_eq!(covered.text(), canonical(&content));
}

#[tokio::test]
async fn only_a_released_set_is_active_and_its_etag_saves_fetching_it_again() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let active = format!("{robot}/parameter-sets/active");
    app.get(&active)
        .await
        .problem(404, "no_active_parameter_set");
    let path = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let released = app
        .post_json(
            &format!("{path}/release"),
            &json!({"reason": "verified on the cell"}),
        )
        .await
        .ok(200);
    assert_eq!(released["status"], "released");
    assert!(released["released_at"].is_string());
    let answer = app.get(&active).await;
    assert_eq!(answer.ok(200), released);
    let etag = answer.header("etag").unwrap().to_owned();
    let again = Answer::of(
        app.request(Method::GET, &active)
            .header("if-none-match", &etag),
    )
    .await;
    assert_eq!(
        (again.status, again.bytes.len(), again.header("etag")),
        (304, 0, Some(etag.as_str()))
    );
    let withdrawn = app
        .post_json(
            &format!("{path}/withdraw"),
            &json!({"reason": "the tool was changed"}),
        )
        .await
        .ok(200);
    assert_eq!(withdrawn["status"], "withdrawn");
    app.get(&active)
        .await
        .problem(404, "no_active_parameter_set");
    let refused = app
        .post_json(&format!("{path}/release"), &json!({"reason": "again"}))
        .await
        .problem(409, "release_refused");
    assert_eq!(refused["errors"][0]["code"], "withdrawn");
}

#[tokio::test]
async fn releasing_another_set_supersedes_the_first_and_one_call_rolls_back() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.identified().await;
    let second = app
        .run(
            &robot,
            &json!({"measurement_set_id": first["measurement_set_id"], "method": "pso"}),
        )
        .await;
    let path = |job: &Value| format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let reason = json!({"reason": "better"});
    for (release, superseded) in [
        (&first, None),
        (&second, Some(&first)),
        (&first, Some(&second)),
    ] {
        app.post_json(&format!("{}/release", path(release)), &reason)
            .await
            .ok(200);
        assert_eq!(
            app.get(&format!("{robot}/parameter-sets/active"))
                .await
                .ok(200)["id"],
            release["parameter_set_id"]
        );
        if let Some(superseded) = superseded {
            assert_eq!(
                app.get(&path(superseded)).await.ok(200)["status"],
                "superseded"
            );
        }
    }
}

#[tokio::test]
async fn a_set_that_nobody_verified_is_not_released() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let all_identify = String::from_utf8(paper("first.csv"))
        .unwrap()
        .replace("verify", "identify");
    let set = app.upload_csv(&robot, "frame=base", all_identify).await;
    let job = app.run(&robot, &json!({"measurement_set_id": set["id"], "method": "least_squares", "verify": {"source": "subset"}})).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let report = app.report(&job).await;
    assert_eq!(
        (&report["verify"], &report["evidence"]),
        (&Value::Null, &json!("none"))
    );
    let path = format!(
        "/v1/parameter-sets/{}/release",
        text(&job["parameter_set_id"])
    );
    let refused = app
        .post_json(&path, &json!({"reason": "it looks good"}))
        .await
        .problem(409, "release_refused");
    let gates: Vec<&str> = refused["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|issue| text(&issue["code"]))
        .collect();
    assert_eq!(gates, ["verified", "verify_errors_improved"]);
    app.post_json(&path, &json!({"reason": ""}))
        .await
        .problem(422, "invalid_reason");
    app.post_json(&path, &json!({}))
        .await
        .problem(422, "invalid_body");
}

/// q and position of the paper's first rows.
fn first_rows(n: usize) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let text = String::from_utf8(paper("first.csv")).unwrap();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = |name: &str| header.iter().position(|column| *column == name).unwrap();
    let pick = |line: &str, names: &[&str]| {
        names
            .iter()
            .map(|name| line.split(',').nth(at(name)).unwrap().parse().unwrap())
            .collect()
    };
    let q = ["q1_deg", "q2_deg", "q3_deg", "q4_deg", "q5_deg", "q6_deg"];
    lines
        .take(n)
        .map(|line| (pick(line, &q), pick(line, &["x_mm", "y_mm", "z_mm"])))
        .unzip()
}

#[tokio::test]
async fn predictions_agree_with_what_was_measured() {
    let app = TestApp::with_workers(1).await;
    let (_, job) = app.identified().await;
    let path = format!(
        "/v1/parameter-sets/{}/predict",
        text(&job["parameter_set_id"])
    );
    let (q_deg, measured) = first_rows(20);
    let answer = app.post_json(&path, &json!({"q_deg": q_deg})).await.ok(200);
    assert_eq!(answer["extrapolated"], json!(vec![false; 20]));
    // The simulated set has no noise: what remains is the rounding of its printed positions.
    const PRINT_MM: f64 = 1e-5;
    for (row, measured) in measured.iter().enumerate() {
        for (axis, expected) in measured.iter().enumerate() {
            let predicted = answer["position_mm"][row][axis].as_f64().unwrap();
            assert!(
                (predicted - expected).abs() < PRINT_MM,
                "row {row}, axis {axis}: {predicted} and {expected}"
            );
        }
    }
    app.post_json(&path, &json!({"q_deg": [[0.0]]}))
        .await
        .problem(422, "invalid_poses");
    app.post_json(&path, &json!({"q_deg": q_deg, "target": 3}))
        .await
        .problem(422, "unknown_target");
    app.post(&path, "text/plain", "x")
        .await
        .problem(415, "unsupported_media_type");
    assert_eq!(
        app.post_json(&path, &json!({"q_deg": []})).await.ok(200)["position_mm"],
        json!([])
    );
}

#[tokio::test]
async fn after_a_slip_the_reflector_is_predicted_in_either_stretch() {
    let app = TestApp::with_workers(1).await;
    let robot: RobotBody = serde_json::from_slice(&paper("robot.json")).unwrap();
    let links = Robot::try_from(&robot).unwrap().links;
    let (q_deg, mut measured) = first_rows(100);
    // A shift of 2 mm in the flange frame before row 40; the nominal robot's flange rotation is accurate enough for that.
    const SLIP_ROW: usize = 40;
    let slip_mm = Vector3::new(1.2, -1.6, 0.0);
    let mut csv = String::from("subset,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n");
    for (row, (q, position)) in q_deg.iter().zip(&mut measured).enumerate() {
        let q_rad: Vec<f64> = q.iter().map(|deg| deg.to_radians()).collect();
        let moved = t_base_flange(&links, &q_rad).rotation * slip_mm;
        (0..3)
            .filter(|_| row >= SLIP_ROW)
            .for_each(|axis| position[axis] += moved[axis]);
        let subset = if row % 4 == 3 { "verify" } else { "identify" };
        let numbers: Vec<String> = q
            .iter()
            .chain(position.iter())
            .map(f64::to_string)
            .collect();
        csv += &format!("{subset},{}\n", numbers.join(","));
    }
    let robot = app.paper_robot().await;
    let set = app.upload_csv(&robot, "frame=instrument", csv).await;
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": set["id"], "corrections": "off"}),
        )
        .await;
    let report = app.report(&job).await;
    let moved = report["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .find(|w| w["code"] == "target_moved")
        .expect("the slip is named");
    assert_eq!(moved["rows"], json!([SLIP_ROW]), "{moved}");
    let path = format!(
        "/v1/parameter-sets/{}/predict",
        text(&job["parameter_set_id"])
    );
    let predicted =
        async |body: Value| app.post_json(&path, &body).await.ok(200)["position_mm"].clone();
    let (first, second) = (
        predicted(json!({"q_deg": q_deg, "segment": 0})).await,
        predicted(json!({"q_deg": q_deg, "segment": 1})).await,
    );
    assert_eq!(
        predicted(json!({"q_deg": q_deg})).await,
        second,
        "the last stretch is where the reflector is now"
    );
    for (row, position) in measured.iter().enumerate() {
        let (own, other) = if row < SLIP_ROW {
            (&first, &second)
        } else {
            (&second, &first)
        };
        let distance = |from: &Value| {
            (0..3)
                .map(|axis| (from[row][axis].as_f64().unwrap() - position[axis]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        assert!(
            distance(own) < 0.01 && distance(other) > 1.9,
            "row {row}: {} and {}",
            distance(own),
            distance(other)
        );
    }
    app.post_json(&path, &json!({"q_deg": q_deg, "segment": 2}))
        .await
        .problem(422, "unknown_target");
}

#[tokio::test]
async fn uploads_and_predictions_speak_the_controllers_joint_values() {
    let app = TestApp::with_workers(1).await;
    let mut robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    // The controller counts joint 3 backwards from the horizontal: its J3 is -(J2 + q3) and 10° off.
    let mut coupling = vec![vec![0.0; 6]; 6];
    (0..6).for_each(|i| coupling[i][i] = 1.0);
    coupling[2][1] = -1.0;
    robot["joint_map"] = json!({"sign": [1, 1, -1, 1, 1, 1], "offset_deg": [0, 0, 10, 0, 0, 0], "coupling": coupling});
    let path = format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &robot).await.ok(201)["id"])
    );
    let (q_model, measured) = first_rows(100);
    let to_controller = |q: &Vec<f64>| [q[0], q[1], -(q[2] - 10.0 + q[1]), q[3], q[4], q[5]];
    let points: Vec<Value> = q_model
        .iter()
        .zip(&measured)
        .map(|(q, position)| json!({"q_deg": to_controller(q), "position_mm": position}))
        .collect();
    let set = app
        .post_json(
            &format!("{path}/measurement-sets"),
            &json!({"frame": "base", "points": points}),
        )
        .await
        .ok(201);
    let job = app
        .run(
            &path,
            &json!({"measurement_set_id": set["id"], "method": "least_squares"}),
        )
        .await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let predict = format!(
        "/v1/parameter-sets/{}/predict",
        text(&job["parameter_set_id"])
    );
    let answer = app
        .post_json(&predict, &json!({"q_deg": [to_controller(&q_model[3])]}))
        .await
        .ok(200);
    for axis in 0..3 {
        assert!(
            (answer["position_mm"][0][axis].as_f64().unwrap() - measured[3][axis]).abs() < 1e-4,
            "{answer} and {:?}",
            measured[3]
        );
    }
}

#[tokio::test]
async fn an_uncertainty_that_is_not_true_is_absent_and_a_gate_that_needs_one_says_why() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let policy = json!({"tolerance_mm": 0.5});
    let put = app
        .request(Method::PUT, &format!("{robot}/policy"))
        .header("content-type", "application/json")
        .body(policy.to_string());
    Answer::of(put).await.ok(200);
    // The paper's swarm stops before it has reached the minimum.
    let request = json!({"measurement_set_id": set, "method": "pso", "preset": "paper"});
    let job = app.run(&robot, &request).await;
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    let report = app.get(&path).await.ok(200);
    assert!(report["verify"]["after"]["rms_mm"].as_f64().unwrap() > 0.1);
    assert_eq!(report["tool_uncertainty_mm"], Value::Null);
    let parameters = report["parameters"].as_array().unwrap();
    assert!(
        parameters
            .iter()
            .all(|p| p["std_uncertainty"].is_null() && p["interval_95"].is_null())
    );
    let why = text(&report["tool_uncertainty_absent_because"]);
    assert!(why.contains("did not converge"), "{why}");
    let page = app.get(&format!("{path}.html")).await;
    assert!(
        page.text()
            .contains("not stated: the method did not converge")
    );
    let set = text(&job["parameter_set_id"]);
    let gates = app
        .get(&format!("/v1/parameter-sets/{set}/gates"))
        .await
        .ok(200);
    let mut of_uncertainty = gates["gates"].as_array().unwrap().iter();
    let gate = of_uncertainty
        .find(|gate| gate["gate"] == "uncertainty_within_tolerance")
        .unwrap();
    assert_eq!(gate["passed"], false, "{gate}");
    assert!(text(&gate["detail"]).contains(why), "{gate}");
    // A converged result has one, which is stated to be that of the links.
    let refined = json!({"measurement_set_id": set_of(&job), "method": "pso", "preset": "paper", "refine": true});
    let job = app.run(&robot, &refined).await;
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    let report = app.get(&path).await.ok(200);
    assert!(report["tool_uncertainty_mm"]["max"].is_number());
    assert!(report.get("tool_uncertainty_absent_because").is_none());
    let page = app.get(&format!("{path}.html")).await.text();
    assert!(page.contains("(one standard deviation); by the links alone"));
}

fn set_of(job: &Value) -> &Value {
    &job["measurement_set_id"]
}
