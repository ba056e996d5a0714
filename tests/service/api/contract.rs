use crate::app::{Answer, TestApp};

#[test]
fn openapi_yaml_is_what_the_code_says() {
    let stored = include_str!("../../../openapi.yaml");
    let printed = kincal::http::yaml().unwrap();
    let difference = stored
        .lines()
        .zip(printed.lines())
        .position(|(a, b)| a != b);
    assert!(
        stored == printed,
        "openapi.yaml differs from the code from line {:?} on; make it anew: cargo run -- openapi > openapi.yaml",
        difference.map(|line| line + 1)
    );
}

#[tokio::test]
async fn the_server_hands_out_its_contract_and_a_page_that_needs_nothing_else() {
    let app = TestApp::spawn().await;
    let contract = app.get("/openapi.yaml").await;
    assert_eq!(
        (contract.status, contract.header("content-type")),
        (200, Some("application/yaml"))
    );
    assert_eq!(contract.text(), include_str!("../../../openapi.yaml"));
    let page = app.get("/").await;
    assert!(
        page.header("content-type")
            .unwrap()
            .starts_with("text/html")
    );
    assert!(
        page.header("content-security-policy")
            .unwrap()
            .contains("default-src 'none'")
    );
    assert!(
        page.text().contains("/openapi.yaml")
            && !page.text().contains("http://")
            && !page.text().contains("https://")
    );
    assert_eq!(
        app.get("/openapi.json").await.ok(200)["info"]["title"],
        "kincal"
    );
    assert_eq!(
        (
            app.get("/healthz").await.text(),
            app.get("/readyz").await.text()
        ),
        ("ok\n".into(), "ready\n".into())
    );
}

#[tokio::test]
async fn nothing_in_any_answer_is_to_be_run_framed_guessed_at_or_kept() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let posted = app.post("/v1/robots", "application/json", "{").await;
    posted.problem(400, "malformed_json");
    let mut answers = vec![posted];
    for path in [
        "/",
        "/docs",
        "/healthz",
        "/openapi.yaml",
        "/metrics",
        "/v1/robots",
        robot.as_str(),
        "/v1/jobs/job_0",
        "/nowhere",
    ] {
        answers.push(app.get(path).await);
    }
    for answer in answers {
        assert_eq!(
            answer.header("x-content-type-options"),
            Some("nosniff"),
            "{}",
            answer.text()
        );
        assert_eq!(
            (
                answer.header("x-frame-options"),
                answer.header("referrer-policy")
            ),
            (Some("DENY"), Some("no-referrer"))
        );
        let policy = answer.header("content-security-policy").unwrap();
        assert!(
            policy.contains("default-src 'none'")
                && policy.contains("frame-ancestors 'none'")
                && !policy.contains("unsafe"),
            "{policy}"
        );
        assert!(
            answer.header("cache-control").is_some() && answer.header("x-request-id").is_some()
        );
    }
}

/// Paths of `src="…"` and `href="…"` on this server.
fn linked(page: &str) -> Vec<String> {
    let attributes = page.split('"').zip(page.split('"').skip(1));
    let own = attributes.filter(|(before, value)| {
        (before.ends_with("src=") || before.ends_with("href=")) && value.starts_with("/assets/")
    });
    own.map(|(_, value)| value.to_owned()).collect()
}

#[tokio::test]
async fn pages_are_served_with_a_strict_policy_and_their_files_are_there() {
    let app = TestApp::spawn().await;
    for path in ["/", "/docs"] {
        let page = app.get(path).await;
        let policy = page.header("content-security-policy").unwrap().to_owned();
        assert!(
            policy.contains("script-src 'self'")
                && !policy.contains("unsafe")
                && !policy.contains('*'),
            "{policy}"
        );
        let files = linked(&page.text());
        assert!(files.len() >= 3, "{path}: {files:?}");
        for file in files {
            let answer = app.get(&file).await;
            assert_eq!(answer.status, 200, "{file}");
            let tag = answer.header("etag").unwrap().to_owned();
            let again = Answer::of(
                app.request(reqwest::Method::GET, &file)
                    .header("if-none-match", tag),
            )
            .await;
            assert_eq!((again.status, again.bytes.len()), (304, 0), "{file}");
        }
    }
    app.get("/assets/no-such-file.js")
        .await
        .problem(404, "not_found");
}

#[tokio::test]
async fn the_front_page_says_whether_a_key_is_needed() {
    let app = TestApp::spawn().await;
    assert!(app.get("/").await.text().contains("data-auth=\"none\""));
    assert_eq!(
        app.get("/v1/me").await.ok(200)["scopes"],
        serde_json::json!(["admin"])
    );
}
