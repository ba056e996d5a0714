//! Another process locks the database: reads are answered, writes are refused with `Retry-After`, and nothing is left behind afterwards.

use crate::data::paper_path;
use crate::disk::{active, released, upload};
use crate::engines::for_each_engine;
use crate::load::{body, keeps_its_promises};
use crate::process::{Server, kincal};
use crate::stop::on;
use kincal::store::StoreLocation;
use serde_json::json;
use sqlx::{AnyConnection, Connection};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Environment variable with the duration of the lock, s; 30 and more overnight.
const LOCKED_S: &str = "KINCAL_LOCKED_S";
const LOCKED_S_BY_DEFAULT: u64 = 6;
/// Longest time to a refusal: a write waits at most 5 s on SQLite (2 s for its turn, 3 s for the lock), plus the delays of a busy machine.
const REFUSED_WITHIN: Duration = Duration::from_secs(9);
/// Longest read; reads do not wait for writers. Unoptimised, on a busy machine.
const READ_WITHIN: Duration = Duration::from_secs(2);
/// Longest time until stuck writers are reported: the server reports them after 1 s, and a busy machine adds to it.
const NOTICED_WITHIN_S: f64 = 3.0;
/// Time from the statement that takes the lock to the first check.
const LOCK_TAKEN_S: f64 = 2.0;
/// Duration of a lock from which on `/readyz` answers 503.
const STUCK_TOO_LONG_S: f64 = 60.0;
/// Number of writers: more than there are connections for writers.
const WRITERS: usize = 24;

/// Holds a lock, as another process would, while `during` runs.
fn locked<T>(url: &str, lock: &'static str, during: impl FnOnce() -> T) -> T {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .unwrap();
    let mut locker = runtime.block_on(async {
        sqlx::any::install_default_drivers();
        let mut connection = AnyConnection::connect(url).await.unwrap();
        for statement in lock.split("; ") {
            sqlx::query(statement)
                .execute(&mut connection)
                .await
                .unwrap();
        }
        connection
    });
    let done = during();
    runtime.block_on(async { sqlx::query("rollback").execute(&mut locker).await.unwrap() });
    done
}

/// Runs writers that retry after each refusal, and a reader, and checks the times of their answers.
fn write_and_read(server: &Server, robot: &str) {
    let lock_s = std::env::var(LOCKED_S)
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(LOCKED_S_BY_DEFAULT);
    let begun_at = Instant::now();
    let until = begun_at + Duration::from_secs(lock_s);
    let (url, over) = (server.url.clone(), AtomicBool::new(false));
    let (refusals, reads, slowest_read) = std::thread::scope(|scope| {
        let writers: Vec<_> = (0..WRITERS)
            .map(|n| {
                scope.spawn({
                    let (url, over) = (&url, &over);
                    move || refusal_times(url, robot, n, over)
                })
            })
            .collect();
        // Also when an assertion fails: otherwise the writers would never end.
        let over_at_end = SetOnDrop(&over);
        let (mut reads, mut slowest) = (0, Duration::ZERO);
        while Instant::now() < until {
            let begun = Instant::now();
            assert_eq!(active(server, robot), 200);
            check_reported_duration(server, begun_at.elapsed());
            slowest = slowest.max(begun.elapsed() / 2);
            reads += 2;
            std::thread::sleep(Duration::from_millis(50)); // a moderate rate of reads
        }
        drop(over_at_end);
        let refusals: Vec<Duration> = writers
            .into_iter()
            .flat_map(|writer| writer.join().unwrap())
            .collect();
        (refusals, reads, slowest)
    });
    let longest = refusals.iter().max().copied().unwrap_or_default();
    eprintln!(
        "locked for {lock_s} s: {reads} reads, the slowest {slowest_read:?}; {} writers told to come back, the last after {longest:?}",
        refusals.len()
    );
    assert!(
        refusals.len() >= WRITERS && longest < REFUSED_WITHIN && slowest_read < READ_WITHIN,
        "{longest:?} {slowest_read:?}"
    );
}

/// Sets a flag when it is dropped.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// `/readyz` reports how long writers have been stuck: not longer than the first of them has waited, and not longer than the lock has been held.
fn check_reported_duration(server: &Server, locked: Duration) {
    let (status, text) = server.status_and_text("/readyz");
    let stuck_s = text
        .split_once("no write has succeeded for ")
        .and_then(|(_, rest)| rest.split_once(" s: "))
        .map(|(seconds, _)| seconds.parse::<f64>().unwrap());
    let locked_s = locked.as_secs_f64();
    match stuck_s {
        Some(stuck_s) => {
            let is_near =
                stuck_s > locked_s - NOTICED_WITHIN_S && stuck_s < locked_s + LOCK_TAKEN_S;
            assert!(is_near, "{text} after {locked_s} s");
            // The text is rounded to a tenth of a second: it can say 60.0 just before the limit.
            let is_at_limit = (stuck_s - STUCK_TOO_LONG_S).abs() < 0.1;
            let expected = if stuck_s < STUCK_TOO_LONG_S { 200 } else { 503 };
            assert!(status == expected || is_at_limit, "{status} {text}");
        }
        None => assert!(
            status == 200 && locked_s < NOTICED_WITHIN_S,
            "{status} {text}"
        ),
    }
}

