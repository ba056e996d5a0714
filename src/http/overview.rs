//! The overview: each robot with its most urgent need.

use crate::http::auth::Caller;
use crate::http::extract::Query;
use crate::http::history::scored_sessions;
use crate::http::list_query::NamedListQuery;
use crate::http::{App, Error};
use crate::jobs::evidence::{policy_in_force, session};
use crate::release::needs::{NeedFacts, need};
use crate::release::{self, LastMisfit, PointsSeq, StoredFacts, may_have_trend};
use crate::store::overview::{self, OverviewRow};
use crate::store::{VerificationRow, verifications};
use crate::wire::overview::{JobOverview, Need, RobotOverview, SessionOverview, SetOverview};
use crate::wire::page::Page;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::report_summary::ReportSummary;
use crate::wire::robot::{Robot, RobotBody};
use crate::wire::time::rfc3339;
use crate::wire::verification::{Fit, VerificationKind};
use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Every robot with its most urgent need and the reason. Newest robots first; a client can sort by the need.
#[utoipa::path(
    get, path = "/v1/overview", tag = "robots", operation_id = "getOverview", params(NamedListQuery),
    responses((status = 200, description = "One page", body = Page<RobotOverview>))
)]
pub async fn list(
    State(app): State<App>,
    caller: Caller,
    Query(query): Query<NamedListQuery>,
) -> Result<Json<Page<RobotOverview>>, Error> {
    let found = overview::list(&app.store, caller.robots.as_deref(), &query.request()?).await?;
    let ids: Vec<&str> = found.items.iter().map(|row| row.id.as_str()).collect();
    let mut facts_of: BTreeMap<String, Vec<VerificationRow>> = BTreeMap::new();
    for facts in verifications::of_newest_sets(&app.store, &ids).await? {
        if let Some(set) = facts.parameter_set_id.clone() {
            facts_of.entry(set).or_default().push(facts);
        }
    }
    let with_trend = found
        .items
        .iter()
        .filter(|row| may_have_trend(row.n_sessions));
    let with_trend: Vec<&str> = with_trend.map(|row| row.id.as_str()).collect();
    let scored_of = match with_trend.is_empty() {
        true => BTreeMap::new(),
        false => scored_sessions(&app, &with_trend).await?,
    };
    let mut items = Vec::with_capacity(found.items.len());
    for row in found.items {
        let of_newest = row.newest_id.as_ref().and_then(|id| facts_of.remove(id));
        let refused_by = first_refusal(&row, of_newest.unwrap_or_default())?;
        let scored = scored_of.get(&row.id);
        let days_to_limit =
            scored.and_then(|scored| release::trend(scored, row.policy.tolerance_mm).days_to_limit);
        items.push(robot_overview(row, days_to_limit, refused_by)?);
    }
    Ok(Json(Page {
        items,
        next_cursor: found.next_cursor.map(|cursor| cursor.to_string()),
        total: found.total,
    }))
}

/// The part of a robot's document that the overview shows.
#[derive(Deserialize)]
struct Document {
    #[serde(default)]
    serial_number: Option<String>,
}

/// The first gate that refuses the newest set by stored facts, if the set is a candidate.
fn first_refusal(row: &OverviewRow, of_set: Vec<VerificationRow>) -> Result<Option<String>, Error> {
    if row.newest_status != Some(ParameterSetStatus::Candidate) {
        return Ok(None);
    }
    let is_session = |facts: &VerificationRow| facts.found.kind == VerificationKind::Session;
    let (sessions, identified): (Vec<_>, Vec<_>) = of_set.into_iter().partition(is_session);
    let Some(identified) = identified.into_iter().next() else {
        return Ok(None);
    };
    // No session is outdated: this list does not read when the points were uploaded.
    let sessions = sessions.into_iter();
    let sessions: Vec<_> = sessions
        .map(|facts| session(identified.frame, PointsSeq::default(), facts))
        .collect();
    let body: RobotBody = serde_json::from_str(&row.body_json)?;
    // A robot that an older version stored may fail today's checks.
    let Ok(robot) = Robot::try_from(&body) else {
        return Ok(None);
    };
    let last_misfit = (row.misfit_seq > 0).then(|| LastMisfit {
        seq: row.misfit_seq,
        job_id: String::new(),
    });
    let refused = release::first_refusal(&StoredFacts {
        robot: &robot,
        check_job_id: row.check_job_id.as_deref(),
        last_misfit: last_misfit.as_ref(),
        checked_seq: row.checked_seq,
        identification: &identified.found,
        identification_seq: identified.seq,
        sessions: &sessions,
        has_other_joint_map: row.newest_has_other_joint_map,
        insisted_on: row.newest_insisted_on.as_deref(),
        policy: &policy_in_force(&row.policy),
        report: &ReportSummary::default(),
    });
    Ok(refused.map(|gate| gate.gate))
}

