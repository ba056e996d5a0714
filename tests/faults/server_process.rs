//! The released binary as a process.

use crate::app::{paper, text};
use crate::process::{run as kincal, url_of};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

struct Process {
    child: Child,
    url: String,
}

impl Process {
    fn serve(data_dir: &Path, workers: &str, extra: &[&str]) -> Self {
        Self::serve_with_log(data_dir, workers, extra, Stdio::null(), None)
    }

    fn serve_with_log(
        data_dir: &Path,
        workers: &str,
        extra: &[&str],
        log: Stdio,
        uid: Option<u32>,
    ) -> Self {
        kincal::http::tls::use_ring();
        let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
        command
            .args([
                "serve",
                "--listen",
                "127.0.0.1:0",
                "--workers",
                workers,
                "--data-dir",
            ])
            .arg(data_dir)
            .args(extra);
        if let Some(uid) = uid {
            std::os::unix::process::CommandExt::uid(&mut command, uid);
        }
        let mut child = command.stdout(Stdio::piped()).stderr(log).spawn().unwrap();
        let url = url_of(&mut child);
        Self { child, url }
    }

    /// Asks the process to stop and waits until it has ended. Returns the time that it took.
    fn terminate(&mut self) -> (Duration, Option<i32>) {
        let begun = Instant::now();
        assert!(
            Command::new("kill")
                .arg(self.child.id().to_string())
                .status()
                .unwrap()
                .success()
        );
        let status = self.child.wait().unwrap();
        (begun.elapsed(), status.code())
    }

    async fn post(&self, path: &str, content_type: &str, body: Vec<u8>) -> Value {
        let request = reqwest::Client::new()
            .post(format!("{}{path}", self.url))
            .header("content-type", content_type)
            .body(body);
        request
            .send()
            .await
            .unwrap()
            .error_for_status()
            .unwrap()
            .json()
            .await
            .unwrap()
    }

