//! Jobs: request, progress and result. [`super::leases`] has the statements of the workers.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::id_prefix::IdPrefix;
use super::listing::{self, ListQueries, list_row};
use super::sql::{self, values};
use super::{
    AuditEvent, Conflict, Error, ListRequest, Page, Result, Store, Tx, archive, job_sources, robots,
};
use crate::wire::canonical;
use crate::wire::job::{Kind, Method};
use crate::wire::job_answer::{Finding, JobStatus};

row! {
    /// A job without its report and convergence curve.
    #[derive(Clone, Debug, PartialEq)]
    pub struct JobRow {
        /// `job_…`
        pub id: String,
        /// Its robot.
        pub robot_id: String,
        /// The set to identify from, or to verify on. With several sessions, the set of the first session.
        pub measurement_set_id: String,
        /// Ids of the sets of further sessions, in order, separated by commas; empty for a job with one session.
        pub further_set_ids: String,
        /// A separate set to verify on.
        pub verify_set_id: Option<String>,
        /// Frames computed from sweeps.
        pub frames_id: Option<String>,
        /// The network to start from, chosen when the job was posted.
        pub network_input_id: Option<String>,
        /// The residual network from which training continues, chosen when the job was posted.
        pub residual_network_input_id: Option<String>,
        /// The parameter set to start from or to verify, chosen when the job was posted.
        pub parameter_set_input_id: Option<String>,
        /// `identify`, `verify` or `check`.
        pub kind: Kind,
        /// The requested method, as text: the schema does not restrict the names, and `verify` must be able to read any text.
        pub method: String,
        /// The whole request in JSON.
        pub request_json: String,
        /// Its state.
        pub status: JobStatus,
        /// Jobs with a higher number run first.
        pub priority: i64,
        /// Number of the attempt. Attempts that were handed back are not counted.
        pub attempt: i64,
        /// The worker that runs or ran the job.
        pub owner: Option<String>,
        /// End of that worker's lease, unless it is renewed.
        pub lease_until_ms: Option<i64>,
        /// When its cancellation was requested.
        pub cancel_requested_at_ms: Option<i64>,
        /// Progress of this attempt in JSON.
        pub progress_json: Option<String>,
        /// Why it failed.
        pub error_json: Option<String>,
        /// SHA-256 of its result, hexadecimal.
        pub result_sha256: Option<String>,
        /// The parameter set that it identified.
        pub parameter_set_id: Option<String>,
        /// The network that it trained.
        pub network_id: Option<String>,
        /// The residual network that it trained.
        pub residual_network_id: Option<String>,
        /// When it was posted.
        pub created_at_ms: i64,
        /// When this attempt began.
        pub started_at_ms: Option<i64>,
        /// When it ended.
        pub finished_at_ms: Option<i64>,
        /// Version of the robot that the job computes with, chosen when the job was posted.
        pub robot_version: i64,
        /// When it was archived.
        pub archived_at_ms: Option<i64>,
        /// Name of its measurement set.
        pub measurement_set_name: Option<String>,
        /// rms error of the nominal robot on the points that were not fitted, mm.
        pub before_rms_mm: Option<f64>,
        /// rms error of the parameter set on the same points, mm.
        pub after_rms_mm: Option<f64>,
        /// What it found against the parameter set or against its points.
        pub finding: Option<Finding>,
    }
}

list_row!(JobRow);

impl JobRow {
    /// All sets that the job identifies from or scores, in the order of the request.
    pub fn set_ids(&self) -> impl Iterator<Item = &str> {
        let further = self.further_set_ids.split(',').filter(|id| !id.is_empty());
        std::iter::once(self.measurement_set_id.as_str()).chain(further)
    }

    /// Whether the status, attempt or progress differs from an earlier state of the job.
    pub fn has_progressed_since(&self, earlier: &JobRow) -> bool {
        (self.status, self.attempt) != (earlier.status, earlier.attempt)
            || self.progress_json != earlier.progress_json
    }
}

row! {
    /// A document of a job. It exists only if the job succeeded.
    struct DocumentRow {
        status: JobStatus,
        document: Option<String>,
    }
}

