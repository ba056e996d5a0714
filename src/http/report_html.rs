//! A job's report as an HTML page for printing.

use crate::http::extract::Item;
use crate::http::history::session_times;
use crate::http::{App, Error, access};
use crate::jobs::evidence;
use crate::report_page::{self, MeasuredSet, ScoredSession, Sources};
use crate::store::{ParameterSetRow, jobs, policies, robot_versions, verifications};
use crate::wire::job_answer::JobAnswer;
use crate::wire::measurement::SetSummary;
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::time::rfc3339;
use axum::http::header;
use axum::response::{IntoResponse, Response};

/// Maximum number of scored sessions on the page.
const MAX_SESSIONS: usize = 20;

/// The report as one self-contained page for printing, without scripts and without requests.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/report.html", tag = "jobs", operation_id = "getReportPage", params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The page", body = String, content_type = "text/html"))
)]
pub async fn report_html(Item { app, caller, id }: Item) -> Result<Response, Error> {
    let job = access::job(&app, &caller, &id).await?;
    let robot = robot_versions::robot_at(&app.store, &job.robot_id, job.robot_version).await?;
    let mut sets = Vec::new();
    for set_id in job.set_ids() {
        sets.push(access::measurement_set(&app, &caller, set_id).await?);
    }
    let parameter_set = match &job.parameter_set_id {
        Some(id) => Some(access::parameter_set(&app, &caller, id).await?),
        None => None,
    };
    let sessions = match &parameter_set {
        Some(set) => scored_sessions(&app, set).await?,
        None => vec![],
    };
    let found = verifications::of_job(&app.store, &id).await?;
    let verified_expanded_mm = found.and_then(|row| row.found.after_expanded_mm);
    let policy = evidence::policy_in_force(&policies::get(&app.store, &job.robot_id).await?);
    let permit = app.limits.compute_permit(caller.class).await?;
    let (report, convergence) = (
        jobs::report(&app.store, &id).await?,
        jobs::convergence(&app.store, &id).await?,
    );
    let page = move || {
        let sets: Vec<SetSummary> = sets
            .iter()
            .map(SetSummary::try_from)
            .collect::<Result<_, _>>()?;
        let sets: Vec<MeasuredSet<'_>> = sets.iter().map(Into::into).collect();
        let (set, further_sets) = sets
            .split_first()
            .ok_or(Error::NotFound("measurement set"))?;
        Ok::<_, Error>(report_page::html(&Sources {
            robot: &access::robot_body(&robot)?,
            set: *set,
            further_sets,
            job: Some(&JobAnswer::try_from(&job)?),
            parameter_set: parameter_set
                .as_ref()
                .map(ParameterSetAnswer::try_from)
                .transpose()?
                .as_ref(),
            sessions: &sessions,
            verified_expanded_mm,
            tolerance_mm: policy.tolerance_mm,
            decision_rule: policy.decision_rule,
            report: &serde_json::from_str(&report)?,
            convergence: &serde_json::from_str(&convergence)?,
        }))
    };
    let page = permit.run(page).await?;
    let security_policy = report_page::CONTENT_SECURITY_POLICY.as_str();
    Ok((
        [
            (header::CONTENT_TYPE, "text/html; charset=utf-8"),
            (header::CONTENT_SECURITY_POLICY, security_policy),
        ],
        page,
    )
        .into_response())
}

/// The newest sessions that were scored with a parameter set.
async fn scored_sessions(app: &App, set: &ParameterSetRow) -> Result<Vec<ScoredSession>, Error> {
    let times = session_times(app, &set.id).await?;
    let sessions = evidence::scored_sessions(&app.store, set).await?;
    Ok(sessions
        .into_iter()
        .rev()
        .take(MAX_SESSIONS)
        .map(|session| ScoredSession {
            measured_at: rfc3339(times.get(&session.job_id).copied().unwrap_or_default()),
            session,
        })
        .collect())
}
