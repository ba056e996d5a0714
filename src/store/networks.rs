//! Trained networks, at most one of each kind per job. Networks of link parameters and residual networks are stored in two tables. Lists contain both
//! kinds.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::id_prefix::IdPrefix;
use super::listing::{self, ListQueries, list_row};
use super::sql::{self, values};
use super::{AuditEvent, Hashed, ListRequest, Page, Result, Store, Tx};
use crate::wire::canonical;
use crate::wire::job::{Model, Preset};
use crate::wire::safetensors::StoredNetwork;

row! {
    /// A network without its weights.
    #[derive(Clone, Debug, PartialEq)]
    pub struct NetworkRow {
        /// `net_…`
        pub id: String,
        /// Its robot.
        pub robot_id: String,
        /// The job that trained it.
        pub job_id: String,
        /// The model of that job, as text, because `verify` must be able to read any text.
        pub model: String,
        /// The preset of that job, as text for the same reason.
        pub preset: String,
        /// Further facts in JSON, among them its kind.
        pub metadata_json: String,
        /// SHA-256 of the tensors, hexadecimal.
        pub weights_sha256: String,
        /// When it was stored.
        pub created_at_ms: i64,
        /// When it was archived.
        pub archived_at_ms: Option<i64>,
        /// Version of the robot's joint map that the network was trained with.
        pub joint_map_version: i64,
    }
}

list_row!(NetworkRow);

row! {
    /// A network of link parameters and its weights.
    #[derive(Clone, Debug, PartialEq)]
    pub struct NetworkWeights {
        /// `net_…`
        pub id: String,
        /// The weights in safetensors format.
        pub weights: Vec<u8>,
    }
}

/// A network to be stored with the job that trained it, with fields of [`NetworkRow`].
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // as in the row
pub struct NewNetwork {
    pub model: Model,
    pub preset: Preset,
    pub metadata_json: String,
    /// The weights in safetensors format.
    pub weights: Hashed<Vec<u8>>,
    pub weights_sha256: String,
}

impl TryFrom<StoredNetwork> for NewNetwork {
    type Error = serde_json::Error;

    fn try_from(network: StoredNetwork) -> std::result::Result<Self, serde_json::Error> {
        Ok(Self {
            model: network.metadata.model,
            preset: network.metadata.preset,
            metadata_json: serde_json::to_string(&network.metadata)?,
            weights: network.bytes.into(),
            weights_sha256: network.sha256,
        })
    }
}

macro_rules! columns {
    ($table:literal) => {
        concat!(
            "id, robot_id, job_id, model, preset, metadata_json, weights_sha256, created_at_ms,
             (select a.archived_at_ms from archived a where a.id = ", $table, ".id) as archived_at_ms,
             coalesce((select v.joint_map_version from job_robot_version w join robot_version v on v.version = w.version
                 where w.job_id = ", $table, ".job_id and v.robot_id = ", $table, ".robot_id), 1) as joint_map_version"
        )
    };
}

