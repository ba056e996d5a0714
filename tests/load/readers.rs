//! A key that may only read floods the server with computations: writes, cancellations and withdrawals still succeed in time.

use crate::app::{Answer, paper, text};
use crate::people::{Person, guarded};
use reqwest::Method;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;

/// Concurrent clients: more than any limit on concurrent requests.
const CLIENTS: usize = 200;
/// Pause of a refused client before it retries.
const PAUSE: Duration = Duration::from_millis(100);
/// Longest time for each of the other requests: they take milliseconds, but an unoptimised build computes on all cores meanwhile.
const WITHIN: Duration = Duration::from_secs(5);
/// Number of refusals that shows that the flood is under way.
const REFUSALS: usize = 50;

/// Waits for an answer and asserts that it came in time.
async fn in_time(what: &str, answer: impl Future<Output = Answer>) -> Answer {
    let begun = Instant::now();
    let answer = answer.await;
    println!("{what}: {} after {:?}", answer.status, begun.elapsed());
    assert!(
        begun.elapsed() < WITHIN,
        "{what} took {:?}",
        begun.elapsed()
    );
    answer
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_plans_by_a_key_that_only_reads_keeps_no_upload_and_no_withdrawal_out() {
    let (app, _dir) = guarded(1).await;
    let writer = Person::new(&app, &["read", "upload", "identify", "release"]).await;
    let (reader, other) = (
        Person::new(&app, &["read"]).await,
        Person::new(&app, &["read"]).await,
    );
    let robot = writer
        .send(
            Method::POST,
            "/v1/robots",
            "application/json",
            paper("robot.json"),
        )
        .await
        .ok(201);
    let robot = format!("/v1/robots/{}", text(&robot["id"]));
    let csv = String::from_utf8(paper("first.csv")).unwrap();
    let set = writer.upload(&robot, &csv).await;
    let job = writer
        .job(
            &robot,
            &json!({"measurement_set_id": set["id"], "method": "least_squares"}),
        )
        .await;
    let parameters = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));

    let refusals = Arc::new(AtomicUsize::new(0));
    let plan = json!({"n_configurations": 60, "n_candidates": 2000}).to_string();
    let mut flood = JoinSet::new();
    for _ in 0..CLIENTS {
        let request = app
            .request(Method::POST, &format!("{robot}/pose-plans"))
            .bearer_auth(&reader.key);
        let request = request
            .header("content-type", "application/json")
            .body(plan.clone());
        let refusals = Arc::clone(&refusals);
        flood.spawn(async move {
            loop {
                let Ok(response) = request
                    .try_clone()
                    .expect("a text can be sent again")
                    .send()
                    .await
                else {
                    continue;
                };
                if response.status() != 200 {
                    assert!(
                        matches!(response.status().as_u16(), 429 | 503),
                        "{}",
                        response.status()
                    );
                    assert!(response.headers().contains_key("retry-after"));
                    refusals.fetch_add(1, Ordering::Relaxed);
                    tokio::time::sleep(PAUSE).await;
                }
            }
        });
    }
    let begun = Instant::now();
    while refusals.load(Ordering::Relaxed) < REFUSALS {
        assert!(begun.elapsed() < WITHIN, "that is no flood");
        tokio::time::sleep(PAUSE).await;
    }
    in_time(
        "upload",
        writer.send(
            Method::POST,
            &format!("{robot}/measurement-sets?frame=base"),
            "text/csv",
            csv,
        ),
    )
    .await
    .ok(201);
    in_time(
        "cancel",
        writer.send(
            Method::POST,
            &format!("/v1/jobs/{}/cancel", text(&job["id"])),
            "",
            "",
        ),
    )
    .await
    .ok(200);
    in_time("read by another", other.get(&parameters))
        .await
        .ok(200);
    let why = json!({"reason": "the cell makes scrap"});
    assert_eq!(
        in_time(
            "withdrawal",
            writer.post(&format!("{parameters}/withdraw"), &why)
        )
        .await
        .ok(200)["status"],
        "withdrawn"
    );
    flood.abort_all();
    while let Some(end) = flood.join_next().await {
        assert!(
            end.is_err_and(|error| error.is_cancelled()),
            "a client of the flood got what it should not"
        );
    }
}
