//! The region in which the robot may move during the measurement.

use crate::identification::statistics::workspace::within_a_turn;
use crate::kinematics::Robot;
use crate::kinematics::forward::t_previous_link;
use nalgebra::{IsometryMatrix3, Point3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// A box along the axes of the base frame: lowest and highest corner, mm.
pub type AlignedBox = (Vector3<f64>, Vector3<f64>);

/// Allowed boxes, obstacles and line of sight, in the base frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Room {
    /// The target has to be in one of these boxes. Without boxes it may be anywhere.
    pub boxes_mm: Vec<AlignedBox>,
    /// Boxes to keep out of. The straight lines from the axis of joint 2 over the link origins and the flange to the target must not enter
    /// them.
    pub keep_out_mm: Vec<AlignedBox>,
    /// No checked point may be below this height, mm.
    pub floor_z_mm: Option<f64>,
    /// No checked point may be inside this cylinder.
    pub base_cylinder: Option<BaseCylinder>,
    /// The instrument must see the target.
    pub line_of_sight: Option<LineOfSight>,
}

/// The robot's own foot: an upright cylinder about the base's z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseCylinder {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Its top, mm above the base's origin.
    pub height_mm: f64,
}

/// The position of the instrument, and the directions from which its target can be measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineOfSight {
    /// The instrument in the base frame, mm.
    pub instrument_mm: Vector3<f64>,
    /// The target's acceptance cone. Without it, the target can be measured from every direction.
    pub cone: Option<AcceptanceCone>,
}

/// The directions from which a target can be measured: a cone about an axis of the flange frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AcceptanceCone {
    /// Unit vector from the target outwards, in the flange frame.
    pub axis: Vector3<f64>,
    /// Largest angle between this axis and the direction to the instrument, rad.
    pub half_angle_rad: f64,
}

impl Room {
    /// True if the configuration is allowed. The target must be in a box and seen by the instrument. Target, flange, wrist and elbow (the
    /// origins of link 3 and of those after it) must be clear of floor and foot. The lines between these points must not enter the boxes to
    /// keep out of. Bodies have no thickness here.
    pub fn holds(&self, robot: &Robot, q_controller_rad: &[f64], target_mm: &Vector3<f64>) -> bool {
        let mut t = IsometryMatrix3::identity();
        let mut before: Option<Vector3<f64>> = None;
        let mut is_outside = |p: &Vector3<f64>| {
            let from = before.replace(*p).unwrap_or(*p);
            !self.keep_out_mm.iter().any(|b| meets(&from, p, b))
        };
        for (i, (link, q)) in robot
            .links
            .iter()
            .zip(robot.q_model_rad(q_controller_rad))
            .enumerate()
        {
            t *= t_previous_link(link, q);
            let origin = t.translation.vector;
            if i >= 1 && !is_outside(&origin) || i >= 2 && !self.is_clear(&origin) {
                return false;
            }
        }
        let target = (t * Point3::from(*target_mm)).coords;
        is_outside(&target)
            && self.is_clear(&target)
            && (self.boxes_mm.is_empty() || self.boxes_mm.iter().any(|b| is_within(&target, b)))
            && self.is_seen(&target, &t)
    }

    fn is_clear(&self, p: &Vector3<f64>) -> bool {
        let above = self.floor_z_mm.is_none_or(|floor| p.z >= floor);
        let beside = |foot: BaseCylinder| {
            p.z >= foot.height_mm || p.x * p.x + p.y * p.y >= foot.radius_mm * foot.radius_mm
        };
        above && self.base_cylinder.is_none_or(beside)
    }

    /// True if the target faces the instrument and none of the boxes to keep out of is in between. The robot itself is not checked.
    fn is_seen(&self, target: &Vector3<f64>, t_base_flange: &IsometryMatrix3<f64>) -> bool {
        let Some(sight) = &self.line_of_sight else {
            return true;
        };
        let faces = |cone: AcceptanceCone| {
            let axis = t_base_flange.rotation * cone.axis;
            let direction = sight.instrument_mm - target;
            axis.dot(&direction) >= direction.norm() * libm::cos(cone.half_angle_rad)
        };
        sight.cone.is_none_or(faces)
            && !self.keep_out_mm.iter().any(|b| {
                meets(target, &sight.instrument_mm, b) && !is_within(&sight.instrument_mm, b)
            })
    }
}

fn is_within(p: &Vector3<f64>, (low, high): &AlignedBox) -> bool {
    (0..3).all(|k| (low[k]..=high[k]).contains(&p[k]))
}

/// True if the straight line between two points enters the box: the parts of the line between the faces of each axis overlap.
fn meets(from: &Vector3<f64>, to: &Vector3<f64>, (low, high): &AlignedBox) -> bool {
    let (mut first, mut last) = (0.0f64, 1.0f64);
    for k in 0..3 {
        let way = to[k] - from[k];
        if way == 0.0 {
            if !(low[k]..=high[k]).contains(&from[k]) {
                return false;
            }
            continue;
        }
        let (a, b) = ((low[k] - from[k]) / way, (high[k] - from[k]) / way);
        first = first.max(a.min(b));
        last = last.min(a.max(b));
    }
    first <= last
}

/// The same draw, shifted towards the joint limits (arcsine distribution).
pub fn towards_limits(robot: &Robot, q: Vec<f64>) -> Vec<f64> {
    let pushed = |(q, limits): (f64, &Option<(f64, f64)>)| {
        let (low, high) = limits.map_or((-FRAC_PI_2, FRAC_PI_2), within_a_turn);
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
