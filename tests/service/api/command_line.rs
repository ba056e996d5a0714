//! The command line: the binary against a real server.

use crate::api::sessions::{csv, rows, seen_by_a_tracker};
use crate::app::{paper, text};
use crate::people::{Person, guarded};
use crate::process::run_against;
use crate::simulation::Normal;
use kincal::store::{Store, StoreLocation};
use serde_json::{Value, json};
use std::io::Read;
use std::process::{Command, Stdio};
use std::time::Duration;

fn data(name: &str) -> String {
    format!("{}/data/paper/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[tokio::test(flavor = "multi_thread")]
async fn from_the_upload_to_the_release_and_back_in_a_terminal() {
    let (app, dir) = guarded(1).await;
    let person = Person::new(&app, &["read", "upload", "identify", "release"]).await;
    let mut robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    (robot["name"], robot["serial_number"]) = (json!("Cell 4"), json!("ER20-0117"));
    let robot = person.post("/v1/robots", &robot).await.ok(201);
    let key = person.key.as_str();

    let needs = |table: &str| -> Vec<String> {
        let lines = table.lines().skip(1);
        let need = |line: &str| {
            line.split("  ")
                .map(str::trim)
                .filter(|cell| !cell.is_empty())
                .nth(2)
                .unwrap()
                .to_owned()
        };
        lines.map(need).collect()
    };
    let (_, table, _) = run_against(&app, key, &["robots", "--needs"]).await;
    assert_eq!(needs(&table), ["calibrate"], "{table}");

    let (code, stdout, _) = run_against(&app, key, &["params", "--robot", "ER20-0117"]).await;
    assert_eq!(code, Some(0));
    assert!(
        stdout.contains("next: kincal submit"),
        "an empty list says what to do: {stdout}"
    );
    let (code, stdout, stderr) = run_against(
        &app,
        key,
        &[
            "submit",
            "--robot",
            "Cell 4",
            &data("first_noisy.csv"),
            "--wait",
        ],
    )
    .await;
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        stdout.contains("verify (50), after") && stdout.contains("next: kincal release par_"),
        "{stdout}"
    );
    let (_, offline, _) = run_against(
        &app,
        key,
        &["calibrate", &data("robot.json"), &data("first_noisy.csv")],
    )
    .await;
    let offline = without_times(&offline);
    assert!(offline.contains("on the same points"), "{offline}");
    assert!(
        without_times(&stdout).contains(&offline),
        "the table of calibrate\n{offline}\nis that of submit\n{stdout}"
    );
    let sets = person
        .get(&format!("/v1/robots/{}/parameter-sets", text(&robot["id"])))
        .await
        .ok(200);
    let (set, job) = (
        text(&sets["items"][0]["id"]),
        text(&sets["items"][0]["job_id"]),
    );

    let (_, listed, _) = run_against(&app, key, &["sets", "--robot", "Cell 4"]).await;
    assert!(
        listed.contains("  first_noisy  base   100 "),
        "a set is called as its file: {listed}"
    );
    let (code, table, _) = run_against(&app, key, &["report", job]).await;
    assert_eq!(code, Some(0));
    assert!(
        stdout.contains(table.trim()),
        "the same table as at the end of submit:\n{table}"
    );
    let (_, report, _) = run_against(&app, key, &["report", job, "--json"]).await;
    assert_eq!(
        serde_json::from_str::<Value>(&report).unwrap()["job_id"],
        job
    );
    let page = dir.path().join("report.html");
    let (code, _, stderr) = run_against(
        &app,
        key,
        &["report", job, "--html", page.to_str().unwrap()],
    )
    .await;
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        std::fs::read_to_string(page)
            .unwrap()
            .contains("<h1>Calibration of Cell 4</h1>")
    );

    let (code, released, stderr) =
        run_against(&app, key, &["release", set, "--reason", "seen", "--json"]).await;
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(
        serde_json::from_str::<Value>(&released).unwrap()["status"],
        "released"
    );
    let (code, stdout, _) =
        run_against(&app, key, &["release", set, "--reason", "seen twice"]).await;
    assert_eq!(
        (code, stdout.trim()),
        (
            Some(0),
            format!("{set} was released already; nothing changed").as_str()
        )
    );
    let (code, verified, stderr) = run_against(
        &app,
        key,
        &[
            "submit",
            "--robot",
            "Cell 4",
            &data("followup_drifted.csv"),
            "--verify",
            "--wait",
        ],
    )
    .await;
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        verified.contains(&format!("verification of the parameter set {set}"))
            && verified.contains("\nthese parameters (100)"),
        "{verified}"
    );
    assert!(
        !verified.contains("rank 0 of 0")
            && !verified.contains("parameter  ")
            && !verified.contains("on the same points"),
        "{verified}"
    );
    let (code, stdout, _) =
        run_against(&app, key, &["withdraw", set, "--reason", "seen again"]).await;
    assert_eq!(code, Some(0));
    assert!(stdout.contains("is withdrawn"), "{stdout}");
    let (code, _, stderr) =
        run_against(&app, key, &["release", set, "--reason", "after all"]).await;
    assert_eq!(code, Some(1), "a gate is a failure, not a wrong usage");
    assert!(
        stderr.contains("release_refused") && stderr.contains("the set was withdrawn"),
        "{stderr}"
    );
    let (code, stdout, _) = run_against(&app, key, &["cancel", job]).await;
    assert_eq!(
        (code, stdout.trim()),
        (Some(0), format!("{job} is succeeded").as_str()),
        "what is over stays as it is"
    );
}

