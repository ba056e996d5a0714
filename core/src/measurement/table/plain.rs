//! Columns with fixed names, such as `station`. Decides which of them are read, and finds names that are nearly a fixed name or look like
//! an uncertainty.

use crate::measurement::columns::column::column_of;
use crate::measurement::columns::mapping::Needs;
use crate::measurement::columns::meaning::{column, thing};
use crate::measurement::columns::names::{Known, nearly, recognise};
use crate::measurement::columns::words::is_one_of;
use crate::measurement::table::resolution::Resolution;

/// Uses columns with fixed names. Adds an issue for names that are nearly such a name, and for names that look like an uncertainty of the
/// position.
pub fn named_plain(resolution: &mut Resolution, known: &[(usize, Known)]) {
    // True if all joints and positions have the names of kincal's own file format. Other fixed names then match in any letter case, and
    // misspelt names are reported.
    let is_own = resolution.table.header.iter().all(|name| {
        !matches!(
            recognise(name, None),
            Known::Joint(..) | Known::Position(..)
        ) || column(&name.trim().to_lowercase(), resolution.n_joints).is_some()
    });
    // If an instrument's file has only one label, it is the name of the point, whatever the column is called.
    let has_label = known
        .iter()
        .any(|(_, known)| matches!(known, Known::Key(key) if key.is_label()))
        || ["name", "number", "time"]
            .iter()
            .any(|key| resolution.has(key));
    for (place, known) in known {
        let name = resolution.table.name(*place);
        let is_exact = |means: &str| {
            let is_of_noise = means.starts_with("std_") || means.starts_with("cov_");
            // In a robot's table, `configuration` may be the posture of the arm.
            means != "configuration"
                && (name.trim() == means || is_of_noise && name.trim().eq_ignore_ascii_case(means))
                && (!is_of_target(means) || has_label || resolution.needs != Needs::Positions)
        };
        // The only label of an instrument's file: another maker's `Target_Name` is the name of a point.
        let is_only_label =
            |means: &str| means == "target_name" && !has_label && !resolution.needs_joints();
        match known {
            Known::Plain(means) if !is_only_label(means) && (is_own || is_exact(means)) => {
                if resolution.has(means) {
                    let detail = format!("column {name} appears twice");
                    resolution.issue(Some(name), "duplicate_column", detail);
                } else if resolution.needs != Needs::Joints {
                    resolution.take(*place, means.clone());
                }
            }
            Known::WrongUnit => wrong_unit(resolution, name),
            Known::Unknown => unknown(resolution, *place, name, is_own),
            _ => {}
        }
    }
}

/// Whether a column identifies the reflector of a row.
pub fn is_of_target(means: &str) -> bool {
    matches!(means, "target" | "target_name")
}

fn unknown(resolution: &mut Resolution, place: usize, name: String, is_own: bool) {
    let lower = name.to_lowercase();
    if is_own && column(&lower, resolution.n_joints).is_some() {
        return resolution.take(place, lower);
    }
    let aside = format!("leave it aside in the column mapping: {{\"ignore\": [{name:?}]}}");
    let detail = match nearly(&name).filter(|_| is_own) {
        Some(meant) => format!("column {name} is nearly {meant}: call it so, or {aside}"),
        None if resolution.needs_positions() && looks_uncertain(&name) => format!(
            "column {name} looks like an uncertainty of the position: name the columns std_mm, or std_x_mm std_y_mm std_z_mm (one standard deviation), or \
             cov_xx_mm2 … cov_zz_mm2 (a covariance), or say so in the column mapping: {{\"std_x_mm\": {name:?}}}; or {aside}"
        ),
        None => return,
    };
    resolution.issue(Some(name), "unknown_column", detail);
}

/// Words for an uncertainty.
const UNCERTAINTY_WORDS: &str =
    "sigma|σ|std|stdev|stddev|sd|cov|covariance|variance|var|uncertainty|unc|unsicherheit";
/// Words that may occur beside them in the name of a position's uncertainty.
const IGNORED_UNCERTAINTY_WORDS: &str = "x|y|z|xx|xy|xz|yx|yy|yz|zx|zy|zz|xyz|mm|mm²|um|m|dev|deviation|pos|position|point|total|\
    tracker";

/// Whether a name looks like an uncertainty or a covariance of a position: `sigma_x_mm`, `Std Dev X`, `u_x_mm`, `Ux [mm]`.
fn looks_uncertain(name: &str) -> bool {
    let lower = name
        .to_lowercase()
        .replace("mm2", "mm")
        .replace("mm^2", "mm");
    let words: Vec<&str> = lower
        .split(|c: char| !c.is_alphanumeric())
        .filter(|word| !word.is_empty())
        .collect();
    let is_axis = |word: &&str| matches!(*word, "x" | "y" | "z");
    let is_beside = |word: &&str| is_one_of(IGNORED_UNCERTAINTY_WORDS, word);
    let (uncertain, beside): (Vec<&str>, Vec<&str>) = words
        .iter()
        .partition(|word| is_one_of(UNCERTAINTY_WORDS, word));
    let is_uncertain = !uncertain.is_empty() && beside.iter().all(is_beside);
    match words[..] {
        ["u", ref rest @ ..] => rest.first().is_some_and(is_axis) && rest.iter().all(is_beside),
        ["ux" | "uy" | "uz", ref rest @ ..] => rest.iter().all(is_beside),
        _ => is_uncertain,
    }
}

/// Adds an issue for names such as `q1_inch` and `x_um`, unless a mapping states their meaning.
fn wrong_unit(resolution: &mut Resolution, name: String) {
    let lower = name.to_lowercase();
    let thing = thing(&lower);
    let is_wanted = if thing.starts_with('q') {
        resolution.needs_joints()
    } else {
        resolution.needs_positions()
    };
    if !is_wanted || resolution.has(thing) {
        return;
    }
    if let Err(issue) = column_of(&lower, resolution.n_joints) {
        let units = if thing.starts_with('q') { "deg" } else { "mm" };
        let detail = format!(
            "{}; or say what it is in the column mapping: {{\"{thing}_{units}\": {name:?}}}",
            issue.detail
        );
        resolution.issue(Some(name), issue.code, detail);
    }
}

#[cfg(test)]
mod tests {
    use super::looks_uncertain;

    #[test]
    fn uncertainties_of_positions_are_known_by_their_names() {
        for name in [
            "sigma_x_mm",
            "σ x [mm]",
            "u_x_mm",
            "Ux (mm)",
            "std_xx_mm2",
            "Std Dev X",
            "StdDev",
            "cov_xy",
            "Uncertainty",
            "variance z [mm²]",
        ] {
            assert!(looks_uncertain(name), "{name}");
        }
        for name in [
            "U [deg]",
            "Gesamt-RMS [µm]",
            "std temperature",
            "Standard",
            "u",
            "sigma torque 3",
            "x",
            "",
        ] {
            assert!(!looks_uncertain(name), "{name}");
        }
    }
}
