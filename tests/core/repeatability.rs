//! RP and AP of ISO 9283, compared with numbers computed by hand, and in a report.

use crate::data::paper_robot;
use crate::simulation::{Campaign, Normal, measure, poses, true_robot};
use kincal::calibration::{CalibrationRequest, calibrate, is_anew, repeats};
use kincal::measurement::MeasurementSet;
use kincal::measurement::repeatability::{Visits, pooled_rp_mm, pooled_std_mm};
use nalgebra::{Rotation3, Vector3};
use std::ops::ControlFlow;

#[test]
fn rp_is_what_a_pencil_says() {
    // Distances from the barycentre (100, 0, 0): 3, 3, 0; and from (0, 50, 0): 4, 4, 4.
    let first = Visits::of(&[
        Vector3::new(103.0, 0.0, 0.0),
        Vector3::new(97.0, 0.0, 0.0),
        Vector3::new(100.0, 0.0, 0.0),
    ])
    .unwrap();
    assert_eq!(
        (first.n, first.barycentre_mm),
        (3, Vector3::new(100.0, 0.0, 0.0))
    );
    // Mean 2, squares of deviations 1 + 1 + 4 over 2.
    assert!(
        (first.mean_distance_mm - 2.0).abs() < 1e-12
            && (first.std_distance_mm - 3f64.sqrt()).abs() < 1e-12
    );
    assert!((first.rp_mm() - 7.196_152_422_706_632).abs() < 1e-12);
    let second =
        Visits::of(&[Vector3::new(4.0, 50.0, 0.0), Vector3::new(-4.0, 50.0, 0.0)]).unwrap();
    assert_eq!(second.rp_mm(), 4.0);
    // Together: mean (3·2 + 2·4)/5 = 2.8, variance (2·3 + 1·0)/3 = 2; one coordinate (18 + 32)/(3·3).
    assert!((pooled_rp_mm(&[first, second]) - (2.8 + 3.0 * 2f64.sqrt())).abs() < 1e-12);
    assert!((pooled_std_mm(&[first, second]) - (50.0f64 / 9.0).sqrt()).abs() < 1e-12);
    assert!(Visits::of(&[Vector3::zeros()]).is_none());
}

