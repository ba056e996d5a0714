//! Cartesian targets in work frames, and the uncertainty of corrected tools. The true robots are simulated.

use crate::data::paper_robot;
use crate::simulation::{
    Campaign, NonlinearErrors, Normal, anchored_robot, limited, links_alone, measure,
    nonlinear_set, poses, robot_of_the_priors, true_robot,
};
use kincal::calibration::request::{Estimate, Model};
use kincal::calibration::{CalibrationReport, CalibrationRequest, calibrate};
use kincal::compensation::{
    Base, Compensation, FixtureDoubt, FixtureMisfit, FixtureMistake, FixturePoint, Mode, Status,
    Tool, ToolError, ToolGoal, ToolPoint, WorkFrame, WorkFrameError,
};
use kincal::identification::KinematicModel;
use kincal::identification::model::parameters::rotation_exp;
use kincal::kinematics::{Robot, t_base_flange};
use kincal::measurement::{Frame, MeasurementSet, Subset};
use kincal::operations::{Correctable, compensate, fitting_work_frame, work_frame_answer};
use kincal::wire::compensate::{CartesianTarget, CompensateBody};
use kincal::wire::estimate::StoredEstimate;
use kincal::wire::frames::Transform;
use kincal::wire::json;
use kincal::wire::named_frame::{FixturePointBody, WorkFrameBody, WorkFrameReference};
use kincal::wire::parameter_set::{ParameterSetContent, Provenance};
use kincal::wire::robot::RobotBody;
use kincal::wire::tool::{ToolBody, quaternion};
use nalgebra::{IsometryMatrix3, Point3, Translation3, Vector3};
use std::ops::ControlFlow;

fn isometry(translation: [f64; 3], turn: [f64; 3]) -> IsometryMatrix3<f64> {
    IsometryMatrix3::from_parts(
        Translation3::from(Vector3::from(translation)),
        rotation_exp(&Vector3::from(turn)),
    )
}

/// A robot whose base stands 0.5 mm off along each axis and is turned by 0.02°, with three reflectors off a line.
fn cell(nominal: &Robot, seed: u64) -> KinematicModel {
    let mut random = Normal::new(seed);
    let mut truth = anchored_robot(nominal, 3, &mut random);
    truth.t_instrument_base = IsometryMatrix3::from_parts(
        Translation3::from(random.vector() * 0.5),
        rotation_exp(&(random.vector() * 0.02f64.to_radians())),
    );
    truth
}

fn identified(
    nominal: &Robot,
    truth: &KinematicModel,
    seed: u64,
    frame: Frame,
) -> CalibrationReport {
    let mut random = Normal::new(7000 + seed);
    let campaign = Campaign {
        n_configurations: 60,
        n_targets: truth.targets_mm.len(),
        ..Campaign::PLAIN
    };
    let q = poses(60, &mut random);
    let measured = measure(truth, &q, &campaign, &mut random);
    let mut points = measured.points;
    for (i, point) in points.iter_mut().enumerate() {
        if (i / campaign.n_targets) % 2 == 1 {
            point.subset = Some(Subset::Verify);
        }
    }
    let request = CalibrationRequest::new(nominal.clone(), MeasurementSet::new(frame, points));
    calibrate(&links_alone(&request), &mut |_| ControlFlow::Continue(())).unwrap()
}

