//! Runs the tutorial: every command line of its code blocks, in order, in one shell, with the binary under test.

use serde_json::Value;
use std::net::TcpListener;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Output};

/// The lines of a text's code blocks.
pub fn commands(file: &str) -> Vec<String> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
    text.lines()
        .filter_map(|line| line.strip_prefix("    "))
        .map(str::to_owned)
        .collect()
}

/// The value for a placeholder in capitals: the id of the newest item of its kind.
fn placeholder_value(word: &str) -> String {
    let newest = "python3 -c 'import json, sys; print(json.load(sys.stdin)[\"items\"][0][\"id\"])'";
    match word {
        "ROBOT_ID" => format!("$(kincal robots --json | {newest})"),
        "JOB" => format!("$(kincal jobs --robot ER20-C10 --json | {newest})"),
        "PARAMETER_SET" => format!("$(kincal params --robot ER20-C10 --json | {newest})"),
        word => word.into(),
    }
}

/// The commands as one script. It differs from the tutorial in three ways: the binary is already built, the port is another, and it polls the server until it is ready.
fn script(port: u16) -> String {
    let mut script = String::from("set -euo pipefail\ntrap 'kill $(jobs -p)' EXIT\n");
    for command in commands("docs/tutorial.md") {
        if command == "cargo build --release --locked" {
            continue;
        }
        let words: Vec<String> = command.split(' ').map(placeholder_value).collect();
        let command = words.join(" ").replace(":8080", &format!(":{port}"));
        script += &format!(
            "echo {:?}\n{command}\n",
            format!("--- {}", command.replace(['$', '"', '`', '\\'], ""))
        );
        if command == "kincal serve &" {
            script += &format!(
                "for i in $(seq 200); do curl -s -o /dev/null http://127.0.0.1:{port}/readyz && break; sleep 0.1; done\n"
            );
        }
    }
    script
}

#[test]
fn the_tutorial_does_what_it_says() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    for name in ["data", "examples"] {
        symlink(root.join(name), folder.path().join(name)).unwrap();
    }
    std::fs::create_dir_all(folder.path().join("target/release")).unwrap();
    symlink(
        env!("CARGO_BIN_EXE_kincal"),
        folder.path().join("target/release/kincal"),
    )
    .unwrap();
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let server = format!("http://127.0.0.1:{port}");
    let script = script(port);
    assert!(
        script.matches("\n--- ").count() == 0 && script.matches("echo \"--- ").count() >= 10,
        "commands were found:\n{script}"
    );
    let Output {
        status,
        stdout,
        stderr,
    } = Command::new("timeout")
        .args(["300", "bash", "-c", &script])
        .current_dir(folder.path())
        .env("KINCAL_LISTEN", format!("127.0.0.1:{port}"))
        .envs([("KINCAL_SERVER", &server), ("KINCAL_URL", &server)])
        .output()
        .unwrap();
    let printed = String::from_utf8(stdout).unwrap();
    assert!(
        status.success(),
        "{printed}\n{}",
        String::from_utf8_lossy(&stderr)
    );

    // The results that the text promises for each step.
    for expected in [
        "verify (50), after",
        "passed   verify_errors_improved",
        "is released",
        "fetched par_",
        "SHA-256",
    ] {
        assert!(printed.contains(expected), "{expected}:\n{printed}");
    }
    let parameters: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("parameters.json")).unwrap())
            .unwrap();
    assert_eq!(parameters["links"].as_array().unwrap().len(), 6);
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    let text = std::fs::read_to_string(root.join("docs/tutorial.md"))
        .unwrap()
        .replace('\n', " ");
    let (_, sentence) = page
        .split_once("the mean position error fell from ")
        .unwrap();
    let (before, rest) = sentence.split_once(" mm to <strong>").unwrap();
    let (after, _) = rest.split_once(" mm</strong>").unwrap();
    let number = |text: &str| text.parse::<f64>().unwrap();
    let promised = format!("fell from {:.3} to {:.3} mm", number(before), number(after));
    assert!(
        text.contains(&promised),
        "the text does not say: {promised}"
    );
}
