//! A measurement set: joint values, and the measured positions or poses of the target.

use crate::measurement::conventions::{Frame, Subset};
use crate::measurement::position_noise::PositionNoise;
use nalgebra::{Rotation3, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// One measured position or pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Joint values as uploaded, in the convention of the controller, rad.
    pub q_rad: Vec<f64>,
    /// Measured target position in the measuring frame, mm.
    pub position_mm: Vector3<f64>,
    /// Label of the arm configuration. Points of one configuration have the same label and are never split between identify and verify. Parsers fill
    /// it for every point; without a column, points with equal joint values get the same label.
    pub configuration: String,
    /// Its name in the file, if the file names its points. It is only shown: what belongs together is decided by the configuration.
    pub name: Option<String>,
    /// The line of the file on which it stands, counted from 1; with two files, that of the instrument's file.
    pub line: Option<usize>,
    /// Number of the reflector on the tool, 0-based.
    pub target: usize,
    /// Name of the reflector, if the set has names. Sessions that are fitted together share the targets of the same name.
    pub target_name: Option<String>,
    /// The subset, if the file states it.
    pub subset: Option<Subset>,
    /// Standard uncertainty of each coordinate of this point, mm. Weights are 1/std².
    pub std_mm: Option<f64>,
    /// Label of the station, i.e. of the instrument's set-up. Each station has its own unknown base pose.
    pub station: Option<String>,
    /// Label of the measuring session.
    pub session: Option<String>,
    /// Position in the measuring order; default: the row.
    pub sequence: i64,
    /// Time of measurement as the file states it. New uploads state date, time and offset from UTC.
    pub measured_at: Option<String>,
    /// Air temperature at the robot, °C.
    pub temperature_c: Option<f64>,
    /// In a file of sweeps: the joint that moves, 1-based.
    pub sweep_joint: Option<usize>,
    /// For a pose: orientation of the target in the measuring frame.
    pub rotation: Option<Rotation3<f64>>,
    /// The three angles from which `rotation` was computed, rad, if the file has angles.
    pub rotation_angles_rad: Option<Vector3<f64>>,
    /// Anisotropic noise of the position in the measuring frame; instead of `std_mm`.
    pub position_noise: Option<PositionNoise>,
    /// Standard uncertainty of one component of the rotation vector, rad.
    pub std_rotation_rad: Option<f64>,
    /// For a pose: the point in the target's frame at which the noise of the position is independent of the noise of the rotation, mm. Zero
    /// for the target itself.
    pub lever_mm: Vector3<f64>,
}

/// All points of one upload, in file order.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSet {
    /// The frame of all positions.
    pub frame: Frame,
    /// Whether gravity is −z of the measuring frame, by the level of the instrument.
    pub is_levelled: bool,
    /// The points in file order. The index is the 0-based data row.
    pub points: Vec<Point>,
}

impl Point {
    /// An empty point with `n_joints` joint values of 0, measured in file order at `row`.
    pub fn empty(n_joints: usize, row: usize) -> Self {
        Self {
            q_rad: vec![0.0; n_joints],
            position_mm: Vector3::zeros(),
            configuration: String::new(),
            name: None,
            line: None,
            target: 0,
            target_name: None,
            subset: None,
            std_mm: None,
            station: None,
            session: None,
            sequence: row as i64,
            measured_at: None,
            temperature_c: None,
            sweep_joint: None,
            rotation: None,
            rotation_angles_rad: None,
            position_noise: None,
            std_rotation_rad: None,
            lever_mm: Vector3::zeros(),
        }
    }
}

impl Point {
    /// Standard uncertainty of one coordinate of the position, mm. For anisotropic noise: root mean square over the three axes.
    pub fn position_std_mm(&self) -> Option<f64> {
        self.std_mm
            .or(self.position_noise.map(|noise| noise.rms_mm()))
    }
}

