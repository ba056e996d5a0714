//! Checks whether a measurement set can be from this robot as stated. The nominal robot is fitted to the points. If it does not fit,
//! hypotheses are tried: another frame, makers' joint conventions, wrong units, columns or rows, and other robots. A set is refused if a
//! hypothesis fits several times better, or if none fits. An unmastered joint alone is no reason to refuse.

mod affine;
mod convention;
mod explanation;
mod fitting;
mod hypotheses;
mod joint_maps;
mod suspect;
mod texts;

pub use explanation::{BETTER, Explanation, FITS, NEAR_FIT_PER_REACH, Suspicion, UNMASTERED_RAD};
pub use hypotheses::{Hypothesis, hypotheses};

use crate::identification::KinematicModel;
use crate::identification::model::objective::{Observation, weighted_jacobian};
use crate::identification::model::parameters::placement_parameters;
use crate::kinematics::{Link, Robot};
use crate::measurement::{Frame, MeasurementSet, Point};
use explanation::{observations, of_one_station};
use fitting::{Zeroed, placed, placed_thoroughly, quickly_placed, reach_mm, with_free_zeros};
use nalgebra::{Matrix3, Rotation3, Vector3};
use suspect::{Cause, Suspect};

/// Whether the nominal robot fits an uploaded set, with the best placement of base and target.
#[derive(Clone, Debug, PartialEq)]
pub enum Alignment {
    /// It fits, or there are too few points for a decision.
    Fits,
    /// It does not fit: rms, mm.
    Misses(f64),
}

/// The base's rotation is known if its standard deviation is at most this, rad (0.5°).
const KNOWN_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Lower limit of a nominal robot's misfit, as a share of its reach.
const MIN_NOISE: f64 = 1e-4;

/// Code of the refusal of rotations that do not fit.
pub const ROTATION_SUSPECT: &str = "rotation_suspect";

/// Codes of refusals by suspicion. A caller may insist on the upload.
pub const SUSPICIONS: [&str; 7] = [
    "unit_suspect",
    "column_suspect",
    "frame_suspect",
    "joint_map_suspect",
    "robot_mismatch",
    "poor_alignment",
    ROTATION_SUSPECT,
];

/// Checks every upload.
pub fn align(robot: &Robot, set: &MeasurementSet) -> Alignment {
    let observations = observations(robot, &of_one_station(set));
    let fits_mm = FITS * reach_mm(&robot.links, &observations);
    let quick = quickly_placed(&robot.links, &observations, set.frame);
    if quick.as_ref().is_some_and(|found| found.rms_mm <= fits_mm) {
        return Alignment::Fits;
    }
    let thorough = placed_thoroughly(&robot.links, &observations, set.frame);
    match thorough.or(quick) {
        Some(found) if found.rms_mm > fits_mm => Alignment::Misses(found.rms_mm),
        _ => Alignment::Fits,
    }
}

/// Rotation of the base in the measuring frame, from the positions of one station alone. `None` if they do not determine it or do not fit the links.
pub(super) fn base_rotation(
    robot: &Robot,
    links: &[Link],
    points: &[Point],
    frame: Frame,
) -> Option<Rotation3<f64>> {
    let observations = observations(robot, points);
    let found = placed(links, &observations, frame)?;
    let reach_mm = reach_mm(links, &observations);
    let is_known = frame == Frame::Base || {
        let noise_mm = found.rms_mm.max(MIN_NOISE * reach_mm) / 3f64.sqrt();
        base_rotation_std_rad(&found.model, &observations, noise_mm)
            .is_some_and(|std| std <= KNOWN_RAD)
    };
    (found.rms_mm <= NEAR_FIT_PER_REACH * reach_mm && is_known)
        .then_some(found.model.t_instrument_base.rotation)
}

/// Standard deviation of the base's rotation about its least known axis, rad. `None` if the positions do not determine it.
fn base_rotation_std_rad(
    model: &KinematicModel,
    observations: &[Observation],
    noise_mm: f64,
) -> Option<f64> {
    let parameters = placement_parameters(model.targets_mm.len());
    let rows = weighted_jacobian(model, &parameters, observations, &Vector3::zeros());
    let covariance = rows.tr_mul(&rows).cholesky()?.inverse();
    let rotation: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into();
    Some(rotation.symmetric_eigenvalues().max().max(0.0).sqrt() * noise_mm)
}

