//! Finds statistics of groups: rows after (or before) the measurements of each pose that are their mean, standard deviation etc. A label is
//! not necessary. Measurements are distinguished from statistics by their noise: only by chance does a measurement equal the mean of the
//! others within the last digit.

use crate::measurement::issue::Issue;
use crate::measurement::set::{Configurations, Point};
use crate::measurement::table::checks::statistics::{
    Column, MAX_DECIMALS, NAMES, ROUNDED, decimals, values,
};
use std::collections::BTreeMap;
use std::ops::Range;

/// Maximum number of rows of statistics of one group.
const MAX_STATISTICS: usize = 5;
/// Minimum number of measurements of a group.
const MIN_MEASURED: usize = 2;
/// Maximum number of rows of a group if joint values do not separate the groups.
const MAX_PERIOD: usize = 30;
/// Largest difference between the joint values of one pose, degrees: a robot at standstill.
const SAME_POSE_DEG: f64 = 0.1;
/// Number of groups that are examined. If a file has statistics, its first groups show it.
const MAX_GROUPS: usize = 1000;
/// Significance level, as a power of ten: largest probability with which measurements would look like statistics.
const FALSE_ALARM: f64 = -9.0;
/// A match with a larger probability is no evidence, because it may be due to the resolution of the file.
const MAX_PROBABILITY: f64 = 0.3;
/// If a statistic differs from the mean by more than this multiple of the measurements' range, it cannot be a measurement.
const FAR_FROM_MEAN: f64 = 10.0;
/// Minimum number of groups with statistics per group without them.
const HITS_PER_MISS: usize = 9;

/// A row of statistics.
#[derive(Clone, Debug, PartialEq)]
struct GroupStatistic {
    row: usize,
    name: &'static str,
    /// The first row of its measurements, and their number.
    first: usize,
    n_measured: usize,
}

/// The numbers of all rows.
struct Table {
    /// Joint values in degrees, and coordinates in the unit of the file.
    rows: Vec<Vec<f64>>,
    /// Decimals of the coordinates.
    decimals: Vec<[usize; 3]>,
    /// Range of each coordinate over all rows.
    spread: [f64; 3],
    /// A number for each combination of reflector and set-up.
    places: Vec<usize>,
}

/// Refuses rows that are statistics of their group in every column, if nearly every group has them. `reflectors` are the cells with the
/// reflector of each row, if the file has them; `millimetres` is the unit of each coordinate in the file.
pub fn group_statistics(
    points: &[Point],
    reflectors: &[String],
    millimetres: [f64; 3],
) -> Vec<Issue> {
    let found = rows_of_groups(points, reflectors, millimetres);
    let n = found.len();
    let issue = |statistic: GroupStatistic| {
        let (at, first) = (statistic.row, statistic.first);
        let detail = format!(
            "row {at} is the {} of {} others in every column (the first of them is row {first}), and {n} rows in all are such statistics of their groups: a row of statistics is no measurement; \
             remove such rows",
            statistic.name, statistic.n_measured
        );
        Issue::new("summary_row", detail).in_row(at)
    };
    found.into_iter().map(issue).collect()
}

fn rows_of_groups(
    points: &[Point],
    reflectors: &[String],
    millimetres: [f64; 3],
) -> Vec<GroupStatistic> {
    if points.len() < 2 * (MIN_MEASURED + 1) {
        return vec![];
    }
    let table = Table::new(points, reflectors, millimetres);
    let mut groupings = by_joints(points, &table.places);
    groupings.extend(by_period(points.len()));
    // The largest block is tried first: a mean, a deviation and a range are three rows.
    let blocks = (1..=MAX_STATISTICS).rev();
    let blocks = blocks.flat_map(|n| [(n, false), (n, true)]);
    let mut found = blocks.flat_map(|(n, is_in_front)| {
        let (table, groupings) = (&table, &groupings);
        groupings
            .iter()
            .filter_map(move |groups| table.statistics(groups, n, is_in_front))
    });
    let mut found = found.next().unwrap_or_default();
    found.sort_by_key(|statistic| statistic.row);
    found
}

