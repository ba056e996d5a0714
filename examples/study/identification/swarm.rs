//! The default preset's swarm from a cold start on the paper's first set: iterations to the paper's F.

use crate::data::{paper_robot, paper_set};
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use std::ops::ControlFlow;

/// The paper's smallest F in simulation, mm² [Gao 2018, table 4].
const PAPER_F_MM2: f64 = 5.5519e-5;
const BOXES: [(f64, f64); 5] = [(0.5, 0.15), (1.0, 0.3), (1.0, 0.5), (1.5, 0.5), (2.0, 1.0)];

/// The table.
pub fn table(n_seeds: u64) {
    println!(
        "## A cold swarm of 200 particles on first.csv: iterations to F = 5.5519e-5\n\n{n_seeds} seeds; the paper prints 404.\n"
    );
    println!("| box | median | smallest | largest | not reached in 400 |\n|---|---|---|---|---|");
    for (mm, deg) in BOXES {
        let mut iterations: Vec<usize> = (0..n_seeds)
            .map(|seed| {
                let mut request = CalibrationRequest::new(paper_robot(), paper_set("first.csv"));
                (request.method, request.seed, request.refine) = (Method::Pso, seed, Some(false));
                (
                    request.options.n_iterations,
                    request.options.stop_at_cost_mm2,
                ) = (Some(400), Some(PAPER_F_MM2));
                (
                    request.options.search_half_width_mm,
                    request.options.search_half_width_deg,
                ) = (Some(mm), Some(deg));
                let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
                if report.cost_mm2 <= PAPER_F_MM2 {
                    report.n_iterations
                } else {
                    usize::MAX
                }
            })
            .collect();
        iterations.sort_unstable();
        let missed = iterations.iter().filter(|i| **i == usize::MAX).count();
        println!(
            "| ±{mm} mm/±{deg}° | {} | {} | {} | {missed} |",
            iterations[iterations.len() / 2],
            iterations[0],
            iterations[iterations.len() - 1 - missed]
        );
    }
    println!();
}
