//! Tables as people have them: each habit is taken with the values that it means, or refused with the remedy, and never taken with others.

use crate::workbooks;
use kincal::measurement::Frame;
use kincal::wire::Invalid;
use kincal::wire::columns::ColumnsBody;
use kincal::wire::measurement::{MeasurementSet, Upload, from_file, from_upload};
use kincal::wire::understood::Reading;

const N_ROWS: usize = 9;
/// Values are written with four decimals and read back exactly, but for the factors of their units.
const ROUNDING: f64 = 1e-9;

/// What was measured: joints in degrees, position in mm.
fn truth() -> Vec<([f64; 6], [f64; 3])> {
    let angle = |row: usize, joint: usize| {
        let spread = ((row * 7 + joint * 13) * 2654) % 36_000;
        let joint_deg = spread as f64 / 100.0 - 180.0 + 0.0137 * (joint as f64 + 1.0);
        (joint_deg * 1e4).round() / 1e4
    };
    let length = |row: usize, axis: usize| {
        let spread = ((row * 11 + axis * 5) * 7919) % 300_000;
        let at_mm = spread as f64 / 100.0 - 1500.0 + 0.1213 * (axis as f64 + 1.0);
        (at_mm * 1e4).round() / 1e4
    };
    (0..N_ROWS)
        .map(|row| {
            (
                std::array::from_fn(|joint| angle(row, joint)),
                std::array::from_fn(|axis| length(row, axis)),
            )
        })
        .collect()
}

/// A table to be written.
struct Written {
    separator: &'static str,
    header: Vec<String>,
    angle: fn(f64) -> String,
    length: fn(f64) -> String,
    /// Cells in front of the joints, of a row.
    front: fn(usize) -> Vec<String>,
    /// Cells behind the position, of a row.
    back: fn(usize) -> Vec<String>,
    ending: &'static str,
}

fn none(_: usize) -> Vec<String> {
    vec![]
}

fn four(value: f64) -> String {
    format!("{value:.4}")
}

fn four_with_comma(value: f64) -> String {
    four(value).replace('.', ",")
}

fn header(joint: impl Fn(usize) -> String, axes: [&str; 3]) -> Vec<String> {
    (1..=6).map(joint).chain(axes.map(str::to_owned)).collect()
}

fn own_header() -> Vec<String> {
    header(|j| format!("q{j}_deg"), ["x_mm", "y_mm", "z_mm"])
}

impl Default for Written {
    fn default() -> Self {
        Self {
            separator: ",",
            header: own_header(),
            angle: four,
            length: four,
            front: none,
            back: none,
            ending: "\n",
        }
    }
}

impl Written {
    fn rows(&self) -> Vec<Vec<String>> {
        let row = |(row, (q, p)): (usize, ([f64; 6], [f64; 3]))| {
            let mut cells = (self.front)(row);
            cells.extend(q.map(self.angle));
            cells.extend(p.map(self.length));
            cells.extend((self.back)(row));
            cells
        };
        truth().into_iter().enumerate().map(row).collect()
    }

    fn text(&self) -> String {
        let mut lines = vec![self.header.join(self.separator)];
        lines.extend(self.rows().iter().map(|row| row.join(self.separator)));
        lines
            .iter()
            .map(|line| format!("{line}{}", self.ending))
            .collect()
    }
}

/// The columns of another maker's header by number: joints from `first`, then the position.
fn by_number(first: usize, angle: &str, length: &str) -> String {
    let joints = (0..6).map(|j| format!("\"q{}_{angle}\": {}", j + 1, first + j));
    let axes = ["x", "y", "z"].iter().enumerate();
    let axes = axes.map(|(i, axis)| format!("\"{axis}_{length}\": {}", first + 6 + i));
    joints.chain(axes).collect::<Vec<_>>().join(", ")
}

