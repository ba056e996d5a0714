//! A running server with keys and robots for the tests in a browser.

use crate::process::{Server, kincal, run};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A server with keys, and an administrator's client for it.
pub struct Plant {
    pub server: Server,
    pub folder: TempDir,
}

impl Plant {
    /// Starts a server with one worker.
    pub fn open() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let mut command = kincal(&[
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--workers",
            "1",
            "--data-dir",
        ]);
        command.arg(&data);
        let plant = Self {
            server: Server::of(command),
            folder,
        };
        let admin = plant.key(&["admin"]);
        Self {
            server: plant.server.with_key(admin),
            folder: plant.folder,
        }
    }

    /// Makes a key with the command line.
    pub fn key(&self, scopes: &[&str]) -> String {
        let data = self.folder.path().join("data");
        let mut arguments = vec![
            "key",
            "create",
            "--name",
            "test",
            "--data-dir",
            data.to_str().unwrap(),
        ];
        arguments.extend(scopes.iter().flat_map(|scope| ["--scope", scope]));
        let output = run(&arguments);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    }

    /// Stores the paper's robot under a name.
    pub fn robot(&self, name: &str, serial_number: &str) -> String {
        let mut robot: Value =
            serde_json::from_slice(&std::fs::read(data("robot.json")).unwrap()).unwrap();
        (robot["name"], robot["serial_number"]) = (json!(name), json!(serial_number));
        self.server.create(
            "/v1/robots",
            "application/json",
            robot.to_string().into_bytes(),
        )
    }

    /// Uploads one of the paper's sets under a name. Returns its id.
    pub fn set(&self, robot: &str, file: &str, name: &str) -> String {
        let query =
            reqwest::Url::parse_with_params("http://x/", [("frame", "base"), ("name", name)])
                .unwrap();
        let path = format!(
            "/v1/robots/{robot}/measurement-sets?{}",
            query.query().unwrap()
        );
        self.server
            .create(&path, "text/csv", std::fs::read(data(file)).unwrap())
    }

    /// Runs a calibration to its end. Returns the job.
    pub fn calibrated(&self, robot: &str, set: &str, method: &str) -> Value {
        let job = self
            .server
            .job(robot, &json!({"measurement_set_id": set, "method": method}));
        self.server.finished(&job)
    }

    /// Calibrates a robot with one of the paper's sets, by least squares. Returns the job.
    pub fn identified(&self, robot: &str, file: &str) -> Value {
        self.calibrated(robot, &self.set(robot, file, "first"), "least_squares")
    }

    /// Posts a calibration that runs until it is cancelled.
    pub fn long_job(&self, robot: &str, set: &str) -> String {
        let options = json!({"n_particles": 3000, "n_iterations": 10_000, "stop_at_cost_mm2": 0.0});
        let request = json!({"measurement_set_id": set, "method": "pso", "preset": "paper", "options": options});
        self.server.job(robot, &request)
    }

    /// Releases the parameter set of a job.
    pub fn release(&self, job: &Value, reason: &str) {
        let path = format!(
            "/v1/parameter-sets/{}/release",
            job["parameter_set_id"].as_str().unwrap()
        );
        let body = json!({"reason": reason, "change_reason": "tried in a test"}).to_string();
        let (status, answer) = self
            .server
            .post(&path, "application/json", body.into_bytes());
        assert_eq!(status, 200, "{answer}");
    }

    /// Writes a temporary file.
    pub fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    }
}

/// A file of the paper's data.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("data/paper")
        .join(name)
}

/// The part of a job's address behind the host's page.
pub fn job_hash(job: &Value) -> String {
    format!("#/jobs/{}", job["id"].as_str().unwrap())
}

/// The page of a job.
pub fn job_page(job: &Value) -> String {
    format!("/{}", job_hash(job))
}
