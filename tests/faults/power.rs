//! Power loss: what a server wrote and synced is recorded, and replayed up to random moments with writes that were not synced dropped or torn,
//! sector by sector. No acknowledged upload may be missing. The same replay without the log's syncs, which is what `synchronous = NORMAL`
//! leaves, has to lose some: otherwise this test could not detect a loss.

use crate::data::paper_path;
use crate::load::{Ledger, Load};
use crate::preload;
use crate::process::{Server, kincal};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use sqlx::Connection;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, UNIX_EPOCH};

/// Environment variable with the number of crash states; 1,000 overnight.
const STATES: &str = "KINCAL_CRASH_STATES";
const STATES_BY_DEFAULT: usize = 40;
/// Bytes that a disk writes atomically.
const SECTOR: usize = 512;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Write,
    Sync,
    Truncate,
}

struct Operation {
    kind: Kind,
    /// File: 0 is the database, 1 the write-ahead log.
    file: usize,
    offset: usize,
    /// Time since the epoch, ns.
    at_ns: u64,
    bytes: Vec<u8>,
}

fn read(log: &[u8]) -> Vec<Operation> {
    let mut operations = Vec::new();
    let mut rest = log;
    // A killed process may leave an incomplete record at the end.
    while rest.len() >= 32 {
        let number = |i: usize| u64::from_le_bytes(rest[8 * i..8 * i + 8].try_into().unwrap());
        let (head, offset, length, at_ns) =
            (number(0), number(1) as usize, number(2) as usize, number(3));
        let kind = match head & 0xff {
            1 => Kind::Write,
            2 => Kind::Sync,
            _ => Kind::Truncate,
        };
        let Some(bytes) = rest.get(32..32 + length) else {
            break;
        };
        operations.push(Operation {
            kind,
            file: (head >> 8) as usize,
            offset,
            at_ns,
            bytes: bytes.to_vec(),
        });
        rest = &rest[32 + length..];
    }
    operations
}

/// Both files after a power loss that follows the first `n` operations.
fn crash_state(
    operations: &[Operation],
    n: usize,
    log_is_synced: bool,
    random: &mut ChaCha8Rng,
) -> [Vec<u8>; 2] {
    let done = &operations[..n];
    let counts = |o: &Operation, file: usize| {
        o.kind == Kind::Sync && o.file == file && (file == 0 || log_is_synced)
    };
    let durable = [0, 1].map(|file| {
        done.iter()
            .rposition(|o| counts(o, file))
            .map_or(0, |last| last + 1)
    });
    let mut files = [Vec::new(), Vec::new()];
    for (i, operation) in done.iter().enumerate() {
        let file: &mut Vec<u8> = &mut files[operation.file];
        let is_durable = i < durable[operation.file];
        match operation.kind {
            Kind::Sync => {}
            Kind::Truncate if is_durable || random.random() => file.resize(operation.offset, 0),
            Kind::Truncate => {}
            Kind::Write => {
                for (k, sector) in operation.bytes.chunks(SECTOR).enumerate() {
                    if is_durable || random.random() {
                        let at = operation.offset + k * SECTOR;
                        if file.len() < at + sector.len() {
                            file.resize(at + sector.len(), 0);
                        }
                        file[at..at + sector.len()].copy_from_slice(sector);
                    }
                }
            }
        }
    }
    files
}

/// Uploads that were acknowledged before `before_ns` and are missing in a database in this state.
async fn lost(files: &[Vec<u8>; 2], ledger: &Ledger, before_ns: u64) -> (usize, usize) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("kincal.sqlite");
    std::fs::write(&path, &files[0]).unwrap();
    std::fs::write(dir.path().join("kincal.sqlite-wal"), &files[1]).unwrap();
    let acknowledged = ledger.uploads.iter().filter_map(|upload| {
        upload
            .acknowledged
            .as_ref()
            .map(|(id, at)| (id, at, &upload.body))
    });
    let expected: Vec<(&String, &String)> = acknowledged
        .filter(|(_, at, _)| (at.duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64) < before_ns)
        .map(|(id, _, body)| (id, body))
        .collect();
    let stored = stored(&path).await.unwrap_or_default();
    let missing = expected
        .iter()
        .filter(|(id, body)| stored.get(*id).is_none_or(|bytes| bytes != body.as_bytes()))
        .count();
    (missing, expected.len())
}

async fn stored(path: &Path) -> Result<BTreeMap<String, Vec<u8>>, sqlx::Error> {
    let mut connection =
        sqlx::AnyConnection::connect(&format!("sqlite://{}", path.display())).await?;
    let sound: String = sqlx::query_scalar("pragma integrity_check")
        .fetch_one(&mut connection)
        .await?;
    if sound != "ok" {
        return Ok(BTreeMap::new());
    }
    let rows: Vec<(String, Vec<u8>)> = sqlx::query_as("select id, body from measurement_set")
        .fetch_all(&mut connection)
        .await?;
    connection.close().await?;
    Ok(rows.into_iter().collect())
}

#[test]
fn a_power_loss_at_any_moment_loses_no_acknowledged_upload() {
    let dir = tempfile::tempdir().unwrap();
    let Some(library) = preload::build(dir.path(), "recorder", include_str!("recorder.c")) else {
        return;
    };
    let (data_dir, log) = (dir.path().join("data"), dir.path().join("log"));
    let mut command = kincal(&[
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--no-auth",
        "--workers",
        "1",
        "--data-dir",
    ]);
    command
        .arg(&data_dir)
        .env("LD_PRELOAD", &library)
        .env("KINCAL_RECORD", &log);
    let server = Server::of(command);
    let robot = server.robot(&paper_path("robot.json"));
    let (load, url) = (Load::new(), server.url.clone());
    load.during(&url, &robot, || {
        std::thread::sleep(Duration::from_millis(1500)); // some uploads to lose
        server.kill();
    });
    let operations = read(&std::fs::read(&log).unwrap());
    let ledger = load.ledger.lock().unwrap();
    let first_ack = ledger
        .uploads
        .iter()
        .filter_map(|u| u.acknowledged.as_ref())
        .map(|(_, at)| *at)
        .min()
        .unwrap();
    let first_ns = first_ack.duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64;
    let first = operations.iter().position(|o| o.at_ns > first_ns).unwrap();
    let states = std::env::var(STATES)
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(STATES_BY_DEFAULT);
    sqlx::any::install_default_drivers();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let (mut looked_at, mut blind, mut states_with_loss) = (0, 0, 0);
    for _ in 0..states {
        let n = random.random_range(first + 1..operations.len());
        let before_ns = operations[n - 1].at_ns;
        let full = crash_state(&operations, n, true, &mut random);
        let (missing, expected) = runtime.block_on(lost(&full, &ledger, before_ns));
        assert_eq!(
            missing,
            0,
            "of {expected} acknowledged uploads, after {n} of {} operations",
            operations.len()
        );
        looked_at += expected;
        let normal = crash_state(&operations, n, false, &mut random);
        let (missing, expected) = runtime.block_on(lost(&normal, &ledger, before_ns));
        states_with_loss += usize::from(missing > 0);
        blind += usize::from(missing == 0 && expected > 0);
    }
    eprintln!(
        "{states} crash states of {} recorded operations: {looked_at} acknowledged uploads looked for, none lost; without the log's syncs {states_with_loss} states lose some, {blind} none",
        operations.len()
    );
    assert!(
        looked_at > 0 && states_with_loss > 0,
        "the control loses nothing: the test is blind"
    );
}
