//! Points of KUKA: `DECL E6AXIS XP1={A1 10.0,A2 -90.0,…,E1 0.0}` of a data list. An aggregate in braces is on one line.

use crate::measurement::programs::point::{Found, Reason};
use crate::measurement::programs::text::{code, last_word, trimmed};
use std::ops::Range;

const CARTESIAN_TYPES: [&str; 3] = ["E6POS", "POS", "FRAME"];
const JOINT_TYPES: [&str; 2] = ["E6AXIS", "AXIS"];

/// The points of a program. Those that are called `XP1` are the points P1 of the inline forms.
pub(super) fn points(text: &str) -> Found {
    let mut found = Found::default();
    if !text.contains('{') {
        return found;
    }
    let code = code(text, ';', &['"']);
    let mut start = 0;
    for line in code.split_inclusive('\n') {
        let mut behind = 0;
        while let Some((open, close)) = braces(line, behind) {
            aggregate(
                &code,
                &line[behind..open],
                start + open + 1..start + close,
                &mut found,
            );
            behind = close + 1;
        }
        start += line.len();
    }
    found
}

/// The next pair of braces that belong together.
fn braces(line: &str, from: usize) -> Option<(usize, usize)> {
    let open = from + line[from..].find('{')?;
    let mut depth = 0;
    for (at, byte) in line.bytes().enumerate().skip(open) {
        match byte {
            b'{' => depth += 1,
            b'}' if depth == 1 => return Some((open, at)),
            b'}' => depth -= 1,
            _ => {}
        }
    }
    None
}

/// The components of an aggregate, such as `A1 10.0`: name, and place of the value.
fn components(code: &str, inner: Range<usize>) -> Vec<(&str, Range<usize>)> {
    // The type may stand in front: `{E6AXIS: A1 10.0, …}`.
    let begin = code[inner.clone()]
        .find(':')
        .map_or(inner.start, |at| inner.start + at + 1);
    let mut parts = Vec::new();
    let (mut from, mut depth) = (begin, 0);
    for (at, byte) in code.bytes().enumerate().take(inner.end).skip(begin) {
        match byte {
            b'{' => depth += 1,
            b'}' => depth -= 1,
            b',' if depth == 0 => {
                parts.push(trimmed(code, from..at));
                from = at + 1;
            }
            _ => {}
        }
    }
    parts.push(trimmed(code, from..inner.end));
    parts
        .into_iter()
        .filter_map(|part| {
            let (name, _) = code[part.clone()].split_once(char::is_whitespace)?;
            Some((name, trimmed(code, part.start + name.len()..part.end)))
        })
        .collect()
}

fn aggregate(code: &str, head: &str, inner: Range<usize>, found: &mut Found) {
    let at = inner.start;
    let components = components(code, inner);
    let component = |wanted: &str| {
        let is_it = |(name, _): &&(&str, Range<usize>)| name.eq_ignore_ascii_case(wanted);
        components
            .iter()
            .find(is_it)
            .map(|(_, value)| value.clone())
    };
    let declared = head.trim_end().strip_suffix('=').map(str::trim_end);
    let Some((before, name)) = declared.and_then(|d| d.rsplit_once(char::is_whitespace)) else {
        return;
    };
    let word = last_word(before);
    let is_type = |types: &[&str]| types.iter().any(|known| word.eq_ignore_ascii_case(known));
    let name = name
        .strip_prefix(['X', 'x'])
        .filter(|rest| !rest.is_empty())
        .unwrap_or(name);
    if is_type(&JOINT_TYPES) {
        let angles = (1..=6).map_while(|number| component(&format!("A{number}")));
        found.point(code, at, name, angles.collect());
    } else if is_type(&CARTESIAN_TYPES) {
        found.other(at, name, Reason::Cartesian);
    }
}
