//! Jobs that kill their process on each attempt.

use crate::data::paper_path;
use crate::engines::for_each_engine;
use crate::load::keeps_its_promises;
use crate::process::{Server, kincal};
use crate::stop::{Node, on, signal};
use kincal::store::StoreLocation;
use kincal::store::leases::MAX_DEATHS_ALONE;
use serde_json::{Value, json};
use std::os::unix::process::ExitStatusExt;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Signal with which a stack overflow ends a process.
const SIGABRT: i32 = 6;

/// A job that runs longer than its process lives.
fn poison(set: &str) -> Value {
    json!({"measurement_set_id": set, "method": "pso", "preset": "paper", "verify": {"source": "subset"},
        "options": {"n_particles": 200, "n_iterations": 50_000, "stop_at_cost_mm2": 0.0}})
}

#[test]
fn a_job_that_takes_its_process_down_each_time_comes_to_an_end_and_others_go_on() {
    let dir = tempfile::tempdir().unwrap();
    let mut server = Server::start(dir.path(), 2);
    let robot = server.robot(&paper_path("robot.json"));
    let set = server.set(&robot, &paper_path("first.csv"), "base");
    let poison = server.job(&robot, &poison(&set));
    for death in 0..=MAX_DEATHS_ALONE {
        let begun = server.begun(&poison);
        assert_eq!(
            begun["attempt"],
            death + 1,
            "each start is an attempt of its own, and the limit counts none that a death ended: {begun}"
        );
        // First it runs beside the other job. Later it waits while a suspect runs, and it runs before the suspect after a restart.
        let other = server.job(
            &robot,
            &json!({"measurement_set_id": set, "method": "least_squares"}),
        );
        if death == 0 {
            assert_eq!(server.finished(&other)["status"], "succeeded");
        }
        assert_eq!(server.end_by("-ABRT").signal(), Some(SIGABRT));
        server = Server::start(dir.path(), 2);
        assert_eq!(
            server.finished(&other)["status"],
            "succeeded",
            "others go on"
        );
    }
    let end = server.finished(&poison);
    assert_eq!(
        (&end["status"], &end["error"]["code"]),
        (&json!("failed"), &json!("attempts_exhausted")),
        "{end}"
    );
    assert!(server.terminate().0.success());
    keeps_its_promises(dir.path());
}

#[test]
fn a_job_that_takes_its_node_down_each_time_comes_to_an_end_and_others_go_on() {
    for_each_engine(async |database| {
        let StoreLocation::Postgres { url } = &database.location else {
            return;
        };
        // The HTTP client has its own tokio runtime, which cannot run inside this one.
        std::thread::scope(|scope| scope.spawn(|| takes_nodes_down(url)).join()).unwrap();
    });
}

fn start_node(url: &str) -> Node {
    let mut command = kincal(&["worker", "--database-url", url, "--workers", "1"]);
    Node(
        command
            .env("KINCAL_LEASE_S", "1")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    )
}

/// Waits until a node has started attempt number `attempt`. Until the previous lease expires, the job still shows the previous attempt.
fn wait_for_attempt(server: &Server, job: &str, attempt: u64) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while server.begun(job)["attempt"] != attempt {
        assert!(Instant::now() < deadline, "no attempt {attempt} of {job}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn takes_nodes_down(url: &str) {
    let server = on(url);
    let robot = server.robot(&paper_path("robot.json"));
    let set = server.set(&robot, &paper_path("first.csv"), "base");
    let poison = server.job(&robot, &poison(&set));
    for attempt in 1..=1 + MAX_DEATHS_ALONE.unsigned_abs() {
        let mut node = start_node(url);
        wait_for_attempt(&server, &poison, attempt);
        signal("-ABRT", node.0.id());
        assert_eq!(node.0.wait().unwrap().signal(), Some(SIGABRT));
    }
    let other = server.job(
        &robot,
        &json!({"measurement_set_id": set, "method": "least_squares"}),
    );
    let _node = start_node(url);
    assert_eq!(
        server.finished(&other)["status"],
        "succeeded",
        "others go on"
    );
    let end = server.finished(&poison);
    assert_eq!(
        (&end["status"], &end["error"]["code"]),
        (&json!("failed"), &json!("attempts_exhausted")),
        "{end}"
    );
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
