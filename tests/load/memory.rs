//! Peak memory of the whole process under the largest bodies and answers, as the operating system reports it.

use crate::process::Server;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::JoinSet;

/// Concurrent bodies of the largest size.
const BODIES: usize = 64;
/// Bound promised in docs/trust.md.
const MAX_MIB: u64 = 400;
/// Longest time until the server has noticed that clients have disconnected, on a busy machine.
const FREE_AGAIN_WITHIN: Duration = Duration::from_secs(8);

/// Bodies of the largest size: one endless cell, valid rows, points in JSON, one point with endless joint values, and JSON that
/// has only nesting.
fn bodies() -> [(&'static str, Vec<u8>); 5] {
    let header = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n";
    let filled = |start: &str, with: &str| {
        let n = (kincal::http::MAX_BODY_BYTES - start.len()) / with.len();
        [start, &with.repeat(n)].concat().into_bytes()
    };
    [
        ("text/csv", filled(header, "1")),
        (
            "text/csv",
            filled(header, "10.25,20.5,-30,40,50,60,1000.125,200,300\n"),
        ),
        (
            "application/json",
            filled(
                "{\"frame\":\"base\",\"points\":[",
                "{\"q_deg\":[1,2,3,4,5,6],\"position_mm\":[0,0,0]},",
            ),
        ),
        (
            "application/json",
            filled("{\"frame\":\"base\",\"points\":[{\"q_deg\":[", "1,"),
        ),
        ("application/json", filled("{\"points\":", "[")),
    ]
}

async fn post(
    address: String,
    path: String,
    content_type: &'static str,
    body: Arc<Vec<u8>>,
) -> Option<u16> {
    let mut stream = TcpStream::connect(&address)
        .await
        .expect("the server accepts");
    let head = format!(
        "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {content_type}\r\ncontent-length: {}\r\n\r\n",
        body.len()
    );
    let (mut reader, mut writer) = stream.split();
    // A server that answers before it has read everything may close while the client still writes.
    let send = async {
        let _ = writer.write_all(head.as_bytes()).await;
        let _ = writer.write_all(&body).await;
        std::future::pending::<()>().await;
    };
    let mut answer = [0; 12];
    tokio::select! {
        () = send => None,
        read = reader.read_exact(&mut answer) => read.ok().and_then(|_| std::str::from_utf8(&answer[9..12]).ok()?.parse().ok()),
    }
}

/// Peak memory of the process, MiB.
fn peak_mib(server: &Server) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", server.id())).unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .expect("its peak");
    line.split_whitespace()
        .next()
        .unwrap()
        .parse::<u64>()
        .unwrap()
        / 1024
}

#[test]
fn sixty_four_of_the_largest_bodies_at_once_stay_within_memory() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 0);
    let robot = server.robot(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data/paper/robot.json"));
    let path = format!("/v1/robots/{robot}/measurement-sets");
    let address = server.url.strip_prefix("http://").unwrap().to_owned();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    for (content_type, body) in bodies() {
        let body = Arc::new(body);
        let mut all = JoinSet::new();
        for _ in 0..BODIES {
            runtime.block_on(async {
                drop(all.spawn(post(
                    address.clone(),
                    path.clone(),
                    content_type,
                    Arc::clone(&body),
                )))
            });
        }
        let answers: Vec<u16> = runtime
            .block_on(all.join_all())
            .into_iter()
            .flatten()
            .collect();
        assert!(
            answers
                .iter()
                .all(|status| matches!(status, 400 | 422 | 503)),
            "{answers:?}"
        );
        // At least one body was read to its end: otherwise the test has measured nothing.
        assert!(answers.iter().any(|status| *status != 503), "{answers:?}");
        println!(
            "{content_type}: {} refused for what is in them, {} unread; at most {} MiB so far",
            answers.iter().filter(|s| **s != 503).count(),
            answers.iter().filter(|s| **s == 503).count(),
            peak_mib(&server)
        );
    }
    assert!(peak_mib(&server) <= MAX_MIB, "{} MiB", peak_mib(&server));
}

/// Bytes of an unread answer: more than the kernel buffers for a connection.
const ANSWER_BYTES: usize = 16 * 1024 * 1024;
/// Clients that do not read; their answers have 640 MiB in total.
const NOT_READING: usize = 40;

/// Sends a request and reads only the status; the stream stays open.
async fn ask(address: &str, path: &str) -> (u16, TcpStream) {
    let mut stream = TcpStream::connect(address)
        .await
        .expect("the server accepts");
    stream
        .write_all(format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n\r\n").as_bytes())
        .await
        .unwrap();
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).await.expect("a status");
    (
        std::str::from_utf8(&answer[9..12])
            .unwrap()
            .parse()
            .unwrap(),
        stream,
    )
}

#[test]
fn clients_that_do_not_read_their_answers_stay_within_memory_and_are_refused_beyond_it() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 0);
    let robot = server.robot(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data/paper/robot.json"));
    // White space makes the document large.
    let mut body =
        b"{\"frame\":\"base\",\"points\":[{\"q_deg\":[1,2,3,4,5,6],\"position_mm\":[500,0,900]}]}"
            .to_vec();
    body.resize(ANSWER_BYTES, b' ');
    let set = server.create(
        &format!("/v1/robots/{robot}/measurement-sets"),
        "application/json",
        body,
    );
    let path = format!("/v1/measurement-sets/{set}/points");
    let address = server.url.strip_prefix("http://").unwrap().to_owned();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let not_reading = runtime.block_on(async {
        let mut all = JoinSet::new();
        for _ in 0..NOT_READING {
            let (address, path) = (address.clone(), path.clone());
            all.spawn(async move { ask(&address, &path).await });
        }
        all.join_all().await
    });
    let count = |status: u16| {
        not_reading
            .iter()
            .filter(|(found, _)| *found == status)
            .count()
    };
    println!(
        "{} kept, {} refused; at most {} MiB",
        count(200),
        count(503),
        peak_mib(&server)
    );
    assert!(
        count(200) > 0 && count(503) > 0 && count(200) + count(503) == NOT_READING,
        "{} kept, {} refused",
        count(200),
        count(503)
    );
    assert_eq!(
        runtime.block_on(ask(&address, &path)).0,
        503,
        "there is no room for one more"
    );
    assert_eq!(
        server.get(&format!("/v1/measurement-sets/{set}")).0,
        200,
        "small answers go on"
    );
    assert!(peak_mib(&server) <= MAX_MIB, "{} MiB", peak_mib(&server));
    drop(not_reading);
    let begun = Instant::now();
    while runtime.block_on(ask(&address, &path)).0 != 200 {
        assert!(
            begun.elapsed() < FREE_AGAIN_WITHIN,
            "clients that are gone keep their room"
        );
    }
}
