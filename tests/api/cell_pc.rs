//! The cell PC in Python, as examples/ has it, against a real server with keys.

use crate::app::{TestApp, paper, text};
use crate::people::{Person, guarded};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Output};

/// Runs the example with a key.
async fn python(app: &TestApp, key: &str, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut command = Command::new("python3");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/cell_pc.py")).args(arguments);
    command.env("KINCAL_URL", app.server.url()).env("KINCAL_KEY", key);
    // the server runs in this process: the example must not hold its threads up
    let output: Output = tokio::task::spawn_blocking(move || command.output().expect("python3 is there")).await.unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_python_example_calibrates_and_fetches_what_was_released() {
    let (app, dir) = guarded(1).await;
    let cell = Person::new(&app, &["read", "upload", "identify"]).await;
    let boss = Person::new(&app, &["read", "release"]).await;
    let robot: Value = cell.post("/v1/robots", &serde_json::from_slice(&paper("robot.json")).unwrap()).await.ok(201);
    let (robot, file) = (text(&robot["id"]), dir.path().join("parameters.json"));
    let (set, file) = (format!("{}/data/paper/first_noisy.csv", env!("CARGO_MANIFEST_DIR")), file.to_str().unwrap());

    let (code, told, _) = python(&app, &cell.key, &["fetch", robot, file]).await;
    assert_eq!((code, told.as_str()), (Some(2), ""), "nothing is released yet");
    let (code, told, complaints) = python(&app, &cell.key, &["calibrate", robot, &set]).await;
    assert_eq!(code, Some(0), "{complaints}");
    assert!(told.contains("verify: 50 points, rms 1.0"), "{told}");
    let sets = cell.get(&format!("/v1/robots/{robot}/parameter-sets")).await.ok(200);
    let candidate = &sets["items"][0];
    assert!(told.contains(text(&candidate["id"])), "{told}");

    boss.post(&format!("/v1/parameter-sets/{}/release", text(&candidate["id"])), &json!({"reason": "seen"})).await.ok(200);
    let (code, told, complaints) = python(&app, &cell.key, &["fetch", robot, file]).await;
    assert_eq!(code, Some(0), "{complaints}");
    assert!(told.starts_with("fetched") && told.contains(text(&candidate["sha256"])), "{told}");
    let fetched: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let canonical = |value: &Value| kincal::wire::canonical::to_canonical_json(value).unwrap();
    assert_eq!(canonical(&fetched["links"]), canonical(&candidate["links"]));
    let (code, told, _) = python(&app, &cell.key, &["fetch", robot, file]).await;
    assert_eq!((code, told.as_str()), (Some(0), "unchanged\n"));

    let faulty = dir.path().join("faulty.csv");
    std::fs::write(&faulty, "q1_deg,x_mm\n1,2\n").unwrap();
    let (code, _, complaints) = python(&app, &cell.key, &["calibrate", robot, faulty.to_str().unwrap()]).await;
    assert_eq!(code, Some(2));
    assert!(complaints.contains("q2_deg") && !complaints.contains("Traceback"), "{complaints}");
    let (code, _, complaints) = python(&app, "kincal_wrong", &["fetch", robot, file]).await;
    assert_eq!(code, Some(2));
    assert!(complaints.contains("unauthorized"), "{complaints}");
}
