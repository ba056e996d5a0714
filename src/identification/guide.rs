//! The network that is trained on what a swarm saw, not only on where it ended.
//!
//! Every evaluated particle i has a position x_i and residuals r_i = measured − predicted(x_i). If particle j were the robot, i would see
//! r_i − r_j, and its way to the answer would be x_j − x_i. From such pairs a network learns the way from what is seen; told what a
//! particle really sees, it answers with the way from there to the robot as it is now, changed or not. It is trained anew in every run,
//! on this swarm at this session's poses, so that neither a moved tracker nor other poses make it stale; what is kept from run to run is
//! the network of [`bpnn_pso`](crate::identification::bpnn_pso), which remembers where the robot was.
//!
//! What is seen enters as random mixtures of the residuals: the network has one size however many points there are, and all that links
//! mixtures to ways it has to learn by back-propagation. There are no derivatives of the robot and no least-squares step in it.

use crate::identification::objective::{Observation, weighted_residuals};
use crate::identification::search_space::SearchSpace;
use crate::solvers::bpnn::{self, Network};
use crate::solvers::pso::Positions;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Points that are looked at, at most, evenly spread over the set: ten times as many residuals as a six-axis arm has parameters.
const MOST_POINTS: usize = 100;
/// Mixtures for each coordinate of the search: with as many as coordinates some way would hardly be seen.
const MIXTURES: usize = 2;
/// Hidden neurons beyond one for each coordinate: fewer could not pass on a way in every direction, and [Gao 2018]'s rule gives fewer.
const MORE_HIDDEN: usize = 4;
/// Passes over the samples in one training.
const EPOCHS: usize = 300;
/// Trainings in one run. Each learns what the one before left: the long ways first, then the short ones.
const MOST_TRAININGS: usize = 4;
/// As long as half of the guided particles come to at most this share of their cost in one move, the network is good enough.
const GOOD_ENOUGH: f64 = 0.3;
/// Swarms of fewer particles for each coordinate show too little to learn from.
const PARTICLES_PER_COORDINATE: usize = 2;
/// One particle of so many is moved by networks; the others search as a cold swarm does.
const GUIDED: usize = 2;
/// One particle of so many starts where the stored network remembers the robot. The other guided ones start in the box: from there the
/// way to a robot that has changed is one like those that were learnt.
const REMEMBERING: usize = 4;

/// What particles see: mixtures of the weighted residuals at some of the points.
struct Sight<'a> {
    space: &'a SearchSpace,
    observations: Vec<Observation>,
    /// Signs at random, n_mixtures × 3·N (and one column for each prior).
    mixing: DMatrix<f64>,
}

/// A particle where it was evaluated, and what it saw there.
#[derive(Clone)]
struct Evaluated {
    position: Vec<f64>,
    mixtures: DVector<f64>,
    /// F over the points looked at, mm².
    cost: f64,
}

impl<'a> Sight<'a> {
    fn new(space: &'a SearchSpace, observations: &[Observation], seed: u64) -> Self {
        let step = observations.len().div_ceil(MOST_POINTS).max(1);
        let observations: Vec<Observation> = observations.iter().step_by(step).cloned().collect();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let n = 3 * observations.len() + space.known().pulls.len();
        let n_mixtures = (MIXTURES * space.n_coordinates()).min(n);
        let mixing = DMatrix::from_fn(n_mixtures, n, |_, _| {
            if random.random::<bool>() { 1.0 } else { -1.0 }
        });
        Self {
            space,
            observations,
            mixing,
        }
    }

    fn look(&self, position: Vec<f64>) -> Evaluated {
        let mut residuals = weighted_residuals(&self.space.model(&position), &self.observations);
        let known = self.space.known();
        if !known.pulls.is_empty() {
            let deviation = self.space.deviation(&position);
            residuals = DVector::from_iterator(
                self.mixing.ncols(),
                residuals.iter().copied().chain(known.residuals(&deviation)),
            );
        }
        Evaluated {
            position,
            mixtures: &self.mixing * &residuals,
            cost: residuals.norm_squared(),
        }
    }
}

/// The trained network with the scales of its inputs and outputs.
struct Guide {
    network: Network,
    input_scale: Vec<f64>,
    output_scale: Vec<f64>,
}

impl Guide {
    /// Trains on pairs, each with one half of the list on. `weight` says how much each coordinate matters.
    fn train(evaluated: &[Evaluated], weight: &[f64], seed: u64) -> Self {
        let n = evaluated.len();
        let pairs: Vec<(&Evaluated, &Evaluated)> = (0..n)
            .map(|i| (&evaluated[i], &evaluated[(i + n / 2 + 1) % n]))
            .collect();
        let seen: Vec<Vec<f64>> = pairs
            .iter()
            .map(|(i, j)| (&i.mixtures - &j.mixtures).as_slice().to_vec())
            .collect();
        let ways: Vec<Vec<f64>> = pairs
            .iter()
            .map(|(i, j)| {
                i.position
                    .iter()
                    .zip(&j.position)
                    .map(|(x, y)| y - x)
                    .collect()
            })
            .collect();
        let mean_square = |rows: &[Vec<f64>], k: usize| {
            rows.iter().map(|row| row[k] * row[k]).sum::<f64>() / n as f64
        };
        let input_scale: Vec<f64> = (0..seen[0].len())
            .map(|k| mean_square(&seen, k).sqrt().max(f64::MIN_POSITIVE))
            .collect();
        let weighted: f64 = weight
            .iter()
            .enumerate()
            .map(|(k, w)| w * w * mean_square(&ways, k))
            .sum::<f64>()
            / weight.len() as f64;
        let output_scale: Vec<f64> = weight
            .iter()
            .map(|w| (weighted.sqrt() / w).max(f64::MIN_POSITIVE))
            .collect();
        let scaled = |rows: &[Vec<f64>], scale: &[f64]| -> Vec<Vec<f64>> {
            rows.iter()
                .map(|row| row.iter().zip(scale).map(|(v, s)| v / s).collect())
                .collect()
        };
        let options = bpnn::Options {
            seed,
            n_epochs: EPOCHS,
            ..bpnn::Options::default()
        };
        let n_hidden = weight.len() + MORE_HIDDEN;
        let (network, _) = bpnn::train(
            &scaled(&seen, &input_scale),
            &scaled(&ways, &output_scale),
            n_hidden,
            &options,
        );
        Self {
            network,
            input_scale,
            output_scale,
        }
    }

