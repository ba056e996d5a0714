//! Refusals of columns name a remedy that works, and contradictions are refused.

use super::{N_ROWS, Written, four, header, is_true, own_header, read};

fn refusal(text: &str, columns: &str) -> (String, String) {
    let error = read(text.as_bytes(), columns).unwrap_err();
    (error.issues[0].code.clone(), error.issues[0].detail.clone())
}

fn named(names: [&str; 6], axes: [&str; 3]) -> String {
    let header = header(|joint| names[joint - 1].to_owned(), axes);
    let written = Written {
        header,
        ..Written::default()
    };
    written.text()
}

const JOINTS: [&str; 6] = [
    "J1 [deg]", "J2 [deg]", "J3 [deg]", "J4 [deg]", "J5 [deg]", "J6 [deg]",
];
const AXES: [&str; 3] = ["X [mm]", "Y [mm]", "Z [mm]"];

#[test]
fn a_unit_that_contradicts_the_names_is_refused() {
    let text = named(JOINTS, AXES);
    for (stated, remedy) in [
        ("\"joint_unit\": \"rad\"", "{\"q1_rad\": \"J1 [deg]\"}"),
        ("\"position_unit\": \"m\"", "{\"x_m\": \"X [mm]\"}"),
    ] {
        let (code, detail) = refusal(&text, stated);
        assert_eq!(code, "two_readings");
        assert!(detail.contains(remedy), "{detail}");
    }
    let same = "\"joint_unit\": \"deg\", \"position_unit\": \"mm\"";
    is_true("the same unit", &read(text.as_bytes(), same).unwrap().0);
}

#[test]
fn a_unit_that_is_not_known_is_named() {
    for unit in ["ft", "mil"] {
        let axes = ["X", "Y", "Z"].map(|axis| format!("{axis} [{unit}]"));
        let (code, detail) = refusal(&named(JOINTS, [&axes[0], &axes[1], &axes[2]]), "");
        assert_eq!(code, "missing_column");
        assert!(
            detail.contains(&format!("{unit:?}")) && detail.contains("mm, m, cm"),
            "{detail}"
        );
    }
}

#[test]
fn external_axes_that_move_are_refused_and_constant_ones_are_told() {
    let with = |name: &str, value: fn(usize) -> String| {
        let rows = Written::default().rows();
        let rows = rows
            .iter()
            .enumerate()
            .map(|(row, cells)| format!("{},{}\n", cells.join(","), value(row)));
        format!(
            "{},{name}\n{}",
            own_header().join(","),
            rows.collect::<String>()
        )
    };
    for name in ["E1 [mm]", "E2", "EXTAX", "J7 [mm]", "eax_a"] {
        let moving = with(name, |row| format!("{}.5", row / 4));
        let (code, detail) = refusal(&moving, "");
        assert_eq!(code, "external_axis_moves", "{name}: {detail}");
        assert!(
            detail.contains("0.5 in line 2") && detail.contains("2.5 in line 10"),
            "{detail}"
        );
        let aside = format!("\"ignore\": [{name:?}]");
        assert!(detail.contains(&aside), "{detail}");
        is_true(name, &read(moving.as_bytes(), &aside).unwrap().0);
        let standing = with(name, |_| "12.5".into());
        let (set, reading) = read(standing.as_bytes(), "").unwrap();
        is_true(name, &set);
        assert_eq!(reading.unwrap().understood.unwrap().ignored, [name]);
    }
}

#[test]
fn more_names_of_joints_and_positions_are_known() {
    let ros = [
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ];
    let set = read(named(ros, AXES).as_bytes(), "\"joint_unit\": \"deg\"")
        .unwrap()
        .0;
    is_true("ROS", &set);
    let jpos = [
        "JPOS1 [deg]",
        "JPOS2 [deg]",
        "JPOS3 [deg]",
        "JPOS4 [deg]",
        "JPOS5 [deg]",
        "JPOS6 [deg]",
    ];
    let posx = ["PosX_mm", "PosY_mm", "PosZ_mm"];
    is_true("JPOS", &read(named(jpos, posx).as_bytes(), "").unwrap().0);
    let joint_a = [
        "joint_a1 [deg]",
        "joint_a2 [deg]",
        "joint_a3 [deg]",
        "joint_a4 [deg]",
        "joint_a5 [deg]",
        "joint_a6 [deg]",
    ];
    let tx = ["TX [mm]", "TY [mm]", "TZ [mm]"];
    is_true(
        "joint_a",
        &read(named(joint_a, tx).as_bytes(), "").unwrap().0,
    );
}

#[test]
fn a_table_without_header_is_told_the_columns_that_have_numbers() {
    let rows = Written {
        angle: four,
        ..Written::default()
    }
    .rows();
    let rows = rows
        .iter()
        .zip(1..)
        .map(|(cells, i)| format!("Cell,P{i},{}\n", cells.join(",")));
    let text: String = rows.collect();
    let (code, detail) = refusal(&text, "");
    assert_eq!(code, "no_header");
    let (_, mapping) = detail.split_once("in the column mapping: {").unwrap();
    let (set, _) = read(text.as_bytes(), mapping.trim_end_matches('}')).unwrap();
    assert_eq!(set.points.len(), N_ROWS);
    is_true("without header", &set);
}

#[test]
fn a_unit_in_the_name_and_another_below_it_is_told_with_a_remedy_for_all() {
    let text = named(JOINTS, AXES);
    let (names, rows) = text.split_once('\n').unwrap();
    let text = format!("{names}\nrad,rad,rad,rad,rad,rad,mm,mm,mm\n{rows}");
    let (code, detail) = refusal(&text, "");
    assert_eq!(code, "two_readings");
    assert!(
        detail.contains("in the column mapping: {\"joint_unit\": \"deg\"}"),
        "{detail}"
    );
    is_true(
        "degrees",
        &read(text.as_bytes(), "\"joint_unit\": \"deg\"").unwrap().0,
    );
}
