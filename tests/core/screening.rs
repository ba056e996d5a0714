//! Faults in a cell: outliers, reflectors that slip, instruments that are set up again. Simulated robots with planted faults; the
//! oracle is the truth, or the same fit to the same set without the fault. The long form is `examples/study/identification.rs`.

use crate::bad_campaigns::{bad_campaign, clean_verify_rms_mm, unseen_rms_mm};
use crate::data::paper_robot;
use crate::simulation::{
    Campaign, Normal, found, limited, links_alone, measure, poses, true_robot,
};
use kincal::calibration::point_errors::counted_errors_mm;
use kincal::calibration::report::Warning;
use kincal::calibration::request::Loss;
use kincal::calibration::{
    CalibrationReport, CalibrationRequest, Error, Method, Model, calibrate, check,
    robust_comparison,
};
use kincal::identification::KinematicModel;
use kincal::kinematics::Robot;
use kincal::measurement::{Frame, MeasurementSet, Subset};
use nalgebra::{IsometryMatrix3, Point3, Rotation3, Translation3, Vector3};
use rand::RngExt;
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// A simulated set: half of 60 poses to identify, noise of 0.1 mm.
const CAMPAIGN: Campaign = Campaign {
    n_configurations: 60,
    noise_mm: 0.1,
    ..Campaign::PLAIN
};
/// Factor by which the verify rms on clean points may be larger than without outliers.
const AS_GOOD_AS_WITHOUT: f64 = 1.1;

fn run(request: &CalibrationRequest) -> CalibrationReport {
    run_whole(&links_alone(request))
}

fn run_whole(request: &CalibrationRequest) -> CalibrationReport {
    calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn campaign(seed: u64, campaign: Campaign) -> (Robot, KinematicModel, MeasurementSet, Normal) {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(seed);
    let truth = true_robot(&nominal, campaign.n_targets, &mut random);
    let mut set = measure(
        &truth,
        &poses(campaign.n_configurations, &mut random),
        &campaign,
        &mut random,
    );
    for (row, p) in set.points.iter_mut().enumerate() {
        p.subset = Some(if (row / campaign.n_targets).is_multiple_of(2) {
            Subset::Identify
        } else {
            Subset::Verify
        });
    }
    (nominal, truth, set, random)
}

fn displaced(
    set: &MeasurementSet,
    n: usize,
    random: &mut Normal,
) -> (MeasurementSet, BTreeSet<usize>) {
    let (mut set, mut rows) = (set.clone(), BTreeSet::new());
    while rows.len() < n {
        rows.insert(random.0.random_range(0..set.points.len()));
    }
    for row in &rows {
        set.points[*row].position_mm +=
            random.vector().normalize() * random.0.random_range(5.0..20.0);
    }
    (set, rows)
}

fn without(set: &MeasurementSet, rows: &BTreeSet<usize>) -> MeasurementSet {
    let points = set
        .points
        .iter()
        .enumerate()
        .filter(|(row, _)| !rows.contains(row))
        .map(|(_, p)| p.clone());
    MeasurementSet::new(set.frame, points.collect())
}

fn warning<'a>(report: &'a CalibrationReport, code: &str) -> Option<&'a Warning> {
    report.warnings.iter().find(|w| w.code == code)
}

#[test]
fn with_a_twentieth_of_the_points_wild_the_fit_is_as_good_as_without_them_and_names_them() {
    for seed in 0..8 {
        let (robot, _, set, mut random) = campaign(seed, CAMPAIGN);
        let (faulty, rows) = displaced(&set, 3, &mut random);
        let reference = clean_verify_rms_mm(
            &run(&CalibrationRequest::new(
                robot.clone(),
                without(&set, &rows),
            )),
            &BTreeSet::new(),
        );
        for loss in [None, Some(Loss::Tukey)] {
            let mut request = CalibrationRequest::new(robot.clone(), faulty.clone());
            request.options.loss = loss;
            let report = run(&request);
            let rms = clean_verify_rms_mm(&report, &rows);
            assert!(
                rms <= AS_GOOD_AS_WITHOUT * reference,
                "robot {seed}, {loss:?}: {rms} against {reference}"
            );
            let named: BTreeSet<usize> = warning(&report, "outliers")
                .unwrap()
                .rows
                .iter()
                .copied()
                .collect();
            assert_eq!(named, rows, "robot {seed}, {loss:?}");
            // All of them stay in the statistics.
            assert_eq!(
                report.identify.n_points + report.verify.unwrap().n_points,
                60
            );
        }
        let mut squares = CalibrationRequest::new(robot, faulty);
        squares.options.loss = Some(Loss::Squares);
        let report = run(&squares);
        let is_fitted = |row: &usize| report.per_point[*row].subset == Subset::Identify;
        let pulled = clean_verify_rms_mm(&report, &rows) / reference;
        println!("robot {seed}: with squares alone {pulled:.2} times as far off");
        assert!(
            pulled > 1.5 || !rows.iter().any(is_fitted),
            "squares alone are pulled away, or the fault is none: {pulled}"
        );
    }
}

