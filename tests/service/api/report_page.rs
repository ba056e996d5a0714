//! The report page: its content, and that it has no scripts or requests.

use crate::api::closed_loop::{Cell, LIMITS_DEG, csv};
use crate::app::{Answer, TestApp, paper, text};
use base64::Engine;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::process::Command;

/// Fetches the page of a job.
async fn page(app: &TestApp, job: &Value) -> (String, String) {
    let answer = app
        .get(&format!("/v1/jobs/{}/report.html", text(&job["id"])))
        .await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    assert_eq!(
        answer.header("content-type"),
        Some("text/html; charset=utf-8")
    );
    (
        answer.text(),
        answer.header("content-security-policy").unwrap().to_owned(),
    )
}

/// The text between two marks.
fn between<'a>(page: &'a str, begin: &str, end: &str) -> &'a str {
    let (_, rest) = page
        .split_once(begin)
        .unwrap_or_else(|| panic!("no {begin}"));
    rest.split_once(end).unwrap_or_else(|| panic!("no {end}")).0
}

/// Names of all elements of the page.
fn elements(page: &str) -> Vec<&str> {
    page.split('<')
        .skip(1)
        .filter(|tag| !tag.starts_with(['/', '!']))
        .map(|tag| tag.split([' ', '>']).next().unwrap())
        .collect()
}

/// A parameter as the page writes it.
fn written(name: &str) -> String {
    let plain = [
        ("base_r", "base, turned about "),
        ("base_", "base "),
        ("target_0_", "reflector 0, "),
        ("theta_offset_", "θ"),
        ("alpha_", "α"),
        ("beta_", "β"),
        ("a_", "a"),
        ("d_", "d"),
    ];
    let (start, said) = plain
        .iter()
        .find(|(start, _)| name.starts_with(start))
        .unwrap();
    let below = |c: char| {
        c.to_digit(10)
            .map_or(c, |d| char::from_u32(0x2080 + d).unwrap())
    };
    format!(
        "{said}{}",
        name[start.len()..].chars().map(below).collect::<String>()
    )
}

#[tokio::test]
async fn the_page_says_what_the_report_says() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first_noisy.csv").await;
    let job = app
        .run(&robot, &json!({"measurement_set_id": set, "method": "pso"}))
        .await;
    let (page, _) = page(&app, &job).await;
    let report = app.report(&job).await;
    for half in ["identify", "verify"] {
        for (stage, decimals) in [("before", 2), ("after", 4)] {
            let rms = report[half][stage]["rms_mm"].as_f64().unwrap();
            assert!(
                page.contains(&format!("{rms:.decimals$}</td>")),
                "{half} {stage} {rms}"
            );
        }
    }
    let summary = app
        .get(&format!("/v1/measurement-sets/{set}"))
        .await
        .ok(200);
    let parameters = app.parameter_set(&job).await;
    for expected in [
        &report["result_sha256"],
        &summary["sha256"],
        &parameters["sha256"],
        &report["version"],
        &report["method_reason"],
        &job["id"],
    ] {
        assert!(page.contains(text(expected)), "{expected}");
    }
    for parameter in report["parameters"].as_array().unwrap() {
        let name = written(text(&parameter["name"]));
        let row = between(&page, &format!("<th>{name}"), "</tr>");
        assert_eq!(
            row.contains("not seen alone"),
            parameter["identifiable"] == false,
            "{parameter}"
        );
        assert!(
            row.contains(&format!(
                "{:.4}</td>",
                parameter["identified"].as_f64().unwrap().abs()
            )),
            "{parameter}: {row}"
        );
    }
    assert!(page.contains("same upload"));
    // one bar before and one after for each of the 100 points, arrows of both kinds in two views, the curve
    let bars = between(&page, "Error per point", "</figure>");
    let bars = bars.split_once("role=\"img\"").unwrap().1;
    assert_eq!(
        (
            bars.matches("class=\"before\"").count(),
            bars.matches("class=\"after\"").count()
        ),
        (100, 100)
    );
    assert_eq!(
        (
            page.matches("class=\"before-line\"").count(),
            page.matches("class=\"after-line\"").count()
        ),
        (200, 200)
    );
    assert_eq!(page.matches("class=\"curve\"").count(), 1);
}

