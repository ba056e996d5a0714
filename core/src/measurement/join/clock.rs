//! The difference between two clocks, from the pattern of the times.

use crate::measurement::join::options::{JoinBy, JoinError, JoinOptions, error, n_paired};

/// Maximum number of positions with which clock differences are tried.
pub const MAX_TRIED: usize = 200;
/// Maximum number of clock differences that an error names.
const MAX_OFFSETS_NAMED: usize = 20;
/// Maximum number of clock differences that are kept for an error. With more of them the rows follow each other evenly, and only a stated difference
/// helps.
pub const MAX_TIES: usize = 200;
/// Minimum number of pairs for finding the clock difference.
pub const MIN_PAIRS: usize = 4;

/// A standstill of the robot: its start, its end, and the row in the middle.
#[derive(Clone, Copy, Debug)]
pub struct Standstill {
    pub from_s: f64,
    pub to_s: f64,
    pub row: usize,
}

/// For each time of the instrument, the nearest standstill, if it is within the tolerance.
pub fn paired(
    standstills: &[Standstill],
    instrument_s: &[f64],
    offset_s: f64,
    tolerance_s: f64,
) -> Vec<Option<usize>> {
    let nearest = |time_s: &f64| {
        let at_s = time_s + offset_s;
        let after = standstills.partition_point(|standstill| standstill.from_s <= at_s);
        let near = [
            after.checked_sub(1),
            Some(after).filter(|at| *at < standstills.len()),
        ];
        let gap = |at: usize| gap(&standstills[at], at_s).abs();
        let best = near
            .into_iter()
            .flatten()
            .min_by(|a, b| gap(*a).total_cmp(&gap(*b)))?;
        (gap(best) <= tolerance_s).then_some(best)
    };
    instrument_s.iter().map(nearest).collect()
}

/// Distance of a time from a standstill, s: negative before it, 0 during it, positive after it.
fn gap(standstill: &Standstill, at_s: f64) -> f64 {
    (at_s - standstill.from_s).min(0.0) + (at_s - standstill.to_s).max(0.0)
}

/// The clock difference with which most times of the instrument fall into standstills of the robot.
///
/// # Errors
/// `join_unclear` if none pairs enough of them, `two_readings` if several do.
pub fn offset_from_times(
    standstills: &[Standstill],
    instrument_s: &[f64],
    tolerance_s: f64,
) -> Result<f64, JoinError> {
    let step = instrument_s.len().div_ceil(MAX_TRIED).max(1);
    let tried: Vec<f64> = instrument_s.iter().copied().step_by(step).collect();
    let anchors = [0, tried.len() / 2, tried.len().saturating_sub(1)];
    let mut offsets: Vec<f64> = vec![0.0];
    for anchor in anchors.iter().filter_map(|at| tried.get(*at)) {
        for standstill in standstills {
            let middle_s = (standstill.from_s + standstill.to_s) / 2.0;
            offsets.push(middle_s - anchor);
        }
    }
    let mut ties = Ties::default();
    for offset_s in offsets {
        // If the best clock differences pair all rows and there are already many of them, further ones change nothing.
        if ties.most == tried.len() && ties.are_many() {
            break;
        }
        let offset_s = centred(standstills, &tried, offset_s, tolerance_s);
        let pairs = paired(standstills, &tried, offset_s, tolerance_s);
        ties.add(offset_s, pairs, tolerance_s);
    }
    let possible = tried.len().min(standstills.len());
    if ties.most < MIN_PAIRS || 2 * ties.most < possible {
        return Err(clocks_cannot_be_compared(&format!(
            "with no difference between them do the times of most rows agree within {tolerance_s:.3} s"
        )));
    }
    if !ties.are_contradictory {
        return Ok(ties.offsets_s[0]);
    }
    let n_pairs = |offset_s| n_paired(&paired(standstills, instrument_s, offset_s, tolerance_s));
    Err(several_offsets(ties.offsets_s, &n_pairs))
}

/// The error if no clock difference pairs enough rows.
pub fn clocks_cannot_be_compared(why: &str) -> JoinError {
    let detail = format!(
        "the two clocks cannot be compared: {why}. State the robot's clock minus the instrument's in the column mapping: {{\"join\": {{\"clock_offset_s\": \
         \"SECONDS\", \"tolerance_s\": \"SECONDS\"}}}}"
    );
    error("join_unclear", detail)
}