#[test]
fn with_hubers_loss_swarm_and_least_squares_are_as_good_as_without_the_wild_points() {
    let (robot, _, set, mut random) = campaign(
        3,
        Campaign {
            n_configurations: 100,
            ..CAMPAIGN
        },
    );
    let (faulty, rows) = displaced(&set, 5, &mut random);
    let reference = clean_verify_rms_mm(
        &run(&CalibrationRequest::new(
            robot.clone(),
            without(&set, &rows),
        )),
        &BTreeSet::new(),
    );
    for method in [Method::LeastSquares, Method::Pso] {
        let mut request = CalibrationRequest {
            method,
            refine: Some(false),
            ..CalibrationRequest::new(robot.clone(), faulty.clone())
        };
        request.options.loss = Some(Loss::Huber);
        let report = run(&request);
        let rms = clean_verify_rms_mm(&report, &rows);
        assert!(
            rms <= AS_GOOD_AS_WITHOUT * reference,
            "{method:?}: {rms} against {reference}"
        );
        // The swarm's curve ends with the cost of the report, and the kernel's equals the readable one; that of least squares has what the
        // priors add, 12 combinations' squares beside 150 rows'.
        let (last, stated) = (*report.convergence_mm2.last().unwrap(), report.cost_mm2);
        let added = match method {
            Method::LeastSquares => 0.1,
            _ => 1e-9,
        };
        assert!(
            (-1e-9..added).contains(&(last / stated - 1.0)),
            "{method:?}: {last} {stated}"
        );
    }
}

/// The oracle is the file as somebody would prepare it who knew what went wrong.
#[test]
fn gross_rows_swapped_labels_and_a_slip_cost_nothing() {
    for seed in 0..16 {
        let made = bad_campaign(seed);
        let report = run_whole(&CalibrationRequest::new(
            made.robot.clone(),
            made.set.clone(),
        ));
        let reference = run(&CalibrationRequest::new(made.robot, made.prepared));
        let named = report.warnings.iter();
        let named = named.filter(|w| w.code.starts_with("outliers"));
        let named: BTreeSet<usize> = named.flat_map(|w| w.rows.clone()).collect();
        assert_eq!(named, made.bad, "campaign {seed}");
        let has_moved = warning(&report, "target_moved").is_some();
        assert_eq!(has_moved, made.has_slipped, "campaign {seed}");
        let ratio = unseen_rms_mm(&report, &made.truth) / unseen_rms_mm(&reference, &made.truth);
        assert!(ratio < AS_GOOD_AS_WITHOUT, "campaign {seed}: {ratio}");
        let (all, without) = (
            report.verify.unwrap(),
            report.verify_without_outliers.unwrap(),
        );
        assert!(all.after.max_mm > 20.0 && without.after.max_mm < 0.5);
        // what is decided on these points is decided without the outliers
        assert!(warning(&report, "no_better_than_nominal").is_none());
        let decided = robust_comparison(&counted_errors_mm(&report.per_point));
        assert!(decided.after_rms_mm < 0.2, "campaign {seed}: {decided:?}");
    }
}

/// Four reflectors, knocked by 15 mm before the last two configurations: no gross errors, though each reflector has two such rows only.
#[test]
fn reflectors_that_were_knocked_near_the_end_are_no_gross_errors() {
    let shape = Campaign {
        n_configurations: 40,
        n_targets: 4,
        ..CAMPAIGN
    };
    for seed in 950..954 {
        let (robot, truth, mut set, mut random) = campaign(seed, shape);
        let mut knocked = truth.clone();
        for target in &mut knocked.targets_mm {
            *target += random.vector().normalize() * 15.0;
        }
        for p in &mut set.points[4 * 38..] {
            p.position_mm +=
                knocked.position(&p.q_rad, p.target) - truth.position(&p.q_rad, p.target);
        }
        let report = run(&CalibrationRequest::new(robot, set));
        let codes: Vec<&str> = report.warnings.iter().map(|w| w.code).collect();
        println!("robot {seed}: {codes:?}");
        assert!(codes.contains(&"target_moved"), "robot {seed}: {codes:?}");
    }
}