/// A job to be stored, with fields of [`JobRow`]. It names everything that the result depends on, so that every attempt computes the same result.
#[derive(Clone, Debug, Default, PartialEq)]
#[allow(missing_docs)] // as in the row
pub struct NewJob {
    pub robot_id: String,
    /// Version of the robot that the request was checked with; 0 or 1 for the robot as it was created.
    pub robot_version: i64,
    /// The measurement sets, in their order: one for each session.
    pub set_ids: Vec<String>,
    pub verify_set_id: Option<String>,
    pub frames_id: Option<String>,
    pub network_input_id: Option<String>,
    pub residual_network_input_id: Option<String>,
    pub parameter_set_input_id: Option<String>,
    /// Whether the job holds parameters at the values of that set. The result then depends on the sources of that set.
    pub holds_parameter_set: bool,
    pub kind: Kind,
    pub method: Method,
    pub request_json: String,
    pub priority: i64,
    /// The client that posts the job. Among jobs of equal priority the queue takes one job of each client in turn.
    pub client: String,
}

impl NewJob {
    /// Ids of the items that the job refers to and that can be archived.
    fn inputs(&self) -> impl Iterator<Item = &str> {
        let others = [
            &self.verify_set_id,
            &self.network_input_id,
            &self.residual_network_input_id,
            &self.parameter_set_input_id,
        ];
        let others = others.into_iter().flatten();
        self.set_ids.iter().chain(others).map(String::as_str)
    }
}

/// SQL for the ids of a job's further sets: in order, separated by commas.
macro_rules! further_set_ids {
    () => {
        "coalesce((select string_agg(s.measurement_set_id, ',' order by s.place) from job_session s where s.job_id = job.id), '')"
    };
}

pub(super) use further_set_ids;

macro_rules! columns {
    () => {
        concat!("id, robot_id, measurement_set_id, verify_set_id, frames_id, network_input_id,
         residual_network_input_id, parameter_set_input_id, kind, method, request_json, status, priority, attempt, owner, lease_until_ms, cancel_requested_at_ms,
         progress_json, error_json, result_sha256, created_at_ms, started_at_ms, finished_at_ms,
         (select p.id from parameter_set p where p.job_id = job.id) as parameter_set_id,
         (select n.id from network n where n.job_id = job.id) as network_id,
         (select r.id from residual_network r where r.job_id = job.id) as residual_network_id,
         coalesce((select v.version from job_robot_version v where v.job_id = job.id), 1) as robot_version,
         ", crate::store::jobs::further_set_ids!(), " as further_set_ids,
         (select a.archived_at_ms from archived a where a.id = job.id) as archived_at_ms,
         (select m.name from measurement_set m where m.id = job.measurement_set_id) as measurement_set_name,
         (select v.before_rms_mm from verification v where v.job_id = job.id) as before_rms_mm,
         (select v.after_rms_mm from verification v where v.job_id = job.id) as after_rms_mm,
         (select case when v.fit <> 'fits' then v.fit when v.n_points > 0 and v.is_better = 0 and v.parameter_set_id is not null and v.evidence <> 'none' then 'no_better_than_nominal'
            when v.is_worse = 1 then 'worse_than_identified' end from verification v where v.job_id = job.id and job.status = 'succeeded') as finding")
    };
}

pub(super) use columns;

pub(super) const ALL_QUERIES: &[&str] = &[
    INSERT,
    INSERT_VERSION,
    INSERT_SESSION,
    GET,
    REPORT,
    CONVERGENCE,
    ANY_QUEUED,
    ANY_SUSPECT_QUEUED,
    CANCEL,
    BY_ID,
];

// Fair queue: a new job's turn is one after the client's last waiting job, but not before the first waiting turn of all clients. So a
// client that was idle cannot overtake the others with many jobs.
const INSERT: &str = concat!(
    "insert into job (id, robot_id, measurement_set_id, verify_set_id, frames_id, network_input_id,
        residual_network_input_id, parameter_set_input_id, kind, method, request_json, priority, client, turn, status, attempt,
        created_at_ms)
    select $1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, (
        select coalesce(max(turns.turn), 0) from (
            select max(j.turn) + 1 as turn from job j where j.status = 'queued' and j.client = $13 and j.priority = $12
            union all
            select min(j.turn) as turn from job j where j.status = 'queued' and j.priority = $12) as turns),
        'queued', 0, (select now_ms from clock)
    where cast($14 as bigint) is null or cast($14 as bigint) > (
        select count(*) from (select 1 from job j where j.robot_id = $2 and j.status = 'queued' limit cast($14 as bigint)) as waiting)
    returning ",
    columns!()
);

const GET: &str = concat!("select ", columns!(), " from job where id = $1");

const INSERT_VERSION: &str = "insert into job_robot_version (job_id, version) values ($1, $2)";

