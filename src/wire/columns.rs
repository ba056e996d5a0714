//! The column mapping of a file, as callers write it: `{"q1_deg": "J1 [deg]", "x_mm": "X (mm)"}`.

use crate::measurement::Decimal;
use crate::measurement::columns::mapping::{ColumnRef, HeaderRow, Mapping, Separator};
use crate::measurement::columns::meaning::is_meaning;
use crate::measurement::columns::names::{ANGLES, LENGTHS, PLAIN};
use crate::measurement::join::{JoinBy, JoinOptions};
use crate::wire::issue::{Checker, Invalid};
use crate::wire::json;
use crate::wire::names;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// Maximum length of a text in a mapping, characters.
const MAX_TEXT: usize = 200;
/// Maximum number of entries of a mapping. This is ample, because a robot has at most 12 joints.
const MAX_ENTRIES: usize = 100;
/// Maximum number of columns that a mapping may ignore.
const MAX_IGNORED: usize = 1000;
/// Largest line and column number.
const MAX_NUMBER: u64 = 1_000_000;

/// Column mapping of a file. Each key is the meaning of a column, with its unit: `q1_deg` or `q1_rad` …; `x_mm`, `x_m`, `x_cm`, `x_um` or `x_in` …;
/// `configuration`, `target`, `subset`, `measured_at`, `std_mm`, `station`, `session`, `sequence`, `temperature_c`; `name`, `number`, `time_s`. Each
/// value is the header of the column, or its number counted from 1.
///
/// Further keys are settings: `decimal` (`point`, `comma`), `separator` (`,` `;` `|` `tab` `spaces`), `header_row` (a line number counted from 1, or
/// false), `comments` (true, false), `ignore` (a list of columns), `sheet`, and the units of columns whose header has no unit: `joint_unit` (`deg`,
/// `rad`, `gon`) and `position_unit` (`mm`, `m`, `cm`, `um`, `in`). `groups` (a list of names) says which groups of points of an instrument's file are
/// read, if one point stands under several, such as `Nominals` and `Measured`. A group is the part of a name before its last `::`, or stands in columns
/// `group` and `collection`.
///
/// For two files: `robot` and `instrument` contain the mapping of one of the files, and `join` says how their rows are joined (`{"by":
/// "name"|"number"|"time"|"order", "tolerance_s", "clock_offset_s"}`).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(value_type = Object, example = json!({"q1_deg": "J1 [deg]", "x_mm": "X (mm)"}))]
#[serde(transparent)]
pub struct ColumnsBody(pub Map<String, Value>);

/// A column mapping that is stored under a name.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = ColumnMapping)]
pub struct ColumnMappingAnswer {
    /// Its name.
    pub name: String,
    /// The mapping.
    pub columns: ColumnsBody,
    /// RFC 3339, UTC.
    pub created_at: String,
}

names! {
    /// The file of an upload that a mapping is for.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum FilePart {
        /// The only file.
        Table = "table",
        /// The robot's file, if there are two files.
        Robot = "robot",
        /// The instrument's file, if there are two files.
        Instrument = "instrument",
    }
}

