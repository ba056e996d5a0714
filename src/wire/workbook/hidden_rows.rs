//! Finds rows that are hidden, by a filter or by hand, and rows that are struck through. It is unknown whether such rows count, so a sheet
//! with them is refused. Also finds formulas that were never computed.

use super::refusal::{Archive, refused};
use super::sheet::Sheet;
use super::xml::{attribute, each_element};
use crate::wire::Invalid;
use std::collections::BTreeSet;

/// Maximum number of rows that a refusal lists.
const MAX_LISTED: usize = 10;

/// Properties of rows and cells that the cell reader does not report.
#[derive(Default)]
pub(super) struct Marks {
    /// The hidden rows, counted from 0.
    pub hidden: BTreeSet<usize>,
    /// Rows with a cell that is struck through, counted from 0.
    pub struck: BTreeSet<usize>,
    /// Numeric formulas without a value, as cell references such as `B7`. Programs that do not compute formulas write them like this.
    pub formulas: BTreeSet<String>,
}

/// Refuses a sheet with hidden rows that have cells, and with rows that are struck through.
pub(super) fn refuse_marked_rows(sheet: &Sheet) -> Result<(), Invalid> {
    let name = &sheet.name;
    refuse_rows(&sheet.hidden_rows, "hidden_rows", |n, rows| {
        format!(
            "{n} rows of sheet {name:?} are hidden, by a filter or by hand: {rows}. Nothing tells whether they count: show all rows, or delete those that do not count"
        )
    })?;
    refuse_rows(&sheet.struck_rows, "struck_rows", |n, rows| {
        format!(
            "{n} rows of sheet {name:?} have cells that are struck through: {rows}. Nothing tells whether they count: delete these rows, or remove the strike"
        )
    })
}

fn refuse_rows(
    rows: &[usize],
    code: &'static str,
    in_words: impl Fn(usize, String) -> String,
) -> Result<(), Invalid> {
    let Some(first) = rows.first() else {
        return Ok(());
    };
    let listed = rows.iter().take(MAX_LISTED);
    let listed: Vec<String> = listed.map(|row| (row + 1).to_string()).collect();
    let more = if rows.len() > MAX_LISTED { " …" } else { "" };
    let mut error = refused(code, in_words(rows.len(), listed.join(", ") + more));
    error.issues[0].line = Some(first + 1);
    Err(error)
}

