//! Do the stated 95 % intervals hold the truth? Prints the tables of `docs/uncertainty.md`.
//!
//! `cargo run --release --example study coverage [n_robots]`; `study coverage joints` and
//! `study coverage corrections` print the third and the fourth table alone.

use crate::data::{paper_robot, real_data, robot};
use crate::measured_robots;
use crate::simulation;
use crate::simulation::{
    Campaign, NonlinearErrors, Normal, Scored, identified, intervals_held, limited, measure, poses,
    position_with_sag, robot_of_wide_priors, tool_intervals_held, true_robot,
};
use kincal::calibration::request::CorrectionsChoice;
use kincal::calibration::{CalibrationReport, CalibrationRequest, Method, calibrate};
use kincal::identification::KinematicModel;
use kincal::identification::corrections::corrected::IdentifiedRobot;
use kincal::kinematics::Robot;
use kincal::measurement::{MeasurementSet, Subset};
use nalgebra::{Rotation3, Vector3};
use std::ops::ControlFlow;

/// Robots per row of the second table.
const N_RATIOS: u64 = 100;
/// Robots per row of the third table.
const N_OF_JOINTS: u64 = 40;
/// Robots per row of the fourth table.
const N_CORRECTED: u64 = 24;
/// Poses that no fit has seen, per robot.
const N_UNSEEN: usize = 200;

/// Counts over the robots of one campaign.
#[derive(Default)]
struct Tally {
    parameters: (usize, usize),
    tool: (usize, usize),
    predicted_mm2: f64,
    missed_mm2: f64,
    n: f64,
}

/// Runs the study.
pub fn study(arguments: &[String]) {
    match arguments.first().map(String::as_str) {
        Some("joints") => return of_joints(),
        Some("corrections") => return of_corrections(),
        _ => {}
    }
    let n_robots = arguments
        .first()
        .cloned()
        .and_then(|n| n.parse().ok())
        .unwrap_or(1000);
    println!("## Do the stated 95 % intervals hold the truth?\n");
    println!(
        "| {n_robots} robots each | parameters | tool | tool: predicted / true rms, mm |\n|---|---|---|---|"
    );
    let plain = Campaign::PLAIN;
    let three = Campaign {
        n_configurations: 20,
        n_targets: 3,
        ..plain
    };
    let rows = [
        ("50 poses, white noise 0.03 mm", plain),
        (
            "25 poses, white noise 0.03 mm",
            Campaign {
                n_configurations: 25,
                ..plain
            },
        ),
        ("20 configurations of 3 targets, white noise 0.03 mm", three),
        (
            "20 configurations of 3 targets, 0.05 mm shared by a configuration",
            Campaign {
                shared_mm: 0.05,
                ..three
            },
        ),
        (
            "50 poses, sag of 0.2 mm (rms)",
            Campaign {
                sag_rad: 1e-4,
                ..plain
            },
        ),
        (
            "50 poses, sag of 1 mm (rms)",
            Campaign {
                sag_rad: 5e-4,
                ..plain
            },
        ),
        (
            "20 configurations of 3 targets, sag of 1 mm",
            Campaign {
                sag_rad: 5e-4,
                ..three
            },
        ),
    ];
    for (name, campaign) in rows {
        tell(n_robots, name, &campaign, true_robot);
    }
    for (name, made) in [
        (
            "50 poses, white noise 0.03 mm, links as the priors say",
            (|nominal, n_targets, random| robot_of_wide_priors(nominal, n_targets, 1.0, random))
                as Truth,
        ),
        (
            "the same, links three times as far off",
            |nominal, n_targets, random| robot_of_wide_priors(nominal, n_targets, 3.0, random),
        ),
    ] {
        tell(n_robots, name, &plain, made);
    }
    ratios(&rows_of_ratios());
    of_joints();
    of_corrections();
}

/// Makes a robot as it truly is.
type Truth = fn(&Robot, usize, &mut Normal) -> KinematicModel;

/// A row of the first table.
fn tell(n_robots: u64, name: &str, campaign: &Campaign, made: Truth) {
    let mut tally = Tally::default();
    (0..n_robots).for_each(|seed| one_robot(seed, campaign, made, &mut tally));
    let share = |(stated, held): (usize, usize)| {
        format!("{:.2} % of {stated}", 100.0 * held as f64 / stated as f64)
    };
    let rms = |sum: f64| (sum / tally.n).sqrt();
    let (predicted, missed) = (rms(tally.predicted_mm2), rms(tally.missed_mm2));
    println!(
        "| {name} | {} | {} | {predicted:.4} / {missed:.4} |",
        share(tally.parameters),
        share(tally.tool)
    );
}

