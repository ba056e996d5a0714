//! How kincal's queue and lists behave on a PostgreSQL that holds a million jobs and a million sets.
//!
//!     cargo run --release --example study scale postgres://postgres@127.0.0.1:5432/empty [rows]
//!
//! The database must be empty. Rows are made by SQL in the database; what is measured goes through kincal's own store. The table is that of
//! docs/scaling.md.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use kincal::jobs::queue::{self, AttemptEnd};
use kincal::store::leases::{self, Eligible};
use kincal::store::{
    Lease, ListRequest, NewJob, NewMeasurementSet, NewRobot, Store, StoreLocation, jobs,
    measurement_sets, robots,
};
use kincal::wire::canonical::sha256_hex;
use kincal::wire::job::{JobRequestBody, Method};

/// Robots that the rows belong to.
const N_ROBOTS: usize = 1000;
/// Times each statement is measured.
const N_TIMES: usize = 1000;
/// Jobs that worker processes share in one measurement.
const N_COMPUTED: usize = 400;
/// Longest a measurement of worker processes may take.
const PATIENCE: Duration = Duration::from_secs(300);

/// Runs the study.
pub async fn study(arguments: &[String]) {
    let mut arguments = arguments.iter().cloned();
    let url = arguments
        .next()
        .expect("give the URL of an empty PostgreSQL database");
    let n_rows: i64 = arguments
        .next()
        .map_or(1_000_000, |n| n.parse().expect("a number of rows"));
    let store = Store::open(StoreLocation::Postgres { url: url.clone() })
        .await
        .expect("the database opens");
    println!(
        "| what, {n_rows} queued jobs and {n_rows} sets of {N_ROBOTS} robots | median ms | p99 ms |\n|---|---|---|"
    );
    let robots = fill(&store, n_rows).await;
    vacuum(&store).await;
    let robot = &robots[robots.len() / 2];

    let mut claimed = Vec::new();
    measured("claim a job", async || {
        claimed.push(claim(&store).await);
    })
    .await;
    measured("renew a lease", async || {
        let lease = &claimed[claimed.len() / 2];
        leases::heartbeat(&store, lease, Duration::from_secs(600), Some("{}"))
            .await
            .expect("the lease is ours");
    })
    .await;
    let set = measurement_sets::search(&store, robot, &page())
        .await
        .expect("a list")
        .items
        .remove(0);
    let new = NewJob {
        robot_id: robot.clone(),
        set_ids: vec![set.id.clone()],
        kind: kincal::wire::job::Kind::Identify,
        method: Method::LeastSquares,
        request_json: serde_json::to_string(&JobRequestBody::for_set(&set.id)).expect("JSON"),
        client: "study".into(),
        ..NewJob::default()
    };
    measured("post a job", async || {
        let mut tx = store.begin().await.expect("a transaction");
        queue::enqueue(&mut tx, &new).await.expect("there is room");
        tx.commit().await.expect("a commit");
    })
    .await;
    let new_set = papers_set(robot);
    measured("store a set of 100 points", async || {
        let mut tx = store.begin().await.expect("a transaction");
        measurement_sets::insert(&mut tx, &new_set)
            .await
            .expect("it is stored");
        tx.commit().await.expect("a commit");
    })
    .await;
    measured("get a job", async || {
        drop(
            jobs::get(&store, &claimed[0].job_id)
                .await
                .expect("it is there"),
        )
    })
    .await;
    measured("list 50 jobs of a robot", async || {
        drop(jobs::search(&store, robot, &page()).await.expect("a list"))
    })
    .await;
    measured("list 50 sets of a robot", async || {
        drop(
            measurement_sets::search(&store, robot, &page())
                .await
                .expect("a list"),
        )
    })
    .await;
    measured("get a set's bytes", async || {
        drop(
            measurement_sets::body(&store, &set.id)
                .await
                .expect("it is there"),
        )
    })
    .await;
    measured_few("count jobs by status, for /metrics", 5, async || {
        kincal::store::statistics::jobs(&store)
            .await
            .expect("counts");
    })
    .await;
    for lease in &claimed {
        queue::end(&store, lease, &AttemptEnd::Cancelled)
            .await
            .expect("the lease is ours");
    }
    let since = Instant::now();
    vacuum(&store).await;
    println!(
        "| vacuum analyze of everything | {:.0} | once |",
        since.elapsed().as_secs_f64() * 1e3
    );
    sqlx::query("update job set status = 'cancelled', finished_at_ms = 1 where status = 'queued'")
        .execute(store.readers())
        .await
        .expect("nothing waits any more");
    workers(&store, &url).await;
    another_client(&store, &url).await;
    store.close().await;
}