/// The marks of a sheet in an xlsx workbook. Calamine's cell reader does not report them.
pub(super) fn marks_of_xlsx(archive: &mut Archive, sheet: &str) -> Result<Marks, Invalid> {
    let mut workbook = "xl/workbook.xml".to_owned();
    each_element(archive, "_rels/.rels", |element| {
        let is_workbook =
            attribute(element, "Type").is_some_and(|t| t.ends_with("/officeDocument"));
        if let Some(target) = attribute(element, "Target").filter(|_| is_workbook) {
            workbook = target.trim_start_matches('/').to_owned();
        }
    })?;
    let (folder, name) = workbook.rsplit_once('/').unwrap_or(("", &workbook));
    let in_folder = |path: &str| match folder {
        "" => path.to_owned(),
        folder => format!("{folder}/{path}"),
    };
    let mut id = None;
    each_element(archive, &workbook, |element| {
        if element.local_name().as_ref() == "sheet"
            && attribute(element, "name").is_some_and(|name| name == sheet)
        {
            let mut attributes = element.attributes().flatten();
            let own = attributes.find(|own| own.key.local_name().as_ref() == "id");
            id = own.map(|own| own.value.into_owned());
        }
    })?;
    let (mut path, mut styles) = (None, None);
    each_element(
        archive,
        &in_folder(&format!("_rels/{name}.rels")),
        |element| {
            if attribute(element, "Id").is_some_and(|own| Some(own) == id) {
                path = attribute(element, "Target");
            } else if attribute(element, "Type").is_some_and(|t| t.ends_with("/styles")) {
                styles = attribute(element, "Target");
            }
        },
    )?;
    let from_root = |path: String| match path.strip_prefix('/') {
        Some(path) => path.to_owned(),
        None => in_folder(&path),
    };
    let struck_styles = match styles {
        Some(path) => struck_styles(archive, &from_root(path))?,
        None => BTreeSet::new(),
    };
    let path = from_root(path.unwrap_or_default());
    let (mut marks, mut next) = (Marks::default(), 0_usize);
    let mut cell = Cell::default();
    each_element(archive, &path, |element| {
        let name = element.local_name();
        match name.as_ref() {
            "row" => cell.end(&mut marks),
            "c" => {
                cell.end(&mut marks);
                let style = attribute(element, "s").and_then(|style| style.parse::<usize>().ok());
                cell = Cell {
                    place: attribute(element, "r").unwrap_or_default(),
                    is_text: attribute(element, "t").is_some_and(|kind| kind != "n"),
                    is_struck: style.is_some_and(|style| struck_styles.contains(&style)),
                    ..Cell::default()
                };
                return;
            }
            "f" => cell.is_formula = true,
            "v" | "is" if cell.is_struck => marks.struck.extend(next.checked_sub(1)),
            _ => {}
        }
        if name.as_ref() != "row" {
            return;
        }
        let number = attribute(element, "r").and_then(|number| number.parse::<usize>().ok());
        let row = number
            .and_then(|number| number.checked_sub(1))
            .unwrap_or(next);
        next = row.saturating_add(1);
        if attribute(element, "hidden").is_some_and(|is| matches!(is.as_str(), "1" | "true")) {
            marks.hidden.insert(row);
        }
    })?;
    cell.end(&mut marks);
    Ok(marks)
}

/// A place as spreadsheets write it, such as `B7`. Row and column are counted from 0.
pub(super) fn reference(row: usize, column: usize) -> String {
    let mut letters = String::new();
    let mut left = column + 1;
    while left > 0 {
        letters.insert(0, char::from(b'A' + ((left - 1) % 26) as u8));
        left = (left - 1) / 26;
    }
    format!("{letters}{}", row + 1)
}

/// The cell that is being read.
#[derive(Default)]
struct Cell {
    place: String,
    is_struck: bool,
    is_formula: bool,
    /// Whether the value is text; text may be empty.
    is_text: bool,
}

impl Cell {
    /// Called at the end of the cell's element.
    fn end(&mut self, marks: &mut Marks) {
        let cell = std::mem::take(self);
        if cell.is_formula && !cell.is_text {
            marks.formulas.insert(cell.place);
        }
    }
}

/// The styles of cells whose text is struck through, by their numbers.
fn struck_styles(archive: &mut Archive, path: &str) -> Result<BTreeSet<usize>, Invalid> {
    let (mut section, mut fonts, mut n_fonts) = (String::new(), BTreeSet::new(), 0);
    let (mut struck, mut n_styles) = (BTreeSet::new(), 0);
    each_element(archive, path, |element| {
        let name = element.local_name();
        match (section.as_str(), name.as_ref()) {
            (
                _,
                part @ ("fonts" | "fills" | "borders" | "cellStyleXfs" | "cellXfs" | "cellStyles"
                | "dxfs"),
            ) => {
                section = part.to_owned();
            }
            ("fonts", "font") => n_fonts += 1,
            ("fonts", "strike") => {
                let is_off = attribute(element, "val");
                if !is_off.is_some_and(|val| matches!(val.as_str(), "0" | "false")) {
                    fonts.insert(n_fonts);
                }
            }
            ("cellXfs", "xf") => {
                let font = attribute(element, "fontId").and_then(|font| font.parse::<usize>().ok());
                if font.is_some_and(|font| fonts.contains(&(font + 1))) {
                    struck.insert(n_styles);
                }
                n_styles += 1;
            }
            _ => {}
        }
    })?;
    Ok(struck)
}