/// A row of the second table.
struct Row {
    name: &'static str,
    n_poses: usize,
    sag_rad: f64,
    /// Reach of the arm, mm.
    reach_mm: f64,
    noise_mm: f64,
    n_stations: usize,
}

/// Reach of the paper's arm, mm.
const REACH_MM: f64 = 2479.0;

fn rows_of_ratios() -> Vec<Row> {
    let usual = Row {
        name: "",
        n_poses: 50,
        sag_rad: 0.0,
        reach_mm: REACH_MM,
        noise_mm: 0.03,
        n_stations: 1,
    };
    let mut rows = Vec::new();
    for (sag_rad, names) in [
        (
            0.0,
            ["10 poses", "25 poses", "50 poses", "200 poses", "800 poses"],
        ),
        (
            5e-4,
            [
                "10 poses, sag of 1 mm",
                "25 poses, sag of 1 mm",
                "50 poses, sag of 1 mm",
                "200 poses, sag of 1 mm",
                "800 poses, sag of 1 mm",
            ],
        ),
    ] {
        for (name, n_poses) in names.into_iter().zip([10, 25, 50, 200, 800]) {
            rows.push(Row {
                name,
                n_poses,
                sag_rad,
                ..usual
            });
        }
    }
    for (name, reach_mm, noise_mm) in [
        ("an arm of 10 mm, 50 poses, noise 0.5 µm", 10.0, 0.0005),
        ("an arm of 1.7 m, 50 poses", 1700.0, 0.03),
        ("an arm of 20 m, 50 poses, noise 0.1 mm", 20_000.0, 0.1),
    ] {
        rows.push(Row {
            name,
            reach_mm,
            noise_mm,
            ..usual
        });
    }
    rows.push(Row {
        name: "6 stations of 8 poses",
        n_poses: 48,
        n_stations: 6,
        ..usual
    });
    rows
}

/// What the first station measures, as another one does.
fn from_station(station: usize, position_mm: &Vector3<f64>) -> Vector3<f64> {
    let turn = Rotation3::new(Vector3::new(0.1, -0.05, 0.9) * station as f64);
    turn * position_mm + Vector3::new(1500.0, -400.0, 100.0) * station as f64
}

/// Stated and true error of one robot's tool, mm; the stated one is `None` where nothing is stated.
fn stated_and_true_mm(seed: u64, row: &Row) -> (Option<f64>, f64) {
    let size = row.reach_mm / REACH_MM;
    let campaign = Campaign {
        n_configurations: row.n_poses,
        noise_mm: row.noise_mm / size,
        sag_rad: row.sag_rad,
        ..Campaign::PLAIN
    };
    let mut nominal = limited(paper_robot());
    let mut random = Normal::new(seed);
    let truth = true_robot(&nominal, 1, &mut random);
    let measured = poses(row.n_poses, &mut random);
    let mut set = measure(&truth, &measured, &campaign, &mut random);
    let of_one_station = row.n_poses.div_ceil(row.n_stations);
    for (k, point) in set.points.iter_mut().enumerate() {
        let station = k / of_one_station;
        if row.n_stations > 1 {
            point.position_mm = from_station(station, &point.position_mm);
            point.station = Some(format!("s{station}"));
        }
        point.position_mm *= size;
    }
    for link in &mut nominal.links {
        link.a_mm *= size;
        link.d_mm *= size;
    }
    let request = CalibrationRequest {
        method: Method::LeastSquares,
        corrections: Some(CorrectionsChoice::Off),
        ..CalibrationRequest::new(nominal, set)
    };
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(()))
        .expect("these campaigns can be identified from");
    let found = simulation::found(&report);
    // the model stands in the frame of one of the stations
    let unseen = poses(N_UNSEEN, &mut random);
    let squares_from = |station: usize| -> f64 {
        unseen
            .iter()
            .map(|q| {
                let there = position_with_sag(&truth, q, 0, row.sag_rad);
                (found.position(q, 0) - from_station(station, &there) * size).norm_squared()
            })
            .sum()
    };
    let squares = (0..row.n_stations)
        .map(squares_from)
        .fold(f64::INFINITY, f64::min);
    let true_mm = (squares / N_UNSEEN as f64).sqrt();
    (report.tool_uncertainty.map(|t| t.mean_mm), true_mm)
}

