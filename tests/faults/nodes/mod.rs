//! Several API and compute nodes on one PostgreSQL, as real processes with real faults.

mod cluster;
mod crashes;
mod frozen;

use self::cluster::Cluster;
use crate::process::Server;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

const NO_AUTH: &[&str] = &["--no-auth"];
/// Longest time until every node knows of an event: nodes poll twice a second.
const A_SECOND: Duration = Duration::from_secs(1);
/// Longest time to serve again after PostgreSQL is back.
const SERVING_AGAIN: Duration = Duration::from_secs(2);
/// Timeout for jobs that take milliseconds on a free machine.
const PATIENCE: Duration = Duration::from_secs(60);

fn paper(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("data/paper")
        .join(name)
}

fn robot_and_set(node: &Server) -> (String, String) {
    let robot = node.robot(&paper("robot.json"));
    let set = node.set(&robot, &paper("first.csv"), "base");
    (robot, set)
}

/// A job that computes for minutes unless it is cancelled.
fn long(set: &str) -> Value {
    json!({"measurement_set_id": set, "method": "pso", "preset": "paper", "options": {"n_particles": 2000, "n_iterations": 20000}})
}

/// A job that computes for some seconds.
fn some_seconds(set: &str) -> Value {
    json!({"measurement_set_id": set, "method": "pso", "preset": "paper", "options": {"n_particles": 1000, "n_iterations": 1500}})
}

#[test]
fn a_job_posted_here_is_computed_there_and_its_events_are_heard_everywhere() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let (a, b) = (cluster.api_node(NO_AUTH), cluster.api_node(NO_AUTH));
    let _worker = cluster.worker();
    let (robot, set) = robot_and_set(&a);
    let job = a.job(&robot, &json!({"measurement_set_id": set, "method": "pso"}));
    let events = events_until_the_end(&b.url, &job);
    assert_eq!(
        events.last().map(String::as_str),
        Some("finished"),
        "{events:?}"
    );
    assert!(events.iter().any(|event| event == "progress"), "{events:?}");
    let (_, there) = b.get(&format!("/v1/jobs/{job}/report"));
    assert_eq!(
        a.get(&format!("/v1/jobs/{job}/report")).1["result_sha256"],
        there["result_sha256"]
    );
    cluster.verify();
}

/// The names of a job's server-sent events, until the server ends the stream.
fn events_until_the_end(url: &str, job: &str) -> Vec<String> {
    let address = url.trim_start_matches("http://");
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    write!(
        stream,
        "GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n"
    )
    .unwrap();
    let lines = BufReader::new(stream).lines().map_while(Result::ok);
    lines
        .filter_map(|line| line.strip_prefix("event: ").map(String::from))
        .collect()
}

#[test]
fn a_cancellation_and_a_revoked_key_are_seen_on_every_node_within_a_second() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let (a, b) = (cluster.api_node(NO_AUTH), cluster.api_node(NO_AUTH));
    let _worker = cluster.worker();
    let (robot, set) = robot_and_set(&a);
    let job = a.job(&robot, &long(&set));
    b.begun(&job);
    let asked = Instant::now();
    b.post(
        &format!("/v1/jobs/{job}/cancel"),
        "application/json",
        vec![],
    );
    assert_eq!(a.finished(&job)["status"], "cancelled");
    assert!(asked.elapsed() < A_SECOND, "{:?}", asked.elapsed());

    let guarded = cluster.api_node(&[]);
    let key = |arguments: &[&str]| {
        let url = cluster.url();
        let all = [&["key"], arguments, &["--database-url", &url]].concat();
        let output = crate::process::run(&all);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8(output.stdout).unwrap()
    };
    let printed = key(&["create", "--name", "cell-4", "--scope", "read"]);
    let secret = printed
        .split_whitespace()
        .find(|word| word.starts_with("kincal_"))
        .unwrap_or_else(|| panic!("{printed}"));
    let status = |secret: &str| {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap();
        let request = reqwest::Client::new()
            .get(format!("{}/v1/robots", guarded.url))
            .bearer_auth(secret);
        runtime.block_on(async { request.send().await.unwrap().status().as_u16() })
    };
    assert_eq!(status(secret), 200);
    key(&["revoke", "--name", "cell-4"]);
    let revoked = Instant::now();
    assert_eq!(status(secret), 401);
    assert!(revoked.elapsed() < A_SECOND);
}

