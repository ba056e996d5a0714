//! Rows that stand in a file twice, as if a table had been pasted again. Measurements that repeat a pose differ by their noise.

use crate::measurement::issue::Issue;
use crate::measurement::set::Point;
use std::collections::{BTreeMap, BTreeSet};

/// Number of different rows that have to stand in a file again. One or two may agree by chance.
const MIN_AGAIN: usize = 3;
/// Positions that are multiples of this are too coarse to tell, mm: the resolution may hide the noise.
const COARSE_MM: f64 = 0.1;

/// Refuses rows that stand in a table twice.
pub fn repeats(points: &[Point]) -> Vec<Issue> {
    let found = rows_again(points);
    let n = found.len();
    let issue = |(at, first): (usize, usize)| {
        let detail = format!(
            "row {at} agrees with row {first} in every digit of joints and position, as {n} rows in all do with earlier ones: repeated measurements differ by their noise, so a table \
             stands here twice; remove these rows"
        );
        Issue::new("rows_twice", detail).in_row(at)
    };
    found.into_iter().map(issue).collect()
}

/// The rows that agree with an earlier one in every digit of joints and position, each with that earlier one. None if most repetitions of poses differ.
pub fn rows_again(points: &[Point]) -> Vec<(usize, usize)> {
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect();
    let (mut poses, mut firsts) = (BTreeSet::new(), BTreeMap::new());
    let (mut again, mut n_repetitions) = (Vec::new(), 0);
    for (row, point) in points.iter().enumerate() {
        let q: Vec<u64> = bits(&point.q_rad);
        n_repetitions += usize::from(!poses.insert(q.clone()));
        let position: Vec<u64> = bits(point.position_mm.as_slice());
        let first = *firsts
            .entry((q, position, &point.measured_at))
            .or_insert(row);
        if first != row && is_fine(point) {
            again.push((row, first));
        }
    }
    let different: BTreeSet<usize> = again.iter().map(|(_, first)| *first).collect();
    match different.len() >= MIN_AGAIN && 2 * again.len() >= n_repetitions {
        true => again,
        false => vec![],
    }
}

fn is_fine(point: &Point) -> bool {
    let is_multiple = |mm: &f64| ((mm / COARSE_MM).round() * COARSE_MM - mm).abs() < 1e-6;
    !point.position_mm.iter().all(is_multiple)
}
