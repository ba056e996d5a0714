//! Finds rows of an upload that only repeat an earlier upload and so are no new measurement: a file that was uploaded again, possibly
//! rounded, transformed to another frame, or with a little noise added.
//!
//! Rows that repeat an earlier row's pose count as a new measurement only if their noise shows it. A rigid motion is removed first. It is
//! no evidence of a new measurement, because a file is easily transformed.
//! - Noise of the joint readings: a robot that returns to a pose reads joint values that differ by a few thousandths of a degree, and its positions
//!   follow these readings. Noise that is added to a file does not follow them.
//! - Noise of the positions: a point that was off by chance is nearer the next time. The change between two measurements is thus negatively
//!   correlated with the residuals of the first and positively with those of the second. Noise that is added to a copy is not correlated with the
//!   residuals of the original, and a copy that is only transformed has no noise.
//!
//! Other things are removed too, because they are no evidence of a new measurement: another scale of all positions (a file is easily
//! converted to another temperature); a constant displacement of each reflector in the flange frame (it may have been mounted again); and a
//! constant offset of all values of the first or the last joint (it is equivalent to a rotation of the base or the reflector, which are
//! fitted anew).
//!
//! Positions that differ by much more than the scatter of both files are no copy either: the robot has changed in between.
//!
//! Rows may come from several visits: a pose is measured twice in one upload, or two uploads are joined in one file. Each row is therefore
//! compared with every earlier visit of its pose. Two measurements differ by their noise. A row that agrees with an earlier row ten times
//! better is a copy of it.
//!
//! If there is no sign of new noise, a new measurement cannot be distinguished from a copy, and the rows count as repeated.

use crate::calibration::validation::same_poses::{
    Pair, PlacedRows, constant_offset, n_of_placement, observations, position,
};
use crate::calibration::validation::session_fit::fitted_to_session;
use crate::identification::KinematicModel;
use crate::identification::least_squares::start::rigid_motion;
use crate::kinematics::{Robot, reach_mm};
use crate::measurement::{MeasurementSet, Point};
use crate::solvers::median::median;
use nalgebra::{Point3, Rotation3, Vector3};
use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::BTreeSet;

/// Joint readings that differ by less than this are copies of one reading, rad.
const SAME_READING_RAD: f64 = 1e-9;
/// A session that repeats more than this share of its rows is not a new measurement. A smaller share is allowed, because a home pose may recur.
const MAX_REPEATED: f64 = 0.1;
/// Minimum number of repeated rows for judging noise.
const MIN_ROWS: usize = 10;
/// Uploads are selected for the test of position noise: the one with the smallest difference of positions, and those whose difference is at
/// most this multiple of it. The selection limits the time, because the robot is fitted to each. If one of them is repeated, all others are
/// tested as well.
const MAX_DIFFERENCE_RATIO: f64 = 1.2;
/// Added to this limit, so that differences from rounding do not exceed it; as a share of the reach: 0.01 mm of 2 m.
const ROUNDED_PER_REACH: f64 = 5e-6;
/// Maximum number of earlier uploads that are tested for position noise. If the upload is a copy, the others count as repeated.
const MAX_TESTED: usize = 50;
/// Positions follow the readings if the slope of their regression is at least this (1 for noise-free readings).
const FOLLOWS: f64 = 0.5;
/// If the positions differ by more than this multiple of the residuals of both fits, they were measured anew: the robot has changed. The
/// multiple allows for small residuals: a fit of 30 parameters to 36 equations leaves 0.4 of the noise.
const MEASURED_ANEW_RATIO: f64 = 6.0;
/// A slope is significant if it differs from zero by this number of standard errors: by chance once in some millions.
const SIGNIFICANT: f64 = 5.0;
/// A row is a copy of an earlier row if they differ by less than this share of the typical difference between measurements of one pose (the
/// upper quartile). By chance, three coordinates are that close in two of a thousand rows.
const COPIED: f64 = 0.1;
/// Copies are looked for only if the rounding step of the positions is at most this multiple of the copy threshold. With coarser steps, two
/// measurements may give equal numbers.
const STEPS_PER_COPIED: f64 = 1.5;
/// Ratio of two lengths: the difference between measurements of one pose (upper quartile), and the error of a fit to one visit (median). √2
/// · 2.03/1.54 for three normal coordinates.
const DIFFERENCE_PER_ERROR: f64 = 1.86;
/// Number of rounds in which the placement is found again, each time from the third of the rows that agree best. A third, because three
/// files may have been joined.
const ALIGNED_ROUNDS: usize = 8;
const ALIGNED_SHARE: usize = 3;
/// Minimum number of rows per parameter of the placement. With fewer, the best-agreeing rows may agree by chance.
const ROWS_PER_PLACEMENT: usize = 3;
/// Vectors are clipped to this multiple of the median length. Otherwise a single outlier that was measured again would prove that all rows
/// were.
const CLIPPED: f64 = 3.0;

