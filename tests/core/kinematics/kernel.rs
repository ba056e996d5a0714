//! The fast cost kernel: equal to the readable cost for any robot and any particle, and the same bits on every code path.

use super::{random_model, random_q};
use kincal::identification::KinematicModel;
use kincal::identification::model::objective::{Observation, cost};
use kincal::identification::model::parameters::{Parameter, Quantity, apply};
use kincal::identification::model::search_space::SearchSpace;
use kincal::identification::search::swarm::{lane_robots, prepared_poses};
use kincal::kinematics::batch::{
    InstructionSet, LANES, LaneRobots, Lanes, PreparedPoses, sum_of_squares,
};
use nalgebra::{IsometryMatrix3, Vector3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Tolerance, mm: the kernel transforms points backwards with fused multiply-adds where the reference multiplies matrices, and adds angles by their sines. Lengths
/// and residuals are metres, with some roundings each.
const KERNEL_RELATIVE: f64 = 1e-13;
/// Tolerance of residuals near the minimum, mm: they are small differences of lengths, with an absolute error of some roundings of 10 m.
const RESIDUAL_ROUNDING_MM: f64 = 1e-11;

/// A reference robot, its free parameters, the deviations of eight particles, and poses.
pub struct Case {
    pub space: SearchSpace,
    pub deviations: Vec<Lanes>,
    pub observations: Vec<Observation>,
}

impl Case {
    pub fn model(&self, lane: usize) -> KinematicModel {
        let deviation: Vec<f64> = self.deviations.iter().map(|d| d.0[lane]).collect();
        apply(&self.space.reference, &self.space.parameters, &deviation)
    }

    pub fn robots(&self) -> LaneRobots {
        let mut robots = lane_robots(&self.space);
        robots.set(&self.deviations);
        robots
    }

    pub fn poses(&self) -> PreparedPoses {
        prepared_poses(&self.space, &self.observations)
    }
}

pub fn all_parameters(n_links: usize, n_targets: usize) -> Vec<Parameter> {
    let quantities = [
        Quantity::A,
        Quantity::Alpha,
        Quantity::D,
        Quantity::ThetaOffset,
        Quantity::Beta,
    ];
    let links =
        (0..n_links).flat_map(|link| quantities.map(|quantity| Parameter::Link(link, quantity)));
    let base = (0..3).flat_map(|axis| {
        [
            Parameter::BaseTranslation(axis),
            Parameter::BaseRotation(axis),
        ]
    });
    let targets =
        (0..n_targets).flat_map(|target| (0..3).map(move |axis| Parameter::Target(target, axis)));
    links.chain(base).chain(targets).collect()
}

/// Poses measured on `model`, with noise of up to `noise_mm`.
fn observations(
    random: &mut ChaCha8Rng,
    model: &KinematicModel,
    n: usize,
    noise_mm: f64,
    weighted: bool,
) -> Vec<Observation> {
    (0..n)
        .map(|i| {
            let q_rad = random_q(random, model.links.len());
            let target = i % model.targets_mm.len();
            let noise = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0) * noise_mm);
            let weight = if weighted {
                random.random_range(0.1..2.0)
            } else {
                1.0
            };
            Observation {
                position_mm: model.position(&q_rad, target) + noise,
                q_rad,
                target,
                weight,
                whitening: None,
                rotation: None,
                station: None,
            }
        })
        .collect()
}

/// Random deviations within these half-widths.
pub fn case(
    random: &mut ChaCha8Rng,
    reference: KinematicModel,
    parameters: Vec<Parameter>,
    (mm, rad): (f64, f64),
    weighted: bool,
) -> Case {
    let deviation = |p: &Parameter, random: &mut ChaCha8Rng| {
        random.random_range(-1.0..1.0) * if p.is_angle() { rad } else { mm }
    };
    let deviations = parameters
        .iter()
        .map(|p| Lanes(std::array::from_fn(|_| deviation(p, random))))
        .collect();
    // not a multiple of the number of poses that are processed together
    let observations = observations(random, &reference, 37, mm, weighted);
    let scale = vec![1.0; parameters.len()];
    Case {
        space: SearchSpace::raw(reference, parameters, scale),
        deviations,
        observations,
    }
}

