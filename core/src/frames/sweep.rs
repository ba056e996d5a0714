//! The sweep of one joint: its points, checked, and their axis of rotation.

use crate::frames::circle_fit::fit_circle;
use crate::frames::error::Error;
use crate::kinematics::{Robot, reach_mm};
use crate::measurement::{MeasurementSet, Point};
use nalgebra::Vector3;

/// Shortest arc for finding an axis, rad (45°). The uncertainty of a circle's centre is noise / (1 − cos(arc/2)): thirteen times the noise
/// at 45°, and fifty times at 22°.
pub const MIN_ARC_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Minimum number of points of one sweep.
pub const MIN_SWEEP_POINTS: usize = 5;
/// Largest motion of the joints that must not move, rad (0.05°).
const STILL_RAD: f64 = 8.7e-4;
/// Maximum rms distance of the points from one circle, as a share of the reach. A joint that moves alone is more repeatable than this, so
/// points with a larger distance do not come from one joint.
const MAX_CIRCLE_RMS_PER_REACH: f64 = 2.5e-4;
/// Lower limit of that maximum, mm: the accuracy of instruments, which does not depend on the size of the arm.
const INSTRUMENT_RMS_MM: f64 = 0.5;
/// The measured arc may differ from the joint's by this much, rad (3°). An unmastered joint shifts an arc, but does not stretch it.
const ARC_MISMATCH_RAD: f64 = 0.052;

/// A sweep of one joint: the circle, and the model's joint values, rad.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// The fitted circle, its normal along the joint's positive axis.
    pub circle: SweepCircle,
    /// Joint values of the first point, rad; only the swept joint differs in the others.
    pub q_rad: Vec<f64>,
}

/// Finds, checks and fits the sweep of `joint` (1-based).
///
/// # Errors
/// No such sweep, too few points, another joint moved, too short an arc, or an arc that the joint did not make.
pub fn fit_sweep(robot: &Robot, set: &MeasurementSet, joint: usize) -> Result<Sweep, Error> {
    let points: Vec<&Point> = set
        .points
        .iter()
        .filter(|p| p.sweep_joint == Some(joint))
        .collect();
    if points.is_empty() {
        return Err(Error::MissingSweep { joint });
    }
    if points.len() < MIN_SWEEP_POINTS {
        return Err(Error::TooFewPoints {
            joint,
            found: points.len(),
            needed: MIN_SWEEP_POINTS,
        });
    }
    let mut swept: Vec<(Vec<f64>, Vector3<f64>)> = points
        .iter()
        .map(|p| (robot.q_model_rad(&p.q_rad), p.position_mm))
        .collect();
    swept.sort_by(|a, b| a.0[joint - 1].total_cmp(&b.0[joint - 1]));
    check_still(joint, &swept)?;
    let q_first = swept[0].0[joint - 1];
    let arc_rad = swept[swept.len() - 1].0[joint - 1] - q_first;
    if arc_rad < MIN_ARC_RAD {
        return Err(Error::ShortArc {
            joint,
            arc_deg: arc_rad.to_degrees(),
            needed_deg: MIN_ARC_RAD.to_degrees(),
        });
    }
    let positions: Vec<Vector3<f64>> = swept.iter().map(|(_, p)| *p).collect();
    let circle = fit_circle(joint, &positions)?;
    let limit_mm = (MAX_CIRCLE_RMS_PER_REACH * reach_mm(&robot.links)).max(INSTRUMENT_RMS_MM);
    if circle.rms_mm > limit_mm {
        return Err(Error::PoorCircle {
            joint,
            rms_mm: circle.rms_mm,
            limit_mm,
        });
    }
    let (normal, measured_arc_rad) = oriented(&positions, &circle.centre_mm, &circle.normal);
    if (measured_arc_rad - arc_rad).abs() > ARC_MISMATCH_RAD {
        return Err(Error::ArcMismatch {
            joint,
            arc_deg: arc_rad.to_degrees(),
            measured_deg: measured_arc_rad.to_degrees(),
        });
    }
    let circle = SweepCircle {
        joint,
        centre_mm: circle.centre_mm,
        normal,
        radius_mm: circle.radius_mm,
        rms_mm: circle.rms_mm,
    };
    Ok(Sweep {
        circle,
        q_rad: swept[0].0.clone(),
    })
}

fn check_still(joint: usize, swept: &[(Vec<f64>, Vector3<f64>)]) -> Result<(), Error> {
    for (q_rad, _) in swept {
        for (other, (q, q0)) in q_rad.iter().zip(&swept[0].0).enumerate() {
            if other + 1 != joint && (q - q0).abs() > STILL_RAD {
                return Err(Error::OtherJointMoved {
                    joint,
                    other: other + 1,
                });
            }
        }
    }
    Ok(())
}

/// The normal for positive rotation of the points in their order, and the angle that they cover, rad.
fn oriented(
    positions: &[Vector3<f64>],
    centre: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> (Vector3<f64>, f64) {
    let turn: f64 = positions
        .windows(2)
        .map(|pair| {
            let (from, to) = (pair[0] - centre, pair[1] - centre);
            libm::atan2(from.cross(&to).dot(normal), from.dot(&to))
        })
        .sum();
    if turn < 0.0 {
        (-normal, -turn)
    } else {
        (*normal, turn)
    }
}

/// A circle fitted to one sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepCircle {
    /// The joint that moved, 1-based.
    pub joint: usize,
    /// Centre in the instrument frame, mm.
    pub centre_mm: Vector3<f64>,
    /// Unit normal, along the joint's positive axis, instrument frame.
    pub normal: Vector3<f64>,
    /// Radius, mm.
    pub radius_mm: f64,
    /// Root mean square distance of the points from the circle, mm.
    pub rms_mm: f64,
}
