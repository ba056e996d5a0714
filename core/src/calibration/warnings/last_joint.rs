//! Checks the sign of the last joint. A reflector near the last axis hardly moves with that joint. The points may then fit as well, or
//! better, if the joint is reversed or coupled to the joint before it, or if the reflector is behind the wrist.

use crate::calibration::problem::Problem;
use crate::calibration::report::Warning;
use crate::calibration::request::Preset;
use crate::calibration::warnings::plausibility::{JOINT_MAP, joint_counted_otherwise};
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::estimate;
use crate::identification::least_squares::evidence::Noise;
use crate::identification::least_squares::start::fit_base_and_targets;
use crate::identification::model::objective::Observation;
use crate::kinematics::{Link, reach_mm};
use nalgebra::Vector3;
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// The check is made for reflectors closer than this share of the reach to the last axis: 17 mm of 1.7 m. If a reflector is further away,
/// points with a reversed joint do not fit at all.
const NEAR_PER_REACH: f64 = 0.01;
/// Maximum number of points that other readings are tried on, evenly selected.
const MAX_POINTS: usize = 600;

/// Another reading of the last joint: its value times `sign`, plus `coupling` times the value of the joint before it.
#[derive(Clone, Copy)]
struct Reading {
    sign: f64,
    coupling: f64,
}

/// The joint reversed.
const REVERSED: Reading = Reading {
    sign: -1.0,
    coupling: 0.0,
};
/// Wrists with coupled last two joints.
const COUPLED: [Reading; 4] = [
    Reading {
        sign: 1.0,
        coupling: 1.0,
    },
    Reading {
        sign: 1.0,
        coupling: -1.0,
    },
    Reading {
        sign: -1.0,
        coupling: 1.0,
    },
    Reading {
        sign: -1.0,
        coupling: -1.0,
    },
];

/// What the points show about the direction of the last joint.
pub enum LastJoint {
    /// The points fit best with the joint map's direction.
    Shown,
    /// The points fit as well with the joint reversed.
    NotShown,
    /// The points fit only with another reading than the joint map's.
    Otherwise(Warning),
}

impl Reading {
    fn of(self, q_rad: &mut [f64]) {
        if let [.., before, last] = q_rad {
            *last = self.sign * *last + self.coupling * *before;
        }
    }

    fn in_words(self, joint: usize) -> String {
        let before = joint - 1;
        match (self.sign < 0.0, self.coupling) {
            (true, 0.0) => "counted the other way round".into(),
            (is_reversed, coupling) => format!(
                "counted{} together with joint {before} (q{joint} {} q{before})",
                if is_reversed {
                    " the other way round,"
                } else {
                    ""
                },
                if coupling > 0.0 { '+' } else { '−' }
            ),
        }
    }
}

/// Warning if the fitted reflector is where none can be: further away than the arm is long, or inside the arm.
pub fn impossible_reflector(model: &KinematicModel, nominal: &[Link]) -> Option<Warning> {
    let reach_mm = reach_mm(nominal);
    out_of_reach(model, reach_mm).or_else(|| behind_the_wrist(model, reach_mm))
}

/// Compares the fit with fits to the same points with other readings of the last joint.
pub fn last_joint(problem: &Problem<'_>, model: &KinematicModel) -> LastJoint {
    let nominal = &problem.request.robot.links;
    if let Some(warning) = impossible_reflector(model, nominal) {
        return LastJoint::Otherwise(warning);
    }
    let reach_mm = reach_mm(nominal);
    let off_axis_mm = model.targets_mm.iter().map(|target| target.xy().norm());
    let is_near = off_axis_mm.fold(0.0, f64::max) < NEAR_PER_REACH * reach_mm;
    // Rotations show the direction of every joint.
    let has_poses = problem.request.set.has_poses();
    if !is_near || has_poses || problem.request.preset == Preset::Paper {
        return LastJoint::Shown;
    }
    let own = problem.noise(model);
    let reversed = noise_of(problem, REVERSED);
    // Rotating a link by half a turn has the same effect as reversing a joint.
    let is_turned = is_turned(problem, model);
    let is_reversed =
        |other: &Noise| own.is_more_than(other) || (is_turned && !other.is_more_than(&own));
    if let Some(other) = reversed.as_ref().filter(|other| is_reversed(other)) {
        return LastJoint::Otherwise(otherwise(model, &own, other, REVERSED));
    }
    for reading in COUPLED {
        let other = noise_of(problem, reading);
        if let Some(other) = other.filter(|other| own.is_more_than(other)) {
            return LastJoint::Otherwise(otherwise(model, &own, &other, reading));
        }
    }
    match reversed {
        Some(other) if !other.is_more_than(&own) => LastJoint::NotShown,
        _ => LastJoint::Shown,
    }
}

