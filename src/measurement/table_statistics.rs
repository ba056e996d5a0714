//! Rows of a table that hold no measurement: statistics of the rows above them, and positions that instruments write where nothing was measured.

use crate::measurement::set::Point;
use nalgebra::Vector3;

/// Words with which a row of statistics begins in reports.
const STATISTICS: [&str; 51] = [
    "mean",
    "mean value",
    "average",
    "avg",
    "median",
    "std",
    "stdev",
    "stddev",
    "std dev",
    "standard deviation",
    "sigma",
    "σ",
    "rms",
    "min",
    "max",
    "minimum",
    "maximum",
    "sum",
    "total",
    "range",
    "mittelwert",
    "mittel",
    "durchschnitt",
    "standardabweichung",
    "summe",
    "spannweite",
    "ø",
    "moyenne",
    "médiane",
    "mediane",
    "écart type",
    "écart-type",
    "ecart type",
    "ecart-type",
    "somme",
    "étendue",
    "media",
    "mediana",
    "deviazione standard",
    "scarto tipo",
    "somma",
    "massimo",
    "minimo",
    "promedio",
    "desviación estándar",
    "desviacion estandar",
    "máximo",
    "mínimo",
    "平均",
    "平均値",
    "标准差",
];

/// Whether a cell is the name of a statistic.
pub(super) fn is_statistic(cell: &str) -> bool {
    let word = cell.trim().trim_end_matches([':', '.']).to_lowercase();
    STATISTICS.contains(&word.as_str())
}

/// Magnitude of a coordinate that means that nothing was measured, mm.
const NO_VALUE_MM: f64 = 99_999.0;

/// What a position is if nothing was measured: all coordinates zero, or one of ±99999.
fn not_measured(position_mm: &Vector3<f64>) -> Option<&'static str> {
    if position_mm.iter().all(|mm| *mm == 0.0) {
        return Some("0, 0, 0");
    }
    let is_mark = |mm: &f64| (mm.abs() - NO_VALUE_MM).abs() < 1.0;
    position_mm.iter().any(is_mark).then_some("±99999")
}

/// The points whose positions were not measured, each with what is in its place. None if only one point has such a position, which may be right.
pub(super) fn rows_not_measured(points: &[Point]) -> Vec<(usize, &'static str)> {
    let marked = points.iter().enumerate().filter_map(|(at, point)| {
        let mark = not_measured(&point.position_mm)?;
        Some((at, mark))
    });
    let found: Vec<(usize, &str)> = marked.collect();
    match found.len() {
        0 | 1 => vec![],
        _ => found,
    }
}

#[cfg(test)]
mod tests {
    use super::is_statistic;

    #[test]
    fn statistics_have_names_in_several_languages() {
        for word in [
            "Mean",
            "Durchschnitt:",
            "MOYENNE",
            "Mittel",
            "Media",
            "Ø",
            "Std.",
            "平均",
        ] {
            assert!(is_statistic(word), "{word}");
        }
        for word in ["P1", "1", "meander", ""] {
            assert!(!is_statistic(word), "{word}");
        }
    }
}
