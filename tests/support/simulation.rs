//! Simulated robots: random errors of every number of every link, random poses, normal noise, and sag that no model here
//! knows of.

use kincal::calibration::CalibrationRequest;
use kincal::calibration::request::CorrectionsChoice;
use kincal::identification::KinematicModel;
use kincal::identification::model::parameters::{
    Parameter, Quantity, apply, complete_parameters, is_parallel,
};
use kincal::identification::statistics::distributions::t_half_width;
use kincal::kinematics::Robot;
use kincal::kinematics::forward::t_previous_link;
use kincal::measurement::{Frame, MeasurementSet, Point, Subset};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Unit, Vector3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::f64::consts::TAU;

/// Middle and half-width of the poses of each joint, rad.
const JOINTS_RAD: [(f64, f64); 6] = [
    (0.0, 2.6),
    (-0.4, 1.0),
    (0.3, 1.1),
    (0.0, 2.8),
    (0.0, 1.7),
    (0.0, 3.0),
];

/// Seeded normal numbers (Box and Muller 1958).
pub struct Normal(pub ChaCha8Rng);

impl Normal {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn draw(&mut self) -> f64 {
        let (u, v): (f64, f64) = (1.0 - self.0.random::<f64>(), self.0.random());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }

    pub fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.draw(), self.draw(), self.draw())
    }

    /// Joint values, rad, anywhere between these limits and their negatives.
    pub fn pose(&mut self, limits_deg: &[f64; 6]) -> Vec<f64> {
        limits_deg
            .iter()
            .map(|limit| (limit * (2.0 * self.0.random::<f64>() - 1.0)).to_radians())
            .collect()
    }
}

/// Settings of a simulated measuring campaign.
#[derive(Clone, Copy, Debug)]
pub struct Campaign {
    pub n_configurations: usize,
    pub n_targets: usize,
    /// White noise of each coordinate, mm.
    pub noise_mm: f64,
    /// Error that all points of one configuration share, each coordinate, mm.
    pub shared_mm: f64,
    /// Compliance of joints 2 and 3: rotation per unit moment (1 kg at 1 m), rad; half of it about the other two axes.
    pub sag_rad: f64,
}

impl Campaign {
    /// White noise alone, one target.
    pub const PLAIN: Self = Self {
        n_configurations: 50,
        n_targets: 1,
        noise_mm: 0.03,
        shared_mm: 0.0,
        sag_rad: 0.0,
    };
}

/// A robot as it truly is: errors of 0.3 mm and 0.05° (one standard deviation) in every number of every link, somewhere
/// in the room, with targets off the flange's axis.
pub fn true_robot(nominal: &Robot, n_targets: usize, random: &mut Normal) -> KinematicModel {
    robot_with_errors(nominal, n_targets, random, Parameter::is_link, workshop_std)
}

/// As [`true_robot`], with errors only where neither the base nor a target nor another number says the same: its base is the one of its
/// axes, and its flange that of its last axis (`compensation::anchor`).
pub fn anchored_robot(nominal: &Robot, n_targets: usize, random: &mut Normal) -> KinematicModel {
    let links = &nominal.links;
    let last = links.len() - 1;
    let is_parallel = |link: usize| is_parallel(&links[link]);
    // d of parallel axes slides: one of them is free, and none where they hold the first or the last axis
    let has_own_d = |link: usize| {
        let first = (1..=link).rev().take_while(|i| is_parallel(*i)).last();
        let end = (link + 1..links.len())
            .take_while(|i| is_parallel(*i))
            .last();
        first.is_none() && end != Some(last)
    };
    let is_own = |p: &Parameter| match *p {
        Parameter::Link(0, _) => false,
        Parameter::Link(_, Quantity::A | Quantity::Alpha) => true,
        Parameter::Link(link, Quantity::D) => link != last && has_own_d(link),
        Parameter::Link(link, Quantity::ThetaOffset) => link != last,
        Parameter::Link(link, Quantity::Beta) => is_parallel(link),
        _ => false,
    };
    robot_with_errors(nominal, n_targets, random, is_own, workshop_std)
}

