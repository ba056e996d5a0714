//! Checks I1 to I7: compare rows with their hashes and with the audit chain.

use std::collections::BTreeMap;

use super::chain::{Chain, created_rows};
use super::check::{BATCH, Check, DOCUMENT_BATCH, Options};
use super::rules;
use crate::store::from_row::row;
use crate::store::id_prefix::IdPrefix;
use crate::store::idempotency::{self, AnsweredKey, IdempotencyScope};
use crate::store::jobs::further_set_ids;
use crate::store::report_summaries::SummaryOfReport;
use crate::store::sql::{self, values};
use crate::store::{AuditEvent, Result, Store, parameter_sets, report_summaries};
use crate::wire::canonical::sha256_hex;
use crate::wire::report_summary::summary_json;
use serde::Deserialize;
use serde_json::Value;

pub(super) const SETS: &str = "select id, sha256, body from measurement_set where id > $1 order by id limit cast($2 as bigint)";
pub(super) const FRAMES: &str = "select id, cast('' as text), body from frames where id > $1 order by id limit cast($2 as bigint)";
pub(super) const NETWORKS: &str = "select id, cast('' as text), weights from network where id > $1 order by id limit cast($2 as bigint)";
pub(super) const RESIDUAL_NETWORKS: &str = "select id, cast('' as text), weights from residual_network where id > $1 order by id limit cast($2 as bigint)";
pub(super) const REPORTS: &str = "select id, report_json from job where status = 'succeeded' and id > $1 order by id limit cast($2 as bigint)";
pub(super) const CONVERGENCES: &str = "
    select id, coalesce(convergence_json, '') from job where status = 'succeeded' and id > $1 order by id limit cast($2 as bigint)";
pub(super) const JOBS: &str = concat!(
    "
    select id, robot_id, measurement_set_id, coalesce(verify_set_id, '') as verify_set_id, coalesce(frames_id, '') as frames_id,
        coalesce(network_input_id, '') as network_input_id, coalesce(residual_network_input_id, '') as residual_network_input_id,
        coalesce(parameter_set_input_id, '') as parameter_set_input_id, request_json, report_json, coalesce(result_sha256, '') as result_sha256,
        coalesce((select v.version from job_robot_version v where v.job_id = job.id), 1) as robot_version,
        ",
    further_set_ids!(),
    " as further_set_ids
    from job where status = 'succeeded' and id > $1 order by id limit cast($2 as bigint)"
);
pub(super) const ANSWERS: &str = "
    select key_holder, method, path, idempotency_key, request_sha256, status, location, content_type, response_body from idempotency
    where (key_holder, method, path, idempotency_key) > ($1, $2, $3, $4)
    order by key_holder, method, path, idempotency_key limit cast($5 as bigint)";
pub(super) const IS_THERE: &str = concat!(
    "select count(*) from (",
    created_rows!(),
    ") as things where id = $1"
);
pub(super) const ENDS: &str = "
    select id, status, created_at_ms, (select count(*) from parameter_set p where p.job_id = job.id)
    from job where id > $1 order by id limit cast($2 as bigint)";
pub(super) const STUCK: &str = "
    select id from job where status = 'running' and lease_until_ms < (select now_ms from clock) - $1 order by id";
pub(super) const SETS_OF_JOBS: &str = "select job_id, count(*) from parameter_set group by job_id";
pub(super) const RELEASED_OF_ROBOTS: &str = "
    select robot_id, count(*) from parameter_set where status = 'released' group by robot_id";
pub(super) const RELEASES: &str = "
    select id, status, coalesce(release_checks_json, '') as checks_json, released_at_ms, release_n_passed, release_n_failed from parameter_set
    where released_at_ms is not null order by id";

/// A job is stuck if its lease expired longer ago than this, ms. Workers check leases every second, and even a busy machine does not delay this by a
/// minute.
const STUCK_AFTER_MS: i64 = 60_000;