fn assert_equal_to_the_readable_cost(case: &Case, name: &str) {
    let fast = sum_of_squares(&case.robots(), &case.poses());
    for lane in 0..LANES {
        let readable = cost(&case.model(lane), &case.observations);
        let rounding = RESIDUAL_ROUNDING_MM * (case.observations.len() as f64 * readable).sqrt()
            + RESIDUAL_ROUNDING_MM.powi(2);
        let allowed = KERNEL_RELATIVE * readable + rounding;
        assert!(
            (fast.0[lane] - readable).abs() <= allowed,
            "{name}, lane {lane}: {} and {readable}",
            fast.0[lane]
        );
    }
}

#[test]
fn the_kernel_equals_the_readable_cost_for_any_robot() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    for n_links in 1..=12 {
        for n_targets in [1, 3] {
            let reference = random_model(&mut random, n_links, n_targets);
            // In some lanes angles beyond π/4, where the polynomials end.
            let moved = case(
                &mut random,
                reference,
                all_parameters(n_links, n_targets),
                (5.0, 1.2),
                true,
            );
            assert_equal_to_the_readable_cost(
                &moved,
                &format!("{n_links} links, {n_targets} targets"),
            );
        }
    }
}

#[test]
fn the_kernel_equals_the_readable_cost_with_base_known_and_target_on_the_axis() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for n_links in 1..=12 {
        for height_mm in [0.0, 120.0] {
            let mut reference = random_model(&mut random, n_links, 1);
            reference.t_instrument_base = IsometryMatrix3::identity();
            reference.targets_mm[0] = Vector3::new(0.0, 0.0, height_mm);
            reference
                .links
                .iter_mut()
                .for_each(|link| link.beta_rad = 0.0);
            let parameters = kincal::identification::model::parameters::paper_parameters(n_links);
            for (mm, rad) in [(1.0, 0.01), (1e-6, 1e-8), (500.0, 3.0)] {
                let moved = case(
                    &mut random,
                    reference.clone(),
                    parameters.clone(),
                    (mm, rad),
                    false,
                );
                assert_equal_to_the_readable_cost(
                    &moved,
                    &format!("{n_links} links, moved by {mm} mm and {rad} rad"),
                );
            }
        }
    }
}

#[test]
fn parameters_that_do_not_move_stay_at_the_reference() {
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let reference = random_model(&mut random, 6, 2);
    for parameter in all_parameters(6, 2) {
        let moved = case(
            &mut random,
            reference.clone(),
            vec![parameter],
            (3.0, 0.02),
            true,
        );
        assert_equal_to_the_readable_cost(&moved, &parameter.name());
    }
    let none = case(&mut random, reference, vec![], (3.0, 0.02), true);
    assert_equal_to_the_readable_cost(&none, "none");
}

#[test]
fn particles_far_out_cost_what_the_readable_cost_says() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    // A swarm without bounds may move an angle by many turns and a length by many metres.
    for (mm, rad) in [(1e6, 50.0), (1e3, 1e4)] {
        let reference = random_model(&mut random, 6, 1);
        let moved = case(
            &mut random,
            reference,
            all_parameters(6, 1),
            (mm, rad),
            false,
        );
        let fast = sum_of_squares(&moved.robots(), &moved.poses());
        for lane in 0..LANES {
            let readable = cost(&moved.model(lane), &moved.observations);
            // The readable form takes the sine of reference + deviation, which is rounded to an ulp of the sum.
            let allowed = readable * (KERNEL_RELATIVE + 40.0 * rad * f64::EPSILON);
            assert!(
                (fast.0[lane] - readable).abs() <= allowed,
                "{mm} mm, {rad} rad, lane {lane}: {} and {readable}",
                fast.0[lane]
            );
        }
    }
}

