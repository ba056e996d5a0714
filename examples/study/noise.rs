//! Identification from points whose noise differs from direction to direction: with it stated, and without, beside a weighted fit of scipy.
//!
//!     cargo run --release --example study noise DIR > DIR/kincal.txt
//!     docs/oracles/scipy_noise.py DIR > DIR/scipy.csv
//!     cargo run --release --example study noise DIR DIR/scipy.csv
//!
//! The first run writes every set with its robot and the truth at unseen poses into DIR; the last one prints both beside each other.
//! `docs/noise.md` has the table.

use crate::simulation::{found, limited};
use crate::trackers::{Instrument, Measured, measured};
use kincal::calibration::{CalibrationRequest, calibrate};
use kincal::kinematics::Robot;
use kincal::measurement::MeasurementSet;
use kincal::wire::json;
use kincal::wire::robot::RobotBody;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Simulated robots of each case.
const ROBOTS: u64 = 24;
/// What the robot itself scatters by, mm in each coordinate.
const ROBOT_MM: [f64; 2] = [0.0, 0.05];

/// Runs the study.
pub fn study(arguments: &[String]) {
    let mut arguments = arguments.iter().cloned();
    let folder = PathBuf::from(arguments.next().expect("a folder to write the sets into"));
    let scipy: BTreeMap<String, Vec<f64>> = arguments
        .next()
        .map(|path| std::fs::read_to_string(path).unwrap())
        .iter()
        .flat_map(|text| text.lines().skip(1))
        .map(|line| {
            let (case, errors) = line.split_once(',').unwrap();
            let errors = errors.split(',').map(|e| e.parse().unwrap()).collect();
            (case.to_owned(), errors)
        })
        .collect();
    std::fs::create_dir_all(&folder).unwrap();
    let body: RobotBody = json::parse(&std::fs::read("data/paper/robot.json").unwrap()).unwrap();
    let nominal = limited(Robot::try_from(&body).unwrap());
    println!(
        "case | without | stated | without / stated | stated / scipy | stated / scipy with priors"
    );
    for instrument in Instrument::ALL {
        for robot_mm in ROBOT_MM {
            let rows: Vec<[f64; 4]> = (0..ROBOTS)
                .map(|seed| {
                    let measured = measured(&nominal, instrument, robot_mm, seed);
                    let name = format!("{}_{robot_mm}_{seed}", instrument.name());
                    write(&folder, &name, &nominal, &measured, robot_mm);
                    let error =
                        |set: MeasurementSet| measured.error_mm(&found(&run(&nominal, set)));
                    let (without, stated) =
                        (error(measured.unstated()), error(measured.set.clone()));
                    let oracle = scipy.get(&name);
                    let over = |k: usize| oracle.map_or(f64::NAN, |errors| stated / errors[k]);
                    [without, stated, over(0), over(1)]
                })
                .collect();
            let of = |value: fn(&[f64; 4]) -> f64| median(rows.iter().map(value).collect());
            println!(
                "{}, robot {robot_mm} mm | {:.4} | {:.4} | {:.3} | {:.3} | {:.3}",
                instrument.name(),
                of(|r| r[0]),
                of(|r| r[1]),
                of(|r| r[0] / r[1]),
                of(|r| r[2]),
                of(|r| r[3])
            );
        }
    }
}

fn run(nominal: &Robot, set: MeasurementSet) -> kincal::calibration::CalibrationReport {
    let request = CalibrationRequest::new(nominal.clone(), set);
    calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Links, points with their covariances, and where the true robot is at unseen poses; lengths in mm, angles in rad.
fn write(folder: &Path, name: &str, nominal: &Robot, measured: &Measured, robot_mm: f64) {
    let mut text = String::new();
    for link in &nominal.links {
        let (a, d) = (link.a_mm, link.d_mm);
        let (alpha, theta, beta) = (link.alpha_rad, link.theta_offset_rad, link.beta_rad);
        writeln!(text, "link,{a},{alpha},{d},{theta},{beta}").unwrap();
    }
    let list = |values: &[f64]| -> String {
        let texts: Vec<String> = values.iter().map(f64::to_string).collect();
        texts.join(",")
    };
    for point in &measured.set.points {
        let noise = point.position_noise.unwrap();
        let variances = noise.std_mm.map(|std| std * std + robot_mm * robot_mm);
        let covariance =
            noise.axes * nalgebra::Matrix3::from_diagonal(&variances) * noise.axes.transpose();
        let values = [
            nominal.q_model_rad(&point.q_rad),
            point.position_mm.as_slice().to_vec(),
            covariance.as_slice().to_vec(),
        ];
        writeln!(text, "point,{}", list(&values.concat())).unwrap();
    }
    for q_rad in &measured.unseen {
        let truth = measured.truth.position(&nominal.q_model_rad(q_rad), 0);
        let values = [nominal.q_model_rad(q_rad), truth.as_slice().to_vec()];
        writeln!(text, "unseen,{}", list(&values.concat())).unwrap();
    }
    std::fs::write(folder.join(format!("{name}.txt")), text).unwrap();
}
