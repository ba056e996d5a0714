//! Joint values of URScript and of plain lists: `P1=[0.1, -1.57, …]`. In a script with `movej` they are in radians; a plain list states no
//! unit.

use crate::measurement::programs::program::ProgramRows;
use crate::measurement::programs::text::{code, is_number, is_word};

/// Number of axes of these arms.
const N_AXES: usize = 6;
/// Minimum number of points.
const MIN_POINTS: usize = 2;
/// Largest joint value of these arms, rad: one turn, rounded up.
const MAX_RAD: f64 = 6.3;

/// The points of a script as a table with one row per point; none if the text is no such script.
pub(super) fn table(text: &str) -> Option<(String, ProgramRows)> {
    if !text.contains("=[") && !text.contains("= [") {
        return None;
    }
    let code = code(text, '#', &['"']);
    let is_script = code.lines().any(|line| {
        let line = line.trim_start();
        line.starts_with("def ") || line.starts_with("movej(")
    });
    let mut points = Vec::new();
    let mut n_other_lines = 0;
    for (at, line) in code.lines().enumerate() {
        match point(line) {
            Some((name, angles)) => points.push((at + 1, name, angles)),
            None if is_script || line.trim().is_empty() => n_other_lines += 1,
            None => return None,
        }
    }
    if points.len() < MIN_POINTS {
        return None;
    }
    let is_turn = |angle: &str| angle.parse().is_ok_and(|angle: f64| angle.abs() < MAX_RAD);
    let are_radians = is_script
        && code.contains("movej(")
        && points
            .iter()
            .all(|(.., angles)| angles.iter().all(|angle| is_turn(angle)));
    let unit = if are_radians { " [rad]" } else { "" };
    let joints: Vec<String> = (1..=N_AXES)
        .map(|joint| format!("J{joint}{unit}"))
        .collect();
    let mut rows = format!("name\tnumber\t{}\n", joints.join("\t"));
    for (_, name, angles) in &points {
        let digits = name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        rows.push_str(&format!(
            "{name}\t{}\t{}\n",
            &name[digits..],
            angles.join("\t")
        ));
    }
    let about = ProgramRows {
        lines: points.iter().map(|(line, ..)| *line).collect(),
        n_other_lines,
        ..ProgramRows::default()
    };
    Some((rows, about))
}

/// The point of a line: its name and its joint values.
fn point(line: &str) -> Option<(&str, Vec<&str>)> {
    let (head, list) = line.split_once('=')?;
    let head = head.trim();
    let name = ["global ", "local "]
        .iter()
        .find_map(|word| head.strip_prefix(word))
        .unwrap_or(head)
        .trim();
    let begins = name.starts_with(|c: char| c.is_alphabetic());
    let list = list.trim().trim_end_matches(';').trim_end();
    let list = list.strip_prefix('[')?.strip_suffix(']')?;
    let angles: Vec<&str> = list.split(',').map(str::trim).collect();
    let is_point = begins
        && name.chars().all(is_word)
        && angles.len() == N_AXES
        && angles.iter().all(|angle| is_number(angle));
    is_point.then_some((name, angles))
}

#[cfg(test)]
mod tests {
    use super::table;

    #[test]
    fn lists_of_a_script_are_radians_and_plain_lists_have_no_unit() {
        let script = "def cal():\n  # P0=[9,9,9,9,9,9]\n  global P1=[0.1, -1.5, 0, 0.5, 1, 2]\n  P2=[1,2,3,4,5,6]\n  movej(P1)\n  pose=p[1,2,3,0,0,0]\nend\n";
        let (rows, about) = table(script).unwrap();
        assert!(rows.contains("J6 [rad]\nP1\t1\t0.1\t-1.5"), "{rows}");
        assert_eq!(about.lines, [3, 4]);
        let (rows, _) = table("P1=[1,2,3,4,5,6]\nP2=[1,2,3,4,50,6]\n").unwrap();
        assert!(rows.contains("\tJ6\nP1\t1"), "{rows}");
        assert!(table("P1=[1,2,3,4,5,6]\nP2=[1,2,3,4,5,6]\nJ1 [deg],x_mm\n1,2\n").is_none());
    }
}