#[tokio::test]
async fn the_page_has_corrections_with_their_standard_errors_repeatability_and_what_was_known() {
    let app = TestApp::with_workers(1).await;
    let Cell {
        robot,
        truth,
        mut random,
        ..
    } = Cell::registered(&app).await;
    // A hundred poses, three of which have five more measurements.
    let mut poses: Vec<Vec<f64>> = (0..100).map(|_| random.pose(&LIMITS_DEG)).collect();
    (0..5).for_each(|_| poses.extend_from_within(..3));
    let csv = csv(&truth, &poses, &mut random);
    let set = app.upload_csv(&robot, "frame=instrument", csv).await;
    let job = app
        .run(&robot, &json!({"measurement_set_id": set["id"]}))
        .await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let (text_of_it, _) = page(&app, &job).await;
    let report = app.report(&job).await;

    let section = between(&text_of_it, "Corrections", "</section>");
    let corrections = report["corrections"].as_array().unwrap();
    assert!(
        corrections.iter().any(|c| c["kept"] == true),
        "the robot sags: {corrections:?}"
    );
    for correction in corrections {
        let row = between(
            section,
            &format!(
                "<th>{}</th>",
                kincal::report_page::words::correction(text(&correction["kind"]))
            ),
            "</tr>",
        );
        for field in [
            "cross_validated_rms_mm_before",
            "cross_validated_rms_mm_after",
            "gain_mm2",
            "standard_error_mm2",
        ] {
            assert!(
                row.contains(&shown(&correction[field])),
                "{field} of {correction}: {row}"
            );
        }
        assert_eq!(
            (row.contains("yes"), row.contains("no")),
            (correction["kept"] == true, correction["kept"] == false),
            "{row}"
        );
    }
    let errors = between(
        &text_of_it,
        "Position errors before and after",
        "</section>",
    );
    for half in ["identify", "verify"] {
        assert!(
            errors.contains(&shown(&report[half]["corrected"]["rms_mm"])),
            "{half} with corrections: {errors}"
        );
    }

    let section = between(&text_of_it, "<h2>Repeatability", "</section>");
    let found = &report["repeatability"];
    for field in ["rp_mm", "std_mm"] {
        assert!(
            section.replace(" mm<", "<").contains(&shown(&found[field])),
            "{field} of {found}: {section}"
        );
    }
    let visited = found["poses"].as_array().unwrap();
    assert_eq!(
        (
            visited.len(),
            section.matches("<td class=\"n\">6</td>").count()
        ),
        (3, 3),
        "{section}"
    );
    for pose in visited {
        let row = between(
            section,
            &format!("<th>{}</th>", text(&pose["configuration"])),
            "</tr>",
        );
        for field in ["rp_mm", "ap_before_mm", "ap_after_mm", "ap_corrected_mm"] {
            assert!(
                row.contains(&shown(&pose[field])),
                "{field} of {pose}: {row}"
            );
        }
    }

    // With priors no corrections are identified.
    let priors = json!([{"name": "a_3", "std": 0.5, "max": 800.0}]);
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": set["id"], "parameters": {"priors": priors}}),
        )
        .await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let (page, _) = page(&app, &job).await;
    let row = between(
        between(&page, "Known beforehand", "</section>"),
        "<th>a₃</th>",
        "</tr>",
    );
    assert!(
        row.contains("0.500") && row.contains("to +800.0000") && row.contains(" %"),
        "{row}"
    );
}

/// A number as the page writes it: three digits; below a thousandth two of them and the beginning of a power of ten.
fn shown(value: &Value) -> String {
    let value = value.as_f64().unwrap();
    let sign = if value < 0.0 { "\u{2212}" } else { "" };
    if value.abs() < 1e-3 {
        let scientific = format!("{:.1e}", value.abs());
        return format!("{sign}{}·10", scientific.split('e').next().unwrap());
    }
    let decimals = (2.0 - value.abs().log10().floor()).max(0.0) as usize;
    format!("{sign}{:.decimals$}<", value.abs())
}