const INSERT_SESSION: &str =
    "insert into job_session (job_id, place, measurement_set_id) values ($1, $2, $3)";

macro_rules! filter {
    ($robots:literal) => {
        concat!(
            $robots,
            " and ($2 = 'all' or ($2 = 'true') = exists (select 1 from archived a where a.id = job.id))
             and ($3 = '' or status = $3) and ($4 = '' or kind = $4)"
        )
    };
}

pub(super) const OF_ROBOT: ListQueries = ListQueries {
    columns: columns!(),
    from: "job",
    filter: filter!("robot_id = $1"),
    n_filters: 4,
    name: None,
};

// $1 is a comma-separated list of robot ids; '' for all robots.
pub(super) const OF_ROBOTS: ListQueries = ListQueries {
    columns: columns!(),
    from: "job",
    filter: filter!("($1 = '' or replace($1, robot_id, '') <> $1)"),
    n_filters: 4,
    name: None,
};

const REPORT: &str = "select status, report_json as document from job where id = $1";

const CONVERGENCE: &str = "select status, convergence_json as document from job where id = $1";

const ANY_QUEUED: &str = "select cast(1 as bigint) from job where status = 'queued' limit 1";

const ANY_SUSPECT_QUEUED: &str =
    "select cast(1 as bigint) from job where status = 'queued' and deaths > 0 limit 1";

const CANCEL: &str = "
    update job set
        cancel_requested_at_ms = coalesce(cancel_requested_at_ms, (select now_ms from clock)),
        finished_at_ms = case when status = 'queued' then (select now_ms from clock) else finished_at_ms end,
        status = case when status = 'queued' then 'cancelled' else status end
    where id = $1 and status in ('queued', 'running')";

const BY_ID: &str = concat!(
    "select client, ",
    columns!(),
    " from job where id > $1 order by id limit cast($2 as bigint)"
);

row! {
    /// A job with the client that posted it.
    #[derive(Debug)]
    pub(super) struct JobWithClient {
        client: String,
        job: JobRow,
    }
}

fn created_detail(row: &JobRow, client: &str) -> Value {
    // `robot_version` and `further_set_ids` are fields of their own and not part of the hash, because audit entries of older versions lack them.
    let rest = json!([
        row.kind,
        row.method,
        row.priority,
        client,
        row.created_at_ms
    ]);
    json!({"robot_id": row.robot_id, "measurement_set_id": row.measurement_set_id, "verify_set_id": row.verify_set_id,
        "frames_id": row.frames_id, "network_input_id": row.network_input_id, "residual_network_input_id": row.residual_network_input_id,
        "parameter_set_input_id": row.parameter_set_input_id, "request_sha256": canonical::sha256_hex(row.request_json.as_bytes()),
        "rest_sha256": canonical::sha256_hex(rest.to_string().as_bytes()), "robot_version": row.robot_version, "further_set_ids": row.further_set_ids})
}

pub(super) fn failed_detail(error_json: &str) -> Value {
    json!({"error_sha256": canonical::sha256_hex(error_json.as_bytes())})
}

audited!(JobWithClient, job.id, |row| {
    let JobWithClient { client, job } = row;
    let failed = job.error_json.as_deref().map(failed_detail);
    vec![
        ExpectedEntry::at(
            AuditEvent::JobCreated,
            job.created_at_ms,
            created_detail(job, client),
        ),
        ExpectedEntry::new(
            AuditEvent::JobFailed,
            failed.map(|failed| (job.finished_at_ms.unwrap_or_default(), failed)),
        ),
    ]
});

