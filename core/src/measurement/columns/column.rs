//! Columns by their names in kincal's own form, and which of them a file must have.

use crate::measurement::columns::pose::{PoseColumn, pose_column};
use crate::measurement::columns::units::{ANGLES, LENGTHS};
use crate::measurement::issue::Issue;
use std::collections::BTreeMap;

/// Content of a column. For joints and positions: the index, and the factor from the column's unit to rad or mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Column {
    Joint(usize, f64),
    Position(usize, f64),
    Configuration,
    Target,
    TargetName,
    Subset,
    MeasuredAt,
    StdMm,
    Station,
    Session,
    Sequence,
    TemperatureC,
    SweepJoint,
    OfPose(PoseColumn),
}

/// The column of a name in kincal's own form.
pub fn column_of(name: &str, n_joints: usize) -> Result<Column, Issue> {
    let plain = match name {
        "x_mm" => Column::Position(0, 1.0),
        "y_mm" => Column::Position(1, 1.0),
        "z_mm" => Column::Position(2, 1.0),
        "x_m" => Column::Position(0, 1000.0),
        "y_m" => Column::Position(1, 1000.0),
        "z_m" => Column::Position(2, 1000.0),
        "configuration" => Column::Configuration,
        "target" => Column::Target,
        "target_name" => Column::TargetName,
        "subset" => Column::Subset,
        "measured_at" => Column::MeasuredAt,
        "std_mm" => Column::StdMm,
        "station" => Column::Station,
        "session" => Column::Session,
        "sequence" => Column::Sequence,
        "temperature_c" => Column::TemperatureC,
        "sweep_joint" => Column::SweepJoint,
        _ => match pose_column(name) {
            Some(of_pose) => Column::OfPose(of_pose),
            None => return joint_column(name, n_joints),
        },
    };
    Ok(plain)
}

fn joint_column(name: &str, n_joints: usize) -> Result<Column, Issue> {
    let unitless = matches!(name, "x" | "y" | "z");
    let Some(rest) = name.strip_prefix('q') else {
        let detail = if unitless {
            format!("column {name} has no unit; name it {name}_mm or {name}_m")
        } else {
            format!(
                "column {name:?} is not known; known are q1_deg … or q1_rad …, x_mm y_mm z_mm or x_m y_m z_m, configuration, target, target_name, subset, \
                 measured_at, std_mm, station, session, sequence, temperature_c, sweep_joint, kind; of poses quat_w quat_x quat_y quat_z or rx_deg \
                 ry_deg rz_deg, std_x_mm …, cov_xx_mm2 …, std_rotation_deg or std_rx_deg …"
            )
        };
        return Err(column_issue(
            name,
            if unitless {
                "missing_unit"
            } else {
                "unknown_column"
            },
            detail,
        ));
    };
    let (number, unit) = rest.split_once('_').unwrap_or((rest, ""));
    let joint: usize = number
        .parse()
        .ok()
        .filter(|j| *j >= 1 && number == format!("{j}"))
        .ok_or_else(|| {
            column_issue(
                name,
                "unknown_column",
                format!("column {name:?} is not known; joints are q1_deg, q2_deg, …"),
            )
        })?;
    if joint > n_joints {
        return Err(column_issue(
            name,
            "wrong_joint_count",
            format!("column {name} is for joint {joint}, but the robot has {n_joints} joints"),
        ));
    }
    let factor = ANGLES.iter().find(|(known, _)| *known == unit);
    match factor {
        Some((_, factor)) => Ok(Column::Joint(joint - 1, *factor)),
        None => Err(column_issue(
            name,
            "missing_unit",
            format!("column {name} has no unit; name it q{joint}_deg or q{joint}_rad"),
        )),
    }
}

pub fn missing_columns(columns: &[Column], n_joints: usize) -> Vec<Issue> {
    let mut issues = Vec::new();
    for joint in 0..n_joints {
        if columns
            .iter()
            .filter(|c| matches!(c, Column::Joint(j, _) if *j == joint))
            .count()
            != 1
        {
            let name = format!("q{}_deg", joint + 1);
            let detail = format!(
                "joint {} needs exactly one column, {name} or q{}_rad; the robot has {n_joints} joints",
                joint + 1,
                joint + 1
            );
            issues.push(column_issue(&name, "wrong_joint_count", detail));
        }
    }
    for (axis, name) in ["x_mm", "y_mm", "z_mm"].into_iter().enumerate() {
        if columns
            .iter()
            .filter(|c| matches!(c, Column::Position(a, _) if *a == axis))
            .count()
            != 1
        {
            let detail = format!(
                "the position needs exactly one column {name} (or {}_m)",
                &name[..1]
            );
            issues.push(column_issue(name, "missing_column", detail));
        }
    }
    issues
}

/// The issue to report if joints or coordinates are in two units. Each column has its name.
pub fn mixed_units<'n>(columns: impl Iterator<Item = (Column, &'n str)>) -> Option<Issue> {
    let mut first: BTreeMap<&str, (&str, &str)> = BTreeMap::new();
    for (column, name) in columns {
        let (what, units, factor) = match column {
            Column::Joint(_, factor) => ("joint values", &ANGLES[..], factor),
            Column::Position(_, factor) => ("coordinates", &LENGTHS[..], factor),
            _ => continue,
        };
        let unit = units.iter().find(|(_, own)| *own == factor);
        let unit = unit.map_or("", |(unit, _)| unit);
        let (known, other) = first.entry(what).or_insert((unit, name));
        if *known != unit {
            let detail = format!(
                "{what} are in two different units: column {other} is in {known}, column {name} in {unit}; use one unit for all of them"
            );
            return Some(Issue::new("mixed_units", detail));
        }
    }
    None
}

fn column_issue(name: &str, code: &'static str, detail: String) -> Issue {
    Issue::new(code, detail).in_column(name.to_string())
}
