//! Points of ABB: `CONST jointtarget p10:=[[0,-30,20,0,30,0],[9E+09,…]];`. RAPID allows any spaces, line breaks and letter case, so each
//! statement is read up to its semicolon.

use crate::measurement::programs::point::{Found, Reason};
use crate::measurement::programs::text::{Node, code, last_word, list};

/// Number of axes in each part of a `jointtarget`: the robot's own, and external ones.
const N_AXES: usize = 6;
/// Keywords before the name in a declaration.
const DECLARING: [&str; 6] = ["LOCAL", "TASK", "CONST", "PERS", "VAR", "ALIAS"];

/// The points of a module.
pub(super) fn points(text: &str) -> Found {
    let mut found = Found::default();
    if !text.contains(":=") {
        return found;
    }
    let code = code(text, '!', &['"']);
    let mut start = 0;
    for text in code.split(';') {
        if let Some(open) = text.find('[') {
            statement(&code[..start + text.len()], start, start + open, &mut found);
        }
        start += text.len() + 1;
    }
    found
}

/// The name, the type, and the first word of a declaration or assignment that ends before `:=`.
struct Declared<'t> {
    name: &'t str,
    of_type: &'t str,
    at: usize,
}

fn declared(head: &str, start: usize) -> Declared<'_> {
    let bare = head.trim_end();
    let named = match bare.ends_with('}') {
        // The length of an array.
        true => bare.rfind('{').map_or(bare, |at| &bare[..at]),
        false => bare,
    };
    let name = last_word(named);
    let mut before = named.trim_end().len() - name.len();
    let mut at = start + before;
    let of_type = last_word(&head[..before]);
    let is_known = ["jointtarget", "robtarget"]
        .iter()
        .any(|known| of_type.eq_ignore_ascii_case(known));
    if is_known {
        before = head[..before].trim_end().len() - of_type.len();
        at = start + before;
        loop {
            let word = last_word(&head[..before]);
            if !DECLARING
                .iter()
                .any(|known| word.eq_ignore_ascii_case(known))
            {
                break;
            }
            before = head[..before].trim_end().len() - word.len();
            at = start + before;
        }
    }
    Declared { name, of_type, at }
}

/// Reads the statement that begins at `start` and has its first bracket at `open`.
fn statement(code: &str, start: usize, open: usize, found: &mut Found) {
    let head = code[start..open].trim_end();
    let Some(head) = head.strip_suffix(":=") else {
        return;
    };
    let Declared { name, of_type, at } = declared(head, start);
    if of_type.eq_ignore_ascii_case("robtarget") {
        return found.other(at, name, Reason::Cartesian);
    }
    if !of_type.eq_ignore_ascii_case("jointtarget") {
        return;
    }
    match list(code, open).map(|(node, _)| node) {
        Some(value) if is_joints(&value) => target(code, at, name, &value, found),
        Some(value) if !value.list().is_empty() && value.list().iter().all(is_joints) => {
            for (number, value) in (1..).zip(value.list()) {
                target(code, at, &format!("{name}{{{number}}}"), value, found);
            }
        }
        _ => found.other(at, name, Reason::NotNumbers),
    }
}

fn length(node: Option<&Node>) -> usize {
    node.map_or(0, |node| node.list().len())
}

fn is_joints(node: &Node) -> bool {
    let parts = node.list();
    parts.len() == 2 && length(parts.first()) == N_AXES && length(parts.get(1)) == N_AXES
}

fn target(code: &str, at: usize, name: &str, value: &Node, found: &mut Found) {
    match value.list().first().and_then(Node::items) {
        Some(angles) => {
            let external = value.list().get(1).and_then(Node::items);
            let external = external.unwrap_or_default().into_iter().zip('a'..);
            let external = external.map(|(value, axis)| (format!("eax_{axis}"), value));
            found.point(code, at, name, angles, external.collect());
        }
        None => found.other(at, name, Reason::NotNumbers),
    }
}
