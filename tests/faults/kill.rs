//! `kill -9` and SIGTERM of a server under load.

use crate::data::paper_path;
use crate::load::{Load, all_is_well, keeps_its_promises};
use crate::process::{Server, run};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::time::{Duration, Instant};

/// Environment variable with the number of kills: 20 by default, 200 overnight.
const KILLS: &str = "KINCAL_KILLS";
const KILLS_BY_DEFAULT: usize = 20;
/// Longest time from the start of the process to its first answer, recovery included; unoptimised, on a busy machine.
const READY_AGAIN: Duration = Duration::from_secs(10);
/// Longest time from SIGTERM to the end of the process (docs/trust.md).
const STOPPED: Duration = Duration::from_secs(10);

#[test]
fn a_server_that_is_killed_at_random_moments_loses_nothing_and_does_nothing_twice() {
    let kills = std::env::var(KILLS)
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(KILLS_BY_DEFAULT);
    let dir = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let load = Load::new();
    let mut server = Server::start(dir.path(), 2);
    let robot = server.robot(&paper_path("robot.json"));
    let mut slowest = Duration::ZERO;
    for _ in 0..kills {
        let url = server.url.clone();
        let moment = Duration::from_millis(20 + random.random_range(0..400));
        load.during(&url, &robot, || {
            std::thread::sleep(moment); // kills at a random moment
            server.kill();
        });
        let begun = Instant::now();
        server = Server::start(dir.path(), 2);
        assert_eq!(server.get("/readyz").0, 200);
        slowest = slowest.max(begun.elapsed());
        load.retry(&server.url, &robot);
    }
    assert!(slowest < READY_AGAIN, "{slowest:?}");
    let ledger = load.ledger.lock().unwrap();
    eprintln!(
        "{kills} kills: {} uploads, {} jobs, ready again within {slowest:?}",
        ledger.uploads.len(),
        ledger.jobs.len()
    );
    assert!(
        ledger.uploads.len() > kills && ledger.refusals.is_empty(),
        "{:?}",
        ledger.refusals
    );
    all_is_well(server, &robot, dir.path(), &ledger);
}

#[test]
fn a_server_that_is_asked_to_stop_under_load_answers_what_it_began_and_hands_jobs_back() {
    let dir = tempfile::tempdir().unwrap();
    let load = Load::new();
    let server = Server::start(dir.path(), 2);
    let robot = server.robot(&paper_path("robot.json"));
    let url = server.url.clone();
    let (status, took) = load.during(&url, &robot, || {
        std::thread::sleep(Duration::from_millis(500)); // builds up some load
        server.terminate()
    });
    assert!(
        status.success() && took < STOPPED,
        "{status} after {took:?}"
    );
    let server = Server::start(dir.path(), 2);
    // Refused requests and failed connections are sent again. Requests that the server had accepted were answered.
    load.retry(&server.url, &robot);
    let ledger = load.ledger.lock().unwrap();
    eprintln!(
        "stopped in {took:?}: {} uploads, {} jobs",
        ledger.uploads.len(),
        ledger.jobs.len()
    );
    all_is_well(server, &robot, dir.path(), &ledger);
}

#[test]
fn a_backup_under_load_is_whole_and_can_be_served() {
    let dir = tempfile::tempdir().unwrap();
    let (data_dir, backups) = (dir.path().join("data"), dir.path().join("backups"));
    let load = Load::new();
    let server = Server::start(&data_dir, 1);
    let robot = server.robot(&paper_path("robot.json"));
    let url = server.url.clone();
    load.during(&url, &robot, || {
        for n in 0..3 {
            let to = backups.join(n.to_string());
            let made = run(&[
                "backup",
                "--data-dir",
                data_dir.to_str().unwrap(),
                to.to_str().unwrap(),
            ]);
            assert!(
                made.status.success(),
                "{}",
                String::from_utf8_lossy(&made.stderr)
            );
            let over = run(&[
                "backup",
                "--data-dir",
                data_dir.to_str().unwrap(),
                to.to_str().unwrap(),
            ]);
            assert!(
                !over.status.success()
                    && String::from_utf8_lossy(&over.stderr).contains("not empty")
            );
        }
    });
    for n in 0..3 {
        keeps_its_promises(&backups.join(n.to_string()));
    }
    let restored = Server::start(&backups.join("2"), 1);
    assert_eq!(restored.get(&format!("/v1/robots/{robot}")).0, 200);
    let (_, sets) = restored.get(&format!("/v1/robots/{robot}/measurement-sets?limit=200"));
    assert!(!sets["items"].as_array().unwrap().is_empty());
}
