//! Queries with one parameter, outside a transaction or in it.

use sqlx::any::AnyRow;
use sqlx::{Any, Decode, Executor, FromRow, Type};

use super::{Result, Store};

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

/// Calls `examine` for each row that a query finds, as [`rows_after`] makes one. Reads `batch` rows at a time.
pub(super) async fn each<T>(
    store: &Store,
    sql: &'static str,
    batch: i64,
    id: fn(&T) -> &str,
    mut examine: impl FnMut(T),
) -> Result<()>
where
    T: for<'r> FromRow<'r, AnyRow> + Send + Unpin,
{
    let mut after = String::new();
    loop {
        let query = sqlx::query_as(sql).bind(&after).bind(batch);
        let rows: Vec<T> = query.fetch_all(store.readers()).await?;
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
