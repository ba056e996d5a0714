//! Pairs the rows of an upload with the rows of an earlier upload that have the same pose, and compares their positions. The placement of
//! instrument and reflector is removed, because it differs between sessions.

use crate::identification::KinematicModel;
use crate::identification::least_squares::start::align_in_closed_form;
use crate::identification::model::objective::Observation;
use crate::kinematics::rotation::within_half_a_turn;
use crate::kinematics::{Robot, reach_mm, t_base_flange};
use crate::measurement::{Frame, MeasurementSet, Point};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3xX, Vector3};

/// Two poses are the same if the values of every joint differ by less than this, rad (0.02°): controllers return to a pose and read it to
/// 0.01°. A joint near the reflector may differ by more, as long as it moves the reflector no further than this angle at full reach would.
const SAME_POSE_RAD: f64 = 3.5e-4;
/// Maximum number of rows for finding a constant offset of a joint, evenly from the whole set. Each is compared with every earlier row.
const COMPARED_ROWS: usize = 100;
/// Maximum number of rows that the robot is fitted to, evenly from the whole set.
const MAX_FITTED: usize = 2_000;
/// Maximum number of earlier visits of a row's pose that the row is compared with.
const MAX_VISITS: usize = 20;
/// Singular values below this share of the largest diagonal element are rounding errors.
const ROUNDING: f64 = 1e-9;
/// Step of a joint for computing how far it moves the reflector, rad.
const STEP_RAD: f64 = 1e-4;

/// The nominal robot placed on an upload.
pub struct PlacedRows {
    model: KinematicModel,
    rows: Vec<PlacedRow>,
}

struct PlacedRow {
    /// The reflector's position, mm.
    here_mm: Vector3<f64>,
    /// How far each joint moves the reflector, mm/rad.
    levers_mm: Vec<f64>,
    /// Rotation of the flange in the frame of the positions.
    r_flange: Matrix3<f64>,
}

impl PlacedRows {
    pub fn new(robot: &Robot, set: &MeasurementSet) -> Option<Self> {
        let is_base_known = set.frame == Frame::Base;
        let observations = observations(robot, set);
        let model =
            align_in_closed_form(&robot.links, &observations, set.n_targets(), is_base_known)?;
        let of_row = |point: &Point| {
            let position = |q_rad: &[f64]| position(robot, &model, q_rad, point.target);
            let here = position(&point.q_rad);
            let lever_mm = |joint: usize| {
                let mut q_rad = point.q_rad.clone();
                q_rad[joint] += STEP_RAD;
                (position(&q_rad) - here).norm() / STEP_RAD
            };
            let q_rad = robot.q_model_rad(&point.q_rad);
            let r_flange =
                model.t_instrument_base.rotation * t_base_flange(&model.links, &q_rad).rotation;
            PlacedRow {
                here_mm: here,
                levers_mm: (0..point.q_rad.len()).map(lever_mm).collect(),
                r_flange: r_flange.into_inner(),
            }
        };
        let rows = set.points.iter().map(of_row).collect();
        Some(Self { model, rows })
    }

