//! Options for the meaning of a file's columns: a mapping without writing JSON.

use super::files::read;
use super::usage::Usage;
use crate::wire::columns::ColumnsBody;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Meaning of columns whose names do not state it.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ColumnOptions {
    /// Unit of joint values in columns whose names have no unit.
    #[arg(long, env = "KINCAL_JOINT_UNIT", value_name = "UNIT", value_parser = ["deg", "rad", "gon"])]
    pub joint_unit: Option<String>,
    /// Unit of positions in columns whose names have no unit.
    #[arg(long, env = "KINCAL_POSITION_UNIT", value_name = "UNIT", value_parser = ["mm", "m", "cm", "um", "in"])]
    pub position_unit: Option<String>,
    /// Meaning of a column: q1_deg="J1", x_mm=5 or name="Target", with the text of its header or its number, counted from 1. Once per column.
    /// With two files, robot.name=… and instrument.name=… state the file, also for settings: instrument.header_row=none.
    #[arg(long, env = "KINCAL_COLUMN", value_name = "MEANING=COLUMN", value_parser = column)]
    pub column: Vec<(String, Value)>,
    /// Column to ignore although its name is known. Once per column.
    #[arg(long, env = "KINCAL_IGNORE", value_name = "COLUMN")]
    pub ignore: Vec<String>,
    /// Group of points to read, if one point stands under several groups of the instrument's file: Measured beside Nominals. Once per group.
    #[arg(long, env = "KINCAL_GROUP", value_name = "GROUP")]
    pub group: Vec<String>,
    /// Key by which the rows of two files are joined.
    #[arg(long, env = "KINCAL_JOIN", value_name = "BY", value_parser = ["name", "number", "time", "order"])]
    pub join: Option<String>,
    /// The robot's clock minus the instrument's, if the files are joined by time [default: found from the times].
    #[arg(
        long,
        env = "KINCAL_CLOCK_OFFSET_S",
        value_name = "SECONDS",
        allow_negative_numbers = true
    )]
    pub clock_offset_s: Option<f64>,
    /// Largest time difference between the two rows of a pair [default: found from the times].
    #[arg(long, env = "KINCAL_JOIN_TOLERANCE_S", value_name = "SECONDS")]
    pub join_tolerance_s: Option<f64>,
    /// Line of the header, counted from 1, or `none` if all lines are data. Of one of two files: --column instrument.header_row=none.
    #[arg(long, env = "KINCAL_HEADER_ROW", value_name = "LINE", value_parser = header_row)]
    pub header_row: Option<Value>,
    /// Separator of the columns.
    #[arg(long, env = "KINCAL_SEPARATOR", value_name = "SEPARATOR", value_parser = [",", ";", "|", "tab", "spaces"])]
    pub separator: Option<String>,
    /// Sheet to read, if the workbook has several.
    #[arg(long, env = "KINCAL_SHEET", value_name = "NAME")]
    pub sheet: Option<String>,
    /// Decimal mark, if the numbers of the file do not show it.
    #[arg(long, env = "KINCAL_DECIMAL", value_name = "MARK", value_parser = ["comma", "point"])]
    pub decimal: Option<String>,
    /// Whether lines that begin with #, %, ! or // are comments.
    #[arg(long, env = "KINCAL_COMMENTS", value_name = "true|false")]
    pub comments: Option<bool>,
    /// File with the whole mapping as a JSON object, {"q1_deg": "J1 [deg]", "x_mm": "X (mm)"} (docs/measurement-files.md). Options add to it.
    #[arg(long, env = "KINCAL_COLUMNS", value_name = "FILE")]
    pub columns: Option<PathBuf>,
}

fn column(text: &str) -> Result<(String, Value), String> {
    let Some((means, column)) = text.split_once('=').map(|(a, b)| (a.trim(), b.trim())) else {
        return Err("MEANING=COLUMN, such as q1_deg=\"J1\" or x_mm=5".into());
    };
    let column = column
        .strip_prefix('"')
        .and_then(|text| text.strip_suffix('"'))
        .unwrap_or(column);
    let setting = means.split_once('.').map_or("", |(_file, setting)| setting);
    let value = match (setting, column) {
        ("header_row", "none" | "false") | ("comments", "false") => json!(false),
        ("comments", "true") => json!(true),
        _ => column
            .parse::<u64>()
            .map_or_else(|_| json!(column), |number| json!(number)),
    };
    Ok((means.to_owned(), value))
}

