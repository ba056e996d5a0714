//! Several sessions of one robot in one job: how often they are fitted together, and what that gains. Prints the tables of `docs/sessions.md`.
//!
//! `cargo run --release --example study sessions [n_pairs]`

use crate::data::paper_robot;
use crate::simulation::{Campaign, Normal, measure, poses, true_robot};
use kincal::calibration::request::{CorrectionsChoice, Method};
use kincal::calibration::{
    CalibrationReport, CalibrationRequest, Error, SESSIONS_DIFFER, calibrate,
};
use kincal::identification::KinematicModel;
use kincal::measurement::MeasurementSet;
use kincal::measurement::sessions::joined;
use std::ops::ControlFlow;

/// What is done to the robot between the sessions.
type Change = fn(&mut KinematicModel, &mut Normal);

/// Runs the study.
pub fn study(arguments: &[String]) {
    let n_pairs = arguments
        .first()
        .cloned()
        .and_then(|n| n.parse().ok())
        .unwrap_or(100);
    refusals(n_pairs);
    gains(n_pairs.div_ceil(10));
}

/// Sessions of one robot, in each of which the tracker stands elsewhere, the reflector is fixed anew and other poses are measured. The links change
/// before the last one. And the robot of the last one.
fn sessions(
    seed: u64,
    campaigns: &[Campaign],
    change: Change,
) -> (Vec<MeasurementSet>, KinematicModel) {
    let mut random = Normal::new(seed);
    let links = true_robot(&paper_robot(), 1, &mut random).links;
    let mut sets = Vec::new();
    let mut last = KinematicModel::nominal(&links, 1);
    for (session, campaign) in campaigns.iter().enumerate() {
        last = true_robot(&paper_robot(), campaign.n_targets, &mut random);
        last.links.clone_from(&links);
        if session + 1 == campaigns.len() {
            change(&mut last, &mut random);
        }
        let poses = poses(campaign.n_configurations, &mut random);
        sets.push(measure(&last, &poses, campaign, &mut random));
    }
    (sets, last)
}

fn fitted(sets: &[MeasurementSet]) -> Result<CalibrationReport, Error> {
    let (set, sessions) = match sets {
        [single] => (single.clone(), vec![]),
        several => (joined(several), several.to_vec()),
    };
    let request = CalibrationRequest {
        sessions,
        method: Method::LeastSquares,
        corrections: Some(CorrectionsChoice::Off),
        ..CalibrationRequest::new(paper_robot(), set)
    };
    calibrate(&request, &mut |_| ControlFlow::Continue(()))
}

fn is_refused(sets: &[MeasurementSet]) -> bool {
    match fitted(sets) {
        Ok(_) => false,
        Err(Error::Unusable { code, .. }) if code == SESSIONS_DIFFER => true,
        Err(other) => panic!("{other}"),
    }
}

fn of_poses(n_configurations: usize) -> Campaign {
    Campaign {
        n_configurations,
        ..Campaign::PLAIN
    }
}

/// A robot with sessions, how often it is simulated, and what is done to it before the last session.
struct Row {
    name: &'static str,
    n_robots: u64,
    campaigns: Vec<Campaign>,
    change: Change,
}

