//! Simulated campaigns in which something drifts, slips or scatters, with one pose that is visited five times.

use super::data::paper_robot;
use super::simulation::{Campaign, Normal, limited, measure, poses, true_robot};
use kincal::calibration::request::CorrectionsChoice;
use kincal::calibration::{CalibrationRequest, calibrate};
use kincal::kinematics::Robot;
use kincal::measurement::MeasurementSet;
use nalgebra::Vector3;
use rand::RngExt;
use std::ops::ControlFlow;

/// Rows of a campaign, and how often its first pose is visited among them.
pub const ROWS: usize = 60;
pub const VISITS: usize = 5;
/// Noise of a coordinate, mm (one standard deviation).
pub const NOISE_MM: f64 = 0.05;
/// The drift from the first row to the last one, mm.
pub const DRIFT_MM: f64 = 0.2;
/// Time constant of the warm-up, as a share of the session.
pub const TIME_CONSTANT: f64 = 0.15;
/// Standard deviation of each coordinate's change from row to row, mm.
pub const WALK_MM: f64 = 0.02;
/// A slip, mm.
pub const SLIP_MM: f64 = 2.0;

/// What goes on in a campaign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum What {
    Clean,
    Sag,
    Drift,
    WarmUp,
    HeavyTails,
    Walk,
    SlipOfTarget,
    SlipOfBase,
}

impl What {
    pub const ALL: [Self; 8] = [
        Self::Clean,
        Self::Sag,
        Self::Drift,
        Self::WarmUp,
        Self::HeavyTails,
        Self::Walk,
        Self::SlipOfTarget,
        Self::SlipOfBase,
    ];

    pub fn name(self) -> String {
        match self {
            Self::Clean => "clean".into(),
            Self::Sag => "sag of 0.4 mm (rms)".into(),
            Self::Drift => format!("drift of {DRIFT_MM} mm"),
            Self::WarmUp => {
                format!("warm-up of {DRIFT_MM} mm, time constant {TIME_CONSTANT} of the session")
            }
            Self::HeavyTails => "noise with Student's t distribution, 3 degrees of freedom".into(),
            Self::Walk => format!("random walk of {WALK_MM} mm a row"),
            Self::SlipOfTarget => format!("target slips by {SLIP_MM} mm"),
            Self::SlipOfBase => format!("base slips by {SLIP_MM} mm"),
        }
    }
}

/// What a report says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Told {
    /// A step was told; and that within a row of where one was.
    pub step: bool,
    pub step_near: bool,
    pub drift: bool,
    pub warm_up: bool,
}

/// The set, and the first row after a slip.
pub fn campaign(what: What, seed: u64) -> (Robot, MeasurementSet, Option<usize>) {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(7_000_000 + seed);
    let truth = true_robot(&nominal, 1, &mut random);
    let mut q = poses(ROWS, &mut random);
    let visits: Vec<usize> = (0..VISITS).map(|k| k * (ROWS - 1) / (VISITS - 1)).collect();
    for row in &visits {
        q[*row] = q[0].clone();
    }
    let settings = Campaign {
        n_configurations: ROWS,
        noise_mm: if what == What::HeavyTails {
            0.0
        } else {
            NOISE_MM
        },
        sag_rad: if what == What::Sag { 2e-4 } else { 0.0 },
        ..Campaign::PLAIN
    };
    let mut set = measure(&truth, &q, &settings, &mut random);
    let direction = random.vector().normalize();
    let slips_at = random.0.random_range(1..ROWS);
    let slip = random.vector().normalize() * SLIP_MM;
    let mut walked = Vector3::zeros();
    let end = 1.0 - (-1.0 / TIME_CONSTANT).exp();
    for (row, point) in set.points.iter_mut().enumerate() {
        point.subset = None;
        if visits.contains(&row) {
            point.configuration = "c0".into();
        }
        let t = row as f64 / (ROWS - 1) as f64;
        walked += random.vector() * WALK_MM;
        point.position_mm += match what {
            What::Drift => direction * DRIFT_MM * t,
            What::WarmUp => direction * DRIFT_MM * (1.0 - (-t / TIME_CONSTANT).exp()) / end,
            What::Walk => walked,
            What::HeavyTails => Vector3::from_fn(|_, _| {
                let chi = (0..3).map(|_| random.draw().powi(2)).sum::<f64>() / 3.0;
                // of unit variance: that of Student's t is 3
                NOISE_MM * random.draw() / chi.sqrt() / 3f64.sqrt()
            }),
            What::SlipOfBase if row >= slips_at => slip,
            What::SlipOfTarget if row >= slips_at => {
                let mut moved = truth.clone();
                moved.targets_mm[0] += slip;
                moved.position(&point.q_rad, 0) - truth.position(&point.q_rad, 0)
            }
            _ => Vector3::zeros(),
        };
    }
    let is_slip = matches!(what, What::SlipOfBase | What::SlipOfTarget);
    (nominal, set, is_slip.then_some(slips_at))
}

/// Runs one campaign.
pub fn told(what: What, seed: u64) -> Told {
    let (robot, set, slips_at) = campaign(what, seed);
    let request = CalibrationRequest {
        corrections: Some(CorrectionsChoice::Off),
        ..CalibrationRequest::new(robot, set)
    };
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
    let is_told = |code: &str| report.warnings.iter().any(|w| w.code == code);
    let steps = || {
        report
            .warnings
            .iter()
            .filter(|w| w.code.ends_with("_moved"))
    };
    Told {
        step: steps().next().is_some(),
        step_near: steps().any(|w| slips_at.is_some_and(|at| w.rows[0].abs_diff(at) <= 1)),
        drift: is_told("drift"),
        warm_up: is_told("warm_up"),
    }
}

/// Of some campaigns: steps told, steps within a row of where one was, drift, warm-up.
pub fn counts(what: What, seeds: std::ops::Range<u64>) -> [usize; 4] {
    seeds
        .map(|seed| told(what, seed))
        .fold([0; 4], |sum, told| {
            let each = [told.step, told.step_near, told.drift, told.warm_up];
            std::array::from_fn(|i| sum[i] + usize::from(each[i]))
        })
}
