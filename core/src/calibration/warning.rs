//! A warning: its stable code, its text, and the rows that it is about. Also how texts write a probability.

/// A warning in the report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Machine-readable code; it never changes.
    pub code: &'static str,
    /// Text for people.
    pub detail: String,
    /// 0-based data rows concerned, if any.
    pub rows: Vec<usize>,
}

/// Beginning of a warning about a separate verification set.
const IN_THE_VERIFY_SET: &str = "in the verify set: ";

impl Warning {
    /// The same, marked as a warning about a separate verification set. Its rows are those of that set.
    pub fn of_the_verify_set(self) -> Self {
        Self {
            detail: format!("{IN_THE_VERIFY_SET}{}", self.detail),
            ..self
        }
    }

    /// Whether it is about a separate verification set.
    pub fn is_of_the_verify_set(&self) -> bool {
        self.detail.starts_with(IN_THE_VERIFY_SET)
    }

    /// A warning that is not about rows.
    pub fn new(code: &'static str, detail: impl Into<String>) -> Self {
        Self {
            code,
            detail: detail.into(),
            rows: vec![],
        }
    }
}

/// Smallest probability that is written as a number.
const MIN_PROBABILITY: f64 = 1e-6;

/// A probability as texts write it: two significant digits, without a power of ten.
pub fn probability_in_words(probability: f64) -> String {
    if probability < MIN_PROBABILITY {
        return "below 0.000001".into();
    }
    // Digits before the first one that counts. Rounding may carry into it, so it is taken from the rounded number.
    let rounded = format!("{probability:.1e}");
    let exponent = rounded
        .split_once('e')
        .and_then(|(_, exponent)| exponent.parse::<i32>().ok());
    let decimals = usize::try_from(1 - exponent.unwrap_or_default()).unwrap_or_default();
    format!("{probability:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::probability_in_words;

    #[test]
    fn a_probability_has_two_digits_and_no_power_of_ten() {
        for (probability, words) in [
            (0.0, "below 0.000001"),
            (9.99e-7, "below 0.000001"),
            (1e-6, "0.0000010"),
            (1.2e-3, "0.0012"),
            (9.96e-3, "0.010"),
            (0.044, "0.044"),
            (0.5, "0.50"),
            (1.0, "1.0"),
        ] {
            assert_eq!(probability_in_words(probability), words, "{probability}");
        }
    }
}
