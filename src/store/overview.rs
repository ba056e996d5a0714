//! Overview of robots. Each robot comes with its released and its newest parameter set, its newest session and its newest job. One query reads a
//! whole page of robots.

use super::from_row::row;
use super::sql::{self, values};
use super::verifications::newest_set;
use super::{JobStatus, ListRequest, Page, PolicyRow, Result, Store, robots};
use crate::wire::job::Kind;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::report_shape::Evidence;
use crate::wire::verification::Fit;

pub(super) const ALL_QUERIES: &[&str] = &[LIST];

row! {
    /// One robot of the overview.
    #[derive(Clone, Debug, PartialEq)]
    #[allow(missing_docs)] // the columns of the tables that are joined
    pub struct OverviewRow {
        pub id: String,
        pub name: String,
        pub body_json: String,
        pub created_at_ms: i64,
        pub check_job_id: Option<String>,
        pub misfit_seq: i64,
        pub checked_seq: i64,
        pub policy: PolicyRow,
        pub active_id: Option<String>,
        pub active_job_id: Option<String>,
        pub active_created_at_ms: Option<i64>,
        pub active_released_at_ms: Option<i64>,
        pub active_before_rms_mm: Option<f64>,
        pub active_after_rms_mm: Option<f64>,
        pub active_evidence: Option<Evidence>,
        pub newest_id: Option<String>,
        pub newest_job_id: Option<String>,
        pub newest_status: Option<ParameterSetStatus>,
        pub newest_created_at_ms: Option<i64>,
        pub newest_released_at_ms: Option<i64>,
        pub newest_before_rms_mm: Option<f64>,
        pub newest_after_rms_mm: Option<f64>,
        pub newest_evidence: Option<Evidence>,
        pub newest_insisted_on: Option<String>,
        pub newest_has_other_joint_map: bool,
        pub newest_n_points: Option<i64>,
        pub session_job_id: Option<String>,
        pub session_created_at_ms: Option<i64>,
        pub session_reading_json: Option<String>,
        pub session_rms_mm: Option<f64>,
        pub session_expanded_mm: Option<f64>,
        pub session_fit: Option<Fit>,
        pub session_before_rms_mm: Option<f64>,
        pub session_is_better: bool,
        pub session_is_worse: bool,
        pub n_sessions: i64,
        pub withdrawn_job_id: Option<String>,
        pub has_points: bool,
        pub job_id: Option<String>,
        pub job_kind: Option<Kind>,
        pub job_status: Option<JobStatus>,
        pub job_created_at_ms: Option<i64>,
        pub job_finished_at_ms: Option<i64>,
    }
}

// $1 is a comma-separated list of robot ids, at most one page. The newest rows are found through the indexes of their tables. Archived
// items and items of archived jobs are left out, because they need no attention.
const LIST: &str = concat!(
    "
    select r.id as id, r.name as name, r.body_json as body_json, r.created_at_ms as created_at_ms, r.check_job_id as check_job_id,
        r.check_seq as misfit_seq, r.checked_seq as checked_seq,
        y.tolerance_mm as tolerance_mm, y.decision_rule as decision_rule,
        coalesce(y.independent_session_required, 0) as independent_session_required,
        coalesce(y.second_person_required, 0) as second_person_required, coalesce(y.version, 0) as version,
        a.id as active_id, a.job_id as active_job_id, a.created_at_ms as active_created_at_ms, a.released_at_ms as active_released_at_ms,
        va.before_rms_mm as active_before_rms_mm, va.after_rms_mm as active_after_rms_mm, va.evidence as active_evidence,
        n.id as newest_id, n.job_id as newest_job_id, n.status as newest_status, n.created_at_ms as newest_created_at_ms,
        n.released_at_ms as newest_released_at_ms,
        vn.before_rms_mm as newest_before_rms_mm, vn.after_rms_mm as newest_after_rms_mm, vn.evidence as newest_evidence,
        coalesce((select m.insisted_on from job k join measurement_set m on m.id = k.measurement_set_id where k.id = n.job_id),
            (select min(m.insisted_on) from job_session k join measurement_set m on m.id = k.measurement_set_id where k.job_id = n.job_id))
            as newest_insisted_on,
        case when coalesce((select v.joint_map_version from job_robot_version k join robot_version v on v.version = k.version
            where k.job_id = n.job_id and v.robot_id = n.robot_id), 1) = r.joint_map_version
            then cast(0 as bigint) else cast(1 as bigint) end as newest_has_other_joint_map,
        (select cast(sum(m.n_points) as bigint) from measurement_set m where m.id in
            (select k.measurement_set_id from job k where k.id = n.job_id union select k.measurement_set_id from job_session k where k.job_id = n.job_id))
            as newest_n_points,
        s.job_id as session_job_id, sj.created_at_ms as session_created_at_ms, s.after_rms_mm as session_rms_mm,
        sm.reading_json as session_reading_json,
        s.after_expanded_mm as session_expanded_mm, s.fit as session_fit, s.before_rms_mm as session_before_rms_mm,
        case when s.is_better = 0 and s.evidence <> 'none' then cast(0 as bigint) else cast(1 as bigint) end as session_is_better,
        coalesce(s.is_worse, 0) as session_is_worse,
        (select count(*) from verification w where w.parameter_set_id = a.id and w.kind = 'session') as n_sessions,
        case when a.id is null then (select w.job_id from parameter_set w where w.robot_id = r.id and w.status = 'withdrawn'
            and w.released_at_ms is not null and not exists (select 1 from archived x where x.id in (w.id, w.job_id))
            order by w.created_at_ms desc, w.id desc limit 1) end as withdrawn_job_id,
        case when exists (select 1 from measurement_set m where m.robot_id = r.id and not exists (select 1 from archived x where x.id = m.id))
            then cast(1 as bigint) else cast(0 as bigint) end as has_points,
        j.id as job_id, j.kind as job_kind, j.status as job_status, j.created_at_ms as job_created_at_ms, j.finished_at_ms as job_finished_at_ms
    from robot_now r
    left join robot_policy y on y.robot_id = r.id
    left join parameter_set a on a.robot_id = r.id and a.status = 'released'
    left join verification va on va.job_id = a.job_id
    left join parameter_set n on n.id = ",
    newest_set!(),
    "
    left join verification vn on vn.job_id = n.job_id
    left join verification s on s.job_id = (select w.job_id from verification w where w.parameter_set_id = a.id and w.kind = 'session'
        and w.fit <> 'does_not_fit' order by w.seq desc limit 1)
    left join job sj on sj.id = s.job_id
    left join measurement_set sm on sm.id = sj.measurement_set_id
    left join job j on j.id = (select k.id from job k where k.robot_id = r.id
        and not exists (select 1 from archived x where x.id = k.id) order by k.created_at_ms desc, k.id desc limit 1)
    where replace($1, r.id, '') <> $1"
);

/// A page of the list of robots, with the facts that decide what each robot needs next. `only` limits the list to the robots that a key may see.
pub async fn list(
    store: &Store,
    only: Option<&[String]>,
    request: &ListRequest,
) -> Result<Page<OverviewRow>> {
    let robots = robots::search(store, only, request).await?;
    let ids: Vec<&str> = robots.items.iter().map(|row| row.id.as_str()).collect();
    let values = values![format!(",{}", ids.join(","))];
    let mut rows: Vec<OverviewRow> = sql::all(store.readers(), LIST, values).await?;
    rows.sort_by_key(|row| ids.iter().position(|id| *id == row.id));
    Ok(Page {
        items: rows,
        next_cursor: robots.next_cursor,
        total: robots.total,
    })
}
