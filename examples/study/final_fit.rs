//! The delivered fit beside the best possible one: error at poses that no fit has seen. Prints `docs/final-fit.md`.
//!
//! `cargo run --release --example study final_fit DIR docs/oracles/final_fit.csv > docs/final-fit.md`, with the folders that
//! `docs/oracles/final_fit.py` made.

use crate::data;
use kincal::calibration::request::FinalFit;
use kincal::calibration::{CalibrationRequest, calibrate};
use kincal::identification::KinematicModel;
use kincal::identification::corrections::corrected::IdentifiedRobot;
use kincal::measurement::Frame;
use kincal::measurement::table::own_form;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

/// rms at the unseen poses of a case over that of the oracle.
struct Ratios {
    /// All points, links alone.
    links: f64,
    /// All points, with corrections where they were kept.
    delivered: f64,
    /// The identify subset, with corrections where they were kept.
    verified: f64,
}

/// Runs the study.
pub fn study(arguments: &[String]) {
    let [folder, oracle] = arguments else {
        panic!("study final_fit DIR ORACLE.csv");
    };
    let text = std::fs::read_to_string(oracle).unwrap();
    let mut groups: BTreeMap<String, Vec<Ratios>> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let (case, oracle_mm) = line.split_once(',').unwrap();
        let ratios = ratios(&Path::new(folder).join(case), oracle_mm.parse().unwrap());
        eprintln!(
            "{case}: {:.3} {:.3} {:.3}",
            ratios.links, ratios.delivered, ratios.verified
        );
        let group = case.splitn(3, '.').last().unwrap().replace('.', " poses, ");
        groups.entry(group).or_default().push(ratios);
    }
    println!("# Final fit\n");
    println!(
        "Half of the points is held out to verify. Once that is done, the parameters are fitted to all points of the upload and delivered \
         (`final_fit: all`, the default). Nothing is chosen again: free parameters, segments of reflectors and stations, rows that do not count, the loss \
         and the kinds of corrections stay. The report's errors, F and convergence are those of the fit that was verified; its parameters, uncertainties \
         and identifiability those of the delivered one. `final` in the report has the number of points, their rms by the links alone, and `moved_mm`: \
         the mean distance of the tool between both fits at 200 configurations over the workspace, with base and flange anchored to the robot's own axes. \
         The gate `final_fit_near_verified` of a release refuses more than twice the verified rms (with corrections, if any was kept).\n"
    );
    println!(
        "The verified parameters are delivered instead with `final_fit: identify_subset`, in preset `paper`, with `refine: false`, and where more rows are \
         outliers than may be left out. With another set to verify on, both fits are the same.\n"
    );
    println!(
        "Made by `cargo run --release --example study final_fit DIR docs/oracles/final_fit.csv`, of the uploads that `docs/oracles/final_fit.py` makes: \
         16 robots of four arms in each row, half of the poses held out to verify. Error at 200 other poses without noise, rms, over that of a maximum \
         a posteriori fit of the true model to all poses; median, and lower to upper quartile in brackets.\n"
    );
    println!(
        "| upload | delivered (`final_fit: all`) | its links alone | verified fit (`identify_subset`) |\n|---|---|---|---|"
    );
    for (group, ratios) in groups {
        println!(
            "| {group} | {} | {} | {} |",
            quartiles(ratios.iter().map(|r| r.delivered)),
            quartiles(ratios.iter().map(|r| r.links)),
            quartiles(ratios.iter().map(|r| r.verified))
        );
    }
}

fn ratios(folder: &Path, oracle_mm: f64) -> Ratios {
    let robot = data::robot(&folder.join("robot.json"));
    let read = |file: &str| {
        let bytes = std::fs::read(folder.join(file)).unwrap();
        own_form::parse(&bytes, Frame::Instrument, robot.links.len()).unwrap()
    };
    let (set, unseen) = (read("set.csv"), read("unseen.csv"));
    let rms_mm = |robot: &IdentifiedRobot| {
        let squares = unseen.points.iter().map(|point| {
            (point.position_mm - robot.position(&point.q_rad, point.target)).norm_squared()
        });
        (squares.sum::<f64>() / unseen.points.len() as f64).sqrt()
    };
    let fitted = |final_fit| {
        let request = CalibrationRequest {
            final_fit: Some(final_fit),
            ..CalibrationRequest::new(robot.clone(), set.clone())
        };
        let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
        let plain = KinematicModel {
            t_instrument_base: report.t_instrument_base,
            links: report.links,
            targets_mm: report.targets_mm,
            target_rotations: vec![],
        };
        IdentifiedRobot {
            plain,
            corrected: report.corrected,
        }
    };
    let delivered = fitted(FinalFit::All);
    Ratios {
        links: rms_mm(&IdentifiedRobot::of_links(delivered.plain.clone())) / oracle_mm,
        delivered: rms_mm(&delivered) / oracle_mm,
        verified: rms_mm(&fitted(FinalFit::IdentifySubset)) / oracle_mm,
    }
}

/// Median, and lower to upper quartile.
fn quartiles(values: impl Iterator<Item = f64>) -> String {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
    format!("{:.3} ({:.3} to {:.3})", at(0.5), at(0.25), at(0.75))
}