    async fn get(&self, path: &str) -> Value {
        reqwest::get(format!("{}{path}", self.url))
            .await
            .unwrap()
            .error_for_status()
            .unwrap()
            .json()
            .await
            .unwrap()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[tokio::test]
async fn everything_is_there_after_sigterm_and_a_new_start() {
    let dir = tempfile::tempdir().unwrap();
    let mut server = Process::serve(dir.path(), "1", &["--no-auth"]);
    let robot = server
        .post("/v1/robots", "application/json", paper("robot.json"))
        .await;
    let sets = format!(
        "/v1/robots/{}/measurement-sets?frame=base",
        text(&robot["id"])
    );
    let set = server.post(&sets, "text/csv", paper("first.csv")).await;
    let jobs = format!("/v1/robots/{}/jobs", text(&robot["id"]));
    let request = json!({"measurement_set_id": set["id"], "method": "pso"})
        .to_string()
        .into_bytes();
    let posted = server.post(&jobs, "application/json", request).await;
    // Whether the job is running or queued by now: it is finished or handed back, and ends once.
    let (took, code) = server.terminate();
    assert_eq!(code, Some(0));
    assert!(took < Duration::from_secs(10), "{took:?}");
    let server = Process::serve(dir.path(), "1", &["--no-auth"]);
    assert_eq!(
        server
            .get(&format!("/v1/robots/{}", text(&robot["id"])))
            .await,
        robot
    );
    assert_eq!(
        server
            .get(&format!("/v1/measurement-sets/{}", text(&set["id"])))
            .await,
        set
    );
    let mut job = posted.clone();
    while ["queued", "running"].contains(&text(&job["status"])) {
        job = server
            .get(&format!("/v1/jobs/{}?wait_s=30", text(&posted["id"])))
            .await;
    }
    assert_eq!(
        (&job["status"], &job["attempt"]),
        (&json!("succeeded"), &json!(1)),
        "{job}"
    );
    let sets = server
        .get(&format!("/v1/robots/{}/parameter-sets", text(&robot["id"])))
        .await;
    assert_eq!(sets["items"].as_array().unwrap().len(), 1);
}

#[tokio::test]
async fn sigterm_ends_long_polls_and_event_streams_within_ten_seconds() {
    let dir = tempfile::tempdir().unwrap();
    let mut server = Process::serve(dir.path(), "0", &["--no-auth"]);
    let robot = server
        .post("/v1/robots", "application/json", paper("robot.json"))
        .await;
    let set = server
        .post(
            &format!("/v1/robots/{}/measurement-sets", text(&robot["id"])),
            "text/csv",
            paper("first.csv"),
        )
        .await;
    let request = json!({"measurement_set_id": set["id"]})
        .to_string()
        .into_bytes();
    let job = server
        .post(
            &format!("/v1/robots/{}/jobs", text(&robot["id"])),
            "application/json",
            request,
        )
        .await;
    let job = format!("{}/v1/jobs/{}", server.url, text(&job["id"]));
    let events = reqwest::get(format!("{job}/events")).await.unwrap();
    let poll = tokio::spawn(reqwest::get(format!("{job}?wait_s=30")));
    // When this is answered, the server has accepted the poll sent before it, or will close that connection unread.
    reqwest::get(&job).await.unwrap();
    let (took, code) = tokio::task::spawn_blocking(move || server.terminate())
        .await
        .unwrap();
    assert_eq!(code, Some(0));
    assert!(took < Duration::from_secs(10), "{took:?}");
    assert!(events.text().await.unwrap().starts_with("event: progress"));
    if let Ok(answer) = poll.await.unwrap() {
        assert_eq!(answer.json::<Value>().await.unwrap()["status"], "queued");
    }
}

/// Sends requests until no more connections are accepted. Returns how many were answered, and how many were connected and cut off.
fn ask_until_refused(address: &str) -> (usize, usize) {
    let (begun, mut answered, mut cut_off) = (Instant::now(), 0, 0);
    while begun.elapsed() < Duration::from_secs(10) {
        let Ok(mut connection) = TcpStream::connect(address) else {
            break;
        };
        connection
            .set_read_timeout(Some(Duration::from_secs(5)))
            .unwrap();
        let mut answer = Vec::new();
        let asked = connection
            .write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
        let _ = asked.and_then(|()| connection.read_to_end(&mut answer));
        if answer.starts_with(b"HTTP/1.1 ") {
            answered += 1
        } else {
            cut_off += 1
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    (answered, cut_off)
}

/// Most requests that are cut off in all stops together. The socket is closed some microseconds after it was found empty, and at thousands of
/// connections a second one may arrive in between; only a filter in the kernel could prevent that. Without a grace period there are several at each
/// stop.
const MOST_CUT_OFF: usize = 2;

#[test]
fn who_is_connected_when_the_server_stops_is_answered() {
    let mut all_cut_off = 0;
    for _ in 0..5 {
        let dir = tempfile::tempdir().unwrap();
        let mut server = Process::serve(dir.path(), "0", &["--no-auth"]);
        let address = server.url.strip_prefix("http://").unwrap().to_owned();
        let clients: Vec<_> = (0..16)
            .map(|_| address.clone())
            .map(|address| std::thread::spawn(move || ask_until_refused(&address)))
            .collect();
        std::thread::sleep(Duration::from_millis(200));
        let (took, code) = server.terminate();
        assert_eq!(code, Some(0));
        assert!(took < Duration::from_secs(10), "{took:?}");
        let (answered, cut_off) = clients
            .into_iter()
            .map(|client| client.join().unwrap())
            .fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        assert!(answered > 16, "{answered}");
        all_cut_off += cut_off;
    }
    assert!(all_cut_off <= MOST_CUT_OFF, "{all_cut_off}");
}

/// Sends a request on each of these connections. Returns the number of answers.
fn ask_all(mut connections: Vec<TcpStream>) -> usize {
    for connection in &mut connections {
        let _ = connection
            .write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
    }
    let mut answered = 0;
    for mut connection in connections {
        let mut answer = Vec::new();
        let _ = connection.read_to_end(&mut answer);
        answered += usize::from(answer.starts_with(b"HTTP/1.1 "));
    }
    answered
}

#[test]
fn open_connections_are_answered_during_shutdown() {
    for _ in 0..5 {
        let dir = tempfile::tempdir().unwrap();
        let mut server = Process::serve(dir.path(), "0", &["--no-auth"]);
        let address = server.url.strip_prefix("http://").unwrap();
        let connections: Vec<TcpStream> = (0..32)
            .map(|_| TcpStream::connect(address).unwrap())
            .collect();
        std::thread::sleep(Duration::from_millis(50));
        // Some milliseconds after the signal.
        let asked = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(15));
            ask_all(connections)
        });
        assert_eq!(server.terminate().1, Some(0));
        assert_eq!(asked.join().unwrap(), 32);
    }
}

#[test]
fn no_auth_beyond_loopback_is_wrong_usage() {
    let output = kincal(&["serve", "--no-auth", "--listen", "0.0.0.0:0"]);
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        message.contains("loopback") && message.contains("kincal key create"),
        "{message}"
    );
    assert_eq!(
        kincal(&["serve", "--listen", "nowhere"]).status.code(),
        Some(2)
    );
    assert_eq!(kincal(&["fly"]).status.code(), Some(2));
}

