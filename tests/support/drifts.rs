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
/// The drift from the first row to the last one, mm, and a smaller one.
pub const DRIFT_MM: f64 = 0.2;
pub const SMALL_DRIFT_MM: f64 = 0.1;
/// Time constant of the warm-up, as a share of the session.
pub const TIME_CONSTANT: f64 = 0.15;
/// Standard deviation of each coordinate's change from row to row, mm.
pub const WALK_MM: f64 = 0.02;
/// Growth of every length while the links warm up, and its time constant as a share of the session.
pub const GROWTH: f64 = 4e-5;
pub const GROWTH_TIME_CONSTANT: f64 = 1.0 / 3.0;
/// Noise of a coordinate with which growing links can be seen, mm.
pub const FINE_NOISE_MM: f64 = 0.002;
/// A slip, mm.
pub const SLIP_MM: f64 = 2.0;

/// What goes on in a campaign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum What {
    Clean,
    Sag,
    Drift,
    SmallDrift,
    WarmUp,
    LinksWarmUp,
    HeavyTails,
    Walk,
    SlipOfTarget,
    SlipOfBase,
}

impl What {
    pub const ALL: [Self; 10] = [
        Self::Clean,
        Self::Sag,
        Self::Drift,
        Self::SmallDrift,
        Self::WarmUp,
        Self::LinksWarmUp,
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
            Self::SmallDrift => format!("drift of {SMALL_DRIFT_MM} mm"),
            Self::LinksWarmUp => format!(
                "links grow by {:.0} ppm, time constant a third of the session, noise of {FINE_NOISE_MM} mm",
                GROWTH * 1e6
            ),
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
    pub backlash: bool,
    pub err_together: bool,
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
        noise_mm: match what {
            What::HeavyTails => 0.0,
            What::LinksWarmUp => FINE_NOISE_MM,
            _ => NOISE_MM,
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
            What::SmallDrift => direction * SMALL_DRIFT_MM * t,
            What::LinksWarmUp => {
                let growth = GROWTH * (1.0 - (-t / GROWTH_TIME_CONSTANT).exp());
                let mut grown = truth.clone();
                for link in &mut grown.links {
                    link.a_mm *= 1.0 + growth;
                    link.d_mm *= 1.0 + growth;
                }
                grown.position(&point.q_rad, 0) - truth.position(&point.q_rad, 0)
            }
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
    told_of(robot, set, slips_at)
}

/// What the report on a set says.
pub fn told_of(robot: Robot, set: MeasurementSet, slips_at: Option<usize>) -> Told {
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
        backlash: is_told("backlash"),
        err_together: is_told("configurations_err_together"),
    }
}

/// Number of campaigns in which something was told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    pub step: usize,
    pub step_near: usize,
    pub drift: usize,
    pub warm_up: usize,
    pub backlash: usize,
    pub err_together: usize,
}

/// Of some campaigns, what was told.
pub fn counts_of(told: impl Iterator<Item = Told>) -> Counts {
    told.fold(Counts::default(), |sum, told| Counts {
        step: sum.step + usize::from(told.step),
        step_near: sum.step_near + usize::from(told.step_near),
        drift: sum.drift + usize::from(told.drift),
        warm_up: sum.warm_up + usize::from(told.warm_up),
        backlash: sum.backlash + usize::from(told.backlash),
        err_together: sum.err_together + usize::from(told.err_together),
    })
}

/// Of some campaigns of a kind, what was told.
pub fn counts(what: What, seeds: std::ops::Range<u64>) -> Counts {
    counts_of(seeds.map(|seed| told(what, seed)))
}
