//! A joint convention relative to the robot's current joints: its effect on joint values, its joint map, and its description.

use crate::identification::model::objective::Observation;
use crate::kinematics::{JointMap, Robot};
use nalgebra::DMatrix;
use std::f64::consts::FRAC_PI_2;

/// Joint signs of makers of six-axis arms, relative to axes that all turn in the same direction: KUKA, and FANUC.
pub(super) const MAKERS: [[bool; 6]; 2] = [
    [true, false, false, true, false, true],
    [false, false, true, true, true, true],
];
/// Factors by which joint 2's value may be multiplied before it is added to joint 3's.
pub(super) const COUPLINGS: [f64; 3] = [0.0, 1.0, -1.0];

/// A joint convention relative to the robot's current joints.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Convention {
    /// True for each joint that counts in the opposite direction.
    pub reversed: Vec<bool>,
    /// Factor of joint 2's value when it is added to joint 3's: 0, 1 or -1.
    pub coupling: f64,
    /// Quarter turns added to each joint, 0 to 3.
    pub quarter_turns: Vec<u8>,
}

impl Convention {
    /// The makers' signs and the robot's own signs, each with every coupling.
    pub fn of_makers(n_joints: usize) -> impl Iterator<Item = Self> {
        let makers = MAKERS.iter().filter(move |maker| maker.len() == n_joints);
        let signs = makers.map(|maker| maker.to_vec());
        let signs = signs.chain([vec![false; n_joints]]);
        signs.flat_map(move |reversed| {
            COUPLINGS.map(|coupling| Self {
                reversed: reversed.clone(),
                coupling,
                quarter_turns: vec![0; n_joints],
            })
        })
    }

    /// The model's joint values with this convention.
    pub fn applied(&self, q_rad: &[f64]) -> Vec<f64> {
        let mut q: Vec<f64> = q_rad
            .iter()
            .zip(&self.reversed)
            .map(|(q, reversed)| if *reversed { -q } else { *q })
            .collect();
        if self.coupling != 0.0 {
            q[2] += self.coupling * q[1];
        }
        q.iter_mut()
            .zip(&self.quarter_turns)
            .for_each(|(q, turns)| *q += f64::from(*turns) * FRAC_PI_2);
        q
    }

    /// The observations with this convention.
    pub fn observations(&self, observations: &[Observation]) -> Vec<Observation> {
        observations
            .iter()
            .map(|o| Observation {
                q_rad: self.applied(&o.q_rad),
                ..o.clone()
            })
            .collect()
    }

    /// True if a zero is shifted by quarter turns.
    pub fn is_turned(&self) -> bool {
        self.quarter_turns.iter().any(|turns| *turns > 0)
    }

    /// Complexity of the convention. Turned zeros count most, then the coupling, then signs, because a turned zero of one joint may replace the sign
    /// of another. A maker's signs count as a single sign. An unobservable joint thus gets the direction that goes with the others.
    pub fn complexity(&self) -> usize {
        let turned = self
            .quarter_turns
            .iter()
            .filter(|turns| **turns > 0)
            .count();
        let reversed = match MAKERS.iter().any(|maker| maker[..] == self.reversed[..]) {
            true => 1,
            false => self.reversed.iter().filter(|reversed| **reversed).count(),
        };
        4 * turned + 3 * usize::from(self.coupling != 0.0) + reversed
    }

    /// The same convention with the last joint reversed.
    pub fn with_last_reversed(&self) -> Self {
        let mut other = self.clone();
        if let Some(last) = other.reversed.last_mut() {
            *last = !*last;
        }
        other
    }

    /// The robot's joint map with this convention: `q_model = coupling · (sign ∘ q_controller) + offset`, applied after the robot's own map.
    pub fn joint_map(&self, robot: &Robot) -> JointMap {
        let n = self.reversed.len();
        let mut rates = DMatrix::<f64>::identity(n, n);
        if self.coupling != 0.0 {
            rates[(2, 1)] = self.coupling;
        }
        for (joint, reversed) in self.reversed.iter().enumerate() {
            if *reversed {
                rates.column_mut(joint).neg_mut();
            }
        }
        let mut offset_rad = match &robot.joint_map {
            Some(map) => (0..n)
                .map(|i| (0..n).map(|j| rates[(i, j)] * map.offset_rad[j]).sum())
                .collect(),
            None => vec![0.0; n],
        };
        for (offset, turns) in offset_rad.iter_mut().zip(&self.quarter_turns) {
            *offset += f64::from(signed(*turns)) * FRAC_PI_2;
        }
        let rates = rates * robot.joint_rates();
        let sign: Vec<f64> = (0..n)
            .map(|joint| {
                if rates[(joint, joint)] < 0.0 {
                    -1.0
                } else {
                    1.0
                }
            })
            .collect();
        // Adding 0 converts -0 to 0; -0 would be displayed.
        let coupling = DMatrix::from_fn(n, n, |i, j| rates[(i, j)] * sign[j] + 0.0);
        JointMap {
            sign,
            offset_rad,
            coupling,
        }
    }

    /// Columns concerned, as named in a CSV header.
    pub fn columns(&self) -> String {
        let is_meant = |joint: usize| {
            self.reversed[joint]
                || self.quarter_turns[joint] > 0
                || (joint == 2 && self.coupling != 0.0)
        };
        let columns: Vec<String> = (0..self.reversed.len())
            .filter(|joint| is_meant(*joint))
            .map(|joint| format!("q{}", joint + 1))
            .collect();
        columns.join(", ")
    }

    /// Text that describes the convention for this robot.
    pub fn words(&self, robot: &Robot) -> String {
        let reversed: Vec<usize> = joints(&self.reversed, |reversed| *reversed);
        let mut words = Vec::new();
        match reversed.as_slice() {
            [] => {}
            [joint] => words.push(format!("joint {joint} is counted the other way round")),
            several => words.push(format!(
                "joints {} are counted the other way round",
                listed(several)
            )),
        }
        if self.coupling != 0.0 && self.joint_map(robot).coupling[(2, 1)] == 0.0 {
            words.push(
                "joint 3 does not move with joint 2, as the robot's joint_map says it does".into(),
            );
        } else if self.coupling != 0.0 {
            let of_q3 = if self.reversed[2] { "−" } else { "" };
            let of_q2 = if self.reversed[1] == (self.coupling > 0.0) {
                "−"
            } else {
                "+"
            };
            words.push(format!(
                "joint 3 moves with joint 2 (the model's q3 is {of_q3}q3 {of_q2} q2)"
            ));
        }
        for joint in joints(&self.quarter_turns, |turns| *turns > 0) {
            words.push(format!(
                "the zero of joint {joint} is {:+}° away",
                90 * i32::from(signed(self.quarter_turns[joint - 1]))
            ));
        }
        words.join(" and ")
    }
}

/// Quarter turns as a number from -1 to 2.
fn signed(quarter_turns: u8) -> i8 {
    if quarter_turns == 3 {
        -1
    } else {
        quarter_turns as i8
    }
}

/// Numbers, from 1, of the joints for which `holds` is true.
fn joints<T>(of: &[T], holds: impl Fn(&T) -> bool) -> Vec<usize> {
    (0..of.len())
        .filter(|joint| holds(&of[*joint]))
        .map(|joint| joint + 1)
        .collect()
}

fn listed(joints: &[usize]) -> String {
    let names: Vec<String> = joints.iter().map(usize::to_string).collect();
    match names.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
        _ => names.join(""),
    }
}
