//! Which hosts and origins are answered, and requests that reach no route. The requests are written byte by byte, as no HTTP library would.

use crate::app::{Answer, TestApp};
use crate::raw::Raw;
use kincal::config::ServeConfig;
use reqwest::Method;
use serde_json::{Value, json};

/// Paths of every kind: pages, contract, health, metrics, data, and an unknown one.
const PATHS: [&str; 8] = [
    "/",
    "/docs",
    "/assets/app.js",
    "/healthz",
    "/openapi.yaml",
    "/metrics",
    "/v1/robots",
    "/nowhere",
];

/// Sends one request. Returns the status, the header in lower case, and the body.
async fn answer(app: &TestApp, request: &str) -> (u16, String, String) {
    let mut client = Raw::connect(app.server.address).await;
    assert!(client.send(request.as_bytes()).await);
    let answer = client.rest().await;
    let (header, body) = answer
        .split_once("\r\n\r\n")
        .unwrap_or_else(|| panic!("no answer to {request:?}: {answer:?}"));
    let status = header.split(' ').nth(1).unwrap().parse().unwrap();
    (status, header.to_lowercase(), body.into())
}

/// Asserts that an answer is a problem document with the right headers and length.
fn problem((status, header, body): (u16, String, String)) -> (u16, String) {
    for expected in [
        "content-type: application/problem+json\r\n",
        "x-request-id: ",
        "x-content-type-options: nosniff",
    ] {
        assert!(header.contains(expected), "{expected:?} in {header}");
    }
    let length = format!("content-length: {}", body.len());
    assert!(
        header.lines().any(|line| line == length) && header.matches("content-length").count() == 1,
        "{length} in {header}"
    );
    let problem: Value = serde_json::from_str(&body).unwrap_or_else(|e| panic!("{e}: {body}"));
    assert_eq!(problem["status"], status, "{problem}");
    assert!(problem["detail"].as_str().unwrap().len() > 20, "{problem}");
    (status, problem["code"].as_str().unwrap().into())
}

fn get(path: &str, headers: &str) -> String {
    format!("GET {path} HTTP/1.1\r\n{headers}connection: close\r\n\r\n")
}

#[tokio::test]
async fn without_keys_only_loopback_names_are_answered() {
    let app = TestApp::spawn().await;
    let port = app.server.address.port();
    for host in ["localhost", "LOCALHOST", "127.0.0.1", "127.1.2.3", "[::1]"] {
        for host in [host.to_owned(), format!("{host}:{port}")] {
            let (status, _, body) =
                answer(&app, &get("/healthz", &format!("host: {host}\r\n"))).await;
            assert_eq!((status, body.as_str()), (200, "ok\n"), "{host}");
        }
    }
    for host in [
        "evil.example",
        "rebound.evil.example:8080",
        "localhost.evil.example",
        "127.0.0.1.nip.io",
        "192.168.1.5",
        "0.0.0.0",
        "[::ffff:127.0.0.1]",
    ] {
        for path in PATHS {
            let refused = answer(&app, &get(path, &format!("host: {host}\r\n"))).await;
            let found = problem(refused);
            assert_eq!(found, (421, "host_not_loopback".into()), "{host} {path}");
        }
    }
    // The request target may contain the host, too.
    let refused = answer(
        &app,
        &get("http://evil.example/v1/robots", "host: localhost\r\n"),
    )
    .await;
    assert_eq!(problem(refused), (421, "host_not_loopback".into()));
}

#[tokio::test]
async fn with_keys_a_server_answers_to_any_name() {
    let dir = tempfile::tempdir().unwrap();
    let config = ServeConfig {
        no_auth: false,
        ..ServeConfig::loopback(dir.path().join("data"), 0)
    };
    let app = TestApp::with_config(config).await;
    let headers = "host: kincal.example\r\norigin: https://elsewhere.example\r\n";
    assert_eq!(answer(&app, &get("/healthz", headers)).await.0, 200);
    let refused = answer(&app, &get("/v1/robots", headers)).await;
    assert_eq!(problem(refused), (401, "unauthorized".into()));
}

/// A request with these headers.
async fn with(
    app: &TestApp,
    method: Method,
    path: &str,
    headers: &[(&str, &str)],
    body: &str,
) -> Answer {
    let request = headers
        .iter()
        .fold(app.request(method, path), |request, (name, value)| {
            request.header(*name, *value)
        });
    Answer::of(request.body(body.to_owned())).await
}

