//! Files whose header has the meanings of their columns, and the split: accepted files, and refusals with row, column and a hint.

use crate::data::paper_path;
use kincal::measurement::csv::{MAX_ISSUES, ParseError};
use kincal::measurement::table::own_form::parse;
use kincal::measurement::{Frame, MeasurementSet, Point, Subset, split};
use proptest::prelude::*;

const HEADER: &str = "q1_deg,q2_deg,x_mm,y_mm,z_mm";

fn two_joints(text: &str) -> Result<MeasurementSet, ParseError> {
    parse(text.as_bytes(), Frame::Instrument, 2)
}

/// Code, row and column of the first issue.
fn first_issue(text: &[u8]) -> (&'static str, Option<usize>, Option<String>) {
    let error = parse(text, Frame::Instrument, 2).expect_err("must be refused");
    let issue = &error.issues[0];
    assert!(
        issue.detail.len() > 10,
        "an error explains itself: {issue:?}"
    );
    (issue.code, issue.row, issue.column.clone())
}

fn cell(row: &str) -> (&'static str, Option<usize>, Option<String>) {
    first_issue(format!("{HEADER}\n1,2,3,4,5\n{row}\n").as_bytes())
}

#[test]
fn units_are_read_from_the_headers_and_order_is_free() {
    let mm_deg = two_joints("q1_deg,q2_deg,x_mm,y_mm,z_mm\n180,-90,1000,2000,3000\n").unwrap();
    let m_rad =
        two_joints("z_m,q2_rad,y_m,q1_rad,x_m\n3,-1.5707963267948966,2,3.141592653589793,1\n")
            .unwrap();
    assert_eq!(mm_deg.points[0].position_mm, m_rad.points[0].position_mm);
    assert!(
        mm_deg.points[0]
            .q_rad
            .iter()
            .zip(&m_rad.points[0].q_rad)
            .all(|(a, b)| (a - b).abs() < 1e-15)
    );
}

#[test]
fn byte_order_mark_crlf_blank_ends_and_quotes_are_accepted() {
    let set = two_joints(
        "\u{feff}q1_deg, q2_deg,x_mm,y_mm,z_mm,station\r\n1,2,3,4,5,\"hall 2, east\"\r\n\r\n",
    )
    .unwrap();
    assert_eq!(set.points.len(), 1);
    assert_eq!(set.points[0].station.as_deref(), Some("hall 2, east"));
}

#[test]
fn a_label_is_there_in_every_row_or_in_none() {
    for column in ["station", "session", "configuration", "measured_at"] {
        let issues = two_joints(&format!("{HEADER},{column}\n1,2,3,4,5,a\n1,3,3,4,5,\n"))
            .unwrap_err()
            .issues;
        let found: Vec<_> = issues
            .iter()
            .map(|issue| (issue.row, issue.column.as_deref(), issue.code))
            .collect();
        assert_eq!(found, [(Some(1), Some(column), "empty_cell")]);
        assert!(
            issues[0].detail.contains("leave the column out"),
            "{}",
            issues[0].detail
        );
    }
}

#[test]
fn every_optional_column_is_kept() {
    let text = "q1_deg,q2_deg,x_mm,y_mm,z_mm,configuration,target,subset,measured_at,std_mm,station,session,sequence,temperature_c,sweep_joint\n\
                1,2,3,4,5,c7,2,verify,2026-03-01T10:00:00Z,0.02,s1,morning,17,21.5,2\n";
    let p = &two_joints(text).unwrap().points[0];
    assert_eq!(
        (p.configuration.as_str(), p.target, p.subset, p.std_mm),
        ("c7", 2, Some(Subset::Verify), Some(0.02))
    );
    assert_eq!(
        (
            p.station.as_deref(),
            p.session.as_deref(),
            p.sequence,
            p.temperature_c
        ),
        (Some("s1"), Some("morning"), 17, Some(21.5))
    );
    assert_eq!(p.sweep_joint, Some(2));
}

#[test]
fn rows_with_equal_joint_values_share_a_configuration_where_none_is_named() {
    let set = two_joints(&format!("{HEADER}\n1,2,3,4,5\n6,7,3,4,5\n1,2,3,4,6\n")).unwrap();
    let labels: Vec<&str> = set
        .points
        .iter()
        .map(|p| p.configuration.as_str())
        .collect();
    assert!(labels[0] == labels[2] && labels[0] != labels[1]);
    assert_eq!(set.configurations().len(), 2);
}

