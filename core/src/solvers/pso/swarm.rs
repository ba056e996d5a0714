//! The moving swarm: update [Gao 2018, eq. 9, 10], evaluation, and storing of the best. Nothing here allocates after `new`, and every inner loop runs
//! over particles, which are contiguous in memory.

use super::options::{Cost, Options, Positions};
use crate::solvers::random::{LANES, LaneRandom};
use multiversion::multiversion;

/// The state that changes during a search.
pub(super) struct Swarm {
    pub positions: Positions,
    pub velocities: Positions,
    pub costs: Vec<f64>,
    pub own_best_positions: Positions,
    pub own_best_costs: Vec<f64>,
    pub best_position: Vec<f64>,
    pub best_cost: f64,
    /// r1 of all particles, then r2 of all particles.
    random_numbers: Vec<f64>,
}

/// Inputs of eq. 9 and 10 for one coordinate, except the particles.
struct Coordinate {
    inertia_weight: f64,
    cognitive: f64,
    social: f64,
    swarm_best: f64,
}

impl Swarm {
    /// A swarm at rest at the given positions.
    pub fn new(positions: &Positions) -> Self {
        let n = positions.n_particles;
        Self {
            positions: positions.clone(),
            velocities: Positions::zeros(n, positions.n_coordinates),
            costs: vec![f64::INFINITY; n],
            own_best_positions: positions.clone(),
            own_best_costs: vec![f64::INFINITY; n],
            best_position: positions.particle(0),
            best_cost: f64::INFINITY,
            random_numbers: vec![0.0; 2 * n],
        }
    }

    /// Evaluates all positions and keeps each particle's and the swarm's best. An equal cost replaces nothing. Among equal particles, the first is
    /// the swarm's best.
    pub fn evaluate(&mut self, cost: &mut Cost<'_>) {
        self.costs.copy_from_slice(&self.own_best_costs);
        cost(&self.positions, &mut self.costs);
        let best = keep_own_best(
            &mut self.costs,
            &self.positions,
            &mut self.own_best_costs,
            &mut self.own_best_positions,
        );
        if self.costs[best] < self.best_cost {
            self.best_cost = self.costs[best];
            for (j, x) in self.best_position.iter_mut().enumerate() {
                *x = self.positions.get(best, j);
            }
        }
    }

    /// Moves all particles once [Gao 2018, eq. 9, 10].
    pub fn update(&mut self, options: &Options, random: &mut LaneRandom) {
        for j in 0..self.positions.n_coordinates {
            random.fill(&mut self.random_numbers);
            let (r1, r2) = self.random_numbers.split_at(self.positions.n_particles);
            let coordinate = Coordinate {
                inertia_weight: options.inertia_weight,
                cognitive: options.cognitive,
                social: options.social,
                swarm_best: self.best_position[j],
            };
            let own_best = self.own_best_positions.coordinate(j);
            move_coordinate(
                &coordinate,
                r1,
                r2,
                own_best,
                self.positions.coordinate_mut(j),
                self.velocities.coordinate_mut(j),
            );
        }
    }
}

/// Sets costs that are not finite to +∞, stores cost and coordinates of the particles that improved, and returns the index of the first cheapest
/// particle.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn keep_own_best(
    costs: &mut [f64],
    positions: &Positions,
    own_best_costs: &mut [f64],
    own_best_positions: &mut Positions,
) -> usize {
    let n = costs.len();
    let mut lowest = [f64::INFINITY; LANES];
    for block in costs.chunks_mut(LANES) {
        for (cost, lowest) in block.iter_mut().zip(&mut lowest) {
            *cost = if cost.is_finite() {
                *cost
            } else {
                f64::INFINITY
            };
            *lowest = if *cost < *lowest { *cost } else { *lowest };
        }
    }
    let lowest = lowest.into_iter().fold(f64::INFINITY, f64::min);
    // Only a few particles improve.
    for i in 0..n {
        if costs[i] < own_best_costs[i] {
            own_best_costs[i] = costs[i];
            for (x, best) in positions
                .values
                .chunks_exact(n)
                .zip(own_best_positions.values.chunks_exact_mut(n))
            {
                best[i] = x[i];
            }
        }
    }
    costs.iter().position(|cost| *cost == lowest).unwrap_or(0)
}

/// [Gao 2018, eq. 9, 10] for one coordinate of all particles.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn move_coordinate(
    coordinate: &Coordinate,
    r1: &[f64],
    r2: &[f64],
    own_best: &[f64],
    x: &mut [f64],
    v: &mut [f64],
) {
    let Coordinate {
        inertia_weight,
        cognitive,
        social,
        swarm_best,
    } = *coordinate;
    let n = x.len();
    let (r1, r2, own_best, x, v) = (&r1[..n], &r2[..n], &own_best[..n], &mut x[..n], &mut v[..n]);
    for i in 0..n {
        let inertia = inertia_weight * v[i];
        let towards_swarm = (social * r2[i]).mul_add(swarm_best - x[i], inertia);
        v[i] = (cognitive * r1[i]).mul_add(own_best[i] - x[i], towards_swarm);
        x[i] += v[i];
    }
}
