//! Priors, compared with scipy, the closed form and planted truth.

use crate::data::{paper_robot, paper_set};
use crate::simulation::{Campaign, Normal, measure, poses, robot_of_the_priors, true_value};
use kincal::calibration::report::ParameterOutcome;
use kincal::calibration::request::{Loss, ParameterChoice, ParameterPrior, VerifySource};
use kincal::calibration::{
    CalibrationReport, CalibrationRequest, Error, Event, Method, Model, Preset, calibrate,
    prior_faults,
};
use kincal::identification::model::parameters::complete_parameters;
use std::ops::ControlFlow;

/// `docs/oracles/priors.py`: name, mean, std, min and max from nominal, mm or degrees.
const PRIORS: [(&str, f64, f64); 6] = [
    ("d_2", 0.0, 0.05),
    ("theta_offset_6", 0.1, 0.02),
    ("a_6", 0.2, 0.1),
    ("d_5", 0.3, 0.1),
    ("a_3", 0.0, 0.02),
    ("alpha_2", 0.0, 0.002),
];
const BOUNDS: [(&str, f64, f64, f64); 4] = [
    ("a_4", 10.0, -0.02, 0.02),
    ("a_2", 10.0, -0.01, 0.1),
    ("theta_offset_3", 1.0, -1.0, 0.001),
    ("d_5", 0.1, 0.0, 0.32),
];
/// scipy's answers.
const SCIPY: &str = include_str!("../../docs/oracles/priors.csv");
/// Tolerance: scipy's central differences have a relative error of about 1e-9, and its trust region stops a little inside a bound.
const AS_SCIPY: f64 = 2e-6;

fn prior(name: &str, std: f64) -> ParameterPrior {
    ParameterPrior {
        name: name.into(),
        std,
        mean: None,
        min: None,
        max: None,
    }
}

/// Least squares of the paper's model without other priors than these.
fn request(set: &str, priors: Vec<ParameterPrior>) -> CalibrationRequest {
    let request = CalibrationRequest::new(paper_robot(), paper_set(set));
    CalibrationRequest {
        model: Some(Model::Paper),
        preset: Preset::Paper,
        method: Method::LeastSquares,
        refine: Some(false),
        priors,
        ..request
    }
}

fn run(request: &CalibrationRequest) -> CalibrationReport {
    calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn of<'a>(report: &'a CalibrationReport, name: &str) -> &'a ParameterOutcome {
    report.parameters.iter().find(|p| p.name == name).unwrap()
}

fn warned(report: &CalibrationReport, code: &str) -> bool {
    report.warnings.iter().any(|w| w.code == code)
}

/// The priors of the oracle in absolute values, with its bounds if `is_bounded`.
fn of_the_oracle(is_bounded: bool) -> Vec<ParameterPrior> {
    let plain = run(&request("first_noisy.csv", vec![]));
    let nominal = |name: &str| of(&plain, name).nominal;
    let mut priors: Vec<ParameterPrior> = PRIORS
        .iter()
        .map(|(name, mean, std)| ParameterPrior {
            mean: Some(nominal(name) + mean),
            ..prior(name, *std)
        })
        .collect();
    for (name, std, min, max) in BOUNDS.iter().filter(|_| is_bounded) {
        let bounds = (Some(nominal(name) + min), Some(nominal(name) + max));
        match priors.iter_mut().find(|p| p.name == *name) {
            Some(known) => (known.min, known.max) = bounds,
            None => priors.push(ParameterPrior {
                min: bounds.0,
                max: bounds.1,
                ..prior(name, *std)
            }),
        }
    }
    priors
}

#[test]
fn least_squares_with_priors_and_bounds_ends_where_scipy_does() {
    for (case, is_bounded) in [("priors", false), ("bounds", true)] {
        let report = run(&request("first_noisy.csv", of_the_oracle(is_bounded)));
        let mut compared = 0;
        for line in SCIPY
            .lines()
            .filter_map(|line| line.strip_prefix(&format!("{case},")))
            .filter(|line| !line.starts_with("sigma"))
        {
            let (name, deviation) = line.split_once(',').unwrap();
            let (ours, scipy) = (of(&report, name).delta, deviation.parse::<f64>().unwrap());
            assert!(
                (ours - scipy).abs() < AS_SCIPY,
                "{case}, {name}: {ours} against {scipy}"
            );
            compared += 1;
        }
        assert_eq!((compared, report.termination), (24, "converged"));
        assert_eq!(report.identifiability.n_by_priors, Some(4));
        // The directions that the points determine are the same as without priors.
        assert_eq!(
            (
                report.identifiability.rank,
                report.identifiability.unidentifiable.len()
            ),
            (20, 4)
        );
        assert!(
            report
                .convergence_mm2
                .windows(2)
                .all(|pair| pair[1] <= pair[0])
        );
        assert_eq!(report.convergence_mm2.len(), report.n_iterations + 1);
    }
}

