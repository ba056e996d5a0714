//! Prior knowledge of parameters: normal priors, and bounds.
//!
//! With σ the standard deviation of a coordinate of the points and δ a parameter's deviation from the reference, F gains Σ (σ/std)²·(δ − mean)²
//! (maximum a posteriori for normal errors of both), and δ stays between its bounds. Priors and points are thus weighed by their uncertainties,
//! whatever the units.

use crate::identification::KinematicModel;
use crate::identification::model::parameters::{Parameter, apply, deviation_from};

/// A parameter is at a bound if its distance from it is at most this share of the prior's std plus the bound's size.
const AT_BOUND: f64 = 1e-9;

/// Prior of one parameter, relative to the reference, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Its index among the free parameters.
    pub parameter: usize,
    /// Expected value.
    pub mean: f64,
    /// One standard deviation.
    pub std: f64,
    /// Smallest value allowed; −∞ without.
    pub min: f64,
    /// Largest value allowed; +∞ without.
    pub max: f64,
}

/// The priors of a fit. The base's rotation has none: it has no value that could be known before the instrument is set up.
#[derive(Clone, Debug, PartialEq)]
pub struct Priors {
    /// One for each parameter that has a prior.
    pub all: Vec<Prior>,
    /// σ, mm.
    pub scale_mm: f64,
    reference: KinematicModel,
    parameters: Vec<Parameter>,
}

/// A prior as a row of least squares: residual = weight · (mean − deviation).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorRow {
    /// Index of the parameter.
    pub parameter: usize,
    /// σ/std, mm per mm or rad.
    pub weight: f64,
    /// Expected deviation of the parameter, mm or rad.
    pub mean: f64,
}

/// Bounds of a deviation, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Index of the parameter.
    pub parameter: usize,
    /// Lower bound.
    pub low: f64,
    /// Upper bound.
    pub high: f64,
}

impl Limit {
    /// The nearest deviation within the bounds.
    pub fn within(&self, deviation: f64) -> f64 {
        deviation.max(self.low).min(self.high)
    }
}

/// Priors and bounds relative to a model, whose deviations are 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PriorRows {
    /// Priors.
    pub rows: Vec<PriorRow>,
    /// Bounds of the parameters that have any.
    pub limits: Vec<Limit>,
}

impl PriorRows {
    /// Residuals of the priors, mm.
    pub fn residuals<'a>(&'a self, deviation: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
        self.rows
            .iter()
            .map(|row| row.weight * (row.mean - deviation[row.parameter]))
    }

    /// Cost of the priors, mm².
    pub fn cost_mm2(&self, deviation: &[f64]) -> f64 {
        self.residuals(deviation).map(|r| r * r).sum()
    }
}

impl Priors {
    /// Priors relative to `reference`, with σ not yet set.
    pub fn new(reference: &KinematicModel, parameters: &[Parameter], all: Vec<Prior>) -> Self {
        Self {
            all,
            scale_mm: 0.0,
            reference: reference.clone(),
            parameters: parameters.to_vec(),
        }
    }

    /// Deviation of each parameter with a prior from the reference in a model, mm or rad.
    fn deviations(&self, model: &KinematicModel) -> Vec<f64> {
        self.all
            .iter()
            .map(|prior| deviation_from(&self.reference, model, &self.parameters[prior.parameter]))
            .collect()
    }

    /// Priors and bounds relative to a model.
    pub fn from(&self, model: &KinematicModel) -> PriorRows {
        let of = |(prior, at): (&Prior, f64)| {
            let row = PriorRow {
                parameter: prior.parameter,
                weight: self.scale_mm / prior.std,
                mean: prior.mean - at,
            };
            (
                row,
                Limit {
                    parameter: prior.parameter,
                    low: prior.min - at,
                    high: prior.max - at,
                },
            )
        };
        let (rows, limits): (Vec<PriorRow>, Vec<Limit>) =
            self.all.iter().zip(self.deviations(model)).map(of).unzip();
        PriorRows {
            rows,
            limits: limits
                .into_iter()
                .filter(|l| l.low.is_finite() || l.high.is_finite())
                .collect(),
        }
    }

    /// Parameters and the standard deviations of their priors, mm or rad.
    pub fn stds(&self) -> Vec<(usize, f64)> {
        self.all
            .iter()
            .map(|prior| (prior.parameter, prior.std))
            .collect()
    }

    /// Cost of the priors at a model, mm².
    pub fn cost_mm2(&self, model: &KinematicModel) -> f64 {
        self.from(model).cost_mm2(&vec![0.0; self.parameters.len()])
    }

    /// The model with every parameter moved inside its bounds.
    pub fn within_bounds(&self, model: &KinematicModel) -> KinematicModel {
        self.moved(model, |limit| limit.within(0.0))
    }

    fn moved(&self, model: &KinematicModel, by: impl Fn(&Limit) -> f64) -> KinematicModel {
        let mut deviation = vec![0.0; self.parameters.len()];
        self.from(model)
            .limits
            .iter()
            .for_each(|limit| deviation[limit.parameter] = by(limit));
        if deviation.iter().all(|d| *d == 0.0) {
            model.clone()
        } else {
            apply(model, &self.parameters, &deviation)
        }
    }

    /// Moves from a model inside the bounds towards another one, as far as the bounds allow. Also returns the parameter whose bound ended the step.
    pub fn towards(
        &self,
        from: &KinematicModel,
        to: &KinematicModel,
    ) -> (KinematicModel, Option<usize>) {
        let way: Vec<f64> = self
            .parameters
            .iter()
            .map(|p| deviation_from(from, to, p))
            .collect();
        let share = |limit: &Limit| {
            let bound = if way[limit.parameter] > 0.0 {
                limit.high
            } else {
                limit.low
            };
            (bound / way[limit.parameter]).max(0.0)
        };
        let beyond = |limit: &&Limit| limit.within(way[limit.parameter]) != way[limit.parameter];
        let limits = self.from(from).limits;
        match limits
            .iter()
            .filter(beyond)
            .min_by(|a, b| share(a).total_cmp(&share(b)))
        {
            None => (to.clone(), None),
            Some(first) => {
                let part: Vec<f64> = way.iter().map(|w| w * share(first)).collect();
                (
                    self.within_bounds(&apply(from, &self.parameters, &part)),
                    Some(first.parameter),
                )
            }
        }
    }

    /// The parameters of a model that are at a bound; true for the upper bound.
    pub fn at_bounds(&self, model: &KinematicModel) -> Vec<(usize, bool)> {
        let at = |(prior, deviation): (&Prior, f64)| {
            let near = |bound: f64| {
                bound.is_finite()
                    && (deviation - bound).abs() <= AT_BOUND * (prior.std + bound.abs())
            };
            match (near(prior.max), near(prior.min)) {
                (true, _) => Some((prior.parameter, true)),
                (false, true) => Some((prior.parameter, false)),
                _ => None,
            }
        };
        self.all
            .iter()
            .zip(self.deviations(model))
            .filter_map(at)
            .collect()
    }
}
