//! The examples of a cell PC in Python and C# (examples/), against a real server with keys.

use crate::api::tutorial::commands;
use crate::app::{TestApp, paper, text};
use crate::people::{Person, guarded};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("examples")
        .join(name)
}

/// How an example is run.
struct Example {
    program: &'static str,
    file: PathBuf,
    /// Temporary files that must live as long as the example.
    _folder: Option<TempDir>,
}

impl Example {
    fn python() -> Self {
        Self {
            program: "python3",
            file: example("cell_pc.py"),
            _folder: None,
        }
    }

    /// Compiles the example with the command of docs/cell-pc.md, as C# 5, which every .NET Framework 4 can compile. `None`, with a message,
    /// if there is no compiler; KINCAL_EXPECT_MCS requires one.
    fn c_sharp() -> Option<Self> {
        if Command::new("mcs").arg("--version").output().is_err() {
            assert!(
                std::env::var_os("KINCAL_EXPECT_MCS").is_none(),
                "mcs is expected here and missing"
            );
            eprintln!(
                "SKIPPED: no mcs here; apt-get install mono-mcs mono-runtime libmono-system-runtime-serialization4.0-cil"
            );
            return None;
        }
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("examples")).unwrap();
        std::fs::copy(
            example("cell_pc.cs"),
            folder.path().join("examples/cell_pc.cs"),
        )
        .unwrap();
        let commands = commands("docs/cell-pc.md");
        let [command] = commands.as_slice() else {
            panic!("one command: {commands:?}")
        };
        let strict = command.replace("mcs ", "mcs -langversion:5 -warnaserror ");
        let compiled = Command::new("bash")
            .args(["-c", &strict])
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(
            compiled.status.success(),
            "{}",
            String::from_utf8_lossy(&compiled.stderr)
        );
        Some(Self {
            program: "mono",
            file: folder.path().join("examples/cell_pc.exe"),
            _folder: Some(folder),
        })
    }

    /// Runs the example with a key.
    async fn run(
        &self,
        app: &TestApp,
        key: &str,
        arguments: &[&str],
    ) -> (Option<i32>, String, String) {
        let mut command = Command::new(self.program);
        command
            .arg(&self.file)
            .args(arguments)
            .env("KINCAL_URL", app.server.url())
            .env("KINCAL_KEY", key);
        // The server runs in this process: the example must not block its threads.
        let output: Output =
            tokio::task::spawn_blocking(move || command.output().expect("it is there"))
                .await
                .unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (
            output.status.code(),
            text(output.stdout),
            text(output.stderr),
        )
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_python_example_calibrates_and_fetches_what_was_released() {
    calibrates_and_fetches(&Example::python()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_c_sharp_example_calibrates_and_fetches_what_was_released() {
    let Some(example) = Example::c_sharp() else {
        return;
    };
    calibrates_and_fetches(&example).await;
}

async fn calibrates_and_fetches(example: &Example) {
    let (app, dir) = guarded(1).await;
    let cell = Person::new(&app, &["read", "upload", "identify"]).await;
    let boss = Person::new(&app, &["read", "release"]).await;
    let robot: Value = cell
        .post(
            "/v1/robots",
            &serde_json::from_slice(&paper("robot.json")).unwrap(),
        )
        .await
        .ok(201);
    let (robot, file) = (text(&robot["id"]), dir.path().join("parameters.json"));
    let (set, file) = (
        format!("{}/data/paper/first_noisy.csv", env!("CARGO_MANIFEST_DIR")),
        file.to_str().unwrap(),
    );

    let (code, stdout, stderr) = example.run(&app, &cell.key, &["fetch", robot, file]).await;
    assert_eq!(
        (code, stdout.as_str()),
        (Some(2), ""),
        "nothing is released yet"
    );
    assert!(stderr.contains("no_active_parameter_set"), "{stderr}");
    assert!(!Path::new(file).exists());
    for (count, reason) in [(1, "seen"), (2, "seen again")] {
        let (code, stdout, stderr) = example
            .run(&app, &cell.key, &["calibrate", robot, &set])
            .await;
        assert_eq!(code, Some(0), "{stderr}");
        assert!(stdout.contains("verify: 50 points, rms 1.0"), "{stdout}");
        assert!(stderr.contains("warning (pose_not_seen): "), "{stderr}");
        let sets = cell
            .get(&format!("/v1/robots/{robot}/parameter-sets"))
            .await
            .ok(200);
        assert_eq!(sets["items"].as_array().unwrap().len(), count);
        let candidate = &sets["items"][0];
        assert!(stdout.contains(text(&candidate["id"])), "{stdout}");

        boss.post(
            &format!("/v1/parameter-sets/{}/release", text(&candidate["id"])),
            &json!({"reason": reason}),
        )
        .await
        .ok(200);
        let (code, stdout, stderr) = example.run(&app, &cell.key, &["fetch", robot, file]).await;
        assert_eq!(code, Some(0), "{stderr}");
        assert!(
            stdout.starts_with("fetched") && stdout.contains(text(&candidate["sha256"])),
            "{stdout}"
        );
        let fetched: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
        let canonical = |value: &Value| kincal::wire::canonical::to_canonical_json(value).unwrap();
        assert_eq!(canonical(&fetched["links"]), canonical(&candidate["links"]));
        let (code, stdout, _) = example.run(&app, &cell.key, &["fetch", robot, file]).await;
        assert_eq!((code, stdout.trim_end()), (Some(0), "unchanged"));
    }
    assert!(
        !Path::new(&format!("{file}.part")).exists(),
        "nothing half is left"
    );

    let faulty = dir.path().join("faulty.csv");
    std::fs::write(&faulty, "q1_deg,x_mm\n1,2\n").unwrap();
    let (code, _, stderr) = example
        .run(
            &app,
            &cell.key,
            &["calibrate", robot, faulty.to_str().unwrap()],
        )
        .await;
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("q2_deg") && !stderr.contains("Traceback") && !stderr.contains("Exception"),
        "{stderr}"
    );
    let (code, _, stderr) = example
        .run(&app, "kincal_wrong", &["fetch", robot, file])
        .await;
    assert_eq!(code, Some(2));
    assert!(stderr.contains("unauthorized"), "{stderr}");
    let (code, _, stderr) = example
        .run(&app, &cell.key, &["calibrate", robot, "no_such_file.csv"])
        .await;
    assert_eq!(code, Some(1));
    assert!(
        stderr.contains("no_such_file.csv") && stderr.lines().count() == 1,
        "{stderr}"
    );
}

/// A server whose content does not match its hash: nothing of it may reach the file.
#[tokio::test(flavor = "multi_thread")]
async fn damaged_parameters_are_not_kept() {
    for example in [Some(Example::python()), Example::c_sharp()]
        .into_iter()
        .flatten()
    {
        let url = server_with_wrong_content();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("parameters.json");
        let mut command = Command::new(example.program);
        command
            .arg(&example.file)
            .args(["fetch", "rob_1"])
            .arg(&file)
            .env("KINCAL_URL", url)
            .env_remove("KINCAL_KEY");
        let output = tokio::task::spawn_blocking(move || command.output().expect("it is there"))
            .await
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        assert!(stderr.contains("is damaged"), "{stderr}");
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            0,
            "nothing was written"
        );
    }
}

/// Answers two requests: first an active set, then the content of another one.
fn server_with_wrong_content() -> String {
    use std::io::{BufRead, BufReader, Write};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        let set =
            json!({"id": "par_1", "sha256": "0".repeat(64), "released_at": "2026-11-21T12:00:00Z"})
                .to_string();
        for body in [set, "{}".to_owned()] {
            let (mut stream, _) = listener.accept().unwrap();
            BufReader::new(&stream)
                .lines()
                .map_while(Result::ok)
                .find(String::is_empty);
            let head = format!(
                "HTTP/1.1 200 OK\r\nETag: \"1\"\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
                body.len()
            );
            stream.write_all((head + &body).as_bytes()).unwrap();
        }
    });
    url
}
