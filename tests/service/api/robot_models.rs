//! The library of ready arms, robots from descriptions, and postures beside the pendant.

use crate::app::{Answer, TestApp, text};
use crate::people::{guarded, key, with_key};
use crate::process::{Printed, run_beside};
use nalgebra::{Matrix3, Rotation3, Vector3};
use reqwest::Method;
use serde_json::{Value, json};

/// The answers have all digits of a float.
const SAME: f64 = 1e-9;

#[tokio::test]
async fn arms_are_listed_page_by_page_and_found_by_maker_and_name() {
    let app = TestApp::spawn().await;
    let (mut ids, mut cursor) = (Vec::new(), String::new());
    let total = loop {
        let page = app
            .get(&format!("/v1/robot-models?limit=40{cursor}"))
            .await
            .ok(200);
        let items = page["items"].as_array().unwrap().clone();
        ids.extend(items.iter().map(|item| text(&item["id"]).to_owned()));
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break page["total"].as_u64().unwrap(),
        }
    };
    assert_eq!(ids.len() as u64, total);
    assert!(total >= 60, "{total}");
    let found = app
        .get("/v1/robot-models?search=m10ia&maker=fanuc")
        .await
        .ok(200);
    assert_eq!(found["items"][0]["id"], "fanuc_m_10ia");
    let none = app.get("/v1/robot-models?search=nosucharm").await.ok(200);
    assert_eq!((&none["total"], &none["items"]), (&json!(0), &json!([])));
    for (query, code) in [
        ("limit=0", "invalid_query"),
        ("limit=201", "invalid_query"),
        ("serch=a", "invalid_query"),
        ("cursor=nobody", "invalid_cursor"),
    ] {
        let answer = app.get(&format!("/v1/robot-models?{query}")).await;
        answer.problem(400, code);
    }
    let long = "a".repeat(101);
    let answer = app.get(&format!("/v1/robot-models?search={long}")).await;
    answer.problem(400, "invalid_query");
}

#[tokio::test]
async fn an_arm_of_the_library_becomes_a_robot_as_it_is() {
    let app = TestApp::spawn().await;
    let model = app.get("/v1/robot-models/kuka_kr10_r1100_2").await.ok(200);
    assert_eq!(model["joints"][0], "A1");
    assert!(text(&model["sources"][0]["title"]).contains("kuka_robot_descriptions"));
    let mut body = model["robot"].clone();
    body["name"] = json!("cell 4");
    let robot = app.post_json("/v1/robots", &body).await.ok(201);
    assert_eq!(robot["links"], model["robot"]["links"]);
    assert_eq!(robot["joint_map"], model["robot"]["joint_map"]);
    assert!(text(&robot["description"]).contains("kuka_kr10_r1100_2"));
    app.get("/v1/robot-models/no_such_arm")
        .await
        .problem(404, "not_found");
}

#[tokio::test]
async fn every_arm_of_the_library_is_a_robot_for_the_server() {
    let app = TestApp::spawn().await;
    let page = app.get("/v1/robot-models?limit=200").await.ok(200);
    for item in page["items"].as_array().unwrap() {
        let id = text(&item["id"]);
        let model = app.get(&format!("/v1/robot-models/{id}")).await.ok(200);
        let answer = app.post_json("/v1/robots", &model["robot"]).await;
        assert_eq!(answer.status, 201, "{id}: {}", answer.text());
    }
}

/// The robot of an arm, and the path of its postures.
async fn arm(app: &TestApp, id: &str) -> String {
    let model = app.get(&format!("/v1/robot-models/{id}")).await.ok(200);
    let robot = app.post_json("/v1/robots", &model["robot"]).await.ok(201);
    format!("/v1/robots/{}/posture", text(&robot["id"]))
}

fn numbers(value: &Value) -> Vec<f64> {
    let all = value.as_array().unwrap();
    all.iter().map(|n| n.as_f64().unwrap()).collect()
}

#[track_caller]
fn are(value: &Value, expected: &[f64]) {
    let found = numbers(value);
    assert_eq!(found.len(), expected.len());
    let same = found
        .iter()
        .zip(expected)
        .all(|(a, b)| (a - b).abs() < SAME);
    assert!(same, "{found:?}, not {expected:?}");
}

