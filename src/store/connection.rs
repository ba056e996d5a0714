//! Where a statement runs, the same to whoever writes it: on SQLite here and now ([`sqlite`](super::sqlite)), on PostgreSQL through sqlx.

use either::Either;
use futures_util::future::BoxFuture;
use futures_util::stream::{self, BoxStream, StreamExt};
use futures_util::{FutureExt, TryFutureExt};
use sqlx::any::{AnyArguments, AnyQueryResult, AnyRow, AnyStatement, AnyTypeInfo};
use sqlx::{Any, AnyConnection, AnyPool, Describe, Execute, Executor, SqlStr};
use sqlx_core::any::AnyValueKind;

use super::sqlite::{self, Done, aside};

type Step = sqlx::Result<Either<AnyQueryResult, AnyRow>>;

/// To write more than this may take long, bytes.
const LARGE: usize = 1 << 20;

/// What a statement is sent to.
#[derive(Debug)]
pub(crate) enum Connection<'c> {
    /// SQLite.
    Sqlite(OnSqlite<'c>),
    /// A transaction on PostgreSQL.
    Sqlx(&'c mut AnyConnection),
    /// PostgreSQL outside of transactions, to read.
    SqlxPool(&'c AnyPool),
}

/// Where on SQLite.
#[derive(Debug)]
pub(crate) struct OnSqlite<'c> {
    place: Place<'c>,
    /// Whether the statement may take long, whatever it looks like.
    is_long: bool,
}

#[derive(Debug)]
enum Place<'c> {
    Transaction(&'c mut sqlite::Connection),
    /// Outside of transactions, to read.
    Pool(&'c sqlite::Pool),
}

impl<'c> Connection<'c> {
    /// A transaction on SQLite.
    pub(crate) fn sqlite(connection: &'c mut sqlite::Connection) -> Self {
        Connection::Sqlite(OnSqlite {
            place: Place::Transaction(connection),
            is_long: false,
        })
    }

    /// SQLite outside of transactions, to read.
    pub(crate) fn sqlite_pool(pool: &'c sqlite::Pool) -> Self {
        Connection::Sqlite(OnSqlite {
            place: Place::Pool(pool),
            is_long: false,
        })
    }

    /// For a statement that may take long.
    pub(crate) fn for_long(mut self) -> Self {
        if let Connection::Sqlite(sqlite) = &mut self {
            sqlite.is_long = true;
        }
        self
    }

    /// The same for another statement.
    pub(crate) fn again(&mut self) -> Connection<'_> {
        match self {
            Connection::Sqlite(OnSqlite { place, is_long }) => {
                let place = match place {
                    Place::Transaction(connection) => Place::Transaction(connection),
                    Place::Pool(pool) => Place::Pool(pool),
                };
                Connection::Sqlite(OnSqlite {
                    place,
                    is_long: *is_long,
                })
            }
            Connection::Sqlx(connection) => Connection::Sqlx(connection),
            Connection::SqlxPool(pool) => Connection::SqlxPool(pool),
        }
    }
}

impl OnSqlite<'_> {
    /// Here and now, or aside what may take long: lists, and writes of much.
    async fn run<'q>(self, mut query: impl Execute<'q, Any>, most: usize) -> sqlx::Result<Done> {
        let arguments = query.take_arguments().map_err(sqlx::Error::Encode)?;
        let sql = query.sql();
        match self.place {
            Place::Transaction(connection)
                if self.is_long || arguments.as_ref().is_some_and(is_large) =>
            {
                aside(|| connection.run(sql.as_str(), arguments, most))
            }
            Place::Transaction(connection) => connection.run(sql.as_str(), arguments, most),
            Place::Pool(pool) if self.is_long || most > 1 => {
                pool.run_aside(sql.as_str(), arguments, most).await
            }
            Place::Pool(pool) => pool.run(sql.as_str(), arguments, most),
        }
    }
}

fn is_large(arguments: &AnyArguments) -> bool {
    let bytes = |value: &AnyValueKind| match value {
        AnyValueKind::Text(text) => text.len(),
        AnyValueKind::TextSlice(text) => text.len(),
        AnyValueKind::Blob(bytes) => bytes.len(),
        _ => 0,
    };
    arguments.values.0.iter().map(bytes).sum::<usize>() > LARGE
}

/// All rows, then what was done.
fn steps(done: Done) -> impl Iterator<Item = Step> {
    let end = AnyQueryResult {
        rows_affected: done.n_changed,
        last_insert_id: None,
    };
    done.rows
        .into_iter()
        .map(|row| Ok(Either::Right(row)))
        .chain([Ok(Either::Left(end))])
}

impl<'c> Executor<'c> for Connection<'c> {
    type Database = Any;

    fn fetch_many<'e, 'q: 'e, E>(self, query: E) -> BoxStream<'e, Step>
    where
        'c: 'e,
        E: 'q + Execute<'q, Any>,
    {
        match self {
            Connection::Sqlite(sqlite) => {
                async move { Ok(stream::iter(steps(sqlite.run(query, usize::MAX).await?))) }
                    .try_flatten_stream()
                    .boxed()
            }
            Connection::Sqlx(connection) => connection.fetch_many(query),
            Connection::SqlxPool(pool) => pool.fetch_many(query),
        }
    }

    fn fetch_optional<'e, 'q: 'e, E>(self, query: E) -> BoxFuture<'e, sqlx::Result<Option<AnyRow>>>
    where
        'c: 'e,
        E: 'q + Execute<'q, Any>,
    {
        match self {
            Connection::Sqlite(sqlite) => {
                async move { Ok(sqlite.run(query, 1).await?.rows.pop()) }.boxed()
            }
            Connection::Sqlx(connection) => connection.fetch_optional(query),
            Connection::SqlxPool(pool) => pool.fetch_optional(query),
        }
    }

    fn prepare_with<'e>(
        self,
        sql: SqlStr,
        parameters: &'e [AnyTypeInfo],
    ) -> BoxFuture<'e, sqlx::Result<AnyStatement>>
    where
        'c: 'e,
    {
        match self {
            Connection::Sqlite(_) => no_preparing(),
            Connection::Sqlx(connection) => connection.prepare_with(sql, parameters),
            Connection::SqlxPool(pool) => pool.prepare_with(sql, parameters),
        }
    }

    fn describe<'e>(self, sql: SqlStr) -> BoxFuture<'e, sqlx::Result<Describe<Any>>>
    where
        'c: 'e,
    {
        match self {
            Connection::Sqlite(_) => no_preparing(),
            Connection::Sqlx(connection) => connection.describe(sql),
            Connection::SqlxPool(pool) => pool.describe(sql),
        }
    }
}

/// Nothing in the store asks for this.
fn no_preparing<'e, T: Send + 'e>() -> BoxFuture<'e, sqlx::Result<T>> {
    async {
        Err(sqlx::Error::AnyDriverError(
            "SQLite's statements are prepared where they run".into(),
        ))
    }
    .boxed()
}
