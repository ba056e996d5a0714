//! `kincal demo`: the paper's calibrations through a real server on a temporary database.

use super::calibrate::{progress_bar, show};
use super::client::Client;
use super::{block_on, table};
use crate::config::ServeConfig;
use crate::http::server;
use crate::wire::job::JobAnswer;
use crate::wire::report_shape::{ErrorsReport, Report};
use anyhow::Context;
use serde_json::{Value, json};

/// The paper's data, which `demo` uploads: made by `kincal`'s own model, 100 poses each without noise.
const ROBOT: &[u8] = include_bytes!("../../data/paper/robot.json");
const SWEEPS: &[u8] = include_bytes!("../../data/paper/sweeps_instrument.csv");
const FIRST: &[u8] = include_bytes!("../../data/paper/first.csv");
const FOLLOW_UP: &[u8] = include_bytes!("../../data/paper/followup_unchanged.csv");
const CSV: &str = "text/csv";

/// Iterations of the paper's PSO and BPNN-PSO [Gao 2018, section 4.1]; the follow-up gets the same limit as the first.
const ITERATIONS: u64 = 404;
/// F that the paper's PSO ends with in its simulation [Gao 2018, section 4.1].
const PRINTED_COST_MM2: f64 = 5.5519e-5;

/// Settings of the demo.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Seed of every random number.
    #[arg(long, env = "KINCAL_SEED", default_value_t = 0)]
    seed: u64,
}

/// One finished job with its report and its curve.
struct Done {
    label: &'static str,
    report: Report,
    convergence_mm2: Vec<f64>,
}

/// Runs it.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let data_dir = tempfile::tempdir().context("cannot make a temporary folder for the database")?;
    let n_workers = std::thread::available_parallelism().map_or(1, usize::from);
    block_on(async {
        let server = server::start(&ServeConfig::loopback(data_dir.path().into(), n_workers)).await?;
        println!("kincal serves on {} with its database in {}\n", server.url(), data_dir.path().display());
        let result = calibrations(&Client::new(&server.url(), None)?, arguments.seed).await;
        server.shutdown().await;
        result
    })
}

async fn calibrations(client: &Client, seed: u64) -> anyhow::Result<()> {
    let robot = id(&client.post("/v1/robots", "application/json", ROBOT.to_vec()).await?)?;
    println!("robot ER20-C10 is {robot}");
    frames(client, &robot).await?;
    let first = upload(client, &robot, "first", FIRST).await?;
    let follow_up = upload(client, &robot, "follow-up", FOLLOW_UP).await?;
    let mut done = Vec::new();
    for preset in ["paper", "default"] {
        let labels = if preset == "paper" { ["PSO, paper's preset", "BPNN-PSO, paper's preset"] } else { ["PSO, ours", "BPNN-PSO, ours"] };
        for (label, method, set) in [(labels[0], "pso", &first), (labels[1], "bpnn_pso", &follow_up)] {
            let request = json!({
                "measurement_set_id": set, "method": method, "preset": preset, "seed": seed, "refine": false,
                "options": {"n_iterations": ITERATIONS}
            });
            done.push(calibration(client, &robot, label, &request).await?);
        }
    }
    let best = json!({"measurement_set_id": first});
    done.push(calibration(client, &robot, "method auto", &best).await?);
    print_table(&done);
    Ok(())
}

/// Uploads the sweeps of joints 1, 2 and 5 and says what they give.
async fn frames(client: &Client, robot: &str) -> anyhow::Result<()> {
    let frames = client.post(&format!("/v1/robots/{robot}/frames"), CSV, SWEEPS.to_vec()).await?;
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let at = &frames["t_instrument_base"]["translation_mm"];
    println!(
        "sweeps of joints 1, 2 and 5: base at {:.3} {:.3} {:.3} mm of the instrument, z_t = {:.3} mm",
        number(&at[0]),
        number(&at[1]),
        number(&at[2]),
        number(&frames["z_tool_mm"])
    );
    Ok(())
}

async fn upload(client: &Client, robot: &str, name: &str, csv: &[u8]) -> anyhow::Result<String> {
    let set = client.post(&format!("/v1/robots/{robot}/measurement-sets?frame=base&name={name}"), CSV, csv.to_vec()).await?;
    println!("set {name}: {} points, sha256 {:.12}…", set["n_points"], set["sha256"].as_str().unwrap_or_default());
    id(&set)
}

