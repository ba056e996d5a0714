//! `kincal demo`: the paper's calibrations through a real server on a temporary database.

use super::calibrate::{progress_bar, show};
use super::client::Client;
use super::runtime::block_on;
use super::table;
use super::terminal::Output;
use crate::config::ServeConfig;
use crate::http::server;
use crate::wire::job_answer::JobAnswer;
use crate::wire::report_shape::{ErrorsReport, Report};
use anyhow::Context;
use reqwest::Method;
use serde_json::{Value, json};

/// The data that `demo` uploads: the paper's robot, simulated with `kincal`'s own model, 100 poses per set, without noise.
const ROBOT: &[u8] = include_bytes!("../../data/paper/robot.json");
const SWEEPS: &[u8] = include_bytes!("../../data/paper/sweeps_instrument.csv");
const FIRST: &[u8] = include_bytes!("../../data/paper/first.csv");
const FOLLOW_UP: &[u8] = include_bytes!("../../data/paper/followup_unchanged.csv");
const CSV: &str = "text/csv";

/// Iterations of the paper's PSO [Gao 2018, section 4.1]; the follow-up has the same limit.
const ITERATIONS: u64 = 404;
/// Final F of the paper's PSO in its simulation [Gao 2018, section 4.1].
const PRINTED_COST_MM2: f64 = 5.5519e-5;

/// Settings of the demo.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Seed of every random number.
    #[arg(long, env = "KINCAL_SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    output: Output,
}

/// The server's client and the command's arguments.
struct Demo<'a> {
    client: Client,
    arguments: &'a Arguments,
}

/// A finished job with its report and its convergence curve.
struct FinishedJob {
    label: &'static str,
    report: Report,
    convergence_mm2: Vec<f64>,
}

/// A row of the paper's tables: label, iterations, F in mm², time in s, and mean, standard deviation and maximum of the position error, mm.
struct Printed {
    label: &'static str,
    n_iterations: u64,
    cost_mm2: f64,
    duration_s: f64,
    errors_mm: Option<[f64; 3]>,
}

/// [Gao 2018, section 4.1]
const SIMULATION: [Printed; 2] = [
    Printed {
        label: "PSO",
        n_iterations: 404,
        cost_mm2: PRINTED_COST_MM2,
        duration_s: 1067.0,
        errors_mm: None,
    },
    Printed {
        label: "BPNN-PSO",
        n_iterations: 71,
        cost_mm2: 6.6432e-5,
        duration_s: 183.0,
        errors_mm: None,
    },
];
/// [Gao 2018, section 4.2]
const EXPERIMENT: [Printed; 2] = [
    Printed {
        label: "PSO",
        n_iterations: 492,
        cost_mm2: 17.1724,
        duration_s: 1235.0,
        errors_mm: Some([0.4614, 0.1843, 0.65]),
    },
    Printed {
        label: "BPNN-PSO",
        n_iterations: 51,
        cost_mm2: 17.2219,
        duration_s: 162.0,
        errors_mm: Some([0.46, 0.1836, 0.637]),
    },
];

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let data_dir =
        tempfile::tempdir().context("cannot make a temporary folder for the database")?;
    let n_workers = std::thread::available_parallelism().map_or(1, usize::from);
    block_on(async {
        let server =
            server::start(&ServeConfig::loopback(data_dir.path().into(), n_workers)).await?;
        let demo = Demo {
            client: Client::new(&server.url(), None, None)?,
            arguments,
        };
        demo.progress(&format!(
            "kincal serves on {} with its database in {}\n",
            server.url(),
            data_dir.path().display()
        ));
        let done = demo.calibrations().await;
        server.shutdown().await;
        let done = done?;
        arguments.output.print(&answer(&done), || text(&done))
    })
}