/// The links with the joint zeros that fit the positions of one station best.
pub(super) fn links_with_fitted_zeros(
    robot: &Robot,
    points: &[Point],
    frame: Frame,
) -> Option<Vec<Link>> {
    let observations = observations(robot, points);
    let enough_mm = FITS * reach_mm(&robot.links, &observations);
    let zeros = with_free_zeros(&robot.links, &observations, frame, enough_mm)?;
    let mut links = robot.links.clone();
    for (link, offset_rad) in links.iter_mut().zip(&zeros.offsets_rad) {
        link.theta_offset_rad += offset_rad;
    }
    Some(links)
}

/// Explains a set that fits only to `off_mm`. `others` are robots that the set may have been measured on instead.
pub fn explain(
    robot: &Robot,
    set: &MeasurementSet,
    off_mm: f64,
    others: &[(String, Robot)],
) -> Explanation {
    let suspect = Suspect::new(robot, set, off_mm);
    let zeros = suspect.zeros(set.frame);
    let best = suspect.best_hypothesis(others);
    // No other hypothesis is blamed if unmastered joints explain the set nearly as well.
    let is_unmastered = |rms_mm: f64| {
        zeros.as_ref().is_some_and(|zeros| {
            zeros.rms_mm <= suspect.fits_mm
                && zeros.largest_rad() <= UNMASTERED_RAD
                && zeros.rms_mm < BETTER * rms_mm
        })
    };
    let explains = |rms_mm: f64| BETTER * rms_mm <= off_mm && !is_unmastered(rms_mm);
    let best = best.filter(|best| explains(best.rms_mm));
    let free = (set.frame == Frame::Base).then(|| suspect.in_another_frame());
    let free = free.flatten().filter(|free| explains(free.rms_mm));
    // A zero of joint 1 that is shifted by quarter turns is equivalent to a rotated frame. Frames are therefore tried before zeros.
    if let Some(best) = best.as_ref().filter(|best| best.rms_mm <= suspect.fits_mm)
        && !best.cause.is_turned()
    {
        let free = free.filter(|free| Suspect::are_equal(free, best));
        return match (&best.cause, free) {
            (Cause::Joints(convention), Some(free)) => suspect.frame_or_joints(&free, convention),
            _ => Explanation::Refusal(suspect.suspicion(best, others)),
        };
    }
    if let Some(free) = free {
        return suspect.frame(&free, "");
    }
    if let Some(best) = best.as_ref().filter(|best| best.rms_mm <= suspect.fits_mm) {
        // A frame that is rotated by quarter turns, together with an unmastered joint.
        let is_frame = set.frame == Frame::Base && best.cause.turns_first_joint();
        return is_frame
            .then(|| suspect.frame_and_joints())
            .flatten()
            .unwrap_or_else(|| Explanation::Refusal(suspect.suspicion(best, others)));
    }
    if let Some(found) = suspect
        .convention_and_zeros(set.frame)
        .filter(|found| explains(found.rms_mm))
    {
        return Explanation::Refusal(suspect.suspicion(&found, others));
    }
    if let Some(best) = best.filter(|best| best.rms_mm <= suspect.near_mm) {
        return Explanation::Refusal(suspect.suspicion(&best, others));
    }
    let comes_near =
        |zeros: &&Zeroed| zeros.rms_mm <= suspect.near_mm && BETTER * zeros.rms_mm <= off_mm;
    let near = zeros.as_ref().filter(comes_near);
    let is_usual = |zeros: &&Zeroed| zeros.largest_rad() <= UNMASTERED_RAD;
    near.filter(is_usual)
        .and_then(|zeros| suspect.unmastered(zeros))
        .or_else(|| {
            let is_base = set.frame == Frame::Base;
            is_base.then(|| suspect.frame_and_joints()).flatten()
        })
        .or_else(|| suspect.unmastered(near.filter(|zeros| zeros.rms_mm <= suspect.fits_mm)?))
        .unwrap_or_else(|| suspect.poor(zeros.as_ref()))
}
