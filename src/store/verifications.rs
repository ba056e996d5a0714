//! Verification facts: what each succeeded job found about a parameter set. The release gates read these facts. The facts of a robot are ordered by a
//! counter (`seq`), never by a clock.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::{from_row, row};
use super::policies::ABSENT;
use super::sql::{self, values};
use super::{AuditEvent, Result, Store, Tx};
use crate::wire::measurement::Frame;
use crate::wire::report_shape::Evidence;
use crate::wire::verification::{Fit, Verification, VerificationKind};

row! {
    /// Verification facts of one job.
    #[derive(Clone, Debug, PartialEq)]
    pub struct VerificationRow {
        /// The job.
        pub job_id: String,
        /// Its robot.
        pub robot_id: String,
        /// The parameter set that the job identified or scored; none if the job scored the nominal robot.
        pub parameter_set_id: Option<String>,
        /// The job's measurement set. An identification fits it; a session scores it.
        pub measurement_set_id: String,
        /// The frame of that set's positions.
        pub frame: Frame,
        /// When the job was posted.
        pub created_at_ms: i64,
        /// Number of the row in the robot's counter.
        pub seq: i64,
        /// Number in the audit chain of the upload in which the job's fitted or scored points appeared first; 0 if that is older than the chain.
        pub points_seq: i64,
        /// The same for the upload that a parameter set was scored on: the scored set of a session, the verify set of an identification (0 for none).
        pub scored_seq: i64,
        /// What the job found.
        pub found: Verification,
    }
}

from_row!(Verification {
    before_rms_mm,
    after_rms_mm,
    after_expanded_mm,
    measured_seq,
    misfit_seq,
    uncertainty_mm,
    kind,
    fit,
    evidence,
    is_better,
    is_repeat,
    is_worse,
    n_points
});

impl VerificationRow {
    fn audit_entry(&self) -> Value {
        let found = &self.found;
        let mut entry = json!({"parameter_set_id": self.parameter_set_id, "kind": found.kind.as_str(), "seq": self.seq, "n_points": found.n_points,
            "before_rms_mm": found.before_rms_mm, "after_rms_mm": found.after_rms_mm, "is_better": i64::from(found.is_better), "fit": found.fit.as_str(),
            "evidence": found.evidence.as_str(), "is_repeat": i64::from(found.is_repeat), "is_worse": i64::from(found.is_worse), "check_seq": found.misfit_seq,
            "verified_uncertainty_mm": found.uncertainty_mm});
        // Audit entries of older versions do not have these fields.
        if let Some(expanded_mm) = found.after_expanded_mm {
            entry["after_expanded_mm"] = json!(expanded_mm);
        }
        if found.measured_seq > 0 {
            entry["measured_seq"] = json!(found.measured_seq);
        }
        entry
    }
}

row! {
    /// An upload whose points a job scored with a parameter set.
    #[derive(Clone, Debug, PartialEq)]
    pub struct ScoredUpload {
        /// The job.
        pub job_id: String,
        /// When the upload was stored.
        pub uploaded_at_ms: i64,
        /// How its bytes were interpreted (`wire::understood::Reading`).
        pub reading_json: Option<String>,
    }
}

row! {
    /// What a job found about a robot's released set, with one of the uploads whose points it scored.
    #[derive(Clone, Debug, PartialEq)]
    pub struct ScoredRelease {
        /// What the job found.
        pub facts: VerificationRow,
        /// When the upload was stored.
        pub uploaded_at_ms: i64,
        /// How its bytes were interpreted (`wire::understood::Reading`).
        pub reading_json: Option<String>,
        /// Whether the set was identified from, or verified on, the job's measurement set.
        pub is_own_upload: bool,
    }
}

row! {
    /// A later session on which this parameter set was not scored: another set was identified from it or scored on it.
    #[derive(Clone, Debug, PartialEq)]
    pub struct LaterSession {
        /// The job that identified or scored the other set.
        pub job_id: String,
        /// The session's upload.
        pub measurement_set_id: String,
        /// The summary of that job's report; empty if there is none.
        pub summary_json: String,
        /// Whether the other set was identified from the session and is unusable, or the session fits no robot.
        pub is_unusable: bool,
    }
}

