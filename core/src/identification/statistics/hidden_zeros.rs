//! Joint zeros that a session hardly shows, because base and targets are fitted to its own points.
//!
//! Let J be the displacement of the points by a joint's zero, and P that by base and targets. The placement absorbs the part of J in the
//! span of P; J − P·P⁺·J is left. Its rms over the session's points is compared with that over random configurations of the region around
//! the session: the ranges of the joints in the session, and a quarter turn to both sides for joints that move little. Example: if joint 6
//! does not move, an error of joint 5 is a shift of the reflector, and nothing is left. A session in a part of the workspace says little
//! about other parts, but it is valid for its own.

use crate::identification::KinematicModel;
use crate::identification::model::objective::{Observation, weighted_jacobian};
use crate::identification::model::parameters::{Parameter, Quantity, placement_parameters};
use crate::identification::statistics::workspace::random_in;
use crate::solvers::orthonormal::span;
use nalgebra::{DMatrix, Vector3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_3};

/// A zero is hidden if the session shows less than this share of what the region would show. The error of the tool is then more than five
/// times what the session shows.
pub const SHOWN: f64 = 0.2;
/// A joint with a smaller range moves little, rad (60°). Its range is extended to a quarter turn to both sides of its middle.
const SMALL_RANGE_RAD: f64 = FRAC_PI_3;
/// If less than this share of a zero's effect is left over the region, the placement absorbs the zero everywhere. This is so for the first
/// and the last joint.
const MIN_LEFT_SHARE: f64 = 1e-3;
/// Number of configurations of the region.
const N_CONFIGURATIONS: usize = 100;
/// Seed of the configurations.
const SEED: u64 = 1;
/// Maximum number of points, evenly from all of them.
const MAX_POINTS: usize = 500;

/// A joint whose zero a session hardly shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HiddenZero {
    /// Joint, 0-based.
    pub joint: usize,
    /// Share of the zero's effect that the session shows, 0 to 1.
    pub share: f64,
}

/// The hidden zeros of a session. `placed` is the robot placed on it. Each of `stations` has the points of one instrument position, with
/// its own base. Points of weight 0 are ignored.
pub fn hidden_zeros(placed: &KinematicModel, stations: &[Vec<&Observation>]) -> Vec<HiddenZero> {
    let n_points: usize = stations.iter().map(Vec::len).sum();
    let step = n_points.div_ceil(MAX_POINTS).max(1);
    let some = |points: &Vec<&Observation>| -> Vec<Observation> {
        let counted = points.iter().filter(|point| point.weight > 0.0);
        counted.step_by(step).map(|point| plain(point)).collect()
    };
    let stations: Vec<Vec<Observation>> = stations.iter().map(some).collect();
    let session: Vec<Observation> = stations.concat();
    let Some(first) = session.first() else {
        return vec![];
    };
    let ranges: Vec<(f64, f64)> = (0..first.q_rad.len())
        .map(|joint| range(&session, joint))
        .collect();
    let mut region = Vec::new();
    for q_rad in random_in(&ranges, N_CONFIGURATIONS, SEED) {
        region.extend((0..placed.targets_mm.len()).map(|target| Observation {
            q_rad: q_rad.clone(),
            target,
            ..first.clone()
        }));
    }
    let (Some(shown), Some(everywhere)) = (left(placed, &stations), left(placed, &[region])) else {
        return vec![];
    };
    let joints = 0..placed.links.len();
    joints
        .filter_map(|joint| {
            let (left_mm, whole_mm) = everywhere[joint];
            let share = shown[joint].0 / left_mm;
            let is_hidden = left_mm > MIN_LEFT_SHARE * whole_mm && share < SHOWN;
            is_hidden.then_some(HiddenZero { joint, share })
        })
        .collect()
}

/// The range of a joint in the session, extended for a joint that moves little, rad.
fn range(session: &[Observation], joint: usize) -> (f64, f64) {
    let values = session.iter().map(|o| o.q_rad[joint]);
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), q| {
        (low.min(q), high.max(q))
    });
    let middle = 0.5 * (low + high);
    match high - low < SMALL_RANGE_RAD {
        true => (middle - FRAC_PI_2, middle + FRAC_PI_2),
        false => (low, high),
    }
}

/// Unweighted, without a rotation.
fn plain(observation: &Observation) -> Observation {
    Observation {
        weight: 1.0,
        whitening: None,
        ..observation.position_alone()
    }
}

/// For each joint, rms, mm per rad: the effect of its zero on the points that is left after base and targets are fitted to each station,
/// and the whole effect.
fn left(model: &KinematicModel, stations: &[Vec<Observation>]) -> Option<Vec<(f64, f64)>> {
    let zeros: Vec<Parameter> = (0..model.links.len())
        .map(|link| Parameter::Link(link, Quantity::ThetaOffset))
        .collect();
    let placement = placement_parameters(model.targets_mm.len());
    let mut squares = vec![(0.0, 0.0); zeros.len()];
    for points in stations.iter().filter(|points| !points.is_empty()) {
        let jacobian = |parameters: &[Parameter]| {
            weighted_jacobian(model, parameters, points, &Vector3::zeros())
        };
        let whole = jacobian(&zeros);
        let taken = span(&jacobian(&placement))?;
        let left: DMatrix<f64> = &whole - &taken * taken.tr_mul(&whole);
        for (joint, sum) in squares.iter_mut().enumerate() {
            sum.0 += left.column(joint).norm_squared();
            sum.1 += whole.column(joint).norm_squared();
        }
    }
    let n_points = stations.iter().map(Vec::len).sum::<usize>() as f64;
    let rms = |squares: f64| (squares / n_points).sqrt();
    Some(
        squares
            .into_iter()
            .map(|(left, whole)| (rms(left), rms(whole)))
            .collect(),
    )
}