/// I1: uploads and documents have the hashes that were stored when they were acknowledged.
pub(super) async fn uploads_read_back(store: &Store, chain: &Chain) -> Result<Check> {
    let mut check = Check::new(
        "I1",
        "every acknowledged upload, request and result reads back bit for bit",
    );
    let (readers, mut found) = (store.readers(), 0);
    let kept = [
        (SETS, AuditEvent::MeasurementSetCreated),
        (FRAMES, AuditEvent::FramesCreated),
        (NETWORKS, AuditEvent::NetworkCreated),
        (RESIDUAL_NETWORKS, AuditEvent::NetworkCreated),
    ];
    for (query, event) in kept {
        let field = EntryField {
            event,
            name: "sha256",
        };
        let examine = |(id, kept, body): (String, String, Vec<u8>)| {
            found += 1;
            let now = sha256_hex(&body);
            check.require(kept.is_empty() || kept == now, || {
                format!("{id}: its bytes do not match its hash")
            });
            compare_with_entry(&mut check, chain, &id, field, &now);
        };
        sql::for_each_row(readers, query, DOCUMENT_BATCH, |row| &row.0, examine).await?;
    }
    let documents = [
        (REPORTS, AuditEvent::JobSucceeded, "report_sha256"),
        (CONVERGENCES, AuditEvent::JobSucceeded, "convergence_sha256"),
        (
            parameter_sets::ESTIMATES,
            AuditEvent::ParameterSetCreated,
            "estimate_sha256",
        ),
    ];
    for (query, event, name) in documents {
        let field = EntryField { event, name };
        let examine = |(id, document): (String, String)| {
            found += 1;
            let now = sha256_hex(document.as_bytes());
            compare_with_entry(&mut check, chain, &id, field, &now);
        };
        sql::for_each_row(readers, query, DOCUMENT_BATCH, |row| &row.0, examine).await?;
    }
    check.n_examined = found;
    compare_summaries(&mut check, store).await?;
    rules::match_entries(&mut check, store, chain).await?;
    check_lost_rows(&mut check, store, chain).await?;
    Ok(check)
}

/// Compares each summary with its report. The order of fields does not count.
async fn compare_summaries(check: &mut Check, store: &Store) -> Result<()> {
    let examine = |row: SummaryOfReport| {
        check.n_examined += 1;
        let expected = summary_json(&row.report_json).ok();
        let is_same = expected.is_some_and(|expected| {
            let [expected, found] =
                [&expected, &row.summary_json].map(|text| serde_json::from_str::<Value>(text));
            matches!((expected, found), (Ok(expected), Ok(found)) if expected == found)
        });
        check.require(is_same, || {
            format!("{}: its summary does not match its report", row.job_id)
        });
    };
    let query = report_summaries::BY_ID;
    sql::for_each_row(
        store.readers(),
        query,
        DOCUMENT_BATCH,
        |row| &row.job_id,
        examine,
    )
    .await
}

/// A field of the newest entry of an event.
#[derive(Clone, Copy)]
struct EntryField {
    event: AuditEvent,
    name: &'static str,
}

/// Compares a hash with the chain. Rows that are older than the chain or than this field are skipped; I8 reports missing entries.
fn compare_with_entry(check: &mut Check, chain: &Chain, id: &str, field: EntryField, now: &str) {
    if let Some(then) = chain.field_of_newest(id, field.event, field.name) {
        check.require(then == now, || {
            format!("{id}: it is not what was acknowledged")
        });
    }
}

/// Checks that every row whose creation is in the chain still exists.
async fn check_lost_rows(check: &mut Check, store: &Store, chain: &Chain) -> Result<()> {
    for id in chain.events.keys() {
        if chain.was_created(id) && !row_exists(store, id).await? {
            check.add_violation(format!("{id} was acknowledged and is gone"));
        }
    }
    Ok(())
}

async fn row_exists(store: &Store, id: &str) -> Result<bool> {
    if IdPrefix::from_id(id).is_none() {
        return Ok(true);
    }
    let n: i64 = sql::value(store.readers(), IS_THERE, values![id]).await?;
    Ok(n == 1)
}

