//! Finds the meaning of each column of a table: first from the caller's mapping, then from the name of the column.

use crate::measurement::columns::column::{Column, missing_columns, mixed_units};
pub use crate::measurement::columns::mapping::Needs;
use crate::measurement::columns::mapping::{HeaderRow, Mapping};
use crate::measurement::columns::meaning::{column, key, key_name, thing};
use crate::measurement::columns::names::{
    Key, Known, PLAIN, TimeUnit, Unit, named_axes, recognise,
};
use crate::measurement::columns::pose_names::rotation_columns;
use crate::measurement::issue::{Issue, MAX_ISSUES};
use crate::measurement::table::Table;
use crate::measurement::table::groups::{without_groups_not_measured, without_rotations};
use crate::measurement::table::halves::missing_half;
use crate::measurement::table::lines::is_numeric;
use crate::measurement::table::other_layouts::other_layout;
use crate::measurement::table::plain::{is_of_target, named_plain};
use crate::measurement::table::resolution::Resolution;
pub use crate::measurement::table::resolution::{Columns, Used};
use crate::measurement::table::second_readings::ask_for_second_readings;
use std::collections::BTreeSet;

/// Resolves the meanings of the columns of a table. `issues` of the result is empty if the table can be read.
pub fn resolve(table: &Table, mapping: &Mapping, n_joints: usize, needs: Needs) -> Columns {
    let mut resolution = Resolution {
        table,
        mapping,
        n_joints,
        needs,
        columns: Columns::default(),
        taken: BTreeSet::new(),
    };
    resolution.mapped(mapping);
    if !mapping.is_complete {
        resolution.named();
    }
    resolution.check();
    let mut columns = resolution.columns;
    columns.used.sort_by_key(|used| used.place);
    columns.issues.truncate(MAX_ISSUES);
    columns
}

/// Sets the unit of the time to seconds if the joint values are those of Universal Robots' RTDE interface: its `timestamp` is defined in
/// seconds.
fn with_time_of_rtde(table: &Table, mut known: Vec<(usize, Known)>) -> Vec<(usize, Known)> {
    let mut names = table.header.iter().map(|name| name.trim());
    if names.any(|name| name.eq_ignore_ascii_case("actual_q_0")) {
        for (_, known) in &mut known {
            if *known == Known::Key(Key::Time(TimeUnit::Unstated)) {
                *known = Known::Key(Key::Time(TimeUnit::Seconds));
            }
        }
    }
    known
}

/// Where the file states the frames per second, the number of the frame is the time.
fn with_time_of_frames(table: &Table, mut known: Vec<(usize, Known)>) -> Vec<(usize, Known)> {
    let has_time = known
        .iter()
        .any(|(_, known)| matches!(known, Known::Key(Key::Time(_))));
    if let Some(rate) = table.frame_rate.filter(|_| !has_time) {
        for (place, known) in &mut known {
            if table.name(*place).eq_ignore_ascii_case("frame") {
                *known = Known::Key(Key::Time(rate));
            }
        }
    }
    known
}