/// A table without its times: the duration in its second line, and the column "time, ms" of the methods.
fn without_times(table: &str) -> String {
    let mut in_methods = false;
    let lines = table.trim_end().lines().map(|line| {
        in_methods = line.starts_with("on the same points") || in_methods && !line.is_empty();
        match line
            .split_once(" mm², ")
            .filter(|_| line.contains(" iterations, F = "))
        {
            Some((cost, rest)) => format!("{cost} mm², {}", rest.split_once(" ms, ").unwrap().1),
            None if in_methods => line
                .chars()
                .enumerate()
                .filter(|(at, _)| !(50..62).contains(at))
                .map(|(_, c)| c)
                .collect(),
            None => line.into(),
        }
    });
    lines.collect::<Vec<_>>().join("\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn what_goes_wrong_says_what_to_do_next() {
    let (app, _dir) = guarded(0).await;
    let person = Person::new(&app, &["read", "upload"]).await;
    for _ in 0..2 {
        person
            .post(
                "/v1/robots",
                &serde_json::from_slice(&paper("robot.json")).unwrap(),
            )
            .await
            .ok(201);
    }
    let key = person.key.as_str();
    for (arguments, code, expected) in [
        (
            vec!["jobs", "--robot", "Cell 9"],
            2,
            "`kincal robots` lists those that are there",
        ),
        (
            vec!["jobs", "--robot", "ER20-C10"],
            2,
            "several robots are called \"ER20-C10\": name one by its id, in place of \"ER20-C10\": rob_",
        ),
        (
            vec!["predict", "Cell 9", "0,0,0,0,0,0"],
            2,
            "no robot is called \"Cell 9\"",
        ),
        (vec!["robots", "ER20-C10"], 2, "several robots are called"),
        (vec!["robots", "rob_0"], 1, "next: kincal robots lists"),
        (vec!["report", "job_0"], 1, "(not_found)"),
        (
            vec!["release", "par_0", "--reason", "x"],
            1,
            "(insufficient_scope)",
        ),
        (
            vec![
                "submit",
                "--robot",
                "rob_0",
                "no-set.csv",
                "--verify",
                "--method",
                "pso",
            ],
            2,
            "--method",
        ),
        (
            vec![
                "submit",
                "--robot",
                "rob_0",
                "no-set.csv",
                "--parameters",
                "par_0",
            ],
            2,
            "give --verify or --check with it",
        ),
        (vec!["params", "--gates"], 2, "<ID>"),
        (
            vec!["export", "par_0", "--json", "--format", "urdf"],
            2,
            "another --format",
        ),
        (
            vec!["report", "job_0", "--json", "--html", "x.html"],
            2,
            "--html and --json",
        ),
        (vec!["compare", "par_1", "par_2#x"], 2, "is not an id"),
        (vec!["gates", "par_1/../x?y"], 2, "is not an id"),
        (vec!["key", "revoke"], 2, "--name NAME"),
        (
            vec!["key", "create", "--name", "", "--scope", "read"],
            2,
            "whose key",
        ),
        (
            vec!["key", "list", "--data-dir", "/nowhere/at/all"],
            1,
            "there is no database in /nowhere/at/all",
        ),
    ] {
        let (found, _, stderr) = run_against(&app, key, &arguments).await;
        assert_eq!(found, Some(code), "{arguments:?}: {stderr}");
        assert!(stderr.contains(expected), "{arguments:?}: {stderr}");
    }
    let (code, _, stderr) = run_against(&app, "kincal_wrong", &["robots"]).await;
    assert_eq!(code, Some(1));
    assert!(
        stderr.contains("next: give the key with --key or in KINCAL_KEY"),
        "{stderr}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_terminal_sees_how_far_a_job_is_and_a_file_does_not() {
    let (app, _dir) = guarded(1).await;
    let person = Person::new(&app, &["read", "upload", "identify"]).await;
    let robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = person.post("/v1/robots", &robot).await.ok(201);
    let robot = format!("/v1/robots/{}", text(&robot["id"]));
    let csv = String::from_utf8(paper("first.csv")).unwrap();
    let set = person.upload(&robot, &csv).await;
    // The only worker computes this job until the terminal has been seen to wait.
    let other_job = person
        .post(
            &format!("{robot}/jobs"),
            &json!({"measurement_set_id": set["id"], "method": "pso", "preset": "paper",
                "options": {"n_particles": 3000, "n_iterations": 10_000, "stop_at_cost_mm2": 0.0}}),
        )
        .await
        .ok(202);
    let arguments = [
        "submit",
        "--robot",
        "ER20-C10",
        &data("first_noisy.csv"),
        "--method",
        "pso",
        "--preset",
        "paper",
        "--wait",
    ];
    let line = format!("{} {}", env!("CARGO_BIN_EXE_kincal"), arguments.join(" "));
    // script(1) runs it on its own terminal.
    let mut terminal = Command::new("script")
        .args(["-qefc", &line, "/dev/null"])
        .env("KINCAL_SERVER", app.server.url())
        .env("KINCAL_KEY", &person.key)
        .stdout(Stdio::piped())
        .spawn()
        .expect("script is there");
    let mut stdout = terminal.stdout.take().unwrap();
    let waiting = tokio::task::spawn_blocking(move || {
        let (mut seen, mut part) = (Vec::new(), [0; 4096]);
        while !String::from_utf8_lossy(&seen).contains("░ waiting for a worker") {
            match stdout.read(&mut part).unwrap() {
                0 => break,
                n => seen.extend_from_slice(&part[..n]),
            }
        }
        (stdout, seen)
    });
    let waited = tokio::time::timeout(Duration::from_secs(60), waiting).await;
    if waited.is_err() {
        terminal.kill().unwrap();
    }
    let (mut stdout, mut seen) = waited
        .expect("the terminal says within 60 s that the job waits")
        .unwrap();
    let cancel = format!("/v1/jobs/{}/cancel", text(&other_job["id"]));
    person.post(&cancel, &json!({})).await.ok(200);
    let (seen, status) = tokio::task::spawn_blocking(move || {
        stdout.read_to_end(&mut seen).unwrap();
        (seen, terminal.wait().unwrap())
    })
    .await
    .unwrap();
    let seen = String::from_utf8_lossy(&seen);
    assert!(status.success(), "{seen}");
    assert!(
        seen.contains("iterations, F = ")
            && seen.contains("not releasable yet (kincal params --gates par_")
            && seen.contains("orientation_known: ")
            && !seen.contains("next: kincal release"),
        "{seen}"
    );
    let (code, stdout, stderr) = run_against(&app, &person.key, &arguments).await;
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        !stdout.contains(['█', '░'])
            && !stderr.contains(['█', '░'])
            && stdout.contains("verify (50), after"),
        "{stdout}{stderr}"
    );
}

#[test]
fn every_shell_completes_every_command() {
    let run = |arguments: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_kincal"))
            .args(arguments)
            .output()
            .unwrap()
    };
    for shell in ["bash", "zsh", "fish", "powershell"] {
        let output = run(&["completions", shell]);
        assert!(output.status.success());
        let script = String::from_utf8(output.stdout).unwrap();
        for word in [
            "submit",
            "calibrate",
            "report",
            "release",
            "withdraw",
            "completions",
            "robot",
            "frame",
        ] {
            assert!(script.contains(word), "{shell} does not know {word}");
        }
    }
    let script = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(script.path(), run(&["completions", "bash"]).stdout).unwrap();
    let ask = "source \"$1\"; COMP_WORDS=(kincal relea); COMP_CWORD=1; COMP_LINE='kincal relea'; _kincal kincal relea kincal; echo \"${COMPREPLY[@]}\"";
    let output = Command::new("bash")
        .args(["-c", ask, "bash"])
        .arg(script.path())
        .output()
        .unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "release");
    assert_eq!(run(&["completions", "tcsh"]).status.code(), Some(2));
}