#[test]
fn a_pose_is_reached_from_joint_values_near_it() {
    let nominal = limited(paper_robot());
    let tool = Tool::Tcp(isometry([30.0, -45.0, 160.0], [0.3, -0.8, 0.5]));
    let (mut n_nominal, mut n_reached, mut n) = (0, 0, 0);
    for seed in 0..5 {
        let truth = anchored_robot(&nominal, 1, &mut Normal::new(seed));
        let compensation = Compensation::new(&nominal, &truth.links);
        let mut random = Normal::new(50 + seed);
        for q in poses(20, &mut random)
            .iter()
            .filter(|q| q[4].sin().abs() > 0.2)
        {
            let wanted = compensation.t_nominal_tool(q, &tool);
            let near: Vec<f64> = q.iter().map(|q| q + 0.2 * random.draw()).collect();
            let reached = compensation.reach(&wanted, &near, &tool, Mode::Pose);
            n += 1;
            if reached.corrected.status != Status::Ok {
                continue; // a joint limit on the way
            }
            n_reached += 1;
            // by the plain forward kinematics, not by the code that searched
            let flange = t_base_flange(&nominal.links, &reached.q_nominal_rad);
            let Tool::Tcp(tcp) = tool else { unreachable!() };
            let apart = wanted.inverse() * flange * tcp;
            // where the search of the nominal robot ends near a singularity, the correction still reaches the target
            let is_there = apart.translation.vector.norm() < 2e-3 && apart.rotation.angle() < 2e-6;
            n_nominal += usize::from(is_there);
            let true_tool = t_base_flange(&truth.links, &reached.corrected.q_controller_rad) * tcp;
            let missed = (true_tool.translation.vector - wanted.translation.vector).norm();
            assert!(missed < 2e-3, "{missed}");
            assert!(reached.corrected.position_error_before_mm > 0.01);
        }
    }
    println!("{n_reached} of {n} reached");
    assert!(n > 60 && 10 * n_reached >= 9 * n, "{n_reached} of {n}");
    assert!(
        10 * n_nominal >= 9 * n_reached,
        "{n_nominal} of {n_reached}"
    );
}

/// The first oracle is the derivative that identification uses, the second one is simulation.
#[test]
fn the_uncertainty_of_a_tool_is_that_of_predictions_and_of_simulated_robots() {
    let nominal = limited(paper_robot());
    let (mut squares, mut stated) = (0.0, 0.0);
    for seed in 0..12 {
        let truth = true_robot(&nominal, 3, &mut Normal::new(200 + seed));
        let report = identified(&nominal, &truth, seed, Frame::Instrument);
        let estimate = report.estimate.as_ref().expect("an estimate");
        let robot = ParameterSetContent::from(&report).identified_robot(None);
        let error_in =
            |base| ToolError::new(&nominal, estimate, &robot, base, ToolPoint::Target(0));
        let error = error_in(Base::Measured);
        let compensation = Compensation::of(&nominal, &robot, Base::Robot);
        let in_base = error_in(Base::Robot);
        for q in poses(10, &mut Normal::new(300 + seed)) {
            let by_derivative =
                estimate
                    .uncertainty
                    .position_std_mm(&estimate.model, &estimate.parameters, &q, 0);
            let std_mm = error.std_mm(&q, ToolGoal::Fixed);
            assert!(
                (std_mm / by_derivative - 1.0).abs() < 1e-4,
                "{std_mm} {by_derivative}"
            );
            // corrected joint targets of the reflector, in the robot's own base
            let tool = Tool::Target(report.targets_mm[0]);
            let corrected = compensation.correct(&q, &tool, Mode::Position);
            let std_mm = in_base.std_mm(&corrected.q_controller_rad, ToolGoal::AsNominal(&q));
            stated += std_mm * std_mm;
            let real = Compensation::new(&nominal, &truth.links);
            let p = Point3::from(real.p_anchored_mm(&truth.targets_mm[0]));
            let missed = real.t_base_flange(&corrected.q_controller_rad) * p
                - t_base_flange(&nominal.links, &q) * p;
            squares += missed.norm_squared();
        }
    }
    let ratio = (stated / squares).sqrt();
    println!("stated over true, corrected targets in the robot's base: {ratio:.3}");
    assert!((0.67..1.5).contains(&ratio), "{ratio}");
}

const ROBOT_JSON: &str = include_str!("../../data/paper/robot.json");