impl MeasurementSet {
    /// A set in which all points have a configuration. Points without a label get the same label if their joint values are equal. Targets with names are
    /// numbered in the order in which the names appear.
    pub fn new(frame: Frame, mut points: Vec<Point>) -> Self {
        let names = points.iter().filter_map(|p| p.target_name.as_deref());
        let (numbers, _) = numbered(names);
        let named = points.iter_mut().filter(|p| p.target_name.is_some());
        for (point, number) in named.zip(numbers) {
            point.target = number;
        }
        let mut configurations = Configurations::default();
        for (row, point) in points.iter_mut().enumerate() {
            if point.configuration.is_empty() {
                point.configuration =
                    format!("row_{}", configurations.first_row_like(&point.q_rad, row));
            }
        }
        Self {
            frame,
            is_levelled: false,
            points,
        }
    }

    /// The same set with every pose inverted. A camera on the arm measures the pose of a fixed board in the camera's frame. Inverted, this
    /// is the pose of the camera in the board's frame. Points without a rotation stay unchanged.
    pub fn with_inverse_poses(mut self) -> Self {
        for point in &mut self.points {
            let Some(rotation) = point.rotation else {
                continue;
            };
            let back = rotation.inverse();
            point.lever_mm = point.position_mm;
            point.position_mm = -(back * point.position_mm);
            point.rotation = Some(back);
            point.rotation_angles_rad = None;
            if let Some(noise) = &mut point.position_noise {
                noise.axes = back.matrix() * noise.axes;
            }
        }
        self
    }

    /// Configurations in order of their first row.
    pub fn configurations(&self) -> Vec<&str> {
        let mut seen = BTreeSet::new();
        self.points
            .iter()
            .map(|p| p.configuration.as_str())
            .filter(|c| seen.insert(*c))
            .collect()
    }

    /// A number for each configuration label. Labels with equal joint values get the same number, because they are one configuration with different
    /// names.
    pub fn distinct_configurations(&self) -> BTreeMap<&str, usize> {
        let mut numbers: BTreeMap<&str, usize> = BTreeMap::new();
        // Union-find: for each number, a number of the same configuration that is not higher.
        let mut lower: Vec<usize> = Vec::new();
        let lowest = |lower: &[usize], mut number: usize| {
            while lower[number] != number {
                number = lower[number];
            }
            number
        };
        let mut firsts = Configurations::default();
        let mut number_at: BTreeMap<usize, usize> = BTreeMap::new();
        for (row, point) in self.points.iter().enumerate() {
            let next = lower.len();
            let number = *numbers.entry(&point.configuration).or_insert(next);
            if number == next {
                lower.push(next);
            }
            let first = firsts.first_row_like(&point.q_rad, row);
            let other = *number_at.entry(first).or_insert(number);
            let (a, b) = (lowest(&lower, number), lowest(&lower, other));
            lower[a.max(b)] = a.min(b);
        }
        numbers
            .into_iter()
            .map(|(label, number)| (label, lowest(&lower, number)))
            .collect()
    }

    /// The number of each point's configuration, as in [`Self::distinct_configurations`].
    pub fn configuration_numbers(&self) -> Vec<usize> {
        let numbers = self.distinct_configurations();
        let points = self.points.iter();
        points
            .map(|point| numbers[point.configuration.as_str()])
            .collect()
    }

    /// Number of different configurations of the robot.
    pub fn n_distinct_configurations(&self) -> usize {
        let numbers = self.distinct_configurations();
        numbers.into_values().collect::<BTreeSet<_>>().len()
    }

    /// Standard deviation of a coordinate by its rounding in the file, mm: a step of the last decimal place over √12. `None` if the
    /// positions have more than six decimal places of a millimetre.
    pub fn rounding_std_mm(&self) -> Option<f64> {
        let coordinates = || self.points.iter().flat_map(|p| p.position_mm.iter());
        let is_rounded = |x: f64| (x - x.round()).abs() < ROUNDED;
        let mut steps = STEPS_PER_MM.into_iter();
        let per_mm = steps.find(|per_mm| coordinates().all(|x| is_rounded(x * per_mm)))?;
        Some(1.0 / (per_mm * 12f64.sqrt()))
    }