/// Stores a job as queued, unless `limit` jobs of its robot are waiting already. Everything that the job refers to must be committed already, because
/// a worker reads it as soon as it has claimed the job.
///
/// # Errors
/// [`Conflict::QueueFull`], [`Conflict::RobotArchived`], [`Conflict::Archived`], [`super::Error::NotFound`] if something that the job refers to does not
/// exist, [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: &NewJob, limit: Option<i64>) -> Result<JobRow> {
    tx.require_disk_space()?;
    let (first_set_id, further_set_ids) = new.set_ids.split_first().ok_or(Error::NotFound)?;
    robots::lock_in_use(tx, &new.robot_id).await?;
    archive::require_in_use(tx, new.inputs()).await?;
    let id = IdPrefix::Job.new_id();
    let values = values![
        id,
        new.robot_id,
        first_set_id,
        new.verify_set_id,
        new.frames_id,
        new.network_input_id,
        new.residual_network_input_id,
        new.parameter_set_input_id,
        new.kind.as_str(),
        new.method.as_str(),
        new.request_json,
        new.priority,
        new.client,
        limit
    ];
    let row: Option<JobRow> = sql::first(tx.connection(), INSERT, values)
        .await
        .map_err(|error| error.into_conflict_of_trigger(|_| Conflict::RobotArchived))?;
    let mut row = row.ok_or(Conflict::QueueFull {
        limit: limit.unwrap_or_default(),
    })?;
    if new.robot_version > 1 {
        let values = values![id, new.robot_version];
        sql::execute(tx.connection(), INSERT_VERSION, values).await?;
        row.robot_version = new.robot_version;
    }
    let held = new.parameter_set_input_id.as_deref();
    if let Some(held) = held.filter(|_| new.holds_parameter_set) {
        job_sources::insert_held(tx, &id, held).await?;
    }
    for (place, set_id) in (1_i64..).zip(further_set_ids) {
        sql::execute(tx.connection(), INSERT_SESSION, values![id, place, set_id]).await?;
    }
    row.further_set_ids = further_set_ids.join(",");
    tx.audit(
        AuditEvent::JobCreated,
        &id,
        created_detail(&row, &new.client),
    );
    Ok(row)
}

/// One job.
pub async fn get(store: &Store, id: &str) -> Result<JobRow> {
    sql::one(store.readers(), GET, values![id]).await
}

/// One job, as this transaction sees it.
pub async fn get_in(tx: &mut Tx, id: &str) -> Result<JobRow> {
    sql::one(tx.connection(), GET, values![id]).await
}

/// A robot's jobs, filtered by status, kind and archived state.
pub async fn search(store: &Store, robot_id: &str, request: &ListRequest) -> Result<Page<JobRow>> {
    listing::list(store, &OF_ROBOT, &filters(robot_id, request), request).await
}

/// As [`search`], for all robots, or only for the robots in `only`.
pub async fn search_all(
    store: &Store,
    only: Option<&[String]>,
    request: &ListRequest,
) -> Result<Page<JobRow>> {
    let only = only.map_or(String::new(), |ids| format!(",{}", ids.join(",")));
    listing::list(store, &OF_ROBOTS, &filters(&only, request), request).await
}

fn filters<'a>(robots: &'a str, request: &'a ListRequest) -> [&'a str; 4] {
    [
        robots,
        request.archived.as_str(),
        request.status,
        request.kind,
    ]
}

/// The report of a job that succeeded.
///
/// # Errors
/// [`super::Error::NotFound`], [`Conflict::JobStatus`] if it did not succeed (yet), [`super::Error::Database`].
pub async fn report(store: &Store, id: &str) -> Result<String> {
    document(store, REPORT, id).await
}

/// The convergence curve of a job that succeeded.
///
/// # Errors
/// [`super::Error::NotFound`], [`Conflict::JobStatus`] if it did not succeed (yet), [`super::Error::Database`].
pub async fn convergence(store: &Store, id: &str) -> Result<String> {
    document(store, CONVERGENCE, id).await
}

async fn document(store: &Store, query: &'static str, id: &str) -> Result<String> {
    let row: DocumentRow = sql::one(store.readers(), query, values![id]).await?;
    let status = row.status;
    row.document.ok_or(Conflict::JobStatus { status }.into())
}

/// Whether any job is queued.
pub async fn any_queued(store: &Store) -> Result<bool> {
    let one: Option<i64> = sql::first_value(store.readers(), ANY_QUEUED, values![]).await?;
    Ok(one.is_some())
}

/// Whether a suspect job is queued. A suspect is a job during which a process died.
pub async fn any_suspect_queued(store: &Store) -> Result<bool> {
    let query = ANY_SUSPECT_QUEUED;
    let one: Option<i64> = sql::first_value(store.readers(), query, values![]).await?;
    Ok(one.is_some())
}

/// Cancels a job. A queued job is cancelled at once. For a running job the cancellation is requested, and the worker sees the request at its next
/// heartbeat. A job that has ended does not change.
pub async fn cancel(tx: &mut Tx, id: &str) -> Result<JobRow> {
    let changed = sql::execute(tx.connection(), CANCEL, values![id]).await?;
    let row = get_in(tx, id).await?;
    if changed > 0 {
        let event = if row.status == JobStatus::Cancelled {
            AuditEvent::JobCancelled
        } else {
            AuditEvent::JobCancelRequested
        };
        tx.audit(event, id, json!({}));
    }
    Ok(row)
}