/// Posts a job as a client does: a stopped process may hold a lock for some seconds, and the answer is 503 until then.
fn job_posted(node: &Server, robot: &str, request: &Value) -> String {
    let path = format!("/v1/robots/{robot}/jobs");
    let deadline = Instant::now() + PATIENCE;
    loop {
        let (status, answer) = node.post(
            &path,
            "application/json",
            serde_json::to_vec(request).unwrap(),
        );
        match status {
            202 => return answer["id"].as_str().unwrap().to_owned(),
            503 if Instant::now() < deadline => {}
            _ => panic!("{path} answered {status}: {answer}"),
        }
    }
}

#[test]
fn a_worker_that_is_killed_or_stopped_past_its_lease_gives_one_result_all_the_same() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let node = cluster.api_node(NO_AUTH);
    let (robot, set) = robot_and_set(&node);
    let alone = cluster.worker();
    let undisturbed = node.report(&robot, &some_seconds(&set))["result_sha256"].clone();
    for signal in ["KILL", "STOP"] {
        let unlucky = cluster.worker();
        alone.signal("STOP");
        let job = job_posted(&node, &robot, &some_seconds(&set));
        node.begun(&job);
        unlucky.signal(signal);
        alone.signal("CONT");
        let end = node.finished(&job);
        assert_eq!(end["status"], "succeeded", "{end}");
        if signal == "STOP" {
            unlucky.signal("CONT");
        }
        assert_eq!(
            node.get(&format!("/v1/jobs/{job}/report")).1["result_sha256"],
            undisturbed,
            "after {signal}"
        );
    }
    // The stopped node has continued meanwhile; its job must not give a second result.
    let last = node.report(&robot, &json!({"measurement_set_id": set}));
    assert!(last["result_sha256"].is_string());
    cluster.verify();
}

/// Counts of the answers of clients under load, by kind.
#[derive(Default)]
struct Tally {
    created: AtomicUsize,
    unavailable: AtomicUsize,
    other: std::sync::Mutex<Vec<String>>,
}

/// Uploads with Idempotency-Keys from several clients until the flag is set; each upload is retried until it is acknowledged. Returns the ids.
fn upload_until(
    node: &Server,
    robot: &str,
    stop: &AtomicBool,
    tally: &Tally,
    client: usize,
) -> Vec<String> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let http = reqwest::Client::builder()
        .no_proxy()
        .timeout(PATIENCE)
        .build()
        .unwrap();
    let body = std::fs::read(paper("first.csv")).unwrap();
    let mut ids = Vec::new();
    runtime.block_on(async {
        for number in 0.. {
            let key = format!("client-{client}-{number}");
            let deadline = Instant::now() + PATIENCE;
            loop {
                assert!(
                    Instant::now() < deadline,
                    "{key} was not acknowledged in {PATIENCE:?}"
                );
                let url = format!("{}/v1/robots/{robot}/measurement-sets?frame=base", node.url);
                let request = http
                    .post(url)
                    .header("content-type", "text/csv")
                    .header("idempotency-key", &key)
                    .body(body.clone());
                let Ok(response) = request.send().await else {
                    continue;
                };
                let (status, retry_after) = (
                    response.status().as_u16(),
                    response.headers().contains_key("retry-after"),
                );
                let text = response.text().await.unwrap_or_default();
                match status {
                    201 => {
                        tally.created.fetch_add(1, Ordering::Relaxed);
                        let answer: Value = serde_json::from_str(&text).unwrap();
                        ids.push(answer["id"].as_str().unwrap().to_string());
                        break;
                    }
                    503 if retry_after => {
                        tally.unavailable.fetch_add(1, Ordering::Relaxed);
                        tokio::time::sleep(Duration::from_millis(20)).await;
                    }
                    _ => tally.other.lock().unwrap().push(format!("{status} {text}")),
                }
            }
            if stop.load(Ordering::Relaxed) {
                return;
            }
        }
    });
    ids
}

