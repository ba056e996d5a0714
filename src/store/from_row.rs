//! `FromRow` without sqlx's derive macro. The macro crate would build both database drivers, SQLite included, a second time.

use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::Error as NotAName;

/// Implements `FromRow` for a struct. Columns have the names of its fields.
///
/// - `parsed`: enums that are stored by name. The schema allows only the names of variants.
/// - `optional`: as `parsed`, but the column may be null.
/// - `flags`: booleans that are stored as 0 or 1.
/// - `counts`: non-negative counts.
/// - `nested`: structs that are read from the same row.
macro_rules! from_row {
    ($row:ident { $($field:ident),* $(,)? } $(parsed { $($parsed:ident),* $(,)? })? $(optional { $($optional:ident),* $(,)? })?
        $(flags { $($flag:ident),* $(,)? })? $(counts { $($count:ident),* $(,)? })? $(nested { $($nested:ident),* $(,)? })?) => {
        impl<'r> sqlx::FromRow<'r, sqlx::any::AnyRow> for $row {
            fn from_row(row: &'r sqlx::any::AnyRow) -> sqlx::Result<Self> {
                Ok($row {
                    $($field: sqlx::Row::try_get(row, stringify!($field))?,)*
                    $($($parsed: $crate::store::from_row::parse(row, stringify!($parsed))?,)*)?
                    $($($optional: $crate::store::from_row::parse_optional(row, stringify!($optional))?,)*)?
                    $($($flag: sqlx::Row::try_get::<i64, _>(row, stringify!($flag))? == 1,)*)?
                    $($($count: $crate::store::from_row::count(row, stringify!($count))?,)*)?
                    $($($nested: sqlx::FromRow::from_row(row)?,)*)?
                })
            }
        }
    };
}
pub(crate) use from_row;

/// Reads a text column that holds the name of an enum's variant, as in JSON.
///
/// # Errors
/// If the column is missing, is not text, or holds a name that is not a variant.
pub(crate) fn parse<T: for<'de> Deserialize<'de>>(
    row: &sqlx::any::AnyRow,
    column: &str,
) -> sqlx::Result<T> {
    variant(sqlx::Row::try_get(row, column)?, column)
}

/// As [`parse`], for a column that may be null.
///
/// # Errors
/// As [`parse`].
pub(crate) fn parse_optional<T: for<'de> Deserialize<'de>>(
    row: &sqlx::any::AnyRow,
    column: &str,
) -> sqlx::Result<Option<T>> {
    let name: Option<String> = sqlx::Row::try_get(row, column)?;
    name.map(|name| variant(name, column)).transpose()
}

/// Reads a count. A negative number is read as 0. Only an edit outside the service can write one, and the audit chain reveals that edit.
///
/// # Errors
/// If the column is missing or is not an integer.
pub(crate) fn count(row: &sqlx::any::AnyRow, column: &str) -> sqlx::Result<usize> {
    let n: i64 = sqlx::Row::try_get(row, column)?;
    Ok(usize::try_from(n).unwrap_or(0))
}

fn variant<T: for<'de> Deserialize<'de>>(name: String, column: &str) -> sqlx::Result<T> {
    T::deserialize(name.into_deserializer()).map_err(|source: NotAName| sqlx::Error::ColumnDecode {
        index: column.into(),
        source: source.into(),
    })
}

#[cfg(test)]
mod tests {
    use crate::wire::job::Kind;
    use crate::wire::job_answer::JobStatus;
    use crate::wire::measurement::Frame;
    use crate::wire::parameter_set::ParameterSetStatus;
    use crate::wire::policy::DecisionRule;
    use crate::wire::report_shape::Evidence;
    use crate::wire::verification::{Fit, VerificationKind};

    /// Rows are written with `as_str` and read by serde, so both must use the same names.
    #[test]
    fn every_enum_of_a_row_is_read_by_the_name_that_is_written() {
        macro_rules! check {
            ($($name:ident: $variants:expr;)*) => {
                $(for value in $variants {
                    let read: $name = super::variant(value.as_str().to_owned(), "column").unwrap();
                    assert_eq!(read, value);
                })*
            };
        }
        check! {
            Kind: Kind::ALL;
            JobStatus: JobStatus::ALL;
            Frame: [Frame::Base, Frame::Instrument];
            ParameterSetStatus: ParameterSetStatus::ALL;
            Evidence: Evidence::ALL;
            DecisionRule: DecisionRule::ALL;
            Fit: [Fit::Fits, Fit::SetFarOff, Fit::DoesNotFit];
            VerificationKind: VerificationKind::ALL;
        }
        assert!(super::variant::<Fit>("not_thought_of".into(), "fit").is_err());
    }
}
