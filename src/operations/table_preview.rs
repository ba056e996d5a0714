//! Preview of a table before it is uploaded.

use crate::measurement::table::points::Preview;
use crate::wire::Invalid;
use crate::wire::columns::{ColumnsBody, FilePart};
use crate::wire::measurement::{Decimal, Frame};
use crate::wire::table_preview::{FilePreview, PreviewAnswer};
use crate::wire::table_upload::{self, Files, UploadOptions};
use crate::wire::understood::UnderstoodBody;

/// Number of rows in a preview.
const N_ROWS: usize = 8;
/// Maximum length of a cell in a preview, characters. Longer cells are cut.
const MAX_CELL: usize = 80;

/// Makes a preview of the files of an upload: how they are interpreted.
///
/// # Errors
/// [`Invalid`] for a form without the required files, or with an invalid column mapping.
pub fn preview_table(
    content_type: &str,
    bytes: &[u8],
    columns: &ColumnsBody,
    decimal: Option<Decimal>,
    n_joints: usize,
) -> Result<PreviewAnswer, Invalid> {
    let files = Files::new(content_type, bytes)?;
    let options = UploadOptions {
        columns: files.columns.as_ref().unwrap_or(columns),
        decimal,
        rotation: None,
        frame: Frame::Instrument,
        n_joints,
        is_time: crate::wire::time::is_rfc3339,
    };
    let file = |(part, bytes): &(FilePart, &[u8])| {
        let found = table_upload::preview(*part, bytes, &options, N_ROWS);
        file_preview(*part, found.as_ref().ok())
    };
    let previews = files.files.iter().map(file).collect();
    Ok(match table_upload::read(&files, &options) {
        Ok((set, reading)) => PreviewAnswer {
            files: previews,
            join: reading.joined.map(|joined| joined.join),
            n_points: Some(set.points.len()),
            errors: vec![],
        },
        Err(error) => PreviewAnswer {
            files: previews,
            join: None,
            n_points: None,
            errors: error.issues,
        },
    })
}

fn file_preview(part: FilePart, found: Option<&Preview>) -> FilePreview {
    let part = part.as_str().to_owned();
    let Some(found) = found else {
        return FilePreview {
            part,
            understood: None,
            header: vec![],
            above: vec![],
            rows: vec![],
            missing: vec![],
            proposed: ColumnsBody::default(),
        };
    };
    let shown = |cells: &Vec<String>| -> Vec<String> {
        let cut = |cell: &String| cell.chars().take(MAX_CELL).collect();
        cells.iter().take(200).map(cut).collect()
    };
    let proposed = found.columns.proposed.iter();
    let proposed = proposed.map(|(means, place)| (means.clone(), (place + 1).into()));
    FilePreview {
        part,
        understood: Some(UnderstoodBody::from(&found.understood)),
        header: shown(&found.header),
        above: shown(&found.above),
        rows: found.rows.iter().map(shown).collect(),
        missing: found.columns.missing.clone(),
        proposed: ColumnsBody(proposed.collect()),
    }
}