    /// True if the stated noise of any position is anisotropic.
    pub fn has_uneven_noise(&self) -> bool {
        let noise = self.points.iter().filter_map(|p| p.position_noise);
        noise.into_iter().any(|noise| !noise.is_isotropic())
    }

    /// True if poses were measured, and not only positions.
    pub fn has_poses(&self) -> bool {
        self.points.iter().any(|p| p.rotation.is_some())
    }

    /// Targets whose poses were measured.
    pub fn posed_targets(&self) -> BTreeSet<usize> {
        let posed = self.points.iter().filter(|p| p.rotation.is_some());
        posed.map(|p| p.target).collect()
    }

    /// The points in measuring order: by their sequence, then by row.
    pub fn measuring_order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.points.len()).collect();
        order.sort_by_key(|row| (self.points[*row].sequence, *row));
        order
    }

    /// The largest stated standard uncertainty of a component of a rotation, rad; 0 if none is stated.
    pub fn stated_rotation_std_rad(&self) -> f64 {
        let stated = self
            .points
            .iter()
            .filter_map(|point| point.std_rotation_rad);
        stated.fold(0.0, f64::max)
    }

    /// The name of a target, if it has one.
    pub fn target_name(&self, target: usize) -> Option<&str> {
        let of_target = self.points.iter().find(|point| point.target == target);
        of_target?.target_name.as_deref()
    }

    /// The names of all targets in the order of their numbers; empty if not all have one.
    pub fn target_names(&self) -> Vec<&str> {
        let names = (0..self.n_targets()).map(|target| self.target_name(target));
        names.collect::<Option<_>>().unwrap_or_default()
    }

    /// Number of targets: one more than the largest index.
    pub fn n_targets(&self) -> usize {
        self.points.iter().map(|p| p.target + 1).max().unwrap_or(0)
    }
}

/// Numbers names in the order in which they first appear. Returns the number of each name, and the distinct names in the order of their
/// numbers.
pub(super) fn numbered<'n>(names: impl Iterator<Item = &'n str>) -> (Vec<usize>, Vec<&'n str>) {
    let (mut different, mut numbers) = (Vec::new(), BTreeMap::new());
    let number = |name| {
        *numbers.entry(name).or_insert_with(|| {
            different.push(name);
            different.len() - 1
        })
    };
    (names.map(number).collect(), different)
}

/// Rows are one configuration if every joint value differs by less than this, rad (0.05°); used for files without labels. The readings of a
/// robot at standstill vary a little from row to row, and two poses this close give the same information about the robot.
pub const SAME_JOINT_RAD: f64 = 8.7e-4;
/// Steps to a millimetre at which rounding is looked for.
const STEPS_PER_MM: [f64; 7] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6];
/// A number counts as rounded if it differs from the rounded one by less than this share of the last place.
const ROUNDED: f64 = 1e-4;

/// The first row of each configuration found so far, with several indexes for a fast lookup. The keys are a weighted sum of the joint values, and
/// each joint value itself. Every key is divided into cells; the keys of equal joint values differ by less than one cell. The lookup uses the index
/// with the fewest candidates: poses that share a cell of one key (a grid of joint values, or poses with equal sums) differ in another key.
#[derive(Debug, Default)]
pub struct Configurations {
    /// Joint values and row of the first point of each configuration.
    firsts: Vec<(Vec<f64>, usize)>,
    /// For each key: map from a cell to indices in `firsts`.
    near: Vec<BTreeMap<i64, Vec<usize>>>,
}

