//! Tails of Student's t, Fisher's F and chi-square, all from the regularised incomplete beta and gamma functions.

/// Terms of a continued fraction or series at most; a hundred times what the arguments here need.
const MAX_TERMS: usize = 10_000;
/// Relative change at which a continued fraction or series has converged.
const CONVERGED: f64 = 1e-15;
/// Stands for zero in a denominator (Lentz 1976).
const TINY: f64 = 1e-300;
/// Halvings of an interval: more than a double has bits.
const BISECTIONS: usize = 200;

/// I_x(a, b), the regularised incomplete beta function (Abramowitz & Stegun 26.5.8, evaluated by Lentz's method).
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return if x <= 0.0 { 0.0 } else { 1.0 };
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(b, a, 1.0 - x);
    }
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

    /// Printed tables hold four figures.
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
}
