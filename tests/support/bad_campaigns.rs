//! Whole campaigns with what goes wrong in a cell, all at once: gross rows of up to metres, swapped labels, a reflector that slips.

use super::data::paper_robot;
use super::simulation::{Campaign, Normal, found, limited, measure, poses, true_robot};
use kincal::calibration::CalibrationReport;
use kincal::identification::KinematicModel;
use kincal::kinematics::Robot;
use kincal::measurement::{MeasurementSet, Subset};
use rand::RngExt;
use std::collections::BTreeSet;

/// Share of the rows that are off by 20 mm to 3 m.
const GROSS: f64 = 0.05;
/// Unseen configurations that errors are taken at, without noise.
pub const N_UNSEEN: usize = 200;
const N_TARGETS: usize = 2;

/// One campaign, and the same as somebody would prepare it who knew what had happened: without the bad rows, the reflector after its slip as another target.
pub struct BadCampaign {
    pub robot: Robot,
    /// The robot and its reflectors at the end.
    pub truth: KinematicModel,
    pub set: MeasurementSet,
    pub prepared: MeasurementSet,
    pub bad: BTreeSet<usize>,
    pub has_slipped: bool,
}

pub fn bad_campaign(seed: u64) -> BadCampaign {
    let robot = limited(paper_robot());
    let mut random = Normal::new(40_000 + seed);
    let mut truth = true_robot(&robot, N_TARGETS, &mut random);
    let campaign = Campaign {
        n_configurations: 60,
        n_targets: N_TARGETS,
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    let poses = poses(campaign.n_configurations, &mut random);
    let mut set = measure(&truth, &poses, &campaign, &mut random);
    for (row, point) in set.points.iter_mut().enumerate() {
        let is_even = (row / N_TARGETS).is_multiple_of(2);
        point.subset = Some(if is_even {
            Subset::Identify
        } else {
            Subset::Verify
        });
    }
    let has_slipped = seed.is_multiple_of(2);
    let mut prepared = set.clone();
    if has_slipped {
        let first = N_TARGETS * random.0.random_range(15..45);
        let before = truth.clone();
        truth.targets_mm[0] += random.vector().normalize() * random.0.random_range(0.5..5.0);
        for (row, point) in set.points.iter_mut().enumerate().skip(first) {
            if point.target == 0 {
                point.position_mm +=
                    truth.position(&point.q_rad, 0) - before.position(&point.q_rad, 0);
                prepared.points[row].position_mm = point.position_mm;
                prepared.points[row].target = N_TARGETS;
            }
        }
    }
    let n = set.points.len();
    let mut bad = BTreeSet::new();
    while (bad.len() as f64) < GROSS * n as f64 {
        bad.insert(random.0.random_range(0..n));
    }
    for row in &bad {
        let size_mm = 20.0 * 150f64.powf(random.0.random());
        set.points[*row].position_mm += random.vector().normalize() * size_mm;
    }
    // the operator takes one reflector for the other
    let swapped = N_TARGETS * random.0.random_range(0..60);
    if !bad.contains(&swapped) && !bad.contains(&(swapped + 1)) {
        let of_first = set.points[swapped].position_mm;
        set.points[swapped].position_mm = set.points[swapped + 1].position_mm;
        set.points[swapped + 1].position_mm = of_first;
        bad.extend([swapped, swapped + 1]);
    }
    let mut row = 0;
    prepared.points.retain(|_| {
        row += 1;
        !bad.contains(&(row - 1))
    });
    BadCampaign {
        robot,
        truth,
        set,
        prepared,
        bad,
        has_slipped,
    }
}

/// Error of the delivered parameters at unseen configurations, mm rms: of the reflector that has its place to the end.
pub fn unseen_rms_mm(report: &CalibrationReport, truth: &KinematicModel) -> f64 {
    let model = found(report);
    let unseen = poses(N_UNSEEN, &mut Normal::new(1));
    let square = |q: &Vec<f64>| (model.position(q, 1) - truth.position(q, 1)).norm_squared();
    (unseen.iter().map(square).sum::<f64>() / N_UNSEEN as f64).sqrt()
}

/// What a fit left on the points to verify that are not among these rows, mm rms.
pub fn clean_verify_rms_mm(report: &CalibrationReport, bad: &BTreeSet<usize>) -> f64 {
    let points = report.per_point.iter().enumerate();
    let clean = points.filter(|(row, p)| p.subset == Subset::Verify && !bad.contains(row));
    let squares: Vec<f64> = clean.map(|(_, p)| p.after_mm * p.after_mm).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}
