//! Pose plans, compared with random poses and with a plain second implementation; and their promises.

use crate::data::paper_robot;
use crate::simulation::{Normal, limited, poses};
use kincal::identification::model::identifiability::prior_scales;
use kincal::identification::model::objective::{Observation, weighted_jacobian};
use kincal::identification::model::parameters::{Parameter, apply, complete_parameters};
use kincal::identification::model::pose_rows::MeasuredRotation;
use kincal::identification::statistics::workspace::random_configurations;
use kincal::identification::{KinematicModel, Model};
use kincal::kinematics::{Robot, reach_mm, t_base_flange};
use kincal::planning::{
    AcceptanceCone, BaseCylinder, LineOfSight, Noise, Plan, PlanRequest, Room, SetUp, plan,
};
use nalgebra::{DMatrix, IsometryMatrix3, Vector3};

fn request(robot: &Robot) -> PlanRequest<'_> {
    PlanRequest {
        robot,
        model: Model::Complete,
        target_mm: Vector3::new(80.0, 0.0, 100.0),
        set_ups: vec![one_set_up(30, 3)],
        n_candidates: 2_000,
        noise: Noise {
            position_std_mm: 0.05,
            rotation_std_rad: 3e-4,
        },
        is_of_poses: false,
        seed: 1,
        measured: vec![],
    }
}

fn one_set_up(n_configurations: usize, n_repeats: usize) -> SetUp {
    SetUp {
        n_configurations,
        n_repeats,
        room: Room::default(),
    }
}

fn model_of(robot: &Robot, target_mm: Vector3<f64>) -> KinematicModel {
    KinematicModel {
        t_instrument_base: IsometryMatrix3::identity(),
        links: robot.links.clone(),
        targets_mm: vec![target_mm],
        target_rotations: vec![],
    }
}

/// Mean standard deviation of the tool over configurations that the plan did not use: the textbook formula with a plain inverse.
fn mean_std_mm(request: &PlanRequest<'_>, chosen: &[Vec<f64>]) -> f64 {
    let parameters = complete_parameters(request.robot.links.len(), 1);
    let model = model_of(request.robot, request.target_mm);
    let rows = |q: &[Vec<f64>]| {
        let observation = |q: &Vec<f64>| Observation {
            q_rad: request.robot.q_model_rad(q),
            position_mm: Vector3::zeros(),
            target: 0,
            weight: 1.0,
            whitening: None,
            rotation: None,
            station: None,
        };
        weighted_jacobian(
            &model,
            &parameters,
            &q.iter().map(observation).collect::<Vec<_>>(),
            &Vector3::zeros(),
        )
    };
    let measured = rows(chosen) / request.noise.position_std_mm;
    let prior = DMatrix::from_diagonal(&nalgebra::DVector::from_iterator(
        parameters.len(),
        prior_scales(&parameters, reach_mm(&request.robot.links))
            .iter()
            .map(|scale| 1.0 / (scale * scale)),
    ));
    let covariance = (measured.transpose() * measured + prior)
        .try_inverse()
        .unwrap();
    let workspace = random_configurations(request.robot, 300, 987);
    let j = rows(&workspace);
    let std = |i: usize| {
        let j = j.rows(3 * i, 3);
        (j * &covariance * j.transpose()).trace().sqrt()
    };
    (0..300).map(std).sum::<f64>() / 300.0
}

fn configurations(plan: &Plan) -> Vec<Vec<f64>> {
    plan.configurations
        .iter()
        .map(|c| c.q_controller_rad.clone())
        .collect()
}

#[test]
fn a_plan_knows_the_tool_better_than_random_poses_and_says_how_well() {
    let robot = limited(paper_robot());
    let request = request(&robot);
    let plan = plan(&request).unwrap();
    let planned = mean_std_mm(&request, &configurations(&plan));
    let random: Vec<f64> = (0..5)
        .map(|k| mean_std_mm(&request, &poses(30, &mut Normal::new(50 + k))))
        .collect();
    let random_mean = random.iter().sum::<f64>() / 5.0;
    println!(
        "planned {planned:.4} mm (it says {:.4}), random {random_mean:.4} mm: {:.2} times",
        plan.predicted[0].mean_mm,
        random_mean / planned
    );
    assert!(
        (plan.predicted[0].mean_mm / planned - 1.0).abs() < 0.1,
        "{} {planned}",
        plan.predicted[0].mean_mm
    );
    assert!(random_mean / planned > 1.2, "{random_mean} {planned}");
}

