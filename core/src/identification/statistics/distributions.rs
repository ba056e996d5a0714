//! Tails of Student's t, Fisher's F (central and noncentral) and chi-square, all from the regularised incomplete beta and gamma functions.

/// Maximum number of terms of a continued fraction or series: a hundred times what the arguments here need.
const MAX_TERMS: usize = 10_000;
/// Relative change at which a continued fraction or series has converged.
const CONVERGED: f64 = 1e-15;
/// Replaces a zero denominator (Lentz 1976).
const TINY: f64 = 1e-300;
/// Maximum number of bisections: more than the number of bits of a double.
const BISECTIONS: usize = 200;

/// I_x(a, b), the regularised incomplete beta function (Abramowitz & Stegun 26.5.8, evaluated by Lentz's method).
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return if x <= 0.0 { 0.0 } else { 1.0 };
    }
    // The continued fraction converges fast on this side of the mode. The side is chosen only once: after rounding, x may be on neither
    // side.
    match x > (a + 1.0) / (a + b + 2.0) {
        true => 1.0 - beta_fraction(b, a, 1.0 - x),
        false => beta_fraction(a, b, x),
    }
}

/// I_x(a, b) by its continued fraction.
fn beta_fraction(a: f64, b: f64, x: f64) -> f64 {
    let front = libm::exp(
        libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b)
            + a * libm::log(x)
            + b * libm::log1p(-x),
    ) / a;
    let guarded = |v: f64| if v.abs() < TINY { TINY } else { v };
    let (mut c, mut d) = (1.0, 1.0 / guarded(1.0 - (a + b) * x / (a + 1.0)));
    let mut fraction = d;
    for m in 1..MAX_TERMS {
        let m = m as f64;
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut change = 1.0;
        for term in [even, odd] {
            d = 1.0 / guarded(1.0 + term * d);
            c = guarded(1.0 + term / c);
            change = c * d;
            fraction *= change;
        }
        if (change - 1.0).abs() < CONVERGED {
            break;
        }
    }
    front * fraction
}

/// Q(a, x), the upper regularised incomplete gamma function (Abramowitz & Stegun 6.5.29 and 6.5.31).
fn upper_gamma(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let front = libm::exp(a * libm::log(x) - x - libm::lgamma(a));
    if x < a + 1.0 {
        let (mut term, mut sum) = (1.0 / a, 1.0 / a);
        for n in 1..MAX_TERMS {
            term *= x / (a + n as f64);
            sum += term;
            if term < sum * CONVERGED {
                break;
            }
        }
        return 1.0 - front * sum;
    }
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1.0 / TINY, 1.0 / b);
    let mut fraction = d;
    for n in 1..MAX_TERMS {
        let n = n as f64;
        let term = -n * (n - a);
        b += 2.0;
        d = 1.0 / (term * d + b);
        c = b + term / c;
        fraction *= c * d;
        if (c * d - 1.0).abs() < CONVERGED {
            break;
        }
    }
    front * fraction
}

/// Probability that F with (`numerator`, `denominator`) degrees of freedom is above `value`.
pub fn f_tail(value: f64, numerator: f64, denominator: f64) -> f64 {
    if value.is_nan() {
        return value;
    }
    incomplete_beta(
        denominator / 2.0,
        numerator / 2.0,
        denominator / (denominator + numerator * value.max(0.0)),
    )
}

/// Probability that chi-square with `freedom` degrees of freedom is above `value`.
pub fn chi_square_tail(value: f64, freedom: f64) -> f64 {
    upper_gamma(freedom / 2.0, value / 2.0)
}

/// Poisson weights further than this number of standard deviations (and one more unit each) from their mean are left out of a noncentral tail.
const POISSON_STDS: f64 = 9.0;

