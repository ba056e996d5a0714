use crate::app::{TestApp, paper};
use crate::raw::Raw;
use kincal::config::{LimitsConfig, ServeConfig};
use std::time::{Duration, Instant};

/// Timeout of clients in these tests; short, so that the tests are quick.
const CLIENT_TIMEOUT_S: u64 = 1;
/// The timeout plus the delays of a busy machine.
const CUT_OFF_WITHIN: Duration = Duration::from_secs(CLIENT_TIMEOUT_S + 9);
/// Longest wait of other clients meanwhile: ten times the promised 100 ms, for an unoptimised build on a busy machine.
const OTHERS_WITHIN: Duration = Duration::from_secs(1);
const PAUSE: Duration = Duration::from_millis(50);

pub async fn impatient(limits: LimitsConfig) -> (TestApp, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let config = ServeConfig {
        limits,
        ..ServeConfig::loopback(dir.path().join("data"), 0)
    };
    (TestApp::with_config(config).await, dir)
}

pub fn short() -> LimitsConfig {
    LimitsConfig {
        client_timeout_s: CLIENT_TIMEOUT_S,
        ..LimitsConfig::default()
    }
}

#[tokio::test]
async fn a_silent_client_is_cut_off() {
    let (app, _dir) = impatient(short()).await;
    let begun = Instant::now();
    Raw::connect(app.server.address).await.rest().await;
    assert!(
        begun.elapsed() >= Duration::from_secs(CLIENT_TIMEOUT_S)
            && begun.elapsed() < CUT_OFF_WITHIN,
        "{:?}",
        begun.elapsed()
    );
}

#[tokio::test]
async fn a_client_that_is_silent_after_an_answer_is_cut_off() {
    let (app, _dir) = impatient(short()).await;
    let begun = Instant::now();
    let mut client = Raw::connect(app.server.address).await;
    client
        .send(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n")
        .await;
    assert!(client.rest().await.starts_with("HTTP/1.1 200"));
    assert!(begun.elapsed() < CUT_OFF_WITHIN, "{:?}", begun.elapsed());
}

#[tokio::test]
async fn a_dribbling_header_is_cut_off() {
    let (app, _dir) = impatient(short()).await;
    let (took, _) = Raw::connect(app.server.address)
        .await
        .dribble(b"GET / HTTP/1.1\r\nx-slow: ", b'a', PAUSE)
        .await;
    assert!(took < CUT_OFF_WITHIN, "{took:?}");
}

#[tokio::test]
async fn a_dribbling_body_is_cut_off_with_408_and_nothing_is_stored() {
    let (app, _dir) = impatient(short()).await;
    let robot = app.paper_robot().await;
    let length = paper("first.csv").len();
    let header = format!(
        "POST {robot}/measurement-sets HTTP/1.1\r\nhost: localhost\r\ncontent-type: text/csv\r\ncontent-length: {length}\r\n\r\nq1_deg"
    );
    let (took, answer) = Raw::connect(app.server.address)
        .await
        .dribble(header.as_bytes(), b'1', PAUSE)
        .await;
    assert!(took < CUT_OFF_WITHIN, "{took:?}");
    assert!(
        answer.starts_with("HTTP/1.1 408") && answer.contains("request_timeout"),
        "{answer}"
    );
    assert!(
        app.get(&format!("{robot}/measurement-sets")).await.ok(200)["items"]
            .as_array()
            .unwrap()
            .is_empty()
    );
}

#[tokio::test]
async fn a_refusal_reaches_a_client_that_is_still_sending() {
    let (app, _dir) = impatient(LimitsConfig::default()).await;
    let robot = app.paper_robot().await;
    let too_large = 33 << 20;
    let body = format!(
        "POST {robot}/measurement-sets HTTP/1.1\r\nhost: localhost\r\ncontent-type: text/csv\r\ncontent-length: {too_large}\r\n\r\n"
    );
    let header = format!(
        "GET /healthz HTTP/1.1\r\nhost: localhost\r\nx-long: {}",
        "a".repeat(40 * 1024)
    );
    for (first, expected) in [(body, "HTTP/1.1 413"), (header, "HTTP/1.1 431")] {
        let mut client = Raw::connect(app.server.address).await;
        assert!(client.send(first.as_bytes()).await);
        for _ in 0..4 {
            tokio::time::sleep(PAUSE).await;
            assert!(
                client.send(&[b'1'; 64 * 1024]).await,
                "{expected}: the server still listens"
            );
        }
        let answer = client.rest().await;
        assert!(answer.starts_with(expected), "{answer}");
    }
}

#[tokio::test]
async fn slow_clients_do_not_keep_others_waiting() {
    let (app, _dir) = impatient(short()).await;
    let robot = app.paper_robot().await;
    let body = format!(
        "POST {robot}/measurement-sets HTTP/1.1\r\nhost: localhost\r\ncontent-type: text/csv\r\ncontent-length: 30000000\r\n\r\nq"
    );
    let mut slow = tokio::task::JoinSet::new();
    for i in 0..300 {
        let first = [b"".as_slice(), b"GET / HTTP/1.1\r\nx: ", body.as_bytes()][i % 3].to_vec();
        let client = Raw::connect(app.server.address).await;
        slow.spawn(async move { client.dribble(&first, b'a', PAUSE).await.0 });
    }
    let mut worst = Duration::ZERO;
    for _ in 0..20 {
        let begun = Instant::now();
        app.get(&robot).await.ok(200);
        app.upload(&robot, "first.csv").await;
        worst = worst.max(begun.elapsed());
    }
    assert!(worst < OTHERS_WITHIN, "{worst:?}");
    let last = slow.join_all().await.into_iter().max().unwrap();
    assert!(last < 2 * CUT_OFF_WITHIN, "{last:?}");
}

#[tokio::test]
async fn one_connection_too_many_is_told_to_come_back() {
    let (app, _dir) = impatient(LimitsConfig {
        max_connections: 2,
        ..short()
    })
    .await;
    let mut idle = Vec::new();
    for _ in 0..2 {
        let mut client = Raw::connect(app.server.address).await;
        client
            .send(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n")
            .await;
        client.0.readable().await.unwrap();
        idle.push(client);
    }
    let mut one_more = Raw::connect(app.server.address).await;
    one_more
        .send(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n")
        .await;
    let answer = one_more.rest().await;
    assert!(
        answer.starts_with("HTTP/1.1 503")
            && answer.contains("retry-after: 1")
            && answer.contains("too_many_connections"),
        "{answer}"
    );
    for client in &mut idle {
        client.rest().await;
    }
    assert_eq!(
        app.get("/healthz").await.status,
        200,
        "room again once the idle ones were cut off"
    );
    let metrics = app.get("/metrics").await.text();
    assert!(
        metrics.contains("kincal_errors_total{code=\"too_many_connections\"} 1\n"),
        "{metrics}"
    );
}

#[tokio::test]
async fn a_client_that_does_not_read_its_answer_is_cut_off() {
    let (app, _dir) = impatient(short()).await;
    let mut client = Raw::connect(app.server.address).await;
    // More requests than all buffers hold: a server that waits for its answers to be read stops reading requests.
    let requests = "GET /openapi.yaml HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(1_000_000);
    let sending = client.send(requests.as_bytes());
    let sent = tokio::time::timeout(CUT_OFF_WITHIN, sending)
        .await
        .expect("the server closes rather than waits");
    assert!(!sent, "the connection is closed");
}
