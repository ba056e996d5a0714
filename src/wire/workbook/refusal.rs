//! Refusals of workbooks.

use crate::wire::{Invalid, Issue};
use std::io::Cursor;
use zip::ZipArchive;

/// Maximum unpacked size of a workbook, bytes. 100,000 rows of twelve numbers have 45 MB as xlsx.
pub(super) const MAX_UNPACKED_BYTES: u64 = 64 * 1024 * 1024;

pub(super) type Archive<'a> = ZipArchive<Cursor<&'a [u8]>>;

pub(super) fn refused(code: &'static str, detail: String) -> Invalid {
    Invalid {
        code: "invalid_measurements",
        issues: vec![Issue {
            code: code.into(),
            detail,
            ..Issue::default()
        }],
    }
}

pub(super) fn too_large() -> Invalid {
    let detail = format!(
        "the workbook unpacks to more than {} MiB: save the sheet alone, without pictures, or as CSV",
        MAX_UNPACKED_BYTES / (1024 * 1024)
    );
    refused("too_large", detail)
}

pub(super) fn unreadable(why: &str) -> Invalid {
    let detail = format!("the workbook cannot be read ({why}): save the sheet again, or as CSV");
    refused("unreadable", detail)
}