/// Runs `faults` while four clients upload to two nodes, then checks that everything acknowledged is stored once.
fn under_load(cluster: &Cluster, nodes: &[Server; 2], robot: &str, faults: impl FnOnce(&Tally)) {
    let (stop, tally) = (AtomicBool::new(false), Tally::default());
    let before = n_sets(&nodes[0], robot);
    let ids: Vec<String> = std::thread::scope(|scope| {
        let clients: Vec<_> = (0..4)
            .map(|client| {
                let (stop, tally, node) = (&stop, &tally, &nodes[client % 2]);
                scope.spawn(move || upload_until(node, robot, stop, tally, client))
            })
            .collect();
        faults(&tally);
        stop.store(true, Ordering::Relaxed);
        clients
            .into_iter()
            .flat_map(|client| client.join().unwrap())
            .collect()
    });
    let other = tally.other.lock().unwrap();
    assert!(
        other.is_empty(),
        "neither 201 nor 503 with Retry-After: {:?}",
        &other[..other.len().min(3)]
    );
    println!(
        "{} acknowledged, {} times 503",
        ids.len(),
        tally.unavailable.load(Ordering::Relaxed)
    );
    let distinct: std::collections::BTreeSet<_> = ids.iter().collect();
    assert_eq!(distinct.len(), ids.len(), "an id was given twice");
    assert_eq!(
        n_sets(&nodes[1], robot),
        before + ids.len(),
        "every acknowledged upload is there once, and nothing else"
    );
    let bytes = std::fs::read(paper("first.csv")).unwrap();
    let sha256 = kincal::wire::canonical::sha256_hex(&bytes);
    for id in ids.iter().step_by((ids.len() / 20).max(1)) {
        assert_eq!(
            nodes[1].get(&format!("/v1/measurement-sets/{id}")).1["sha256"],
            json!(sha256)
        );
    }
    cluster.verify();
}

fn n_sets(node: &Server, robot: &str) -> usize {
    let mut n = 0;
    let mut cursor = String::new();
    for _ in 0..10_000 {
        let (status, page) = node.get(&format!(
            "/v1/robots/{robot}/measurement-sets?limit=100{cursor}"
        ));
        assert_eq!(status, 200, "{page}");
        n += page["items"].as_array().unwrap().len();
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => return n,
        }
    }
    panic!("the list does not end");
}

fn wait_for_more(tally: &Tally, than: usize, within: Duration) -> Option<Duration> {
    let since = Instant::now();
    while since.elapsed() < within {
        if tally.created.load(Ordering::Relaxed) > than {
            return Some(since.elapsed());
        }
        std::thread::yield_now();
    }
    None
}

