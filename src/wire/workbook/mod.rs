//! Workbooks (xlsx, ods) as tables: one sheet becomes text with one line per row. A workbook is a zip archive. The unpacked size of all its files is
//! checked before anything is parsed.

mod hidden_rows;
mod ods;
mod refusal;
mod sheet;
mod xlsx;
mod xml;

use crate::measurement::columns::mapping::Mapping;
use crate::measurement::table::text::{Encoding, Source};
use crate::wire::Invalid;
use hidden_rows::refuse_marked_rows;
use refusal::{Archive, MAX_UNPACKED_BYTES, refused, too_large, unreadable};
use sheet::Sheets;
use std::io::{Cursor, Read};
use zip::ZipArchive;

/// Maximum number of files in a workbook.
const MAX_FILES: usize = 1000;

/// Media type of xlsx.
pub const XLSX: &str = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet";
/// Media type of ods.
pub const ODS: &str = "application/vnd.oasis.opendocument.spreadsheet";

/// A kind of workbook.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Workbook {
    /// Office Open XML.
    Xlsx,
    /// OpenDocument.
    Ods,
}

impl Workbook {
    /// Its media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Xlsx => XLSX,
            Self::Ods => ODS,
        }
    }
}

/// The kind of workbook, if the bytes are a zip archive with the files of a workbook.
pub fn workbook(bytes: &[u8]) -> Option<Workbook> {
    if !bytes.starts_with(b"PK\x03\x04") {
        return None;
    }
    let archive = ZipArchive::new(Cursor::new(bytes)).ok()?;
    let has = |name: &str| archive.index_for_name(name).is_some();
    if has("xl/workbook.xml") {
        Some(Workbook::Xlsx)
    } else if has("content.xml") && has("mimetype") {
        Some(Workbook::Ods)
    } else {
        None
    }
}

/// Reads one sheet of a workbook as a table. Also returns the name of the sheet.
///
/// # Errors
/// [`Invalid`] if the workbook is too large or damaged, if several sheets have cells and `mapping` names none, or if rows are hidden.
/// Hidden rows of a stored file, which was accepted once, are read.
pub fn read(
    kind: Workbook,
    bytes: &[u8],
    mapping: &Mapping,
) -> Result<(Source<'static>, String), Invalid> {
    let wanted = mapping.sheet.as_deref();
    let mut archive =
        ZipArchive::new(Cursor::new(bytes)).map_err(|e| unreadable(&e.to_string()))?;
    refuse_bombs(&mut archive)?;
    let (sheets, encoding) = match kind {
        Workbook::Xlsx => (xlsx::sheets(bytes, &mut archive, wanted)?, Encoding::Xlsx),
        Workbook::Ods => (ods::sheets(&mut archive, wanted)?, Encoding::Ods),
    };
    let Sheets { names, found } = sheets;
    let listed = |names: &[String]| {
        let names: Vec<String> = names
            .iter()
            .take(20)
            .map(|name| format!("{name:?}"))
            .collect();
        names.join(", ")
    };
    let mut found = found.into_iter();
    match (found.next(), found.next()) {
        (Some(sheet), None) => {
            if !mapping.is_complete {
                refuse_marked_rows(&sheet)?;
            }
            Ok((Source::from_sheet(sheet.text, encoding), sheet.name))
        }
        (None, _) => Err(match wanted {
            Some(wanted) => refused(
                "unknown_sheet",
                format!(
                    "the workbook has no sheet {wanted:?} with cells; it has {}",
                    listed(&names)
                ),
            ),
            None => refused("empty", "no sheet of the workbook has cells".into()),
        }),
        (Some(first), Some(second)) => {
            let (robot, instrument) = match is_of_instrument(&first.name) {
                true => (&second.name, &first.name),
                false => (&first.name, &second.name),
            };
            let detail = format!(
                "several sheets of the workbook have cells, {:?} and {:?} among them. If one has the joint values and another the positions, give the workbook as both \
                 files, and name the sheets in the column mapping: {{\"robot\": {{\"sheet\": {robot:?}}}, \"instrument\": {{\"sheet\": {instrument:?}}}}}. If one sheet has \
                 both, name it in the column mapping: {{\"sheet\": {:?}}}",
                first.name, second.name, first.name
            );
            Err(refused("two_readings", detail))
        }
    }
}

/// Whether the sheet's name indicates that it contains the instrument's data.
fn is_of_instrument(name: &str) -> bool {
    let name = name.to_lowercase();
    let words = ["tracker", "laser", "instrument", "meas", "mess", "position"];
    words.iter().any(|word| name.contains(word))
}

/// Protection against zip bombs: unpacks every file without keeping its content, and counts the bytes.
fn refuse_bombs(archive: &mut Archive) -> Result<(), Invalid> {
    if archive.len() > MAX_FILES {
        return Err(too_large());
    }
    let mut left = MAX_UNPACKED_BYTES;
    for index in 0..archive.len() {
        let file = archive
            .by_index(index)
            .map_err(|e| unreadable(&e.to_string()))?;
        let mut file = file.take(left + 1);
        let unpacked = std::io::copy(&mut file, &mut std::io::sink());
        let unpacked = unpacked.map_err(|e| unreadable(&e.to_string()))?;
        left = left.checked_sub(unpacked).ok_or_else(too_large)?;
    }
    Ok(())
}
