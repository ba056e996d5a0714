//! Finds rows above or below the measurements that are their mean, standard deviation etc.

use crate::measurement::columns::words::is_one_of;
use crate::measurement::issue::Issue;
use crate::measurement::set::Point;

/// Words at the beginning of a row of statistics in reports.
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
/// Minimum number of rows of measurements.
const MIN_MEASURED: usize = 5;
/// Largest difference between a statistic in a file and its exact value: files have at least two decimals, in mm and degrees.
pub const ROUNDED: f64 = 0.006;
/// A column separates statistics from measurements if its range is this number of roundings.
const MIN_SPREAD: f64 = 100.0;

/// The statistics that reports print: the name, and whether the values alone distinguish it from a measurement. They do not for the
/// minimum, for example: a first pose may be the minimum of all columns.
pub const NAMES: [(&str, bool); 9] = [
    ("mean", true),
    ("standard deviation", true),
    ("standard deviation", true),
    ("rms", true),
    ("range", true),
    ("sum", true),
    ("minimum", false),
    ("maximum", false),
    ("median", false),
];
/// The place of the median in [`NAMES`].
const MEDIAN: usize = 8;
/// A row that is the median of all columns is a statistic if no other row is this near in all columns, degrees or mm. Otherwise it may be
/// one of several repetitions of a pose.
const SAME_ROW: f64 = 0.5;
/// Minimum number of joints for recognising a row of tolerances, which has the same number in all joints.
const MIN_JOINTS: usize = 3;
/// Maximum number of decimals that are counted. Values with more are exact.
pub const MAX_DECIMALS: usize = 6;

/// Number of decimals of a value; one more than [`MAX_DECIMALS`] if it has more.
pub fn decimals(value: f64) -> usize {
    let is_whole = |decimals: &usize| {
        let scaled = value * libm::pow(10.0, *decimals as f64);
        (scaled - scaled.round()).abs() < 1e-4
    };
    (0..=MAX_DECIMALS)
        .find(is_whole)
        .unwrap_or(MAX_DECIMALS + 1)
}

/// The largest rounding difference between some cells of a row and exact statistics: half of the last digit.
fn rounding(cells: &[f64]) -> f64 {
    let most = cells.iter().map(|cell| decimals(*cell)).max().unwrap_or(0);
    ROUNDED.max(0.5 * libm::pow(10.0, -(most as f64)) + 1e-6)
}

/// Whether a row has the same number in all joints, and the same in all coordinates: tolerances, or numbers of measurements.
fn is_alike(row: &[f64]) -> bool {
    let (joints, position) = row.split_at(row.len() - 3);
    let are_one = |cells: &[f64]| cells.iter().all(|cell| (cell - cells[0]).abs() < 1e-9);
    joints.len() >= MIN_JOINTS && are_one(joints) && are_one(position)
}

/// Statistics of one column, in the order of [`NAMES`].
pub struct Column {
    pub statistics: [f64; NAMES.len()],
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
        let largest = values.clone().fold(f64::NEG_INFINITY, f64::max);
        let sorted: Vec<f64> = values.collect();
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
                median(sorted),
            ],
        }
    }

    /// Whether the column separates statistics from measurements. A joint that does not move has the same value in all rows.
    fn spreads(&self, rounding: f64) -> bool {
        self.range() > MIN_SPREAD * rounding
    }

    /// The difference between the largest and the least value.
    pub fn range(&self) -> f64 {
        self.statistics[4]
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    let n = values.len();
    if n == 0 {
        return f64::NAN;
    }
    let (below, upper, _) = values.select_nth_unstable_by(n / 2, f64::total_cmp);
    match n % 2 {
        1 => *upper,
        _ => (*upper + below.iter().copied().fold(f64::NEG_INFINITY, f64::max)) / 2.0,
    }
}

/// Joint values in degrees and coordinates in mm of a point.
pub fn values(point: &Point) -> Vec<f64> {
    let joints = point.q_rad.iter().map(|q| q.to_degrees());
    joints.chain(point.position_mm.iter().copied()).collect()
}

/// Refuses rows above or below the others that are their statistics in every column. A label is not necessary, because many reports write
/// it in another language or omit it.
pub fn statistics(points: &[Point]) -> Vec<Issue> {
    let issue = |(at, name): (usize, &str)| {
        let what = match name {
            TOLERANCES => "has one number in all joints and one in all coordinates, as a row of tolerances or counts has".to_owned(),
            name => format!("is the {name} of the other rows in every column"),
        };
        let detail = format!(
            "row {at} {what}: a row of statistics is no measurement; remove it, or put # before it"
        );
        Issue::new("summary_row", detail).in_row(at)
    };
    rows_of_statistics(points).into_iter().map(issue).collect()
}

/// Name of a row with one number in all joints and one in all coordinates.
const TOLERANCES: &str = "tolerances";

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

/// The names of the statistics that these rows are; none if one of the rows is no statistic.
fn names_of(block: &[Vec<f64>], measured: &[Vec<f64>]) -> Option<Vec<&'static str>> {
    let n_columns = measured[0].len();
    let first_of_position = n_columns - 3;
    let are_alike: Vec<bool> = block.iter().map(|row| is_alike(row)).collect();
    let roundings: Vec<[f64; 2]> = (block.iter())
        .map(|row| {
            let (joints, position) = row.split_at(first_of_position);
            [rounding(joints), rounding(position)]
        })
        .collect();
    let mut possible = vec![[true; NAMES.len()]; block.len()];
    let (mut n_spread, mut n_of_position) = (0, 0);
    for at in 0..n_columns {
        let column = Column::new(measured.iter().map(|row| row[at]));
        let is_of_position = at >= first_of_position;
        let mut coarsest: f64 = ROUNDED;
        let rows = block.iter().zip(&mut possible).zip(&roundings);
        let rows = rows.zip(&are_alike).filter(|(_, alike)| !**alike);
        for (((row, possible), rounding), _) in rows {
            let rounding = rounding[usize::from(is_of_position)];
            coarsest = coarsest.max(rounding);
            for (possible, statistic) in possible.iter_mut().zip(column.statistics) {
                *possible &= (row[at] - statistic).abs() <= rounding;
            }
            if !possible.contains(&true) {
                return None;
            }
        }
        let spreads = column.spreads(coarsest);
        n_spread += usize::from(spreads);
        n_of_position += usize::from(spreads && is_of_position);
    }
    let mut names = Vec::new();
    let mut is_told = false;
    for ((row, possible), is_alike) in block.iter().zip(possible).zip(are_alike) {
        if is_alike {
            names.push(TOLERANCES);
            is_told = true;
            continue;
        }
        let which = possible.iter().position(|is| *is)?;
        names.push(NAMES[which].0);
        // If a robot returned to one pose again and again, every row is the median.
        is_told |= NAMES[which].1 || which == MEDIAN && !is_repeated(row, measured);
    }
    is_told |= names.contains(&"minimum") && names.contains(&"maximum");
    (is_told && n_spread >= 3 && n_of_position >= 2).then_some(names)
}

/// Whether another row has nearly the same values in all columns.
fn is_repeated(row: &[f64], others: &[Vec<f64>]) -> bool {
    let is_near = |other: &Vec<f64>| (row.iter().zip(other)).all(|(a, b)| (a - b).abs() < SAME_ROW);
    others.iter().any(is_near)
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
