//! Rows that a judgement, a weight, a remark, the name of a point or a strike puts aside, and rows of statistics and tolerances without a name.

use super::put_aside::with_column;
use super::traps::{deviation, is_read, mean, named_rows, refused_as};
use super::*;

#[test]
fn rows_that_failed_are_not_taken_silently() {
    type Cells = fn(usize) -> Vec<String>;
    macro_rules! of {
        ($bad:literal, $good:literal) => {
            |row| vec![if row == 4 { $bad } else { $good }.into()]
        };
    }
    let columns: [(&str, &str, Cells); 16] = [
        ("Result", "FAIL", of!("FAIL", "PASS")),
        ("Test", "Fail", of!("Fail", "Pass")),
        ("Anything", "failed", of!("failed", "passed")),
        ("Measured?", "N", of!("N", "Y")),
        ("Result", "no", of!("no", "yes")),
        ("Gemessen", "nein", of!("nein", "ja")),
        ("Bewertung", "n.i.O.", of!("n.i.O.", "i.O.")),
        ("Type", "calculated", of!("calculated", "measured")),
        ("Weight", "0", of!("0", "1")),
        ("Weight", "0.0", of!("0.0", "0.75")),
        ("Gewicht", "0", of!("0", "1")),
        ("Remark", "do not use", of!("do not use", "")),
        ("Comment", "Bad", of!("Bad", "")),
        ("Comment", "Beam broken twice", of!("Beam broken twice", "")),
        (
            "Bemerkung",
            "bitte nicht verwenden!",
            of!("bitte nicht verwenden!", "warm"),
        ),
        ("Valid", "invalid", of!("invalid", "valid")),
    ];
    for (name, cell, back) in columns {
        let text = with_column(name, back);
        refused_as(name, &text, "two_readings", &format!("row 4 has {cell:?}"));
        let (set, _) = read(text.as_bytes(), &format!("\"ignore\": [{name:?}]")).unwrap();
        is_true(name, &set);
    }
    let taken: [(&str, Cells); 6] = [
        ("Test", |row| vec![format!("T{}", row % 3)]),
        ("Result", of!("0.02", "0.03")),
        ("Test", of!("fail", "fail")),
        ("Weight", of!("0.5", "1")),
        ("Payload weight [kg]", of!("0", "5")),
        ("Gripper", of!("no", "yes")),
    ];
    for (name, back) in taken {
        is_read(name, &with_column(name, back));
    }
}

#[test]
fn points_whose_names_say_that_they_do_not_count_are_not_taken_silently() {
    type NamesOfRow = fn(usize) -> Vec<String>;
    let names: [(&str, NamesOfRow); 3] = [
        ("BAD_P5", |row| {
            vec![if row == 4 {
                "BAD_P5".into()
            } else {
                format!("P{row}")
            }]
        }),
        ("P5 (bad)", |row| {
            vec![if row == 4 {
                "P5 (bad)".into()
            } else {
                format!("P{row}")
            }]
        }),
        ("P5 NOK", |row| {
            vec![if row == 4 {
                "P5 NOK".into()
            } else {
                format!("P{row}")
            }]
        }),
    ];
    for (name, front) in names {
        let mut table = named_rows();
        table.front = front;
        refused_as(name, &table.text(), "two_readings", &format!("4 {name:?}"));
    }
    let mut table = named_rows();
    table.front = |row| vec![format!("Bad Aibling {row}")];
    is_read("a place", &table.text());
    table.front = |row| vec![format!("badge{row}")];
    is_read("part of a word", &table.text());
}