#[test]
fn a_report_has_the_figures_of_revisited_poses() {
    let mut random = Normal::new(4);
    let nominal = paper_robot();
    let truth = true_robot(&nominal, 1, &mut random);
    let mut visited = poses(40, &mut random);
    // Five poses, nine times each.
    for k in 0..9 {
        visited.extend((0..5).map(|pose| visited[pose].clone()).collect::<Vec<_>>());
        assert_eq!(visited.len(), 45 + 5 * k);
    }
    let campaign = Campaign {
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    let mut set = measure(&truth, &visited, &campaign, &mut random);
    // The same joint values are the same configuration.
    (0..set.points.len())
        .skip(40)
        .for_each(|row| set.points[row].configuration = format!("c{}", row % 5));
    let run = |set| {
        calibrate(&CalibrationRequest::new(nominal.clone(), set), &mut |_| {
            ControlFlow::Continue(())
        })
        .unwrap()
    };
    let report = run(set.clone());
    let repeatability = report.repeatability.clone().unwrap();
    assert_eq!(repeatability.poses.len(), 5);
    assert!(repeatability.poses.iter().all(|pose| pose.rows.len() == 10));
    assert_eq!(repeatability.poses[2].rows[..3], [2, 42, 47]);
    // 45 · 3 / 5 · 5 degrees of freedom: 0.05 mm to about a tenth.
    assert!(
        (repeatability.std_mm - 0.05).abs() < 0.01,
        "{}",
        repeatability.std_mm
    );
    let positions: Vec<Vector3<f64>> = repeatability.poses[1]
        .rows
        .iter()
        .map(|row| set.points[*row].position_mm)
        .collect();
    let visits = Visits::of(&positions).unwrap();
    assert!((repeatability.poses[1].rp_mm - visits.rp_mm()).abs() < 1e-12);
    // AP: the distance of the barycentre from the identified robot, computed another way.
    let found = crate::simulation::found(&report);
    let off = (visits.barycentre_mm - found.position(&visited[1], 0)).norm();
    assert!(
        (repeatability.poses[1].ap_after_mm - off).abs() < 1e-9,
        "{off}"
    );
    assert!(
        repeatability
            .poses
            .iter()
            .all(|pose| pose.ap_after_mm < 0.1 && pose.ap_before_mm > pose.ap_after_mm)
    );
    // Without repeated poses there are no figures.
    set.points.truncate(40);
    assert!(run(set).repeatability.is_none());
}

/// The set in the frame of an instrument at another place, with positions rounded to 0.001 mm.
fn carried(set: &MeasurementSet) -> MeasurementSet {
    let turn = Rotation3::from_euler_angles(0.01, -0.02, 0.7);
    let mut set = set.clone();
    for point in &mut set.points {
        let moved = turn * point.position_mm + Vector3::new(900.0, -300.0, 50.0);
        point.position_mm = moved.map(|x| (x * 1e3).round() / 1e3);
    }
    set
}

fn noisy(set: &MeasurementSet, std_mm: f64, random: &mut Normal) -> MeasurementSet {
    let mut set = set.clone();
    let noisy = |point: &mut kincal::measurement::Point| {
        point.position_mm += random.vector() * std_mm;
    };
    set.points.iter_mut().for_each(noisy);
    set
}

#[test]
fn a_session_at_the_same_joint_values_is_told_from_a_copy_by_its_noise_wherever_the_instrument_stands()
 {
    let nominal = paper_robot();
    for seed in 0..8 {
        let mut random = Normal::new(seed);
        let truth = true_robot(&nominal, 1, &mut random);
        let poses = poses(40, &mut random);
        let mut session = || measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        let (first, second) = (session(), session());
        assert!(is_anew(&nominal, &first, &second), "measured anew: {seed}");
        assert!(is_anew(&nominal, &first, &carried(&second)), "{seed}");
        for std_mm in [0.0, 0.001, 0.01, 0.03, 0.1, 0.3] {
            let copy = noisy(&first, std_mm, &mut random);
            for (copy, what) in [(carried(&copy), "carried"), (copy, "in place")] {
                assert!(!is_anew(&nominal, &first, &copy), "{std_mm} mm, {what}");
                assert!(!is_anew(&nominal, &copy, &first), "{std_mm} mm, {what}");
            }
        }
    }
}

#[test]
fn a_session_with_its_reflector_mounted_again_is_told_from_a_copy_whose_positions_were_displaced_like_that()
 {
    let nominal = paper_robot();
    for seed in 0..8 {
        let mut random = Normal::new(100 + seed);
        let truth = true_robot(&nominal, 1, &mut random);
        let poses = poses(40, &mut random);
        let first = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        for displaced_mm in [0.03, 0.3, 1.0] {
            let by = Vector3::new(0.6, -0.8, 0.5) * displaced_mm;
            let mut mounted_again = truth.clone();
            mounted_again.targets_mm[0] += by;
            let second = measure(&mounted_again, &poses, &Campaign::PLAIN, &mut random);
            assert!(
                is_anew(&nominal, &first, &second),
                "{displaced_mm} mm, seed {seed}"
            );
            let mut copy = noisy(&first, 0.02, &mut random);
            for point in &mut copy.points {
                let q_rad = nominal.q_model_rad(&point.q_rad);
                let moved = mounted_again.position(&q_rad, 0) - truth.position(&q_rad, 0);
                point.position_mm += moved;
            }
            assert!(
                !is_anew(&nominal, &first, &copy),
                "{displaced_mm} mm, seed {seed}"
            );
        }
    }
}

/// Every pose was measured twice, in one upload or in two. What repeats one of both measurements of each pose is no new one.
#[test]
fn a_copy_of_one_of_several_visits_of_each_pose_is_no_new_session() {
    let nominal = paper_robot();
    let joined = |first: &MeasurementSet, second: &MeasurementSet| {
        let mut both = first.clone();
        both.points.extend(second.points.iter().cloned());
        both
    };
    for seed in 0..8 {
        let mut random = Normal::new(300 + seed);
        let truth = true_robot(&nominal, 1, &mut random);
        let poses = poses(60, &mut random);
        let mut session = || measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        let (first, second, new) = (session(), session(), session());
        let both = joined(&first, &second);
        let mut mixed = first.clone();
        for row in (0..60).step_by(2) {
            mixed.points[row] = second.points[row].clone();
        }
        let apart = [first.clone(), second.clone()];
        for (copy, what) in [(&both, "joined"), (&mixed, "mixed"), (&second, "second")] {
            for copy in [copy.clone(), carried(copy)] {
                for earlier in [std::slice::from_ref(&both), &apart] {
                    assert!(repeats(&nominal, earlier, &copy), "{what}, seed {seed}");
                }
            }
        }
        let newer = joined(&new, &session());
        for new in [&new, &newer] {
            for earlier in [std::slice::from_ref(&both), &apart] {
                assert!(!repeats(&nominal, earlier, new), "seed {seed}");
            }
        }
        // the more visits there are, the nearer is one of them by chance
        let many: Vec<MeasurementSet> = (0..20).map(|_| session()).collect();
        assert!(!repeats(&nominal, &many, &new), "seed {seed}");
    }
}

/// Rounded numbers of two measurements may be equal, and where a robot has changed, the differences are a smooth field.
#[test]
fn sessions_with_coarse_numbers_and_of_a_changed_robot_are_new() {
    let nominal = paper_robot();
    for seed in 0..8 {
        let mut random = Normal::new(500 + seed);
        let truth = true_robot(&nominal, 1, &mut random);
        let poses = poses(60, &mut random);
        let rounded = |mut set: MeasurementSet, step_mm: f64| {
            for point in &mut set.points {
                point.position_mm = point.position_mm.map(|x| (x / step_mm).round() * step_mm);
            }
            set
        };
        let first = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        let second = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        let [before, after] = [&first, &second].map(|set| rounded(set.clone(), 0.1));
        assert!(is_anew(&nominal, &before, &after), "0.1 mm, seed {seed}");
        for (joint, deg) in [(1, 0.1), (1, 0.5), (2, 0.2)] {
            let mut changed = truth.clone();
            changed.links[joint].theta_offset_rad += f64::to_radians(deg);
            let after = measure(&changed, &poses, &Campaign::PLAIN, &mut random);
            assert!(
                is_anew(&nominal, &first, &after),
                "joint {joint}, {deg}°, seed {seed}"
            );
        }
    }
}

/// Positions are converted to another temperature by a common factor.
#[test]
fn another_scale_makes_no_new_session_of_a_copy() {
    let nominal = paper_robot();
    for seed in 0..6 {
        let mut random = Normal::new(700 + seed);
        let truth = true_robot(&nominal, 1, &mut random);
        let poses = poses(40, &mut random);
        let first = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        for scale in [1.0002, 0.9997, 1.0003, 1.002] {
            for std_mm in [0.0, 0.02] {
                let mut copy = noisy(&first, std_mm, &mut random);
                for point in &mut copy.points {
                    point.position_mm *= scale;
                }
                for copy in [carried(&copy), copy] {
                    assert!(!is_anew(&nominal, &first, &copy), "{scale}, {std_mm} mm");
                }
            }
        }
        let second = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        assert!(is_anew(&nominal, &first, &second), "{seed}");
    }
}

#[test]
fn a_joint_that_does_not_move_the_reflector_makes_no_new_pose_of_a_copy() {
    let nominal = paper_robot();
    let mut random = Normal::new(3);
    let mut truth = true_robot(&nominal, 1, &mut random);
    truth.targets_mm[0] = Vector3::new(0.0, 0.0, 110.0);
    let poses = poses(40, &mut random);
    let first = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
    for turned_deg in [0.03f64, 1.0, 90.0] {
        let mut copy = noisy(&first, 0.02, &mut random);
        let turn = |point: &mut kincal::measurement::Point| {
            point.q_rad[5] += turned_deg.to_radians();
        };
        copy.points.iter_mut().for_each(turn);
        assert!(!is_anew(&nominal, &first, &copy), "{turned_deg}°");
    }
    let session = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
    assert!(is_anew(&nominal, &first, &session));
}

/// The set with constants added to the values of the first and the last joint, degrees.
fn turned(set: &MeasurementSet, [first_deg, last_deg]: [f64; 2]) -> MeasurementSet {
    let mut set = set.clone();
    for point in &mut set.points {
        point.q_rad[0] += first_deg.to_radians();
        point.q_rad[5] += last_deg.to_radians();
    }
    set
}

#[test]
fn a_constant_on_the_first_or_the_last_joint_makes_no_new_session_of_a_copy() {
    let nominal = paper_robot();
    let constants = [[0.05, 0.0], [7.0, 0.0], [0.0, 30.0], [-120.0, 200.0]];
    for seed in 0..4 {
        let mut random = Normal::new(seed);
        let truth = true_robot(&nominal, 1, &mut random);
        let poses = poses(40, &mut random);
        let first = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
        for constants in constants {
            for std_mm in [0.0, 0.02, 0.1] {
                let copy = turned(&noisy(&first, std_mm, &mut random), constants);
                for copy in [carried(&copy), copy] {
                    let what = format!("{constants:?}, {std_mm} mm");
                    assert!(!is_anew(&nominal, &first, &copy), "{what}");
                    assert!(!is_anew(&nominal, &copy, &first), "{what}");
                }
            }
            // Other rows of the file, in another order, are no less a copy.
            let mut copy = turned(&noisy(&first, 0.02, &mut random), constants);
            copy.points.reverse();
            copy.points.truncate(25);
            assert!(!is_anew(&nominal, &first, &copy), "{constants:?}");
        }
        // The same program, turned about joint 1 and measured anew, shows its own noise.
        let turned_poses: Vec<Vec<f64>> = poses
            .iter()
            .map(|q| [&[q[0] + 0.1], &q[1..]].concat())
            .collect();
        let second = measure(&truth, &turned_poses, &Campaign::PLAIN, &mut random);
        assert!(is_anew(&nominal, &first, &second), "{seed}");
    }
}
