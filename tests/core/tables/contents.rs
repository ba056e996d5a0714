//! Columns beside joints and positions, and rows that hold no measurement.

use super::*;
use kincal::release::unread_labels;
use nalgebra::Matrix3;

/// A table with other columns behind joints and positions.
fn beside(names: &[&str], back: fn(usize) -> Vec<String>) -> Written {
    Written {
        header: header(DEG, MM)
            .into_iter()
            .chain(names.iter().map(|name| (*name).to_owned()))
            .collect(),
        back,
        ..Written::default()
    }
}

fn three(_: usize) -> Vec<String> {
    ["1.0", "2.0", "3.0"].map(str::to_owned).to_vec()
}

/// A table with a row of other cells behind its own.
fn with_row(written: &Written, front: &str, joint: &str, position: &str) -> String {
    let cells = std::iter::once(front)
        .chain([joint; 6])
        .chain([position; 3]);
    format!(
        "{}{}\n",
        written.text(),
        cells.collect::<Vec<_>>().join(",")
    )
}

fn labelled(label: &str) -> Written {
    Written {
        header: std::iter::once(label.to_owned())
            .chain(header(DEG, MM))
            .collect(),
        front: |row| vec![format!("{}", row + 1)],
        ..Written::default()
    }
}

fn numbered_and_named() -> Written {
    Written {
        header: ["No.", "Point"]
            .map(str::to_owned)
            .into_iter()
            .chain(header(DEG, MM))
            .collect(),
        front: |row| vec![format!("{}", row + 1), format!("P{row}")],
        ..Written::default()
    }
}

/// Columns and rows.
pub fn contents() -> Vec<Habit> {
    let poses = [
        ("Universal Robots", ["Rx [rad]", "Ry [rad]", "Rz [rad]"]),
        ("Staubli", ["RX", "RY", "RZ"]),
        (
            "roll, pitch, yaw",
            ["Roll (deg)", "Pitch (deg)", "Yaw (deg)"],
        ),
        ("Kawasaki", ["O", "A", "T"]),
        ("Fanuc", ["W", "P", "R"]),
    ];
    let poses = poses.map(|(name, rotation)| {
        let text = beside(&rotation, three).text();
        let mapping = by_number(1, "deg", "mm");
        asked(name, text, "two_readings", "computes itself", mapping)
    });
    let uncertain = ["sigma_x_mm", "u_y_mm", "StdDev Z"];
    let mapped =
        "\"std_x_mm\": \"sigma_x_mm\", \"std_y_mm\": \"u_y_mm\", \"std_z_mm\": \"StdDev Z\"";
    let mut all = vec![
        taken(
            "exact names beside names of others",
            beside(&["target", "station", "std_mm"], |row| {
                vec![format!("{}", row % 2), "west".into(), "0.02".into()]
            })
            .text(),
        ),
        asked(
            "uncertainties under other names",
            beside(&uncertain, three).text(),
            "unknown_column",
            "looks like an uncertainty",
            mapped,
        ),
        asked(
            "an uncertainty to leave aside",
            beside(&["std_xx_mm2"], |_| vec!["1.0".into()]).text(),
            "unknown_column",
            "{\"ignore\": [\"std_xx_mm2\"]}",
            "\"ignore\": [\"std_xx_mm2\"]",
        ),
        refused(
            "angles without a convention",
            beside(&["rx_deg", "ry_deg", "rz_deg"], three).text(),
            "rotation_required",
            "rotation=",
        ),
        refused(
            "half a covariance",
            beside(&["cov_xx_mm2", "cov_yy_mm2", "cov_zz_mm2"], three).text(),
            "incomplete_covariance",
            "cov_xy_mm2",
        ),
        refused(
            "no covariance",
            beside(
                &[
                    "cov_xx_mm2",
                    "cov_xy_mm2",
                    "cov_xz_mm2",
                    "cov_yy_mm2",
                    "cov_yz_mm2",
                    "cov_zz_mm2",
                ],
                |_| ["1", "2", "0", "1", "0", "1"].map(str::to_owned).to_vec(),
            )
            .text(),
            "not_a_covariance",
            "eigenvalues",
        ),
        refused(
            "two noises",
            beside(
                &[
                    "std_mm",
                    "cov_xx_mm2",
                    "cov_xy_mm2",
                    "cov_xz_mm2",
                    "cov_yy_mm2",
                    "cov_yz_mm2",
                    "cov_zz_mm2",
                ],
                |_| {
                    ["1", "1", "0", "0", "1", "0", "1"]
                        .map(str::to_owned)
                        .to_vec()
                },
            )
            .text(),
            "duplicate_column",
            "keep one",
        ),
        taken(
            "units behind every number",
            Written {
                header: header(|j| format!("Achse {j} [Grad]"), MM),
                angle: |v| format!("{v:.4}°").replace('.', ","),
                length: |v| format!("{v:.4} mm").replace('.', ","),
                separator: ";",
                ..Written::default()
            }
            .text(),
        ),
        refused(
            "units behind some numbers",
            Written {
                header: header(DEG, MM),
                length: |v| {
                    if v > 0.0 {
                        format!("{v:.4} mm")
                    } else {
                        four(v)
                    }
                },
                ..Written::default()
            }
            .text(),
            "not_a_number",
            "write it behind every number",
        ),
        refused(
            "other units behind numbers",
            Written {
                header: header(DEG, MM),
                length: |v| format!("{} m", v / 1000.0),
                ..Written::default()
            }
            .text(),
            "not_a_number",
            "and the column in mm",
        ),
        taken(
            "names and brackets of other languages",
            named(
                |j| format!("θ{j}（°）"),
                ["X（毫米）", "Y（毫米）", "Z（毫米）"],
            )
            .text(),
        ),
        refused(
            "a mean in a numbered column",
            with_row(&labelled("No."), "Durchschnitt", "1.5", "2.5"),
            "summary_row",
            "Durchschnitt",
        ),
        refused(
            "a mean among labels that are numbers",
            with_row(&labelled("configuration"), "Moyenne", "1.5", "2.5"),
            "summary_row",
            "Moyenne",
        ),
        refused(
            "a mean behind the number of its row",
            with_row(&numbered_and_named(), "11,Mean", "1.5", "2.5"),
            "summary_row",
            "Mean",
        ),
    ];
    for (name, mark) in [("zeros", "0"), ("nines", "-99999")] {
        let twice = with_row(&labelled("No."), "10", "1.5", mark);
        let twice = with_row(&labelled("No."), "11", "2.5", mark)
            .lines()
            .next_back()
            .map(|row| format!("{twice}{row}\n"))
            .unwrap_or_default();
        all.push(refused(name, twice, "not_measured", "as in 2 rows"));
    }
    all.extend(poses);
    all
}

