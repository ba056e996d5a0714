//! A key that may only read asks for more than can be computed: whoever writes goes on, and what must end ends.

use crate::app::{Answer, paper, text};
use crate::people::{Person, guarded};
use reqwest::Method;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;

/// More than may be under way of anything.
const CLIENTS: usize = 200;
/// A refused client comes back after this.
const PAUSE: Duration = Duration::from_millis(100);
/// Each of these takes some milliseconds; an unoptimised build computes for others on all cores meanwhile.
const WITHIN: Duration = Duration::from_secs(5);
/// So many refusals tell a flood.
const REFUSALS: usize = 50;

/// An answer, and that it came in time.
async fn soon(what: &str, answer: impl Future<Output = Answer>) -> Answer {
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
    soon(
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
    soon(
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
    soon("read by another", other.get(&parameters))
        .await
        .ok(200);
    let why = json!({"reason": "the cell makes scrap"});
    assert_eq!(
        soon(
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
