//! Identification from poses: measured by a tracker (ur10_tmac) and simulated, beside a weighted fit of scipy on the same draws.
//!
//!     cargo run --release --example study poses DIR
//!     docs/oracles/scipy_poses.py DIR > DIR/scipy.txt
//!     cargo run --release --example study poses DIR DIR/scipy.txt
//!
//! The first run writes every set with its robot into DIR; the last one prints both beside each other. `docs/poses.md` has the table.

use kincal::calibration::request::VerifySource;
use kincal::calibration::{CalibrationReport, CalibrationRequest, calibrate};
use kincal::identification::KinematicModel;
use kincal::identification::model::parameters::{Parameter, apply, complete_parameters};
use kincal::kinematics::rotation::{rotation_exp, rotation_log};
use kincal::kinematics::{Link, Robot};
use kincal::measurement::table::own_form;
use kincal::measurement::{Decimal, Frame, MeasurementSet, Point, Subset};
use nalgebra::{IsometryMatrix3, Translation3, UnitQuaternion, Vector3};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Poses to identify from, and draws of each number.
const POSES: [usize; 3] = [8, 12, 20];
const DRAWS: u64 = 5;
/// Others to verify on.
const OTHERS: usize = 800;
/// Simulated robots, poses of each, and configurations at which they are compared with the truth.
const ROBOTS: u64 = 20;
const SIMULATED_POSES: usize = 150;
const UNSEEN: usize = 300;
/// Noise of each coordinate of simulated poses, mm and rad.
const NOISE: (f64, f64) = (0.1, 1e-3);
/// Weight of rotations in scipy's fit to measured poses, mm/rad: 100 to 1000 change its errors by less than 1 %.
const MEASURED_MM_PER_RAD: f64 = 500.0;

struct Case {
    name: String,
    robot: Robot,
    set: MeasurementSet,
    mm_per_rad: f64,
    is_simulated: bool,
}

/// Runs the study.
pub fn study(arguments: &[String]) {
    let mut arguments = arguments.iter().cloned();
    let folder = PathBuf::from(arguments.next().expect("a folder to write the sets into"));
    let scipy = arguments
        .next()
        .map(|path| std::fs::read_to_string(path).unwrap());
    std::fs::create_dir_all(&folder).unwrap();
    let scipy: BTreeMap<String, [f64; 2]> = scipy
        .iter()
        .flat_map(|text| text.lines().skip(1))
        .map(row)
        .collect();
    println!("set | nominal mm | nominal ° | kincal mm | kincal ° | scipy mm | scipy °");
    for case in measured().into_iter().chain(simulated()) {
        write(&folder, &case);
        let errors = scored(&case);
        let beside = scipy
            .get(&case.name)
            .map_or("- | -".into(), |[mm, deg]| format!("{mm:.4} | {deg:.4}"));
        let [before_mm, before_deg, after_mm, after_deg] = errors;
        println!(
            "{} | {before_mm:.4} | {before_deg:.4} | {after_mm:.4} | {after_deg:.4} | {beside}",
            case.name
        );
    }
    crosswise();
}

/// Errors on the points to verify, nominal and identified, mm and degrees. Those of simulated robots have no noise: were they in the same set,
/// noisy points would stand out beside them, and count as outliers.
fn scored(case: &Case) -> [f64; 4] {
    let (robot, set) = (case.robot.clone(), case.set.clone());
    if !case.is_simulated {
        let verify = run(&CalibrationRequest::new(robot, set)).verify.unwrap();
        let rotation = verify.rotation.unwrap();
        return [
            verify.before.rms_mm,
            rotation.before.rms_deg,
            verify.after.rms_mm,
            rotation.after.rms_deg,
        ];
    }
    let is_fitted = |p: &Point| p.subset == Some(Subset::Identify);
    let (fitted, unseen): (Vec<Point>, Vec<Point>) = set.points.into_iter().partition(is_fitted);
    let request = CalibrationRequest {
        verify: VerifySource::Fraction(0.0),
        ..CalibrationRequest::new(
            robot,
            MeasurementSet::new(
                Frame::Instrument,
                fitted
                    .into_iter()
                    .map(|p| Point { subset: None, ..p })
                    .collect(),
            ),
        )
    };
    let report = run(&request);
    let model = KinematicModel {
        t_instrument_base: report.t_instrument_base,
        links: report.links,
        targets_mm: report.targets_mm,
        target_rotations: report.target_rotations,
    };
    let n = unseen.len() as f64;
    let rms = |square: &dyn Fn(&Point) -> f64| (unseen.iter().map(square).sum::<f64>() / n).sqrt();
    let mm = rms(&|p| (p.position_mm - model.position(&p.q_rad, 0)).norm_squared());
    let rad = rms(&|p| {
        let predicted = model.rotation(&p.q_rad, 0).unwrap();
        rotation_log(&(predicted.inverse() * p.rotation.unwrap())).norm_squared()
    });
    let before = report.identify.rotation.unwrap().before.rms_deg;
    [report.identify.before.rms_mm, before, mm, rad.to_degrees()]
}

