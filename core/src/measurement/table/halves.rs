//! Messages for joint values and positions in two separate files: if one of the files is missing, or if the files are swapped.

use crate::measurement::columns::mapping::Needs;
use crate::measurement::columns::meaning::thing;
use crate::measurement::columns::names::{ANGLES, Known, LENGTHS, Unit, recognise, unit_alone};
use crate::measurement::issue::Issue;
use crate::measurement::table::resolution::Resolution;

/// The issue for a file in which all joint values or all positions are missing. It says where they may be.
pub fn missing_half(resolution: &Resolution) -> Option<Issue> {
    let columns = &resolution.columns;
    let is_named = columns.used.iter().all(|used| !used.is_mapped);
    let missing = columns.missing.first().filter(|_| is_named)?;
    // The column exists and only lacks its unit.
    if (columns.proposed.iter()).any(|(means, _)| thing(means) == thing(missing)) {
        return None;
    }
    let detail = match unknown_unit(resolution) {
        Some(detail) => detail,
        None => other_half(resolution)?.to_owned(),
    };
    let detail = format!("{detail}. The table has {}", resolution.table.names());
    Some(Issue::new("missing_column", detail).in_column(missing.clone()))
}

/// The refusal of columns whose unit is not known, such as `X [ft]`.
fn unknown_unit(resolution: &Resolution) -> Option<String> {
    let missing = |means: &str| {
        let missing = resolution.columns.missing.iter();
        missing.clone().any(|missing| thing(missing) == means)
    };
    let found = resolution.table.header.iter().find_map(|name| {
        let (base, unit) = name
            .trim()
            .strip_suffix([']', ')'])?
            .rsplit_once(['[', '('])?;
        let what = match recognise(base, None) {
            Known::Position(axis, Unit::Missing) if missing(["x", "y", "z"][axis]) => {
                LENGTHS.map(|(name, _)| name).join(", ")
            }
            Known::Joint(number, Unit::Missing) if missing(&format!("q{number}")) => {
                ANGLES.map(|(name, _)| name).join(", ")
            }
            _ => return None,
        };
        (unit_alone(unit).is_none() && !unit.trim().is_empty()).then_some((name, unit, what))
    });
    let (name, unit, known) = found?;
    Some(format!(
        "the unit {unit:?} of column {name} is not known; known are {known}: write the values in one of these"
    ))
}

fn other_half(resolution: &Resolution) -> Option<&'static str> {
    let (names, n_joints) = (resolution.names(), resolution.n_joints);
    let count = |is_wanted: fn(&Known) -> bool| {
        let known = names.iter().map(|(name, below)| recognise(name, *below));
        known.filter(is_wanted).count()
    };
    let found_joints = count(|known| matches!(known, Known::Joint(..)));
    let found_axes = count(|known| matches!(known, Known::Position(..)));
    match (resolution.needs, found_joints, found_axes) {
        (Needs::Joints, 0, 3..) => Some(
            "it has positions and no joint values. Of two files: are they exchanged? The robot's is the first, the instrument's the second. A program of \
             Cartesian targets needs the joint values near each target in columns of its own",
        ),
        (Needs::Positions, joints, 0) if joints >= n_joints => Some(
            "it has joint values and no positions: are the two files exchanged? The robot's is the first, the instrument's the second",
        ),
        (Needs::Points, joints, 0) if joints >= n_joints => Some(
            "the file has joint values and no positions that are known: if the instrument wrote them into a file of its own, give both files, the \
             robot's first; if they are in this one, say where in the column mapping: {\"x_mm\": \"COLUMN\"}",
        ),
        (Needs::Points, 0, 3..) => Some(
            "the file has positions and no joint values that are known: if the robot wrote them into a file of its own, give both files, the robot's \
             first; if they are in this one, say where in the column mapping: {\"q1_deg\": \"COLUMN\"}",
        ),
        _ => None,
    }
}
