//! The metrics, and their documentation in docs/operations.md.

use crate::app::TestApp;
use std::collections::{BTreeMap, BTreeSet};

const DOCUMENT: &str = include_str!("../../../docs/operations.md");
/// Suffixes of the samples of a summary or histogram.
const ENDINGS: [&str; 3] = ["_bucket", "_sum", "_count"];

/// Names of all series in a text, each with the names of its labels: `kincal_jobs{status="queued"}`.
fn series(text: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut found = BTreeMap::<String, BTreeSet<String>>::new();
    for (at, _) in text.match_indices("kincal_") {
        let end = |text: &str| {
            text.find(|c: char| !c.is_ascii_lowercase() && c != '_')
                .unwrap_or(text.len())
        };
        let (name, rest) = text[at..].split_at(end(&text[at..]));
        let labels = found.entry(name.to_owned()).or_default();
        let Some(mut inside) = rest.strip_prefix('{') else {
            continue;
        };
        loop {
            let (label, after) = inside.split_at(end(inside));
            labels.insert(label.to_owned());
            // `label`, `label="value"` or `label!~"value"`, and then a comma or the end.
            let after = match after
                .split_once('"')
                .filter(|(sign, _)| matches!(*sign, "=" | "!=" | "=~" | "!~"))
            {
                Some((_, value)) => value.split_once('"').expect("a value has an end").1,
                None => after,
            };
            let Some(more) = after.strip_prefix(',') else {
                break;
            };
            inside = more;
        }
    }
    found
}

/// The metrics of a server after requests of each kind.
async fn scrape() -> String {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    app.upload(&robot, "first.csv").await;
    app.get("/nowhere").await.problem(404, "no_such_route");
    let answer = app.get("/metrics").await;
    assert_eq!(answer.status, 200);
    answer.text()
}

fn family(name: &str) -> &str {
    ENDINGS
        .iter()
        .find_map(|ending| name.strip_suffix(ending))
        .unwrap_or(name)
}

#[tokio::test]
async fn each_series_that_operations_md_names_is_there_with_its_labels() {
    let found = series(&scrape().await);
    let documented = series(DOCUMENT);
    assert!(documented.len() > 10, "{documented:?}");
    for (name, labels) in documented {
        // The table names histograms and summaries without suffix.
        let names = [name.clone()]
            .into_iter()
            .chain(ENDINGS.map(|ending| format!("{name}{ending}")));
        let own: BTreeSet<&String> = names
            .filter_map(|name| found.get(&name))
            .flatten()
            .collect();
        assert!(found.contains_key(&name), "{name} is not in /metrics");
        assert!(
            labels.iter().all(|label| own.contains(label)),
            "{name} has the labels {own:?}, not {labels:?}"
        );
    }
}

#[tokio::test]
async fn each_series_that_there_is_stands_in_operations_md() {
    let documented = series(DOCUMENT);
    let text = scrape().await;
    let samples = text.lines().filter(|line| !line.starts_with('#'));
    for name in samples.filter_map(|line| line.split(['{', ' ']).next()) {
        assert!(
            documented.contains_key(family(name)),
            "{name} is not in docs/operations.md"
        );
    }
}

#[tokio::test]
async fn each_code_and_status_that_an_alert_waits_for_can_come() {
    let text = scrape().await;
    let alerts = DOCUMENT
        .split("Recommended alarms:")
        .nth(1)
        .expect("the alerts")
        .split("\n`")
        .next()
        .unwrap();
    let values = |label: &str| {
        let starts: Vec<&str> = [format!("{label}=\""), format!("{label}=~\"")]
            .iter()
            .flat_map(|s| alerts.split(s.as_str()).skip(1))
            .collect();
        starts
            .iter()
            .flat_map(|rest| rest.split('"').next().unwrap().split('|'))
            .map(str::to_owned)
            .collect::<BTreeSet<String>>()
    };
    let (statuses, codes) = (values("status"), values("code"));
    assert!(
        !statuses.is_empty() && codes.len() > 3,
        "{statuses:?} {codes:?}"
    );
    for status in statuses {
        assert!(
            text.contains(&format!(
                "kincal_oldest_job_age_seconds{{status=\"{status}\"}}"
            )) || text.contains(&format!("kincal_jobs{{status=\"{status}\"}}")),
            "{status}"
        );
    }
    let sources = ["src/http/error.rs", "src/http/connection/accept.rs"].map(|path| {
        std::fs::read_to_string(format!("{}/{path}", env!("CARGO_MANIFEST_DIR"))).unwrap()
    });
    for code in codes {
        assert!(
            sources
                .iter()
                .any(|source| source.contains(&format!("\"{code}\""))),
            "nothing answers {code}"
        );
    }
}