impl Demo<'_> {
    /// Prints a line of progress; with `--json` to standard error.
    fn progress(&self, line: &str) {
        if self.arguments.output.json {
            eprintln!("{line}");
        } else {
            say!("{line}");
        }
    }

    async fn calibrations(&self) -> anyhow::Result<Vec<FinishedJob>> {
        let robot = id(&self
            .client
            .post("/v1/robots", "application/json", ROBOT.to_vec())
            .await?)?;
        self.progress(&format!("robot ER20-C10 is {robot}"));
        self.frames(&robot).await?;
        let first = self.upload(&robot, "first", FIRST).await?;
        let follow_up = self.upload(&robot, "follow-up", FOLLOW_UP).await?;
        let mut done = Vec::new();
        for preset in ["paper", "default"] {
            let labels = if preset == "paper" {
                ["PSO, paper's preset", "BPNN-PSO, paper's preset"]
            } else {
                ["PSO, ours", "BPNN-PSO, ours"]
            };
            for (label, method, set) in [
                (labels[0], "pso", &first),
                (labels[1], "bpnn_pso", &follow_up),
            ] {
                let request = json!({
                    "measurement_set_id": set, "method": method, "model": "paper", "preset": preset, "seed": self.arguments.seed, "refine": false,
                    "options": {"n_iterations": ITERATIONS}
                });
                done.push(self.calibration(&robot, label, &request).await?);
            }
        }
        let best = json!({"measurement_set_id": first});
        done.push(self.calibration(&robot, "method auto", &best).await?);
        Ok(done)
    }

    /// Uploads the sweeps of joints 1, 2 and 5 and prints the frames that they give.
    async fn frames(&self, robot: &str) -> anyhow::Result<()> {
        let frames = self
            .client
            .post(&format!("/v1/robots/{robot}/frames"), CSV, SWEEPS.to_vec())
            .await?;
        let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
        let at = &frames["t_instrument_base"]["translation_mm"];
        self.progress(&format!(
            "sweeps of joints 1, 2 and 5: base at {:.3} {:.3} {:.3} mm of the instrument, z_t = {:.3} mm",
            number(&at[0]),
            number(&at[1]),
            number(&at[2]),
            number(&frames["z_tool_mm"])
        ));
        Ok(())
    }

    async fn upload(&self, robot: &str, name: &str, csv: &[u8]) -> anyhow::Result<String> {
        let set = self
            .client
            .post(
                &format!("/v1/robots/{robot}/measurement-sets?frame=base&name={name}"),
                CSV,
                csv.to_vec(),
            )
            .await?;
        self.progress(&format!(
            "set {name}: {} points, sha256 {:.12}…",
            set["n_points"],
            set["sha256"].as_str().unwrap_or_default()
        ));
        id(&set)
    }

    async fn calibration(
        &self,
        robot: &str,
        label: &'static str,
        request: &Value,
    ) -> anyhow::Result<FinishedJob> {
        let job = id(&self
            .client
            .send(Method::POST, &format!("/v1/robots/{robot}/jobs"), request)
            .await?)?;
        let bar = (!self.arguments.output.json).then(progress_bar);
        bar.iter().for_each(|bar| bar.set_message(label));
        let on_update = |job: &JobAnswer| {
            if let (Some(bar), Some(progress)) = (&bar, &job.progress) {
                show(bar, progress);
            }
        };
        self.client.follow(&job, on_update).await?;
        if let Some(bar) = &bar {
            bar.finish_and_clear();
        }
        let report: Report =
            serde_json::from_value(self.client.get(&format!("/v1/jobs/{job}/report")).await?)?;
        let convergence = self
            .client
            .get(&format!("/v1/jobs/{job}/convergence"))
            .await?;
        let convergence_mm2: Vec<f64> =
            serde_json::from_value(convergence["best_cost_mm2"].clone())?;
        let cost = table::number(report.cost_mm2);
        self.progress(&format!(
            "{label}: job {job}, F = {cost} mm², result {:.12}…",
            report.result_sha256
        ));
        Ok(FinishedJob {
            label,
            report,
            convergence_mm2,
        })
    }
}

fn id(answer: &Value) -> anyhow::Result<String> {
    Ok(answer["id"]
        .as_str()
        .context("the server's answer has no id")?
        .to_string())
}

