//! The order in which points were measured: how much points of one configuration err together, and random orders of the configurations.

use crate::solvers::watch::Watch;
use nalgebra::{DVector, Vector3};
use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::ChaCha8Rng};

/// Maximum number of random orders. An effect must be larger than in every one of them.
const ORDERS: usize = 199;
/// Maximum of points times orders, so that a large set takes no longer than a small one; but at least [`MIN_ORDERS`].
const ORDERED_POINTS: usize = 24_000;
/// Minimum number of random orders.
const MIN_ORDERS: usize = 39;

/// Design effect: how much more the sums of residuals per configuration vary than sums of independent points; at least 1. `clusters` has the
/// configuration of each point.
pub fn design_effect(residuals: &DVector<f64>, clusters: impl Iterator<Item = usize>) -> f64 {
    let mut sums: Vec<Vector3<f64>> = Vec::new();
    for (place, cluster) in clusters.enumerate() {
        if cluster >= sums.len() {
            sums.resize(cluster + 1, Vector3::zeros());
        }
        sums[cluster] += residuals.fixed_rows::<3>(3 * place);
    }
    let of_sums: f64 = sums.iter().map(Vector3::norm_squared).sum();
    (of_sums / residuals.norm_squared()).max(1.0)
}

/// True if `holds` is true for all random orders of the blocks, each with the places of one configuration. False if the watch stops.
pub fn holds_in_random_orders(
    mut blocks: Vec<Vec<usize>>,
    watch: &Watch<'_>,
    mut holds: impl FnMut(&[usize]) -> bool,
) -> bool {
    let n_points: usize = blocks.iter().map(Vec::len).sum();
    let n_orders = (ORDERED_POINTS / n_points.max(1)).clamp(MIN_ORDERS, ORDERS);
    let mut random = ChaCha8Rng::seed_from_u64(0);
    (0..n_orders).all(|_| {
        if !watch.goes_on() {
            return false;
        }
        blocks.shuffle(&mut random);
        holds(&blocks.concat())
    })
}
