//! Tables as people have them: each habit is taken with the values that it means, or refused with the remedy, and never taken with others.

mod contents;
mod forms;
mod groups;
mod layouts;
mod names;
mod put_aside;
mod put_aside_by_name;
mod remedies;
mod second_readings;
mod traps;

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
        rotation: None,
        frame: Frame::Instrument,
        instrument: None,
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

fn all() -> Vec<Habit> {
    [
        forms::forms(),
        forms::surroundings(),
        names::names(),
        names::sheets(),
        contents::contents(),
    ]
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
    type NameOfJoint = fn(usize) -> String;
    let names: [(NameOfJoint, [&str; 3]); 3] = [
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
    for reading in ["1.234", "1234", "{\"decimal\": \"comma\"}"] {
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
fn a_header_below_the_lines_that_are_searched_is_read_if_it_is_stated() {
    let rows = "1,2,3,4,5,6,7,8,9\n".repeat(3);
    let text = format!("{}{}\n{rows}", "note\n".repeat(64), own_header().join(","));
    let (set, _) = read(text.as_bytes(), "\"header_row\": 65").unwrap();
    assert_eq!(set.points.len(), 3);
}

#[test]
fn a_quaternion_of_another_length_is_named_as_such() {
    let header = own_header().join(",");
    let text = format!("{header},quat_w,quat_x,quat_y,quat_z\n1,2,3,4,5,6,7,8,9,2,0,0,0\n");
    let error = read(text.as_bytes(), "").unwrap_err();
    assert_eq!(error.issues[0].code, "quaternion_not_normalised");
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
