//! A generated corpus of bad uploads: ten files and more per class, each answered with the right status, code, row, column and hint, and
//! nothing is stored.

use crate::app::{Answer, TestApp, paper, text};
use crate::simulation::Normal;
use rand::RngExt;
use serde_json::{Value, json};

const FILES_PER_CLASS: usize = 12;

/// The paper's first set as cells; row 0 is the header.
fn cells() -> Vec<Vec<String>> {
    let text = String::from_utf8(paper("first.csv")).unwrap();
    text.lines()
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

fn csv(cells: &[Vec<String>]) -> Vec<u8> {
    cells
        .iter()
        .map(|row| row.join(",") + "\n")
        .collect::<String>()
        .into_bytes()
}

/// One bad file and its expected answer.
struct Bad {
    body: Vec<u8>,
    code: &'static str,
    row: Option<usize>,
    column: Option<String>,
    hint: &'static str,
}

/// Place of a class's fault: a random data row and a random column among `columns`.
struct Place<'a> {
    random: &'a mut Normal,
}

impl Place<'_> {
    fn below(&mut self, n: usize) -> usize {
        (self.random.0.random::<f64>() * n as f64) as usize
    }

    fn number_column(&mut self) -> usize {
        2 + self.below(9)
    }
}

/// A cell that cannot be read as a number of that column.
fn bad_cell(place: &mut Place, value: &str, code: &'static str, hint: &'static str) -> Bad {
    let mut cells = cells();
    let (row, column) = (place.below(cells.len() - 1), place.number_column());
    cells[row + 1][column] = value.into();
    Bad {
        body: csv(&cells),
        code,
        row: Some(row),
        column: Some(cells[0][column].clone()),
        hint,
    }
}

/// A header with a fault in one column.
fn bad_header(
    place: &mut Place,
    rename: impl Fn(&str) -> String,
    code: &'static str,
    hint: &'static str,
) -> Bad {
    let mut cells = cells();
    let column = place.number_column();
    let name = rename(&cells[0][column]);
    cells[0][column].clone_from(&name);
    Bad {
        body: csv(&cells),
        code,
        row: None,
        column: Some(name),
        hint,
    }
}

fn whole(body: Vec<u8>, code: &'static str, hint: &'static str) -> Bad {
    Bad {
        body,
        code,
        row: None,
        column: None,
        hint,
    }
}