    /// The ways of some particles. Odd in what is seen: who sees no residuals stays.
    fn ways(&self, particles: &[Evaluated]) -> Vec<Vec<f64>> {
        let scaled = |sign: f64| -> Vec<Vec<f64>> {
            particles
                .iter()
                .map(|p| {
                    p.mixtures
                        .iter()
                        .zip(&self.input_scale)
                        .map(|(m, s)| sign * m / s)
                        .collect()
                })
                .collect()
        };
        let (there, back) = (
            self.network.evaluate_all(&scaled(1.0)),
            self.network.evaluate_all(&scaled(-1.0)),
        );
        let way = |(there, back): (Vec<f64>, Vec<f64>)| {
            let halves = there.iter().zip(back).map(|(t, b)| 0.5 * (t - b));
            halves
                .zip(&self.output_scale)
                .map(|(half, scale)| half * scale)
                .collect()
        };
        there.into_iter().zip(back).map(way).collect()
    }
}

/// Moves a part of a swarm, once per iteration, for as long as that lowers its costs.
pub struct GuidedSwarm<'a> {
    sight: Sight<'a>,
    /// How far each coordinate displaces the points, rms, mm.
    effects_mm: Vec<f64>,
    seed: u64,
    guide: Option<Guide>,
    n_trained: usize,
    /// Positions that were handed out to be evaluated.
    handed_out: Option<Positions>,
    /// Where each guided particle was best.
    best: Vec<Evaluated>,
    is_over: bool,
}

impl<'a> GuidedSwarm<'a> {
    /// Before the first swarm is evaluated. `effects_mm`: how far each coordinate of the space displaces the points, rms.
    pub fn new(
        space: &'a SearchSpace,
        observations: &[Observation],
        effects_mm: &[f64],
        seed: u64,
    ) -> Self {
        Self {
            sight: Sight::new(space, observations, seed),
            effects_mm: effects_mm.to_vec(),
            seed,
            guide: None,
            n_trained: 0,
            handed_out: None,
            best: vec![],
            is_over: false,
        }
    }

    /// True if a swarm of this size can be guided; else the stored network moves all of it, once.
    pub fn is_possible(space: &SearchSpace, n_particles: usize) -> bool {
        n_particles >= PARTICLES_PER_COORDINATE * space.n_coordinates().max(MIXTURES)
    }

    /// The particles that start where the stored network remembers the robot.
    pub fn remembering(n_particles: usize) -> impl Iterator<Item = usize> {
        (0..n_particles).step_by(REMEMBERING)
    }

    /// Called before every evaluation, with what the swarm would evaluate.
    pub fn move_particles(&mut self, positions: &mut Positions) {
        if self.is_over {
            return;
        }
        if let Some(evaluated) = self.handed_out.take() {
            if self.best.is_empty() {
                self.learn_from_all(&evaluated);
            } else {
                self.learn_from_guided(&evaluated);
            }
            self.guide_from_best(positions);
        }
        self.handed_out = Some(positions.clone());
    }

    fn learn_from_all(&mut self, evaluated: &Positions) {
        let all: Vec<Evaluated> = (0..evaluated.n_particles)
            .map(|i| self.sight.look(evaluated.particle(i)))
            .collect();
        self.train(&all);
        self.best = all.into_iter().step_by(GUIDED).collect();
    }

    /// Keeps what was better, and trains anew on both where the last moves were not good enough.
    fn learn_from_guided(&mut self, evaluated: &Positions) {
        let mut now: Vec<Evaluated> = (0..evaluated.n_particles)
            .step_by(GUIDED)
            .map(|i| self.sight.look(evaluated.particle(i)))
            .collect();
        let mut shares: Vec<f64> = now
            .iter()
            .zip(&self.best)
            .map(|(now, best)| now.cost / best.cost)
            .collect();
        shares.sort_by(f64::total_cmp);
        for (now, best) in now
            .iter_mut()
            .zip(&mut self.best)
            .filter(|(now, best)| now.cost < best.cost)
        {
            std::mem::swap(now, best);
        }
        if shares[shares.len() / 2] <= GOOD_ENOUGH {
            return;
        }
        if self.n_trained == MOST_TRAININGS {
            self.is_over = true;
            return;
        }
        now.extend(self.best.iter().cloned());
        self.train(&now);
    }

    fn train(&mut self, evaluated: &[Evaluated]) {
        self.guide = Some(Guide::train(evaluated, &self.effects_mm, self.seed));
        self.n_trained += 1;
    }

    fn guide_from_best(&self, positions: &mut Positions) {
        let Some(guide) = self.guide.as_ref().filter(|_| !self.is_over) else {
            return;
        };
        for (k, (best, way)) in self.best.iter().zip(guide.ways(&self.best)).enumerate() {
            let there: Vec<f64> = best.position.iter().zip(way).map(|(x, w)| x + w).collect();
            if there.iter().all(|x| x.is_finite()) {
                positions.set_particle(GUIDED * k, &there);
            }
        }
    }
}