#[test]
fn postgresql_restarted_and_connections_cut_under_load_lose_nothing_and_repeat_nothing() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let nodes = [cluster.api_node(NO_AUTH), cluster.api_node(NO_AUTH)];
    let _worker = cluster.worker();
    let (robot, set) = robot_and_set(&nodes[0]);
    let mut jobs = Vec::new();
    under_load(&cluster, &nodes, &robot, |tally| {
        for _ in 0..10 {
            let so_far = tally.created.load(Ordering::Relaxed);
            wait_for_more(tally, so_far + 10, PATIENCE).expect("uploads go on");
            cluster.cut_connections();
        }
        for round in 0..2 {
            jobs.push(nodes[0].job(&robot, &some_seconds(&set)));
            let so_far = tally.created.load(Ordering::Relaxed);
            wait_for_more(tally, so_far + 20, PATIENCE).expect("uploads go on");
            cluster.crash();
            cluster.up();
            let down = tally.created.load(Ordering::Relaxed);
            let again = wait_for_more(tally, down, PATIENCE).expect("uploads go on");
            println!("round {round}: serving again {again:?} after PostgreSQL was back");
            assert!(again < SERVING_AGAIN, "serving again only after {again:?}");
        }
    });
    for job in jobs {
        assert_eq!(nodes[1].finished(&job)["status"], "succeeded");
    }
    cluster.verify();
}

#[test]
fn nodes_come_and_go_and_several_may_start_on_an_empty_database_at_once() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let mut nodes: Vec<Server> = std::thread::scope(|scope| {
        let starting: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| cluster.api_node(NO_AUTH)))
            .collect();
        starting
            .into_iter()
            .map(|node| node.join().unwrap())
            .collect()
    });
    let migrated = crate::process::run(&["migrate", "--database-url", &cluster.url()]);
    let said = String::from_utf8_lossy(&migrated.stdout).into_owned();
    assert!(
        migrated.status.success() && said.contains("the schema is at version"),
        "{said}"
    );
    let _worker = cluster.worker();
    let (robot, set) = robot_and_set(&nodes[0]);
    let job = nodes[1].job(&robot, &some_seconds(&set));
    let (status, took) = nodes.remove(1).terminate();
    assert!(
        status.success() && took < Duration::from_secs(10),
        "an API node leaves in {took:?}"
    );
    nodes.remove(1).kill();
    assert_eq!(nodes[1].finished(&job)["status"], "succeeded");
    cluster.verify();
}

/// haproxy with the configuration of compose.yaml; `None` with a clear message if it is not installed.
fn proxy(nodes: &[Server; 2]) -> Option<(std::process::Child, String)> {
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let address = format!("127.0.0.1:{port}");
    let mut command = std::process::Command::new("haproxy");
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/haproxy.cfg");
    command
        .arg("-f")
        .arg(config)
        .arg("-db")
        .env("KINCAL_PROXY", &address);
    for (name, node) in ["KINCAL_NODE_1", "KINCAL_NODE_2"].into_iter().zip(nodes) {
        command.env(name, node.url.trim_start_matches("http://"));
    }
    let Ok(child) = command
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
    else {
        let _ = writeln!(
            std::io::stderr(),
            "!!! haproxy IS NOT INSTALLED: NO TEST RUNS BEHIND A PROXY !!!"
        );
        return None;
    };
    Some((child, format!("http://{address}")))
}

#[test]
fn behind_a_proxy_a_node_may_die_and_a_client_that_tries_again_loses_nothing() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let nodes = [cluster.api_node(NO_AUTH), cluster.api_node(NO_AUTH)];
    let _workers = (cluster.worker(), cluster.worker());
    let Some((mut proxy, url)) = proxy(&nodes) else {
        return;
    };
    let (robot, set) = robot_and_set(&nodes[0]);
    let [unlucky, lucky] = nodes;
    let mut unlucky = Some(unlucky);
    let http = reqwest::Client::builder()
        .no_proxy()
        .timeout(PATIENCE)
        .build()
        .unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let mut ids = std::collections::BTreeSet::new();
    for number in 0..20 {
        if number == 5
            && let Some(node) = unlucky.take()
        {
            node.kill();
        }
        let deadline = Instant::now() + PATIENCE;
        let id = loop {
            assert!(Instant::now() < deadline, "job {number} was not accepted");
            let request = http
                .post(format!("{url}/v1/robots/{robot}/jobs"))
                .header("idempotency-key", format!("job-{number}"))
                .header("content-type", "application/json")
                .body(json!({"measurement_set_id": set, "seed": number}).to_string());
            let answer = runtime.block_on(async {
                let response = request.send().await.ok()?;
                let status = response.status().as_u16();
                assert!(
                    status == 202 || status >= 502,
                    "{status}: neither accepted nor a proxy without a node"
                );
                if status == 202 {
                    response.text().await.ok()
                } else {
                    None
                }
            });
            if let Some(answer) = answer {
                break serde_json::from_str::<Value>(&answer).unwrap()["id"]
                    .as_str()
                    .unwrap()
                    .to_string();
            }
        };
        ids.insert(id);
    }
    assert_eq!(ids.len(), 20);
    for id in &ids {
        assert_eq!(lucky.finished(id)["status"], "succeeded");
    }
    let (_, page) = lucky.get(&format!("/v1/robots/{robot}/jobs?limit=100"));
    assert_eq!(
        page["items"].as_array().unwrap().len(),
        20,
        "each request had one effect"
    );
    proxy.kill().unwrap();
    proxy.wait().unwrap();
    cluster.verify();
}