#[test]
fn more_outliers_than_a_twentieth_are_for_review_and_more_than_a_tenth_are_not_left_out() {
    let (robot, _, set, mut random) = campaign(5, CAMPAIGN);
    for (n_displaced, consequence) in [(6, "count nothing"), (8, "none was left out")] {
        let (faulty, rows) = displaced(&set, n_displaced, &mut random);
        let report = run(&CalibrationRequest::new(robot.clone(), faulty));
        let review = warning(&report, "outliers_review").unwrap();
        assert_eq!(review.rows.iter().copied().collect::<BTreeSet<_>>(), rows);
        assert!(review.detail.contains(consequence), "{}", review.detail);
        assert!(warning(&report, "outliers").is_none());
        let (all, without) = (
            report.verify.unwrap(),
            report.verify_without_outliers.unwrap(),
        );
        let n_named = report.warnings.iter().flat_map(|w| &w.rows);
        let n_named = n_named.filter(|row| !row.is_multiple_of(2)).count();
        assert_eq!(all.n_points - without.n_points, n_named);
        assert!(all.after.rms_mm > 1.0 && all.after.max_mm > without.after.max_mm);
    }
}

#[test]
fn clean_campaigns_raise_no_alarm() {
    for seed in 20..28 {
        let sag = Campaign {
            sag_rad: 2e-4,
            ..CAMPAIGN
        };
        for campaign_of in [
            CAMPAIGN,
            sag,
            Campaign {
                n_configurations: 20,
                n_targets: 3,
                ..CAMPAIGN
            },
        ] {
            let (robot, _, set, _) = campaign(seed, campaign_of);
            let report = run(&CalibrationRequest::new(robot, set));
            let raised: Vec<&str> = report
                .warnings
                .iter()
                .map(|w| w.code)
                .filter(|c| c.ends_with("_moved") || c.starts_with("outliers"))
                .collect();
            assert!(
                raised.is_empty(),
                "robot {seed}, {campaign_of:?}: {raised:?}"
            );
        }
    }
}

#[test]
fn a_slipped_reflector_is_found_at_its_row_and_fitted_as_two() {
    for (seed, row) in [(40, 2), (41, 17), (42, 30), (43, 44), (44, 57)] {
        let (robot, truth, mut set, mut random) = campaign(seed, CAMPAIGN);
        let slip = random.vector().normalize() * 2.0;
        let clean = run(&CalibrationRequest::new(robot.clone(), set.clone()))
            .verify
            .unwrap()
            .after
            .rms_mm;
        let mut slipped = truth.clone();
        slipped.targets_mm[0] += slip;
        for p in &mut set.points[row..] {
            p.position_mm += slipped.position(&p.q_rad, 0) - truth.position(&p.q_rad, 0);
        }
        let report = run(&CalibrationRequest::new(robot, set));
        let moved = warning(&report, "target_moved").unwrap();
        assert!(
            moved.rows.len() == 1 && moved.rows[0].abs_diff(row) <= 1,
            "{} for {row}",
            moved.rows[0]
        );
        assert!(
            moved.detail.contains("2.") || moved.detail.contains("1.9"),
            "its size: {}",
            moved.detail
        );
        // As good as without a slip, except for the cost of three more parameters.
        let rms = report.verify.unwrap().after.rms_mm;
        assert!(rms < 1.25 * clean, "row {row}: {rms} against {clean}");
        // The target's current position comes first, then the earlier one.
        assert_eq!(report.target_segments, [(0, 1), (0, 0)]);
        if (17..=44).contains(&row) {
            let fitted = report.targets_mm[0] - report.targets_mm[1];
            assert!((fitted - slip).norm() < 0.2, "{fitted} for {slip}");
        }
    }
}

