//! Parameter sets. A job has at most one parameter set, a robot has at most one released parameter set, and a release needs passed checks. The schema
//! enforces each of these rules.

use serde_json::json;

use super::audit::{ExpectedEntry, audited};
use super::id_prefix::IdPrefix;
use super::listing::{self, ListQueries};
pub use super::parameter_set_row::ParameterSetRow;
use super::parameter_set_row::{created_detail, released_detail, withdrawn_detail};
use super::policies::ABSENT;
use super::robots::RobotCheck;
use super::sql::{self, rows_after, values};
use super::{
    AuditEvent, Conflict, Hashed, ListRequest, Page, Result, Store, Tx, policies, robots,
    verifications, withdrawals,
};
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::report_shape::Evidence;
use crate::wire::verification::Fit;

/// A parameter set to be stored with the job that identified it, with fields of [`ParameterSetRow`].
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // as in the row
pub struct NewParameterSet {
    pub body_json: String,
    pub sha256: String,
    /// The estimate that later sessions are compared with, see `wire::estimate`.
    pub estimate_json: Option<Hashed<String>>,
}

/// A release to be written.
#[derive(Clone, Debug, PartialEq)]
pub struct Release {
    /// Id of the parameter set.
    pub id: String,
    /// State of the database for which the checks were made.
    pub checked: CheckedState,
    /// Reason of the release.
    pub reason: String,
    /// The gates and their results, in JSON.
    pub checks_json: String,
    /// Number of gates that passed.
    pub n_passed: i64,
    /// Number of gates that failed. The schema's trigger refuses a release unless it is 0.
    pub n_failed: i64,
    /// Id of the key that releases.
    pub released_by: String,
    /// Strength of the verification.
    pub evidence: Evidence,
    /// The tool's largest uncertainty over the workspace, mm.
    pub uncertainty_mm: Option<f64>,
}

/// State of the database for which the checks of a release were made. If this state has changed when the release is written, the checks must run
/// again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CheckedState {
    /// The robot's active set.
    pub active: Option<String>,
    /// Version of the robot's policy.
    pub policy_version: i64,
    /// Number of verification facts of the robot: jobs that have identified or scored its sets.
    pub n_verifications: i64,
    /// The state of the robot.
    pub robot: RobotCheck,
    /// Number of withdrawn sets of the robot, with which the set was compared.
    pub n_withdrawn: i64,
}

// The version of the robot's joint map that a set was identified with.
macro_rules! joint_map_version {
    () => {
        "coalesce((select v.joint_map_version from job_robot_version j join robot_version v on v.version = j.version
            where j.job_id = parameter_set.job_id and v.robot_id = parameter_set.robot_id), 1)"
    };
}