/// The first oracle is the derivative that the corrections' fit uses, the second one are robots that sag.
#[test]
fn the_uncertainty_of_a_tool_with_corrections_is_that_of_predictions_and_of_robots_that_sag() {
    let nominal = limited(paper_robot());
    let sags = NonlinearErrors {
        sag_rad: 1e-3,
        ..NonlinearErrors::NONE
    };
    let (mut squares, mut stated) = (0.0, 0.0);
    for seed in 0..6 {
        let mut random = Normal::new(seed);
        let (truth, mut set) = nonlinear_set(&nominal, &Campaign::PLAIN, &sags, &mut random);
        // measured in the base frame
        let t_base_instrument = truth.truth.t_instrument_base.inverse();
        let in_base = |p: Vector3<f64>| (t_base_instrument * Point3::from(p)).coords;
        set.frame = Frame::Base;
        for point in &mut set.points {
            point.position_mm = in_base(point.position_mm);
        }
        let request = CalibrationRequest::new(nominal.clone(), set);
        let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
        let estimate = report.estimate.as_ref().expect("an estimate");
        let body: RobotBody = json::parse(ROBOT_JSON.as_bytes()).unwrap();
        let stored = StoredEstimate::new(estimate, Model::Complete, &body).unwrap();
        assert_eq!(&Estimate::try_from(&stored).unwrap(), estimate);
        assert!(estimate.corrected.is_some());
        let robot = ParameterSetContent::from(&report).identified_robot(None);
        let tool = ToolPoint::Target(0);
        let error = ToolError::new(&nominal, estimate, &robot, Base::Measured, tool);
        let compensation = Compensation::of(&nominal, &robot, Base::Measured);
        let tool = Tool::Target(robot.target_mm(0));
        for q in poses(20, &mut Normal::new(300 + seed)) {
            let predicted_mm = estimate.predicted_std_mm(&robot, &q, 0);
            let ratio = error.std_mm(&q, ToolGoal::Fixed) / predicted_mm;
            assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
            // a position of the reflector, in the measuring frame, that the corrected joint values are to reach
            let wanted: [f64; 3] = (robot.position(&q, 0) + Vector3::new(3.0, -2.0, 1.0)).into();
            let wanted = isometry(wanted, [0.0; 3]);
            let reached = compensation.reach(&wanted, &q, &tool, Mode::Position);
            let q_rad = &reached.corrected.q_controller_rad;
            let missed = in_base(truth.position(q_rad, 0)) - wanted.translation.vector;
            squares += missed.norm_squared();
            let std_mm = error.std_mm(q_rad, ToolGoal::Fixed);
            stated += std_mm * std_mm;
        }
    }
    let ratio = (stated / squares).sqrt();
    println!("stated over true: {ratio:.3}");
    assert!((0.67..1.5).contains(&ratio), "{ratio}");
}

/// A drawing knows the tool relative to the nominal flange. Positions do not show where the real flange is along and about the last axis.
#[test]
fn a_tool_from_a_drawing_is_as_uncertain_as_the_flange_of_simulated_robots() {
    let nominal = limited(paper_robot());
    let tcp = isometry([120.0, -60.0, 160.0], [0.0; 3]);
    let point = |std_mm| ToolPoint::of(&Tool::Tcp(tcp), 0, std_mm);
    for base in [Base::Robot, Base::Measured] {
        let (mut squares, mut stated, mut measured_tool) = (0.0, 0.0, 0.0);
        for seed in 0..15 {
            let mut truth = robot_of_the_priors(&nominal, 3, &mut Normal::new(200 + seed));
            let frame = match base {
                Base::Robot => Frame::Instrument,
                Base::Measured => Frame::Base,
            };
            if base == Base::Measured {
                truth.t_instrument_base = cell(&nominal, seed).t_instrument_base;
            }
            let report = identified(&nominal, &truth, seed, frame);
            let estimate = report.estimate.as_ref().expect("an estimate");
            let robot = ParameterSetContent::from(&report).identified_robot(None);
            let error_of = |tool| ToolError::new(&nominal, estimate, &robot, base, tool);
            let drawn = error_of(point(None));
            let measured = error_of(point(Some(0.0)));
            let compensation = Compensation::of(&nominal, &robot, base);
            let real = Compensation::new(&nominal, &truth.links);
            let t_frame_base = match base {
                Base::Robot => real.anchor().t_base_anchored.inverse(),
                Base::Measured => truth.t_instrument_base,
            };
            for q in poses(10, &mut Normal::new(300 + seed)) {
                let corrected = compensation.correct(&q, &Tool::Tcp(tcp), Mode::Position);
                let q_corrected = &corrected.q_controller_rad;
                let wanted = ToolGoal::AsNominal(&q);
                stated += drawn.std_mm(q_corrected, wanted).powi(2);
                measured_tool += measured.std_mm(q_corrected, wanted).powi(2);
                let there = t_frame_base * t_base_flange(&truth.links, q_corrected) * tcp;
                let missed = there.translation.vector
                    - (t_base_flange(&nominal.links, &q) * tcp).translation.vector;
                squares += missed.norm_squared();
            }
        }
        let ratio = (stated / squares).sqrt();
        let without = (measured_tool / squares).sqrt();
        println!("{base:?}: stated over true {ratio:.3}, without the flange {without:.3}");
        assert!((0.67..1.5).contains(&ratio), "{base:?} {ratio}");
        assert!(without < ratio, "{base:?} {without}");
    }
}

