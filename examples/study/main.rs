//! The studies behind the tables of docs/: `cargo run --release --example study NAME [ARGUMENTS]`. What each takes and makes stands at its top.

#[path = "../../tests/support/bad_campaigns.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod bad_campaigns;
#[path = "../../tests/support/data.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod data;
#[path = "../../tests/support/drifts.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod drifts;
#[path = "../../tests/support/joint_errors.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod joint_errors;
#[path = "../../tests/support/robots.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod robots;
#[path = "../../tests/support/simulation.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod simulation;
#[path = "../throughput.rs"]
#[allow(dead_code, reason = "an example of its own")]
mod throughput;
#[path = "../../tests/support/trackers.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod trackers;

mod alignment;
mod changes;
mod corrections;
mod coverage;
mod drift;
mod estimator;
mod final_fit;
mod growth;
mod identification;
mod job_growth;
mod measured_robots;
mod noise;
mod paper;
mod poses;
mod scale;
mod sessions;
mod targets;
mod train_network;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((name, rest)) = arguments.split_first() else {
        anyhow::bail!(
            "give the name of a study: alignment, changes, corrections, coverage, drift, estimator, final_fit, growth, identification, job_growth, noise, paper, poses, scale, sessions, targets, train_network"
        )
    };
    match name.as_str() {
        "alignment" => alignment::study(rest),
        "changes" => changes::study(rest),
        "corrections" => corrections::study(rest),
        "coverage" => coverage::study(rest),
        "drift" => drift::study(rest),
        "estimator" => estimator::study(rest),
        "final_fit" => final_fit::study(rest),
        "growth" => growth::study(rest)?,
        "identification" => identification::study(rest),
        "job_growth" => job_growth::study(rest)?,
        "noise" => noise::study(rest),
        "paper" => paper::study(rest),
        "poses" => poses::study(rest),
        "scale" => tokio::runtime::Runtime::new()?.block_on(scale::study(rest)),
        "sessions" => sessions::study(rest),
        "targets" => targets::study(rest),
        "train_network" => train_network::study(),
        other => anyhow::bail!("there is no study {other}"),
    }
    Ok(())
}
