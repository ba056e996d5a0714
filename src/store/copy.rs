//! Copies a whole database into an empty database of either engine, for `kincal copy-store`.
//!
//! The columns are read from the target's schema, so only a migration that adds a table needs a change here.

use sqlx::any::AnyArguments;
use sqlx::query::Query;
use sqlx::{Any, AnyConnection, AssertSqlSafe, Row, ValueRef};
use tokio_stream::StreamExt;

use super::{Engine, Error, Result, Store};

/// Every table; a table comes after those that it references.
pub const TABLES: &[&str] = &[
    "robot",
    "robot_version",
    "robot_policy",
    "named_document",
    "measurement_set",
    "frames",
    "job",
    "job_robot_version",
    "job_session",
    "report_summary",
    "network",
    "residual_network",
    "parameter_set",
    "job_source",
    "estimate",
    "verification",
    "archived",
    "idempotency",
    "api_key",
    "browser_session",
    "audit",
    "audit_head",
];

/// References of a job to results of other jobs. Those rows are copied after the jobs, so these columns are filled at the end.
const RESULT_REFERENCES: &[&str] = &[
    "network_input_id",
    "residual_network_input_id",
    "parameter_set_input_id",
];

/// Number of rows copied of one table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CopiedTable {
    /// The table.
    pub table: &'static str,
    /// Its rows.
    pub n_rows: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ColumnType {
    Text,
    BigInt,
    Double,
    Bytes,
}

struct Column {
    name: String,
    kind: ColumnType,
}

/// Copies one store into another in one transaction of the target. No process may write to the source during the copy. `started_table` is
/// called before each table.
///
/// # Errors
/// [`Error::Open`] if the target is not empty or the schemas differ, [`Error::Database`].
pub async fn copy(
    from: &Store,
    to: &Store,
    mut started_table: impl FnMut(&'static str),
) -> Result<Vec<CopiedTable>> {
    let versions = (from.schema_version().await?, to.schema_version().await?);
    if versions.0 != versions.1 {
        let detail = format!(
            "the schemas are at versions {} and {}: run `kincal migrate` of the same kincal on both",
            versions.0, versions.1
        );
        return Err(Error::open(detail));
    }
    let mut tx = to.begin().await?;
    let mut source = from.readers().acquire().await?;
    if from.engine() == Engine::Postgres {
        // All tables are read from one snapshot.
        sqlx::query("begin isolation level repeatable read read only")
            .execute(&mut *source)
            .await?;
    }
    let target = tx.connection();
    for table in TABLES.iter().filter(|table| **table != "audit_head") {
        refuse_rows(target, table).await?;
    }
    let mut copied = Vec::new();
    for &table in TABLES {
        started_table(table);
        copied.push(CopiedTable {
            table,
            n_rows: copy_table(&mut source, target, to.engine(), table).await?,
        });
    }
    link_jobs(&mut source, target).await?;
    if from.engine() == Engine::Postgres {
        sqlx::query("commit").execute(&mut *source).await?;
    }
    tx.commit().await?;
    Ok(copied)
}

async fn refuse_rows(target: &mut AnyConnection, table: &str) -> Result<()> {
    let sql = format!("select count(*) from (select 1 from {table} limit 1) as first_row");
    let n: i64 = sqlx::query_scalar(AssertSqlSafe(sql))
        .fetch_one(&mut *target)
        .await?;
    if n > 0 {
        let detail = format!(
            "the database to copy to has rows in {table} already: give an empty one, so that nothing is mixed"
        );
        return Err(Error::open(detail));
    }
    Ok(())
}

async fn copy_table(
    source: &mut AnyConnection,
    target: &mut AnyConnection,
    engine: Engine,
    table: &'static str,
) -> Result<u64> {
    let mut columns = columns(target, engine, table).await?;
    if table == "job" {
        columns.retain(|column| !RESULT_REFERENCES.contains(&column.name.as_str()));
    }
    if table == "audit_head" {
        // The migrations of the new database have already inserted a head, which would conflict with the copied one.
        sqlx::query("delete from audit_head")
            .execute(&mut *target)
            .await?;
    }
    let names = columns
        .iter()
        .map(|column| column.name.as_str())
        .collect::<Vec<_>>()
        .join(", ");
    let select = format!("select {names} from {table}");
    let mut rows = sqlx::query(AssertSqlSafe(select)).fetch(source);
    let mut n_rows = 0;
    while let Some(row) = rows.next().await {
        let row = row?;
        // Null columns are left out of the insert: a bound null has a type, and no type is valid on both engines.
        let mut present = Vec::new();
        for (at, column) in columns.iter().enumerate() {
            if !row.try_get_raw(at)?.is_null() {
                present.push((at, column));
            }
        }
        let names = present
            .iter()
            .map(|(_, column)| column.name.as_str())
            .collect::<Vec<_>>()
            .join(", ");
        let places = (1..=present.len())
            .map(|n| format!("${n}"))
            .collect::<Vec<_>>()
            .join(", ");
        let mut query = sqlx::query(AssertSqlSafe(format!(
            "insert into {table} ({names}) values ({places})"
        )));
        for (at, column) in present {
            query = bind(query, &row, at, column.kind)?;
        }
        query.execute(&mut *target).await?;
        n_rows += 1;
    }
    Ok(n_rows)
}

fn bind<'q>(
    query: Query<'q, Any, AnyArguments>,
    row: &sqlx::any::AnyRow,
    at: usize,
    kind: ColumnType,
) -> Result<Query<'q, Any, AnyArguments>> {
    Ok(match kind {
        ColumnType::Text => query.bind(row.try_get::<String, _>(at)?),
        ColumnType::BigInt => query.bind(row.try_get::<i64, _>(at)?),
        ColumnType::Double => query.bind(row.try_get::<f64, _>(at)?),
        ColumnType::Bytes => query.bind(row.try_get::<Vec<u8>, _>(at)?),
    })
}

