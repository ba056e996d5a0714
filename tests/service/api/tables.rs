//! Tables of other forms and two files through the server: kept as they came, read the same way by the worker, mappings kept per robot.

use crate::app::{Answer, TestApp, paper, text};
use kincal::wire::canonical;
use reqwest::Method;
use serde_json::{Value, json};
use std::io::Write;
use std::process::{Command, Output, Stdio};

fn paper_path(name: &str) -> String {
    format!("{}/data/paper/{name}", env!("CARGO_MANIFEST_DIR"))
}

/// Runs a command with a text on its standard input.
fn kincal(arguments: &[&str], input: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(input.as_bytes()).unwrap();
    drop(stdin);
    child.wait_with_output().unwrap()
}

/// The paper's first set, a row as cells.
fn rows() -> Vec<Vec<String>> {
    let text = String::from_utf8(paper("first.csv")).unwrap();
    text.lines()
        .skip(1)
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

/// As a controller without units writes it, with commas.
fn without_units() -> String {
    let mut text = "A1;A2;A3;A4;A5;A6;X;Y;Z;Rest\n".to_owned();
    for row in rows() {
        text += &(row[2..].join(";").replace('.', ",") + ";ok\n");
    }
    text
}

/// The same points as the documentation says.
fn plain() -> String {
    let mut text = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n".to_owned();
    for row in rows() {
        text += &(row[2..].join(",") + "\n");
    }
    text
}

async fn plain_outcome(app: &TestApp, robot: &str) -> (Value, Value) {
    let path = format!("{robot}/measurement-sets?frame=base");
    let set = app.post(&path, "text/csv", plain()).await.ok(201);
    outcome(app, robot, text(&set["id"])).await
}

fn columns() -> Value {
    json!({"q1_deg": "A1", "q2_deg": "A2", "q3_deg": "A3", "q4_deg": "A4", "q5_deg": "A5", "q6_deg": "A6",
        "x_mm": "X", "y_mm": "Y", "z_mm": "Z"})
}

fn query(parameters: &[(&str, &str)]) -> String {
    let url = reqwest::Url::parse_with_params("http://x/", parameters).unwrap();
    url.query().unwrap().to_owned()
}

async fn put(app: &TestApp, path: &str, body: &Value) -> Answer {
    let request = app
        .request(Method::PUT, path)
        .header("content-type", "application/json")
        .body(body.to_string());
    Answer::of(request).await
}

async fn outcome(app: &TestApp, robot: &str, set: &str) -> (Value, Value) {
    let request = json!({"measurement_set_id": set, "method": "least_squares"});
    let job = app.run(robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let report = app.report(&job).await;
    (report["parameters"].clone(), report["verify"].clone())
}

#[tokio::test]
async fn a_table_without_units_is_asked_about_once_and_then_read_by_name() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let upload = format!("{robot}/measurement-sets?frame=base");
    let table = without_units();
    let problem = app
        .post(&upload, "text/csv", table.clone())
        .await
        .problem(422, "invalid_measurements");
    assert_eq!(problem["errors"][0]["code"], "missing_unit");
    let preview = app
        .post(
            &format!("{robot}/measurement-sets/preview"),
            "text/csv",
            table.clone(),
        )
        .await
        .ok(200);
    let file = &preview["files"][0];
    assert_eq!(file["proposed"]["q1_deg"], 1);
    assert_eq!(file["header"][9], "Rest");
    assert_eq!(file["understood"]["separator"], ";");
    assert_eq!(
        file["understood"]["decimal"], "point",
        "no column is known to hold numbers"
    );
    assert_eq!(file["rows"].as_array().unwrap().len(), 8);
    assert_eq!(preview["errors"][0]["code"], "missing_unit");

    let path = format!("{robot}/columns/cell%204");
    let kept = put(&app, &path, &columns()).await.ok(200);
    assert_eq!(
        (&kept["name"], &kept["columns"]),
        (&json!("cell 4"), &columns())
    );
    assert_eq!(app.get(&path).await.ok(200), kept);
    let set = app
        .post(
            &format!("{upload}&columns=cell%204"),
            "text/csv",
            table.clone(),
        )
        .await
        .ok(201);
    assert_eq!(set["understood"]["decimal"], "comma");
    assert_eq!(set["understood"]["ignored"], json!(["Rest"]));
    assert_eq!(
        set["understood"]["columns"][6],
        json!({"column": "X", "number": 7, "means": "x", "unit": "mm"})
    );
    assert_eq!(
        app.get(&format!("/v1/measurement-sets/{}", text(&set["id"])))
            .await
            .ok(200),
        set
    );
    let points = app
        .get(&format!("/v1/measurement-sets/{}/points", text(&set["id"])))
        .await;
    assert_eq!(points.bytes, table.clone().into_bytes());

    // Another mapping under that name changes no set that is there; the list has the newest.
    let mut other = columns();
    other["q1_rad"] = other["q1_deg"].take();
    other.as_object_mut().unwrap().remove("q1_deg");
    put(&app, &path, &other).await.ok(200);
    let list = app.get(&format!("{robot}/columns")).await.ok(200);
    assert_eq!(list["items"].as_array().unwrap().len(), 1);
    assert_eq!(list["items"][0]["columns"], other);
    app.post(
        &format!("{upload}&columns=cell%204"),
        "text/csv",
        table.clone(),
    )
    .await
    .problem(422, "invalid_measurements");
    let stated = query(&[("columns", &columns().to_string())]);
    let same = app
        .post(&format!("{upload}&{stated}"), "text/csv", table)
        .await
        .ok(201);
    assert_eq!(same["understood"], set["understood"]);

    let found = outcome(&app, &robot, text(&set["id"])).await;
    assert_eq!(found, plain_outcome(&app, &robot).await);

    let unknown = app
        .post(&format!("{upload}&columns=other"), "text/csv", "a")
        .await;
    unknown.problem(422, "unknown_mapping");
    put(&app, &path, &json!({"q1": "A1"}))
        .await
        .problem(422, "invalid_columns");
    app.get(&format!("{robot}/columns/none"))
        .await
        .problem(404, "not_found");
    let data_dir = app.config.database.data_dir.to_str().unwrap();
    let verified = kincal(&["verify-store", "--data-dir", data_dir], "");
    assert!(
        verified.status.success(),
        "{}",
        String::from_utf8_lossy(&verified.stdout)
    );
}

const FORM: &str = "multipart/form-data; boundary=x";

/// Posts a form as a program does: forms of pages have no such key, and a server without keys takes none of those.
async fn post_form(app: &TestApp, path: &str, body: &str) -> Answer {
    let key = canonical::sha256_hex(format!("{path}{body}").as_bytes());
    let request = app.request(Method::POST, path);
    let request = request
        .header("content-type", FORM)
        .header("idempotency-key", key);
    Answer::of(request.body(body.to_owned())).await
}

#[tokio::test]
async fn two_files_are_joined_kept_as_they_came_and_read_the_same_by_the_worker() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let mut log = "point,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\n".to_owned();
    let mut export = "// tracker\npoint;X [mm];Y [mm];Z [mm]\n".to_owned();
    for (i, row) in rows().iter().enumerate() {
        log += &format!("P{i},{}\n", row[2..8].join(","));
        export += &format!("P{i};{}\n", row[8..].join(";"));
    }
    log += "P999,1,2,3,4,5,6\n";
    let body = format!(
        "--x\r\nContent-Disposition: form-data; name=\"instrument\"; filename=\"t.csv\"\r\n\r\n{export}\r\n--x\r\nContent-Disposition: form-data; \
         name=\"robot\"\r\nContent-Type: text/csv\r\n\r\n{log}\r\n--x--\r\n"
    );
    let upload = format!("{robot}/measurement-sets?frame=base&name=two");
    let set = post_form(&app, &upload, &body).await.ok(201);
    assert_eq!(set["n_points"], 100);
    let joined = &set["joined"];
    assert_eq!(
        (&joined["join"]["by"], &joined["join"]["n_joined"]),
        (&json!("name"), &json!(100))
    );
    assert_eq!(
        joined["join"]["leftover_robot"],
        json!({"n": 1, "rows": [{"line": 102, "label": "P999"}]})
    );
    assert_eq!(joined["instrument"]["header_row"], 2);
    let points = app
        .get(&format!("/v1/measurement-sets/{}/points", text(&set["id"])))
        .await;
    assert_eq!(
        (points.header("content-type"), points.bytes.as_slice()),
        (Some(FORM), body.as_bytes())
    );
    let preview = post_form(&app, &format!("{robot}/measurement-sets/preview"), &body)
        .await
        .ok(200);
    assert_eq!(
        (&preview["n_points"], &preview["errors"]),
        (&json!(100), &json!([]))
    );
    let found = outcome(&app, &robot, text(&set["id"])).await;
    assert_eq!(found, plain_outcome(&app, &robot).await);
    let cut = &body[..body.len() - 20];
    post_form(&app, &upload, cut)
        .await
        .problem(422, "malformed_multipart");
    let broken = body.replace("P3;", "P3;x");
    let problem = post_form(&app, &upload, &broken)
        .await
        .problem(422, "invalid_measurements");
    assert_eq!(problem["errors"][0]["pointer"], "/instrument", "{problem}");
    assert_eq!(problem["errors"][0]["line"], 6);
}

