//! Reads files whose header has the meanings of the columns (`q1_deg`, `x_mm`, `station` …). Uploads of the first versions have this form
//! and no stored reading.

use crate::measurement::columns::mapping::{ColumnRef, HeaderRow, Mapping, Needs, Separator};
use crate::measurement::conventions::{Decimal, Frame};
use crate::measurement::issue::ParseError;
use crate::measurement::rotation_convention::RotationConvention;
use crate::measurement::set::MeasurementSet;
use crate::measurement::table::lines::{cells, lines};
use crate::measurement::table::points::{TableOptions, read};
use crate::measurement::table::text::Source;

/// Parses a file with decimal points. `n_joints` is the robot's number of links.
///
/// # Errors
/// [`ParseError`] with the row, the column and a hint for each error.
pub fn parse(bytes: &[u8], frame: Frame, n_joints: usize) -> Result<MeasurementSet, ParseError> {
    parse_as(Decimal::Point, None, bytes, frame, n_joints)
}

/// As [`parse`], with the given decimal mark and rotation convention. Columns are separated by `,`, or by `;` if the decimal mark is a comma.
///
/// # Errors
/// As [`parse`].
pub fn parse_as(
    decimal: Decimal,
    rotation: Option<RotationConvention>,
    bytes: &[u8],
    frame: Frame,
    n_joints: usize,
) -> Result<MeasurementSet, ParseError> {
    let source = Source::decode(bytes)?;
    let separator = match decimal {
        Decimal::Point => Separator::Comma,
        Decimal::Comma => Separator::Semicolon,
    };
    let (header, line) = (lines(&source.text).map(|line| line.text).zip(1..))
        .find(|(text, _)| !text.trim().is_empty())
        .unwrap_or_default();
    let names = cells(header, separator);
    let mapping = Mapping {
        columns: (names.into_iter())
            .map(|name| (name.clone(), ColumnRef::Header(name)))
            .collect(),
        decimal: Some(decimal),
        separator: Some(separator),
        header_row: Some(HeaderRow::Line(line)),
        comments: Some(false),
        is_complete: true,
        ..Mapping::default()
    };
    let options = TableOptions {
        mapping: &mapping,
        n_joints,
        needs: Needs::Points,
        rotation,
        is_time: |_| true,
        are_targets: false,
    };
    Ok(MeasurementSet::new(frame, read(source, &options)?.points))
}
