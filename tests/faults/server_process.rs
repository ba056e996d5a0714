//! The released binary as a process.

use crate::process::{Server, run as kincal, serve};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Files of the paper's robot and of its first measurement set.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("data/paper")
        .join(name)
}

#[test]
fn everything_is_there_after_sigterm_and_a_new_start() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 1);
    let robot = server.robot(&data("robot.json"));
    let set = server.set(&robot, &data("first.csv"), "base");
    let job = server.job(&robot, &json!({"measurement_set_id": set, "method": "pso"}));
    let stored = |server: &Server| {
        [
            server.get(&format!("/v1/robots/{robot}")),
            server.get(&format!("/v1/measurement-sets/{set}")),
        ]
    };
    let before = stored(&server);
    assert_eq!([before[0].0, before[1].0], [200, 200]);
    // Whether the job is running or queued by now: it is finished or handed back, and ends once.
    let (status, took) = server.terminate();
    assert_eq!(status.code(), Some(0));
    assert!(took < Duration::from_secs(10), "{took:?}");
    let server = Server::start(dir.path(), 1);
    assert_eq!(stored(&server), before);
    let job = server.finished(&job);
    assert_eq!(
        (&job["status"], &job["attempt"]),
        (&json!("succeeded"), &json!(1)),
        "{job}"
    );
    let (_, sets) = server.get(&format!("/v1/robots/{robot}/parameter-sets"));
    assert_eq!(sets["items"].as_array().unwrap().len(), 1);
}

#[test]
fn sigterm_ends_long_polls_and_event_streams_within_ten_seconds() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 0);
    let robot = server.robot(&data("robot.json"));
    let set = server.set(&robot, &data("first.csv"), "base");
    let job = server.job(&robot, &json!({"measurement_set_id": set}));
    let job = format!("{}/v1/jobs/{job}", server.url);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let (events, poll) = runtime.block_on(async {
        let events = reqwest::get(format!("{job}/events")).await.unwrap();
        let poll = tokio::spawn(reqwest::get(format!("{job}?wait_s=30")));
        // When this is answered, the server has accepted the poll sent before it, or will close that connection unread.
        reqwest::get(&job).await.unwrap();
        (events, poll)
    });
    let (status, took) = server.terminate();
    assert_eq!(status.code(), Some(0));
    assert!(took < Duration::from_secs(10), "{took:?}");
    runtime.block_on(async {
        assert!(events.text().await.unwrap().starts_with("event: progress"));
        if let Ok(answer) = poll.await.unwrap() {
            assert_eq!(answer.json::<Value>().await.unwrap()["status"], "queued");
        }
    });
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