#[tokio::test]
async fn the_page_needs_nothing_else_and_hostile_names_do_nothing() {
    let app = TestApp::with_workers(1).await;
    let hostile = "</title></style><script>alert(1)</script><img src=x onerror=alert(2)>\"'&amp;";
    let mut robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    (robot["name"], robot["serial_number"]) = (json!(hostile), json!(hostile));
    let robot = format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &robot).await.ok(201)["id"])
    );
    let csv = String::from_utf8(paper("first.csv")).unwrap();
    let sets = reqwest::Url::parse_with_params("http://x/", [("frame", "base"), ("name", hostile)])
        .unwrap();
    let set = app
        .post(
            &format!("{robot}/measurement-sets?{}", sets.query().unwrap()),
            "text/csv",
            csv,
        )
        .await
        .ok(201);
    let job = app
        .run(&robot, &json!({"measurement_set_id": set["id"]}))
        .await;
    let (page, policy) = page(&app, &job).await;
    let known = [
        "html",
        "head",
        "meta",
        "title",
        "style",
        "body",
        "header",
        "main",
        "section",
        "figure",
        "figcaption",
        "div",
        "p",
        "h1",
        "h2",
        "dl",
        "dt",
        "dd",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
        "strong",
        "svg",
        "rect",
        "line",
        "text",
        "path",
        "polyline",
    ];
    assert_eq!(
        elements(&page)
            .into_iter()
            .find(|element| !known.contains(element)),
        None
    );
    assert_eq!(
        page.matches("&lt;script&gt;alert(1)").count(),
        4,
        "title, heading, serial number and set"
    );
    for forbidden in [
        " src=",
        " href=",
        "url(",
        "@import",
        "http://",
        "https://",
        " style=\"",
    ] {
        assert!(
            !page.replace("src=x onerror", "").contains(forbidden),
            "{forbidden}"
        );
    }
    let style = between(&page, "<style>", "</style>");
    let hash = base64::prelude::BASE64_STANDARD.encode(Sha256::digest(style));
    assert_eq!(
        policy,
        format!(
            "default-src 'none'; style-src 'sha256-{hash}'; base-uri 'none'; form-action 'none'"
        )
    );
    assert!(page.contains(&format!("content=\"{policy}\"")));
}

#[tokio::test]
async fn a_verification_has_a_page_too() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    app.run(&robot, &json!({"measurement_set_id": set})).await;
    let follow_up = app.upload(&robot, "followup_unchanged.csv").await;
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": follow_up, "kind": "verify"}),
        )
        .await;
    let (page, _) = page(&app, &job).await;
    assert!(page.contains("<h1>Verification of ER20-C10</h1>"));
    assert!(
        page.contains("<th>on 100 points</th>")
            && page.contains("<dd>the nominal robot; ")
            && page.contains(text(&job["robot_id"]))
    );
    for nothing in [
        "<h2>Parameters</h2>",
        "<h2>Convergence</h2>",
        "Identify (0)",
        "these parameters",
    ] {
        assert!(!page.contains(nothing), "{nothing}");
    }
}

#[tokio::test]
async fn the_command_line_makes_the_same_page() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": set, "method": "pso", "seed": 3}),
        )
        .await;
    let (served, _) = page(&app, &job).await;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("report.html");
    let paper = |name: &str| format!("{}/data/paper/{name}", env!("CARGO_MANIFEST_DIR"));
    let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args([
            "calibrate",
            &paper("robot.json"),
            &paper("first.csv"),
            "--method",
            "pso",
            "--seed",
            "3",
            "--json",
            "--html",
        ])
        .arg(&path)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let offline = std::fs::read_to_string(path).unwrap();
    let parts = [
        ("Position errors before and after, mm", "</section>"),
        ("<h2>Error per point", "</figure>"),
        ("<h2>Distribution of the errors", "</figure>"),
        ("<h2>Convergence", "</figure>"),
        ("<h2>Seen from above", "</figure>"),
        ("<h2>Parameters", "</section>"),
    ];
    for (begin, end) in parts {
        assert!(
            between(&served, begin, end) == between(&offline, begin, end),
            "{begin}"
        );
    }
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(
        served.contains(text(&report["result_sha256"]))
            && offline.contains(text(&report["result_sha256"]))
    );
    let nowhere = dir.path().join("missing").join("report.html");
    let output = Command::new(env!("CARGO_BIN_EXE_kincal"))
        .args([
            "calibrate",
            &paper("robot.json"),
            &paper("first.csv"),
            "--html",
        ])
        .arg(&nowhere)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("cannot write"));
}

