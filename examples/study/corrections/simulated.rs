//! Simulated robots: geometric ones, which corrections must not harm, and real ones, which they must help.

use super::{kept, run, spread};
use crate::data::paper_robot;
use crate::simulation::{self, Campaign, Normal};
use kincal::calibration::CalibrationRequest;
use kincal::calibration::request::CorrectionsChoice;
use std::time::Instant;

/// Unseen poses that a robot is scored at.
const UNSEEN: usize = 200;

/// How much worse corrections make robots that are nothing but links, at unseen poses and without noise in the score. Robots are told apart by
/// their seeds, so that the study can be run in parts.
pub fn geometric(n: usize, first_seed: u64) {
    println!("## Geometric robots: {n} per row, seeds from {first_seed}\n");
    println!(
        "Ratio: rms error at {UNSEEN} unseen poses with corrections, over that of links alone.\n"
    );
    println!(
        "| poses | noise, mm | something kept | worse by more than 5 % | median ratio | largest ratio |\n|---|---|---|---|---|---|"
    );
    for (n_configurations, n_targets, noise_mm) in
        [(50, 1, 0.03), (100, 1, 0.1), (30, 3, 0.1), (200, 1, 0.03)]
    {
        let campaign = Campaign {
            n_configurations,
            n_targets,
            noise_mm,
            ..Campaign::PLAIN
        };
        let (mut ratios, mut n_kept) = (vec![], 0);
        for seed in (first_seed..).take(n) {
            let found = simulation::identified(
                &paper_robot(),
                &campaign,
                &simulation::NonlinearErrors::NONE,
                seed,
                UNSEEN,
            );
            ratios.push(found.corrected_mm / found.links_mm);
            n_kept += usize::from(!kept(&found.report).is_empty());
        }
        let worse = ratios.iter().filter(|r| **r > 1.05).count();
        let (median, _, largest) = spread(ratios);
        println!(
            "| {n_configurations} × {n_targets} | {noise_mm} | {n_kept} | {worse} | {median:.4} | {largest:.3} |"
        );
    }
    println!();
}

/// Robots with other parameters, joints 2 and 3 that sag, harmonics, and noise.
pub fn real_robots(n: usize) {
    println!("## Simulated real robots: {n} per row, noise 0.03 mm, from an instrument frame\n");
    println!(
        "| poses | sag of joints 2 and 3, mrad per unit | harmonics, mrad | links, mm rms | with corrections: median | smallest | largest |\n|---|---|---|---|---|---|---|"
    );
    for (n_configurations, sag_rad, harmonic_rad) in [
        (100, 1e-3, 0.0),
        (100, 1e-3, 2e-4),
        (100, 0.0, 2e-4),
        (50, 1e-3, 2e-4),
        (200, 2e-3, 5e-4),
    ] {
        let campaign = Campaign {
            n_configurations,
            ..Campaign::PLAIN
        };
        let bent = simulation::NonlinearErrors {
            sag_rad,
            harmonic_rad,
            ..simulation::NonlinearErrors::NONE
        };
        let found: Vec<_> = (0..n)
            .map(|seed| {
                simulation::identified(&paper_robot(), &campaign, &bent, seed as u64, UNSEEN)
            })
            .collect();
        let (links, ..) = spread(found.iter().map(|f| f.links_mm).collect());
        let (median, smallest, largest) = spread(found.iter().map(|f| f.corrected_mm).collect());
        let (sag, harmonic) = (sag_rad * 1e3, harmonic_rad * 1e3);
        println!(
            "| {n_configurations} | {sag} | {harmonic} | {links:.4} | {median:.4} | {smallest:.4} | {largest:.4} |"
        );
    }
    println!();
}

/// What the stage costs.
pub fn time() {
    println!("## Time, ms, median of 5\n\n| poses | without | with corrections |\n|---|---|---|");
    for n_configurations in [50, 100, 300, 1000] {
        let campaign = Campaign {
            n_configurations,
            ..Campaign::PLAIN
        };
        let bent = simulation::NonlinearErrors {
            sag_rad: 1e-3,
            harmonic_rad: 2e-4,
            ..simulation::NonlinearErrors::NONE
        };
        let (mut random, nominal) = (Normal::new(1), paper_robot());
        let set = simulation::nonlinear_set(&nominal, &campaign, &bent, &mut random).1;
        let timed = |choice| {
            let request = CalibrationRequest {
                corrections: Some(choice),
                ..CalibrationRequest::new(nominal.clone(), set.clone())
            };
            let once = |_| {
                let start = Instant::now();
                run(&request);
                start.elapsed().as_secs_f64() * 1e3
            };
            spread((0..5).map(once).collect()).0
        };
        println!(
            "| {n_configurations} | {:.0} | {:.0} |",
            timed(CorrectionsChoice::Off),
            timed(CorrectionsChoice::Auto)
        );
    }
    println!();
}