/// Poses that are read off a drawing: the arm of a KR 10 R1100-2 upright and its forearm level, and so on.
#[tokio::test]
async fn postures_are_where_a_drawing_has_them() {
    let app = TestApp::spawn().await;
    let kuka = arm(&app, "kuka_kr10_r1100_2").await;
    // cannon: 25 + 515 + 90 to the front, 400 + 560 + 25 up
    let cannon = json!({"q_deg": [0, -90, 90, 0, 0, 0], "shown_position_mm": [630, 3, 989]});
    let answer = app.post_json(&kuka, &cannon).await.ok(200);
    are(&answer["position_mm"], &[630.0, 0.0, 985.0]);
    are(&answer["kuka_abc_deg"], &[0.0, 90.0, 0.0]);
    assert_eq!(answer["angles_not_unique"], true);
    assert!((answer["position_apart_mm"].as_f64().unwrap() - 5.0).abs() < SAME);
    // A1 turns clockwise seen from above, and the hand points down
    let down = json!({"q_deg": [90, -90, 90, 0, 90, 0]});
    let answer = app.post_json(&kuka, &down).await.ok(200);
    are(&answer["position_mm"], &[0.0, -540.0, 895.0]);
    let is_down = numbers(&answer["rotation"][2]);
    assert!((is_down[2] + 1.0).abs() < SAME, "{is_down:?}");

    // FANUC at zeros: W 180, P -90, R 0; the base is at the height of axis 2
    let fanuc = arm(&app, "fanuc_m_10ia").await;
    let zeros = json!({"q_deg": [0, 0, 0, 0, 0, 0]});
    let answer = app.post_json(&fanuc, &zeros).await.ok(200);
    are(
        &answer["position_mm"],
        &[150.0 + 640.0 + 100.0, 0.0, 600.0 + 200.0],
    );
    let wpr = numbers(&answer["fanuc_wpr_deg"]);
    assert!(
        (wpr[0].abs() - 180.0).abs() < 1e-6 && (wpr[1] + 90.0).abs() < 1e-6,
        "{wpr:?}"
    );
    // J2 leans the arm, and the forearm stays level: that is what J3 = 0 says
    let leaning = json!({"q_deg": [0, 30, 0, 0, 0, 0]});
    let answer = app.post_json(&fanuc, &leaning).await.ok(200);
    let (s, c) = 30f64.to_radians().sin_cos();
    are(
        &answer["position_mm"],
        &[150.0 + 600.0 * s + 740.0, 0.0, 600.0 * c + 200.0],
    );
    // UR5e at zeros: stretched out along -x of the pendant's base, the tool along -y
    let ur = arm(&app, "ur_ur5e").await;
    let answer = app.post_json(&ur, &zeros).await.ok(200);
    are(
        &answer["position_mm"],
        &[-425.0 - 392.2, -133.3 - 99.6, 162.5 - 99.7],
    );
    let half = std::f64::consts::FRAC_PI_2;
    are(&answer["ur_rotation_vector_rad"], &[half, 0.0, 0.0]);
    // ABB at zeros: tool0 is (0.7071, 0, 0.7071, 0)
    let abb = arm(&app, "abb_irb_4600_60_205").await;
    let answer = app.post_json(&abb, &zeros).await.ok(200);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    are(&answer["quaternion"], &[half, 0.0, half, 0.0]);
    are(
        &answer["position_mm"],
        &[175.0 + 960.0 + 135.0, 0.0, 495.0 + 900.0 + 175.0],
    );
}

/// The angles put together again by elementary turns give the matrix; the quaternion and the rotation vector by formulas of their own.
#[tokio::test]
async fn all_forms_of_an_orientation_are_the_same_orientation() {
    let app = TestApp::spawn().await;
    let path = arm(&app, "staubli_tx2_60").await;
    for q in [
        [10.0, -20.0, 30.0, 40.0, 50.0, 60.0],
        [-100.0, 60.0, -70.0, 170.0, -90.0, 200.0],
        [0.0, 0.0, 90.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 180.0],
    ] {
        let tool = json!({"translation_mm": [10, 20, 130], "rotation": [[0, -1, 0], [1, 0, 0], [0, 0, 1]]});
        let answer = app
            .post_json(&path, &json!({"q_deg": q, "tool": tool}))
            .await
            .ok(200);
        let rows: Vec<f64> = (0..3)
            .flat_map(|i| numbers(&answer["rotation"][i]))
            .collect();
        let r = Matrix3::from_row_slice(&rows);
        let apart = |other: Matrix3<f64>| (other - r).amax();
        let about = |axis: usize, deg: f64| {
            let axis = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()][axis];
            *Rotation3::from_axis_angle(&axis, deg.to_radians()).matrix()
        };
        let abc = numbers(&answer["kuka_abc_deg"]);
        assert!(
            apart(about(2, abc[0]) * about(1, abc[1]) * about(0, abc[2])) < 1e-7,
            "{abc:?}"
        );
        let wpr = numbers(&answer["fanuc_wpr_deg"]);
        assert!(
            apart(about(2, wpr[2]) * about(1, wpr[1]) * about(0, wpr[0])) < 1e-7,
            "{wpr:?}"
        );
        let [w, x, y, z]: [f64; 4] = numbers(&answer["quaternion"]).try_into().unwrap();
        let by_quaternion = Matrix3::new(
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        );
        assert!(w >= 0.0 && apart(by_quaternion) < SAME);
        let v = Vector3::from_row_slice(&numbers(&answer["ur_rotation_vector_rad"]));
        let k = v.cross_matrix();
        let exponential = (0..40).rev().fold(Matrix3::identity(), |sum, n| {
            Matrix3::identity() + k * sum / f64::from(n + 1)
        });
        assert!(v.norm() < std::f64::consts::PI + SAME && apart(exponential) < SAME);
    }
}

