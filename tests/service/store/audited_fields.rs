//! Every field that the audit chain covers: `verify-store` reports an edit of it. Entries of earlier versions cover fewer fields.

use kincal::store::verify::{Options, verify};
use kincal::store::{AuditRow, Engine, Store, audit};
use kincal::wire::canonical::sha256_hex;
use serde_json::{Value, json};
use sqlx::AssertSqlSafe;

use crate::engines::for_each_engine;
use crate::fixtures::{a_robot, a_set};
use crate::store::verify::insert_examples;

/// What an attacker writes into a column, and the field that is reported.
#[derive(Debug)]
struct Edit {
    table: &'static str,
    column: &'static str,
    value: &'static str,
    field: &'static str,
}

/// Reads `table | column | value | field`, one edit a line. Without a field, the column's name is reported.
fn edits(lines: &'static str) -> Vec<Edit> {
    let edit = |line: &'static str| {
        let mut cells = line.split('|').map(str::trim);
        let [table, column, value] = [(); 3].map(|()| cells.next().expect(line));
        Edit {
            table,
            column,
            value,
            field: cells.next().unwrap_or(column),
        }
    };
    lines.trim().lines().map(edit).collect()
}

/// Fields that entries have had from the beginning.
const KNOWN: &str = "
    robot | body_json | '[]' | sha256
    robot | check_job_id | 'job_0' | says
    measurement_set | uploaded_by | 'key_0'
    measurement_set | sha256 | 'ff'
    measurement_set | robot_id | (select max(id) from robot)
    frames | result_json | '[]' | result_sha256
    robot | check_seq | check_seq + 1 | says
    verification | parameter_set_id | null
    verification | kind | 'session'
    verification | seq | seq + 7
    verification | n_points | 9
    verification | before_rms_mm | 9.0
    verification | after_rms_mm | 0.01
    verification | is_better | 0
    verification | fit | 'fits'
    verification | evidence | 'independent_session'
    verification | is_repeat | 1
    verification | check_seq | 1
    verification | uncertainty_mm | 0.01 | verified_uncertainty_mm
    network | job_id | (select max(id) from job)
    parameter_set | body_json | '[]' | body_sha256
    parameter_set | sha256 | 'ff'
    parameter_set | released_by | 'key_0'
    parameter_set | released_by | null
    parameter_set | release_reason | 'other' | reason
    parameter_set | release_checks_json | '[{\"passed\":true},{\"passed\":true}]' | checks_sha256
    parameter_set | release_n_passed | release_n_passed + 1 | counts
    parameter_set | release_n_failed | release_n_failed + 1 | counts
    parameter_set | release_evidence | 'independent_session' | evidence
    parameter_set | withdrawn_by | 'key_0'
    parameter_set | withdraw_reason | 'other' | reason
    parameter_set | status | case when status = 'superseded' then 'candidate' else status end | superseded
    job | measurement_set_id | (select max(id) from measurement_set)
    job | request_json | '[]' | request_sha256
    report_summary | summary_json | '[]' | summary
    named_document | content_json | case when kind = 'columns' then '[]' else content_json end | columns_sha256
    named_document | content_json | case when kind = 'tool' then '[]' else content_json end | content_sha256
    named_document | name | 'other'
    named_document | version | version + 1
    named_document | kind | case when kind = 'tool' then 'work_frame' else kind end
    named_document | created_by | 'key_9'
    estimate | estimate_json | '[]' | acknowledged
    robot_policy | changed_by | 'key_9'
    robot_policy | tolerance_mm | 9.5
    api_key | name | 'other'
";

/// Fields that were added later.
const NEW: &str = "
    robot | name | 'other'
    robot | created_at_ms | created_at_ms + 1
    measurement_set | uploaded_by | null
    measurement_set | frame | 'instrument'
    measurement_set | serial_number | 'other'
    measurement_set | content_type | 'application/json'
    measurement_set | name | 'other' | rest_sha256
    measurement_set | n_points | 9 | rest_sha256
    measurement_set | n_configurations | 9 | rest_sha256
    measurement_set | n_targets | 9 | rest_sha256
    measurement_set | warnings_json | '[1]' | rest_sha256
    measurement_set | created_at_ms | created_at_ms + 1 | rest_sha256
    named_document | created_at_ms | 1
    frames | content_type | 'other'
    network | metadata_json | '[]' | metadata_sha256
    network | weights_sha256 | 'ff'
    network | model | 'complete'
    residual_network | metadata_json | '[]' | metadata_sha256
    parameter_set | release_uncertainty_mm | case when release_uncertainty_mm > 0 then 0.05 end | uncertainty_mm
    parameter_set | release_seq | release_seq + 7
    parameter_set | supersedes_id | id
    parameter_set | released_at_ms | released_at_ms - 1
    parameter_set | withdrawn_at_ms | withdrawn_at_ms - 1
    job | verify_set_id | measurement_set_id
    job | frames_id | (select max(id) from frames)
    job | network_input_id | (select max(id) from network)
    job | residual_network_input_id | (select max(id) from residual_network)
    job | parameter_set_input_id | (select max(id) from parameter_set)
    job | kind | 'verify' | rest_sha256
    job | method | 'other' | rest_sha256
    job | priority | 9 | rest_sha256
    job | client | 'key_9' | rest_sha256
    job | error_json | case when status = 'failed' then '[]' end | error_sha256
    robot_policy | changed_at_ms | 1
    api_key | created_at_ms | 1
";