impl Resolution<'_> {
    /// Advice for a file without a header of which no column is known.
    fn no_header(&self) -> String {
        let others = self.numbered_columns();
        let other = match self.needs {
            Needs::Joints => "instrument",
            Needs::Positions => "robot",
            Needs::Points => "",
        };
        let is_stated = self.mapping.header_row == Some(HeaderRow::None) && !other.is_empty();
        match is_stated {
            true => format!(
                "the column mapping states that no line of the file names its columns. If only the {other}'s file is meant, state it for that file alone, \
                 in the column mapping: {{\"{other}\": {{\"header_row\": false}}}}"
            ),
            false => format!(
                "no line of the file names its columns: put a header row on top, or say which column is which by its number, counted \
                 from 1, in the column mapping: {others}"
            ),
        }
    }

    /// A mapping by numbers, for an example: the first columns with numbers, and a column of names that are all different.
    fn numbered_columns(&self) -> String {
        const SAMPLE: usize = 20;
        let rows = self.table.first_rows(SAMPLE, 5 * SAMPLE);
        let column = |place: usize| {
            rows.iter()
                .map(move |row| row.get(place).map_or("", String::as_str))
        };
        let width = rows.iter().map(Vec::len).max().unwrap_or(0);
        let is_free = |place: &usize| !self.taken.contains(place);
        let (numbers, texts): (Vec<usize>, Vec<usize>) = (0..width)
            .filter(is_free)
            .partition(|place| column(*place).all(is_numeric));
        let is_name = |place: &&usize| {
            let names: BTreeSet<&str> = column(**place).collect();
            names.len() == rows.len() && !names.contains("")
        };
        let joints = (1..=self.n_joints).map(|joint| format!("q{joint}_deg"));
        let axes = ["x_mm", "y_mm", "z_mm"].map(str::to_owned);
        let (wanted, part): (Vec<String>, _) = match self.needs {
            Needs::Joints => (joints.collect(), "robot"),
            Needs::Positions => (axes.to_vec(), "instrument"),
            Needs::Points => (joints.chain(axes).collect(), ""),
        };
        let wanted: Vec<&String> = wanted
            .iter()
            .filter(|means| !self.has(thing(means)))
            .collect();
        // With fewer numbers than needed the first columns stand for them.
        let places = match numbers.len() >= wanted.len() {
            true => numbers,
            false => (0..wanted.len()).collect(),
        };
        let said = wanted.iter().zip(places);
        let mut said: Vec<String> = said
            .map(|(means, place)| format!("{means:?}: {}", place + 1))
            .collect();
        if let Some(name) = texts.iter().find(is_name).filter(|_| !part.is_empty()) {
            said.push(format!("{part:?}: {{\"name\": {}}}", name + 1));
        }
        format!("{{{}}}", said.join(", "))
    }

    fn mapped(&mut self, mapping: &Mapping) {
        for (means, reference) in &mapping.columns {
            let is_known = column(means, self.n_joints).is_some() || key(means).is_some();
            if !is_known {
                let detail = format!(
                    "the mapping has {means:?}, which is no meaning of a column of this robot: q1_deg … q{}_deg (or _rad _gon), x_mm y_mm z_mm (or \
                     _m _cm _um _in), {}, name, number, time_s",
                    self.n_joints,
                    PLAIN.join(", ")
                );
                self.issue(Some(means.clone()), "unknown_meaning", detail);
                continue;
            }
            let place = match self.table.place(reference) {
                Ok(place) => place,
                Err(detail) => {
                    let detail = format!("the mapping of {means}: {detail}");
                    self.issue(Some(means.clone()), "unknown_column", detail);
                    continue;
                }
            };
            if self.has(thing(means)) || !self.taken.insert(place) {
                let detail = format!("the mapping names {means} or its column twice");
                self.issue(Some(means.clone()), "duplicate_column", detail);
                continue;
            }
            self.columns.used.push(Used {
                place,
                means: means.clone(),
                is_mapped: true,
            });
        }
        for reference in &mapping.ignore {
            // A column to ignore need not exist.
            if let Ok(place) = self.table.place(reference) {
                self.taken.insert(place);
            }
        }
    }

    /// Finds the meanings of the columns that are not in the mapping, from their names.
    fn named(&mut self) {
        let known: Vec<(usize, Known)> = self
            .names()
            .into_iter()
            .enumerate()
            .filter(|(place, _)| !self.taken.contains(place))
            .map(|(place, (name, below))| (place, recognise(name, below)))
            .collect();
        let known = with_time_of_rtde(self.table, known);
        let known = with_time_of_frames(self.table, known);
        let known = without_rotations(self.table, known);
        let known = without_groups_not_measured(self.table, known);
        if self.needs_joints() {
            self.named_joints(&known);
        }
        if self.needs_positions() {
            self.named_positions(&known);
        }
        named_plain(self, &known);
        let has_name = known
            .iter()
            .any(|(_, known)| *known == Known::Key(Key::Name));
        for (place, known) in &known {
            // In the file of an instrument, a column "Target" contains the names of points.
            let is_target = matches!(known, Known::Plain(means) if is_of_target(means));
            if self.needs == Needs::Positions
                && is_target
                && !self.taken.contains(place)
                && !has_name
                && !self.has("name")
            {
                self.take(*place, key_name(Key::Name));
            }
            if let Known::Key(key) = known {
                let means = key_name(*key);
                let is_wanted = key.is_label() || self.needs_positions();
                if is_wanted && !self.has(thing(&means)) && !self.taken.contains(place) {
                    self.take(*place, means);
                }
            }
        }
        if self.columns.issues.is_empty() {
            ask_for_second_readings(self, &known);
        }
    }

    fn named_joints(&mut self, known: &[(usize, Known)]) {
        let mut joints: Vec<(usize, usize, Unit)> = known
            .iter()
            .filter_map(|(place, known)| match known {
                Known::Joint(number, unit) => Some((*place, *number, *unit)),
                _ => None,
            })
            .collect();
        if (1..=self.n_joints).all(|joint| self.has(&format!("q{joint}"))) {
            return;
        }
        if joints.is_empty() {
            joints = named_axes(&self.names(), &self.taken, self.n_joints);
        }
        let numbers: BTreeSet<usize> = joints.iter().map(|(_, number, _)| *number).collect();
        // Joints are counted from 0 only if their numbers are exactly 0 to n − 1.
        if numbers.iter().copied().eq(0..self.n_joints) {
            joints.iter_mut().for_each(|(_, number, _)| *number += 1);
        }
        for (place, number, unit) in joints {
            let name = self.table.name(place);
            if number == 0 || number > self.n_joints {
                let detail = format!(
                    "column {name} is for joint {number}, but the robot has {} joints; if it is none of them, leave it aside \
                     in the column mapping: {{\"ignore\": [{name:?}]}}",
                    self.n_joints
                );
                self.issue(Some(name), "wrong_joint_count", detail);
                continue;
            }
            self.offer(place, &format!("q{number}"), unit, ["deg", "rad"]);
        }
    }

    fn named_positions(&mut self, known: &[(usize, Known)]) {
        if ["x", "y", "z"].iter().all(|axis| self.has(axis)) {
            return;
        }
        let pose = self.controllers_pose();
        for (place, known) in known {
            match known {
                Known::Position(axis, _) if pose.is_some() => {
                    let name = self.table.name(*place);
                    let axis = ["x", "y", "z"][*axis];
                    self.columns.proposed.push((format!("{axis}_mm"), *place));
                    let detail = format!(
                        "column {name} stands beside joint values and {}, as a controller writes the pose that it computes itself: if it was \
                         measured all the same, say so in the column mapping: {{\"{axis}_mm\": {name:?}}}",
                        pose.as_deref().unwrap_or_default()
                    );
                    self.issue(Some(name), "two_readings", detail);
                }
                Known::Position(axis, unit) => {
                    self.offer(*place, ["x", "y", "z"][*axis], *unit, ["mm", "m"]);
                }
                _ => {}
            }
        }
    }

    /// The columns of a rotation next to X, Y, Z, as controllers write them for a pose that they compute. Only for files that need joint
    /// values and positions, and only if the mapping does not state that the rotation was measured.
    fn controllers_pose(&self) -> Option<String> {
        let places = rotation_columns(&self.table.header)?;
        let is_mapped = |place: &usize| self.columns.used.iter().any(|used| used.place == *place);
        let is_computed = self.needs == Needs::Points && !places.iter().any(is_mapped);
        let names = places.map(|place| self.table.name(place));
        is_computed.then(|| names.join(", "))
    }

    /// Adds issues for missing columns and mixed units.
    fn check(&mut self) {
        let mut missing = Vec::new();
        if self.needs_joints() {
            let joints = (1..=self.n_joints).map(|joint| format!("q{joint}"));
            missing.extend(
                joints
                    .filter(|joint| !self.has(joint))
                    .map(|joint| format!("{joint}_deg")),
            );
        }
        if self.needs_positions() {
            let axes = ["x", "y", "z"].into_iter().filter(|axis| !self.has(axis));
            missing.extend(axes.map(|axis| format!("{axis}_mm")));
        }
        self.columns.missing = missing;
        if let Some(issue) = other_layout(self).or_else(|| missing_half(self)) {
            self.columns.issues = vec![issue];
        }
        if !self.columns.issues.is_empty() {
            return;
        }
        let columns: Vec<Column> = self
            .columns
            .used
            .iter()
            .filter_map(|used| column(&used.means, self.n_joints))
            .collect();
        let all = self.table.names();
        let is_about = |issue: &Issue| {
            let thing = issue.column.as_deref().map(thing);
            match (self.needs, thing) {
                (Needs::Points, _) | (_, None) => true,
                (Needs::Joints, Some(thing)) => thing.starts_with('q'),
                (Needs::Positions, Some(thing)) => !thing.starts_with('q'),
            }
        };
        let found: Vec<Issue> = missing_columns(&columns, self.n_joints)
            .into_iter()
            .filter(is_about)
            .collect();
        let has_none = !self
            .columns
            .used
            .iter()
            .any(|used| key(&used.means).is_none());
        let no_header = self.table.header_line.is_none();
        self.columns.issues = found
            .into_iter()
            .map(|mut issue| {
                if issue.code == "missing_column" || issue.code == "wrong_joint_count" {
                    issue.detail = match (no_header, &issue.column) {
                        (true, Some(means)) => format!("{}; no line of the file names its columns: say which it is by its number, in the column mapping: {{\"{means}\": 1}}", issue.detail),
                        (false, Some(means)) => format!("{}; if another column is it, say so in the column mapping: {{\"{means}\": \"COLUMN\"}}. The table has {all}", issue.detail),
                        _ => issue.detail,
                    };
                }
                issue
            })
            .collect();
        if has_none && no_header && !self.columns.issues.is_empty() {
            self.columns.issues = vec![Issue::new("no_header", self.no_header())];
        }
        if self.columns.issues.is_empty() {
            let names: Vec<String> = (self.columns.used.iter())
                .filter(|used| column(&used.means, self.n_joints).is_some())
                .map(|used| self.table.name(used.place))
                .collect();
            let named = columns.into_iter().zip(names.iter().map(String::as_str));
            self.columns.issues = mixed_units(named).into_iter().collect();
        }
    }
}