#[test]
fn what_stands_at_a_bound_is_said_and_has_no_interval() {
    let report = run(&request("first_noisy.csv", of_the_oracle(true)));
    for (name, bound) in [("a_4", 0.02), ("theta_offset_3", 0.001)] {
        let found = of(&report, name);
        assert_eq!(
            found.prior.as_ref().unwrap().at_bound.as_deref(),
            Some("max")
        );
        assert!(
            (found.delta - bound).abs() < 1e-12
                && found.std_uncertainty.is_none()
                && found.interval_95.is_none(),
            "{found:?}"
        );
    }
    assert!(
        of(&report, "a_2")
            .prior
            .as_ref()
            .unwrap()
            .at_bound
            .is_none()
            && of(&report, "a_2").std_uncertainty.is_some()
    );
    assert!(warned(&report, "at_bound"));
}

#[test]
fn every_method_finds_the_same_with_priors() {
    let priors = of_the_oracle(false);
    let best = run(&request("first_noisy.csv", priors.clone())).cost_mm2;
    let network = run(&CalibrationRequest {
        method: Method::Pso,
        preset: Preset::Default,
        ..request("first_noisy.csv", vec![])
    })
    .network;
    // auto takes least squares, which has priors of its own in the default preset
    for (method, preset) in [
        (Method::Pso, Preset::Default),
        (Method::BpnnPso, Preset::Default),
        (Method::Auto, Preset::Paper),
    ] {
        let custom_request = CalibrationRequest {
            method,
            preset,
            network: network.clone(),
            ..request("first_noisy.csv", priors.clone())
        };
        // the noise, which weighs the priors in F, is found beside other priors in the default preset
        let found = run(&custom_request).cost_mm2;
        println!("{method:?}: F {found} of {best}");
        assert!(
            (0.999..1.001).contains(&(found / best)),
            "{method:?}: {found} for {best}"
        );
    }
}

#[test]
fn every_method_and_loss_keeps_the_bounds_and_finds_the_same() {
    let priors = of_the_oracle(true);
    let best = run(&request("first_noisy.csv", priors.clone()));
    let network = run(&CalibrationRequest {
        method: Method::Pso,
        preset: Preset::Default,
        ..request("first_noisy.csv", vec![])
    })
    .network;
    for (method, preset) in [
        (Method::Pso, Preset::Default),
        (Method::Pso, Preset::Paper),
        (Method::BpnnPso, Preset::Default),
        (Method::Auto, Preset::Default),
    ] {
        let custom_request = CalibrationRequest {
            method,
            preset,
            network: network.clone(),
            ..request("first_noisy.csv", priors.clone())
        };
        let report = run(&custom_request);
        for known in &priors {
            let value = of(&report, &known.name).identified;
            let (min, max) = (known.min.unwrap_or(f64::MIN), known.max.unwrap_or(f64::MAX));
            assert!(
                (min - 1e-12..=max + 1e-12).contains(&value),
                "{method:?}, {preset:?}: {} is {value}",
                known.name
            );
        }
        // the noise, which weighs the priors in F, is found beside other priors in the default preset
        let nearly = match preset {
            Preset::Paper => 1e-9,
            Preset::Default => 1e-3,
        };
        assert!(
            report.cost_mm2 >= best.cost_mm2 * (1.0 - nearly),
            "{method:?}: below the least there is"
        );
        println!(
            "{method:?}, {preset:?}: F {} of {}",
            report.cost_mm2, best.cost_mm2
        );
        // the curve of least squares has what its own priors add
        let added = match method {
            Method::Auto => 0.1,
            _ => 1e-9,
        };
        let (last, stated) = (*report.convergence_mm2.last().unwrap(), report.cost_mm2);
        assert!(
            (-1e-9..added).contains(&(last / stated - 1.0)),
            "{method:?}: {last} {stated}"
        );
        // A bound crosses the search directions, so a swarm alone does not reach the answer on it; least squares after it does.
        if preset == Preset::Default {
            let [refined, least] = [method, Method::LeastSquares].map(|method| {
                run(&CalibrationRequest {
                    method,
                    refine: Some(true),
                    ..custom_request.clone()
                })
            });
            assert!(
                (refined.cost_mm2 / least.cost_mm2 - 1.0).abs() < 1e-6,
                "{method:?}: {} {}",
                refined.cost_mm2,
                least.cost_mm2
            );
        }
    }
    let squares = CalibrationRequest {
        preset: Preset::Default,
        ..request("first_noisy.csv", priors.clone())
    };
    let mut huber = squares.clone();
    huber.options.loss = Some(Loss::Huber);
    let (report, best) = (run(&huber), run(&squares));
    for known in &priors {
        let value = of(&report, &known.name).identified;
        assert!(
            (known.min.unwrap_or(f64::MIN) - 1e-12..=known.max.unwrap_or(f64::MAX) + 1e-12)
                .contains(&value),
            "{}: {value}",
            known.name
        );
    }
    // Without outliers the loss is nearly quadratic, and the answer nearly that of least squares.
    assert!(
        (of(&report, "a_5").delta - of(&best, "a_5").delta).abs()
            < 2.0 * of(&best, "a_5").std_uncertainty.unwrap()
    );
}

