//! Groups of columns, named by the line above the header, such as `Nominal;;;Measured;;`. They show which positions were measured.

use crate::measurement::columns::mapping::Separator;
use crate::measurement::columns::names::Known;
use crate::measurement::columns::words::is_one_of;
use crate::measurement::table::Table;
use crate::measurement::table::header::{ROTATION, has_rotation_and_position};

/// Words above columns that were not measured, or that are differences and spreads.
pub const NOT_MEASURED: &str = "tcp|controller|nominal|nom|soll|sollwert|sollwerte|deviation|deviations|dev|abweichung|\
    delta|error|errors|difference|diff|reference|design|cad|command|commanded|programmed|\
    theoretical|predicted|computed|calculated|residual|residuals|std|sigma|uncertainty|rms|\
    streuung|unsicherheit|minus|abw|resid";
/// Words above columns that were measured.
const MEASURED: &str =
    "measured|meas|measurement|actual|ist|istwerte|gemessen|tracker|laser|smr|instrument|camera";
/// Maximum number of words above columns. Longer texts are titles.
const MAX_WORDS: usize = 3;

/// Whether the columns of a group were measured, if its name says so.
fn is_measured(group: &str) -> Option<bool> {
    let group = group.to_lowercase();
    let words = group.split(|c: char| !c.is_alphanumeric());
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    let has = |list| words.iter().any(|word| is_one_of(list, word));
    match words.len() <= MAX_WORDS {
        // Examples: "Measured - Nominal", "Tracker residuals".
        true if has(NOT_MEASURED) => Some(false),
        true if has(MEASURED) => Some(true),
        _ => None,
    }
}

/// Ignores columns named X, Y and Z that belong to the rotation of a rigid body.
pub fn without_rotations(table: &Table, mut known: Vec<(usize, Known)>) -> Vec<(usize, Known)> {
    if !has_rotation_and_position(&table.above) {
        return known;
    }
    let named = table.above.iter().enumerate();
    let group = |place: usize| {
        named
            .clone()
            .rfind(|(at, cell)| *at <= place && !cell.is_empty())
    };
    for (place, known) in &mut known {
        let is_rotation =
            group(*place).is_some_and(|(_, cell)| cell.eq_ignore_ascii_case(ROTATION));
        if is_rotation && matches!(known, Known::Position(..)) {
            *known = Known::Unknown;
        }
    }
    known
}

/// Ignores positions in groups that were not measured. If one group was measured, positions in groups with any other name are ignored too.
/// A group ends where the next one begins. A group that begins at a joint or a name does not concern positions, or it is a title.
pub fn without_groups_not_measured(
    table: &Table,
    mut known: Vec<(usize, Known)>,
) -> Vec<(usize, Known)> {
    let above = table.above.iter().enumerate();
    let above = above.filter(|_| table.separator != Separator::Spaces);
    let groups: Vec<(usize, &String)> = above.filter(|(_, cell)| !cell.is_empty()).collect();
    let is_about_positions = |first: usize| {
        let of_group = known.iter().find(|(place, _)| *place == first);
        of_group.is_some_and(|(_, k)| matches!(k, Known::Position(..) | Known::Unknown))
    };
    let stated: Vec<(usize, bool)> = (groups.iter())
        .filter(|(first, _)| is_about_positions(*first))
        .filter_map(|(first, name)| Some((*first, is_measured(name)?)))
        .collect();
    let has_measured = stated.iter().any(|(_, is_measured)| *is_measured);
    for (place, known) in &mut known {
        let group = groups.iter().rfind(|(first, _)| first <= place);
        let own = group.and_then(|(first, _)| stated.iter().find(|(other, _)| other == first));
        let is_measured = own.map_or(!has_measured || group.is_none(), |(_, is)| *is);
        if !is_measured && matches!(known, Known::Position(..)) {
            *known = Known::Unknown;
        }
    }
    known
}