#[test]
fn the_command_line_takes_mappings_two_files_and_the_standard_input() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let robot = paper_path("robot.json");
    let calibrated = |arguments: &[&str], input: &str| {
        let all = [
            &["calibrate", "--json", "--method", "least_squares", &robot],
            arguments,
        ]
        .concat();
        let output = kincal(&all, input);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{stderr}");
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        (report["result_sha256"].clone(), stderr)
    };
    let (meant, told) = calibrated(&[&file("plain.csv", &plain())], "");
    assert!(!told.contains("read as"), "{told}");
    assert_eq!(calibrated(&["-"], &plain()).0, meant);
    let (mut log, mut export) = (
        "point;A1 [deg];A2 [deg];A3 [deg];A4 [deg];A5 [deg];A6 [deg]\n".to_owned(),
        "name\tx\ty\tz\n".to_owned(),
    );
    for (i, row) in rows().iter().enumerate() {
        log += &format!("P{i};{}\n", row[2..8].join(";"));
        export += &format!("P{i}\t{}\n", row[8..].join("\t"));
    }
    let (log, export) = (file("log.csv", &log), file("export.txt", &export));
    let axes = file(
        "axes.json",
        "{\"x_mm\": \"x\", \"y_mm\": \"y\", \"z_mm\": \"z\"}",
    );
    let (found, told) = calibrated(&[&log, &export, "--columns", &axes], "");
    assert_eq!(found, meant);
    assert!(told.contains("100 pairs of rows, joined by name"), "{told}");
    assert!(
        told.contains("robot file: name = \"point\", q1_deg = \"A1 [deg]\""),
        "{told}"
    );
    assert_eq!(
        calibrated(&[&log, "--instrument", &export, "--columns", &axes], "").0,
        meant
    );
    let table = file("table.csv", &without_units());
    let mapping = file("columns.json", &columns().to_string());
    assert_eq!(calibrated(&[&table, "--columns", &mapping], "").0, meant);
    let asked = kincal(&["calibrate", &robot, &table], "");
    let told = String::from_utf8_lossy(&asked.stderr).into_owned();
    assert_eq!(asked.status.code(), Some(2), "{told}");
    assert!(
        told.contains("column A1 has no unit") && told.contains("--joint-unit"),
        "{told}"
    );
}

