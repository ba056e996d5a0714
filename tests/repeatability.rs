//! RP and AP of ISO 9283, against numbers computed by hand, and in a report.

#[path = "support/data.rs"]
mod data;
#[path = "support/simulation.rs"]
mod simulation;

use data::paper_robot;
use kincal::calibration::{CalibrationRequest, calibrate};
use kincal::measurement::repeatability::{Visits, pooled_rp_mm, pooled_std_mm};
use nalgebra::Vector3;
use simulation::{Campaign, Normal, measure, poses, true_robot};
use std::ops::ControlFlow;

#[test]
fn rp_is_what_a_pencil_says() {
    // distances from the barycentre (100, 0, 0): 3, 3, 0 and 4, 4, 4 about (0, 50, 0)
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
    // mean 2, squares of deviations 1 + 1 + 4 over 2
    assert!(
        (first.mean_distance_mm - 2.0).abs() < 1e-12
            && (first.std_distance_mm - 3f64.sqrt()).abs() < 1e-12
    );
    assert!((first.rp_mm() - 7.196_152_422_706_632).abs() < 1e-12);
    let second =
        Visits::of(&[Vector3::new(4.0, 50.0, 0.0), Vector3::new(-4.0, 50.0, 0.0)]).unwrap();
    assert_eq!(second.rp_mm(), 4.0);
    // together: mean (3·2 + 2·4)/5 = 2.8, variance (2·3 + 1·0)/3 = 2; coordinate (18 + 32)/(3·3)
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
    // five poses again, nine times each
    for k in 0..9 {
        visited.extend((0..5).map(|pose| visited[pose].clone()).collect::<Vec<_>>());
        assert_eq!(visited.len(), 45 + 5 * k);
    }
    let campaign = Campaign {
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    let mut set = measure(&truth, &visited, &campaign, &mut random);
    // the same joints are the same configuration
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
    // 45 · 3 / 5 · 5 degrees of freedom: 0.05 mm to a tenth or so
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
    // AP: the barycentre against the identified robot, by another way
    let found = simulation::found(&report);
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
    // no pose twice: no figures
    set.points.truncate(40);
    assert!(run(set).repeatability.is_none());
}
