//! A least-squares job from its POST to the fetched parameter set, through the real server with its durable database, and where the
//! time goes.
//!
//! `cargo run --release --example end_to_end` prints one line of JSON, medians over the jobs: what the fsyncs of a job cost in the folder
//! of the database, what a request takes that does nothing, what the job took, what the computation took of it, and the rest as a multiple of
//! its fsyncs. The computation is what the worker's thread does, from the stored bytes to the texts of report and parameter set, timed there
//! (`us_compute`); `us_stages` is what the report calls `duration_ms`: the same without reading the inputs and writing the results. How it would be
//! on a slower disk:
//! `strace -f --seccomp-bpf -o /dev/null -e trace=fsync,fdatasync -e inject=fsync,fdatasync:delay_exit=4000 end_to_end` (microseconds).

use anyhow::Context;
use kincal::config::ServeConfig;
use kincal::http::server;
use kincal::jobs::{JobFailure, JobInputs, JobOutcome, Progress, execution};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use tokio::runtime::Builder;

/// Jobs that are timed, after some that warm up.
const JOBS: usize = 100;
const WARM_UP: usize = 10;
/// A job is durable three times: when it is posted, when it is claimed, and when its result is stored; each time so many pages go to the
/// write-ahead log. `strace -f -e trace=pwrite64,fsync,fdatasync` shows them.
const COMMIT_PAGES: [usize; 3] = [12, 6, 30];
const PAGE_BYTES: usize = 4096;
/// As large as the log is before it is written from its beginning again.
const LOG_PAGES: usize = 1000;

const ROBOT: &[u8] = include_bytes!("../data/paper/robot.json");
const SET: &[u8] = include_bytes!("../data/paper/first.csv");

/// What the worker's thread took for each job, µs.
static COMPUTED: Mutex<Vec<f64>> = Mutex::new(Vec::new());

/// One job's times, µs.
struct Times {
    posted: f64,
    waited: f64,
    fetched: f64,
    computed: f64,
    stages: f64,
}

/// A client of the server.
struct Client {
    http: reqwest::Client,
    url: String,
}

impl Client {
    async fn get(&self, path: &str) -> anyhow::Result<Value> {
        answer(self.http.get(format!("{}{path}", self.url))).await
    }

    async fn post(&self, path: &str, content_type: &str, body: Vec<u8>) -> anyhow::Result<Value> {
        answer(self.http.post(format!("{}{path}", self.url)).header("content-type", content_type).body(body)).await
    }
}

async fn answer(request: reqwest::RequestBuilder) -> anyhow::Result<Value> {
    let bytes = request.send().await?.error_for_status()?.bytes().await?;
    serde_json::from_slice(&bytes).context("the server's answer is not JSON")
}

fn main() -> anyhow::Result<()> {
    // beside the sources: a folder in memory has no fsync to speak of
    let folder = tempfile::tempdir_in(std::env::var("END_TO_END_DIR").unwrap_or_else(|_| "target".into()))?;
    // the server as `kincal serve` runs it; the client on this thread alone, as another machine has its own
    let servers = Builder::new_multi_thread().enable_all().build()?;
    let server = servers.block_on(server::start_with(&ServeConfig::loopback(folder.path().join("data"), 1), timed))?;
    kincal::http::tls::use_ring();
    let client = Client { http: reqwest::Client::builder().no_proxy().build()?, url: server.url() };
    let ran = Builder::new_current_thread().enable_all().build()?.block_on(run(client, folder.path()));
    servers.block_on(server.shutdown());
    ran
}