/// Probability that F with (`numerator`, `denominator`) degrees of freedom and noncentrality λ is above `value`: the mixture of central tails with
/// Poisson weights of mean λ/2 (Johnson, Kotz & Balakrishnan 1995, eq. 30.10).
pub fn noncentral_f_tail(value: f64, numerator: f64, denominator: f64, noncentrality: f64) -> f64 {
    let mean = noncentrality.max(0.0) / 2.0;
    if mean == 0.0 {
        return f_tail(value, numerator, denominator);
    }
    let around = POISSON_STDS * (mean.sqrt() + 1.0);
    let (first, last) = (
        (mean - around).max(0.0).floor() as usize,
        (mean + around).ceil() as usize,
    );
    let x = denominator / (denominator + numerator * value.max(0.0));
    let of = |i: f64| {
        let weight = libm::exp(i * libm::log(mean) - mean - libm::lgamma(i + 1.0));
        weight * incomplete_beta(denominator / 2.0, numerator / 2.0 + i, x)
    };
    (first..=last).map(|i| of(i as f64)).sum()
}

/// The value that F with (`numerator`, `denominator`) degrees of freedom exceeds with this probability.
pub fn f_quantile(above: f64, numerator: f64, denominator: f64) -> f64 {
    invert_increasing(
        |value| 1.0 - f_tail(value, numerator, denominator),
        1.0 - above,
    )
}

/// The value that chi-square with `freedom` degrees of freedom exceeds with this probability.
pub fn chi_square_quantile(above: f64, freedom: f64) -> f64 {
    let scaled = |value: f64| 1.0 - chi_square_tail(freedom * value, freedom);
    freedom * invert_increasing(scaled, 1.0 - above)
}

/// The noncentrality at which an F test with (`numerator`, `denominator`) degrees of freedom at this level has the power `power`.
pub fn noncentrality(level: f64, power: f64, numerator: f64, denominator: f64) -> f64 {
    let critical = f_quantile(level, numerator, denominator);
    invert_increasing(
        |lambda| noncentral_f_tail(critical, numerator, denominator, lambda),
        power,
    )
}

