//! Divides the points into parts for cross-validation, and evaluates predictions of parts that were not fitted.

use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::ChaCha8Rng};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Number of parts of the cross-validation.
const FOLDS: usize = 5;

/// Number of divisions into parts. A configuration's error is averaged over them, because with few configurations a single division depends on luck.
const DIVISIONS: u64 = 5;

/// A correction is kept if its gain exceeds this number of its standard errors.
const STANDARD_ERRORS: f64 = 2.0;

/// A correction that was tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = CorrectionReport)]
pub struct Evidence {
    /// `compliance` (joints and base deflect under gravity), `joint_coupling`, `link_masses` (masses and centres of gravity), `joint_harmonics` or
    /// `residual_network`. They are tried in this order, each in addition to those that were kept before. Reports of earlier versions also have
    /// `stiffness_2_3`, `stiffness_all`, `base_compliance`, `link_centres` and `all_together`.
    pub kind: String,
    /// True if the correction is used. This requires that the gain exceeds twice its standard error, and that the errors on the verify points do
    /// not increase. The errors below are of fits with the usual prior widths; the delivered fit takes its widths from the points.
    pub kept: bool,
    /// Why the correction was dropped in spite of its gain: `worse_on_verify_points` if the errors on the verify points are larger with all
    /// corrections than with the link parameters only. Absent otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dropped_because: Option<String>,
    /// Cross-validated rms error without the correction, mm.
    pub cross_validated_rms_mm_before: f64,
    /// Cross-validated rms error with the correction, mm.
    pub cross_validated_rms_mm_after: f64,
    /// Gain: mean over configurations of the squared error without the correction minus the squared error with it, mm².
    pub gain_mm2: f64,
    /// Standard error of the gain, mm².
    pub standard_error_mm2: f64,
}

/// Squared error of each configuration when it was not fitted, averaged over its points, mm².
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
        let kept = gain_mm2 > STANDARD_ERRORS * standard_error_mm2;
        Evidence {
            kind: kind.into(),
            kept,
            dropped_because: None,
            cross_validated_rms_mm_before: self.rms_mm(),
            cross_validated_rms_mm_after: with.rms_mm(),
            gain_mm2,
            standard_error_mm2,
        }
    }
}

/// A division of the points into parts.
pub(super) struct Folds {
    /// Configuration of each point, counted from 0.
    pub clusters: Vec<usize>,
    /// Part of each point.
    pub folds: Vec<usize>,
    pub n_folds: usize,
    /// Number of configurations.
    pub n_clusters: usize,
}

/// Divides by session if there are several; otherwise divides the configurations at random, several times.
pub(super) fn divisions(clusters: &[usize], sessions: &[Option<String>], seed: u64) -> Vec<Folds> {
    let n_clusters = clusters.iter().max().map_or(0, |last| last + 1);
    let mut labels: BTreeMap<&Option<String>, usize> = BTreeMap::new();
    for session in sessions {
        let next = labels.len();
        labels.entry(session).or_insert(next);
    }
    if labels.len() > 1 {
        // Whole sessions stay together. The number of parts is limited, because each part needs a fit.
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
    /// Mean of a value over the points of each configuration.
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
