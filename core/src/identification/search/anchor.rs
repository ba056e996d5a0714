//! The point about which the lower bound of a swarm's costs is linearised: first the reference, later a point near the best particle.

use crate::identification::least_squares::linearisation::Linearisation;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::moved;
use crate::identification::model::search_space::SearchSpace;
use crate::kinematics::batch::{Anchored, InstructionSet, LowerBound, Moved};
use crate::solvers::qr::triangularise;
use nalgebra::Vector3;

/// Maximum number of Jacobian entries (32 MB). For larger problems no bound is used.
const LARGEST: usize = 1 << 22;
/// Maximum number of pairs of parameters per residual. The bound takes half a multiply-add per pair, F about twenty per residual. With more
/// pairs, the bound saves nothing.
const MAX_PAIRS_PER_RESIDUAL: usize = 40;
/// The relative error of Householder's triangle and of sums of m terms is at most m times a small number of roundings [Higham, Accuracy and Stability
/// of Numerical Algorithms, 2002, lemma 8.4 and theorem 19.4].
const ROUNDINGS: f64 = 8.0;
/// Upper limit of the roundings per link, in the kernel and in the Jacobian.
const ROUNDINGS_PER_LINK: usize = 64;

/// A lower bound of F with its anchor, and the buffers for moving the anchor.
pub struct Anchor {
    bound: LowerBound,
    linearisation: Linearisation<'static>,
    measured: Measured,
    rounding: f64,
    /// F at the anchor, mm².
    cost_mm2: f64,
    residuals: Vec<f64>,
    jacobian: Vec<f64>,
    effects_mm: Vec<f64>,
}

/// Summary of the measured positions.
struct Measured {
    sum_weights: f64,
    centre_mm: Vector3<f64>,
    /// Σ weight · (distance from the centre)², mm².
    spread_mm2: f64,
}

impl Anchor {
    /// The bound anchored at the space's reference. `None` if no parameter is free, if there are fewer residuals than parameters, or if the bound
    /// would take too much memory or time.
    pub fn at_reference(space: &SearchSpace, observations: &[Observation]) -> Option<Self> {
        let linearisation = Linearisation::of_parameters(space, observations);
        let (p, n_rows) = (space.parameters.len(), linearisation.n_rows());
        if p == 0 || n_rows < p || n_rows * p > LARGEST || p * p > MAX_PAIRS_PER_RESIDUAL * n_rows {
            return None;
        }
        let roundings = n_rows * (p + 1) + ROUNDINGS_PER_LINK * (space.reference.links.len() + 1);
        let moved: Vec<Moved> = space.parameters.iter().map(moved).collect();
        let mut anchor = Self {
            bound: LowerBound::new(&moved),
            linearisation,
            measured: Measured::new(observations),
            rounding: ROUNDINGS * f64::EPSILON * roundings as f64,
            cost_mm2: f64::INFINITY,
            residuals: vec![0.0; n_rows],
            jacobian: vec![0.0; n_rows * p],
            effects_mm: vec![0.0; p],
        };
        anchor.move_to(&vec![0.0; p]);
        Some(anchor)
    }

    /// Selects another code path of the bound.
    pub fn with_instructions(mut self, instructions: InstructionSet) -> Self {
        self.bound = self.bound.with_instructions(instructions);
        self
    }

    /// The bound.
    pub fn bound(&self) -> &LowerBound {
        &self.bound
    }

    /// F at the anchor, mm².
    pub fn cost_mm2(&self) -> f64 {
        self.cost_mm2
    }

    /// Moves the anchor to some deviations from the space's reference, mm or rad, without allocating.
    pub fn move_to(&mut self, deviation: &[f64]) {
        self.linearisation
            .linearise(deviation, &mut self.residuals, &mut self.jacobian);
        let n_rows = self.residuals.len();
        for (effect, column) in self
            .effects_mm
            .iter_mut()
            .zip(self.jacobian.chunks_exact(n_rows))
        {
            *effect = norm(column);
        }
        let (size_mm, base_arm_mm) = self.sizes_mm(deviation);
        self.cost_mm2 = squares(&self.residuals);
        triangularise(&mut self.jacobian, n_rows, &mut self.residuals);
        self.bound.set(&Anchored {
            deviation,
            effects_mm: &self.effects_mm,
            triangle: &self.jacobian,
            n_rows,
            qt_residuals: &self.residuals,
            base_arm_mm,
            rounding: self.rounding,
            size_mm,
        });
    }

    /// [`Anchored::size_mm`] and [`Anchored::base_arm_mm`].
    fn sizes_mm(&self, deviation: &[f64]) -> (f64, f64) {
        let (model, measured) = (self.linearisation.model(), &self.measured);
        let (residual_mm, root_weights) = (norm(&self.residuals), measured.sum_weights.sqrt());
        let base_mm = &model.t_instrument_base.translation.vector;
        let links_mm: f64 = model
            .links
            .iter()
            .map(|link| link.a_mm.abs() + link.d_mm.abs())
            .sum();
        let target_mm = model
            .targets_mm
            .iter()
            .map(|target| target.norm())
            .fold(0.0, f64::max);
        let moved_mm: f64 = self
            .effects_mm
            .iter()
            .zip(deviation)
            .map(|(effect, deviation)| effect * deviation.abs())
            .sum();
        let lengths_mm = root_weights * (links_mm + target_mm + base_mm.norm());
        let base_arm_mm = measured.arm_mm(base_mm) + residual_mm;
        (
            residual_mm + measured.arm_mm(&Vector3::zeros()) + lengths_mm + moved_mm + base_arm_mm,
            base_arm_mm,
        )
    }
}

impl Measured {
    fn new(observations: &[Observation]) -> Self {
        let sum_weights: f64 = observations.iter().map(|o| o.weight).sum();
        let sum = observations
            .iter()
            .fold(Vector3::zeros(), |sum, o| sum + o.weight * o.position_mm);
        let centre_mm = if sum_weights > 0.0 {
            sum / sum_weights
        } else {
            Vector3::zeros()
        };
        let spread_mm2 = observations
            .iter()
            .map(|o| o.weight * (o.position_mm - centre_mm).norm_squared())
            .sum();
        Self {
            sum_weights,
            centre_mm,
            spread_mm2,
        }
    }

    /// Root of Σ weight · (distance from a point)² [Huygens, Steiner], mm.
    fn arm_mm(&self, point_mm: &Vector3<f64>) -> f64 {
        (self.sum_weights * (self.centre_mm - point_mm).norm_squared() + self.spread_mm2).sqrt()
    }
}

fn squares(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum()
}

fn norm(x: &[f64]) -> f64 {
    squares(x).sqrt()
}
