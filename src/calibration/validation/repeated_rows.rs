//! Finds rows of an upload that only repeat an earlier upload and so are no new measurement: a file that is uploaded again, rounded, transformed to
//! another frame, or with a little noise added.
//!
//! Rows that repeat an earlier row's pose count as a new measurement only if the noise shows it. A rigid motion is removed first. It is no evidence
//! of a new measurement, because a file is easily transformed.
//! - Noise of the joint readings: a robot that returns to a pose reads joint values that differ by a few thousandths of a degree, and its positions
//!   follow these readings. Noise that is added to a file does not follow them.
//! - Noise of the positions: a point that was off by chance is nearer the next time. The change between two measurements is thus negatively
//!   correlated with the residuals of the first and positively with those of the second. Noise that is added to a copy is not correlated with the
//!   residuals of the original, and a copy that is only transformed has no noise.
//!
//! A constant displacement of each reflector in the flange frame is removed as well: somebody has mounted it again. So is a constant offset of all
//! values of the first or the last joint: it only rotates the base or the reflector, which are placed anew.
//!
//! If neither noise shows, a new measurement cannot be told from a copy, and the rows count as repeated.

use crate::calibration::validation::session_fit::fitted_as_well_as_can_be;
use crate::identification::KinematicModel;
use crate::identification::objective::Observation;
use crate::identification::start::align_in_closed_form;
use crate::kinematics::{Robot, reach_mm, t_base_flange};
use crate::measurement::{Frame, MeasurementSet, Point};
use nalgebra::{
    DMatrix, DVector, IsometryMatrix3, Matrix3, Matrix3xX, Point3, Rotation3, Translation3, Vector3,
};
use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// Joint values that differ by less than this in every joint are the same pose, rad (0.02°): controllers return to a pose and read it to 0.01°. A
/// joint near the reflector may differ by more, as long as it moves the reflector no further than this angle turns the whole arm.
const SAME_POSE_RAD: f64 = 3.5e-4;
/// Joint readings that differ by less than this are the same reading, copied, rad.
const SAME_READING_RAD: f64 = 1e-9;
/// A session that repeats more than this share of its rows is not a new measurement. A smaller share is allowed, because a home pose may recur.
const MAX_REPEATED: f64 = 0.1;
/// Minimum number of repeated rows for judging noise.
const FEWEST_ROWS: usize = 10;
/// Maximum number of rows for finding a constant offset of a joint, evenly from the whole set. Each is compared with every earlier row.
const COMPARED_ROWS: usize = 100;
/// Earlier uploads whose positions differ by up to this multiple of the smallest difference are tested by the noise of the positions, because the
/// robot is fitted to each of them. If one of them is repeated, all others are tested as well.
const NEAR: f64 = 1.2;
/// And a difference as of rounded numbers, as a share of the reach: 0.01 mm of 2 m.
const ROUNDED_PER_REACH: f64 = 5e-6;
/// Maximum number of earlier uploads that are tested so. Of a copy, the others count as repeated.
const MOST_TESTED: usize = 50;
/// Maximum number of rows that the robot is fitted to, evenly from the whole set.
const MAX_FITTED: usize = 2_000;
/// Singular values below this share of the largest diagonal element are rounding errors.
const ROUNDING: f64 = 1e-9;
/// Step of a joint for computing how far it moves the reflector, rad.
const STEP_RAD: f64 = 1e-4;
/// Positions follow the readings if the slope of their regression is at least this (1 for noise-free readings).
const FOLLOWS: f64 = 0.5;
/// Positions that differ by more than this multiple of the residuals of both fits were measured anew: the robot has changed. A fit of 30 parameters
/// to 36 equations leaves 0.4 of the noise.
const FAR: f64 = 6.0;
/// A significant slope differs from zero by this number of standard errors: by chance once in some millions.
const SIGNIFICANT: f64 = 5.0;
/// A row is clipped to this multiple of the median. A single outlier that was measured again does not prove that all rows were.
const CLIPPED: f64 = 3.0;

/// The rows of an upload that repeat each of several earlier uploads, where nothing shows that they were measured anew.
#[derive(Clone, Debug)]
pub struct RepeatedRows {
    /// The rows that repeat one earlier upload, for each of them.
    of_earlier: Vec<BTreeSet<usize>>,
    /// Number of rows of the upload.
    n_rows: usize,
}