fn header_row(text: &str) -> Result<Value, String> {
    match text {
        "none" => Ok(json!(false)),
        _ => text
            .parse::<u64>()
            .map(|line| json!(line))
            .map_err(|_| "a line, counted from 1, or none".into()),
    }
}

impl ColumnOptions {
    /// The mapping that the file and the options state.
    pub fn body(&self) -> anyhow::Result<ColumnsBody> {
        let mut all = match &self.columns {
            None => Map::new(),
            Some(path) => named_columns(path)?.0,
        };
        for (means, column) in &self.column {
            let (file, means) = means.split_once('.').unwrap_or(("", means));
            match file {
                "" => all.insert(means.into(), column.clone()),
                _ => object(&mut all, file).insert(means.into(), column.clone()),
            };
        }
        let ignore = Some(&self.ignore).filter(|ignore| !ignore.is_empty());
        let groups = Some(&self.group).filter(|groups| !groups.is_empty());
        all.extend(given(json!({
            "groups": groups,
            "joint_unit": self.joint_unit, "position_unit": self.position_unit, "header_row": self.header_row, "separator": self.separator,
            "decimal": self.decimal, "sheet": self.sheet, "comments": self.comments, "ignore": ignore,
        })));
        let mut join = given(json!({
            "by": self.join, "clock_offset_s": self.clock_offset_s, "tolerance_s": self.join_tolerance_s,
        }))
        .peekable();
        if join.peek().is_some() {
            object(&mut all, "join").extend(join);
        }
        let body = ColumnsBody(all);
        body.check().map_err(|invalid| {
            let faults: Vec<String> = invalid
                .issues
                .iter()
                .map(|issue| issue.in_words())
                .collect();
            Usage(faults.join("\n"))
        })?;
        Ok(body)
    }
}

/// The fields of an object that are not null.
fn given(options: Value) -> impl Iterator<Item = (String, Value)> {
    let fields = match options {
        Value::Object(fields) => fields,
        _ => Map::new(),
    };
    fields.into_iter().filter(|(_, value)| !value.is_null())
}

fn object<'m>(all: &'m mut Map<String, Value>, name: &str) -> &'m mut Map<String, Value> {
    let value = all.entry(name).or_insert_with(|| json!({}));
    if !value.is_object() {
        *value = json!({});
    }
    match value {
        Value::Object(object) => object,
        _ => unreachable!("it was made an object"),
    }
}

fn named_columns(path: &Path) -> anyhow::Result<ColumnsBody> {
    ColumnsBody::parse(&read(path)?).map_err(|invalid| {
        let faults: Vec<String> = invalid
            .issues
            .iter()
            .map(|issue| format!("\n  {}", issue.in_words()))
            .collect();
        Usage(format!(
            "{} cannot be used:{}",
            path.display(),
            faults.concat()
        ))
        .into()
    })
}

#[cfg(test)]
mod tests {
    use super::{ColumnOptions, column};
    use serde_json::json;

    #[test]
    fn options_are_a_mapping() {
        let options = ColumnOptions {
            joint_unit: Some("deg".into()),
            column: [
                "x_mm=5",
                "robot.name=\"P Name\"",
                "instrument.name=Target",
                "instrument.header_row=none",
                "robot.comments=true",
            ]
            .map(|text| column(text).unwrap())
            .to_vec(),
            join: Some("name".into()),
            clock_offset_s: Some(-1.5),
            ..ColumnOptions::default()
        };
        let meant = json!({"x_mm": 5, "robot": {"name": "P Name", "comments": true}, "instrument": {"name": "Target", "header_row": false}, "joint_unit": "deg",
            "join": {"by": "name", "clock_offset_s": -1.5}});
        assert_eq!(
            serde_json::to_value(options.body().unwrap()).unwrap(),
            meant
        );
        let wrong = ColumnOptions {
            column: vec![column("q99_deg=J1").unwrap()],
            ..ColumnOptions::default()
        };
        assert!(wrong.body().is_err());
        assert!(column("J1").is_err());
    }
}
