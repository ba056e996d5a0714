use crate::app::{Answer, TestApp};
use crate::engines::{TestDatabase, for_each_engine};
use kincal::config::{DatabaseConfig, ServeConfig};
use kincal::store::StoreLocation;
use reqwest::Method;
use serde_json::json;

#[tokio::test]
async fn unknown_paths_and_methods_are_problems() {
    let app = TestApp::spawn().await;
    for path in [
        "/v1",
        "/v1/nothing",
        "/v2/robots",
        "/v1/robots/",
        "//",
        "/robots",
    ] {
        app.get(path).await.problem(404, "no_such_route");
    }
    for (method, path, allow) in [
        (Method::DELETE, "/v1/robots", vec!["GET", "HEAD", "POST"]),
        (Method::POST, "/healthz", vec!["GET", "HEAD"]),
        (Method::GET, "/v1/jobs/job_1/cancel", vec!["POST"]),
        (
            Method::from_bytes(b"BREW").unwrap(),
            "/v1/jobs/job_1",
            vec!["GET", "HEAD"],
        ),
    ] {
        let answer = Answer::of(app.request(method, path)).await;
        answer.problem(405, "method_not_allowed");
        let mut allowed: Vec<&str> = answer
            .header("allow")
            .unwrap()
            .split(',')
            .map(str::trim)
            .collect();
        allowed.sort_unstable();
        assert_eq!(allowed, allow, "{path}");
    }
}

#[tokio::test]
async fn every_answer_has_a_request_id_of_its_own() {
    let app = TestApp::spawn().await;
    let (first, second) = (app.get("/healthz").await, app.get("/nothing").await);
    let ids = [
        first.header("x-request-id").unwrap(),
        second.header("x-request-id").unwrap(),
    ];
    assert_ne!(ids[0], ids[1]);
}

#[tokio::test]
async fn a_bad_path_is_not_looked_up() {
    let app = TestApp::spawn().await;
    for id in [
        "%ff",
        "%00",
        "a%2Fb",
        "..%2f..",
        &"x".repeat(5000),
        "'%20or%201=1",
    ] {
        let answer = app.get(&format!("/v1/robots/{id}")).await;
        assert_eq!(answer.status, 404, "{id}: {}", answer.text());
        answer.problem(404, "not_found");
    }
}

/// A server on the engine of a test's database.
async fn on(database: &TestDatabase) -> TestApp {
    let StoreLocation::Postgres { url } = &database.location else {
        return TestApp::spawn().await;
    };
    let nowhere = ServeConfig::loopback("nowhere".into(), 0);
    let config = DatabaseConfig {
        database_url: Some(url.clone()),
        ..nowhere.database.clone()
    };
    TestApp::with_config(ServeConfig {
        database: config,
        ..nowhere
    })
    .await
}

#[test]
fn what_cannot_be_an_id_is_not_looked_up_wherever_it_stands() {
    for_each_engine(async |database| {
        let app = on(database).await;
        let (robot, set) = app.robot_with_set("first.csv").await;
        for id in ["\u{0}", "set_\u{0}", "a/b", "' or 1=1", &"x".repeat(5000)] {
            for (mut body, at) in [
                (json!({}), "/measurement_set_id"),
                (
                    json!({"verify": {"source": "set", "measurement_set_id": ""}}),
                    "/verify/measurement_set_id",
                ),
                (json!({}), "/frames_id"),
                (json!({}), "/network_id"),
                (json!({}), "/residual_network_id"),
                (json!({}), "/parameter_set_id"),
            ] {
                body["measurement_set_id"] = json!(set);
                match at {
                    "/verify/measurement_set_id" => {
                        body["verify"]["measurement_set_id"] = json!(id)
                    }
                    _ => body[at.trim_start_matches('/')] = json!(id),
                }
                let problem = app
                    .post_json(&format!("{robot}/jobs"), &body)
                    .await
                    .problem(422, "unknown_reference");
                assert_eq!(problem["errors"][0]["pointer"], at, "{problem}");
            }
            let plan = json!({"n_configurations": 10, "measured": [set, id]});
            let problem = app
                .post_json(&format!("{robot}/pose-plans"), &plan)
                .await
                .problem(422, "unknown_reference");
            assert_eq!(problem["errors"][0]["pointer"], "/measured/1", "{problem}");
        }
        app.server.shutdown().await;
    });
}

#[tokio::test]
async fn of_several_references_that_are_unknown_the_same_one_is_always_told() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let mut body = json!({"method": "bpnn_pso", "model": "paper", "verify": {"source": "set"}});
    let references = [
        "/measurement_set_id",
        "/verify/measurement_set_id",
        "/frames_id",
        "/parameter_set_id",
        "/network_id",
        "/residual_network_id",
    ];
    for at in references {
        match at {
            "/verify/measurement_set_id" => {
                body["verify"]["measurement_set_id"] = json!("set_unknown")
            }
            _ => body[at.trim_start_matches('/')] = json!("x_unknown"),
        }
    }
    for at in references {
        let problem = app
            .post_json(&format!("{robot}/jobs"), &body)
            .await
            .problem(422, "unknown_reference");
        assert_eq!(problem["errors"][0]["pointer"], at, "{problem}");
        match at {
            "/measurement_set_id" => body["measurement_set_id"] = json!(set),
            "/verify/measurement_set_id" => body["verify"] = json!({"source": "subset"}),
            _ => drop(
                body.as_object_mut()
                    .unwrap()
                    .remove(at.trim_start_matches('/')),
            ),
        }
    }
}

#[tokio::test]
async fn json_that_is_nested_a_million_deep_is_refused() {
    let app = TestApp::spawn().await;
    app.post("/v1/robots", "application/json", "[".repeat(1_000_000))
        .await
        .problem(422, "invalid_body");
    let deep = format!("{{\"name\": {}", "[".repeat(1_000_000));
    let answer = app.post("/v1/robots", "application/json", deep).await;
    assert!(
        answer.status == 400 || answer.status == 422,
        "{}",
        answer.text()
    );
}

#[tokio::test]
async fn a_closed_database_is_503_and_hides_the_cause() {
    let app = TestApp::spawn().await;
    app.server.store.close().await;
    assert_eq!(app.get("/healthz").await.status, 200);
    let not_ready = app.get("/readyz").await;
    not_ready.problem(503, "not_ready");
    assert!(not_ready.header("retry-after").is_some());
    let problem = app.get("/v1/robots").await.problem(503, "unavailable");
    assert!(
        !problem.to_string().to_lowercase().contains("pool"),
        "{problem}"
    );
    app.post_json("/v1/robots", &json!({"name": "r", "links": [{"a_mm": 1, "alpha_deg": 0, "d_mm": 0, "theta_offset_deg": 0}]}))
        .await
        .problem(503, "unavailable");
}
