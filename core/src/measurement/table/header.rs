//! Finds the header and the column separator of a table.

use crate::measurement::columns::mapping::{Mapping, Separator};
use crate::measurement::columns::names::{Known, LENGTHS, TimeUnit, Unit, recognise, unit_alone};
use crate::measurement::issue::{ParseError, whole};
use crate::measurement::table::lines::{Line, cells, comment_mark, is_numeric, lines};

/// Number of lines that are used to find the separator if no header is known.
const SAMPLE: usize = 20;

/// A header that was found.
pub struct Header {
    pub line: usize,
    pub separator: Separator,
    pub cells: Vec<String>,
    score: usize,
    is_comment: bool,
}

fn score(cells: &[String], mapping: &Mapping) -> usize {
    let is_known = |cell: &&String| {
        mapping.names(cell)
            || match recognise(cell, None) {
                Known::Unknown => false,
                // These words also occur in titles, so they count only in lines with more than two cells.
                Known::Key(_) | Known::Plain(_) => cells.len() > 2,
                _ => true,
            }
    };
    cells.iter().filter(is_known).count()
}

pub fn stated_header(
    text: &str,
    line: usize,
    separators: &[Separator],
    mapping: &Mapping,
) -> Result<Header, ParseError> {
    let Some(found) = line.checked_sub(1).and_then(|at| lines(text).nth(at)) else {
        let detail = format!(
            "the mapping says that the header is on line {line}, which the file does not have"
        );
        return Err(whole("no_header", detail));
    };
    let candidates = candidates(line, found.text, separators, mapping);
    let best = candidates.into_iter().reduce(|a, b| {
        match (b.score, b.cells.len()) > (a.score, a.cells.len()) {
            true => b,
            false => a,
        }
    });
    best.ok_or_else(|| whole("no_header", format!("line {line} is empty")))
}

/// Candidates for the header: the line, split by each separator.
fn candidates(line: usize, text: &str, separators: &[Separator], mapping: &Mapping) -> Vec<Header> {
    let mark = comment_mark(text);
    let plain = mark.map_or(text, |mark| &text.trim_start()[mark.len()..]);
    let split = |separator: &Separator| {
        let cells = cells(plain, *separator);
        Header {
            line,
            separator: *separator,
            score: score(&cells, mapping),
            cells,
            is_comment: mark.is_some(),
        }
    };
    let found: Vec<Header> = separators
        .iter()
        .map(split)
        .filter(|header| !header.cells.is_empty())
        .collect();
    // Names may contain spaces. So spaces are no separator if another separator gives three or more cells.
    let has_other = found
        .iter()
        .any(|header| header.separator != Separator::Spaces && header.cells.len() > 2);
    found
        .into_iter()
        .filter(|header| !has_other || header.separator != Separator::Spaces)
        .collect()
}

/// Finds the header: the line with the most known cells. Among equal lines, a line that is not a comment is preferred.
pub fn found_header(
    above: &[Line],
    body: usize,
    separators: &[Separator],
    mapping: &Mapping,
) -> Result<Option<Header>, ParseError> {
    let mut best: Option<Header> = None;
    let mut rival = None;
    for (at, line) in above.iter().enumerate().skip(body) {
        if line.text.len() > 64 * 1024 {
            break;
        }
        for header in candidates(at + 1, line.text, separators, mapping) {
            let rank = |header: &Header| (header.score, !header.is_comment);
            let Some(known) = &best else {
                if header.score > 0 {
                    best = Some(header);
                }
                continue;
            };
            if rank(&header) > rank(known) {
                (best, rival) = (Some(header), None);
            } else if rank(&header) == rank(known)
                && header.line == known.line
                // Names may contain spaces.
                && header.separator != Separator::Spaces
                && header.cells != known.cells
            {
                rival = Some(header.separator);
            }
        }
    }
    if let (Some(best), Some(rival)) = (&best, rival)
        && best.score > 1
    {
        let detail = format!(
            "line {0} can be read with {1:?} or with {2:?} between its columns. State it in the column mapping: {{\"separator\": {1:?}}}",
            best.line,
            best.separator.as_str(),
            rival.as_str()
        );
        return Err(whole("two_readings", detail));
    }
    if let Some(best) = best {
        refuse_rows_above(&best, &above[body..best.line - 1], body)?;
        return Ok(Some(widest(best, above, separators, mapping)));
    }
    let separator = separator_of_data(&above[body..], separators)?;
    Ok(first_named(above, body, separator))
}

