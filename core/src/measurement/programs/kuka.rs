//! Points of KUKA: `DECL E6AXIS XP1={A1 10.0,A2 -90.0,…,E1 0.0}` of a data list, and assignments such as `CALP[1]={A1 10.0, …}`. An aggregate in braces is on one line.

use crate::measurement::programs::point::{Found, Reason};
use crate::measurement::programs::text::{code, is_word, last_word, trimmed};
use std::collections::BTreeMap;
use std::ops::Range;

const CARTESIAN_TYPES: [&str; 3] = ["e6pos", "pos", "frame"];
const JOINT_TYPES: [&str; 2] = ["e6axis", "axis"];
/// Keywords before the type in a declaration.
const DECLARING: [&str; 4] = ["decl", "global", "const", "public"];

/// The points of a program. A point named `XP1` is the point P1 of the inline forms.
pub(super) fn points(text: &str) -> Found {
    let mut found = Found::default();
    if !text.contains('{') {
        return found;
    }
    let code = code(text, ';', &['"']);
    let types = declared_types(&code);
    let mut start = 0;
    for line in code.split_inclusive('\n') {
        let mut behind = 0;
        while let Some((open, close)) = braces(line, behind) {
            aggregate(
                &code,
                &line[behind..open],
                start + open + 1..start + close,
                &types,
                &mut found,
            );
            behind = close + 1;
        }
        start += line.len();
    }
    found
}

/// The next pair of matching braces.
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
    // The type may come first: `{E6AXIS: A1 10.0, …}`.
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

fn aggregate(
    code: &str,
    head: &str,
    inner: Range<usize>,
    types: &BTreeMap<String, String>,
    found: &mut Found,
) {
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
    let Some((of_type, name)) = declared.and_then(|head| declaration(head, types)) else {
        return;
    };
    // `{E6AXIS: A1 10.0, …}`
    let own = code[at..].split(['}', ',']).next().unwrap_or_default();
    let own = own
        .split_once(':')
        .map(|(own, _)| own.trim().to_lowercase());
    let of_type = of_type.or(own);
    let angles: Vec<Range<usize>> = (1..=6)
        .map_while(|number| component(&format!("A{number}")))
        .collect();
    let is_joints = match of_type.as_deref() {
        // The variable is declared in another file, so the type follows from the value.
        None => angles.len() == 6,
        Some(of_type) => JOINT_TYPES.contains(&of_type),
    };
    let bare = name
        .strip_prefix(['X', 'x'])
        .filter(|rest| !rest.is_empty())
        .unwrap_or(name);
    if is_joints {
        let external = (1..=6).filter_map(|number| {
            let name = format!("E{number}");
            Some((name.clone(), component(&name)?))
        });
        found.point(code, at, bare, angles, external.collect());
    } else if of_type.is_some_and(|of_type| CARTESIAN_TYPES.contains(&&*of_type)) {
        found.other(at, bare, Reason::Cartesian);
    }
}

/// Type, in lower case, and name of the variable that `head=` declares or assigns. For an assignment, the type comes from the declaration
/// of the name elsewhere in the file. None if `head=` is neither.
fn declaration<'h>(
    head: &'h str,
    types: &BTreeMap<String, String>,
) -> Option<(Option<String>, &'h str)> {
    let Some((before, name)) = head.rsplit_once(char::is_whitespace) else {
        return assigned(head, types);
    };
    match before.trim() {
        "" => assigned(name, types),
        before => Some((Some(last_word(before).to_lowercase()), name)),
    }
}

/// An assignment such as `CALP[3]=`.
fn assigned<'h>(
    name: &'h str,
    types: &BTreeMap<String, String>,
) -> Option<(Option<String>, &'h str)> {
    let (base, index) = name.split_once('[').unwrap_or((name, "1]"));
    let is_index = index
        .strip_suffix(']')
        .is_some_and(|index| !index.is_empty() && index.chars().all(|c| c.is_ascii_digit()));
    let begins = base.starts_with(|c: char| c.is_alphabetic());
    let is_name = begins && base.chars().all(|c| is_word(c) && c != '$');
    let of_type = types.get(&base.to_lowercase()).cloned();
    (is_name && is_index).then_some((of_type, name))
}

/// The type of each declared variable, both in small letters: `DECL E6AXIS CALP[40]`.
fn declared_types(code: &str) -> BTreeMap<String, String> {
    let mut types = BTreeMap::new();
    for line in code.lines() {
        let lower = line.split('=').next().unwrap_or_default().to_lowercase();
        let words = lower.split(|c: char| !is_word(c));
        let mut words = words.filter(|word| !word.is_empty()).peekable();
        let mut is_declared = false;
        while words.next_if(|word| DECLARING.contains(word)).is_some() {
            is_declared = true;
        }
        let Some(of_type) = words.next() else {
            continue;
        };
        if is_declared || JOINT_TYPES.contains(&of_type) || CARTESIAN_TYPES.contains(&of_type) {
            types.extend(words.map(|name| (name.to_owned(), of_type.to_owned())));
        }
    }
    types
}