impl RepeatedRows {
    /// Compares `later` with each earlier upload. Itself must not be among them.
    pub fn find<'a>(
        robot: &Robot,
        earlier: impl IntoIterator<Item = &'a MeasurementSet>,
        later: &MeasurementSet,
    ) -> Self {
        let later = Later::new(robot, later);
        let mut of_earlier = Vec::new();
        let mut alike: Vec<(usize, Alike<'_>)> = Vec::new();
        for (index, set) in earlier.into_iter().enumerate() {
            of_earlier.push(BTreeSet::new());
            alike.extend(later.alike(set).into_iter().map(|alike| (index, alike)));
        }
        // of a copy, the original is the nearest: a new measurement differs by its own noise as well
        alike.sort_by(|a, b| a.1.median_mm.total_cmp(&b.1.median_mm));
        let is_testable = |alike: &Alike<'_>| alike.pairs.len() >= FEWEST_ROWS;
        let mut testable = alike.iter().filter(|(_, alike)| is_testable(alike));
        let nearest_mm = testable.next().map_or(0.0, |(_, a)| a.median_mm);
        let near_mm = NEAR * nearest_mm + ROUNDED_PER_REACH * reach_mm(&robot.links);
        let (mut n_tested, mut is_copy) = (0, false);
        for (index, alike) in &alike {
            let is_new = is_testable(alike) && {
                let is_tested = alike.median_mm <= near_mm || is_copy;
                n_tested += usize::from(is_tested);
                // of a copy, every older upload may be the original
                let is_tested = is_tested && n_tested <= MOST_TESTED;
                match is_tested {
                    true => later.noise_is_new(alike),
                    false => !is_copy,
                }
            };
            if !is_new {
                is_copy |= is_testable(alike);
                of_earlier[*index].extend(alike.pairs.iter().map(|pair| pair.row));
            }
        }
        Self {
            of_earlier,
            n_rows: later.set.points.len(),
        }
    }

    /// True if more than one row in ten repeats one of the earlier uploads with an index in `among`, taken together.
    pub fn repeats(&self, among: impl IntoIterator<Item = usize>) -> bool {
        let rows: BTreeSet<usize> = among
            .into_iter()
            .flat_map(|earlier| &self.of_earlier[earlier])
            .copied()
            .collect();
        rows.len() as f64 > MAX_REPEATED * self.n_rows as f64
    }

    /// The first index in `among` of an earlier upload that is repeated. If only several together are repeated, the first with a repeated row.
    pub fn first(&self, among: impl IntoIterator<Item = usize> + Clone) -> Option<usize> {
        if !self.repeats(among.clone()) {
            return None;
        }
        let mut alone = among.clone().into_iter();
        let has_rows = |earlier: &usize| !self.of_earlier[*earlier].is_empty();
        alone
            .find(|earlier| self.repeats([*earlier]))
            .or_else(|| among.into_iter().find(has_rows))
    }
}

/// True if `later` repeats rows of earlier uploads, more than one row in ten in total, and nothing shows that they were measured anew.
pub fn repeats(robot: &Robot, earlier: &[MeasurementSet], later: &MeasurementSet) -> bool {
    RepeatedRows::find(robot, earlier, later).repeats(0..earlier.len())
}

/// True if `later` was measured anew and is not a copy of `earlier`.
pub fn is_anew(robot: &Robot, earlier: &MeasurementSet, later: &MeasurementSet) -> bool {
    !repeats(robot, std::slice::from_ref(earlier), later)
}

/// The upload that is compared with earlier ones, and what of it does not depend on them.
struct Later<'a> {
    robot: &'a Robot,
    set: &'a MeasurementSet,
    /// The nominal robot placed on the upload; `None` if it has too few rows.
    placed: Option<PlacedRows>,
    /// The fitted robot, if it was needed.
    fitted: OnceCell<Option<KinematicModel>>,
}

/// The nominal robot placed on an upload.
struct PlacedRows {
    model: KinematicModel,
    rows: Vec<PlacedRow>,
}