/// Minimum number of known columns in a header for refusing rows above it. Matrices above a header have four numbers in a line, so they are
/// not refused.
const MIN_KNOWN: usize = 6;

/// Refuses a header with rows of another table above it, because these rows would be ignored. `above` begins after the first `n_skipped`
/// lines.
fn refuse_rows_above(header: &Header, above: &[Line], n_skipped: usize) -> Result<(), ParseError> {
    let is_row = |line: &Line| {
        let cells = cells(line.text, header.separator);
        let n_numbers = cells.iter().filter(|cell| is_numeric(cell)).count();
        // Labels may be among the known columns, so fewer numbers are sufficient.
        4 * n_numbers >= 3 * header.score
    };
    let rows = above.iter().enumerate().filter(|(_, line)| is_row(line));
    let rows: Vec<usize> = rows.map(|(at, _)| n_skipped + at + 1).collect();
    let [first, .., last] = rows[..] else {
        return Ok(());
    };
    if header.score < MIN_KNOWN {
        return Ok(());
    }
    let detail = format!(
        "lines {first} to {last} look like rows, and the header was found below them, on line {0}: are these two tables? Write them into files of their own, or say which \
         line is the header, in the column mapping: {{\"header_row\": {0}}}",
        header.line
    );
    Err(whole("two_readings", detail))
}

/// Splits a header with only one known cell by the separator that gives the most cells. With one known cell, several separators may have the same
/// score.
fn widest(header: Header, above: &[Line], separators: &[Separator], mapping: &Mapping) -> Header {
    if header.score > 1 {
        return header;
    }
    let (line, score) = (header.line, header.score);
    let others = candidates(line, above[line - 1].text, separators, mapping);
    others
        .into_iter()
        .filter(|other| other.score == score)
        .fold(header, |best, other| {
            match other.cells.len() > best.cells.len() {
                true => other,
                false => best,
            }
        })
}

/// The header of a table without known names: the first line with several cells, if it contains no number.
fn first_named(above: &[Line], body: usize, separator: Separator) -> Option<Header> {
    let (at, cells) = above
        .iter()
        .enumerate()
        .skip(body)
        .filter(|(_, line)| comment_mark(line.text).is_none())
        .map(|(at, line)| (at, cells(line.text, separator)))
        .find(|(_, cells)| cells.iter().filter(|cell| !cell.is_empty()).count() > 1)?;
    (!cells.iter().any(|cell| is_numeric(cell))).then_some(Header {
        line: at + 1,
        separator,
        cells,
        score: 0,
        is_comment: false,
    })
}

/// The separator with which most rows have the same number of cells, at least two.
pub fn separator_of_data(
    above: &[Line],
    separators: &[Separator],
) -> Result<Separator, ParseError> {
    let data: Vec<&Line> = above
        .iter()
        .filter(|line| !line.text.trim().is_empty() && comment_mark(line.text).is_none())
        .take(SAMPLE)
        .collect();
    let width = |separator: Separator| {
        let widths: Vec<usize> = data
            .iter()
            .map(|line| cells(line.text, separator).len())
            .collect();
        let most = widths.iter().copied().max().unwrap_or(0);
        let alike = widths.iter().filter(|width| **width == most).count();
        (most > 1 && 2 * alike > widths.len()).then_some(most)
    };
    // Cells may contain spaces, so spaces are the separator only if no other separator is possible.
    let found: Vec<Separator> = separators
        .iter()
        .copied()
        .filter(|separator| *separator != Separator::Spaces && width(*separator).is_some())
        .collect();
    match found[..] {
        [separator] => Ok(separator),
        [] if width(Separator::Spaces).is_some() => Ok(Separator::Spaces),
        [] => Ok(separators[0]),
        _ => {
            let names: Vec<String> = found.iter().map(|s| format!("{:?}", s.as_str())).collect();
            let detail = format!(
                "columns may be separated by {}. State it in the column mapping: {{\"separator\": {}}}",
                names.join(" or by "),
                names[0]
            );
            Err(whole("two_readings", detail))
        }
    }
}