/// I2: the stored answer to an Idempotency-Key and the effect of the request agree, because one transaction wrote both. A missing answer cannot be
/// detected, because answers are deleted after a week.
pub(super) async fn answers_have_effects(store: &Store, chain: &Chain) -> Result<Check> {
    let mut check = Check::new(
        "I2",
        "a request takes effect completely or not at all, and once per Idempotency-Key",
    );
    let mut after = IdempotencyScope::default();
    loop {
        let values = values![after.holder, after.method, after.path, after.key, BATCH];
        let rows: Vec<AnsweredKey> = sql::all(store.readers(), ANSWERS, values).await?;
        let Some(last) = rows.last() else {
            return Ok(check);
        };
        after = last.scope.clone();
        for AnsweredKey { scope, answer } in rows {
            check.n_examined += 1;
            let IdempotencyScope {
                method, path, key, ..
            } = &scope;
            let Some(answer) = answer else {
                check.add_violation(format!(
                    "{method} {path} with key {key:?} was begun and never answered"
                ));
                continue;
            };
            let (request, now) = idempotency::hashes(&scope, &answer);
            let is_as_given = chain.answers.get(&request).is_none_or(|then| *then == now);
            check.require(is_as_given, || {
                format!("{method} {path} with key {key:?}: the stored answer is not the one sent")
            });
            if let Some(id) = answer
                .location
                .as_deref()
                .and_then(|location| location.rsplit('/').next())
            {
                check.require(row_exists(store, id).await?, || {
                    format!("{method} {path} with key {key:?} was answered with {id}, which is not there")
                });
            }
        }
    }
}

/// I3: the chain has exactly one end for each job that has ended, and no end for any other job. No job runs long after its lease has expired.
pub(super) async fn jobs_end_once(
    store: &Store,
    chain: &Chain,
    options: &Options,
) -> Result<Check> {
    let mut check = Check::new(
        "I3",
        "every accepted job ends in exactly one state, and none is stuck",
    );
    let examine = |(id, status, created_at_ms, n_sets): (String, String, i64, i64)| {
        check.n_examined += 1;
        let ended = |event: AuditEvent| chain.entries(&id, event).count();
        let ends = [
            ("succeeded", ended(AuditEvent::JobSucceeded)),
            ("failed", ended(AuditEvent::JobFailed)),
            ("cancelled", ended(AuditEvent::JobCancelled)),
        ];
        let n_ends: usize = ends.iter().map(|(_, n)| n).sum();
        let is_over = ends.iter().any(|(end, _)| *end == status);
        if created_at_ms > chain.begun_at_ms {
            check.require(n_ends == usize::from(is_over), || {
                format!("{id} is {status} and has ended {n_ends} times")
            });
            let agrees = !is_over || ends.contains(&(status.as_str(), 1));
            check.require(agrees, || {
                format!("{id} is {status}, but ended otherwise in the audit chain")
            });
        }
        check.require(n_sets == 0 || status == "succeeded", || {
            format!("{id} is {status} and has a parameter set")
        });
    };
    sql::for_each_row(store.readers(), ENDS, BATCH, |row| &row.0, examine).await?;
    if options.is_served {
        let values = values![STUCK_AFTER_MS];
        let stuck: Vec<String> = sql::all_values(store.readers(), STUCK, values).await?;
        stuck.into_iter().for_each(|id| {
            check.add_violation(format!(
                "{id} is stuck: its lease ran out over a minute ago"
            ))
        });
    }
    Ok(check)
}

/// I4: a job has at most one parameter set.
pub(super) async fn one_set_per_job(store: &Store) -> Result<Check> {
    let check = Check::new("I4", "a job has at most one parameter set");
    at_most_one(check, store, SETS_OF_JOBS, "parameter sets").await
}

async fn at_most_one(
    mut check: Check,
    store: &Store,
    counts: &'static str,
    what: &str,
) -> Result<Check> {
    let counts: Vec<(String, i64)> = sql::all(store.readers(), counts, values![]).await?;
    for (id, n) in counts {
        check.n_examined += 1;
        check.require(n == 1, || format!("{id} has {n} {what}"));
    }
    Ok(check)
}

row! {
    /// A succeeded job: all inputs that determine its result, and the result. An absent input is an empty text.
    struct SucceededJob {
        id: String,
        robot_id: String,
        measurement_set_id: String,
        further_set_ids: String,
        verify_set_id: String,
        frames_id: String,
        network_input_id: String,
        residual_network_input_id: String,
        parameter_set_input_id: String,
        request_json: String,
        report_json: String,
        result_sha256: String,
        robot_version: i64,
    }
}