/// A row of the placed robot.
struct PlacedRow {
    /// The reflector's position, mm.
    here_mm: Vector3<f64>,
    /// How far each joint moves the reflector, mm/rad.
    levers_mm: Vec<f64>,
    /// Rotation of the flange in the frame of the positions.
    r_flange: Matrix3<f64>,
}

impl PlacedRows {
    fn new(robot: &Robot, set: &MeasurementSet) -> Option<Self> {
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
}

/// The rows of the later upload with the pose of a row of an earlier one.
struct Alike<'a> {
    /// The earlier upload, with an offset of its joint values if there is one.
    earlier: Cow<'a, MeasurementSet>,
    pairs: Vec<Pair>,
    /// Rotation from the earlier frame to the later one.
    r_later_earlier: Rotation3<f64>,
    /// Median of the differences of position, without the rigid motion.
    median_mm: f64,
}

impl<'a> Later<'a> {
    fn new(robot: &'a Robot, set: &'a MeasurementSet) -> Self {
        Self {
            robot,
            set,
            placed: PlacedRows::new(robot, set),
            fitted: OnceCell::new(),
        }
    }

    /// The rows with the pose of a row of `earlier`, except those whose readings show that they were measured anew; once as they are, and once with a
    /// constant offset of the first and the last joint, if there is one.
    fn alike<'b>(&self, earlier: &'b MeasurementSet) -> Vec<Alike<'b>> {
        let Some(placed) = &self.placed else {
            return Vec::new();
        };
        let mut sets = vec![Cow::Borrowed(earlier)];
        if let Some(offset) = constant_offset(earlier, self.set) {
            let mut turned = earlier.clone();
            for point in &mut turned.points {
                offset.add_to(&mut point.q_rad);
            }
            sets.push(Cow::Owned(turned));
        }
        let alike = sets.into_iter().map(|set| self.alike_rows(placed, set));
        alike.filter(|alike| !alike.pairs.is_empty()).collect()
    }

    fn alike_rows<'b>(&self, placed: &PlacedRows, earlier: Cow<'b, MeasurementSet>) -> Alike<'b> {
        let mut pairs = self.same_poses(placed, &earlier);
        let mut r_later_earlier = Rotation3::identity();
        if pairs.len() >= FEWEST_ROWS {
            let of_pair = |pair: &Pair| {
                let before = earlier.points[pair.earlier_row].position_mm;
                (before, self.set.points[pair.row].position_mm)
            };
            let positions: Vec<_> = pairs.iter().map(of_pair).collect();
            let t_later_earlier = rigid_motion(&positions);
            for (pair, (before, after)) in pairs.iter_mut().zip(positions) {
                pair.difference_mm = after - (t_later_earlier * Point3::from(before)).coords;
            }
            remove_placement(&mut pairs, &self.set.points, &placed.rows);
            r_later_earlier = t_later_earlier.rotation;
            let (same, reread): (Vec<Pair>, Vec<Pair>) = pairs
                .into_iter()
                .partition(|pair| pair.reading_rad <= SAME_READING_RAD);
            let is_reread = positions_follow_readings(&reread);
            pairs = same;
            pairs.extend(reread.into_iter().filter(|_| !is_reread));
        }
        Alike {
            earlier,
            median_mm: median(pairs.iter().map(|pair| pair.difference_mm.norm())),
            pairs,
            r_later_earlier,
        }
    }

    /// Each row with the nearest earlier row of the same target and the same pose, if there is one.
    fn same_poses(&self, placed: &PlacedRows, earlier: &MeasurementSet) -> Vec<Pair> {
        let (robot, model) = (self.robot, &placed.model);
        let same_mm = SAME_POSE_RAD * reach_mm(&robot.links);
        let x_mm = |(row, p): (usize, &Point)| {
            let is_known = p.target < model.targets_mm.len();
            is_known.then(|| (position(robot, model, &p.q_rad, p.target).x, row))
        };
        // sorted by the reflector's x coordinate: joint values within the tolerance of one pose move it by a bounded distance
        let mut known: Vec<(f64, usize)> =
            earlier.points.iter().enumerate().filter_map(x_mm).collect();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut pairs = Vec::new();
        for (row, (point, placed)) in self.set.points.iter().zip(&placed.rows).enumerate() {
            let (here, levers_mm) = (&placed.here_mm, &placed.levers_mm);
            let width_mm = 2.0 * same_mm * levers_mm.len() as f64;
            let begin = known.partition_point(|(x, _)| *x < here.x - width_mm);
            let nearest = known[begin..]
                .iter()
                .take_while(|(x, _)| *x <= here.x + width_mm)
                .filter(|(_, other)| earlier.points[*other].target == point.target)
                .map(|(_, other)| {
                    let apart = apart_rad(&earlier.points[*other].q_rad, &point.q_rad);
                    let moved = apart.iter().zip(levers_mm).map(|(rad, mm)| rad * mm);
                    (moved.fold(0.0, f64::max), apart, *other)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, apart, earlier_row)) = nearest.filter(|(mm, ..)| *mm <= same_mm) {
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

    /// True if the changes are correlated with the residuals of both measurements as new noise requires.
    fn noise_is_new(&self, alike: &Alike<'_>) -> bool {
        let robot = self.robot;
        let fitted = |set| fitted_as_well_as_can_be(&robot.links, &observations(robot, set));
        let Some(after) = self.fitted.get_or_init(|| fitted(self.set)) else {
            return false;
        };
        let residual = |model: &KinematicModel, point: &Point| {
            point.position_mm - position(robot, model, &point.q_rad, point.target)
        };
        let of_pairs = |vector: &dyn Fn(&Pair) -> Vector3<f64>| {
            clipped(alike.pairs.iter().map(vector).collect())
        };
        let change = of_pairs(&|pair| pair.difference_mm - pair.predicted_mm);
        let runs_against = |residuals: Vec<Vector3<f64>>, sign: f64| {
            let change = change.iter().map(|v| v * sign);
            let (slope, standard_error) =
                regression(&residuals.into_iter().zip(change).collect::<Vec<_>>());
            slope <= -SIGNIFICANT * standard_error
        };
        let after = of_pairs(&|pair| residual(after, &self.set.points[pair.row]));
        // noise that was added to a copy is among the residuals of one of the fits
        let exceeds = |residuals: &[Vector3<f64>]| {
            alike.median_mm > FAR * median(residuals.iter().map(Vector3::norm))
        };
        let is_far = exceeds(&after);
        if !is_far && !runs_against(after, -1.0) {
            return false;
        }
        let Some(before) = fitted(&alike.earlier) else {
            return false;
        };
        let before = of_pairs(&|pair| {
            alike.r_later_earlier * residual(&before, &alike.earlier.points[pair.earlier_row])
        });
        match is_far {
            true => exceeds(&before),
            false => runs_against(before, 1.0),
        }
    }
}

/// Constant offsets of the first and the last joint in all rows. They rotate the base and the reflector, which are placed anew, so that a copy with
/// such offsets fits as well as the original file.
struct Offset {
    first_rad: f64,
    last_rad: f64,
}

impl Offset {
    fn add_to(&self, q_rad: &mut [f64]) {
        if let [first, .., last] = q_rad {
            *first += self.first_rad;
            *last += self.last_rad;
        }
    }
}

/// The most frequent offset of rows of `later` relative to earlier rows that agree in all joints except the first and the last.
fn constant_offset(earlier: &MeasurementSet, later: &MeasurementSet) -> Option<Offset> {
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
    // without an offset, the poses have already been compared
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

fn within_half_a_turn(rad: f64) -> f64 {
    rad - TAU * (rad / TAU).round()
}

/// A row, and the earlier row whose pose it repeats.
struct Pair {
    row: usize,
    earlier_row: usize,
    /// Largest difference of a joint value, rad.
    reading_rad: f64,
    /// Displacement of the reflector that the difference of joint values predicts.
    predicted_mm: Vector3<f64>,
    /// Measured displacement, without the rigid motion.
    difference_mm: Vector3<f64>,
}

/// Position of a reflector, mm, in the frame of the positions, at the controller's joint values.
fn position(robot: &Robot, model: &KinematicModel, q_rad: &[f64], target: usize) -> Vector3<f64> {
    model.position(&robot.q_model_rad(q_rad), target)
}

fn observations(robot: &Robot, set: &MeasurementSet) -> Vec<Observation> {
    let step = set.points.len().div_ceil(MAX_FITTED).max(1);
    let observation = |p: &Point| Observation {
        q_rad: robot.q_model_rad(&p.q_rad),
        position_mm: p.position_mm,
        target: p.target,
        weight: 1.0,
        whitening: None,
        rotation: None,
    };
    set.points.iter().step_by(step).map(observation).collect()
}

/// Absolute difference of each joint, without whole turns.
fn apart_rad(a: &[f64], b: &[f64]) -> Vec<f64> {
    let apart = |(a, b): (&f64, &f64)| within_half_a_turn(a - b).abs();
    a.iter().zip(b).map(apart).collect()
}

/// The rotation and shift that bring the first positions nearest to the second, with the smallest sum of squares [Arun 1987; Kabsch 1978].
fn rigid_motion(positions: &[(Vector3<f64>, Vector3<f64>)]) -> IsometryMatrix3<f64> {
    let n = positions.len() as f64;
    let from = positions.iter().map(|(from, _)| from).sum::<Vector3<f64>>() / n;
    let to = positions.iter().map(|(_, to)| to).sum::<Vector3<f64>>() / n;
    let correlation: Matrix3<f64> = positions
        .iter()
        .map(|(a, b)| (b - to) * (a - from).transpose())
        .sum();
    let svd = correlation.svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            let signs = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
            Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t)
        }
        _ => Rotation3::identity(),
    };
    IsometryMatrix3::from_parts(Translation3::from(to - rotation * from), rotation)
}

