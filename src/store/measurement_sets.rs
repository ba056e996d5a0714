//! Measurement sets: the uploaded bytes and what was computed from them.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::id_prefix::IdPrefix;
use super::listing::{self, ListQueries, list_row};
use super::sql::{self, rows_after, values};
use super::{AuditEvent, Conflict, ListRequest, Page, Result, Store, Tx};
use crate::wire::canonical;
use crate::wire::measurement::Frame;

row! {
    /// A measurement set without its bytes.
    #[derive(Clone, Debug, PartialEq)]
    pub struct MeasurementSetRow {
        /// `set_…`
        pub id: String,
        /// Its robot.
        pub robot_id: String,
        /// Its name; need not be unique.
        pub name: Option<String>,
        /// `base` or `instrument`.
        pub frame: Frame,
        /// Media type of the upload.
        pub content_type: String,
        /// SHA-256 of the uploaded bytes, hexadecimal.
        pub sha256: String,
        /// Number of points.
        pub n_points: i64,
        /// Number of arm configurations.
        pub n_configurations: i64,
        /// Number of targets on the tool.
        pub n_targets: i64,
        /// JSON list of warnings.
        pub warnings_json: String,
        /// When it was stored.
        pub created_at_ms: i64,
        /// Id of the key that uploaded it.
        pub uploaded_by: Option<String>,
        /// The serial number that the uploader stated.
        pub serial_number: Option<String>,
        /// Code of the suspicion that the uploader overrode with `insist`. A release must not depend on such a set.
        pub insisted_on: Option<String>,
        /// How the bytes were interpreted (`wire::understood::Reading`); none for JSON and for older sets.
        pub reading_json: Option<String>,
        /// When it was archived.
        pub archived_at_ms: Option<i64>,
        /// Its name in lower case, for sorting lists; empty without a name.
        pub sort_name: String,
    }
}

list_row!(MeasurementSetRow, sort_name);

/// A measurement set to be stored, with fields of [`MeasurementSetRow`].
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // as in the row
pub struct NewMeasurementSet {
    pub robot_id: String,
    pub name: Option<String>,
    pub frame: Frame,
    pub content_type: String,
    /// The uploaded bytes.
    pub body: Vec<u8>,
    pub sha256: String,
    pub n_points: i64,
    pub n_configurations: i64,
    pub n_targets: i64,
    pub warnings_json: String,
    pub uploaded_by: Option<String>,
    pub serial_number: Option<String>,
    pub insisted_on: Option<String>,
    pub reading_json: Option<String>,
}

macro_rules! columns {
    () => {
        "id, robot_id, name, frame, content_type, sha256, n_points, n_configurations, n_targets, warnings_json, created_at_ms,
         uploaded_by, serial_number, insisted_on, reading_json, (select a.archived_at_ms from archived a where a.id = measurement_set.id) as archived_at_ms,
         lower(coalesce(name, '')) as sort_name"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, GET, BODY, BY_ID, OTHER_ROBOTS, SAME_FILE];

const INSERT: &str = concat!(
    "insert into measurement_set (id, robot_id, name, frame, content_type, body, sha256,
         n_points, n_configurations, n_targets, warnings_json, created_at_ms, uploaded_by, serial_number, insisted_on,
         reading_json)
     values ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, (select now_ms from clock), $12, $13, $14, $15)
     returning ",
    columns!()
);

const GET: &str = concat!("select ", columns!(), " from measurement_set where id = $1");

const BODY: &str = "select body from measurement_set where id = $1";

pub(super) const LIST: ListQueries = ListQueries {
    columns: columns!(),
    from: "measurement_set",
    filter: "robot_id = $1
        and ($2 = 'all' or ($2 = 'true') = exists (select 1 from archived a where a.id = measurement_set.id))
        and ($3 = '%' or lower(name) like lower($3) escape '!')",
    n_filters: 3,
    name: Some("lower(coalesce(name, ''))"),
};

const BY_ID: &str = rows_after!(columns!(), "measurement_set");

