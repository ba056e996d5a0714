//! Groups the points: by segment between the steps of their target, and by set-up of the instrument.
//!
//! A target that moved counts as several targets in the fit, one per segment. A base that moved (or an instrument that was set up again) is a rigid
//! motion. The points of the other set-ups are transformed into the frame of one reference set-up, and the motions are fitted along with the robot.

use crate::calibration::preparation::observe::Observed;
use crate::calibration::request::{CalibrationRequest, Model};
use crate::identification::KinematicModel;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::{Parameter, rotation_exp};
use crate::measurement::split::MIN_OF_STATION;
use crate::measurement::{Frame, Subset};
use nalgebra::{IsometryMatrix3, Point3, Translation3, Vector3};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

/// Minimum number of identify points for fitting a set-up's motion. With fewer, the motion stays as it was found from all points.
pub const MIN_OF_SETUP: usize = MIN_OF_STATION;

/// The arrangement of a set's points.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrangement {
    /// Points in measuring order.
    pub order: Vec<usize>,
    /// Segment of each point's target, counted from 0.
    pub segments: Vec<usize>,
    /// Set-up of each point.
    pub setups: Vec<usize>,
    /// Transforms each set-up's positions into the frame of the reference set-up.
    pub motions: Vec<IsometryMatrix3<f64>>,
    /// True if the last set-up is the reference, because it shows the current state. False if the base is known: it is then known for the
    /// first set-up, which is the reference.
    pub is_last_reference: bool,
    n_targets: usize,
}

/// Targets as the fit counts them: first the last segment of every target, then the earlier segments.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FittedTargets {
    /// (target, segment) of each fitted target.
    pub segments: Vec<(usize, usize)>,
    /// Targets of the set.
    pub n_targets: usize,
}

impl FittedTargets {
    /// Number of fitted targets.
    pub fn len(&self) -> usize {
        self.segments.len()
    }

    /// The name of a parameter. For an earlier segment, for example `target_0_segment_0_x`.
    pub fn name(&self, parameter: &Parameter) -> String {
        match *parameter {
            Parameter::Target(fitted, _) | Parameter::TargetRotation(fitted, _)
                if fitted >= self.n_targets =>
            {
                let (target, segment) = self.segments[fitted];
                let name = parameter.name();
                let axis = name.rsplit('_').next().unwrap_or_default();
                format!("target_{target}_segment_{segment}_{axis}")
            }
            _ => parameter.name(),
        }
    }
}

impl Arrangement {
    /// The arrangement that the file states, without detected motions: one set-up per station.
    pub fn of(request: &CalibrationRequest) -> Self {
        let points = &request.set.points;
        let order = request.set.measuring_order();
        let mut number: BTreeMap<&Option<String>, usize> = BTreeMap::new();
        let mut setups = vec![0; points.len()];
        for i in &order {
            let next = number.len();
            setups[*i] = *number.entry(&points[*i].station).or_insert(next);
        }
        let motions = vec![IsometryMatrix3::identity(); number.len().max(1)];
        Self {
            order,
            segments: vec![0; points.len()],
            setups,
            motions,
            is_last_reference: request.model() == Model::Complete
                && request.set.frame == Frame::Instrument,
            n_targets: request.set.n_targets(),
        }
    }

    /// The targets of the fit.
    pub fn fitted_targets(&self, observed: &Observed) -> FittedTargets {
        let mut last = vec![0; self.n_targets];
        for (point, segment) in self.segments.iter().enumerate() {
            let of_target = &mut last[observed.targets[point]];
            *of_target = (*of_target).max(*segment);
        }
        let mut segments: Vec<(usize, usize)> = last.iter().copied().enumerate().collect();
        segments.extend(
            last.iter()
                .enumerate()
                .flat_map(|(target, last)| (0..*last).map(move |segment| (target, segment))),
        );
        FittedTargets {
            segments,
            n_targets: self.n_targets,
        }
    }

    /// Writes the arrangement into the observations that are fitted.
    pub fn apply(&self, observed: &mut Observed) {
        let fitted = self.fitted_targets(observed);
        let at: BTreeMap<(usize, usize), usize> = fitted
            .segments
            .iter()
            .enumerate()
            .map(|(i, key)| (*key, i))
            .collect();
        for point in 0..observed.all.len() {
            let motion = &self.motions[self.setups[point]];
            let o = &mut observed.all[point];
            o.target = at[&(observed.targets[point], self.segments[point])];
            o.station = self.station(self.setups[point]);
            o.position_mm = (motion * Point3::from(observed.positions_mm[point])).coords;
            let uneven = observed.whitenings[point];
            o.whitening = uneven.map(|w| w * motion.rotation.matrix().transpose());
            if let Some((of_pose, measured)) = o.rotation.as_mut().zip(observed.rotations[point]) {
                of_pose.rotation = motion.rotation * measured;
            }
        }
    }