// SQL condition for the networks that a new job may choose: not archived, and trained with the robot's current joint map.
macro_rules! is_usable {
    ($table:literal) => {
        concat!(
            "not exists (select 1 from archived a where a.id = ", $table, ".id)
             and coalesce((select v.joint_map_version from job_robot_version w join robot_version v on v.version = w.version
                 where w.job_id = ", $table, ".job_id and v.robot_id = ", $table, ".robot_id), 1)
                 = (select r.joint_map_version from robot_now r where r.id = ", $table, ".robot_id)"
        )
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[
    INSERT,
    INSERT_RESIDUAL,
    GET,
    WEIGHTS,
    NEWEST,
    NEWEST_RESIDUAL,
    BY_ID,
];

const INSERT: &str = concat!(
    "insert into network (id, robot_id, job_id, model, preset, metadata_json, weights, weights_sha256, created_at_ms)
     values ($1, (select robot_id from job where id = $2), $2, $3, $4, $5, $6, $7, (select now_ms from clock))
     returning ",
    columns!("network")
);

const INSERT_RESIDUAL: &str = concat!(
    "insert into residual_network (id, robot_id, job_id, model, preset, metadata_json, weights, weights_sha256, created_at_ms)
     values ($1, (select robot_id from job where id = $2), $2, $3, $4, $5, $6, $7, (select now_ms from clock))
     returning ",
    columns!("residual_network")
);

const GET: &str = concat!(
    "select ",
    columns!("network"),
    " from network where id = $1 union all select ",
    columns!("residual_network"),
    " from residual_network where id = $1"
);

const WEIGHTS: &str = "select weights from network where id = $1 union all select weights from residual_network where id = $1";

const NEWEST: &str = concat!("select id, weights from network
     where robot_id = $1 and model = $2 and preset = $3 and ", is_usable!("network"), "
     order by coalesce((select v.seq from verification v where v.job_id = network.job_id), 0) desc, id desc
     limit cast($4 as bigint)");

const NEWEST_RESIDUAL: &str = concat!("select n.id as id, n.weights as weights from residual_network n
     join job j on j.id = n.job_id join measurement_set m on m.id = j.measurement_set_id
     where n.robot_id = $1 and m.sha256 <> $2 and m.insisted_on is null and ", is_usable!("n"), "
        and not exists (select 1 from parameter_set p where p.job_id = n.job_id and p.status = 'withdrawn')
        and not exists (select 1 from job_session o join measurement_set x on x.id = o.measurement_set_id
            where o.job_id = n.job_id and x.insisted_on is not null)
        and not exists (select 1 from job_source s join job k on k.id = s.source_job_id join measurement_set x on x.id = k.measurement_set_id
            left join parameter_set p on p.job_id = k.id where s.job_id = n.job_id and (x.insisted_on is not null or p.status = 'withdrawn'))
     order by coalesce((select v.seq from verification v where v.job_id = n.job_id), 0) desc, n.id desc
     limit cast($3 as bigint)");

pub(super) const LIST: ListQueries = ListQueries {
    columns: "*",
    from: concat!(
        "(select ",
        columns!("network"),
        " from network where robot_id = $1 union all select ",
        columns!("residual_network"),
        " from residual_network where robot_id = $1) as both_kinds"
    ),
    filter: "($2 = 'all' or ($2 = 'true') = (archived_at_ms is not null))",
    n_filters: 2,
    name: None,
};

const BY_ID: &str = concat!(
    "select * from (select ",
    columns!("network"),
    " from network union all select ",
    columns!("residual_network"),
    " from residual_network) as both_kinds
     where id > $1 order by id limit cast($2 as bigint)"
);

// The row does not contain the weights. `insert` adds the hash of the safetensors file to the audit entry. `weights_sha256` is the hash of the
// tensors in that file.
fn created_detail(row: &NetworkRow) -> Value {
    json!({"robot_id": row.robot_id, "job_id": row.job_id, "model": row.model, "preset": row.preset, "created_at_ms": row.created_at_ms,
        "weights_sha256": row.weights_sha256, "metadata_sha256": canonical::sha256_hex(row.metadata_json.as_bytes())})
}

audited!(NetworkRow, id, |row| vec![ExpectedEntry::at(
    AuditEvent::NetworkCreated,
    row.created_at_ms,
    created_detail(row)
)]);

/// Stores the network of link parameters of a job.
///
/// # Errors
/// [`super::Conflict::Duplicate`] if the job already has one, [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, job_id: &str, new: &NewNetwork) -> Result<NetworkRow> {
    insert_by(INSERT, tx, job_id, new).await
}

/// Stores the residual network of a job.
pub async fn insert_residual(tx: &mut Tx, job_id: &str, new: &NewNetwork) -> Result<NetworkRow> {
    insert_by(INSERT_RESIDUAL, tx, job_id, new).await
}

async fn insert_by(
    insert: &'static str,
    tx: &mut Tx,
    job_id: &str,
    new: &NewNetwork,
) -> Result<NetworkRow> {
    let values = values![
        IdPrefix::Network.new_id(),
        job_id,
        new.model.as_str(),
        new.preset.as_str(),
        new.metadata_json,
        new.weights.content(),
        new.weights_sha256
    ];
    let row: NetworkRow = sql::one(tx.connection(), insert, values).await?;
    tx.audit(AuditEvent::NetworkCreated, &row.id, created_detail(&row));
    tx.audit_field("sha256", new.weights.sha256().into());
    Ok(row)
}

/// One network.
pub async fn get(store: &Store, id: &str) -> Result<NetworkRow> {
    sql::one(store.readers(), GET, values![id]).await
}

/// The weights of one network.
pub async fn weights(store: &Store, id: &str) -> Result<Vec<u8>> {
    sql::value(store.readers(), WEIGHTS, values![id]).await
}

/// The robot's usable networks of this model and preset, newest first, at most `limit`.
pub async fn newest(
    store: &Store,
    robot_id: &str,
    model: Model,
    preset: Preset,
    limit: i64,
) -> Result<Vec<NetworkWeights>> {
    let values = values![robot_id, model.as_str(), preset.as_str(), limit];
    sql::all(store.readers(), NEWEST, values).await
}

/// The robot's usable residual networks, newest first, at most `limit`. Leaves out networks trained on the upload with this hash, on an upload
/// accepted with `insist`, or for a withdrawn set.
pub async fn newest_residual(
    store: &Store,
    robot_id: &str,
    set_sha256: &str,
    limit: i64,
) -> Result<Vec<NetworkWeights>> {
    let values = values![robot_id, set_sha256, limit];
    sql::all(store.readers(), NEWEST_RESIDUAL, values).await
}

/// A robot's networks of both kinds, filtered by archived state.
pub async fn search(
    store: &Store,
    robot_id: &str,
    request: &ListRequest,
) -> Result<Page<NetworkRow>> {
    let filters = [robot_id, request.archived.as_str()];
    listing::list(store, &LIST, &filters, request).await
}
