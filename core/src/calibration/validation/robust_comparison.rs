//! Compares two robots on the same points: which one is closer, without the influence of faulty measurements.
//!
//! A point that is off by centimetres is off for every robot, and by chance slightly more for one of them. In the rms it would outweigh all
//! other points. Points that both robots miss by far are therefore left out. A point that only one robot misses counts.

use crate::solvers::median::median;

/// A point is an outlier if each robot misses it by more than this multiple of that robot's median error. For isotropic noise this is one point in
/// ten thousand.
const OUTLYING: f64 = 3.0;
/// Lower limit of the outlier threshold, as a share of the first robot's median error. It is needed because the second robot may match half
/// of the points by chance, or exactly in a simulation.
const MIN_OUTLIER_SHARE: f64 = 0.25;
/// At most one point in this many (and at most one if there are fewer points) may be set aside. If there are more outliers, they are not
/// accidental, and all points count.
const POINTS_PER_OUTLIER: usize = 20;
/// With fewer points, none is set aside.
const MIN_POINTS: usize = 10;

/// Errors of two robots on the points that count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobustComparison {
    /// Number of points that both miss by far. They do not count.
    pub n_set_aside: usize,
    /// Error of the first robot, mm; NaN without points.
    pub before_rms_mm: f64,
    /// Error of the second robot, by its links alone or with corrections, whichever is larger, mm.
    pub after_rms_mm: f64,
}

impl RobustComparison {
    /// True if the second robot is closer; false if it cannot be decided.
    pub fn is_better(&self) -> bool {
        self.after_rms_mm < self.before_rms_mm
    }

    /// Text about the points that were set aside.
    pub fn remark(&self) -> String {
        match self.n_set_aside {
            0 => String::new(),
            1 => ", without one wild point that both miss".into(),
            n => format!(", without {n} wild points that both miss"),
        }
    }
}

/// Compares by each point's errors, mm: of the first robot, of the second robot's links, and of the second robot with corrections (repeat the links'
/// error if it has none).
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

/// Each point's error of the second robot as used in `after_rms_mm`, mm; `None` if the point is set aside.
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

/// True for each point that both robots miss by far and that does not count.
fn set_aside(points: &[[f64; 3]]) -> Vec<bool> {
    let medians_mm =
        [0, 1, 2].map(|of| median(points.iter().map(|point| point[of])).unwrap_or(f64::INFINITY));
    let limits_mm = medians_mm.map(|mm| (OUTLYING * mm).max(MIN_OUTLIER_SHARE * medians_mm[0]));
    // A faulty measurement is equally wrong for both robots. A point at which their errors differ counts.
    let alike_mm = limits_mm.into_iter().fold(0.0, f64::max);
    let is_outlier = |point: &[f64; 3]| {
        let is_far = point.iter().zip(limits_mm).all(|(mm, limit)| *mm > limit);
        is_far && (1..3).all(|of| (point[of] - point[0]).abs() <= alike_mm)
    };
    let outliers: Vec<bool> = points.iter().map(is_outlier).collect();
    let n_outliers = outliers.iter().filter(|outlier| **outlier).count();
    match points.len() >= MIN_POINTS && n_outliers <= points.len().div_ceil(POINTS_PER_OUTLIER) {
        true => outliers,
        false => vec![false; points.len()],
    }
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
