//! A real server on a free loopback port with its own database, and a client for it.

#![allow(dead_code)] // each test binary uses its part

use kincal::config::ServeConfig;
use kincal::http::server::{self, RunningServer};
use reqwest::{Method, RequestBuilder};
use serde_json::{Value, json};
use tempfile::TempDir;

/// An answer of the server.
pub struct Answer {
    pub status: u16,
    pub headers: reqwest::header::HeaderMap,
    pub bytes: Vec<u8>,
}

impl Answer {
    pub async fn of(request: RequestBuilder) -> Self {
        let response = request.send().await.expect("the server answers");
        let (status, headers) = (response.status().as_u16(), response.headers().clone());
        Self {
            status,
            headers,
            bytes: response.bytes().await.expect("a whole body").to_vec(),
        }
    }

    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers
            .get(name)
            .map(|value| value.to_str().expect("ASCII"))
    }

    pub fn text(&self) -> String {
        String::from_utf8(self.bytes.clone()).expect("UTF-8")
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.bytes).unwrap_or_else(|e| panic!("{e}: {}", self.text()))
    }

    /// Asserts this status and returns the JSON body.
    #[track_caller]
    pub fn ok(&self, status: u16) -> Value {
        assert_eq!(self.status, status, "{}", self.text());
        self.json()
    }

    /// Asserts a complete problem document with this status and code, and returns it.
    #[track_caller]
    pub fn problem(&self, status: u16, code: &str) -> Value {
        assert_eq!(self.status, status, "{}", self.text());
        assert_eq!(
            self.header("content-type"),
            Some("application/problem+json")
        );
        assert!(self.header("x-request-id").is_some());
        let problem = self.json();
        assert_eq!(problem["code"], code, "{problem}");
        assert_eq!(problem["status"], status);
        assert_eq!(problem["type"], format!("urn:kincal:problem:{code}"));
        assert!(
            problem["title"].is_string() && problem["detail"].is_string(),
            "{problem}"
        );
        problem
    }
}

pub struct TestApp {
    pub server: RunningServer,
    pub client: reqwest::Client,
    pub config: ServeConfig,
    _dir: Option<TempDir>,
}

impl TestApp {
    /// A server without workers: jobs stay queued.
    pub async fn spawn() -> Self {
        Self::with_workers(0).await
    }

    pub async fn with_workers(workers: usize) -> Self {
        let dir = tempfile::tempdir().expect("a temporary directory");
        let config = ServeConfig::loopback(dir.path().join("data"), workers);
        Self {
            _dir: Some(dir),
            ..Self::with_config(config).await
        }
    }

    pub async fn with_config(config: ServeConfig) -> Self {
        kincal::http::tls::use_ring();
        let server = server::start(&config).await.expect("the server starts");
        Self {
            server,
            client: reqwest::Client::new(),
            config,
            _dir: None,
        }
    }

    /// Stops the server and starts a new one on the same database.
    pub async fn restart(mut self) -> Self {
        let dir = self._dir.take();
        self.server.shutdown().await;
        Self {
            _dir: dir,
            ..Self::with_config(self.config).await
        }
    }

    pub fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.client
            .request(method, format!("{}{path}", self.server.url()))
    }

    pub async fn get(&self, path: &str) -> Answer {
        Answer::of(self.request(Method::GET, path)).await
    }

    pub async fn post(
        &self,
        path: &str,
        content_type: &str,
        body: impl Into<reqwest::Body>,
    ) -> Answer {
        Answer::of(
            self.request(Method::POST, path)
                .header("content-type", content_type)
                .body(body),
        )
        .await
    }

    pub async fn post_json(&self, path: &str, body: &Value) -> Answer {
        self.post(path, "application/json", body.to_string()).await
    }

    /// Stores the paper's robot. Returns its path.
    pub async fn paper_robot(&self) -> String {
        let answer = self
            .post("/v1/robots", "application/json", paper("robot.json"))
            .await;
        format!("/v1/robots/{}", answer.ok(201)["id"].as_str().unwrap())
    }

    /// Stores a robot and one of the paper's sets. Returns the robot's path and the set's id.
    pub async fn robot_with_set(&self, file: &str) -> (String, String) {
        let robot = self.paper_robot().await;
        let set = self.upload(&robot, file).await;
        (robot, set)
    }

    /// Uploads one of the paper's sets. Returns its id.
    pub async fn upload(&self, robot: &str, file: &str) -> String {
        let answer = self
            .post(
                &format!("{robot}/measurement-sets?frame=base"),
                "text/csv",
                paper(file),
            )
            .await;
        answer.ok(201)["id"].as_str().unwrap().into()
    }

    /// Posts a job and waits until it has ended.
    pub async fn run(&self, robot: &str, request: &Value) -> Value {
        let posted = self.post_json(&format!("{robot}/jobs"), request).await;
        let mut job = posted.ok(202);
        assert_eq!(
            posted.header("location"),
            Some(format!("/v1/jobs/{}", text(&job["id"])).as_str())
        );
        while ["queued", "running"].contains(&text(&job["status"])) {
            job = self
                .get(&format!("/v1/jobs/{}?wait_s=30", text(&job["id"])))
                .await
                .ok(200);
        }
        job
    }

    /// Uploads a CSV file, which must be accepted.
    pub async fn upload_csv(
        &self,
        robot: &str,
        query: &str,
        csv: impl Into<reqwest::Body>,
    ) -> Value {
        let path = format!("{robot}/measurement-sets?{query}");
        self.post(&path, "text/csv", csv).await.ok(201)
    }

    /// The report of a job.
    pub async fn report(&self, job: &Value) -> Value {
        let path = format!("/v1/jobs/{}/report", text(&job["id"]));
        self.get(&path).await.ok(200)
    }

    /// The parameter set of a job.
    pub async fn parameter_set(&self, job: &Value) -> Value {
        let path = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
        self.get(&path).await.ok(200)
    }

    /// Runs a least-squares job on the paper's first set. Returns the robot's path and the job.
    pub async fn identified(&self) -> (String, Value) {
        let (robot, set) = self.robot_with_set("first.csv").await;
        let job = self
            .run(
                &robot,
                &json!({"measurement_set_id": set, "method": "least_squares"}),
            )
            .await;
        assert_eq!(job["status"], "succeeded", "{job}");
        (robot, job)
    }
}

/// A file of the paper's data.
pub fn paper(name: &str) -> Vec<u8> {
    std::fs::read(format!("{}/data/paper/{name}", env!("CARGO_MANIFEST_DIR")))
        .expect("the paper's data")
}

/// A JSON string's text.
#[track_caller]
pub fn text(value: &Value) -> &str {
    value
        .as_str()
        .unwrap_or_else(|| panic!("not a text: {value}"))
}