// Number of other robots with an upload of these bytes, without archived ones: one index look-up per robot.
const OTHER_ROBOTS: &str = "select count(*) from robot r where r.id <> $1
    and not exists (select 1 from archived a where a.id = r.id)
    and exists (select 1 from measurement_set m where m.robot_id = r.id and m.sha256 = $2
        and not exists (select 1 from archived a where a.id = m.id))";

// The newest upload of these bytes to a robot. Archived uploads are left out.
const SAME_FILE: &str = concat!(
    "select ",
    columns!(),
    " from measurement_set where robot_id = $1 and sha256 = $2
        and not exists (select 1 from archived a where a.id = measurement_set.id)
     order by created_at_ms desc, id desc limit 1"
);

fn created_detail(row: &MeasurementSetRow) -> Value {
    let rest = json!([
        row.name,
        row.n_points,
        row.n_configurations,
        row.n_targets,
        row.warnings_json,
        row.created_at_ms
    ]);
    let mut created = json!({"robot_id": row.robot_id, "sha256": row.sha256, "frame": row.frame, "content_type": row.content_type,
        "serial_number": row.serial_number, "uploaded_by": row.uploaded_by, "rest_sha256": canonical::sha256_hex(rest.to_string().as_bytes())});
    // The field is written only if it has a value, because audit entries from before `insist` existed do not have it.
    if let Some(code) = &row.insisted_on {
        created["insisted_on"] = json!(code);
    }
    // The entries of JSON uploads and of older sets do not have this field.
    if let Some(reading) = &row.reading_json {
        created["reading_sha256"] = json!(canonical::sha256_hex(reading.as_bytes()));
    }
    created
}

// The column `uploaded_by` is newer than the audit chain, so some older sets have an entry but no uploader.
audited!(MeasurementSetRow, id, |row| vec![ExpectedEntry {
    by: row.uploaded_by.is_some().then_some("uploaded_by"),
    ..ExpectedEntry::at(
        AuditEvent::MeasurementSetCreated,
        row.created_at_ms,
        created_detail(row)
    )
}]);

/// Stores a measurement set.
///
/// # Errors
/// [`super::Error::NotFound`] if there is no such robot, [`Conflict::RobotArchived`], [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: &NewMeasurementSet) -> Result<MeasurementSetRow> {
    tx.require_disk_space()?;
    let values = values![
        IdPrefix::MeasurementSet.new_id(),
        new.robot_id,
        new.name,
        new.frame.as_str(),
        new.content_type,
        new.body,
        new.sha256,
        new.n_points,
        new.n_configurations,
        new.n_targets,
        new.warnings_json,
        new.uploaded_by,
        new.serial_number,
        new.insisted_on,
        new.reading_json
    ];
    let row: MeasurementSetRow = sql::one(tx.connection(), INSERT, values)
        .await
        .map_err(|error| error.into_conflict_of_trigger(|_| Conflict::RobotArchived))?;
    tx.audit(
        AuditEvent::MeasurementSetCreated,
        &row.id,
        created_detail(&row),
    );
    Ok(row)
}

/// One measurement set.
pub async fn get(store: &Store, id: &str) -> Result<MeasurementSetRow> {
    sql::one(store.readers(), GET, values![id]).await
}

/// Number of other robots to which the same bytes were uploaded.
pub async fn n_other_robots(store: &Store, robot_id: &str, sha256: &str) -> Result<i64> {
    sql::value(store.readers(), OTHER_ROBOTS, values![robot_id, sha256]).await
}

/// The newest upload of the same bytes to this robot.
pub async fn same_file(
    store: &Store,
    robot_id: &str,
    sha256: &str,
) -> Result<Option<MeasurementSetRow>> {
    sql::first(store.readers(), SAME_FILE, values![robot_id, sha256]).await
}

/// The uploaded bytes of one measurement set.
pub async fn body(store: &Store, id: &str) -> Result<Vec<u8>> {
    sql::value(store.readers(), BODY, values![id]).await
}

/// A robot's measurement sets, filtered by name and archived state.
pub async fn search(
    store: &Store,
    robot_id: &str,
    request: &ListRequest,
) -> Result<Page<MeasurementSetRow>> {
    let filters = [robot_id, request.archived.as_str(), &request.pattern()];
    listing::list(store, &LIST, &filters, request).await
}
