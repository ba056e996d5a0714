//! Second positions and second joint values beside those that are read: nothing says which of both was measured.

use super::traps::{is_read, named_rows, refused_as};
use super::*;

/// The table with three more columns behind, whose names `name` makes from the axis: the controller's position, in another frame.
fn with_positions(name: &dyn Fn(&str) -> String, of: fn([f64; 3]) -> [f64; 3]) -> String {
    let table = named_rows();
    let more: Vec<String> = ["X", "Y", "Z"].map(name).into();
    let header = [table.header.clone(), more].concat().join(",");
    let rows = table.rows().into_iter().zip(truth());
    let rows = rows.map(|(row, (_, p))| {
        let cells = of(p).map(four);
        format!("{},{}\n", row.join(","), cells.join(","))
    });
    format!("{header}\n{}", rows.collect::<String>())
}

fn in_another_frame([x, y, z]: [f64; 3]) -> [f64; 3] {
    [100.0 - y + 0.1, x + 900.0, z - 300.0]
}

#[test]
fn a_second_position_is_asked_for() {
    type Name = fn(&str) -> String;
    let names: [Name; 15] = [
        |axis| format!("LT_{axis} [mm]"),
        |axis| format!("M{axis} [mm]"),
        |axis| format!("{axis}m [mm]"),
        |axis| format!("{}_lt [mm]", axis.to_lowercase()),
        |axis| format!("AT960 {axis} [mm]"),
        |axis| format!("{axis}_AT [mm]"),
        |axis| format!("{axis}2 [mm]"),
        |axis| format!("T_{axis} [mm]"),
        |axis| format!("{axis} Leica [mm]"),
        |axis| format!("{axis} real [mm]"),
        |axis| format!("{axis}corr [mm]"),
        |axis| format!("{axis}comp"),
        |axis| format!("{axis} (SMR) [mm]"),
        |axis| format!("Max {axis} [m]"),
        |axis| format!("Pos{axis}"),
    ];
    for name in names {
        let first = name("X");
        let text = with_positions(&name, in_another_frame);
        let text = match first.ends_with("[m]") {
            true => with_positions(&name, |p| in_another_frame(p).map(|mm| mm / 1000.0)),
            false => text,
        };
        let hint = format!("columns X [mm] and {first} may both be x");
        refused_as(&first, &text, "duplicate_column", &hint);
        let own = "\"x_mm\": \"X [mm]\", \"y_mm\": \"Y [mm]\", \"z_mm\": \"Z [mm]\"";
        let (set, reading) = read(text.as_bytes(), own).unwrap();
        is_true(&first, &set);
        is_read_again(&first, text.as_bytes(), &set, &reading.unwrap());
        let ignore = ["X", "Y", "Z"].map(|axis| format!("{:?}", name(axis)));
        let ignore = format!("\"ignore\": [{}]", ignore.join(", "));
        is_true(&first, &read(text.as_bytes(), &ignore).unwrap().0);
    }
}

#[test]
fn columns_that_are_plainly_no_measured_position_are_left_aside() {
    type Name = fn(&str) -> String;
    type Moved = fn([f64; 3]) -> [f64; 3];
    let names: [(Name, Moved); 10] = [
        (|axis| format!("d{axis} [mm]"), in_another_frame),
        (|axis| format!("Nominal {axis} [mm]"), in_another_frame),
        (|axis| format!("{axis}_nom [mm]"), in_another_frame),
        (|axis| format!("TCP {axis} [mm]"), in_another_frame),
        (|axis| format!("Robot {axis} [mm]"), in_another_frame),
        (|axis| format!("Dev {axis} [mm]"), in_another_frame),
        (|axis| format!("F{axis} [N]"), in_another_frame),
        (|axis| format!("{axis} speed [mm/s]"), in_another_frame),
        // moments, and the axis of a tool
        (|axis| format!("M{axis}"), |p| p.map(|mm| (mm * 0.37).sin())),
        (|axis| format!("Tool {axis}"), |_| [0.1, 0.2, 0.3]),
    ];
    for (name, of) in names {
        is_read(&name("X"), &with_positions(&name, of));
    }
}

