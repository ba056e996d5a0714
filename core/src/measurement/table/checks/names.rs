//! Finds names of points that mark invalid rows, and names that show two tables side by side.

use crate::measurement::columns::names::{Key, Known, recognise};
use crate::measurement::columns::words::is_one_of;
use crate::measurement::issue::Issue;
use crate::measurement::table::{Table, TableRow};
use std::collections::BTreeSet;

/// Words in the name of an invalid point: `BAD_P3`, `P3 (bad)`.
const NOT_COUNTED: &str = "bad|nok|invalid|outlier|deleted|rejected|reject|excluded|exclude|discard|discarded|skip|skipped|ignore|fail|failed|\
    ungültig|ausreißer|verworfen|schlecht|gelöscht";
/// Number of rows that a refusal lists.
const MAX_LISTED: usize = 10;

/// The columns with names of points.
#[derive(Default)]
pub struct Names {
    /// Their places: one before the joint values, the other between joint values and positions. `None` if there is only one table.
    pair: Option<[usize; 2]>,
    /// Whether the pair has numbers of points instead of names.
    are_numbers: bool,
    /// Rows with two different names.
    differ: Vec<(usize, [String; 2])>,
    /// The normalised names in each column of the pair, and the number of rows.
    seen: [BTreeSet<String>; 2],
    n_rows: usize,
    /// The column with the names of the points.
    own: Option<usize>,
    /// Rows whose name marks them as invalid.
    not_counted: Vec<(usize, String)>,
    n_named: usize,
}

/// A name in lower case, without punctuation, spaces and leading zeros.
fn plain(name: &str) -> String {
    let lower = name.to_lowercase();
    let mut found = String::new();
    for c in lower.chars().filter(|c| c.is_alphanumeric()) {
        if c != '0' || found.ends_with(|before: char| before.is_ascii_digit()) {
            found.push(c);
        }
    }
    found
}

impl Names {
    /// `own` is the column with the names of the points; `joints` and `positions` are the columns that are read.
    pub fn new(
        table: &Table,
        own: Option<usize>,
        joints: &[usize],
        positions: &[usize],
        is_free: impl Fn(usize) -> bool,
    ) -> Self {
        let pair = pair(table, joints, positions, is_free);
        let pair = pair.filter(|_| !joints.is_empty() && !positions.is_empty());
        Self {
            are_numbers: pair.is_some_and(|[first, _]| is_number(table, first)),
            pair,
            own,
            ..Self::default()
        }
    }

    /// Adds the next row.
    pub fn take(&mut self, index: usize, row: &TableRow) {
        let cell = |place: usize| row.cells.get(place).unwrap_or("").trim();
        if let Some(text) = self.own.map(cell).filter(|text| !text.is_empty()) {
            self.n_named += 1;
            let lower = text.to_lowercase();
            let mut words = lower.split(|c: char| !c.is_alphanumeric());
            if words.any(|word| is_one_of(NOT_COUNTED, word)) {
                self.not_counted.push((index, text.to_owned()));
            }
        }
        let Some(pair) = self.pair else { return };
        let pair = pair.map(cell);
        let [first, second] = pair.map(plain);
        self.n_rows += 1;
        if first != second && !first.is_empty() && !second.is_empty() {
            let texts = pair.map(str::to_owned);
            self.differ.push((index, texts));
        }
        let [seen, others] = &mut self.seen;
        seen.insert(first);
        others.insert(second);
    }

    /// Refuses names that mark some rows as invalid, and rows of two tables that do not belong together.
    pub fn refused(&self, table: &Table) -> Vec<Issue> {
        let counted = self.not_counted();
        let beside = self.beside(table);
        counted.into_iter().chain(beside).collect()
    }

    fn not_counted(&self) -> Option<Issue> {
        let (first, _) = self.not_counted.first()?;
        // If most names contain such a word, it has another meaning.
        if 2 * self.not_counted.len() >= self.n_named {
            return None;
        }
        let listed = self.not_counted.iter().take(MAX_LISTED);
        let listed: Vec<String> = listed
            .map(|(row, text)| format!("{row} {text:?}"))
            .collect();
        let detail = format!(
            "rows have names of points that do not count: {}: remove these rows, or put # before them; if they are measurements, name these points otherwise",
            listed.join(", ")
        );
        Some(Issue::new("two_readings", detail).in_row(*first))
    }

    fn beside(&self, table: &Table) -> Option<Issue> {
        let [first, second] = self.pair?;
        let (row, [a, b]) = self.differ.first()?;
        let [names, others] = &self.seen;
        let n_shared = names.intersection(others).count();
        // Numbers that do not identify the points, such as those of poses, repeat.
        let are_unlike = self.are_numbers && names.len().min(others.len()) < self.n_rows - 1;
        if 2 * n_shared < names.len().max(others.len()) || are_unlike {
            return None;
        }
        let rows = self.differ.iter().take(MAX_LISTED);
        let rows: Vec<String> = rows.map(|(row, ..)| row.to_string()).collect();
        let more = if self.differ.len() > MAX_LISTED {
            " …"
        } else {
            ""
        };
        let (name, other) = (table.name(first), table.name(second));
        let detail = format!(
            "row {row} is {a:?} in column {name} and {b:?} in column {other}: two tables stand side by side, and their rows do not belong together (rows {}{more}). Write each \
             into a file or sheet of its own, with its names, and give both files; or sort them alike. If column {other} is no name of the row, leave it aside \
             in the column mapping: {{\"ignore\": [{}]}}",
            rows.join(", "),
            table.reference(second)
        );
        let issue = Issue::new("two_readings", detail).in_row(*row);
        Some(issue.in_column(other))
    }
}

fn is_number(table: &Table, place: usize) -> bool {
    recognise(&table.header[place], None) == Known::Key(Key::Number)
}

/// Two columns of names, or of numbers: one before the first block of values, the other before the second.
fn pair(
    table: &Table,
    joints: &[usize],
    positions: &[usize],
    is_free: impl Fn(usize) -> bool,
) -> Option<[usize; 2]> {
    let begin = |places: &[usize]| places.iter().copied().min();
    let end = |places: &[usize]| places.iter().copied().max();
    let (first, second) = match begin(joints)? < begin(positions)? {
        true => (joints, positions),
        false => (positions, joints),
    };
    let (first_begin, gap) = (begin(first)?, end(first)?..begin(second)?);
    let known = |place: usize| match recognise(&table.header[place], None) {
        Known::Key(key) if is_free(place) => Some(key),
        _ => None,
    };
    let names = |key, range: std::ops::Range<usize>| {
        let mut places = range.filter(|place| known(*place) == Some(key));
        places.next()
    };
    [Key::Name, Key::Number].into_iter().find_map(|key| {
        let other = names(key, gap.clone())?;
        Some([names(key, 0..first_begin)?, other])
    })
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn names_are_compared_without_signs_and_zeros() {
        assert_eq!(plain("P_01"), "p1");
        assert_eq!(plain("p 1"), "p1");
        assert_eq!(plain("P10"), "p10");
        assert_eq!(plain("100"), "100");
        assert_ne!(plain("P2"), plain("P1"));
    }
}
