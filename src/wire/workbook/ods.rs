//! Reads the sheets of an ods workbook row by row. A row or cell may state that it repeats a million times; most empty rows and cells do so.

use super::refusal::{Archive, refused, unreadable};
use super::sheet::{SheetText, Sheets};
use super::xml::attribute;
use crate::measurement::csv::MAX_ROWS;
use crate::measurement::table::MAX_COLUMNS;
use crate::wire::Invalid;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::io::BufReader;
use std::ops::Range;

/// The row that is being read.
#[derive(Default)]
struct Row {
    cells: Vec<RepeatedCell>,
    column: usize,
    repeats: usize,
    is_hidden: bool,
}

/// Equal cells side by side. Their text is stored once: it may be long, and a file states the number of repeats.
struct RepeatedCell {
    columns: Range<usize>,
    text: String,
}

/// The cell that is being read.
struct Cell {
    repeats: usize,
    /// The value of a number or a date; none if the text of the cell is its value.
    value: Option<String>,
    text: String,
}

pub(super) fn sheets(archive: &mut Archive, wanted: Option<&str>) -> Result<Sheets, Invalid> {
    let content = archive
        .by_name("content.xml")
        .map_err(|e| unreadable(&e.to_string()))?;
    let mut reader = Reader::from_reader(BufReader::new(content));
    let (mut names, mut found) = (Vec::new(), Vec::new());
    let (mut buffer, mut sheet, mut row, mut cell) = (Vec::new(), None, Row::default(), None);
    let mut at_row = 0;
    let mut depth = 0;
    loop {
        buffer.clear();
        let event = reader
            .read_event_into(&mut buffer)
            .map_err(|e| unreadable(&e.to_string()))?;
        match &event {
            Event::Eof => break,
            Event::Start(start) | Event::Empty(start) => {
                let is_empty = matches!(event, Event::Empty(_));
                depth += usize::from(!is_empty);
                if depth > MAX_DEPTH {
                    return Err(unreadable("it is nested too deeply"));
                }
                match start.local_name().as_ref() {
                    "table" if !is_empty => {
                        let name = attribute(start, "table:name").unwrap_or_default();
                        names.push(name.clone());
                        let is_wanted = wanted.is_none_or(|wanted| name == wanted);
                        sheet = is_wanted.then(|| (name, SheetText::default()));
                        at_row = 0;
                    }
                    "table-row" => {
                        let visibility = attribute(start, "table:visibility");
                        row = Row {
                            repeats: repeat_count(start, "table:number-rows-repeated"),
                            is_hidden: visibility.is_some_and(|own| own != "visible"),
                            ..Row::default()
                        };
                        if is_empty {
                            at_row += row.repeats;
                        }
                    }
                    "table-cell" | "covered-table-cell" => {
                        let new = Cell::new(start);
                        if is_empty {
                            row.take(new)?;
                        } else {
                            cell = Some(new);
                        }
                    }
                    // A further paragraph, and the elements for spaces, tabs and line breaks, become one space.
                    "p" | "s" | "tab" | "line-break" => {
                        if let Some(cell) = cell.as_mut().filter(|cell| !cell.text.is_empty()) {
                            cell.text.push(' ');
                        }
                    }
                    _ => {}
                }
            }
            Event::Text(text) => {
                if let Some(cell) = &mut cell {
                    cell.text.push_str(text);
                }
            }
            Event::GeneralRef(reference) => {
                if let Some(cell) = &mut cell {
                    cell.text.push(character(reference)?);
                }
            }
            Event::End(end) => {
                depth = depth.saturating_sub(1);
                match end.local_name().as_ref() {
                    "table-cell" | "covered-table-cell" => {
                        if let Some(done) = cell.take() {
                            row.take(done)?;
                        }
                    }
                    "table-row" => {
                        let done = std::mem::take(&mut row);
                        if let Some((_, text)) = &mut sheet {
                            write(text, at_row, &done)?;
                        }
                        at_row += done.repeats;
                    }
                    "table" => {
                        let done = sheet.take();
                        found.extend(done.and_then(|(name, text)| text.finish(name)));
                        if found.len() > 1 {
                            break;
                        }
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }
    Ok(Sheets { names, found })
}

/// Maximum depth of nested elements. Documents have about ten levels.
const MAX_DEPTH: usize = 100;

fn write(text: &mut SheetText, at: usize, row: &Row) -> Result<(), Invalid> {
    if row.cells.is_empty() {
        return Ok(());
    }
    if row.repeats > MAX_ROWS {
        let detail = format!(
            "row {} repeats {} times; a set has at most {MAX_ROWS} rows",
            at + 1,
            row.repeats
        );
        return Err(refused("too_many_rows", detail));
    }
    for row_at in at..at + row.repeats {
        for cell in &row.cells {
            for column in cell.columns.clone() {
                text.cell(row_at, column, &cell.text, row.is_hidden)?;
            }
        }
    }
    Ok(())
}

impl Row {
    fn take(&mut self, cell: Cell) -> Result<(), Invalid> {
        let text = cell.value.unwrap_or(cell.text);
        if !text.is_empty() {
            if self.column + cell.repeats > MAX_COLUMNS {
                let detail = format!("a row has more than {MAX_COLUMNS} columns");
                return Err(refused("too_many_columns", detail));
            }
            let columns = self.column..self.column + cell.repeats;
            self.cells.push(RepeatedCell { columns, text });
        }
        self.column = self.column.saturating_add(cell.repeats);
        Ok(())
    }
}

impl Cell {
    fn new(start: &BytesStart) -> Self {
        let value = match attribute(start, "office:value-type").as_deref() {
            Some("float" | "percentage" | "currency") => attribute(start, "office:value"),
            Some("date") => attribute(start, "office:date-value"),
            _ => None,
        };
        Self {
            repeats: repeat_count(start, "table:number-columns-repeated"),
            value,
            text: String::new(),
        }
    }
}

fn repeat_count(start: &BytesStart, name: &str) -> usize {
    let stated = attribute(start, name).and_then(|text| text.parse().ok());
    stated.unwrap_or(1).min(4 * 1024 * 1024)
}

fn character(reference: &quick_xml::events::BytesRef) -> Result<char, Invalid> {
    let known = match &**reference {
        "amp" => Some('&'),
        "lt" => Some('<'),
        "gt" => Some('>'),
        "quot" => Some('"'),
        "apos" => Some('\''),
        _ => reference.resolve_char_ref().ok().flatten(),
    };
    known.ok_or_else(|| unreadable("it has an unknown entity"))
}
