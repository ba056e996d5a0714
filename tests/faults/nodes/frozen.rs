//! A node that freezes while it holds a lock that the other nodes need.

use crate::nodes::cluster::Cluster;
use crate::nodes::{NO_AUTH, PATIENCE, Tally, paper, robot_and_set, upload_until};
use crate::process::Server;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Promise of docs/trust.md: longest time until another node writes again.
const WRITES_AGAIN: Duration = Duration::from_secs(10);
const UPLOADERS: usize = 8;

/// For how many milliseconds a session has been idle in a transaction that locked the end of the audit chain; -1 if the row is free. The session
/// that only prepared the statement has locked the table, but not yet the row.
const HELD_MS: &str = "select coalesce(max(cast(extract(epoch from clock_timestamp() - a.state_change) * 1000 as bigint)), -1)
    from pg_stat_activity a join pg_locks l on l.pid = a.pid
    where a.state = 'idle in transaction' and l.relation = 'audit_head'::regclass and l.mode = 'RowShareLock' and l.granted
        and not exists (select 1 from (select seq from audit_head for update skip locked) free)";
/// Time after which a statement that was sent before the node was stopped has arrived.
const STILL_MS: i64 = 500;

fn signal(node: &Server, name: &str) {
    let id = node.id().to_string();
    let sent = Command::new("kill").args([name, &id]).status().unwrap();
    assert!(sent.success());
}

/// Stops and continues a node under load until it is stopped while it holds the lock. Returns the time of the stop.
fn freeze_with_the_lock(cluster: &Cluster, node: &Server) -> Instant {
    let deadline = Instant::now() + PATIENCE;
    while Instant::now() < deadline {
        let stopped = Instant::now();
        signal(node, "-STOP");
        loop {
            match cluster.query(HELD_MS).parse::<i64>().unwrap() {
                -1 => break,
                held_ms if held_ms > STILL_MS => return stopped,
                _ => {}
            }
        }
        signal(node, "-CONT");
    }
    panic!("the node was never stopped with the lock");
}

fn upload(node: &Server, robot: &str) -> u16 {
    let path = format!("/v1/robots/{robot}/measurement-sets?frame=base");
    let body = std::fs::read(paper("first.csv")).unwrap();
    node.post(&path, "text/csv", body).0
}

/// The duration in the answer of `/readyz`, if it reports stuck writers, s.
fn stuck_s(ready: &str) -> Option<f64> {
    let (_, rest) = ready.split_once("no write has succeeded for ")?;
    Some(rest.split_once(" s")?.0.parse().unwrap())
}

/// On drop, continues the node and stops its uploaders, also when the test fails.
struct ContinueOnDrop<'a>(&'a Server, &'a AtomicBool);

impl Drop for ContinueOnDrop<'_> {
    fn drop(&mut self) {
        signal(self.0, "-CONT");
        self.1.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_frozen_node_stops_the_others_for_ten_seconds_at_most() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let (unlucky, other) = (cluster.api_node(NO_AUTH), cluster.api_node(NO_AUTH));
    let (robot, _) = robot_and_set(&other);
    let (stop, tally) = (AtomicBool::new(false), Tally::default());
    let (took, told, ids) = std::thread::scope(|scope| {
        let uploaders: Vec<_> = (0..UPLOADERS)
            .map(|client| {
                let (node, robot, stop, tally) = (&unlucky, &robot, &stop, &tally);
                scope.spawn(move || upload_until(node, robot, stop, tally, client))
            })
            .collect();
        let to_the_end = ContinueOnDrop(&unlucky, &stop);
        let stopped = freeze_with_the_lock(&cluster, &unlucky);
        let (writer, of) = (&other, &robot);
        let writing = scope.spawn(move || {
            while upload(writer, of) != 201 && stopped.elapsed() < WRITES_AGAIN {}
            stopped.elapsed()
        });
        let mut told: Vec<f64> = Vec::new();
        while !writing.is_finished() {
            told.extend(stuck_s(&other.text("/readyz")));
        }
        let took = writing.join().unwrap();
        assert!(
            took < WRITES_AGAIN,
            "no write for {took:?}; /readyz said at most {:.1} s, and {:?} s at last",
            told.iter().copied().fold(0.0, f64::max),
            told.last()
        );
        assert_eq!(other.text("/readyz"), "ready\n", "nobody is stuck any more");
        // The frozen node continues: its open transactions were rolled back, it answers so, and accepts the same uploads again.
        signal(&unlucky, "-CONT");
        let before = tally.created.load(Ordering::Relaxed);
        let again = crate::nodes::wait_for_more(&tally, before + 2 * UPLOADERS, PATIENCE);
        drop(to_the_end);
        again.expect("the node that was frozen takes uploads again");
        let ids: Vec<String> = uploaders
            .into_iter()
            .flat_map(|uploader| uploader.join().unwrap())
            .collect();
        (took, told, ids)
    });
    let longest = told.iter().copied().fold(0.0, f64::max);
    println!("the other node wrote again after {took:?}; /readyz said {longest} s at last");
    assert!(
        longest > 1.0 && longest < took.as_secs_f64() + 1.0,
        "/readyz says how long the writers have been stuck: {told:?}"
    );
    let distinct: std::collections::BTreeSet<_> = ids.iter().collect();
    assert_eq!(distinct.len(), ids.len());
    // In addition to the uploaders' sets: the robot's first set, and the other node's upload.
    assert_eq!(crate::nodes::n_sets(&other, &robot), ids.len() + 2);
    let odd = tally.other.lock().unwrap();
    assert!(odd.is_empty(), "neither 201 nor 503: {:?}", &odd[..1]);
    cluster.verify();
}