#[test]
fn rows_of_an_arm_that_holds_still_are_one_configuration_though_its_encoders_flicker() {
    let row = |q1: f64, q2: f64| format!("{q1},{q2},3,4,5\n");
    for q1 in [0.0, 10.0, -77.77, 179.99] {
        let text: String = (0..40)
            .map(|i| {
                row(
                    q1 + 0.001 * f64::from(i % 7),
                    -30.0 - 0.002 * f64::from(i % 5),
                )
            })
            .collect();
        assert_eq!(
            two_joints(&format!("{HEADER}\n{text}{}", row(q1 + 0.06, -30.0)))
                .unwrap()
                .configurations()
                .len(),
            2
        );
    }
}

#[test]
fn bad_cells_are_refused_with_row_and_column() {
    let x = Some("x_mm".to_string());
    assert_eq!(cell("1,2,NaN,4,5"), ("not_finite", Some(1), x.clone()));
    assert_eq!(cell("1,2,-inf,4,5"), ("not_finite", Some(1), x.clone()));
    assert_eq!(cell("1,2,1e400,4,5"), ("not_finite", Some(1), x.clone()));
    assert_eq!(cell("1,2,,4,5"), ("empty_cell", Some(1), x.clone()));
    assert_eq!(cell("1,2,abc,4,5"), ("not_a_number", Some(1), x.clone()));
    assert_eq!(
        cell("1,2,\"3,5\",4,5"),
        ("decimal_comma", Some(1), x.clone())
    );
    assert_eq!(cell("1,2,3e9,4,5"), ("out_of_range", Some(1), x));
    assert_eq!(cell("1,2,3,4"), ("wrong_cell_count", Some(1), None));
    assert_eq!(cell("1,2,3,5,4,5"), ("wrong_cell_count", Some(1), None));
    assert_eq!(
        cell("1e6,2,3,4,5"),
        ("out_of_range", Some(1), Some("q1_deg".into()))
    );
}

#[test]
fn bad_headers_are_refused_by_name() {
    let column = |name: &str| Some(name.to_string());
    assert_eq!(
        first_issue(b"q1,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,5\n"),
        ("unknown_meaning", None, column("q1"))
    );
    assert_eq!(
        first_issue(b"q1_deg,q2_deg,x,y_mm,z_mm\n1,2,3,4,5\n"),
        ("unknown_meaning", None, column("x"))
    );
    assert_eq!(
        first_issue(b"q1_deg,x_mm,y_mm,z_mm\n1,3,4,5\n"),
        ("wrong_joint_count", None, column("q2_deg"))
    );
    assert_eq!(
        first_issue(b"q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n1,2,3,4,5,6\n"),
        ("unknown_meaning", None, column("q3_deg"))
    );
    assert_eq!(
        first_issue(b"q1_deg,q2_deg,y_mm,z_mm\n1,2,3,4\n"),
        ("missing_column", None, column("x_mm"))
    );
    assert_eq!(
        first_issue(b"q1_deg,q2_deg,x_mm,y_mm,z_mm,colour\n1,2,3,4,5,6\n"),
        ("unknown_meaning", None, column("colour"))
    );
    assert_eq!(
        first_issue(b"q1_deg,q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,1,2,3,4,5\n").0,
        "unknown_column"
    );
    assert_eq!(
        first_issue(b"q1_deg,q2_rad,x_mm,y_mm,z_mm\n1,2,3,4,5\n").0,
        "mixed_units"
    );
    assert_eq!(
        first_issue(b"q01_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,5\n").0,
        "unknown_meaning"
    );
    assert_eq!(
        first_issue(b"q1_deg;q2_deg;x_mm;y_mm;z_mm\n1;2;3;4;5\n").0,
        "unknown_meaning"
    );
}

#[test]
fn files_that_are_no_csv_are_refused() {
    assert_eq!(first_issue(b"PK\x03\x04rest").0, "not_csv");
    assert_eq!(first_issue(b"").0, "empty");
    assert_eq!(first_issue(b"q1_deg,\x00").0, "not_text");
    assert_eq!(first_issue(format!("{HEADER}\n").as_bytes()).0, "no_rows");
}

