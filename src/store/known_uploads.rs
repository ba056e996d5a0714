//! The uploads of a robot that a job's points are compared with, to find out how old the points are.

use super::from_row::row;
use super::sql::{self, values};
use super::{AuditEvent, Result, Store};

row! {
    /// An upload of a robot that a job's points are compared with.
    #[derive(Clone, Debug, PartialEq)]
    pub struct KnownUpload {
        /// The measurement set.
        pub id: String,
        /// Number of its points.
        pub n_points: i64,
        /// Number of its entry in the audit chain; 0 if it is older than the chain.
        pub uploaded_seq: i64,
        /// Whether it was uploaded before the robot's last session that did not fit, or for that session. Uploads of sessions that did not fit are left
        /// out, because a changed robot may be identified from them.
        pub is_before_misfit: bool,
    }
}

// SQL for the upload that a job scored: its verify set if it has one, otherwise `u`, which is one of its own uploads (one row per session).
macro_rules! scored_set {
    () => {
        "coalesce(j.verify_set_id, u.measurement_set_id)"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[NEWEST, IS_USED];

// The newest uploads of a robot, by the order of the audit chain. An upload without an entry is older than the chain. With $5 = 1 (a job of kind
// `verify`), an upload for which a check found a change counts as older than the session that did not fit.
const NEWEST: &str = concat!(
    "with known as (
        select m.id as id, m.n_points as n_points, coalesce((select max(a.seq) from audit a where a.subject = m.id and a.event = $4), 0) as uploaded_seq
        from measurement_set m where m.robot_id = $1)
    select k.id as id, k.n_points as n_points, k.uploaded_seq as uploaded_seq,
        case when cast($2 as bigint) > 0 and k.uploaded_seq <= coalesce((select max(a.seq) from verification v join job j on j.id = v.job_id join job_upload u on u.job_id = j.id
                join audit a on a.subject = ",
    scored_set!(),
    " and a.event = $4 where v.robot_id = $1 and v.seq = cast($2 as bigint)), 0)
            and (k.id not in (select ",
    scored_set!(),
    " from verification v join job j on j.id = v.job_id join job_upload u on u.job_id = j.id where v.robot_id = $1 and v.fit <> 'fits'
                    and not exists (select 1 from job_session o where o.job_id = j.id))
                or (cast($5 as bigint) = 1 and k.id in (select c.measurement_set_id from job c join verification w on w.job_id = c.id
                    where c.kind = 'check' and w.robot_id = $1 and w.fit <> 'fits')))
            then 1 else 0 end as is_before_misfit
    from known k order by k.uploaded_seq desc, k.id desc limit cast($3 as bigint)"
);

// Whether a job of a kind other than check has used an upload.
const IS_USED: &str = "
    select count(*) from job j where j.robot_id = $1 and j.kind <> 'check' and j.status = 'succeeded'
        and (j.measurement_set_id = $2 or j.verify_set_id = $2
            or exists (select 1 from job_session s where s.job_id = j.id and s.measurement_set_id = $2))";

/// The newest uploads of a robot, newest first. `misfit_seq` is the number of its last session that did not fit; 0 for none. `is_session` is true for
/// a job of kind `verify`.
pub async fn newest(
    store: &Store,
    robot_id: &str,
    misfit_seq: i64,
    is_session: bool,
    limit: i64,
) -> Result<Vec<KnownUpload>> {
    let created = AuditEvent::MeasurementSetCreated.as_str();
    let values = values![robot_id, misfit_seq, limit, created, i64::from(is_session)];
    sql::all(store.readers(), NEWEST, values).await
}

/// Whether a job of a kind other than `check` has used an upload of the robot.
pub async fn is_used(store: &Store, robot_id: &str, measurement_set_id: &str) -> Result<bool> {
    let values = values![robot_id, measurement_set_id];
    let n: i64 = sql::value(store.readers(), IS_USED, values).await?;
    Ok(n > 0)
}
