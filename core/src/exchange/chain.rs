//! A serial chain of joints, each with an arbitrary frame.

use crate::exchange::origin::{Origin, origin_of};
use crate::kinematics::Link;
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::rotation::rotation_exp;
use nalgebra::{IsometryMatrix3, Translation3, Vector3};

/// One joint of a chain.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainJoint {
    /// Its name.
    pub name: String,
    /// The joint's frame in the frame of the previous joint (of the root, for the first), at joint value 0, mm.
    pub t_parent_joint: IsometryMatrix3<f64>,
    /// Unit vector of its axis, in its own frame; `None` for a fixed joint.
    pub axis: Option<Vector3<f64>>,
    /// Lower and upper limit, rad, if known.
    pub limits_rad: Option<(f64, f64)>,
}

/// Joints from the root to the tip.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chain {
    /// In order.
    pub joints: Vec<ChainJoint>,
}

/// An axis of rotation in the root's frame: a point on it, mm, and its direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// A point on it, mm.
    pub point_mm: Vector3<f64>,
    /// Unit vector.
    pub direction: Vector3<f64>,
}

impl Chain {
    /// The chain of links: one joint per link, which rotates about its z axis.
    pub fn of_links(links: &[Link]) -> Self {
        let joint = |(i, link): (usize, &Link)| ChainJoint {
            name: format!("joint_{}", i + 1),
            t_parent_joint: t_previous_link(link, 0.0),
            axis: Some(Vector3::z()),
            limits_rad: None,
        };
        Self {
            joints: links.iter().enumerate().map(joint).collect(),
        }
    }

    /// Number of moving joints.
    pub fn n_moving(&self) -> usize {
        self.joints
            .iter()
            .filter(|joint| joint.axis.is_some())
            .count()
    }

    /// Frame of the last joint in the root's frame, mm; one value per moving joint, rad.
    pub fn t_root_tip(&self, q_rad: &[f64]) -> IsometryMatrix3<f64> {
        self.frames(q_rad)
            .last()
            .copied()
            .unwrap_or_else(IsometryMatrix3::identity)
    }

    /// Frame of each joint in the root's frame, after its own rotation.
    pub fn frames(&self, q_rad: &[f64]) -> Vec<IsometryMatrix3<f64>> {
        let mut q = q_rad.iter();
        let mut t = IsometryMatrix3::identity();
        let frame = |joint: &ChainJoint| {
            t *= joint.t_parent_joint;
            if let (Some(axis), Some(q)) = (&joint.axis, joint.axis.and_then(|_| q.next())) {
                t *= IsometryMatrix3::from_parts(
                    Translation3::identity(),
                    rotation_exp(&(axis * *q)),
                );
            }
            t
        };
        self.joints.iter().map(frame).collect()
    }

    /// The axes of the moving joints in the root's frame, all joints at 0.
    pub fn axes(&self) -> Vec<Axis> {
        let frames = self.frames(&vec![0.0; self.n_moving()]);
        let moving = self
            .joints
            .iter()
            .zip(&frames)
            .filter_map(|(joint, t)| Some((joint.axis?, t)));
        moving
            .map(|(axis, t)| Axis {
                point_mm: t.translation.vector,
                direction: t.rotation * axis,
            })
            .collect()
    }

    /// Origin of each joint, as in a URDF.
    pub fn origins(&self) -> Vec<Origin> {
        self.joints
            .iter()
            .map(|joint| origin_of(&joint.t_parent_joint))
            .collect()
    }
}
