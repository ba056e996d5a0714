//! Rows above or below the measurements that are their mean, standard deviation and the like.

use crate::measurement::columns::words::is_one_of;
use crate::measurement::issue::Issue;
use crate::measurement::set::Point;

/// Words with which a row of statistics begins in reports.
const STATISTICS: &str = "mean|mean value|average|avg|median|std|stdev|stddev|std dev|standard deviation|sigma|σ|\
    rms|min|max|minimum|maximum|sum|total|range|mittelwert|mittel|durchschnitt|\
    standardabweichung|summe|spannweite|ø|moyenne|médiane|mediane|écart type|écart-type|\
    ecart type|ecart-type|somme|étendue|media|mediana|deviazione standard|scarto tipo|somma|\
    massimo|minimo|promedio|desviación estándar|desviacion estandar|máximo|mínimo|平均|平均値|标准差";

/// Whether a cell is the name of a statistic.
pub fn is_statistic(cell: &str) -> bool {
    let word = cell.trim().trim_end_matches([':', '.']).to_lowercase();
    is_one_of(STATISTICS, &word)
}

/// Maximum number of rows of statistics above or below the measurements.
const MAX_STATISTICS: usize = 8;
/// Minimum number of rows of measurements beside them.
const MIN_MEASURED: usize = 5;
/// Largest difference of a statistic in a file from its value: the file has at least two decimals, in mm and degrees.
pub const ROUNDED: f64 = 0.006;
/// A column tells statistics from measurements if its values spread by this number of roundings.
const MIN_SPREAD: f64 = 100.0;

/// The statistics that reports print: name, and whether the values alone tell it from a measurement. A first pose may be the minimum of all columns.
pub const NAMES: [(&str, bool); 8] = [
    ("mean", true),
    ("standard deviation", true),
    ("standard deviation", true),
    ("rms", true),
    ("range", true),
    ("sum", true),
    ("minimum", false),
    ("maximum", false),
];

/// Statistics of one column, in the order of [`NAMES`].
pub struct Column {
    pub statistics: [f64; NAMES.len()],
    /// Whether the column tells statistics from measurements. A joint that stood still is the same in all rows.
    spreads: bool,
}

impl Column {
    pub fn new(values: impl Iterator<Item = f64> + Clone) -> Self {
        let n = values.clone().count() as f64;
        let sum: f64 = values.clone().sum();
        let square_sum = |values: &mut dyn Iterator<Item = f64>| -> f64 {
            values.map(|value| value * value).sum()
        };
        let squares = square_sum(&mut values.clone().map(|value| value - sum / n));
        let square_sum = square_sum(&mut values.clone());
        let least = values.clone().fold(f64::INFINITY, f64::min);
        let largest = values.fold(f64::NEG_INFINITY, f64::max);
        Self {
            statistics: [
                sum / n,
                (squares / (n - 1.0)).sqrt(),
                (squares / n).sqrt(),
                (square_sum / n).sqrt(),
                largest - least,
                sum,
                least,
                largest,
            ],
            spreads: largest - least > MIN_SPREAD * ROUNDED,
        }
    }

    /// The difference between the largest and the least value.
    pub fn range(&self) -> f64 {
        self.statistics[4]
    }
}

/// Joint values in degrees and coordinates in mm of a point.
pub fn values(point: &Point) -> Vec<f64> {
    let joints = point.q_rad.iter().map(|q| q.to_degrees());
    joints.chain(point.position_mm.iter().copied()).collect()
}

/// Refuses rows above or below the others that are statistics of them in every column. A label is not needed: many reports write it in another language,
/// or leave it out.
pub fn statistics(points: &[Point]) -> Vec<Issue> {
    let issue = |(at, name): (usize, &str)| {
        let detail = format!(
            "row {at} is the {name} of the other rows in every column: a row of statistics is no measurement; remove it, or put # before it"
        );
        Issue::new("summary_row", detail).in_row(at)
    };
    rows_of_statistics(points).into_iter().map(issue).collect()
}

fn rows_of_statistics(points: &[Point]) -> Vec<(usize, &'static str)> {
    let rows: Vec<Vec<f64>> = points.iter().map(values).collect();
    let blocks = (1..=MAX_STATISTICS)
        .rev()
        .filter(|n| n + MIN_MEASURED <= rows.len());
    let found = blocks.flat_map(|n| {
        let below = rows.len() - n;
        [(below..rows.len(), 0..below), (0..n, n..rows.len())]
    });
    found
        .filter_map(|(block, measured)| {
            let names = names_of(&rows[block.clone()], &rows[measured])?;
            Some(block.zip(names).collect())
        })
        .next()
        .unwrap_or_default()
}

/// The names of the statistics that these rows are; none if one of them is none.
fn names_of(block: &[Vec<f64>], measured: &[Vec<f64>]) -> Option<Vec<&'static str>> {
    let n_columns = measured[0].len();
    let mut possible = vec![[true; NAMES.len()]; block.len()];
    let (mut n_spread, mut n_of_position) = (0, 0);
    for at in 0..n_columns {
        let column = Column::new(measured.iter().map(|row| row[at]));
        for (row, possible) in block.iter().zip(&mut possible) {
            for (possible, statistic) in possible.iter_mut().zip(column.statistics) {
                *possible &= (row[at] - statistic).abs() <= ROUNDED;
            }
            if !possible.contains(&true) {
                return None;
            }
        }
        n_spread += usize::from(column.spreads);
        n_of_position += usize::from(column.spreads && at + 3 >= n_columns);
    }
    let found = possible
        .iter()
        .filter_map(|row| row.iter().position(|is| *is));
    let (names, is_told): (Vec<&str>, Vec<bool>) = found.map(|which| NAMES[which]).unzip();
    let has_extremes = names.contains(&"minimum") && names.contains(&"maximum");
    let is_told = is_told.contains(&true) || has_extremes;
    (is_told && n_spread >= 3 && n_of_position >= 2).then_some(names)
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