/// The rows of an upload that repeat each of several earlier uploads and show no sign of a new measurement.
#[derive(Clone, Debug)]
pub struct RepeatedRows {
    /// The rows that repeat one earlier upload, for each of them.
    of_earlier: Vec<BTreeSet<usize>>,
    /// Number of rows of the upload.
    n_rows: usize,
}

impl RepeatedRows {
    /// Compares `later` with each earlier upload. `later` must not be among them.
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
        // With more uploads of the same poses, a row is near one of them by chance more often.
        let copied: Vec<(usize, Vec<usize>)> = alike
            .iter()
            .map(|(index, found)| (*index, later.copied_rows(&found.visits, alike.len())))
            .collect();
        for (index, rows) in copied {
            of_earlier[index].extend(rows);
        }
        // A copy is nearest to its original, because a new measurement also differs by its own noise.
        alike.sort_by(|a, b| a.1.median_mm.total_cmp(&b.1.median_mm));
        let is_testable = |alike: &Alike<'_>| alike.pairs.len() >= MIN_ROWS;
        let mut testable = alike.iter().filter(|(_, alike)| is_testable(alike));
        let nearest_mm = testable.next().map_or(0.0, |(_, a)| a.median_mm);
        let near_mm =
            MAX_DIFFERENCE_RATIO * nearest_mm + ROUNDED_PER_REACH * reach_mm(&robot.links);
        let (mut n_tested, mut is_copy) = (0, false);
        for (index, alike) in &alike {
            let is_new = is_testable(alike) && {
                let is_tested = alike.median_mm <= near_mm || is_copy;
                n_tested += usize::from(is_tested);
                // For a copy, every older upload may be the original.
                let is_tested = is_tested && n_tested <= MAX_TESTED;
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

/// The upload that is compared with earlier ones, with results that do not depend on these.
struct Later<'a> {
    robot: &'a Robot,
    set: &'a MeasurementSet,
    /// The nominal robot placed on the upload; `None` if it has too few rows.
    placed: Option<PlacedRows>,
    /// The fitted robot, if it was needed.
    fitted: OnceCell<Option<KinematicModel>>,
}

/// The rows of the later upload with the pose of a row of an earlier one.
struct Alike<'a> {
    /// The earlier upload, corrected for an offset of its joint values if there is one.
    earlier: Cow<'a, MeasurementSet>,
    pairs: Vec<Pair>,
    /// For each row, every earlier visit of its pose, with the displacement before placement is removed.
    visits: Vec<Pair>,
    /// Rotation from the earlier frame to the later one.
    r_later_earlier: Rotation3<f64>,
    /// Median of the differences of position, after removing the rigid motion.
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

    /// The rows with the pose of a row of `earlier`, without those whose readings show that they were measured anew. If there is a constant
    /// offset of the first and the last joint, the comparison is made once without and once with it.
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
        let mut visits = placed.same_poses(self.robot, self.set, &earlier);
        let mut pairs = visits.clone();
        pairs.dedup_by_key(|pair| pair.row);
        let mut r_later_earlier = Rotation3::identity();
        if pairs.len() >= MIN_ROWS {
            r_later_earlier = self.remove_motion(placed, &earlier, &mut pairs);
            self.remove_motion(placed, &earlier, &mut visits);
            let (same, reread): (Vec<Pair>, Vec<Pair>) = pairs
                .into_iter()
                .partition(|pair| pair.reading_rad <= SAME_READING_RAD);
            let is_reread = positions_follow_readings(&reread);
            visits.retain(|pair| !(is_reread && pair.reading_rad > SAME_READING_RAD));
            pairs = same;
            pairs.extend(reread.into_iter().filter(|_| !is_reread));
        }
        Alike {
            earlier,
            median_mm: median(pairs.iter().map(|pair| pair.difference_mm.norm())).unwrap_or(0.0),
            pairs,
            visits,
            r_later_earlier,
        }
    }

    /// Removes the rigid motion and the placement from the differences of position. Returns the rotation from the earlier frame to the
    /// later one.
    fn remove_motion(
        &self,
        placed: &PlacedRows,
        earlier: &MeasurementSet,
        pairs: &mut [Pair],
    ) -> Rotation3<f64> {
        let of_pair = |pair: &Pair| {
            let before = earlier.points[pair.earlier_row].position_mm;
            (before, self.set.points[pair.row].position_mm)
        };
        let (before, after): (Vec<_>, Vec<_>) = pairs.iter().map(of_pair).unzip();
        let t_later_earlier = rigid_motion(&before, &after);
        for (pair, (before, after)) in pairs.iter_mut().zip(before.into_iter().zip(after)) {
            pair.difference_mm = after - (t_later_earlier * Point3::from(before)).coords;
        }
        placed.remove_placement(pairs, &self.set.points);
        t_later_earlier.rotation
    }