/// The tables as JSON: the paper's values, and this run's.
fn answer(done: &[FinishedJob]) -> Value {
    let printed = |rows: &[Printed]| -> Vec<Value> {
        rows.iter()
            .map(|row| {
                let errors = row.errors_mm.map(|[mean, std, max]| json!({"mean_mm": mean, "std_mm": std, "max_mm": max}));
                json!({
                    "label": row.label, "n_iterations": row.n_iterations, "cost_mm2": row.cost_mm2, "duration_s": row.duration_s,
                    "errors": errors
                })
            })
            .collect()
    };
    let ran: Vec<Value> = done
        .iter()
        .map(|d| {
            json!({
                "label": d.label, "n_iterations": d.report.n_iterations, "cost_mm2": d.report.cost_mm2,
                "duration_s": d.report.duration_ms / 1e3, "verify": d.report.verify.as_ref().map(|v| json!({"before": v.before, "after": v.after})),
                "result_sha256": d.report.result_sha256, "iterations_to_the_papers_cost": iterations_to(d, PRINTED_COST_MM2)
            })
        })
        .collect();
    json!({"paper_simulation": printed(&SIMULATION), "paper_experiment": printed(&EXPERIMENT), "ran": ran})
}

/// The tables as text: the paper's values, and this run's.
fn text(done: &[FinishedJob]) -> String {
    let mut lines = vec![format!(
        "\n{:<34}{:>11}{:>13}{:>10}{:>10}{:>10}{:>10}",
        "", "iterations", "F, mm²", "time, s", "mean, mm", "std, mm", "max, mm"
    )];
    let titles = [
        "paper, simulation [Gao 2018, section 4.1]",
        "paper, experiment on the real robot [Gao 2018, section 4.2]",
    ];
    for (title, rows) in titles.into_iter().zip([&SIMULATION, &EXPERIMENT]) {
        lines.push(title.into());
        lines.extend(rows.iter().map(|printed| {
            let iterations = printed.n_iterations.to_string();
            row(
                printed.label,
                &iterations,
                &table::number(printed.cost_mm2),
                &printed.duration_s.to_string(),
                printed.errors_mm,
            )
        }));
    }
    lines.push("just now, on the paper's simulated robot; errors on the 50 verify points".into());
    if let Some(verify) = done.first().and_then(|d| d.report.verify) {
        lines.push(row("nominal", "", "", "", Some(errors_mm(&verify.before))));
    }
    lines.extend(done.iter().map(|d| {
        let (iterations, time) = (
            d.report.n_iterations.to_string(),
            format!("{:.3}", d.report.duration_ms / 1e3),
        );
        row(
            d.label,
            &iterations,
            &table::number(d.report.cost_mm2),
            &time,
            d.report.verify.map(|v| errors_mm(&v.after)),
        )
    }));
    lines.push(String::new());
    if let [cold, follow_up, ..] = done {
        let reached_mm2 = cold.convergence_mm2.last().copied().unwrap_or(f64::NAN);
        let n = iterations_to(follow_up, reached_mm2);
        lines.push(format!(
            "{}: where the cold swarm ended {} (the paper: after 71 of 404).",
            follow_up.label,
            after(n)
        ));
    }
    if let [_, _, cold, follow_up, ..] = done {
        for (d, printed) in [(cold, 404), (follow_up, 71)] {
            let n = after(iterations_to(d, PRINTED_COST_MM2));
            lines.push(format!(
                "{}: the paper's F of {PRINTED_COST_MM2:.2e} mm² {n} (the paper: {printed}).",
                d.label
            ));
        }
    }
    lines.push(
        "Medians over seeds, and how least squares compares: docs/paper-comparison.md".into(),
    );
    lines.join("\n")
}

fn iterations_to(done: &FinishedJob, cost_mm2: f64) -> Option<usize> {
    done.convergence_mm2.iter().position(|f| *f <= cost_mm2)
}

fn after(n: Option<usize>) -> String {
    n.map_or_else(
        || format!("not in {ITERATIONS} iterations"),
        |n| format!("after {n} of {ITERATIONS} iterations"),
    )
}

fn errors_mm(e: &ErrorsReport) -> [f64; 3] {
    [e.mean_mm, e.std_mm, e.max_mm]
}

fn row(
    name: &str,
    iterations: &str,
    cost: &str,
    time: &str,
    errors_mm: Option<[f64; 3]>,
) -> String {
    let [mean, std, max] = errors_mm.map_or(["–"; 3].map(String::from), |errors| {
        errors.map(table::number)
    });
    format!("  {name:<32}{iterations:>11}{cost:>13}{time:>10}{mean:>10}{std:>10}{max:>10}")
}