fn row(line: &str) -> (String, [f64; 2]) {
    let cells: Vec<&str> = line.split(',').collect();
    (cells[0].into(), [1, 2].map(|k| cells[k].parse().unwrap()))
}

fn run(request: &CalibrationRequest) -> CalibrationReport {
    calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn root() -> PathBuf {
    let root = std::env::var("KINCAL_REAL_DATA").unwrap_or_else(|_| "../shared/data/real".into());
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(root)
        .join("ur10_tmac")
}

fn robot(path: &Path) -> Robot {
    let body: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let link = |l: &serde_json::Value| {
        let of = |key: &str| l[key].as_f64().unwrap_or(0.0);
        Link {
            a_mm: of("a_mm"),
            alpha_rad: of("alpha_deg").to_radians(),
            d_mm: of("d_mm"),
            theta_offset_rad: of("theta_offset_deg").to_radians(),
            beta_rad: 0.0,
        }
    };
    Robot::from_links(body["links"].as_array().unwrap().iter().map(link).collect())
}

fn ur10(file: &str) -> (Robot, MeasurementSet) {
    let rotation = "intrinsic_xyz".parse().unwrap();
    let bytes = std::fs::read(root().join(file)).unwrap();
    let set =
        own_form::parse_as(Decimal::Point, Some(rotation), &bytes, Frame::Instrument, 6).unwrap();
    (robot(&root().join("robot.json")), set)
}

/// B and D by their own halves; and few random poses of B.
fn measured() -> Vec<Case> {
    let mut cases = Vec::new();
    for (name, file) in [("B_halves", "data_B.csv"), ("D_halves", "data_D.csv")] {
        let (robot, set) = ur10(file);
        cases.push(case(name.into(), robot, set, MEASURED_MM_PER_RAD));
    }
    for n in POSES {
        for seed in 0..DRAWS {
            let (robot, set) = ur10("data_B.csv");
            let mut points = set.points;
            points.shuffle(&mut ChaCha8Rng::seed_from_u64(1000 * n as u64 + seed));
            points.truncate(n + OTHERS);
            for (row, point) in points.iter_mut().enumerate() {
                let subset = if row < n {
                    Subset::Identify
                } else {
                    Subset::Verify
                };
                (point.subset, point.sequence) = (Some(subset), row as i64);
            }
            let set = MeasurementSet::new(Frame::Instrument, points);
            cases.push(case(
                format!("B_{n:02}_{seed}"),
                robot,
                set,
                MEASURED_MM_PER_RAD,
            ));
        }
    }
    cases
}

fn case(name: String, robot: Robot, set: MeasurementSet, mm_per_rad: f64) -> Case {
    Case {
        name,
        robot,
        set,
        mm_per_rad,
        is_simulated: false,
    }
}

/// Robots with errors of 0.3 mm and 0.05°; points to verify are the truth at configurations that nobody measured.
fn simulated() -> Vec<Case> {
    let (nominal, _) = ur10("data_D.csv");
    let one = |seed: u64| {
        let mut random = Normal(ChaCha8Rng::seed_from_u64(seed));
        let truth = truth(&nominal, &mut random);
        let pose = |row: usize, random: &mut Normal| {
            let q_rad: Vec<f64> = (0..6).map(|_| random.0.random_range(-2.6..2.6)).collect();
            let is_fitted = row < SIMULATED_POSES;
            let (mm, rad) = if is_fitted { NOISE } else { (0.0, 0.0) };
            let turned = rotation_exp(&(random.vector() * rad));
            Point {
                position_mm: truth.position(&q_rad, 0) + random.vector() * mm,
                rotation: truth.rotation(&q_rad, 0).map(|rotation| rotation * turned),
                q_rad,
                subset: Some(if is_fitted {
                    Subset::Identify
                } else {
                    Subset::Verify
                }),
                ..Point::empty(6, row)
            }
        };
        let points = (0..SIMULATED_POSES + UNSEEN)
            .map(|row| pose(row, &mut random))
            .collect();
        let set = MeasurementSet::new(Frame::Instrument, points);
        Case {
            is_simulated: true,
            ..case(
                format!("simulated_{seed:02}"),
                nominal.clone(),
                set,
                NOISE.0 / NOISE.1,
            )
        }
    };
    (0..ROBOTS).map(one).collect()
}

fn truth(nominal: &Robot, random: &mut Normal) -> KinematicModel {
    let reference = KinematicModel {
        target_rotations: vec![rotation_exp(&random.vector())],
        ..KinematicModel::nominal(&nominal.links, 1)
    };
    let parameters: Vec<Parameter> = complete_parameters(6, 1)
        .into_iter()
        .filter(Parameter::is_link)
        .collect();
    let error = |p: &Parameter| {
        if p.is_angle() {
            0.05f64.to_radians()
        } else {
            0.3
        }
    };
    let errors: Vec<f64> = parameters
        .iter()
        .map(|p| error(p) * random.draw())
        .collect();
    let mut truth = apply(&reference, &parameters, &errors);
    let at = Translation3::from(random.vector() * 1000.0);
    truth.t_instrument_base = IsometryMatrix3::from_parts(at, rotation_exp(&random.vector()));
    truth.targets_mm = vec![random.vector() * 60.0];
    truth
}

/// Seeded normal numbers (Box and Muller 1958).
struct Normal(ChaCha8Rng);

impl Normal {
    fn draw(&mut self) -> f64 {
        let (u, v): (f64, f64) = (1.0 - self.0.random::<f64>(), self.0.random());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.draw(), self.draw(), self.draw())
    }
}

