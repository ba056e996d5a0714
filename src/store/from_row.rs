//! `FromRow` without sqlx's derive: its macro crate would build both drivers, SQLite included, a second time.

/// Implements `FromRow` for a struct. Columns have the names of its fields. `parsed` fields are read as text and converted by
/// `TryFrom<String>`; `nested` fields are structs that are read from the same row.
macro_rules! from_row {
    ($row:ident { $($field:ident),* $(,)? } $(parsed { $($parsed:ident),* $(,)? })? $(nested { $($nested:ident),* $(,)? })?) => {
        impl<'r> sqlx::FromRow<'r, sqlx::any::AnyRow> for $row {
            fn from_row(row: &'r sqlx::any::AnyRow) -> sqlx::Result<Self> {
                Ok($row {
                    $($field: sqlx::Row::try_get(row, stringify!($field))?,)*
                    $($($parsed: $crate::store::from_row::parse(row, stringify!($parsed))?,)*)?
                    $($($nested: sqlx::FromRow::from_row(row)?,)*)?
                })
            }
        }
    };
}
pub(crate) use from_row;

/// Reads a text column and converts it.
///
/// # Errors
/// If the column is missing, is no text, or cannot be converted.
pub(crate) fn parse<T: TryFrom<String, Error = String>>(
    row: &sqlx::any::AnyRow,
    column: &str,
) -> sqlx::Result<T> {
    let text: String = sqlx::Row::try_get(row, column)?;
    T::try_from(text).map_err(|source| sqlx::Error::ColumnDecode {
        index: column.into(),
        source: source.into(),
    })
}