#[test]
fn a_frame_from_points_is_as_uncertain_as_simulated_ones() {
    let t = isometry([900.0, 100.0, 400.0], [0.1, -0.2, 0.7]);
    let nominal: Vec<Vector3<f64>> = [
        [0.0, 0.0, 0.0],
        [300.0, 0.0, 0.0],
        [0.0, 200.0, 0.0],
        [300.0, 200.0, 50.0],
    ]
    .map(Vector3::from)
    .to_vec();
    let far = Vector3::new(500.0, 400.0, 100.0);
    let (mut squares, mut stated) = (0.0, 0.0);
    let mut random = Normal::new(1);
    let n = 4000;
    for _ in 0..n {
        let points: Vec<FixturePoint> = nominal
            .iter()
            .map(|p| FixturePoint {
                nominal_mm: *p,
                measured_mm: (t * Point3::from(*p)).coords + random.vector() * 0.03,
            })
            .collect();
        let frame = WorkFrame::measured(&points, 0.0).unwrap();
        let missed = frame.t_reference_work * Point3::from(far) - t * Point3::from(far);
        squares += missed.norm_squared();
        stated += frame.position_std_mm(&far).powi(2);
    }
    let ratio = (stated / squares).sqrt();
    println!("stated over true: {ratio:.4}");
    assert!((0.96..1.04).contains(&ratio), "{ratio}");
    // a stated noise is a lower bound
    let exact: Vec<FixturePoint> = nominal
        .iter()
        .map(|p| FixturePoint {
            nominal_mm: *p,
            measured_mm: (t * Point3::from(*p)).coords,
        })
        .collect();
    let with = |std_mm: f64| {
        WorkFrame::measured(&exact, std_mm)
            .unwrap()
            .position_std_mm(&far)
    };
    assert!(with(0.0) < 1e-9 && (with(0.06) / with(0.03) - 2.0).abs() < 1e-9);
}

#[test]
fn points_that_give_no_frame_are_told() {
    let point = |x: f64, y: f64| FixturePoint {
        nominal_mm: Vector3::new(x, y, 0.0),
        measured_mm: Vector3::new(x, y, 10.0),
    };
    let two = [point(0.0, 0.0), point(100.0, 0.0)];
    assert_eq!(WorkFrame::measured(&two, 0.0), Err(WorkFrameError::TooFew));
    let on_a_line = [point(0.0, 0.0), point(100.0, 0.1), point(200.0, 0.0)];
    assert_eq!(
        WorkFrame::measured(&on_a_line, 0.0),
        Err(WorkFrameError::OnALine)
    );
}

