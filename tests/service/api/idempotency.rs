use crate::app::{Answer, TestApp, paper, text};
use reqwest::Method;
use serde_json::json;

async fn keyed(app: &TestApp, path: &str, key: &str, content_type: &str, body: Vec<u8>) -> Answer {
    Answer::of(
        app.request(Method::POST, path)
            .header("idempotency-key", key)
            .header("content-type", content_type)
            .body(body),
    )
    .await
}

#[tokio::test]
async fn a_retry_gets_the_first_answer_byte_for_byte_also_after_a_restart() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = json!({"measurement_set_id": set}).to_string().into_bytes();
    let requests = [
        (
            "/v1/robots".to_owned(),
            "application/json",
            paper("robot.json"),
        ),
        (
            format!("{robot}/measurement-sets?frame=base&name=n"),
            "text/csv",
            paper("first.csv"),
        ),
        (
            format!("{robot}/frames"),
            "text/csv",
            paper("sweeps_instrument.csv"),
        ),
        (format!("{robot}/jobs"), "application/json", job),
    ];
    let mut firsts = Vec::new();
    for (path, content_type, body) in &requests {
        let first = keyed(&app, path, "k 1", content_type, body.clone()).await;
        assert!(
            first.status == 201 || first.status == 202,
            "{}",
            first.text()
        );
        assert_eq!(first.header("idempotency-replayed"), None);
        firsts.push(first);
    }
    let app = app.restart().await;
    for ((path, content_type, body), first) in requests.iter().zip(&firsts) {
        let again = keyed(&app, path, "k 1", content_type, body.clone()).await;
        assert_eq!(
            (again.status, &again.bytes),
            (first.status, &first.bytes),
            "{path}"
        );
        assert_eq!(
            (again.header("location"), again.header("content-type")),
            (first.header("location"), first.header("content-type"))
        );
        assert_eq!(again.header("idempotency-replayed"), Some("true"));
    }
    assert_eq!(
        app.get("/v1/robots").await.ok(200)["items"]
            .as_array()
            .unwrap()
            .len(),
        2
    );
    assert_eq!(
        app.get(&format!("{robot}/jobs")).await.ok(200)["items"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
}

#[tokio::test]
async fn a_key_is_not_used_for_another_body_query_or_type() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let path = format!("{robot}/measurement-sets");
    let body = paper("first.csv");
    assert_eq!(
        keyed(&app, &path, "k", "text/csv", body.clone())
            .await
            .status,
        201
    );
    keyed(&app, &path, "k", "text/csv", paper("first_noisy.csv"))
        .await
        .problem(422, "idempotency_key_reused");
    keyed(
        &app,
        &format!("{path}?frame=instrument"),
        "k",
        "text/csv",
        body.clone(),
    )
    .await
    .problem(422, "idempotency_key_reused");
    keyed(&app, &path, "k", "application/json", body.clone())
        .await
        .problem(422, "idempotency_key_reused");
    assert_eq!(
        keyed(
            &app,
            &format!("{robot}/frames"),
            "k",
            "text/csv",
            paper("sweeps_instrument.csv")
        )
        .await
        .status,
        201,
        "another path"
    );
}

#[tokio::test]
async fn a_refused_request_leaves_its_key_free() {
    let app = TestApp::spawn().await;
    keyed(&app, "/v1/robots", "k", "application/json", b"{}".to_vec())
        .await
        .problem(422, "invalid_body");
    assert_eq!(
        keyed(
            &app,
            "/v1/robots",
            "k",
            "application/json",
            paper("robot.json")
        )
        .await
        .status,
        201
    );
    keyed(
        &app,
        "/v1/robots",
        "a\tb",
        "application/json",
        paper("robot.json"),
    )
    .await
    .problem(400, "invalid_idempotency_key");
    keyed(
        &app,
        "/v1/robots",
        &"k".repeat(201),
        "application/json",
        paper("robot.json"),
    )
    .await
    .problem(400, "invalid_idempotency_key");
}

#[tokio::test]
async fn the_same_request_twenty_times_at_once_has_one_effect() {
    let app = std::sync::Arc::new(TestApp::spawn().await);
    let robot = app.paper_robot().await;
    let path = format!("{robot}/measurement-sets");
    let mut uploads = tokio::task::JoinSet::new();
    for _ in 0..20 {
        let (app, path) = (app.clone(), path.clone());
        uploads
            .spawn(async move { keyed(&app, &path, "once", "text/csv", paper("first.csv")).await });
    }
    let answers = uploads.join_all().await;
    assert!(
        answers
            .iter()
            .all(|answer| answer.status == 201 && answer.bytes == answers[0].bytes)
    );
    assert_eq!(
        answers
            .iter()
            .filter(|answer| answer.header("idempotency-replayed").is_none())
            .count(),
        1
    );
    assert_eq!(
        app.get(&path).await.ok(200)["items"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
}

#[tokio::test]
async fn a_release_that_is_retried_is_judged_once() {
    let app = TestApp::with_workers(1).await;
    let (_, job) = app.identified().await;
    let path = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let reason = json!({"reason": "verified"}).to_string().into_bytes();
    let first = keyed(
        &app,
        &format!("{path}/release"),
        "k",
        "application/json",
        reason.clone(),
    )
    .await;
    assert_eq!(first.ok(200)["status"], "released");
    app.post_json(&format!("{path}/withdraw"), &json!({"reason": "no"}))
        .await
        .ok(200);
    let again = keyed(
        &app,
        &format!("{path}/release"),
        "k",
        "application/json",
        reason,
    )
    .await;
    assert_eq!(again.bytes, first.bytes);
    assert_eq!(app.get(&path).await.ok(200)["status"], "withdrawn");
}