fn workshop_std(parameter: &Parameter) -> f64 {
    if parameter.is_angle() {
        0.05f64.to_radians()
    } else {
        0.3
    }
}

/// As [`true_robot`], with errors that are what the priors of the complete model say: 0.5 mm per 1.7 m of reach, 0.05° between axes, 0.3° of
/// joint offsets.
pub fn robot_of_the_priors(
    nominal: &Robot,
    n_targets: usize,
    random: &mut Normal,
) -> KinematicModel {
    robot_of_wide_priors(nominal, n_targets, 1.0, random)
}

/// The same with errors that are `times` as large.
pub fn robot_of_wide_priors(
    nominal: &Robot,
    n_targets: usize,
    times: f64,
    random: &mut Normal,
) -> KinematicModel {
    let reach_mm: f64 = nominal
        .links
        .iter()
        .map(|l| l.a_mm.abs() + l.d_mm.abs())
        .sum();
    let std = |p: &Parameter| match p {
        Parameter::Link(_, Quantity::ThetaOffset) => 0.3f64.to_radians(),
        p if p.is_angle() => 0.05f64.to_radians(),
        _ => 0.5 / 1700.0 * reach_mm,
    };
    robot_with_errors(nominal, n_targets, random, Parameter::is_link, |p| {
        times * std(p)
    })
}

fn robot_with_errors(
    nominal: &Robot,
    n_targets: usize,
    random: &mut Normal,
    is_off: impl Fn(&Parameter) -> bool,
    std: impl Fn(&Parameter) -> f64,
) -> KinematicModel {
    let parameters: Vec<Parameter> = complete_parameters(nominal.links.len(), n_targets)
        .into_iter()
        .filter(is_off)
        .collect();
    let errors: Vec<f64> = parameters.iter().map(|p| random.draw() * std(p)).collect();
    let mut truth = apply(
        &KinematicModel::nominal(&nominal.links, n_targets),
        &parameters,
        &errors,
    );
    let axis = Unit::new_normalize(random.vector() + Vector3::z() * 0.1);
    let turn = Rotation3::from_axis_angle(&axis, random.draw());
    truth.t_instrument_base =
        IsometryMatrix3::from_parts(Translation3::from(random.vector() * 800.0), turn);
    for (k, target) in truth.targets_mm.iter_mut().enumerate() {
        let angle = TAU * k as f64 / n_targets as f64 + 0.4;
        *target =
            Vector3::new(90.0 * angle.cos(), 90.0 * angle.sin(), 110.0) + random.vector() * 5.0;
    }
    truth
}

/// Random poses of the paper's arm.
pub fn poses(n: usize, random: &mut Normal) -> Vec<Vec<f64>> {
    let mut joint = |(middle, half_width): &(f64, f64)| {
        middle + half_width * (2.0 * random.0.random::<f64>() - 1.0)
    };
    (0..n)
        .map(|_| JOINTS_RAD.iter().map(&mut joint).collect())
        .collect()
}

/// The paper's arm, with the joint limits that [`poses`] keeps.
pub fn limited(mut nominal: Robot) -> Robot {
    nominal.joint_limits_rad = JOINTS_RAD
        .iter()
        .map(|(middle, half_width)| Some((middle - half_width, middle + half_width)))
        .collect();
    nominal
}

/// Two sessions of one simulated robot, 40 configurations of two targets each. In the second one tracker and reflectors have other positions, and
/// the robot has a change.
pub fn two_sessions(
    nominal: &Robot,
    seed: u64,
    change: impl Fn(&mut KinematicModel),
) -> (MeasurementSet, MeasurementSet) {
    let mut random = Normal::new(seed);
    let first = true_robot(nominal, 2, &mut random);
    let mut second = true_robot(nominal, 2, &mut random);
    second.links = first.links.clone();
    change(&mut second);
    let campaign = Campaign {
        n_configurations: 40,
        n_targets: 2,
        ..Campaign::PLAIN
    };
    let mut session =
        |truth: &KinematicModel| measure(truth, &poses(40, &mut random), &campaign, &mut random);
    (session(&first), session(&second))
}