#[test]
fn struck_rows_and_formulas_without_a_value_are_told() {
    let table = named_rows();
    let cells: Vec<Vec<String>> = std::iter::once(table.header.clone())
        .chain(table.rows())
        .collect();
    let cell = |place: &str, style: &str, text: &str| match text.parse::<f64>() {
        Ok(value) => format!("<c r=\"{place}\"{style}><v>{value}</v></c>"),
        Err(_) => format!("<c r=\"{place}\"{style} t=\"inlineStr\"><is><t>{text}</t></is></c>"),
    };
    let bytes = workbooks::xlsx_of_cells(&cells, |_, place, text| cell(place, "", text));
    is_true("plain", &read(&bytes, "").unwrap().0);
    let bytes = workbooks::xlsx_of_cells(&cells, |row, place, text| {
        cell(
            place,
            if row == 5 || row == 7 {
                " s=\"1\""
            } else {
                " s=\"0\""
            },
            text,
        )
    });
    let error = read(&bytes, "").unwrap_err();
    let issue = &error.issues[0];
    assert_eq!((issue.code.as_str(), issue.line), ("struck_rows", Some(6)));
    assert!(issue.detail.contains("struck through: 6, 8."), "{issue:?}");
    for value in ["", "<v></v>", "<v/>"] {
        let bytes = workbooks::xlsx_of_cells(&cells, |row, place, text| match (row, place) {
            (3, "J4") => format!("<c r=\"{place}\"><f>A1+1</f>{value}</c>"),
            _ => cell(place, "", text),
        });
        let error = read(&bytes, "").unwrap_err();
        let issue = &error.issues[0];
        assert_eq!(
            (issue.code.as_str(), issue.row),
            ("not_a_number", Some(2)),
            "{error:?}"
        );
        assert!(
            issue
                .detail
                .contains("open the workbook in a spreadsheet program"),
            "{issue:?}"
        );
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// The cell of a column, from its number and its values.
type Cell<'a> = &'a dyn Fn(usize, &[f64]) -> String;

/// Rows behind the table, of the values of each column.
fn with_rows(rows: &[Cell<'_>]) -> String {
    let column = |at: usize| -> Vec<f64> {
        let rows = truth().into_iter();
        rows.map(|(q, p)| if at < 6 { q[at] } else { p[at - 6] })
            .collect()
    };
    let row = |of: &&dyn Fn(usize, &[f64]) -> String| {
        let cells: Vec<String> = (0..9).map(|at| of(at, &column(at))).collect();
        format!(",{}\n", cells.join(","))
    };
    named_rows().text() + &rows.iter().map(row).collect::<String>()
}

#[test]
fn statistics_and_tolerances_without_a_name_are_no_measurements() {
    let exact =
        |of: fn(&[f64]) -> f64| move |_: usize, values: &[f64]| format!("{:.4}", of(values));
    let tolerance = |at: usize, _: &[f64]| if at < 6 { "0" } else { "0.01" }.to_owned();
    let other = |at: usize, _: &[f64]| if at < 6 { "0.01" } else { "0.05" }.to_owned();
    let count = |_: usize, _: &[f64]| "9".to_owned();
    let (mean_of, std_of, median_of, rms_of) =
        (exact(mean), exact(deviation), exact(median), exact(rms));
    let rounded = |_: usize, values: &[f64]| format!("{:.0}", mean(values));
    let one = |_: usize, values: &[f64]| format!("{:.1}", mean(values));
    let cases: [(&str, &str, &[Cell<'_>]); 8] = [
        (
            "mean and tolerance",
            "row 9 is the mean",
            &[&mean_of, &tolerance],
        ),
        (
            "tolerance and mean",
            "row 9 has one number",
            &[&tolerance, &mean_of],
        ),
        (
            "mean, std, tolerance",
            "row 9 is the mean",
            &[&mean_of, &std_of, &other],
        ),
        (
            "median and rms",
            "row 9 is the median",
            &[&median_of, &rms_of],
        ),
        ("median", "row 9 is the median", &[&median_of]),
        ("whole mean", "row 9 is the mean", &[&rounded]),
        ("coarse mean", "row 9 is the mean", &[&one]),
        ("tolerance alone", "row 9 has one number", &[&other]),
    ];
    for (name, hint, rows) in cases {
        refused_as(name, &with_rows(rows), "summary_row", hint);
    }
    // whole numbers in all coordinates are no position, either
    let error = read(with_rows(&[&count]).as_bytes(), "").unwrap_err();
    assert!(["summary_row", "not_measured"].contains(&error.issues[0].code.as_str()));
    // A robot that returns to one pose after each other: the pose is the median of all columns.
    let home = "P,10,20,30,40,50,60,1000.5000,200.2500,300.7500\n";
    let rows: String = named_rows()
        .text()
        .lines()
        .skip(1)
        .map(|row| format!("{row}\n{home}"))
        .collect();
    let noisy: String = rows
        .lines()
        .enumerate()
        .map(|(at, row)| format!("{row}{}\n", at % 7))
        .collect();
    let text = format!("{}\n{noisy}", named_rows().header.join(","));
    assert_eq!(
        read(text.as_bytes(), "").unwrap().0.points.len(),
        2 * N_ROWS
    );
}