/// The argument (from 0 on) at which an increasing function reaches `value`.
fn invert_increasing(function: impl Fn(f64) -> f64, value: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while function(high) < value && high < 1e12 {
        high *= 2.0;
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high || high - low < CONVERGED * high {
            break;
        }
        if function(middle) < value {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// Half-width of the interval that holds Student's t with `freedom` degrees of freedom with probability `confidence`.
pub fn t_half_width(confidence: f64, freedom: f64) -> f64 {
    let outside = |t: f64| f_tail(t * t, 1.0, freedom);
    let (mut low, mut high) = (0.0, 1.0);
    while outside(high) > 1.0 - confidence && high < 1e12 {
        high *= 2.0;
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if outside(middle) > 1.0 - confidence {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding once put x on neither side of the mode, and the two branches called each other without end.
    #[test]
    fn at_the_mode_of_a_symmetric_distribution_half_is_on_either_side() {
        let half = incomplete_beta(
            64.500_600_216_920_37,
            64.500_600_216_922_32,
            0.499_999_999_999_992_56,
        );
        assert!((half - 0.5).abs() < 1e-9, "{half}");
        for a in [0.5, 1.0, 3.0, 64.5, 1e4] {
            for x in [0.5 - f64::EPSILON, 0.5, 0.5 + f64::EPSILON] {
                assert!((incomplete_beta(a, a, x) - 0.5).abs() < 1e-9, "{a} {x}");
            }
        }
    }

    /// Printed tables have four digits.
    const TABLE: f64 = 1e-3;

    #[test]
    fn the_tails_are_those_of_printed_tables() {
        for (freedom, t) in [
            (1.0, 12.706),
            (5.0, 2.5706),
            (30.0, 2.0423),
            (120.0, 1.9799),
        ] {
            assert!(
                (t_half_width(0.95, freedom) / t - 1.0).abs() < TABLE,
                "t with {freedom}"
            );
        }
        for (freedom, value) in [
            (1.0, 3.8415),
            (10.0, 18.307),
            (20.0, 31.410),
            (100.0, 124.342),
        ] {
            assert!(
                (chi_square_tail(value, freedom) / 0.05 - 1.0).abs() < TABLE,
                "chi-square with {freedom}"
            );
        }
        for (a, b, value) in [
            (1.0, 10.0, 4.9646),
            (5.0, 20.0, 2.7109),
            (20.0, 120.0, 1.6587),
        ] {
            assert!(
                (f_tail(value, a, b) / 0.05 - 1.0).abs() < TABLE,
                "F with {a}, {b}"
            );
        }
    }

    #[test]
    fn with_many_degrees_of_freedom_f_becomes_chi_square() {
        assert!((f_tail(1.8307, 10.0, 1e7) / chi_square_tail(18.307, 10.0) - 1.0).abs() < 1e-4);
    }

    /// Tolerance of a share that was counted in `n` draws: four standard deviations.
    fn by_chance(share: f64, n: usize) -> f64 {
        4.0 * (share * (1.0 - share) / n as f64).sqrt()
    }

    #[test]
    fn quantiles_are_where_the_tails_are() {
        for (above, a, b) in [(0.01, 15.0, 60.0), (0.05, 3.0, 12.0), (0.5, 30.0, 5.0)] {
            let value = f_quantile(above, a, b);
            assert!((f_tail(value, a, b) / above - 1.0).abs() < 1e-9);
        }
        for (above, freedom, value) in [(0.05, 10.0, 18.307), (0.975, 5.0, 0.831)] {
            let found = chi_square_quantile(above, freedom);
            assert!((found / value - 1.0).abs() < TABLE, "{freedom}: {found}");
        }
    }

    /// The first oracle: with one numerator and very many denominator degrees of freedom, F is the square of a normal number.
    #[test]
    fn the_noncentral_tail_is_that_of_a_squared_normal_number() {
        for mean in [0.5_f64, 2.0, 4.0] {
            let critical = 2.575_829_3;
            let found = noncentral_f_tail(critical * critical, 1.0, 1e7, mean * mean);
            let above = |z: f64| 0.5 * libm::erfc(z / 2.0_f64.sqrt());
            let expected = above(critical - mean) + above(critical + mean);
            assert!(
                (found - expected).abs() < 1e-5,
                "{mean}: {found} {expected}"
            );
        }
        // two-sided quantile of 1 % and one-sided quantile of 95 %
        let lambda = noncentrality(0.01, 0.95, 1.0, 1e7);
        let z = 2.575_829_3_f64 + 1.644_853_6;
        let expected = z * z;
        assert!((lambda / expected - 1.0).abs() < 1e-4, "{lambda}");
    }

    /// The second oracle: simulation.
    #[test]
    fn the_noncentral_tail_is_that_of_draws() {
        const DRAWS: usize = 20_000;
        let mut state = 1_u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            ((state >> 11) as f64 + 0.5) / 9_007_199_254_740_992.0
        };
        let mut normal = || {
            let (u, v) = (uniform(), uniform());
            (-2.0 * libm::log(u)).sqrt() * libm::cos(std::f64::consts::TAU * v)
        };
        for (m, nu, lambda) in [(6_usize, 20_usize, 12.0_f64), (15, 60, 33.0)] {
            let critical = f_quantile(0.01, m as f64, nu as f64);
            let mut n_above = 0;
            for _ in 0..DRAWS {
                let shift = |k: usize| if k == 0 { lambda.sqrt() } else { 0.0 };
                let top: f64 = (0..m).map(|k| normal() + shift(k)).map(|z| z * z).sum();
                let bottom: f64 = (0..nu).map(|_| normal()).map(|z| z * z).sum();
                n_above += usize::from(top / m as f64 > critical * bottom / nu as f64);
            }
            let found = noncentral_f_tail(critical, m as f64, nu as f64, lambda);
            let counted = n_above as f64 / DRAWS as f64;
            assert!(
                (found - counted).abs() < by_chance(found, DRAWS),
                "{found} {counted}"
            );
        }
    }
}