#[test]
fn a_fixture_point_that_is_off_is_named_and_noise_alone_raises_no_doubt() {
    let t = isometry([900.0, 100.0, 400.0], [0.1, -0.2, 0.7]);
    let nominal: [[f64; 3]; 6] = [
        [0.0, 0.0, 0.0],
        [1500.0, 0.0, 40.0],
        [0.0, 900.0, 0.0],
        [1500.0, 900.0, 300.0],
        [700.0, 450.0, 200.0],
        [300.0, 800.0, 120.0],
    ];
    let mut random = Normal::new(7);
    let mut measured = |n: usize, off_mm: f64, at: usize| -> Vec<FixturePoint> {
        let points = nominal[..n].iter().enumerate().map(|(i, p)| {
            let nominal_mm = Vector3::from(*p);
            let direction = random.vector().normalize();
            let off = if i == at {
                direction * off_mm
            } else {
                Vector3::zeros()
            };
            FixturePoint {
                nominal_mm,
                measured_mm: (t * Point3::from(nominal_mm)).coords + random.vector() * 0.03 + off,
            }
        });
        points.collect()
    };
    let doubt = |points: &[FixturePoint], std_mm: f64| {
        let frame = WorkFrame::measured(points, std_mm).unwrap();
        FixtureDoubt::of(points, &frame, std_mm)
    };
    for n in [4, 5, 6] {
        for std_mm in [0.0, 0.03] {
            let clean = (0..400).filter(|_| doubt(&measured(n, 0.0, 0), std_mm).is_some());
            let n_false = clean.count();
            assert!(
                n_false <= 4,
                "{n} points, {std_mm} stated: {n_false} false alarms"
            );
        }
        let mut n_named = 0;
        for round in 0..100 {
            match doubt(&measured(n, 3.0, round % n), 0.03) {
                Some(FixtureDoubt::Point { candidates, .. }) => {
                    n_named += usize::from(candidates.contains(&(round % n)));
                }
                Some(FixtureDoubt::Scatter { .. }) => (),
                other => panic!("{n} points: {other:?}"),
            }
        }
        println!("{n} points: named {n_named} of 100");
        assert!(n_named >= 90);
    }
    let of_three = doubt(&measured(3, 0.0, 0), 0.03);
    assert!(matches!(of_three, Some(FixtureDoubt::Unchecked { .. })));
    let body = WorkFrameBody {
        points: Some(
            measured(6, 3.0, 5)
                .iter()
                .map(|p| FixturePointBody {
                    nominal_mm: p.nominal_mm.into(),
                    measured_mm: p.measured_mm.into(),
                })
                .collect(),
        ),
        std_mm: Some(0.03),
        reference: WorkFrameReference::Base,
        measurement_set_id: None,
        station: None,
        translation_mm: None,
        quaternion: None,
        rotation: None,
    };
    let answer = work_frame_answer(body, "bench".into(), "now".into()).unwrap();
    assert_eq!(answer.warnings[0].code, "work_frame_point_off");
    assert_eq!(answer.warnings[0].rows, [5]);
}

/// The drawing of a flat fixture with y mirrored fits as well as the right one, and the frame's z axis is reversed.
#[test]
fn a_flat_fixture_says_where_its_z_axis_points() {
    let t = isometry([900.0, 100.0, 400.0], [0.0, 0.0, 0.7]);
    let corners = [[0.0, 0.0], [800.0, 0.0], [800.0, 500.0], [0.0, 500.0]];
    for (mirror, told) in [(1.0, "(0.00, 0.00, 1.00)"), (-1.0, "-1.00)")] {
        let points = corners.map(|[x, y]| FixturePoint {
            nominal_mm: Vector3::new(x, mirror * y, 0.0),
            measured_mm: (t * Point3::new(x, y, 0.0)).coords,
        });
        let frame = WorkFrame::measured(&points, 0.05).unwrap();
        assert!(frame.rms_mm() < 1e-9);
        let doubt = FixtureDoubt::of(&points, &frame, 0.05).unwrap();
        assert_eq!(doubt.code(), "work_frame_flat");
        assert!(doubt.to_string().contains(told), "{doubt}");
    }
}

/// Four points of a fixture, in three sizes: right with noise, and with each mistake.
#[test]
fn points_that_do_not_fit_are_refused_with_the_mistake() {
    let t = isometry([800.0, -300.0, 150.0], [0.1, 0.0, 0.5]);
    let corners = [
        [0.0, 0.0, 0.0],
        [200.0, 0.0, 0.0],
        [0.0, 150.0, 0.0],
        [100.0, 100.0, 50.0],
    ];
    let mut random = Normal::new(3);
    for size in [0.1, 1.0, 20.0] {
        let mut points = |std_mm: f64| {
            corners.map(|corner| {
                let nominal_mm = Vector3::from(corner) * size;
                let measured_mm = (t * Point3::from(nominal_mm)).coords + random.vector() * std_mm;
                FixturePoint {
                    nominal_mm,
                    measured_mm,
                }
            })
        };
        let misfit = |points: &[FixturePoint], std_mm: f64| {
            FixtureMisfit::of(
                points,
                &WorkFrame::measured(points, std_mm).unwrap(),
                std_mm,
            )
        };
        for _ in 0..200 {
            assert_eq!(misfit(&points(0.3 * size), 0.0), None);
            assert_eq!(misfit(&points(size), size), None, "as uncertain as stated");
        }
        let right = points(0.03 * size);
        let refused = |wrong: &[FixturePoint], expected: Option<FixtureMistake>| {
            let found = misfit(wrong, 0.03 * size).expect("a misfit");
            println!("{size}: {found}");
            assert_eq!(found.mistake.map(|(mistake, _)| mistake), expected);
            assert!(found.to_string().len() < 260, "two lines");
        };
        for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            let mut wrong = right;
            (wrong[a].measured_mm, wrong[b].measured_mm) =
                (right[b].measured_mm, right[a].measured_mm);
            refused(&wrong, Some(FixtureMistake::Exchanged(a, b)));
        }
        let drawn = |change: &dyn Fn(Vector3<f64>) -> Vector3<f64>| {
            right.map(|p| FixturePoint {
                nominal_mm: change(p.nominal_mm),
                ..p
            })
        };
        refused(
            &drawn(&|p| Vector3::new(p.x, p.y, -p.z)),
            Some(FixtureMistake::Mirrored),
        );
        for factor in [25.4, 1000.0, 1.0 / 25.4, 1.0 / 1000.0] {
            let scaled = drawn(&|p| p / factor);
            // a drawing in metres: the points are in mm all the same
            refused(&scaled, Some(FixtureMistake::Scaled(factor)));
        }
        let mut one_off = right;
        one_off[2].measured_mm.z += 30.0 * size;
        refused(&one_off, None);
    }
}