/// The tool is knocked between two configurations, so that both reflectors move at once, each by its own vector. In the middle of the file, either
/// reflector alone would explain little of it.
#[test]
fn reflectors_that_were_knocked_at_once_are_found_wherever_in_the_file() {
    let shape = Campaign {
        n_configurations: 60,
        n_targets: 2,
        noise_mm: 0.04,
        ..Campaign::PLAIN
    };
    for (seed, first) in [8, 18, 24, 27, 30, 33, 36, 42, 52].into_iter().enumerate() {
        for size_mm in [0.5, 1.0, 3.0] {
            let (robot, truth, mut set, mut random) = campaign(300 + seed as u64, shape);
            let mut knocked = truth.clone();
            for target in &mut knocked.targets_mm {
                *target += random.vector().normalize() * size_mm;
            }
            for (row, p) in set.points.iter_mut().enumerate() {
                // without a column the job divides the points itself
                p.subset = None;
                if row >= 2 * first {
                    p.position_mm +=
                        knocked.position(&p.q_rad, p.target) - truth.position(&p.q_rad, p.target);
                }
            }
            let report = run(&CalibrationRequest::new(robot, set));
            let told: Vec<&Warning> = report
                .warnings
                .iter()
                .filter(|w| w.code == "target_moved")
                .collect();
            let rms_mm = report.verify.unwrap().after.rms_mm;
            println!(
                "knocked by {size_mm} mm before configuration {first}: {} told, verify rms {rms_mm:.3} mm",
                told.len()
            );
            assert_eq!(told.len(), 2, "{first} {size_mm}: {:?}", report.warnings);
            let rows: Vec<usize> = told.iter().map(|w| w.rows[0]).collect();
            assert!(
                rows.iter().all(|row| row.abs_diff(2 * first) <= 3),
                "{rows:?}: {told:?}"
            );
            assert!(rms_mm < 0.15, "{first} {size_mm}: {rms_mm}");
        }
    }
}

