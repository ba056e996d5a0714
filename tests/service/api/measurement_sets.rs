use crate::app::{TestApp, paper, text};
use serde_json::{Value, json};

fn row(q: f64, x: f64) -> serde_json::Value {
    json!({"q_deg": [q, 0.0, 0.0, 0.0, 0.0, 0.0], "position_mm": [x, 0.0, 0.0]})
}

#[tokio::test]
async fn a_csv_upload_is_summarised_and_comes_back_bit_for_bit() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let bytes = paper("first.csv");
    let created = app
        .post(
            &format!("{robot}/measurement-sets?frame=base&name=week%209"),
            "text/csv; charset=utf-8",
            bytes.clone(),
        )
        .await;
    let set = created.ok(201);
    let path = format!("/v1/measurement-sets/{}", text(&set["id"]));
    assert_eq!(created.header("location"), Some(path.as_str()));
    assert_eq!(set["robot_id"], robot.trim_start_matches("/v1/robots/"));
    assert_eq!(
        (&set["name"], &set["frame"]),
        (&json!("week 9"), &json!("base"))
    );
    assert_eq!(
        (
            &set["n_points"],
            &set["n_configurations"],
            &set["n_targets"]
        ),
        (&json!(100), &json!(100), &json!(1))
    );
    assert_eq!(set["sha256"], kincal::wire::canonical::sha256_hex(&bytes));
    assert_eq!(app.get(&path).await.ok(200), set);
    let points = app.get(&format!("{path}/points")).await;
    assert_eq!(
        (points.status, points.header("content-type")),
        (200, Some("text/csv; charset=utf-8"))
    );
    assert_eq!(points.bytes, bytes);
}

#[tokio::test]
async fn a_file_that_another_robot_has_too_is_told() {
    let app = TestApp::spawn().await;
    let (robot, other) = (app.paper_robot().await, app.paper_robot().await);
    let told = async |robot: &str| {
        let path = format!("{robot}/measurement-sets?frame=base");
        let set = app
            .post(&path, "text/csv", paper("first.csv"))
            .await
            .ok(201);
        let warnings = set["warnings"].as_array().unwrap().clone();
        let mut warnings = warnings.into_iter();
        warnings.find(|warning| warning["code"] == "same_file_elsewhere")
    };
    assert_eq!(told(&robot).await, None);
    assert_eq!(told(&robot).await, None);
    assert!(told(&other).await.is_some());
}

#[tokio::test]
async fn a_json_upload_comes_back_bit_for_bit_too() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let bytes = format!(
        "  {}\n",
        json!({"frame": "instrument", "name": "n", "points": [row(10.0, 1.0), row(10.0, 2.0), row(20.0, 3.0)]})
    );
    let set = app
        .post(
            &format!("{robot}/measurement-sets"),
            "application/json",
            bytes.clone(),
        )
        .await
        .ok(201);
    assert_eq!(
        (&set["frame"], &set["n_points"], &set["n_configurations"]),
        (&json!("instrument"), &json!(3), &json!(2))
    );
    let points = app
        .get(&format!("/v1/measurement-sets/{}/points", text(&set["id"])))
        .await;
    assert_eq!(
        (points.text(), points.header("content-type")),
        (bytes, Some("application/json"))
    );
}

#[tokio::test]
async fn a_set_too_small_to_identify_from_is_kept_with_a_warning() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let body = json!({"frame": "base", "points": [row(10.0, 1.0)]});
    let set = app
        .post_json(&format!("{robot}/measurement-sets"), &body)
        .await
        .ok(201);
    let codes: Vec<&str> = set["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .map(|warning| text(&warning["code"]))
        .collect();
    assert!(codes.contains(&"under_determined"), "{codes:?}");
    let job = json!({"measurement_set_id": set["id"]});
    app.post_json(&format!("{robot}/jobs"), &job)
        .await
        .problem(422, "under_determined");
}

