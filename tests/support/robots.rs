//! Simulated robots of several makes, with errors of manufacture and of measurement.

use super::simulation::Normal;
use kincal::identification::KinematicModel;
use kincal::identification::model::parameters::{Parameter, apply, complete_parameters};
use kincal::kinematics::{Link, Robot};
use kincal::measurement::{Frame, MeasurementSet, Point};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Unit, Vector3};
use rand::RngExt;

fn robot(links: &[[f64; 4]]) -> Robot {
    let link = |[a_mm, alpha_deg, d_mm, theta_deg]: &[f64; 4]| Link {
        a_mm: *a_mm,
        alpha_rad: alpha_deg.to_radians(),
        d_mm: *d_mm,
        theta_offset_rad: theta_deg.to_radians(),
        beta_rad: 0.0,
    };
    Robot::from_links(links.iter().map(link).collect())
}

/// Name and nominal links (a mm, alpha °, d mm, theta offset °): the paper's arm, a large one, a small one, a cobot with three parallel axes, a
/// seven-axis arm, a palletizer of four axes.
pub fn models() -> Vec<(&'static str, Robot)> {
    vec![
        (
            "paper",
            robot(&[
                [0., 0., 504., 0.],
                [166.605, -90., 0., 0.],
                [782.27, 0., 0., 0.],
                [138.826, -90., 761.35, 0.],
                [0., 90., 0., 0.],
                [0., -90., 125., 0.],
            ]),
        ),
        (
            "large",
            robot(&[
                [0., 0., 675., 0.],
                [350., -90., 0., 0.],
                [1150., 0., 0., -90.],
                [41., -90., 1200., 0.],
                [0., 90., 0., 0.],
                [0., -90., 215., 180.],
            ]),
        ),
        (
            "small",
            robot(&[
                [0., 0., 330., 0.],
                [75., -90., 0., -90.],
                [300., 0., 0., 0.],
                [75., -90., 320., 0.],
                [0., 90., 0., 0.],
                [0., -90., 80., 0.],
            ]),
        ),
        (
            "cobot",
            robot(&[
                [0., 0., 127.3, 0.],
                [0., 90., 0., 0.],
                [-612., 0., 0., 0.],
                [-572.3, 0., 163.9, 0.],
                [0., 90., 115.7, 0.],
                [0., -90., 92.2, 0.],
            ]),
        ),
        (
            "seven axes",
            robot(&[
                [0., 0., 360., 0.],
                [0., -90., 0., 0.],
                [0., 90., 420., 0.],
                [0., 90., 0., 0.],
                [0., -90., 400., 0.],
                [0., -90., 0., 0.],
                [0., 90., 126., 0.],
            ]),
        ),
        (
            "four axes",
            robot(&[
                [0., 0., 700., 0.],
                [260., -90., 0., -90.],
                [1000., 0., 0., 90.],
                [1100., 90., 250., 0.],
            ]),
        ),
    ]
}

/// Errors of a robot's manufacture, and of its measurement.
#[derive(Clone, Copy, Debug)]
pub struct Tolerances {
    pub length_mm: f64,
    pub angle_deg: f64,
    pub noise_mm: f64,
    pub n_points: usize,
    /// Measured in turn.
    pub n_targets: usize,
    pub frame: Frame,
}

/// A set measured on a robot of this make.
pub fn measured(nominal: &Robot, making: &Tolerances, random: &mut Normal) -> MeasurementSet {
    let parameters: Vec<Parameter> = complete_parameters(nominal.links.len(), 1)
        .into_iter()
        .filter(Parameter::is_link)
        .collect();
    let error = |p: &Parameter| {
        random.draw()
            * if p.is_angle() {
                making.angle_deg.to_radians()
            } else {
                making.length_mm
            }
    };
    let errors: Vec<f64> = parameters.iter().map(error).collect();
    let mut truth = apply(
        &KinematicModel::nominal(&nominal.links, 1),
        &parameters,
        &errors,
    );
    if making.frame == Frame::Instrument {
        let axis = Unit::new_normalize(random.vector() + Vector3::z() * 0.1);
        truth.t_instrument_base = IsometryMatrix3::from_parts(
            Translation3::from(random.vector() * 1500.0),
            Rotation3::from_axis_angle(&axis, 2.0 * random.draw()),
        );
        truth.targets_mm[0] = Vector3::new(40.0, -30.0, 120.0) + random.vector() * 40.0;
    }
    for _ in 1..making.n_targets {
        let further = Vector3::new(40.0, -30.0, 120.0) + random.vector() * 60.0;
        truth.targets_mm.push(further);
    }
    let joints = nominal.links.len();
    let mut point = |row: usize| {
        let q_rad: Vec<f64> = (0..joints)
            .map(|joint| reach(joint) * (2.0 * random.0.random::<f64>() - 1.0))
            .collect();
        let target = row % making.n_targets;
        let position_mm = truth.position(&q_rad, target) + random.vector() * making.noise_mm;
        Point {
            q_rad,
            position_mm,
            target,
            ..Point::empty(joints, row)
        }
    };
    let points = (0..making.n_points).map(&mut point).collect();
    MeasurementSet::new(making.frame, points)
}

/// Half the range of a joint, rad: the upper arm moves less than base and wrist.
fn reach(joint: usize) -> f64 {
    if joint == 1 || joint == 2 { 1.0 } else { 2.4 }
}

/// Typical errors of new robots.
pub const CLEAN: Tolerances = Tolerances {
    length_mm: 0.5,
    angle_deg: 0.1,
    noise_mm: 0.05,
    n_points: 40,
    n_targets: 1,
    frame: Frame::Instrument,
};

/// Result of a study of robots without faults: how many were refused, had a warning, or fitted.
pub fn clean_robots(n: usize, seed: u64) -> Vec<(&'static str, [usize; 3])> {
    use kincal::calibration::upload_checks::alignment::{Alignment, Explanation, align, explain};
    let models = models();
    let others: Vec<(String, Robot)> = models
        .iter()
        .map(|(name, robot)| ((*name).to_owned(), robot.clone()))
        .collect();
    let mut counts: Vec<(&'static str, [usize; 3])> =
        models.iter().map(|(name, _)| (*name, [0; 3])).collect();
    for i in 0..n {
        let index = i % models.len();
        let nominal = &models[index].1;
        let mut random = Normal::new(seed + i as u64);
        let n_points = 10 + (random.0.random::<f64>() * 70.0) as usize;
        let frame = if i.is_multiple_of(2) {
            Frame::Instrument
        } else {
            Frame::Base
        };
        let set = measured(
            nominal,
            &Tolerances {
                n_points,
                frame,
                ..CLEAN
            },
            &mut random,
        );
        let without: Vec<(String, Robot)> = others
            .iter()
            .filter(|(name, _)| name != models[index].0)
            .cloned()
            .collect();
        let outcome = match align(nominal, &set) {
            Alignment::Fits => 2,
            Alignment::Misses(rms_mm) => match explain(nominal, &set, rms_mm, &without) {
                Explanation::Refusal(_) => 0,
                Explanation::Warning { .. } => 1,
            },
        };
        counts[index].1[outcome] += 1;
    }
    counts
}