/// Measures `truth` at `poses`, every point to identify, in the instrument frame.
pub fn measure(
    truth: &KinematicModel,
    poses: &[Vec<f64>],
    campaign: &Campaign,
    random: &mut Normal,
) -> MeasurementSet {
    let mut points = Vec::new();
    for (configuration, q_rad) in poses.iter().enumerate() {
        let shared = random.vector() * campaign.shared_mm;
        for target in 0..campaign.n_targets {
            let true_mm = position_with_sag(truth, q_rad, target, campaign.sag_rad);
            points.push(Point {
                q_rad: q_rad.clone(),
                position_mm: true_mm + shared + random.vector() * campaign.noise_mm,
                configuration: format!("c{configuration}"),
                target,
                subset: Some(Subset::Identify),
                ..Point::empty(6, points.len())
            });
        }
    }
    MeasurementSet::new(Frame::Instrument, points)
}

/// Position of a target, mm, if joints 2 and 3 sag under masses of 1, 1 and 0.5 kg at the origins of links 3, 5 and 6. Gravity is −z of the base.
pub fn position_with_sag(
    model: &KinematicModel,
    q_rad: &[f64],
    target: usize,
    sag_rad: f64,
) -> Vector3<f64> {
    position_in_gravity(model, q_rad, target, sag_rad, &-Vector3::z())
}

/// The same with another direction of gravity in the base frame.
pub fn position_in_gravity(
    model: &KinematicModel,
    q_rad: &[f64],
    target: usize,
    sag_rad: f64,
    gravity_in_base: &Vector3<f64>,
) -> Vector3<f64> {
    let mut frames = vec![IsometryMatrix3::identity()];
    for (link, q) in model.links.iter().zip(q_rad) {
        frames.push(frames[frames.len() - 1] * t_previous_link(link, *q));
    }
    let moment = |joint: usize| -> Vector3<f64> {
        let at = frames[joint].translation.vector;
        [(3, 1.0), (5, 1.0), (6, 0.5)]
            .iter()
            .filter(|(link, _)| *link > joint)
            .map(|(link, mass)| {
                (frames[*link].translation.vector - at).cross(gravity_in_base) * (mass / 1000.0)
            })
            .sum()
    };
    let mut t = model.t_instrument_base;
    for (i, (link, q)) in model.links.iter().zip(q_rad).enumerate() {
        t *= t_previous_link(link, *q);
        if i == 1 || i == 2 {
            let turn = (frames[i + 1].rotation.inverse() * moment(i + 1))
                .component_mul(&Vector3::new(0.5, 0.5, 1.0))
                * sag_rad;
            t *= IsometryMatrix3::from_parts(Translation3::identity(), Rotation3::new(turn));
        }
    }
    t.rotation * model.targets_mm[target] + t.translation.vector
}

/// The true value of a parameter of the complete model, mm or degrees; `None` for the base's rotation, which is relative to its first estimate.
pub fn true_value(truth: &KinematicModel, parameter: &Parameter) -> Option<f64> {
    use kincal::identification::model::parameters::quantity_mut;
    match *parameter {
        Parameter::Link(link, quantity) => {
            let value = *quantity_mut(&mut truth.links[link].clone(), quantity);
            Some(if parameter.is_angle() {
                value.to_degrees()
            } else {
                value
            })
        }
        Parameter::BaseTranslation(axis) => Some(truth.t_instrument_base.translation.vector[axis]),
        Parameter::BaseRotation(_) => None,
        Parameter::Target(target, axis) => Some(truth.targets_mm[target][axis]),
        Parameter::TargetRotation(..) => None,
    }
}