fn by_header(header: &[String], angle: &str, length: &str) -> String {
    let means = (1..=6)
        .map(|j| format!("q{j}_{angle}"))
        .chain(["x", "y", "z"].map(|axis| format!("{axis}_{length}")));
    let entries = means
        .zip(header)
        .map(|(means, name)| format!("{}: {}", serde_json::json!(means), serde_json::json!(name)));
    entries.collect::<Vec<_>>().join(", ")
}

/// How a habit ends.
enum End {
    /// Read without a word.
    Taken,
    /// Refused with this code and this text; read with this mapping.
    Asked(&'static str, &'static str, String),
    /// Refused with this code and this text, whatever is stated.
    Refused(&'static str, &'static str),
}

struct Habit {
    name: &'static str,
    bytes: Vec<u8>,
    end: End,
}

fn read(bytes: &[u8], columns: &str) -> Result<(MeasurementSet, Option<Reading>), Invalid> {
    let columns = match columns {
        "" => ColumnsBody::default(),
        columns => ColumnsBody::parse(format!("{{{columns}}}").as_bytes())?,
    };
    let upload = Upload {
        content_type: "text/csv",
        bytes,
        columns: &columns,
        decimal: None,
        frame: Frame::Instrument,
    };
    from_file(&upload, 6)
}

fn is_true(name: &str, set: &MeasurementSet) {
    assert_eq!(set.points.len(), N_ROWS, "{name}");
    for (point, (q, p)) in set.points.iter().zip(truth()) {
        for (read, meant) in point.q_rad.iter().zip(q) {
            assert!(
                (read.to_degrees() - meant).abs() < ROUNDING,
                "{name}: {read} for {meant}°"
            );
        }
        for (read, meant) in point.position_mm.iter().zip(p) {
            assert!(
                (read - meant).abs() < ROUNDING,
                "{name}: {read} for {meant} mm"
            );
        }
    }
}

/// What was understood reads the same points again, whatever the names of columns mean by then.
fn is_read_again(name: &str, bytes: &[u8], set: &MeasurementSet, reading: &Reading) {
    let json = serde_json::to_string(reading).unwrap();
    let again = from_upload("text/csv", Some(&json), bytes, Frame::Instrument, 6).unwrap();
    assert!(again == *set, "{name}");
}

fn check(habit: &Habit) {
    let name = habit.name;
    let refused = |columns: &str, code: &str, hint: &str| {
        let Err(error) = read(&habit.bytes, columns) else {
            panic!("{name}: taken")
        };
        let issue = &error.issues[0];
        assert_eq!(issue.code, code, "{name}: {issue:?}");
        assert!(
            issue.detail.contains(hint),
            "{name}: no {hint:?} in {issue:?}"
        );
    };
    let mapping = match &habit.end {
        End::Taken => "",
        End::Refused(code, hint) => return refused("", code, hint),
        End::Asked(code, hint, mapping) => {
            refused("", code, hint);
            mapping
        }
    };
    let (set, reading) = read(&habit.bytes, mapping).unwrap_or_else(|error| {
        panic!(
            "{name}: {error:?}\n{}",
            String::from_utf8_lossy(&habit.bytes)
        )
    });
    is_true(name, &set);
    is_read_again(name, &habit.bytes, &set, &reading.unwrap());
}

fn taken(name: &'static str, text: impl Into<Vec<u8>>) -> Habit {
    Habit {
        name,
        bytes: text.into(),
        end: End::Taken,
    }
}

fn asked(
    name: &'static str,
    text: impl Into<Vec<u8>>,
    code: &'static str,
    hint: &'static str,
    mapping: impl Into<String>,
) -> Habit {
    Habit {
        name,
        bytes: text.into(),
        end: End::Asked(code, hint, mapping.into()),
    }
}

fn refused(
    name: &'static str,
    text: impl Into<Vec<u8>>,
    code: &'static str,
    hint: &'static str,
) -> Habit {
    Habit {
        name,
        bytes: text.into(),
        end: End::Refused(code, hint),
    }
}

fn named(joint: impl Fn(usize) -> String, axes: [&str; 3]) -> Written {
    Written {
        header: header(joint, axes),
        ..Written::default()
    }
}

