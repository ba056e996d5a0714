//! `kincal references`: lengths with a certificate that the instrument measured.

use super::files::{BYTE_ORDER_MARK, read};
use super::subject::{RobotArgument, checked};
use super::terminal::{columns, shown_items};
use super::usage::Usage;
use crate::measurement::Decimal;
use crate::measurement::csv::number_text::value;
use crate::wire::reference::{ReferenceBody, ReferenceLengthBody};
use serde::Deserialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// References of a robot's instruments: a scale bar or other lengths with a certificate, and what the instrument measured of them.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// List a robot's references, or show one.
    List(List),
    /// Store a reference; uploads name it with --reference NAME.
    Add(Add),
}

#[derive(Debug, clap::Args)]
struct List {
    #[command(flatten)]
    robot: RobotArgument,
    /// Show only the one with this id, in any version.
    #[arg(value_name = "ID")]
    id: Option<String>,
}

#[derive(Debug, clap::Args)]
struct Add {
    #[command(flatten)]
    robot: RobotArgument,
    /// CSV file with the columns name, nominal_mm, measured_mm, std_mm: one row for each length.
    #[arg(value_name = "LENGTHS")]
    lengths: PathBuf,
    /// Name of the reference [default: reference].
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// The instrument and its certificate.
    #[arg(long, value_name = "TEXT")]
    instrument: Option<String>,
}

/// Lists references, or stores one.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.command {
        Command::List(list) => {
            let below = match &list.id {
                Some(id) => format!("/references/{}", checked(id)?),
                None => "/references".into(),
            };
            let answer = list.robot.get(&below)?;
            list.robot
                .output
                .print(&answer, || shown_items(&answer, in_words))
        }
        Command::Add(add) => {
            let body = ReferenceBody {
                name: add.name.clone(),
                items: lengths(&add.lengths)?,
                instrument: add.instrument.clone(),
            };
            let answer = add
                .robot
                .send(reqwest::Method::POST, "/references", &body)?;
            add.robot
                .output
                .print(&answer, || in_words(std::slice::from_ref(&answer)))
        }
    }
}

/// A table: name, version, the scale of the instrument and whether it is off, and the instrument.
fn in_words(items: &[Value]) -> String {
    let row = |item: &Value| {
        let ppm = |field: &str| format!("{:.1}", item[field].as_f64().unwrap_or(f64::NAN));
        vec![
            item["name"].as_str().unwrap_or_default().to_owned(),
            item["version"].to_string(),
            item["items"].as_array().map_or(0, Vec::len).to_string(),
            ppm("scale_error_ppm"),
            ppm("scale_std_ppm"),
            match item["is_off"].as_bool() {
                Some(true) => "off".into(),
                _ => "in order".into(),
            },
            item["instrument"].as_str().unwrap_or("–").to_owned(),
        ]
    };
    let names = [
        "name",
        "version",
        "lengths",
        "error ppm",
        "standard uncertainty ppm",
        "scale",
        "instrument",
    ];
    columns(&names, &items.iter().map(row).collect::<Vec<_>>())
}

/// A row as text, because the decimal mark depends on the separator.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    name: String,
    nominal_mm: String,
    measured_mm: String,
    std_mm: String,
}

/// The lengths of a CSV file: with commas and decimal points, or with semicolons and decimal commas or points.
fn lengths(file: &Path) -> anyhow::Result<Vec<ReferenceLengthBody>> {
    parse(&read(file)?).map_err(|why| {
        let columns = "its columns are name, nominal_mm, measured_mm, std_mm";
        Usage(format!("{}: {why}; {columns}", file.display())).into()
    })
}

fn parse(bytes: &[u8]) -> Result<Vec<ReferenceLengthBody>, String> {
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    let header = bytes.split(|byte| *byte == b'\n').next();
    let delimiter = match header.is_some_and(|header| header.contains(&b';')) {
        true => b';',
        false => b',',
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .delimiter(delimiter)
        .from_reader(bytes);
    let rows = reader.deserialize::<Row>().zip(2..);
    let length = |(row, line): (Result<Row, csv::Error>, usize)| {
        let row = row.map_err(|error| error.to_string())?;
        let number = |cell: &str| {
            let decimal = match delimiter == b';' && cell.contains(',') {
                true => Decimal::Comma,
                false => Decimal::Point,
            };
            value(cell, decimal).ok_or_else(|| format!("line {line}: {cell:?} is not a number"))
        };
        Ok(ReferenceLengthBody {
            nominal_mm: number(&row.nominal_mm)?,
            measured_mm: number(&row.measured_mm)?,
            std_mm: number(&row.std_mm)?,
            name: row.name,
        })
    };
    let lengths: Vec<_> = rows.map(length).collect::<Result<_, String>>()?;
    match lengths.is_empty() {
        true => Err("it has no row, and a reference has one length at least".into()),
        false => Ok(lengths),
    }
}

#[cfg(test)]
mod tests {
    use super::{in_words, parse};
    use serde_json::json;

    #[test]
    fn lengths_are_read_with_points_and_with_commas() {
        let points = "name,nominal_mm,measured_mm,std_mm\nbar 1,1000.012,1000.031,0.004\n";
        let commas =
            "\u{feff}name;nominal_mm;measured_mm;std_mm\r\nbar 1;1000,012;1000,031;0,004\r\n";
        let semicolons = "name;nominal_mm;measured_mm;std_mm\nbar 1;1000.012;1000.031;0.004\n";
        let expected = parse(points.as_bytes()).unwrap();
        assert_eq!(expected[0].measured_mm, 1000.031);
        for text in [commas, semicolons] {
            assert_eq!(parse(text.as_bytes()).unwrap(), expected, "{text}");
        }
        let wrong = "name;nominal_mm;measured_mm;std_mm\nbar 1;1.000,012;x;0,004\n";
        assert_eq!(
            parse(wrong.as_bytes()).unwrap_err(),
            "line 2: \"x\" is not a number"
        );
        assert!(parse(b"name,nominal_mm,measured_mm,std_mm\n").is_err());
    }

    #[test]
    fn the_instrument_stands_under_its_heading() {
        let item = json!({"name": "bar", "version": 1, "items": [], "scale_error_ppm": 20.0, "scale_std_ppm": 4.0, "is_off": true, "instrument": "tracker 7"});
        let table = in_words(&[item]);
        let (head, rows) = table.split_once('\n').unwrap();
        assert_eq!(head.find("instrument"), rows.find("tracker 7"), "{table}");
        assert_eq!(head.rfind("scale"), rows.find("off"), "{table}");
    }
}
