//! Poses of a set that were visited several times: how well the robot returns to them, and how far they are from the model's prediction.

use crate::calibration::problem::Problem;
use crate::calibration::report::{PoseRepeatability, Repeatability};
use crate::calibration::validation::errors::RobotAtPoints;
use crate::identification::KinematicModel;
use crate::measurement::repeatability::{Visits, pooled_rp_mm, pooled_std_mm};
use crate::measurement::set::SAME_JOINT_RAD;
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Repeatability of points without outliers that were measured at the same joint values (to 0.05°), of the same target, in the same segment. `None`
/// if no pose was visited twice. `robot` is in the frame of the fit.
pub fn repeatability(
    problem: &Problem<'_>,
    model: &KinematicModel,
    robot: Option<RobotAtPoints<'_>>,
) -> Option<Repeatability> {
    let all = &problem.observed.all;
    let outliers: BTreeSet<usize> = problem.screening.outliers.iter().map(|w| w.row).collect();
    let mut of_label: BTreeMap<(&str, usize), Vec<Vec<usize>>> = BTreeMap::new();
    for row in (0..all.len()).filter(|row| !outliers.contains(row)) {
        let poses = of_label
            .entry((&problem.observed.configurations[row], all[row].target))
            .or_default();
        let same = |rows: &&mut Vec<usize>| {
            let (a, b) = (&all[rows[0]].q_rad, &all[row].q_rad);
            a.iter().zip(b).all(|(a, b)| (a - b).abs() < SAME_JOINT_RAD)
        };
        match poses.iter_mut().find(same) {
            Some(rows) => rows.push(row),
            None => poses.push(vec![row]),
        }
    }
    let mut groups: Vec<Vec<usize>> = of_label
        .into_values()
        .flatten()
        .filter(|rows| rows.len() > 1)
        .collect();
    groups.sort_unstable();
    let visits: Vec<Visits> = groups
        .iter()
        .filter_map(|rows| {
            Visits::of(&rows.iter().map(|r| all[*r].position_mm).collect::<Vec<_>>())
        })
        .collect();
    if visits.is_empty() {
        return None;
    }
    let with_corrections = robot.filter(|(robot, _)| robot.corrected.is_some());
    let pose = |(rows, visits): (&Vec<usize>, &Visits)| {
        let target = all[rows[0]].target;
        let off = |barycentre_mm: Vector3<f64>, position: &dyn Fn(&[f64]) -> Vector3<f64>| {
            let commanded = rows
                .iter()
                .map(|row| position(&all[*row].q_rad))
                .sum::<Vector3<f64>>()
                / rows.len() as f64;
            (barycentre_mm - commanded).norm()
        };
        let measured_mm = visits.barycentre_mm;
        let of_corrected = |(robot, points): RobotAtPoints<'_>| {
            let sum: Vector3<f64> = rows.iter().map(|row| points[*row].position_mm).sum();
            off(sum / rows.len() as f64, &|q| robot.position(q, target))
        };
        PoseRepeatability {
            configuration: problem.observed.configurations[rows[0]].clone(),
            name: problem.observed.names[rows[0]].clone(),
            target: problem.observed.targets[rows[0]],
            n: rows.len(),
            rows: rows.clone(),
            rp_mm: visits.rp_mm(),
            ap_before_mm: off(measured_mm, &|q| problem.nominal.position(q, target)),
            ap_after_mm: off(measured_mm, &|q| model.position(q, target)),
            ap_corrected_mm: with_corrections.map(of_corrected),
        }
    };
    let poses = groups.iter().zip(&visits).map(pose).collect();
    Some(Repeatability {
        n_poses: groups.len(),
        n_points: groups.iter().map(Vec::len).sum(),
        rp_mm: pooled_rp_mm(&visits),
        std_mm: pooled_std_mm(&visits),
        poses,
    })
}