#[tokio::test]
async fn the_page_says_when_with_what_and_by_whom_the_session_was_measured() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let path = format!("{robot}/measurement-sets?frame=base");
    let upload = async |more: &str| {
        let path = format!("{path}{more}");
        app.post(&path, "text/csv", paper("first_noisy.csv")).await
    };
    let refused = upload("&measured_at=yesterday&operator=")
        .await
        .problem(422, "invalid_session_record");
    let codes: Vec<&str> = refused["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|issue| text(&issue["code"]))
        .collect();
    assert_eq!(codes, ["wrong_length", "not_a_time"], "{refused}");

    let record = "&measured_at=2026-03-01T08:15:30%2B01:00&instrument_name=Leica%20AT960%204711\
                  &instrument_certificate=C-17,%20until%202027-02&operator=J.%20Doe&name=first%20without%20row%203:%20slipped";
    let set = upload(record).await.ok(201);
    let stated = json!({
        "measured_at": "2026-03-01T07:15:30.000Z", "instrument_name": "Leica AT960 4711",
        "instrument_certificate": "C-17, until 2027-02", "operator": "J. Doe",
    });
    assert_eq!(set["record"], stated);
    let path = format!("/v1/measurement-sets/{}", text(&set["id"]));
    assert_eq!(app.get(&path).await.ok(200)["record"], stated);
    let plain = upload("").await.ok(201);
    assert_eq!(plain.get("record"), None);

    let mut hashes = Vec::new();
    for (set, measured_at, n_blanks) in [
        (&set, Some("2026-03-01T07:15:30.000Z"), 2),
        (&plain, None, 5),
    ] {
        let request = json!({"measurement_set_id": set["id"], "method": "least_squares"});
        let job = app.run(&robot, &request).await;
        let report = format!("/v1/jobs/{}/report", text(&job["id"]));
        let report = app.get(&report).await.ok(200);
        assert_eq!(report["measured_at"].as_str(), measured_at);
        hashes.push(report["result_sha256"].clone());
        let (page, _) = page(&app, &job).await;
        let blanks = between(&page, "class=\"blanks\"", "</section>");
        assert_eq!(blanks.matches("<div>").count(), n_blanks, "{blanks}");
        let words = "2026-03-01 07:15:30 UTC; by J. Doe; with Leica AT960 4711, certificate C-17, until 2027-02";
        assert_eq!(page.contains(words), measured_at.is_some());
        let left_out = "Left out of the measured file by hand: row 3: slipped";
        assert_eq!(page.contains(left_out), measured_at.is_some());
        for (name, value) in [
            ("Mounting", "not stated: on the floor is assumed"),
            ("Payload", "not stated"),
        ] {
            let line = between(&page, &format!("<dt>{name}</dt>"), "</div>");
            assert!(line.contains(value), "{name}: {line}");
        }
    }
    assert_eq!(hashes[0], hashes[1], "the record is no part of the result");
}

