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
use kincal::jobs::{JobFailure, JobInputs, JobOutcome, execution};
use kincal::wire::job_answer::ProgressAnswer;
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::net::TcpStream;
use std::ops::ControlFlow;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use tokio::runtime::Builder;

/// Jobs that are timed, after some that warm up.
const JOBS: usize = 100;
const WARM_UP: usize = 10;
/// Of SQLite's write-ahead log: header, header of a frame, and page.
const LOG_HEADER_BYTES: u64 = 32;
const FRAME_HEADER_BYTES: u64 = 24;
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

/// A client of the server that does no more than a cell PC has to: one connection, one request after the other.
struct Client(BufReader<TcpStream>);

impl Client {
    fn connect(address: &str) -> anyhow::Result<Self> {
        let stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        Ok(Self(BufReader::new(stream)))
    }

    fn get(&mut self, path: &str) -> anyhow::Result<Value> {
        parsed(&self.get_bytes(path)?)
    }

    fn get_bytes(&mut self, path: &str) -> anyhow::Result<Vec<u8>> {
        self.answer(
            &format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n\r\n"),
            b"",
        )
    }

    fn post(&mut self, path: &str, content_type: &str, body: &[u8]) -> anyhow::Result<Value> {
        let of_body = format!(
            "content-type: {content_type}\r\ncontent-length: {}",
            body.len()
        );
        parsed(&self.answer(
            &format!("POST {path} HTTP/1.1\r\nhost: localhost\r\n{of_body}\r\n\r\n"),
            body,
        )?)
    }

    fn answer(&mut self, head: &str, body: &[u8]) -> anyhow::Result<Vec<u8>> {
        self.0
            .get_mut()
            .write_all(&[head.as_bytes(), body].concat())?;
        let (mut status, mut length) = (String::new(), 0);
        self.0.read_line(&mut status)?;
        loop {
            let mut line = String::new();
            self.0.read_line(&mut line)?;
            match line.trim_end().split_once(": ") {
                Some(("content-length", bytes)) => length = bytes.parse()?,
                Some(_) => {}
                None => break,
            }
        }
        let mut body = vec![0; length];
        self.0.read_exact(&mut body)?;
        anyhow::ensure!(
            status.starts_with("HTTP/1.1 2"),
            "{status}{}",
            String::from_utf8_lossy(&body)
        );
        Ok(body)
    }
}

fn parsed(bytes: &[u8]) -> anyhow::Result<Value> {
    serde_json::from_slice(bytes).context("the server's answer is not JSON")
}

fn main() -> anyhow::Result<()> {
    // beside the sources: a folder in memory has no fsync to speak of
    let folder =
        tempfile::tempdir_in(std::env::var("END_TO_END_DIR").unwrap_or_else(|_| "target".into()))?;
    // the server as `kincal serve` runs it; the client on this thread alone, as another machine has its own
    let servers = Builder::new_multi_thread().enable_all().build()?;
    let server = servers.block_on(server::start_with(
        &ServeConfig::loopback(folder.path().join("data"), 1),
        timed,
    ))?;
    let url = server.url();
    let client = Client::connect(url.strip_prefix("http://").context("loopback has no TLS")?)?;
    let ran = run(client, folder.path());
    servers.block_on(server.shutdown());
    ran
}

fn run(mut client: Client, folder: &Path) -> anyhow::Result<()> {
    let robot = id(&client.post("/v1/robots", "application/json", ROBOT)?)?;
    let set = id(&client.post(
        &format!("/v1/robots/{robot}/measurement-sets?frame=base&name=first"),
        "text/csv",
        SET,
    )?)?;
    let (mut times, mut commits, mut timed) = (Vec::new(), Vec::new(), Vec::<Vec<f64>>::new());
    let mut disk = Disk::create(&folder.join("fsync"))?;
    let mut log = Log::open(&folder.join("data/kincal.sqlite-wal"))?;
    for i in 0..WARM_UP + JOBS {
        times.push(job(&mut client, &robot, &set)?);
        let Some(of_job) = log.commits()? else {
            continue;
        };
        let Some(which) = i.checked_rem(of_job.len()) else {
            continue;
        };
        timed.resize(timed.len().max(of_job.len()), Vec::new());
        timed[which].push(disk.fsync_us(of_job[which])?);
        commits.push(of_job);
    }
    let times = &times[WARM_UP..];
    let mut nothing = Vec::new();
    for _ in 0..JOBS {
        let begun = Instant::now();
        client.get_bytes("/healthz")?;
        nothing.push(begun.elapsed().as_secs_f64() * 1e6);
    }
    // of the first commit of a job, the second, … : the median, and which share of the jobs has it
    let share = |which| {
        commits.iter().filter(|of_job| of_job.len() > which).count() as f64 / commits.len() as f64
    };
    let timed = timed
        .into_iter()
        .enumerate()
        .filter(|(_, of_commit)| !of_commit.is_empty());
    let fsyncs: f64 = timed
        .map(|(which, of_commit)| share(which) * median(of_commit))
        .sum();
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
            "commits": commits.iter().map(Vec::len).sum::<usize>() as f64 / commits.len() as f64,
            "us_fsyncs": fsyncs,
            "rest_over_fsyncs": rest / fsyncs,
            "jobs": JOBS,
        })
    );
    Ok(())
}