#[test]
fn an_address_in_use_is_a_failure_that_says_so() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let dir = tempfile::tempdir().unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = kincal(&[
        "serve",
        "--no-auth",
        "--listen",
        &address,
        "--data-dir",
        dir.path().to_str().unwrap(),
    ]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("--listen")
    );
}

#[tokio::test]
async fn a_key_made_beside_the_server_opens_it_until_it_is_revoked() {
    let dir = tempfile::tempdir().unwrap();
    let data_dir = dir.path().to_str().unwrap().to_owned();
    let server = Process::serve(dir.path(), "0", &[]);
    let get = |key: String| {
        reqwest::Client::new()
            .get(format!("{}/v1/robots", server.url))
            .bearer_auth(key)
            .send()
    };
    assert_eq!(get("wrong".into()).await.unwrap().status(), 401);
    let create = [
        "key",
        "create",
        "--data-dir",
        &data_dir,
        "--name",
        "cell-4",
        "--scope",
        "read",
        "--scope",
        "upload",
    ];
    let key = String::from_utf8(kincal(&create).stdout)
        .unwrap()
        .trim()
        .to_owned();
    assert_eq!(get(key.clone()).await.unwrap().status(), 200);
    let list = String::from_utf8(kincal(&["key", "list", "--data-dir", &data_dir]).stdout).unwrap();
    assert!(
        list.contains("cell-4") && list.contains("upload") && !list.contains(&key),
        "{list}"
    );
    let revoked = kincal(&["key", "revoke", "--data-dir", &data_dir, "--name", "cell-4"]);
    assert_eq!(revoked.status.code(), Some(0));
    assert_eq!(get(key).await.unwrap().status(), 401);
    assert_eq!(
        kincal(&["key", "revoke", "--data-dir", &data_dir, "--name", "cell-4"])
            .status
            .code(),
        Some(1)
    );
    assert_eq!(
        kincal(&[
            "key",
            "create",
            "--data-dir",
            &data_dir,
            "--name",
            "x",
            "--scope",
            "everything"
        ])
        .status
        .code(),
        Some(2)
    );
    assert_eq!(
        kincal(&[
            "key",
            "create",
            "--data-dir",
            &data_dir,
            "--name",
            "x",
            "--scope",
            "read",
            "--robot",
            "rob_0"
        ])
        .status
        .code(),
        Some(2)
    );
}

#[test]
fn openapi_prints_the_checked_in_document() {
    assert_eq!(
        String::from_utf8(kincal(&["openapi"]).stdout).unwrap(),
        include_str!("../../openapi.yaml")
    );
}

#[tokio::test]
async fn a_log_that_cannot_be_written_ends_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let full = std::fs::File::options()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let mut server = Process::serve_with_log(dir.path(), "1", &["--no-auth"], full.into(), None);
    let robot = server
        .post("/v1/robots", "application/json", paper("robot.json"))
        .await;
    let robot = format!("/v1/robots/{}", text(&robot["id"]));
    let set = server
        .post(
            &format!("{robot}/measurement-sets?frame=base"),
            "text/csv",
            paper("first.csv"),
        )
        .await;
    let request = serde_json::json!({"measurement_set_id": set["id"], "method": "least_squares"});
    let job = server
        .post(
            &format!("{robot}/jobs"),
            "application/json",
            request.to_string().into_bytes(),
        )
        .await;
    let path = format!("/v1/jobs/{}?wait_s=10", text(&job["id"]));
    let deadline = Instant::now() + Duration::from_secs(60);
    while server.get(&path).await["status"] != "succeeded" {
        assert!(Instant::now() < deadline);
    }
    assert_eq!(
        reqwest::get(format!("{}/v1/robots/rob_0", server.url))
            .await
            .unwrap()
            .status(),
        404,
        "what is refused is logged, too"
    );
    assert_eq!(server.terminate().1, Some(0));
}

