//! Points of a FANUC listing such as `P[1:"name"]{ GP1: UF : 0, UT : 1, J1= 0.000 deg, … };`, which extend over several lines.

use crate::measurement::programs::point::{Found, Reason};
use crate::measurement::programs::text::trimmed;
use std::ops::Range;

pub(super) fn is_listing(text: &str) -> bool {
    text.lines().any(|line| line.trim() == "/POS") && text.contains("P[")
}

/// The points of a listing.
pub(super) fn points(text: &str) -> Found {
    let mut found = Found::default();
    let mut begun: Option<(usize, &str)> = None;
    let mut is_position = false;
    let mut start = 0;
    for line in text.split_inclusive('\n') {
        let plain = line.trim();
        is_position |= plain == "/POS";
        if is_position && plain.starts_with("P[") {
            begun = Some((start + (line.len() - line.trim_start().len()), plain));
        }
        start += line.len();
        if plain.contains("};")
            && let Some((at, head)) = begun.take()
        {
            point(text, head, at..start, &mut found);
        }
    }
    found
}

fn point(text: &str, head: &str, range: Range<usize>, found: &mut Found) {
    let label = head["P[".len()..].split(']').next().unwrap_or_default();
    let (number, name) = label.split_once(':').unwrap_or((label, ""));
    let number = number.trim();
    let name = match name.trim().trim_matches('"') {
        "" => format!("P{number}"),
        name => name.to_owned(),
    };
    let at = range.start;
    let body = &text[range.clone()];
    let open = body.find('{').map_or(body.len(), |open| open + 1);
    // Further motion groups (GP2, …) are other machines.
    let groups = body[open..].find("GP2").map(|length| at + open + length);
    let (begin, end) = (at + open, groups.unwrap_or(range.end));
    let mut entries = Vec::new();
    let mut from = begin;
    for part in text[begin..end].split([',', '\n']) {
        let whole = from..from + part.len();
        from = whole.end + 1;
        if let Some((name, _)) = part.split_once('=') {
            let value = trimmed(text, whole.start + name.len() + 1..whole.end);
            entries.push((name.trim(), value));
        }
    }
    let entry = |wanted: &str| {
        let known = entries.iter().find(|(name, _)| *name == wanted);
        known.map(|(_, value)| value.clone())
    };
    // An axis in mm is no joint of the arm.
    let angle = |joint: usize| {
        let value = entry(&format!("J{joint}"))?;
        let plain = text[value.clone()].trim_end_matches("};").trim_end();
        let angle = plain.strip_suffix("deg")?.trim_end();
        Some(value.start..value.start + angle.len())
    };
    let angles: Vec<Range<usize>> = (1..=9).map_while(angle).collect();
    // Extended axes are E1 to E3, and joints in mm.
    let further = (angles.len() + 1..=9).map(|joint| format!("J{joint}"));
    let names = (1..=3).map(|number| format!("E{number}")).chain(further);
    let axis = |name: String| {
        let value = entry(&name)?;
        let plain = text[value.clone()].trim_end_matches("};").trim_end();
        let plain = plain
            .trim_end_matches("deg")
            .trim_end_matches("mm")
            .trim_end();
        Some((name, value.start..value.start + plain.len()))
    };
    let external: Vec<(String, Range<usize>)> = names.filter_map(axis).collect();
    match (entry("J1"), entry("X")) {
        (None, Some(_)) => found.other(at, &name, Reason::Cartesian),
        (None, None) => {}
        _ => {
            let before = found.points.len();
            found.point(text, at, &name, angles, external);
            if let Some(point) = found.points.get_mut(before) {
                point.number = number.to_owned();
            }
        }
    }
}
