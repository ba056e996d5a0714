//! State while the meanings of the columns of a table are resolved.

use crate::measurement::columns::mapping::{Mapping, Needs};
use crate::measurement::columns::meaning::{self, thing};
use crate::measurement::columns::names::Unit;
use crate::measurement::issue::Issue;
use crate::measurement::table::Table;
use std::collections::BTreeSet;

/// A column that is read.
#[derive(Clone, Debug, PartialEq)]
pub struct Used {
    /// Its index, counted from 0.
    pub place: usize,
    /// Its meaning with its unit, as written in mappings: `q1_deg`, `x_mm`, `station`, `name`.
    pub means: String,
    /// Whether the meaning comes from a mapping.
    pub is_mapped: bool,
}

/// Meanings of the columns of a table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// The columns that are read, in the order of the file.
    pub used: Vec<Used>,
    /// Errors in the columns, including missing columns.
    pub issues: Vec<Issue>,
    /// Required meanings without a column, as written in mappings, with a proposed unit.
    pub missing: Vec<String>,
    /// Proposals for the caller: meaning with unit, and index of the column. A proposal is used only if the caller confirms it.
    pub proposed: Vec<(String, usize)>,
}

/// State while the meanings of columns are resolved.
pub struct Resolution<'t> {
    pub table: &'t Table<'t>,
    pub mapping: &'t Mapping,
    pub n_joints: usize,
    pub needs: Needs,
    pub columns: Columns,
    pub taken: BTreeSet<usize>,
}

impl Resolution<'_> {
    pub fn issue(&mut self, column: Option<String>, code: &'static str, detail: String) {
        self.columns
            .issues
            .push(Issue::new(code, detail).in_column(column));
    }

    pub fn has(&self, wanted: &str) -> bool {
        self.columns
            .used
            .iter()
            .any(|used| thing(&used.means) == wanted)
    }

    pub fn needs_joints(&self) -> bool {
        self.needs != Needs::Positions
    }

    pub fn needs_positions(&self) -> bool {
        self.needs != Needs::Joints
    }

    /// The cells of the header, each with the unit below it.
    pub fn names(&self) -> Vec<(&str, Option<Unit>)> {
        let units = self.table.units.as_ref();
        let below = |place| units.and_then(|units| units.get(place).copied().flatten());
        let names = self.table.header.iter().enumerate();
        names
            .map(|(place, name)| (name.as_str(), below(place)))
            .collect()
    }

    pub fn take(&mut self, place: usize, means: String) {
        self.taken.insert(place);
        self.columns.used.push(Used {
            place,
            means,
            is_mapped: false,
        });
    }

    /// The unit of columns without a unit: from the mapping, or, for positions, from a line of the file.
    fn stated_unit(&self, thing: &str) -> Option<&'static str> {
        match thing.starts_with('q') {
            true => self.mapping.joint_unit,
            false => self.mapping.position_unit.or(self.table.length_unit),
        }
    }

    /// The refusal of a unit that the caller states for all columns, and that is not the one in a column's name.
    fn contradiction(&self, name: &str, thing: &str, unit: Unit) -> Option<String> {
        let (key, stated) = match thing.starts_with('q') {
            true => ("joint_unit", self.mapping.joint_unit?),
            false => ("position_unit", self.mapping.position_unit?),
        };
        let Unit::Is(own) = unit else { return None };
        (own != stated).then(|| {
            format!(
                "column {name} is in {own} by its name, and {key} {stated} is stated, which is for columns without a unit: leave {key} out; or, if the name is wrong, \
                 say of each column what it is instead, in the column mapping: {{\"{thing}_{stated}\": {name:?}}}"
            )
        })
    }

    /// Uses a column for a quantity (`q1`, `x`, …), or adds an issue if something about the column is unclear.
    pub fn offer(&mut self, place: usize, thing: &str, unit: Unit, units: [&str; 2]) {
        let name = self.table.name(place);
        let known_unit = match unit {
            Unit::Is(unit) => unit,
            _ => self.stated_unit(thing).unwrap_or(units[0]),
        };
        let other = self
            .columns
            .used
            .iter()
            .find(|used| meaning::thing(&used.means) == thing);
        if let Some(other) = other {
            if other.is_mapped {
                return;
            }
            let detail = match self.table.name(other.place) {
                same if same == name => format!(
                    "column {name} appears twice: say which by its number, counted from 1, in the column mapping: {{\"{thing}_{}\": {}}} (or {})",
                    known_unit,
                    other.place + 1,
                    place + 1
                ),
                other => format!(
                    "columns {other} and {name} may both be {thing}: say which in the column mapping: {{\"{thing}_{known_unit}\": \"COLUMN\"}}"
                ),
            };
            self.issue(Some(name), "duplicate_column", detail);
            return;
        }
        if let Some(detail) = self.contradiction(&name, thing, unit) {
            self.issue(Some(name), "two_readings", detail);
            self.taken.insert(place);
            return;
        }
        let unit = match unit {
            Unit::Missing => self.stated_unit(thing).map_or(unit, Unit::Is),
            // The name itself has two readings; the stated unit is one of them.
            Unit::TwoReadings if thing.starts_with('q') => {
                self.stated_unit(thing).map_or(unit, Unit::Is)
            }
            unit => unit,
        };
        let mapping = format!(
            "in the column mapping: {{\"{thing}_{0}\": {name:?}}}",
            units[0]
        );
        match unit {
            Unit::Is(unit) => self.take(place, format!("{thing}_{unit}")),
            Unit::Missing => {
                self.columns
                    .proposed
                    .push((format!("{thing}_{}", units[0]), place));
                let all = match thing.starts_with('q') {
                    true => {
                        "state the unit of all joints in the column mapping: {\"joint_unit\": \"deg\"} (or \"rad\")"
                    }
                    false => {
                        "state the unit of all positions in the column mapping: {\"position_unit\": \"mm\"} (or \"m\" …)"
                    }
                };
                let detail = format!(
                    "column {name} has no unit; name it {thing}_{} or {thing}_{}, or {all}",
                    units[0], units[1]
                );
                self.issue(Some(name), "missing_unit", detail);
            }
            Unit::TwoReadings => {
                self.columns
                    .proposed
                    .push((format!("{thing}_{}", units[0]), place));
                let is_told_twice = self.names()[place].1.is_some();
                let detail = match thing.starts_with('q') {
                    true if is_told_twice => format!(
                        "column {name} has one unit in its name, and another in the row of units below it: correct the file; or, if you know which is right, say it of \
                         all joints in the column mapping: {{\"joint_unit\": \"deg\"}} (or \"rad\")"
                    ),
                    true => format!(
                        "the unit of column {name} may be degrees (German: Grad) or gons (400 in a turn): say it {mapping} \
                         (for gons: {thing}_gon), or of all joints in the column mapping: {{\"joint_unit\": \"deg\"}} (or \"gon\")"
                    ),
                    false => format!(
                        "column {name} has one unit in its name, and another in the row of units below it: correct the file; or, if you know which is right, say it \
                         {mapping} (for metres: {thing}_m)"
                    ),
                };
                self.issue(Some(name), "two_readings", detail);
            }
        }
        self.taken.insert(place);
    }
}
