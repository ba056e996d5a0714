//! Position errors of a robot at measured points.

use crate::calibration::point_errors::PointErrors;
use crate::calibration::preparation::observe::Observed;
use crate::calibration::report::{Errors, RotationErrors, RotationErrorsOfBoth, SubsetErrors};
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::model::objective::{Observation, residual_at_lever, residuals};
use crate::identification::model::pose_rows::rotation_residual_rad;
use crate::measurement::Subset;
use nalgebra::{Rotation3, Vector3};
use std::collections::BTreeSet;

/// Mean, standard deviation, rms and largest of |residual|; `None` for no points.
pub fn errors(model: &KinematicModel, observations: &[Observation]) -> Option<Errors> {
    statistics(
        &residuals(model, observations)
            .iter()
            .map(Vector3::norm)
            .collect::<Vec<f64>>(),
    )
}

/// A robot with corrections, and the points as they are placed for it.
pub type RobotAtPoints<'a> = (&'a IdentifiedRobot, &'a [Observation]);

/// Errors of a subset's points; `None` for no points.
pub fn of_subset(per_point: &[PointErrors], subset: Subset) -> Option<SubsetErrors> {
    let is_of_subset = |point: &&PointErrors| point.subset == subset;
    of_points(&per_point.iter().filter(is_of_subset).collect::<Vec<_>>())
}

/// Errors of the verify points without the named outliers (indices into `per_point`); `None` if none or all of them are outliers.
pub fn verify_without(
    per_point: &[PointErrors],
    outliers: &BTreeSet<usize>,
) -> Option<SubsetErrors> {
    let verify = (0..per_point.len()).filter(|i| per_point[*i].subset == Subset::Verify);
    let (named, others): (Vec<usize>, Vec<usize>) = verify.partition(|i| outliers.contains(i));
    let others: Vec<&PointErrors> = others.into_iter().map(|i| &per_point[i]).collect();
    (!named.is_empty()).then(|| of_points(&others)).flatten()
}

/// Errors of a subset's points that are not left out of comparisons; `None` for no points.
pub fn without_outliers(per_point: &[PointErrors], subset: Subset) -> Option<SubsetErrors> {
    let counts = |point: &&PointErrors| point.subset == subset && !point.is_outlier;
    of_points(&per_point.iter().filter(counts).collect::<Vec<_>>())
}

fn of_points(points: &[&PointErrors]) -> Option<SubsetErrors> {
    let sizes = |of: fn(&PointErrors) -> Option<f64>| -> Option<Errors> {
        let sizes: Option<Vec<f64>> = points.iter().map(|point| of(point)).collect();
        statistics(&sizes?)
    };
    Some(SubsetErrors {
        n_points: points.len(),
        before: sizes(|point| Some(point.before_mm))?,
        after: sizes(|point| Some(point.after_mm))?,
        corrected: sizes(|point| point.corrected_vector_mm.map(|v| v.norm())),
        rotation: rotations_of_points(points),
    })
}

/// Angle between the measured and the predicted target of each observation, rad; `None` for positions.
fn angles_rad(
    observations: &[Observation],
    rotation: impl Fn(&[f64], usize) -> Option<Rotation3<f64>>,
) -> Vec<Option<f64>> {
    let angle = |o: &Observation| {
        let predicted = rotation(&o.q_rad, o.target)?;
        Some(rotation_residual_rad(&predicted, o.rotation.as_ref()?).norm())
    };
    observations.iter().map(angle).collect()
}

/// Rotation errors of the points' poses; `None` if no pose was measured.
fn rotations_of_points(points: &[&PointErrors]) -> Option<RotationErrorsOfBoth> {
    let statistics = |which: usize| {
        let angles = points.iter().filter_map(|point| point.rotation_rad);
        let angles: Vec<f64> = angles.map(|all| all[which]).collect();
        let n = angles.len() as f64;
        (!angles.is_empty()).then(|| RotationErrors {
            mean_deg: (angles.iter().sum::<f64>() / n).to_degrees(),
            rms_deg: (angles.iter().map(|a| a * a).sum::<f64>() / n)
                .sqrt()
                .to_degrees(),
            max_deg: angles.iter().fold(0.0f64, |m, a| m.max(*a)).to_degrees(),
        })
    };
    let is_corrected = points.iter().any(|point| point.is_corrected());
    Some(RotationErrorsOfBoth {
        n_poses: points.iter().filter(|p| p.rotation_rad.is_some()).count(),
        before: statistics(0)?,
        after: statistics(1)?,
        corrected: is_corrected.then(|| statistics(2)).flatten(),
    })
}

fn statistics(sizes: &[f64]) -> Option<Errors> {
    if sizes.is_empty() {
        return None;
    }
    let n = sizes.len() as f64;
    let mean_mm = sizes.iter().sum::<f64>() / n;
    let rms_mm = (sizes.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
    let std_mm = (sizes
        .iter()
        .map(|e| (e - mean_mm) * (e - mean_mm))
        .sum::<f64>()
        / n)
        .sqrt();
    Some(Errors {
        mean_mm,
        std_mm,
        rms_mm,
        max_mm: sizes.iter().fold(0.0, |m, e| m.max(*e)),
    })
}

/// Errors of every point before, after, and with corrections. Each of the robots has the points as they are placed for it.
pub fn per_point(
    (observed, before): (&Observed, &KinematicModel),
    (observed_after, after): (&Observed, &KinematicModel),
    robot: Option<RobotAtPoints<'_>>,
) -> Vec<PointErrors> {
    let (angles_before, angles_after) = (
        angles_rad(&observed.all, |q, target| before.rotation(q, target)),
        angles_rad(&observed_after.all, |q, target| after.rotation(q, target)),
    );
    let with_corrections = robot.filter(|(robot, _)| robot.corrected.is_some());
    let corrected_angles = with_corrections
        .map(|(robot, points)| angles_rad(points, |q, target| robot.rotation(q, target)));
    let angle = |i: usize| {
        let (before, after) = (angles_before[i]?, angles_after[i]?);
        let corrected = corrected_angles.as_ref().and_then(|angles| angles[i]);
        Some([before, after, corrected.unwrap_or(after)])
    };
    let (before, after) = (
        residuals(before, &observed.all),
        residuals(after, &observed_after.all),
    );
    let corrected = |i: usize| {
        robot.map(|(robot, points)| {
            if robot.corrected.is_some() {
                let o = &points[i];
                let left = o.position_mm - robot.position(&o.q_rad, o.target);
                residual_at_lever(left, robot.rotation(&o.q_rad, o.target).as_ref(), o)
            } else {
                after[i]
            }
        })
    };
    (0..observed.all.len())
        .map(|i| PointErrors {
            configuration: observed.configurations[i].clone(),
            name: observed.names[i].clone(),
            target: observed.targets[i],
            subset: observed.subsets[i],
            before_mm: before[i].norm(),
            after_mm: after[i].norm(),
            position_mm: observed.positions_mm[i],
            before_vector_mm: before[i],
            after_vector_mm: after[i],
            corrected_vector_mm: corrected(i),
            rotation_rad: angle(i),
            is_outlier: false,
        })
        .collect()
}
