use crate::app::TestApp;

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
    assert_eq!((app.get("/healthz").await.text(), app.get("/readyz").await.text()), ("ok\n".into(), "ready\n".into()));
}
