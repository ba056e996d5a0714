//! Standstills in a continuous log of a robot or an instrument.

use crate::measurement::join::clock::Standstill;

/// Minimum number of rows of a standstill.
pub const MIN_STANDSTILL_ROWS: usize = 3;
/// Two standstills in a row are separated by a motion of at least this many times the limit. Below that they are one: the longer of them counts.
const CLEAR_MOTION: f64 = 5.0;
/// From the first to the second half of a standstill, the median moves by less than this share of the limit. A slow part of a motion moves by half
/// of the limit; a few slow rows before or after a standstill do not move its medians.
const MAX_DRIFT: f64 = 0.25;

/// A log in the order of time.
pub struct Log {
    /// The row of the file, and its time, s.
    pub rows: Vec<(usize, f64)>,
    /// Joint values or a position.
    pub values: Vec<Vec<f64>>,
    /// Rows of a standstill are closer than this to each other.
    pub limit: f64,
    /// Distance of two rows.
    pub distance: fn(&[f64], &[f64]) -> f64,
}

/// Largest difference of a joint.
pub fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    let differences = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    differences.fold(0.0, f64::max)
}

/// Euclidean distance.
pub fn length(a: &[f64], b: &[f64]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
    squares.sum::<f64>().sqrt()
}

/// The rows from `first` to before `end`, with the median of their values.
struct Span {
    first: usize,
    end: usize,
    middle: Vec<f64>,
}

impl Log {
    /// The row that was recorded nearest to a time.
    pub fn row_at(&self, time_s: f64) -> usize {
        let after = self.rows.partition_point(|(_, at_s)| *at_s < time_s);
        let near = [after.saturating_sub(1), after.min(self.rows.len() - 1)];
        let away = |at: &usize| (self.rows[*at].1 - time_s).abs();
        let nearest = near.into_iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        self.rows[nearest.unwrap_or(0)].0
    }

    /// The standstills, in the order of time.
    pub fn standstills(&self) -> Vec<Standstill> {
        let mut found: Vec<Span> = Vec::new();
        let mut first = 0;
        while first < self.rows.len() {
            let after = self.rows.len();
            let end = (first..after).find(|row| self.apart(*row, &self.values[first]) > self.limit);
            let end = end.unwrap_or(after);
            if let Some(span) = self.settled(first, end) {
                match found.last_mut().filter(|last| self.are_one(last, &span)) {
                    Some(last) if self.duration_s(last) >= self.duration_s(&span) => {}
                    Some(last) => *last = span,
                    None => found.push(span),
                }
            }
            first = end;
        }
        found.iter().map(|span| self.standstill(span)).collect()
    }

    fn apart(&self, row: usize, from: &[f64]) -> f64 {
        (self.distance)(&self.values[row], from)
    }

    fn duration_s(&self, span: &Span) -> f64 {
        self.rows[span.end - 1].1 - self.rows[span.first].1
    }

    fn standstill(&self, span: &Span) -> Standstill {
        Standstill {
            from_s: self.rows[span.first].1,
            to_s: self.rows[span.end - 1].1,
            row: self.rows[(span.first + span.end) / 2].0,
        }
    }

    /// The standstill around some rows: all rows in a row that are near their median. `None` if the rows are a slow part of a motion.
    fn settled(&self, first: usize, end: usize) -> Option<Span> {
        if end - first < MIN_STANDSTILL_ROWS {
            return None;
        }
        let middle = self.median(first, end);
        let is_near = |row: &usize| self.apart(*row, &middle) <= self.limit;
        let first = (first..end).find(is_near)?;
        let end = (first..end).rfind(is_near)? + 1;
        let before = (0..first).rev().take_while(is_near).count();
        let behind = (end..self.rows.len()).take_while(is_near).count();
        let (first, end) = (first - before, end + behind);
        let half = first + (end - first) / 2;
        let [a, b] = [self.median(first, half), self.median(half, end)];
        let is_settled = (self.distance)(&a, &b) <= MAX_DRIFT * self.limit;
        is_settled.then_some(Span { first, end, middle })
    }

    /// Whether no clear motion is between two spans.
    fn are_one(&self, last: &Span, next: &Span) -> bool {
        let limit = CLEAR_MOTION * self.limit;
        let is_near = |row: usize| self.apart(row, &next.middle) <= limit;
        (self.distance)(&last.middle, &next.middle) <= limit && (last.end..next.first).all(is_near)
    }

    fn median(&self, first: usize, end: usize) -> Vec<f64> {
        let of_column = |column: usize| {
            let mut values: Vec<f64> = (first..end).map(|row| self.values[row][column]).collect();
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        (0..self.values[first].len()).map(of_column).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::{Log, length};

    /// Ten rows a second of one coordinate; the limit is 1.
    fn standstills(values: &[f64]) -> Vec<(f64, f64)> {
        let log = Log {
            rows: (0..values.len())
                .map(|row| (row, row as f64 / 10.0))
                .collect(),
            values: values.iter().map(|value| vec![*value]).collect(),
            limit: 1.0,
            distance: length,
        };
        let found = log.standstills();
        found.iter().map(|one| (one.from_s, one.to_s)).collect()
    }

    #[test]
    fn slow_ends_of_a_motion_are_no_standstills() {
        let mut values = vec![0.0; 10];
        let ramp = [
            0.1, 0.4, 0.9, 1.6, 2.5, 3.6, 5.0, 40.0, 60.0, 95.0, 97.5, 98.4, 99.1, 99.6,
        ];
        values.extend(ramp);
        values.extend([100.0; 10]);
        let found = standstills(&values);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(
            found[0].0 < 0.05 && (0.9..=1.2).contains(&found[0].1),
            "{found:?}"
        );
        assert!((2.1..=2.4).contains(&found[1].0), "{found:?}");
        // a slow motion as a whole
        let slow: Vec<f64> = (0..100).map(|row| 0.2 * f64::from(row)).collect();
        assert_eq!(standstills(&slow), []);
    }

    #[test]
    fn two_standstills_without_a_clear_motion_between_them_are_one() {
        let mut values = vec![0.0; 10];
        values.extend([1.5; 20]);
        assert_eq!(standstills(&values), [(1.0, 2.9)]);
        values.extend([40.0; 5]);
        assert_eq!(standstills(&values).len(), 2);
    }
}
