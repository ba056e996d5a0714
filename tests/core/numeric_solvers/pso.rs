//! The swarm, compared with known minima and with a textbook swarm; and the promises of its summary.

use kincal::solvers::pso::{
    Iteration, Options, Positions, SearchBox, Summary, Termination, initial_positions, minimize,
};
use kincal::solvers::random::LaneRandom;
use std::ops::ControlFlow;

fn sphere(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum()
}

fn rosenbrock(x: &[f64]) -> f64 {
    x.windows(2)
        .map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2))
        .sum()
}

fn rastrigin(x: &[f64]) -> f64 {
    x.iter()
        .map(|x| 10.0 + x * x - 10.0 * libm::cos(std::f64::consts::TAU * x))
        .sum()
}

/// The batch cost of a function of one position.
fn batch(f: impl Fn(&[f64]) -> f64) -> impl FnMut(&Positions, &mut [f64]) {
    move |positions, costs| {
        for (i, cost) in costs.iter_mut().enumerate() {
            *cost = f(&positions.particle(i));
        }
    }
}

fn cube(n: usize, centre: f64, half_width: f64) -> SearchBox {
    SearchBox {
        centre: vec![centre; n],
        half_width: vec![half_width; n],
    }
}

fn go_on(_: Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn run(f: impl Fn(&[f64]) -> f64, search_box: &SearchBox, options: &Options) -> Summary {
    minimize(&mut batch(f), search_box, options, None, &mut go_on)
}

/// The constriction constants of Clerc and Kennedy, with which swarms converge; the paper's w = 0.9 is
/// slow.
fn convergent() -> Options {
    Options {
        inertia_weight: 0.7298,
        cognitive: 1.49618,
        social: 1.49618,
        seed: 1,
        ..Options::default()
    }
}

#[test]
fn the_defaults_are_the_papers() {
    let options = Options::default();
    assert_eq!((options.n_particles, options.n_iterations), (200, 492));
    assert_eq!(
        (options.inertia_weight, options.cognitive, options.social),
        (0.9, 0.5, 1.25)
    );
    assert_eq!(options.stop_at_cost, None);
}

#[test]
fn the_minimum_of_a_sphere_is_found_even_when_it_lies_outside_the_box() {
    for centre in [0.3, 4.0] {
        let summary = run(sphere, &cube(10, centre, 2.0), &convergent());
        assert!(summary.best_cost < 1e-12, "{}", summary.best_cost);
        assert_eq!(summary.best_cost, sphere(&summary.best_position));
        assert_eq!(summary.termination, Termination::IterationLimit);
    }
}

#[test]
fn the_papers_constants_reach_the_minimum_of_a_sphere_slowly() {
    // w = 0.9 with small c keeps the swarm moving: it must get near, but not as near as with the constriction constants.
    let search_box = cube(6, 0.5, 2.0);
    let papers = run(
        sphere,
        &search_box,
        &Options {
            seed: 1,
            ..Options::default()
        },
    );
    let constricted = run(sphere, &search_box, &convergent());
    assert!(papers.best_cost < 1e-2, "{}", papers.best_cost);
    assert!(constricted.best_cost < papers.best_cost);
}

#[test]
fn the_valley_of_rosenbrock_is_followed_to_its_end() {
    let options = Options {
        n_iterations: 3000,
        ..convergent()
    };
    let summary = run(rosenbrock, &cube(4, 0.0, 2.0), &options);
    assert!(summary.best_cost < 1e-10, "{}", summary.best_cost);
    assert!(summary.best_position.iter().all(|x| (x - 1.0).abs() < 1e-4));
}

#[test]
fn the_many_minima_of_rastrigin_do_not_trap_the_swarm() {
    // Its second-best minima cost 0.995: a cost below one half is the global minimum.
    let summary = run(rastrigin, &cube(5, 1.0, 5.12), &convergent());
    assert!(summary.best_cost < 0.5, "{}", summary.best_cost);
}

/// The textbook swarm: one struct per particle, one loop over particles, one over coordinates.
struct Particle {
    x: Vec<f64>,
    v: Vec<f64>,
    best: Vec<f64>,
    best_cost: f64,
}

/// Best cost after each iteration, and the best position.
fn textbook(
    f: impl Fn(&[f64]) -> f64,
    search_box: &SearchBox,
    options: &Options,
) -> (Vec<f64>, Vec<f64>) {
    let (n, d) = (options.n_particles, search_box.centre.len());
    let start = initial_positions(search_box, options);
    let mut swarm: Vec<Particle> = (0..n)
        .map(|i| Particle {
            x: start.particle(i),
            v: vec![0.0; d],
            best: start.particle(i),
            best_cost: f64::INFINITY,
        })
        .collect();
    let mut best = (f64::INFINITY, swarm[0].x.clone());
    let mut convergence = Vec::new();
    let mut random = LaneRandom::new(options.seed, 2);
    for iteration in 0..=options.n_iterations {
        for particle in &mut swarm {
            let cost = f(&particle.x);
            if cost < particle.best_cost {
                (particle.best_cost, particle.best) = (cost, particle.x.clone());
            }
            if cost < best.0 {
                best = (cost, particle.x.clone());
            }
        }
        convergence.push(best.0);
        if iteration == options.n_iterations {
            break;
        }
        let mut numbers = vec![vec![0.0; 2 * n]; d];
        numbers.iter_mut().for_each(|numbers| random.fill(numbers));
        for (i, particle) in swarm.iter_mut().enumerate() {
            for (j, of_coordinate) in numbers.iter().enumerate() {
                let (r1, r2) = (of_coordinate[i], of_coordinate[n + i]);
                let inertia = options.inertia_weight * particle.v[j];
                let social = (options.social * r2).mul_add(best.1[j] - particle.x[j], inertia);
                particle.v[j] =
                    (options.cognitive * r1).mul_add(particle.best[j] - particle.x[j], social);
                particle.x[j] += particle.v[j];
            }
        }
    }
    (convergence, best.1)
}

#[test]
fn a_textbook_swarm_of_structs_finds_the_same_bits() {
    for n_particles in [1, 13, 40] {
        let options = Options {
            n_particles,
            n_iterations: 60,
            seed: 11,
            ..Options::default()
        };
        let search_box = cube(5, 0.25, 1.5);
        let summary = run(rosenbrock, &search_box, &options);
        let (convergence, best_position) = textbook(rosenbrock, &search_box, &options);
        assert_eq!(summary.convergence, convergence);
        assert_eq!(summary.best_position, best_position);
    }
}

#[test]
fn the_first_swarm_fills_the_box_and_is_what_the_summary_and_the_free_function_say() {
    let search_box = SearchBox {
        centre: vec![1.0, -5.0],
        half_width: vec![0.5, 2.0],
    };
    let options = Options {
        n_iterations: 1,
        seed: 3,
        ..Options::default()
    };
    let positions = initial_positions(&search_box, &options);
    for j in 0..2 {
        let (centre, half_width) = (search_box.centre[j], search_box.half_width[j]);
        let scaled: Vec<f64> = positions
            .coordinate(j)
            .iter()
            .map(|x| (x - centre) / half_width)
            .collect();
        assert!(scaled.iter().all(|x| x.abs() <= 1.0));
        // With 200 uniform draws the outer twentieth on either side is empty once in 170,000,000 runs.
        assert!(scaled.iter().any(|&x| x < -0.9) && scaled.iter().any(|&x| x > 0.9));
    }
    let move_all = &mut |k: usize, positions: &mut Positions| {
        if k == 0 {
            positions.values.fill(0.0);
        }
    };
    let summary = minimize(
        &mut batch(sphere),
        &search_box,
        &options,
        Some(move_all),
        &mut go_on,
    );
    assert_eq!(summary.initial_positions, positions);
    assert_eq!(
        summary.convergence[0], 0.0,
        "the moved positions are what is evaluated"
    );
}

#[test]
fn particles_can_be_moved_before_every_evaluation() {
    let mut called = Vec::new();
    let mut seen = Vec::new();
    let mut cost = |positions: &Positions, costs: &mut [f64]| {
        seen.push(positions.get(2, 1));
        costs.fill(1.0);
    };
    let options = Options {
        n_particles: 5,
        n_iterations: 3,
        ..Options::default()
    };
    let move_particles = &mut |k: usize, positions: &mut Positions| {
        called.push(k);
        positions.set_particle(2, &[0.0, 100.0 + k as f64]);
    };
    minimize(
        &mut cost,
        &cube(2, 0.0, 1.0),
        &options,
        Some(move_particles),
        &mut go_on,
    );
    assert_eq!(called, [0, 1, 2, 3]);
    assert_eq!(seen, [100.0, 101.0, 102.0, 103.0]);
}

#[test]
fn the_summary_counts_and_keeps_what_it_says() {
    let options = Options {
        n_particles: 30,
        n_iterations: 25,
        seed: 8,
        ..Options::default()
    };
    let mut reported = Vec::new();
    let mut monitor = |iteration: Iteration| {
        reported.push(iteration);
        ControlFlow::Continue(())
    };
    let summary = minimize(
        &mut batch(rastrigin),
        &cube(3, 0.0, 4.0),
        &options,
        None,
        &mut monitor,
    );
    assert_eq!((summary.n_iterations, summary.n_evaluations), (25, 30 * 26));
    assert_eq!(summary.convergence.len(), 26);
    assert!(
        summary.convergence.is_sorted_by(|a, b| a >= b),
        "convergence rises: {:?}",
        summary.convergence
    );
    assert!(summary.convergence[25] < summary.convergence[0]);
    assert_eq!(
        reported
            .iter()
            .map(|reported| reported.iteration)
            .collect::<Vec<_>>(),
        (0..=25).collect::<Vec<_>>()
    );
    assert_eq!(
        reported
            .iter()
            .map(|reported| reported.best_cost)
            .collect::<Vec<_>>(),
        summary.convergence
    );
    let smallest = summary
        .own_best_costs
        .iter()
        .copied()
        .min_by(f64::total_cmp);
    assert_eq!(smallest, Some(summary.best_cost));
    for (i, &cost) in summary.own_best_costs.iter().enumerate() {
        assert_eq!(rastrigin(&summary.own_best_positions.particle(i)), cost);
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_does_not() {
    let search_box = cube(4, 0.0, 2.0);
    let options = Options {
        n_iterations: 50,
        seed: 5,
        ..Options::default()
    };
    let first = run(rosenbrock, &search_box, &options);
    assert_eq!(first, run(rosenbrock, &search_box, &options));
    assert_ne!(
        first.best_position,
        run(rosenbrock, &search_box, &Options { seed: 6, ..options }).best_position
    );
}

#[test]
fn costs_that_are_not_finite_never_win() {
    // Not finite on one side of the plane x0 = 0: NaN or infinite.
    let holes = |x: &[f64]| match x[0] {
        x0 if x0 < -0.6 => f64::NAN,
        x0 if x0 < -0.3 => f64::NEG_INFINITY,
        x0 if x0 < 0.0 => f64::INFINITY,
        _ => sphere(x),
    };
    let summary = run(holes, &cube(3, 0.0, 1.0), &convergent());
    assert!(
        summary.best_position[0] >= 0.0 && summary.best_cost < 1e-6,
        "{summary:?}"
    );

    let nowhere = run(
        |_| f64::NAN,
        &cube(3, 0.0, 1.0),
        &Options {
            n_iterations: 5,
            ..Options::default()
        },
    );
    assert_eq!(nowhere.best_cost, f64::INFINITY);
    assert!(nowhere.best_position.iter().all(|x| x.is_finite()));
    assert_eq!(nowhere.termination, Termination::IterationLimit);
}

#[test]
fn the_search_stops_at_the_cost_asked_for() {
    let options = Options {
        stop_at_cost: Some(1e-3),
        ..convergent()
    };
    let summary = run(sphere, &cube(5, 0.5, 2.0), &options);
    assert_eq!(summary.termination, Termination::CostReached);
    let n = summary.n_iterations;
    assert!(summary.best_cost <= 1e-3 && summary.convergence[n - 1] > 1e-3);
    assert!(n < options.n_iterations && summary.convergence.len() == n + 1);
}

#[test]
fn the_monitor_can_stop_the_search() {
    for stop_at in [0, 4] {
        let mut monitor = |reported: Iteration| {
            if reported.iteration == stop_at {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        };
        let options = Options {
            n_particles: 10,
            ..Options::default()
        };
        let summary = minimize(
            &mut batch(sphere),
            &cube(2, 0.0, 1.0),
            &options,
            None,
            &mut monitor,
        );
        assert_eq!(
            (summary.termination, summary.n_iterations),
            (Termination::Stopped, stop_at)
        );
        assert_eq!(summary.n_evaluations, 10 * (stop_at + 1));
    }
}