row! {
    /// Two numbers of a robot's row. A job reads them when it begins and when it ends.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    pub struct RobotCounters {
        /// Number of the last session that did not fit the robot; 0 for none.
        pub misfit_seq: i64,
        /// The robot's counter at its last `checked` request; 0 for none.
        pub checked_seq: i64,
    }
}

// SQL: the newest set of robot `r` that can be decided on: not withdrawn, not archived, and not of an archived job.
macro_rules! newest_set {
    () => {
        "(select p.id from parameter_set p where p.robot_id = r.id and p.status <> 'withdrawn'
        and not exists (select 1 from archived x where x.id in (p.id, p.job_id)) order by p.created_at_ms desc, p.id desc limit 1)"
    };
}
pub(super) use newest_set;

// SQL: the age of a measurement set, as a number in the audit chain. If the same bytes were uploaded before, the first upload counts.
macro_rules! uploaded_seq {
    ($set:literal) => {
        concat!(
            "(select coalesce(min(a.seq), 0) from measurement_set m join measurement_set same on same.robot_id = m.robot_id and same.sha256 = m.sha256
                join audit a on a.subject = same.id and a.event = 'measurement_set_created' where m.id = ",
            $set,
            ")"
        )
    };
}

// SQL: the age of the uploads of a verification `v`; with several sessions, that of the newest upload.
macro_rules! uploads_seq {
    () => {
        concat!(
            "(select coalesce(max(",
            uploaded_seq!("o.measurement_set_id"),
            "), 0) from job_upload o where o.job_id = v.job_id)"
        )
    };
}

// SQL: the age of the points of a verification `v`. Copied points are as old as the original.
macro_rules! points_seq {
    () => {
        concat!(
            "(case when v.measured_seq > 0 and v.measured_seq < ",
            uploads_seq!(),
            " then v.measured_seq else ",
            uploads_seq!(),
            " end)"
        )
    };
}