/// The paper's set as a robot's log and an instrument's export whose names agree by their numbers; the position in one row is 4 mm off.
fn log_and_export(stray: Option<usize>) -> String {
    let mut log = "point,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\n".to_owned();
    let mut export = "// tracker\npoint;X [mm];Y [mm];Z [mm]\n".to_owned();
    for (i, row) in rows().iter().enumerate() {
        let off_mm = if stray == Some(i) { 4.0 } else { 0.0 };
        let x_mm = row[8].parse::<f64>().unwrap() + off_mm;
        log += &format!("P{i},{}\n", row[2..8].join(","));
        export += &format!("p_{i:03};{x_mm};{}\n", row[9..].join(";"));
    }
    format!(
        "--x\r\nContent-Disposition: form-data; name=\"robot\"\r\n\r\n{log}\r\n--x\r\nContent-Disposition: form-data; \
         name=\"instrument\"\r\n\r\n{export}\r\n--x--\r\n"
    )
}

#[tokio::test]
async fn the_noise_that_a_file_states_stays_in_its_table_beside_a_levelled_instrument() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let sets = format!("{robot}/measurement-sets?frame=instrument&instrument_levelled=true");
    let csv = String::from_utf8(paper("first_noisy.csv")).unwrap();
    let csv: Vec<String> = (csv.lines().enumerate())
        .map(|(i, line)| format!("{line},{}", if i == 0 { "std_mm" } else { "0.03" }))
        .collect();
    let set = app.post(&sets, "text/csv", csv.join("\n")).await.ok(201);
    let points = format!(
        "/v1/measurement-sets/{}/points?format=csv",
        text(&set["id"])
    );
    let table = app.get(&points).await.text();
    assert!(table.lines().next().unwrap().contains("std_mm"), "{table}");
}

