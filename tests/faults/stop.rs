//! Workers that are stopped (SIGSTOP) past their lease and continue later.

use crate::data::paper_path;
use crate::engines::for_each_engine;
use crate::load::keeps_its_promises;
use crate::process::{Server, kincal};
use kincal::store::StoreLocation;
use serde_json::{Value, json};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// The shortest lease.
const LEASE: [(&str, &str); 1] = [("KINCAL_LEASE_S", "1")];

pub fn signal(name: &str, pid: u32) {
    assert!(
        Command::new("kill")
            .args([name, &pid.to_string()])
            .status()
            .unwrap()
            .success()
    );
}

/// A swarm that takes some seconds, so that it is stopped before it ends.
pub fn long_job(set: &str) -> Value {
    json!({"measurement_set_id": set, "method": "pso", "preset": "paper", "verify": {"source": "subset"},
        "options": {"n_particles": 200, "n_iterations": 20_000, "stop_at_cost_mm2": 0.0}})
}

#[test]
fn a_server_stopped_past_its_leases_gives_no_second_result() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start_with(dir.path(), 1, &LEASE);
    let robot = server.robot(&paper_path("robot.json"));
    let set = server.set(&robot, &paper_path("first.csv"), "base");
    let job = server.job(&robot, &long_job(&set));
    server.begun(&job);
    signal("-STOP", server.id());
    std::thread::sleep(Duration::from_secs(2)); // past the lease
    signal("-CONT", server.id());
    let end = server.finished(&job);
    assert_eq!(end["status"], "succeeded", "{end}");
    let (_, sets) = server.get(&format!("/v1/robots/{robot}/parameter-sets"));
    assert_eq!(
        sets["items"].as_array().unwrap().len(),
        1,
        "one job, one result"
    );
    assert!(server.terminate().0.success());
    keeps_its_promises(dir.path());
}

/// Starts a server without workers.
pub fn on(url: &str) -> Server {
    let mut command = kincal(&[
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--no-auth",
        "--workers",
        "0",
        "--database-url",
        url,
    ]);
    command.envs(LEASE);
    Server::of(command)
}

pub struct Node(pub Child);

impl Node {
    fn start(url: &str) -> Self {
        let mut command = kincal(&["worker", "--database-url", url, "--workers", "1"]);
        Self(
            command
                .envs(LEASE)
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        )
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_worker_node_stopped_past_its_lease_is_replaced_by_another_and_its_late_result_is_refused() {
    for_each_engine(async |database| {
        let StoreLocation::Postgres { url } = &database.location else {
            return;
        };
        // The HTTP client has its own tokio runtime, which cannot run inside this one.
        std::thread::scope(|scope| scope.spawn(|| replaced(url)).join()).unwrap();
    });
}

fn replaced(url: &str) {
    let server = on(url);
    let robot = server.robot(&paper_path("robot.json"));
    let set = server.set(&robot, &paper_path("first.csv"), "base");
    let first = Node::start(url);
    let job = server.job(&robot, &long_job(&set));
    server.begun(&job);
    signal("-STOP", first.0.id());
    let second = Node::start(url);
    let end = server.finished(&job);
    assert_eq!(
        (&end["status"], &end["attempt"]),
        (&json!("succeeded"), &json!(2)),
        "{end}"
    );
    signal("-CONT", first.0.id());
    // The first node notices when it next renews its lease or finishes. A second job runs after that.
    let jobs: Vec<String> = (0..4)
        .map(|_| {
            server.job(
                &robot,
                &json!({"measurement_set_id": set, "method": "least_squares"}),
            )
        })
        .collect();
    jobs.iter()
        .for_each(|job| assert_eq!(server.finished(job)["status"], "succeeded"));
    let again = server.get(&format!("/v1/jobs/{job}")).1;
    assert_eq!(
        (&again["parameter_set_id"], &again["finished_at"]),
        (&end["parameter_set_id"], &end["finished_at"])
    );
    let (_, sets) = server.get(&format!("/v1/robots/{robot}/parameter-sets"));
    assert_eq!(
        sets["items"].as_array().unwrap().len(),
        1 + jobs.len(),
        "one result per job"
    );
    drop((first, second, server));
    let checked = kincal(&["verify-store", "--database-url", url])
        .output()
        .unwrap();
    assert!(
        checked.status.success(),
        "{}",
        String::from_utf8_lossy(&checked.stdout)
    );
}
