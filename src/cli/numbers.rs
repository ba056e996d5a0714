//! Parses comma-separated numbers on the command line.

/// All numbers of a text; `None` if a part is not a finite number.
pub fn all(text: &str) -> Option<Vec<f64>> {
    let number = |part: &str| part.trim().parse().ok().filter(|n: &f64| n.is_finite());
    text.split(',').map(number).collect()
}

/// Parses exactly `N` numbers.
pub fn exactly<const N: usize>(text: &str, what: &str) -> Result<[f64; N], String> {
    let numbers = all(text).and_then(|all| all.try_into().ok());
    numbers.ok_or_else(|| what.to_owned())
}

/// Three lengths.
pub fn three_mm(text: &str) -> Result<[f64; 3], String> {
    exactly(text, "three numbers in mm are needed, such as 30,-45,160")
}

/// Three angles.
pub fn three_angles(text: &str) -> Result<[f64; 3], String> {
    exactly(text, "three angles are needed, such as 112.8,33.2,132.8")
}
