//! How the time and the memory of a whole calibration grow with its rows, and where the time goes.
//!
//! Times are of the processor: other work on the machine does not count.
//!
//! `cargo run --release --example study job_growth [rows …]` writes the tables of docs/performance.md. Each size runs in a process of its own, so that its
//! peak memory is its own.

use crate::data::paper_robot;
use crate::simulation::{Campaign, Normal, limited, measure, poses, true_robot};
use anyhow::{Context, bail};
use kincal::calibration::request::PreviousSession;
use kincal::calibration::{CalibrationRequest, Event, calibrate};
use kincal::identification::KinematicModel;
use kincal::measurement::MeasurementSet;
use std::ops::ControlFlow;
use std::process::Command;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

/// Rows of the table.
const ROWS: [usize; 4] = [200, 2_000, 20_000, 100_000];
/// Of the rows, one of so many is a gross error: 15 mm.
const GROSS_EVERY: usize = 97;
const SEED: u64 = 23;

/// One run.
struct Run {
    stages: Vec<(String, Duration)>,
    total: Duration,
    longest_silence: Duration,
    peak_mib: f64,
}

/// Runs the study.
pub fn study(arguments: &[String]) -> anyhow::Result<()> {
    if let [flag, rows] = arguments
        && flag == "--one"
    {
        return one(rows.parse()?);
    }
    let rows: Vec<usize> = match arguments.is_empty() {
        true => ROWS.to_vec(),
        false => arguments
            .iter()
            .map(|n| n.parse())
            .collect::<Result<_, _>>()?,
    };
    let runs = rows
        .iter()
        .map(|n| in_a_process(*n))
        .collect::<anyhow::Result<Vec<Run>>>()?;
    println!("| rows | s | times the row above | longest silence, s | peak memory, MiB |");
    println!("|---:|---:|---:|---:|---:|");
    let mut before: Option<f64> = None;
    for (n, run) in rows.iter().zip(&runs) {
        let s = run.total.as_secs_f64();
        let times = before.map_or_else(|| "–".into(), |before| format!("{:.1}", s / before));
        before = Some(s);
        println!(
            "| {n} | {s:.3} | {times} | {:.3} | {:.0} |",
            run.longest_silence.as_secs_f64(),
            run.peak_mib
        );
    }
    let heads: Vec<String> = rows.iter().map(|n| format!("{n} rows")).collect();
    println!("\n| stage, s | {} |", heads.join(" | "));
    println!("|---|{}", "---:|".repeat(rows.len()));
    for (stage, _) in &runs[0].stages {
        let of = |run: &Run| {
            let found = run.stages.iter().find(|(name, _)| name == stage);
            found.map_or_else(|| "–".into(), |(_, t)| format!("{:.3}", t.as_secs_f64()))
        };
        let cells: Vec<String> = runs.iter().map(of).collect();
        println!("| {stage} | {} |", cells.join(" | "));
    }
    Ok(())
}

fn in_a_process(rows: usize) -> anyhow::Result<Run> {
    let output = Command::new(std::env::current_exe()?)
        .args(["job_growth", "--one", &rows.to_string()])
        .output()?;
    if !output.status.success() {
        bail!("{rows} rows: {}", String::from_utf8_lossy(&output.stderr));
    }
    let text = String::from_utf8(output.stdout)?;
    let mut run = Run {
        stages: vec![],
        total: Duration::ZERO,
        longest_silence: Duration::ZERO,
        peak_mib: f64::NAN,
    };
    for line in text.lines() {
        let (name, value) = line.split_once('=').context("a line of a run")?;
        let value: f64 = value.parse()?;
        match name {
            "total" => run.total = Duration::from_secs_f64(value),
            "silence" => run.longest_silence = Duration::from_secs_f64(value),
            "peak" => run.peak_mib = value,
            stage => run
                .stages
                .push((stage.into(), Duration::from_secs_f64(value))),
        }
    }
    Ok(run)
}

fn one(rows: usize) -> anyhow::Result<()> {
    let request = request(rows);
    let begun = worked();
    let (mut told, mut silence, mut silent_in) = (begun, Duration::ZERO, String::new());
    let (mut stage, mut stage_begun) = (String::new(), begun);
    let mut stages = Vec::new();
    let report = calibrate(&request, &mut |event| {
        let now = worked();
        if now - told > silence {
            (silence, silent_in) = (now - told, stage.clone());
        }
        told = now;
        match event {
            Event::StageStarted(name) => (stage, stage_begun) = (name.to_owned(), now),
            Event::StageEnded(name) => stages.push((name.to_owned(), now - stage_begun)),
            _ => {}
        }
        ControlFlow::Continue(())
    })?;
    let total = worked() - begun;
    eprintln!(
        "{rows} rows: rms {:.4} mm, {} warnings, longest silence in {silent_in}",
        report.identify.after.rms_mm,
        report.warnings.len()
    );
    for (name, took) in stages {
        println!("{name}={}", took.as_secs_f64());
    }
    println!("total={}", total.as_secs_f64());
    println!("silence={}", silence.as_secs_f64());
    println!("peak={}", peak_mib().unwrap_or(f64::NAN));
    Ok(())
}

/// Everything on: the default preset with corrections and a previous session of as many rows; every pose with two reflectors, sag, gross errors.
fn request(rows: usize) -> CalibrationRequest {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(SEED);
    let truth = true_robot(&nominal, 2, &mut random);
    let mut session = || campaign(&truth, rows, &mut random);
    let (before, now) = (session(), session());
    CalibrationRequest {
        previous: Some(PreviousSession {
            set: before,
            frames: None,
            estimate: None,
        }),
        ..CalibrationRequest::new(nominal, now)
    }
}

fn campaign(truth: &KinematicModel, rows: usize, random: &mut Normal) -> MeasurementSet {
    let campaign = Campaign {
        n_configurations: rows / 2,
        n_targets: 2,
        noise_mm: 0.05,
        sag_rad: 2e-4,
        ..Campaign::PLAIN
    };
    let mut set = measure(
        truth,
        &poses(campaign.n_configurations, random),
        &campaign,
        random,
    );
    for (row, point) in set.points.iter_mut().enumerate() {
        point.subset = None;
        if row % GROSS_EVERY == GROSS_EVERY - 1 {
            point.position_mm += random.vector().normalize() * 15.0;
        }
    }
    set
}

/// What this thread has worked so far: on Linux the processor's time, elsewhere that of the clock.
fn worked() -> Duration {
    let ns = || -> Option<u64> {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split(' ').next()?.parse().ok()
    };
    static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);
    ns().map_or_else(|| BEGUN.elapsed(), Duration::from_nanos)
}

/// Peak memory of this process, MiB, on Linux.
fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    Some(line.split_whitespace().next()?.parse::<f64>().ok()? / 1024.0)
}