#[test]
fn limits_boxes_floor_and_foot_are_kept() {
    let robot = limited(paper_robot());
    let room = Room {
        boxes_mm: vec![
            (
                Vector3::new(300.0, -900.0, 200.0),
                Vector3::new(1500.0, 900.0, 1600.0),
            ),
            (
                Vector3::new(-900.0, 300.0, 500.0),
                Vector3::new(0.0, 1200.0, 1500.0),
            ),
        ],
        floor_z_mm: Some(50.0),
        base_cylinder: Some(BaseCylinder {
            radius_mm: 250.0,
            height_mm: 700.0,
        }),
        ..Room::default()
    };
    let request = PlanRequest {
        set_ups: vec![SetUp {
            room: room.clone(),
            ..one_set_up(30, 3)
        }],
        ..request(&robot)
    };
    let plan = plan(&request).unwrap();
    assert_eq!(plan.configurations.len(), 30);
    for q in configurations(&plan) {
        for (q, limits) in q.iter().zip(&robot.joint_limits_rad) {
            let (low, high) = limits.unwrap();
            assert!((low..=high).contains(q));
        }
        let points: Vec<Vector3<f64>> = (3..=6)
            .map(|n| t_base_flange(&robot.links[..n], &q[..n]).translation.vector)
            .chain([
                (t_base_flange(&robot.links, &q) * nalgebra::Point3::from(request.target_mm))
                    .coords,
            ])
            .collect();
        for p in &points {
            assert!(
                p.z >= 50.0 && (p.z >= 700.0 || p.xy().norm() >= 250.0),
                "{p:?}"
            );
        }
        let p = points[4];
        assert!(
            room.boxes_mm
                .iter()
                .any(|(low, high)| (0..3).all(|k| low[k] <= p[k] && p[k] <= high[k])),
            "{p:?}"
        );
    }
    let nowhere = Room {
        boxes_mm: vec![(Vector3::repeat(9_000.0), Vector3::repeat(9_001.0))],
        ..Room::default()
    };
    let error = kincal::planning::plan(&PlanRequest {
        set_ups: vec![SetUp {
            room: nowhere,
            ..one_set_up(30, 3)
        }],
        ..request
    })
    .unwrap_err();
    assert_eq!((error.found, error.wanted), (0, 30));
}

#[test]
fn the_last_poses_repeat_the_first_and_the_same_seed_gives_the_same_plan() {
    let robot = limited(paper_robot());
    let request = request(&robot);
    let (one, two) = (plan(&request).unwrap(), plan(&request).unwrap());
    assert_eq!(one, two);
    for (i, configuration) in one.configurations.iter().enumerate() {
        assert_eq!(configuration.repeats, i.checked_sub(27));
        if let Some(repeats) = configuration.repeats {
            assert_eq!(
                configuration.q_controller_rad,
                one.configurations[repeats].q_controller_rad
            );
        }
    }
    let other = plan(&PlanRequest { seed: 2, ..request }).unwrap();
    assert_ne!(one.configurations, other.configurations);
}

#[test]
fn what_was_measured_already_counts_and_is_not_measured_again() {
    let robot = limited(paper_robot());
    // An earlier session that hardly moved joints 4 to 6.
    let narrow: Vec<Observation> = poses(40, &mut Normal::new(60))
        .into_iter()
        .map(|q| Observation {
            q_rad: q
                .iter()
                .enumerate()
                .map(|(j, q)| if j < 3 { *q } else { 0.3 + 0.02 * q })
                .collect(),
            position_mm: Vector3::zeros(),
            target: 0,
            weight: 1.0,
            whitening: None,
            rotation: None,
            station: None,
        })
        .collect();
    let alone = plan(&PlanRequest {
        set_ups: vec![one_set_up(8, 0)],
        ..request(&robot)
    })
    .unwrap();
    let after = plan(&PlanRequest {
        set_ups: vec![one_set_up(8, 0)],
        measured: vec![narrow.clone()],
        ..request(&robot)
    })
    .unwrap();
    let rotated: Vec<Observation> = narrow
        .iter()
        .map(|o| Observation {
            rotation: Some(MeasuredRotation {
                rotation: nalgebra::Rotation3::from_euler_angles(0.1, 2.0, 0.3),
                mm_per_rad: 1.0,
                lever_mm: Vector3::zeros(),
            }),
            ..o.clone()
        })
        .collect();
    let after_poses = plan(&PlanRequest {
        set_ups: vec![one_set_up(8, 0)],
        measured: vec![rotated],
        // rotations that are known better than positions
        noise: Noise {
            position_std_mm: 0.05,
            rotation_std_rad: 1e-6,
        },
        ..request(&robot)
    })
    .unwrap();
    println!(
        "after 40 positions {:.4} mm, after 40 poses {:.4} mm",
        after.predicted[0].mean_mm, after_poses.predicted[0].mean_mm
    );
    assert!(after_poses.predicted[0].mean_mm < 0.9 * after.predicted[0].mean_mm);
    println!(
        "8 poses alone {:.4} mm, after 40 others {:.4} mm",
        alone.predicted[0].mean_mm, after.predicted[0].mean_mm
    );
    assert!(after.predicted[0].mean_mm < 0.8 * alone.predicted[0].mean_mm);
    assert_ne!(alone.configurations, after.configurations);
}