/// Groups of rows with equal joint values: first of successive rows, then of rows anywhere in the file.
fn by_joints(points: &[Point], places: &[usize]) -> Vec<Vec<Vec<usize>>> {
    let mut firsts = Configurations::default();
    let mut all: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
    let mut runs: Vec<Vec<usize>> = Vec::new();
    let mut before = None;
    for (row, (point, place)) in points.iter().zip(places).enumerate() {
        let key = (firsts.first_row_like(&point.q_rad, row), *place);
        all.entry(key).or_default().push(row);
        match runs.last_mut().filter(|_| before == Some(key)) {
            Some(run) => run.push(row),
            None => runs.push(vec![row]),
        }
        before = Some(key);
    }
    vec![runs, all.into_values().collect()]
}

/// Groups of equal numbers of rows.
fn by_period(n_rows: usize) -> impl Iterator<Item = Vec<Vec<usize>>> {
    let periods = (MIN_MEASURED + 1..=MAX_PERIOD).filter(move |n| n_rows.is_multiple_of(*n));
    periods.map(move |period| {
        let group = |at: usize| (at * period..(at + 1) * period).collect();
        (0..(n_rows / period).min(MAX_GROUPS)).map(group).collect()
    })
}

impl Table {
    fn new(points: &[Point], reflectors: &[String], millimetres: [f64; 3]) -> Self {
        let mut rows: Vec<Vec<f64>> = points.iter().map(values).collect();
        for row in &mut rows {
            let at = row.len() - 3;
            for (value, millimetres) in row[at..].iter_mut().zip(millimetres) {
                *value /= millimetres;
            }
        }
        let positions = || {
            rows.iter()
                .map(|row| [0, 1, 2].map(|axis| row[row.len() - 3 + axis]))
        };
        let spread = [0, 1, 2].map(|axis| {
            let of_axis = positions().map(|position| position[axis]);
            let (least, largest) = of_axis.fold(
                (f64::INFINITY, f64::NEG_INFINITY),
                |(least, largest), value| (least.min(value), largest.max(value)),
            );
            largest - least
        });
        let mut numbers: BTreeMap<(&str, &str, &str), usize> = BTreeMap::new();
        let places = points.iter().enumerate().map(|(row, point)| {
            let reflector = reflectors.get(row).map_or("", String::as_str);
            let station = point.station.as_deref().unwrap_or("");
            let session = point.session.as_deref().unwrap_or("");
            let next = numbers.len();
            *numbers.entry((reflector, station, session)).or_insert(next)
        });
        Self {
            places: places.collect(),
            decimals: positions().map(|position| position.map(decimals)).collect(),
            spread,
            rows,
        }
    }

    /// The statistics of the groups, if nearly all groups have `n` rows of statistics at their end, or at their beginning.
    fn statistics(
        &self,
        groups: &[Vec<usize>],
        n: usize,
        is_in_front: bool,
    ) -> Option<Vec<GroupStatistic>> {
        let is_large = |group: &&Vec<usize>| group.len() >= n + MIN_MEASURED;
        let groups = groups.iter().filter(is_large).take(MAX_GROUPS);
        let groups: Vec<&Vec<usize>> = groups.collect();
        let split = |group: &Vec<usize>| -> (Range<usize>, Range<usize>) {
            match is_in_front {
                true => (0..n, n..group.len()),
                false => (group.len() - n..group.len(), 0..group.len() - n),
            }
        };
        let tolerance = self.tolerance(&groups, split);
        let (mut n_hits, mut n_misses, mut evidence) = (0, 0, 0.0);
        let mut found = Vec::new();
        for group in &groups {
            let (block, measured) = split(group);
            let (block, measured) = (&group[block], &group[measured]);
            match self.of_group(block, measured, tolerance) {
                Some((names, log_probability)) => {
                    n_hits += 1;
                    evidence += log_probability;
                    found.extend(block.iter().zip(names).map(|(row, name)| GroupStatistic {
                        row: *row,
                        name,
                        first: measured[0],
                        n_measured: measured.len(),
                    }));
                }
                None => n_misses += 1,
            }
            if n_misses > 1 + n_hits / HITS_PER_MISS {
                return None;
            }
        }
        let is_rare = n_misses * HITS_PER_MISS <= n_hits;
        // The groups without statistics may be any, so the probability is multiplied by the number of choices.
        evidence += n_misses as f64 * libm::log10(groups.len().max(1) as f64);
        (n_hits > 1 && is_rare && evidence <= FALSE_ALARM).then_some(found)
    }

