//! Runs statements with the values of their parameters, outside a transaction or in it.

use sqlx::any::{AnyArguments, AnyRow};
use sqlx::{Any, AnyPool, Decode, Executor, FromRow, Type};

use super::Result;

/// The values of a statement's parameters, in their order.
macro_rules! values {
    ($($value:expr),* $(,)?) => {{
        #[allow(unused_mut)] // without parameters
        let mut values = sqlx::any::AnyArguments::default();
        $(sqlx::Arguments::add(&mut values, &$value).map_err(sqlx::Error::Encode)?;)*
        values
    }};
}
pub(super) use values;

/// A row that a query finds.
pub(super) trait Row: for<'r> FromRow<'r, AnyRow> + Send + Unpin {}

impl<T: for<'r> FromRow<'r, AnyRow> + Send + Unpin> Row for T {}

/// A value that a query with one column finds.
pub(super) trait Scalar: for<'r> Decode<'r, Any> + Type<Any> + Send + Unpin {}

impl<T: for<'r> Decode<'r, Any> + Type<Any> + Send + Unpin> Scalar for T {}

/// The row that a query finds.
pub(super) async fn one<T: Row>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    values: AnyArguments,
) -> Result<T> {
    Ok(sqlx::query_as_with(sql, values).fetch_one(from).await?)
}

/// The row that a query finds, or none.
pub(super) async fn first<T: Row>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    values: AnyArguments,
) -> Result<Option<T>> {
    let query = sqlx::query_as_with(sql, values);
    Ok(query.fetch_optional(from).await?)
}

/// The rows that a query finds.
pub(super) async fn all<T: Row>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    values: AnyArguments,
) -> Result<Vec<T>> {
    Ok(sqlx::query_as_with(sql, values).fetch_all(from).await?)
}

/// The value that a query finds.
pub(super) async fn value<T: Scalar>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    values: AnyArguments,
) -> Result<T> {
    Ok(sqlx::query_scalar_with(sql, values).fetch_one(from).await?)
}

/// The value that a query finds, or none.
pub(super) async fn first_value<T: Scalar>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    values: AnyArguments,
) -> Result<Option<T>> {
    let query = sqlx::query_scalar_with(sql, values);
    Ok(query.fetch_optional(from).await?)
}

/// The values that a query finds.
pub(super) async fn all_values<T: Scalar>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    values: AnyArguments,
) -> Result<Vec<T>> {
    Ok(sqlx::query_scalar_with(sql, values).fetch_all(from).await?)
}

/// Runs a statement that writes. Returns the number of rows that it changed.
pub(super) async fn execute(
    to: impl Executor<'_, Database = Any>,
    sql: &'static str,
    values: AnyArguments,
) -> Result<u64> {
    let done = sqlx::query_with(sql, values).execute(to).await?;
    Ok(done.rows_affected())
}

/// Calls `examine` for each row of a query made by [`rows_after`]. Reads `batch` rows at a time.
pub(super) async fn for_each_row<T: Row>(
    readers: &AnyPool,
    sql: &'static str,
    batch: i64,
    id: fn(&T) -> &str,
    mut examine: impl FnMut(T),
) -> Result<()> {
    let mut after = String::new();
    loop {
        let rows: Vec<T> = all(readers, sql, values![after, batch]).await?;
        let Some(last) = rows.last() else {
            return Ok(());
        };
        id(last).clone_into(&mut after);
        rows.into_iter().for_each(&mut examine);
    }
}

/// SQL: at most $2 rows with an id above $1, ordered by id.
macro_rules! rows_after {
    ($columns:expr, $from:literal) => {
        concat!(
            "select ",
            $columns,
            " from ",
            $from,
            " where id > $1 order by id limit cast($2 as bigint)"
        )
    };
}
pub(super) use rows_after;
