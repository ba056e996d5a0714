//! Points in measuring order. Computes how strongly the errors of one configuration's points are correlated, and makes random orders of the
//! configurations.

use crate::identification::screening::outliers::Linearised;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3xX, Vector3};
use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::ChaCha8Rng};
use std::collections::BTreeMap;

/// Maximum number of random orders. An effect must be larger than in every one of them.
const ORDERS: usize = 199;
/// Maximum of points times orders, which limits the time for a large set; but at least [`MIN_ORDERS`] orders.
const ORDERED_POINTS: usize = 24_000;
/// Minimum number of random orders.
const MIN_ORDERS: usize = 39;

/// Points in measuring order.
#[derive(Clone)]
pub struct OrderedPoints<'a> {
    /// The fit to them.
    pub linear: Linearised,
    /// Features of the misfit, 3·N × m.
    pub features: DMatrix<f64>,
    /// Effects of one rad of each joint at each point, weighted.
    pub joints: Vec<&'a Matrix3xX<f64>>,
    /// Effect of a shift at each point, weighted.
    pub shifts: Vec<Matrix3<f64>>,
    /// Square root of each point's weight.
    pub roots: Vec<f64>,
    /// Joint values of each point.
    pub q_rad: Vec<&'a [f64]>,
    /// Configuration of each point.
    pub clusters: Vec<usize>,
    /// Target of each point.
    pub targets: Vec<usize>,
    /// Radius of the workspace, mm.
    pub reach_mm: f64,
    /// Asked between parts of the work whether to stop.
    pub watch: &'a Watch<'a>,
}

impl OrderedPoints<'_> {
    /// Some of the points, in the given order.
    pub fn of(&self, points: &[usize]) -> Self {
        fn some<T: Copy>(all: &[T], points: &[usize]) -> Vec<T> {
            points.iter().map(|i| all[*i]).collect()
        }
        let rows: Vec<usize> = points.iter().flat_map(|i| 3 * i..3 * i + 3).collect();
        Self {
            linear: self.linear.of(points),
            features: self.features.select_rows(&rows),
            joints: some(&self.joints, points),
            shifts: some(&self.shifts, points),
            roots: some(&self.roots, points),
            q_rad: some(&self.q_rad, points),
            clusters: some(&self.clusters, points),
            targets: some(&self.targets, points),
            ..*self
        }
    }
}

/// The places of the points of each configuration. `clusters` has the configuration at each place.
pub fn by_configuration(clusters: &[usize]) -> Vec<Vec<usize>> {
    let mut blocks: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (place, cluster) in clusters.iter().enumerate() {
        blocks.entry(*cluster).or_default().push(place);
    }
    blocks.into_values().collect()
}

/// Visits: runs of points of one configuration, measured one after another. `clusters` has the configuration of each point.
pub fn visits(clusters: &[usize]) -> Vec<Vec<usize>> {
    let places: Vec<usize> = (0..clusters.len()).collect();
    let same = |a: &usize, b: &usize| clusters[*a] == clusters[*b];
    places.chunk_by(same).map(<[usize]>::to_vec).collect()
}

/// Design effect: ratio of the variance of the sums of residuals per configuration to that of sums of independent points; at least 1.
/// `clusters` has the configuration of each point. A fit absorbs part of the errors of whole configurations, so both variances are computed
/// from what it leaves.
///
/// `fitted` has an orthonormal basis of what the fit absorbs, 3·N × r.
pub fn design_effect(
    residuals: &DVector<f64>,
    fitted: &DMatrix<f64>,
    clusters: impl Iterator<Item = usize>,
) -> f64 {
    let n_fitted = fitted.ncols();
    let (mut sums, mut taken) = (Vec::new(), Vec::new());
    let mut n_of: Vec<f64> = Vec::new();
    for (place, cluster) in clusters.enumerate() {
        if cluster >= sums.len() {
            sums.resize(cluster + 1, Vector3::zeros());
            taken.resize(cluster + 1, Matrix3xX::zeros(n_fitted));
            n_of.resize(cluster + 1, 0.0);
        }
        sums[cluster] += residuals.fixed_rows::<3>(3 * place);
        taken[cluster] += fitted.fixed_rows::<3>(3 * place);
        n_of[cluster] += 3.0;
    }
    let squares = |sum: f64, v: &Vector3<f64>| sum + v.norm_squared();
    let of_sums = sums.iter().fold(0.0, squares);
    let left = n_of.iter().zip(&taken).map(|(n, q)| n - q.norm_squared());
    let rows = residuals.len() as f64;
    let of_points = residuals.norm_squared() / (rows - n_fitted as f64).max(1.0);
    (of_sums / left.sum::<f64>().max(1.0) / of_points).max(1.0)
}

/// True if `holds` is true for every random order of the blocks. A block has the places of one configuration. False if the watch stops.
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