/// A cell: base error 0.5 mm, a fixture measured with the tracker, a tool with orientation. Twenty robots, ten targets each, scored by the true
/// robot.
#[test]
fn cartesian_targets_in_a_measured_work_frame_are_met_within_the_stated_uncertainty() {
    let nominal = limited(paper_robot());
    let tcp = isometry([25.0, -40.0, 150.0], [0.2, 0.5, -0.3]);
    let (mut n, mut n_within, mut worst) = (0, 0, 0.0f64);
    let (mut before_mm, mut after_mm) = (vec![], vec![]);
    for seed in 0..20 {
        let truth = cell(&nominal, seed);
        let report = identified(&nominal, &truth, seed, Frame::Base);
        let content = ParameterSetContent::from(&report);
        let mut random = Normal::new(900 + seed);
        // a fixture somewhere in front of the robot, four points measured with 0.03 mm
        let q0 = &poses(1, &mut random)[0];
        let flange = t_base_flange(&nominal.links, q0);
        let t_work =
            IsometryMatrix3::from_parts(flange.translation, rotation_exp(&(random.vector() * 0.5)));
        let corners = [
            [0.0, 0.0, 0.0],
            [250.0, 0.0, 0.0],
            [0.0, 250.0, 0.0],
            [250.0, 250.0, 30.0],
        ];
        let points = corners.map(|nominal_mm| FixturePointBody {
            nominal_mm,
            measured_mm: ((t_work * Point3::from(Vector3::from(nominal_mm))).coords
                + random.vector() * 0.03)
                .into(),
        });
        let work_frame = WorkFrameBody {
            reference: WorkFrameReference::Measuring,
            measurement_set_id: Some("set".into()),
            station: None,
            translation_mm: None,
            quaternion: None,
            rotation: None,
            points: Some(points.to_vec()),
            std_mm: Some(0.03),
        };
        let mut targets = vec![];
        let mut wanted = vec![];
        for q in poses(10, &mut random)
            .iter()
            .filter(|q| q[4].sin().abs() > 0.2)
        {
            let t_base_tool = t_base_flange(&nominal.links, q) * tcp;
            let t_work_tool = t_work.inverse() * t_base_tool;
            targets.push(CartesianTarget {
                position_mm: t_work_tool.translation.vector.into(),
                quaternion: Some(quaternion(&t_work_tool.rotation)),
                rotation: None,
                q_near_deg: q.iter().map(|q| (q + 0.05).to_degrees()).collect(),
            });
            wanted.push(t_base_tool);
        }
        let tool = Transform::from(&tcp);
        let request = CompensateBody {
            targets,
            frame: Some("fixture".into()),
            tool: Some(ToolBody {
                translation_mm: tool.translation_mm,
                rotation: Some(tool.rotation),
                ..ToolBody::default()
            }),
            base: Some(Base::Measured),
            ..CompensateBody::default()
        };
        let provenance = Provenance {
            measuring_frame: Some(Frame::Base),
            ..Provenance::default()
        };
        let from = Correctable {
            robot: &nominal,
            content: &content,
            provenance: &provenance,
            estimate: report.estimate.as_ref(),
            measurement_set_id: Some("set"),
            work_frame: Some(&work_frame),
            named_tool: None,
        };
        let answer = compensate(&request, from).unwrap();
        let stated_mm = answer.position_std_mm.expect("a stated uncertainty");
        let t_reference_work = fitting_work_frame(&work_frame, "/frame")
            .unwrap()
            .t_reference_work;
        for (i, wanted) in wanted.iter().enumerate() {
            if answer.status[i] != Status::Ok {
                continue;
            }
            let q_rad: Vec<f64> = answer.q_deg[i].iter().map(|q| q.to_radians()).collect();
            // the pose for the controller is that of its own, nominal robot, in the work frame
            let pose = answer.poses.as_ref().unwrap()[i].position_mm;
            let pose = t_reference_work * Point3::from(Vector3::from(pose));
            let commanded = t_base_flange(&nominal.links, &q_rad) * tcp;
            assert!((pose.coords - commanded.translation.vector).norm() < 1e-6);
            let there = truth.t_instrument_base * t_base_flange(&truth.links, &q_rad) * tcp;
            let missed = (there.translation.vector - wanted.translation.vector).norm();
            n += 1;
            n_within += usize::from(missed <= 3.0 * stated_mm[i]);
            worst = worst.max(missed / stated_mm[i]);
            before_mm.push(answer.position_error_before_mm[i]);
            after_mm.push(missed);
        }
    }
    before_mm.sort_by(f64::total_cmp);
    after_mm.sort_by(f64::total_cmp);
    println!(
        "{n_within} of {n} targets within three times the stated uncertainty, the worst {worst:.2} times; median error {:.3} mm before, {:.4} mm after",
        before_mm[n / 2],
        after_mm[n / 2]
    );
    assert!(n > 120 && n_within == n, "{n_within} of {n}");
    // most of what is left is the lever of a fixture of 250 mm over targets up to a metre from it
    assert!(after_mm[n / 2] < 0.2 * before_mm[n / 2]);
}

