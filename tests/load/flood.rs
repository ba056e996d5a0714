//! Far more uploads than can be done: those that are taken come to their end, and the others are told at once to come back.

use crate::process::Server;
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::JoinSet;

/// As many as are served without a refusal.
const FEW: usize = 32;
/// Five times as many as may be under way.
const MANY: usize = 640;
const FOR: Duration = Duration::from_secs(4);
/// Of what is done for a few clients, at least this share is done among many, though these take a core of the two for themselves: 0.48 with
/// nothing else running (1,394 and 672 a second), 1.1 to 1.6 beside compilers. Where everything was refused by the threads that work, after
/// routing, it was 0.33 beside compilers; that alone would pass here, and is found by what `/metrics` counts. trust.md asks for 0.9 of a
/// release build, which this does not show.
const SHARE: f64 = 0.25;

#[derive(Default)]
struct Outcome {
    stored: usize,
    refused: usize,
    slowest_refusal: Duration,
}

/// The status of one answer; whether it says when to come back.
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

/// One upload after the other, without a pause.
async fn upload(address: String, request: Vec<u8>, until: Instant) -> Outcome {
    let (mut outcome, mut open) = (Outcome::default(), None);
    while Instant::now() < until {
        let mut stream = match open.take() {
            Some(stream) => stream,
            None => TcpStream::connect(&address)
                .await
                .expect("the server accepts"),
        };
        let begun = Instant::now();
        let answer = match stream.write_all(&request).await {
            Ok(()) => answer(&mut stream).await,
            Err(_) => None,
        };
        // After a refusal the server may close rather than read the rest.
        let Some((status, says_when)) = answer else {
            continue;
        };
        open = Some(stream);
        match status {
            201 => outcome.stored += 1,
            429 | 503 => {
                assert!(says_when, "a refusal says when to come back");
                outcome.refused += 1;
                outcome.slowest_refusal = outcome.slowest_refusal.max(begun.elapsed());
            }
            other => panic!("answered {other}"),
        }
    }
    outcome
}

async fn uploads(address: &str, request: &[u8], clients: usize) -> Outcome {
    let until = Instant::now() + FOR;
    let mut all = JoinSet::new();
    (0..clients).for_each(|_| drop(all.spawn(upload(address.to_owned(), request.to_vec(), until))));
    let outcomes = all.join_all().await;
    Outcome {
        stored: outcomes.iter().map(|outcome| outcome.stored).sum(),
        refused: outcomes.iter().map(|outcome| outcome.refused).sum(),
        slowest_refusal: outcomes
            .iter()
            .map(|outcome| outcome.slowest_refusal)
            .max()
            .unwrap_or_default(),
    }
}

#[test]
fn uploads_that_are_taken_do_not_wait_behind_those_that_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 0);
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/paper");
    let robot = server.robot(&data.join("robot.json"));
    let csv = std::fs::read_to_string(data.join("first.csv")).unwrap();
    let csv = csv.lines().take(21).collect::<Vec<_>>().join("\n");
    let head = format!(
        "POST /v1/robots/{robot}/measurement-sets?frame=base HTTP/1.1\r\nhost: x\r\ncontent-type: text/csv\r\ncontent-length: "
    );
    let request = format!("{head}{}\r\n\r\n{csv}", csv.len()).into_bytes();
    let address = server.url.strip_prefix("http://").unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let alone = runtime.block_on(uploads(address, &request, FEW));
    let flood = runtime.block_on(uploads(address, &request, MANY));
    println!(
        "{FEW} clients: {} stored; {MANY} clients: {} stored, {} refused, the slowest in {:?}",
        alone.stored, flood.stored, flood.refused, flood.slowest_refusal
    );
    assert_eq!(alone.refused, 0);
    assert!(flood.refused > flood.stored, "that was no flood");
    assert!(
        flood.stored as f64 >= SHARE * alone.stored as f64,
        "{} stored among many clients, {} among few",
        flood.stored,
        alone.stored
    );
    let metrics = server.text("/metrics");
    assert!(
        metrics.contains("kincal_requests_total{method=\"POST\",route=\"-\",status=\"503\"}"),
        "{metrics}"
    );
}