/// Heartbeats of a job until the first stage of this name ends.
fn heartbeats(request: &CalibrationRequest, until: &str) -> usize {
    let mut n = 0;
    let mut monitor = |event: Event<'_>| match event {
        Event::StageEnded(name) if name == until => ControlFlow::Break(()),
        Event::Heartbeat => {
            n += 1;
            ControlFlow::Continue(())
        }
        _ => ControlFlow::Continue(()),
    };
    assert_eq!(calibrate(request, &mut monitor), Err(Error::Cancelled));
    n
}

#[test]
fn priors_and_robust_losses_hear_a_cancel_during_their_first_fits() {
    let without = heartbeats(&request("first.csv", vec![]), "screening");
    let with = request("first.csv", vec![prior("d_2", 0.05)]);
    assert!(heartbeats(&with, "screening") > without + 2);
    let mut robust = request("first.csv", vec![]);
    robust.options.loss = Some(Loss::Tukey);
    // The paper's preset has no screening, and so no scale for a robust loss.
    let refused = calibrate(&robust, &mut |_| ControlFlow::Continue(()));
    assert!(
        matches!(&refused, Err(Error::Unusable { code, .. }) if *code == "loss_not_supported"),
        "{refused:?}"
    );
    robust.preset = Preset::Default;
    let before = heartbeats(&robust, "screening");
    assert!(heartbeats(&robust, "least_squares") > before + 2);
}

#[test]
fn a_wide_prior_changes_nothing_and_a_narrow_one_holds() {
    let free = run(&request("first_noisy.csv", vec![]));
    let wide = run(&request("first_noisy.csv", vec![prior("a_3", 1000.0)]));
    assert!((of(&wide, "a_3").delta - of(&free, "a_3").delta).abs() < 1e-7);
    assert!(
        of(&wide, "a_3").prior.as_ref().unwrap().share.unwrap() < 1e-6
            && !warned(&wide, "prior_contradicted")
    );
    let narrow = run(&request("first_noisy.csv", vec![prior("a_3", 1e-6)]));
    let hold = ParameterChoice::Hold(vec!["a_3".into()]);
    let held = run(&CalibrationRequest {
        parameters: hold,
        ..request("first_noisy.csv", vec![])
    });
    let outcome = of(&narrow, "a_3");
    assert!(
        outcome.delta.abs() < 1e-6 && outcome.prior.as_ref().unwrap().share.unwrap() > 0.999,
        "{outcome:?}"
    );
    for other in &held.parameters {
        let (ours, theirs) = (of(&narrow, &other.name).delta, other.delta);
        assert!(
            (ours - theirs).abs() < 1e-5,
            "{}: {ours} {theirs}",
            other.name
        );
    }
    // Exact points: the prior is used, and the contradiction is reported.
    let exact = run(&request("first.csv", vec![prior("a_3", 1e-3)]));
    assert!(
        of(&exact, "a_3").delta.abs() < 5e-3,
        "{}",
        of(&exact, "a_3").delta
    );
    assert!(warned(&exact, "prior_contradicted"));
}

