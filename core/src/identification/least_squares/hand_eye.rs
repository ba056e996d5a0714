//! Rotation of base and target in closed form from poses: R_measured = R_base · R_flange(q) · R_target, the rotation part of AX = ZB.
//!
//! With X = R_targetᵀ and Z = R_base, R_measured·X = Z·R_flange. Σ tr((R_measured·X)ᵀ·Z·R_flange) = vec(X)ᵀ·K·vec(Z) with K = Σ R_flangeᵀ ⊗
//! R_measuredᵀ. X and Z are the singular vectors of K's largest singular value, projected onto the rotations [Shah 2013, Journal of Mechanisms and
//! Robotics 5, 031007]. Three poses whose flanges are rotated about two axes are enough.

use crate::kinematics::rotation::{nearest_rotation, rotation_log};
use nalgebra::{Matrix3, Rotation3, SMatrix};

/// Iteration limit of the singular value decomposition.
const SVD_ITERATIONS: usize = 10_000;
/// A robust fit leaves out one of this many pairs.
const LEFT_OUT: usize = 4;
/// Maximum number of concentration steps; they converge in a few steps.
const CONCENTRATIONS: usize = 10;

/// Rotation of the base in the measuring frame, and of the target in the flange frame.
pub type BaseAndTarget = (Rotation3<f64>, Rotation3<f64>);

/// (Z, Xᵀ): base in the measuring frame and target in the flange frame. Each pair is a flange in the base frame and its target in the measuring
/// frame. `None` if the decomposition fails.
pub fn base_and_target_rotation(
    pairs: &[(Rotation3<f64>, Rotation3<f64>)],
) -> Option<BaseAndTarget> {
    let mut k = SMatrix::<f64, 9, 9>::zeros();
    for (flange, measured) in pairs {
        let (f, m) = (flange.matrix().transpose(), measured.matrix().transpose());
        k += f.kronecker(&m);
    }
    let svd = k.try_svd(true, true, f64::EPSILON, SVD_ITERATIONS)?;
    let largest = svd.singular_values.imax();
    let (u, v_t) = (svd.u?, svd.v_t?);
    let x = Matrix3::from_iterator(u.column(largest).iter().copied());
    let z = Matrix3::from_iterator(v_t.row(largest).iter().copied());
    // The sign of the singular vectors is arbitrary, but the same for both.
    let sign = z.determinant().signum();
    let (x, z) = (
        nearest_rotation(&(x * sign))?,
        nearest_rotation(&(z * sign))?,
    );
    Some((z, x.inverse()))
}

/// Angle between a measured target and its prediction, rad.
pub fn angle_rad(
    (base, target): &BaseAndTarget,
    (flange, measured): &(Rotation3<f64>, Rotation3<f64>),
) -> f64 {
    rotation_log(&((base * flange * target).inverse() * measured)).norm()
}

/// Applies `fit` to the three quarters of the pairs that it fits best, by concentration steps [Rousseeuw & Van Driessen 2006]. `None` if a
/// fit fails.
pub fn robustly(
    pairs: &[(Rotation3<f64>, Rotation3<f64>)],
    fit: impl Fn(&[(Rotation3<f64>, Rotation3<f64>)]) -> Option<BaseAndTarget>,
) -> Option<BaseAndTarget> {
    let n_kept = pairs.len() - pairs.len() / LEFT_OUT;
    let mut found = fit(pairs)?;
    for _ in 0..CONCENTRATIONS {
        let angles = pairs.iter().map(|pair| (angle_rad(&found, pair), *pair));
        let mut kept: Vec<_> = angles.collect();
        kept.sort_by(|a, b| a.0.total_cmp(&b.0));
        kept.truncate(n_kept);
        let kept: Vec<_> = kept.into_iter().map(|(_, pair)| pair).collect();
        let next = fit(&kept)?;
        if next == found {
            break;
        }
        found = next;
    }
    Some(found)
}

/// Rotation of a target in the flange frame for a given rotation of the base: the mean over its poses.
pub fn target_rotation(
    base: &Rotation3<f64>,
    pairs: &[(Rotation3<f64>, Rotation3<f64>)],
) -> Option<Rotation3<f64>> {
    let in_flange = |(flange, measured): &(Rotation3<f64>, Rotation3<f64>)| {
        *(flange.inverse() * base.inverse() * measured).matrix()
    };
    let sum: Matrix3<f64> = pairs.iter().map(in_flange).sum();
    if pairs.is_empty() {
        return None;
    }
    nearest_rotation(&sum)
}