async fn calibration(client: &Client, robot: &str, label: &'static str, request: &Value) -> anyhow::Result<Done> {
    let job = id(&client.post_json(&format!("/v1/robots/{robot}/jobs"), request).await?)?;
    let bar = progress_bar(label);
    let moved = |job: &JobAnswer| {
        if let Some(progress) = &job.progress {
            show(&bar, progress.iteration, progress.n_iterations, progress.best_cost_mm2.unwrap_or(f64::NAN));
        }
    };
    client.follow(&job, moved).await?;
    bar.finish_and_clear();
    let report: Report = serde_json::from_value(client.get(&format!("/v1/jobs/{job}/report")).await?)?;
    let convergence = client.get(&format!("/v1/jobs/{job}/convergence")).await?;
    let convergence_mm2: Vec<f64> = serde_json::from_value(convergence["best_cost_mm2"].clone())?;
    println!("{label}: job {job}, F = {} mm², result {:.12}…", table::number(report.cost_mm2), report.result_sha256);
    Ok(Done { label, report, convergence_mm2 })
}

fn id(answer: &Value) -> anyhow::Result<String> {
    Ok(answer["id"].as_str().context("the server's answer has no id")?.to_string())
}

/// The paper's table beside what just ran.
fn print_table(done: &[Done]) {
    println!("\n{:<34}{:>11}{:>13}{:>10}{:>10}{:>10}{:>10}", "", "iterations", "F, mm²", "time, s", "mean, mm", "std, mm", "max, mm");
    println!("paper, simulation [Gao 2018, section 4.1]");
    row("  PSO", "404", "5.55e-5", "1067", None);
    row("  BPNN-PSO", "71", "6.64e-5", "183", None);
    println!("paper, experiment on the real robot [Gao 2018, section 4.2]");
    row("  PSO", "492", "17.1724", "1235", Some(["0.4614", "0.1843", "0.6500"]));
    row("  BPNN-PSO", "51", "17.2219", "162", Some(["0.4600", "0.1836", "0.6370"]));
    println!("just now, on the paper's simulated robot; errors on the 50 verify points");
    if let Some(verify) = done.first().and_then(|d| d.report.verify) {
        row("  nominal", "", "", "", Some(errors(&verify.before)).as_ref().map(|e| e.each_ref().map(String::as_str)));
    }
    for d in done {
        let time = format!("{:.3}", d.report.duration_ms / 1e3);
        let errors = d.report.verify.map(|v| errors(&v.after));
        let errors = errors.as_ref().map(|e| e.each_ref().map(String::as_str));
        row(&format!("  {}", d.label), &d.report.n_iterations.to_string(), &table::number(d.report.cost_mm2), &time, errors);
    }
    println!();
    if let [cold, follow_up, ..] = done {
        let reached_mm2 = cold.convergence_mm2.last().copied().unwrap_or(f64::NAN);
        let n = iterations_to(follow_up, reached_mm2);
        println!("{}: where the cold swarm ended {} (the paper: after 71 of 404).", follow_up.label, after(n));
    }
    if let [_, _, cold, follow_up, ..] = done {
        for (d, printed) in [(cold, 404), (follow_up, 71)] {
            println!(
                "{}: the paper's F of {PRINTED_COST_MM2:.2e} mm² {} (the paper: {printed}).",
                d.label,
                after(iterations_to(d, PRINTED_COST_MM2))
            );
        }
    }
    println!("Medians over seeds, and how least squares compares: docs/paper-comparison.md");
}

fn iterations_to(done: &Done, cost_mm2: f64) -> Option<usize> {
    done.convergence_mm2.iter().position(|f| *f <= cost_mm2)
}

fn after(n: Option<usize>) -> String {
    n.map_or_else(|| format!("not in {ITERATIONS} iterations"), |n| format!("after {n} of {ITERATIONS} iterations"))
}

fn errors(e: &ErrorsReport) -> [String; 3] {
    [e.mean_mm, e.std_mm, e.max_mm].map(table::number)
}

fn row(name: &str, iterations: &str, cost: &str, time: &str, errors: Option<[&str; 3]>) {
    let [mean, std, max] = errors.unwrap_or(["–"; 3]);
    println!("{name:<34}{iterations:>11}{cost:>13}{time:>10}{mean:>10}{std:>10}{max:>10}");
}