#[tokio::test]
async fn a_set_without_a_stated_time_was_measured_at_the_earliest_time_of_its_points() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    // later rows first; the earliest is in another zone, and its text is not the smallest
    let times = |row: usize| match row {
        40 => "2026-03-01T08:59:59+02:00".to_owned(),
        row => format!("2026-03-01T07:{:02}:{:02}Z", 59 - row % 60, row / 60),
    };
    let table = String::from_utf8(paper("first_noisy.csv")).unwrap();
    let with_times: Vec<String> = table
        .lines()
        .enumerate()
        .map(|(line, text)| match line {
            0 => format!("{text},measured_at"),
            line => format!("{text},{}", times(line - 1)),
        })
        .collect();
    let with_times = with_times.join("\n") + "\n";
    let upload = async |more: &str| {
        let path = format!("{robot}/measurement-sets?frame=base{more}");
        let answer = app.post(&path, "text/csv", with_times.clone()).await;
        answer.ok(201)
    };
    let first = json!({"measured_at": "2026-03-01T06:59:59.000Z", "measured_at_of_points": true});
    let set = upload("").await;
    assert_eq!(set["record"], first);
    let named = upload("&operator=J.%20Doe").await;
    assert_eq!(named["record"]["operator"], "J. Doe");
    assert_eq!(named["record"]["measured_at"], first["measured_at"]);
    let stated = upload("&measured_at=2026-03-02T08:00:00Z").await;
    let expected = json!({"measured_at": "2026-03-02T08:00:00.000Z"});
    assert_eq!(stated["record"], expected, "what is stated counts");

    let request = json!({"measurement_set_id": set["id"], "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    assert_eq!(
        app.report(&job).await["measured_at"],
        first["measured_at"],
        "the report has it"
    );
    let (page, _) = page(&app, &job).await;
    assert!(page.contains("2026-03-01 06:59:59 UTC (the earliest time of its points)"));

    let point = |x: f64, at: &str| json!({"q_deg": [x, 0.0, 0.0, 0.0, 0.0, 0.0], "position_mm": [x, 0.0, 0.0], "measured_at": at});
    let body = json!({"frame": "base", "points": [point(10.0, "2026-03-01T09:00:00Z"), point(20.0, "2026-03-01T08:00:00Z")]});
    let path = format!("{robot}/measurement-sets");
    let set = app.post_json(&path, &body).await.ok(201);
    assert_eq!(set["record"]["measured_at"], "2026-03-01T08:00:00.000Z");
    let points = format!("/v1/measurement-sets/{}", text(&set["id"]));
    assert_eq!(app.get(&points).await.ok(200)["record"], set["record"]);
}

#[tokio::test]
async fn a_verdict_has_an_uncertainty_or_says_in_a_sentence_why_it_has_none() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let policy = app.request(reqwest::Method::PUT, &format!("{robot}/policy"));
    let policy = policy.json(&json!({"tolerance_mm": 0.5}));
    assert_eq!(Answer::of(policy).await.status, 200);
    let tracker = "frame=instrument&range_std_mm=0.01&angle_std_deg=0.001";
    let set = app
        .upload_csv(&robot, tracker, paper("first_noisy.csv"))
        .await;
    let other = app
        .upload_csv(&robot, "frame=instrument", paper("followup_unchanged.csv"))
        .await;
    let first = |request: Value| {
        let mut whole = json!({"measurement_set_id": set["id"], "method": "least_squares"});
        whole
            .as_object_mut()
            .unwrap()
            .extend(request.as_object().unwrap().clone());
        whole
    };
    for verify in [
        json!({}),
        json!({"verify": {"source": "set", "measurement_set_id": other["id"]}}),
    ] {
        let job = app.run(&robot, &first(verify.clone())).await;
        let (page, _) = page(&app, &job).await;
        let verdict = between(&page, "class=\"conformity\"", "</p>");
        assert!(
            verdict.contains(" ± ") && verdict.contains("WITHIN"),
            "{verify}: {verdict}"
        );
        assert!(page.contains("± is the expanded uncertainty (95 %)"));
    }
    let few = json!({"verify": {"source": "fraction", "fraction": 0.04}});
    let job = app.run(&robot, &first(few)).await;
    let (page, _) = page(&app, &job).await;
    assert!(page.contains("NOT SHOWN"), "{page}");
    assert!(
        page.contains("arm configurations, and it takes 5"),
        "{}",
        between(&page, "class=\"conformity\"", "<dl")
    );
}