/// Removes from the differences of position what a small motion of the instrument and a reflector that was mounted again explain, in the sense of least
/// squares: difference = shift + rotation × position + R_flange · δ, with δ of each target in the flange frame.
fn remove_placement(pairs: &mut [Pair], points: &[Point], rows: &[PlacedRow]) {
    let n_targets = pairs.iter().map(|pair| points[pair.row].target + 1).max();
    let n = 6 + 3 * n_targets.unwrap_or(0);
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
        effects
            .fixed_columns_mut::<3>(6 + 3 * target)
            .copy_from(&row.r_flange);
        effects
    };
    let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for pair in pairs.iter() {
        let effects = effects(pair);
        normal += effects.tr_mul(&effects);
        right += effects.tr_mul(&pair.difference_mm);
    }
    // a direction that the poses do not show stays as it is
    let largest = normal.diagonal().max();
    let Ok(found) = normal.svd(true, true).solve(&right, ROUNDING * largest) else {
        return;
    };
    for pair in pairs.iter_mut() {
        let explained = effects(pair) * &found;
        pair.difference_mm -= Vector3::new(explained[0], explained[1], explained[2]);
    }
}

/// True if the positions follow the joint readings from one visit of a pose to the next.
fn positions_follow_readings(pairs: &[Pair]) -> bool {
    if pairs.len() < FEWEST_ROWS {
        return false;
    }
    let vectors: Vec<(Vector3<f64>, Vector3<f64>)> = pairs
        .iter()
        .map(|pair| (pair.predicted_mm, pair.difference_mm))
        .collect();
    let (slope, standard_error) = regression(&vectors);
    slope >= FOLLOWS && slope >= SIGNIFICANT * standard_error
}

/// The median; 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// The vectors, with lengths limited to [`CLIPPED`] times the median.
fn clipped(vectors: Vec<Vector3<f64>>) -> Vec<Vector3<f64>> {
    let mut lengths: Vec<f64> = vectors.iter().map(Vector3::norm).collect();
    lengths.sort_by(f64::total_cmp);
    let longest = CLIPPED * lengths[lengths.len() / 2];
    vectors
        .into_iter()
        .map(|v| v * (longest / v.norm()).min(1.0))
        .collect()
}

/// Slope of the regression of the second vectors on the first, and its standard error; NaN if the first vectors are zero.
fn regression(vectors: &[(Vector3<f64>, Vector3<f64>)]) -> (f64, f64) {
    let squares: f64 = vectors.iter().map(|(x, _)| x.norm_squared()).sum();
    let slope = vectors.iter().map(|(x, y)| x.dot(y)).sum::<f64>() / squares;
    let left: f64 = vectors
        .iter()
        .map(|(x, y)| (y - x * slope).norm_squared())
        .sum();
    let degrees_of_freedom = (3 * vectors.len() - 1) as f64;
    (slope, (left / degrees_of_freedom / squares).sqrt())
}