type Class = (&'static str, fn(&mut Place) -> Bad);

fn pick(place: &mut Place, of: &[&'static str]) -> &'static str {
    of[place.below(of.len())]
}

const CLASSES: &[Class] = &[
    ("NaN", |p| {
        let v = pick(p, &["NaN", "nan", "-NaN", "+nan"]);
        bad_cell(p, v, "not_finite", "not a finite number")
    }),
    ("infinite", |p| {
        let v = pick(p, &["inf", "-inf", "Infinity", "+INF"]);
        bad_cell(p, v, "not_finite", "not a finite number")
    }),
    ("beyond a float", |p| {
        let v = pick(p, &["1e400", "-1e999", "9e308000"]);
        bad_cell(p, v, "not_finite", "not a finite number")
    }),
    ("empty cell", |p| {
        let v = pick(p, &["", "  ", "\"\""]);
        bad_cell(p, v, "empty_cell", "fill it in")
    }),
    ("text", |p| {
        let v = pick(
            p,
            &[
                "abc", "12 mm", "1.2.3", "--", "0x1f", "#REF!", "n/a", "=1+1", "１２",
            ],
        );
        bad_cell(p, v, "not_a_number", "is not a number")
    }),
    ("decimal comma, quoted", |p| {
        let v = pick(p, &["\"12,5\"", "\"-0,1\"", "\"1.234,5\""]);
        bad_cell(p, v, "decimal_comma", "decimal point")
    }),
    ("out of any range", |p| {
        let v = pick(p, &["1e9", "-4e7", "2.5e12"]);
        bad_cell(p, v, "out_of_range", "unit")
    }),
    ("decimal comma, bare", |p| {
        let mut cells = cells();
        let (row, column) = (p.below(cells.len() - 1), p.number_column());
        cells[row + 1][column] = cells[row + 1][column].replace('.', ",");
        Bad {
            body: csv(&cells),
            code: "wrong_cell_count",
            row: Some(row),
            column: None,
            hint: "decimal comma",
        }
    }),
    ("a cell is missing", |p| {
        let mut cells = cells();
        let row = p.below(cells.len() - 1);
        cells[row + 1].pop();
        Bad {
            body: csv(&cells),
            code: "wrong_cell_count",
            row: Some(row),
            column: None,
            hint: "end of the row is missing",
        }
    }),
    ("no unit", |p| {
        bad_header(
            p,
            |name| name.split('_').next().unwrap().into(),
            "missing_unit",
            "has no unit; name it",
        )
    }),
    ("unknown unit", |p| {
        let unit = pick(p, &["_inch", "_um", "_grad", "_cm"]);
        let mut bad = bad_header(
            p,
            |name| format!("{}{unit}", name.split('_').next().unwrap()),
            "",
            "",
        );
        bad.code = if bad.column.as_deref().unwrap().starts_with('q') {
            "missing_unit"
        } else {
            "unknown_column"
        };
        bad
    }),
    ("a joint too many", |p| {
        let mut cells = cells();
        let extra = format!("q{}_deg", 7 + p.below(4));
        cells[0].push(extra.clone());
        cells[1..].iter_mut().for_each(|row| row.push("1.0".into()));
        Bad {
            body: csv(&cells),
            code: "wrong_joint_count",
            row: None,
            column: Some(extra),
            hint: "the robot has 6 joints",
        }
    }),
    ("a joint too few", |p| {
        let mut cells = cells();
        let joint = p.below(6);
        let name = cells[0][2 + joint].clone();
        cells.iter_mut().for_each(|row| drop(row.remove(2 + joint)));
        Bad {
            body: csv(&cells),
            code: "wrong_joint_count",
            row: None,
            column: Some(name),
            hint: "the robot has 6 joints",
        }
    }),
    ("a coordinate is missing", |p| {
        let mut cells = cells();
        let axis = p.below(3);
        let name = cells[0][8 + axis].clone();
        cells.iter_mut().for_each(|row| drop(row.remove(8 + axis)));
        Bad {
            body: csv(&cells),
            code: "missing_column",
            row: None,
            column: Some(name),
            hint: "exactly one column",
        }
    }),
    ("a column twice", |p| {
        let mut cells = cells();
        let column = p.number_column();
        let name = cells[0][column].clone();
        cells.iter_mut().for_each(|row| {
            let cell = row[column].clone();
            row.push(cell)
        });
        Bad {
            body: csv(&cells),
            code: "duplicate_column",
            row: None,
            column: Some(name),
            hint: "twice",
        }
    }),
    ("two units at once", |p| {
        let mut cells = cells();
        let column = p.number_column();
        cells[0][column] = cells[0][column]
            .replace("_deg", "_rad")
            .replace("_mm", "_m");
        Bad {
            body: csv(&cells),
            code: "mixed_units",
            row: None,
            column: None,
            hint: "one unit",
        }
    }),
    ("a byte that is no digit in any encoding", |p| {
        let mut bad = bad_cell(p, "12\u{fffd}.5", "not_a_number", "is not a number");
        let text = String::from_utf8(bad.body).unwrap();
        let (before, after) = text.split_once('\u{fffd}').unwrap();
        bad.body = [before.as_bytes(), &[0xFF], after.as_bytes()].concat();
        bad
    }),
    ("control characters", |p| {
        let mut body = csv(&cells());
        let at = 200 + p.below(1000);
        body[at] = pick(p, &["\0", "\u{1}", "\u{1b}"]).as_bytes()[0];
        whole(body, "not_text", "control character")
    }),
    ("a number with two readings", |_| {
        let mut rows = cells()[..2].to_vec();
        rows[1][2..]
            .iter_mut()
            .for_each(|cell| *cell = "1,234".into());
        let text: Vec<String> = rows.iter().map(|row| row.join(";")).collect();
        whole(
            text.join("\n").into_bytes(),
            "two_readings",
            "{\"decimal\": \"comma\"}",
        )
    }),
    ("no rows", |p| {
        let blank = "\n".repeat(p.below(5));
        whole(
            [&csv(&cells()[..1]), blank.as_bytes()].concat(),
            "no_rows",
            "no data rows",
        )
    }),
    ("a wrong subset", |p| {
        let mut cells = cells();
        let row = p.below(cells.len() - 1);
        cells[row + 1][1] = pick(p, &["train", "Verify", "0"]).into();
        Bad {
            body: csv(&cells),
            code: "unknown_subset",
            row: Some(row),
            column: Some("subset".into()),
            hint: "identify",
        }
    }),
];

async fn refused(answer: &Answer, bad: &Bad, class: &str) {
    assert_eq!(answer.status, 422, "{class}: {}", answer.text());
    let problem = answer.json();
    let first = &problem["errors"][0];
    assert_eq!(first["code"], bad.code, "{class}: {problem}");
    assert_eq!(
        first.get("row").and_then(Value::as_u64),
        bad.row.map(|row| row as u64),
        "{class}: {problem}"
    );
    assert_eq!(
        first.get("column").and_then(Value::as_str),
        bad.column.as_deref(),
        "{class}: {problem}"
    );
    assert!(
        text(&first["detail"]).contains(bad.hint),
        "{class}: no hint {:?} in {first}",
        bad.hint
    );
    assert!(text(&problem["detail"]).len() > 10, "{class}: {problem}");
}

async fn nothing_is_stored(app: &TestApp, robot: &str) {
    assert_eq!(
        app.get(&format!("{robot}/measurement-sets")).await.ok(200)["items"],
        json!([])
    );
}

#[tokio::test]
async fn every_bad_file_is_answered_with_its_row_its_column_and_a_hint() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let mut random = Normal::new(7);
    for (class, make) in CLASSES {
        for _ in 0..FILES_PER_CLASS {
            let bad = make(&mut Place {
                random: &mut random,
            });
            let answer = app
                .post(
                    &format!("{robot}/measurement-sets?frame=base"),
                    "text/csv",
                    bad.body.clone(),
                )
                .await;
            refused(&answer, &bad, class).await;
        }
    }
    nothing_is_stored(&app, &robot).await;
}

#[tokio::test]
async fn workbooks_and_archives_are_answered_415_whatever_they_are_called() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let upload = format!("{robot}/measurement-sets?frame=base");
    for tail in 0..FILES_PER_CLASS {
        let xlsx = [b"PK\x03\x04".as_slice(), &vec![b'x'; tail * 7]].concat();
        let xls = [
            b"\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1".as_slice(),
            &vec![0; tail * 7],
        ]
        .concat();
        for (body, content_type) in [
            (&xlsx, "text/csv"),
            (&xls, "text/csv"),
            (&xlsx, "application/json"),
            (
                &xlsx,
                "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
            ),
            (&xlsx, "application/zip"),
        ] {
            let problem = app
                .post(&upload, content_type, body.clone())
                .await
                .problem(415, "unsupported_media_type");
            assert!(text(&problem["detail"]).contains("CSV"), "{problem}");
        }
    }
    nothing_is_stored(&app, &robot).await;
}

/// Changes of the paper's points that make the file wrong as a whole, with the expected code, text and column.
type Distortion = (
    &'static str,
    &'static str,
    Option<&'static str>,
    fn(&mut [f64; 6], &mut [f64; 3]),
);

const DISTORTIONS: &[Distortion] = &[
    (
        "unit_suspect",
        "radians and were given as degrees",
        Some("q1 …"),
        |q, _| q.iter_mut().for_each(|q| *q = q.to_radians()),
    ),
    (
        "unit_suspect",
        "metres and were given as millimetres",
        Some("x, y, z"),
        |_, p| p.iter_mut().for_each(|p| *p /= 1000.0),
    ),
    (
        "column_suspect",
        "columns named y, x, z",
        Some("x, y"),
        |_, p| p.swap(0, 1),
    ),
    (
        "column_suspect",
        "z has the wrong sign",
        Some("z"),
        |_, p| p[2] = -p[2],
    ),
    // The mirror image of this arm in its own plane equals the same arm with KUKA's signs.
    (
        "joint_map_suspect",
        "It fits as well if y has the wrong sign",
        Some("q1, q4, q6"),
        |_, p| p[1] = -p[1],
    ),
    (
        "column_suspect",
        "joints 2 and 3 are exchanged",
        Some("q2, q3"),
        |q, _| q.swap(1, 2),
    ),
    (
        "joint_map_suspect",
        "joint 3 is counted the other way round",
        Some("q3"),
        |q, _| q[2] = -q[2],
    ),
];

/// Points of the paper's set in JSON, distorted from some row on.
fn distorted(first: usize, distort: fn(&mut [f64; 6], &mut [f64; 3])) -> Value {
    let number = |cell: &String| cell.parse::<f64>().unwrap();
    let cells = cells();
    let points = cells[1 + first..].iter().map(|row| {
        let (mut q, mut p) = ([0.0; 6], [0.0; 3]);
        q.iter_mut()
            .zip(&row[2..8])
            .for_each(|(q, cell)| *q = number(cell));
        p.iter_mut()
            .zip(&row[8..11])
            .for_each(|(p, cell)| *p = number(cell));
        distort(&mut q, &mut p);
        json!({"q_deg": q, "position_mm": p})
    });
    json!({"frame": "base", "points": points.collect::<Vec<_>>()})
}

#[tokio::test]
async fn files_that_are_wrong_as_a_whole_are_answered_with_the_best_hypothesis() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    for (code, words, column, distort) in DISTORTIONS {
        for first in 0..FILES_PER_CLASS {
            let answer = app
                .post_json(
                    &format!("{robot}/measurement-sets"),
                    &distorted(4 * first, *distort),
                )
                .await;
            let problem = answer.problem(422, code);
            assert!(text(&problem["detail"]).contains(words), "{problem}");
            assert_eq!(
                problem["errors"][0]["column"].as_str(),
                *column,
                "{problem}"
            );
        }
    }
    nothing_is_stored(&app, &robot).await;
}