#[test]
fn robots_of_several_kinds_gain_by_planning() {
    let robots = crate::robots::models();
    for (name, robot) in robots {
        let robot = Robot {
            joint_limits_rad: vec![Some((-2.5, 2.5)); robot.links.len()],
            ..robot
        };
        let plan = plan(&PlanRequest {
            n_candidates: 1_000,
            ..request(&robot)
        })
        .unwrap();
        let gain = plan.predicted_random[0].mean_mm / plan.predicted[0].mean_mm;
        println!("{name}: {gain:.2} times");
        assert!(gain > 1.1, "{name}: {gain}");
    }
}

#[test]
fn even_as_few_poses_as_there_are_parameters_are_chosen_better_than_at_random() {
    let robot = limited(paper_robot());
    for n_configurations in [9, 10, 11, 12, 14] {
        let request = PlanRequest {
            set_ups: vec![one_set_up(n_configurations, 0)],
            ..request(&robot)
        };
        let planned = mean_std_mm(&request, &configurations(&plan(&request).unwrap()));
        let mut random: Vec<f64> = (0..9)
            .map(|seed| {
                mean_std_mm(
                    &request,
                    &random_configurations(&robot, n_configurations, 40 + seed),
                )
            })
            .collect();
        random.sort_by(f64::total_cmp);
        println!(
            "{n_configurations} poses: planned {planned:.4} mm, random {:.4} mm",
            random[4]
        );
        assert!(
            planned < random[4] / 1.5,
            "{n_configurations}: {planned} {}",
            random[4]
        );
    }
}