fn robot_overview(
    row: OverviewRow,
    days_to_limit: Option<f64>,
    refused_by: Option<String>,
) -> Result<RobotOverview, Error> {
    let Document { serial_number } = serde_json::from_str(&row.body_json)?;
    let facts = need_facts(&row, days_to_limit, refused_by.clone());
    let (need, reason) = need(&facts);
    let need_job_id = match need {
        Need::CheckRobot => row.check_job_id.clone(),
        Need::Drifted | Need::Due => row.session_job_id.clone(),
        Need::Withdrawn => row.withdrawn_job_id.clone(),
        Need::JobFailed => row.job_id.clone(),
        Need::Review => row.newest_job_id.clone(),
        Need::Calibrate | Need::Nothing => None,
    };
    let session = row
        .session_job_id
        .zip(row.session_created_at_ms)
        .map(|(job_id, at_ms)| SessionOverview {
            job_id,
            created_at: rfc3339(at_ms),
            measured_at: release::stated_time(row.session_reading_json.as_deref()),
            rms_mm: row.session_rms_mm,
        });
    let active = row
        .active_id
        .zip(row.active_job_id)
        .map(|(id, job_id)| SetOverview {
            id,
            job_id,
            status: ParameterSetStatus::Released,
            created_at: rfc3339(row.active_created_at_ms.unwrap_or_default()),
            released_at: row.active_released_at_ms.map(rfc3339),
            before_rms_mm: row.active_before_rms_mm,
            after_rms_mm: row.active_after_rms_mm,
            evidence: row.active_evidence,
            refused_by: None,
            n_points: None,
        });
    let newest = row.newest_id.zip(row.newest_job_id).zip(row.newest_status);
    let newest = newest.map(|((id, job_id), status)| SetOverview {
        id,
        job_id,
        status,
        created_at: rfc3339(row.newest_created_at_ms.unwrap_or_default()),
        released_at: row.newest_released_at_ms.map(rfc3339),
        before_rms_mm: row.newest_before_rms_mm,
        after_rms_mm: row.newest_after_rms_mm,
        evidence: row.newest_evidence,
        refused_by,
        n_points: row.newest_n_points,
    });
    let last_job = row.job_id.zip(row.job_kind).zip(row.job_status);
    let last_job = last_job.map(|((id, kind), status)| JobOverview {
        id,
        kind,
        status,
        created_at: rfc3339(row.job_created_at_ms.unwrap_or_default()),
        finished_at: row.job_finished_at_ms.map(rfc3339),
    });
    Ok(RobotOverview {
        robot_id: row.id,
        name: row.name,
        serial_number,
        created_at: rfc3339(row.created_at_ms),
        need,
        reason,
        need_job_id,
        active,
        newest,
        session,
        days_to_limit,
        last_job,
    })
}

fn need_facts(
    row: &OverviewRow,
    days_to_limit: Option<f64>,
    newest_refused_by: Option<String>,
) -> NeedFacts {
    let policy = policy_in_force(&row.policy);
    NeedFacts {
        must_be_checked: row.check_job_id.is_some(),
        tolerance_mm: policy.tolerance_mm,
        decision_rule: policy.decision_rule,
        released_rms_mm: row.active_after_rms_mm,
        is_released: row.active_id.is_some(),
        session_rms_mm: row.session_rms_mm,
        session_expanded_mm: row.session_expanded_mm,
        is_far_off: row.session_fit == Some(Fit::SetFarOff),
        no_better_than_mm: row.session_before_rms_mm.filter(|_| !row.session_is_better),
        is_worse: row.session_is_worse,
        // An absent set (`None`) counts as older than any other.
        has_newer: row.newest_created_at_ms > row.active_created_at_ms,
        is_withdrawn: row.withdrawn_job_id.is_some(),
        has_points: row.has_points,
        newest_refused_by,
        last_job: row.job_status,
        days_to_limit,
    }
}