#[tokio::test]
async fn a_set_of_another_robot_on_this_server_is_sent_to_it() {
    let app = TestApp::spawn().await;
    let (right, _) = app.robot_with_set("first.csv").await;
    let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    body["links"][2]["a_mm"] = json!(1075.0);
    body["links"][3]["d_mm"] = json!(1280.0);
    let wrong = format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &body).await.ok(201)["id"])
    );
    let upload = app
        .post(
            &format!("{wrong}/measurement-sets?frame=base"),
            "text/csv",
            paper("first.csv"),
        )
        .await;
    let problem = upload.problem(422, "robot_mismatch");
    let name = text(&app.get(&right).await.ok(200)["name"]).to_owned();
    assert!(text(&problem["detail"]).contains(&name), "{problem}");
    nothing_is_stored(&app, &wrong).await;
}

#[tokio::test]
async fn an_unmastered_joint_is_kept_with_a_warning_that_names_it() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    for first in 0..FILES_PER_CLASS {
        let set = app
            .post_json(
                &format!("{robot}/measurement-sets"),
                &distorted(first, |q, _| q[2] += 5.0),
            )
            .await
            .ok(201);
        let warning = set["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .find(|warning| warning["code"] == "joint_offset_suspect");
        assert!(
            text(&warning.unwrap()["detail"]).contains("(joint 3)"),
            "{set}"
        );
    }
}

