//! Names of points with groups, with what all of them begin with, and with numbers of repetitions.

use super::{belongs, export, form, log, read, refusal};
use kincal::measurement::Frame;
use kincal::wire::measurement::from_upload;

/// An instrument's file with nominal positions 0.3 mm from the measured ones. `row` writes the group and the name.
fn nominal_and_measured(header: &str, row: impl Fn(&str, usize) -> String) -> String {
    let rows = (1..=12).flat_map(|i| {
        [("Nominals", 0.3), ("Measured", 0.0)].map(|(group, off)| {
            let (x, y) = (10.0 * i as f64 + off, 100 * i);
            format!("{},{x},{y},3\n", row(group, i))
        })
    });
    format!("{header},x_mm,y_mm,z_mm\n") + &rows.collect::<String>()
}

#[test]
fn nominal_and_measured_positions_are_never_pooled() {
    let robot = log(12, |i| format!("P{i}"));
    for instrument in [
        nominal_and_measured("Name", |group, i| format!("A::{group}::P{i}")),
        nominal_and_measured("Group,Name", |group, i| format!("{group},P{i}")),
        nominal_and_measured("Collection,Name", |group, i| format!("{group},P{i}")),
    ] {
        let (code, detail) = refusal(&robot, &instrument, "");
        assert_eq!(code, "two_readings", "{instrument}");
        assert!(
            detail.contains("Measured\" (12 points)") && detail.contains("Nominals\" (12 points)"),
            "{detail}"
        );
        assert!(
            detail.contains("in the column mapping: {\"groups\": [\""),
            "{detail}"
        );
        let body = form(robot.as_bytes(), instrument.as_bytes());
        let (set, reading) = read(&body, "{\"groups\": [\"measured\"]}").unwrap();
        assert_eq!(set.points.len(), 12);
        for point in &set.points {
            assert!((10.0 * point.q_rad[0].to_degrees() - point.position_mm.x).abs() < 1e-6);
        }
        let json = serde_json::to_string(&reading).unwrap();
        let again = from_upload(super::BOUNDARY, Some(&json), &body, Frame::Base, 6).unwrap();
        assert!(again == set);
        let understood = reading.unwrap().joined.unwrap().instrument;
        assert_eq!(understood.other_groups, Some(12));
        // who says that both are measurements of the points gets both
        let both = "{\"groups\": [\"Measured\", \"Nominals\"]}";
        assert_eq!(read(&body, both).unwrap().0.points.len(), 24);
        let error = read(&body, "{\"groups\": [\"Meas\"]}").unwrap_err();
        assert!(error.issues[0].detail.contains("Measured\""), "{error:?}");
    }
}

#[test]
fn groups_without_a_common_name_and_repetitions_in_a_group_are_read() {
    let robot = log(12, |i| format!("P{i}"));
    let group = |i: usize| if i.is_multiple_of(2) { "Low" } else { "High" };
    belongs(
        &robot,
        &export("Name", 12, |i| format!("{}::P{i}", group(i))),
        12,
    );
    let twice = |i: usize| format!("A::P{}", i.div_ceil(2));
    let rows = (1..=24).map(|i: usize| {
        let point = i.div_ceil(2);
        format!(
            "{},{}.{},{},3\n",
            twice(i),
            10 * point,
            1 + i % 2,
            100 * point
        )
    });
    let instrument = "Name,x_mm,y_mm,z_mm\n".to_owned() + &rows.collect::<String>();
    let body = form(robot.as_bytes(), instrument.as_bytes());
    assert_eq!(read(&body, "").unwrap().0.points.len(), 24);
}

#[test]
fn what_all_names_begin_with_and_repetitions_are_left_out_and_told() {
    let robot = log(12, |i| format!("P{i}"));
    for (name, begin, repetitions) in [
        ("Cell4_P#", "cell4_", false),
        ("KR16-#", "kr16-", false),
        ("2026-03-14 P#", "2026-03-14 ", false),
        ("P# (1)", "", true),
        ("P#.0", "", true),
        ("A::Cal::P#_1", "", true),
        ("Cell4_P#_1", "cell4_", true),
    ] {
        let instrument = export("Name", 12, |i| name.replace('#', &i.to_string()));
        let left_out = belongs(&robot, &instrument, 12).join.left_out;
        let left_out = left_out.unwrap_or_else(|| panic!("{name}: nothing is told"));
        assert_eq!(
            (left_out.instrument.as_str(), left_out.repetitions),
            (begin, repetitions),
            "{name}"
        );
    }
    // several repetitions, beside a name without one
    let rows = (1..=36).map(|i: usize| {
        let (point, repetition) = (i.div_ceil(3), (i - 1) % 3 + 1);
        format!(
            "P{point}.{repetition},{}.0{repetition},{},3\n",
            10 * point,
            100 * point
        )
    });
    let instrument = "Name,x_mm,y_mm,z_mm\nHOME,1,2,3\n".to_owned() + &rows.collect::<String>();
    let body = form(robot.as_bytes(), instrument.as_bytes());
    let (set, reading) = read(&body, "").unwrap();
    assert_eq!(set.points.len(), 36);
    assert_eq!(
        reading.unwrap().joined.unwrap().join.leftover_instrument.n,
        1
    );
}

#[test]
fn a_remedy_that_cannot_work_is_not_offered() {
    let robot = log(12, |i| format!("P{i}"));
    let letters = export("Name", 11, |i| {
        format!("corner {}", char::from(b'a' + i as u8))
    });
    let (code, detail) = refusal(&robot, &letters, "");
    assert_eq!(code, "join_unclear");
    assert!(
        !detail.contains("number\"}") && !detail.contains("\"order\""),
        "{detail}"
    );
    // a file with names needs none
    let unnamed = "x_mm,y_mm,z_mm\n1,2,3\n";
    let (_, detail) = refusal(&robot, unnamed, "");
    assert!(!detail.contains("\"robot\""), "{detail}");
    let header = export("Collection::Group::Target", 12, |i| {
        format!("Cell::Cal::P{i}")
    });
    belongs(&robot, &header, 12);
}