/// B identified and D verified with base and target refitted, and back.
fn crosswise() {
    for (from, to) in [("data_B.csv", "data_D.csv"), ("data_D.csv", "data_B.csv")] {
        let ((robot, set), (_, other)) = (ur10(from), ur10(to));
        let request = CalibrationRequest {
            verify: VerifySource::Set(other),
            ..CalibrationRequest::new(robot, set)
        };
        let verify = run(&request).verify.unwrap();
        let rotation = verify.rotation.unwrap();
        println!(
            "{from} identified, {to} verified | {:.4} | {:.4} | {:.4} | {:.4} | - | -",
            verify.before.rms_mm,
            rotation.before.rms_deg,
            verify.after.rms_mm,
            rotation.after.rms_deg,
        );
    }
}

fn write(folder: &Path, case: &Case) {
    let links: Vec<serde_json::Value> = case
        .robot
        .links
        .iter()
        .map(|l| {
            serde_json::json!({"a_mm": l.a_mm, "alpha_deg": l.alpha_rad.to_degrees(), "d_mm": l.d_mm, "theta_offset_deg": l.theta_offset_rad.to_degrees()})
        })
        .collect();
    let robot = serde_json::json!({"links": links, "mm_per_rad": case.mm_per_rad});
    std::fs::write(
        folder.join(format!("{}.json", case.name)),
        robot.to_string(),
    )
    .unwrap();
    let mut text = String::from(
        "q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_mm,y_mm,z_mm,quat_w,quat_x,quat_y,quat_z,subset\n",
    );
    for p in &case.set.points {
        let q = UnitQuaternion::from_rotation_matrix(&p.rotation.unwrap());
        let subset = if p.subset == Some(Subset::Identify) {
            "identify"
        } else {
            "verify"
        };
        let numbers = p
            .q_rad
            .iter()
            .chain(p.position_mm.iter())
            .copied()
            .chain([q.w, q.i, q.j, q.k]);
        let cells: Vec<String> = numbers.map(|x| x.to_string()).collect();
        text += &format!("{},{subset}\n", cells.join(","));
    }
    std::fs::write(folder.join(format!("{}.csv", case.name)), text).unwrap();
}
