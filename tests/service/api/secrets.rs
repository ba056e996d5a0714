//! Canaries: keys, bodies, headers and queries with marks are sent to a server that logs everything. Afterwards the marks are searched in everything
//! that it has written.

use crate::app::paper;
use crate::process::url_of;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// The mark. It may be stored only where the data belongs.
const CANARY: &str = "CANARY7f3a";

struct Loud {
    child: Child,
    url: String,
    log: PathBuf,
}

impl Loud {
    fn serve(dir: &Path, arguments: &[&str]) -> Self {
        let log = dir.join("log");
        let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
        command
            .args(["serve", "--listen", "127.0.0.1:0", "--workers", "1"])
            .args(arguments);
        command
            .env("KINCAL_LOG", "trace")
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(&log).unwrap());
        let mut child = command.spawn().unwrap();
        let url = url_of(&mut child);
        Self { child, url, log }
    }

    /// Ends the server. Returns its log.
    fn ended(mut self) -> String {
        assert!(
            Command::new("kill")
                .arg(self.child.id().to_string())
                .status()
                .unwrap()
                .success()
        );
        self.child.wait().unwrap();
        String::from_utf8(std::fs::read(&self.log).unwrap()).unwrap()
    }
}

impl Drop for Loud {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn new_key(data_dir: &str, scope: &str) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args([
            "key",
            "create",
            "--data-dir",
            data_dir,
            "--name",
            "canary",
            "--scope",
            scope,
        ])
        .output()
        .unwrap();
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

fn files_below(dir: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| {
            if path.is_dir() {
                files_below(&path)
            } else {
                vec![path]
            }
        })
        .collect()
}

fn holds(haystack: &[u8], needle: &str) -> bool {
    haystack
        .windows(needle.len())
        .any(|window| window == needle.as_bytes())
}