    /// Starts a new target segment at point `first`.
    pub fn split_target(&mut self, observed: &Observed, first: usize) {
        let target = observed.targets[first];
        let of_target = |point: &&usize| observed.targets[**point] == target;
        let from = self
            .order
            .iter()
            .position(|point| *point == first)
            .unwrap_or(0);
        // After a step within an earlier segment, the later segments are renumbered.
        let points: Vec<usize> = self.order[from..]
            .iter()
            .filter(of_target)
            .copied()
            .collect();
        points.iter().for_each(|point| self.segments[*point] += 1);
    }

    /// Starts a new set-up of the base at point `first`. The points before it are transformed by `motion`.
    pub fn split_base(&mut self, first: usize, motion: &IsometryMatrix3<f64>) {
        let from = self
            .order
            .iter()
            .position(|point| *point == first)
            .unwrap_or(0);
        let mut number: BTreeMap<(usize, bool), usize> = BTreeMap::new();
        let mut motions = Vec::new();
        let mut setups = vec![0; self.setups.len()];
        for (place, point) in self.order.iter().enumerate() {
            let key = (self.setups[*point], place >= from);
            setups[*point] = *number.entry(key).or_insert_with(|| {
                let before = self.motions[key.0];
                motions.push(if key.1 { before } else { motion * before });
                motions.len() - 1
            });
        }
        (self.setups, self.motions) = (setups, motions);
        self.set_reference();
    }

    /// Makes the motion of the reference set-up the identity.
    pub fn set_reference(&mut self) {
        let at = self.reference_setup();
        let back = self.motions[at].inverse();
        self.motions.iter_mut().enumerate().for_each(|(i, m)| {
            *m = if i == at {
                IsometryMatrix3::identity()
            } else {
                back * *m
            }
        });
    }

    /// Station of a set-up, from 0 and without the reference; `None` for the reference set-up.
    fn station(&self, setup: usize) -> Option<usize> {
        let reference_setup = self.reference_setup();
        match setup.cmp(&reference_setup) {
            Ordering::Less => Some(setup),
            Ordering::Equal => None,
            Ordering::Greater => Some(setup - 1),
        }
    }

    /// Moves the points of each station. A station without a motion stays.
    pub fn move_stations(&mut self, motions: &[IsometryMatrix3<f64>]) {
        for setup in 0..self.motions.len() {
            let motion = self.station(setup).and_then(|station| motions.get(station));
            if let Some(motion) = motion {
                self.motions[setup] = motion * self.motions[setup];
            }
        }
    }

    /// The reference set-up: the other set-ups are transformed into its frame.
    pub fn reference_setup(&self) -> usize {
        let point = if self.is_last_reference {
            self.order.last()
        } else {
            self.order.first()
        };
        point.map_or(0, |point| self.setups[*point])
    }

    /// Joins each segment without identify points to the segment before it (or after it), because it cannot be fitted. Returns the points of joined
    /// segments.
    pub fn join_unfitted(&mut self, observed: &Observed) -> Vec<usize> {
        let mut joined = Vec::new();
        for target in 0..self.n_targets {
            let points: Vec<usize> = self
                .order
                .iter()
                .copied()
                .filter(|p| observed.targets[*p] == target)
                .collect();
            let fitted: BTreeSet<usize> = points
                .iter()
                .filter(|p| observed.subsets[**p] == Subset::Identify)
                .map(|p| self.segments[*p])
                .collect();
            let Some(first) = fitted.first().copied() else {
                continue;
            };
            for point in points {
                let own = self.segments[point];
                let nearest = fitted.range(..=own).next_back().copied().unwrap_or(first);
                if nearest != own {
                    joined.push(point);
                }
                self.segments[point] = fitted.iter().position(|s| *s == nearest).unwrap_or(0);
            }
        }
        joined.sort_unstable();
        joined
    }
}

/// A motion of the base in the measuring frame: a shift, and a rotation about a centre.
pub fn motion(
    shift_mm: &Vector3<f64>,
    turn_rad: &Vector3<f64>,
    centre: &Vector3<f64>,
) -> IsometryMatrix3<f64> {
    let turn = rotation_exp(turn_rad);
    IsometryMatrix3::from_parts(Translation3::from(centre + shift_mm - turn * centre), turn)
}

/// The paper's model holds the first segment of each target at its nominal position. The targets of later segments are free, because their
/// positions are unknown.
pub fn with_moved_targets(
    request: &CalibrationRequest,
    mut parameters: Vec<Parameter>,
    targets: &FittedTargets,
) -> Vec<Parameter> {
    if request.model() == Model::Paper {
        let moved = targets
            .segments
            .iter()
            .enumerate()
            .filter(|(_, (_, segment))| *segment > 0);
        parameters.extend(
            moved.flat_map(|(fitted, _)| (0..3).map(move |axis| Parameter::Target(fitted, axis))),
        );
    }
    parameters
}

/// Rigid motion that best maps predicted to measured points: the placement of a set-up.
pub fn setup_placement(
    model: &KinematicModel,
    observations: &[Observation],
) -> IsometryMatrix3<f64> {
    let predicted: Vec<Vector3<f64>> = observations
        .iter()
        .map(|o| model.position(&o.q_rad, o.target))
        .collect();
    let measured: Vec<Vector3<f64>> = observations.iter().map(|o| o.position_mm).collect();
    crate::identification::least_squares::start::rigid_motion(&predicted, &measured)
}
