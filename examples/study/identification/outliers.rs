//! Outliers: is the fit as good as without them, and are they named?

use crate::bad_campaigns::clean_verify_rms_mm;
use crate::data::paper_robot;
use crate::simulation::{Campaign, Normal, limited, measure, poses, true_robot};
use kincal::calibration::request::Loss;
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use kincal::measurement::{MeasurementSet, Subset};
use rand::RngExt;
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// Displaces a share of the points by 5 to 20 mm in any direction; their rows.
pub fn displace(set: &mut MeasurementSet, share: f64, random: &mut Normal) -> BTreeSet<usize> {
    let n = (share * set.points.len() as f64).round() as usize;
    let mut rows = BTreeSet::new();
    while rows.len() < n {
        rows.insert(random.0.random_range(0..set.points.len()));
    }
    for row in &rows {
        set.points[*row].position_mm +=
            random.vector().normalize() * random.0.random_range(5.0..20.0);
    }
    rows
}

struct Counts {
    within: usize,
    worst: f64,
    mean: f64,
    named: usize,
    displaced: usize,
    false_names: usize,
    reviews: usize,
}

fn run(
    n_robots: u64,
    campaign: Campaign,
    share: f64,
    loss: Option<Loss>,
    method: Method,
) -> Counts {
    let mut counts = Counts {
        within: 0,
        worst: 0.0,
        mean: 0.0,
        named: 0,
        displaced: 0,
        false_names: 0,
        reviews: 0,
    };
    for seed in 0..n_robots {
        let nominal = limited(paper_robot());
        let mut random = Normal::new(seed);
        let truth = true_robot(&nominal, campaign.n_targets, &mut random);
        let mut set = measure(
            &truth,
            &poses(campaign.n_configurations, &mut random),
            &campaign,
            &mut random,
        );
        set.points.iter_mut().enumerate().for_each(|(i, p)| {
            let configuration = i / campaign.n_targets;
            p.subset = Some(if configuration.is_multiple_of(2) {
                Subset::Identify
            } else {
                Subset::Verify
            });
        });
        let clean = set.clone();
        let rows = displace(&mut set, share, &mut random);
        let mut request = CalibrationRequest {
            method,
            ..CalibrationRequest::new(nominal, set)
        };
        request.options.loss = loss;
        let Ok(report) = calibrate(&request, &mut |_| ControlFlow::Continue(())) else {
            continue;
        };
        // the fit without them: the same set, those points not there
        let mut without = CalibrationRequest {
            set: clean,
            ..request.clone()
        };
        let mut row = 0;
        without.set.points.retain(|_| {
            row += 1;
            !rows.contains(&(row - 1))
        });
        without.options.loss = Some(Loss::Squares);
        let Ok(reference) = calibrate(&without, &mut |_| ControlFlow::Continue(())) else {
            continue;
        };
        let ratio =
            clean_verify_rms_mm(&report, &rows) / clean_verify_rms_mm(&reference, &BTreeSet::new());
        counts.within += usize::from(ratio <= 1.1);
        counts.worst = counts.worst.max(ratio);
        counts.mean += ratio / n_robots as f64;
        let named: BTreeSet<usize> = report
            .warnings
            .iter()
            .filter(|w| w.code.starts_with("outliers"))
            .flat_map(|w| w.rows.clone())
            .collect();
        counts.reviews += usize::from(report.warnings.iter().any(|w| w.code == "outliers_review"));
        counts.displaced += rows.len();
        counts.named += rows.intersection(&named).count();
        counts.false_names += named.difference(&rows).count();
    }
    counts
}

/// The table.
pub fn table(n_robots: u64) {
    println!(
        "## Outliers\n\n{n_robots} simulated robots per row; half of the configurations to identify, half to verify; points displaced by 5 to 20 mm in"
    );
    println!(
        "any direction, on both sides. The ratio is the rms on the clean points to verify over that of least squares without the displaced points.\n"
    );
    println!(
        "| campaign | displaced | loss | within 10 % | mean ratio | largest | displaced points named | others named | for review |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let plain = Campaign {
        n_configurations: 100,
        noise_mm: 0.1,
        ..Campaign::PLAIN
    };
    let three = Campaign {
        n_configurations: 40,
        n_targets: 3,
        ..plain
    };
    let sag = Campaign {
        sag_rad: 2e-4,
        ..plain
    };
    let small = Campaign {
        n_configurations: 60,
        ..plain
    };
    let few = Campaign {
        n_configurations: 40,
        ..plain
    };
    let ours = "ours";
    let rows = [
        ("100 poses, noise 0.1 mm", plain, 0.0, None, ours),
        ("100 poses, noise 0.1 mm", plain, 0.05, None, ours),
        ("100 poses, noise 0.1 mm, sag 0.4 mm", sag, 0.05, None, ours),
        (
            "40 configurations of 3 targets, noise 0.1 mm",
            three,
            0.05,
            None,
            ours,
        ),
        ("60 poses, noise 0.1 mm", small, 0.05, None, ours),
        ("40 poses, noise 0.1 mm", few, 0.05, None, ours),
        ("100 poses, noise 0.1 mm", plain, 0.15, None, ours),
        (
            "100 poses, noise 0.1 mm",
            plain,
            0.05,
            Some(Loss::Squares),
            "squares",
        ),
        (
            "100 poses, noise 0.1 mm",
            plain,
            0.05,
            Some(Loss::Huber),
            "huber",
        ),
        (
            "100 poses, noise 0.1 mm",
            plain,
            0.05,
            Some(Loss::Tukey),
            "tukey",
        ),
    ];
    for (name, campaign, share, loss, loss_name) in rows {
        let c = run(n_robots, campaign, share, loss, Method::Auto);
        println!(
            "| {name} | {:.0} % | {loss_name} | {} of {n_robots} | {:.3} | {:.3} | {} of {} | {} | {} |",
            100.0 * share,
            c.within,
            c.mean,
            c.worst,
            c.named,
            c.displaced,
            c.false_names,
            c.reviews
        );
    }
    println!();
}
