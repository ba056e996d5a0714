//! Rows, columns and tables that are no measurements by what stands beside or above them.

use super::traps::{is_read, named_rows, refused_as, with_remarks};
use super::*;

/// A table with one more column behind.
pub(super) fn with_column(name: &str, back: fn(usize) -> Vec<String>) -> String {
    let mut table = with_remarks(back);
    *table.header.last_mut().unwrap() = name.to_owned();
    table.text()
}

#[test]
fn rows_that_somebody_put_aside_are_not_taken_silently() {
    type Cells = fn(usize) -> Vec<String>;
    let columns: [(&str, &str, Cells); 10] = [
        ("Deleted", "x", |row| {
            vec![if row == 4 { "x" } else { "" }.into()]
        }),
        ("Status", "NOK", |row| {
            vec![if row == 4 { "NOK" } else { "OK" }.into()]
        }),
        ("Valid", "0", |row| {
            vec![if row == 4 { "0" } else { "1" }.into()]
        }),
        ("Use?", "no", |row| {
            vec![if row == 4 { "no" } else { "yes" }.into()]
        }),
        ("Outlier", "TRUE", |row| {
            vec![if row == 4 { "TRUE" } else { "FALSE" }.into()]
        }),
        ("Quality flag", "3", |row| {
            vec![if row == 4 { "3" } else { "0" }.into()]
        }),
        ("Valid samples", "0", |row| {
            vec![if row == 4 { "0" } else { "100" }.into()]
        }),
        ("Bemerkung", "ungültig", |row| {
            vec![if row == 4 { "ungültig" } else { "warm" }.into()]
        }),
        ("", "x", |row| vec![if row == 4 { "x" } else { "" }.into()]),
        ("Sel.", "*", |row| {
            vec![if row == 4 { "*" } else { "" }.into()]
        }),
    ];
    for (name, cell, back) in columns {
        let text = with_column(name, back);
        refused_as(name, &text, "two_readings", &format!("row 4 has {cell:?}"));
        let error = read(text.as_bytes(), "").unwrap_err();
        assert_eq!(error.issues[0].line, Some(6), "{error:?}");
        // what the refusal names
        let column = match name {
            "" => "11".to_owned(),
            name => format!("{name:?}"),
        };
        let ignore = format!("\"ignore\": [{column}]");
        assert!(error.issues[0].detail.contains(&ignore), "{error:?}");
        let (set, reading) = read(text.as_bytes(), &ignore).unwrap();
        is_true(name, &set);
        is_read_again(name, text.as_bytes(), &set, &reading.unwrap());
    }
    let taken: [(&str, Cells); 5] = [
        ("Valid samples", |row| {
            vec![if row == 4 { "99" } else { "100" }.into()]
        }),
        ("Status", |_| vec!["OK".into()]),
        ("Quality", |row| vec![format!("0.9{row}")]),
        ("Quality", |row| {
            vec![if row == 4 { "0.98" } else { "0.99" }.into()]
        }),
        ("Comment", |row| {
            vec![if row == 4 { "bad light" } else { "" }.into()]
        }),
    ];
    for (name, back) in taken {
        is_read(name, &with_column(name, back));
    }
}

/// The table with three columns in front of its position, under a line of groups.
fn in_groups(groups: [&str; 3], separator: &'static str) -> String {
    let table = Written {
        separator,
        ..named_rows()
    };
    let more = |cells: &[String], three: [&str; 3]| {
        let three = three.map(str::to_owned);
        [&cells[..7], &three, &cells[7..]].concat().join(separator)
    };
    let mut above = vec![""; 13];
    (above[1], above[7], above[10]) = (groups[0], groups[1], groups[2]);
    let rows = table.rows();
    let rows = rows.iter().map(|row| more(row, ["1.0", "2.0", "3.0"]));
    let lines = [above.join(separator), more(&table.header, MM)]
        .into_iter()
        .chain(rows);
    lines.map(|line| line + "\n").collect()
}