fn page() -> ListRequest {
    ListRequest {
        limit: 50,
        ..ListRequest::all()
    }
}

async fn claim(store: &Store) -> Lease {
    let mut tx = store.begin().await.expect("a transaction");
    let lease = Duration::from_secs(600);
    let job = leases::claim_in(&mut tx, Eligible::Unsuspected, "study", lease).await;
    tx.commit().await.expect("a commit");
    Lease::new(&job.expect("it answers").expect("jobs wait"), "study")
}

/// Robots, and rows of sets and queued jobs, made in the database.
async fn fill(store: &Store, n_rows: i64) -> Vec<String> {
    let mut ids = Vec::new();
    for n in 0..N_ROBOTS {
        let mut tx = store.begin().await.expect("a transaction");
        let new = NewRobot {
            name: format!("robot {n}"),
            body_json: "{}".into(),
        };
        ids.push(robots::insert(&mut tx, &new).await.expect("a robot").id);
        tx.commit().await.expect("a commit");
    }
    let since = Instant::now();
    for sql in [
        "insert into measurement_set (id, robot_id, frame, content_type, body, sha256, n_points, n_configurations, n_targets, warnings_json, created_at_ms)
         select 'set_study_' || n, robots.ids[1 + n % 1000], 'base', 'text/csv', decode(repeat('00', 200), 'hex'), 'x', 1, 1, 1, '[]', n
         from generate_series(1, $1) as n, (select array_agg(id order by id) as ids from robot) as robots",
        "insert into job (id, robot_id, measurement_set_id, kind, method, request_json, status, priority, client, turn, attempt, created_at_ms)
         select 'job_study_' || n, m.robot_id, m.id, 'identify', 'auto', '{}', 'queued', 0, 'client ' || n % 1000, n / 1000, 0, n
         from generate_series(1, $1) as n join measurement_set m on m.id = 'set_study_' || n",
    ] {
        sqlx::query(sql).bind(n_rows).execute(store.readers()).await.expect("rows are made");
    }
    eprintln!("filled in {:.0} s", since.elapsed().as_secs_f64());
    ids
}

async fn vacuum(store: &Store) {
    sqlx::query("vacuum analyze")
        .execute(store.readers())
        .await
        .expect("it vacuums");
}

async fn measured(what: &str, run: impl AsyncFnMut()) {
    measured_few(what, N_TIMES, run).await;
}

async fn measured_few(what: &str, times: usize, mut run: impl AsyncFnMut()) {
    let mut took_ms = Vec::with_capacity(times);
    for _ in 0..times {
        let since = Instant::now();
        run().await;
        took_ms.push(since.elapsed().as_secs_f64() * 1e3);
    }
    took_ms.sort_by(f64::total_cmp);
    println!(
        "| {what} | {:.2} | {:.2} |",
        took_ms[times / 2],
        took_ms[(times * 99 / 100).min(times - 1)]
    );
}

/// The paper's first set, of this robot.
fn papers_set(robot_id: &str) -> NewMeasurementSet {
    let body = std::fs::read("data/paper/first.csv").expect("the paper's data");
    NewMeasurementSet {
        robot_id: robot_id.into(),
        name: None,
        frame: kincal::wire::measurement::Frame::Base,
        content_type: "text/csv".into(),
        sha256: sha256_hex(&body),
        body,
        n_points: 100,
        n_configurations: 100,
        n_targets: 1,
        warnings_json: "[]".into(),
        uploaded_by: None,
        serial_number: None,
        insisted_on: None,
        reading_json: None,
    }
}

