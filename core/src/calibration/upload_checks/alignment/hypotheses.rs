//! Possible errors of a whole set, and the set corrected for each.

use crate::measurement::Point;
use nalgebra::Vector3;
use std::f64::consts::PI;

/// One possible error of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hypothesis {
    /// Joints and positions in other units than the header says. The fields are the factors that correct them.
    Units {
        /// Factor of the joint values.
        joints: f64,
        /// Factor of the positions.
        positions: f64,
    },
    /// The position's columns are in another order: column `order[axis]` contains this axis.
    PositionColumns([usize; 3]),
    /// One coordinate has the wrong sign.
    MirroredAxis(usize),
    /// Two joints' columns are exchanged.
    JointColumns(usize, usize),
    /// Positions are this many rows below their joint values.
    ShiftedRows(isize),
    /// Measured on another robot, given by its index in a list.
    Robot(usize),
}

const TO_DEGREES: f64 = 180.0 / PI;
const TO_RADIANS: f64 = PI / 180.0;
const AXES: [char; 3] = ['x', 'y', 'z'];
/// Wrong orders of the columns.
const ORDERS: [[usize; 3]; 5] = [[1, 0, 2], [2, 1, 0], [0, 2, 1], [1, 2, 0], [2, 0, 1]];
/// Factors for confused length units: metres, inches.
const LENGTHS: [f64; 4] = [1.0, 1000.0, 0.001, 25.4];

/// All hypotheses that are tried, for a robot of `n_joints` joints and `n_others` other robots.
pub fn hypotheses(n_joints: usize, n_others: usize) -> Vec<Hypothesis> {
    let mut all = Vec::new();
    for joints in [1.0, TO_DEGREES, TO_RADIANS] {
        for positions in LENGTHS
            .into_iter()
            .filter(|positions| (joints, *positions) != (1.0, 1.0))
        {
            all.push(Hypothesis::Units { joints, positions });
        }
    }
    all.extend(ORDERS.map(Hypothesis::PositionColumns));
    all.extend((0..3).map(Hypothesis::MirroredAxis));
    all.extend(
        (0..n_joints).flat_map(|i| (i + 1..n_joints).map(move |j| Hypothesis::JointColumns(i, j))),
    );
    all.extend([1, -1, 2, -2].map(Hypothesis::ShiftedRows));
    all.extend((0..n_others).map(Hypothesis::Robot));
    all
}

impl Hypothesis {
    /// The points corrected under this hypothesis.
    pub fn applied(&self, points: &[Point]) -> Vec<Point> {
        if let Self::ShiftedRows(by) = *self {
            let position = |row: usize| {
                points
                    .get(row.checked_add_signed(by)?)
                    .map(|other| other.position_mm)
            };
            let moved = points.iter().enumerate().map(|(row, p)| {
                Some(Point {
                    position_mm: position(row)?,
                    ..p.clone()
                })
            });
            return moved.flatten().collect();
        }
        points
            .iter()
            .map(|point| self.applied_to(point.clone()))
            .collect()
    }

    fn applied_to(&self, mut point: Point) -> Point {
        let p = point.position_mm;
        match *self {
            Self::Units { joints, positions } => {
                point.q_rad.iter_mut().for_each(|q| *q *= joints);
                point.position_mm = p * positions;
            }
            Self::PositionColumns(order) => {
                point.position_mm = Vector3::new(p[order[0]], p[order[1]], p[order[2]])
            }
            Self::MirroredAxis(axis) => point.position_mm[axis] = -p[axis],
            Self::JointColumns(i, j) => point.q_rad.swap(i, j),
            Self::ShiftedRows(_) | Self::Robot(_) => {}
        }
        point
    }

    /// Index of the other robot, if this hypothesis names one.
    pub fn robot(&self) -> Option<usize> {
        if let Self::Robot(index) = self {
            Some(*index)
        } else {
            None
        }
    }

    /// True if the axes are left-handed under this hypothesis.
    pub fn is_left_handed(&self) -> bool {
        match self {
            Self::MirroredAxis(_) => true,
            Self::PositionColumns(order) => (0..3).any(|axis| order[axis] == axis),
            _ => false,
        }
    }

    /// Code of the problem.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Units { .. } => "unit_suspect",
            Self::Robot(_) => "robot_mismatch",
            _ => "column_suspect",
        }
    }

    /// Columns concerned.
    pub fn columns(&self) -> Option<String> {
        let axes = |order: &[usize; 3]| {
            (0..3)
                .filter(|axis| order[*axis] != *axis)
                .map(|axis| AXES[axis].to_string())
                .collect::<Vec<_>>()
        };
        Some(match self {
            Self::Units { joints, positions } => match (*joints != 1.0, *positions != 1.0) {
                (true, true) => "q1 …, x, y, z".into(),
                (true, false) => "q1 …".into(),
                _ => "x, y, z".into(),
            },
            Self::PositionColumns(order) => axes(order).join(", "),
            Self::MirroredAxis(axis) => AXES[*axis].into(),
            Self::JointColumns(i, j) => format!("q{}, q{}", i + 1, j + 1),
            Self::ShiftedRows(_) => "x, y, z".into(),
            Self::Robot(_) => return None,
        })
    }

    /// Text about the hypothesis; `others` are the names of the other robots.
    pub fn words(&self, others: &[&str]) -> String {
        match self {
            Self::Units { joints, positions } => [joint_unit(*joints), length_unit(*positions)]
                .into_iter()
                .flatten()
                .collect::<Vec<_>>()
                .join(" and "),
            Self::PositionColumns(order) => {
                format!(
                    "x, y, z stand in the columns named {}",
                    order.map(|axis| AXES[axis].to_string()).join(", ")
                )
            }
            Self::MirroredAxis(axis) => {
                format!("{} has the wrong sign (a left-handed frame)", AXES[*axis])
            }
            Self::JointColumns(i, j) => format!(
                "the columns of joints {} and {} are exchanged",
                i + 1,
                j + 1
            ),
            Self::ShiftedRows(by) => {
                let direction = if *by > 0 { "below" } else { "above" };
                format!(
                    "each position stands {} row(s) {direction} its joint values",
                    by.abs()
                )
            }
            Self::Robot(index) => format!(
                "it was measured on {}",
                others.get(*index).copied().unwrap_or("another robot")
            ),
        }
    }

    /// How to correct it.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Units { .. } => "name the columns by the unit that they are in, or convert them",
            Self::PositionColumns(_) | Self::JointColumns(..) => {
                "name the columns by what they hold"
            }
            Self::MirroredAxis(_) => "export in a right-handed frame",
            Self::ShiftedRows(_) => {
                "pair each position with the joint values at which it was measured"
            }
            Self::Robot(_) => "upload it to the robot that was measured",
        }
    }
}

fn joint_unit(factor: f64) -> Option<&'static str> {
    match factor {
        1.0 => None,
        TO_DEGREES => Some("the joint values are radians and were given as degrees"),
        _ => Some("the joint values are degrees and were given as radians"),
    }
}

fn length_unit(factor: f64) -> Option<&'static str> {
    match factor {
        1.0 => None,
        1000.0 => Some("the positions are metres and were given as millimetres"),
        0.001 => Some("the positions are millimetres and were given as metres"),
        _ => Some("the positions are inches and were given as millimetres"),
    }
}
