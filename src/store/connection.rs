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

/// A transaction's connection.
#[derive(Debug)]
pub(crate) enum Connection<'c> {
    /// To SQLite, here and now.
    Sqlite(&'c mut sqlite::Connection),
    /// To SQLite, for what may take long.
    Aside(&'c mut sqlite::Connection),
    /// To PostgreSQL.
    Sqlx(&'c mut AnyConnection),
}

/// For statements that only read, outside of transactions.
#[derive(Debug)]
pub(crate) enum Reader<'c> {
    /// From SQLite, here and now; lists apart.
    Sqlite(&'c sqlite::Pool),
    /// From SQLite what may take long.
    Aside(&'c sqlite::Pool),
    /// From PostgreSQL.
    Sqlx(&'c AnyPool),
}

impl Connection<'_> {
    /// The same for another statement.
    pub(crate) fn again(&mut self) -> Connection<'_> {
        match self {
            Connection::Sqlite(connection) => Connection::Sqlite(connection),
            Connection::Aside(connection) => Connection::Aside(connection),
            Connection::Sqlx(connection) => Connection::Sqlx(connection),
        }
    }
}

fn taken<'q>(mut query: impl Execute<'q, Any>) -> sqlx::Result<(SqlStr, Option<AnyArguments>)> {
    let arguments = query.take_arguments().map_err(sqlx::Error::Encode)?;
    Ok((query.sql(), arguments))
}

fn write<'q>(connection: &mut sqlite::Connection, query: impl Execute<'q, Any>, most: usize) -> sqlx::Result<Done> {
    let (sql, arguments) = taken(query)?;
    match arguments.as_ref().is_some_and(is_large) {
        true => aside(|| connection.run(sql.as_str(), arguments, most)),
        false => connection.run(sql.as_str(), arguments, most),
    }
}

fn write_aside<'q>(connection: &mut sqlite::Connection, query: impl Execute<'q, Any>, most: usize) -> sqlx::Result<Done> {
    let (sql, arguments) = taken(query)?;
    aside(|| connection.run(sql.as_str(), arguments, most))
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
    let end = AnyQueryResult { rows_affected: done.n_changed, last_insert_id: None };
    done.rows.into_iter().map(|row| Ok(Either::Right(row))).chain([Ok(Either::Left(end))])
}

impl<'c> Executor<'c> for Connection<'c> {
    type Database = Any;

    fn fetch_many<'e, 'q: 'e, E>(self, query: E) -> BoxStream<'e, Step>
    where
        'c: 'e,
        E: 'q + Execute<'q, Any>,
    {
        match self {
            Connection::Sqlite(connection) => {
                async move { Ok(stream::iter(steps(write(connection, query, usize::MAX)?))) }.try_flatten_stream().boxed()
            }
            Connection::Aside(connection) => {
                async move { Ok(stream::iter(steps(write_aside(connection, query, usize::MAX)?))) }.try_flatten_stream().boxed()
            }
            Connection::Sqlx(connection) => connection.fetch_many(query),
        }
    }

    fn fetch_optional<'e, 'q: 'e, E>(self, query: E) -> BoxFuture<'e, sqlx::Result<Option<AnyRow>>>
    where
        'c: 'e,
        E: 'q + Execute<'q, Any>,
    {
        match self {
            Connection::Sqlite(connection) => async move { Ok(write(connection, query, 1)?.rows.pop()) }.boxed(),
            Connection::Aside(connection) => async move { Ok(write_aside(connection, query, 1)?.rows.pop()) }.boxed(),
            Connection::Sqlx(connection) => connection.fetch_optional(query),
        }
    }

    fn prepare_with<'e>(self, sql: SqlStr, parameters: &'e [AnyTypeInfo]) -> BoxFuture<'e, sqlx::Result<AnyStatement>>
    where
        'c: 'e,
    {
        match self {
            Connection::Sqlite(_) | Connection::Aside(_) => no_preparing(),
            Connection::Sqlx(connection) => connection.prepare_with(sql, parameters),
        }
    }

    fn describe<'e>(self, sql: SqlStr) -> BoxFuture<'e, sqlx::Result<Describe<Any>>>
    where
        'c: 'e,
    {
        match self {
            Connection::Sqlite(_) | Connection::Aside(_) => no_preparing(),
            Connection::Sqlx(connection) => connection.describe(sql),
        }
    }
}

impl<'c> Executor<'c> for Reader<'c> {
    type Database = Any;

    fn fetch_many<'e, 'q: 'e, E>(self, query: E) -> BoxStream<'e, Step>
    where
        'c: 'e,
        E: 'q + Execute<'q, Any>,
    {
        match self {
            Reader::Sqlite(pool) | Reader::Aside(pool) => async move {
                let (sql, arguments) = taken(query)?;
                Ok(stream::iter(steps(pool.run_aside(sql.as_str(), arguments, usize::MAX).await?)))
            }
            .try_flatten_stream()
            .boxed(),
            Reader::Sqlx(pool) => pool.fetch_many(query),
        }
    }

    fn fetch_optional<'e, 'q: 'e, E>(self, query: E) -> BoxFuture<'e, sqlx::Result<Option<AnyRow>>>
    where
        'c: 'e,
        E: 'q + Execute<'q, Any>,
    {
        match self {
            Reader::Sqlite(pool) => async move {
                let (sql, arguments) = taken(query)?;
                Ok(pool.run(sql.as_str(), arguments, 1)?.rows.pop())
            }
            .boxed(),
            Reader::Aside(pool) => async move {
                let (sql, arguments) = taken(query)?;
                Ok(pool.run_aside(sql.as_str(), arguments, 1).await?.rows.pop())
            }
            .boxed(),
            Reader::Sqlx(pool) => pool.fetch_optional(query),
        }
    }

    fn prepare_with<'e>(self, sql: SqlStr, parameters: &'e [AnyTypeInfo]) -> BoxFuture<'e, sqlx::Result<AnyStatement>>
    where
        'c: 'e,
    {
        match self {
            Reader::Sqlite(_) | Reader::Aside(_) => no_preparing(),
            Reader::Sqlx(pool) => pool.prepare_with(sql, parameters),
        }
    }

    fn describe<'e>(self, sql: SqlStr) -> BoxFuture<'e, sqlx::Result<Describe<Any>>>
    where
        'c: 'e,
    {
        match self {
            Reader::Sqlite(_) | Reader::Aside(_) => no_preparing(),
            Reader::Sqlx(pool) => pool.describe(sql),
        }
    }
}

/// Nothing in the store asks for this.
fn no_preparing<'e, T: Send + 'e>() -> BoxFuture<'e, sqlx::Result<T>> {
    async { Err(sqlx::Error::AnyDriverError("SQLite's statements are prepared where they run".into())) }.boxed()
}