/// Duration of each refusal. Any answer but 503 with `Retry-After` is a fault.
fn refusal_times(url: &str, robot: &str, writer: usize, over: &AtomicBool) -> Vec<Duration> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let mut refusals = Vec::new();
    while !over.load(Ordering::Relaxed) {
        let begun = Instant::now();
        let request = client
            .post(format!(
                "{url}/v1/robots/{robot}/measurement-sets?frame=base"
            ))
            .header("content-type", "text/csv");
        let (status, again, text) = runtime.block_on(async {
            let answer = request.body(body(writer)).send().await.unwrap();
            (
                answer.status().as_u16(),
                answer.headers().contains_key("retry-after"),
                answer.text().await.unwrap(),
            )
        });
        let says_why = text.contains("locks it") || text.contains("no connection");
        assert!(status == 503 && again && says_why, "{status} {text}");
        refusals.push(begun.elapsed());
        std::thread::sleep(Duration::from_millis(100)); // a client that retries sooner than `Retry-After`
    }
    refusals
}

#[test]
fn a_database_locked_by_somebody_else_answers_reads_and_tells_writers_to_come_back() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 1);
    let (robot, _) = released(&server);
    let url = format!("sqlite://{}", dir.path().join("kincal.sqlite").display());
    locked(&url, "begin exclusive", || write_and_read(&server, &robot));
    assert_eq!(
        upload(&server, &robot, 1).0,
        201,
        "it goes on, without a restart"
    );
    assert!(server.terminate().0.success());
    keeps_its_promises(dir.path());
}

#[test]
fn tables_locked_by_somebody_else_on_postgresql_do_the_same_and_running_jobs_end() {
    for_each_engine(async |database| {
        let StoreLocation::Postgres { url } = &database.location else {
            return;
        };
        // The HTTP client has its own tokio runtime, which cannot run inside this one.
        std::thread::scope(|scope| scope.spawn(|| on_postgresql(url)).join()).unwrap();
    });
}

#[test]
fn readyz_tells_how_long_the_writer_has_been_stuck() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), 0);
    let robot = server.robot(&paper_path("robot.json"));
    assert_eq!(server.text("/readyz"), "ready\n");
    let url = format!("sqlite://{}", dir.path().join("kincal.sqlite").display());
    locked(&url, "begin exclusive", || {
        // One writer waits and gives up; none comes after it.
        let begun = Instant::now();
        assert_eq!(upload(&server, &robot, 1).0, 503);
        check_reported_duration(&server, begun.elapsed());
        let (_, first) = server.status_and_text("/readyz");
        assert!(
            first.contains("another program locks the database"),
            "{first}"
        );
    });
    // The check needs no write. A check that waits for the lock itself may take a moment to get it.
    let free = Instant::now();
    while server.text("/readyz") != "ready\n" {
        assert!(free.elapsed() < READ_WITHIN, "nobody is stuck any more");
    }
    for_each_engine(async |database| {
        let StoreLocation::Postgres { url } = &database.location else {
            return;
        };
        std::thread::scope(|scope| scope.spawn(|| reports_on_postgresql(url)).join()).unwrap();
    });
}

fn reports_on_postgresql(url: &str) {
    let server = on(url);
    assert_eq!(server.text("/readyz"), "ready\n");
    // The lock is detected although nobody writes.
    locked(url, "begin; select seq from audit_head for update", || {
        std::thread::sleep(Duration::from_secs(2)); // the reported duration grows with time
        check_reported_duration(&server, Duration::from_secs(2));
        let (_, text) = server.status_and_text("/readyz");
        assert!(text.contains("idle in its transaction"), "{text}");
    });
    assert_eq!(server.text("/readyz"), "ready\n");
}

fn on_postgresql(url: &str) {
    let worker = kincal(&["worker", "--database-url", url, "--workers", "1"])
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let _worker = crate::stop::Node(worker);
    let server = on(url);
    let (robot, _) = released(&server);
    let set = server.set(&robot, &paper_path("first.csv"), "base");
    let job = server.job(
        &robot,
        &json!({"measurement_set_id": set, "method": "pso", "options": {"n_iterations": 300}}),
    );
    locked(
        url,
        "begin; lock table measurement_set, job, audit_head in exclusive mode",
        || write_and_read(&server, &robot),
    );
    assert_eq!(
        upload(&server, &robot, 1).0,
        201,
        "it goes on, without a restart"
    );
    assert_eq!(server.finished(&job)["status"], "succeeded");
    drop(server);
    let checked = kincal(&["verify-store", "--database-url", url])
        .output()
        .unwrap();
    assert!(
        checked.status.success(),
        "{}",
        String::from_utf8_lossy(&checked.stdout)
    );
}