#[test]
fn columns_under_a_group_that_was_not_measured_are_left_aside() {
    for groups in [
        ["Robot", "Nominal", "Measured"],
        ["", "Soll", "Ist"],
        ["Commanded", "Deviation", "Tracker"],
        ["Joints", "TCP", "Laser tracker"],
        ["Actual joints", "Design", "Actual"],
    ] {
        for separator in [",", ";", "\t"] {
            is_read(groups[1], &in_groups(groups, separator));
        }
    }
    // Nothing says which of both was measured.
    refused_as(
        "A and B",
        &in_groups(["Robot", "A", "B"], ","),
        "duplicate_column",
        "appears twice",
    );
    // Without the measured ones.
    let text = in_groups(["Robot", "Nominal", "Measured"], ",");
    let cut: String = text
        .lines()
        .map(|line| line.split(',').take(10).collect::<Vec<_>>().join(",") + "\n")
        .collect();
    refused_as(
        "nominal alone",
        &cut,
        "missing_column",
        "{\"x_mm\": \"COLUMN\"}",
    );
    let cut = cut.replace("Nominal", "TCP");
    refused_as(
        "the controller's own",
        &cut,
        "missing_column",
        "{\"x_mm\": \"COLUMN\"}",
    );
    // A title, and a group of joints.
    is_read("a title", &format!("Nominal tool\n{}", named_rows().text()));
    is_read(
        "joints",
        &format!(",Commanded joints,,,,,,,,\n{}", named_rows().text()),
    );
}

#[test]
fn rows_above_the_header_are_not_left_out_silently() {
    let upper = named_rows().text();
    let mut lower = with_remarks(|_| vec!["west".into()]);
    lower.header[10] = "station".into();
    let text = format!("{upper}\nPredicted\n{}", lower.text());
    refused_as(
        "two tables",
        &text,
        "two_readings",
        "lines 2 to 10 look like rows",
    );
    let (set, _) = read(text.as_bytes(), "\"header_row\": 13").unwrap();
    is_true("the lower one", &set);
}

#[test]
fn a_header_within_the_rows_is_told_as_such() {
    let text = named_rows().text();
    let twice = format!("{text}{text}");
    refused_as("twice", &twice, "not_a_number", "is the name of the column");
}

#[test]
fn one_whole_number_in_all_coordinates_was_not_measured() {
    let text = named_rows().text() + "P10,1,2,3,4,5,6,-1,-1,-1\n";
    refused_as("-1", &text, "not_measured", "-1, -1, -1");
    let text = named_rows().text() + "P10,1,2,3,4,5,6,100.5,100.5,100.5\n";
    assert!(read(text.as_bytes(), "").is_ok());
}

#[test]
fn a_hidden_sheet_is_read_only_if_it_is_named() {
    let table = named_rows();
    let cells: Vec<Vec<String>> = std::iter::once(table.header.clone())
        .chain(table.rows())
        .collect();
    let sheets: [(&str, &[Vec<String>]); 2] = [("Old", &cells[..4]), ("Data", &cells)];
    let bytes = workbooks::xlsx_with_hidden(&sheets, "Old", &[]);
    let (set, reading) = read(&bytes, "").unwrap();
    is_true("the shown sheet", &set);
    assert_eq!(
        reading.unwrap().understood.unwrap().sheet.as_deref(),
        Some("Data")
    );
    assert_eq!(
        read(&bytes, "\"sheet\": \"Old\"").unwrap().0.points.len(),
        3
    );
    let bytes = workbooks::xlsx_with_hidden(&sheets[1..], "Data", &[]);
    is_true("hidden alone", &read(&bytes, "").unwrap().0);
}

#[test]
fn hidden_rows_of_a_workbook_are_not_taken_silently() {
    let table = named_rows();
    let cells: Vec<Vec<String>> = std::iter::once(table.header.clone())
        .chain(table.rows())
        .collect();
    let sheets: [(&str, &[Vec<String>]); 1] = [("Data", &cells)];
    for bytes in [
        workbooks::xlsx_with_hidden(&sheets, "", &[3, 7]),
        workbooks::ods_with_hidden(&sheets, "filter", &[3, 7]),
        workbooks::ods_with_hidden(&sheets, "collapse", &[3, 7]),
    ] {
        let error = read(&bytes, "").unwrap_err();
        let issue = &error.issues[0];
        assert_eq!((issue.code.as_str(), issue.line), ("hidden_rows", Some(3)));
        assert!(issue.detail.contains("by hand: 3, 7."), "{issue:?}");
        assert!(issue.detail.contains("show all rows, or delete"));
        // What was stored before is read as it was.
        let shown = workbooks::xlsx(&sheets);
        let (set, reading) = read(&shown, "").unwrap();
        is_read_again("stored", &bytes, &set, &reading.unwrap());
    }
    let mut with_empty = cells.clone();
    with_empty.insert(4, vec![]);
    let sheets: [(&str, &[Vec<String>]); 1] = [("Data", &with_empty)];
    for bytes in [
        workbooks::xlsx_with_hidden(&sheets, "", &[5]),
        workbooks::ods_with_hidden(&sheets, "collapse", &[5]),
    ] {
        is_true("an empty row", &read(&bytes, "").unwrap().0);
    }
}
