//! From the cell's own files to a report and a released set, in a terminal and without JSON written by hand.

use crate::app::{paper, text};
use crate::people::{Person, guarded};
use crate::process::run_against;
use serde_json::Value;

/// The paper's set as a robot's log with decimal commas and an instrument's export, both without units.
fn two_files() -> (String, String) {
    let set = String::from_utf8(paper("first_noisy.csv")).unwrap();
    let mut log = "Point;J1;J2;J3;J4;J5;J6\n".to_owned();
    let mut export = "// an export\nCollection,Group,Target,X,Y,Z\n".to_owned();
    for (row, line) in set.lines().skip(1).enumerate() {
        let cells: Vec<&str> = line.split(',').collect();
        log += &format!("P{};{}\n", row + 1, cells[2..8].join(";").replace('.', ","));
        export = format!(
            "{export}A,Robot,p_{:03},{}\n",
            row + 1,
            cells[8..11].join(",")
        );
    }
    (log, export)
}

#[tokio::test(flavor = "multi_thread")]
async fn two_files_without_units_lead_to_a_released_set() {
    let (app, dir) = guarded(1).await;
    let person = Person::new(&app, &["read", "upload", "identify", "release"]).await;
    let key = person.key.as_str();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (log, export) = two_files();
    let (robot_file, instrument_file) = (path("log.csv"), path("export.txt"));
    std::fs::write(&robot_file, log).unwrap();
    std::fs::write(&instrument_file, export).unwrap();
    let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    body["name"] = "Cell 4".into();
    body["serial_number"] = "S-1".into();
    person.post("/v1/robots", &body).await.ok(201);
    let out = async |arguments: &[&str]| {
        let (code, stdout, stderr) = run_against(&app, key, arguments).await;
        assert_eq!(code, Some(0), "{arguments:?}: {stdout}{stderr}");
        stdout
    };
    let fails = async |arguments: &[&str]| {
        let (code, stdout, stderr) = run_against(&app, key, arguments).await;
        assert_ne!(code, Some(0), "{arguments:?}: {stdout}{stderr}");
        stderr
    };

    // the units are asked for once, by options
    let files = [robot_file.as_str(), instrument_file.as_str()];
    let submit = [&["submit", "--robot", "Cell 4"][..], &files].concat();
    let refused = fails(&submit).await;
    for expected in [
        "column J1 has no unit",
        "--joint-unit deg",
        "the same for J2, J3",
    ] {
        assert!(refused.contains(expected), "{refused}");
    }
    assert!(!refused.contains("?columns="), "{refused}");
    let preview = [&["columns", "preview", "Cell 4"][..], &files].concat();
    let shown = out(&preview).await;
    assert!(shown.contains("it cannot be read yet"), "{shown}");
    let units = ["--joint-unit", "deg", "--position-unit", "mm"];
    let shown = out(&[&preview[..], &units].concat()).await;
    assert!(shown.contains("it can be read: 100 points"), "{shown}");

    // kept with the robot under a name
    let keep = [&["columns", "keep", "Cell 4", "our log"][..], &units].concat();
    out(&keep).await;
    assert!(
        out(&["columns", "list", "Cell 4"])
            .await
            .contains("our log")
    );
    let shown = out(&["columns", "show", "Cell 4", "our log"]).await;
    assert!(shown.contains("\"joint_unit\": \"deg\""), "{shown}");
    let named = [
        "--kept",
        "our log",
        "--name",
        "march",
        "--serial-number",
        "S-1",
        "--wait",
    ];
    let report = out(&[&submit[..], &named].concat()).await;
    assert!(report.contains("next: kincal release par_"), "{report}");
    let sets = out(&["sets", "--robot", "Cell 4"]).await;
    assert!(sets.contains("march"), "{sets}");
    let other = [&submit[..], &units, &["--serial-number", "S-2"]].concat();
    assert!(fails(&other).await.contains("S-2"));

    let params: Value =
        serde_json::from_str(&out(&["params", "--robot", "Cell 4", "--json"]).await).unwrap();
    let set = text(&params["items"][0]["id"]).to_owned();
    // the robot's only candidate goes by the robot's name
    assert!(out(&["gates", "Cell 4"]).await.contains("passed"));
    out(&["release", "Cell 4", "--reason", "it fits"]).await;
    // a tool is typed in the angles that its controller shows; they are those of W P R in reverse order
    let tool = ["tools", "set", "Cell 4"];
    let mm = ["--mm", "0,0,120", "--json"];
    let kuka = [&tool[..], &["kuka", "--abc-deg", "10,20,-30"], &mm].concat();
    let fanuc = [&tool[..], &["fanuc", "--wpr-deg", "-30,20,10"], &mm].concat();
    let rotation = |shown: String| -> Vec<f64> {
        let tool: Value = serde_json::from_str(&shown).unwrap();
        let rows = tool["t_flange_tool"]["rotation"].as_array().unwrap();
        let cells = rows.iter().flat_map(|row| row.as_array().unwrap());
        cells.map(|cell| cell.as_f64().unwrap()).collect()
    };
    let (kuka, fanuc) = (rotation(out(&kuka).await), rotation(out(&fanuc).await));
    for (a, b) in kuka.iter().zip(&fanuc) {
        assert!((a - b).abs() < 1e-12, "{kuka:?} {fanuc:?}");
    }
    assert!(kuka[1].abs() > 0.1, "{kuka:?}");
    let exported = out(&["export", "Cell 4"]).await;
    assert!(exported.contains(&set), "{exported}");
    let measured = out(&["sets", "--robot", "Cell 4", "--json"]).await;
    let measured: Value = serde_json::from_str(&measured).unwrap();
    let measured = text(&measured["items"][0]["id"]).to_owned();
    let table = out(&["sets", &measured, "--points", "--csv"]).await;
    assert!(
        table.starts_with("line,name,") && table.contains("\n3,P1,"),
        "{table}"
    );

    // options stand before or behind joint values, which have commas or spaces
    let before = out(&["predict", "--target", "0", &set, "-10,-20,30,0,45,0"]).await;
    let behind = out(&["predict", &set, "-10,-20,30,0,45,0", "--target", "0"]).await;
    let spaced = out(&["predict", &set, "-10", "-20", "30", "0", "45", "0"]).await;
    assert_eq!((&before, &before), (&behind, &spaced));
    let posture = ["robots", "posture", "--robot", "Cell 4"];
    let commas = out(&[&posture[..], &["-10,-20,30,0,45,0", "--shown-mm", "1,2,3"]].concat()).await;
    assert!(commas.contains("a tool of zeros"), "{commas}");
    let spaces = out(&[&posture[..], &["-10", "-20", "30", "0", "45", "0"]].concat()).await;
    assert_eq!(commas.lines().next(), spaces.lines().next());

    // what the server shows is a robot file
    let shown = out(&["robots", "show", "Cell 4", "--json"]).await;
    let shown_file = path("robot.json");
    std::fs::write(&shown_file, shown).unwrap();
    let offline = [&["calibrate", &shown_file][..], &files, &units].concat();
    out(&offline).await;
    let missing = fails(&["plan", "no such arm"]).await;
    assert!(missing.contains("kincal robots find"), "{missing}");
    out(&["plan", "kuka_kr10_r1100_2", "-n", "20"]).await;

    // the server's robot gives the plan that its file gives, and a set of the server is added to
    let by_file = out(&["plan", &shown_file, "-n", "12"]).await;
    let by_name = out(&["plan", "--robot", "Cell 4", "-n", "12"]).await;
    assert_eq!(by_file, by_name);
    let listed: Value =
        serde_json::from_str(&out(&["sets", "--robot", "Cell 4", "--json"]).await).unwrap();
    let measured = text(&listed["items"][0]["id"]);
    let frame = text(&listed["items"][0]["frame"]);
    let added = [
        "plan",
        "--robot",
        "Cell 4",
        "-n",
        "12",
        "--measured",
        measured,
    ];
    let added = out(&[&added[..], &["--frame", frame]].concat()).await;
    assert!(added.lines().count() == 13 && added != by_name, "{added}");
    let unknown = fails(&["plan", "--robot", "Cell 5", "-n", "12"]).await;
    assert!(unknown.contains("Cell 5"), "{unknown}");

    let more = [&submit[..], &units, &["--seed", "3", "--wait"]].concat();
    out(&more).await;
    let params: Value =
        serde_json::from_str(&out(&["params", "--robot", "Cell 4", "--json"]).await).unwrap();
    let compared = out(&["compare", &set, text(&params["items"][0]["id"])]).await;
    assert!(!compared.contains('{'), "{compared}");

    out(&["robots", "archive", "Cell 4"]).await;
    let archived = fails(&[&submit[..], &units].concat()).await;
    assert!(archived.contains("kincal restore ID"), "{archived}");
    assert!(!archived.contains("/restore"), "{archived}");
}