#[test]
fn a_row_without_an_end_is_refused_where_it_begins_and_quotes_are_no_row_without_an_end() {
    let rows = "1,2,3,4,5\n".repeat(20_000);
    assert_eq!(
        first_issue("1".repeat(200_000).as_bytes()),
        ("row_too_long", None, None)
    );
    assert_eq!(
        first_issue(format!("{HEADER}\n1,2,3,4,5\n1,2,3,4,{}", "5".repeat(200_000)).as_bytes()),
        ("row_too_long", Some(1), None)
    );
    // An unclosed quote makes one cell of all following rows.
    assert_eq!(
        first_issue(format!("{HEADER}\n1,2,3,4,5\r\n\r\n1,2,3,4,\"5\n{rows}").as_bytes()),
        ("row_too_long", Some(1), None)
    );
    // A quote within a cell opens nothing, so it hides nothing.
    let hidden = format!("{HEADER}\n1,2,3,4,5\"\"\n1,2,3,4,\"5\n{rows}");
    assert_eq!(
        first_issue(hidden.as_bytes()),
        ("row_too_long", Some(1), None)
    );
    // Within an unquoted cell a quote is text; in a quoted cell two quotes are one.
    let labels = format!(
        "{HEADER},station\n1,2,3,4,5,5\"\"plate\n1,2,3,4,6,\"a \"\"b\"\"\nc\"\n{}",
        "1,2,3,4,5,s\n".repeat(20_000)
    );
    let set = two_joints(&labels).unwrap();
    assert_eq!(
        (
            set.points[0].station.as_deref(),
            set.points[1].station.as_deref()
        ),
        (Some("5\"\"plate"), Some("a \"b\"\nc"))
    );
    assert_eq!(set.points.len(), 20_002);
}

#[test]
fn a_wrong_column_reports_a_bounded_number_of_issues() {
    let rows = "1,2,abc,4,5\n".repeat(1000);
    let error = two_joints(&format!("{HEADER}\n{rows}")).unwrap_err();
    assert_eq!(error.issues.len(), MAX_ISSUES);
}

#[test]
fn a_configuration_never_stands_on_both_sides() {
    let text = std::fs::read(paper_path("first.csv")).unwrap();
    let mut set = parse(&text, Frame::Base, 6).unwrap();
    for (i, p) in set.points.iter_mut().enumerate() {
        p.configuration = format!("c{}", i / 3);
    }
    for seed in 0..20 {
        let subsets = split::by_fraction(&set, 0.5, seed);
        assert_eq!(
            subsets,
            split::by_fraction(&set, 0.5, seed),
            "the same seed splits the same way"
        );
        for (i, subset) in subsets.iter().enumerate() {
            assert_eq!(*subset, subsets[i / 3 * 3]);
        }
        let verify = subsets.iter().filter(|s| **s == Subset::Verify).count();
        assert!(
            (48..=52).contains(&verify),
            "half of 34 configurations of three rows: {verify}"
        );
    }
    set.points[0].subset = Some(Subset::Verify);
    set.points[1].subset = Some(Subset::Identify);
    assert!(matches!(
        split::by_column(&set),
        Err(split::Error::ConfigurationOnBothSides { .. })
    ));
}

/// The reference station keeps six configurations to identify from, every other one three, as far as they have them; the rest is divided.
#[test]
fn every_station_keeps_enough_configurations_to_identify_from() {
    let (sizes, verify) = ([8, 1, 3, 4, 5, 6, 12, 8], [4, 0, 0, 1, 2, 3, 6, 2]);
    let mut set = MeasurementSet::new(Frame::Instrument, vec![]);
    for (station, size) in sizes.iter().enumerate() {
        for _ in 0..*size {
            let row = set.points.len();
            set.points.push(Point {
                station: Some(format!("s{station}")),
                configuration: format!("c{row}"),
                ..Point::empty(6, row)
            });
        }
    }
    for seed in 0..20 {
        let subsets = split::by_fraction(&set, 0.5, seed);
        let in_verify = |station: usize| {
            let label = format!("s{station}");
            let points = set.points.iter().zip(&subsets);
            let points = points.filter(|(p, _)| p.station.as_ref() == Some(&label));
            points.filter(|(_, side)| **side == Subset::Verify).count()
        };
        // of an instrument's frame the last station is the reference
        let found: Vec<usize> = (0..sizes.len()).map(in_verify).collect();
        assert_eq!(found, verify, "seed {seed}");
    }
}

proptest! {
    #[test]
    fn any_bytes_are_either_a_finite_set_or_an_explained_refusal(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        check_total(&bytes);
    }

    #[test]
    fn any_cells_under_a_good_header_are_either_a_finite_set_or_an_explained_refusal(cells in "[-+0-9.eE,\"\n NaIinf;]{0,200}") {
        check_total(format!("{HEADER}\n{cells}").as_bytes());
    }
}

fn check_total(bytes: &[u8]) {
    match parse(bytes, Frame::Instrument, 2) {
        Ok(set) => {
            assert!(set.points.iter().all(|p| {
                p.position_mm.iter().chain(&p.q_rad).all(|v| v.is_finite())
                    && !p.configuration.is_empty()
            }))
        }
        Err(error) => assert!(!error.issues.is_empty() && error.issues.len() <= MAX_ISSUES + 5),
    }
}