#[test]
fn the_arm_keeps_out_of_boxes_and_the_reflector_faces_the_instrument() {
    let robot = limited(paper_robot());
    let keep_out = [
        (
            Vector3::new(500.0, -1500.0, -500.0),
            Vector3::new(900.0, -100.0, 900.0),
        ),
        (
            Vector3::new(600.0, 300.0, 0.0),
            Vector3::new(700.0, 400.0, 2500.0),
        ),
    ];
    let instrument_mm = Vector3::new(3000.0, 800.0, 1200.0);
    let cone = AcceptanceCone {
        axis: Vector3::z(),
        half_angle_rad: 0.6,
    };
    let request = PlanRequest {
        set_ups: vec![SetUp {
            room: Room {
                keep_out_mm: keep_out.to_vec(),
                line_of_sight: Some(LineOfSight {
                    instrument_mm,
                    cone: Some(cone),
                }),
                ..Room::default()
            },
            ..one_set_up(20, 0)
        }],
        ..request(&robot)
    };
    let plan = plan(&request).unwrap();
    assert_eq!(plan.configurations.len(), 20);
    // densely sampled lines instead of the intersection formula
    let is_inside = |p: &Vector3<f64>| {
        keep_out
            .iter()
            .any(|(low, high)| (0..3).all(|k| low[k] < p[k] && p[k] < high[k]))
    };
    let mut nearest_in_front = f64::MAX;
    for q in configurations(&plan) {
        let flange = t_base_flange(&robot.links, &q);
        let target = (flange * nalgebra::Point3::from(request.target_mm)).coords;
        let corners: Vec<Vector3<f64>> = (2..=6)
            .map(|n| t_base_flange(&robot.links[..n], &q[..n]).translation.vector)
            .chain([target, instrument_mm])
            .collect();
        for pair in corners.windows(2) {
            for step in 0..=1000 {
                let p = pair[0].lerp(&pair[1], f64::from(step) / 1000.0);
                assert!(!is_inside(&p), "{p:?} of {q:?}");
            }
        }
        let direction = (instrument_mm - target).normalize();
        let angle = (flange.rotation * cone.axis).dot(&direction).acos();
        assert!(angle <= 0.6 + 1e-9, "{angle}");
        nearest_in_front = nearest_in_front.min(angle);
    }
    assert!(nearest_in_front < 0.5);
    // a beam that is thinner than the links: the arm meets it between its joints
    let beam = Room {
        keep_out_mm: vec![(
            Vector3::new(-2000.0, 780.0, 600.0),
            Vector3::new(2000.0, 800.0, 620.0),
        )],
        ..Room::default()
    };
    let meets_beam = |q: &[f64]| {
        let (low, high) = &beam.keep_out_mm[0];
        let corners = |n: usize| t_base_flange(&robot.links[..n], &q[..n]).translation.vector;
        (2..6).any(|n| {
            (0..=1000).any(|step| {
                let p = corners(n).lerp(&corners(n + 1), f64::from(step) / 1000.0);
                (0..3).all(|k| low[k] < p[k] && p[k] < high[k])
            })
        })
    };
    let random = poses(2000, &mut Normal::new(3));
    let met: Vec<&Vec<f64>> = random.iter().filter(|q| meets_beam(q)).collect();
    assert!(met.len() > 20, "{}", met.len());
    for q in met {
        assert!(!beam.holds(&robot, q, &Vector3::zeros()), "{q:?}");
    }
    let without = PlanRequest {
        set_ups: vec![one_set_up(20, 0)],
        ..request
    };
    let crosses = configurations(&kincal::planning::plan(&without).unwrap())
        .iter()
        .filter(|q| {
            let target =
                (t_base_flange(&robot.links, q) * nalgebra::Point3::from(request.target_mm)).coords;
            (0..=1000).any(|step| is_inside(&target.lerp(&instrument_mm, f64::from(step) / 1000.0)))
        })
        .count();
    assert!(crosses > 0, "the boxes restrict nothing");
}

/// Standard deviation of the tool in the frame of each set-up: one normal equation with a base for each set-up and everything else shared, and a
/// plain inverse. Rotations are differentiated numerically.
fn mean_std_of_set_ups_mm(request: &PlanRequest<'_>, plan: &Plan) -> Vec<f64> {
    let n_set_ups = request.set_ups.len();
    let mut parameters = complete_parameters(request.robot.links.len(), 1);
    let noise = request.noise;
    if request.is_of_poses {
        parameters.extend((0..3).map(|axis| Parameter::TargetRotation(0, axis)));
    }
    let (base, others): (Vec<Parameter>, Vec<Parameter>) = parameters.into_iter().partition(|p| {
        matches!(
            p,
            Parameter::BaseTranslation(_) | Parameter::BaseRotation(_)
        )
    });
    let all: Vec<Parameter> = base.iter().chain(&others).copied().collect();
    let scale = prior_scales(&all, reach_mm(&request.robot.links));
    let reference = KinematicModel {
        target_rotations: vec![nalgebra::Rotation3::identity()],
        ..model_of(request.robot, request.target_mm)
    };
    // central differences of position and rotation in units of prior scales
    let rows = |q: &[f64]| {
        let q = request.robot.q_model_rad(q);
        let rotation = reference.rotation(&q, 0).unwrap();
        let mut rows = DMatrix::zeros(6, all.len());
        for k in 0..all.len() {
            let at = |step: f64| {
                let mut deviation = vec![0.0; all.len()];
                deviation[k] = step * scale[k];
                let model = apply(&reference, &all, &deviation);
                let turn = rotation.inverse() * model.rotation(&q, 0).unwrap();
                (model.position(&q, 0), turn.scaled_axis())
            };
            let (h, (above, below)) = (1e-3, (at(1e-3), at(-1e-3)));
            rows.view_mut((0, k), (3, 1))
                .copy_from(&((above.0 - below.0) / (2.0 * h)));
            rows.view_mut((3, k), (3, 1))
                .copy_from(&((above.1 - below.1) / (2.0 * h)));
        }
        rows
    };
    let wide = |rows: &DMatrix<f64>, set_up: usize| {
        let mut wide = DMatrix::zeros(rows.nrows(), 6 * n_set_ups + others.len());
        wide.view_mut((0, 6 * set_up), (rows.nrows(), 6))
            .copy_from(&rows.columns(0, 6));
        wide.view_mut((0, 6 * n_set_ups), (rows.nrows(), others.len()))
            .copy_from(&rows.columns(6, others.len()));
        wide
    };
    let n = 6 * n_set_ups + others.len();
    let mut information = DMatrix::identity(n, n);
    for planned in &plan.configurations {
        let rows = wide(&rows(&planned.q_controller_rad), planned.set_up);
        let position = rows.rows(0, 3) / noise.position_std_mm;
        information += position.tr_mul(&position);
        if request.is_of_poses {
            let rotation = rows.rows(3, 3) / noise.rotation_std_rad;
            information += rotation.tr_mul(&rotation);
        }
    }
    let covariance = information.try_inverse().unwrap();
    let workspace = random_configurations(request.robot, 300, 987);
    let std = |set_up: usize, q: &Vec<f64>| {
        let rows = wide(&rows(q), set_up);
        let j = rows.rows(0, 3);
        (j * &covariance * j.transpose()).trace().sqrt()
    };
    (0..n_set_ups)
        .map(|set_up| workspace.iter().map(|q| std(set_up, q)).sum::<f64>() / 300.0)
        .collect()
}

