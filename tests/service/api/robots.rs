use crate::app::{TestApp, paper, text};
use serde_json::{Value, json};

fn one_link() -> Value {
    json!({"a_mm": 1.5, "alpha_deg": -90.0, "d_mm": 0.1, "theta_offset_deg": 0.0})
}

#[tokio::test]
async fn a_robot_comes_back_as_it_was_sent() {
    let app = TestApp::spawn().await;
    let sent = json!({
        "name": "cell 4", "serial_number": "SN-1", "description": "left of the press",
        "links": [
            {"a_mm": 0.1, "alpha_deg": 0.30000000000000004, "d_mm": 504.0, "theta_offset_deg": -0.0, "joint_limits_deg": [-170.0, 170.0]},
            {"a_mm": 166.605, "alpha_deg": -90.0, "d_mm": 0.0, "theta_offset_deg": 1e-300, "beta_deg": 0.25}
        ],
        "mounting": {"gravity_in_base": [0.0, 0.6, -0.8], "std_deg": 2.0},
        "joint_map": {"sign": [1.0, -1.0], "offset_deg": [0.0, 90.0], "coupling": [[1.0, 0.0], [1.0, 1.0]]}
    });
    let created = app.post_json("/v1/robots", &sent).await;
    let robot = created.ok(201);
    let path = format!("/v1/robots/{}", text(&robot["id"]));
    assert_eq!(created.header("location"), Some(path.as_str()));
    let read = app.get(&path).await;
    assert_eq!(read.ok(200), robot);
    for (key, value) in sent.as_object().unwrap() {
        assert_eq!(&robot[key], value, "{key}");
    }
    assert!(text(&robot["created_at"]).ends_with('Z'));
}

#[tokio::test]
async fn mountings_by_name_come_back() {
    let app = TestApp::spawn().await;
    for mounting in ["floor", "wall", "ceiling"] {
        let robot = app
            .post_json(
                "/v1/robots",
                &json!({"name": "r", "mounting": mounting, "links": [one_link()]}),
            )
            .await
            .ok(201);
        assert_eq!(robot["mounting"], mounting);
    }
}

#[tokio::test]
async fn names_with_html_sql_and_control_characters_round_trip() {
    let app = TestApp::spawn().await;
    for name in [
        "<script>alert(1)</script>",
        "Robert'); DROP TABLE robot;--",
        "tab\tbell\u{7}escape\u{1b}[31m",
        "زاوية 関節 🤖",
        "\u{202e}desrever",
    ] {
        let robot = app
            .post_json("/v1/robots", &json!({"name": name, "links": [one_link()]}))
            .await
            .ok(201);
        assert_eq!(
            app.get(&format!("/v1/robots/{}", text(&robot["id"])))
                .await
                .ok(200)["name"],
            name
        );
    }
    assert_eq!(
        app.get("/v1/robots").await.ok(200)["items"]
            .as_array()
            .unwrap()
            .len(),
        5
    );
    let problem = app
        .post_json(
            "/v1/robots",
            &json!({"name": "a\u{0}b", "links": [one_link()]}),
        )
        .await
        .problem(422, "invalid_robot");
    assert_eq!(problem["errors"][0]["code"], "nul_character");
}