async fn run(client: Client, folder: &Path) -> anyhow::Result<()> {
    let robot = id(&client.post("/v1/robots", "application/json", ROBOT.to_vec()).await?)?;
    let set = id(&client.post(&format!("/v1/robots/{robot}/measurement-sets?frame=base&name=first"), "text/csv", SET.to_vec()).await?)?;
    let (mut times, mut fsyncs) = (Vec::new(), [const { Vec::new() }; 3]);
    let mut log = Log::create(&folder.join("fsync"))?;
    for i in 0..WARM_UP + JOBS {
        times.push(job(&client, &robot, &set).await?);
        fsyncs[i % 3].push(log.fsync_us(COMMIT_PAGES[i % 3])?);
    }
    let times = &times[WARM_UP..];
    let mut nothing = Vec::new();
    for _ in 0..JOBS {
        let begun = Instant::now();
        client.http.get(format!("{}/healthz", client.url)).send().await?.error_for_status()?.bytes().await?;
        nothing.push(begun.elapsed().as_secs_f64() * 1e6);
    }
    let fsyncs: f64 = fsyncs.into_iter().map(median).sum();
    let of = |what: fn(&Times) -> f64| median(times.iter().map(what).collect());
    let rest = of(|t| t.posted + t.waited + t.fetched - t.computed);
    println!(
        "{}",
        json!({
            "us_job": of(|t| t.posted + t.waited + t.fetched),
            "us_post": of(|t| t.posted),
            "us_wait": of(|t| t.waited),
            "us_fetch": of(|t| t.fetched),
            "us_compute": of(|t| t.computed),
            "us_stages": of(|t| t.stages),
            "us_rest": rest,
            "us_request": median(nothing),
            "us_fsyncs": fsyncs,
            "rest_over_fsyncs": rest / fsyncs,
            "jobs": JOBS,
        })
    );
    Ok(())
}

async fn job(client: &Client, robot: &str, set: &str) -> anyhow::Result<Times> {
    let request = json!({"measurement_set_id": set, "method": "least_squares", "model": "paper"});
    let begun = Instant::now();
    let job = id(&client.post(&format!("/v1/robots/{robot}/jobs"), "application/json", serde_json::to_vec(&request)?).await?)?;
    let posted = begun.elapsed();
    let done = loop {
        let job = client.get(&format!("/v1/jobs/{job}?wait_s=10")).await?;
        if job["finished_at"].is_string() {
            break job;
        }
    };
    let waited = begun.elapsed() - posted;
    let parameter_set = done["parameter_set_id"].as_str().with_context(|| format!("the job gave no parameters: {done}"))?;
    client.get(&format!("/v1/parameter-sets/{parameter_set}")).await?;
    let fetched = begun.elapsed() - waited - posted;
    let report = client.get(&format!("/v1/jobs/{job}/report")).await?;
    let stages = report["duration_ms"].as_f64().context("the report has no duration")? * 1e3;
    let us = |d: std::time::Duration| d.as_secs_f64() * 1e6;
    let computed = COMPUTED.lock().unwrap_or_else(PoisonError::into_inner).pop().context("no worker has computed")?;
    Ok(Times { posted: us(posted), waited: us(waited), fetched: us(fetched), computed, stages })
}

/// What a worker's thread has to do for a job.
fn timed(inputs: &JobInputs, progress: &mut dyn FnMut(Progress) -> ControlFlow<()>) -> Result<JobOutcome, JobFailure> {
    let begun = Instant::now();
    let outcome = execution::compute(inputs, progress);
    COMPUTED.lock().unwrap_or_else(PoisonError::into_inner).push(begun.elapsed().as_secs_f64() * 1e6);
    outcome
}

/// A file beside the database that is written as its log is: over and over, and on the disk after each commit.
struct Log {
    file: File,
    next_page: usize,
}

impl Log {
    fn create(path: &Path) -> anyhow::Result<Self> {
        let mut file = File::create(path)?;
        file.write_all(&vec![0; LOG_PAGES * PAGE_BYTES])?;
        file.sync_all()?;
        Ok(Self { file, next_page: 0 })
    }

    /// What a commit of so many pages takes of the disk alone. One between two jobs, for a disk that has just been idle takes longer than one
    /// that is kept busy, and a job's commits are milliseconds apart.
    fn fsync_us(&mut self, pages: usize) -> anyhow::Result<f64> {
        let bytes = vec![7_u8; pages * PAGE_BYTES];
        if self.next_page + pages > LOG_PAGES {
            self.next_page = 0;
        }
        let begun = Instant::now();
        self.file.seek(SeekFrom::Start((self.next_page * PAGE_BYTES) as u64))?;
        self.file.write_all(&bytes)?;
        self.file.sync_all()?;
        self.next_page += pages;
        Ok(begun.elapsed().as_secs_f64() * 1e6)
    }
}

fn id(answer: &Value) -> anyhow::Result<String> {
    Ok(answer["id"].as_str().context("the server's answer has no id")?.to_string())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
