//! Finds rows that occur twice in a file, e.g. because a table was pasted again. Repeated measurements of a pose differ by their noise.

use crate::measurement::issue::Issue;
use crate::measurement::set::Point;
use std::collections::{BTreeMap, BTreeSet};

/// Minimum number of different rows that occur again. Fewer may agree by chance.
const MIN_AGAIN: usize = 5;
/// If positions are multiples of this, the resolution may hide the noise, and nothing can be decided, mm.
const COARSE_MM: f64 = 0.1;
/// If positions are no multiples of this, they show the noise of any instrument, mm.
const FINE_MM: f64 = 0.01;

/// Refuses rows that occur in a table twice.
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

/// The rows that agree with an earlier row in every digit of joints and position, each with that earlier row. Empty if there are fewer than
/// `MIN_AGAIN`, or if repetitions of poses differ: at fine resolution at least half of all repetitions must agree, otherwise all of them.
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
        if first != row && is_finer(point, COARSE_MM) {
            again.push((row, first));
        }
    }
    let different: BTreeSet<usize> = again.iter().map(|(_, first)| *first).collect();
    let is_fine = |(row, _): &&(usize, usize)| is_finer(&points[*row], FINE_MM);
    let n_fine = again.iter().filter(is_fine).count();
    let are_exact = again.len() == n_repetitions || 2 * n_fine >= n_repetitions;
    match different.len() >= MIN_AGAIN && are_exact {
        true => again,
        false => vec![],
    }
}

fn is_finer(point: &Point, step_mm: f64) -> bool {
    let is_multiple = |mm: &f64| ((mm / step_mm).round() * step_mm - mm).abs() < 1e-6;
    !point.position_mm.iter().all(is_multiple)
}
