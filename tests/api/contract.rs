use crate::app::{Answer, TestApp};

#[test]
fn openapi_yaml_is_what_the_code_says() {
    let stored = include_str!("../../openapi.yaml");
    let printed = kincal::http::yaml().unwrap();
    let difference = stored.lines().zip(printed.lines()).position(|(a, b)| a != b);
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
    assert_eq!((contract.status, contract.header("content-type")), (200, Some("application/yaml")));
    assert_eq!(contract.text(), include_str!("../../openapi.yaml"));
    let page = app.get("/").await;
    assert!(page.header("content-type").unwrap().starts_with("text/html"));
    assert!(page.header("content-security-policy").unwrap().contains("default-src 'none'"));
    assert!(page.text().contains("/openapi.yaml") && !page.text().contains("http://") && !page.text().contains("https://"));
    assert_eq!(app.get("/openapi.json").await.ok(200)["info"]["title"], "kincal");
    assert_eq!((app.get("/healthz").await.text(), app.get("/readyz").await.text()), ("ok\n".into(), "ready\n".into()));
}

/// Paths of `src="…"` and `href="…"` on this server.
fn linked(page: &str) -> Vec<String> {
    let attributes = page.split('"').zip(page.split('"').skip(1));
    let own = attributes.filter(|(before, value)| (before.ends_with("src=") || before.ends_with("href=")) && value.starts_with("/assets/"));
    own.map(|(_, value)| value.to_owned()).collect()
}

#[tokio::test]
async fn pages_are_served_with_a_strict_policy_and_their_files_are_there() {
    let app = TestApp::spawn().await;
    for path in ["/", "/docs"] {
        let page = app.get(path).await;
        let policy = page.header("content-security-policy").unwrap().to_owned();
        assert!(policy.contains("script-src 'self'") && !policy.contains("unsafe") && !policy.contains('*'), "{policy}");
        let files = linked(&page.text());
        assert!(files.len() >= 3, "{path}: {files:?}");
        for file in files {
            let answer = app.get(&file).await;
            assert_eq!(answer.status, 200, "{file}");
            let tag = answer.header("etag").unwrap().to_owned();
            let again = Answer::of(app.request(reqwest::Method::GET, &file).header("if-none-match", tag)).await;
            assert_eq!((again.status, again.bytes.len()), (304, 0), "{file}");
        }
    }
    app.get("/assets/no-such-file.js").await.problem(404, "not_found");
}

#[tokio::test]
async fn the_front_page_says_whether_a_key_is_needed() {
    let app = TestApp::spawn().await;
    assert!(app.get("/").await.text().contains("data-auth=\"none\""));
    assert_eq!(app.get("/v1/me").await.ok(200)["scopes"], serde_json::json!(["admin"]));
}
