//! Finds unused columns that may show which rows are valid, because rows that somebody rejected must not be read as measurements.

use crate::measurement::columns::words::is_one_of;
use crate::measurement::issue::Issue;
use crate::measurement::table::{Table, TableRow};
use std::collections::BTreeMap;

/// Words in the name of a column that shows which rows are valid.
const NAMES: &str = "deleted|delete|del|excluded|exclude|ignore|ignored|skip|skipped|omit|omitted|discard|\
    discarded|reject|rejected|removed|use|used|valid|invalid|ok|bad|good|status|state|quality|\
    flag|outlier|active|include|included|accepted|gültig|ungültig|gelöscht|verwendet|\
    ausreißer|aktiv";
/// Words in the name of a column that shows which rows are valid only if all its cells are judgements, because a `Test` may have a name or
/// a number too.
const RESULT_NAMES: &str = "result|results|test|tested|check|checked|measured|gemessen|ergebnis|bewertung|prüfung|\
    verdict|judgement|judgment|pass|passed|fail|failed|usable|reliable|trusted|confirmed|approved|\
    enabled";
/// Cells that are judgements of a row.
const JUDGEMENTS: &str = "|yes|no|y|n|ja|nein|j|oui|non|si|sì|true|false|t|f|1|0|pass|passed|fail|failed|ok|nok|good|bad|\
    valid|invalid|io|nio|i.o.|n.i.o.|in|out|on|off";
/// Words in the name of a column with the weight of each row.
const WEIGHTS: &str = "weight|weights|weighting|gewicht|gewichtung|poids|peso";
/// Words beside them that show that the column has masses.
const MASSES: &str = "kg|g|lb|lbs|n|payload|load|last|tool|part";
/// Words that show that a column does not count anything: "Status number", "Points used".
const STATES: &str = "status|state|flag|quality|use|used|verwendet";
/// Words that show that a column counts something: "Valid samples".
const COUNT_WORDS: &str =
    "samples|points|shots|readings|measurements|observations|count|number|n|anzahl";
/// Maximum number of words in such a name.
const MAX_WORDS: usize = 3;
/// Cells that reject their row, in any column.
const REJECTION_WORDS: &str = "deleted|invalid|nok|not ok|n.ok|bad|outlier|rejected|reject|excluded|exclude|discard|\
    discarded|skip|ignore|ungültig|gelöscht|ausreißer|verworfen|n.i.o.|nio|invalide";
/// Cells that reject their row only if other rows have other texts, because all points may fail a test of nominal positions.
const FAILURES: &str = "fail|failed|failure|not good|ng|n.g.|calculated|interpolated|predicted|simulated|not measured|\
    nicht gemessen|gesperrt";
/// Parts of remarks that reject a row.
const PHRASES: [&str; 18] = [
    "do not use",
    "don't use",
    "not to be used",
    "not used",
    "not usable",
    "not valid",
    "beam broken",
    "beam break",
    "beam lost",
    "broken beam",
    "nicht verwenden",
    "nicht benutzen",
    "nicht verwendet",
    "strahl unterbrochen",
    "strahlunterbrechung",
    "to be deleted",
    "please ignore",
    "ignore this",
];
/// Maximum length of a remark that is read, bytes.
const MAX_REMARK: usize = 200;
/// Cells that mark a row, in a column without other texts.
const MARKS: [&str; 6] = ["x", "*", "!", "+", "✓", "✗"];
/// Maximum number of different values in a column that shows which rows are valid. With more values it is a measurement, such as a quality
/// in percent.
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
    /// Whether the name is one of [`RESULT_NAMES`]; it counts only if all cells are judgements.
    is_result: bool,
    /// Whether the column has weights.
    is_weight: bool,
    /// The first row with weight zero, and whether another row has a larger weight.
    no_weight: Option<Marked>,
    has_weight: bool,
    /// The first cell with a failure, and whether another cell has some other text.
    failed: Option<Marked>,
    has_others: bool,
    /// Whether the name shows that the column counts something.
    is_counted: bool,
    /// Each value in lower case, with its number of rows and the first of them. At most [`MAX_VALUES`] + 1 values are kept.
    values: BTreeMap<String, (usize, Marked)>,
    /// The first cell that rejects its row.
    put_aside: Option<Marked>,
}

/// A cell that may reject its row.
#[derive(Clone)]
struct Marked {
    row: usize,
    cell: String,
}

