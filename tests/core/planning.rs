//! Pose plans, compared with random poses and with a plain second implementation; and their promises.

use crate::data::paper_robot;
use crate::simulation::{Normal, limited, poses};
use kincal::identification::identifiability::prior_scales;
use kincal::identification::objective::{Observation, weighted_jacobian};
use kincal::identification::parameters::complete_parameters;
use kincal::identification::workspace::random_configurations;
use kincal::identification::{KinematicModel, Model};
use kincal::kinematics::{Robot, reach_mm, t_base_flange};
use kincal::planning::{BaseCylinder, Plan, PlanRequest, Room, plan};
use nalgebra::{DMatrix, IsometryMatrix3, Vector3};

fn request(robot: &Robot) -> PlanRequest<'_> {
    PlanRequest {
        robot,
        model: Model::Complete,
        target_mm: Vector3::new(80.0, 0.0, 100.0),
        n_configurations: 30,
        n_repeats: 3,
        n_candidates: 2_000,
        noise_std_mm: 0.05,
        seed: 1,
        room: Room::default(),
        measured: vec![],
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
        };
        weighted_jacobian(
            &model,
            &parameters,
            &q.iter().map(observation).collect::<Vec<_>>(),
            &Vector3::zeros(),
        )
    };
    let measured = rows(chosen) / request.noise_std_mm;
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
        plan.predicted.mean_mm,
        random_mean / planned
    );
    assert!(
        (plan.predicted.mean_mm / planned - 1.0).abs() < 0.1,
        "{} {planned}",
        plan.predicted.mean_mm
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
    };
    let request = PlanRequest {
        room: room.clone(),
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
        room: nowhere,
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
        })
        .collect();
    let alone = plan(&PlanRequest {
        n_configurations: 8,
        n_repeats: 0,
        ..request(&robot)
    })
    .unwrap();
    let after = plan(&PlanRequest {
        n_configurations: 8,
        n_repeats: 0,
        measured: vec![narrow],
        ..request(&robot)
    })
    .unwrap();
    println!(
        "8 poses alone {:.4} mm, after 40 others {:.4} mm",
        alone.predicted.mean_mm, after.predicted.mean_mm
    );
    assert!(after.predicted.mean_mm < 0.8 * alone.predicted.mean_mm);
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
        let gain = plan.predicted_random.mean_mm / plan.predicted.mean_mm;
        println!("{name}: {gain:.2} times");
        assert!(gain > 1.1, "{name}: {gain}");
    }
}

#[test]
fn even_as_few_poses_as_there_are_parameters_are_chosen_better_than_at_random() {
    let robot = limited(paper_robot());
    for n_configurations in [9, 10, 11, 12, 14] {
        let request = PlanRequest {
            n_configurations,
            n_repeats: 0,
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
