//! Things that move while they are measured: are they found, and is nothing found where nothing moved?

use crate::data::paper_robot;
use crate::simulation::{Campaign, Normal, limited, measure, poses, true_robot};
use kincal::calibration::{CalibrationRequest, calibrate};
use nalgebra::Rotation3;
use rand::RngExt;
use std::ops::ControlFlow;

/// What slips.
#[derive(Clone, Copy, PartialEq)]
enum Slip {
    Nothing,
    Target,
    Base,
}

#[derive(Default)]
struct Counts {
    alarms: usize,
    found: usize,
    near: usize,
    ends_missed: usize,
    ratio: f64,
}

fn run(n: u64, campaign: Campaign, slip: Slip, is_ordered: bool) -> Counts {
    let mut counts = Counts::default();
    for seed in 0..n {
        let nominal = limited(paper_robot());
        let mut random = Normal::new(1_000_000 + seed);
        let truth = true_robot(&nominal, campaign.n_targets, &mut random);
        let mut q = poses(campaign.n_configurations, &mut random);
        if is_ordered {
            q.sort_by(|a, b| a[0].total_cmp(&b[0]));
        }
        let mut set = measure(&truth, &q, &campaign, &mut random);
        let n_rows = set.points.len();
        let row = random.0.random_range(1..n_rows);
        let shift = random.vector().normalize() * 2.0;
        let moved = kincal::identification::KinematicModel {
            targets_mm: truth.targets_mm.iter().map(|t| t + shift).collect(),
            ..truth.clone()
        };
        let turn = Rotation3::new(random.vector().normalize() * 0.05f64.to_radians());
        let of_target = set.points[row].target;
        let mut first = None;
        for (i, p) in set.points.iter_mut().enumerate().skip(row) {
            match slip {
                Slip::Target if p.target == of_target => {
                    p.position_mm +=
                        moved.position(&p.q_rad, p.target) - truth.position(&p.q_rad, p.target);
                    first = first.or(Some(i));
                }
                Slip::Base => {
                    p.position_mm = turn * p.position_mm + shift;
                    first = first.or(Some(i));
                }
                _ => {}
            }
        }
        let report = calibrate(&CalibrationRequest::new(nominal, set), &mut |_| {
            ControlFlow::Continue(())
        })
        .unwrap();
        let code = if slip == Slip::Base {
            "base_moved"
        } else {
            "target_moved"
        };
        let steps: Vec<_> = report
            .warnings
            .iter()
            .filter(|w| w.code.ends_with("_moved"))
            .collect();
        counts.alarms += usize::from(!steps.is_empty());
        let near = steps.iter().any(|w| {
            w.code == code && first.is_some_and(|f| w.rows[0].abs_diff(f) <= campaign.n_targets)
        });
        counts.found += usize::from(steps.iter().any(|w| w.code == code));
        counts.near += usize::from(near);
        counts.ends_missed += usize::from(!near && (row < 3 || row + 3 > n_rows));
        counts.ratio += report.identify.after.rms_mm / n as f64;
    }
    counts
}

/// The table.
pub fn table(n: u64) {
    println!(
        "## Things that move while they are measured\n\n{n} simulated campaigns per row without a slip, {} with; a slip of 2 mm (and 0.05° of the base) before a random row, the ends included.\n",
        n / 4
    );
    println!(
        "| campaign | slip | any alarm | found | found within one row (of its target) | missed within two rows of an end | rms after, mm |"
    );
    println!("|---|---|---|---|---|---|---|");
    let plain = Campaign {
        n_configurations: 60,
        noise_mm: 0.1,
        ..Campaign::PLAIN
    };
    let sag = Campaign {
        sag_rad: 2e-4,
        ..plain
    };
    let three = Campaign {
        n_configurations: 20,
        n_targets: 3,
        ..plain
    };
    let shared = Campaign {
        shared_mm: 0.1,
        ..three
    };
    let rows = [
        ("60 poses, noise 0.1 mm", plain, Slip::Nothing, false),
        (
            "60 poses, noise 0.1 mm, sag 0.4 mm",
            sag,
            Slip::Nothing,
            false,
        ),
        (
            "60 poses ordered by joint 1, noise 0.1 mm, sag 0.4 mm",
            sag,
            Slip::Nothing,
            true,
        ),
        (
            "60 poses ordered by joint 1, noise 0.1 mm, sag 1 mm",
            Campaign {
                sag_rad: 5e-4,
                ..sag
            },
            Slip::Nothing,
            true,
        ),
        (
            "20 configurations of 3 targets",
            three,
            Slip::Nothing,
            false,
        ),
        (
            "20 configurations of 3 targets, 0.1 mm shared",
            shared,
            Slip::Nothing,
            false,
        ),
        ("60 poses, noise 0.1 mm", plain, Slip::Target, false),
        (
            "60 poses, noise 0.3 mm",
            Campaign {
                noise_mm: 0.3,
                ..plain
            },
            Slip::Target,
            false,
        ),
        (
            "60 poses, noise 0.1 mm, sag 0.4 mm",
            sag,
            Slip::Target,
            false,
        ),
        ("20 configurations of 3 targets", three, Slip::Target, false),
        ("60 poses, noise 0.1 mm", plain, Slip::Base, false),
        ("60 poses, noise 0.1 mm, sag 0.4 mm", sag, Slip::Base, false),
    ];
    for (name, campaign, slip, is_ordered) in rows {
        let n = if slip == Slip::Nothing { n } else { n / 4 };
        let c = run(n, campaign, slip, is_ordered);
        let what = match slip {
            Slip::Nothing => "none",
            Slip::Target => "target",
            Slip::Base => "base",
        };
        println!(
            "| {name} | {what} | {} | {} | {} | {} | {:.3} |",
            c.alarms, c.found, c.near, c.ends_missed, c.ratio
        );
    }
    println!();
}