#[tokio::test]
async fn few_and_repeated_poses_warn_and_are_not_identified_from() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    for n in 1..=FILES_PER_CLASS / 2 {
        let few = cells()[..=n].to_vec();
        // Repeated measurements differ in the last digits.
        let again = |i: usize| {
            let mut row = cells()[1 + i % n].clone();
            row.last_mut().unwrap().push_str(&format!("{i:02}"));
            row
        };
        let repeated: Vec<Vec<String>> = cells()[..1]
            .iter()
            .cloned()
            .chain((0..60).map(again))
            .collect();
        for (cells, also) in [(few, None), (repeated, Some("duplicate_poses"))] {
            let set = app.upload_csv(&robot, "frame=base", csv(&cells)).await;
            let codes: Vec<&str> = set["warnings"]
                .as_array()
                .unwrap()
                .iter()
                .map(|warning| text(&warning["code"]))
                .collect();
            assert!(
                codes.contains(&"under_determined")
                    && also.is_none_or(|also| codes.contains(&also)),
                "{n}: {codes:?}"
            );
            let job = json!({"measurement_set_id": set["id"]});
            let problem = app
                .post_json(&format!("{robot}/jobs"), &job)
                .await
                .problem(422, "under_determined");
            let detail = text(&problem["detail"]);
            assert!(
                detail.contains("alpha_1 and") && detail.contains("more configurations"),
                "it names parameters and poses: {detail}"
            );
        }
    }
}

