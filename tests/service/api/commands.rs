//! The commands that complete the command line: each against a real server, with `--json`.

use crate::app::{TestApp, paper, text};
use crate::people::{Person, guarded};
use crate::process::run_against;
use kincal::http::ROUTES;
use serde_json::{Value, json};
use std::process::Command;

/// Standard output of a command that succeeds.
async fn out(app: &TestApp, key: &str, arguments: &[&str]) -> String {
    let (code, stdout, stderr) = run_against(app, key, arguments).await;
    assert_eq!(code, Some(0), "{arguments:?}: {stdout}{stderr}");
    stdout
}

/// Its JSON with `--json`.
async fn json_of(app: &TestApp, key: &str, arguments: &[&str]) -> Value {
    let arguments = [arguments, &["--json"]].concat();
    let stdout = out(app, key, &arguments).await;
    serde_json::from_str(&stdout).unwrap_or_else(|error| panic!("{arguments:?}: {error}: {stdout}"))
}

fn data(name: &str) -> String {
    format!("{}/data/paper/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn every_route_has_its_line_in_the_table_of_commands() {
    let table = include_str!("../../../docs/command-line.md");
    for route in ROUTES.iter().filter(|route| route.scope.is_some()) {
        let name = format!("`{} {}`", route.method, route.path);
        assert!(
            table.contains(&name),
            "{name} is not in docs/command-line.md"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_is_edited_put_away_and_taken_back_by_its_name() {
    let (app, _dir) = guarded(0).await;
    let person = Person::new(&app, &["read", "upload"]).await;
    let key = person.key.as_str();
    let robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = person.post("/v1/robots", &robot).await.ok(201);
    let name = text(&robot["name"]);
    let limits = "--limits=-170:170,-90:130.5,none,none,none,none";
    let edited = json_of(
        &app,
        key,
        &[
            "robots",
            "edit",
            name,
            "--name",
            "Cell 4",
            "--serial-number",
            "SN-1",
            "--mounting",
            "0,0.6,-0.8",
            limits,
            "--sign=1,1,-1,1,1,1",
        ],
    )
    .await;
    assert_eq!(
        (&edited["name"], &edited["version"]),
        (&json!("Cell 4"), &json!(2))
    );
    assert_eq!(
        edited["mounting"]["gravity_in_base"],
        json!([0.0, 0.6, -0.8])
    );
    assert_eq!(
        edited["links"][1]["joint_limits_deg"],
        json!([-90.0, 130.5])
    );
    assert_eq!(edited["joint_map"]["sign"][2], -1.0);
    let remove = ["robots", "edit", "SN-1", "--remove", "mounting,joint_map"];
    let edited = json_of(&app, key, &remove).await;
    assert!(edited["mounting"].is_null() && edited["joint_map"].is_null());
    let shown = out(&app, key, &["robots", "show", "Cell 4"]).await;
    assert_eq!(serde_json::from_str::<Value>(&shown).unwrap(), edited);

    let archived = json_of(&app, key, &["robots", "archive", "Cell 4"]).await;
    assert!(archived["archived_at"].is_string());
    let total = async |arguments: &[&str]| json_of(&app, key, arguments).await["total"].clone();
    assert_eq!(total(&["robots"]).await, 0);
    assert_eq!(total(&["robots", "list", "--archived", "true"]).await, 1);
    let (code, _, stderr) = run_against(
        &app,
        key,
        &["submit", "--robot", "Cell 4", &data("first.csv")],
    )
    .await;
    assert!(
        code != Some(0) && stderr.contains("kincal restore ID"),
        "{stderr}"
    );
    json_of(&app, key, &["robots", "restore", "Cell 4"]).await;
    let found = ["robots", "list", "--search", "cell", "--sort=-name"];
    assert_eq!(total(&found).await, 1);
    let table = out(&app, key, &["robots"]).await;
    assert!(table.contains("Cell 4"), "{table}");

    for (arguments, expected) in [
        (vec!["robots", "edit", "Cell 4"], "nothing to edit"),
        (
            vec!["robots", "edit", "Cell 4", "--mounting", "shelf"],
            "floor, wall",
        ),
        (
            vec!["robots", "edit", "Cell 4", "--limits", "1"],
            "LOWER:UPPER",
        ),
        (vec!["archive", "somewhere"], "no id"),
        (
            vec!["robots", "--server", "http://127.0.0.1:1", "list"],
            "list",
        ),
    ] {
        let (code, _, stderr) = run_against(&app, key, &arguments).await;
        assert!(
            code == Some(2) && stderr.contains(expected),
            "{arguments:?}: {code:?} {stderr}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn from_the_upload_to_the_rollback_every_command_answers_as_json() {
    let (app, dir) = guarded(1).await;
    let person = Person::new(&app, &["admin"]).await;
    let key = person.key.as_str();
    let robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = person.post("/v1/robots", &robot).await.ok(201);
    let robot = text(&robot["id"]).to_owned();
    let json = async |arguments: &[&str]| json_of(&app, key, arguments).await;
    let submit = async |seed: &str, more: &[&str]| {
        let file = data("first_noisy.csv");
        let arguments = ["submit", "--robot", &robot, &file, "--wait", "--seed", seed];
        let report = json(&[&arguments, more].concat()).await;
        let job = json(&["jobs", text(&report["job_id"])]).await;
        text(&job["parameter_set_id"]).to_owned()
    };
    let first = submit("1", &["--corrections", "off"]).await;
    let second = submit(
        "2",
        &["--hold", "beta_1", "--prior", "a_2=0.1:mean=166.605"],
    )
    .await;
    let job = json(&["params", &second]).await;
    let job = json(&["jobs", text(&job["job_id"])]).await;
    assert_eq!(
        job["request"]["parameters"],
        json!({"hold": ["beta_1"], "priors": [{"name": "a_2", "std": 0.1, "mean": 166.605}]})
    );

    let shown = json(&["policy", "show", &robot]).await;
    assert_eq!(shown["second_person_required"], false);
    let set = ["policy", "set", &robot, "--tolerance-mm", "5"];
    assert_eq!(json(&set).await["tolerance_mm"], 5.0);
    let set = ["policy", "set", &robot, "--independent-session", "false"];
    assert_eq!(
        json(&set).await["tolerance_mm"],
        5.0,
        "what is not given stays"
    );
    let set = ["policy", "set", &robot, "--tolerance-mm", "none"];
    assert_eq!(json(&set).await["tolerance_mm"], Value::Null);

    assert_eq!(json(&["gates", &first]).await["releasable"], true);
    let (code, _, stderr) = run_against(&app, key, &["gates", &robot]).await;
    assert!(
        code == Some(2) && stderr.contains("name one of them") && stderr.contains(&second),
        "{stderr}"
    );
    for id in [&first, &second] {
        json(&[
            "release",
            id,
            "--reason",
            "it fits",
            "--change-reason",
            "a test",
        ])
        .await;
    }
    let active = json(&["params", "--robot", &robot, "--active"]).await;
    assert_eq!(active["id"], second.as_str());
    let back = json(&["rollback", &robot, "--reason", "scrap"]).await;
    assert_eq!(back["id"], first.as_str());
    let withdrawn = ["params", "--robot", &robot, "--status", "withdrawn"];
    assert_eq!(json(&withdrawn).await["total"], 1);

    let compared = json(&["compare", &first, &second]).await;
    assert!(compared["max_mm"].is_number(), "{compared}");
    let history = json(&["history", &robot]).await;
    assert_eq!(history["total"], 2);
    let line = out(&app, key, &["history", &robot]).await;
    assert!(
        line.contains(&first) && line.contains("withdrawn"),
        "{line}"
    );
    // a robot stands for its released set, and for its candidate if it has one only
    let named = json(&["export", &robot]).await;
    assert_eq!(named["parameter_set_id"], first.as_str());
    let (code, _, stderr) = run_against(&app, key, &["gates", &robot]).await;
    assert!(
        code == Some(2) && stderr.contains("has no candidate"),
        "{stderr}"
    );
    let exported = json(&["export", &first]).await;
    assert_eq!(exported["parameter_set_id"], first.as_str());
    let urdf = dir.path().join("robot.urdf");
    let file = urdf.to_str().unwrap();
    out(
        &app,
        key,
        &["export", &first, "--format", "urdf", "-o", file],
    )
    .await;
    assert!(std::fs::read_to_string(&urdf).unwrap().contains("<robot"));
    // that is the identified robot's description, and not the one that the cell has
    let (code, _, stderr) = run_against(&app, key, &["export", &first, "--patch", file]).await;
    assert!(
        code == Some(2) && stderr.contains("the identified robot's already"),
        "{code:?}: {stderr}"
    );
    // joint values may begin with a minus, and options stand behind them
    let postures = ["10,-20,30,0,45,0", "-5,0,0,0,0,0"];
    let arguments = [&["predict", &first][..], &postures, &["--json"]].concat();
    let predicted: Value = serde_json::from_str(&out(&app, key, &arguments).await).unwrap();
    assert_eq!(predicted["position_mm"].as_array().unwrap().len(), 2);
    let content = out(&app, key, &["params", &first, "--content"]).await;
    assert!(content.starts_with('{') && content.contains("\"links\""));

    let uploaded = [
        "submit",
        "--upload-only",
        "--robot",
        &robot,
        &data("followup_unchanged.csv"),
    ];
    let set = json(&uploaded).await;
    let set = text(&set["id"]).to_owned();
    let points = out(&app, key, &["sets", &set, "--points"]).await;
    assert_eq!(points.into_bytes(), paper("followup_unchanged.csv"));
    let frames = ["frames", "--robot", &robot, &data("sweeps_instrument.csv")];
    let frames = json(&frames).await;
    assert_eq!(json(&["frames", text(&frames["id"])]).await, frames);

    let jobs = json(&["jobs", "--kind", "identify", "--status", "succeeded"]).await;
    assert_eq!(jobs["total"], 2);
    let curve = ["jobs", text(&jobs["items"][0]["id"]), "--convergence"];
    assert!(json(&curve).await["best_cost_mm2"].is_array());
    let jobs = text(&jobs["items"][0]["id"]).to_owned();
    out(&app, key, &["archive", &set, &jobs]).await;
    assert_eq!(json(&["jobs"]).await["total"], 1);
    let sets = [
        "sets",
        "--robot",
        &robot,
        "--archived",
        "all",
        "--sort",
        "name",
    ];
    assert_eq!(json(&sets).await["total"], 3);
    out(&app, key, &["restore", &set, &jobs]).await;
    assert_eq!(json(&["jobs"]).await["total"], 2);
    let (code, _, stderr) = run_against(&app, key, &["archive", &first]).await;
    assert!(code == Some(1) && stderr.contains("history"), "{stderr}");

    let swarm = json!({"measurement_set_id": set, "method": "pso", "options": {"n_particles": 10, "n_iterations": 5}});
    person.job(&format!("/v1/robots/{robot}"), &swarm).await;
    let networks = json(&["networks", "--robot", &robot]).await;
    let network = text(&networks["items"][0]["id"]).to_owned();
    assert_eq!(json(&["networks", &network]).await["id"], network.as_str());
    let weights = dir.path().join("weights");
    let file = weights.to_str().unwrap();
    out(&app, key, &["networks", &network, "--weights", file]).await;
    assert!(std::fs::metadata(&weights).unwrap().len() > 100);
}

#[test]
fn calibrate_takes_what_a_job_takes() {
    let calibrate = |more: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
            .args([
                "calibrate",
                &data("robot.json"),
                &data("first_noisy.csv"),
                "--json",
            ])
            .args(more)
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code(), report, stderr)
    };
    let parameter = |report: &Value, name: &str| {
        let parameters = report["parameters"].as_array().unwrap();
        parameters.iter().find(|p| p["name"] == name).cloned()
    };
    let (code, free, stderr) = calibrate(&["--corrections", "off"]);
    assert_eq!(code, Some(0), "{stderr}");
    let moved = |report: &Value, name: &str| {
        parameter(report, name).map_or(0.0, |p| p["delta"].as_f64().unwrap())
    };
    assert!(moved(&free, "a_2") != 0.0);
    let (code, held, stderr) = calibrate(&["--corrections", "off", "--hold", "a_2,d_1"]);
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(moved(&held, "a_2"), 0.0);
    let (_, only, _) = calibrate(&[
        "--corrections",
        "off",
        "--identify",
        "theta_offset_2,theta_offset_3",
    ]);
    assert!(moved(&only, "theta_offset_2") != 0.0 && moved(&only, "a_3") == 0.0);
    // A narrow prior far from the truth holds the parameter there.
    let (_, bent, _) = calibrate(&[
        "--corrections",
        "off",
        "--prior",
        "a_2=0.000001:mean=166.605",
    ]);
    assert!(moved(&bent, "a_2").abs() < 1e-4, "{}", moved(&bent, "a_2"));
    let (code, _, stderr) = calibrate(&[
        "--mounting",
        "ceiling",
        "--verify-fraction",
        "0.3",
        "--payload",
        "5,0,0,80",
    ]);
    assert_eq!(code, Some(0), "{stderr}");
    for (more, expected) in [
        (vec!["--hold", "a_2", "--identify", "a_3"], "--identify"),
        (vec!["--hold", "a_99"], "a_99"),
        (vec!["--prior", "a_2"], "NAME=STD"),
        (vec!["--mounting", "up"], "floor, wall"),
    ] {
        let (code, _, stderr) = calibrate(&more);
        assert!(
            code == Some(2) && stderr.contains(expected),
            "{more:?}: {code:?} {stderr}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_set_of_the_server_is_submitted_by_its_id() {
    let (app, _dir) = guarded(0).await;
    let person = Person::new(&app, &["read", "upload", "identify"]).await;
    let key = person.key.as_str();
    let robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = person.post("/v1/robots", &robot).await.ok(201);
    let robot = text(&robot["id"]);
    let file = data("first.csv");
    let submit = ["submit", "--robot", robot];
    let set = json_of(
        &app,
        key,
        &[&submit[..], &["--upload-only", file.as_str()]].concat(),
    )
    .await;
    let id = text(&set["id"]);
    let job = json_of(&app, key, &[&submit[..], &["--verify", id]].concat()).await;
    assert_eq!(
        (&job["kind"], &job["measurement_set_id"]),
        (&json!("verify"), &set["id"])
    );
}
