//! Check I9: the database is sound and its schema is complete. This includes the constraints that enforce I4, I6 and I7.

use super::check::Check;
use crate::store::sql::{self, values};
use crate::store::{Engine, Result, Store};

pub(super) const QUERIES_SQLITE: &[&str] =
    &[INTEGRITY, FOREIGN_KEYS, OBJECTS_SQLITE, UNIQUE_SQLITE];
pub(super) const QUERIES_POSTGRES: &[&str] =
    &[NOT_VALIDATED_POSTGRES, OBJECTS_POSTGRES, UNIQUE_POSTGRES];

const INTEGRITY: &str = "select integrity_check from pragma_integrity_check";
const FOREIGN_KEYS: &str = "select \"table\" from pragma_foreign_key_check";
const OBJECTS_SQLITE: &str = "select name from sqlite_master where type in ('trigger', 'index')";
const UNIQUE_SQLITE: &str = "
    select m.name || '(' || (select group_concat(i.name) from pragma_index_info(l.name) i) || ')'
    from sqlite_master m, pragma_index_list(m.name) l where m.type = 'table' and l.\"unique\" = 1";

const NOT_VALIDATED_POSTGRES: &str =
    "select cast(conname as text) from pg_constraint where not convalidated";
const OBJECTS_POSTGRES: &str = "
    select cast(tgname as text) from pg_trigger where tgenabled <> 'D' and not tgisinternal
    union all select cast(indexname as text) from pg_indexes where schemaname = current_schema()";
const UNIQUE_POSTGRES: &str = "
    select c.relname || '(' || (select string_agg(cast(a.attname as text), ',' order by k.n)
        from unnest(i.indkey) with ordinality k (attnum, n) join pg_attribute a on a.attrelid = c.oid and a.attnum = k.attnum) || ')'
    from pg_index i join pg_class c on c.oid = i.indrelid join pg_namespace s on s.oid = c.relnamespace
    where i.indisunique and i.indisvalid and s.nspname = current_schema()";

/// Triggers and indexes that enforce the promises. A missing one is a violation.
const GUARDS: &[&str] = &[
    "audit_entry_stays",
    "audit_entry_is_kept",
    "parameter_set_one_released",
    "parameter_set_life",
    "parameter_set_checks",
    "parameter_set_stays",
    "parameter_set_is_kept",
    "parameter_set_policy",
    "parameter_set_no_better",
    "parameter_set_check_robot",
    "parameter_set_insisted",
    "parameter_set_sources",
    "parameter_set_sessions_fit",
    "verification_stays",
    "verification_is_kept",
    "measurement_set_stays",
    "measurement_set_uploader_stays",
    "measurement_set_insisted_stays",
    "measurement_set_reading_stays",
    "named_document_stays",
    "robot_stays",
    "job_stays_over",
    "job_report_stays",
    "report_summary_stays",
    "report_summary_is_kept",
    "estimate_stays",
    "estimate_is_kept",
    "frames_stay",
    "robot_version_stays",
    "robot_version_is_kept",
    "robot_joint_map_stays",
    "job_robot_version_stays",
    "job_robot_version_is_kept",
    "job_source_stays",
    "job_source_is_kept",
    "job_session_stays",
    "job_session_is_kept",
    "parameter_set_sessions",
    "archived_stays",
    "archived_not_released",
    "archived_job_is_over",
    "measurement_set_robot_in_use",
    "frames_robot_in_use",
    "job_robot_in_use",
    "parameter_set_in_use",
    "parameter_set_joint_map",
];
const UNIQUE: &[&str] = &[
    "parameter_set(job_id)",
    "job_session(job_id,measurement_set_id)",
    "parameter_set(robot_id)",
    "network(job_id)",
    "residual_network(job_id)",
    "idempotency(key_holder,method,path,idempotency_key)",
    "api_key(key_sha256)",
    "named_document(robot_id,kind,name,version)",
];

async fn names(store: &Store, query: &'static str) -> Result<Vec<String>> {
    sql::all_values(store.readers(), query, values![]).await
}

pub(super) async fn is_sound(store: &Store) -> Result<Check> {
    let mut check = Check::new(
        "I9",
        "the database is sound, its references hold and its constraints are in force",
    );
    let (objects, unique) = match store.engine() {
        Engine::Sqlite => {
            let lines = names(store, INTEGRITY).await?;
            check.n_examined += lines.len() as i64;
            lines
                .into_iter()
                .filter(|line| line != "ok")
                .for_each(|line| check.add_violation(line));
            let tables = names(store, FOREIGN_KEYS).await?;
            tables.into_iter().for_each(|table| {
                check.add_violation(format!("a row of {table} refers to one that is not there"))
            });
            (OBJECTS_SQLITE, UNIQUE_SQLITE)
        }
        Engine::Postgres => {
            let unproven = names(store, NOT_VALIDATED_POSTGRES).await?;
            unproven.into_iter().for_each(|name| {
                check.add_violation(format!("constraint {name} is not validated"))
            });
            (OBJECTS_POSTGRES, UNIQUE_POSTGRES)
        }
    };
    let (objects, unique) = (names(store, objects).await?, names(store, unique).await?);
    for (name, found) in GUARDS
        .iter()
        .map(|name| (name, &objects))
        .chain(UNIQUE.iter().map(|name| (name, &unique)))
    {
        check.n_examined += 1;
        check.require(found.iter().any(|object| object == name), || {
            format!("the schema has lost {name}")
        });
    }
    Ok(check)
}