/// The first rows of the paper's set in an instrument's frame: shifted, and turned by a quarter turn about z.
fn five_rows_from_an_instrument(n: usize) -> String {
    let file = String::from_utf8(crate::app::paper("followup_unchanged.csv")).unwrap();
    let mut rows = file.lines();
    let header: Vec<&str> = rows.next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|column| *column == name).unwrap();
    let [x, y, z] = ["x_mm", "y_mm", "z_mm"].map(column);
    let turned = |row: &str| {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        let at = |cell: usize| cells[cell].parse::<f64>().unwrap();
        let (seen_x, seen_y, seen_z) = (1500.0 - at(y), at(x) - 700.0, at(z) + 250.0);
        cells[x] = seen_x.to_string();
        cells[y] = seen_y.to_string();
        cells[z] = seen_z.to_string();
        cells.join(",") + "\n"
    };
    let body: String = rows.take(n).map(turned).collect();
    header.join(",") + "\n" + &body
}

#[tokio::test]
async fn what_an_upload_says_that_a_small_set_can_serve_for_it_can() {
    let app = TestApp::with_workers(1).await;
    let (robot, identified) = app.identified().await;
    let warning_details = |set: &Value| -> String {
        let warnings = set["warnings"].as_array().unwrap().iter();
        let small = warnings.filter(|warning| warning["code"] == "under_determined");
        small
            .map(|warning| text(&warning["detail"]).to_owned())
            .collect()
    };
    let upload = async |csv: String, frame: &str| {
        let path = format!("{robot}/measurement-sets?frame={frame}");
        app.post(&path, "text/csv", csv).await.ok(201)
    };
    let verify = async |set: &Value| {
        let request = json!({"measurement_set_id": set["id"], "kind": "verify"});
        app.post_json(&format!("{robot}/jobs"), &request).await
    };
    // Five points of one target are enough to score a set. In an instrument's frame, where base and target are placed by them, nine are evidence.
    for (frame, n) in [("base", 5), ("instrument", 5), ("instrument", 9)] {
        let csv = match frame {
            "base" => String::from_utf8(crate::app::paper("followup_unchanged.csv"))
                .unwrap()
                .lines()
                .take(n + 1)
                .map(|line| format!("{line}\n"))
                .collect(),
            _ => five_rows_from_an_instrument(n),
        };
        let set = upload(csv, frame).await;
        let is_evidence = frame == "base" || n >= 9;
        let said = match is_evidence {
            true => "it can serve to verify",
            false => "no evidence for a release: 9 configurations are",
        };
        let details = warning_details(&set);
        assert!(details.is_empty() || details.contains(said), "{details}");
        assert!(frame == "base" || n == 9 || !details.is_empty());
        let request = json!({"measurement_set_id": set["id"], "kind": "verify", "parameter_set_id": identified["parameter_set_id"]});
        let job = app.run(&robot, &request).await;
        assert_eq!(job["status"], "succeeded", "{frame}: {job}");
        let path = format!("/v1/jobs/{}/report", text(&job["id"]));
        let report = app.get(&path).await.ok(200);
        // the scored set was identified in the base frame, of which positions from an instrument say nothing
        let expected = match frame {
            "base" => "independent_session",
            _ => "none",
        };
        assert_eq!(report["evidence"], expected, "{frame}, {n}: {report}");
    }
    // Five points that are 4 m off are refused. Kept all the same, they serve for nothing.
    let file = String::from_utf8(crate::app::paper("followup_unchanged.csv")).unwrap();
    let shifted = |(row, line): (usize, &str)| {
        let (rest, z) = line.rsplit_once(',').unwrap();
        match (row, z.parse::<f64>()) {
            (1.., Ok(z_mm)) => format!("{rest},{}\n", z_mm + 4000.0),
            _ => format!("{line}\n"),
        }
    };
    let file: String = file.lines().take(6).enumerate().map(shifted).collect();
    let path = format!("{robot}/measurement-sets?frame=base");
    app.post(&path, "text/csv", file.clone())
        .await
        .problem(422, "frame_suspect");
    let set = upload(file, "base&insist=frame_suspect").await;
    let details = warning_details(&set);
    assert!(
        details.contains("does not fit this robot") && !details.contains("serve"),
        "{details}"
    );
    // Four are not enough, and the upload says the same as the job.
    let four = upload(five_rows_from_an_instrument(4), "instrument").await;
    let why = verify(&four).await.problem(422, "under_determined");
    assert!(
        warning_details(&four).contains("too small to identify from and to verify on")
            && warning_details(&four).contains(text(&why["detail"])),
        "{}: {why}",
        warning_details(&four)
    );
}

