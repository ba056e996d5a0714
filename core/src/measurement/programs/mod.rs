//! Reads declared joint targets of robot programs (data lists of KUKA, modules of ABB, listings of FANUC) as tables with one row per point.
//! Joint values are in degrees in these languages, and in radians in URScript. Targets that are written directly into a motion are not
//! read, because they have no names to match measurements with.

mod abb;
mod external_axes;
mod fanuc;
mod kuka;
mod point;
mod program;
mod text;
mod universal_robots;

pub use point::{Point, Reason};
pub use program::{Language, Program, ProgramRows, Unread};

use crate::measurement::issue::{ParseError, whole};
use external_axes::external_axes;
use point::Found;

/// Number of points that a refusal names.
const MAX_NAMED: usize = 5;

/// Finds the points of a program. None if the text is not a known program.
///
/// # Errors
/// If none of its points has joint values in degrees.
pub fn find(text: &str) -> Result<Option<Program>, ParseError> {
    refuse_yaskawa(text)?;
    let found: Vec<(Language, Found)> = if fanuc::is_listing(text) {
        vec![(Language::Fanuc, fanuc::points(text))]
    } else {
        vec![
            (Language::Kuka, kuka::points(text)),
            (Language::Abb, abb::points(text)),
        ]
    };
    let mut found: Vec<(Language, Found)> =
        found.into_iter().filter(|(_, f)| !f.is_empty()).collect();
    let with_points = found.iter().position(|(_, found)| !found.points.is_empty());
    let Some((language, mut found)) = found.drain(..).nth(with_points.unwrap_or(0)) else {
        return match motion(text) {
            Some((line, remedy)) => Err(targets_in_motions(line, remedy)),
            None => Ok(None),
        };
    };
    found.finish();
    let lines = Lines::new(text);
    let unread = found.others.into_iter().map(|other| Unread {
        line: lines.line(other.at),
        name: other.name,
        reason: other.reason,
    });
    let program = Program {
        language,
        lines: found.points.iter().map(|p| lines.line(p.at)).collect(),
        points: found.points,
        unread: unread.collect(),
    };
    match program.points.is_empty() {
        true => Err(no_joint_values(&program)),
        false => Ok(Some(program)),
    }
}

/// Converts a program to a table with one row per point. None if the text is not a known program.
///
/// # Errors
/// As [`find`].
pub(super) fn table(text: &str) -> Result<Option<(String, ProgramRows)>, ParseError> {
    let Some(program) = find(text)? else {
        return Ok(universal_robots::table(text));
    };
    let external = external_axes(&program, text);
    let n_axes = program.points.first().map_or(0, |point| point.angles.len());
    let joints: Vec<String> = (1..=n_axes)
        .map(|joint| format!("J{joint} [deg]"))
        .collect();
    let mut rows = format!("name\tnumber\t{}\n", joints.join("\t"));
    for point in &program.points {
        let angles: Vec<&str> = point.angles.iter().map(|at| &text[at.clone()]).collect();
        let name = point.name.replace(['\t', '"'], " ");
        rows.push_str(&format!(
            "{name}\t{}\t{}\n",
            point.number,
            angles.join("\t")
        ));
    }
    let mut different = program.lines.clone();
    different.dedup();
    let about = ProgramRows {
        n_other_lines: text.lines().count().saturating_sub(different.len()),
        lines: program.lines,
        unread: external
            .standing
            .into_iter()
            .chain(program.unread)
            .collect(),
        moving_axis: external.moving,
    };
    Ok(Some((rows, about)))
}

/// The lines of a text.
struct Lines(Vec<usize>);

impl Lines {
    fn new(text: &str) -> Self {
        let ends = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
        Self(ends.map(|(at, _)| at).collect())
    }

    /// The line of a byte, counted from 1.
    fn line(&self, at: usize) -> usize {
        self.0.partition_point(|end| *end < at) + 1
    }
}

fn refuse_yaskawa(text: &str) -> Result<(), ParseError> {
    let detail = if text.contains("///PULSE") {
        "a job whose positions are in pulses: how many make a degree is not in the file. Export the positions as joint angles, or log the angles"
    } else if text.contains("///RECTAN") {
        "a job whose positions are Cartesian: it has no joint values. Log the joint angles at each of them"
    } else {
        return Ok(());
    };
    Err(whole("not_angles", detail.into()))
}

