//! Tables without a row for each point, units that contradict each other, and lists of joint values of robots.

use super::traps::{named_rows, refused_as};
use super::*;
use kincal::measurement::columns::mapping::{Mapping, Needs};
use kincal::measurement::csv::ParseError;
use kincal::measurement::table::points::{Content, TableOptions};
use kincal::measurement::table::text::Source;

#[test]
fn other_layouts_are_refused_with_how_to_write_them() {
    let table = Written {
        header: header(DEG, MM),
        ..Written::default()
    };
    let rows = table.rows();
    let line = |(at, name): (usize, &String)| {
        let cells = rows.iter().map(|row| row[at].clone()).collect::<Vec<_>>();
        format!("{name},{}\n", cells.join(","))
    };
    let transposed: String = table.header.iter().enumerate().map(line).collect();
    refused_as(
        "transposed",
        &transposed,
        "missing_column",
        "the table is transposed",
    );
    let mut long =
        "Name;J1 [deg];J2 [deg];J3 [deg];J4 [deg];J5 [deg];J6 [deg];Control;Nom;Meas\n".to_owned();
    for (row, (q, p)) in truth().into_iter().enumerate() {
        for (axis, value) in ["X", "Y", "Z"].iter().zip(p) {
            long += &format!(
                "P{row};{};{axis};{};{}\n",
                q.map(four).join(";"),
                four(value),
                four(value)
            );
        }
    }
    refused_as("long", &long, "missing_column", "each point has three rows");
    let labelled: String = (truth().into_iter().enumerate())
        .map(|(row, (q, _))| {
            let cells: Vec<String> = (1..).zip(q).map(|(j, v)| format!("A{j}={v:.4}")).collect();
            format!("10:{row:02}:11 P{row} {}\n", cells.join(" "))
        })
        .collect();
    refused_as(
        "labelled",
        &labelled,
        "missing_column",
        "names beside their numbers",
    );
    let html = format!(
        "<html><table><tr><td>{}</td></tr></table></html>",
        own_header().join("</td><td>")
    );
    refused_as("html", &html, "not_csv", "save it as xlsx");
}

#[test]
fn a_unit_in_the_name_and_another_below_it_are_told() {
    let table = named_rows().text();
    let (names, rows) = table.split_once('\n').unwrap();
    let text = format!("{names}\n,deg,deg,deg,deg,deg,deg,m,m,m\n{rows}");
    refused_as(
        "mm and m",
        &text,
        "two_readings",
        "another in the row of units below it",
    );
    let text = format!("{names}\n,deg,deg,deg,deg,deg,deg,mm,mm,mm\n{rows}");
    is_true("alike", &read(text.as_bytes(), "").unwrap().0);
}

/// The joint values of a robot's file.
fn joints(text: &str) -> Result<Content, ParseError> {
    let options = TableOptions {
        mapping: &Mapping::default(),
        n_joints: 6,
        needs: Needs::Joints,
        rotation: None,
        is_time: |_| true,
        are_targets: false,
    };
    kincal::measurement::table::points::read(Source::from_bytes(text.as_bytes())?, &options)
}

fn are_true(text: &str, tolerance_deg: f64) {
    let content = joints(text).unwrap_or_else(|error| panic!("{error:?}\n{text}"));
    assert_eq!(content.points.len(), N_ROWS);
    for (point, (q, _)) in content.points.iter().zip(truth()) {
        for (read, meant) in point.q_rad.iter().zip(q) {
            assert!((read.to_degrees() - meant).abs() < tolerance_deg, "{text}");
        }
    }
}

fn lines(line: impl Fn(usize, [f64; 6]) -> String) -> String {
    let rows = truth().into_iter().enumerate();
    rows.map(|(row, (q, _))| line(row + 1, q) + "\n").collect()
}

fn axes(q: [f64; 6]) -> String {
    let axes = (1..).zip(q).map(|(axis, deg)| format!("A{axis} {deg:.4}"));
    axes.collect::<Vec<_>>().join(",")
}