macro_rules! columns {
    () => {
        concat!("id, robot_id, job_id, status, body_json, sha256, created_at_ms,
         released_at_ms, release_reason, release_checks_json, release_n_passed, release_n_failed, withdrawn_at_ms, withdraw_reason, released_by, withdrawn_by,
         release_evidence, release_uncertainty_mm, release_seq, supersedes_id,
         (select k.name from api_key k where k.id = parameter_set.released_by) as released_by_name,
         (select k.name from api_key k where k.id = parameter_set.withdrawn_by) as withdrawn_by_name,
         (select a.archived_at_ms from archived a where a.id = parameter_set.id) as archived_at_ms,
         (select a.archived_at_ms from archived a where a.id = parameter_set.job_id) as job_archived_at_ms,
         coalesce((select v.version from job_robot_version v where v.job_id = parameter_set.job_id), 1) as robot_version, ", joint_map_version!(), " as joint_map_version")
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[
    INSERT,
    GET,
    ACTIVE,
    BEFORE_ACTIVE,
    OF_ANOTHER_UPLOAD,
    LOCK_ROBOT,
    SUPERSEDE,
    RELEASE,
    WITHDRAW,
    BY_ID,
    INSERT_ESTIMATE,
    ESTIMATE,
    ESTIMATES,
];

const INSERT: &str = concat!(
    "insert into parameter_set (id, robot_id, job_id, status, body_json, sha256, created_at_ms)
     values ($1, (select robot_id from job where id = $2), $2, 'candidate', $3, $4, (select now_ms from clock))
     returning ",
    columns!()
);

const GET: &str = concat!("select ", columns!(), " from parameter_set where id = $1");

const ACTIVE: &str = concat!(
    "select ",
    columns!(),
    " from parameter_set where robot_id = $1 and status = 'released'"
);

// The set that the active set superseded. If that set was withdrawn, or if no set is active: the superseded set that was released last, by the
// robot's release counter and not by a clock.
const BEFORE_ACTIVE: &str = concat!(
    "select ",
    columns!(),
    " from parameter_set
     where robot_id = $1 and status = 'superseded'
     order by case when id = (select a.supersedes_id from parameter_set a where a.robot_id = $1 and a.status = 'released') then 0 else 1 end,
         release_seq desc
     limit 1"
);

const OF_ANOTHER_UPLOAD: &str = concat!(
    "select ",
    columns!(),
    " from parameter_set
     where robot_id = $1 and not exists (
         select 1 from job_upload join measurement_set on measurement_set.id = job_upload.measurement_set_id
         where job_upload.job_id = parameter_set.job_id and measurement_set.sha256 in (select sha256 from measurement_set where robot_id = $1 and replace($2, id, '') <> $2))
         and not exists (select 1 from verification v where v.job_id = parameter_set.job_id and v.fit = $3)
         and not exists (select 1 from archived a where a.id = parameter_set.id)
         and ", joint_map_version!(), " = (select r.joint_map_version from robot_now r where r.id = $1)
     order by coalesce((select v.seq from verification v where v.job_id = parameter_set.job_id), 0) desc, id desc
     limit 1"
);

pub(super) const LIST: ListQueries = ListQueries {
    columns: columns!(),
    from: "parameter_set",
    filter: "robot_id = $1
        and ($2 = 'all' or ($2 = 'true') = exists (select 1 from archived a where a.id = parameter_set.id))
        and ($3 = '' or status = $3)",
    n_filters: 3,
    name: None,
};

// This update changes no value. It locks the robot's row, so that releases and withdrawals of one robot run one after the other.
const LOCK_ROBOT: &str =
    "update robot set name = name where id = (select robot_id from parameter_set where id = $1)";

const SUPERSEDE: &str =
    "update parameter_set set status = 'superseded' where robot_id = $1 and status = 'released'";

const RELEASE: &str = "
    update parameter_set set status = 'released', released_at_ms = (select now_ms from clock),
        release_seq = (select coalesce(max(o.release_seq), 0) + 1 from parameter_set o where o.robot_id = parameter_set.robot_id),
        supersedes_id = nullif($7, ''),
        release_reason = $2, release_checks_json = $3, release_n_passed = $8, release_n_failed = $9, released_by = $4, release_evidence = $5, release_uncertainty_mm = nullif($6, cast(-1 as double precision))
    where id = $1";

const WITHDRAW: &str = "
    update parameter_set set status = 'withdrawn', withdrawn_at_ms = (select now_ms from clock), withdraw_reason = $2, withdrawn_by = $3
    where id = $1 and status <> 'withdrawn'";

const BY_ID: &str = rows_after!(columns!(), "parameter_set");

const INSERT_ESTIMATE: &str =
    "insert into estimate (parameter_set_id, estimate_json) values ($1, $2)";

const ESTIMATE: &str = "select estimate_json from estimate where parameter_set_id = $1";

/// Ids of parameter sets with their estimates, for `verify-store`.
pub(super) const ESTIMATES: &str = "
    select parameter_set_id, estimate_json from estimate where parameter_set_id > $1 order by parameter_set_id limit cast($2 as bigint)";

audited!(ParameterSetRow, id, |row| vec![
    ExpectedEntry::at(
        AuditEvent::ParameterSetCreated,
        row.created_at_ms,
        created_detail(row)
    ),
    ExpectedEntry::new(AuditEvent::ParameterSetReleased, released_detail(row)).by("released_by"),
    ExpectedEntry::new(AuditEvent::ParameterSetWithdrawn, withdrawn_detail(row)).by("withdrawn_by"),
]);

/// Stores the parameter set of a job, as a candidate.
///
/// # Errors
/// [`Conflict::Duplicate`] if the job already has one, [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, job_id: &str, new: &NewParameterSet) -> Result<ParameterSetRow> {
    let id = IdPrefix::ParameterSet.new_id();
    let values = values![id, job_id, new.body_json, new.sha256];
    let row: ParameterSetRow = sql::one(tx.connection(), INSERT, values).await?;
    let mut detail = created_detail(&row);
    if let Some(estimate) = &new.estimate_json {
        let values = values![row.id, estimate.content()];
        sql::execute(tx.connection(), INSERT_ESTIMATE, values).await?;
        detail["estimate_sha256"] = json!(estimate.sha256());
    }
    tx.audit(AuditEvent::ParameterSetCreated, &row.id, detail);
    Ok(row)
}

/// One parameter set.
pub async fn get(store: &Store, id: &str) -> Result<ParameterSetRow> {
    sql::one(store.readers(), GET, values![id]).await
}

/// The estimate of a parameter set (`wire::estimate`), if one was stored.
pub async fn estimate(store: &Store, id: &str) -> Result<Option<String>> {
    sql::first_value(store.readers(), ESTIMATE, values![id]).await
}

/// The robot's released parameter set.
pub async fn active(store: &Store, robot_id: &str) -> Result<Option<ParameterSetRow>> {
    sql::first(store.readers(), ACTIVE, values![robot_id]).await
}

/// The set that a rollback would release: usually the set that the active set superseded.
///
/// # Errors
/// [`Conflict::NothingToRollBackTo`], [`super::Error::Database`].
pub async fn before_active(store: &Store, robot_id: &str) -> Result<ParameterSetRow> {
    let row: Option<_> = sql::first(store.readers(), BEFORE_ACTIVE, values![robot_id]).await?;
    row.ok_or_else(|| Conflict::NothingToRollBackTo.into())
}

/// The robot's newest parameter set that was identified from other uploads than these measurement sets (ids separated by commas). Sets whose
/// identification found the fit `except` are left out.
pub async fn of_another_upload(
    store: &Store,
    robot_id: &str,
    measurement_set_ids: &str,
    except: Fit,
) -> Result<Option<ParameterSetRow>> {
    let values = values![robot_id, measurement_set_ids, except.as_str()];
    sql::first(store.readers(), OF_ANOTHER_UPLOAD, values).await
}

/// A robot's parameter sets, filtered by status and archived state.
pub async fn search(
    store: &Store,
    robot_id: &str,
    request: &ListRequest,
) -> Result<Page<ParameterSetRow>> {
    let filters = [robot_id, request.archived.as_str(), request.status];
    listing::list(store, &LIST, &filters, request).await
}

/// Makes a candidate or superseded set the active one. The previously active set becomes superseded. Releasing the active set again changes nothing.
///
/// # Errors
/// [`super::Error::NotFound`], [`Conflict::Withdrawn`], [`Conflict::ActiveChanged`], [`Conflict::ChecksOutdated`],
/// [`Conflict::RefusedBySchema`], [`super::Error::Database`];
/// the transaction must then not be committed.
pub async fn release(tx: &mut Tx, release: &Release) -> Result<ParameterSetRow> {
    let set = lock_and_get(tx, &release.id).await?;
    match set.status {
        ParameterSetStatus::Released => return Ok(set),
        ParameterSetStatus::Withdrawn => return Err(Conflict::Withdrawn.into()),
        ParameterSetStatus::Candidate | ParameterSetStatus::Superseded => {}
    }
    let active = active_in(tx, &set.robot_id).await?;
    let active = active.map(|active| active.id);
    if active != release.checked.active {
        return Err(Conflict::ActiveChanged.into());
    }
    let policy = policies::get_in(tx, &set.robot_id).await?;
    let robot = robots::get_in(tx, &set.robot_id).await?;
    let now = CheckedState {
        active,
        policy_version: policy.version,
        n_verifications: verifications::count_in(tx, &release.id).await?,
        robot: robot.check(),
        n_withdrawn: withdrawals::count_in(tx, &set.robot_id).await?,
    };
    if now != release.checked {
        return Err(Conflict::ChecksOutdated.into());
    }
    let active = now.active;
    sql::execute(tx.connection(), SUPERSEDE, values![set.robot_id]).await?;
    let values = values![
        release.id,
        release.reason,
        release.checks_json,
        release.released_by,
        release.evidence.as_str(),
        release.uncertainty_mm.unwrap_or(ABSENT),
        active.as_deref().unwrap_or_default(),
        release.n_passed,
        release.n_failed
    ];
    sql::execute(tx.connection(), RELEASE, values)
        .await
        .map_err(|error| error.into_conflict_of_trigger(|why| Conflict::RefusedBySchema { why }))?;
    if let Some(active) = &active {
        tx.audit(
            AuditEvent::ParameterSetSuperseded,
            active,
            json!({"by": release.id}),
        );
    }
    let row = get_in(tx, &release.id).await?;
    if let Some((_, detail)) = released_detail(&row) {
        tx.audit(AuditEvent::ParameterSetReleased, &row.id, detail);
    }
    Ok(row)
}

/// Rolls back: withdraws the active set and releases a superseded set (`release`) in one transaction.
pub async fn roll_back(tx: &mut Tx, release: &Release) -> Result<ParameterSetRow> {
    let set = lock_and_get(tx, &release.id).await?;
    let active = active_in(tx, &set.robot_id).await?;
    let values = values![set.robot_id];
    let before: Option<ParameterSetRow> =
        sql::first(tx.connection(), BEFORE_ACTIVE, values).await?;
    // Checked again inside the transaction, because another release may have changed which set a rollback releases.
    let is_before = before.is_some_and(|before| before.id == release.id);
    if active.as_ref().map(|active| &active.id) != release.checked.active.as_ref() || !is_before {
        return Err(Conflict::ActiveChanged.into());
    }
    let mut release = release.clone();
    if let Some(active) = active {
        withdraw(tx, &active.id, &release.reason, &release.released_by).await?;
        release.checked.active = None;
        release.checked.n_withdrawn += 1;
    }
    self::release(tx, &release).await
}

/// Withdraws a set in any state. If it was the active set, the robot has no active set afterwards.
pub async fn withdraw(tx: &mut Tx, id: &str, reason: &str, by: &str) -> Result<ParameterSetRow> {
    lock_and_get(tx, id).await?;
    let changed = sql::execute(tx.connection(), WITHDRAW, values![id, reason, by]).await?;
    let row = get_in(tx, id).await?;
    if let Some((_, detail)) = withdrawn_detail(&row).filter(|_| changed > 0) {
        tx.audit(AuditEvent::ParameterSetWithdrawn, id, detail);
    }
    Ok(row)
}

async fn lock_and_get(tx: &mut Tx, id: &str) -> Result<ParameterSetRow> {
    sql::execute(tx.connection(), LOCK_ROBOT, values![id]).await?;
    get_in(tx, id).await
}

async fn active_in(tx: &mut Tx, robot_id: &str) -> Result<Option<ParameterSetRow>> {
    sql::first(tx.connection(), ACTIVE, values![robot_id]).await
}

async fn get_in(tx: &mut Tx, id: &str) -> Result<ParameterSetRow> {
    sql::one(tx.connection(), GET, values![id]).await
}