macro_rules! rows {
    () => {
        concat!("select v.job_id as job_id, v.robot_id as robot_id, v.parameter_set_id as parameter_set_id, j.measurement_set_id as measurement_set_id, m.frame as frame, j.created_at_ms as created_at_ms, v.kind as kind, v.seq as seq,
             v.n_points as n_points, v.before_rms_mm as before_rms_mm, v.after_rms_mm as after_rms_mm, v.after_expanded_mm as after_expanded_mm, v.is_better as is_better, v.fit as fit,
             v.evidence as evidence, v.is_repeat as is_repeat, v.is_worse as is_worse, v.measured_seq as measured_seq, v.check_seq as misfit_seq, v.uncertainty_mm as uncertainty_mm, ",
            points_seq!(),
            " as points_seq, case when v.kind = 'session' then ",
            points_seq!(),
            " else ",
            uploaded_seq!("j.verify_set_id"),
            " end as scored_seq
         from verification v join job j on j.id = v.job_id join measurement_set m on m.id = j.measurement_set_id")
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[
    INSERT,
    OF_JOB,
    OF_SET,
    SCORED_UPLOADS,
    OF_RELEASED_SETS,
    OF_NEWEST_SETS,
    COUNT,
    LATER_SESSIONS,
    N_WITHOUT_FACTS,
    ROBOT_COUNTERS,
    ROBOT_COUNTERS_OF_JOB,
    JOB_AT,
    BY_ID,
    JOBS_WITHOUT,
];

// The caller has locked the robot's row, so the counter has no gaps and no duplicates. A job of kind verify or check identifies nothing.
const INSERT: &str = "
    insert into verification (job_id, robot_id, parameter_set_id, kind, seq, n_points, before_rms_mm, after_rms_mm, is_better, fit, evidence,
        is_repeat, check_seq, uncertainty_mm, after_expanded_mm, is_worse, measured_seq)
    select j.id, j.robot_id,
        case when $2 = 'session' then j.parameter_set_input_id else (select p.id from parameter_set p where p.job_id = j.id) end,
        $2, (select coalesce(max(v.seq), 0) + 1 from verification v where v.robot_id = j.robot_id), $3,
        nullif($4, cast(-1 as double precision)), nullif($5, cast(-1 as double precision)), $6, $7, $8,
        $9, $11, nullif($10, cast(-1 as double precision)), nullif($12, cast(-1 as double precision)), $13, $14
    from job j where j.id = $1 and ($2 <> 'identification' or j.kind = 'identify')
    on conflict (job_id) do nothing";

const OF_JOB: &str = concat!(rows!(), " where v.job_id = $1");

const OF_SET: &str = concat!(rows!(), " where v.parameter_set_id = $1 order by v.seq");

const SCORED_UPLOADS: &str = "
    select v.job_id as job_id, m.created_at_ms as uploaded_at_ms, m.reading_json as reading_json
    from verification v join job j on j.id = v.job_id join job_upload o on o.job_id = j.id
        join measurement_set m on m.id = coalesce(j.verify_set_id, o.measurement_set_id)
    where v.parameter_set_id = $1";

// $1 is a comma-separated list of robot ids, at most one page.
const OF_RELEASED_SETS: &str = concat!(
    "select f.*, u.created_at_ms as uploaded_at_ms, u.reading_json as reading_json,
        case when f.measurement_set_id = own.verify_set_id
                or exists (select 1 from job_upload w where w.job_id = own.id and w.measurement_set_id = f.measurement_set_id)
            then 1 else 0 end as is_own_upload
     from (",
    rows!(),
    " where v.parameter_set_id in (select p.id from robot r join parameter_set p on p.robot_id = r.id and p.status = 'released'
            where replace($1, r.id, '') <> $1)) f
        join parameter_set s on s.id = f.parameter_set_id join job own on own.id = s.job_id
        join job scorer on scorer.id = f.job_id join job_upload o on o.job_id = f.job_id
        join measurement_set u on u.id = coalesce(scorer.verify_set_id, o.measurement_set_id)
     order by f.robot_id, f.seq"
);

// $1 is a comma-separated list of robot ids, at most one page.
const OF_NEWEST_SETS: &str = concat!(
    rows!(),
    " join parameter_set q on q.id = v.parameter_set_id and q.status = 'candidate' where v.parameter_set_id in (select ",
    newest_set!(),
    " from robot r where replace($1, r.id, '') <> $1) order by v.parameter_set_id, v.seq"
);

// Counts the facts of the whole robot, because a later session of another set matters as well.
const COUNT: &str = "select count(*) from verification where robot_id = (select robot_id from parameter_set where id = $1)";

// Later sessions: their points were uploaded after those of the set, and another set was identified from them or scored on them.
//
// Order: that of the uploads in the audit chain, never the times of jobs. The same bytes uploaded again are as old as their first upload.
// If the set's own points are a copy, they are as old as the original (`measured_seq`). A later session is as old as its upload even if it
// may be a copy: it can block a release. Uploads without an entry are older than the chain. Among these, and for the same upload, the order
// of the jobs decides.
//
// Left out: jobs with one session that repeat uploads from before a session that did not fit, because they show nothing new; a job with
// several sessions stays, because one repeated session must not hide the others. Sessions before a `checked` request are left out too,
// because its reason explains them.
//
// Of several jobs on the same bytes, a job that fits is preferred to one that does not, because the file may have been read in a wrong way
// at first; then the newest is taken.
const LATER_SESSIONS: &str = concat!(
    "
    with own as (
        select v.robot_id as robot_id, v.seq as seq, r.checked_seq as checked_seq, ",
    points_seq!(),
    " as uploaded
        from parameter_set p join verification v on v.job_id = p.job_id join robot r on r.id = v.robot_id where p.id = $1),
    later as (
        select v.job_id as job_id, u.measurement_set_id as measurement_set_id, v.seq as seq, coalesce(r.summary_json, '') as summary_json,
            cast(case when v.kind = $2 and v.fit <> $3 then 1 else 0 end as bigint) as is_unusable, ",
    uploaded_seq!("u.measurement_set_id"),
    " as uploaded
        from own join verification v on v.robot_id = own.robot_id join job_upload u on u.job_id = v.job_id
            left join report_summary r on r.job_id = v.job_id
        where (v.kind = $2 or (v.fit <> $5 and v.evidence <> $6))
            and (v.is_repeat = 0 or exists (select 1 from job_session o where o.job_id = v.job_id))),
    ranked as (
        select v.*, row_number() over (
            partition by case when v.uploaded > 0 then cast(v.uploaded as text) else v.measurement_set_id end
            order by v.is_unusable, v.seq desc) as nth
        from later v)
    select v.job_id as job_id, v.measurement_set_id as measurement_set_id, v.summary_json as summary_json, v.is_unusable as is_unusable
    from ranked v join own on (v.uploaded > own.uploaded or (v.uploaded = own.uploaded and v.seq > own.seq))
    where v.nth = 1 and v.seq > own.checked_seq and not exists (select 1 from verification s join job k on k.id = s.job_id
            where s.parameter_set_id = $1 and (k.measurement_set_id = v.measurement_set_id or k.verify_set_id = v.measurement_set_id
                or exists (select 1 from job_session w where w.job_id = k.id and w.measurement_set_id = v.measurement_set_id)))
    order by v.is_unusable desc, v.seq desc limit cast($4 as bigint)"
);

// Counts jobs that an older version of kincal ended and that have no facts yet.
const N_WITHOUT_FACTS: &str = "
    select count(*) from job j where j.status = 'succeeded'
        and ((j.kind in ('verify', 'check') and j.parameter_set_input_id = $1) or j.id = (select job_id from parameter_set where id = $1))
        and not exists (select 1 from verification v where v.job_id = j.id)";

const ROBOT_COUNTERS: &str = "select check_seq as misfit_seq, checked_seq from robot where id = $1";

const ROBOT_COUNTERS_OF_JOB: &str = "select check_seq as misfit_seq, checked_seq from robot where id = (select robot_id from job where id = $1)";

const JOB_AT: &str = "select job_id from verification where robot_id = $1 and seq = $2";

const BY_ID: &str = concat!(
    rows!(),
    " where v.job_id > $1 order by v.job_id limit cast($2 as bigint)"
);

// Sorted by the order in which the jobs ended, from the audit chain.
const JOBS_WITHOUT: &str = "
    select id from (
        select j.id as id, (select min(a.seq) from audit a where a.subject = j.id and a.event = $1) as ended
        from job j where j.status = 'succeeded' and not exists (select 1 from verification v where v.job_id = j.id)
            and (j.kind in ('verify', 'check') or exists (select 1 from parameter_set p where p.job_id = j.id))) as without
    order by coalesce(ended, 0), id";

audited!(VerificationRow, job_id, |row| vec![ExpectedEntry::at(
    AuditEvent::VerificationKept,
    row.created_at_ms,
    row.audit_entry()
)]);

/// Stores what a job found. The transaction must be the one that ends the job, and it must have locked the robot's row. Returns the stored row;
/// `None` if the job has facts already.
pub async fn insert(
    tx: &mut Tx,
    job_id: &str,
    found: &Verification,
) -> Result<Option<VerificationRow>> {
    let values = values![
        job_id,
        found.kind.as_str(),
        i64::try_from(found.n_points).unwrap_or(i64::MAX),
        number(found.before_rms_mm),
        number(found.after_rms_mm),
        i64::from(found.is_better),
        found.fit.as_str(),
        found.evidence.as_str(),
        i64::from(found.is_repeat),
        number(found.uncertainty_mm),
        found.misfit_seq,
        number(found.after_expanded_mm),
        i64::from(found.is_worse),
        found.measured_seq
    ];
    if sql::execute(tx.connection(), INSERT, values).await? == 0 {
        return Ok(None);
    }
    let row: VerificationRow = sql::one(tx.connection(), OF_JOB, values![job_id]).await?;
    tx.audit(AuditEvent::VerificationKept, job_id, row.audit_entry());
    Ok(Some(row))
}

/// The number to bind: [`ABSENT`] if there is none or it is not finite.
fn number(value: Option<f64>) -> f64 {
    value.filter(|value| value.is_finite()).unwrap_or(ABSENT)
}

/// The facts of one job, if any.
pub async fn of_job(store: &Store, job_id: &str) -> Result<Option<VerificationRow>> {
    sql::first(store.readers(), OF_JOB, values![job_id]).await
}

/// All facts of a parameter set, its identification and every session, in order.
pub async fn of_set(store: &Store, parameter_set_id: &str) -> Result<Vec<VerificationRow>> {
    sql::all(store.readers(), OF_SET, values![parameter_set_id]).await
}

/// The uploads whose points the jobs of a parameter set scored. For an identification, these are the uploads of its held-out points.
pub async fn scored_uploads(store: &Store, parameter_set_id: &str) -> Result<Vec<ScoredUpload>> {
    sql::all(store.readers(), SCORED_UPLOADS, values![parameter_set_id]).await
}

/// All facts of the released set of each of these robots, for their trends. The facts of one robot follow each other, in order; a job of several
/// sessions has one row for each of their uploads.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn of_released_sets(store: &Store, robot_ids: &[&str]) -> Result<Vec<ScoredRelease>> {
    let values = values![format!(",{}", robot_ids.join(","))];
    sql::all(store.readers(), OF_RELEASED_SETS, values).await
}

/// All facts of the newest set of each of these robots, for the overview. The facts of one set follow each other, in order.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn of_newest_sets(store: &Store, robot_ids: &[&str]) -> Result<Vec<VerificationRow>> {
    let values = values![format!(",{}", robot_ids.join(","))];
    sql::all(store.readers(), OF_NEWEST_SETS, values).await
}