/// Empty column names for a table without a header.
pub fn unnamed(above: &[Line], separator: Separator) -> Vec<String> {
    let widths = above
        .iter()
        .filter(|line| comment_mark(line.text).is_none())
        .take(SAMPLE)
        .map(|line| cells(line.text, separator).len());
    vec![String::new(); widths.max().unwrap_or(0)]
}

/// Whether the line above the header has the groups `Rotation` and `Position`, as for a rigid body in files of OptiTrack.
pub fn has_rotation_and_position(above: &[String]) -> bool {
    let has = |name: &str| above.iter().any(|cell| cell.eq_ignore_ascii_case(name));
    has(ROTATION) && has("position")
}

/// Above X, Y and Z that are components of a rotation.
pub const ROTATION: &str = "rotation";

/// The unit in a line such as `Length Units,Millimeters` above the header, as in files of OptiTrack.
pub fn stated_length_unit(above: &[Line]) -> Option<&'static str> {
    // For a rigid body, columns named X, Y and Z may also be components of a quaternion. No unit is assumed unless a line tells them apart.
    let of_rotation = |line: &Line| {
        let cells = cells(line.text, Separator::Comma);
        let has_rotation = cells.iter().any(|cell| cell.eq_ignore_ascii_case(ROTATION));
        has_rotation && !has_rotation_and_position(&cells)
    };
    if above.iter().any(of_rotation) {
        return None;
    }
    above.iter().find_map(|line| {
        let cells = cells(line.text, Separator::Comma);
        let at = cells
            .iter()
            .position(|cell| cell.eq_ignore_ascii_case("length units"))?;
        match unit_alone(cells.get(at + 1)?)? {
            Unit::Is(unit) if LENGTHS.iter().any(|(name, _)| *name == unit) => Some(unit),
            _ => None,
        }
    })
}

/// The rate in the second line of a file of Vicon: `Trajectories`, below it the frames per second, and a header with `Frame` and `Sub Frame`.
pub fn stated_frame_rate(above: &[Line], header: &[String]) -> Option<TimeUnit> {
    let has = |name: &str| {
        header
            .iter()
            .any(|cell| cell.trim().eq_ignore_ascii_case(name))
    };
    let alone = |line: &Line| {
        line.text
            .trim()
            .trim_end_matches([',', ';', '\t'])
            .to_owned()
    };
    let (title, rate) = (alone(above.first()?), alone(above.get(1)?));
    let is_title = title.starts_with(char::is_alphabetic);
    (has("frame") && has("sub frame") && is_title).then(|| TimeUnit::of_rate(&rate))?
}

/// The row of units below the header, if there is one, and the number of lines above the data.
pub fn units_below(
    text: &str,
    header: usize,
    separator: Separator,
    n_columns: usize,
) -> (Option<Vec<Option<Unit>>>, usize) {
    if header == 0 {
        return (None, 0);
    }
    let next = lines(text)
        .enumerate()
        .skip(header)
        .find(|(_, line)| !line.text.trim().is_empty());
    let Some((at, line)) = next.filter(|(_, line)| line.text.len() < 64 * 1024) else {
        return (None, header);
    };
    let plain =
        comment_mark(line.text).map_or(line.text, |mark| &line.text.trim_start()[mark.len()..]);
    let found: Vec<String> = cells(plain, separator);
    let units: Vec<Option<Unit>> = found.iter().map(|cell| unit_alone(cell)).collect();
    let named = found
        .iter()
        .zip(&units)
        .filter(|(cell, _)| !cell.is_empty());
    let n_units = units.iter().flatten().count();
    if n_units >= 2 && named.count() == n_units && found.len() <= n_columns {
        return (Some(units), at + 1);
    }
    (None, header)
}
