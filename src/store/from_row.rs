//! `FromRow` without sqlx's derive macro. The macro crate would build both database drivers, SQLite included, a second time.

use crate::wire::job::Kind;
use crate::wire::job_answer::{Finding, JobStatus};
use crate::wire::measurement::Frame;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::policy::DecisionRule;
use crate::wire::report_shape::Evidence;
use crate::wire::verification::{Fit, VerificationKind};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::Error as NotAName;
use sqlx::Row;
use sqlx::any::AnyRow;

/// A value that is read from a column of its name.
pub(crate) trait Column: Sized {
    /// Reads it.
    ///
    /// # Errors
    /// If the column is missing or holds something else.
    fn read(row: &AnyRow, column: &str) -> sqlx::Result<Self>;
}

/// Declares the struct of a row and implements `FromRow` for it. Each field is a [`Column`] of that name, or a nested row that is read from
/// the same columns.
macro_rules! row {
    ($(#[$about:meta])* $visible:vis struct $row:ident { $($(#[$doc:meta])* $visible_field:vis $field:ident: $type:ty),* $(,)? }) => {
        $(#[$about])*
        $visible struct $row {
            $($(#[$doc])* $visible_field $field: $type),*
        }

        $crate::store::from_row::from_row!($row { $($field),* });
    };
}
pub(crate) use row;

/// Implements `FromRow` for a struct, see [`row`].
macro_rules! from_row {
    ($row:ident { $($field:ident),* $(,)? }) => {
        impl<'r> sqlx::FromRow<'r, sqlx::any::AnyRow> for $row {
            fn from_row(row: &'r sqlx::any::AnyRow) -> sqlx::Result<Self> {
                use $crate::store::from_row::Column;
                Ok($row { $($field: Column::read(row, stringify!($field))?),* })
            }
        }

        impl $crate::store::from_row::Column for $row {
            fn read(row: &sqlx::any::AnyRow, _: &str) -> sqlx::Result<Self> {
                sqlx::FromRow::from_row(row)
            }
        }
    };
}
pub(crate) use from_row;

macro_rules! plain {
    ($($type:ty),*) => {$(
        impl Column for $type {
            fn read(row: &AnyRow, column: &str) -> sqlx::Result<Self> {
                row.try_get(column)
            }
        }
    )*};
}
plain!(
    i64,
    String,
    Vec<u8>,
    Option<i64>,
    Option<f64>,
    Option<String>
);

/// Stored as 0 or 1.
impl Column for bool {
    fn read(row: &AnyRow, column: &str) -> sqlx::Result<Self> {
        Ok(row.try_get::<i64, _>(column)? == 1)
    }
}

/// A count. A negative number is read as 0. Only an edit outside the service can write one, and the audit chain reveals that edit.
impl Column for usize {
    fn read(row: &AnyRow, column: &str) -> sqlx::Result<Self> {
        Ok(usize::try_from(row.try_get::<i64, _>(column)?).unwrap_or(0))
    }
}

/// Enums that are stored by name, as in JSON. The schema allows only the names of variants.
macro_rules! by_name {
    ($($name:ident),*) => {$(
        impl Column for $name {
            fn read(row: &AnyRow, column: &str) -> sqlx::Result<Self> {
                variant(row.try_get(column)?, column)
            }
        }

        impl Column for Option<$name> {
            fn read(row: &AnyRow, column: &str) -> sqlx::Result<Self> {
                let name: Option<String> = row.try_get(column)?;
                name.map(|name| variant(name, column)).transpose()
            }
        }
    )*};
}
by_name!(
    DecisionRule,
    Evidence,
    Finding,
    Fit,
    Frame,
    JobStatus,
    Kind,
    ParameterSetStatus,
    VerificationKind
);

fn variant<T: for<'de> Deserialize<'de>>(name: String, column: &str) -> sqlx::Result<T> {
    T::deserialize(name.into_deserializer()).map_err(|source: NotAName| sqlx::Error::ColumnDecode {
        index: column.into(),
        source: source.into(),
    })
}

#[cfg(test)]
mod tests {
    use super::{
        DecisionRule, Evidence, Fit, Frame, JobStatus, Kind, ParameterSetStatus, VerificationKind,
    };

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
