//! Reads joint values from robot programs (data lists of KUKA, modules of ABB, listings of FANUC) as tables with one row per point. In these
//! languages the values are defined to be in degrees.

use crate::measurement::csv_issue::{ParseError, whole};

/// Maximum number of joints of a point, including external axes.
const MAX_AXES: usize = 12;

/// A point of a program.
struct Point {
    /// Its line, counted from 0.
    line: usize,
    name: String,
    number: String,
    angles: Vec<String>,
}

/// Converts a program to a table in which each point keeps its line. None if the text is not a known program.
///
/// # Errors
/// If the positions of the program are not joint values in degrees.
pub(super) fn table(text: &str) -> Result<Option<String>, ParseError> {
    if text.contains("///PULSE") {
        let detail = "a job whose positions are in pulses: how many make a degree is not in the file. Export the positions as joint angles, \
                      or log the angles";
        return Err(whole("not_angles", detail.into()));
    }
    let points = if text.contains("/POS") && text.contains("P[") {
        fanuc(text)
    } else {
        text.lines()
            .enumerate()
            .filter_map(|(line, text)| kuka(line, text).or_else(|| abb(line, text)))
            .collect()
    };
    Ok((!points.is_empty()).then(|| in_table(&points)))
}

fn in_table(points: &[Point]) -> String {
    let n_axes = points
        .iter()
        .map(|point| point.angles.len())
        .max()
        .unwrap_or(0);
    let joints: Vec<String> = (1..=n_axes)
        .map(|joint| format!("J{joint} [deg]"))
        .collect();
    let mut text = format!("name\tnumber\t{}\n", joints.join("\t"));
    let mut at = 1;
    for point in points {
        while at < point.line {
            text.push('\n');
            at += 1;
        }
        text.push_str(&format!(
            "{}\t{}\t{}\n",
            point.name,
            point.number,
            point.angles.join("\t")
        ));
        at += 1;
    }
    text
}

/// The digits at the end of a name.
fn number_of(name: &str) -> String {
    let digits = name.len() - name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    name[name.len() - digits..].to_owned()
}

fn point(line: usize, name: &str, angles: Vec<String>) -> Option<Point> {
    let is_number = |text: &String| text.parse::<f64>().is_ok();
    (!angles.is_empty() && angles.len() <= MAX_AXES && angles.iter().all(is_number)).then(|| {
        Point {
            line,
            number: number_of(name),
            name: name.to_owned(),
            angles,
        }
    })
}

/// Parses a line of KUKA such as `DECL E6AXIS XP1={A1 10.0,A2 -90.0,…,E1 0.0}`: the point P1.
fn kuka(line: usize, text: &str) -> Option<Point> {
    let (head, rest) = text.split_once('{')?;
    let (declared, _) = head.split_once('=')?;
    let mut words = declared.split_whitespace().rev();
    let name = words.next()?;
    if !words.any(|word| word.eq_ignore_ascii_case("E6AXIS") || word.eq_ignore_ascii_case("AXIS")) {
        return None;
    }
    let body = rest.split_once('}')?.0;
    let body = body.rsplit_once(':').map_or(body, |(_, body)| body);
    let axis = |number: usize| {
        let wanted = format!("A{number}");
        body.split(',').find_map(|part| {
            let (axis, value) = part.trim().split_once(' ')?;
            axis.eq_ignore_ascii_case(&wanted)
                .then(|| value.trim().to_owned())
        })
    };
    let angles: Vec<String> = (1..=6).map_while(axis).collect();
    let name = name
        .strip_prefix(['X', 'x'])
        .filter(|rest| !rest.is_empty())
        .unwrap_or(name);
    point(line, name, angles)
}

/// Parses a line of ABB such as `CONST jointtarget p10:=[[0,-30,20,0,30,0],[9E+09,…]];`.
fn abb(line: usize, text: &str) -> Option<Point> {
    let (head, value) = text.split_once(":=")?;
    let mut words = head.split_whitespace().rev();
    let name = words.next()?;
    if !words.any(|word| word.eq_ignore_ascii_case("jointtarget")) {
        return None;
    }
    let inner = value.trim().strip_prefix("[[")?.split_once(']')?.0;
    point(
        line,
        name,
        inner
            .split(',')
            .map(|angle| angle.trim().to_owned())
            .collect(),
    )
}