/// Fields of [`NEW`], and those of the actor.
const NEW_FIELDS: &[&str] = &[
    "created_at_ms",
    "uploaded_by",
    "frame",
    "serial_number",
    "content_type",
    "rest_sha256",
    "metadata_sha256",
    "weights_sha256",
    "model",
    "preset",
    "uncertainty_mm",
    "released_by",
    "released_at_ms",
    "n_passed",
    "n_failed",
    "release_seq",
    "supersedes_id",
    "withdrawn_by",
    "withdrawn_at_ms",
    "verify_set_id",
    "frames_id",
    "network_input_id",
    "residual_network_input_id",
    "parameter_set_input_id",
    "error_sha256",
    "changed_by",
    "changed_at_ms",
    "revoked_at_ms",
    "answered",
];

async fn run(store: &Store, sql: &str) {
    let done = sqlx::query(AssertSqlSafe(sql.to_owned()))
        .execute(store.readers())
        .await;
    done.unwrap_or_else(|error| panic!("{sql}: {error}"));
}

/// Edits a row as somebody with the database's password could.
async fn drop_triggers(store: &Store) {
    let find = match store.engine() {
        Engine::Sqlite => "select 'drop trigger ' || name from sqlite_master where type = 'trigger'",
        Engine::Postgres => {
            "select distinct 'alter table ' || c.relname || ' disable trigger user' from pg_trigger t join pg_class c on c.oid = t.tgrelid
             join pg_namespace n on n.oid = c.relnamespace where n.nspname = current_schema()"
        }
    };
    let statements: Vec<String> = sqlx::query_scalar(find)
        .fetch_all(store.readers())
        .await
        .unwrap();
    assert!(!statements.is_empty());
    for sql in statements {
        run(store, &sql).await;
    }
}

/// The violations, without those about the removed triggers.
async fn violations(store: &Store) -> Vec<String> {
    let checks = verify(store, &Options::default()).await.unwrap();
    checks
        .into_iter()
        .filter(|check| check.id != "I9")
        .flat_map(|check| check.violations)
        .collect()
}

/// The violations that an edit causes; the edit is undone afterwards.
async fn violations_of(store: &Store, edit: &Edit) -> Vec<String> {
    let Edit {
        table,
        column,
        value,
        ..
    } = edit;
    let id = match *table {
        "robot_policy" => "robot_id",
        "verification" | "report_summary" => "job_id",
        "estimate" => "parameter_set_id",
        _ => "id",
    };
    run(
        store,
        &format!("create table kept as select {id} as subject, {column} as was from {table}"),
    )
    .await;
    run(store, &format!("update {table} set {column} = {value}")).await;
    let violations = violations(store).await;
    run(
        store,
        &format!(
            "update {table} set {column} = (select was from kept where subject = {table}.{id})"
        ),
    )
    .await;
    run(store, "drop table kept").await;
    violations
}

async fn assert_each_is_reported(store: &Store, edits: &[Edit]) {
    for edit in edits {
        let Edit { field, .. } = edit;
        let violations = violations_of(store, edit).await;
        assert!(
            violations
                .iter()
                .any(|what| what.contains(&format!(" {field} ")) || what.ends_with(field)),
            "{edit:?}: {violations:?}"
        );
    }
    assert_eq!(
        violations(store).await,
        [""; 0],
        "nothing is left of the edits"
    );
}

#[test]
fn each_fault_is_told_in_whatever_field_it_is() {
    for_each_engine(async |database| {
        let store = &database.store;
        insert_examples(store, &a_set(store, &a_robot(store, "r").await).await).await;
        drop_triggers(store).await;
        assert_each_is_reported(store, &edits(KNOWN)).await;
        assert_each_is_reported(store, &edits(NEW)).await;
    });
}

/// Rewrites the chain as an earlier version wrote it, without the new fields.
async fn rewrite_as_earlier_version(store: &Store) {
    let mut before = String::new();
    for mut row in audit::list(store, 0, 1000).await.unwrap() {
        let mut detail: Value = serde_json::from_str(&row.detail_json).unwrap();
        let fields = detail.as_object_mut().unwrap();
        NEW_FIELDS
            .iter()
            .for_each(|field| drop(fields.remove(*field)));
        if row.event == "robot_created" {
            fields.remove("name");
        }
        row.detail_json = detail.to_string();
        let AuditRow {
            seq,
            at_ms,
            actor,
            event,
            subject,
            detail_json,
            ..
        } = &row;
        let sha256 = sha256_hex(
            json!([before, seq, at_ms, actor, event, subject, detail_json])
                .to_string()
                .as_bytes(),
        );
        let update = sqlx::query("update audit set detail_json = $1, sha256 = $2 where seq = $3")
            .bind(detail_json)
            .bind(&sha256)
            .bind(seq);
        update.execute(store.readers()).await.unwrap();
        before = sha256;
    }
    sqlx::query("update audit_head set sha256 = $1")
        .bind(before)
        .execute(store.readers())
        .await
        .unwrap();
}

#[test]
fn databases_from_before_are_whole_and_what_their_entries_say_is_compared() {
    for_each_engine(async |database| {
        let store = &database.store;
        insert_examples(store, &a_set(store, &a_robot(store, "r").await).await).await;
        drop_triggers(store).await;
        rewrite_as_earlier_version(store).await;
        assert_each_is_reported(store, &edits(KNOWN)).await;
        // A field without an entry cannot be compared, and is no violation.
        for edit in edits(NEW) {
            assert_eq!(violations_of(store, &edit).await, [""; 0], "{edit:?}");
        }
    });
}