/// Corrections are variables of the same problem, so that the stated priors hold for the links that are fitted with them.
#[test]
fn corrections_are_fitted_beside_stated_priors() {
    let robot = paper_robot();
    let sagging = Campaign {
        sag_rad: 5e-4,
        ..Campaign::PLAIN
    };
    let mut random = Normal::new(61);
    let truth = robot_of_the_priors(&robot, 1, &mut random);
    let set = measure(&truth, &poses(60, &mut random), &sagging, &mut random);
    let with = |priors: Vec<ParameterPrior>| {
        let report = run(&CalibrationRequest {
            priors,
            ..CalibrationRequest::new(robot.clone(), set.clone())
        });
        report.corrected.expect("sag is corrected").model.links[2].a_mm - robot.links[2].a_mm
    };
    let (free_mm, held_mm) = (with(vec![]), with(vec![prior("a_3", 1e-3)]));
    println!("a_3 with corrections: {free_mm:.4} mm, {held_mm:.5} mm with a prior of 0.001 mm");
    assert!(free_mm.abs() > 0.02 && held_mm.abs() < 3e-3);
}

/// The nominal robot is placed anew when stations move, and a target that a coordinate measuring machine measured stays where it was stated.
#[test]
fn a_prior_of_a_target_holds_with_several_stations() {
    let robot = paper_robot();
    let mut random = Normal::new(62);
    let truth = robot_of_the_priors(&robot, 1, &mut random);
    let mut set = measure(
        &truth,
        &poses(60, &mut random),
        &Campaign::PLAIN,
        &mut random,
    );
    for (row, point) in set.points.iter_mut().enumerate() {
        point.station = Some(if row < 30 { "a".into() } else { "b".into() });
    }
    let z_mm = truth.targets_mm[0].z;
    let report = run(&CalibrationRequest {
        priors: vec![ParameterPrior {
            mean: Some(z_mm),
            ..prior("target_0_z", 1e-3)
        }],
        verify: VerifySource::Fraction(0.5),
        ..CalibrationRequest::new(robot, set)
    });
    let stated = of(&report, "target_0_z").prior.as_ref().unwrap().mean;
    println!(
        "target_0_z {:.5} mm, prior {stated:.5} mm, stated {z_mm:.5} mm",
        report.targets_mm[0].z
    );
    assert!((stated - z_mm).abs() < 1e-9 && (report.targets_mm[0].z - z_mm).abs() < 4e-3);
    assert_eq!(report.uncertainty_absent_because, None);
}

#[test]
fn what_points_cannot_see_stays_where_its_prior_has_it_with_the_uncertainty_of_the_prior() {
    // With the target on its axis, positions do not depend on the last joint's offset.
    let known = ParameterPrior {
        mean: Some(0.07),
        ..prior("theta_offset_6", 0.01)
    };
    let report = run(&request("first_noisy.csv", vec![known, prior("d_2", 0.1)]));
    let sixth = of(&report, "theta_offset_6");
    assert!((sixth.identified - 0.07).abs() < 1e-9 && !sixth.identifiable);
    assert!(
        (sixth.std_uncertainty.unwrap() / 0.01 - 1.0).abs() < 1e-6,
        "{sixth:?}"
    );
    assert!((sixth.prior.as_ref().unwrap().share.unwrap() - 1.0).abs() < 1e-6);
    // The points determine only the sum of d_2 and d_3: if d_2 is known to 0.1 mm, so is d_3, and no better.
    let (second, third) = (of(&report, "d_2"), of(&report, "d_3"));
    assert!((second.std_uncertainty.unwrap() / 0.1 - 1.0).abs() < 1e-6);
    assert!(
        (0.1..0.2).contains(&third.std_uncertainty.unwrap())
            && third.prior.is_none()
            && third.identifiable
    );
    // Without a prior nothing is stated.
    assert!(of(&report, "alpha_6").std_uncertainty.is_none());
    assert_eq!(report.identifiability.n_by_priors, Some(2));
}

/// Robots whose true errors are drawn from the stated priors.
const ROBOTS: u64 = 150;
/// Standard deviation of what is stated of a parameter, as a share of that of the model's own prior.
const KNOWN_BETTER: f64 = 0.1;