/// The third table: errors of the joints.
fn of_joints() {
    println!(
        "\n## Joints that turn by more than links say\n\n| {N_OF_JOINTS} robots each | poses | stated / true, median (10 % to 90 %) | stated, median | true, \
         median | nothing stated |\n|---|---|---|---|---|---|"
    );
    let none = NonlinearErrors::NONE;
    let harmonics = |order: f64| NonlinearErrors {
        harmonic_rad: 3e-4,
        order,
        ..none
    };
    let follows = |follows: f64| NonlinearErrors { follows, ..none };
    for (name, errors) in [
        ("harmonics of order 1 and 2", harmonics(1.0)),
        ("harmonics of order 2 and 4", harmonics(2.0)),
        ("harmonics of order 3 and 6", harmonics(3.0)),
        ("harmonics of order 4 and 8", harmonics(4.0)),
        ("harmonics of order 8 and 16", harmonics(8.0)),
        ("joint 6 follows joint 5 by 0.5 %", follows(0.005)),
        ("joint 6 follows joint 5 by 2 %", follows(0.02)),
        ("joint 6 follows joint 5 by 5 %", follows(0.05)),
    ] {
        rows_of_errors(name, &errors, &[50, 120], N_OF_JOINTS, |found| {
            let tool = found.report.tool_uncertainty;
            (tool.map(|tool| tool.mean_mm), found.links_mm)
        });
    }
}

/// A row for each number of poses: stated and true errors of robots that links do not describe.
fn rows_of_errors(
    name: &str,
    errors: &NonlinearErrors,
    n_poses: &[usize],
    n_robots: u64,
    stated_and_true_mm: impl Fn(&Scored) -> (Option<f64>, f64),
) {
    let nominal = limited(paper_robot());
    for n_configurations in n_poses {
        let campaign = Campaign {
            n_configurations: *n_configurations,
            ..Campaign::PLAIN
        };
        let found = |seed| identified(&nominal, &campaign, errors, seed, N_UNSEEN);
        let all: Vec<(Option<f64>, f64)> = (0..n_robots)
            .map(|seed| stated_and_true_mm(&found(seed)))
            .collect();
        println!("| {name} | {n_configurations} {}", summary(&all));
    }
}

/// The fourth table: predictions with corrections.
fn of_corrections() {
    println!(
        "\n## Predictions with corrections\n\n| {N_CORRECTED} robots each | poses | stated / true, median (10 % to 90 %) | stated, median | true, \
         median | nothing stated |\n|---|---|---|---|---|---|"
    );
    let none = NonlinearErrors::NONE;
    for (name, errors) in [
        ("links alone", none),
        (
            "sag, 0.5 mrad",
            NonlinearErrors {
                sag_rad: 5e-4,
                ..none
            },
        ),
        (
            "sag, 1 mrad",
            NonlinearErrors {
                sag_rad: 1e-3,
                ..none
            },
        ),
        (
            "sag, 2 mrad, harmonics, 0.2 mrad",
            NonlinearErrors {
                sag_rad: 2e-3,
                harmonic_rad: 2e-4,
                ..none
            },
        ),
        (
            "harmonics of order 1 and 2, 0.3 mrad",
            NonlinearErrors {
                harmonic_rad: 3e-4,
                ..none
            },
        ),
        (
            "harmonics of order 3 and 6, 0.3 mrad",
            NonlinearErrors {
                harmonic_rad: 3e-4,
                order: 3.0,
                ..none
            },
        ),
        (
            "sag that grows with the moment's power of 1.5, 0.5 mrad",
            NonlinearErrors {
                hardening_rad: 5e-4,
                ..none
            },
        ),
        (
            "sag, 1 mrad; joint 6 follows joint 5 by 2 %",
            NonlinearErrors {
                sag_rad: 1e-3,
                follows: 0.02,
                ..none
            },
        ),
    ] {
        rows_of_errors(name, &errors, &[25, 50, 200], N_CORRECTED, |found| {
            (found.stated_mm, found.corrected_mm)
        });
    }
    measured_halves();
}