#[tokio::test]
async fn what_is_wrong_in_a_csv_file_is_named_by_row_and_column() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let header = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm";
    for (cell, what) in [
        ("nan", "NaN"),
        ("inf", "infinity"),
        ("1e400", "beyond a float"),
        ("", "empty"),
        ("ten", "text"),
    ] {
        let file = format!("{header}\n0,0,0,0,0,0,1,2,3\n0,0,0,0,{cell},0,1,2,3\n");
        let answer = app
            .post(&format!("{robot}/measurement-sets"), "text/csv", file)
            .await;
        let problem = answer.problem(422, "invalid_measurements");
        assert_eq!(
            (
                &problem["errors"][0]["row"],
                &problem["errors"][0]["column"]
            ),
            (&json!(1), &json!("q5_deg")),
            "{what}: {problem}"
        );
    }
    let without_unit = format!("{}\n0,0,0,0,0,0,1,2,3\n", header.replace("x_mm", "x"));
    app.post(
        &format!("{robot}/measurement-sets"),
        "text/csv",
        without_unit,
    )
    .await
    .problem(422, "invalid_measurements");
    app.post(&format!("{robot}/measurement-sets"), "text/csv", "")
        .await
        .problem(422, "invalid_measurements");
}

#[tokio::test]
async fn what_is_wrong_in_a_json_set_is_named_by_pointer() {
    let app = TestApp::spawn().await;
    let path = format!("{}/measurement-sets", app.paper_robot().await);
    let body = json!({"frame": "base", "points": [row(1.0, 2.0), {"q_deg": [1.0], "position_mm": [1e9, 0.0, 0.0], "std_mm": 0.0, "target": 99}]});
    let problem = app
        .post_json(&path, &body)
        .await
        .problem(422, "invalid_measurements");
    let pointers: Vec<&str> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|issue| text(&issue["pointer"]))
        .collect();
    assert_eq!(
        pointers,
        [
            "/points/1/q_deg",
            "/points/1/position_mm/0",
            "/points/1/target",
            "/points/1/std_mm",
            "/points/0/std_mm"
        ]
    );
    app.post_json(&path, &json!({"frame": "base", "points": []}))
        .await
        .problem(422, "invalid_measurements");
    // Without a frame, CSV and JSON are read alike, and the answer states the frame.
    let bodies = [
        (
            "application/json",
            json!({"points": [row(1.0, 2.0)]}).to_string(),
        ),
        ("text/csv", String::from_utf8(paper("first.csv")).unwrap()),
    ];
    for (content_type, body) in bodies {
        let set = app.post(&path, content_type, body).await.ok(201);
        assert_eq!(set["frame"], "base");
        assert!(
            set["warnings"]
                .as_array()
                .unwrap()
                .iter()
                .any(|warning| warning["code"] == "frame_assumed"),
            "{set}"
        );
    }
    app.post_json(
        &format!("{path}?frame=instrument"),
        &json!({"frame": "base", "points": [row(1.0, 2.0)]}),
    )
    .await
    .problem(422, "frame_conflict");
}

/// One of the paper's measurement files with an additional column.
fn with_column(name: &str, cell: impl Fn(usize) -> String) -> String {
    let csv = String::from_utf8(paper("first.csv")).unwrap();
    let (header, rows) = csv.trim_end().split_once('\n').unwrap();
    let rows = rows.lines().enumerate();
    let rows = rows.map(|(i, row)| format!("{},{}\n", row.trim_end(), cell(i)));
    format!("{},{name}\n{}", header.trim_end(), rows.collect::<String>())
}

