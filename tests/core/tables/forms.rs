//! Habits of writing tables: separators, decimal marks, encodings, and what stands around the data.

use super::*;

/// Separators, decimal marks, encodings, line endings.
pub fn forms() -> Vec<Habit> {
    let plain = || Written::default();
    let semicolons = || Written {
        separator: ";",
        ..plain()
    };
    let german = || Written {
        separator: ";",
        angle: four_with_comma,
        length: four_with_comma,
        ..plain()
    };
    let text = plain().text();
    vec![
        taken("as the documentation says", text.clone()),
        taken("semicolons and points", semicolons().text()),
        taken("semicolons and commas", german().text()),
        taken(
            "tabs and points",
            Written {
                separator: "\t",
                ..plain()
            }
            .text(),
        ),
        taken(
            "tabs and commas",
            Written {
                separator: "\t",
                ..german()
            }
            .text(),
        ),
        taken(
            "pipes",
            Written {
                separator: "|",
                ..plain()
            }
            .text(),
        ),
        taken(
            "spaces",
            Written {
                separator: "   ",
                ..plain()
            }
            .text(),
        ),
        taken(
            "spaces before and between",
            plain()
                .text()
                .replace(',', "  ")
                .lines()
                .map(|l| format!("  {l}\n"))
                .collect::<String>(),
        ),
        taken(
            "comma and space",
            Written {
                separator: ", ",
                ..plain()
            }
            .text(),
        ),
        taken(
            "numbers with commas in quotes",
            Written {
                angle: |v| format!("\"{}\"", four_with_comma(v)),
                length: |v| format!("\"{}\"", four_with_comma(v)),
                ..plain()
            }
            .text(),
        ),
        taken(
            "everything in quotes",
            text.lines()
                .map(|l| format!("\"{}\"\n", l.replace(',', "\",\"")))
                .collect::<String>(),
        ),
        taken("sep= in front", format!("sep=;\n{}", semicolons().text())),
        taken(
            "sep= in quotes",
            format!(
                "\"sep=\t\"\n{}",
                Written {
                    separator: "\t",
                    ..plain()
                }
                .text()
            ),
        ),
        taken("byte order mark", format!("\u{feff}{text}")),
        taken("UTF-16, low byte first", utf16(&text, false, true)),
        taken("UTF-16, high byte first", utf16(&text, true, true)),
        taken("UTF-16 without its mark", utf16(&text, false, false)),
        taken(
            "Latin-1",
            latin_1(
                &Written {
                    header: header(|j| format!("J{j} [°]"), MM),
                    ..german()
                }
                .text(),
            ),
        ),
        taken(
            "line endings of Windows",
            Written {
                ending: "\r\n",
                ..plain()
            }
            .text(),
        ),
        taken(
            "line endings of old Macs",
            Written {
                ending: "\r",
                ..plain()
            }
            .text(),
        ),
        taken("no line ending at the end", text.trim_end().to_owned()),
        taken(
            "signs",
            Written {
                angle: |v| format!("{v:+.4}"),
                ..plain()
            }
            .text(),
        ),
        taken(
            "powers of ten",
            Written {
                angle: |v| format!("{v:e}"),
                length: |v| format!("{v:E}"),
                ..plain()
            }
            .text(),
        ),
        refused(
            "commas between columns and as decimal mark",
            Written {
                angle: four_with_comma,
                length: four_with_comma,
                ..plain()
            }
            .text(),
            "wrong_cell_count",
            "decimal comma",
        ),
        taken(
            "separators of thousands that can be read in one way",
            Written {
                separator: ";",
                length: |v| {
                    let text = format!("{:.4}", v.abs());
                    let (whole, fraction) = text.split_once('.').unwrap();
                    let sign = if v < 0.0 { "\u{2212}" } else { "" };
                    match whole.len() {
                        4 => format!("{sign}{}\u{a0}{},{fraction}", &whole[..1], &whole[1..]),
                        _ => format!("{sign}{whole},{fraction}"),
                    }
                },
                angle: four_with_comma,
                ..plain()
            }
            .text(),
        ),
        taken(
            "points that separate thousands, before a decimal comma",
            Written {
                separator: ";",
                length: |v| {
                    let text = format!("{v:.4}");
                    let (whole, fraction) = text.split_once('.').unwrap();
                    match whole.trim_start_matches('-').len() {
                        4 => {
                            let at = whole.len() - 3;
                            format!("{}.{},{fraction}", &whole[..at], &whole[at..])
                        }
                        _ => format!("{whole},{fraction}"),
                    }
                },
                angle: four_with_comma,
                ..plain()
            }
            .text(),
        ),
        refused(
            "a row of statistics",
            Written {
                header: std::iter::once("Point".to_owned())
                    .chain(own_header())
                    .collect(),
                front: |r| vec![format!("P{r}")],
                ..Written::default()
            }
            .text()
                + "Mean,0,0,0,0,0,0,1,2,3\n",
            "summary_row",
            "\"Mean\"",
        ),
        refused(
            "nothing measured in one row",
            Written::default().text() + "1,2,3,4,5,6,n/a,n/a,n/a\n",
            "not_a_number",
            "remove the row",
        ),
        refused(
            "separators of thousands",
            Written {
                separator: ";",
                length: |v| format!("{:.0},{:02}.5", v / 1000.0, 17),
                ..plain()
            }
            .text(),
            "decimal_comma",
            "has a comma",
        ),
        refused(
            "a binary file",
            [b"q1_deg,x_mm\n".as_slice(), &[0, 1, 2, 3, 255, 254, 0, 7]].concat(),
            "not_text",
            "control character",
        ),
        refused(
            "cut off UTF-16",
            utf16(&text, false, true)[..301].to_vec(),
            "not_text",
            "cut off",
        ),
    ]
}