impl ColumnsBody {
    /// Parses a mapping and makes all checks that are possible without the file.
    pub fn parse(text: &[u8]) -> Result<Self, Invalid> {
        let text = text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text);
        let body: Self = json::parse(text).map_err(|error| match error {
            json::Error::Shape(invalid) => invalid,
            json::Error::Syntax(detail) => Invalid::at(
                "/columns",
                "malformed_json",
                format!("the mapping of columns is a JSON object, {{\"q1_deg\": \"J1 [deg]\", …}}: {detail}"),
            ),
        })?;
        body.check()?;
        Ok(body)
    }

    /// Makes all checks that are possible without the file.
    pub fn check(&self) -> Result<(), Invalid> {
        for part in [FilePart::Table, FilePart::Robot, FilePart::Instrument] {
            self.mapping(part)?;
        }
        self.join()?;
        Ok(())
    }

    /// The mapping of one file. With two files, the joint columns (`q1_deg …`) belong to the robot's file and all other columns to the instrument's
    /// file. The join keys (`name`, `number`, `time_s`) belong to both files. Entries in `robot` or `instrument` take precedence.
    pub fn mapping(&self, part: FilePart) -> Result<Mapping, Invalid> {
        let mut reader = Reader::default();
        let mut mapping = Mapping::default();
        let own = match part {
            FilePart::Table => None,
            part => self.0.get(part.as_str()),
        };
        if let Some(own) = own {
            match own.as_object() {
                Some(own) => reader.object(own, &format!("/{}", part.as_str()), &mut mapping),
                None => reader.wrong(
                    &format!("/{}", part.as_str()),
                    "an object with the columns of that file",
                ),
            }
        }
        let stated: Vec<String> = mapping
            .columns
            .iter()
            .map(|(means, _)| means.clone())
            .collect();
        let is_wanted = |means: &str| {
            let is_joint =
                means.starts_with('q') && means.as_bytes().get(1).is_some_and(u8::is_ascii_digit);
            let is_key = means == "name" || means == "number" || means.starts_with("time");
            let is_stated = stated.iter().any(|known| known == means);
            let is_this = match part {
                FilePart::Table => true,
                FilePart::Robot => is_joint || is_key,
                FilePart::Instrument => !is_joint,
            };
            is_this && !is_stated
        };
        let common: Map<String, Value> = self
            .0
            .iter()
            .filter(|(means, _)| {
                !matches!(means.as_str(), "robot" | "instrument" | "join")
                    && (SETTINGS.contains(&means.as_str()) || is_wanted(means))
            })
            .map(|(means, value)| (means.clone(), value.clone()))
            .collect();
        let mut shared = Mapping::default();
        reader.object(&common, "", &mut shared);
        mapping.columns.extend(shared.columns);
        mapping.ignore.extend(shared.ignore);
        mapping.decimal = mapping.decimal.or(shared.decimal);
        mapping.separator = mapping.separator.or(shared.separator);
        mapping.header_row = mapping.header_row.or(shared.header_row);
        mapping.comments = mapping.comments.or(shared.comments);
        mapping.sheet = mapping.sheet.or(shared.sheet);
        mapping.joint_unit = mapping.joint_unit.or(shared.joint_unit);
        mapping.position_unit = mapping.position_unit.or(shared.position_unit);
        mapping.groups.extend(shared.groups);
        reader.checker.finish("invalid_columns")?;
        Ok(mapping)
    }

    /// The options for joining two files.
    pub fn join(&self) -> Result<JoinOptions, Invalid> {
        let mut reader = Reader::default();
        let mut options = JoinOptions::default();
        let empty = Map::new();
        let join = match self.0.get("join") {
            None => &empty,
            Some(Value::Object(join)) => join,
            Some(_) => {
                reader.wrong("/join", "an object: {\"by\": \"name\"}");
                &empty
            }
        };
        for (name, value) in join {
            let pointer = format!("/join/{name}");
            let seconds = value
                .as_f64()
                .filter(|s| s.is_finite() && s.abs() <= 1.0e10);
            match name.as_str() {
                "by" => {
                    let by = JoinBy::ALL
                        .into_iter()
                        .find(|by| value.as_str() == Some(by.as_str()));
                    if by.is_none() {
                        reader.wrong(&pointer, "name, number, time or order");
                    }
                    options.by = by;
                }
                "tolerance_s" if seconds.is_some_and(|s| s >= 0.0) => options.tolerance_s = seconds,
                "clock_offset_s" if seconds.is_some() => options.clock_offset_s = seconds,
                "tolerance_s" | "clock_offset_s" => reader.wrong(&pointer, "a number of seconds"),
                _ => reader.wrong(
                    &pointer,
                    "nothing: a join has by, tolerance_s and clock_offset_s",
                ),
            }
        }
        reader.checker.finish("invalid_columns")?;
        Ok(options)
    }
}

/// Keys that are settings and not meanings of columns.
const SETTINGS: [&str; 9] = [
    "decimal",
    "separator",
    "header_row",
    "comments",
    "ignore",
    "sheet",
    "joint_unit",
    "position_unit",
    "groups",
];

/// Reads the values of a mapping and collects the issues.
#[derive(Default)]
struct Reader {
    checker: Checker,
}

impl Reader {
    fn wrong(&mut self, pointer: &str, expected: &str) {
        let detail = format!("expected {expected}");
        self.checker.add(pointer, "invalid_columns", detail);
    }

