//! Reads the sheets of an xlsx workbook cell by cell. A dense table would not fit into memory if a sheet has cells far apart.

use super::hidden_rows;
use super::refusal::{Archive, unreadable};
use super::sheet::{Sheet, SheetText, Sheets};
use crate::wire::Invalid;
use calamine::{DataRef, ExcelDateTime, Reader, SheetVisible, Xlsx};
use std::io::Cursor;

/// Text that replaces a formula without a value.
const UNCOMPUTED: &str =
    "formula without a value: open the workbook in a spreadsheet program and save it";

pub(super) fn sheets(
    bytes: &[u8],
    archive: &mut Archive,
    wanted: Option<&str>,
) -> Result<Sheets, Invalid> {
    let unreadable = |error: calamine::XlsxError| unreadable(&error.to_string());
    let mut workbook: Xlsx<_> = Xlsx::new(Cursor::new(bytes)).map_err(unreadable)?;
    let names = workbook.sheet_names();
    let sheets = workbook.sheets_metadata().iter();
    let hidden = sheets.filter(|sheet| sheet.visible != SheetVisible::Visible);
    let hidden: Vec<String> = hidden.map(|sheet| sheet.name.clone()).collect();
    let is_wanted = |name: &&String| wanted.is_none_or(|wanted| *name == wanted);
    // Hidden sheets come last. Only the first of them is read, and only if no visible sheet has cells.
    let (last, first): (Vec<&String>, Vec<&String>) = names
        .iter()
        .filter(is_wanted)
        .partition(|name| hidden.contains(name));
    let n_shown = first.len();
    let mut found = Vec::new();
    for (at, name) in first.into_iter().chain(last).enumerate() {
        if at >= n_shown && !found.is_empty() {
            break;
        }
        // Sheets of charts and macros have no cells.
        let Ok(mut cells) = workbook.worksheet_cells_reader(name) else {
            continue;
        };
        let marks = hidden_rows::marks_of_xlsx(archive, name)?;
        let mut text = SheetText::default();
        while let Some(cell) = cells.next_cell().map_err(unreadable)? {
            let (row, column) = cell.get_position();
            let (row, column) = (row as usize, column as usize);
            let value = in_text(cell.get_value());
            let is_formula = || {
                marks
                    .formulas
                    .contains(&hidden_rows::reference(row, column))
            };
            let value = match value.is_empty() && !marks.formulas.is_empty() && is_formula() {
                true => UNCOMPUTED.to_owned(),
                false => value,
            };
            text.cell(row, column, &value, marks.hidden.contains(&row))?;
        }
        let sheet = text.finish(name.clone());
        found.extend(sheet.map(|sheet| Sheet {
            struck_rows: marks.struck.into_iter().collect(),
            ..sheet
        }));
        if found.len() > 1 {
            break;
        }
    }
    Ok(Sheets { names, found })
}

fn in_text(value: &DataRef) -> String {
    match value {
        DataRef::Int(value) => value.to_string(),
        DataRef::Float(value) => value.to_string(),
        DataRef::String(text) | DataRef::DateTimeIso(text) | DataRef::DurationIso(text) => {
            text.clone()
        }
        DataRef::SharedString(text) => (*text).to_owned(),
        DataRef::Bool(value) => value.to_string(),
        DataRef::DateTime(time) => time_in_text(time),
        DataRef::Error(error) => error.to_string(),
        DataRef::Empty => String::new(),
    }
}

/// Formats a time as `2026-03-01T08:15:30.250`, or as a time of day if it has no date.
fn time_in_text(time: &ExcelDateTime) -> String {
    let (year, month, day, hour, minute, second, milli) = time.to_ymd_hms_milli();
    let clock = format!("{hour:02}:{minute:02}:{second:02}.{milli:03}");
    if time.as_f64() < 1.0 || time.is_duration() {
        return clock;
    }
    format!("{year:04}-{month:02}-{day:02}T{clock}")
}
