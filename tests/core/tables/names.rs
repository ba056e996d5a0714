//! Habits of naming columns, and workbooks.

use super::*;

/// Names of columns.
pub fn names() -> Vec<Habit> {
    let tcp = Written {
        header: header(DEG, MM)
            .into_iter()
            .chain(["A", "B", "C"].map(str::to_owned))
            .collect(),
        back: |_| vec!["1.0".into(), "2.0".into(), "3.0".into()],
        ..Written::default()
    };
    let rad = |v: f64| v.to_radians().to_string();
    let actual_q = header(|j| format!("actual_q_{}", j - 1), ["px", "py", "pz"]);
    let letters: Vec<String> = ["S", "L", "U", "R", "B", "T", "X", "Y", "Z"]
        .map(str::to_owned)
        .into();
    let mut swapped = Written {
        header: own_header(),
        ..Written::default()
    };
    swapped.header.swap(0, 8);
    let swapped = {
        let rows = swapped.rows().into_iter().map(|mut row| {
            row.swap(0, 8);
            row.join(",")
        });
        std::iter::once(swapped.header.join(","))
            .chain(rows)
            .collect::<Vec<_>>()
            .join("\n")
    };
    vec![
        taken("J1 [deg] and X [mm]", named(DEG, MM).text()),
        taken(
            "A1 [°] and X (mm)",
            named(|j| format!("A{j} [°]"), ["X (mm)", "Y (mm)", "Z (mm)"]).text(),
        ),
        taken(
            "Axis 1 [deg] and Pos X [mm]",
            named(
                |j| format!("Axis {j} [deg]"),
                ["Pos X [mm]", "Pos Y [mm]", "Pos Z [mm]"],
            )
            .text(),
        ),
        taken(
            "Joint1_deg and x mm",
            named(|j| format!("Joint{j}_deg"), ["x mm", "y mm", "z mm"]).text(),
        ),
        taken(
            "Joint[1] (degrees) and measured X (millimeters)",
            named(
                |j| format!("Joint[{j}] (degrees)"),
                [
                    "measured X (millimeters)",
                    "measured Y (millimeters)",
                    "measured Z (millimeters)",
                ],
            )
            .text(),
        ),
        taken(
            "Achse 1 / ° and X / mm",
            named(|j| format!("Achse {j} / °"), ["X / mm", "Y / mm", "Z / mm"]).text(),
        ),
        taken(
            "J1° and X in mm",
            named(|j| format!("J{j}°"), ["X in mm", "Y in mm", "Z in mm"]).text(),
        ),
        taken(
            "upper case",
            Written {
                header: own_header().iter().map(|n| n.to_uppercase()).collect(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "metres",
            Written {
                header: header(DEG, ["X [m]", "Y [m]", "Z [m]"]),
                length: |v| (v / 1000.0).to_string(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "inches",
            Written {
                header: header(DEG, ["X [in]", "Y [in]", "Z [in]"]),
                length: |v| (v / 25.4).to_string(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "centimetres",
            Written {
                header: header(DEG, ["X [cm]", "Y [cm]", "Z [cm]"]),
                length: |v| (v / 10.0).to_string(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "radians",
            Written {
                header: header(|j| format!("J{j} [rad]"), MM),
                angle: rad,
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "joints counted from 0",
            named(|j| format!("joint_{} [deg]", j - 1), MM).text(),
        ),
        taken("columns in another order", swapped),
        asked(
            "no units at all",
            named(|j| format!("J{j}"), ["X", "Y", "Z"]).text(),
            "missing_unit",
            "in the column mapping: {",
            by_header(&header(|j| format!("J{j}"), ["X", "Y", "Z"]), "deg", "mm"),
        ),
        asked(
            "joints without units",
            named(|j| format!("A{j}"), MM).text(),
            "missing_unit",
            "\"joint_unit\"",
            "\"joint_unit\": \"deg\"",
        ),
        asked(
            "units of all columns stated at once",
            Written {
                header: header(|j| format!("J{j}"), ["X", "Y", "Z"]),
                angle: rad,
                length: |v| (v / 1000.0).to_string(),
                ..Written::default()
            }
            .text(),
            "missing_unit",
            "{\"joint_unit\": \"deg\"} (or \"rad\")",
            "\"joint_unit\": \"rad\", \"position_unit\": \"m\"",
        ),
        taken(
            "the axes of Yaskawa with units",
            Written {
                header: ["S", "L", "U", "R", "B", "T"]
                    .map(|axis| format!("{axis} [deg]"))
                    .into_iter()
                    .chain(MM.map(str::to_owned))
                    .collect(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "the axes of Universal Robots as its pendant names them",
            Written {
                header: ["Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3"]
                    .map(|axis| format!("{axis} [°]"))
                    .into_iter()
                    .chain(MM.map(str::to_owned))
                    .collect(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "actual_q of Universal Robots is in radians",
            Written {
                header: header(|j| format!("actual_q_{}", j - 1), MM),
                angle: rad,
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "the unit of lengths above the header",
            format!(
                "Format Version,1.23,Take Name,a,Length Units,Meters\n\n{}",
                Written {
                    header: header(DEG, ["X", "Y", "Z"]),
                    length: |v| (v / 1000.0).to_string(),
                    ..Written::default()
                }
                .text()
            ),
        ),
        refused(
            "the unit of lengths above a quaternion",
            format!(
                "Format Version,1.23,Take Name,a,Length Units,Meters\n,,Rotation,Rotation\n{}",
                named(DEG, ["X", "Y", "Z"]).text()
            ),
            "missing_unit",
            "column X has no unit",
        ),
        refused(
            "nominal positions only, in names with spaces",
            named(DEG, ["Nominal X [mm]", "Nominal Y [mm]", "Nominal Z [mm]"]).text(),
            "missing_column",
            "give both files",
        ),
        asked(
            "radians without a unit",
            Written {
                header: actual_q.clone(),
                angle: rad,
                length: |v| (v / 1000.0).to_string(),
                ..Written::default()
            }
            .text(),
            "missing_unit",
            "has no unit",
            by_header(&actual_q, "rad", "m"),
        ),
        asked(
            "letters of axes",
            Written {
                header: letters.clone(),
                ..Written::default()
            }
            .text(),
            "missing_unit",
            "column S has no unit",
            by_header(&letters, "deg", "mm"),
        ),
        asked(
            "names of another language",
            named(|j| format!("eje {j} (grados)"), ["largo", "ancho", "alto"]).text(),
            "wrong_joint_count",
            "eje 1 (grados)",
            by_header(
                &header(|j| format!("eje {j} (grados)"), ["largo", "ancho", "alto"]),
                "deg",
                "mm",
            ),
        ),
        asked(
            "Grad",
            named(|j| format!("A{j} [Grad]"), MM).text(),
            "two_readings",
            "gons",
            by_number(1, "deg", "mm"),
        ),
        asked(
            "no header",
            Written::default()
                .text()
                .split_once('\n')
                .unwrap()
                .1
                .to_owned(),
            "no_header",
            "\"q1_deg\": 1",
            by_number(1, "deg", "mm"),
        ),
        asked(
            "no header, numbers in front",
            Written {
                header: vec![],
                front: |r| vec![format!("P{r}")],
                ..Written::default()
            }
            .text()
            .split_once('\n')
            .unwrap()
            .1
            .to_owned(),
            "no_header",
            "by its number",
            by_number(2, "deg", "mm"),
        ),
        asked(
            "the controller's own pose beside the joints",
            tcp.text(),
            "two_readings",
            "computes itself",
            by_number(1, "deg", "mm"),
        ),
        asked(
            "two columns for x",
            Written {
                header: header(DEG, MM)
                    .into_iter()
                    .chain(["Measured X [mm]".to_owned()])
                    .collect(),
                back: |_| vec!["1.0".into()],
                ..Written::default()
            }
            .text(),
            "duplicate_column",
            "say which",
            "\"x_mm\": \"X [mm]\"",
        ),
        asked(
            "a seventh axis",
            Written {
                header: header(DEG, MM)
                    .into_iter()
                    .chain(["J7 [deg]".to_owned()])
                    .collect(),
                back: |_| vec!["1.0".into()],
                ..Written::default()
            }
            .text(),
            "wrong_joint_count",
            "\"ignore\"",
            "\"ignore\": [\"J7 [deg]\"]",
        ),
        asked(
            "nominal positions in front of the measured ones",
            Written {
                header: ["Nominal X", "Nominal Y", "Nominal Z"]
                    .map(str::to_owned)
                    .into_iter()
                    .chain(header(DEG, ["Actual X", "Actual Y", "Actual Z"]))
                    .collect(),
                front: |_| vec!["1.0".into(), "2.0".into(), "3.0".into()],
                ..Written::default()
            }
            .text(),
            "missing_unit",
            "Actual X",
            "\"x_mm\": \"Actual X\", \"y_mm\": \"Actual Y\", \"z_mm\": \"Actual Z\"",
        ),
        refused(
            "units that differ",
            named(DEG, ["X [mm]", "Y [m]", "Z [mm]"]).text(),
            "mixed_units",
            "one unit",
        ),
        refused(
            "a slip of the keyboard",
            Written {
                header: own_header()
                    .into_iter()
                    .chain(["std_m".to_owned()])
                    .collect(),
                back: |_| vec!["0.01".into()],
                ..Written::default()
            }
            .text(),
            "unknown_column",
            "nearly std_mm",
        ),
    ]
}

pub fn sheets() -> Vec<Habit> {
    let table = named(DEG, MM);
    let cells: Vec<Vec<String>> = std::iter::once(table.header.clone())
        .chain(table.rows())
        .collect();
    let titled: Vec<Vec<String>> = [vec!["Cell 4".to_owned()], vec![]]
        .into_iter()
        .chain(cells.clone())
        .collect();
    vec![
        taken("xlsx", workbooks::xlsx(&[("Sheet1", &cells)])),
        taken(
            "xlsx with a title and an empty sheet",
            workbooks::xlsx(&[("Data", &titled), ("Sheet2", &[])]),
        ),
        taken("ods", workbooks::ods(&[("Sheet1", &titled)])),
        asked(
            "two sheets",
            workbooks::xlsx(&[("Old", &cells[..3]), ("New", &cells)]),
            "two_readings",
            "\"sheet\"",
            "\"sheet\": \"New\"",
        ),
        asked(
            "two sheets of ods",
            workbooks::ods(&[("Old", &cells[..3]), ("New", &cells)]),
            "two_readings",
            "\"sheet\"",
            "\"sheet\": \"New\"",
        ),
        refused(
            "a zip",
            workbooks::zip(&[("set.csv", Written::default().text().into_bytes())]),
            "not_csv",
            "no workbook",
        ),
    ]
}
