//! What changed since the last session: false alarms and detection. Prints `docs/changes.md`.
//!
//! `cargo run --release --example study changes [n_pairs] > docs/changes.md`

use crate::data;
use crate::data::{paper_robot, real_data};
use crate::simulation::{Campaign, Normal, measure, poses, true_robot};
use kincal::calibration::report::{ChangeKind, Changes};
use kincal::calibration::request::PreviousSession;
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use kincal::identification::KinematicModel;
use kincal::kinematics::Robot;
use kincal::measurement::table::own_form;
use kincal::measurement::{Frame, MeasurementSet};
use std::ops::ControlFlow;

const TEXT: &str = "\
Each pair is two sessions of one simulated robot (random errors of every link parameter): the tracker stands elsewhere, the reflectors
are fixed anew, other poses are measured. Both sessions are fitted alike, on all of their points, and compared in the combinations of link
parameters that both see, with the covariance of both: noise, what configurations share, and the misfit of the model as far as it does not
bend both sessions alike. One joint test (chi-square, against Fisher's F since the noise is estimated) at 1 % false alarms comes first;
only where it alarms are parameters named, the one that explains most first, until the rest is within chance. Jumps (over 0.2 mm or
0.06°) in few parameters are called a collision, small changes drift. A base or target that stands elsewhere is listed under its own name
(`base_x`, `target_0_z`, warning `placement_changed`), and is no change of the robot. Of the complete model, link 1 is carried by
the base: a change there cannot be told from a tracker that was moved.
";

/// What is done to the robot between the sessions.
type Change = fn(&mut KinematicModel, &mut Normal);

/// Runs the study.
pub fn study(arguments: &[String]) {
    let n_pairs = arguments
        .first()
        .cloned()
        .and_then(|n| n.parse().ok())
        .unwrap_or(1000);
    println!(
        "# What changed since the last session\n\nMade by `cargo run --release --example study changes {n_pairs} > docs/changes.md`.\n\n{TEXT}"
    );
    false_alarms(n_pairs);
    detection(n_pairs / 5);
    on_files();
}

fn false_alarms(n_pairs: u64) {
    println!(
        "## Robots that have not changed\n\n| {n_pairs} pairs each | called changed (stated: 1 %) | placement called changed |\n|---|---|---|"
    );
    let plain = Campaign {
        n_configurations: 50,
        ..Campaign::PLAIN
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
        (
            "20 configurations of 3 targets, 0.05 mm shared by a configuration",
            Campaign {
                n_configurations: 20,
                n_targets: 3,
                shared_mm: 0.05,
                ..plain
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
    ];
    for (name, campaign) in rows {
        let (mut alarms, mut placed) = (0, 0);
        for seed in 0..n_pairs {
            let changes = pair(seed, &campaign, |_, _| ());
            alarms += u64::from(changes.kind.is_some());
            placed += u64::from(
                changes
                    .warnings
                    .iter()
                    .any(|w| w.code == "placement_changed"),
            );
        }
        let share = |n: u64| 100.0 * n as f64 / n_pairs as f64;
        println!(
            "| {name} | {:.1} % | {:.1} % |",
            share(alarms),
            share(placed)
        );
    }
}

fn detection(n_pairs: u64) {
    println!(
        "\n## Robots that have changed\n\n50 poses, white noise 0.03 mm. Named: the first names are exactly what was changed.\n"
    );
    println!(
        "| {n_pairs} pairs each | called changed | called a collision | named |\n|---|---|---|---|"
    );
    let rows: [(&str, Change, &[&str]); 5] = [
        (
            "theta_offset_3 by 0.02°",
            |m, _| m.links[2].theta_offset_rad += 0.02f64.to_radians(),
            &["theta_offset_3"],
        ),
        (
            "theta_offset_3 by 0.1°",
            |m, _| m.links[2].theta_offset_rad += 0.1f64.to_radians(),
            &["theta_offset_3"],
        ),
        ("a_3 by 0.25 mm", |m, _| m.links[2].a_mm += 0.25, &["a_3"]),
        (
            "theta_offset_2 by 0.2°, theta_offset_3 by −0.15°, a_3 by 0.1 mm",
            |m, _| {
                m.links[1].theta_offset_rad += 0.2f64.to_radians();
                m.links[2].theta_offset_rad -= 0.15f64.to_radians();
                m.links[2].a_mm += 0.1;
            },
            &["a_3", "theta_offset_2", "theta_offset_3"],
        ),
        (
            "every a and d by 0.03 mm, every angle by 0.005° (one standard deviation)",
            drifted,
            &[],
        ),
    ];
    for (name, change, expected) in rows {
        let (mut alarms, mut collisions, mut named) = (0, 0, 0);
        for seed in 0..n_pairs {
            let changes = pair(seed, &Campaign::PLAIN, change);
            alarms += u64::from(changes.kind.is_some());
            collisions += u64::from(changes.kind == Some(ChangeKind::Collision));
            let is_link = |name: &&str| !name.starts_with("base") && !name.starts_with("target");
            let mut names: Vec<&str> = changes
                .all
                .iter()
                .map(|c| c.name.as_str())
                .filter(is_link)
                .take(expected.len())
                .collect();
            names.sort_unstable();
            named += u64::from(names == expected);
        }
        let share = |n: u64| 100.0 * n as f64 / n_pairs as f64;
        let named = if expected.is_empty() {
            "–".into()
        } else {
            format!("{:.1} %", share(named))
        };
        println!(
            "| {name} | {:.1} % | {:.1} % | {named} |",
            share(alarms),
            share(collisions)
        );
    }
}

fn drifted(model: &mut KinematicModel, random: &mut Normal) {
    for link in &mut model.links[1..] {
        link.a_mm += 0.03 * random.draw();
        link.d_mm += 0.03 * random.draw();
        link.alpha_rad += 0.005f64.to_radians() * random.draw();
        link.theta_offset_rad += 0.005f64.to_radians() * random.draw();
    }
}

/// Two sessions of one robot, compared.
fn pair(
    seed: u64,
    campaign: &Campaign,
    change: impl Fn(&mut KinematicModel, &mut Normal),
) -> Changes {
    let mut random = Normal::new(seed);
    let first = true_robot(&paper_robot(), campaign.n_targets, &mut random);
    let mut second = true_robot(&paper_robot(), campaign.n_targets, &mut random);
    second.links = first.links.clone();
    change(&mut second, &mut random);
    let mut session = |truth: &KinematicModel| {
        measure(
            truth,
            &poses(campaign.n_configurations, &mut random),
            campaign,
            &mut random,
        )
    };
    let (first, second) = (session(&first), session(&second));
    compared(&paper_robot(), first, second)
}

fn compared(robot: &Robot, before: MeasurementSet, after: MeasurementSet) -> Changes {
    let first = CalibrationRequest::new(robot.clone(), before.clone());
    let first = calibrate(&first, &mut |_| ControlFlow::Continue(()))
        .expect("these campaigns can be identified from");
    let previous = Some(PreviousSession {
        set: before,
        frames: None,
        estimate: first.estimate,
    });
    let request = CalibrationRequest {
        method: Method::LeastSquares,
        previous,
        ..CalibrationRequest::new(robot.clone(), after)
    };
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(()))
        .expect("these campaigns can be identified from");
    report.changes.expect("both sessions can be compared")
}

fn on_files() {
    println!(
        "\n## On files\n\nWhat the report says of them after `first.csv`, and of each visit after the other:\n"
    );
    let show = |name: &str, changes: Changes| match changes.warnings.as_slice() {
        [] => println!("- `{name}`: nothing changed beyond chance"),
        warnings => warnings
            .iter()
            .for_each(|w| println!("- `{name}`, `{}`: {}", w.code, w.detail)),
    };
    let paper = |name: &str| data::paper_set(name);
    for name in [
        "followup_unchanged.csv",
        "followup_drifted.csv",
        "followup_collision.csv",
    ] {
        show(
            name,
            compared(&paper_robot(), paper("first.csv"), paper(name)),
        );
    }
    let Some(folder) = real_data().map(|real| real.join("motoman_ma1400")) else {
        return;
    };
    let robot = data::robot(&folder.join("robot.json"));
    let visit = |name: &str| {
        own_form::parse(
            &std::fs::read(folder.join(name)).expect("a visit"),
            Frame::Instrument,
            6,
        )
        .expect("a set")
    };
    show(
        "motoman visit 2 after visit 1",
        compared(&robot, visit("visit_1.csv"), visit("visit_2.csv")),
    );
    show(
        "motoman visit 1 after visit 2",
        compared(&robot, visit("visit_2.csv"), visit("visit_1.csv")),
    );
}