impl Flags {
    /// The columns of a table that are neither read nor ignored by the mapping. In a robot's log, names of columns are not used, because
    /// the robot has states of its own.
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
                is_result: !is_log && words.len() <= MAX_WORDS && has(RESULT_NAMES),
                is_weight: has(WEIGHTS) && !has(MASSES),
                no_weight: None,
                has_weight: false,
                failed: None,
                has_others: false,
                is_counted: has(COUNT_WORDS) && !has(STATES),
                values: BTreeMap::new(),
                put_aside: None,
            }
        };
        Self {
            columns: free.map(flag).collect(),
        }
    }

    /// Adds the next row.
    pub fn take(&mut self, index: usize, row: &TableRow) {
        for flag in &mut self.columns {
            let cell = row.cells.get(flag.place).unwrap_or("").trim();
            let is_full = flag.values.len() > MAX_VALUES;
            let marked = || Marked {
                row: index,
                cell: cell.to_owned(),
            };
            if flag.is_weight && !cell.is_empty() {
                match cell.replace(',', ".").parse::<f64>() {
                    Ok(0.0) => _ = flag.no_weight.get_or_insert_with(marked),
                    _ => flag.has_weight = true,
                }
            }
            if cell.len() > MAX_REMARK || is_full && is_number(cell) {
                continue;
            }
            let value = cell.to_lowercase();
            let has_phrase = || value.contains(' ') && PHRASES.iter().any(|p| value.contains(p));
            if flag.put_aside.is_none() && (is_one_of(REJECTION_WORDS, &value) || has_phrase()) {
                flag.put_aside = Some(marked());
            }
            match is_one_of(FAILURES, &value) {
                true => _ = flag.failed.get_or_insert_with(marked),
                false => flag.has_others |= !cell.is_empty(),
            }
            if cell.len() > MAX_LENGTH {
                continue;
            }
            if !is_full {
                flag.values.entry(value).or_insert_with(|| (0, marked())).0 += 1;
            }
        }
    }

    /// Refuses rows that may have been rejected.
    pub fn refused(&self, table: &Table) -> Vec<Issue> {
        let columns = self.columns.iter();
        columns
            .filter_map(|flag| Some(issue(table, flag, flag.marked()?)))
            .collect()
    }
}

/// Whether a cell is a number and not a remark.
fn is_number(cell: &str) -> bool {
    cell.starts_with(|c: char| c.is_ascii_digit() || c == '-')
}

fn issue(table: &Table, flag: &Flag, marked: &Marked) -> Issue {
    let Marked { row, cell } = marked;
    let name = table.name(flag.place);
    let reference = table.reference(flag.place);
    let detail = format!(
        "row {row} has {cell:?} in column {name}, and others have not: if it says that such rows do not count, remove them, or put # before them; if all rows are \
         measurements, leave the column aside in the column mapping: {{\"ignore\": [{reference}]}}"
    );
    Issue::new("two_readings", detail)
        .in_row(*row)
        .in_column(name)
}

impl Flag {
    /// The first row that may have been rejected. If the column has a few different values, the rarest value marks the rejected rows.
    fn marked(&self) -> Option<&Marked> {
        if self.put_aside.is_some() {
            return self.put_aside.as_ref();
        }
        let failed = self.failed.as_ref().filter(|_| self.has_others);
        let no_weight = self.no_weight.as_ref().filter(|_| self.has_weight);
        if let Some(marked) = failed.or(no_weight) {
            return Some(marked);
        }
        let is_mark = |value: &String| value.is_empty() || MARKS.contains(&value.as_str());
        let are_judgements = || {
            let mut values = self.values.keys();
            values.all(|value| is_one_of(JUDGEMENTS, value))
        };
        let is_named = self.is_named || self.is_result && are_judgements();
        let is_measured = |value: &String| value.contains(['.', ',']);
        // A count of zero samples may mark a rejected row.
        let is_count = |value: &String| value.parse::<u32>().is_ok_and(|number| number > 0);
        let values = || self.values.keys();
        let are_counts = self.is_counted && values().all(is_count);
        let are_few = (2..=MAX_VALUES).contains(&values().len()) && !values().any(is_measured);
        let are_marks = values().len() == 2 && values().all(is_mark);
        let all = self.values.values();
        let rarest = all.min_by_key(|(n, first)| (*n, std::cmp::Reverse(first.row)));
        rarest
            .filter(|_| are_few && is_named && !are_counts || are_marks)
            .map(|(_, first)| first)
    }
}