#[tokio::test]
async fn a_data_directory_that_is_removed_takes_nothing_more() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let server = Process::serve(&data, "0", &["--no-auth"]);
    server
        .post("/v1/robots", "application/json", paper("robot.json"))
        .await;
    std::fs::rename(&data, dir.path().join("elsewhere")).unwrap();
    let ready = reqwest::get(format!("{}/readyz", server.url))
        .await
        .unwrap();
    assert_eq!(ready.status(), 503);
    assert!(ready.text().await.unwrap().contains("moved or removed"));
    let request = reqwest::Client::new()
        .post(format!("{}/v1/robots", server.url))
        .header("content-type", "application/json");
    assert_eq!(
        request
            .body(paper("robot.json"))
            .send()
            .await
            .unwrap()
            .status(),
        503
    );
    std::fs::rename(dir.path().join("elsewhere"), &data).unwrap();
    server
        .post("/v1/robots", "application/json", paper("robot.json"))
        .await;
}

/// Permissions of a file or directory.
fn mode(path: &Path) -> u32 {
    use std::os::unix::fs::PermissionsExt;
    std::fs::metadata(path).unwrap().permissions().mode() & 0o7777
}

/// Name and permissions of every file in a directory.
fn modes_within(dir: &Path) -> Vec<(String, u32)> {
    let entries = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap());
    let mut modes: Vec<_> = entries
        .map(|entry| {
            (
                entry.file_name().into_string().unwrap(),
                mode(&entry.path()),
            )
        })
        .collect();
    modes.sort();
    modes
}

#[tokio::test]
async fn the_data_directory_and_its_backup_are_their_owners_alone() {
    let dir = tempfile::tempdir().unwrap();
    let (data, copy) = (dir.path().join("new/data"), dir.path().join("copy"));
    let server = Process::serve(&data, "0", &["--no-auth"]);
    server
        .post("/v1/robots", "application/json", paper("robot.json"))
        .await;
    assert_eq!(mode(&data), 0o700);
    let files = modes_within(&data);
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(
        names,
        [
            "kincal.sqlite",
            "kincal.sqlite-shm",
            "kincal.sqlite-wal",
            "lock"
        ]
    );
    assert!(files.iter().all(|(_, mode)| *mode == 0o600), "{files:?}");
    let arguments = [
        "backup",
        "--data-dir",
        data.to_str().unwrap(),
        copy.to_str().unwrap(),
    ];
    let made = kincal(&arguments);
    assert!(made.status.success(), "{made:?}");
    assert_eq!(mode(&copy), 0o700);
    let files = modes_within(&copy);
    assert!(
        !files.is_empty() && files.iter().all(|(_, mode)| *mode == 0o600),
        "{files:?}"
    );
}

/// Runs a server on a data directory with the permissions that older versions gave it. Returns its log.
fn served_from_an_old_directory(data: &Path, rights: u32, server_uid: Option<u32>) -> String {
    use std::os::unix::fs::PermissionsExt;
    std::fs::create_dir_all(data).unwrap();
    std::fs::set_permissions(data, std::fs::Permissions::from_mode(rights)).unwrap();
    let log = data.with_extension("log");
    let to = std::fs::File::create(&log).unwrap();
    let mut server = Process::serve_with_log(data, "0", &["--no-auth"], to.into(), server_uid);
    server.terminate();
    std::fs::read_to_string(&log).unwrap()
}

#[tokio::test]
async fn a_data_directory_of_an_older_version_becomes_its_owners_alone() {
    let dir = tempfile::tempdir().unwrap();
    for (rights, is_told) in [(0o755, true), (0o700, false), (0o710, true)] {
        let data = dir.path().join(format!("data-{rights:o}"));
        let said = served_from_an_old_directory(&data, rights, None);
        assert_eq!(mode(&data), 0o700, "{rights:o}: {said}");
        let told = said.contains("removed the permissions of other users");
        assert_eq!(told, is_told, "{rights:o}: {said}");
    }
}

#[tokio::test]
async fn a_data_directory_of_somebody_else_is_warned_of() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    const DEFAULT_ACTOR: u32 = 65534;
    let dir = tempfile::tempdir().unwrap();
    if dir.path().metadata().unwrap().uid() != 0 {
        eprintln!("not looked at: only root can be somebody else");
        return;
    }
    let open = std::fs::Permissions::from_mode(0o755);
    std::fs::set_permissions(dir.path(), open).unwrap();
    let data = dir.path().join("data");
    let said = served_from_an_old_directory(&data, 0o777, Some(DEFAULT_ACTOR));
    assert!(said.contains("can read the data directory"), "{said}");
    assert_eq!(mode(&data), 0o777);
}

#[test]
fn the_help_of_backup_says_that_copying_the_directory_is_none() {
    let help = kincal(&["backup", "--help"]);
    let said = String::from_utf8(help.stdout).unwrap();
    assert!(
        said.contains("Copying the data directory of a running server is no backup"),
        "{said}"
    );
}
