//! Division of the points into parts, and what predictions of parts that were not fitted show.

use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::ChaCha8Rng};
use std::collections::BTreeMap;

/// Parts of the cross-validation.
const FOLDS: usize = 5;

/// Divisions into such parts, over which a configuration's error is averaged: with few configurations one division is a matter of luck.
const DIVISIONS: u64 = 5;

/// What a correction was found to do.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// `stiffness_2_3` (the two joints that gravity loads most), `stiffness_all`, `base_compliance`, `link_masses`, `link_centres`,
    /// `joint_harmonics`, `residual_network`, and at last `all_together` where something was kept.
    pub kind: String,
    /// It won, and the points to verify had nothing against it.
    pub kept: bool,
    /// It won, and was dropped with all others: on the points to verify the robot with corrections is further off than its links alone.
    pub is_vetoed: bool,
    /// Root mean square error of unseen points without it, mm.
    pub before_mm: f64,
    /// And with it, mm.
    pub after_mm: f64,
    /// Mean gain in squared error over configurations, mm².
    pub gain_mm2: f64,
    /// Standard error of that, mm².
    pub standard_error_mm2: f64,
}

/// Squared error of each configuration when it was not fitted, mm² (mean over its points).
#[derive(Clone)]
pub(super) struct Unseen {
    pub errors: Vec<f64>,
}

impl Unseen {
    /// Mean gain from `self` to `other`, and its standard error.
    pub fn gain(&self, other: &Self) -> (f64, f64) {
        let gains: Vec<f64> = self
            .errors
            .iter()
            .zip(&other.errors)
            .map(|(before, after)| before - after)
            .collect();
        let n = gains.len() as f64;
        let mean = gains.iter().sum::<f64>() / n;
        let variance = gains.iter().map(|g| (g - mean) * (g - mean)).sum::<f64>() / (n - 1.0);
        (mean, (variance / n).sqrt())
    }

    pub fn rms_mm(&self) -> f64 {
        (self.errors.iter().sum::<f64>() / self.errors.len() as f64).sqrt()
    }

    pub fn evidence(&self, with: &Self, kind: &str) -> Evidence {
        let (gain_mm2, standard_error_mm2) = self.gain(with);
        let kept = gain_mm2 > standard_error_mm2;
        Evidence {
            kind: kind.into(),
            kept,
            is_vetoed: false,
            before_mm: self.rms_mm(),
            after_mm: with.rms_mm(),
            gain_mm2,
            standard_error_mm2,
        }
    }
}

/// How the points are divided.
pub(super) struct Folds {
    /// Configuration of each point, counted from 0.
    pub clusters: Vec<usize>,
    /// Part of each point.
    pub folds: Vec<usize>,
    pub n_folds: usize,
    /// Configurations.
    pub n_clusters: usize,
}

/// By session where there are several; else the configurations at random, several times.
pub(super) fn divisions(clusters: &[usize], sessions: &[Option<String>], seed: u64) -> Vec<Folds> {
    let n_clusters = clusters.iter().max().map_or(0, |last| last + 1);
    let mut labels: BTreeMap<&Option<String>, usize> = BTreeMap::new();
    for session in sessions {
        let next = labels.len();
        labels.entry(session).or_insert(next);
    }
    if labels.len() > 1 {
        // whole sessions stay together; what a fold costs does not grow with how many there are
        let folds = sessions
            .iter()
            .map(|session| labels[session] % FOLDS)
            .collect();
        return vec![Folds {
            clusters: clusters.to_vec(),
            folds,
            n_folds: labels.len().min(FOLDS),
            n_clusters,
        }];
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<usize> = (0..n_clusters).collect();
    let mut division = |_| {
        order.shuffle(&mut random);
        let mut fold_of = vec![0; n_clusters];
        order
            .iter()
            .enumerate()
            .for_each(|(i, cluster)| fold_of[*cluster] = i % FOLDS);
        let folds = clusters.iter().map(|cluster| fold_of[*cluster]).collect();
        Folds {
            clusters: clusters.to_vec(),
            folds,
            n_folds: FOLDS,
            n_clusters,
        }
    };
    (0..DIVISIONS).map(&mut division).collect()
}

impl Folds {
    /// Means over configurations of a value of each point.
    pub fn by_configuration(&self, of_point: impl Fn(usize) -> f64) -> Unseen {
        let (mut sums, mut counts) = (vec![0.0; self.n_clusters], vec![0.0; self.n_clusters]);
        for (point, cluster) in self.clusters.iter().enumerate() {
            sums[*cluster] += of_point(point);
            counts[*cluster] += 1.0;
        }
        Unseen {
            errors: sums
                .iter()
                .zip(&counts)
                .filter(|(_, n)| **n > 0.0)
                .map(|(sum, n)| sum / n)
                .collect(),
        }
    }
}