/// Number of 95 % intervals in a report, and of those that contain the true value.
pub fn intervals_held(
    nominal: &Robot,
    truth: &KinematicModel,
    report: &kincal::calibration::CalibrationReport,
) -> (usize, usize) {
    let parameters = complete_parameters(nominal.links.len(), truth.targets_mm.len());
    let mut counts = (0, 0);
    for parameter in &parameters {
        let stated = report
            .parameters
            .iter()
            .find(|p| p.name == parameter.name())
            .and_then(|p| p.interval_95);
        if let (Some([low, high]), Some(value)) = (stated, true_value(truth, parameter)) {
            counts.0 += 1;
            counts.1 += usize::from((low..=high).contains(&value));
        }
    }
    counts
}

/// A request without corrections. They change neither links nor placement nor what screening finds, and take half of the time: for tests that look at
/// nothing else.
pub fn links_alone(request: &CalibrationRequest) -> CalibrationRequest {
    CalibrationRequest {
        corrections: Some(CorrectionsChoice::Off),
        ..request.clone()
    }
}

/// The identified robot of a report.
pub fn found(report: &kincal::calibration::CalibrationReport) -> KinematicModel {
    KinematicModel {
        t_instrument_base: report.t_instrument_base,
        links: report.links.clone(),
        targets_mm: report.targets_mm.clone(),
        target_rotations: vec![],
    }
}

/// Number of 95 % intervals of target 0's position at some poses, along each axis, and of those that contain the true value.
pub fn tool_intervals_held(
    nominal: &Robot,
    truth: &KinematicModel,
    report: &kincal::calibration::CalibrationReport,
    poses: &[Vec<f64>],
    sag_rad: f64,
) -> (usize, usize) {
    let Some(uncertainty) = &report.uncertainty else {
        return (0, 0);
    };
    let (parameters, found) = (
        complete_parameters(nominal.links.len(), truth.targets_mm.len()),
        found(report),
    );
    let half = t_half_width(0.95, uncertainty.freedom);
    let held = |q: &Vec<f64>| {
        let errors = uncertainty.position_errors_mm(&found, &parameters, q, 0);
        let missed = position_with_sag(truth, q, 0, sag_rad) - found.position(q, 0);
        (0..3)
            .filter(|axis| missed[*axis].abs() <= half * errors.row(*axis).norm())
            .count()
    };
    (3 * poses.len(), poses.iter().map(held).sum())
}

/// Errors of a simulated robot that links do not describe.
#[derive(Clone, Copy, Debug)]
pub struct NonlinearErrors {
    /// As [`Campaign::sag_rad`].
    pub sag_rad: f64,
    /// Amplitude of each joint's first harmonic, half of it of the second; phases are random.
    pub harmonic_rad: f64,
    /// Order of that first harmonic; the second has twice the order.
    pub order: f64,
    /// Joint 6 follows joint 5 by this share of its value.
    pub follows: f64,
    /// Deflection of joint 2 by the weight of the stretched arm, half of it of joint 3, growing with the moment's power of 1.5.
    pub hardening_rad: f64,
}

impl NonlinearErrors {
    pub const NONE: Self = Self {
        sag_rad: 0.0,
        harmonic_rad: 0.0,
        order: 1.0,
        follows: 0.0,
        hardening_rad: 0.0,
    };
}

/// A robot with errors that links do not describe.
pub struct NonlinearRobot {
    pub truth: KinematicModel,
    nonlinear: NonlinearErrors,
    phases_rad: Vec<[f64; 2]>,
}