#[tokio::test]
async fn the_points_of_two_files_are_one_table_that_says_their_names() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let sets = format!("{robot}/measurement-sets?frame=base");
    let set = post_form(&app, &sets, &log_and_export(None)).await.ok(201);
    let points = format!(
        "/v1/measurement-sets/{}/points?format=csv",
        text(&set["id"])
    );
    let table = app.get(&points).await;
    assert_eq!(
        table.header("content-type"),
        Some("text/csv; charset=utf-8")
    );
    let table = String::from_utf8(table.bytes).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(
        lines[0],
        "line,name,configuration,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm"
    );
    assert_eq!(lines.len(), 101);
    // the joint values are the digits of the robot's file, and the line is that of the instrument's
    let first = &rows()[0];
    let number = |cell: &str| cell.parse::<f64>().unwrap().to_string();
    let joints: Vec<String> = first[2..8].iter().map(|cell| number(cell)).collect();
    let start = format!("3,P0,row_0,{},", joints.join(","));
    assert!(lines[1].starts_with(&start), "{} is not {start}", lines[1]);
    // uploaded as one file, it is the same measurement
    let again = app.post(&sets, "text/csv", table).await.ok(201);
    let id = text(&again["id"]);
    let found = outcome(&app, &robot, id).await;
    assert_eq!(found, outcome(&app, &robot, text(&set["id"])).await);
    assert_eq!(found, plain_outcome(&app, &robot).await);
    app.get(&points.replace("csv", "xml"))
        .await
        .problem(400, "invalid_query");

    // reports and warnings name the point as the files do
    let stray = log_and_export(Some(17));
    let set = post_form(&app, &sets, &stray).await.ok(201);
    let request = json!({"measurement_set_id": set["id"], "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    let report = app.report(&job).await;
    assert_eq!(report["per_point"][17]["name"], "P17");
    assert_eq!(report["per_point"][17]["configuration"], "row_17");
    let warnings = report["warnings"].as_array().unwrap();
    let outliers = warnings.iter().find(|w| w["code"] == "outliers").unwrap();
    assert_eq!(outliers["points"], json!(["P17"]), "{outliers}");
    let page = format!("/v1/jobs/{}/report.html", text(&job["id"]));
    let page = String::from_utf8(app.get(&page).await.bytes).unwrap();
    assert!(page.contains("(P17)"), "{page}");
}

#[tokio::test]
async fn a_file_that_is_uploaded_once_more_is_told_so() {
    let app = TestApp::with_workers(0).await;
    let robot = app.paper_robot().await;
    let sets = format!("{robot}/measurement-sets?frame=base&name=first");
    let codes = |set: &Value| -> Vec<String> {
        let warnings = set["warnings"].as_array().unwrap().iter();
        warnings.map(|w| text(&w["code"]).to_owned()).collect()
    };
    let two = log_and_export(None);
    let forms = [(FORM, two), ("text/csv", plain())];
    for (content_type, body) in forms {
        let upload = async |path: &str| {
            let request = app.request(Method::POST, path);
            let key = canonical::sha256_hex(path.as_bytes()) + content_type;
            let request = request
                .header("content-type", content_type)
                .header("idempotency-key", &key[40..80.min(key.len())]);
            Answer::of(request.body(body.clone())).await.ok(201)
        };
        assert_eq!(codes(&upload(&sets).await), Vec::<String>::new());
        let again = upload(&sets.replace("first", "second")).await;
        assert_eq!(codes(&again), ["same_file_again"]);
        let detail = text(&again["warnings"][0]["detail"]);
        assert!(detail.contains("\"first\""), "{detail}");
    }
}