#[test]
fn exact_names_mean_the_same_in_any_table() {
    let written = beside(
        &[
            "target",
            "station",
            "sequence",
            "configuration",
            "subset",
            "temperature_c",
        ],
        |row| {
            let subset = if row < 5 { "identify" } else { "verify" };
            vec![
                format!("{}", row % 2),
                format!("s{}", row / 5),
                format!("{}", 100 - row),
                format!("c{row}"),
                subset.into(),
                "21.5".into(),
            ]
        },
    );
    let (set, _) = read(written.text().as_bytes(), "").unwrap();
    let point = &set.points[7];
    assert_eq!((point.target, point.sequence), (1, 93));
    assert_eq!(point.station.as_deref(), Some("s1"));
    // in a robot's table a configuration may be the posture of the arm
    assert_eq!(point.configuration, "row_7");
    assert!(point.subset.is_some() && point.temperature_c == Some(21.5));
}

#[test]
fn a_covariance_is_read_from_its_six_columns() {
    let names = [
        "cov_xx_mm2",
        "cov_xy_mm2",
        "cov_xz_mm2",
        "cov_yy_mm2",
        "cov_yz_mm2",
        "cov_zz_mm2",
    ];
    let written = beside(&names, |_| {
        ["0.04", "0.01", "-0.02", "0.09", "0.03", "0.25"]
            .map(str::to_owned)
            .to_vec()
    });
    let (set, reading) = read(written.text().as_bytes(), "").unwrap();
    let noise = set.points[3].position_noise.unwrap();
    let variances = noise.std_mm.map(|std| std * std);
    let found = noise.axes * Matrix3::from_diagonal(&variances) * noise.axes.transpose();
    let stated = Matrix3::new(0.04, 0.01, -0.02, 0.01, 0.09, 0.03, -0.02, 0.03, 0.25);
    assert!((found - stated).amax() < ROUNDING);
    is_read_again(
        "covariance",
        written.text().as_bytes(),
        &set,
        &reading.unwrap(),
    );
}

#[test]
fn columns_that_may_say_the_reflector_or_the_set_up_are_named() {
    let written = beside(&["Target", "Station no.", "Operator"], three);
    let (_, reading) = read(written.text().as_bytes(), "").unwrap();
    let named = unread_labels(&reading.unwrap()).unwrap();
    assert!(named.contains("\"Target\", \"Station no.\"."), "{named}");
    assert!(named.contains("{\"target\": \"Target\"}") && !named.contains("Operator"));
    let (_, reading) = read(labelled("No.").text().as_bytes(), "").unwrap();
    assert!(unread_labels(&reading.unwrap()).is_none());
}