fn utf16(text: &str, big: bool, mark: bool) -> Vec<u8> {
    let units = mark
        .then_some(0xFEFF)
        .into_iter()
        .chain(text.encode_utf16());
    let bytes = |unit: u16| {
        if big {
            unit.to_be_bytes()
        } else {
            unit.to_le_bytes()
        }
    };
    units.flat_map(bytes).collect()
}

fn latin_1(text: &str) -> Vec<u8> {
    text.chars()
        .map(|c| u8::try_from(u32::from(c)).unwrap())
        .collect()
}

const MM: [&str; 3] = ["X [mm]", "Y [mm]", "Z [mm]"];
const DEG: fn(usize) -> String = |j| format!("J{j} [deg]");

/// Separators, decimal marks, encodings, line endings.
fn forms() -> Vec<Habit> {
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
        refused(
            "separators of thousands",
            Written {
                separator: ";",
                length: |v| format!("{:.0},{:03}.5", v / 1000.0, 17),
                ..plain()
            }
            .text(),
            "decimal_comma",
            "has a comma",
        ),
        refused(
            "units in the cells",
            Written {
                length: |v| format!("{v:.4} mm"),
                ..plain()
            }
            .text(),
            "not_a_number",
            "not a number",
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
fn surroundings() -> Vec<Habit> {
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
        asked(
            "a row that is commented out",
            with_row_after(5, &format!("#{}", lines[3])),
            "two_readings",
            "a comment or data",
            "\"comments\": true",
        ),
    ]
}

/// Names of columns.
fn names() -> Vec<Habit> {
    let tcp = Written {
        header: header(DEG, MM)
            .into_iter()
            .chain(["A", "B", "C"].map(str::to_owned))
            .collect(),
        back: |_| vec!["1.0".into(), "2.0".into(), "3.0".into()],
        ..Written::default()
    };
    let rad = |v: f64| v.to_radians().to_string();
    let actual_q = header(|j| format!("actual_q_{}", j - 1), ["px", "py", "pz"]);
    let letters: Vec<String> = ["S", "L", "U", "R", "B", "T", "X", "Y", "Z"]
        .map(str::to_owned)
        .into();
    let mut swapped = Written {
        header: own_header(),
        ..Written::default()
    };
    swapped.header.swap(0, 8);
    let swapped = {
        let rows = swapped.rows().into_iter().map(|mut row| {
            row.swap(0, 8);
            row.join(",")
        });
        std::iter::once(swapped.header.join(","))
            .chain(rows)
            .collect::<Vec<_>>()
            .join("\n")
    };
    vec![
        taken("J1 [deg] and X [mm]", named(DEG, MM).text()),
        taken(
            "A1 [°] and X (mm)",
            named(|j| format!("A{j} [°]"), ["X (mm)", "Y (mm)", "Z (mm)"]).text(),
        ),
        taken(
            "Axis 1 [deg] and Pos X [mm]",
            named(
                |j| format!("Axis {j} [deg]"),
                ["Pos X [mm]", "Pos Y [mm]", "Pos Z [mm]"],
            )
            .text(),
        ),
        taken(
            "Joint1_deg and x mm",
            named(|j| format!("Joint{j}_deg"), ["x mm", "y mm", "z mm"]).text(),
        ),
        taken(
            "Joint[1] (degrees) and measured X (millimeters)",
            named(
                |j| format!("Joint[{j}] (degrees)"),
                [
                    "measured X (millimeters)",
                    "measured Y (millimeters)",
                    "measured Z (millimeters)",
                ],
            )
            .text(),
        ),
        taken(
            "Achse 1 / ° and X / mm",
            named(|j| format!("Achse {j} / °"), ["X / mm", "Y / mm", "Z / mm"]).text(),
        ),
        taken(
            "J1° and X in mm",
            named(|j| format!("J{j}°"), ["X in mm", "Y in mm", "Z in mm"]).text(),
        ),
        taken(
            "upper case",
            Written {
                header: own_header().iter().map(|n| n.to_uppercase()).collect(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "metres",
            Written {
                header: header(DEG, ["X [m]", "Y [m]", "Z [m]"]),
                length: |v| (v / 1000.0).to_string(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "inches",
            Written {
                header: header(DEG, ["X [in]", "Y [in]", "Z [in]"]),
                length: |v| (v / 25.4).to_string(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "centimetres",
            Written {
                header: header(DEG, ["X [cm]", "Y [cm]", "Z [cm]"]),
                length: |v| (v / 10.0).to_string(),
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "radians",
            Written {
                header: header(|j| format!("J{j} [rad]"), MM),
                angle: rad,
                ..Written::default()
            }
            .text(),
        ),
        taken(
            "joints counted from 0",
            named(|j| format!("joint_{} [deg]", j - 1), MM).text(),
        ),
        taken("columns in another order", swapped),
        asked(
            "no units at all",
            named(|j| format!("J{j}"), ["X", "Y", "Z"]).text(),
            "missing_unit",
            "?columns=",
            by_header(&header(|j| format!("J{j}"), ["X", "Y", "Z"]), "deg", "mm"),
        ),
        asked(
            "joints without units",
            named(|j| format!("A{j}"), MM).text(),
            "missing_unit",
            "\"q1_deg\": \"A1\"",
            by_header(&header(|j| format!("A{j}"), MM), "deg", "mm"),
        ),
        asked(
            "radians without a unit",
            Written {
                header: actual_q.clone(),
                angle: rad,
                length: |v| (v / 1000.0).to_string(),
                ..Written::default()
            }
            .text(),
            "missing_unit",
            "has no unit",
            by_header(&actual_q, "rad", "m"),
        ),
        asked(
            "letters of axes",
            Written {
                header: letters.clone(),
                ..Written::default()
            }
            .text(),
            "missing_unit",
            "column X has no unit",
            by_header(&letters, "deg", "mm"),
        ),
        asked(
            "names of another language",
            named(|j| format!("eje {j} (grados)"), ["largo", "ancho", "alto"]).text(),
            "wrong_joint_count",
            "eje 1 (grados)",
            by_header(
                &header(|j| format!("eje {j} (grados)"), ["largo", "ancho", "alto"]),
                "deg",
                "mm",
            ),
        ),
        asked(
            "Grad",
            named(|j| format!("A{j} [Grad]"), MM).text(),
            "two_readings",
            "gons",
            by_number(1, "deg", "mm"),
        ),
        asked(
            "no header",
            Written::default()
                .text()
                .split_once('\n')
                .unwrap()
                .1
                .to_owned(),
            "no_header",
            "\"q1_deg\": 1",
            by_number(1, "deg", "mm"),
        ),
        asked(
            "no header, numbers in front",
            Written {
                header: vec![],
                front: |r| vec![format!("P{r}")],
                ..Written::default()
            }
            .text()
            .split_once('\n')
            .unwrap()
            .1
            .to_owned(),
            "no_header",
            "by its number",
            by_number(2, "deg", "mm"),
        ),
        asked(
            "the controller's own pose beside the joints",
            tcp.text(),
            "two_readings",
            "computes itself",
            by_number(1, "deg", "mm"),
        ),
        asked(
            "two columns for x",
            Written {
                header: header(DEG, MM)
                    .into_iter()
                    .chain(["Measured X [mm]".to_owned()])
                    .collect(),
                back: |_| vec!["1.0".into()],
                ..Written::default()
            }
            .text(),
            "duplicate_column",
            "say which",
            "\"x_mm\": \"X [mm]\"",
        ),
        asked(
            "a seventh axis",
            Written {
                header: header(DEG, MM)
                    .into_iter()
                    .chain(["J7 [deg]".to_owned()])
                    .collect(),
                back: |_| vec!["1.0".into()],
                ..Written::default()
            }
            .text(),
            "wrong_joint_count",
            "\"ignore\"",
            "\"ignore\": [\"J7 [deg]\"]",
        ),
        asked(
            "nominal positions in front of the measured ones",
            Written {
                header: ["Nominal X", "Nominal Y", "Nominal Z"]
                    .map(str::to_owned)
                    .into_iter()
                    .chain(header(DEG, ["Actual X", "Actual Y", "Actual Z"]))
                    .collect(),
                front: |_| vec!["1.0".into(), "2.0".into(), "3.0".into()],
                ..Written::default()
            }
            .text(),
            "missing_unit",
            "Actual X",
            "\"x_mm\": \"Actual X\", \"y_mm\": \"Actual Y\", \"z_mm\": \"Actual Z\"",
        ),
        refused(
            "units that differ",
            named(DEG, ["X [mm]", "Y [m]", "Z [mm]"]).text(),
            "mixed_units",
            "one unit",
        ),
        refused(
            "a slip of the keyboard",
            Written {
                header: own_header()
                    .into_iter()
                    .chain(["std_m".to_owned()])
                    .collect(),
                back: |_| vec!["0.01".into()],
                ..Written::default()
            }
            .text(),
            "unknown_column",
            "nearly std_mm",
        ),
    ]
}

fn sheets() -> Vec<Habit> {
    let table = named(DEG, MM);
    let cells: Vec<Vec<String>> = std::iter::once(table.header.clone())
        .chain(table.rows())
        .collect();
    let titled: Vec<Vec<String>> = [vec!["Cell 4".to_owned()], vec![]]
        .into_iter()
        .chain(cells.clone())
        .collect();
    vec![
        taken("xlsx", workbooks::xlsx(&[("Sheet1", &cells)])),
        taken(
            "xlsx with a title and an empty sheet",
            workbooks::xlsx(&[("Data", &titled), ("Sheet2", &[])]),
        ),
        taken("ods", workbooks::ods(&[("Sheet1", &titled)])),
        asked(
            "two sheets",
            workbooks::xlsx(&[("Old", &cells[..3].to_vec()), ("New", &cells)]),
            "two_readings",
            "\"sheet\"",
            "\"sheet\": \"New\"",
        ),
        asked(
            "two sheets of ods",
            workbooks::ods(&[("Old", &cells[..3].to_vec()), ("New", &cells)]),
            "two_readings",
            "\"sheet\"",
            "\"sheet\": \"New\"",
        ),
        refused(
            "a zip",
            workbooks::zip(&[("set.csv", Written::default().text().into_bytes())]),
            "not_csv",
            "no workbook",
        ),
    ]
}

fn all() -> Vec<Habit> {
    [forms(), surroundings(), names(), sheets()]
        .into_iter()
        .flatten()
        .collect()
}

#[test]
fn every_habit_is_read_as_it_is_meant_or_refused_with_the_remedy() {
    let habits = all();
    assert!(habits.len() >= 55, "{}", habits.len());
    for habit in &habits {
        check(habit);
    }
}

/// The habits that are taken without a word, with every pair of form and name.
#[test]
fn habits_of_form_and_of_name_go_together() {
    let names: [(fn(usize) -> String, [&str; 3]); 3] = [
        (|j| format!("Achse {j} [°]"), MM),
        (|j| format!("joint{j}_deg"), ["x_mm", "y_mm", "z_mm"]),
        (|j| format!("J{j}, deg"), ["X, mm", "Y, mm", "Z, mm"]),
    ];
    for (joint, axes) in names {
        for separator in [";", "\t", "|"] {
            for number in [four as fn(f64) -> String, four_with_comma] {
                let text = Written {
                    separator,
                    header: header(joint, axes),
                    angle: number,
                    length: number,
                    ..Written::default()
                }
                .text();
                for (name, bytes) in [
                    ("UTF-8", text.clone().into_bytes()),
                    ("UTF-16", utf16(&text, true, true)),
                    ("Latin-1", latin_1(&text)),
                    ("with comments", format!("# a\n\n{text}\n").into_bytes()),
                ] {
                    let name = format!("{name} {separator:?} {}", number(1.5));
                    let (set, _) =
                        read(&bytes, "").unwrap_or_else(|e| panic!("{name}: {e:?}\n{text}"));
                    is_true(&name, &set);
                }
            }
        }
    }
}

#[test]
fn one_number_with_two_readings_is_refused_with_both() {
    let text =
        "q1_deg;q2_deg;q3_deg;q4_deg;q5_deg;q6_deg;x_mm;y_mm;z_mm\n1;2;3;4;5;6;1,234;2,345;3,456\n";
    let error = read(text.as_bytes(), "").unwrap_err();
    assert_eq!(error.issues[0].code, "two_readings");
    for reading in ["1.234", "1234", "?decimal=comma"] {
        assert!(error.issues[0].detail.contains(reading), "{error:?}");
    }
    let (set, _) = read(text.as_bytes(), "\"decimal\": \"comma\"").unwrap();
    assert_eq!(set.points[0].position_mm.x, 1.234);
}

#[test]
fn what_was_understood_is_told() {
    let text = "Cell 4\n\nNo.;J1 [deg];J2 [deg];J3 [deg];J4 [deg];J5 [deg];J6 [deg];X (mm);Y (mm);Z (mm);RMS\n1;1,5;2;3;4;5;6;7;8;9;0,1\n;;;;;;;;;;\n";
    let (_, reading) = read(&latin_1(text), "").unwrap();
    let understood = reading.unwrap().understood.unwrap();
    assert_eq!(understood.separator, ";");
    assert_eq!(understood.header_row, Some(3));
    assert_eq!(understood.ignored, ["No.", "RMS"]);
    assert_eq!(understood.skipped_rows, 3);
    let x = &understood.columns[6];
    assert_eq!(
        (
            x.column.as_str(),
            x.number,
            x.means.as_str(),
            x.unit.as_deref()
        ),
        ("X (mm)", 8, "x", Some("mm"))
    );
}

#[test]
fn a_bad_cell_is_named_with_its_line() {
    let text = Written::default().text();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    lines[4] = lines[4].replacen(',', ",x", 1);
    let bytes = format!("# one\n\n# two\n{}\n", lines.join("\n\n"));
    let error = read(bytes.as_bytes(), "").unwrap_err();
    let issue = &error.issues[0];
    assert_eq!(
        (issue.code.as_str(), issue.row, issue.line),
        ("not_a_number", Some(3), Some(12))
    );
    assert_eq!(issue.column.as_deref(), Some("q2_deg"));
}

#[test]
fn another_tables_target_is_no_reflector() {
    let table = Written {
        header: std::iter::once("Target".to_owned())
            .chain(header(DEG, MM))
            .collect(),
        front: |r| vec![(r + 1).to_string()],
        ..Written::default()
    };
    let (set, reading) = read(table.text().as_bytes(), "").unwrap();
    assert!(set.points.iter().all(|point| point.target == 0));
    assert_eq!(reading.unwrap().understood.unwrap().ignored, ["Target"]);
}

#[test]
fn bombs_are_refused() {
    let rows = "1,2,3,4,5,6,7,8,9\n".repeat(100_001);
    let error = read(format!("{}\n{rows}", own_header().join(",")).as_bytes(), "").unwrap_err();
    assert_eq!(error.issues[0].code, "too_many_rows");
    let zeros = vec![b' '; 65 * 1024 * 1024];
    let bomb = workbooks::zip(&[("xl/workbook.xml", zeros)]);
    assert!(bomb.len() < 1024 * 1024);
    assert_eq!(read(&bomb, "").unwrap_err().issues[0].code, "too_large");
    let wide = workbooks::ods_content(
        "<table:table table:name=\"a\"><table:table-row table:number-rows-repeated=\"1000000\"><table:table-cell office:value-type=\"float\" \
         office:value=\"1\" table:number-columns-repeated=\"900\"/></table:table-row></table:table>",
    );
    assert_eq!(read(&wide, "").unwrap_err().issues[0].code, "too_many_rows");
}
