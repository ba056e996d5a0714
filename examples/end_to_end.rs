//! A least-squares job from its POST to the fetched parameter set, through the real server with its durable database, and where the
//! time goes.
//!
//! `cargo run --release --example end_to_end` prints one line of JSON, medians over the jobs: what an fsync costs in the folder of the
//! database, what a request takes that does nothing, what the job took, what the computation took of it, and the rest as a multiple of the
//! job's fsyncs. The computation is what the worker's thread does, from the stored bytes to the texts of report and parameter set: after all
//! jobs it is done once more for each here, by the same function from the same inputs, and timed. `us_stages` is the part of it that the report calls
//! `duration_ms`, without reading the inputs and writing the results. How it would be on a slower disk:
//! `strace -f --seccomp-bpf -o /dev/null -e trace=fsync,fdatasync -e inject=fsync,fdatasync:delay_exit=4000 end_to_end` (microseconds).

use anyhow::Context;
use kincal::config::ServeConfig;
use kincal::http::server;
use kincal::jobs::{JobInputs, execution};
use kincal::store::Store;
use serde_json::{Value, json};
use std::fs::File;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;
use tokio::runtime::Builder;

/// Jobs that are timed, after some that warm up.
const JOBS: usize = 100;
const WARM_UP: usize = 10;
/// A job is durable three times: when it is posted, when it is claimed, and when its result is stored.
/// `strace -f -c -e trace=fsync,fdatasync` counts them.
const FSYNCS: f64 = 3.0;
/// Bytes that a commit appends to the write-ahead log, about.
const COMMIT_BYTES: usize = 8 * 4096;

const ROBOT: &[u8] = include_bytes!("../data/paper/robot.json");
const SET: &[u8] = include_bytes!("../data/paper/first.csv");

/// One job's times, µs.
struct Times {
    posted: f64,
    waited: f64,
    fetched: f64,
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
    let server = servers.block_on(server::start(&ServeConfig::loopback(folder.path().join("data"), 1)))?;
    kincal::http::tls::use_ring();
    let client = Client { http: reqwest::Client::builder().no_proxy().build()?, url: server.url() };
    let ran = Builder::new_current_thread().enable_all().build()?.block_on(run(client, &server.store, folder.path()));
    servers.block_on(server.shutdown());
    ran
}

async fn run(client: Client, store: &Store, folder: &Path) -> anyhow::Result<()> {
    let robot = id(&client.post("/v1/robots", "application/json", ROBOT.to_vec()).await?)?;
    let set = id(&client.post(&format!("/v1/robots/{robot}/measurement-sets?frame=base&name=first"), "text/csv", SET.to_vec()).await?)?;
    let (mut jobs, mut times, mut fsyncs) = (Vec::new(), Vec::new(), Vec::new());
    let mut log = File::create(folder.join("fsync"))?;
    for _ in 0..WARM_UP + JOBS {
        let (job, spent) = job(&client, &robot, &set).await?;
        jobs.push(job);
        times.push(spent);
        fsyncs.push(fsync_us(&mut log)?);
    }
    let (times, fsyncs) = (&times[WARM_UP..], fsyncs.split_off(WARM_UP));
    let mut computed = Vec::new();
    for job in &jobs[WARM_UP..] {
        computed.push(compute_us(&JobInputs::load(store, job).await?)?);
    }
    let mut nothing = Vec::new();
    for _ in 0..JOBS {
        let begun = Instant::now();
        client.http.get(format!("{}/healthz", client.url)).send().await?.error_for_status()?.bytes().await?;
        nothing.push(begun.elapsed().as_secs_f64() * 1e6);
    }
    let fsync = median(fsyncs);
    let of = |what: fn(&Times) -> f64| median(times.iter().map(what).collect());
    let (job, computed) = (of(|t| t.posted + t.waited + t.fetched), median(computed));
    let rest = job - computed;
    println!(
        "{}",
        json!({
            "us_job": job,
            "us_post": of(|t| t.posted),
            "us_wait": of(|t| t.waited),
            "us_fetch": of(|t| t.fetched),
            "us_compute": computed,
            "us_stages": of(|t| t.stages),
            "us_rest": rest,
            "us_request": median(nothing),
            "us_fsync": fsync,
            "rest_over_fsyncs": rest / (FSYNCS * fsync),
            "jobs": JOBS,
        })
    );
    Ok(())
}

async fn job(client: &Client, robot: &str, set: &str) -> anyhow::Result<(String, Times)> {
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
    Ok((job, Times { posted: us(posted), waited: us(waited), fetched: us(fetched), stages }))
}

/// What a worker's thread has to do for a job.
fn compute_us(inputs: &JobInputs) -> anyhow::Result<f64> {
    let begun = Instant::now();
    execution::compute(inputs, &mut |_| ControlFlow::Continue(()))
        .map_err(|failure| anyhow::anyhow!("it cannot be computed: {failure:?}"))?;
    Ok(begun.elapsed().as_secs_f64() * 1e6)
}

/// What it takes to append as much as a commit does to a file beside the database, and to have it on the disk. Between two jobs, for a disk
/// that has just been idle takes longer than one that is kept busy.
fn fsync_us(log: &mut File) -> anyhow::Result<f64> {
    let bytes = vec![7_u8; COMMIT_BYTES];
    let begun = Instant::now();
    log.write_all(&bytes)?;
    log.sync_data()?;
    Ok(begun.elapsed().as_secs_f64() * 1e6)
}

fn id(answer: &Value) -> anyhow::Result<String> {
    Ok(answer["id"].as_str().context("the server's answer has no id")?.to_string())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