#[test]
fn a_long_option_without_an_environment_variable_is_one_of_those_that_are_said_to_have_none() {
    let run_cli = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
            .args(arguments)
            .arg("--help")
            .output()
            .unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let help = run_cli(&[]);
    let commands = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| line.starts_with("  "));
    let commands = commands
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| !["help", "key"].contains(command));
    for command in commands {
        let help = run_cli(&[command]);
        let mut options: Vec<String> = Vec::new();
        for line in help.lines().skip_while(|line| *line != "Options:") {
            let indent = line.len() - line.trim_start().len();
            match options.last_mut() {
                _ if line.trim_start().starts_with('-') && indent <= 6 => options.push(line.into()),
                Some(option) => option.push_str(line),
                None => {}
            }
        }
        assert!(options.len() > 1, "{command}: {help}");
        for option in options {
            let has_none = ["--help", "--version", "--reason", "--change-reason"]
                .iter()
                .any(|name| option.contains(name));
            assert!(
                has_none || option.contains("[env: KINCAL_"),
                "{command}: {option}"
            );
        }
    }
}

#[test]
fn a_flag_that_the_environment_switches_off_is_not_given() {
    let error = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
            .args(arguments)
            .env("KINCAL_JSON", "0")
            .env("KINCAL_SERVER", "http://127.0.0.1:1")
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    for arguments in [
        vec!["report", "job_0", "--html", "/nowhere/x.html"],
        vec!["export", "par_0", "--patch", &data("robot.json")],
    ] {
        let (code, stderr) = error(&arguments);
        assert_eq!(code, Some(1), "{arguments:?}: {stderr}");
        assert!(stderr.contains("127.0.0.1:1"), "{stderr}");
    }
}