/// The set as a German spreadsheet exports it.
fn with_decimal_commas(cells: &[Vec<String>]) -> Vec<u8> {
    String::from_utf8(csv(cells))
        .unwrap()
        .replace(',', ";")
        .replace('.', ",")
        .into_bytes()
}

#[tokio::test]
async fn a_decimal_comma_is_read_declared_or_not_and_never_against_what_is_declared() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let upload = format!("{robot}/measurement-sets?frame=base");
    let german = with_decimal_commas(&cells());
    for (path, content_type) in [
        (format!("{upload}&decimal=comma"), "text/csv; charset=utf-8"),
        (upload.clone(), "text/csv; charset=utf-8; Decimal=Comma"),
        (
            upload.clone(),
            "text/csv; note=\"decimal=comma is not declared\"",
        ),
    ] {
        let set = app.post(&path, content_type, german.clone()).await.ok(201);
        let points = app
            .get(&format!("/v1/measurement-sets/{}/points", text(&set["id"])))
            .await;
        assert_eq!(points.bytes, german, "kept as it came");
        assert!(
            points
                .header("content-type")
                .unwrap()
                .to_lowercase()
                .contains("decimal=comma"),
            "and says how it is to be read"
        );
        // The worker parses the same numbers as from the file with decimal points.
        let plain = app.upload(&robot, "first.csv").await;
        let mut results = Vec::new();
        for id in [text(&set["id"]), &plain] {
            let job = app
                .run(
                    &robot,
                    &json!({"measurement_set_id": id, "method": "least_squares"}),
                )
                .await;
            assert_eq!(job["status"], "succeeded", "{job}");
            let report = app.report(&job).await;
            results.push((
                report["cost_mm2"].clone(),
                report["parameters"].clone(),
                report["verify"].clone(),
            ));
        }
        assert_eq!(results[0], results[1]);
    }
    let n_stored = app.get(&format!("{robot}/measurement-sets")).await.ok(200)["items"]
        .as_array()
        .unwrap()
        .len();
    let mut thousands = cells();
    thousands[1][8] = "1234.5".into();
    let with_point = |text: &str| {
        let commas = String::from_utf8(with_decimal_commas(&thousands)).unwrap();
        commas.replacen("1234,5", text, 1).into_bytes()
    };
    let comma = format!("{upload}&decimal=comma");
    // groups of three before a comma can only be thousands
    app.post(&comma, "text/csv", with_point("1.234,5"))
        .await
        .ok(201);
    let n_stored = n_stored + 1;
    for (path, body, code) in [
        (format!("{upload}&decimal=point"), german, "decimal_comma"),
        (
            format!("{upload}&decimal=comma"),
            csv(&cells()),
            "wrong_separator",
        ),
        (comma, with_point("1234.5"), "decimal_point"),
    ] {
        let problem = app
            .post(&path, "text/csv", body)
            .await
            .problem(422, "invalid_measurements");
        assert_eq!(problem["errors"][0]["code"], code, "{problem}");
    }
    assert_eq!(
        app.get(&format!("{robot}/measurement-sets")).await.ok(200)["items"]
            .as_array()
            .unwrap()
            .len(),
        n_stored
    );
}

#[tokio::test]
async fn a_byte_order_mark_and_windows_line_ends_are_no_fault() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let plain = String::from_utf8(csv(&cells())).unwrap();
    for body in [
        plain.replace('\n', "\r\n"),
        format!("\u{feff}{plain}"),
        format!("\u{feff}{}\r\n\r\n", plain.replace('\n', "\r\n")),
    ] {
        let set = app.upload_csv(&robot, "frame=base", body).await;
        assert_eq!(
            (&set["n_points"], &set["warnings"]),
            (&json!(100), &json!([]))
        );
    }
}
