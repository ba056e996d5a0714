//! How often the alignment check refuses a correct upload: `cargo run --release --example study alignment 1000 > docs/alignment.md`.

use crate::robots;
use crate::simulation;
use kincal::calibration::upload_checks::alignment::{Alignment, align};
use kincal::measurement::Frame;
use std::time::Instant;

/// Runs the study.
pub fn study(arguments: &[String]) {
    let n: usize = arguments
        .first()
        .cloned()
        .and_then(|text| text.parse().ok())
        .unwrap_or(1000);
    let counts = robots::clean_robots(n, 1);
    println!("# Correct uploads and the alignment check\n");
    println!("Made by `cargo run --release --example study alignment {n} > docs/alignment.md`.\n");
    println!(
        "Simulated robots with errors of 0.5 mm and 0.1° (one standard deviation) in every parameter, measured with 0.05 mm noise at 10 to 80"
    );
    println!(
        "poses, half of them in the base frame. All sets are correct: none should be refused.\n"
    );
    println!("| make | refused | with a warning | accepted |\n|---|---|---|---|");
    for (name, [refused, odd, fine]) in &counts {
        println!("| {name} | {refused} | {odd} | {fine} |");
    }
    let sum = |i: usize| counts.iter().map(|(_, outcome)| outcome[i]).sum::<usize>();
    println!("| all | {} | {} | {} |", sum(0), sum(1), sum(2));
    println!("\n## Cost of a check\n");
    println!(
        "Median of {LOOKS} checks of a correct set of a six-axis robot. Every upload is checked before it is stored.\n"
    );
    println!("| frame | points | ms |\n|---|---|---|");
    for (name, frame) in [("base", Frame::Base), ("instrument", Frame::Instrument)] {
        for n_points in [60, 600, 6000] {
            println!("| {name} | {n_points} | {:.3} |", look_ms(frame, n_points));
        }
    }
}

/// Looks that a figure is the median of.
const LOOKS: usize = 101;

fn look_ms(frame: Frame, n_points: usize) -> f64 {
    let nominal = &robots::models()[0].1;
    let set = robots::measured(
        nominal,
        &robots::Tolerances {
            n_points,
            frame,
            ..robots::CLEAN
        },
        &mut simulation::Normal::new(1),
    );
    let mut times: Vec<f64> = (0..LOOKS)
        .map(|_| {
            let begun = Instant::now();
            assert!(
                matches!(align(nominal, &set), Alignment::Fits),
                "a right set"
            );
            begun.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[LOOKS / 2]
}