    /// The rows that are copies of one of these earlier visits of their poses. `n_uploads` is the number of uploads with such visits.
    fn copied_rows(&self, visits: &[Pair], n_uploads: usize) -> Vec<usize> {
        let points = &self.set.points;
        let Some(placed) = &self.placed else {
            return Vec::new();
        };
        let mut near: Vec<Pair> = visits.to_vec();
        let length_mm = |pair: &Pair| pair.difference_mm.norm();
        let n_rows = visits.chunk_by(|a, b| a.row == b.row).count();
        if n_rows < ROWS_PER_PLACEMENT * n_of_placement(visits, points) {
            return Vec::new();
        }
        let mut lengths: Vec<f64> = visits.iter().map(length_mm).collect();
        lengths.sort_by(f64::total_cmp);
        let typical_mm = lengths[3 * lengths.len() / 4];
        // Copies agree exactly only if the placement is computed from copies alone: any other row adds its noise to it.
        for _ in 0..ALIGNED_ROUNDS {
            near.sort_by(|a, b| length_mm(a).total_cmp(&length_mm(b)));
            let mut seen = BTreeSet::new();
            let (mut nearest, others): (Vec<Pair>, Vec<Pair>) =
                near.into_iter().partition(|pair| seen.insert(pair.row));
            nearest.extend(others);
            near = nearest;
            placed.remove_placement_of(&mut near, n_rows.div_ceil(ALIGNED_SHARE), points);
        }
        let chances = n_uploads as f64 * visits.len() as f64 / n_rows as f64;
        let copied = |typical_mm: f64| -> Vec<usize> {
            let copied_mm = COPIED * typical_mm / libm::cbrt(chances);
            let is_told = rounding_mm(self.set) <= STEPS_PER_COPIED * copied_mm;
            let copies = near.iter().filter(|pair| length_mm(pair) < copied_mm);
            copies.filter(|_| is_told).map(|pair| pair.row).collect()
        };
        let rows = copied(typical_mm);
        if rows.is_empty() {
            return rows;
        }
        // A robot that has changed causes larger differences than the noise.
        let error_mm = self.fitted().and_then(|model| {
            let residual =
                |p: &Point| p.position_mm - position(self.robot, model, &p.q_rad, p.target);
            median(points.iter().map(|p| residual(p).norm()))
        });
        let noise_mm = error_mm.map_or(typical_mm, |mm| DIFFERENCE_PER_ERROR * mm);
        copied(typical_mm.min(noise_mm))
    }

    /// The robot fitted to the upload; `None` if it cannot be.
    fn fitted(&self) -> Option<&KinematicModel> {
        let fitted = || {
            let observations = observations(self.robot, self.set);
            fitted_to_session(&self.robot.links, &observations)
        };
        self.fitted.get_or_init(fitted).as_ref()
    }

    /// True if the differences are correlated with the residuals of both measurements as expected for new noise.
    fn noise_is_new(&self, alike: &Alike<'_>) -> bool {
        let robot = self.robot;
        let fitted = |set| fitted_to_session(&robot.links, &observations(robot, set));
        let Some(after) = self.fitted() else {
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
        // Noise that was added to a copy is part of the residuals of one of the fits.
        let exceeds = |residuals: &[Vector3<f64>]| {
            alike.median_mm
                > MEASURED_ANEW_RATIO * median(residuals.iter().map(Vector3::norm)).unwrap_or(0.0)
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

/// Rounding step of the positions, mm: the largest power of ten, up to 1 mm, of which all are multiples. 0 below 1 nm.
fn rounding_mm(set: &MeasurementSet) -> f64 {
    let is_multiple = |step_mm: f64| {
        let mut all = set.points.iter().flat_map(|p| p.position_mm.iter());
        all.all(|x| (x / step_mm - (x / step_mm).round()).abs() < 1e-3)
    };
    let steps_mm = [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];
    let found = steps_mm.into_iter().find(|step_mm| is_multiple(*step_mm));
    found.unwrap_or(0.0)
}

/// True if the positions follow the joint readings from one visit of a pose to the next.
fn positions_follow_readings(pairs: &[Pair]) -> bool {
    if pairs.len() < MIN_ROWS {
        return false;
    }
    let vectors: Vec<(Vector3<f64>, Vector3<f64>)> = pairs
        .iter()
        .map(|pair| (pair.predicted_mm, pair.difference_mm))
        .collect();
    let (slope, standard_error) = regression(&vectors);
    slope >= FOLLOWS && slope >= SIGNIFICANT * standard_error
}

/// The vectors, with lengths limited to [`CLIPPED`] times the median.
fn clipped(vectors: Vec<Vector3<f64>>) -> Vec<Vector3<f64>> {
    let longest = CLIPPED * median(vectors.iter().map(Vector3::norm)).unwrap_or(0.0);
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
