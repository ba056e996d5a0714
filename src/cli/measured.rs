//! Measurement files of a command: one table, or the robot's file and the instrument's. Also the text about how they were understood.

use super::column_options::ColumnOptions;
use super::files::{BYTE_ORDER_MARK, NumberFormat, is_json, read};
use super::terminal::plain;
use super::usage::Usage;
use crate::measurement::{Decimal, RotationConvention};
use crate::wire::canonical;
use crate::wire::columns::ColumnsBody;
use crate::wire::instrument::InstrumentBody;
use crate::wire::measurement::{MAX_UPLOAD_BYTES, Upload};
use crate::wire::understood::{JoinBody, Reading, UnderstoodBody, UnderstoodColumn, UnreadPoint};
use std::io::Read;
use std::path::{Path, PathBuf};

/// The second file of a set, and the meaning of the columns.
#[derive(Debug, clap::Args)]
pub struct TableOptions {
    /// The instrument's file, if SET holds the robot's joint values only; rows are joined by name, number or time.
    #[arg(value_name = "INSTRUMENT_EXPORT", conflicts_with = "instrument")]
    pub instrument_export: Option<PathBuf>,
    /// The instrument's file; the same as the argument INSTRUMENT_EXPORT.
    #[arg(long, env = "KINCAL_INSTRUMENT", value_name = "FILE")]
    pub instrument: Option<PathBuf>,
    #[command(flatten)]
    pub columns: ColumnOptions,
    #[command(flatten)]
    pub numbers: NumberFormat,
}

impl TableOptions {
    /// The file or files of a set, for messages.
    pub fn shown(&self, set: &Path) -> PathBuf {
        match self.instrument.as_ref().or(self.instrument_export.as_ref()) {
            Some(other) => format!("{} and {}", set.display(), other.display()).into(),
            None => set.into(),
        }
    }
}

/// The files of a set as they are uploaded.
pub struct MeasurementFiles {
    /// Content type of the bytes.
    pub content_type: String,
    /// The file, or a multipart form with two files.
    pub bytes: Vec<u8>,
    /// Mapping of the columns.
    pub columns: ColumnsBody,
    /// The decimal mark, if it was stated.
    pub decimal: Option<Decimal>,
    /// Rotation convention of the poses, if it was stated.
    pub rotation: Option<RotationConvention>,
}

impl MeasurementFiles {
    /// The files as input of the upload reader.
    pub fn upload(
        &self,
        frame: crate::measurement::Frame,
        instrument: Option<InstrumentBody>,
    ) -> Upload<'_> {
        Upload {
            content_type: &self.content_type,
            bytes: &self.bytes,
            columns: &self.columns,
            decimal: self.decimal,
            rotation: self.rotation,
            frame,
            instrument,
        }
    }
}

/// Reads the files of a set; `-` is the standard input.
pub fn read_measurement_files(
    set: &Path,
    options: &TableOptions,
) -> anyhow::Result<MeasurementFiles> {
    let is_stdin = |path: &Path| path == Path::new("-");
    let bytes = if is_stdin(set) {
        read_stdin()?
    } else {
        read(set)?
    };
    let columns = options.columns.body()?;
    let decimal = options.numbers.decimal_comma.then_some(Decimal::Comma);
    let rotation = options.numbers.rotation;
    let instrument = options
        .instrument_export
        .as_ref()
        .or(options.instrument.as_ref());
    let Some(instrument) = instrument else {
        let begins = bytes
            .strip_prefix(BYTE_ORDER_MARK)
            .unwrap_or(&bytes)
            .trim_ascii_start();
        let is_json = is_json(set) || is_stdin(set) && begins.first() == Some(&b'{');
        return Ok(MeasurementFiles {
            content_type: if is_json {
                "application/json"
            } else {
                "text/csv"
            }
            .into(),
            bytes,
            columns,
            decimal,
            rotation,
        });
    };
    let of_instrument = match (is_stdin(set), is_stdin(instrument)) {
        (true, true) => {
            let text = "only one of the two files can be the standard input (-)";
            return Err(Usage(text.into()).into());
        }
        (_, true) => read_stdin()?,
        _ => read(instrument)?,
    };
    let (content_type, form) = form(&[
        ("robot", set, &bytes),
        ("instrument", instrument, &of_instrument),
    ]);
    Ok(MeasurementFiles {
        content_type,
        bytes: form,
        columns,
        decimal,
        rotation,
    })
}

