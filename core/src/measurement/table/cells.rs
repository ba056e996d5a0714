//! Finds the places of the cells in a line, so that single cells can be replaced and all others stay unchanged.

use crate::measurement::columns::mapping::Separator;
use std::ops::Range;

/// The place of each cell of a line, without surrounding spaces and quotes. As in the cell reader, a quote opens a quoted cell only as its
/// first character: `5"` is a length in inches.
pub fn cell_places(line: &str, separator: Separator) -> Vec<Range<usize>> {
    let is_separator = |c: char| match separator {
        Separator::Spaces => matches!(c, ' ' | '\t'),
        other => c == char::from(other.byte()),
    };
    let mut places = Vec::new();
    // In a quoted cell, two quotes stand for one; they close and reopen the cell.
    let (mut from, mut begins_quoted, mut is_quoted) = (0, false, false);
    for (at, c) in line.char_indices() {
        begins_quoted |= c == '"' && at == from;
        is_quoted ^= c == '"' && begins_quoted;
        if !is_quoted && is_separator(c) {
            places.push(from..at);
            from = at + c.len_utf8();
            begins_quoted = false;
        }
    }
    places.push(from..line.len());
    // A run of spaces is a single separator.
    if separator == Separator::Spaces {
        places.retain(|place| !place.is_empty());
    }
    let bare = |place: Range<usize>| {
        let trimmed = within(line, place, char::is_whitespace);
        within(line, trimmed, |c| c == '"')
    };
    places.into_iter().map(bare).collect()
}

/// The place without the outside characters at its ends.
fn within(line: &str, place: Range<usize>, is_outside: impl Fn(char) -> bool) -> Range<usize> {
    let cell = &line[place.clone()];
    let start = place.start + (cell.len() - cell.trim_start_matches(&is_outside).len());
    start..start + cell.trim_matches(&is_outside).len()
}

#[cfg(test)]
mod tests {
    use super::cell_places;
    use crate::measurement::columns::mapping::Separator;

    #[test]
    fn cells_are_found_between_separators_and_within_quotes() {
        let cells = |line: &'static str, separator| -> Vec<&'static str> {
            let places = cell_places(line, separator);
            places.into_iter().map(|place| &line[place]).collect()
        };
        assert_eq!(
            cells("P1,\"10,5\" ,,2 ", Separator::Comma),
            ["P1", "10,5", "", "2"]
        );
        assert_eq!(
            cells("5\",\"a, \"\"b\"\"\",7", Separator::Comma),
            ["5", "a, \"\"b", "7"]
        );
        assert_eq!(
            cells("\"say \"\"x\"\", y\",1,2", Separator::Comma),
            ["say \"\"x\"\", y", "1", "2"]
        );
        assert_eq!(cells("  1   2\t\t3 ", Separator::Spaces), ["1", "2", "3"]);
        assert_eq!(
            cells("é;\u{2212}1;", Separator::Semicolon),
            ["é", "\u{2212}1", ""]
        );
    }
}
