//! Open-loop load against a real server: requests are sent at scheduled times, whether earlier ones are answered or not, and response times count
//! from the scheduled time. Prints a table.
//!
//! `cargo build --release && cargo run --release --example load -- target/release/kincal [seconds]`

#[path = "load/hostile.rs"]
mod hostile;

use anyhow::{Context, ensure};
use kincal::store::leases::{self, Eligible};
use kincal::store::{
    NewJob, NewMeasurementSet, NewRobot, Store, StoreLocation, jobs, measurement_sets, robots,
};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep_until, timeout};

/// Connections that the generator keeps open.
const CONNECTIONS: usize = 128;
/// Connections of a flood: far more than the server allows concurrent uploads.
const FLOOD_CONNECTIONS: usize = 1024;
/// Uploads that are promised, 1/s.
const PROMISED: f64 = 150.0;
/// Offered in a flood, in units of what is promised, and then of what this server can do at its best.
const FLOODS: [f64; 2] = [2.0, 10.0];
/// A request that takes longer has failed.
const PATIENCE: Duration = Duration::from_secs(30);
/// Jobs waiting, for the claim.
const QUEUED: usize = 100_000;
const CLAIMS: usize = 500;

struct Server {
    child: Child,
    address: String,
}

impl Server {
    fn start(binary: &str, data_dir: &std::path::Path) -> anyhow::Result<Self> {
        let mut command = Command::new(binary);
        command
            .args([
                "serve",
                "--listen",
                "127.0.0.1:0",
                "--no-auth",
                "--workers",
                "0",
                "--data-dir",
            ])
            .arg(data_dir);
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .context("the binary starts")?;
        let mut line = String::new();
        BufReader::new(child.stdout.take().context("its output")?).read_line(&mut line)?;
        let address = line
            .trim()
            .strip_prefix("kincal listening on http://")
            .context("it listens")?
            .to_owned();
        Ok(Self { child, address })
    }

    /// Largest memory that it ever had, MiB.
    fn peak_mib(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id()))
            .unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok())
            .unwrap_or(0)
            / 1024
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// One answer: status and time since the scheduled time. A refusal without `Retry-After` counts as failed, status 0.
type Answer = (u16, Duration);

async fn exchange(stream: &mut TcpStream, request: &[u8]) -> anyhow::Result<u16> {
    stream.write_all(request).await?;
    let mut bytes = Vec::new();
    let (head_end, length, says_when) = loop {
        let mut chunk = [0; 16 * 1024];
        let n = stream.read(&mut chunk).await?;
        ensure!(n > 0, "closed");
        bytes.extend_from_slice(&chunk[..n]);
        if let Some(end) = bytes.windows(4).position(|w| w == b"\r\n\r\n") {
            let head = String::from_utf8_lossy(&bytes[..end]).to_ascii_lowercase();
            let length = head
                .lines()
                .find_map(|line| line.strip_prefix("content-length:"))
                .and_then(|n| n.trim().parse().ok());
            break (end + 4, length.unwrap_or(0), head.contains("retry-after:"));
        }
    };
    while bytes.len() < head_end + length {
        let mut chunk = [0; 16 * 1024];
        let n = stream.read(&mut chunk).await?;
        ensure!(n > 0, "closed");
        bytes.extend_from_slice(&chunk[..n]);
    }
    let status = String::from_utf8_lossy(&bytes[9..12]).parse()?;
    Ok(if matches!(status, 429 | 503) && !says_when {
        0
    } else {
        status
    })
}

/// Sends at `rate` for `seconds`, each request at its scheduled time over any free connection. Returns the answer to each request, and the seconds
/// until the last answer.
async fn at_rate(
    address: &str,
    rate: f64,
    seconds: f64,
    connections: usize,
    request: impl Fn(usize) -> Vec<u8> + Send + Sync + 'static,
) -> (Vec<Answer>, f64) {
    let n = (rate * seconds) as usize;
    let (begun, request, next) = (
        Instant::now() + Duration::from_millis(500),
        Arc::new(request),
        Arc::new(AtomicUsize::new(0)),
    );
    let tasks: Vec<_> = (0..connections)
        .map(|_| {
            let (address, request, next) =
                (address.to_owned(), Arc::clone(&request), Arc::clone(&next));
            tokio::spawn(async move {
                let mut answers = Vec::new();
                let mut stream = TcpStream::connect(&address).await.ok();
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    if i >= n {
                        return answers;
                    }
                    let appointed = begun + Duration::from_secs_f64(i as f64 / rate);
                    sleep_until(appointed).await;
                    if stream.is_none() {
                        stream = TcpStream::connect(&address).await.ok();
                    }
                    let status = match &mut stream {
                        Some(open) => timeout(PATIENCE, exchange(open, &request(i)))
                            .await
                            .ok()
                            .and_then(Result::ok),
                        None => None,
                    };
                    if status.is_none() {
                        stream = None;
                    }
                    answers.push((status.unwrap_or(0), appointed.elapsed()));
                }
            })
        })
        .collect();
    let mut all = Vec::new();
    for task in tasks {
        all.extend(task.await.unwrap_or_default());
    }
    (all, begun.elapsed().as_secs_f64())
}