/// Each set-up of the instrument has a measuring frame of its own.
#[test]
fn a_work_frame_from_another_set_up_is_refused() {
    let nominal = limited(paper_robot());
    let truth = true_robot(&nominal, 3, &mut Normal::new(5));
    let report = identified(&nominal, &truth, 5, Frame::Instrument);
    let content = ParameterSetContent::from(&report);
    let provenance = Provenance {
        measuring_frame: Some(Frame::Instrument),
        ..Provenance::default()
    };
    let work_frame = WorkFrameBody {
        reference: WorkFrameReference::Measuring,
        measurement_set_id: Some("first".into()),
        station: None,
        translation_mm: Some([0.0; 3]),
        quaternion: None,
        rotation: None,
        points: None,
        std_mm: None,
    };
    let q = &poses(1, &mut Normal::new(6))[0];
    // the true reflector, in the measuring frame
    let there = truth.position(q, 0);
    let request = CompensateBody {
        targets: vec![CartesianTarget {
            position_mm: there.into(),
            quaternion: None,
            rotation: None,
            q_near_deg: q.iter().map(|q| q.to_degrees()).collect(),
        }],
        frame: Some("fixture".into()),
        mode: Mode::Position,
        ..CompensateBody::default()
    };
    let answer = |set: &str| {
        let from = Correctable {
            robot: &nominal,
            content: &content,
            provenance: &provenance,
            estimate: report.estimate.as_ref(),
            measurement_set_id: Some(set),
            work_frame: Some(&work_frame),
            named_tool: None,
        };
        compensate(&request, from)
    };
    assert_eq!(answer("second").unwrap_err().code, "other_measuring_frame");
    let answer = answer("first").unwrap();
    let q_rad: Vec<f64> = answer.q_deg[0].iter().map(|q| q.to_radians()).collect();
    // the pose for the controller is in the work frame too, off by what was corrected, while the base is elsewhere
    let pose = Vector3::from(answer.poses.unwrap()[0].position_mm);
    assert!((pose - there).norm() < 10.0, "{pose} {there}");
    let missed = (truth.position(&q_rad, 0) - there).norm();
    let std_mm = answer.position_std_mm.unwrap()[0];
    assert!(missed < 3.0 * std_mm, "{missed} mm, stated {std_mm}");
}
