//! How a table was interpreted. This is part of answers and is stored with the bytes of an upload.

use crate::measurement::columns::mapping::{ColumnRef, HeaderRow, Mapping, Separator};
use crate::measurement::join::{Join, JoinBy, JoinOptions, LeftOut, Leftover};
use crate::measurement::programs::Unread;
use crate::measurement::table::points::Understood;
use crate::measurement::{Decimal, MeasurementSet};
use crate::wire::instrument::InstrumentBody;
use crate::wire::reference::SetReference;
use crate::wire::session_record::SessionRecord;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of ignored columns, unread points and unpaired rows that are listed.
const MAX_NAMED: usize = 50;
/// Maximum length of a column name in answers, characters. Longer names are cut.
const MAX_NAME_SHOWN: usize = 100;

/// How a table was interpreted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = Understood)]
pub struct UnderstoodBody {
    /// Column separator: `,` `;` `|` `tab` or `spaces`.
    pub separator: String,
    /// The decimal mark.
    pub decimal: Decimal,
    /// `utf-8`, `utf-16le`, `utf-16be`, `windows-1252`, `xlsx`, `ods` or `robot program`.
    pub encoding: String,
    /// The sheet of a workbook.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sheet: Option<String>,
    /// Line of the header, counted from 1; null if the file has no header.
    #[schema(required)]
    pub header_row: Option<usize>,
    /// True if quotes that close nothing were read as plain characters, or cells with line breaks were joined.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub plain_quotes: bool,
    /// Whether rows that begin with a comment sign are comments: as the mapping states, else true for at most one row in five. Absent if no row begins
    /// with such a sign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub comments: Option<bool>,
    /// The columns that are read.
    pub columns: Vec<UnderstoodColumn>,
    /// Names of columns that are not read. They are still contained in the stored bytes.
    pub ignored: Vec<String>,
    /// Number of lines that are not data: blank lines, comments, units, and lines above the header.
    pub skipped_rows: usize,
    /// Names of the reflectors (targets) in the order of their numbers, counted from 0; absent if the file has numbers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reflectors: Vec<String>,
    /// Points of a robot program that are not read; absent if all are read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unread: Option<UnreadPoints>,
    /// The groups of points that are read, as the mapping states them; absent for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub groups: Vec<String>,
    /// Number of rows of other groups; absent if there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub other_groups: Option<usize>,
}

/// Points of a robot program that are not read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct UnreadPoints {
    /// Number of these points.
    pub n: usize,
    /// The first of these points.
    pub points: Vec<UnreadPoint>,
}

/// A point of a robot program that is not read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct UnreadPoint {
    /// The line on which it begins, counted from 1.
    pub line: usize,
    /// Its name; empty for a target in a motion.
    pub name: String,
    /// Why it is not read.
    pub reason: String,
}

/// A column that is read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct UnderstoodColumn {
    /// Its name in the file.
    pub column: String,
    /// Its number, counted from 1.
    pub number: usize,
    /// Its meaning: `q1`, `x`, `station`, `name` …
    pub means: String,
    /// Its unit, if it has one.
    #[schema(required)]
    pub unit: Option<String>,
}

/// How two files were joined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Join)]
pub struct JoinBody {
    /// `name`, `number`, `time` or `order`.
    pub by: String,
    /// Number of joined pairs of rows.
    pub n_joined: usize,
    /// With `time`: largest difference between the times of a pair, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance_s: Option<f64>,
    /// With `time`: the robot's clock minus the instrument's clock, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock_offset_s: Option<f64>,
    /// True if names were compared without punctuation, spaces and leading zeros, or by the numbers in them (`P1` with `Point 1` or 1).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub loose_names: bool,
    /// What is no part of the points' names, if names pair only without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out: Option<LeftOut>,
    /// True if the instrument's file is a continuous log (at least two rows per second). Then one position is taken from each standstill.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub instrument_log: bool,
    /// With `time`: true if slow parts of motions in a log count as no standstills. Absent for uploads of earlier versions, which are read as they were.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub settled_standstills: bool,
    /// With `time`: true if times of day fall back by about a day, and the rows behind are those of the next day.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub over_midnight: bool,
    /// Rows of the robot's file without a partner.
    pub leftover_robot: Leftovers,
    /// Rows of the instrument's file without a partner.
    pub leftover_instrument: Leftovers,
}

/// Rows without a partner.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Leftovers {
    /// Number of these rows.
    pub n: usize,
    /// The first of these rows.
    pub rows: Vec<LeftoverRow>,
}

/// A row without a partner.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LeftoverRow {
    /// Its line, counted from 1.
    pub line: usize,
    /// Its name, number or time.
    pub label: String,
}

/// Two files that were joined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JoinedFiles {
    /// How the robot's file was interpreted.
    pub robot: UnderstoodBody,
    /// How the instrument's file was interpreted.
    pub instrument: UnderstoodBody,
    /// How the rows of the two files were joined.
    pub join: JoinBody,
}