    /// Each row with the earlier rows of the same target and the same pose, the one with the nearest joint values first, and at most
    /// [`MAX_VISITS`] of them.
    pub fn same_poses(
        &self,
        robot: &Robot,
        later: &MeasurementSet,
        earlier: &MeasurementSet,
    ) -> Vec<Pair> {
        let model = &self.model;
        let same_mm = SAME_POSE_RAD * reach_mm(&robot.links);
        let place_mm = |(row, p): (usize, &Point)| {
            let is_known = p.target < model.targets_mm.len();
            is_known.then(|| (position(robot, model, &p.q_rad, p.target), row))
        };
        // Joint values within the tolerance of one pose move the reflector by a limited distance. Sorted by its x coordinate, rows that are too far
        // along x are not looked at; of the others, few are near in y and z, too.
        let earlier_points = earlier.points.iter().enumerate();
        let mut known: Vec<(Vector3<f64>, usize)> = earlier_points.filter_map(place_mm).collect();
        known.sort_by(|a, b| a.0.x.total_cmp(&b.0.x));
        let mut pairs = Vec::new();
        for (row, (point, placed)) in later.points.iter().zip(&self.rows).enumerate() {
            let (here, levers_mm) = (&placed.here_mm, &placed.levers_mm);
            let width_mm = 2.0 * same_mm * levers_mm.len() as f64;
            let begin = known.partition_point(|(at, _)| at.x < here.x - width_mm);
            let mut visits: Vec<(f64, Vec<f64>, usize)> = known[begin..]
                .iter()
                .take_while(|(at, _)| at.x <= here.x + width_mm)
                .filter(|(at, other)| {
                    (at - here).norm() <= width_mm && earlier.points[*other].target == point.target
                })
                .map(|(_, other)| {
                    let apart = apart_rad(&earlier.points[*other].q_rad, &point.q_rad);
                    let moved = apart.iter().zip(levers_mm).map(|(rad, mm)| rad * mm);
                    (moved.fold(0.0, f64::max), apart, *other)
                })
                .filter(|(mm, ..)| *mm <= same_mm)
                .collect();
            visits.sort_by(|a, b| a.0.total_cmp(&b.0));
            visits.truncate(MAX_VISITS);
            for (_, apart, earlier_row) in visits {
                let before = &earlier.points[earlier_row].q_rad;
                pairs.push(Pair {
                    row,
                    earlier_row,
                    reading_rad: apart.into_iter().fold(0.0, f64::max),
                    predicted_mm: here - position(robot, model, before, point.target),
                    difference_mm: Vector3::zeros(),
                });
            }
        }
        pairs
    }

    /// Removes from the differences of position, by least squares, what these causes explain: a small motion of the instrument, another
    /// scale (positions converted to another temperature), and a reflector that was mounted again. The model is difference = shift +
    /// rotation × position + scale · position + R_flange · δ, with δ of each target in the flange frame.
    pub fn remove_placement(&self, pairs: &mut [Pair], points: &[Point]) {
        self.remove_placement_of(pairs, pairs.len(), points);
    }

    /// As [`PlacedRows::remove_placement`], but the placement is fitted to the first `n_placed` pairs only.
    pub fn remove_placement_of(&self, pairs: &mut [Pair], n_placed: usize, points: &[Point]) {
        let rows = &self.rows;
        let n = n_of_placement(pairs, points);
        let size_mm = rows
            .iter()
            .map(|row| row.here_mm.norm())
            .fold(1.0, f64::max);
        let effects = |pair: &Pair| {
            let (row, target) = (&rows[pair.row], points[pair.row].target);
            let mut effects = Matrix3xX::zeros(n);
            effects.fixed_columns_mut::<3>(0).fill_with_identity();
            let turned = -row.here_mm.cross_matrix() / size_mm;
            effects.fixed_columns_mut::<3>(3).copy_from(&turned);
            effects.set_column(6, &(row.here_mm / size_mm));
            effects
                .fixed_columns_mut::<3>(7 + 3 * target)
                .copy_from(&row.r_flange);
            effects
        };
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for pair in &pairs[..n_placed] {
            let effects = effects(pair);
            normal += effects.tr_mul(&effects);
            right += effects.tr_mul(&pair.difference_mm);
        }
        // A direction that the poses do not determine is left unchanged.
        let largest = normal.diagonal().max();
        let Ok(found) = normal.svd(true, true).solve(&right, ROUNDING * largest) else {
            return;
        };
        for pair in pairs.iter_mut() {
            let explained = effects(pair) * &found;
            pair.difference_mm -= Vector3::new(explained[0], explained[1], explained[2]);
        }
    }
}

/// Number of parameters of [`PlacedRows::remove_placement`].
pub fn n_of_placement(pairs: &[Pair], points: &[Point]) -> usize {
    let n_targets = pairs.iter().map(|pair| points[pair.row].target + 1).max();
    7 + 3 * n_targets.unwrap_or(0)
}

