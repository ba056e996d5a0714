//! Losses that bound the cost of one pose, in the form of the kernel: a branch-free function of the weighted square.

use super::lanes::Vector;

/// Cost of a pose with the weighted squared error e² (mm²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// e² up to k², then the tangent k·(2e − k) (Huber 1964).
    Huber {
        /// k, mm.
        k_mm: f64,
    },
}

impl Bound {
    #[inline(always)]
    pub(super) fn of<const W: usize>(self, square: Vector<W>) -> Vector<W> {
        match self {
            Self::Huber { k_mm } => {
                // with m = min(e, k): m·(2e − m)
                let e = square.sqrt();
                let m = e.at_most(k_mm);
                m * (e + e - m)
            }
        }
    }
}
