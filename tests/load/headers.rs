//! Random bytes in headers, paths and queries: the answer is a success or a 4xx, never a 5xx, and the next client is served.

use crate::app::TestApp;
use crate::clients::{impatient, short};
use crate::raw::Raw;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Environment variable with the number of requests; more overnight.
const REQUESTS: &str = "KINCAL_HEADERS";
const REQUESTS_BY_DEFAULT: usize = 600;
/// Concurrent requests: fewer than a process may have open files.
const AT_ONCE: usize = 300;

const NAMES: [&str; 14] = [
    "authorization",
    "content-type",
    "content-length",
    "content-encoding",
    "transfer-encoding",
    "idempotency-key",
    "if-none-match",
    "accept",
    "accept-encoding",
    "cookie",
    "expect",
    "host",
    "upgrade",
    "x-request-id",
];

/// Texts with a meaning for parsers, which are mixed with random bytes.
const PARTS: [&[u8]; 24] = [
    b"Bearer ",
    b"bearer",
    b"Basic dTpw",
    b"kincal_",
    b"application/json",
    b"text/csv",
    b"; decimal=comma",
    b"; charset=\"",
    b"gzip",
    b"identity",
    b"chunked",
    b"100-continue",
    b"-1",
    b"18446744073709551616",
    b"0x10",
    b"W/\"",
    b"\"",
    b"*",
    b",",
    b";",
    b"=",
    b"\xff\xfe",
    b"\t \t",
    b"q=0.5",
];

fn value(random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut value = Vec::new();
    for _ in 0..random.random_range(0..5) {
        if random.random_bool(0.95) {
            value.extend(PARTS[random.random_range(0..PARTS.len())]);
        } else {
            // Any byte except those that end a header.
            value.extend(
                (0..random.random_range(0..40))
                    .map(|_| random.random_range(1..=255_u8))
                    .filter(|b| !matches!(b, b'\r' | b'\n')),
            );
        }
    }
    value
}

fn request(random: &mut ChaCha8Rng, robot: &str) -> Vec<u8> {
    let method: &[u8] = [
        b"GET".as_slice(),
        b"POST",
        b"PUT",
        b"DELETE",
        b"HEAD",
        b"OPTIONS",
        b"BREW",
    ][random.random_range(0..7)];
    let paths = [robot, "/v1/robots", "/metrics", "/v1/jobs/x", "/"].map(str::to_owned);
    let mut request = [
        method,
        b" ",
        paths[random.random_range(0..paths.len())].as_bytes(),
    ]
    .concat();
    for (sign, name) in
        ["/", "?", "&", "&"]
            .iter()
            .zip(["measurement-sets", "frame=base", "limit=", "cursor="])
    {
        if random.random_bool(0.5) {
            let tail = (0..random.random_range(0..12)).map(|_| random.random_range(b'!'..=b'~'));
            request.extend([sign.as_bytes(), name.as_bytes(), &tail.collect::<Vec<_>>()].concat());
        }
    }
    request.extend(b" HTTP/1.1\r\n");
    // Most requests have a valid `Host`: otherwise the server would read nothing else.
    if random.random_bool(0.9) {
        request.extend(b"host: localhost\r\n");
    }
    for _ in 0..random.random_range(0..6) {
        request.extend(
            [
                NAMES[random.random_range(0..NAMES.len())].as_bytes(),
                b": ",
                &value(random),
                b"\r\n",
            ]
            .concat(),
        );
    }
    request.extend(b"connection: close\r\n\r\n{}");
    request
}

#[tokio::test]
async fn any_headers_are_the_clients_fault_or_fine() {
    let n = std::env::var(REQUESTS)
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(REQUESTS_BY_DEFAULT);
    // An announced body that never comes waits for the timeout, so many requests run concurrently.
    let (app, _dir) = impatient(short()).await;
    let robot = app.paper_robot().await;
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let (mut requests, mut statuses) = (
        tokio::task::JoinSet::new(),
        std::collections::BTreeMap::new(),
    );
    for already in (0..n).step_by(AT_ONCE) {
        for _ in already..n.min(already + AT_ONCE) {
            let (request, address) = (request(&mut random, &robot), app.server.address);
            requests.spawn(async move {
                let mut client = Raw::connect(address).await;
                client.send(&request).await;
                (client.rest().await, request)
            });
        }
        while let Some(requests) = requests.join_next().await {
            let (answer, request) = requests.unwrap();
            let status = answer.split(' ').nth(1).unwrap_or("none").to_owned();
            let is_theirs = answer.is_empty()
                || ["2", "3", "4"]
                    .iter()
                    .any(|class| status.starts_with(class))
                || status == "503";
            assert!(is_theirs, "{}\n{answer}", String::from_utf8_lossy(&request));
            *statuses.entry(status).or_insert(0) += 1;
        }
    }
    eprintln!("{n} requests: {statuses:?}");
    assert!(
        statuses.len() >= 5 && TestApp::get(&app, "/readyz").await.status == 200,
        "{statuses:?}"
    );
}