#[test]
fn a_database_moves_from_the_embedded_engine_to_postgresql_and_back_with_all_it_holds() {
    let Some(cluster) = Cluster::start() else {
        return;
    };
    let home = tempfile::tempdir().unwrap();
    let (here, back) = (home.path().join("here"), home.path().join("back"));
    let server = Server::start(&here, 1);
    let (robot, set) = robot_and_set(&server);
    let swarm =
        server.finished(&server.job(&robot, &json!({"measurement_set_id": set, "method": "pso"})));
    let follow_up = server.set(&robot, &paper("followup_drifted.csv"), "base");
    let second = server.finished(&server.job(
        &robot,
        &json!({"measurement_set_id": follow_up, "method": "bpnn_pso"}),
    ));
    let parameter_set = second["parameter_set_id"].as_str().unwrap().to_string();
    let reason = json!({"reason": "moves with the rest"}).to_string();
    assert_eq!(
        server
            .post(
                &format!("/v1/parameter-sets/{parameter_set}/release"),
                "application/json",
                reason.into()
            )
            .0,
        200
    );
    let seen = |node: &Server| {
        let documents = [
            format!("/v1/robots/{robot}/parameter-sets/active"),
            format!("/v1/jobs/{}/report", second["id"].as_str().unwrap()),
            format!("/v1/networks/{}", swarm["network_id"].as_str().unwrap()),
            format!("/v1/robots/{robot}/measurement-sets"),
            format!("/v1/robots/{robot}/jobs"),
        ];
        documents.map(|path| node.get(&path)).to_vec()
    };
    let before = seen(&server);
    let copy =
        |from: &str, to: &str| crate::process::run(&["copy-store", "--from", from, "--to", to]);
    let (here, back) = (here.to_str().unwrap(), back.to_str().unwrap());
    let refused = copy(here, &cluster.url());
    assert!(
        !refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("in use"),
        "a served database is not copied"
    );
    assert!(server.terminate().0.success());
    let copied = copy(here, &cluster.url());
    assert!(
        copied.status.success(),
        "{}{}",
        String::from_utf8_lossy(&copied.stdout),
        String::from_utf8_lossy(&copied.stderr)
    );
    cluster.verify();
    let again = copy(here, &cluster.url());
    assert!(
        !again.status.success()
            && String::from_utf8_lossy(&again.stderr).contains("has rows in robot"),
        "nothing is mixed"
    );
    let node = cluster.api_node(NO_AUTH);
    assert_eq!(seen(&node), before);
    drop(node);
    let returned = copy(&cluster.url(), back);
    assert!(
        returned.status.success(),
        "{}",
        String::from_utf8_lossy(&returned.stderr)
    );
    let server = Server::start(Path::new(back), 0);
    assert_eq!(seen(&server), before);
}
