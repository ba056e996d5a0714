//! How the cost of a swarm's evaluation grows with particles and poses, on one core and on all; and the complete model's to the paper's.
//!
//! `cargo run --release --example study growth data/paper/robot.json data/paper/first.csv` writes the table of docs/performance.md.

use crate::throughput;
use anyhow::{Context, bail};
use kincal::identification::model::identifiability::prior_scales;
use kincal::identification::model::objective::Observation;
use kincal::identification::model::parameters::complete_parameters;
use kincal::identification::model::search_space::SearchSpace;
use kincal::identification::search::swarm::SwarmCost;
use kincal::kinematics::reach_mm;
use kincal::solvers::pso;
use std::hint::black_box;
use std::time::Instant;

/// Evaluations are repeated until this many particles times poses are done, at least [`REPETITIONS`] times; the fastest counts.
const WORK: usize = 100_000_000;
const REPETITIONS: usize = 15;

/// Runs the study.
pub fn study(arguments: &[String]) -> anyhow::Result<()> {
    let [robot, set] = arguments else {
        bail!("usage: growth ROBOT.json SET.csv")
    };
    let (robot, set) = (
        std::fs::read(robot).context("the robot file")?,
        std::fs::read(set).context("the measurement set")?,
    );
    let (paper, observations) = throughput::problem(&robot, &set)?;
    let parameters = complete_parameters(paper.reference.links.len(), 1);
    let scale = prior_scales(&parameters, reach_mm(&paper.reference.links));
    let complete = SearchSpace::raw(paper.reference.clone(), parameters, scale);
    let n_cores = std::thread::available_parallelism()?.get();
    println!(
        "| model | particles | poses | us per evaluation, one core | ns per particle and pose | us, {n_cores} cores |"
    );
    println!("|---|---:|---:|---:|---:|---:|");
    for (name, space) in [("paper", &paper), ("complete", &complete)] {
        for (particles, poses) in [
            (200, 50),
            (400, 50),
            (1000, 50),
            (200, 100),
            (200, 500),
            (1000, 1000),
            (10_000, 1000),
        ] {
            let observations: Vec<Observation> =
                observations.iter().cycle().take(poses).cloned().collect();
            let one = evaluation_us(space, &observations, particles, 1);
            let all = evaluation_us(space, &observations, particles, n_cores);
            let each = 1e3 * one / (particles * poses) as f64;
            println!("| {name} | {particles} | {poses} | {one:.1} | {each:.3} | {all:.1} |");
        }
    }
    Ok(())
}

/// Of every particle to the last pose: what a swarm gives up early depends on the problem.
fn evaluation_us(
    space: &SearchSpace,
    observations: &[Observation],
    n_particles: usize,
    n_threads: usize,
) -> f64 {
    let mut cost = SwarmCost::new(space, observations).on_threads(n_threads);
    let n = space.n_coordinates();
    let search_box = pso::SearchBox {
        centre: vec![0.0; n],
        half_width: vec![0.5; n],
    };
    let positions = pso::initial_positions(
        &search_box,
        &pso::Options {
            n_particles,
            ..pso::Options::default()
        },
    );
    let mut costs = vec![0.0; n_particles];
    let work = n_particles * observations.len();
    let repetitions = (WORK / work).clamp(REPETITIONS, 2_000);
    let before = worked_us();
    let mut fastest = f64::INFINITY;
    for _ in 0..repetitions {
        let begun = Instant::now();
        cost.evaluate(black_box(&positions), &mut costs);
        fastest = fastest.min(begun.elapsed().as_secs_f64() * 1e6);
    }
    // an evaluation that is longer than the system's time slice is interrupted for others on a busy machine: what it worked counts
    match (before, worked_us()) {
        (Some(before), Some(after)) if n_threads == 1 && work >= LONG => {
            (after - before) / repetitions as f64
        }
        _ => fastest,
    }
}

/// Particles times poses that take longer than some milliseconds.
const LONG: usize = 5_000_000;

/// What this thread has run so far, on Linux.
fn worked_us() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split(' ').next()?.parse::<f64>().ok()? / 1e3)
}