#[test]
fn intervals_hold_the_truth_where_the_priors_are_true() {
    let nominal = paper_robot();
    let campaign = Campaign {
        n_configurations: 20,
        ..Campaign::PLAIN
    };
    let (mut held, mut stated, mut widths) = (0, 0, [0.0; 2]);
    for seed in 0..ROBOTS {
        let mut random = Normal::new(7_000 + seed);
        let mut truth = robot_of_the_priors(&nominal, 1, &mut random);
        // Of four parameters more is known than the model's own priors say.
        let (first, links) = (&nominal.links, &mut truth.links);
        let nearer = |at: &mut f64, nominal: f64| *at = nominal + KNOWN_BETTER * (*at - nominal);
        nearer(&mut links[1].a_mm, first[1].a_mm);
        nearer(&mut links[3].d_mm, first[3].d_mm);
        nearer(&mut links[4].a_mm, first[4].a_mm);
        nearer(&mut links[4].theta_offset_rad, first[4].theta_offset_rad);
        let set = measure(&truth, &poses(20, &mut random), &campaign, &mut random);
        let reach_mm: f64 = first.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum();
        let priors = ["a_2", "d_4", "a_5", "theta_offset_5"].map(|name| {
            let own = if name.starts_with("theta") {
                0.3
            } else {
                0.5 / 1700.0 * reach_mm
            };
            prior(name, KNOWN_BETTER * own)
        });
        let with = |priors| {
            let custom_request = CalibrationRequest {
                method: Method::LeastSquares,
                priors,
                ..CalibrationRequest::new(nominal.clone(), set.clone())
            };
            run(&custom_request)
        };
        let reports = [with(priors.to_vec()), with(vec![])];
        for p in complete_parameters(nominal.links.len(), 1) {
            let interval = |k: usize| of(&reports[k], &p.name()).interval_95;
            let (Some(value), Some(known), Some(alone)) =
                (true_value(&truth, &p), interval(0), interval(1))
            else {
                continue;
            };
            if priors.iter().any(|prior| prior.name == p.name()) {
                for (sum, [low, high]) in widths.iter_mut().zip([known, alone]) {
                    *sum += high - low;
                }
            }
            stated += 1;
            held += usize::from((known[0]..=known[1]).contains(&value));
        }
    }
    let share = held as f64 / stated as f64;
    println!(
        "{held} of {stated}: {share:.4}; mean width {:.4} of that without",
        widths[0] / widths[1]
    );
    assert!((0.93..0.97).contains(&share), "{share}");
    assert!(widths[0] < widths[1]);
}

#[test]
fn priors_that_cannot_be_used_are_refused_with_their_place() {
    let faults =
        |priors: Vec<ParameterPrior>, hold: &[&str]| -> Vec<(usize, &'static str, &'static str)> {
            let hold = ParameterChoice::Hold(hold.iter().map(ToString::to_string).collect());
            let request = CalibrationRequest {
                parameters: hold,
                ..request("first.csv", priors)
            };
            let found = prior_faults(&request);
            assert_eq!(
                found.is_empty(),
                calibrate(&request, &mut |_| ControlFlow::Continue(())).is_ok()
            );
            found
                .into_iter()
                .map(|f| (f.index, f.field, f.code))
                .collect()
        };
    let bounded = |name: &str, min: f64, max: f64| ParameterPrior {
        min: Some(min),
        max: Some(max),
        ..prior(name, 1.0)
    };
    assert_eq!(
        faults(vec![prior("a_1", 0.1), prior("a_9", 0.1)], &[]),
        [(1, "name", "unknown_parameter")]
    );
    assert_eq!(
        faults(vec![prior("a_1", 0.1)], &["a_1"]),
        [(0, "name", "parameter_held")]
    );
    assert_eq!(
        faults(vec![prior("a_1", 0.1), prior("a_1", 0.2)], &[]),
        [(1, "name", "duplicate")]
    );
    assert_eq!(
        faults(vec![bounded("a_1", 1e4, 2e4)], &[]),
        [(0, "min", "out_of_bounds")]
    );
    assert_eq!(
        faults(vec![bounded("a_1", -2e4, -1e4)], &[]),
        [(0, "max", "out_of_bounds")]
    );
    let off = ParameterPrior {
        mean: Some(3e4),
        ..bounded("a_1", -1e4, 1e4)
    };
    assert_eq!(faults(vec![off], &[]), [(0, "max", "out_of_bounds")]);
    assert!(faults(vec![bounded("a_1", -1e4, 1e4)], &[]).is_empty());
    let refused = calibrate(&request("first.csv", vec![prior("a_9", 0.1)]), &mut |_| {
        ControlFlow::Continue(())
    });
    assert!(
        matches!(
            refused,
            Err(Error::Unusable {
                code: "unknown_parameter",
                ..
            })
        ),
        "{refused:?}"
    );
}