impl Configurations {
    /// The first row whose joint values equal `q_rad`: an earlier row, or `row` if there is none.
    pub fn first_row_like(&mut self, q_rad: &[f64], row: usize) -> usize {
        let cells = cells_of(q_rad);
        self.near
            .resize_with(cells.len().max(self.near.len()), BTreeMap::new);
        let near = &self.near;
        let around = |key: usize| {
            (cells[key] - 1..=cells[key] + 1).filter_map(move |cell| near[key].get(&cell))
        };
        let fewest = (0..cells.len()).min_by_key(|key| around(*key).map(Vec::len).sum::<usize>());
        let same = |place: &&usize| {
            self.firsts[**place]
                .0
                .iter()
                .zip(q_rad)
                .all(|(a, b)| (a - b).abs() < SAME_JOINT_RAD)
        };
        let known = fewest
            .into_iter()
            .flat_map(around)
            .flatten()
            .filter(same)
            .map(|place| self.firsts[*place].1)
            .min();
        known.unwrap_or_else(|| {
            let place = self.firsts.len();
            self.near
                .iter_mut()
                .zip(cells)
                .for_each(|(near, cell)| near.entry(cell).or_default().push(place));
            self.firsts.push((q_rad.to_vec(), row));
            row
        })
    }
}

/// The cell of each key. The weights of the sum are incommensurable, so that different poses of a grid rarely share a cell.
fn cells_of(q_rad: &[f64]) -> Vec<i64> {
    let weight = |joint: usize| 1.0 / (joint as f64 + 1.0).sqrt();
    let (sum, reach) = q_rad
        .iter()
        .enumerate()
        .fold((0.0, 0.0), |(sum, reach), (j, q)| {
            (sum + weight(j) * q, reach + weight(j) * SAME_JOINT_RAD)
        });
    let of_sum = (sum / f64::max(reach, SAME_JOINT_RAD)).floor() as i64;
    std::iter::once(of_sum)
        .chain(q_rad.iter().map(|q| (q / SAME_JOINT_RAD).floor() as i64))
        .collect()
}

/// Number of points of `b` that are also in `a`, with the same joint values and the same position. One of the two may have been rounded to 0.01 mm
/// and 0.001° by a spreadsheet. A new measurement shares no points with an earlier one, because it repeats neither the noise nor the scatter of the
/// robot.
pub fn n_shared_points(a: &MeasurementSet, b: &MeasurementSet) -> usize {
    let cell = |p: &Point| p.position_mm.map(|x| (x / SAME_POSITION_MM).floor() as i64);
    let mut known: BTreeMap<[i64; 3], Vec<&Point>> = BTreeMap::new();
    for point in &a.points {
        known.entry(cell(point).into()).or_default().push(point);
    }
    let around = |p: &Point| {
        let [x, y, z]: [i64; 3] = cell(p).into();
        let steps = || -1..=1_i64;
        steps().flat_map(move |i| {
            steps().flat_map(move |j| steps().map(move |k| [x + i, y + j, z + k]))
        })
    };
    let same = |a: &Point, b: &Point| {
        (a.position_mm - b.position_mm).amax() < SAME_POSITION_MM
            && a.q_rad
                .iter()
                .zip(&b.q_rad)
                .all(|(a, b)| turned(a - b) < SAME_READING_RAD)
    };
    let is_known = |p: &&Point| {
        let near = around(p).filter_map(|cell| known.get(&cell)).flatten();
        near.take(MAX_COMPARED).any(|other| same(other, p))
    };
    b.points.iter().filter(is_known).count()
}

/// Absolute difference of two joint values, rad, ignoring whole turns.
fn turned(difference_rad: f64) -> f64 {
    let part = difference_rad.rem_euclid(std::f64::consts::TAU);
    part.min(std::f64::consts::TAU - part)
}

/// Joint values closer than this count as the same reading, rad. One of them may be rounded to 0.001°.
const SAME_READING_RAD: f64 = 1.1e-5;
/// Coordinates closer than this count as the same reading, mm. One of them may be rounded to 0.01 mm.
const SAME_POSITION_MM: f64 = 0.006;
/// Maximum number of nearby points that a point is compared with.
const MAX_COMPARED: usize = 200;
