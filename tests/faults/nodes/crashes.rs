//! Nodes that crash: their jobs do not fail, unless one of them kills its process again and again.

use crate::nodes::cluster::Cluster;
use crate::nodes::{NO_AUTH, PATIENCE, robot_and_set, some_seconds};
use crate::process::Server;
use kincal::store::leases::MAX_DEATHS_ALONE;
use serde_json::{Value, json};
use std::time::Instant;

const WORKERS: usize = 4;
const CRASHES: usize = 3;

/// A swarm that runs longer than its process lives.
fn endless(set: &str) -> Value {
    json!({"measurement_set_id": set, "method": "pso", "preset": "paper", "verify": {"source": "subset"},
        "options": {"n_particles": 200, "n_iterations": 100_000, "stop_at_cost_mm2": 0.0}})
}

fn get_job(node: &Server, job: &str) -> Value {
    node.get(&format!("/v1/jobs/{job}")).1
}

/// Waits until one of these jobs runs in a new attempt, and records all attempts that have started by then.
fn wait_for_new_attempt(node: &Server, jobs: &[String], seen: &mut [u64]) {
    let deadline = Instant::now() + 3 * PATIENCE;
    let attempt = |job: &Value| job["attempt"].as_u64().unwrap();
    while Instant::now() < deadline {
        let now: Vec<Value> = jobs.iter().map(|job| get_job(node, job)).collect();
        let is_new = |(job, seen): (&Value, &u64)| {
            let is_computed = job["progress"]["iteration"].as_u64().unwrap_or(0) > 0;
            job["status"] == "running" && is_computed && attempt(job) > *seen
        };
        if now.iter().zip(seen.iter()).any(is_new) {
            seen.iter_mut()
                .zip(&now)
                .for_each(|(seen, job)| *seen = attempt(job));
            return;
        }
        std::thread::yield_now();
    }
    panic!("no job was begun anew");
}

#[test]
fn crashes_of_a_node_do_not_fail_innocent_jobs() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let node = cluster.api_node(NO_AUTH);
    let (robot, set) = robot_and_set(&node);
    // At each crash every worker has a job, and many more jobs wait.
    let long: Vec<String> = (0..WORKERS)
        .map(|seed| {
            let mut request = some_seconds(&set);
            request["seed"] = json!(seed);
            request["options"]["n_iterations"] = json!(6000);
            node.job(&robot, &request)
        })
        .collect();
    let short: Vec<String> = (0..40)
        .map(|seed| {
            node.job(
                &robot,
                &json!({"measurement_set_id": set, "method": "least_squares", "seed": seed}),
            )
        })
        .collect();
    let mut seen = [0; WORKERS];
    for _ in 0..CRASHES {
        let crashing = cluster.node_of_workers(WORKERS);
        if seen == [0; WORKERS] {
            while long.iter().any(|job| get_job(&node, job)["attempt"] == 0) {}
        }
        wait_for_new_attempt(&node, &long, &mut seen);
        crashing.kill();
    }
    let _last = cluster.node_of_workers(WORKERS);
    for job in long.iter().chain(&short) {
        let end = node.finished(job);
        assert_eq!(end["status"], "succeeded", "{end}");
    }
    cluster.verify();
}

#[test]
fn a_job_that_kills_its_process_is_given_up_when_it_ran_alone() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let node = cluster.api_node(NO_AUTH);
    let (robot, set) = robot_and_set(&node);
    let poison = [node.job(&robot, &endless(&set))];
    let innocent: Vec<String> = (1..WORKERS)
        .map(|seed| {
            let mut request = some_seconds(&set);
            request["seed"] = json!(seed);
            node.job(&robot, &request)
        })
        .collect();
    // The process dies whenever it computes the poison job, and only then: once with other jobs beside it, and alone from then on.
    let mut attempts = [0];
    for _ in 0..=MAX_DEATHS_ALONE {
        assert_eq!(get_job(&node, &poison[0])["error"], Value::Null);
        let dying = cluster.node_of_workers(WORKERS);
        wait_for_new_attempt(&node, &poison, &mut attempts);
        dying.kill();
    }
    let end = node.finished(&poison[0]);
    assert_eq!(end["error"]["code"], "attempts_exhausted", "{end}");
    let _last = cluster.node_of_workers(WORKERS);
    for job in &innocent {
        let end = node.finished(job);
        assert_eq!(end["status"], "succeeded", "{end}");
    }
    cluster.verify();
}
