//! Maximum a posteriori fit of links and corrections together: the terms are further variables of the least-squares problem
//! ([`crate::identification::least_squares::problem`]).

use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::{Ends, Estimate, estimate_from};
use crate::identification::least_squares::evidence::Evidence;
use crate::identification::least_squares::problem::{CorrectionWidths, Problem, Unknown};
use crate::identification::model::correction_terms::Term;
use crate::identification::model::objective::Observation;
use crate::kinematics::{Corrections, Mounting, Payload};
use nalgebra::IsometryMatrix3;
use std::ops::ControlFlow;

/// A step that gains less than a millionth of the sum of squares moves the fit by a small part of a standard deviation. The derivatives by links are
/// approximate, so the last steps are short.
const ENDS: Ends = Ends {
    smallest_gain: 1e-6,
    ..Ends::AT_MINIMUM
};

/// Everything that does not change between fits.
pub struct Setting<'a> {
    /// The problem of the links alone, with the motions of the stations. Its reference is the nominal robot.
    pub links: Problem<'a>,
    /// Gravity.
    pub mounting: Mounting,
    /// Payload on the flange, if known.
    pub payload: Option<Payload>,
    /// The points, each with nonzero weight.
    pub observations: &'a [Observation],
}

/// A fit of links with some corrections.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// Base, links and targets.
    pub model: KinematicModel,
    /// The free terms of the corrections.
    pub terms: Vec<Term>,
    /// Values of the terms.
    pub values: Vec<f64>,
    /// σ², mm².
    pub variance: f64,
    /// Motion of each station except the reference: transforms its points from their placement by the fit of the links alone. Corrections change
    /// that placement.
    pub station_motions: Vec<IsometryMatrix3<f64>>,
    /// Noise and prior widths of all variables of the fit; `None` before the first fit.
    pub evidence: Option<Evidence>,
}

impl Fitted {
    /// The fit of the links alone, with its σ² in mm², as the start of the fits of corrections.
    pub fn of_links(model: KinematicModel, variance: f64) -> Self {
        Self {
            model,
            terms: vec![],
            values: vec![],
            variance,
            station_motions: vec![],
            evidence: None,
        }
    }

    /// Value of a term; 0 if it is not free.
    pub fn value(&self, term: &Term) -> f64 {
        let of_terms = self.terms.iter().zip(&self.values);
        let mut found = of_terms.filter(|(free, _)| *free == term);
        found.next().map_or(0.0, |(_, value)| *value)
    }
}

/// A fit with its problem.
pub(super) struct Fit<'a> {
    pub(super) problem: Problem<'a>,
    pub(super) estimate: Estimate,
}

impl<'a> Setting<'a> {
    /// Fits links and `terms`, starting at `start`. Terms that `start` already contains start at their values there.
    pub(super) fn fit(
        &self,
        start: &Fitted,
        terms: &[Term],
        widths: CorrectionWidths,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Option<Fit<'a>> {
        let gravity = (self.mounting, self.payload);
        let problem = self.links.clone().with_corrections(gravity, terms, widths);
        let x = problem.coordinates_with(&start.model, |term| start.value(term));
        let first = Evidence::first(&problem, start.variance.sqrt());
        let mut monitor = |_| match go_on() {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        };
        let estimate = estimate_from(&problem, &x, first, ENDS, &mut monitor);
        let is_finite = estimate.evidence.sigma_mm.is_finite();
        is_finite.then_some(Fit { problem, estimate })
    }
}

impl Fit<'_> {
    /// The corrections, without a network.
    pub(super) fn corrections(&self) -> Option<Corrections> {
        self.problem.corrections(&self.estimate.x)
    }

    /// The fit without its problem.
    pub(super) fn fitted(&self) -> Fitted {
        let (problem, estimate) = (&self.problem, &self.estimate);
        let deviations = problem.deviation(&estimate.x);
        let of_terms = problem.variables.iter().zip(deviations);
        let of_terms = of_terms.filter_map(|(variable, value)| match variable.unknown {
            Unknown::Correction(term) => Some((term, value)),
            _ => None,
        });
        let (terms, values) = of_terms.unzip();
        Fitted {
            model: estimate.model.clone(),
            terms,
            values,
            variance: estimate.evidence.sigma_mm * estimate.evidence.sigma_mm,
            station_motions: estimate.station_motions.clone(),
            evidence: Some(estimate.evidence.clone()),
        }
    }
}