#[tokio::test]
async fn measured_at_must_be_a_time() {
    let app = TestApp::spawn().await;
    let path = format!("{}/measurement-sets?frame=base", app.paper_robot().await);
    for text in [
        "yesterday",
        "2026-03-01",
        "01.03.2026 08:15",
        "2026-02-30T08:15:30Z",
        "1772352930",
    ] {
        let csv = with_column("measured_at", |i| match i {
            3 => text.into(),
            _ => "2026-03-01T08:15:30Z".into(),
        });
        let problem = app.post(&path, "text/csv", csv).await;
        let problem = problem.problem(422, "invalid_measurements");
        let issue = &problem["errors"][0];
        assert_eq!(
            (
                &issue["row"],
                text_of(issue, "column"),
                text_of(issue, "code")
            ),
            (&json!(3), "measured_at", "not_a_time"),
            "{problem}"
        );
        assert!(text_of(issue, "detail").contains("RFC 3339"), "{problem}");
        let mut point = row(1.0, 2.0);
        point["measured_at"] = text.into();
        let body = json!({"points": [row(1.0, 2.0), point]});
        let problem = app.post_json(&path, &body).await;
        let problem = problem.problem(422, "invalid_measurements");
        let issue = &problem["errors"][0];
        assert_eq!(
            (text_of(issue, "pointer"), text_of(issue, "code")),
            ("/points/1/measured_at", "not_a_time")
        );
    }
    let csv = with_column("measured_at", |i| {
        format!("2026-03-01T08:15:{:02}.5+01:00", i % 60)
    });
    app.post(&path, "text/csv", csv).await.ok(201);
}

fn text_of<'a>(issue: &'a serde_json::Value, field: &str) -> &'a str {
    text(&issue[field])
}

#[tokio::test]
async fn a_set_that_was_stored_with_another_measured_at_stays_readable() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let csv = with_column("measured_at", |_| "Sunday morning".into());
    let new = kincal::store::NewMeasurementSet {
        insisted_on: None,
        reading_json: None,
        robot_id: robot.rsplit('/').next().unwrap().into(),
        name: None,
        frame: kincal::wire::measurement::Frame::Base,
        content_type: "text/csv".into(),
        body: csv.clone().into_bytes(),
        sha256: kincal::wire::canonical::sha256_hex(csv.as_bytes()),
        n_points: csv.lines().count() as i64 - 1,
        n_configurations: csv.lines().count() as i64 - 1,
        n_targets: 1,
        warnings_json: "[]".into(),
        uploaded_by: None,
        serial_number: None,
    };
    let mut tx = app.server.store.begin().await.unwrap();
    let set = kincal::store::measurement_sets::insert(&mut tx, &new)
        .await
        .unwrap();
    tx.commit().await.unwrap();
    let points = app
        .get(&format!("/v1/measurement-sets/{}/points", set.id))
        .await;
    assert_eq!(points.text(), csv);
    let request = json!({"measurement_set_id": set.id, "method": "least_squares"});
    assert_eq!(app.run(&robot, &request).await["status"], "succeeded");
}

