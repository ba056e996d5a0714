//! Solves the wider problem of [`uncertainty`](super::uncertainty): the features that are included, their standard deviations, the noise,
//! and the posterior.

use crate::identification::least_squares::evidence::{Evidence, Posterior, Triangle};
use crate::identification::statistics::uncertainty_problem::Rows;
use std::ops::Range;

/// Scale of the half-Cauchy prior of σm, rad: joints usually rotate by 0.3 mrad under the weight of an arm's end.
const USUAL_MISFIT_RAD: f64 = 3e-4;
/// Number of rounds of the search for both σm; each uses the noise of the round before.
const SEARCHES: usize = 3;
/// Quantiles of the normal distribution for keeping features: 5 % for the usual ones, which every robot has, and 0.1 % for harmonics of
/// orders above 1, which most robots do not have. If these were found by chance, they would widen the stated uncertainty and differ between
/// sessions.
const USUAL_KEPT_ABOVE: f64 = 1.645;
const HIGHER_KEPT_ABOVE: f64 = 3.09;
/// Significance level for a joint that follows another one, over all pairs of joints. It must also explain more than it leaves: other
/// errors of a robot are smooth functions of its joints too, and with many points they are just as significant.
const CHANCE_OF_FOLLOWING: f64 = 1e-6;

/// Solution of the wider problem.
pub(super) struct Solved {
    /// Columns of the rows that are coordinates of the solution.
    pub(super) columns: Vec<usize>,
    /// Joints that follow others, as indices into the misfit's list.
    pub(super) followings: Vec<usize>,
    pub(super) triangle: Triangle,
    pub(super) evidence: Evidence,
    pub(super) posterior: Posterior,
    /// σm of the usual features, and of harmonics of orders above 1; 0 if not significant. Such features are no coordinates of the
    /// solution.
    pub(super) usual_std_rad: f64,
    pub(super) higher_std_rad: f64,
}

impl Rows<'_> {
    /// The posterior, with σm and σ. `priors` has the widths from the estimate. Joints that follow others are added one by one as coordinates with a
    /// flat prior, the most significant first.
    pub(super) fn solve(&self, priors: &Evidence, ratio: f64) -> Solved {
        let triangle = self.triangle(ratio);
        let mut followings = vec![];
        loop {
            let solved = self.solve_with(&triangle, &followings, priors);
            let next = self.next_following(&triangle, &solved);
            let Some(next) = next.filter(|_| self.session.watch.goes_on()) else {
                return solved;
            };
            followings.push(next);
        }
    }

    /// The most significant of the joints that may follow others and are not in a solution.
    fn next_following(&self, triangle: &Triangle, solved: &Solved) -> Option<usize> {
        let n = self.columns.n_followings;
        let others: Vec<usize> = (0..n).filter(|k| !solved.followings.contains(k)).collect();
        let of_others = others.iter().map(|k| self.columns.without_features() + k);
        let columns: Vec<usize> = solved.columns.iter().copied().chain(of_others).collect();
        let n_solved = solved.columns.len();
        let triangle = triangle.of_columns(&columns);
        let beyond =
            triangle.remaining_rows(&self.coordinates(columns.len()), &solved.evidence, n_solved);
        let best = beyond.dominant(CHANCE_OF_FOLLOWING / n.max(1) as f64)?;
        Some(others[best])
    }

    /// Coordinates of the identified robot; all others are 0 there.
    fn coordinates(&self, n: usize) -> Vec<f64> {
        let mut x = self.x.clone();
        x.resize(n, 0.0);
        x
    }

    fn solve_with(&self, triangle: &Triangle, followings: &[usize], priors: &Evidence) -> Solved {
        let columns = &self.columns;
        let of_followings = followings.iter().map(|k| columns.without_features() + k);
        let flat: Vec<usize> = (0..columns.without_features())
            .chain(of_followings)
            .collect();
        let [usual, higher] = [columns.usual(), columns.higher()];
        // Coordinates, noise and widths, with the features that have a standard deviation.
        let with = |stds_rad: [f64; 2], sigma_mm: f64| {
            let mut columns = flat.clone();
            let width = |column: &usize| *priors.widths.get(*column).unwrap_or(&Evidence::FLAT);
            let mut evidence = Evidence {
                sigma_mm,
                widths: flat.iter().map(width).collect(),
                ..priors.clone()
            };
            let [usual_std_rad, higher_std_rad] = stds_rad;
            for (features, std_rad) in [(&higher, higher_std_rad), (&usual, usual_std_rad)] {
                if std_rad > 0.0 {
                    columns.extend(features.clone());
                    evidence.widths.resize(columns.len(), std_rad);
                }
            }
            (columns, evidence)
        };
        let solved = |stds_rad: [f64; 2], sigma_mm: f64| {
            let (columns, evidence) = with(stds_rad, sigma_mm);
            let triangle = triangle.of_columns(&columns);
            Solved {
                followings: followings.to_vec(),
                posterior: triangle.solve(&self.coordinates(columns.len()), &evidence),
                usual_std_rad: stds_rad[0],
                higher_std_rad: stds_rad[1],
                columns,
                triangle,
                evidence,
            }
        };
        let noise_mm = |stds_rad: [f64; 2], sigma_mm: f64| {
            let Solved {
                triangle,
                posterior,
                ..
            } = solved(stds_rad, sigma_mm);
            let problem = self.session.problem;
            let noise_mm = triangle.noise_mm(problem, &posterior);
            noise_mm.max(problem.least_sigma_mm)
        };
        // The standard deviation of some features, given that of the others.
        let std_of = |features: &Range<usize>, others_rad: [f64; 2], sigma_mm: f64, kept_above| {
            let (mut columns, evidence) = with(others_rad, sigma_mm);
            let first = columns.len();
            columns.extend(features.clone());
            let x = self.coordinates(columns.len());
            let beyond = triangle
                .of_columns(&columns)
                .remaining_rows(&x, &evidence, first);
            beyond.spectrum().map_or(0.0, |s| {
                s.most_probable(USUAL_MISFIT_RAD, sigma_mm, kept_above)
            })
        };
        // If there are fewer equations than features, they show nothing about the features.
        let n_spare = (3 * self.n_points()).saturating_sub(flat.len());
        let (mut usual_rad, mut higher_rad) = (0.0, 0.0);
        let mut sigma_mm = noise_mm([0.0, 0.0], priors.sigma_mm);
        for search in 0..=SEARCHES {
            usual_rad = std_of(&usual, [0.0, higher_rad], sigma_mm, USUAL_KEPT_ABOVE);
            sigma_mm = noise_mm([usual_rad, higher_rad], sigma_mm);
            if search == SEARCHES {
                break;
            }
            if search == 0 && n_spare >= higher.len() || higher_rad > 0.0 {
                higher_rad = std_of(&higher, [usual_rad, 0.0], sigma_mm, HIGHER_KEPT_ABOVE);
                sigma_mm = noise_mm([usual_rad, higher_rad], sigma_mm);
            }
            if usual_rad == 0.0 && higher_rad == 0.0 {
                break;
            }
        }
        solved([usual_rad, higher_rad], sigma_mm)
    }
}
