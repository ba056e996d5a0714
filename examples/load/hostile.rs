//! Hostile bodies: how fast they are answered, and how much memory they cost.

use anyhow::Context;
use kincal::http::MAX_BODY_BYTES;
use std::time::{Duration, Instant};

/// Promised time to the answer.
const WITHIN: Duration = Duration::from_secs(1);
const HEADER: &str = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n";
const MILLION: usize = 1_000_000;

/// A body and its headers.
struct Hostile {
    what: &'static str,
    content_type: &'static str,
    encoding: Option<&'static str>,
    body: Vec<u8>,
}

fn all() -> Vec<Hostile> {
    let plain = |what, content_type, body: String| Hostile {
        what,
        content_type,
        encoding: None,
        body: body.into_bytes(),
    };
    let nested =
        |open: &str, close: &str| format!("{}1{}", open.repeat(MILLION), close.repeat(MILLION));
    let points = "{\"q_deg\":[],\"position_mm\":[0,0,0]},".repeat(900_000);
    let mut cell = String::from(HEADER);
    cell.extend(std::iter::repeat_n('1', MAX_BODY_BYTES - HEADER.len()));
    vec![
        Hostile {
            what: "gzip bomb",
            content_type: "text/csv",
            encoding: Some("gzip"),
            body: vec![0x1f; 1000],
        },
        plain(
            "JSON of lists, 10⁶ deep",
            "application/json",
            nested("[", "]"),
        ),
        plain(
            "JSON of objects, 10⁶ deep",
            "application/json",
            nested("{\"a\":", "}"),
        ),
        plain(
            "10⁶ rows of CSV",
            "text/csv",
            HEADER.to_owned() + &"1,2,3,4,5,6,7,8,9\n".repeat(MILLION),
        ),
        plain(
            "900,000 points of JSON",
            "application/json",
            format!(
                "{{\"frame\":\"base\",\"points\":[{}]}}",
                points.trim_end_matches(',')
            ),
        ),
        plain("one cell of 32 MiB", "text/csv", cell),
    ]
}

/// Uploads each body alone, and then the largest 64 times concurrently. Prints a table.
pub async fn bodies(client: &reqwest::Client, url: &str) -> anyhow::Result<()> {
    println!("\n| body | at once | answers | slowest, s | target, s |\n|---|---|---|---|---|");
    let hostile = all();
    for each in &hostile {
        row(client, url, each, 1).await?;
    }
    row(client, url, hostile.last().context("one")?, 64).await
}

async fn row(
    client: &reqwest::Client,
    url: &str,
    hostile: &Hostile,
    at_once: usize,
) -> anyhow::Result<()> {
    let mut uploads = tokio::task::JoinSet::new();
    for _ in 0..at_once {
        let request = client
            .post(url)
            .header("content-type", hostile.content_type)
            .body(hostile.body.clone());
        let request = hostile
            .encoding
            .into_iter()
            .fold(request, |request, encoding| {
                request.header("content-encoding", encoding)
            });
        uploads.spawn(async move {
            let begun = Instant::now();
            // A server that answers before it has read everything may close while the client still writes.
            let status = request.send().await.map_or("cut off".into(), |answer| {
                answer.status().as_u16().to_string()
            });
            (status, begun.elapsed())
        });
    }
    let answers = uploads.join_all().await;
    let slowest = answers
        .iter()
        .map(|(_, took)| *took)
        .max()
        .unwrap_or_default();
    let mut counts = std::collections::BTreeMap::new();
    answers
        .iter()
        .for_each(|(status, _)| *counts.entry(status.as_str()).or_insert(0) += 1);
    let counts: Vec<String> = counts
        .iter()
        .map(|(status, n)| format!("{n} × {status}"))
        .collect();
    println!(
        "| {} | {at_once} | {} | {:.2} | {} |",
        hostile.what,
        counts.join(", "),
        slowest.as_secs_f64(),
        WITHIN.as_secs()
    );
    Ok(())
}