#[tokio::test]
async fn postures_that_cannot_be_are_told() {
    let app = TestApp::spawn().await;
    let path = arm(&app, "ur_ur5e").await;
    let short = app.post_json(&path, &json!({"q_deg": [1, 2]})).await;
    let problem = short.problem(422, "invalid_posture");
    assert_eq!(problem["errors"][0]["pointer"], "/q_deg");
    let tool = json!({"q_deg": [0, 0, 0, 0, 0, 0], "tool": {"translation_mm": [0, 0, 1], "rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}});
    let problem = app
        .post_json(&path, &tool)
        .await
        .problem(422, "invalid_posture");
    assert_eq!(problem["errors"][0]["code"], "not_a_rotation");
    let far = json!({"q_deg": [0, 0, 200, 0, 0, 0]});
    let answer = app.post_json(&path, &far).await.ok(200);
    assert_eq!(answer["outside_limits"], json!([3]));
    app.post_json(
        "/v1/robots/rob_00000000000000000000000000000000/posture",
        &far,
    )
    .await
    .problem(404, "not_found");
}

#[tokio::test]
async fn a_key_that_reads_may_look_and_no_other() {
    let (app, _dir) = guarded(0).await;
    let (reader, _) = key(&app, &["read"], None).await;
    let (uploader, _) = key(&app, &["upload"], None).await;
    for path in ["/v1/robot-models", "/v1/robot-models/ur_ur5e"] {
        let may = with_key(&app, Method::GET, path, &reader, Vec::new()).await;
        assert_eq!(may.status, 200, "{}", may.text());
        with_key(&app, Method::GET, path, &uploader, Vec::new())
            .await
            .problem(403, "insufficient_scope");
    }
}

const URDF: &str = r#"<robot name="a">
 <link name="world"/><link name="base"/><link name="one"/><link name="two"/><link name="plate"/><link name="camera"/>
 <joint name="w" type="fixed"><parent link="world"/><child link="base"/></joint>
 <joint name="j1" type="revolute"><origin xyz="0 0 0.3" rpy="0 0 0"/><parent link="base"/><child link="one"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="0" velocity="0"/></joint>
 <joint name="j2" type="revolute"><origin xyz="0.1 0 0.2" rpy="-1.5708 0 0"/><parent link="one"/><child link="two"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="0" velocity="0"/></joint>
 <joint name="p" type="fixed"><origin xyz="0.705 0 0" rpy="0 0 0"/><parent link="two"/><child link="plate"/></joint>
 <joint name="c" type="fixed"><parent link="one"/><child link="camera"/></joint>
</robot>"#;

async fn import(app: &TestApp, query: &str, kind: &str, body: &str) -> Answer {
    let path = format!("/v1/robot-imports?{query}");
    let request = app
        .request(Method::POST, &path)
        .header("content-type", kind.to_owned())
        .body(body.to_owned());
    Answer::of(request).await
}

#[tokio::test]
async fn an_import_names_the_tip_and_the_frames_that_it_skipped_and_rounds_to_what_the_file_says() {
    let app = TestApp::spawn().await;
    let exact = import(&app, "format=urdf", "application/xml", URDF)
        .await
        .ok(200);
    assert_eq!(
        (&exact["root"], &exact["tip"]),
        (&json!("world"), &json!("plate"))
    );
    assert_eq!(exact["fixed_frames"], json!(["base", "plate"]));
    assert_eq!(exact["skipped_frames"], json!(["camera"]));
    let alpha = exact["robot"]["links"][1]["alpha_deg"].as_f64().unwrap();
    let written: f64 = "1.5708".parse().unwrap();
    assert!((alpha + written.to_degrees()).abs() < 1e-9, "{alpha}");
    assert!(exact["largest_difference_mm"].as_f64().unwrap() < SAME);
    let meant = import(&app, "format=urdf&digits=source", "application/xml", URDF)
        .await
        .ok(200);
    let link = &meant["robot"]["links"][1];
    assert_eq!(
        (&link["alpha_deg"], &link["a_mm"]),
        (&json!(-90.0), &json!(100.0))
    );
    // 0.705 m at 3.7e-6 rad
    let moved = meant["largest_difference_mm"].as_f64().unwrap();
    assert!((1e-4..0.01).contains(&moved), "{moved}");
}

#[tokio::test]
async fn tables_in_json_are_the_tables_in_csv() {
    let app = TestApp::spawn().await;
    let csv = "a_mm,alpha_deg,d_mm,theta_offset_deg,min_deg,max_deg\n0,-90,400,0,-170,170\n560,0,0,-90,-100,100\n";
    let rows = json!([
        {"a_mm": 0, "alpha_deg": -90, "d_mm": 400, "theta_offset_deg": 0, "min_deg": -170, "max_deg": 170},
        {"a_mm": 560, "alpha_deg": 0, "d_mm": 0, "theta_offset_deg": -90, "min_deg": -100, "max_deg": 100}]);
    for format in ["dh", "mdh"] {
        let query = format!("format={format}");
        let by_csv = import(&app, &query, "text/csv", csv).await.ok(200);
        for body in [rows.clone(), json!({"rows": rows})] {
            let by_json = import(&app, &query, "application/json", &body.to_string()).await;
            assert_eq!(by_json.ok(200), by_csv, "{format}");
        }
    }
    let wrong = json!([{"a_mm": "x", "alpha_deg": 0, "d_mm": 0, "theta_offset_deg": 0}]);
    let problem = import(&app, "format=dh", "application/json", &wrong.to_string())
        .await
        .problem(422, "invalid_table");
    assert_eq!(problem["errors"][0]["pointer"], "/0/a_mm");
    let mixed = json!([rows[0], 5]).to_string();
    for body in ["[]", "{}", "[1]", "[{\"a_mm\": 1}]", &mixed] {
        let answer = import(&app, "format=mdh", "application/json", body).await;
        answer.problem(422, "invalid_table");
    }
}

async fn kincal(app: Option<&TestApp>, arguments: &[&str]) -> Printed {
    match app {
        Some(app) => run_beside(arguments, &[("KINCAL_SERVER", app.server.url())]).await,
        None => run_beside(arguments, &[]).await,
    }
}

/// A6 is typed as 300 where the pendant shows 30.
#[tokio::test(flavor = "multi_thread")]
async fn a_posture_is_compared_with_the_orientation_that_the_pendant_shows() {
    let typed =
        "robots posture --arm kuka_kr10_r1100_2 0 -80 95 10 20 300 --shown-mm 700.2,-5.1,790.6";
    let shown = |more: &str| {
        let line = format!("{typed} {more}");
        async move { kincal(None, &line.split_whitespace().collect::<Vec<_>>()).await }
    };
    let (code, unseen, said) = shown("").await;
    assert_eq!(code, Some(0), "{said}");
    assert!(unseen.contains("not checked: joints [6]"), "{unseen}");
    let app = TestApp::spawn().await;
    let kuka = arm(&app, "kuka_kr10_r1100_2").await;
    let right = json!({"q_deg": [0, -80, 95, 10, 20, 30]});
    let right = app.post_json(&kuka, &right).await.ok(200);
    let abc: Vec<String> = numbers(&right["kuka_abc_deg"])
        .iter()
        .map(f64::to_string)
        .collect();
    let (_, seen, said) = shown(&format!("--shown-abc-deg={}", abc.join(","))).await;
    assert!(
        seen.contains("orientation is 90.000° from the model's: more than")
            && !seen.contains("not checked"),
        "{seen}{said}"
    );
    let body = json!({"q_deg": [0, -80, 95, 10, 20, 300], "shown_orientation": {"kuka_abc_deg": right["kuka_abc_deg"]}});
    let answer = app.post_json(&kuka, &body).await.ok(200);
    assert!((answer["orientation_apart_deg"].as_f64().unwrap() - 90.0).abs() < 1e-6);
    let two = json!({"q_deg": [0, 0, 0, 0, 0, 0], "shown_orientation": {"kuka_abc_deg": [0, 0, 0], "fanuc_wpr_deg": [0, 0, 0]}});
    let problem = app
        .post_json(&kuka, &two)
        .await
        .problem(422, "invalid_posture");
    assert_eq!(problem["errors"][0]["code"], "not_one_orientation");
    let off =
        json!({"q_deg": [0, 0, 0, 0, 0, 0], "shown_orientation": {"quaternion": [1, 1, 0, 0]}});
    let problem = app
        .post_json(&kuka, &off)
        .await
        .problem(422, "invalid_posture");
    assert_eq!(
        problem["errors"][0]["pointer"],
        "/shown_orientation/quaternion"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn from_the_arms_name_to_the_pose_in_a_terminal() {
    let app = TestApp::spawn().await;
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    // without a server
    let (code, listed, said) = kincal(None, &["robots", "find", "tx2", "60"]).await;
    assert_eq!(code, Some(0), "{said}");
    assert!(listed.contains("staubli_tx2_60l"), "{listed}");
    let (_, full, _) = kincal(None, &["robots", "find", "fanuc_m_10ia"]).await;
    for word in ["sources:", "issue 186", "against the horizontal", "J3"] {
        assert!(full.contains(word), "{word}: {full}");
    }
    let (code, _, said) = kincal(None, &["robots", "find", "hal9000"]).await;
    assert_eq!(code, Some(2));
    assert!(said.contains("kincal robots add"), "{said}");
    let robot = file("robot.json");
    let (code, _, said) = kincal(
        None,
        &["robots", "find", "fanuc_m_10ia", "--robot-file", &robot],
    )
    .await;
    assert_eq!(code, Some(0), "{said}");
    let q = ["10", "-20", "30", "40", "50", "-60"];
    let with = |more: &[&'static str], last: &str| -> Vec<String> {
        let mut all: Vec<String> = ["robots", "posture"].map(String::from).to_vec();
        all.extend(more.iter().map(|s| (*s).to_owned()));
        all.push(last.to_owned());
        all.extend(q.map(String::from));
        all
    };
    let run = async |arguments: Vec<String>| {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let (code, stdout, stderr) = kincal(Some(&app), &arguments).await;
        assert_eq!(code, Some(0), "{stderr}");
        stdout
    };
    // ready arm, file and server answer the same
    let by_file = run(with(&["--json", "--robot-file"], &robot)).await;
    let by_model = run(with(&["--json", "--arm"], "fanuc_m_10ia")).await;
    let (code, added, said) = kincal(
        Some(&app),
        &[
            "robots",
            "add",
            "--arm",
            "M-10iA",
            "--name",
            "cell 4",
            "--mounting",
            "floor",
        ],
    )
    .await;
    assert_eq!(code, Some(0), "{said}");
    assert!(added.contains("kincal robots posture"), "{added}");
    let by_server = run(with(&["--json", "--robot"], "cell 4")).await;
    assert_eq!(by_file, by_model);
    assert_eq!(by_file, by_server);
    let words = run(with(&["--shown-mm", "1,2,3", "--robot"], "cell 4")).await;
    for word in [
        "KUKA A B C",
        "FANUC W P R",
        "UR rotation vector",
        "mm from the model's",
    ] {
        assert!(words.contains(word), "{word}: {words}");
    }
    // descriptions
    std::fs::write(file("arm.urdf"), URDF).unwrap();
    let (code, _, said) = kincal(Some(&app), &["robots", "add", &file("arm.urdf")]).await;
    assert_eq!(code, Some(0), "{said}");
    assert!(
        said.contains("from world to plate") && said.contains("camera"),
        "{said}"
    );
    let table = "a_mm,alpha_deg,d_mm,theta_offset_deg\n0,-90,400,0\n560,0,0,-90\n";
    std::fs::write(file("table.csv"), table).unwrap();
    let (code, _, said) = kincal(Some(&app), &["robots", "add", &file("table.csv")]).await;
    assert_eq!(code, Some(2));
    assert!(said.contains("--convention dh"), "{said}");
    let arguments = [
        "robots",
        "add",
        &file("table.csv"),
        "--convention",
        "dh",
        "--json",
    ];
    let (code, added, said) = kincal(Some(&app), &arguments).await;
    assert_eq!(code, Some(0), "{said}");
    let added: Value = serde_json::from_str(&added).unwrap();
    assert_eq!(added["links"][1]["a_mm"], 0.0);
    let (code, _, said) = kincal(Some(&app), &["robots", "add", &robot]).await;
    assert_eq!(code, Some(0), "{said}");
    let (_, listed, _) = kincal(Some(&app), &["robots"]).await;
    assert!(
        listed.contains("cell 4") && listed.contains("FANUC M-10iA"),
        "{listed}"
    );
}