impl NonlinearRobot {
    /// True position of a target, mm.
    pub fn position(&self, q_rad: &[f64], target: usize) -> Vector3<f64> {
        let NonlinearErrors {
            harmonic_rad,
            order,
            follows,
            hardening_rad,
            ..
        } = self.nonlinear;
        let turned = |(q, phase): (&f64, &[f64; 2])| {
            q + harmonic_rad
                * ((order * q + phase[0]).sin() + 0.5 * (2.0 * order * q + phase[1]).sin())
        };
        let q_5_rad = q_rad[4];
        let mut q_rad: Vec<f64> = q_rad.iter().zip(&self.phases_rad).map(turned).collect();
        q_rad[5] += follows * q_5_rad;
        let [upper, lower] = [q_rad[1].cos(), (q_rad[1] + q_rad[2]).cos()];
        q_rad[1] += hardening_rad * upper * upper.abs().sqrt();
        q_rad[2] += 0.5 * hardening_rad * lower * lower.abs().sqrt();
        position_with_sag(&self.truth, &q_rad, target, self.nonlinear.sag_rad)
    }
}

/// A nonlinear robot and a campaign on it, every point to identify, in the instrument frame.
pub fn nonlinear_set(
    nominal: &Robot,
    campaign: &Campaign,
    nonlinear: &NonlinearErrors,
    random: &mut Normal,
) -> (NonlinearRobot, MeasurementSet) {
    let truth = true_robot(nominal, campaign.n_targets, random);
    let phases_rad = nominal
        .links
        .iter()
        .map(|_| {
            [
                TAU * random.0.random::<f64>(),
                TAU * random.0.random::<f64>(),
            ]
        })
        .collect();
    let robot = NonlinearRobot {
        truth,
        nonlinear: *nonlinear,
        phases_rad,
    };
    let poses = poses(campaign.n_configurations, random);
    let mut set = measure(
        &robot.truth,
        &poses,
        &Campaign {
            noise_mm: 0.0,
            sag_rad: 0.0,
            ..*campaign
        },
        random,
    );
    for point in &mut set.points {
        point.position_mm =
            robot.position(&point.q_rad, point.target) + random.vector() * campaign.noise_mm;
    }
    (robot, set)
}

/// An identified nonlinear robot, scored at unseen poses of the same kind, against the truth without noise.
pub struct Scored {
    pub report: kincal::calibration::CalibrationReport,
    /// rms of links alone, mm.
    pub links_mm: f64,
    /// With corrections, mm.
    pub corrected_mm: f64,
    /// Standard uncertainty of the predictions with corrections at these poses, rms, mm; `None` where nothing is stated.
    pub stated_mm: Option<f64>,
}

/// Identifies a simulated robot and scores it.
pub fn identified(
    nominal: &Robot,
    campaign: &Campaign,
    nonlinear: &NonlinearErrors,
    seed: u64,
    n_unseen: usize,
) -> Scored {
    use kincal::identification::corrections::corrected::IdentifiedRobot;
    let mut random = Normal::new(seed);
    let (robot, set) = nonlinear_set(nominal, campaign, nonlinear, &mut random);
    let request = kincal::calibration::CalibrationRequest::new(nominal.clone(), set);
    let report =
        kincal::calibration::calibrate(&request, &mut |_| std::ops::ControlFlow::Continue(()))
            .unwrap();
    let found = IdentifiedRobot {
        plain: found(&report),
        corrected: report.corrected.clone(),
    };
    let unseen = poses(n_unseen, &mut random);
    let rms = |predicted: &dyn Fn(&[f64]) -> Vector3<f64>| {
        let squares = unseen
            .iter()
            .map(|q| (robot.position(q, 0) - predicted(q)).norm_squared());
        (squares.sum::<f64>() / n_unseen as f64).sqrt()
    };
    let (links_mm, corrected_mm) = (
        rms(&|q| found.plain.position(q, 0)),
        rms(&|q| found.position(q, 0)),
    );
    let stated_mm = report.estimate.as_ref().map(|estimate| {
        let squares = unseen.iter().map(|q| {
            let std_mm = estimate.predicted_std_mm(&found, q, 0);
            std_mm * std_mm
        });
        (squares.sum::<f64>() / n_unseen as f64).sqrt()
    });
    Scored {
        report,
        links_mm,
        corrected_mm,
        stated_mm,
    }
}
