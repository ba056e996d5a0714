//! How well the network of [Gao 2018, section 3.2] answers after how many epochs, and how long that takes.
//!
//! 200 inputs uniform in ± 1 in 24 coordinates, all with the same answer: what a swarm's run leaves behind. Prints, per
//! number of epochs, the distances of the answers from the target in units of the search box.
//!
//! `cargo run --release --example study train_network`

use kincal::solvers::bpnn::{Options, choose_size_and_train};
use kincal::solvers::random::LaneRandom;
use std::time::Instant;

const N_SAMPLES: usize = 200;
const N_COORDINATES: usize = 24;

fn rows(n: usize, random: &mut LaneRandom) -> Vec<Vec<f64>> {
    let mut row = || {
        let mut numbers = vec![0.0; N_COORDINATES];
        random.fill(&mut numbers);
        numbers.iter().map(|u| 2.0 * u - 1.0).collect()
    };
    (0..n).map(|_| row()).collect()
}

/// Distances of the answers from the target, smallest first.
fn distances(answers: &[Vec<f64>], target: &[f64]) -> Vec<f64> {
    let squares = |answer: &Vec<f64>| {
        answer
            .iter()
            .zip(target)
            .map(|(a, t)| (a - t) * (a - t))
            .sum::<f64>()
    };
    let mut distances: Vec<f64> = answers
        .iter()
        .map(|answer| squares(answer).sqrt())
        .collect();
    distances.sort_by(f64::total_cmp);
    distances
}

/// Runs the study.
pub fn study() {
    println!("seed epochs hidden      mse   median      10%      90%  unseen median   time");
    for seed in 0..3 {
        let mut random = LaneRandom::new(seed, 0);
        let (inputs, target, unseen) = (
            rows(N_SAMPLES, &mut random),
            rows(1, &mut random).remove(0),
            rows(N_SAMPLES, &mut random),
        );
        let targets = vec![target.clone(); N_SAMPLES];
        for n_epochs in [300, 1000, 3000, 10_000, 30_000] {
            let start = Instant::now();
            let (network, choice) = choose_size_and_train(
                &inputs,
                &targets,
                &Options {
                    n_epochs,
                    seed,
                    ..Options::default()
                },
            );
            let elapsed = start.elapsed();
            let seen = distances(&network.evaluate_all(&inputs), &target);
            let unseen = distances(&network.evaluate_all(&unseen), &target);
            println!(
                "{seed:4} {n_epochs:6} {:6} {:8.1e} {:8.1e} {:8.1e} {:8.1e} {:14.1e} {:6.3}s",
                choice.n_hidden,
                choice.training_error,
                seen[N_SAMPLES / 2],
                seen[N_SAMPLES / 10],
                seen[N_SAMPLES * 9 / 10],
                unseen[N_SAMPLES / 2],
                elapsed.as_secs_f64()
            );
        }
    }
}
