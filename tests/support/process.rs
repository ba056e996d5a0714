//! The real binary as a process, used over HTTP like a cell PC does.
#![allow(dead_code)] // each test binary uses its part

use super::app::TestApp;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Timeout for a job, which no test exceeds even on a busy machine with an unoptimised build.
const PATIENCE: Duration = Duration::from_secs(120);

/// A running `kincal serve`.
pub struct Server {
    child: Child,
    /// `http://127.0.0.1:PORT`.
    pub url: String,
    key: Option<String>,
    http: reqwest::Client,
    runtime: tokio::runtime::Runtime,
}

/// The binary under test with arguments.
pub fn kincal(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
    command.args(arguments);
    command
}

/// Runs the binary to its end.
pub fn run(arguments: &[&str]) -> Output {
    kincal(arguments).output().unwrap()
}

/// What the binary printed and how it ended: exit code, standard output, standard error.
pub type Printed = (Option<i32>, String, String);

/// Runs the binary with these variables of the environment, without blocking the threads of a server in this process.
pub async fn run_beside(arguments: &[&str], environment: &[(&str, String)]) -> Printed {
    let mut command = kincal(arguments);
    command.envs(environment.iter().map(|(name, value)| (name, value)));
    let output = tokio::task::spawn_blocking(move || command.output().expect("the binary runs"));
    let output = output.await.expect("no panic");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

/// Runs the binary against a server of the test, with a key.
pub async fn run_against(server: &TestApp, key: &str, arguments: &[&str]) -> Printed {
    let environment = [
        ("KINCAL_SERVER", server.server.url()),
        ("KINCAL_KEY", key.to_owned()),
    ];
    run_beside(arguments, &environment).await
}

/// `kincal serve` on a free port over the database in `data_dir`.
pub fn serve(data_dir: &Path, workers: usize) -> Command {
    let workers = workers.to_string();
    let mut command = kincal(&["serve", "--listen", "127.0.0.1:0", "--workers", &workers]);
    command.arg("--data-dir").arg(data_dir);
    command
}

/// Address of a server that has just started, read from its first line. Its standard output must be a pipe.
pub fn url_of(child: &mut Child) -> String {
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    line.trim()
        .strip_prefix("kincal listening on ")
        .unwrap_or_else(|| panic!("said {line:?}"))
        .to_owned()
}

impl Server {
    /// Starts a server on a free port over the database in `data_dir`.
    pub fn start(data_dir: &Path, workers: usize) -> Self {
        Self::start_with(data_dir, workers, &[])
    }

    /// As [`Self::start`], with more environment.
    pub fn start_with(data_dir: &Path, workers: usize, environment: &[(&str, &str)]) -> Self {
        let mut command = serve(data_dir, workers);
        command.arg("--no-auth").envs(environment.iter().copied());
        Self::of(command)
    }

    /// Starts a server with this command, without its log.
    pub fn of(command: Command) -> Self {
        Self::with_log(command, Stdio::null())
    }

    /// Starts a server with this command, which writes its log there.
    pub fn with_log(mut command: Command, log: Stdio) -> Self {
        command.stdout(Stdio::piped()).stderr(log);
        let mut child = command.spawn().unwrap();
        let url = url_of(&mut child);
        kincal::http::tls::use_ring();
        // Each request uses a new connection, because the server closes idle ones.
        let http = reqwest::Client::builder()
            .no_proxy()
            .timeout(PATIENCE)
            .pool_max_idle_per_host(0)
            .build()
            .unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap();
        Self {
            child,
            url,
            key: None,
            http,
            runtime,
        }
    }

    /// Sends this key with all further requests.
    pub fn with_key(mut self, key: String) -> Self {
        self.key = Some(key);
        self
    }

    /// Id of the process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// kill -9.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Ends the process with a signal. Returns its exit status.
    pub fn end_by(mut self, signal: &str) -> std::process::ExitStatus {
        assert!(
            Command::new("kill")
                .args([signal, &self.child.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
        self.child.wait().unwrap()
    }

    /// Ends the process with SIGTERM. Returns its exit status and the time that it took to end.
    pub fn terminate(mut self) -> (std::process::ExitStatus, Duration) {
        let since = Instant::now();
        assert!(
            Command::new("kill")
                .args(["-TERM", &self.child.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
        (self.child.wait().unwrap(), since.elapsed())
    }

    /// GET: status and JSON.
    pub fn get(&self, path: &str) -> (u16, Value) {
        self.send(self.http.get(format!("{}{path}", self.url)))
    }

    /// GET that must succeed: the text.
    pub fn text(&self, path: &str) -> String {
        let request = self.signed(self.http.get(format!("{}{path}", self.url)));
        self.runtime.block_on(async {
            request
                .send()
                .await
                .unwrap()
                .error_for_status()
                .unwrap()
                .text()
                .await
                .unwrap()
        })
    }

    /// GET: status and text.
    pub fn status_and_text(&self, path: &str) -> (u16, String) {
        let request = self.signed(self.http.get(format!("{}{path}", self.url)));
        self.runtime.block_on(async {
            let response = request.send().await.unwrap();
            let status = response.status().as_u16();
            (status, response.text().await.unwrap())
        })
    }

    /// POST: status and JSON.
    pub fn post(&self, path: &str, content_type: &str, body: Vec<u8>) -> (u16, Value) {
        self.send(
            self.http
                .post(format!("{}{path}", self.url))
                .header("content-type", content_type)
                .body(body),
        )
    }

    /// PUT of JSON: status and JSON.
    pub fn put(&self, path: &str, body: &Value) -> (u16, Value) {
        self.send(
            self.http
                .put(format!("{}{path}", self.url))
                .header("content-type", "application/json")
                .body(body.to_string()),
        )
    }

    /// POST under an Idempotency-Key: status and JSON.
    pub fn post_with_key(
        &self,
        path: &str,
        content_type: &str,
        body: Vec<u8>,
        key: &str,
    ) -> (u16, Value) {
        let request = self
            .http
            .post(format!("{}{path}", self.url))
            .header("content-type", content_type)
            .header("idempotency-key", key);
        self.send(request.body(body))
    }

    /// POST: status, `Retry-After`, and JSON.
    pub fn post_and_when_again(
        &self,
        path: &str,
        content_type: &str,
        body: Vec<u8>,
    ) -> (u16, Option<String>, Value) {
        let request = self
            .http
            .post(format!("{}{path}", self.url))
            .header("content-type", content_type)
            .body(body);
        self.runtime.block_on(async {
            let response = request.send().await.unwrap();
            let again = response
                .headers()
                .get("retry-after")
                .map(|value| value.to_str().unwrap().to_owned());
            let status = response.status().as_u16();
            (
                status,
                again,
                serde_json::from_slice(&response.bytes().await.unwrap()).unwrap_or(Value::Null),
            )
        })
    }

    /// POST that must create something. Returns its `id`.
    pub fn create(&self, path: &str, content_type: &str, body: Vec<u8>) -> String {
        let (status, answer) = self.post(path, content_type, body);
        assert!(
            matches!(status, 201 | 202),
            "{path} answered {status}: {answer}"
        );
        answer["id"].as_str().unwrap().to_string()
    }

    /// Stores a robot from a file.
    pub fn robot(&self, path: &Path) -> String {
        self.create(
            "/v1/robots",
            "application/json",
            std::fs::read(path).unwrap(),
        )
    }

    /// Uploads a set from a CSV file.
    pub fn set(&self, robot: &str, path: &Path, frame: &str) -> String {
        self.create(
            &format!("/v1/robots/{robot}/measurement-sets?frame={frame}"),
            "text/csv",
            std::fs::read(path).unwrap(),
        )
    }

    /// Posts a job, which must be accepted.
    pub fn job(&self, robot: &str, request: &Value) -> String {
        self.create(
            &format!("/v1/robots/{robot}/jobs"),
            "application/json",
            serde_json::to_vec(request).unwrap(),
        )
    }

    /// Waits until a job has ended.
    pub fn finished(&self, job: &str) -> Value {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            let (status, answer) = self.get(&format!("/v1/jobs/{job}?wait_s=10"));
            assert_eq!(status, 200, "{answer}");
            if !matches!(answer["status"].as_str().unwrap(), "queued" | "running") {
                return answer;
            }
        }
        panic!("job {job} is not over after {PATIENCE:?}");
    }

    /// Waits until a worker has started a job and reported an iteration.
    pub fn begun(&self, job: &str) -> Value {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            let (_, answer) = self.get(&format!("/v1/jobs/{job}"));
            if answer["status"] == "running"
                && answer["progress"]["iteration"].as_u64().unwrap_or(0) > 0
            {
                return answer;
            }
            assert!(
                matches!(answer["status"].as_str().unwrap(), "queued" | "running"),
                "over too early: {answer}"
            );
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("job {job} has not begun after {PATIENCE:?}");
    }

    /// Runs a job, which must succeed. Returns its report.
    pub fn report(&self, robot: &str, request: &Value) -> Value {
        let job = self.job(robot, request);
        let end = self.finished(&job);
        assert_eq!(end["status"], "succeeded", "{end}");
        self.get(&format!("/v1/jobs/{job}/report")).1
    }

    fn signed(&self, request: reqwest::RequestBuilder) -> reqwest::RequestBuilder {
        match &self.key {
            Some(key) => request.bearer_auth(key),
            None => request,
        }
    }

    fn send(&self, request: reqwest::RequestBuilder) -> (u16, Value) {
        self.runtime.block_on(async {
            let response = self.signed(request).send().await.unwrap();
            let status = response.status().as_u16();
            let bytes = response.bytes().await.unwrap();
            (
                status,
                serde_json::from_slice(&bytes).unwrap_or(Value::Null),
            )
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
