//! Prior knowledge of parameters: normal priors, and bounds.
//!
//! With σ the standard deviation of a coordinate of the points and δ a parameter's deviation from the reference, F gains Σ (σ/std)²·(δ − mean)²
//! (maximum a posteriori for normal errors of both), and δ stays between its bounds. Priors and points are thus weighed by their uncertainties,
//! whatever the units.

use crate::identification::KinematicModel;
use crate::identification::model::parameters::{Parameter, apply, deviation_from};

/// A parameter is at a bound if its distance from the bound is at most this share of the prior's std plus the bound's absolute value.
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

/// The priors of a fit. The base's rotation has no prior, because it is unknown before the instrument is set up.
#[derive(Clone, Debug, PartialEq)]
pub struct Priors {
    /// One for each parameter that has a prior.
    pub all: Vec<Prior>,
    /// σ, mm.
    pub scale_mm: f64,
    reference: KinematicModel,
    parameters: Vec<Parameter>,
}

impl Prior {
    /// The nearest deviation within the bounds.
    pub fn within(&self, deviation: f64) -> f64 {
        deviation.max(self.min).min(self.max)
    }
}

/// Priors and bounds relative to a model, whose deviations are 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PriorRows {
    /// The priors, relative to the model.
    pub all: Vec<Prior>,
    /// σ, mm.
    scale_mm: f64,
}

impl PriorRows {
    /// σ/std of a prior, mm per mm or rad. Its row of least squares is this times (mean − deviation).
    pub fn weight(&self, prior: &Prior) -> f64 {
        self.scale_mm / prior.std
    }

    /// Cost of the priors, mm².
    pub fn cost_mm2(&self, deviation: &[f64]) -> f64 {
        let row = |prior: &Prior| self.weight(prior) * (prior.mean - deviation[prior.parameter]);
        self.all.iter().map(row).map(|r| r * r).sum()
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
        let relative = |(prior, at): (&Prior, f64)| Prior {
            mean: prior.mean - at,
            min: prior.min - at,
            max: prior.max - at,
            ..*prior
        };
        let all = self.all.iter().zip(self.deviations(model));
        PriorRows {
            all: all.map(relative).collect(),
            scale_mm: self.scale_mm,
        }
    }

    /// Parameters and the standard deviations of their priors, mm or rad.
    pub fn stds(&self) -> Vec<(usize, f64)> {
        self.all
            .iter()
            .map(|prior| (prior.parameter, prior.std))
            .collect()
    }

    /// The same priors and bounds, with deviations from another reference.
    pub fn with_reference(&self, reference: &KinematicModel) -> Self {
        Self {
            all: self.from(reference).all,
            reference: reference.clone(),
            ..self.clone()
        }
    }

    /// True if a parameter has a bound.
    pub fn has_bounds(&self) -> bool {
        let is_bounded = |prior: &Prior| prior.min.is_finite() || prior.max.is_finite();
        self.all.iter().any(is_bounded)
    }

    /// Cost of the priors at a model, mm².
    pub fn cost_mm2(&self, model: &KinematicModel) -> f64 {
        self.from(model).cost_mm2(&vec![0.0; self.parameters.len()])
    }

    /// The model with every parameter moved inside its bounds.
    pub fn within_bounds(&self, model: &KinematicModel) -> KinematicModel {
        let mut deviation = vec![0.0; self.parameters.len()];
        for prior in self.from(model).all {
            deviation[prior.parameter] = prior.within(0.0);
        }
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
        let share = |prior: &Prior| {
            let bound = if way[prior.parameter] > 0.0 {
                prior.max
            } else {
                prior.min
            };
            (bound / way[prior.parameter]).max(0.0)
        };
        let beyond = |prior: &&Prior| prior.within(way[prior.parameter]) != way[prior.parameter];
        let known = self.from(from).all;
        match known
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