#[test]
fn wild_points_do_not_hide_the_slip_of_one_reflector_of_several() {
    let of = |n_configurations, n_targets| Campaign {
        n_configurations,
        n_targets,
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    for (seed, shape, slipped_target, first, size_mm, outliers) in [
        (60, of(50, 2), 1, 28, 2.0, &[7][..]),
        (61, of(50, 2), 1, 28, 2.0, &[7, 40, 88]),
        (62, of(50, 2), 0, 20, 2.0, &[7]),
        (63, of(50, 2), 0, 40, 2.0, &[70]),
        (64, of(50, 2), 1, 10, 1.0, &[31]),
        (65, of(34, 3), 2, 17, 2.0, &[7, 41]),
    ] {
        let (robot, truth, mut set, mut random) = campaign(seed, shape);
        let clean = run(&CalibrationRequest::new(robot.clone(), set.clone()))
            .verify
            .unwrap()
            .after
            .rms_mm;
        let slip = random.vector().normalize() * size_mm;
        let mut slipped = truth.clone();
        slipped.targets_mm[slipped_target] += slip;
        let row = shape.n_targets * first + slipped_target;
        for p in set.points[row..]
            .iter_mut()
            .filter(|p| p.target == slipped_target)
        {
            p.position_mm += slipped.position(&p.q_rad, slipped_target)
                - truth.position(&p.q_rad, slipped_target);
        }
        for outliers in outliers {
            set.points[*outliers].position_mm += random.vector().normalize() * 9.0;
        }
        let report = run(&CalibrationRequest::new(robot, set));
        let codes: Vec<&str> = report.warnings.iter().map(|w| w.code).collect();
        let moved =
            warning(&report, "target_moved").unwrap_or_else(|| panic!("robot {seed}: {codes:?}"));
        let within = moved.rows[0].abs_diff(row) <= shape.n_targets;
        assert!(
            within && report.target_segments.contains(&(slipped_target, 1)),
            "robot {seed}: {:?} for {row}",
            moved.rows
        );
        let outliers: BTreeSet<usize> = outliers.iter().copied().collect();
        let named =
            warning(&report, "outliers").unwrap_or_else(|| panic!("robot {seed}: {codes:?}"));
        assert_eq!(
            named.rows.iter().copied().collect::<BTreeSet<_>>(),
            outliers,
            "robot {seed}"
        );
        let rms = clean_verify_rms_mm(&report, &outliers);
        assert!(rms < 1.25 * clean, "robot {seed}: {rms} against {clean}");
    }
}

#[test]
fn a_session_that_ends_badly_is_not_said_to_have_moved() {
    let of = Campaign {
        n_configurations: 50,
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    let mut worst = 0.0f64;
    for (seed, n_bad) in
        (0..12).flat_map(|seed| [(700 + seed, 2), (800 + seed, 3), (900 + seed, 5)])
    {
        let (robot, truth, mut set, mut random) = campaign(seed, of);
        // The last rows are outliers, or have the joint values of their neighbours.
        let first = set.points.len() - n_bad;
        if seed % 2 == 0 {
            set.points[first..].iter_mut().for_each(|p| {
                p.position_mm += random.vector().normalize() * random.0.random_range(5.0..20.0)
            });
        } else {
            let positions: Vec<Vector3<f64>> =
                set.points[first..].iter().map(|p| p.position_mm).collect();
            set.points[first..]
                .iter_mut()
                .zip(positions.iter().cycle().skip(1))
                .for_each(|(p, position)| p.position_mm = *position);
        }
        let report = run(&CalibrationRequest::new(robot, set));
        let codes: Vec<&str> = report.warnings.iter().map(|w| w.code).collect();
        assert!(
            warning(&report, "base_moved").is_none() && warning(&report, "target_moved").is_none(),
            "robot {seed}, {n_bad} rows: {codes:?}"
        );
        assert!(
            codes.iter().any(|code| code.starts_with("outliers")),
            "robot {seed}, {n_bad} rows: {codes:?}"
        );
        // a row that is off by metres hides no other
        let named = warning(&report, "outliers").map(|w| w.rows.clone());
        let bad: Vec<usize> = (first..first + n_bad).collect();
        assert!(n_bad == 5 || named == Some(bad), "robot {seed}: {named:?}");
        assert!(
            !codes.contains(&"no_fit") || n_bad == 5,
            "robot {seed}, {n_bad} rows: {codes:?}"
        );
        // The robot's last target in its own base: distances do not depend on the placement of base and instrument.
        let found = KinematicModel {
            t_instrument_base: report.t_instrument_base,
            links: report.links.clone(),
            targets_mm: report.targets_mm.clone(),
            target_rotations: vec![],
        };
        for q in poses(20, &mut random) {
            let off = (found.position(&q, 0) - truth.position(&q, 0)).norm();
            // With a tenth of the rows metres off, Huber's loss fails; the result is then reported as no fit, and cannot be released.
            let off = if codes.contains(&"no_fit") { 0.0 } else { off };
            worst = worst.max(off);
        }
    }
    println!("worst of all at unseen poses: {worst:.3} mm");
    assert!(worst < 1.0, "{worst}");
}

#[test]
fn a_wild_point_in_the_slipped_segment_does_not_hide_the_slip() {
    let of = Campaign {
        n_configurations: 80,
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    for seed in 0..8 {
        let (robot, truth, mut set, mut random) = campaign(1100 + seed, of);
        let row = random.0.random_range(45..65);
        let mut slipped = truth.clone();
        slipped.targets_mm[0] += random.vector().normalize() * 2.0;
        for p in &mut set.points[row..] {
            p.position_mm += slipped.position(&p.q_rad, 0) - truth.position(&p.q_rad, 0);
        }
        for outliers in [10, random.0.random_range(row + 2..79)] {
            set.points[outliers].position_mm +=
                random.vector().normalize() * random.0.random_range(5.0..20.0);
        }
        let report = run(&CalibrationRequest::new(robot, set));
        let codes: Vec<&str> = report.warnings.iter().map(|w| w.code).collect();
        let moved =
            warning(&report, "target_moved").unwrap_or_else(|| panic!("robot {seed}: {codes:?}"));
        assert!(
            moved.rows[0].abs_diff(row) <= 1,
            "robot {seed}: {:?} for {row}",
            moved.rows
        );
    }
}

#[test]
fn a_target_off_the_flange_axis_is_not_said_to_have_moved_in_the_papers_model() {
    for seed in 0..3 {
        let (robot, mut truth, mut set, mut random) = campaign(70 + seed, CAMPAIGN);
        truth.t_instrument_base = nalgebra::IsometryMatrix3::identity();
        truth.targets_mm[0] = Vector3::new(80.0, -60.0, 120.0);
        for p in &mut set.points {
            p.position_mm = truth.position(&p.q_rad, 0) + random.vector() * 0.05;
        }
        set.frame = kincal::measurement::Frame::Base;
        let report = run(&CalibrationRequest {
            model: Some(Model::Paper),
            ..CalibrationRequest::new(robot, set)
        });
        let codes: Vec<&str> = report.warnings.iter().map(|w| w.code).collect();
        assert!(
            warning(&report, "target_moved").is_none(),
            "robot {seed}: {codes:?}"
        );
        let hint = warning(&report, "model_too_small")
            .unwrap_or_else(|| panic!("robot {seed}: {codes:?}"));
        let (_, place) = hint.detail.split_once("has it at ").unwrap();
        let x_mm: f64 = place.split(',').next().unwrap().parse().unwrap();
        assert!(
            hint.detail.contains("Choose model complete") && (x_mm - 80.0).abs() < 0.5,
            "{}",
            hint.detail
        );
    }
}

#[test]
fn a_base_that_is_not_where_it_is_said_to_be_is_told_in_the_papers_model_on_arms_of_any_size() {
    // each length a share of the arm's; 0.8 mm on an arm of 1.9 m
    for scale in [1.0, 0.1, 0.01] {
        let (mut robot, mut truth, mut set, mut random) = campaign(75, CAMPAIGN);
        for links in [&mut robot.links, &mut truth.links] {
            for link in links.iter_mut() {
                link.a_mm *= scale;
                link.d_mm *= scale;
            }
        }
        truth.t_instrument_base = nalgebra::IsometryMatrix3::from_parts(
            (Vector3::new(0.3, 0.4, -0.3) * scale).into(),
            nalgebra::Rotation3::new(Vector3::new(4e-4, -3e-4, 3e-4)),
        );
        truth.targets_mm[0] = Vector3::new(0.0, 0.0, 120.0) * scale;
        for p in &mut set.points {
            p.position_mm = truth.position(&p.q_rad, 0) + random.vector() * (0.02 * scale);
        }
        set.frame = kincal::measurement::Frame::Base;
        let with = |model| {
            run(&CalibrationRequest {
                model,
                ..CalibrationRequest::new(robot.clone(), set.clone())
            })
        };
        let (paper, default) = (with(Some(Model::Paper)), with(None));
        let rms = |report: &CalibrationReport| report.verify.unwrap().after.rms_mm / scale;
        println!(
            "scale {scale}: paper {:.4}, complete {:.4} mm of an arm of 1.9 m",
            rms(&paper),
            rms(&default)
        );
        assert_eq!(default.model, Model::Complete);
        assert!(warning(&default, "model_too_small").is_none());
        assert!(
            warning(&paper, "model_too_small").is_some() || rms(&paper) < 2.0 * rms(&default),
            "scale {scale}: {} against {}",
            rms(&paper),
            rms(&default)
        );
    }
}

#[test]
fn a_tripod_that_was_pushed_is_found_at_its_row() {
    for (seed, row) in [(50, 12), (51, 30), (52, 49)] {
        let (robot, _, mut set, mut random) = campaign(seed, CAMPAIGN);
        let clean = run(&CalibrationRequest::new(robot.clone(), set.clone()))
            .verify
            .unwrap()
            .after
            .rms_mm;
        let turn = Rotation3::new(random.vector().normalize() * 0.05f64.to_radians());
        let shift = random.vector().normalize() * 2.0;
        set.points[row..]
            .iter_mut()
            .for_each(|p| p.position_mm = turn * p.position_mm + shift);
        let report = run(&CalibrationRequest::new(robot, set));
        let moved = warning(&report, "base_moved").unwrap();
        assert!(
            moved.rows[0].abs_diff(row) <= 1,
            "{} for {row}",
            moved.rows[0]
        );
        let rms = report.verify.unwrap().after.rms_mm;
        assert!(rms < 1.25 * clean, "row {row}: {rms} against {clean}");
    }
}

#[test]
fn the_warning_says_for_which_rows_the_delivered_base_holds() {
    for (frame, holds_for_last) in [(Frame::Instrument, true), (Frame::Base, false)] {
        let (robot, mut truth, _, mut random) = campaign(55, CAMPAIGN);
        if frame == Frame::Base {
            truth.t_instrument_base = IsometryMatrix3::identity();
        }
        let q = poses(CAMPAIGN.n_configurations, &mut random);
        let mut set = measure(&truth, &q, &CAMPAIGN, &mut random);
        set.frame = frame;
        let turn = Rotation3::new(Vector3::new(3e-4, 5e-4, -6e-4));
        let push = IsometryMatrix3::from_parts(Translation3::new(1.0, -1.5, 0.8), turn);
        for p in &mut set.points[30..] {
            p.position_mm = (push * Point3::from(p.position_mm)).coords;
        }
        let report = run(&CalibrationRequest::new(robot, set));
        let moved = warning(&report, "base_moved").unwrap();
        let row = moved.rows[0];
        let rows = match holds_for_last {
            true => format!("that of the rows from row {row} on"),
            false => format!("that of the rows before row {row},"),
        };
        assert!(moved.detail.contains(&rows), "{}", moved.detail);
        let delivered = found(&report);
        let off_mm = |there: &IsometryMatrix3<f64>| -> f64 {
            let missed = q.iter().map(|q| {
                let p = there * Point3::from(truth.position(q, 0));
                (p.coords - delivered.position(q, 0)).norm()
            });
            missed.fold(0.0, f64::max)
        };
        let (first, last) = (off_mm(&IsometryMatrix3::identity()), off_mm(&push));
        println!("{frame:?}: {first:.3} mm off before the step, {last:.3} mm after it");
        let (own, other) = if holds_for_last {
            (last, first)
        } else {
            (first, last)
        };
        assert!(own < 0.5 && other > 1.0, "{own} {other}");
    }
}

#[test]
fn stations_are_carried_into_one_frame() {
    let (robot, _, mut set, _) = campaign(60, CAMPAIGN);
    let still = run(&CalibrationRequest::new(robot.clone(), set.clone()));
    let one = still.verify.unwrap().after.rms_mm;
    let turn = Rotation3::new(Vector3::new(0.3, -0.2, 2.0));
    for (row, p) in set.points.iter_mut().enumerate() {
        p.station = Some(if row < 35 { "door" } else { "window" }.into());
        if row < 35 {
            p.position_mm = turn * p.position_mm + Vector3::new(4000.0, -700.0, 90.0);
        }
    }
    let report = run(&CalibrationRequest::new(robot, set));
    assert!(
        report.warnings.iter().all(|w| !w.code.ends_with("_moved")),
        "{:?}",
        report.warnings
    );
    let rms = report.verify.unwrap().after.rms_mm;
    assert!(rms < 1.25 * one, "{rms} against {one}");
    let (base, as_last) = (
        report.t_instrument_base.translation.vector,
        still.t_instrument_base.translation.vector,
    );
    assert!(
        (base - as_last).norm() < 1.0,
        "as the last station sees it, which is where the instrument stood alone: {base:?}, {as_last:?}"
    );
}

#[test]
fn a_tenth_of_the_points_wild_by_up_to_a_metre_is_no_reason_to_look_for_another_robot() {
    for seed in 200..212 {
        let (robot, truth, mut set, mut random) = campaign(seed, CAMPAIGN);
        for point in set
            .points
            .iter_mut()
            .filter(|_| random.0.random::<f64>() < 0.1)
            .collect::<Vec<_>>()
        {
            point.position_mm += random.vector().normalize() * random.0.random_range(20.0..1000.0);
        }
        let report = run(&CalibrationRequest::new(robot, set));
        assert!(
            report.method_reason.contains("it converges"),
            "robot {seed}: {}",
            report.method_reason
        );
        for (i, (found, real)) in report.links.iter().zip(&truth.links).enumerate() {
            let off = (found.theta_offset_rad - real.theta_offset_rad).to_degrees();
            assert!(
                off.abs() < 45.0,
                "robot {seed}, joint {}: another branch, {off} degrees off",
                i + 1
            );
        }
    }
}

#[test]
fn a_set_that_rests_on_a_station_of_few_points_is_refused() {
    let (robot, _, set, _) = campaign(61, CAMPAIGN);
    for (frame, n_first, is_enough) in [
        (Frame::Instrument, 56, false),
        (Frame::Instrument, 30, true),
        (Frame::Base, 3, false),
        (Frame::Base, 30, true),
    ] {
        let mut set = set.clone();
        set.frame = frame;
        for (row, p) in set.points.iter_mut().enumerate() {
            p.station = Some(if row < n_first { "door" } else { "window" }.into());
        }
        let checked = check(&CalibrationRequest::new(robot.clone(), set));
        match is_enough {
            true => assert_eq!(checked, Ok(()), "{frame:?}"),
            false => assert!(
                matches!(&checked, Err(Error::Unusable { code: "under_determined", detail }) if detail.contains("station")),
                "{checked:?}"
            ),
        }
    }
}

#[test]
fn a_swarm_that_auto_may_choose_has_the_limit_of_a_swarm() {
    let (robot, _, set, _) = campaign(61, CAMPAIGN);
    let many = (0..30).flat_map(|_| set.points.clone()).collect();
    let mut request = CalibrationRequest::new(robot, MeasurementSet::new(set.frame, many));
    request.options.n_particles = Some(1_000_000);
    request.options.n_iterations = Some(500);
    request.method = Method::LeastSquares;
    assert_eq!(check(&request), Ok(()));
    request.method = Method::Auto;
    let refused = check(&request).unwrap_err();
    assert!(
        matches!(
            refused,
            Error::Unusable {
                code: "too_much_work",
                ..
            }
        ),
        "{refused:?}"
    );
}

#[test]
fn joints_that_were_never_mastered_are_found_with_no_guess_of_base_and_target() {
    for seed in 80..86 {
        let (robot, mut truth, mut set, mut random) = campaign(seed, CAMPAIGN);
        let clean = run(&CalibrationRequest::new(robot.clone(), set.clone()))
            .identify
            .after
            .rms_mm;
        // Up to 30 degrees, and for the last robots up to 120.
        let widest = if seed < 83 { 30.0f64 } else { 120.0 }.to_radians();
        for link in &mut truth.links {
            link.theta_offset_rad += widest * (2.0 * random.0.random::<f64>() - 1.0);
        }
        for p in &mut set.points {
            p.position_mm = truth.position(&p.q_rad, 0) + random.vector() * CAMPAIGN.noise_mm;
        }
        let report = run(&CalibrationRequest::new(robot, set));
        // Another draw of the same noise: with 90 residuals and 27 parameters the scatter is a tenth.
        assert!(
            report.identify.after.rms_mm < 1.5 * clean,
            "robot {seed}: {} against {clean}",
            report.identify.after.rms_mm
        );
        assert_eq!(report.method, Method::LeastSquares);
        assert!(
            report
                .method_reason
                .contains("least squares from nominal ended"),
            "{}",
            report.method_reason
        );
    }
}

/// Factor by which the verify rms of a single set may be larger with a loss that has 95 % of the efficiency of squares. A loss without a scale was off by
/// twelve times.
const AS_EFFICIENT: f64 = 1.25;

#[test]
fn a_robust_loss_fits_points_without_outliers_as_squares_do() {
    let (robot, _, set, _) = campaign(310, CAMPAIGN);
    let rms_mm = |loss| {
        let mut request = CalibrationRequest::new(robot.clone(), set.clone());
        request.options.loss = Some(loss);
        request.method = Method::LeastSquares;
        let report = run(&request);
        assert!(report.cost_mm2.is_finite(), "{loss:?}");
        report.verify.unwrap().after.rms_mm
    };
    let squares_mm = rms_mm(Loss::Squares);
    for loss in [Loss::Huber, Loss::Tukey] {
        let robust_mm = rms_mm(loss);
        assert!(
            robust_mm < AS_EFFICIENT * squares_mm,
            "{loss:?}: {robust_mm} against {squares_mm}"
        );
    }
}

/// Points that links alone miss by far, because joints 2 and 3 give way, are no outliers; and a point that is off by a millimetre is found beside the sag, which
/// moves others by more.
#[test]
fn points_of_a_robot_that_sags_are_no_outliers_and_hide_none() {
    let sagging = Campaign {
        n_configurations: 30,
        n_targets: 3,
        sag_rad: 0.03f64.to_radians(),
        ..Campaign::PLAIN
    };
    for seed in 0..12 {
        let (robot, _, mut set, mut random) = campaign(7000 + seed, sagging);
        set.points.iter_mut().for_each(|p| p.subset = None);
        let outliers = |set: &MeasurementSet| -> Vec<usize> {
            let report = run(&CalibrationRequest::new(robot.clone(), set.clone()));
            let told = report.warnings.iter();
            let told = told.filter(|told| told.code.starts_with("outliers"));
            told.flat_map(|told| told.rows.clone()).collect()
        };
        assert_eq!(outliers(&set), [0; 0], "seed {seed}");
        set.points[40].position_mm += random.vector().normalize();
        assert_eq!(outliers(&set), [40], "seed {seed}");
    }
}
