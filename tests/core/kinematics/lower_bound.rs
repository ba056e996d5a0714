//! The lower bound of F: never above F, wherever particle and anchor are, and close to F if the particle is near the anchor.

use super::kernel::{Case, all_parameters, case};
use super::random_model;
use kincal::identification::model::objective::cost;
use kincal::identification::model::parameters::{apply, complete_parameters, paper_parameters};
use kincal::identification::search::anchor::Anchor;
use kincal::kinematics::batch::{InstructionSet, LANES, Lanes, sum_of_squares};
use nalgebra::{IsometryMatrix3, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// The particles whose bound is above this share of their own F.
fn exceeds(case: &Case, anchor: &Anchor, limits: &Lanes) -> [bool; LANES] {
    anchor.bound().exceeds(
        &case.deviations,
        limits,
        &mut vec![Lanes::ZERO; case.deviations.len()],
    )
}

fn times(costs: Lanes, factor: f64) -> Lanes {
    Lanes(costs.0.map(|cost| factor * cost))
}

/// Random robots with many, the paper's or the complete parameters, deviating by up to (mm, rad).
fn random_case(seed: u64, n_links: usize, moved: (f64, f64)) -> Case {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let n_targets = random.random_range(1..4);
    let mut reference = random_model(&mut random, n_links, n_targets);
    let parameters = match seed % 3 {
        0 => all_parameters(n_links, n_targets),
        1 => complete_parameters(reference.links.len(), n_targets),
        _ => {
            reference.t_instrument_base = IsometryMatrix3::identity();
            reference
                .targets_mm
                .iter_mut()
                .for_each(|target| *target = Vector3::zeros());
            paper_parameters(n_links)
        }
    };
    case(
        &mut random,
        reference,
        parameters,
        moved,
        seed.is_multiple_of(2),
    )
}

fn anchor_at(case: &Case, deviation: &[f64]) -> Anchor {
    let mut anchor = Anchor::at_reference(&case.space, &case.observations)
        .expect("there are more residuals than parameters");
    anchor.move_to(deviation);
    anchor
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    // The limit is F itself, from the kernel and from the readable form: a bound that is above F by one rounding fails.
    #[test]
    fn the_lower_bound_is_never_above_the_cost(
        seed in any::<u64>(),
        n_links in 1_usize..8,
        mm in -9.0..7.0_f64,
        rad in -12.0..4.0_f64,
        anchor_share in prop_oneof![Just(0.0), Just(1.0), -1.0..1.0_f64, -1e3..1e3_f64],
    ) {
        let case = random_case(seed, n_links, (10f64.powf(mm), 10f64.powf(rad)));
        // Around the reference, at a particle, or anywhere on the line through both.
        let deviation: Vec<f64> = case.deviations.iter().map(|d| anchor_share * d.0[3]).collect();
        let anchor = anchor_at(&case, &deviation);
        let costs = sum_of_squares(&case.robots(), &case.poses());
        prop_assert_eq!(exceeds(&case, &anchor, &costs), [false; LANES]);
        let readable = Lanes(std::array::from_fn(|lane| cost(&case.model(lane), &case.observations)));
        prop_assert_eq!(exceeds(&case, &anchor, &readable), [false; LANES]);
    }
}

#[test]
fn near_the_anchor_the_bound_is_near_the_cost() {
    for seed in 0..60 {
        // Thirty angles of 10 µrad on lengths of metres: the nonlinear part is a thousandth of the linear one.
        let mut case = random_case(seed, 6, (0.01, 1e-5));
        let anchor = anchor_at(&case, &vec![0.0; case.deviations.len()]);
        let costs = sum_of_squares(&case.robots(), &case.poses());
        assert_eq!(
            exceeds(&case, &anchor, &times(costs, 0.97)),
            [true; LANES],
            "seed {seed}"
        );
        // At other anchors the bound is as close.
        let there: Vec<f64> = case
            .space
            .parameters
            .iter()
            .map(|p| if p.is_angle() { 0.4 } else { 50.0 })
            .collect();
        case.deviations
            .iter_mut()
            .zip(&there)
            .for_each(|(d, there)| d.0.iter_mut().for_each(|d| *d = 0.1 * *d + there));
        let costs = sum_of_squares(&case.robots(), &case.poses());
        assert_eq!(
            exceeds(&case, &anchor_at(&case, &there), &times(costs, 0.97)),
            [true; LANES],
            "seed {seed}, moved"
        );
    }
}

#[test]
fn what_is_not_a_number_is_above_nothing_and_disturbs_nobody() {
    let mut case = random_case(6, 6, (0.01, 1e-5));
    let anchor = anchor_at(&case, &vec![0.0; case.deviations.len()]);
    let limits = times(sum_of_squares(&case.robots(), &case.poses()), 0.97);
    for extreme in [
        f64::NAN,
        f64::INFINITY,
        -f64::INFINITY,
        f64::MAX,
        1e200,
        -1e160,
    ] {
        for parameter in 0..case.deviations.len() {
            let before = std::mem::replace(&mut case.deviations[parameter].0[3], extreme);
            let is_length = !case.space.parameters[parameter].is_angle();
            let found = exceeds(&case, &anchor, &limits);
            // A finite length may be that large: then its cost is not a number either, or above the limit.
            let cost = sum_of_squares(&case.robots(), &case.poses()).0[3];
            assert!(
                !found[3] || is_length && (cost.is_nan() || cost > limits.0[3]),
                "{extreme}: {}",
                case.space.parameters[parameter].name()
            );
            assert!((0..LANES).filter(|lane| *lane != 3).all(|lane| found[lane]));
            case.deviations[parameter].0[3] = before;
        }
    }
    assert_eq!(
        exceeds(&case, &anchor, &Lanes::splat(f64::INFINITY)),
        [false; LANES]
    );
    assert_eq!(
        exceeds(&case, &anchor, &Lanes::splat(f64::NAN)),
        [false; LANES]
    );
}

#[test]
fn every_code_path_says_the_same() {
    for seed in 0..30 {
        let case = random_case(seed, 5, (1.0, 1e-2));
        let costs = sum_of_squares(&case.robots(), &case.poses());
        for factor in [0.9, 0.5, 0.2, 0.05, 0.01] {
            let on = |set: InstructionSet| {
                let anchor =
                    anchor_at(&case, &vec![0.0; case.deviations.len()]).with_instructions(set);
                exceeds(&case, &anchor, &times(costs, factor))
            };
            for set in InstructionSet::all_here() {
                assert_eq!(on(set), on(InstructionSet::Baseline), "{set:?}");
            }
        }
    }
}

#[test]
fn the_anchors_cost_is_the_readable_one() {
    let case = random_case(5, 6, (3.0, 0.1));
    let deviation: Vec<f64> = case.deviations.iter().map(|d| d.0[0]).collect();
    let readable = cost(
        &apply(&case.space.reference, &case.space.parameters, &deviation),
        &case.observations,
    );
    assert!((anchor_at(&case, &deviation).cost_mm2() - readable).abs() < 1e-12 * readable);
}

#[test]
fn where_poses_are_fewer_than_parameters_there_is_no_bound() {
    let mut case = random_case(3, 6, (1.0, 0.01));
    case.observations.truncate(1);
    assert!(Anchor::at_reference(&case.space, &case.observations).is_none());
}
