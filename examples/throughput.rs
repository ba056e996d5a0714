//! The public yardstick of speed: 200 particles, 492 iterations, the paper's constants, one thread, on the identify points of a set.
//!
//! `cargo run --release --example throughput -- data/paper/robot.json data/paper/first.csv` prints one line of JSON: microseconds per
//! swarm iteration, in the cost kernel alone (every particle over all poses, without what is made once per particle), and for least squares
//! from nominal to F < 1e-15; the median of the runs and the smallest, and the smallest F of the swarm.

use anyhow::{Context, bail};
use kincal::identification::KinematicModel;
use kincal::identification::model::objective::Observation;
use kincal::identification::model::parameters::paper_parameters;
use kincal::identification::model::search_space::SearchSpace;
use kincal::identification::search::fit::fit_in_space;
use kincal::identification::search::swarm::{lane_robots, prepared_poses, run_swarm};
use kincal::kinematics::batch::{LANES, LaneRobots, Lanes, sum_of_squares};
use kincal::kinematics::{Link, Robot};
use kincal::measurement::table::own_form;
use kincal::measurement::{Frame, Point, Subset};
use kincal::solvers::{least_squares, pso};
use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Instant;

/// Timed runs of the whole swarm.
const RUNS: usize = 31;
/// Half-width of the search box, as `preset: "paper"` has it.
const HALF_WIDTH_MM: f64 = 1.0;
const HALF_WIDTH_DEG: f64 = 1.0;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [robot, set] = arguments.as_slice() else {
        bail!("usage: throughput ROBOT.json SET.csv")
    };
    let (robot, set) = (
        std::fs::read(robot).context("the robot file")?,
        std::fs::read(set).context("the measurement set")?,
    );
    let (space, observations) = problem(&robot, &set)?;
    let options = pso::Options::default();

    let (mut whole_us, mut kernel_us, mut least_squares_us) = (Vec::new(), Vec::new(), Vec::new());
    let mut final_cost_mm2 = f64::INFINITY;
    for _ in 0..RUNS {
        let begun = Instant::now();
        let summary = run_swarm(
            &space,
            black_box(&observations),
            None,
            &options,
            None,
            &mut |_| ControlFlow::Continue(()),
        );
        whole_us.push(begun.elapsed().as_secs_f64() * 1e6 / (summary.n_iterations + 1) as f64);
        final_cost_mm2 = summary.best_cost;
        kernel_us.push(time_kernel(
            &space,
            &observations,
            &summary.own_best_positions,
        ));
        least_squares_us.push(time_least_squares(&space, &observations)?);
    }
    println!(
        "{}",
        serde_json::json!({
            "us_per_iteration": median(&mut whole_us),
            "us_kernel": median(&mut kernel_us),
            "us_least_squares": median(&mut least_squares_us),
            "smallest": {"us_per_iteration": whole_us[0], "us_kernel": kernel_us[0], "us_least_squares": least_squares_us[0]},
            "runs": RUNS,
            "final_cost_mm2": final_cost_mm2,
        })
    );
    Ok(())
}

/// The kernel on all particles, once for each iteration of the swarm.
fn time_kernel(
    space: &SearchSpace,
    observations: &[Observation],
    positions: &pso::Positions,
) -> f64 {
    const EVALUATIONS: usize = 493;
    let poses = prepared_poses(space, observations);
    let mut deviations = vec![Lanes::ZERO; space.parameters.len()];
    let chunk = |first: usize| {
        let mut robots = lane_robots(space);
        space.deviations_of_chunk(positions, first, &mut deviations);
        robots.set(&deviations);
        robots
    };
    let robots: Vec<LaneRobots> = (0..positions.n_particles)
        .step_by(LANES)
        .map(chunk)
        .collect();
    let begun = Instant::now();
    for _ in 0..EVALUATIONS {
        for chunk in &robots {
            black_box(sum_of_squares(black_box(chunk), &poses));
        }
    }
    begun.elapsed().as_secs_f64() * 1e6 / EVALUATIONS as f64
}

/// Least squares from nominal on the raw parameters until F < 1e-15, everything prepared anew.
fn time_least_squares(space: &SearchSpace, observations: &[Observation]) -> anyhow::Result<f64> {
    const FITS: usize = 50;
    let options = least_squares::Options {
        stop_at_cost: Some(1e-15),
        ..least_squares::Options::default()
    };
    let begun = Instant::now();
    for _ in 0..FITS {
        let fit = fit_in_space(space, black_box(observations), &options, &mut |_| {
            ControlFlow::Continue(())
        });
        if fit.summary.cost >= 1e-15 {
            // a set with noise has no such minimum
            return Ok(f64::NAN);
        }
    }
    Ok(begun.elapsed().as_secs_f64() * 1e6 / FITS as f64)
}

/// The paper's search on the identify points of a set.
pub fn problem(robot: &[u8], set: &[u8]) -> anyhow::Result<(SearchSpace, Vec<Observation>)> {
    let robot = read_robot(robot)?;
    let set = own_form::parse(set, Frame::Base, robot.links.len())?;
    let points = set
        .points
        .iter()
        .filter(|p| p.subset != Some(Subset::Verify));
    let observation = |p: &Point| Observation {
        q_rad: p.q_rad.clone(),
        position_mm: p.position_mm,
        target: 0,
        weight: 1.0,
        whitening: None,
        rotation: None,
        station: None,
    };
    Ok((search_space(&robot), points.map(observation).collect()))
}

fn search_space(robot: &Robot) -> SearchSpace {
    let parameters = paper_parameters(robot.links.len());
    let half_width = |is_angle: bool| {
        if is_angle {
            HALF_WIDTH_DEG.to_radians()
        } else {
            HALF_WIDTH_MM
        }
    };
    let scale = parameters
        .iter()
        .map(|p| half_width(p.is_angle()))
        .collect();
    SearchSpace::raw(KinematicModel::nominal(&robot.links, 1), parameters, scale)
}

fn read_robot(bytes: &[u8]) -> anyhow::Result<Robot> {
    let json: serde_json::Value = serde_json::from_slice(bytes)?;
    let number = |link: &serde_json::Value, key: &str| {
        link.get(key)
            .and_then(serde_json::Value::as_f64)
            .unwrap_or(0.0)
    };
    let links = json["links"].as_array().context("the robot has no links")?;
    let link = |link: &serde_json::Value| Link {
        a_mm: number(link, "a_mm"),
        alpha_rad: number(link, "alpha_deg").to_radians(),
        d_mm: number(link, "d_mm"),
        theta_offset_rad: number(link, "theta_offset_deg").to_radians(),
        beta_rad: number(link, "beta_deg").to_radians(),
    };
    Ok(Robot::from_links(links.iter().map(link).collect()))
}

/// Sorts, too: the first is the smallest.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