/// Parses points of FANUC such as `P[1:"name"]{ GP1: UF : 0, UT : 1, J1= 0.000 deg, … };`, which extend over several lines.
fn fanuc(text: &str) -> Vec<Point> {
    let mut points = Vec::new();
    let mut begun: Option<(usize, String, String, String)> = None;
    let mut is_position = false;
    for (line, text) in text.lines().enumerate() {
        let plain = text.trim();
        is_position |= plain == "/POS";
        if let Some(rest) = plain.strip_prefix("P[").filter(|_| is_position) {
            let (label, _) = rest.split_once(']').unwrap_or((rest, ""));
            let (number, name) = label.split_once(':').unwrap_or((label, ""));
            let name = match name.trim().trim_matches('"') {
                "" => format!("P{}", number.trim()),
                name => name.replace('\t', " "),
            };
            begun = Some((line, name, number.trim().to_owned(), String::new()));
        }
        if let Some((_, _, _, body)) = &mut begun {
            body.push_str(plain);
            body.push(',');
        }
        if plain.contains("};") {
            points.extend(begun.take().and_then(fanuc_point));
        }
    }
    points
}

fn fanuc_point((line, name, number, body): (usize, String, String, String)) -> Option<Point> {
    // Further motion groups (GP2, …) are other machines.
    let own = body.split_once("GP2").map_or(body.as_str(), |(own, _)| own);
    let axis = |joint: usize| {
        let wanted = format!("J{joint}");
        own.split(',').find_map(|part| {
            let (axis, value) = part.split_once('=')?;
            let value = value.trim().trim_end_matches("};").trim();
            let value = value.strip_suffix("deg")?.trim();
            (axis.trim() == wanted).then(|| value.to_owned())
        })
    };
    let angles: Vec<String> = (1..=9).map_while(axis).collect();
    let mut found = point(line, &name, angles)?;
    found.number = number;
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::table;

    #[test]
    fn points_of_programs_are_found_on_their_lines() {
        let kuka = "&ACCESS RVP\nDEFDAT CAL\nDECL E6POS XP1={X 1.0,Y 2.0}\nDECL E6AXIS XP2={A1 1.5,A2 -90.0,A3 90,A4 0.0,A5 -1E1,A6 0.25,E1 0.0}\nENDDAT\n";
        let found = table(kuka).unwrap().unwrap();
        let lines: Vec<&str> = found.lines().collect();
        assert_eq!(lines[3], "P2\t2\t1.5\t-90.0\t90\t0.0\t-1E1\t0.25");
        let abb = "MODULE m\n  CONST jointtarget cal_10:=[[1,-2.5,3,4,5,6],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];\n  CONST robtarget p:=[[1,2,3],[1,0,0,0]];\nENDMODULE";
        let found = table(abb).unwrap().unwrap();
        assert_eq!(
            found.lines().nth(1),
            Some("cal_10\t10\t1\t-2.5\t3\t4\t5\t6")
        );
        assert_eq!(found.lines().count(), 2);
        let fanuc = "/PROG CAL\n/MN\n 1:J P[1] 10% FINE ;\n/POS\nP[1:\"T 1\"]{\n   GP1:\n\tUF : 0, UT : 1,\t\n\tJ1=    10.000 deg,\tJ2=   -30.000 deg,\tJ3=     5.500 deg,\n\tJ4=     0.000 deg,\tJ5=   -90.000 deg,\tJ6=     1.000 deg\n};\nP[2]{\n   GP1:\n\tUF : 0, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n\tX = 1.0 mm\n};\n/END\n";
        let found = table(fanuc).unwrap().unwrap();
        assert_eq!(
            found.lines().nth(4),
            Some("T 1\t1\t10.000\t-30.000\t5.500\t0.000\t-90.000\t1.000")
        );
        assert_eq!(found.lines().filter(|line| !line.is_empty()).count(), 2);
        assert!(table("q1_deg,x_mm\n1,2\n").unwrap().is_none());
        assert_eq!(
            table("/JOB\n///PULSE\nC00000=1,2\n").unwrap_err().issues[0].code,
            "not_angles"
        );
    }
}
