//! Names with HTML, SQL, escapes, bidirectional text, and too long ones: they are returned unchanged, and have no effect.

use crate::app::{Answer, TestApp, paper, text};
use kincal::store::audit;
use reqwest::Method;
use serde_json::{Value, json};
use std::process::Command;

const NAMES: [&str; 11] = [
    "<script>alert(1)</script>",
    "\"><img src=x onerror=alert(1)>",
    "Robert'); DROP TABLE robot;--",
    "' or '1'='1",
    "tab\tbell\u{7}escape\u{1b}[2J\u{1b}]0;title\u{7}",
    "\u{9b}31m c1 \u{85}",
    "one \u{1} \u{1f} \u{7f} \u{fffe}",
    "\u{202e}desrever\u{2066}",
    "../../etc/passwd%00${jndi:ldap://x}{{7*7}}",
    "زاوية 関節 🤖 \u{200d}\u{feff}",
    "line\r\nset-cookie: a=b\r\n\r\n<html>",
];

fn kincal(app: &TestApp, arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args(arguments)
        .args(["--server", &app.server.url()])
        .output()
        .unwrap();
    String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap()
}

/// Longest name for a URL.
const LONGEST_QUERY: usize = 60_000;

/// Percent-encodes a name for a query.
fn encoded(name: &str) -> String {
    name.bytes().map(|byte| format!("%{byte:02X}")).collect()
}

/// Asserts that a text has no control characters.
#[track_caller]
fn assert_no_control_characters(shown: &str) {
    let is_control = |c: char| {
        c != '\n'
            && (c.is_control()
                || ('\u{202a}'..='\u{202e}').contains(&c)
                || ('\u{2066}'..='\u{2069}').contains(&c))
    };
    assert!(!shown.chars().any(is_control), "{shown:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn they_round_trip_through_robots_sets_lists_reasons_and_audit_and_do_nothing() {
    let app = TestApp::with_workers(1).await;
    let mut robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    for name in NAMES {
        (robot["name"], robot["serial_number"], robot["description"]) =
            (json!(name), json!(name), json!(name));
        let created = app.post_json("/v1/robots", &robot).await;
        let answer = created.ok(201);
        assert_eq!(
            (
                &answer["name"],
                &answer["serial_number"],
                &answer["description"]
            ),
            (&json!(name), &json!(name), &json!(name))
        );
        for header in ["set-cookie", "refresh"] {
            assert_eq!(created.header(header), None);
        }
        let path = format!("/v1/robots/{}", text(&answer["id"]));
        let read = app.get(&path).await;
        assert_eq!(read.ok(200)["name"], name);
        assert_eq!(
            (
                read.header("content-type"),
                read.header("x-content-type-options")
            ),
            (Some("application/json"), Some("nosniff"))
        );
        let request = app.request(
            Method::POST,
            &format!("{path}/measurement-sets?frame=base&name={}", encoded(name)),
        );
        let set = Answer::of(
            request
                .header("content-type", "text/csv")
                .body(paper("first.csv")),
        )
        .await
        .ok(201);
        assert_eq!(
            app.get(&format!("{path}/measurement-sets")).await.ok(200)["items"][0]["name"],
            name
        );
        assert_no_control_characters(&kincal(&app, &["sets", "--robot", text(&answer["id"])]));
        let job = app
            .run(
                &path,
                &json!({"measurement_set_id": set["id"], "method": "least_squares"}),
            )
            .await;
        let release = format!(
            "/v1/parameter-sets/{}/release",
            text(&job["parameter_set_id"])
        );
        app.post_json(&release, &json!({"reason": name}))
            .await
            .ok(200);
        assert_no_control_characters(&kincal(
            &app,
            &["params", "--gates", text(&job["parameter_set_id"])],
        ));
        for format in ["json", "yaml", "csv", "urdf", "mastering"] {
            let export = app
                .get(&format!(
                    "/v1/parameter-sets/{}/export?format={format}",
                    text(&job["parameter_set_id"])
                ))
                .await;
            assert_eq!(
                export.status,
                200,
                "{name:?} as {format}: {}",
                export.text()
            );
        }
    }
    let list = app.get("/v1/robots?limit=50").await.ok(200);
    let listed: Vec<&str> = list["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|robot| text(&robot["name"]))
        .collect();
    assert_eq!(listed, NAMES.into_iter().rev().collect::<Vec<_>>());
    let shown = kincal(&app, &["robots"]);
    assert!(
        shown.contains("DROP TABLE") && shown.lines().count() == 1 + NAMES.len(),
        "{shown}"
    );
    assert_no_control_characters(&shown);
    // Refusals repeat the name, also in a terminal.
    let refused = kincal(&app, &["robots", "rob_\u{1b}[2J"]);
    assert_no_control_characters(&refused);
    // The chain has the exact reasons, and is intact.
    let rows = audit::list(&app.server.store, 0, 1000).await.unwrap();
    for name in NAMES {
        let quoted = serde_json::to_string(name).unwrap();
        assert!(
            rows.iter()
                .any(|row| row.event == "parameter_set_released"
                    && row.detail_json.contains(&quoted)),
            "{name:?}"
        );
    }
}

#[tokio::test]
async fn names_that_are_too_long_or_have_a_nul_are_refused_and_leave_nothing() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    for name in [
        "x".repeat(10_000),
        "関".repeat(10_000),
        "a\u{0}b".into(),
        "\u{0}".into(),
    ] {
        body["name"] = json!(name);
        app.post_json("/v1/robots", &body)
            .await
            .problem(422, "invalid_robot");
        if encoded(&name).len() > LONGEST_QUERY {
            continue;
        }
        let request = app.request(
            Method::POST,
            &format!("{robot}/measurement-sets?name={}", encoded(&name)),
        );
        let answer = Answer::of(
            request
                .header("content-type", "text/csv")
                .body(paper("first.csv")),
        )
        .await;
        assert!(
            matches!(answer.status, 400 | 414 | 422 | 431),
            "{}",
            answer.text()
        );
    }
    assert_eq!(
        app.get("/v1/robots").await.ok(200)["items"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    assert_eq!(
        app.get(&format!("{robot}/measurement-sets")).await.ok(200)["items"],
        json!([])
    );
}