#[tokio::test]
async fn everything_that_is_wrong_with_a_robot_is_named_where_it_stands() {
    let app = TestApp::spawn().await;
    let sent = json!({
        "name": "",
        "links": [
            {"a_mm": 1e6, "alpha_deg": 361.0, "d_mm": 0.0, "theta_offset_deg": 0.0, "joint_limits_deg": [10.0, -10.0]},
            {"a_mm": 0.0, "alpha_deg": 0.0, "d_mm": 0.0, "theta_offset_deg": 0.0, "beta_deg": 90.0}
        ],
        "mounting": {"gravity_in_base": [0.0, 0.0, -9.81], "std_deg": -1.0},
        "joint_map": {"sign": [1.0, 2.0], "offset_deg": [0.0], "coupling": [[1.0, 1.0], [1.0, 1.0]]}
    });
    let problem = app
        .post_json("/v1/robots", &sent)
        .await
        .problem(422, "invalid_robot");
    let pointers: Vec<&str> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|issue| text(&issue["pointer"]))
        .collect();
    for pointer in [
        "/name",
        "/links/0/a_mm",
        "/links/0/alpha_deg",
        "/links/0/joint_limits_deg",
        "/links/1/beta_deg",
        "/joint_map/sign/1",
        "/joint_map/offset_deg",
        "/joint_map/coupling",
        "/mounting/gravity_in_base",
        "/mounting/std_deg",
    ] {
        assert!(
            pointers.contains(&pointer),
            "{pointer} is missing in {pointers:?}"
        );
    }
    assert_eq!(
        app.get("/v1/robots").await.ok(200)["items"],
        json!([]),
        "nothing was stored"
    );
}

#[tokio::test]
async fn robots_have_1_to_12_links() {
    let app = TestApp::spawn().await;
    for (n, status) in [(0, 422), (1, 201), (12, 201), (13, 422)] {
        let answer = app
            .post_json(
                "/v1/robots",
                &json!({"name": "r", "links": vec![one_link(); n]}),
            )
            .await;
        assert_eq!(answer.status, status, "{n} links");
    }
}

#[tokio::test]
async fn numbers_beyond_a_float_unknown_fields_and_text_for_numbers_are_refused() {
    let app = TestApp::spawn().await;
    let robot = String::from_utf8(paper("robot.json")).unwrap();
    for (from, to, pointer) in [
        ("504", "1e400", "/links/0/d_mm"),
        ("504", "\"504\"", "/links/0/d_mm"),
        ("d_mm", "d_m", "/links/0/d_m"),
    ] {
        let answer = app
            .post(
                "/v1/robots",
                "application/json",
                robot.replacen(from, to, 1),
            )
            .await;
        assert_eq!(answer.status, 422, "{}", answer.text());
        assert_eq!(
            answer.json()["errors"][0]["pointer"],
            pointer,
            "{}",
            answer.text()
        );
    }
    app.post(
        "/v1/robots",
        "application/json",
        robot.replacen("504", "NaN", 1),
    )
    .await
    .problem(400, "malformed_json");
    app.post("/v1/robots", "application/json", "{\"name\": \"cut off")
        .await
        .problem(400, "malformed_json");
    app.post("/v1/robots", "text/plain", robot)
        .await
        .problem(415, "unsupported_media_type");
}

#[tokio::test]
async fn lists_come_page_by_page_newest_first_and_each_item_once() {
    let app = TestApp::spawn().await;
    let mut sent = Vec::new();
    for i in 0..7 {
        let robot = app
            .post_json(
                "/v1/robots",
                &json!({"name": format!("r{i}"), "links": [one_link()]}),
            )
            .await
            .ok(201);
        sent.insert(0, robot["id"].clone());
    }
    let (mut seen, mut path) = (Vec::new(), "/v1/robots?limit=3".to_owned());
    loop {
        let page = app.get(&path).await.ok(200);
        seen.extend(
            page["items"]
                .as_array()
                .unwrap()
                .iter()
                .map(|robot| robot["id"].clone()),
        );
        match page["next_cursor"].as_str() {
            Some(cursor) => path = format!("/v1/robots?limit=3&cursor={cursor}"),
            None => break,
        }
    }
    assert_eq!(seen, sent);
    for (query, code) in [
        ("limit=0", "invalid_query"),
        ("limit=201", "invalid_query"),
        ("limit=x", "invalid_query"),
        ("cursor=nonsense", "invalid_cursor"),
        ("page=2", "invalid_query"),
    ] {
        app.get(&format!("/v1/robots?{query}"))
            .await
            .problem(400, code);
    }
}
