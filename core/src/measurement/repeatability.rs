//! Pose repeatability RP of ISO 9283, from poses that were measured several times.

use nalgebra::Vector3;

/// One pose that was visited several times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Visits {
    /// Number of visits.
    pub n: usize,
    /// p̄: the barycentre, mm.
    pub barycentre_mm: Vector3<f64>,
    /// l̄: mean distance from the barycentre, mm.
    pub mean_distance_mm: f64,
    /// S_l: standard deviation of the distance from the barycentre (with n − 1), mm.
    pub std_distance_mm: f64,
    /// Σ |p − p̄|², mm².
    pub sum_of_squares_mm2: f64,
}

impl Visits {
    /// From the positions measured at one pose; `None` for fewer than two positions.
    pub fn of(positions_mm: &[Vector3<f64>]) -> Option<Self> {
        let n = positions_mm.len();
        if n < 2 {
            return None;
        }
        let barycentre_mm = positions_mm.iter().sum::<Vector3<f64>>() / n as f64;
        let distances: Vec<f64> = positions_mm
            .iter()
            .map(|p| (p - barycentre_mm).norm())
            .collect();
        let mean_distance_mm = distances.iter().sum::<f64>() / n as f64;
        let variance = distances
            .iter()
            .map(|l| (l - mean_distance_mm) * (l - mean_distance_mm))
            .sum::<f64>()
            / (n - 1) as f64;
        let sum_of_squares_mm2 = distances.iter().map(|l| l * l).sum();
        Some(Self {
            n,
            barycentre_mm,
            mean_distance_mm,
            std_distance_mm: variance.sqrt(),
            sum_of_squares_mm2,
        })
    }

    /// RP = l̄ + 3·S_l, mm (ISO 9283:1998, 7.2.2).
    pub fn rp_mm(&self) -> f64 {
        self.mean_distance_mm + 3.0 * self.std_distance_mm
    }
}

/// Pooled RP of several poses, mm: l̄ is weighted by the number of visits, S_l² by the degrees of freedom.
pub fn pooled_rp_mm(poses: &[Visits]) -> f64 {
    let n: f64 = poses.iter().map(|v| v.n as f64).sum();
    let mean = poses
        .iter()
        .map(|v| v.n as f64 * v.mean_distance_mm)
        .sum::<f64>()
        / n;
    let freedom: f64 = poses.iter().map(|v| (v.n - 1) as f64).sum();
    let variance = poses
        .iter()
        .map(|v| (v.n - 1) as f64 * v.std_distance_mm * v.std_distance_mm)
        .sum::<f64>()
        / freedom;
    mean + 3.0 * variance.sqrt()
}

/// Standard deviation of one coordinate about the barycentre of its pose, mm: √(Σ |p − p̄|² / (3·Σ (n − 1))). It is also correct for few visits.
pub fn pooled_std_mm(poses: &[Visits]) -> f64 {
    let freedom: f64 = poses.iter().map(|v| 3.0 * (v.n - 1) as f64).sum();
    (poses.iter().map(|v| v.sum_of_squares_mm2).sum::<f64>() / freedom).sqrt()
}