/// The fields of a report that I5 compares. Other fields are skipped during parsing.
#[derive(Default, Deserialize)]
struct ReportOrigin {
    result_sha256: String,
    version: String,
}

/// I5: equal inputs have equal results.
pub(super) async fn same_request_same_result(store: &Store, chain: &Chain) -> Result<Check> {
    let mut check = Check::new(
        "I5",
        "the same request, seed and version gives the same bytes",
    );
    let mut results: BTreeMap<String, (String, String)> = BTreeMap::new();
    let examine = |job: SucceededJob| {
        let SucceededJob {
            id, result_sha256, ..
        } = job;
        check.n_examined += 1;
        let report: ReportOrigin = serde_json::from_str(&job.report_json).unwrap_or_default();
        check.require(report.result_sha256 == result_sha256, || {
            format!("{id}: its report does not match its result hash")
        });
        let field = EntryField {
            event: AuditEvent::JobSucceeded,
            name: "result_sha256",
        };
        compare_with_entry(&mut check, chain, &id, field, &result_sha256);
        let inputs = serde_json::json!([
            job.robot_id,
            job.robot_version,
            job.measurement_set_id,
            job.further_set_ids,
            job.verify_set_id,
            job.frames_id,
            job.network_input_id,
            job.residual_network_input_id,
            job.parameter_set_input_id,
            job.request_json,
            report.version
        ])
        .to_string();
        let (first, expected) = results
            .entry(inputs)
            .or_insert_with(|| (id.clone(), result_sha256.clone()));
        check.require(*expected == result_sha256, || {
            format!("{id} and {first} have equal inputs and different results")
        });
    };
    sql::for_each_row(
        store.readers(),
        JOBS,
        DOCUMENT_BATCH,
        |row| &row.id,
        examine,
    )
    .await?;
    Ok(check)
}

/// I6: a robot has at most one released parameter set.
pub(super) async fn one_released_per_robot(store: &Store) -> Result<Check> {
    let check = Check::new("I6", "a robot has at most one released parameter set");
    at_most_one(check, store, RELEASED_OF_ROBOTS, "released parameter sets").await
}

row! {
    /// A parameter set that was released at least once.
    struct Released {
        id: String,
        status: String,
        checks_json: String,
        released_at_ms: i64,
        release_n_passed: Option<i64>,
        release_n_failed: Option<i64>,
    }
}

/// I7: the checks of a release are stored, all of them passed, and their hash is in the chain.
pub(super) async fn releases_have_checks(store: &Store, chain: &Chain) -> Result<Check> {
    let mut check = Check::new("I7", "no release without its checks");
    let rows: Vec<Released> = sql::all(store.readers(), RELEASES, values![]).await?;
    for row in rows {
        let Released {
            id,
            status,
            checks_json,
            ..
        } = row;
        check.n_examined += 1;
        let checks: Vec<Value> = serde_json::from_str(&checks_json).unwrap_or_default();
        check.require(!checks.is_empty(), || {
            format!("{id} is {status} without checks")
        });
        check.require(checks.iter().all(|gate| gate["passed"] == true), || {
            format!("{id} is {status} in spite of a gate that failed")
        });
        let n = |passed: bool| {
            checks
                .iter()
                .filter(|gate| gate["passed"] == passed)
                .count() as i64
        };
        let (n_passed, n_failed) = (row.release_n_passed, row.release_n_failed);
        // Older versions did not store the counts.
        let is_counted = (n_passed, n_failed) == (Some(n(true)), Some(n(false)))
            || (n_passed, n_failed) == (None, None);
        check.require(is_counted, || {
            format!("{id}: its gates do not match their stored counts")
        });
        if row.released_at_ms > chain.begun_at_ms {
            let in_chain =
                chain.field_of_newest(&id, AuditEvent::ParameterSetReleased, "checks_sha256");
            let is_in_chain =
                in_chain.as_deref() == Some(sha256_hex(checks_json.as_bytes()).as_str());
            check.require(is_in_chain, || {
                format!("{id} is {status}, but its checks do not match the audit chain")
            });
        }
    }
    Ok(check)
}
