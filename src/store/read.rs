//! Queries with one parameter, outside a transaction or in it.

use sqlx::any::AnyRow;
use sqlx::{Any, Decode, Executor, FromRow, Type};

use super::Result;

/// The row that a query finds.
pub(super) async fn one<T>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    id: &str,
) -> Result<T>
where
    T: for<'r> FromRow<'r, AnyRow> + Send + Unpin,
{
    Ok(sqlx::query_as(sql).bind(id).fetch_one(from).await?)
}

/// The row that a query finds, or none.
pub(super) async fn first<T>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    id: &str,
) -> Result<Option<T>>
where
    T: for<'r> FromRow<'r, AnyRow> + Send + Unpin,
{
    Ok(sqlx::query_as(sql).bind(id).fetch_optional(from).await?)
}

/// The value that a query finds.
pub(super) async fn value<T>(
    from: impl Executor<'_, Database = Any>,
    sql: &'static str,
    id: &str,
) -> Result<T>
where
    T: for<'r> Decode<'r, Any> + Type<Any> + Send + Unpin,
{
    Ok(sqlx::query_scalar(sql).bind(id).fetch_one(from).await?)
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
