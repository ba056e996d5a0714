//! Two robots on the same points: which of them is nearer, whatever a broken beam does to a point.
//!
//! A point that is off by centimetres is so for every robot, and by chance a little more for one of them: in the rms of both it outweighs all
//! others. So what both miss by far is left out, and only that: a point that one of the two misses alone counts.

/// An outlier is what each misses by more than this many times what it misses half of the points by; of noise alike in all directions one point in
/// ten thousand is.
const OUTLYING: f64 = 3.0;
/// Nearer than this share of what the one misses half of the points by, nothing is an outlier: the other may meet half of them by chance, or in a simulation.
const NEVER_OUTLYING: f64 = 0.25;
/// One point in this many, and one of fewer, may be set aside; more are no accident, and all count.
const ONE_IN: usize = 20;
/// Of fewer points none is.
const FEWEST: usize = 10;

/// Errors of two robots on the points that count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobustComparison {
    /// Points that both miss by far: they do not count.
    pub n_set_aside: usize,
    /// Of the one, mm; not a number where there are no points.
    pub before_rms_mm: f64,
    /// Of the other, links alone or with corrections, whichever are larger, mm.
    pub after_rms_mm: f64,
}

impl RobustComparison {
    /// Whether the other is nearer; not where that cannot be told.
    pub fn is_better(&self) -> bool {
        self.after_rms_mm < self.before_rms_mm
    }

    /// What to say of points that were set aside.
    pub fn remark(&self) -> String {
        match self.n_set_aside {
            0 => String::new(),
            1 => ", without one wild point that both miss".into(),
            n => format!(", without {n} wild points that both miss"),
        }
    }
}

/// Compares by each point's errors, mm: of the one robot; of the other's links, and of those with corrections (again of the links where it has
/// none).
pub fn robust_comparison(points: &[[f64; 3]]) -> RobustComparison {
    let is_set_aside = set_aside(points);
    let counted: Vec<&[f64; 3]> = points
        .iter()
        .zip(&is_set_aside)
        .filter(|(_, aside)| !**aside)
        .map(|(point, _)| point)
        .collect();
    let rms = |of: usize| {
        (counted
            .iter()
            .map(|point| point[of] * point[of])
            .sum::<f64>()
            / counted.len() as f64)
            .sqrt()
    };
    let (links, corrected) = (rms(1), rms(2));
    RobustComparison {
        n_set_aside: points.len() - counted.len(),
        before_rms_mm: rms(0),
        after_rms_mm: if corrected > links { corrected } else { links },
    }
}

/// Each point's error of the other robot as it counts in `after_rms_mm`, mm; `None` where the point is set aside.
pub fn after_errors_mm(points: &[[f64; 3]]) -> Vec<Option<f64>> {
    let is_set_aside = set_aside(points);
    let sum = |of: usize| -> f64 {
        let counted = points
            .iter()
            .zip(&is_set_aside)
            .filter(|(_, aside)| !**aside);
        counted.map(|(point, _)| point[of] * point[of]).sum()
    };
    let of = if sum(2) > sum(1) { 2 } else { 1 };
    let own = |(point, aside): (&[f64; 3], &bool)| (!*aside).then_some(point[of]);
    points.iter().zip(&is_set_aside).map(own).collect()
}

/// Which points both robots miss by far, so that they do not count.
fn set_aside(points: &[[f64; 3]]) -> Vec<bool> {
    let medians_mm = [0, 1, 2].map(|of| median(points.iter().map(|point| point[of])));
    let limits_mm = medians_mm.map(|mm| (OUTLYING * mm).max(NEVER_OUTLYING * medians_mm[0]));
    // what is wrong with a point is as wrong for either robot; by how much their own errors differ there, counts
    let alike_mm = limits_mm.into_iter().fold(0.0, f64::max);
    let is_outlier = |point: &[f64; 3]| {
        let is_far = point.iter().zip(limits_mm).all(|(mm, limit)| *mm > limit);
        is_far && (1..3).all(|of| (point[of] - point[0]).abs() <= alike_mm)
    };
    let outliers: Vec<bool> = points.iter().map(is_outlier).collect();
    let n_outliers = outliers.iter().filter(|outlier| **outlier).count();
    match points.len() >= FEWEST && n_outliers <= points.len().div_ceil(ONE_IN) {
        true => outliers,
        false => vec![false; points.len()],
    }
}

fn median(errors_mm: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = errors_mm.collect();
    sorted.sort_by(f64::total_cmp);
    sorted
        .get(sorted.len() / 2)
        .copied()
        .unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::{RobustComparison, robust_comparison};

    /// Twenty points that the one robot misses by 0.8 mm and the other by 0.9 mm.
    fn worse() -> Vec<[f64; 3]> {
        vec![[0.8, 0.9, 0.9]; 20]
    }

    #[test]
    fn a_wild_point_decides_nothing() {
        for (before, after) in [(10.0, 9.5), (9.5, 10.5), (50.0, 49.0)] {
            let mut points = worse();
            points[7] = [before, after, after];
            let comparison = robust_comparison(&points);
            assert_eq!(
                (comparison.n_set_aside, comparison.is_better()),
                (1, false),
                "{comparison:?}"
            );
            assert!(
                (comparison.before_rms_mm - 0.8).abs() < 1e-12
                    && (comparison.after_rms_mm - 0.9).abs() < 1e-12,
                "{comparison:?}"
            );
            points.iter_mut().for_each(|point| point.swap(0, 1));
            points.iter_mut().for_each(|point| point[2] = point[1]);
            assert!(super::robust_comparison(&points).is_better());
        }
    }

    #[test]
    fn a_point_that_one_of_them_misses_alone_counts() {
        let mut points = vec![[0.8, 0.1, 0.1]; 20];
        points[3] = [0.8, 12.0, 12.0];
        assert_eq!(
            (
                robust_comparison(&points).n_set_aside,
                robust_comparison(&points).is_better()
            ),
            (0, false)
        );
        let mut points = vec![[0.8, 0.1, 0.1]; 20];
        points[3] = [0.8, 0.1, 12.0];
        assert!(!robust_comparison(&points).is_better(), "with corrections");
    }

    #[test]
    fn more_than_one_in_twenty_and_points_of_a_few_all_count() {
        let mut points = worse();
        points[3] = [10.0, 9.0, 9.0];
        points[4] = [10.0, 9.0, 9.0];
        assert_eq!(robust_comparison(&points).n_set_aside, 0);
        assert_eq!(robust_comparison(&points[..9]).n_set_aside, 0);
        let RobustComparison {
            before_rms_mm,
            after_rms_mm,
            ..
        } = robust_comparison(&[]);
        assert!(
            before_rms_mm.is_nan() && after_rms_mm.is_nan() && !robust_comparison(&[]).is_better()
        );
        assert_eq!(robust_comparison(&[[1e-9, 0.0, 0.0]; 20]).n_set_aside, 0);
    }
}