/// Number of facts of a set's robot.
pub async fn count(store: &Store, parameter_set_id: &str) -> Result<i64> {
    sql::value(store.readers(), COUNT, values![parameter_set_id]).await
}

/// Later sessions on which this parameter set was not scored, except those that a `checked` request explains: sessions uploaded after the
/// set's points, from which another set was identified or on which another set was scored. At most `limit`: first those that fit no robot,
/// then the newest.
pub async fn later_sessions(
    store: &Store,
    parameter_set_id: &str,
    limit: i64,
) -> Result<Vec<LaterSession>> {
    let values = values![
        parameter_set_id,
        VerificationKind::Identification.as_str(),
        Fit::Fits.as_str(),
        limit,
        Fit::DoesNotFit.as_str(),
        Evidence::None.as_str()
    ];
    sql::all(store.readers(), LATER_SESSIONS, values).await
}

/// Number of succeeded jobs of a parameter set that have no facts.
pub async fn n_without_facts(store: &Store, parameter_set_id: &str) -> Result<i64> {
    let values = values![parameter_set_id];
    sql::value(store.readers(), N_WITHOUT_FACTS, values).await
}

pub(super) async fn count_in(tx: &mut Tx, parameter_set_id: &str) -> Result<i64> {
    sql::value(tx.connection(), COUNT, values![parameter_set_id]).await
}

/// The numbers of a robot that a job reads when it begins.
pub async fn robot_counters(store: &Store, robot_id: &str) -> Result<RobotCounters> {
    sql::one(store.readers(), ROBOT_COUNTERS, values![robot_id]).await
}

/// As [`robot_counters`], for the robot of a job. The transaction must have locked the robot's row.
pub(crate) async fn robot_counters_of_job(tx: &mut Tx, job_id: &str) -> Result<RobotCounters> {
    sql::one(tx.connection(), ROBOT_COUNTERS_OF_JOB, values![job_id]).await
}

/// The job behind a number of a robot's counter.
pub async fn job_at(store: &Store, robot_id: &str, seq: i64) -> Result<Option<String>> {
    sql::first_value(store.readers(), JOB_AT, values![robot_id, seq]).await
}

/// Jobs without facts, ended by older versions, in the order in which they ended.
pub async fn jobs_without_facts(store: &Store) -> Result<Vec<String>> {
    let values = values![AuditEvent::JobSucceeded.as_str()];
    sql::all_values(store.readers(), JOBS_WITHOUT, values).await
}