    /// Largest difference between a statistic in the file and its exact value, for each coordinate: half of the last digit of both.
    fn tolerance(
        &self,
        groups: &[&Vec<usize>],
        split: impl Fn(&Vec<usize>) -> (Range<usize>, Range<usize>),
    ) -> [f64; 3] {
        let mut most = [[0; 3]; 2];
        for group in groups {
            let (block, measured) = split(group);
            for (most, rows) in most.iter_mut().zip([&group[block], &group[measured]]) {
                for row in rows {
                    for (most, own) in most.iter_mut().zip(self.decimals[*row]) {
                        *most = own.max(*most);
                    }
                }
            }
        }
        let half_digit = |decimals: usize| match decimals > MAX_DECIMALS {
            true => 0.0,
            false => 0.5 * libm::pow(10.0, -(decimals as f64)),
        };
        [0, 1, 2].map(|axis| half_digit(most[0][axis]) + half_digit(most[1][axis]) + 1e-7)
    }

    /// The names of the statistics of one group, and the decimal logarithm of the probability that measurements would look the same. None
    /// if one of the rows is no statistic.
    fn of_group(
        &self,
        block: &[usize],
        measured: &[usize],
        tolerance: [f64; 3],
    ) -> Option<(Vec<&'static str>, f64)> {
        let place = self.places[measured[0]];
        if block
            .iter()
            .chain(measured)
            .any(|row| self.places[*row] != place)
        {
            return None;
        }
        let n_columns = self.rows[block[0]].len();
        let n_joints = n_columns - 3;
        let mut possible = vec![[true; NAMES.len()]; block.len()];
        let mut columns = Vec::with_capacity(3);
        // Positions first: most groups have no statistics, and the positions show this.
        for at in (0..n_columns).rev() {
            let column = Column::new(measured.iter().map(|row| self.rows[*row][at]));
            let limit = match at.checked_sub(n_joints) {
                Some(axis) => tolerance[axis],
                None => ROUNDED,
            };
            if at < n_joints && column.range() > SAME_POSE_DEG {
                return None;
            }
            for (row, possible) in block.iter().zip(&mut possible) {
                let value = self.rows[*row][at];
                // Beside any statistic of the position, the joint values may simply be those of the pose.
                let is_of_pose = at < n_joints && (value - column.statistics[0]).abs() <= limit;
                for (possible, statistic) in possible.iter_mut().zip(column.statistics) {
                    *possible &= is_of_pose || (value - statistic).abs() <= limit;
                }
                if !possible.contains(&true) {
                    return None;
                }
            }
            if at >= n_joints {
                columns.push((at - n_joints, column));
            }
        }
        let mut evidence = 0.0;
        let mut names = Vec::new();
        for (row, possible) in block.iter().zip(possible) {
            let which = possible.iter().position(|is| *is)?;
            let (name, is_told) = NAMES[which];
            names.push(name);
            if !is_told {
                continue;
            }
            for (axis, column) in &columns {
                let from_mean = (self.rows[*row][n_joints + axis] - column.statistics[0]).abs();
                let width = match which {
                    // The density of normal noise is largest at its mean.
                    0 => {
                        let n = measured.len() as f64;
                        let std = column.statistics[1] * (1.0 + 1.0 / n).sqrt();
                        std * (2.0 * std::f64::consts::PI).sqrt()
                    }
                    _ if from_mean > FAR_FROM_MEAN * (column.range() + tolerance[*axis]) => {
                        self.spread[*axis]
                    }
                    // The rms of repeated measurements is nearly their mean, so it is no evidence.
                    _ => continue,
                };
                let probability = 2.0 * tolerance[*axis] / width;
                if probability < MAX_PROBABILITY {
                    evidence += libm::log10(probability);
                }
            }
        }
        Some((names, evidence))
    }
}