/// Copies the references of jobs to results of other jobs.
async fn link_jobs(source: &mut AnyConnection, target: &mut AnyConnection) -> Result<()> {
    for column in RESULT_REFERENCES {
        let select = format!("select id, {column} from job where {column} is not null");
        let update = format!("update job set {column} = $2 where id = $1");
        let mut rows =
            sqlx::query_as::<_, (String, String)>(AssertSqlSafe(select)).fetch(&mut *source);
        while let Some(row) = rows.next().await {
            let (id, value) = row?;
            sqlx::query(AssertSqlSafe(update.clone()))
                .bind(id)
                .bind(value)
                .execute(&mut *target)
                .await?;
        }
    }
    Ok(())
}

async fn columns(target: &mut AnyConnection, engine: Engine, table: &str) -> Result<Vec<Column>> {
    let sql = match engine {
        Engine::Sqlite => "select name, lower(type) from pragma_table_info($1) order by cid",
        Engine::Postgres => {
            "select cast(column_name as text), cast(data_type as text) from information_schema.columns
             where table_schema = current_schema() and table_name = $1 order by ordinal_position"
        }
    };
    let found: Vec<(String, String)> = sqlx::query_as(sql)
        .bind(table)
        .fetch_all(&mut *target)
        .await?;
    let column = |(name, kind): (String, String)| {
        let kind = match kind.as_str() {
            "text" => ColumnType::Text,
            "bigint" => ColumnType::BigInt,
            "double precision" => ColumnType::Double,
            "blob" | "bytea" => ColumnType::Bytes,
            other => {
                return Err(Error::open(format!(
                    "column {table}.{name} is of type {other}, which copy-store does not support"
                )));
            }
        };
        Ok(Column { name, kind })
    };
    found.into_iter().map(column).collect()
}