/// Least-squares jobs per second with 1, 2 and 4 worker processes.
async fn workers(store: &Store, url: &str) {
    println!("\n| worker processes | least-squares jobs per second |\n|---|---|");
    let robot_json = std::fs::read_to_string("data/paper/robot.json").expect("the paper's data");
    let mut tx = store.begin().await.expect("a transaction");
    let robot = robots::insert(
        &mut tx,
        &NewRobot {
            name: "paper".into(),
            body_json: robot_json,
        },
    )
    .await
    .expect("a robot");
    let set = measurement_sets::insert(&mut tx, &papers_set(&robot.id))
        .await
        .expect("a set");
    tx.commit().await.expect("a commit");
    for n_workers in [1, 2, 4] {
        let mut last = String::new();
        for _ in 0..N_COMPUTED {
            let new = NewJob {
                robot_id: robot.id.clone(),
                set_ids: vec![set.id.clone()],
                kind: kincal::wire::job::Kind::Identify,
                method: Method::LeastSquares,
                request_json: serde_json::to_string(&JobRequestBody::for_set(&set.id))
                    .expect("JSON"),
                ..NewJob::default()
            };
            let mut tx = store.begin().await.expect("a transaction");
            last = queue::enqueue(&mut tx, &new)
                .await
                .expect("there is room")
                .id;
            tx.commit().await.expect("a commit");
        }
        let since = Instant::now();
        let mut processes: Vec<Child> = (0..n_workers).map(|_| worker(url)).collect();
        // the last of one client's jobs is claimed last; counting all of a million would be most of the work
        while !jobs::get(store, &last)
            .await
            .expect("it is there")
            .status
            .is_over()
        {
            assert!(since.elapsed() < PATIENCE, "the workers did not end");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let per_second = N_COMPUTED as f64 / since.elapsed().as_secs_f64();
        println!("| {n_workers} | {per_second:.0} |");
        for process in &mut processes {
            process.kill().expect("it runs");
            process.wait().expect("it ends");
        }
    }
}

/// How long the first job of a client takes while another one's 100,000 wait, with one worker process.
async fn another_client(store: &Store, url: &str) {
    let sql = "insert into job (id, robot_id, measurement_set_id, kind, method, request_json, status, priority, client, turn, attempt, created_at_ms)
         select 'job_many_' || n, j.robot_id, j.measurement_set_id, j.kind, j.method, j.request_json, 'queued', 0, 'many', n, 0, n
         from generate_series(1, 100000) as n,
             (select * from job where status = 'succeeded' order by created_at_ms desc limit 1) as j";
    sqlx::query(sql)
        .execute(store.readers())
        .await
        .expect("jobs wait");
    let of: (String, String, String) = sqlx::query_as(
        "select robot_id, measurement_set_id, request_json from job where id = 'job_many_1'",
    )
    .fetch_one(store.readers())
    .await
    .expect("a job");
    let mut process = worker(url);
    let mut took_ms = Vec::new();
    for n in 0..20 {
        let new = NewJob {
            robot_id: of.0.clone(),
            set_ids: vec![of.1.clone()],
            kind: kincal::wire::job::Kind::Identify,
            method: Method::LeastSquares,
            request_json: of.2.clone(),
            client: format!("newcomer {n}"),
            ..NewJob::default()
        };
        let since = Instant::now();
        let mut tx = store.begin().await.expect("a transaction");
        // past the queue's limit of a robot, which is not what is measured here
        let id = jobs::insert(&mut tx, &new, None)
            .await
            .expect("it is stored")
            .id;
        tx.commit().await.expect("a commit");
        while !jobs::get(store, &id)
            .await
            .expect("it is there")
            .status
            .is_over()
        {
            assert!(since.elapsed() < PATIENCE, "the newcomer waits for ever");
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        took_ms.push(since.elapsed().as_secs_f64() * 1e3);
    }
    process.kill().expect("it runs");
    process.wait().expect("it ends");
    took_ms.sort_by(f64::total_cmp);
    println!(
        "\nFirst job of a client while 100,000 of another wait, one worker process, posted to over: median {:.0} ms, longest {:.0} ms of 20.",
        took_ms[10], took_ms[19]
    );
}

/// The binary beside this example, as `cargo build` leaves it.
fn worker(url: &str) -> Child {
    let here = std::env::current_exe().expect("a path");
    let binary = here
        .parent()
        .and_then(|examples| examples.parent())
        .expect("target/PROFILE/examples")
        .join("kincal");
    let mut command = Command::new(binary);
    command
        .args(["worker", "--workers", "1", "--database-url", url])
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
        .spawn()
        .expect("cargo build --release first: the study starts the binary")
}
