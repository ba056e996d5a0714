//! Ten times as many uploads as promised (docs/operations.md, "Load"): accepted ones are stored, the rest are refused quickly, and jobs can be
//! cancelled meanwhile.

use crate::process::Server;
use std::path::Path;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

/// Promised durable uploads per second (docs/operations.md, "Load").
const PROMISED_PER_S: f64 = 150.0;
/// Ten times the promise.
const RATE_PER_S: f64 = 10.0 * PROMISED_PER_S;
/// Connections that the requests are spread over.
const CLIENTS: usize = 300;
const SECONDS: f64 = 4.0;
/// Longest time to a refusal; [`CANCELLED_WITHIN`] is that of a cancellation (docs/trust.md).
const REFUSED_WITHIN: Duration = Duration::from_millis(250);
const CANCELLED_WITHIN: Duration = Duration::from_secs(1);
/// Jobs that are cancelled one after the other during the flood.
const JOBS: usize = 10;

/// Status of an answer, and whether it has `Retry-After`.
async fn answer(stream: &mut TcpStream) -> Option<(u16, bool)> {
    let (mut bytes, mut chunk) = (Vec::new(), [0; 4096]);
    loop {
        let n = stream.read(&mut chunk).await.ok().filter(|n| *n > 0)?;
        bytes.extend_from_slice(&chunk[..n]);
        let text = String::from_utf8_lossy(&bytes).to_ascii_lowercase();
        let Some((head, body)) = text.split_once("\r\n\r\n") else {
            continue;
        };
        let length: usize = head
            .lines()
            .find_map(|line| line.strip_prefix("content-length: "))
            .expect("a length")
            .parse()
            .unwrap();
        if body.len() >= length {
            for name in [
                "x-request-id",
                "x-content-type-options",
                "content-security-policy",
            ] {
                assert!(head.contains(&format!("\r\n{name}: ")), "{head}");
            }
            return Some((
                head[9..12].parse().unwrap(),
                head.contains("\r\nretry-after: "),
            ));
        }
    }
}

/// An answer and the time from the request to it.
struct Answer {
    status: u16,
    took: Duration,
}

/// Sends a request and keeps the connection open if the server does. `None` if the server closed the connection meanwhile.
async fn send(open: &mut Option<TcpStream>, address: &str, request: &[u8]) -> Option<Answer> {
    let mut stream = match open.take() {
        Some(stream) => stream,
        None => TcpStream::connect(address)
            .await
            .expect("the server accepts"),
    };
    let begun = Instant::now();
    stream.write_all(request).await.ok()?;
    let (status, says_when) = answer(&mut stream).await?;
    *open = Some(stream);
    assert_eq!(
        says_when,
        matches!(status, 429 | 503),
        "Retry-After of {status}"
    );
    Some(Answer {
        status,
        took: begun.elapsed(),
    })
}

/// One client of an open loop at [`RATE_PER_S`]: it sends every [`CLIENTS`]th request.
async fn client(number: usize, begun: Instant, address: String, request: Vec<u8>) -> Vec<Answer> {
    let (mut answers, mut open) = (Vec::new(), None);
    for i in (number..(RATE_PER_S * SECONDS) as usize).step_by(CLIENTS) {
        sleep_until(begun + Duration::from_secs_f64(i as f64 / RATE_PER_S)).await;
        answers.extend(send(&mut open, &address, &request).await);
    }
    answers
}

async fn flood(address: &str, upload: &[u8], cancellations: &[Vec<u8>]) -> Vec<Answer> {
    let begun = Instant::now();
    let mut clients = JoinSet::new();
    for number in 0..CLIENTS {
        clients.spawn(client(number, begun, address.to_owned(), upload.to_vec()));
    }
    let mut open = None;
    for (i, request) in cancellations.iter().enumerate() {
        sleep_until(begun + Duration::from_secs_f64(SECONDS * (i + 1) as f64 / (JOBS + 1) as f64))
            .await;
        let answer = send(&mut open, address, request).await.expect("an answer");
        assert_eq!(answer.status, 200);
        assert!(answer.took < CANCELLED_WITHIN, "{:?}", answer.took);
    }
    clients.join_all().await.into_iter().flatten().collect()
}

#[test]
fn ten_times_as_many_uploads_as_promised_are_stored_or_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 0);
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/paper");
    let robot = server.robot(&data.join("robot.json"));
    let csv = std::fs::read_to_string(data.join("first.csv")).unwrap();
    let csv = csv.lines().take(61).collect::<Vec<_>>().join("\n");
    let path = format!("/v1/robots/{robot}/measurement-sets?frame=base");
    let set = server.create(&path, "text/csv", csv.clone().into_bytes());
    let post = |path: &str, content_type: &str, body: &str| {
        let length = body.len();
        format!("POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {content_type}\r\ncontent-length: {length}\r\n\r\n{body}")
            .into_bytes()
    };
    let job = format!("{{\"measurement_set_id\":\"{set}\"}}").into_bytes();
    let cancellations: Vec<_> = (0..JOBS)
        .map(|_| {
            server.create(
                &format!("/v1/robots/{robot}/jobs"),
                "application/json",
                job.clone(),
            )
        })
        .map(|id| post(&format!("/v1/jobs/{id}/cancel"), "", ""))
        .collect();
    let address = server.url.strip_prefix("http://").unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let answers = runtime.block_on(flood(
        address,
        &post(&path, "text/csv", &csv),
        &cancellations,
    ));
    let of = |statuses: &[u16]| -> Vec<Duration> {
        let answers = answers
            .iter()
            .filter(|answer| statuses.contains(&answer.status));
        let mut took: Vec<_> = answers.map(|answer| answer.took).collect();
        took.sort();
        took
    };
    let (stored, refused) = (of(&[201]), of(&[429, 503]));
    assert_eq!(stored.len() + refused.len(), answers.len(), "other answers");
    let p99 = |took: &[Duration]| took.get(took.len() * 99 / 100).copied().unwrap_or_default();
    println!(
        "{} stored, p99 {:?}; {} refused, p99 {:?}",
        stored.len(),
        p99(&stored),
        refused.len(),
        p99(&refused)
    );
    assert!(p99(&refused) <= REFUSED_WITHIN);
    let enough = PROMISED_PER_S * SECONDS;
    assert!(stored.len() as f64 >= enough, "{enough} were promised");
    let n_stored = stored_sets(&server, &robot);
    let unanswered = (RATE_PER_S * SECONDS) as usize - answers.len();
    // One was uploaded before the flood.
    let acknowledged = stored.len() + 1;
    assert!(
        (acknowledged..=acknowledged + unanswered).contains(&n_stored),
        "{n_stored} kept, {acknowledged} acknowledged, {unanswered} unanswered"
    );
}

/// Number of the robot's measurement sets, page by page.
fn stored_sets(server: &Server, robot: &str) -> usize {
    let (mut n, mut cursor) = (0, String::new());
    loop {
        let path = format!("/v1/robots/{robot}/measurement-sets?limit=200{cursor}");
        let (status, page) = server.get(&path);
        assert_eq!(status, 200, "{page}");
        n += page["items"].as_array().unwrap().len();
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => return n,
        }
    }
}