/// The socket is closed some microseconds after it was found empty. If the server loses its processor in between, clients that connect meanwhile are
/// cut off; only a filter in the kernel could prevent that. It is rare, so that most stops cut nobody off. Without a grace period each stop does.
#[test]
fn who_is_connected_when_the_server_stops_is_answered() {
    let mut cut_off_by_stop = Vec::new();
    for _ in 0..5 {
        let dir = tempfile::tempdir().unwrap();
        let server = Server::start(dir.path(), 0);
        let address = server.url.strip_prefix("http://").unwrap().to_owned();
        let clients: Vec<_> = (0..16)
            .map(|_| address.clone())
            .map(|address| std::thread::spawn(move || ask_until_refused(&address)))
            .collect();
        std::thread::sleep(Duration::from_millis(200));
        let (status, took) = server.terminate();
        assert_eq!(status.code(), Some(0));
        assert!(took < Duration::from_secs(10), "{took:?}");
        let (answered, cut_off) = clients
            .into_iter()
            .map(|client| client.join().unwrap())
            .fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        assert!(answered > 16, "{answered}");
        cut_off_by_stop.push(cut_off);
    }
    cut_off_by_stop.sort_unstable();
    assert_eq!(cut_off_by_stop[2], 0, "{cut_off_by_stop:?}");
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
        let server = Server::start(dir.path(), 0);
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
        assert_eq!(server.terminate().0.code(), Some(0));
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

#[test]
fn a_key_made_beside_the_server_opens_it_until_it_is_revoked() {
    let dir = tempfile::tempdir().unwrap();
    let data_dir = dir.path().to_str().unwrap().to_owned();
    let server = Server::of(serve(dir.path(), 0)).with_key("wrong".into());
    assert_eq!(server.get("/v1/robots").0, 401);
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
    let server = server.with_key(key.clone());
    assert_eq!(server.get("/v1/robots").0, 200);
    let list = String::from_utf8(kincal(&["key", "list", "--data-dir", &data_dir]).stdout).unwrap();
    assert!(
        list.contains("cell-4") && list.contains("upload") && !list.contains(&key),
        "{list}"
    );
    let revoked = kincal(&["key", "revoke", "--data-dir", &data_dir, "--name", "cell-4"]);
    assert_eq!(revoked.status.code(), Some(0));
    assert_eq!(server.get("/v1/robots").0, 401);
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

#[test]
fn a_log_that_cannot_be_written_ends_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let full = std::fs::File::options()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let mut command = serve(dir.path(), 1);
    command.arg("--no-auth");
    let server = Server::with_log(command, full.into());
    let robot = server.robot(&data("robot.json"));
    let set = server.set(&robot, &data("first.csv"), "base");
    server.report(
        &robot,
        &json!({"measurement_set_id": set, "method": "least_squares"}),
    );
    assert_eq!(
        server.get("/v1/robots/rob_0").0,
        404,
        "what is refused is logged, too"
    );
    assert_eq!(server.terminate().0.code(), Some(0));
}

#[test]
fn a_data_directory_that_is_removed_takes_nothing_more() {
    let dir = tempfile::tempdir().unwrap();
    let data_dir = dir.path().join("data");
    let server = Server::start(&data_dir, 0);
    let post = || {
        let robot = std::fs::read(data("robot.json")).unwrap();
        server.post("/v1/robots", "application/json", robot).0
    };
    assert_eq!(post(), 201);
    std::fs::rename(&data_dir, dir.path().join("elsewhere")).unwrap();
    let (status, why) = server.status_and_text("/readyz");
    assert_eq!(status, 503);
    assert!(why.contains("moved or removed"), "{why}");
    assert_eq!(post(), 503);
    std::fs::rename(dir.path().join("elsewhere"), &data_dir).unwrap();
    assert_eq!(post(), 201);
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

#[test]
fn the_data_directory_and_its_backup_are_their_owners_alone() {
    let dir = tempfile::tempdir().unwrap();
    let (data_dir, copy) = (dir.path().join("new/data"), dir.path().join("copy"));
    let server = Server::start(&data_dir, 0);
    server.robot(&data("robot.json"));
    assert_eq!(mode(&data_dir), 0o700);
    let files = modes_within(&data_dir);
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
        data_dir.to_str().unwrap(),
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
    let mut command = serve(data, 0);
    command.arg("--no-auth");
    if let Some(uid) = server_uid {
        command.uid(uid);
    }
    Server::with_log(command, to.into()).terminate();
    std::fs::read_to_string(&log).unwrap()
}

#[test]
fn a_data_directory_of_an_older_version_becomes_its_owners_alone() {
    let dir = tempfile::tempdir().unwrap();
    for (rights, is_told) in [(0o755, true), (0o700, false), (0o710, true)] {
        let data = dir.path().join(format!("data-{rights:o}"));
        let said = served_from_an_old_directory(&data, rights, None);
        assert_eq!(mode(&data), 0o700, "{rights:o}: {said}");
        let told = said.contains("removed the permissions of other users");
        assert_eq!(told, is_told, "{rights:o}: {said}");
    }
}

#[test]
fn a_data_directory_of_somebody_else_is_warned_of() {
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
