//! Columns that are not read and may say which rows count: rows that somebody put aside must not be taken as measurements.

use crate::measurement::columns::words::is_one_of;
use crate::measurement::issue::Issue;
use crate::measurement::table::{Table, TableRow};
use std::collections::BTreeMap;

/// Words in the name of a column that says which rows count.
const NAMES: &str = "deleted|delete|del|excluded|exclude|ignore|ignored|skip|skipped|omit|omitted|discard|\
    discarded|reject|rejected|removed|use|used|valid|invalid|ok|bad|good|status|state|quality|\
    flag|outlier|active|include|included|accepted|gültig|ungültig|gelöscht|verwendet|\
    ausreißer|aktiv";
/// Words in the name of a column that never counts: "Status number", "Points used".
const STATES: &str = "status|state|flag|quality|use|used|verwendet";
/// Words beside the names in that of a column that counts: "Valid samples".
const COUNT_WORDS: &str =
    "samples|points|shots|readings|measurements|observations|count|number|n|anzahl";
/// Maximum number of words of such a name.
const MAX_WORDS: usize = 3;
/// Cells that say in any column that a row does not count.
const REJECTION_WORDS: &str = "deleted|invalid|nok|not ok|n.ok|bad|outlier|rejected|reject|excluded|exclude|discard|\
    discarded|skip|ignore|ungültig|gelöscht|ausreißer|verworfen|n.i.o.|nio|invalide";
/// Cells that mark a row, in a column without other texts.
const MARKS: [&str; 6] = ["x", "*", "!", "+", "✓", "✗"];
/// Maximum number of different values of a column that says which rows count. More are measurements, such as a quality in percent.
const MAX_VALUES: usize = 4;
/// Maximum length of such a value, bytes.
const MAX_LENGTH: usize = 20;

/// Columns that are not read, with their values.
#[derive(Default)]
pub struct Flags {
    columns: Vec<Flag>,
}

struct Flag {
    place: usize,
    is_named: bool,
    /// Whether the name says that the column counts.
    is_counted: bool,
    /// Each value in small letters, with its number of rows and the first of them. One more than [`MAX_VALUES`] if there are more.
    values: BTreeMap<String, (usize, Marked)>,
    /// The first cell that says that its row does not count.
    put_aside: Option<Marked>,
}

/// A cell that may say that its row does not count.
#[derive(Clone)]
struct Marked {
    row: usize,
    line: usize,
    cell: String,
}

impl Flags {
    /// The columns of a table that are neither read nor left aside by the caller. Of the log of a robot, which has states of its own, names say nothing.
    pub fn new(table: &Table, is_log: bool, is_free: impl Fn(&usize) -> bool) -> Self {
        let free = (0..table.header.len()).filter(is_free);
        let flag = |place: usize| {
            let name = table.header[place].to_lowercase();
            let words = name.split(|c: char| !c.is_alphanumeric());
            let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
            let has = |list| words.iter().any(|word| is_one_of(list, word));
            let is_named = !is_log && words.len() <= MAX_WORDS && has(NAMES);
            Flag {
                place,
                is_named,
                is_counted: has(COUNT_WORDS) && !has(STATES),
                values: BTreeMap::new(),
                put_aside: None,
            }
        };
        Self {
            columns: free.map(flag).collect(),
        }
    }

    /// Takes the next row.
    pub fn take(&mut self, index: usize, row: &TableRow) {
        for flag in &mut self.columns {
            let cell = row.cells.get(flag.place).unwrap_or("").trim();
            let is_full = flag.values.len() > MAX_VALUES;
            if cell.len() > MAX_LENGTH || is_full && flag.put_aside.is_some() {
                continue;
            }
            let marked = || Marked {
                row: index,
                line: row.line,
                cell: cell.to_owned(),
            };
            let value = cell.to_lowercase();
            if flag.put_aside.is_none() && is_one_of(REJECTION_WORDS, &value) {
                flag.put_aside = Some(marked());
            }
            if !is_full {
                flag.values.entry(value).or_insert_with(|| (0, marked())).0 += 1;
            }
        }
    }

    /// Refuses rows that may have been put aside. Each issue has its line.
    pub fn refused(&self, table: &Table) -> Vec<(Issue, Option<usize>)> {
        let columns = self.columns.iter();
        columns
            .filter_map(|flag| Some(issue(table, flag, flag.marked()?)))
            .collect()
    }
}

fn issue(table: &Table, flag: &Flag, marked: &Marked) -> (Issue, Option<usize>) {
    let Marked { row, line, cell } = marked;
    let name = table.name(flag.place);
    let reference = table.reference(flag.place);
    let detail = format!(
        "row {row} has {cell:?} in column {name}, and others have not: if it says that such rows do not count, remove them, or put # before them; if all rows are \
         measurements, leave the column aside in the column mapping: {{\"ignore\": [{reference}]}}"
    );
    let issue = Issue::new("two_readings", detail)
        .in_row(*row)
        .in_column(name);
    (issue, Some(*line))
}

impl Flag {
    /// The first row that may have been put aside. Among a few values, those of the fewest rows say so.
    fn marked(&self) -> Option<&Marked> {
        if self.put_aside.is_some() {
            return self.put_aside.as_ref();
        }
        let is_mark = |value: &String| value.is_empty() || MARKS.contains(&value.as_str());
        let is_measured = |value: &String| value.contains(['.', ',']);
        // no sample at all is a flag
        let is_count = |value: &String| value.parse::<u32>().is_ok_and(|number| number > 0);
        let values = || self.values.keys();
        let are_counts = self.is_counted && values().all(is_count);
        let are_few = (2..=MAX_VALUES).contains(&values().len()) && !values().any(is_measured);
        let are_marks = values().len() == 2 && values().all(is_mark);
        let all = self.values.values();
        let rarest = all.min_by_key(|(n, first)| (*n, std::cmp::Reverse(first.row)));
        rarest
            .filter(|_| are_few && self.is_named && !are_counts || are_marks)
            .map(|(_, first)| first)
    }
}