fn refusals(n_pairs: u64) {
    println!("| white noise 0.03 mm | refused |\n|---|---|");
    let two = |name, n_poses, change| Row {
        name,
        n_robots: n_pairs.div_ceil(4),
        campaigns: vec![of_poses(n_poses); 2],
        change,
    };
    let sagging = Campaign {
        sag_rad: 1e-4,
        ..of_poses(50)
    };
    let unchanged: Change = |_, _| ();
    let rows = [
        Row {
            n_robots: n_pairs,
            ..two(
                "two robots of one model (0.3 mm and 0.05° in every number), 50 poses each",
                50,
                another_robot,
            )
        },
        Row {
            n_robots: n_pairs,
            ..two("two robots of one model, 20 poses each", 20, another_robot)
        },
        two("one robot, 2 sessions of 50 poses", 50, unchanged),
        two("one robot, 2 sessions of 20 poses", 20, unchanged),
        Row {
            campaigns: vec![of_poses(30); 4],
            ..two("one robot, 4 sessions of 30 poses", 30, unchanged)
        },
        Row {
            campaigns: vec![sagging; 2],
            ..two(
                "one robot that sags by 0.2 mm (rms), 2 sessions of 50 poses",
                50,
                unchanged,
            )
        },
        two(
            "theta_offset_3 by 0.02°, 2 sessions of 50 poses",
            50,
            |model, _| model.links[2].theta_offset_rad += 0.02f64.to_radians(),
        ),
        two("a_3 by 0.1 mm, 2 sessions of 50 poses", 50, |model, _| {
            model.links[2].a_mm += 0.1
        }),
        two(
            "every a and d by 0.03 mm, every angle by 0.005° (one standard deviation), 2 sessions of 50 poses",
            50,
            drifted,
        ),
        Row {
            campaigns: vec![of_poses(30); 4],
            ..two(
                "the same in the last of 4 sessions of 30 poses",
                30,
                drifted,
            )
        },
    ];
    for row in rows {
        let sets = |seed: &u64| sessions(*seed, &row.campaigns, row.change).0;
        let refused = (0..row.n_robots).filter(|seed| is_refused(&sets(seed)));
        println!("| {} | {} of {} |", row.name, refused.count(), row.n_robots);
    }
}

fn another_robot(model: &mut KinematicModel, random: &mut Normal) {
    model.links = true_robot(&paper_robot(), 1, random).links;
}

fn drifted(model: &mut KinematicModel, random: &mut Normal) {
    for link in &mut model.links[1..] {
        link.a_mm += 0.03 * random.draw();
        link.d_mm += 0.03 * random.draw();
        link.alpha_rad += 0.005f64.to_radians() * random.draw();
        link.theta_offset_rad += 0.005f64.to_radians() * random.draw();
    }
}

/// Mean squared error of the links and the last session's placement at 200 unseen poses, mm².
fn unseen_mm2(report: &CalibrationReport, truth: &KinematicModel) -> f64 {
    let found = KinematicModel {
        t_instrument_base: report.t_instrument_base,
        links: report.links.clone(),
        targets_mm: report.targets_mm.clone(),
        target_rotations: vec![],
    };
    let last = report.targets_mm.len() - 1;
    let unseen = poses(200, &mut Normal::new(999));
    let squares = unseen
        .iter()
        .map(|q| (found.position(q, last) - truth.position(q, 0)).norm_squared());
    squares.sum::<f64>() / 200.0
}

fn gains(n_robots: u64) {
    println!(
        "\n| {n_robots} robots each, rms at unseen poses, mm | last session alone | all as one upload of several stations | several sessions |\n|---|---|---|---|"
    );
    let noisy = |noise_mm: f64| Campaign {
        noise_mm,
        ..of_poses(30)
    };
    for (name, campaigns) in [
        ("2 sessions of 30 poses, 0.1 mm", vec![noisy(0.1); 2]),
        ("4 sessions of 30 poses, 0.1 mm", vec![noisy(0.1); 4]),
        (
            "30 poses with 0.5 mm, then 30 with 0.05 mm",
            vec![noisy(0.5), noisy(0.05)],
        ),
        (
            "30 poses with 0.05 mm, then 30 with 0.5 mm",
            vec![noisy(0.05), noisy(0.5)],
        ),
    ] {
        let (mut alone, mut one, mut several, mut n) = (0.0, 0.0, 0.0, 0.0);
        for seed in 0..n_robots {
            let (sets, truth) = sessions(5000 + seed, &campaigns, |_, _| ());
            let Ok(report) = fitted(&sets) else {
                continue; // refused by chance
            };
            several += unseen_mm2(&report, &truth);
            let report = fitted(&sets[sets.len() - 1..]).expect("enough poses");
            alone += unseen_mm2(&report, &truth);
            one += unseen_mm2(&fitted(&[joined(&sets)]).expect("enough poses"), &truth);
            n += 1.0;
        }
        let rms = |sum: f64| (sum / n).sqrt();
        println!(
            "| {name} | {:.4} | {:.4} | {:.4} |",
            rms(alone),
            rms(one),
            rms(several)
        );
    }
}