/// The first motion to a joint target that is written into it: its line, counted from 1, and advice what to export instead.
fn motion(text: &str) -> Option<(usize, &'static str)> {
    let motions = [
        ("ptp{", Language::Kuka.remedy()),
        ("sptp{", Language::Kuka.remedy()),
        ("moveabsj[[", Language::Abb.remedy()),
        (
            "movej([",
            "Write them into a table with a row per point, or log actual_q at each of them",
        ),
    ];
    let plain = |line: &str| {
        let signs = line.chars().filter(|c| !c.is_whitespace()).take(20);
        signs.collect::<String>().to_lowercase()
    };
    text.lines().enumerate().find_map(|(at, line)| {
        let line = plain(line);
        let found = motions.iter().find(|(begin, _)| line.starts_with(begin));
        found.map(|(_, remedy)| (at + 1, *remedy))
    })
}

fn targets_in_motions(line: usize, remedy: &str) -> ParseError {
    let detail = format!(
        "a robot program whose joint targets are written into its motions (line {line}): nothing in it says which measurement belongs to which motion. {remedy}"
    );
    whole("not_angles", detail)
}

fn no_joint_values(program: &Program) -> ParseError {
    let name = |point: &Unread| format!("{} (line {})", point.name, point.line);
    let named: Vec<String> = program.unread.iter().take(MAX_NAMED).map(name).collect();
    let n = program.unread.len();
    let more = if n > named.len() { ", …" } else { "" };
    let reason = match program
        .unread
        .iter()
        .find(|p| p.reason != Reason::Cartesian)
    {
        None => "all of them are Cartesian positions",
        Some(point) => point.reason.as_str(),
    };
    let detail = format!(
        "a robot program of {n} points without joint values ({reason}): {}{more}. {}",
        named.join(", "),
        program.language.remedy()
    );
    whole("not_angles", detail)
}

#[cfg(test)]
mod tests {
    use super::{Reason, find, table};

    /// Rows of the table, each with the line of its point before it.
    fn rows(text: &str) -> Vec<String> {
        let (rows, about) = table(text).unwrap().unwrap();
        let rows = rows.lines().skip(1).zip(about.lines);
        rows.map(|(row, line)| format!("{line}: {}", row.replace('\t', " ")))
            .collect()
    }

    /// Line, name and reason of the points that are not read.
    fn unread(text: &str) -> Vec<(usize, String, Reason)> {
        let program = find(text).unwrap().unwrap();
        let unread = program.unread.into_iter();
        unread.map(|p| (p.line, p.name, p.reason)).collect()
    }

    fn refusal(text: &str) -> String {
        let error = find(text).unwrap_err();
        assert_eq!(error.issues[0].code, "not_angles");
        error.issues[0].detail.clone()
    }

    #[test]
    fn targets_in_motions_are_refused_with_what_to_export() {
        for (text, remedy) in [
            (
                "DEF CAL()\n  PTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nEND\n",
                "E6AXIS",
            ),
            (
                "def cal():\n  movej([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], a=1)\nend\n",
                "actual_q",
            ),
            (
                "PROC m()\n  MoveAbsJ [[1,2,3,4,5,6],[9E9]], v100;\n",
                "jointtarget",
            ),
        ] {
            let detail = refusal(text);
            assert!(
                detail.contains("(line 2)") && detail.contains(remedy),
                "{detail}"
            );
        }
        assert!(find("J1 [deg],J2 [deg]\n1,2\n").unwrap().is_none());
    }