fn read_stdin() -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let limit = MAX_UPLOAD_BYTES as u64;
    std::io::stdin()
        .take(limit + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| Usage(format!("cannot read the standard input: {e}")))?;
    if bytes.len() as u64 > limit {
        let text = format!(
            "the standard input has more than {} MiB",
            limit / (1024 * 1024)
        );
        return Err(Usage(text).into());
    }
    Ok(bytes)
}

/// A multipart form with these files. Its boundary is a hash of the files, so that the same files make the same bytes.
fn form(files: &[(&str, &Path, &[u8])]) -> (String, Vec<u8>) {
    let hashes: Vec<String> = files
        .iter()
        .map(|(_, _, bytes)| canonical::sha256_hex(bytes))
        .collect();
    let boundary = format!(
        "kincal-{}",
        &canonical::sha256_hex(hashes.concat().as_bytes())[..40]
    );
    let mut body = Vec::new();
    for (part, path, bytes) in files {
        let name: String = path
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or(part)
            .chars()
            .filter(|c| !c.is_control() && *c != '"')
            .take(200)
            .collect();
        let head = format!(
            "--{boundary}\r\nContent-Disposition: form-data; name=\"{part}\"; filename=\"{name}\"\r\nContent-Type: application/octet-stream\r\n\r\n"
        );
        body.extend_from_slice(head.as_bytes());
        body.extend_from_slice(bytes);
        body.extend_from_slice(b"\r\n");
    }
    body.extend_from_slice(format!("--{boundary}--\r\n").as_bytes());
    (format!("multipart/form-data; boundary={boundary}"), body)
}

/// Lines that tell the user how the files were understood. A CSV in the default format needs none.
pub fn in_words(reading: &Reading) -> Vec<String> {
    if let Some(joined) = &reading.joined {
        let mut lines = table_in_words("robot file: ", &joined.robot, true);
        lines.extend(table_in_words(
            "instrument file: ",
            &joined.instrument,
            true,
        ));
        lines.extend(join_in_words(&joined.join));
        return lines;
    }
    let understood = reading.understood.as_ref();
    understood.map_or(vec![], |table| table_in_words("", table, false))
}

fn table_in_words(file: &str, table: &UnderstoodBody, always: bool) -> Vec<String> {
    let own = |column: &UnderstoodColumn| match &column.unit {
        Some(unit) => format!("{}_{unit}", column.means),
        None => column.means.clone(),
    };
    let is_plain = table.separator == ","
        && table.decimal == Decimal::Point
        && table.encoding == "utf-8"
        && table.header_row == Some(1)
        && table.ignored.is_empty()
        && table
            .columns
            .iter()
            .all(|column| column.column == own(column));
    if is_plain && !always {
        return vec![];
    }
    let decimal = match table.decimal {
        Decimal::Point => "points",
        Decimal::Comma => "commas",
    };
    let header = table
        .header_row
        .map_or("no header".into(), |line| format!("header in line {line}"));
    let sheet = table
        .sheet
        .as_ref()
        .map_or(String::new(), |sheet| format!(", sheet {sheet:?}"));
    let columns: Vec<String> = table
        .columns
        .iter()
        .map(|column| format!("{} = {:?}", own(column), column.column))
        .collect();
    let mut lines = vec![
        format!(
            "{file}read as {}{sheet}, columns separated by {:?}, decimal {decimal}, {header}, {} other lines skipped",
            table.encoding, table.separator, table.skipped_rows
        ),
        format!("{file}{}", columns.join(", ")),
    ];
    if !table.ignored.is_empty() {
        lines.push(format!("{file}not read: {}", table.ignored.join(", ")));
    }
    if !table.reflectors.is_empty() {
        let names = table.reflectors.iter().enumerate();
        let names: Vec<String> = names
            .map(|(at, name)| format!("{at} = {}", plain(name)))
            .collect();
        lines.push(format!("{file}reflectors (target): {}", names.join(", ")));
    }
    if let Some(n) = table.other_groups {
        let groups: Vec<String> = table.groups.iter().map(|name| plain(name)).collect();
        lines.push(format!(
            "{file}only these groups of points are read: {}; {n} rows of other groups are not",
            groups.join(", ")
        ));
    }
    lines.extend(unread_in_words(table).map(|line| format!("{file}{line}")));
    lines
}