#[tokio::test]
async fn a_key_for_a_robot_that_cannot_be_read_is_no_wrong_usage() {
    let dir = tempfile::tempdir().unwrap();
    let location = StoreLocation::Sqlite {
        data_dir: dir.path().to_owned(),
    };
    let store = Store::open_for_command(location).await.unwrap();
    sqlx::query("drop view robot_now")
        .execute(store.readers())
        .await
        .unwrap();
    drop(store);
    let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args(["key", "create", "--name", "n", "--scope", "read"])
        .args(["--robot", "rob_0", "--data-dir"])
        .arg(dir.path())
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(!stderr.contains("there is no robot"), "{stderr}");
}

#[test]
fn keys_and_the_database_answer_as_json_too() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
            .args(arguments)
            .arg("--data-dir")
            .arg(&data)
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let made = run(&[
        "key", "create", "--name", "cell-4", "--scope", "read", "--json",
    ]);
    assert!(text(&made["key"]).starts_with("kincal_"));
    let listed = run(&["key", "list", "--json"]);
    assert_eq!(
        (&listed["items"][0]["id"], &listed["items"][0]["scopes"]),
        (&made["id"], &json!(["read"]))
    );
    assert_eq!(
        listed["items"][0].get("key"),
        None,
        "a key is shown only once"
    );
    let copy = dir.path().join("copy");
    let made_of_it = run(&["backup", copy.to_str().unwrap(), "--json"]);
    assert_eq!(
        (&made_of_it["directory"], &made_of_it["audit_head"]["seq"]),
        (&json!(copy), &json!(1))
    );
    assert!(
        run(&["migrate", "--json"])["schema_version"]
            .as_i64()
            .unwrap()
            > 0
    );
    let revoked = run(&["key", "revoke", "--name", "cell-4", "--json"]);
    assert_eq!(revoked["revoked"][0]["id"], made["id"]);
    let copied = printed(&[
        "copy-store",
        "--from",
        copy.to_str().unwrap(),
        "--to",
        dir.path().join("other").to_str().unwrap(),
        "--json",
    ]);
    assert_eq!(
        copied["audit_head"], made_of_it["audit_head"],
        "as the backup, in which the key was not revoked yet"
    );
    assert!(
        copied["tables"]
            .as_array()
            .unwrap()
            .contains(&json!({"table": "api_key", "n_rows": 1})),
        "{copied}"
    );
}

