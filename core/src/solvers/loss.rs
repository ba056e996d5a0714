//! Losses of a residual's length, for M-estimates [Huber 1964; Beaton & Tukey 1974].
//!
//! `s` is the length of a residual vector of three components, divided by the standard deviation of one component. ρ is scaled so that every loss is
//! s² near 0. The minimum of Σ ρ(s) is found by least squares with the weights w(s) = ρ′(s) / 2s, repeated until they no longer change (iteratively
//! reweighted least squares [Holland & Welsch 1977]).

/// Huber's k for 95 % efficiency, relative to least squares on normal errors, of the estimate of a location in three dimensions. It is the solution
/// of (E[⅔·ψ/s + ⅓·ψ′])² = 0.95 · E[ψ²]/3 with ψ(s) = w(s)·s and s² chi-square with three degrees of freedom.
pub const HUBER_K_95: f64 = 1.627_95;
/// Tukey's c for the same efficiency.
pub const TUKEY_C_95: f64 = 5.490_25;

/// Loss of a residual's length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// s².
    Squares,
    /// s² up to k, then its tangent: the influence of a point is bounded.
    Huber {
        /// Where the tangent begins.
        k: f64,
    },
    /// Tukey's biweight: beyond c a point has no influence.
    Tukey {
        /// Where the loss becomes flat.
        c: f64,
    },
}

impl Loss {
    /// ρ(s) for s ≥ 0.
    pub fn rho(self, s: f64) -> f64 {
        match self {
            Self::Squares => s * s,
            Self::Huber { k } if s <= k => s * s,
            Self::Huber { k } => k * (2.0 * s - k),
            Self::Tukey { c } if s <= c => {
                let left = 1.0 - (s / c) * (s / c);
                c * c / 3.0 * (1.0 - left * left * left)
            }
            Self::Tukey { c } => c * c / 3.0,
        }
    }

    /// w(s) = ρ′(s) / 2s, between 0 and 1.
    pub fn weight(self, s: f64) -> f64 {
        match self {
            Self::Squares => 1.0,
            Self::Huber { k } if s <= k => 1.0,
            Self::Huber { k } => k / s,
            Self::Tukey { c } if s < c => {
                let left = 1.0 - (s / c) * (s / c);
                left * left
            }
            Self::Tukey { .. } => 0.0,
        }
    }

    /// Mean slope of the influence ψ(e) = w(|e|)·e along the three axes, for e of length s in any direction: ⅔·ψ/s + ⅓·ψ′.
    pub fn mean_slope(self, s: f64) -> f64 {
        match self {
            Self::Squares => 1.0,
            Self::Huber { k } if s <= k => 1.0,
            Self::Huber { k } => 2.0 / 3.0 * k / s,
            Self::Tukey { c } if s < c => {
                let x = (s / c) * (s / c);
                let psi_slope = (1.0 - x) * (1.0 - 5.0 * x);
                2.0 / 3.0 * self.weight(s) + psi_slope / 3.0
            }
            Self::Tukey { .. } => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{HUBER_K_95, Loss, TUKEY_C_95};

    const LOSSES: [Loss; 3] = [
        Loss::Squares,
        Loss::Huber { k: HUBER_K_95 },
        Loss::Tukey { c: TUKEY_C_95 },
    ];
    /// Width of the strips of the integrals and of the central differences.
    const STEP: f64 = 1e-3;
    /// Error of such an integral or derivative, with a margin for the kinks.
    const NUMERIC: f64 = 1e-5;

    #[test]
    fn the_weight_is_half_the_slope_over_s() {
        for loss in LOSSES {
            for i in 1..80 {
                let s = 0.1 * f64::from(i) + 0.037;
                let slope = (loss.rho(s + STEP) - loss.rho(s - STEP)) / (2.0 * STEP);
                assert!(
                    (slope / (2.0 * s) - loss.weight(s)).abs() < NUMERIC,
                    "{loss:?} at {s}"
                );
            }
        }
    }

    #[test]
    fn the_mean_slope_is_that_of_the_pull_along_and_across() {
        for loss in LOSSES {
            for i in 1..80 {
                let s = 0.1 * f64::from(i) + 0.037;
                let psi = |s: f64| loss.weight(s) * s;
                let along = (psi(s + STEP) - psi(s - STEP)) / (2.0 * STEP);
                assert!(
                    (2.0 / 3.0 * psi(s) / s + along / 3.0 - loss.mean_slope(s)).abs() < NUMERIC,
                    "{loss:?} at {s}"
                );
            }
        }
    }

    #[test]
    fn every_loss_is_the_square_near_zero_and_never_falls() {
        for loss in LOSSES {
            assert!((loss.rho(1e-3) / 1e-6 - 1.0).abs() < NUMERIC, "{loss:?}");
            let values: Vec<f64> = (0..200).map(|i| loss.rho(0.1 * f64::from(i))).collect();
            assert!(values.windows(2).all(|pair| pair[1] >= pair[0]), "{loss:?}");
            assert!(
                (0..200).all(|i| (0.0..=1.0).contains(&loss.weight(0.1 * f64::from(i)))),
                "{loss:?}"
            );
        }
    }

    #[test]
    fn a_wild_residual_pulls_bounded_with_huber_and_not_at_all_with_tukey() {
        let pull = |loss: Loss, s: f64| loss.weight(s) * s;
        assert_eq!(pull(Loss::Huber { k: 2.0 }, 1e6), 2.0);
        assert_eq!(pull(Loss::Tukey { c: 2.0 }, 1e6), 0.0);
        assert_eq!(Loss::Tukey { c: 3.0 }.rho(1e6), 3.0);
    }

    #[test]
    fn the_constants_keep_95_percent_of_the_efficiency_in_three_dimensions() {
        for loss in [Loss::Huber { k: HUBER_K_95 }, Loss::Tukey { c: TUKEY_C_95 }] {
            let (mut squares, mut slopes) = (0.0, 0.0);
            for i in 0..12_000 {
                let s = (f64::from(i) + 0.5) * STEP;
                // density of a length in three dimensions: sqrt(2/π)·s²·exp(−s²/2)
                let mass =
                    (2.0 / std::f64::consts::PI).sqrt() * s * s * libm::exp(-0.5 * s * s) * STEP;
                let psi = |s: f64| loss.weight(s) * s;
                let psi_slope = (psi(s + 0.5 * STEP) - psi(s - 0.5 * STEP)) / STEP;
                squares += psi(s) * psi(s) / 3.0 * mass;
                slopes += (2.0 / 3.0 * psi(s) / s + psi_slope / 3.0) * mass;
            }
            assert!(
                (slopes * slopes / squares - 0.95).abs() < NUMERIC,
                "{loss:?}: {}",
                slopes * slopes / squares
            );
        }
    }
}