/// The stated clock difference, or, if none is stated, the one that `found` finds. A stated one is refused if it pairs no row, or, unless the join by
/// time was requested, fewer than half of the rows that can be paired.
///
/// # Errors
/// Those of `found`; `join_unclear` for a stated difference that is refused, with the one that the times show, if they show one.
pub(super) fn stated_or_found(
    options: &JoinOptions,
    tolerance_s: f64,
    possible: usize,
    n_pairs: impl Fn(f64) -> usize,
    found: impl Fn() -> Result<f64, JoinError>,
) -> Result<f64, JoinError> {
    let Some(stated_s) = options.clock_offset_s else {
        return found();
    };
    let n = n_pairs(stated_s);
    if 2 * n >= possible || n > 0 && options.by == Some(JoinBy::Time) {
        return Ok(stated_s);
    }
    let found = match found() {
        Ok(found_s) => {
            let rounded_s = (found_s * 1e3).round() / 1e3;
            format!(
                "The times themselves show {rounded_s} s, which pairs {} rows: state that in the column mapping: {{\"join\": {{\"clock_offset_s\": {rounded_s}}}}}, or state none",
                n_pairs(found_s)
            )
        }
        Err(_) => "The times themselves show no other difference. Read both clocks at one moment: the difference is the robot's minus the instrument's".into(),
    };
    let detail = format!(
        "with the stated difference of the two clocks, {stated_s} s, {n} of {possible} rows pair by time within {tolerance_s:.3} s. {found}"
    );
    Err(error("join_unclear", detail))
}

/// The clock differences that pair most rows.
#[derive(Default)]
struct Ties {
    /// Number of rows that each of them pairs.
    most: usize,
    /// The first one, and those that differ from all before them by more than the tolerance; at most one more than [`MAX_TIES`].
    offsets_s: Vec<f64>,
    /// The pairs of the first one.
    first: Vec<Option<usize>>,
    /// True if another clock difference gives a different pair for some row.
    are_contradictory: bool,
}

impl Ties {
    fn add(&mut self, offset_s: f64, pairs: Vec<Option<usize>>, tolerance_s: f64) {
        let n = n_paired(&pairs);
        if n < self.most {
            return;
        }
        if n > self.most || self.offsets_s.is_empty() {
            *self = Self {
                most: n,
                offsets_s: vec![offset_s],
                first: pairs,
                are_contradictory: false,
            };
            return;
        }
        let mut both = self.first.iter().zip(&pairs).filter_map(|(a, b)| a.zip(*b));
        self.are_contradictory |= both.any(|(a, b)| a != b);
        let is_new = |known_s: &f64| (known_s - offset_s).abs() > tolerance_s;
        if self.offsets_s.len() <= MAX_TIES && self.offsets_s.iter().all(is_new) {
            self.offsets_s.push(offset_s);
        }
    }

    fn are_many(&self) -> bool {
        self.are_contradictory && self.offsets_s.len() > MAX_TIES
    }
}

/// The error for clock differences that fit equally well. None of them is recommended, because nothing in the files decides which one is
/// correct.
pub fn several_offsets(mut offsets_s: Vec<f64>, n_pairs: &dyn Fn(f64) -> usize) -> JoinError {
    offsets_s.sort_by(f64::total_cmp);
    let named: Vec<String> = offsets_s
        .iter()
        .take(MAX_OFFSETS_NAMED)
        .map(|offset_s| format!("{offset_s:.3} s ({} pairs)", n_pairs(*offset_s)))
        .collect();
    let more = match offsets_s.len() - named.len() {
        0 => String::new(),
        n if offsets_s.len() > MAX_TIES => format!(" and at least {n} more"),
        n => format!(" and {n} more"),
    };
    let detail = format!(
        "the rows follow each other so evenly that several differences of the two clocks fit equally well: {}{more}. Read both clocks at one moment, and state the \
         robot's minus the instrument's in the column mapping: {{\"join\": {{\"clock_offset_s\": \"SECONDS\"}}}}",
        named.join(", ")
    );
    error("two_readings", detail)
}

/// Refines a clock difference: subtracts the median gap of the pairs that it gives.
fn centred(
    standstills: &[Standstill],
    instrument_s: &[f64],
    offset_s: f64,
    tolerance_s: f64,
) -> f64 {
    let pairs = paired(standstills, instrument_s, offset_s, tolerance_s);
    let mut gaps: Vec<f64> = instrument_s
        .iter()
        .zip(&pairs)
        .filter_map(|(time_s, pair)| Some(gap(&standstills[(*pair)?], time_s + offset_s)))
        .collect();
    if gaps.is_empty() {
        return offset_s;
    }
    gaps.sort_by(f64::total_cmp);
    offset_s - gaps[gaps.len() / 2]
}
