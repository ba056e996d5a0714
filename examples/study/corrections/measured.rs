//! Measured robots.

use super::{kept, run};
use crate::data::real_data;
use crate::measured_robots::{robots, set, with_split};
use kincal::calibration::CalibrationRequest;
use kincal::calibration::request::VerifySource;
use kincal::measurement::{MeasurementSet, Point, Subset, split};

const SEEDS: u64 = 8;

fn row(name: &str, split: &str, request: &CalibrationRequest) -> (f64, f64) {
    let report = run(request);
    let verify = report.verify.unwrap();
    let corrected = verify.corrected.unwrap().rms_mm;
    println!(
        "| {name} | {split} | {:.3} | {:.4} | {corrected:.4} | {} |",
        verify.before.rms_mm,
        verify.after.rms_mm,
        kept(&report)
    );
    if std::env::var("DETAILS").is_ok() {
        for e in report.corrections.iter().flatten() {
            println!(
                "    {} {} {:.4} {:.4} gain {:.5} se {:.5}",
                e.kind,
                e.kept,
                e.cross_validated_rms_mm_before,
                e.cross_validated_rms_mm_after,
                e.gain_mm2,
                e.standard_error_mm2
            );
        }
    }
    (verify.after.rms_mm, corrected)
}

pub fn tables() {
    let Some(root) = real_data() else { return };
    println!("## Measured robots: unseen configurations\n");
    println!(
        "| set | split | nominal, mm rms | links | with corrections | kept |\n|---|---|---|---|---|---|"
    );
    for (name, robot, set) in robots(&root) {
        row(
            name,
            "column",
            &CalibrationRequest::new(robot.clone(), set.clone()),
        );
        let (mut links, mut corrected) = (0.0, 0.0);
        for seed in 0..SEEDS {
            let subsets = split::by_fraction(&set, 0.5, seed);
            let found = row(
                name,
                &seed.to_string(),
                &CalibrationRequest::new(robot.clone(), with_split(&set, |row, _| subsets[row])),
            );
            (links, corrected) = (
                links + found.0 / SEEDS as f64,
                corrected + found.1 / SEEDS as f64,
            );
        }
        println!("| {name} | mean of seeds 0 to 7 | | {links:.4} | {corrected:.4} | |");
    }
    println!(
        "\n## One visit identified, the other verified (motoman_ma1400; base and target placed anew)\n"
    );
    println!(
        "| set | identified, verified | nominal, mm rms | links | with corrections | kept |\n|---|---|---|---|---|---|"
    );
    let folder = root.join("motoman_ma1400");
    let (_, motoman, both) = robots(&root)
        .into_iter()
        .find(|(name, ..)| *name == "motoman_ma1400")
        .expect("a measured robot");
    for (first, second) in [("visit_1", "visit_2"), ("visit_2", "visit_1")] {
        let mut request =
            CalibrationRequest::new(motoman.clone(), set(&folder.join(format!("{first}.csv"))));
        request.verify = VerifySource::Set(set(&folder.join(format!("{second}.csv"))));
        row("motoman_ma1400", &format!("{first}, {second}"), &request);
    }
    println!(
        "\n## Half of the configurations of one visit identified, the other half verified in the other visit (motoman_ma1400)\n"
    );
    println!(
        "| set | identified, verified, seed | nominal, mm rms | links | with corrections | kept |\n|---|---|---|---|---|---|"
    );
    for (first, second) in [("visit_1", "visit_2"), ("visit_2", "visit_1")] {
        let [identified, verified] =
            [first, second].map(|visit| set(&folder.join(format!("{visit}.csv"))));
        let (mut links, mut corrected) = (0.0, 0.0);
        for seed in 0..SEEDS {
            let subsets = split::by_fraction(&identified, 0.5, seed);
            let all = identified.points.iter().zip(&subsets);
            let (half, others): (Vec<_>, Vec<_>) =
                all.partition(|(_, subset)| **subset == Subset::Identify);
            let seen: Vec<&str> = half.iter().map(|(p, _)| p.configuration.as_str()).collect();
            assert!(!others.is_empty());
            let mut request = CalibrationRequest::new(
                motoman.clone(),
                MeasurementSet::new(
                    identified.frame,
                    half.iter().map(|(p, _)| (*p).clone()).collect(),
                ),
            );
            let unseen = verified.points.iter();
            let unseen = unseen.filter(|p| !seen.contains(&p.configuration.as_str()));
            request.verify = VerifySource::Set(MeasurementSet::new(
                verified.frame,
                unseen.cloned().collect(),
            ));
            let found = row(
                "motoman_ma1400",
                &format!("{first}, {second}, {seed}"),
                &request,
            );
            (links, corrected) = (
                links + found.0 / SEEDS as f64,
                corrected + found.1 / SEEDS as f64,
            );
        }
        println!("| motoman_ma1400 | {first}, {second}, mean | | {links:.4} | {corrected:.4} | |");
    }
    println!("\n## One of three surfaces left out (motoman_ma1400, both visits)\n");
    println!(
        "| set | surface left out | nominal, mm rms | links | with corrections | kept |\n|---|---|---|---|---|---|"
    );
    for left_out in 0..3 {
        let surface = |p: &Point| p.configuration.parse::<u32>().unwrap_or(0) / 1000;
        let set = with_split(&both, |_, p| {
            if surface(p) == left_out {
                Subset::Verify
            } else {
                Subset::Identify
            }
        });
        row(
            "motoman_ma1400",
            &left_out.to_string(),
            &CalibrationRequest::new(motoman.clone(), set),
        );
    }
    println!();
}
