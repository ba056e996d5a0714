//! The parts of a swarm iteration and of a least-squares step, for the paper's problem: `cargo bench`.

#[path = "../examples/throughput.rs"]
#[allow(dead_code)]
mod throughput;

use criterion::{Criterion, criterion_group, criterion_main};
use kincal::identification::least_squares::linearisation::Linearisation;
use kincal::identification::least_squares::linearisation::decomposition_at;
use kincal::identification::model::identifiability::prior_scales;
use kincal::identification::model::parameters::complete_parameters;
use kincal::identification::model::search_space::SearchSpace;
use kincal::identification::search::fit::fit_in_space;
use kincal::identification::search::swarm::{lane_robots, prepared_poses, run_swarm};
use kincal::kinematics::batch::{InstructionSet, Lanes, sum_of_squares};
use kincal::kinematics::reach_mm;
use kincal::solvers::random::LaneRandom;
use kincal::solvers::{least_squares, pso};
use std::hint::black_box;
use std::ops::ControlFlow;

/// Chunks of eight particles in a swarm of 200.
const CHUNKS: usize = 25;

fn paper() -> (
    SearchSpace,
    Vec<kincal::identification::model::objective::Observation>,
) {
    let (robot, set) = (
        include_bytes!("../data/paper/robot.json"),
        include_bytes!("../data/paper/first.csv"),
    );
    throughput::problem(robot, set).unwrap_or_else(|error| panic!("the repository's data: {error}"))
}

/// Base, links and target around the same nominal robot.
fn complete(paper: &SearchSpace) -> SearchSpace {
    let parameters = complete_parameters(paper.reference.links.len(), 1);
    let scale = prior_scales(&parameters, reach_mm(&paper.reference.links));
    SearchSpace::raw(paper.reference.clone(), parameters, scale)
}

fn kernels(criterion: &mut Criterion) {
    let (paper, observations) = paper();
    for (name, space) in [("paper", &paper), ("complete", &complete(&paper))] {
        let poses = prepared_poses(space, &observations);
        let deviations = vec![Lanes::splat(1e-3); space.parameters.len()];
        for instructions in InstructionSet::all_here()
            .into_iter()
            .filter(|set| *set != InstructionSet::Baseline || cfg!(target_arch = "aarch64"))
        {
            let mut robots = lane_robots(space).with_instructions(instructions);
            criterion.bench_function(
                &format!("{name}, {instructions:?}: constants of 200 particles"),
                |bench| {
                    bench.iter(|| (0..CHUNKS).for_each(|_| robots.set(black_box(&deviations))));
                },
            );
            criterion.bench_function(
                &format!("{name}, {instructions:?}: 200 particles, 50 poses"),
                |bench| {
                    bench.iter(|| {
                        for _ in 0..CHUNKS {
                            black_box(sum_of_squares(black_box(&robots), &poses));
                        }
                    });
                },
            );
        }
    }
}

fn swarm(criterion: &mut Criterion) {
    let (space, observations) = paper();
    let mut numbers = vec![0.0; 400];
    let mut random = LaneRandom::new(1, 1);
    criterion.bench_function("9,600 random numbers", |bench| {
        bench.iter(|| (0..24).for_each(|_| random.fill(black_box(&mut numbers))))
    });
    let options = pso::Options {
        n_iterations: 99,
        ..pso::Options::default()
    };
    criterion.bench_function("100 iterations, 200 particles, 50 poses", |bench| {
        bench.iter(|| {
            run_swarm(
                &space,
                black_box(&observations),
                None,
                &options,
                None,
                &mut |_| ControlFlow::Continue(()),
            )
        });
    });
}

fn fits(criterion: &mut Criterion) {
    let (space, observations) = paper();
    let scale = prior_scales(&space.parameters, reach_mm(&space.reference.links));
    let options = least_squares::Options {
        stop_at_cost: Some(1e-15),
        ..least_squares::Options::default()
    };
    criterion.bench_function("least squares from nominal to F < 1e-15", |bench| {
        bench.iter(|| {
            fit_in_space(&space, black_box(&observations), &options, &mut |_| {
                ControlFlow::Continue(())
            })
        });
    });
    criterion.bench_function("what the data see", |bench| {
        bench.iter(|| {
            decomposition_at(
                &space.reference,
                &space.parameters,
                &scale,
                black_box(&observations),
            )
        });
    });
    let mut linearisation = Linearisation::new(&space, &observations);
    let z = vec![0.01; space.n_coordinates()];
    let (mut residuals, mut jacobian) = (
        vec![0.0; linearisation.n_rows()],
        vec![0.0; linearisation.n_rows() * z.len()],
    );
    criterion.bench_function("residuals", |bench| {
        bench.iter(|| linearisation.residuals(black_box(&z), &mut residuals))
    });
    criterion.bench_function("residuals and Jacobian", |bench| {
        bench.iter(|| linearisation.linearise(black_box(&z), &mut residuals, &mut jacobian));
    });
}

criterion_group!(parts, kernels, swarm, fits);
criterion_main!(parts);