/// Lines around the data, and columns beside it.
pub fn surroundings() -> Vec<Habit> {
    let plain = || Written::default();
    let text = plain().text();
    let lines: Vec<&str> = text.lines().collect();
    let with_row_after = |n: usize, row: &str| {
        let mut lines = lines.clone();
        lines.insert(n, row);
        lines.join("\n")
    };
    let extra = |header: &[&str], back: fn(usize) -> Vec<String>| {
        let mut all = own_header();
        all.extend(header.iter().map(|name| (*name).to_owned()));
        Written {
            header: all,
            back,
            ..plain()
        }
        .text()
    };
    vec![
        taken(
            "comment lines above",
            format!("# cell 4\n# q1 and others\n\n{text}"),
        ),
        taken(
            "comment lines between",
            with_row_after(4, "# tracker warmed up again"),
        ),
        taken(
            "comments of another kind",
            with_row_after(4, "% pause, of ten minutes"),
        ),
        taken("the header is a comment", format!("# {text}")),
        taken(
            "titles above",
            format!("Project: hall 3\nOperator: Mr. X\nDate: 2026-03-01, 08:15\n\n{text}"),
        ),
        taken("blank rows", text.replace('\n', "\n\n")),
        taken("rows of separators", with_row_after(3, ",,,,,,,,")),
        taken("rows of spaces", with_row_after(3, "   ")),
        taken(
            "empty trailing columns",
            text.lines()
                .map(|l| format!("{l},,,\n"))
                .collect::<String>(),
        ),
        taken(
            "empty trailing cells only",
            text.lines()
                .enumerate()
                .map(|(i, l)| format!("{l}{}\n", if i > 0 { "," } else { "" }))
                .collect::<String>(),
        ),
        taken(
            "a column of remarks",
            extra(&["remark"], |r| vec![format!("\"row, {r}\"")]),
        ),
        taken(
            "columns of other things",
            extra(&["RMS [mm]", "Humidity [%]"], |r| {
                vec!["0.0123".into(), format!("4{r}")]
            }),
        ),
        taken(
            "a column without a name",
            extra(&[""], |r| vec![r.to_string()]),
        ),
        taken(
            "a number in front",
            Written {
                header: std::iter::once("No.".to_owned())
                    .chain(own_header())
                    .collect(),
                front: |r| vec![(r + 1).to_string()],
                ..plain()
            }
            .text(),
        ),
        taken(
            "units under the header",
            format!(
                "J1,J2,J3,J4,J5,J6,X,Y,Z\ndeg,deg,deg,deg,deg,deg,mm,mm,mm\n{}",
                lines[1..].join("\n")
            ),
        ),
        taken(
            "units in brackets under the header",
            format!(
                "A1;A2;A3;A4;A5;A6;X;Y;Z\n[°];[°];[°];[°];[°];[°];[mm];[mm];[mm]\n{}",
                lines[1..].join("\n").replace(',', ";")
            ),
        ),
        refused(
            "a row that is cut off",
            text[..text.len() - 40].to_owned(),
            "wrong_cell_count",
            "the end of the row is missing",
        ),
        refused(
            "a sum under the table",
            format!("{text}mean,,,,,,1.5,2.5,3.5\n"),
            "not_a_number",
            "row 9, column q1_deg",
        ),
        taken(
            "a row that is commented out",
            with_row_after(5, &format!("#{}", lines[3])),
        ),
        asked(
            "many rows that are commented out",
            with_row_after(5, &format!("#{0}\n#{0}\n#{0}", lines[3])),
            "two_readings",
            "a comment or data",
            "\"comments\": true",
        ),
    ]
}