    fn object(&mut self, object: &Map<String, Value>, at: &str, mapping: &mut Mapping) {
        if object.len() > MAX_ENTRIES {
            self.wrong(at, &format!("a mapping of at most {MAX_ENTRIES} entries"));
            return;
        }
        for (name, value) in object {
            let pointer = format!("{at}/{name}");
            match name.as_str() {
                "decimal" => match value.as_str() {
                    Some("comma") => mapping.decimal = Some(Decimal::Comma),
                    Some("point") => mapping.decimal = Some(Decimal::Point),
                    _ => self.wrong(&pointer, "point or comma"),
                },
                "separator" => match value.as_str().and_then(Separator::parse) {
                    Some(separator) => mapping.separator = Some(separator),
                    None => self.wrong(&pointer, "one of , ; | tab spaces"),
                },
                "header_row" => match (value, value.as_u64()) {
                    (Value::Bool(false), _) => mapping.header_row = Some(HeaderRow::None),
                    (_, Some(line)) if (1..=MAX_NUMBER).contains(&line) => {
                        mapping.header_row = Some(HeaderRow::Line(line as usize));
                    }
                    _ => self.wrong(&pointer, "a line, counted from 1, or false"),
                },
                "comments" => match value.as_bool() {
                    Some(comments) => mapping.comments = Some(comments),
                    None => self.wrong(&pointer, "true or false"),
                },
                "sheet" => match value
                    .as_str()
                    .filter(|text| text.chars().count() <= MAX_TEXT)
                {
                    Some(sheet) => mapping.sheet = Some(sheet.to_owned()),
                    None => self.wrong(&pointer, "the name of a sheet"),
                },
                "joint_unit" => {
                    mapping.joint_unit = self.unit(value, &pointer, &ANGLES.map(|(name, _)| name));
                }
                "position_unit" => {
                    mapping.position_unit =
                        self.unit(value, &pointer, &LENGTHS.map(|(name, _)| name));
                }
                "ignore" => match value.as_array().filter(|list| list.len() <= MAX_IGNORED) {
                    Some(list) => {
                        for (index, value) in list.iter().enumerate() {
                            let column = self.column(value, &format!("{pointer}/{index}"));
                            mapping.ignore.extend(column);
                        }
                    }
                    None => self.wrong(&pointer, "a list of columns"),
                },
                "groups" => self.groups(value, &pointer, mapping),
                "rotation" => {
                    let detail = "the convention of angles is no column: state it beside the mapping, as rotation=intrinsic_xyz (--rotation intrinsic_xyz)";
                    self.checker.add(&pointer, "unknown_meaning", detail);
                }
                _ if !is_meaning(name) => {
                    let detail = format!(
                        "unknown key {name:?}; known are q1_deg … (or _rad _gon), x_mm y_mm z_mm (or _m _cm _um _in), {}, name, number, time_s; or \
                         decimal, separator, header_row, comments, ignore, sheet, joint_unit, position_unit, groups, robot, instrument, join",
                        PLAIN.join(", ")
                    );
                    self.checker.add(&pointer, "unknown_meaning", detail);
                }
                _ => {
                    let column = self.column(value, &pointer);
                    mapping
                        .columns
                        .extend(column.map(|column| (name.clone(), column)));
                }
            }
        }
    }

    fn groups(&mut self, value: &Value, pointer: &str, mapping: &mut Mapping) {
        let name = |value: &Value| {
            let name = value
                .as_str()
                .map(str::trim)
                .filter(|name| !name.is_empty());
            name.filter(|name| name.chars().count() <= MAX_TEXT)
                .map(str::to_owned)
        };
        let list = value.as_array().filter(|list| list.len() <= MAX_ENTRIES);
        let names: Option<Vec<String>> = list.and_then(|list| list.iter().map(name).collect());
        match names {
            Some(names) => mapping.groups.extend(names),
            None => self.wrong(pointer, "a list of groups of points: [\"Measured\"]"),
        }
    }

    fn unit(
        &mut self,
        value: &Value,
        pointer: &str,
        units: &[&'static str],
    ) -> Option<&'static str> {
        let found = value
            .as_str()
            .and_then(|text| units.iter().find(|unit| **unit == text));
        if found.is_none() {
            self.wrong(pointer, &format!("one of {}", units.join(", ")));
        }
        found.copied()
    }

    fn column(&mut self, value: &Value, pointer: &str) -> Option<ColumnRef> {
        let number = value
            .as_u64()
            .filter(|number| (1..=MAX_NUMBER).contains(number));
        let text = value
            .as_str()
            .filter(|text| !text.is_empty() && text.chars().count() <= MAX_TEXT);
        match (text, number) {
            (Some(text), _) => Some(ColumnRef::Header(text.to_owned())),
            (None, Some(number)) => Some(ColumnRef::Number(number as usize)),
            (None, None) => {
                self.wrong(
                    pointer,
                    "the header of a column, or its number counted from 1",
                );
                None
            }
        }
    }
}
