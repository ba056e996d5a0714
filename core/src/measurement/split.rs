//! Splits the points into those that the parameters are fitted to (identify) and those that they are scored on (verify). Rows of one
//! configuration stay together.

use crate::measurement::conventions::{Frame, Subset};
use crate::measurement::set::MeasurementSet;
use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::ChaCha8Rng};
use std::collections::{BTreeMap, BTreeSet};

/// Why a split cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The split by the `subset` column was requested, but a row has no subset.
    #[error(
        "row {row} has no subset; name identify or verify in every row, or leave the column out"
    )]
    MissingSubset {
        /// 0-based data row.
        row: usize,
    },
    /// A configuration has rows in both subsets.
    #[error(
        "rows {} and {} are of one configuration ({configuration:?}), and the subset of one is identify, of the other verify; rows of one configuration belong to one subset: \
         state one for both, or let kincal choose, with verify {{\"source\": \"fraction\", \"fraction\": 0.5}}",
        .rows[0],
        .rows[1]
    )]
    ConfigurationOnBothSides {
        /// The configuration.
        configuration: String,
        /// Two of its rows, 0-based.
        rows: [usize; 2],
    },
}

/// The subsets that the file states, one per point.
///
/// # Errors
/// If a row has no subset, or a configuration has rows in both subsets.
pub fn by_column(set: &MeasurementSet) -> Result<Vec<Subset>, Error> {
    let mut subsets = Vec::with_capacity(set.points.len());
    let mut side: BTreeMap<&str, (Subset, usize)> = BTreeMap::new();
    for (row, point) in set.points.iter().enumerate() {
        let subset = point.subset.ok_or(Error::MissingSubset { row })?;
        let (first, first_row) = *side.entry(&point.configuration).or_insert((subset, row));
        if first != subset {
            return Err(Error::ConfigurationOnBothSides {
                configuration: point.configuration.clone(),
                rows: [first_row, row],
            });
        }
        subsets.push(subset);
    }
    Ok(subsets)
}

/// Minimum number of configurations of the reference station in the identify subset, because an error of its base would change every link.
pub const MIN_OF_REFERENCE: usize = 6;
/// Minimum number of configurations of any other station in the identify subset: three points place a station.
pub const MIN_OF_STATION: usize = 3;

/// Puts a random share of the configurations, chosen with the seed, into verify and the rest into identify. Returns one subset per point.
/// With `verify_fraction` 0 all points are in identify. With several stations, each station is split separately and keeps at least
/// [`MIN_OF_REFERENCE`] or [`MIN_OF_STATION`] configurations in identify. A configuration belongs to the station of its first point.
pub fn by_fraction(set: &MeasurementSet, verify_fraction: f64, seed: u64) -> Vec<Subset> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let stations = configurations_by_station(set);
    let reference = match set.frame {
        Frame::Base => 0,
        Frame::Instrument => stations.len().saturating_sub(1),
    };
    let is_one = stations.len() == 1;
    let mut verify = BTreeSet::new();
    for (station, mut configurations) in stations.into_iter().enumerate() {
        configurations.shuffle(&mut random);
        let n = configurations.len();
        let n_kept = match station == reference {
            _ if is_one => 0,
            true => MIN_OF_REFERENCE,
            false => MIN_OF_STATION,
        };
        let n_verify = (verify_fraction * n as f64).round() as usize;
        let n_verify = n_verify.min(n.saturating_sub(n_kept));
        verify.extend(configurations.into_iter().take(n_verify));
    }
    let side = |c: &str| {
        if verify.contains(c) {
            Subset::Verify
        } else {
            Subset::Identify
        }
    };
    set.points.iter().map(|p| side(&p.configuration)).collect()
}

/// The configurations of each station, both in the order in which they appear.
fn configurations_by_station(set: &MeasurementSet) -> Vec<Vec<&str>> {
    let mut stations: Vec<Vec<&str>> = Vec::new();
    let mut numbers = BTreeMap::new();
    let mut seen = BTreeSet::new();
    for point in &set.points {
        if seen.insert(point.configuration.as_str()) {
            let number = *numbers.entry(&point.station).or_insert(stations.len());
            if number == stations.len() {
                stations.push(Vec::new());
            }
            stations[number].push(&point.configuration);
        }
    }
    stations
}

/// True if any row states a subset.
pub fn has_column(set: &MeasurementSet) -> bool {
    set.points.iter().any(|p| p.subset.is_some())
}