/// The standard output of a command, which must be JSON only.
fn printed(arguments: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args(arguments)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice::<Value>(&output.stdout).unwrap()
}

#[test]
fn an_output_that_is_closed_early_is_no_failure() {
    let line = format!(
        "set -o pipefail; {} openapi | head -1",
        env!("CARGO_BIN_EXE_kincal")
    );
    let output = Command::new("bash").args(["-c", &line]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && stderr.is_empty(),
        "{:?}: {stderr}",
        output.status
    );
    // A full disk is a failure.
    let full = std::fs::OpenOptions::new()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .arg("openapi")
        .stdout(full)
        .output()
        .unwrap();
    assert_eq!(
        output.status.code(),
        Some(1),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(String::from_utf8_lossy(&output.stderr).contains("cannot write"));
    // A command that prints long after `head` has ended.
    let (robot, set) = (data("robot.json"), data("first_noisy.csv"));
    let line = format!(
        "set -o pipefail; {} calibrate {robot} {set} --json | head -1",
        env!("CARGO_BIN_EXE_kincal")
    );
    let output = Command::new("bash").args(["-c", &line]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && !stderr.contains("panicked"),
        "{:?}: {stderr}",
        output.status
    );
}

#[test]
fn the_demo_and_the_contract_answer_as_json_too() {
    let openapi = printed(&["openapi", "--json"]);
    assert!(openapi["paths"]["/v1/robots"].is_object());
    let demo = printed(&["demo", "--json"]);
    assert_eq!(
        (
            &demo["paper_simulation"][0]["n_iterations"],
            &demo["paper_experiment"][1]["errors"]["mean_mm"]
        ),
        (&json!(404), &json!(0.46))
    );
    let ran = demo["ran"].as_array().unwrap();
    let labels: Vec<&str> = ran.iter().map(|row| text(&row["label"])).collect();
    assert_eq!(
        labels,
        [
            "PSO, paper's preset",
            "BPNN-PSO, paper's preset",
            "PSO, ours",
            "BPNN-PSO, ours",
            "method auto"
        ]
    );
    for row in ran {
        let [before, after] =
            ["before", "after"].map(|half| row["verify"][half]["rms_mm"].as_f64().unwrap());
        assert!(after < 0.5 * before, "{row}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn remedies_in_a_terminal_are_commands_and_options() {
    let (app, dir) = guarded(1).await;
    let person = Person::new(&app, &["read", "upload", "identify", "release"]).await;
    let body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = person.post("/v1/robots", &body).await.ok(201);
    let robot = text(&robot["id"]);
    let mut random = Normal::new(27);
    let misplaced = dir.path().join("misplaced.csv");
    let seen = seen_by_a_tracker(&rows("first_noisy.csv"), &mut random);
    std::fs::write(&misplaced, csv(&seen)).unwrap();
    let (good, collided) = (data("first_noisy.csv"), data("followup_collision.csv"));
    let (misplaced, file) = (misplaced.to_str().unwrap(), data("robot.json"));
    let mut all = String::new();
    let mut run_cli = async |arguments: &[&str]| {
        let (_, stdout, stderr) = run_against(&app, &person.key, arguments).await;
        all += &stdout;
        all += &stderr;
        stdout + &stderr
    };
    let submit = ["submit", "--robot", robot, "--wait"];
    let refused = run_cli(&[&submit[..], &[misplaced]].concat()).await;
    assert!(refused.contains("--frame instrument"), "{refused}");
    assert!(refused.contains("--insist frame_suspect"), "{refused}");
    run_cli(&["calibrate", &file, misplaced]).await;
    run_cli(&["calibrate", &file, misplaced, "--insist", "frame_suspect"]).await;
    run_cli(&[&submit[..], &[misplaced, "--insist", "frame_suspect"]].concat()).await;
    run_cli(&[&submit[..], &[&good]].concat()).await;
    let sets = format!("/v1/robots/{robot}/parameter-sets");
    let set = person.get(&sets).await.ok(200)["items"][0]["id"].clone();
    let verify = ["--verify", "--parameters", text(&set), &collided];
    let misfit = run_cli(&[&submit[..], &verify].concat()).await;
    assert!(misfit.contains("frame instrument"), "{misfit}");
    let gates = run_cli(&["params", "--gates", text(&set)]).await;
    assert!(gates.contains("kincal checked"), "{gates}");
    let refused = run_cli(&["release", text(&set), "--reason", "it fits"]).await;
    assert!(refused.contains("kincal checked"), "{refused}");
    let blank = run_cli(&["checked", robot, "--reason", " "]).await;
    assert!(blank.contains("nothing to read"), "{blank}");
    for form in ["POST ", "?frame=", "?insist=", " frame=instrument", "/v1/"] {
        assert!(!all.contains(form), "{form:?} in {all}");
    }
    // the robot that a session did not fit comes before one that was never calibrated, which is newer
    let mut other: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    other["name"] = json!("Another cell");
    person.post("/v1/robots", &other).await.ok(201);
    let (_, listed, _) = run_against(&app, &person.key, &["robots", "--needs", "--json"]).await;
    let listed: Value = serde_json::from_str(&listed).unwrap();
    let needs = [0, 1].map(|i| listed["items"][i]["need"].clone());
    assert_eq!(needs, ["check_robot", "calibrate"], "{listed}");
    // no script takes what was insisted on for a calibration, however well it fits in the end
    let insisted = [misplaced, "--insist", "frame_suspect"];
    for command in [&["calibrate", &file][..], &submit] {
        let (code, ..) = run_against(&app, &person.key, &[command, &insisted].concat()).await;
        assert_eq!(code, Some(1), "{command:?}");
    }
}