#[tokio::test]
async fn no_key_and_no_body_is_in_logs_database_audit_or_metrics() {
    let dir = tempfile::tempdir().unwrap();
    let data_dir = dir.path().join("data");
    let server = Loud::serve(dir.path(), &["--data-dir", data_dir.to_str().unwrap()]);
    let (admin, reader) = (
        new_key(data_dir.to_str().unwrap(), "admin"),
        new_key(data_dir.to_str().unwrap(), "read"),
    );
    assert!(admin.starts_with("kincal_") && reader.starts_with("kincal_"));
    let unknown = format!("kincal_{}", "5ca1ab1e".repeat(8));
    kincal::http::tls::use_ring();
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let mut answers = Vec::new();
    let mut said = async |request: reqwest::RequestBuilder| {
        let answer = request.send().await.unwrap();
        let headers = format!("{:?}", answer.headers());
        let text = answer.text().await.unwrap();
        answers.push(headers + &text);
        serde_json::from_str::<serde_json::Value>(&text).unwrap_or_default()
    };
    let at = |path: &str| format!("{}{path}", server.url);
    let json = "application/json";
    // A robot, a set, a job and a refused release, with a valid key.
    let body = String::from_utf8(paper("robot.json")).unwrap().replacen(
        "\"name\": \"",
        &format!("\"name\": \"{CANARY} "),
        1,
    );
    assert!(body.contains(CANARY));
    let post = |path: &str| client.post(at(path)).bearer_auth(&admin);
    let robot = said(
        post("/v1/robots")
            .header("content-type", json)
            .header("idempotency-key", CANARY)
            .body(body),
    )
    .await;
    let robot = robot["id"].as_str().unwrap().to_owned();
    let sets = format!("/v1/robots/{robot}/measurement-sets?frame=base&name={CANARY}");
    let set = said(
        post(&sets)
            .header("content-type", "text/csv")
            .body(paper("first.csv")),
    )
    .await;
    let request =
        serde_json::json!({"measurement_set_id": set["id"], "method": "least_squares"}).to_string();
    let job = said(
        post(&format!("/v1/robots/{robot}/jobs"))
            .header("content-type", json)
            .body(request),
    )
    .await;
    let polled = said(
        client
            .get(at(&format!(
                "/v1/jobs/{}?wait_s=20",
                job["id"].as_str().unwrap()
            )))
            .bearer_auth(&admin),
    )
    .await;
    let parameter_set = polled["parameter_set_id"]
        .as_str()
        .unwrap_or_default()
        .to_owned();
    let release = format!("/v1/parameter-sets/{parameter_set}/release");
    said(
        post(&release)
            .header("content-type", json)
            .body(format!("{{\"reason\": \"{CANARY}\", \"{CANARY}\": 1}}")),
    )
    .await;
    // Refused requests: wrong cells, wrong JSON, wrong types, wrong keys, wrong schemes, unknown paths, other methods.
    let bad_cell = String::from_utf8(paper("first.csv"))
        .unwrap()
        .replacen("-", CANARY, 3);
    said(
        post(&sets)
            .header("content-type", "text/csv")
            .body(bad_cell),
    )
    .await;
    said(
        post("/v1/robots")
            .header("content-type", json)
            .body(format!("{{\"{CANARY}\": ")),
    )
    .await;
    said(
        post("/v1/robots")
            .header("content-type", json)
            .body(format!("{{\"{CANARY}\": 1}}")),
    )
    .await;
    said(
        post("/v1/robots")
            .header("content-type", format!("text/{CANARY}"))
            .body(CANARY),
    )
    .await;
    said(post(&format!("/v1/{CANARY}?q={CANARY}")).body(CANARY)).await;
    said(
        client
            .delete(at(&format!("/v1/robots/{CANARY}")))
            .bearer_auth(&admin),
    )
    .await;
    said(
        client
            .get(at("/v1/robots"))
            .bearer_auth(&unknown)
            .header("cookie", CANARY)
            .header("x-note", CANARY),
    )
    .await;
    said(
        client
            .get(at("/v1/robots"))
            .basic_auth(CANARY, Some(&unknown)),
    )
    .await;
    said(
        client
            .get(at("/v1/robots"))
            .header("authorization", format!("Bearer {admin} {CANARY}")),
    )
    .await;
    said(
        client
            .post(at("/v1/robots"))
            .bearer_auth(&reader)
            .header("content-type", json)
            .body(CANARY),
    )
    .await;
    said(client.get(at("/metrics")).bearer_auth(&admin)).await;
    let metrics = answers.last().unwrap().clone();
    assert!(metrics.contains("kincal_requests_total") && !metrics.contains(CANARY));
    for answer in &answers {
        assert!(
            ![&admin, &reader, &unknown]
                .iter()
                .any(|key| answer.contains(key.as_str())),
            "a key is answered: {answer}"
        );
    }
    let log = server.ended();
    assert!(
        log.contains("\"level\":\"DEBUG\"")
            && log.contains("insufficient_scope")
            && log.lines().count() > 50,
        "it logs everything"
    );
    for secret in [&admin, &reader, &unknown] {
        let bare = &secret["kincal_".len()..];
        for file in files_below(&data_dir) {
            let bytes = std::fs::read(&file).unwrap();
            assert!(!holds(&bytes, bare), "a key is in {}", file.display());
        }
        assert!(
            !log.contains(bare),
            "a key is logged: {:?}",
            log.lines().find(|line| line.contains(bare))
        );
    }
    assert!(
        !log.contains(CANARY),
        "{:?}",
        log.lines().find(|line| line.contains(CANARY))
    );
    // The rows of the set must not be in the log either.
    let row = String::from_utf8(paper("first.csv"))
        .unwrap()
        .lines()
        .nth(1)
        .unwrap()
        .to_owned();
    assert!(
        !log.contains(&row),
        "{:?}",
        log.lines().find(|line| line.contains(&row))
    );
    // The search works: it finds the name in the database, where it belongs.
    assert!(
        files_below(&data_dir)
            .iter()
            .any(|file| holds(&std::fs::read(file).unwrap(), CANARY))
    );
}

#[test]
fn the_databases_password_is_not_said_aloud() {
    let url = format!("postgres://someone:{CANARY}@127.0.0.1:1/nothing");
    for command in [
        vec!["serve", "--listen", "127.0.0.1:0"],
        vec!["worker"],
        vec!["key", "list"],
        vec!["verify-store"],
        vec!["serve", "--help"],
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
            .args(&command)
            .env("KINCAL_DATABASE_URL", &url)
            .env("KINCAL_LOG", "trace")
            .output()
            .unwrap();
        let all = String::from_utf8_lossy(&output.stdout).into_owned()
            + &String::from_utf8_lossy(&output.stderr);
        assert!(
            !all.is_empty() && !all.contains(CANARY),
            "{command:?}: {all}"
        );
    }
}