#[tokio::test]
async fn joint_limits_are_the_controllers_as_the_joint_values_are() {
    let app = TestApp::spawn().await;
    let mut robot: serde_json::Value =
        serde_json::from_slice(&crate::app::paper("robot.json")).unwrap();
    let set = String::from_utf8(crate::app::paper("first.csv")).unwrap();
    for link in robot["links"].as_array_mut().unwrap() {
        link["joint_limits_deg"] = json!([-180, 180]);
    }
    // The model's joint 3 is the controller's plus 300 degrees: beyond every limit, and still accepted.
    robot["joint_map"] = json!({"sign": [1, 1, 1, 1, 1, 1], "offset_deg": [0, 0, 300, 0, 0, 0]});
    robot["links"][2]["theta_offset_deg"] =
        json!(robot["links"][2]["theta_offset_deg"].as_f64().unwrap() - 300.0);
    let robot = app.post_json("/v1/robots", &robot).await.ok(201);
    let path = format!(
        "/v1/robots/{}/measurement-sets?frame=base",
        text(&robot["id"])
    );
    let warned = |answer: &serde_json::Value| {
        answer["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .any(|w| w["code"] == "outside_joint_limits")
    };
    let answer = app
        .post(&path, "text/csv", set.clone().into_bytes())
        .await
        .ok(201);
    assert!(!warned(&answer), "{answer}");
    let mut lines: Vec<String> = set.lines().map(str::to_owned).collect();
    let column = lines[0]
        .split(',')
        .position(|name| name == "q3_deg")
        .unwrap();
    let mut cells: Vec<String> = lines[5].split(',').map(str::to_owned).collect();
    cells[column] = (cells[column].parse::<f64>().unwrap() - 360.0).to_string();
    let stated = cells[column].parse::<f64>().unwrap();
    lines[5] = cells.join(",");
    let answer = app
        .post(&path, "text/csv", lines.join("\n").into_bytes())
        .await
        .ok(201);
    let warning = answer["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .find(|w| w["code"] == "outside_joint_limits")
        .unwrap();
    assert!(
        text(&warning["detail"]).contains(&format!("first row 4: joint 3 at {stated:.3}")),
        "{warning}"
    );
}

#[tokio::test]
async fn other_types_other_queries_and_unknown_robots_are_refused() {
    let app = TestApp::spawn().await;
    let path = format!("{}/measurement-sets", app.paper_robot().await);
    app.post(&path, "application/zip", "PK")
        .await
        .problem(415, "unsupported_media_type");
    app.post(
        &format!("{path}?frane=base"),
        "text/csv",
        paper("first.csv"),
    )
    .await
    .problem(400, "invalid_query");
    app.post(
        &format!("{path}?frame=tool"),
        "text/csv",
        paper("first.csv"),
    )
    .await
    .problem(400, "invalid_query");
    app.post(
        "/v1/robots/rob_0/measurement-sets",
        "text/csv",
        paper("first.csv"),
    )
    .await
    .problem(404, "not_found");
    app.get("/v1/measurement-sets/set_0")
        .await
        .problem(404, "not_found");
    app.get("/v1/measurement-sets/%00%27/points")
        .await
        .problem(404, "not_found");
}

#[tokio::test]
async fn a_body_beyond_32_mib_is_refused_before_it_is_read() {
    let app = TestApp::spawn().await;
    let path = format!("{}/measurement-sets", app.paper_robot().await);
    app.post(&path, "text/csv", vec![b'x'; 33 * 1024 * 1024])
        .await
        .problem(413, "too_large");
}

#[tokio::test]
async fn a_compressed_body_is_refused_rather_than_unpacked() {
    let app = TestApp::spawn().await;
    let path = format!("{}/measurement-sets", app.paper_robot().await);
    let request = app
        .request(reqwest::Method::POST, &path)
        .header("content-type", "text/csv")
        .header("content-encoding", "gzip")
        .body("x");
    crate::app::Answer::of(request)
        .await
        .problem(415, "unsupported_media_type");
}

#[tokio::test]
async fn sweeps_give_base_and_tool_frame() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let created = app
        .post(
            &format!("{robot}/frames"),
            "text/csv",
            paper("sweeps_instrument.csv"),
        )
        .await;
    let frames = created.ok(201);
    assert_eq!(frames["circles"].as_array().unwrap().len(), 3);
    assert!(
        (frames["z_tool_mm"].as_f64().unwrap() - 100.0).abs() < 50.0,
        "{frames}"
    );
    assert_eq!(
        app.get(created.header("location").unwrap()).await.ok(200),
        frames
    );
    app.post(&format!("{robot}/frames"), "text/csv", paper("first.csv"))
        .await
        .problem(422, "missing_sweep");
}

#[tokio::test]
async fn a_robots_sets_are_listed() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let page = app.get(&format!("{robot}/measurement-sets")).await.ok(200);
    assert_eq!(page["items"][0]["id"], set);
    assert!(page["next_cursor"].is_null());
}
