//! The commands that read and write files of other programs.

use crate::api::compensate::parameter_set;
use crate::app::TestApp;
use std::path::Path;
use std::process::{Command, Output};

fn kincal(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args(arguments)
        .output()
        .unwrap()
}

fn paper_path(name: &str) -> String {
    format!("{}/data/paper/{name}", env!("CARGO_MANIFEST_DIR"))
}

fn path(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().into()
}

#[test]
fn a_program_is_corrected_by_a_file_and_by_a_server_alike() {
    // The command runs its own runtime, which must not run inside this test's.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (app, set, document) = runtime.block_on(async {
        let app = TestApp::with_workers(1).await;
        let set = parameter_set(&app).await;
        let document = app.get(&format!("{set}/export")).await.text();
        (app, set, document)
    });
    let parameters = path(folder.path(), "parameters.json", &document);
    let text = "speed,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,comment\nv100,10,-30,20,15,40,5,\"first, slow\"\nv200,-60,-50,35,-20,-50,100,ünïcode\n";
    let program = path(folder.path(), "program.csv", text);
    let by_file = kincal(&["compensate", &parameters, &program]);
    assert!(
        by_file.status.success(),
        "{}",
        String::from_utf8_lossy(&by_file.stderr)
    );
    assert!(String::from_utf8_lossy(&by_file.stderr).contains("taught_targets"));
    let id = set.rsplit('/').next().unwrap();
    let by_server = kincal(&[
        "compensate",
        "--server",
        &app.server.url(),
        "--parameters",
        id,
        &program,
    ]);
    assert_eq!(
        String::from_utf8_lossy(&by_server.stdout),
        String::from_utf8_lossy(&by_file.stdout),
        "{}",
        String::from_utf8_lossy(&by_server.stderr)
    );
    let json = kincal(&["compensate", "--json", &parameters, &program]);
    let answer: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    for field in [
        "q_deg",
        "status",
        "extrapolated",
        "position_error_before_mm",
        "position_error_after_mm",
        "orientation_error_after_deg",
    ] {
        assert_eq!(
            answer[field].as_array().map(Vec::len),
            Some(2),
            "{field}: {answer}"
        );
    }
    let remark = String::from_utf8(json.stderr).unwrap();
    assert!(
        answer["left_out"].is_object() && !remark.replace("\n", "").contains("  "),
        "{remark}"
    );
    let out = String::from_utf8(by_file.stdout).unwrap();
    let cells = |text: &str| -> Vec<Vec<String>> {
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_reader(text.as_bytes());
        reader
            .records()
            .map(|record| record.unwrap().iter().map(str::to_owned).collect())
            .collect()
    };
    let (before, after) = (cells(text), cells(&out));
    assert_eq!(before[0], after[0]);
    for (before, after) in before.iter().zip(&after).skip(1) {
        assert_eq!((&before[0], &before[7]), (&after[0], &after[7]));
        for column in 1..7 {
            let change =
                after[column].parse::<f64>().unwrap() - before[column].parse::<f64>().unwrap();
            assert!(
                change.abs() < 3.0 && (column == 6 || change != 0.0),
                "{column}: {change}"
            );
        }
    }
    // The same targets in UTF-16 beside what was measured.
    let angle: f64 = after[1][1].parse().unwrap();
    let names = |what: &str| -> String { (1..=6).map(|j| format!(";{what} J{j} [deg]")).collect() };
    let both = format!(
        "name{}{};X;Y;Z\r\nA;9;9;9;9;9;9;10,0;-30,0;20,0;15,0;40,0;5,0;1;2;3\r\n",
        names("Actual"),
        names("Target")
    );
    let file = folder.path().join("both.csv");
    let utf16: Vec<u8> = std::iter::once(0xFEFF)
        .chain(both.encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    std::fs::write(&file, utf16).unwrap();
    let corrected = kincal(&["compensate", &parameters, file.to_str().unwrap()]);
    let said = String::from_utf8(corrected.stderr).unwrap();
    assert!(
        said.contains("corrected columns: Target J1 [deg], "),
        "{said}"
    );
    assert!(
        said.contains("poses_left") && said.contains("X, Y, Z"),
        "{said}"
    );
    let units = corrected.stdout.chunks_exact(2);
    let units: Vec<u16> = units
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect();
    let text = String::from_utf16(&units).unwrap();
    let angle = format!("{angle:.7}").replace('.', ",");
    assert!(text.starts_with("\u{feff}name;Actual J1"), "{text}");
    assert!(
        text.contains(&format!("\r\nA;9;9;9;9;9;9;{angle};")),
        "{text}"
    );
    assert!(text.ends_with(";1;2;3\r\n"), "{text}");
    // An explicit tool, anywhere on the command line and with any signs.
    let with_tool = |tool: &[&str]| {
        let output = kincal(&[&["compensate", "--json"], tool, &[&parameters, &program]].concat());
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()["q_deg"].clone()
    };
    let other = with_tool(&["--tool-mm", "-30,45.5,160"]);
    assert_eq!(other, with_tool(&["--tool-mm=-30,45.5,160"]));
    assert_ne!(other, answer["q_deg"]);
    let output = kincal(&["compensate", "--tool-mm", "1,2", &parameters, &program]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("three numbers in mm"),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let wrong = path(folder.path(), "wrong.csv", "q1_deg,q2_deg\n1,x\n");
    let output = kincal(&["compensate", &parameters, &wrong]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("row 0 (line 2), column q2_deg"),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    runtime.block_on(app.server.shutdown());
}

#[test]
fn an_imported_robot_can_be_planned_for() {
    let folder = tempfile::tempdir().unwrap();
    let table = "a_mm,alpha_deg,d_mm,theta_offset_deg,min_deg,max_deg\n0,0,504,0,-170,170\n166.605,-90,0,0,-80,80\n782.27,0,0,0,-90,90\n138.826,-90,761.35,0,-180,180\n0,90,0,0,-115,115\n0,-90,125,0,-300,300\n";
    let table = path(folder.path(), "table.csv", table);
    let imported = kincal(&["import", &table, "--convention", "mdh", "--name", "mine"]);
    assert!(
        imported.status.success(),
        "{}",
        String::from_utf8_lossy(&imported.stderr)
    );
    let robot = path(
        folder.path(),
        "robot.json",
        &String::from_utf8(imported.stdout).unwrap(),
    );
    let plan = kincal(&[
        "plan",
        &robot,
        "-n",
        "20",
        "--measured",
        &paper_path("first.csv"),
        "--frame",
        "base",
    ]);
    assert!(
        plan.status.success(),
        "{}",
        String::from_utf8_lossy(&plan.stderr)
    );
    let text = String::from_utf8(plan.stdout).unwrap();
    assert_eq!(
        text.lines().next(),
        Some("configuration,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg")
    );
    assert_eq!(text.lines().count(), 21);
    assert!(
        text.lines().last().unwrap().starts_with("3,"),
        "the last repeats the third: {text}"
    );
    let output = kincal(&["import", &robot]);
    assert_eq!(output.status.code(), Some(2), "a robot file is no table");
}

#[test]
fn options_win_over_a_plans_request_and_what_is_assumed_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let request = path(
        folder.path(),
        "request.json",
        r#"{"seed": 1, "n_candidates": 500}"#,
    );
    let lines = |arguments: &[&str]| {
        let output = kincal(
            &[
                &["plan", &paper_path("robot.json"), "--request", &request],
                arguments,
            ]
            .concat(),
        );
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let warned = String::from_utf8(output.stderr).unwrap();
        assert!(
            warned
                .contains("no limits for joint 1, 2, 3, 4, 5, 6: the plan takes -90° to 90° there"),
            "{warned}"
        );
        String::from_utf8(output.stdout).unwrap()
    };
    let of_the_file = lines(&["-n", "12"]);
    assert_eq!(of_the_file.lines().count(), 13);
    assert_eq!(of_the_file, lines(&["-n", "12", "--seed", "1"]));
    assert_ne!(of_the_file, lines(&["-n", "12", "--seed", "2"]));
    let output = kincal(&[
        "plan",
        &paper_path("robot.json"),
        "--measured",
        &paper_path("first.csv"),
    ]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(
        stderr.contains("--frame base or --frame instrument"),
        "{stderr}"
    );
}

#[test]
fn semicolons_are_read_in_measurements_and_named_where_they_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(paper_path("first.csv"))
        .unwrap()
        .replace(',', ";")
        .replace('.', ",");
    let set = path(folder.path(), "semi.csv", &text);
    let robot = paper_path("robot.json");
    let report = |arguments: &[&str]| {
        let output = kincal(&[&["calibrate", "--json", &robot], arguments].concat());
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()["result_sha256"]
            .clone()
    };
    let plain = report(&[&paper_path("first.csv")]);
    assert_eq!(report(&[&set, "--decimal-comma"]), plain);
    assert_eq!(report(&[&set]), plain, "one reading only");
    let table = path(
        folder.path(),
        "table.csv",
        "a_mm;alpha_deg;d_mm;theta_deg\n0;0;504,5;0\n",
    );
    let read = kincal(&["import", table.as_str(), "--convention", "dh"]);
    let robot = String::from_utf8_lossy(&read.stdout).into_owned();
    assert!(robot.contains("504.5"), "{robot}");
    let output = kincal(&["import", table.as_str()]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(
        stderr.contains("one of two conventions: give --convention dh"),
        "{stderr}"
    );
}

#[test]
fn a_robot_file_may_begin_with_a_mark_and_has_to_be_an_object() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(paper_path("robot.json")).unwrap();
    let marked = path(folder.path(), "marked.json", &format!("\u{feff}{text}"));
    let output = kincal(&["calibrate", &marked, &paper_path("first.csv")]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let seven = path(folder.path(), "seven.json", "7");
    let output = kincal(&["calibrate", &seven, &paper_path("first.csv")]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(
        stderr.contains("it is not JSON of a robot (an object is expected"),
        "{stderr}"
    );
}

#[test]
fn a_server_is_named_by_a_url_and_its_silence_by_its_cause() {
    for server in ["127.0.0.1:19100", "ftp://x"] {
        let output = kincal(&["robots", "--server", server]);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(
            stderr.contains("begins with http:// or https://"),
            "{stderr}"
        );
    }
    let output = kincal(&["robots", "--server", "http://127.0.0.1:1"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("refused"), "{stderr}");
}