fn job(client: &mut Client, robot: &str, set: &str) -> anyhow::Result<Times> {
    let request = json!({"measurement_set_id": set, "method": "least_squares", "model": "paper"});
    let begun = Instant::now();
    let job = id(&client.post(
        &format!("/v1/robots/{robot}/jobs"),
        "application/json",
        &serde_json::to_vec(&request)?,
    )?)?;
    let posted = begun.elapsed();
    let done = loop {
        let job = client.get(&format!("/v1/jobs/{job}?wait_s=10"))?;
        if job["finished_at"].is_string() {
            break job;
        }
    };
    let waited = begun.elapsed() - posted;
    let parameter_set = done["parameter_set_id"]
        .as_str()
        .with_context(|| format!("the job gave no parameters: {done}"))?;
    client.get(&format!("/v1/parameter-sets/{parameter_set}"))?;
    let fetched = begun.elapsed() - waited - posted;
    let report = client.get(&format!("/v1/jobs/{job}/report"))?;
    let stages = report["duration_ms"]
        .as_f64()
        .context("the report has no duration")?
        * 1e3;
    let us = |d: std::time::Duration| d.as_secs_f64() * 1e6;
    let computed = COMPUTED
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .pop()
        .context("no worker has computed")?;
    Ok(Times {
        posted: us(posted),
        waited: us(waited),
        fetched: us(fetched),
        computed,
        stages,
    })
}

/// What a worker's thread has to do for a job.
fn timed(
    inputs: &JobInputs,
    progress: &mut dyn FnMut(ProgressAnswer) -> ControlFlow<()>,
) -> Result<JobOutcome, JobFailure> {
    let begun = Instant::now();
    let outcome = execution::compute(inputs, progress);
    COMPUTED
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push(begun.elapsed().as_secs_f64() * 1e6);
    outcome
}

/// SQLite's write-ahead log [sqlite.org/fileformat2.html, section 4], as far as it was looked at. Only headers are read: the whole log would
/// drive what the server needs out of the processor's caches.
struct Log {
    file: File,
    salt: [u8; 8],
    n_frames: u64,
}

impl Log {
    fn open(path: &Path) -> anyhow::Result<Self> {
        let mut log = Self {
            file: File::open(path)?,
            salt: [0; 8],
            n_frames: 0,
        };
        log.commits()?;
        Ok(log)
    }

    /// How many pages each commit has written since the last look; none if the log was begun anew meanwhile.
    fn commits(&mut self) -> anyhow::Result<Option<Vec<usize>>> {
        let mut header = [0; LOG_HEADER_BYTES as usize];
        self.file.read_exact_at(&mut header, 0)?;
        let salt: [u8; 8] = header[16..24].try_into()?;
        let is_same = std::mem::replace(&mut self.salt, salt) == salt;
        if !is_same {
            self.n_frames = 0;
        }
        let (mut commits, mut pages) = (Vec::new(), 0);
        let mut frame = [0; FRAME_HEADER_BYTES as usize];
        loop {
            let at = LOG_HEADER_BYTES + self.n_frames * (FRAME_HEADER_BYTES + PAGE_BYTES as u64);
            // behind the last one are those of before, or nothing
            if self.file.read_exact_at(&mut frame, at).is_err() || frame[8..16] != salt {
                return Ok(is_same.then_some(commits));
            }
            (self.n_frames, pages) = (self.n_frames + 1, pages + 1);
            // the last one of a commit says how large the database is then
            if frame[4..8] != [0; 4] {
                commits.push(std::mem::take(&mut pages));
            }
        }
    }
}

/// A file beside the database that is written as its log is: over and over, and on the disk after each commit.
struct Disk {
    file: File,
    next_page: usize,
}

impl Disk {
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
        self.file
            .seek(SeekFrom::Start((self.next_page * PAGE_BYTES) as u64))?;
        self.file.write_all(&bytes)?;
        self.file.sync_all()?;
        self.next_page += pages;
        Ok(begun.elapsed().as_secs_f64() * 1e6)
    }
}

fn id(answer: &Value) -> anyhow::Result<String> {
    Ok(answer["id"]
        .as_str()
        .context("the server's answer has no id")?
        .to_string())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
