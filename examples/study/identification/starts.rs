//! Does the complete model converge, wherever the instrument stands, whatever the arm, however badly its joints are mastered?

use crate::simulation::Normal;
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use kincal::identification::KinematicModel;
use kincal::kinematics::{Link, Robot};
use kincal::measurement::{Frame, MeasurementSet, Point, Subset};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Vector3};
use rand::RngExt;
use std::ops::ControlFlow;

const NOISE_MM: f64 = 0.05;

/// An arm of `n` links: right angles and parallels between axes of an industrial arm's lengths.
fn arm(n: usize, random: &mut Normal) -> Robot {
    let angles = [0.0, 90.0, -90.0, 180.0];
    let link = |i: usize, random: &mut Normal| Link {
        a_mm: if i == 0 {
            0.0
        } else {
            random.0.random_range(0.0..500.0)
        },
        alpha_rad: if i == 0 {
            0.0
        } else {
            f64::to_radians(angles[random.0.random_range(0..4)])
        },
        d_mm: random.0.random_range(0.0..500.0),
        theta_offset_rad: 0.0,
        beta_rad: 0.0,
    };
    Robot::from_links((0..n).map(|i| link(i, random)).collect())
}

struct Case {
    name: &'static str,
    n_links: Option<usize>,
    n_poses: usize,
    n_targets: usize,
    on_axis: bool,
    unmastered_deg: f64,
}

fn simulate(case: &Case, seed: u64) -> (Robot, MeasurementSet) {
    let mut random = Normal::new(7_000_000 + seed);
    let nominal = match case.n_links {
        Some(n) => arm(n, &mut random),
        None => crate::data::paper_robot(),
    };
    let mut truth = KinematicModel::nominal(&nominal.links, case.n_targets);
    for link in &mut truth.links {
        link.a_mm += 0.3 * random.draw();
        link.d_mm += 0.3 * random.draw();
        link.alpha_rad += 0.05f64.to_radians() * random.draw();
        link.theta_offset_rad +=
            (case.unmastered_deg * (2.0 * random.0.random::<f64>() - 1.0)).to_radians();
    }
    let turn = Rotation3::new(random.vector() * 2.0);
    truth.t_instrument_base =
        IsometryMatrix3::from_parts(Translation3::from(random.vector() * 2000.0), turn);
    for target in &mut truth.targets_mm {
        let off_axis = if case.on_axis {
            Vector3::zeros()
        } else {
            Vector3::new(random.draw(), random.draw(), 0.0) * 80.0
        };
        *target = off_axis + Vector3::new(0.0, 0.0, 120.0);
    }
    let points = (0..case.n_poses * case.n_targets).map(|row| Point {
        target: row % case.n_targets,
        ..Point::empty(nominal.links.len(), row)
    });
    let mut points: Vec<Point> = points.collect();
    for pose in points.chunks_mut(case.n_targets) {
        let q: Vec<f64> = nominal
            .links
            .iter()
            .map(|_| random.0.random_range(-1.6..1.6))
            .collect();
        for p in pose {
            p.position_mm = truth.position(&q, p.target) + random.vector() * NOISE_MM;
            (p.q_rad, p.subset) = (q.clone(), Some(Subset::Identify));
        }
    }
    (nominal, MeasurementSet::new(Frame::Instrument, points))
}

/// The table.
pub fn table(n: u64) {
    println!(
        "## From nominal kinematics, with no guess of base and targets\n\n{n} simulated robots per row, noise {NOISE_MM} mm, instrument anywhere; joints off by up to the stated angle to both sides. Converged: the points"
    );
    println!("fit to three times the noise, rms.\n");
    println!(
        "| arms | poses | targets | joints off by | least squares from nominal | auto | slowest auto, ms |\n|---|---|---|---|---|---|---|"
    );
    let case = |name, n_links, n_poses, n_targets, on_axis, unmastered_deg| Case {
        name,
        n_links,
        n_poses,
        n_targets,
        on_axis,
        unmastered_deg,
    };
    let cases = [
        case("the paper's", None, 50, 1, false, 0.1),
        case("the paper's", None, 20, 1, false, 5.0),
        case("the paper's", None, 50, 1, false, 5.0),
        case("the paper's, target on the axis", None, 50, 1, true, 5.0),
        case("the paper's", None, 50, 3, false, 10.0),
        case("the paper's", None, 600, 1, false, 10.0),
        case("the paper's", None, 50, 1, false, 30.0),
        case("the paper's", None, 50, 1, false, 60.0),
        case("the paper's", None, 50, 1, false, 120.0),
        case("1 link", Some(1), 20, 1, false, 5.0),
        case("random, 3 links", Some(3), 30, 1, false, 10.0),
        case("random, 4 links", Some(4), 40, 2, false, 10.0),
        case("random, 6 links", Some(6), 50, 1, false, 10.0),
        case("random, 7 links", Some(7), 60, 1, false, 10.0),
        case("random, 12 links", Some(12), 100, 1, false, 5.0),
    ];
    for case in &cases {
        let (mut converged, mut slowest) = ([0, 0], 0.0f64);
        for seed in 0..n {
            let (robot, set) = simulate(case, seed);
            for (k, method) in [Method::LeastSquares, Method::Auto].into_iter().enumerate() {
                let start = std::time::Instant::now();
                let report = calibrate(
                    &CalibrationRequest {
                        method,
                        ..CalibrationRequest::new(robot.clone(), set.clone())
                    },
                    &mut |_| ControlFlow::Continue(()),
                );
                let ms = start.elapsed().as_secs_f64() * 1e3;
                if k == 1 {
                    slowest = slowest.max(ms);
                }
                converged[k] += u32::from(
                    report.is_ok_and(|r| r.identify.after.rms_mm < 3.0 * NOISE_MM * 3f64.sqrt()),
                );
            }
        }
        println!(
            "| {} | {} | {} | {}\u{b0} | {} | {} | {slowest:.0} |",
            case.name,
            case.n_poses,
            case.n_targets,
            case.unmastered_deg,
            converged[0],
            converged[1]
        );
    }
    println!();
}