#[test]
fn poses_and_several_set_ups_are_planned_as_one_problem() {
    let robot = limited(paper_robot());
    let half = |sign: f64| Room {
        boxes_mm: vec![(
            Vector3::new(-3000.0, f64::min(0.0, sign * 3000.0), -3000.0),
            Vector3::new(3000.0, f64::max(0.0, sign * 3000.0), 3000.0),
        )],
        ..Room::default()
    };
    let two = |n: usize| {
        [1.0, -1.0]
            .map(|sign| SetUp {
                room: half(sign),
                ..one_set_up(n, 2)
            })
            .to_vec()
    };
    for (name, set_ups, is_of_poses, n_combinations) in [
        ("poses", vec![one_set_up(12, 2)], true, 30),
        ("two set-ups", two(20), false, 27 + 6),
        ("two set-ups, poses", two(11), true, 30 + 6),
    ] {
        let request = PlanRequest {
            set_ups,
            n_candidates: 800,
            is_of_poses,
            ..request(&robot)
        };
        let plan = plan(&request).unwrap();
        assert_eq!(plan.n_combinations, n_combinations, "{name}");
        let again = kincal::planning::plan(&request).unwrap();
        assert_eq!(plan, again, "{name}");
        for (set_up, mean_mm) in mean_std_of_set_ups_mm(&request, &plan).iter().enumerate() {
            let (stated, random) = (
                plan.predicted[set_up].mean_mm,
                plan.predicted_random[set_up].mean_mm,
            );
            println!(
                "{name} {set_up}: stated {stated:.4} mm, {mean_mm:.4} mm, random {random:.4} mm"
            );
            assert!((stated / mean_mm - 1.0).abs() < 0.1, "{name}");
            assert!(stated < 0.85 * random, "{name}");
        }
        for planned in &plan.configurations {
            let flange = t_base_flange(&robot.links, &planned.q_controller_rad);
            let y = (flange * nalgebra::Point3::from(request.target_mm)).y;
            if request.set_ups.len() == 2 {
                assert!(if planned.set_up == 0 {
                    y >= 0.0
                } else {
                    y <= 0.0
                });
            }
            if let Some(repeats) = planned.repeats {
                let repeated = &plan.configurations[repeats];
                assert_eq!(repeated.set_up, planned.set_up, "{name}");
                assert_eq!(repeated.q_controller_rad, planned.q_controller_rad);
            }
        }
    }
}

#[test]
fn a_pose_tells_more_than_a_position_and_one_set_up_more_than_two() {
    let robot = limited(paper_robot());
    let mean = |set_ups: Vec<SetUp>, is_of_poses| {
        let request = PlanRequest {
            set_ups,
            n_candidates: 800,
            is_of_poses,
            ..request(&robot)
        };
        plan(&request).unwrap().predicted[0].mean_mm
    };
    let positions = mean(vec![one_set_up(36, 0)], false);
    let poses = mean(vec![one_set_up(36, 0)], true);
    let two = mean(vec![one_set_up(18, 0), one_set_up(18, 0)], false);
    println!("positions {positions:.4}, poses {poses:.4}, two set-ups {two:.4} mm");
    assert!(poses < 0.95 * positions);
    assert!(two > positions);
}