/// How an upload was interpreted. It is stored with the upload, so that the upload is read in the same way again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// For a single table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub understood: Option<UnderstoodBody>,
    /// For two files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joined: Option<JoinedFiles>,
    /// The instrument, if it was stated in the query or in a JSON body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument: Option<InstrumentBody>,
    /// The reference that the instrument measured, if the query named one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<SetReference>,
    /// When, by whom and with what the session was measured, if the query stated it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record: Option<SessionRecord>,
    /// True if the poses are inverted before use: they are those of a fixed board as seen by a camera that the robot carries.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub inverse_poses: bool,
}

impl From<&Understood> for UnderstoodBody {
    fn from(found: &Understood) -> Self {
        let column = |(used, name): &(crate::measurement::table::columns::Used, String)| {
            let (means, unit) = split(&used.means);
            UnderstoodColumn {
                column: shortened(name),
                number: used.place + 1,
                means: means.into(),
                unit: unit.map(str::to_owned),
            }
        };
        Self {
            separator: found.separator.as_str().into(),
            decimal: found.decimal,
            encoding: found.encoding.as_str().into(),
            sheet: found.sheet.clone(),
            header_row: found.header_row,
            plain_quotes: found.plain_quotes,
            comments: found.comments,
            columns: found.columns.iter().map(column).collect(),
            ignored: found
                .ignored
                .iter()
                .take(MAX_NAMED)
                .map(|name| shortened(name))
                .collect(),
            skipped_rows: found.skipped_rows,
            reflectors: found
                .reflectors
                .iter()
                .map(|name| shortened(name))
                .collect(),
            unread: UnreadPoints::from_unread(&found.unread),
            groups: found.groups.clone(),
            other_groups: Some(found.n_other_groups).filter(|n| *n > 0),
        }
    }
}

impl UnreadPoints {
    fn from_unread(unread: &[Unread]) -> Option<Self> {
        let point = |point: &Unread| UnreadPoint {
            line: point.line,
            name: shortened(&point.name),
            reason: point.reason.as_str().into(),
        };
        (!unread.is_empty()).then(|| Self {
            n: unread.len(),
            points: unread.iter().take(MAX_NAMED).map(point).collect(),
        })
    }
}

fn shortened(name: &str) -> String {
    name.chars().take(MAX_NAME_SHOWN).collect()
}

/// Splits a meaning into quantity and unit. Names such as `std_mm` are not split.
fn split(means: &str) -> (&str, Option<&str>) {
    match means.split_once('_') {
        Some((base, unit)) if matches!(base, "x" | "y" | "z" | "time") => (base, Some(unit)),
        Some((base, unit))
            if base
                .strip_prefix('q')
                .is_some_and(|n| n.parse::<u16>().is_ok()) =>
        {
            (base, Some(unit))
        }
        _ => (means, None),
    }
}

impl UnderstoodBody {
    /// Adds the names of the set's targets, if they have names.
    pub fn with_targets_of(mut self, set: &MeasurementSet) -> Self {
        let names = set.target_names();
        if !names.is_empty() {
            self.reflectors = names.into_iter().map(shortened).collect();
        }
        self
    }

    /// The mapping that reads the file in the same way.
    pub fn mapping(&self) -> Mapping {
        let column = |column: &UnderstoodColumn| {
            let means = match &column.unit {
                Some(unit) => format!("{}_{unit}", column.means),
                None => column.means.clone(),
            };
            (means, ColumnRef::Number(column.number))
        };
        Mapping {
            columns: self.columns.iter().map(column).collect(),
            ignore: vec![],
            decimal: Some(self.decimal),
            separator: Separator::parse(&self.separator),
            header_row: Some(self.header_row.map_or(HeaderRow::None, HeaderRow::Line)),
            plain_quotes: self.plain_quotes,
            comments: self.comments,
            sheet: self.sheet.clone(),
            groups: self.groups.clone(),
            is_complete: true,
            ..Mapping::default()
        }
    }
}

impl From<&Join> for JoinBody {
    fn from(join: &Join) -> Self {
        Self {
            by: join.by.as_str().into(),
            n_joined: join.n_joined,
            tolerance_s: join.tolerance_s,
            clock_offset_s: join.clock_offset_s,
            loose_names: join.loose_names,
            left_out: join.left_out.clone(),
            instrument_log: join.instrument_log,
            settled_standstills: join.settled_standstills,
            over_midnight: join.over_midnight,
            leftover_robot: Leftovers::from(&join.leftover_robot[..]),
            leftover_instrument: Leftovers::from(&join.leftover_instrument[..]),
        }
    }
}

impl From<&[Leftover]> for Leftovers {
    fn from(rows: &[Leftover]) -> Self {
        let row = |row: &Leftover| LeftoverRow {
            line: row.line,
            label: shortened(&row.label),
        };
        Self {
            n: rows.len(),
            rows: rows.iter().take(MAX_NAMED).map(row).collect(),
        }
    }
}

impl JoinBody {
    /// The options that join in the same way.
    pub fn options(&self) -> JoinOptions {
        JoinOptions {
            by: JoinBy::ALL.into_iter().find(|by| by.as_str() == self.by),
            tolerance_s: self.tolerance_s,
            clock_offset_s: self.clock_offset_s,
            loose_names: self.loose_names,
            left_out: self.left_out.clone(),
            instrument_log: Some(self.instrument_log),
            settled_standstills: self.settled_standstills,
            refuse_apart: false,
        }
    }
}