/// Two halves of a measured robot, each identified by itself: what one half states of its predictions, and how far it predicts the other half's points
/// and the other half's predictions of these points.
fn measured_halves() {
    let Some(root) = real_data() else { return };
    println!(
        "\n| split | stated, rms | halves differ, rms over root 2 | misses the other half's points, rms | inside 95 % |\n|---|---|---|---|---|"
    );
    let nominal = robot(&root.join("qkm_hl6/robot.json"));
    let whole = measured_robots::set(&root.join("qkm_hl6/set.csv"));
    for seed in 0..8 {
        let mut random = Normal::new(seed);
        let of_first: Vec<bool> = whole.points.iter().map(|_| random.draw() > 0.0).collect();
        let half = |first: bool| {
            let points = whole.points.iter().zip(&of_first);
            let points = points.filter(|(_, is_first)| **is_first == first);
            MeasurementSet::new(whole.frame, points.map(|(p, _)| p.clone()).collect())
        };
        let [own, other] = [half(true), half(false)].map(|set| {
            let everything = set.points.clone();
            let all = measured_robots::with_split(&set, |_, _| Subset::Identify);
            let request = CalibrationRequest::new(nominal.clone(), all);
            let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
            (report, everything)
        });
        let of = |report: &CalibrationReport| IdentifiedRobot {
            plain: simulation::found(report),
            corrected: report.corrected.clone(),
        };
        let (here, there) = (of(&own.0), of(&other.0));
        let Some(estimate) = &own.0.estimate else {
            println!("| {seed} | nothing | | | |");
            continue;
        };
        let (mut stated, mut differ, mut missed, mut inside) = (0.0, 0.0, 0.0, 0);
        let of_noise = match &estimate.corrected {
            Some(corrected) => &corrected.uncertainty,
            None => &estimate.uncertainty,
        };
        // a point scatters by what its configuration shares, too
        let scatter_mm = of_noise.noise_std_mm.hypot(of_noise.configuration_std_mm);
        for point in &other.1 {
            let (q, target) = (&point.q_rad, point.target);
            let std_mm = estimate.predicted_std_mm(&here, q, target);
            let miss_mm = (here.position(q, target) - point.position_mm).norm();
            stated += std_mm * std_mm;
            differ += 0.5 * (here.position(q, target) - there.position(q, target)).norm_squared();
            missed += miss_mm * miss_mm;
            // 1.614 is the 95 % quantile of the length of a normal vector over its root mean square
            let expected_mm = std_mm.hypot(3f64.sqrt() * scatter_mm);
            inside += usize::from(miss_mm < 1.614 * expected_mm);
        }
        let n = other.1.len() as f64;
        let rms = |sum: f64| (sum / n).sqrt();
        println!(
            "| {seed} | {:.4} mm | {:.4} mm | {:.4} mm | {:.0} % |",
            rms(stated),
            rms(differ),
            rms(missed),
            100.0 * inside as f64 / n
        );
    }
}

fn ratios(rows: &[Row]) {
    println!(
        "\n## Is the stated uncertainty of the tool its error?\n\n| {N_RATIOS} robots each | stated / true, median (10 % to 90 %) | stated, \
         median | true, median | nothing stated |\n|---|---|---|---|---|"
    );
    for row in rows {
        let all: Vec<(Option<f64>, f64)> = (0..N_RATIOS)
            .map(|seed| stated_and_true_mm(seed, row))
            .collect();
        println!("| {} {}", row.name, summary(&all));
    }
}

/// The cells of a row of the second and third table, from the stated and true errors of some robots.
fn summary(all: &[(Option<f64>, f64)]) -> String {
    let stated: Vec<(f64, f64)> = all
        .iter()
        .filter_map(|(stated, actual)| Some(((*stated)?, *actual)))
        .collect();
    let at = |share: f64, of: fn(&(f64, f64)) -> f64| {
        let mut values: Vec<f64> = stated.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        let k = (share * values.len() as f64) as usize;
        values.get(k).copied().unwrap_or(f64::NAN)
    };
    let ratio = |(stated, actual): &(f64, f64)| stated / actual;
    format!(
        "| {:.2} ({:.2} to {:.2}) | {:.3e} mm | {:.3e} mm | {} |",
        at(0.5, ratio),
        at(0.1, ratio),
        at(0.9, ratio),
        at(0.5, |p| p.0),
        at(0.5, |p| p.1),
        all.len() - stated.len()
    )
}

fn one_robot(seed: u64, campaign: &Campaign, made: Truth, tally: &mut Tally) {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(seed);
    let truth = made(&nominal, campaign.n_targets, &mut random);
    let set = measure(
        &truth,
        &poses(campaign.n_configurations, &mut random),
        campaign,
        &mut random,
    );
    let request = CalibrationRequest {
        method: Method::LeastSquares,
        ..CalibrationRequest::new(nominal.clone(), set)
    };
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(()))
        .expect("these campaigns can be identified from");
    let elsewhere = poses(20, &mut random);
    let add =
        |to: &mut (usize, usize), counts: (usize, usize)| *to = (to.0 + counts.0, to.1 + counts.1);
    add(
        &mut tally.parameters,
        intervals_held(&nominal, &truth, &report),
    );
    add(
        &mut tally.tool,
        tool_intervals_held(&nominal, &truth, &report, &elsewhere, campaign.sag_rad),
    );
    tally.predicted_mm2 += report
        .tool_uncertainty
        .map_or(0.0, |t| t.mean_mm * t.mean_mm);
    let found = simulation::found(&report);
    let missed = |q: &Vec<f64>| {
        (position_with_sag(&truth, q, 0, campaign.sag_rad) - found.position(q, 0)).norm_squared()
    };
    tally.missed_mm2 += elsewhere.iter().map(missed).sum::<f64>() / elsewhere.len() as f64;
    tally.n += 1.0;
}
