//! Weights of points that a known robot is placed on: for noise that differs between directions, and for poses.
//!
//! As in [`row_weights`](super::row_weights), the covariance of a position is the stated covariance plus s²·1. s is estimated from the
//! residuals of the placed robot along the axes of each point's noise. So all directions count nearly alike in the placement of a robot
//! that is far off. The variance of rotations is estimated in the same way.

use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::observe::{Observed, relative_weights};
use crate::calibration::preparation::row_weights::{uneven_noise, whiten};
use crate::calibration::preparation::screening::Outlier;
use crate::identification::KinematicModel;
use crate::identification::least_squares::problem::{USUAL_ANGLE_RAD, usual_length_mm};
use crate::identification::model::objective::residual_mm;
use crate::identification::model::pose_rows::rotation_residual_rad;
use crate::identification::statistics::variance::variance_over_usual;
use crate::kinematics::reach_mm;
use crate::measurement::{MeasurementSet, Point};
use nalgebra::IsometryMatrix3;

/// Minimum redundancy of rotations. With less, they keep their usual weight.
const MIN_FREEDOM: f64 = 10.0;

/// Weighs the points of `set` by the residuals of a model that was placed on them with `n_placed` fitted numbers. `observed` has the same points in
/// the same order. Outliers do not contribute to the noise estimate. Of the numbers that place poses, half are lengths and half are angles.
pub fn weigh_placed(
    set: &MeasurementSet,
    observed: &mut Observed,
    (arrangement, outliers): (&Arrangement, &[Outlier]),
    model: &KinematicModel,
    n_placed: usize,
) {
    let motion_of = |row: usize| arrangement.motions[arrangement.setups[row]];
    let usual_mm = usual_length_mm(reach_mm(&model.links));
    let usual_mm2 = usual_mm * usual_mm;
    let (mut terms, mut turned) = (Vec::new(), Vec::new());
    let mut n_trusted = 0;
    for (row, (point, o)) in set.points.iter().zip(&observed.all).enumerate() {
        if o.weight <= 0.0 || outliers.iter().any(|outlier| outlier.row == row) {
            continue;
        }
        n_trusted += 1;
        let predicted = model.rotation(&o.q_rad, o.target);
        if let Some((measured, predicted)) = o.rotation.as_ref().zip(predicted) {
            let square = rotation_residual_rad(&predicted, measured).norm_squared();
            let std_rad = point.std_rotation_rad.unwrap_or(0.0);
            turned.push((square, std_rad * std_rad, USUAL_ANGLE_RAD * USUAL_ANGLE_RAD));
        }
        let residual = residual_mm(model, o);
        match uneven_noise(point) {
            Some(noise) => {
                let measured = motion_of(row).rotation.inverse() * residual;
                let along = noise.axes.tr_mul(&measured);
                terms.extend((0..3).map(|axis| {
                    let std_mm = noise.std_mm[axis];
                    (along[axis] * along[axis], std_mm * std_mm, usual_mm2)
                }));
            }
            None => {
                let std_mm = point.position_std_mm().unwrap_or(0.0);
                terms.push((residual.norm_squared(), std_mm * std_mm, usual_mm2));
            }
        }
    }
    let n_angles = if turned.is_empty() { 0 } else { n_placed / 2 };
    let freedom = (3 * n_trusted) as f64 - (n_placed - n_angles) as f64;
    let beside_mm = variance_over_usual(&terms, freedom).sqrt() * usual_mm;
    let precision = |point: &Point| {
        let std_mm = point.position_std_mm().unwrap_or(0.0);
        1.0 / (std_mm * std_mm + beside_mm * beside_mm)
    };
    let precisions: Vec<f64> = set.points.iter().map(precision).collect();
    let weights = relative_weights(&precisions, |row| observed.all[row].weight > 0.0);
    let with_weight = observed.all.iter_mut().zip(weights);
    for (o, weight) in with_weight.filter(|(o, _)| o.weight > 0.0) {
        o.weight = weight;
    }
    let freedom = (3 * turned.len()) as f64 - n_angles as f64;
    if freedom >= MIN_FREEDOM {
        let beside_rad = variance_over_usual(&turned, freedom).sqrt() * USUAL_ANGLE_RAD;
        for (o, point) in observed.all.iter_mut().zip(&set.points) {
            let std_mm2 = 1.0 / precision(point);
            let std_rad = libm::hypot(point.std_rotation_rad.unwrap_or(0.0), beside_rad);
            if let Some(rotation) = &mut o.rotation {
                rotation.mm_per_rad = std_mm2.sqrt() / std_rad;
            }
        }
    }
    let to_measuring = IsometryMatrix3::identity();
    whiten(observed, set, beside_mm, &to_measuring, &motion_of);
}
