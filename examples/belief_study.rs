//! What the stated uncertainties, the searches and the comparison of sessions are worth: prints `docs/uncertainty.md`.
//!
//! `cargo run --release --example belief_study [n_robots [n_seeds]] > docs/uncertainty.md`

#[path = "../tests/support/data.rs"]
mod data;
#[path = "../tests/support/simulation.rs"]
mod simulation;

use data::paper_robot;
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use simulation::{Campaign, Normal, intervals_held, limited, measure, poses, position_with_sag, true_robot};
use std::ops::ControlFlow;

fn main() {
    let mut arguments = std::env::args().skip(1).filter_map(|n| n.parse().ok());
    let n_robots = arguments.next().unwrap_or(1000);
    println!("# What to believe\n\nMade by `cargo run --release --example belief_study {n_robots} > docs/uncertainty.md`.\n");
    coverage(n_robots);
}

fn coverage(n_robots: u64) {
    println!("## Do the stated 95 % intervals hold the truth?\n");
    println!("{n_robots} simulated robots per row; every parameter of the complete model but the base's rotation.\n");
    println!("| campaign | intervals that hold the truth | tool: predicted / true rms, mm |\n|---|---|---|");
    let plain = Campaign::PLAIN;
    let rows = [
        ("50 poses, white noise 0.03 mm", plain),
        ("25 poses, white noise 0.03 mm", Campaign { n_configurations: 25, ..plain }),
        ("20 configurations of 3 targets, white noise 0.03 mm", Campaign { n_configurations: 20, n_targets: 3, ..plain }),
        (
            "20 configurations of 3 targets, 0.05 mm shared by a configuration",
            Campaign { n_configurations: 20, n_targets: 3, shared_mm: 0.05, ..plain },
        ),
        ("50 poses, sag of 0.2 mm (rms)", Campaign { sag_rad: 1e-4, ..plain }),
        ("50 poses, sag of 1 mm (rms)", Campaign { sag_rad: 5e-4, ..plain }),
        ("20 configurations of 3 targets, sag of 1 mm", Campaign { n_configurations: 20, n_targets: 3, sag_rad: 5e-4, ..plain }),
    ];
    for (name, campaign) in rows {
        let (mut stated, mut held, mut predicted, mut missed, mut n) = (0, 0, 0.0, 0.0, 0);
        for seed in 0..n_robots {
            let nominal = limited(paper_robot());
            let mut random = Normal::new(seed);
            let truth = true_robot(&nominal, campaign.n_targets, &mut random);
            let set = measure(&truth, &poses(campaign.n_configurations, &mut random), &campaign, &mut random);
            let mut request = CalibrationRequest::new(nominal.clone(), set);
            request.method = Method::LeastSquares;
            let Ok(report) = calibrate(&request, &mut |_| ControlFlow::Continue(())) else { continue };
            let (s, h) = intervals_held(&nominal, &truth, &report);
            (stated, held) = (stated + s, held + h);
            predicted += report.tool_uncertainty.map_or(0.0, |t| t.mean_mm * t.mean_mm);
            let found = kincal::identification::KinematicModel {
                t_instrument_base: report.t_instrument_base,
                links: report.links,
                targets_mm: report.targets_mm,
            };
            for q in poses(20, &mut random) {
                missed += (position_with_sag(&truth, &q, 0, campaign.sag_rad) - found.position(&q, 0)).norm_squared() / 20.0;
            }
            n += 1;
        }
        let share = 100.0 * held as f64 / stated as f64;
        println!(
            "| {name} | {share:.2} % of {stated} | {:.4} / {:.4} |",
            (predicted / f64::from(n)).sqrt(),
            (missed / f64::from(n)).sqrt()
        );
    }
}
