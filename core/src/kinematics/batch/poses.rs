//! The measured poses, prepared once per job.

use super::bound::Bound;
use nalgebra::Vector3;

/// Measured poses: sine and cosine of the commanded joints, and the measured positions.
#[derive(Clone, Debug, PartialEq)]
pub struct PreparedPoses {
    /// (cos q, sin q) of the commanded joints, `[pose][link]`.
    pub(super) cos_sin_q: Vec<(f64, f64)>,
    /// Measured positions, mm.
    pub(super) measured_mm: Vec<Vector3<f64>>,
    /// Weight of each squared residual.
    pub(super) weight: Vec<f64>,
    /// Target index of each pose.
    pub(super) target: Vec<usize>,
    pub(super) n_links: usize,
    /// True if all weights are 1.
    pub(super) is_unweighted: bool,
    /// The loss that bounds a pose's cost; squares without one.
    pub(super) bound: Option<Bound>,
}

impl PreparedPoses {
    /// An empty set of poses for a robot with `n_links` links.
    pub fn new(n_links: usize) -> Self {
        Self {
            cos_sin_q: vec![],
            measured_mm: vec![],
            weight: vec![],
            target: vec![],
            n_links,
            is_unweighted: true,
            bound: None,
        }
    }

    /// Adds one pose: joint values (rad), the measured position (mm), and the weight of its squared residual.
    ///
    /// # Panics
    /// When there is not one joint value per link.
    pub fn push(&mut self, q_rad: &[f64], measured_mm: Vector3<f64>, weight: f64, target: usize) {
        assert_eq!(q_rad.len(), self.n_links, "one joint value per link");
        self.cos_sin_q
            .extend(q_rad.iter().map(|q| (libm::cos(*q), libm::sin(*q))));
        self.measured_mm.push(measured_mm);
        self.weight.push(weight);
        self.target.push(target);
        self.is_unweighted &= weight == 1.0;
    }

    /// The same poses with a bounded loss.
    #[must_use]
    pub fn bounded(self, bound: Option<Bound>) -> Self {
        Self { bound, ..self }
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.measured_mm.len()
    }

    /// True if there are no poses.
    pub fn is_empty(&self) -> bool {
        self.measured_mm.is_empty()
    }
}
