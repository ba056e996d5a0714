//! Steps and drift: simulated campaigns with a planted drift, warm-up, random walk or slip; the oracle is what was planted. The long form, with
//! 1,000 campaigns per row, is `examples/study/drift.rs`.

use crate::drifts::{DRIFT_MM, NOISE_MM, ROWS, VISITS, What, campaign, counts, told};
use kincal::calibration::{CalibrationRequest, calibrate};
use kincal::measurement::MeasurementSet;
use std::ops::ControlFlow;

/// Campaigns of a kind.
const CAMPAIGNS: u64 = 12;
/// Among them so many may tell a step, or a drift, that is none: one in a hundred is stated, and two of twelve are then told in 1 of 200 cases.
const FALSELY: usize = 1;
/// So many must be found of those that are there: 95 and 90 in a hundred are stated, and fewer are then found in 2 and 11 of 100 cases.
const FOUND: usize = 10;

#[test]
fn no_step_is_told_where_something_drifts_scatters_or_wanders() {
    for what in [
        What::Clean,
        What::Sag,
        What::Drift,
        What::WarmUp,
        What::HeavyTails,
        What::Walk,
    ] {
        let [steps, ..] = counts(what, 0..CAMPAIGNS);
        assert!(steps <= FALSELY, "{}: {steps}", what.name());
    }
}

#[test]
fn nothing_drifts_in_a_clean_campaign_with_sag_or_with_heavy_tails() {
    for what in [What::Clean, What::Sag, What::HeavyTails] {
        let [_, _, drift, warm_up] = counts(what, 0..CAMPAIGNS);
        assert!(
            drift + warm_up <= FALSELY,
            "{}: {drift} {warm_up}",
            what.name()
        );
    }
}

#[test]
fn slips_of_two_millimetres_are_found_within_a_row() {
    let [_, near, ..] = counts(What::SlipOfTarget, 0..CAMPAIGNS);
    assert!(near >= FOUND, "{near}");
    // the first row or the last one alone may as well be an outlier
    let is_seen = |seed: &u64| {
        let (_, _, slips_at) = campaign(What::SlipOfBase, *seed);
        slips_at.is_some_and(|row| (2..=ROWS - 2).contains(&row))
    };
    let missed = (0..CAMPAIGNS)
        .filter(is_seen)
        .filter(|seed| !told(What::SlipOfBase, *seed).step_near)
        .count();
    assert!(missed <= FALSELY, "{missed}");
}

#[test]
fn a_drift_is_named_with_its_size_and_direction_and_a_warm_up_is_told_from_it() {
    let [_, _, drift, warm_up] = counts(What::Drift, 0..CAMPAIGNS);
    assert!(
        drift + warm_up >= FOUND && drift > warm_up,
        "{drift} {warm_up}"
    );
    let [_, _, drift, warm_up] = counts(What::WarmUp, 0..CAMPAIGNS);
    assert!(
        drift + warm_up >= FOUND && warm_up > drift,
        "{drift} {warm_up}"
    );
    let (robot, set, _) = campaign(What::Drift, 1);
    let planted = drift_by_repeats_mm(&set);
    let report = calibrate(&CalibrationRequest::new(robot, set), &mut |_| {
        ControlFlow::Continue(())
    })
    .unwrap();
    let detail = &report
        .warnings
        .iter()
        .find(|w| w.code == "drift")
        .unwrap()
        .detail;
    let first = detail.split("mm in the measuring frame, ").nth(1).unwrap();
    let size: f64 = first.split(' ').next().unwrap().parse().unwrap();
    assert!((size - DRIFT_MM).abs() < 2.0 * NOISE_MM, "{detail}");
    // a second way: the differences of the visits of one pose, without any robot
    assert!(
        (planted - size).abs() < 4.0 * NOISE_MM,
        "{planted} {detail}"
    );
}

/// A straight line through the visits of the first pose, mm over the session.
fn drift_by_repeats_mm(set: &MeasurementSet) -> f64 {
    let n = set.points.len();
    let visits: Vec<_> = set
        .points
        .iter()
        .enumerate()
        .filter(|(_, p)| p.configuration == "c0")
        .collect();
    assert_eq!(visits.len(), VISITS);
    let time = |row: usize| row as f64 / (n - 1) as f64;
    let mean = visits.iter().map(|(row, _)| time(*row)).sum::<f64>() / VISITS as f64;
    let squares: f64 = visits
        .iter()
        .map(|(row, _)| (time(*row) - mean).powi(2))
        .sum();
    let slope: nalgebra::Vector3<f64> = visits
        .iter()
        .map(|(row, p)| p.position_mm * (time(*row) - mean))
        .sum();
    (slope / squares).norm()
}
