//! Checks the store's promises I1 to I9. Only reads, and may run at the same time as a server.

mod chain;
mod check;
mod content;
mod rules;
mod schema;

pub use check::{Check, MAX_LISTED, Options};

use super::{Result, Store, audit};

/// Maximum number of runs while a server changes the database. The result of the last run counts.
const MAX_RUNS: usize = 5;

pub(super) const ALL_QUERIES: &[&str] = &[
    content::SETS,
    content::FRAMES,
    content::NETWORKS,
    content::RESIDUAL_NETWORKS,
    content::REPORTS,
    content::CONVERGENCES,
    content::JOBS,
    content::ANSWERS,
    content::IS_THERE,
    content::ENDS,
    content::STUCK,
    content::SETS_OF_JOBS,
    content::RELEASED_OF_ROBOTS,
    content::RELEASES,
    chain::MISSING,
];
pub(super) const QUERIES_SQLITE: &[&str] = schema::QUERIES_SQLITE;
pub(super) const QUERIES_POSTGRES: &[&str] = schema::QUERIES_POSTGRES;

/// Runs every check, in order. If a check fails and the chain has grown in the meantime, all checks run again, because rows look inconsistent if a
/// server changes them between two queries.
///
/// # Errors
/// [`super::Error::Database`] if the database cannot be read at all.
pub async fn verify(store: &Store, options: &Options) -> Result<Vec<Check>> {
    for _ in 1..MAX_RUNS {
        let head = audit::head(store).await?;
        let checks = verify_once(store, options).await?;
        if checks.iter().all(|check| check.n_violations == 0)
            || audit::head(store).await?.seq == head.seq
        {
            return Ok(checks);
        }
    }
    verify_once(store, options).await
}

async fn verify_once(store: &Store, options: &Options) -> Result<Vec<Check>> {
    let chain = chain::read(store, options).await?;
    Ok(vec![
        content::uploads_read_back(store, &chain).await?,
        content::answers_have_effects(store, &chain).await?,
        content::jobs_end_once(store, &chain, options).await?,
        content::one_set_per_job(store).await?,
        content::same_request_same_result(store, &chain).await?,
        content::one_released_per_robot(store).await?,
        content::releases_have_checks(store, &chain).await?,
        chain.check,
        schema::is_sound(store).await?,
    ])
}
