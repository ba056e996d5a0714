//! Computes data that older versions of kincal did not store when a job ended: the summaries of reports, and verification facts. Runs once at start,
//! before the server accepts requests.

use crate::jobs::JobInputs;
use crate::jobs::execution::run_verification;
use crate::jobs::measurement_age::measurement_age;
use crate::jobs::queue;
use crate::jobs::request::{parse_requests, parse_uploads};
use crate::release::facts::{identification_facts, missing_misfit_warning};
use crate::release::independence::is_verified_anew;
use crate::store::{Result, Store, jobs, report_summaries, robots, verifications};
use crate::wire::report_shape::Report;
use crate::wire::report_summary::summary_json;
use crate::wire::verification::Verification;
use std::ops::ControlFlow;

/// Maximum number of summaries that are stored in one transaction.
const SUMMARIES: i64 = 100;

/// Stores everything that is missing.
pub async fn backfill_missing(store: &Store) -> Result<()> {
    backfill_summaries(store).await?;
    backfill_facts(store).await
}

/// Stores all missing summaries. A report that cannot be read gets no summary, and is logged.
async fn backfill_summaries(store: &Store) -> Result<()> {
    let mut after = String::new();
    loop {
        let without = report_summaries::jobs_without(store, &after, SUMMARIES).await?;
        let Some(last) = without.last() else {
            return Ok(());
        };
        after.clone_from(last);
        tracing::info!(
            n_jobs = without.len(),
            "summarising reports of an older version, once"
        );
        let mut summaries: Vec<(String, String)> = Vec::new();
        for job_id in without {
            let report = jobs::report(store, &job_id).await?;
            match tokio::task::spawn_blocking(move || summary_json(&report)).await {
                Ok(Ok(summary)) => summaries.push((job_id, summary)),
                Ok(Err(_)) | Err(_) => tracing::error!(job_id, "this report cannot be read"),
            }
        }
        let mut tx = store.begin().await?;
        for (job_id, summary) in &summaries {
            report_summaries::insert(&mut tx, job_id, summary).await?;
        }
        tx.commit().await?;
    }
}

/// Stores all missing facts, in the order in which the jobs ended. A job that cannot be read is skipped and logged; its set cannot be released.
async fn backfill_facts(store: &Store) -> Result<()> {
    let without = verifications::jobs_without_facts(store).await?;
    if !without.is_empty() {
        tracing::info!(
            n_jobs = without.len(),
            "computing verification facts of jobs that an older version has ended, once"
        );
    }
    for job_id in without {
        let inputs = JobInputs::load(store, &job_id)
            .await?
            .with_known_uploads(store)
            .await?;
        let report = jobs::report(store, &job_id).await?;
        let found = tokio::task::spawn_blocking(move || compute_facts(&inputs, &report));
        match found.await {
            Ok(Some(found)) => store_facts(store, &job_id, &found).await?,
            Ok(None) | Err(_) => tracing::error!(
                job_id,
                "the verification facts of this job cannot be computed; its parameter set cannot be released"
            ),
        }
    }
    Ok(())
}

async fn store_facts(store: &Store, job_id: &str, found: &Verification) -> Result<()> {
    let mut tx = store.begin().await?;
    robots::lock_of_job(&mut tx, job_id).await?;
    queue::record_facts(&mut tx, job_id, found).await?;
    tx.commit().await
}

/// Facts of one job. A session is scored again, which is quick. For an identification, the facts are taken from its report.
fn compute_facts(inputs: &JobInputs, report: &str) -> Option<Verification> {
    let (body, request) = parse_requests(inputs).ok()?;
    if inputs.job.kind.scores() {
        let outcome = run_verification(&body, &request, inputs, &mut |_| ControlFlow::Continue(()));
        return outcome.ok()?.verification;
    }
    let mut report: Report = serde_json::from_str(report).ok()?;
    report
        .warnings
        .extend(missing_misfit_warning(&request, &report));
    let age = measurement_age(inputs, &request);
    let sources = parse_uploads(&inputs.sources, &request).ok()?;
    Some(identification_facts(
        &request,
        &report,
        is_verified_anew(&request, &sources),
        age,
    ))
}