/// Constant offsets of the first and the last joint in all rows. They are equivalent to rotations of base and reflector, which are fitted
/// anew. A copy with such offsets thus fits as well as the original file.
pub struct Offset {
    first_rad: f64,
    last_rad: f64,
}

impl Offset {
    pub fn add_to(&self, q_rad: &mut [f64]) {
        if let [first, .., last] = q_rad {
            *first += self.first_rad;
            *last += self.last_rad;
        }
    }
}

/// The most frequent offset of rows of `later` relative to earlier rows that agree in all joints except the first and the last.
pub fn constant_offset(earlier: &MeasurementSet, later: &MeasurementSet) -> Option<Offset> {
    let step = later.points.len().div_ceil(COMPARED_ROWS).max(1);
    let mut differences: Vec<(f64, f64)> = Vec::new();
    for point in later.points.iter().step_by(step) {
        let [_, inner @ .., _] = point.q_rad.as_slice() else {
            return None;
        };
        for known in earlier.points.iter().filter(|p| p.target == point.target) {
            let [first, known_inner @ .., last] = known.q_rad.as_slice() else {
                continue;
            };
            let mut apart = apart_rad(inner, known_inner).into_iter();
            if apart.all(|rad| rad <= SAME_POSE_RAD) {
                let [first_rad, .., last_rad] = point.q_rad.as_slice() else {
                    continue;
                };
                differences.push((
                    within_half_a_turn(first_rad - first),
                    within_half_a_turn(last_rad - last),
                ));
            }
        }
    }
    let first_rad = most_frequent(differences.iter().map(|(first, _)| *first))?;
    let of_first = differences
        .iter()
        .filter(|(first, _)| (first - first_rad).abs() <= SAME_POSE_RAD);
    let last_rad = most_frequent(of_first.map(|(_, last)| *last))?;
    let offset = Offset {
        first_rad,
        last_rad,
    };
    // Without an offset, the poses have already been compared.
    let is_none = first_rad.abs().max(last_rad.abs()) <= SAME_POSE_RAD;
    (!is_none).then_some(offset)
}

/// The median of the largest cluster of values that lie within the tolerance of one pose.
fn most_frequent(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let mut most: &[f64] = &[];
    for (begin, value) in sorted.iter().enumerate() {
        let n = sorted[begin..].partition_point(|other| *other <= value + SAME_POSE_RAD);
        if n > most.len() {
            most = &sorted[begin..begin + n];
        }
    }
    most.get(most.len() / 2).copied()
}

/// A row, and an earlier row whose pose it repeats.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The row.
    pub row: usize,
    /// The earlier row.
    pub earlier_row: usize,
    /// Largest difference of a joint value, rad.
    pub reading_rad: f64,
    /// Displacement of the reflector that the difference of joint values predicts.
    pub predicted_mm: Vector3<f64>,
    /// Measured displacement, after removing the rigid motion.
    pub difference_mm: Vector3<f64>,
}

/// Position of a reflector, mm, in the frame of the positions, at the controller's joint values.
pub fn position(
    robot: &Robot,
    model: &KinematicModel,
    q_rad: &[f64],
    target: usize,
) -> Vector3<f64> {
    model.position(&robot.q_model_rad(q_rad), target)
}

pub fn observations(robot: &Robot, set: &MeasurementSet) -> Vec<Observation> {
    let step = set.points.len().div_ceil(MAX_FITTED).max(1);
    let observation =
        |p: &Point| Observation::at(robot.q_model_rad(&p.q_rad), p.position_mm, p.target);
    set.points.iter().step_by(step).map(observation).collect()
}

/// Absolute difference of each joint, without whole turns.
fn apart_rad(a: &[f64], b: &[f64]) -> Vec<f64> {
    let apart = |(a, b): (&f64, &f64)| within_half_a_turn(a - b).abs();
    a.iter().zip(b).map(apart).collect()
}