#[tokio::test]
async fn without_keys_a_page_of_another_site_can_do_nothing() {
    let app = TestApp::with_workers(1).await;
    let (_, job) = app.identified().await;
    let set = format!(
        "/v1/parameter-sets/{}",
        job["parameter_set_id"].as_str().unwrap()
    );
    let reason = json!({"reason": "a page of another site"}).to_string();
    let json = ("content-type", "application/json");
    let other_port = format!("http://localhost:{}", app.server.address.port() ^ 1);
    let scheme_of_nobody = format!("ftp://{}", app.server.address);
    for action in ["release", "withdraw"] {
        let path = format!("{set}/{action}");
        for origin in [
            "https://evil.example",
            "null",
            "",
            "file://",
            other_port.as_str(),
            scheme_of_nobody.as_str(),
        ] {
            let refused = with(
                &app,
                Method::POST,
                &path,
                &[json, ("origin", origin)],
                &reason,
            )
            .await;
            refused.problem(403, "foreign_origin");
        }
        for site in ["cross-site", "same-site", "something-new"] {
            let headers = [
                json,
                ("sec-fetch-site", site),
                ("sec-fetch-mode", "navigate"),
            ];
            with(&app, Method::POST, &path, &headers, &reason)
                .await
                .problem(403, "foreign_origin");
        }
        // A form from an old browser that sends no origin.
        for kind in [
            "text/plain",
            "application/x-www-form-urlencoded",
            "Multipart/Form-Data; boundary=x",
        ] {
            with(
                &app,
                Method::POST,
                &path,
                &[("content-type", kind)],
                &reason,
            )
            .await
            .problem(415, "unsupported_media_type");
        }
    }
    for path in PATHS {
        let foreign = [("origin", "https://evil.example")];
        with(&app, Method::GET, path, &foreign, "")
            .await
            .problem(403, "foreign_origin");
        let embedded = [
            ("sec-fetch-site", "cross-site"),
            ("sec-fetch-mode", "no-cors"),
        ];
        with(&app, Method::GET, path, &embedded, "")
            .await
            .problem(403, "foreign_origin");
    }
    assert_eq!(app.get(&set).await.ok(200)["status"], "candidate");

    // The server's own page may, a link from another site may, and programs other than browsers send none of these headers.
    let own = app.server.url();
    let headers = [
        json,
        ("origin", own.as_str()),
        ("sec-fetch-site", "same-origin"),
    ];
    with(
        &app,
        Method::POST,
        &format!("{set}/release"),
        &headers,
        &reason,
    )
    .await
    .ok(200);
    let link = [
        ("sec-fetch-site", "cross-site"),
        ("sec-fetch-mode", "navigate"),
    ];
    assert_eq!(with(&app, Method::GET, "/", &link, "").await.status, 200);
    app.post(&format!("{set}/withdraw"), "application/json", reason)
        .await
        .ok(200);
}

#[tokio::test]
async fn a_host_that_is_missing_doubled_or_none_is_400() {
    for no_auth in [true, false] {
        let dir = tempfile::tempdir().unwrap();
        let config = ServeConfig {
            no_auth,
            ..ServeConfig::loopback(dir.path().join("data"), 0)
        };
        let app = TestApp::with_config(config).await;
        for path in PATHS {
            for (headers, code) in [
                ("", "missing_host"),
                ("host: localhost\r\nhost: localhost\r\n", "repeated_host"),
                ("Host: localhost\r\nhost: evil.example\r\n", "repeated_host"),
                ("host: somebody@localhost\r\n", "invalid_host"),
                ("host: local host\r\n", "invalid_host"),
                ("host: \r\n", "invalid_host"),
                ("host: http://localhost/\r\n", "invalid_host"),
                ("host: 127.0.0.1:80.evil.example\r\n", "invalid_host"),
                ("host: [::1].evil.example\r\n", "invalid_host"),
            ] {
                let refused = answer(&app, &get(path, headers)).await;
                assert_eq!(problem(refused), (400, code.into()), "{path} {headers:?}");
            }
        }
        // HTTP/1.0 has no Host; load balancers use it for health checks.
        let (status, ..) = answer(&app, "GET /readyz HTTP/1.0\r\n\r\n").await;
        assert_eq!(status, 200);
    }
}

#[tokio::test]
async fn requests_refused_by_hyper_answer_a_problem() {
    let app = TestApp::spawn().await;
    let many = (0..101)
        .map(|i| format!("x-{i}: a\r\n"))
        .collect::<String>();
    let large = format!("x-long: {}\r\n", "a".repeat(60 * 1024));
    for (request, status, code) in [
        (
            get("/healthz", &format!("host: localhost\r\n{many}")),
            431,
            "header_too_large",
        ),
        (
            get("/healthz", &format!("host: localhost\r\n{large}")),
            431,
            "header_too_large",
        ),
        (
            "G@T / HTTP/1.1\r\nhost: localhost\r\n\r\n".into(),
            400,
            "malformed_request",
        ),
        (
            "GET / HTTP/9.9\r\nhost: localhost\r\n\r\n".into(),
            400,
            "malformed_request",
        ),
        (
            "GET /a b HTTP/1.1\r\nhost: localhost\r\n\r\n".into(),
            400,
            "malformed_request",
        ),
        ("\u{0}\u{1}\u{2}\r\n\r\n".into(), 400, "malformed_request"),
        (
            get("/", "host: localhost\r\nbad name: 1\r\n"),
            400,
            "malformed_request",
        ),
        (
            get("/", "host: localhost\r\ncontent-length: many\r\n"),
            400,
            "malformed_request",
        ),
        (
            get(
                "/",
                "host: localhost\r\ncontent-length: 1\r\ncontent-length: 2\r\n",
            ),
            400,
            "malformed_request",
        ),
        (
            get("/", "host: localhost\r\ntransfer-encoding: gzip\r\n"),
            400,
            "malformed_request",
        ),
    ] {
        let start: String = request.chars().take(60).collect();
        let refused = answer(&app, &request).await;
        assert!(
            refused.1.contains("connection: close"),
            "{start}: {}",
            refused.1
        );
        assert_eq!(problem(refused), (status, code.into()), "{start}");
        // Also after an answered request on the same connection.
        let second = format!("GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n{request}");
        let (first, header, rest) = answer(&app, &second).await;
        let (ok, rest) = rest.split_at(3);
        assert_eq!(
            (first, ok, header.contains("content-length: 3")),
            (200, "ok\n", true)
        );
        let (header, body) = rest.split_once("\r\n\r\n").unwrap();
        let status_said = header.split(' ').nth(1).unwrap().parse().unwrap();
        let refused = (status_said, header.to_lowercase(), body.to_owned());
        assert_eq!(problem(refused), (status, code.into()), "second: {start}");
    }
    let counted = app.get("/metrics").await.text();
    for code in ["header_too_large", "malformed_request"] {
        assert!(counted.contains(&format!("code=\"{code}\"")), "{counted}");
    }
}
