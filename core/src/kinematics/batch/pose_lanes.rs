//! Measured poses, eight side by side, for comparison with [`OneRobot`](super::OneRobot).

use super::lanes::{LANES, Lanes, Vector};
use nalgebra::Vector3;

/// Number of residual rows of eight poses: x of each, y of each, z of each.
pub(super) const ROWS: usize = 3 * LANES;

/// Measured poses, eight side by side, all eight with the same target. Missing poses have weight zero.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseLanes {
    pub(super) n_links: usize,
    /// (cos q, sin q), `[chunk][link]`.
    pub(super) cos_sin_q: Vec<[Lanes; 2]>,
    /// Target of each chunk.
    pub(super) target: Vec<usize>,
    pub(super) measured_mm: Vec<[Lanes; 3]>,
    pub(super) root_weight: Vec<Lanes>,
    /// For each target: its last chunk, and the number of poses in it.
    pub(super) filled: Vec<(usize, usize)>,
}

impl PoseLanes {
    /// An empty set of poses for a robot with `n_links` links.
    pub fn new(n_links: usize) -> Self {
        Self {
            n_links,
            cos_sin_q: vec![],
            target: vec![],
            measured_mm: vec![],
            root_weight: vec![],
            filled: vec![],
        }
    }

    /// Adds one pose: joint values (rad), the measured position (mm), and the weight of its squared residual.
    ///
    /// # Panics
    /// When there is not one joint value per link.
    pub fn push(&mut self, q_rad: &[f64], measured_mm: Vector3<f64>, weight: f64, target: usize) {
        assert_eq!(q_rad.len(), self.n_links, "one joint value per link");
        let (chunk, lane) = self.place(target);
        for (link, q) in q_rad.iter().enumerate() {
            let (sin, cos) = libm::sincos(*q);
            let [cosines, sines] = &mut self.cos_sin_q[chunk * self.n_links + link];
            (cosines.0[lane], sines.0[lane]) = (cos, sin);
        }
        (0..3).for_each(|axis| self.measured_mm[chunk][axis].0[lane] = measured_mm[axis]);
        self.root_weight[chunk].0[lane] = weight.sqrt();
    }

    /// The next free lane in a target's chunks.
    fn place(&mut self, target: usize) -> (usize, usize) {
        if self.filled.len() <= target {
            self.filled.resize(target + 1, (0, LANES));
        }
        let (chunk, lane) = self.filled[target];
        let (chunk, lane) = if lane == LANES {
            (self.target.len(), 0)
        } else {
            (chunk, lane)
        };
        if lane == 0 {
            self.target.push(target);
            self.measured_mm.push([Lanes::ZERO; 3]);
            self.root_weight.push(Lanes::ZERO);
            self.cos_sin_q.resize(
                self.cos_sin_q.len() + self.n_links,
                [Lanes::splat(1.0), Lanes::ZERO],
            );
        }
        self.filled[target] = (chunk, lane + 1);
        (chunk, lane)
    }

    /// Number of residuals, including those of missing poses, which are zero.
    pub fn n_rows(&self) -> usize {
        ROWS * self.target.len()
    }

    /// sqrt(weight) · (measured − tip) of one register of poses, into the chunk's rows.
    #[inline(always)]
    pub(super) fn weigh<const W: usize>(
        &self,
        chunk: usize,
        part: usize,
        tip: &[Vector<W>; 3],
        rows: &mut [f64],
    ) {
        let root = Vector::load(&self.root_weight[chunk], part);
        for (axis, tip) in tip.iter().enumerate() {
            let residual = root * (Vector::load(&self.measured_mm[chunk][axis], part) - *tip);
            residual.store_at(rows, axis * LANES + part * W);
        }
    }
}