/// The table with joint values behind its own.
fn with_joints(name: &dyn Fn(usize) -> String, of: fn(f64) -> f64) -> String {
    let table = named_rows();
    let more: Vec<String> = (1..=6).map(name).collect();
    let header = [table.header.clone(), more].concat().join(",");
    let rows = table.rows().into_iter().zip(truth());
    let rows = rows.map(|(row, (q, _))| {
        let cells = q.map(|deg| format!("{:.6}", of(deg)));
        format!("{},{}\n", row.join(","), cells.join(","))
    });
    format!("{header}\n{}", rows.collect::<String>())
}

#[test]
fn second_joint_values_are_asked_for() {
    type Name = fn(usize) -> String;
    let names: [Name; 7] = [
        |joint| format!("J{joint} feedback [deg]"),
        |joint| format!("J{joint} enc [deg]"),
        |joint| format!("FB_J{joint}"),
        |joint| format!("J{joint}m [deg]"),
        |joint| format!("Meas J{joint} [deg]"),
        |joint| format!("J{joint} real [deg]"),
        |joint| format!("enc2_{}", joint - 1),
    ];
    for name in names {
        let first = name(1);
        let text = with_joints(&name, |deg| deg + 0.02);
        let hint = format!("columns J1 [deg] and {first} may both be q1");
        refused_as(&first, &text, "duplicate_column", &hint);
        let own = (1..=6).map(|j| format!("\"q{j}_deg\": \"J{j} [deg]\""));
        let own = own.collect::<Vec<_>>().join(", ");
        is_true(&first, &read(text.as_bytes(), &own).unwrap().0);
    }
    let radians: Name = |joint| format!("J{joint} actual pos 1 [rad]");
    let text = with_joints(&radians, |deg| deg.to_radians() + 1e-4);
    refused_as("radians", &text, "duplicate_column", "may both be q1");
    // Values that are no angles of the joints, and those that were commanded.
    type Value = fn(f64) -> f64;
    let others: [(Name, Value); 4] = [
        (|joint| format!("J{joint} torque"), |deg| deg * 0.3 + 40.0),
        (|joint| format!("J{joint} error [deg]"), |_| 0.01),
        (|joint| format!("J{joint}_cmd [deg]"), |deg| deg),
        (|joint| format!("Target J{joint} [deg]"), |deg| deg),
    ];
    for (name, of) in others {
        is_read(&name(1), &with_joints(&name, of));
    }
}

/// Robot and instrument side by side: the names of the second table in another order.
fn side_by_side(order: &[usize], name: fn(usize) -> String) -> String {
    let rows = truth();
    let mut text =
        "Point,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg],,Name,X [mm],Y [mm],Z [mm]\n"
            .to_owned();
    for (row, other) in order.iter().enumerate() {
        let joints = rows[row].0.map(four).join(",");
        let position = rows[*other].1.map(four).join(",");
        text += &format!("P{},{joints},,{},{position}\n", row + 1, name(*other));
    }
    text
}

#[test]
fn tables_side_by_side_must_have_the_same_names_in_each_row() {
    let same: Vec<usize> = (0..N_ROWS).collect();
    is_read(
        "alike",
        &side_by_side(&same, |row| format!(" p_{:02} ", row + 1)),
    );
    is_read(
        "others",
        &side_by_side(&same, |row| format!("west {}", row * row)),
    );
    let mut swapped = same.clone();
    swapped.swap(6, 7);
    let text = side_by_side(&swapped, |row| format!("P{}", row + 1));
    refused_as(
        "swapped",
        &text,
        "two_readings",
        "row 6 is \"P7\" in column Point and \"P8\" in column Name",
    );
    let (_, detail) = code(&text, "").unwrap();
    assert!(detail.contains("rows 6, 7"), "{detail}");
    assert!(read(text.as_bytes(), "\"ignore\": [\"Name\"]").is_ok());
    let shifted = [0, 1, 2, 4, 5, 6, 7, 8];
    let text = side_by_side(&shifted, |row| format!("P{}", row + 1));
    refused_as("shifted", &text, "two_readings", "row 3 is \"P4\"");
}

fn code(text: &str, columns: &str) -> Option<(String, String)> {
    let error = read(text.as_bytes(), columns).err()?;
    Some((
        error.issues[0].code.to_string(),
        error.issues[0].detail.clone(),
    ))
}