    const EXTERNAL: &str = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]";

    #[test]
    fn points_of_a_data_list_are_read_and_comments_are_not() {
        let text = "&ACCESS RVP\nDEFDAT CAL\nDECL E6POS XP1={X 1.0,Y 2.0,Z 3}\n\
            DECL E6AXIS XP2={A1 1.5,A2 -90.0,A3 90,A4 0.0,A5 -1E1,A6 0.25,E1 0.0}\n\
            ; DECL E6AXIS XP3={A1 9,A2 9,A3 9,A4 9,A5 9,A6 9}\n\
            DECL FDAT FP4={TOOL_NO 1,POINT2[] \"; {A1 5}\"}\n\
            GLOBAL E6AXIS P5={E6AXIS: A1 1,A2 2,A3 3,A4 4,A5 5,A6 x}\n\
            PTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6} ; home\n\
            PTP_REL {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nPTP {A1 5}\n\
            DECL MYLIMIT LIM={A1 170,A2 1,A3 1,A4 1,A5 1,A6 1}\nIF $AXIS_ACT=={A1 1,A2 2,A3 3,A4 4,A5 5,A6 6} THEN\nENDDAT\n";
        assert_eq!(rows(text), ["4: P2 2 1.5 -90.0 90 0.0 -1E1 0.25"]);
        let arrays = "DECL E6AXIS CALP[40]\nDECL MYLIMIT LIM[2]\nCALP[1]={E6AXIS: A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nCALP[2]={A1 2,A2 2,A3 3,A4 4,A5 5,A6 6,E1 0}\n\
            LIM[1]={A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nP7={A1 3,A2 2,A3 3,A4 4,A5 5,A6 6}\n";
        assert_eq!(
            rows(arrays),
            [
                "3: CALP[1] 1 1 2 3 4 5 6",
                "4: CALP[2] 2 2 2 3 4 5 6",
                "6: P7 7 3 2 3 4 5 6"
            ]
        );
        let own = |line, name: &str, reason| (line, name.to_owned(), reason);
        assert_eq!(
            unread(text),
            [
                own(3, "P1", Reason::Cartesian),
                own(7, "P5", Reason::NotNumbers)
            ]
        );
    }

    #[test]
    fn rapid_is_free_in_lines_spaces_and_case() {
        let text = format!(
            "MODULE m\n  CONST jointtarget cal_10:=[[1,-2.5,3,4,5,6],{EXTERNAL}];\n\
            ! CONST jointtarget off:=[[1,1,1,1,1,1],{EXTERNAL}];\n\
            local pers JOINTTARGET b2\n  :=[ [1,\n 2,3 ,4,5,6 ],{EXTERNAL} ];CONST robtarget p:=[[1,2,3],[1,0,0,0],[0,0,0,0],{EXTERNAL}];\n\
            PROC main()\n  TPWrite \"jointtarget x:=[[;\";\n  MoveAbsJ \\Conc, [[7,2,3,4,5,6],{EXTERNAL}]\\NoEOffs, v100, fine, tool0;\n\
            VAR jointtarget many{{2}}:=[[[8,2,3,4,5,6],{EXTERNAL}],[[9,2,3,4,5,6],{EXTERNAL}]];\n\
            CONST jointtarget c:=[[x,2,3,4,5,6],{EXTERNAL}];\nCONST jointtarget d:=[[9E9,9E9,9E9,9E9,9E9,9E9],[1,2,3,4,5,6]];\nCONST num soft{{2,6}}:=[[1,2,3,4,5,6],[1,2,3,4,5,6]];\nx:=[;y:=[[1,2,3,4,5,6],{EXTERNAL}];\nENDMODULE"
        );
        assert_eq!(
            rows(&text),
            [
                "2: cal_10 10 1 -2.5 3 4 5 6",
                "4: b2 2 1 2 3 4 5 6",
                "10: many{1} 1 8 2 3 4 5 6",
                "10: many{2} 2 9 2 3 4 5 6"
            ]
        );
        let own = |line, name: &str, reason| (line, name.to_owned(), reason);
        assert_eq!(
            unread(&text),
            [
                own(6, "p", Reason::Cartesian),
                own(11, "c", Reason::NotNumbers),
                own(12, "d", Reason::NotNumbers)
            ]
        );
    }

    #[test]
    fn points_of_a_listing_are_read_and_cartesian_ones_are_named() {
        let text = "/PROG CAL\n/MN\n 1:J P[1] 10% FINE ;\n/POS\nP[1:\"T 1\"]{\n   GP1:\n\tUF : 0, UT : 1,\t\n\
            \tJ1=    10.000 deg,\tJ2=   -30.000 deg,\tJ3=     5.500 deg,\n\tJ4=     0.000 deg,\tJ5=   -90.000 deg,\tJ6=     1.000 deg\n};\n\
            P[2:\"GP2 x\"]{\n   GP1:\n\tUF : 0, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n\tX = 1.0 mm\n};\n/END\n";
        assert_eq!(
            rows(text),
            ["5: T 1 1 10.000 -30.000 5.500 0.000 -90.000 1.000"]
        );
        assert_eq!(unread(text), [(11, "GP2 x".to_owned(), Reason::Cartesian)]);
    }

    #[test]
    fn programs_without_joint_values_are_refused_with_what_to_export() {
        for (text, named) in [
            (
                "DECL E6POS XP7={X 1.0,Y 2.0,Z 3}\n",
                ["P7 (line 1)", "E6AXIS"],
            ),
            (
                "\nCONST robtarget p10:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];",
                ["p10 (line 2)", "jointtarget"],
            ),
            (
                "/POS\nP[2]{\n GP1:\n UF : 0,\n X = 1.0 mm\n};\n/END\n",
                ["P2 (line 2)", "REPRE"],
            ),
        ] {
            let detail = refusal(text);
            assert!(detail.contains("Cartesian"), "{detail}");
            assert!(named.iter().all(|word| detail.contains(word)), "{detail}");
        }
        refusal("/JOB\n///PULSE\nC00000=1,2\n");
        for table in [
            "q1_deg,x_mm\n1,2\n",
            "J1 [deg];note\n1;moved {A1 3}\n",
            "# start: PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\n# movej([0,-1,0,0,0,0])\nJ1 [deg]\n1\n",
            "# frame: base={X 1,Y 2,Z 3}\nJ1 [deg]\n1\n",
        ] {
            assert!(find(table).unwrap().is_none(), "{table}");
        }
    }
}