#[test]
fn lists_of_joint_values_of_robots_are_read() {
    let array = lines(|row, q| format!("CALP[{row}]={{E6AXIS: {},E1 0.0}}", axes(q)));
    are_true(
        &format!("DEFDAT CAL\nDECL E6AXIS CALP[40]\n{array}ENDDAT\n"),
        ROUNDING,
    );
    are_true(
        &format!("DEF CAL()\n{}END\n", array.replace("E6AXIS: ", "")),
        ROUNDING,
    );
    are_true(&lines(|row, q| format!("P{row}={{{}}}", axes(q))), ROUNDING);
    let radians = |q: [f64; 6]| q.map(|deg| format!("{:.8}", deg.to_radians())).join(", ");
    let script = lines(|row, q| format!("  P{row}=[{}]\n  movej(P{row})", radians(q)));
    are_true(&format!("def cal():\n{script}end\n"), 1e-6);
    let error = joints(&lines(|row, q| format!("P{row}=[{}]", radians(q)))).unwrap_err();
    assert_eq!(error.issues[0].code, "missing_unit");
}

#[test]
fn external_axes_are_named_and_must_not_move() {
    let external = |at: fn(usize) -> f64| {
        [
            lines(|row, q| {
                format!(
                    "DECL E6AXIS XP{row}={{{},E1 {:.2},E2 0.0}}",
                    axes(q),
                    at(row)
                )
            }),
            lines(|row, q| {
                let angles = q.map(four).join(",");
                format!(
                    "CONST jointtarget P{row}:=[[{angles}],[{:.2},9E9,9E9,9E9,9E9,9E9]];",
                    at(row)
                )
            }),
            format!(
                "/PROG CAL\n/POS\n{}/END\n",
                lines(|row, q| {
                    let angles: Vec<String> = (1..)
                        .zip(q)
                        .map(|(j, v)| format!("\tJ{j}= {v:.4} deg"))
                        .collect();
                    format!(
                        "P[{row}]{{\n   GP1:\n\tUF : 0, UT : 1,\n{},\n\tE1= {:.2} mm\n}};",
                        angles.join(","),
                        at(row)
                    )
                })
            ),
        ]
    };
    for text in external(|_| 0.0) {
        are_true(&text, ROUNDING);
        assert!(joints(&text).unwrap().understood.unread.is_empty());
    }
    for text in external(|_| 500.0) {
        let content = joints(&text).unwrap();
        let unread = &content.understood.unread;
        assert_eq!(unread.len(), 1, "{text}");
        assert!(unread[0].reason.as_str().contains("stands at one value"));
    }
    for at in [
        |row: usize| row as f64 * 50.0,
        |row: usize| 0.3 * (row % 2) as f64,
    ] {
        for text in external(at) {
            let error = joints(&text).unwrap_err();
            let issue = &error.issues[0];
            assert_eq!(issue.code, "external_axis_moves", "{issue:?}");
            assert!(issue.detail.contains("a program of its own"), "{issue:?}");
        }
    }
}

#[test]
fn a_workbook_with_a_sheet_for_robot_and_instrument_names_both() {
    let table = named_rows();
    let cells: Vec<Vec<String>> = std::iter::once(table.header.clone())
        .chain(table.rows())
        .collect();
    let joints: Vec<Vec<String>> = cells.iter().map(|row| row[..7].to_vec()).collect();
    for names in [["Robot", "Tracker"], ["Tracker", "Robot"]] {
        let bytes = workbooks::xlsx(&[(names[0], &joints), (names[1], &cells)]);
        let error = read(&bytes, "").unwrap_err();
        let mapping = "in the column mapping: {\"robot\": {\"sheet\": \"Robot\"}, \"instrument\": {\"sheet\": \"Tracker\"}}";
        assert!(error.issues[0].detail.contains(mapping), "{error:?}");
    }
}
