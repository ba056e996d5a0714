//! The region in which the robot may move during the measurement.

use crate::kinematics::Robot;
use crate::kinematics::forward::t_previous_link;
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Allowed boxes and forbidden obstacles, in the base frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Room {
    /// The target has to be in one of these boxes (lowest and highest corner, mm). Without boxes it may be anywhere.
    pub boxes_mm: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// No checked point may be below this, mm.
    pub floor_z_mm: Option<f64>,
    /// No checked point may be inside this.
    pub base_cylinder: Option<BaseCylinder>,
}

/// The robot's own foot: an upright cylinder about the base's z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseCylinder {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Its top, mm above the base's origin.
    pub height_mm: f64,
}

impl Room {
    /// True if the target is in a box, and if target, flange, wrist and elbow (the origins of link 3 and of those after it) are clear of floor and
    /// foot. The bodies between these points are not checked.
    pub fn holds(&self, robot: &Robot, q_controller_rad: &[f64], target_mm: &Vector3<f64>) -> bool {
        let mut t = IsometryMatrix3::identity();
        for (i, (link, q)) in robot
            .links
            .iter()
            .zip(robot.q_model_rad(q_controller_rad))
            .enumerate()
        {
            t *= t_previous_link(link, q);
            if i >= 2 && !self.is_clear(&t.translation.vector) {
                return false;
            }
        }
        let target = (t * Point3::from(*target_mm)).coords;
        let within = |(low, high): &(Vector3<f64>, Vector3<f64>)| {
            (0..3).all(|k| (low[k]..=high[k]).contains(&target[k]))
        };
        self.is_clear(&target) && (self.boxes_mm.is_empty() || self.boxes_mm.iter().any(within))
    }

    fn is_clear(&self, p: &Vector3<f64>) -> bool {
        let above = self.floor_z_mm.is_none_or(|floor| p.z >= floor);
        let beside = |foot: BaseCylinder| {
            p.z >= foot.height_mm || p.x * p.x + p.y * p.y >= foot.radius_mm * foot.radius_mm
        };
        above && self.base_cylinder.is_none_or(beside)
    }
}

/// The same draw, shifted towards the joint limits (arcsine distribution).
pub fn towards_limits(robot: &Robot, q: Vec<f64>) -> Vec<f64> {
    let pushed = |(q, limits): (f64, &Option<(f64, f64)>)| {
        let (low, high) = limits.map_or((-FRAC_PI_2, FRAC_PI_2), |(low, high)| {
            (low.max(-PI), high.min(PI))
        });
        if low >= high {
            return q;
        }
        let share = ((q - low) / (high - low)).clamp(0.0, 1.0);
        low + (high - low) * 0.5 * (1.0 - libm::cos(PI * share))
    };
    q.into_iter()
        .zip(&robot.joint_limits_rad)
        .map(pushed)
        .collect()
}