fn percentile(times: &mut [Duration], share: f64) -> f64 {
    times.sort();
    times
        .get(((times.len() as f64 * share) as usize).min(times.len().saturating_sub(1)))
        .map_or(f64::NAN, |t| t.as_secs_f64() * 1e3)
}

/// Prints a row of the table. Returns the number of successes per second.
fn row(what: &str, rate: f64, took_s: f64, answers: &[Answer], target: &str) -> f64 {
    let is_good = |status: u16| (200..300).contains(&status);
    let mut good: Vec<Duration> = answers
        .iter()
        .filter(|(status, _)| is_good(*status))
        .map(|(_, t)| *t)
        .collect();
    let mut told: Vec<Duration> = answers
        .iter()
        .filter(|(status, _)| matches!(status, 429 | 503))
        .map(|(_, t)| *t)
        .collect();
    let other = answers.len() - good.len() - told.len();
    let goodput = good.len() as f64 / took_s;
    println!(
        "| {what} | {rate:.0} | {goodput:.0} | {:.1} | {:.1} | {} | {:.1} | {other} | {target} |",
        percentile(&mut good, 0.5),
        percentile(&mut good, 0.99),
        told.len(),
        percentile(&mut told, 0.99)
    );
    goodput
}

fn post(path: &str, content_type: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {content_type}\r\ncontent-length: {}\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

async fn created(
    client: &reqwest::Client,
    url: &str,
    content_type: &str,
    body: Vec<u8>,
) -> anyhow::Result<String> {
    let answer = client
        .post(url)
        .header("content-type", content_type)
        .body(body)
        .send()
        .await?
        .error_for_status()?;
    let answer: serde_json::Value = answer.json().await?;
    Ok(answer["id"].as_str().context("an id")?.to_owned())
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let binary = arguments.next().context("usage: load BINARY [seconds]")?;
    let seconds: f64 = arguments.next().map_or(Ok(5.0), |text| text.parse())?;
    let dir = tempfile::tempdir()?;
    let server = Server::start(&binary, &dir.path().join("data"))?;
    kincal::http::tls::use_ring();
    let client = reqwest::Client::builder().no_proxy().build()?;
    let url = format!("http://{}/v1/robots", server.address);
    let robot = created(
        &client,
        &url,
        "application/json",
        std::fs::read("data/paper/robot.json")?,
    )
    .await?;
    let csv = std::fs::read_to_string("data/paper/first.csv")?;
    let sixty = csv
        .lines()
        .take(61)
        .collect::<Vec<_>>()
        .join("\n")
        .into_bytes();
    println!(
        "| what | offered, 1/s | done, 1/s | median, ms | p99, ms | told to come back | p99 of these, ms | failed | target |\n|---|---|---|---|---|---|---|---|---|"
    );
    let get = format!("GET /v1/robots/{robot} HTTP/1.1\r\nhost: localhost\r\n\r\n").into_bytes();
    for rate in [1000.0, 2500.0, 5000.0, 10_000.0] {
        let request = get.clone();
        let (answers, took_s) = at_rate(&server.address, rate, seconds, CONNECTIONS, move |_| {
            request.clone()
        })
        .await;
        row(
            "GET of a robot",
            rate,
            took_s,
            &answers,
            "2,000/s, p99 20 ms",
        );
    }
    let path = format!("/v1/robots/{robot}/measurement-sets?frame=base");
    let mut capacity = 0.0_f64;
    for rate in [250.0, 500.0, 1000.0, 2000.0, 4000.0] {
        let request = post(&path, "text/csv", &sixty);
        let (answers, took_s) = at_rate(&server.address, rate, seconds, CONNECTIONS, move |_| {
            request.clone()
        })
        .await;
        capacity = capacity.max(row(
            "durable upload of 60 poses",
            rate,
            took_s,
            &answers,
            "150/s, p99 100 ms",
        ));
    }
    for (unit, of_what) in [
        (PROMISED, "what is promised"),
        (capacity, "what can be done"),
    ] {
        for times in FLOODS {
            let request = post(&path, "text/csv", &sixty);
            let (answers, took_s) = at_rate(
                &server.address,
                times * unit,
                seconds,
                FLOOD_CONNECTIONS,
                move |_| request.clone(),
            )
            .await;
            let what = format!("the same, {times:.0} times {of_what}, {FLOOD_CONNECTIONS} clients");
            row(
                &what,
                times * unit,
                took_s,
                &answers,
                "refused within 250 ms",
            );
        }
    }
    println!("\nLargest memory of the server: {} MiB.", server.peak_mib());
    hostile::bodies(&client, &format!("http://{}{path}", server.address)).await?;
    println!(
        "\nLargest memory of the server with these: {} MiB (target 400).",
        server.peak_mib()
    );
    slow_clients(&server, &get).await?;
    drop(server);
    claims(&dir.path().join("queue")).await
}

/// 2,000 clients that send nothing, half a header or half a body, and a normal one.
async fn slow_clients(server: &Server, get: &[u8]) -> anyhow::Result<()> {
    const SLOW: usize = 2000;
    let begun = Instant::now();
    let mut slow = Vec::new();
    for i in 0..SLOW {
        let mut stream = TcpStream::connect(&server.address).await?;
        let beginning: &[u8] = match i % 3 {
            0 => b"",
            1 => b"GET / HT",
            _ => b"POST /v1/robots HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 1000\r\n\r\n{",
        };
        stream.write_all(beginning).await?;
        slow.push(tokio::spawn(async move {
            let mut rest = Vec::new();
            let _ = timeout(Duration::from_secs(60), stream.read_to_end(&mut rest)).await;
        }));
    }
    let request = get.to_vec();
    let (answers, _) = at_rate(&server.address, 200.0, 5.0, CONNECTIONS, move |_| {
        request.clone()
    })
    .await;
    let mut times: Vec<Duration> = answers.iter().map(|(_, time)| *time).collect();
    let good = answers.iter().filter(|(status, _)| *status == 200).count();
    let p99 = percentile(&mut times, 0.99);
    for task in slow {
        task.await?;
    }
    println!(
        "\n{SLOW} slow clients: all cut off after {:.1} s (target 15); meanwhile {good} of {} others answered, p99 {p99:.1} ms (target 100).",
        begun.elapsed().as_secs_f64(),
        answers.len()
    );
    Ok(())
}

/// Measures claims from a long queue, directly on the store.
async fn claims(data_dir: &std::path::Path) -> anyhow::Result<()> {
    let store = Store::open(StoreLocation::Sqlite {
        data_dir: data_dir.to_owned(),
    })
    .await?;
    let mut tx = store.begin().await?;
    let robot = robots::insert(
        &mut tx,
        &NewRobot {
            name: "r".into(),
            body_json: "{}".into(),
        },
    )
    .await?;
    let set = NewMeasurementSet {
        robot_id: robot.id.clone(),
        name: None,
        frame: kincal::wire::measurement::Frame::Base,
        content_type: "text/csv".into(),
        body: vec![0],
        sha256: String::new(),
        n_points: 1,
        n_configurations: 1,
        n_targets: 1,
        warnings_json: "[]".into(),
        uploaded_by: None,
        serial_number: None,
        insisted_on: None,
        reading_json: None,
    };
    let set = measurement_sets::insert(&mut tx, &set).await?;
    tx.commit().await?;
    let new = NewJob {
        robot_id: robot.id,
        set_ids: vec![set.id],
        kind: kincal::wire::job::Kind::Identify,
        method: kincal::wire::job::Method::Auto,
        request_json: "{}".into(),
        ..NewJob::default()
    };
    for _ in 0..QUEUED / 1000 {
        let mut tx = store.begin().await?;
        for _ in 0..1000 {
            jobs::insert(&mut tx, &new, None).await?;
        }
        tx.commit().await?;
    }
    let mut times = Vec::new();
    for _ in 0..CLAIMS {
        let begun = Instant::now();
        let mut tx = store.begin().await?;
        let minute = Duration::from_secs(60);
        leases::claim_in(&mut tx, Eligible::Unsuspected, "load", minute)
            .await?
            .context("a job")?;
        tx.commit().await?;
        times.push(begun.elapsed());
    }
    println!(
        "\n{QUEUED} jobs waiting: claim, median {:.2} ms, p99 {:.2} ms (target p99 15).",
        percentile(&mut times, 0.5),
        percentile(&mut times, 0.99)
    );
    Ok(())
}
