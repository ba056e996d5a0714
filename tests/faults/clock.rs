//! The wall clock jumps by a year, forwards and back, while a server is under load.

use crate::data::paper_path;
use crate::load::{Load, all_is_well};
use crate::preload;
use crate::process::{Server, kincal};
use crate::stop::long_job;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

const DAYS: [i64; 6] = [365, 0, -365, 365, -365, 0];
/// Longest time for a poll with `wait_s=1` on a busy machine, whatever the clock shows.
const POLLED_WITHIN: Duration = Duration::from_secs(10);

struct Clock(File);

impl Clock {
    fn set_offset_days(&self, days: i64) {
        self.0
            .write_all_at(&(days * 86_400_000_000_000).to_ne_bytes(), 0)
            .unwrap();
    }
}

/// Starts a server with short leases and many attempts, because each jump forward ends all leases.
fn serve(data_dir: &Path, library: &Path, clock: &Path) -> Command {
    let mut command = kincal(&[
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--no-auth",
        "--workers",
        "2",
        "--data-dir",
    ]);
    command
        .arg(data_dir)
        .env("LD_PRELOAD", library)
        .env("KINCAL_CLOCK", clock);
    command
        .env("KINCAL_LEASE_S", "1")
        .env("KINCAL_MAX_ATTEMPTS", "20");
    command
}

#[test]
fn a_clock_that_jumps_by_a_year_gives_no_second_result_and_loses_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let Some(library) = preload::build(dir.path(), "clock", include_str!("clock.c")) else {
        return;
    };
    let (data_dir, clock_file) = (dir.path().join("data"), dir.path().join("clock"));
    std::fs::write(&clock_file, [0; 8]).unwrap();
    let clock = Clock(File::options().write(true).open(&clock_file).unwrap());
    let mut server = Server::of(serve(&data_dir, &library, &clock_file));
    let (robot, own) = (
        server.robot(&paper_path("robot.json")),
        server.robot(&paper_path("robot.json")),
    );
    let set = server.set(&own, &paper_path("first.csv"), "base");
    let load = Load::new();
    let url = server.url.clone();
    let mut years = Vec::new();
    let long = server.job(&own, &long_job(&set));
    server.begun(&long);
    load.during(&url, &robot, || {
        for days in DAYS {
            clock.set_offset_days(days);
            std::thread::sleep(Duration::from_millis(300)); // some load at this time
            let begun = Instant::now();
            let (status, job) = server.get(&format!("/v1/jobs/{long}?wait_s=1"));
            assert!(
                status == 200 && begun.elapsed() < POLLED_WITHIN,
                "{status} after {:?}: {job}",
                begun.elapsed()
            );
            let probe = server.set(&own, &paper_path("first.csv"), "base");
            years.push(
                server.get(&format!("/v1/measurement-sets/{probe}")).1["created_at"]
                    .as_str()
                    .unwrap()[..4]
                    .to_owned(),
            );
        }
    });
    let different = years
        .iter()
        .collect::<std::collections::BTreeSet<_>>()
        .len();
    assert!(different >= 3, "the server saw the clock jump: {years:?}");
    // The same idempotency key has no second effect after a jump.
    resend(&server, &load, &robot);
    // A start in the past: interrupted jobs run again; they do not wait for leases that end next year.
    clock.set_offset_days(-365);
    server.kill();
    server = Server::of(serve(&data_dir, &library, &clock_file));
    load.retry(&server.url, &robot);
    let end = server.finished(&long);
    assert_eq!(end["status"], "succeeded", "{end}");
    let (_, results) = server.get(&format!("/v1/robots/{own}/parameter-sets"));
    assert_eq!(
        results["items"].as_array().unwrap().len(),
        1,
        "one job, one result: {results}"
    );
    let ledger = load.ledger.lock().unwrap();
    assert!(ledger.refusals.is_empty(), "{:?}", ledger.refusals);
    eprintln!(
        "{} jumps, years {years:?}: {} uploads, {} jobs",
        DAYS.len(),
        ledger.uploads.len(),
        ledger.jobs.len()
    );
    all_is_well(server, &robot, &data_dir, &ledger);
}

fn resend(server: &Server, load: &Load, robot: &str) {
    let ledger = load.ledger.lock().unwrap();
    let mut known = ledger
        .uploads
        .iter()
        .filter_map(|upload| Some((upload, &upload.acknowledged.as_ref()?.0)));
    let (upload, id) = known.next().expect("an acknowledged upload");
    let path = format!("/v1/robots/{robot}/measurement-sets?frame=base");
    let (status, answer) = server.post_with_key(
        &path,
        "text/csv",
        upload.body.clone().into_bytes(),
        &upload.key,
    );
    assert_eq!(
        (status, answer["id"].as_str()),
        (201, Some(id.as_str())),
        "{answer}"
    );
}

/// Days by which the clock is ahead when the first set is released.
const AHEAD_DAYS: i64 = 30;

#[test]
fn a_release_under_a_clock_that_was_ahead_is_not_what_a_rollback_goes_to() {
    let dir = tempfile::tempdir().unwrap();
    let Some(library) = preload::build(dir.path(), "clock", include_str!("clock.c")) else {
        return;
    };
    let (data_dir, clock_file) = (dir.path().join("data"), dir.path().join("clock"));
    std::fs::write(&clock_file, [0; 8]).unwrap();
    let clock = Clock(File::options().write(true).open(&clock_file).unwrap());
    let server = Server::of(serve(&data_dir, &library, &clock_file));
    let robot = server.robot(&paper_path("robot.json"));
    let set = server.set(&robot, &paper_path("first_noisy.csv"), "base");
    let decide = |path: &str| {
        let body = br#"{"reason": "better"}"#.to_vec();
        let (status, answer) = server.post(path, "application/json", body);
        assert_eq!(status, 200, "{answer}");
        answer
    };
    let mut sets = Vec::new();
    for days in [AHEAD_DAYS, 0, 0] {
        let request = serde_json::json!({"measurement_set_id": set, "method": "least_squares"});
        let job = server.finished(&server.job(&robot, &request));
        let id = job["parameter_set_id"].as_str().unwrap().to_owned();
        clock.set_offset_days(days);
        decide(&format!("/v1/parameter-sets/{id}/release"));
        clock.set_offset_days(0);
        sets.push(id);
    }
    for back_to in [1, 0] {
        let active = decide(&format!("/v1/robots/{robot}/parameter-sets/rollback"));
        assert_eq!(active["id"], sets[back_to]);
    }
}