/// Number of points that are listed in one line.
const POINTS_SHOWN: usize = 10;

/// The points of a robot program that are not read.
pub fn unread_in_words(table: &UnderstoodBody) -> Option<String> {
    let unread = table.unread.as_ref()?;
    let point = |point: &UnreadPoint| {
        let name = match point.name.as_str() {
            "" => String::new(),
            name => format!(" {}", plain(name)),
        };
        format!("line {}{name} ({})", point.line, point.reason)
    };
    let points: Vec<String> = unread.points.iter().take(POINTS_SHOWN).map(point).collect();
    let more = if unread.n > points.len() { ", …" } else { "" };
    Some(format!(
        "not read of the program: {}{more} ({} in all)",
        points.join(", "),
        unread.n
    ))
}

fn join_in_words(join: &JoinBody) -> Vec<String> {
    let clock = match (join.clock_offset_s, join.tolerance_s) {
        // Two logs are paired at times when both show a standstill.
        (Some(offset), Some(0.0)) => format!("; {}", clock_offset_in_words(offset)),
        (Some(offset), Some(tolerance)) => {
            format!(
                "; {}, pairs may be {tolerance:.3} s apart",
                clock_offset_in_words(offset)
            )
        }
        _ => String::new(),
    };
    let left_out = join.left_out.as_ref();
    let left_out = left_out.map(|left_out| format!(" ({})", plain(&left_out.in_words())));
    let loosely = match join.loose_names {
        true if left_out.is_some() => "",
        true => {
            " (names agree loosely: without signs, spaces and leading zeros, or by their numbers alone)"
        }
        false => "",
    };
    let loosely = left_out.as_deref().unwrap_or(loosely);
    let clock = match join.over_midnight {
        true => clock + "; times of day that fall back are those of the next day",
        false => clock,
    };
    let clock = match join.instrument_log {
        true => clock + "; one position per standstill was taken from the instrument's log",
        false => clock,
    };
    let mut lines = vec![format!(
        "{} of rows, joined by {}{loosely}{clock}",
        if join.n_joined == 1 {
            "1 pair".into()
        } else {
            format!("{} pairs", join.n_joined)
        },
        join.by
    )];
    for (file, rest) in [
        ("robot", &join.leftover_robot),
        ("instrument", &join.leftover_instrument),
    ] {
        if rest.n > 0 {
            let rows: Vec<String> = rest
                .rows
                .iter()
                .take(10)
                .map(|row| match row.label.as_str() {
                    "" => format!("line {}", row.line),
                    label => format!("line {} ({label})", row.line),
                })
                .collect();
            let more = if rest.n > rows.len() { ", …" } else { "" };
            let rows_have = match rest.n {
                1 => format!("row of the {file} file has"),
                _ => format!("rows of the {file} file have"),
            };
            lines.push(format!(
                "{} {rows_have} no partner: {}{more}",
                rest.n,
                rows.join(", ")
            ));
        }
    }
    lines
}

/// Largest offset between two clocks that show the same date, s: two days and a time zone. With a larger offset the clocks have different
/// epochs.
const MAX_SAME_CALENDAR_S: f64 = 200_000.0;

fn clock_offset_in_words(offset_s: f64) -> String {
    let size_s = offset_s.abs();
    match offset_s {
        _ if size_s > MAX_SAME_CALENDAR_S => format!(
            "the two clocks count from different moments (the robot's minus the instrument's: {offset_s:.3} s)"
        ),
        offset_s if offset_s < 0.0 => {
            format!("the robot's clock is {size_s:.3} s behind the instrument's")
        }
        _ => format!("the robot's clock is {size_s:.3} s ahead of the instrument's"),
    }
}