#[test]
fn a_deviation_that_is_not_a_number_gives_a_cost_that_is_not_finite() {
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let reference = random_model(&mut random, 6, 1);
    for extreme in [f64::NAN, f64::INFINITY] {
        let mut moved = case(
            &mut random,
            reference.clone(),
            all_parameters(6, 1),
            (1.0, 0.01),
            false,
        );
        let sane = sum_of_squares(&moved.robots(), &moved.poses());
        for parameter in 0..moved.deviations.len() {
            let before = std::mem::replace(&mut moved.deviations[parameter].0[3], extreme);
            let costs = sum_of_squares(&moved.robots(), &moved.poses());
            assert!(
                !costs.0[3].is_finite(),
                "{}",
                moved.space.parameters[parameter].name()
            );
            assert!(
                (0..LANES)
                    .filter(|lane| *lane != 3)
                    .all(|lane| costs.0[lane] == sane.0[lane])
            );
            moved.deviations[parameter].0[3] = before;
        }
    }
}

fn cases_for_bits() -> Vec<Case> {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let mut cases = Vec::new();
    for n_links in [1, 2, 6, 7, 12] {
        let reference = random_model(&mut random, n_links, 2);
        for (weighted, angles) in [(true, 0.02), (false, 0.9), (false, 5.0)] {
            cases.push(case(
                &mut random,
                reference.clone(),
                all_parameters(n_links, 2),
                (3.0, angles),
                weighted,
            ));
        }
        let mut paper = random_model(&mut random, n_links, 1);
        paper.t_instrument_base = IsometryMatrix3::identity();
        paper.targets_mm[0] = Vector3::zeros();
        let parameters = kincal::identification::model::parameters::paper_parameters(n_links);
        cases.push(case(&mut random, paper, parameters, (1.0, 0.01), false));
    }
    cases
}

fn bits(costs: Lanes) -> [u64; LANES] {
    costs.0.map(f64::to_bits)
}

#[test]
fn every_code_path_gives_the_same_bits() {
    let sets = InstructionSet::all_here();
    eprintln!("code paths here: {sets:?}");
    assert!(sets.contains(&InstructionSet::Baseline));
    for case in cases_for_bits() {
        let on = |set: InstructionSet| {
            let mut robots = lane_robots(&case.space).with_instructions(set);
            robots.set(&case.deviations);
            bits(sum_of_squares(&robots, &case.poses()))
        };
        for set in &sets {
            assert_eq!(on(*set), on(InstructionSet::Baseline), "{set:?}");
        }
    }
}

#[test]
fn a_particles_cost_does_not_depend_on_its_lane_or_its_neighbours() {
    for case in cases_for_bits() {
        let together = bits(sum_of_squares(&case.robots(), &case.poses()));
        for (lane, expected) in together.into_iter().enumerate() {
            let alone: Vec<Lanes> = case
                .deviations
                .iter()
                .map(|d| Lanes::splat(d.0[lane]))
                .collect();
            let mut robots = lane_robots(&case.space);
            robots.set(&alone);
            assert_eq!(
                bits(sum_of_squares(&robots, &case.poses())),
                [expected; LANES]
            );
        }
    }
}

#[test]
fn a_weight_of_one_is_no_weight() {
    // Poses of weight 1 use a faster path than weighted ones; one last pose of weight 0 sends all of them through the slower path.
    let mut random = ChaCha8Rng::seed_from_u64(10);
    let reference = random_model(&mut random, 6, 1);
    let mut case = case(
        &mut random,
        reference,
        all_parameters(6, 1),
        (3.0, 0.02),
        false,
    );
    let short = bits(sum_of_squares(&case.robots(), &case.poses()));
    let mut last = case.observations[0].clone();
    last.weight = 0.0;
    case.observations.push(last);
    assert_eq!(bits(sum_of_squares(&case.robots(), &case.poses())), short);
}