fn otherwise(model: &KinematicModel, own: &Noise, other: &Noise, reading: Reading) -> Warning {
    let joint = model.links.len();
    Warning::new(
        JOINT_MAP,
        format!(
            "the points scatter by {:.4} mm, and by {:.4} mm with joint {joint} {} (one standard deviation of a coordinate): the flange is turned \
             wrongly. Turn joint {joint} at the controller, compare the nominal robot, correct the robot's joint_map, and upload the file again. It \
             cannot be released",
            own.std_mm,
            other.std_mm,
            reading.in_words(joint)
        ),
    )
}

/// True if a link is rotated by more than the zero error of an unmastered joint.
fn is_turned(problem: &Problem<'_>, model: &KinematicModel) -> bool {
    joint_counted_otherwise(&model.links, &problem.request.robot.links, &BTreeSet::new()).is_some()
}

/// Noise of a fit with another reading of the last joint; `None` if that fit rotates a link.
fn noise_of(problem: &Problem<'_>, reading: Reading) -> Option<Noise> {
    let read = |o: &Observation| {
        let mut o = o.clone();
        reading.of(&mut o.q_rad);
        o
    };
    let trusted = problem.trusted();
    let with_weight: Vec<_> = trusted.iter().filter(|o| o.weight > 0.0).collect();
    let step = with_weight.len().div_ceil(MAX_POINTS).max(1);
    let points: Vec<Observation> = with_weight.into_iter().step_by(step).map(read).collect();
    let links = &problem.nominal.links;
    let start = fit_base_and_targets(links, &points, problem.screening.targets.len());
    let rows = problem.rows(&points, &[]);
    let go_on = &mut |_| ControlFlow::Continue(());
    let found = estimate(&rows, &rows.coordinates(&start), 0.0, go_on);
    (!is_turned(problem, &found.model)).then(|| Noise::of(&rows, &found.evidence, &found.posterior))
}

/// A tool is not as long as the arm. Such a fit occurs if the points cover little of the workspace and a mirrored robot fits them.
fn out_of_reach(model: &KinematicModel, reach_mm: f64) -> Option<Warning> {
    let of_targets = model.targets_mm.iter().map(|target| target.norm());
    let farthest_mm = of_targets.fold(0.0, f64::max);
    (farthest_mm > reach_mm).then(|| {
        let detail = format!(
            "the reflector is found {farthest_mm:.0} mm from the flange, and the whole arm reaches {reach_mm:.0} mm: no tool is as long. The joints are \
             counted otherwise, or the frame is mirrored, and the points cover too little of the workspace to show it. Compare the controller's joint \
             values with the nominal robot, and measure poses spread over the workspace"
        );
        Warning::new(JOINT_MAP, detail)
    })
}

/// Warning for a reflector that is behind the centre of a spherical wrist by more than its distance from the last axis: it would be inside
/// the arm. Such a fit occurs if the zero of the joint before the last is half a turn off and the reflector is really in front.
fn behind_the_wrist(model: &KinematicModel, reach_mm: f64) -> Option<Warning> {
    let Link { a_mm, d_mm, .. } = model.links.last()?;
    let near_mm = NEAR_PER_REACH * reach_mm;
    if a_mm.abs() > near_mm || d_mm.abs() < near_mm {
        return None;
    }
    let behind_mm = |target: &Vector3<f64>| -(target.z + d_mm) * d_mm.signum();
    let mut targets = model.targets_mm.iter();
    let inside = targets.find(|t| behind_mm(t) > near_mm.max(t.xy().norm()))?;
    let joint = model.links.len() - 1;
    Some(Warning::new(
        JOINT_MAP,
        format!(
            "the reflector is found {:.1} mm behind the wrist, inside the arm: joint {joint} that is counted from half a turn off looks like that, and then \
             the flange is turned wrongly. Compare the controller's joint values with the nominal robot, correct the robot's joint_map, and upload the \
             file again. It cannot be released",
            behind_mm(inside)
        ),
    ))
}
