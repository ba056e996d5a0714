//! Points of Universal Robots' script: `movej([…], …)` and `P1_q=[…]`, as PolyScope writes its waypoints. Joint values are in radians.

use crate::measurement::programs::point::{Found, Reason};
use crate::measurement::programs::text::{code, is_word, last_word, list, trimmed};
use std::collections::BTreeSet;

const MOTIONS: [&str; 5] = ["movej", "movel", "movep", "movec", "servoj"];
const N_AXES: usize = 6;

/// The points of a script.
pub(super) fn points(text: &str) -> Found {
    let mut found = Found::default();
    let has_points = text.contains('[') && ["mov", "servoj", "_q"].iter().any(|w| text.contains(w));
    if !has_points {
        return found;
    }
    let code = code(text, '#', &['"', '\'']);
    let targets = targets_of_motions(&code);
    let mut at = 0;
    while let Some(open) = code[at..].find('[').map(|found| at + found) {
        let Some((node, end)) = list(&code, open) else {
            at = open + 1;
            continue;
        };
        let mut head = code[at..open].trim_end();
        let is_pose = last_word(head) == "p";
        if is_pose {
            head = head[..head.len() - 1].trim_end();
        }
        let line = head.len() - head.rsplit('\n').next().unwrap_or_default().len();
        let head_at = trimmed(&code, at + line..at + head.len()).start;
        let begin = if head_at < open { head_at } else { open };
        if let Some(name) = head.strip_suffix('=').map(last_word) {
            let is_waypoint = name.ends_with(if is_pose { "_p" } else { "_q" });
            if is_waypoint || targets.contains(name) {
                let name = name.strip_suffix("_q").unwrap_or(name);
                target(&code, begin, name, is_pose, node.items(), &mut found);
            }
        } else if let Some(function) = head.strip_suffix('(').map(last_word) {
            let is_target = MOTIONS.contains(&function) || is_pose && function == "get_inverse_kin";
            if is_target {
                target(&code, begin, "", is_pose, node.items(), &mut found);
            }
        }
        at = end;
    }
    // PolyScope writes each waypoint twice: NAME_p, and NAME_q with its joint values.
    let names: BTreeSet<String> = found.points.iter().map(|p| p.name.clone()).collect();
    let is_twice = |name: &str| name.strip_suffix("_p").is_some_and(|n| names.contains(n));
    found.others.retain(|other| !is_twice(&other.name));
    found
}

/// Names of the variables that motions go to.
fn targets_of_motions(code: &str) -> BTreeSet<&str> {
    let called = |(open, _): (usize, &str)| {
        let is_motion = MOTIONS.contains(&last_word(&code[..open]));
        let argument = code[open + 1..].trim_start();
        let end = argument.find(|c: char| !is_word(c))?;
        is_motion.then(|| &argument[..end])
    };
    code.match_indices('(').filter_map(called).collect()
}

fn target(
    code: &str,
    at: usize,
    name: &str,
    is_pose: bool,
    items: Option<Vec<std::ops::Range<usize>>>,
    found: &mut Found,
) {
    match items {
        _ if is_pose => found.other(at, name, Reason::Cartesian),
        Some(items) if items.len() == N_AXES => found.point(code, at, name, items),
        _ => found.other(at, name, Reason::NotNumbers),
    }
}
