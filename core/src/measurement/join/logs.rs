//! Pairs the standstills of an instrument's continuous log with those of the robot. If the difference between the two clocks is not stated, it is found from
//! the pattern of motions and standstills.

use crate::measurement::join::clock::{
    MAX_TIES, MAX_TRIED, MIN_PAIRS, Standstill, clocks_cannot_be_compared, several_offsets,
    stated_or_found,
};
use crate::measurement::join::options::{JoinError, JoinOptions, n_paired};

/// Number of standstills of the instrument from which clock differences are tried.
const ANCHORS: usize = 5;
/// Another clock difference fits as well as the best one if its standstills agree to at least this share with those of the robot. With the right one,
/// beginnings and ends agree; with a wrong one, half of each standstill may agree by chance.
const AS_GOOD: f64 = 0.9;
/// Clock differences that are closer than this are the same, s.
const SAME_OFFSET_S: f64 = 0.5;

/// The time in which both stand, by the robot's clock: its beginning and its end, s. The end is before the beginning if they never stand together.
pub fn together(ours: &Standstill, theirs: &Standstill, offset_s: f64) -> [f64; 2] {
    [
        ours.from_s.max(theirs.from_s + offset_s),
        ours.to_s.min(theirs.to_s + offset_s),
    ]
}

/// How well two standstills agree, 0 to 1: the time in which both stand, as a share of the time in which one of them does. A pose without duration agrees if
/// it is within the standstill.
fn agreement(ours: &Standstill, theirs: &Standstill, offset_s: f64) -> f64 {
    let [from_s, to_s] = together(ours, theirs, offset_s);
    let longest_s =
        ours.to_s.max(theirs.to_s + offset_s) - ours.from_s.min(theirs.from_s + offset_s);
    match ours.to_s > ours.from_s {
        _ if to_s < from_s => 0.0,
        true if longest_s > 0.0 => (to_s - from_s) / longest_s,
        _ => 1.0,
    }
}

/// For each standstill of the instrument, the one of the robot that agrees best, if they are at most `tolerance_s` apart.
pub fn paired(
    ours: &[Standstill],
    theirs: &[Standstill],
    offset_s: f64,
    tolerance_s: f64,
) -> Vec<Option<usize>> {
    let best = |one: &Standstill| {
        let (from_s, to_s) = (one.from_s + offset_s, one.to_s + offset_s);
        let first = ours.partition_point(|own| own.to_s < from_s - tolerance_s);
        let near = ours[first..].iter().enumerate();
        let near = near.take_while(|(_, own)| own.from_s <= to_s + tolerance_s);
        let rank = |own: &Standstill| {
            let [from_s, to_s] = together(own, one, offset_s);
            (agreement(own, one, offset_s), to_s - from_s)
        };
        let ranked = near.map(|(at, own)| (first + at, rank(own)));
        let best = ranked.max_by(|(_, a), (_, b)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        best.map(|(at, _)| at)
    };
    theirs.iter().map(best).collect()
}

/// A clock difference and how well it fits.
struct Tried {
    offset_s: f64,
    n_pairs: usize,
    /// Sum of the agreements.
    sum: f64,
    /// Mean agreement of the instrument's standstills that fall into the robot's file.
    mean: f64,
}

impl Tried {
    fn new(ours: &[Standstill], theirs: &[Standstill], offset_s: f64) -> Self {
        let pairs = paired(ours, theirs, offset_s, 0.0);
        let both = theirs.iter().zip(&pairs);
        let both = both.filter_map(|(one, pair)| Some((&ours[(*pair)?], one)));
        let sum: f64 = both.map(|(own, one)| agreement(own, one, offset_s)).sum();
        let (from_s, to_s) = (ours[0].from_s, ours[ours.len() - 1].to_s);
        let is_within =
            |one: &&Standstill| one.to_s + offset_s >= from_s && one.from_s + offset_s <= to_s;
        let n = theirs.iter().filter(is_within).count().max(1);
        Self {
            offset_s,
            n_pairs: n_paired(&pairs),
            sum,
            mean: sum / n as f64,
        }
    }

    /// Whether another clock difference fits as well.
    fn is_rivalled_by(&self, other: &Self) -> bool {
        other.n_pairs >= MIN_PAIRS.max(self.n_pairs / 2) && other.mean >= AS_GOOD * self.mean
    }
}

/// The clock difference with which the standstills of both files agree.
///
/// # Errors
/// `join_unclear` if none makes enough pairs, `two_readings` if another one fits as well.
pub fn offset_from_standstills(
    ours: &[Standstill],
    all_theirs: &[Standstill],
) -> Result<f64, JoinError> {
    let step = all_theirs.len().div_ceil(MAX_TRIED).max(1);
    let theirs: Vec<Standstill> = all_theirs.iter().copied().step_by(step).collect();
    let middle_s = |one: &Standstill| (one.from_s + one.to_s) / 2.0;
    let last = theirs.len().saturating_sub(1);
    let mut offsets_s = vec![0.0];
    for anchor in (0..ANCHORS).filter_map(|k| theirs.get(k * last / (ANCHORS - 1))) {
        offsets_s.extend(ours.iter().map(|own| middle_s(own) - middle_s(anchor)));
    }
    let tried = offsets_s.into_iter();
    let mut tried: Vec<Tried> = tried.map(|s| Tried::new(ours, &theirs, s)).collect();
    tried.sort_by(|a, b| b.sum.total_cmp(&a.sum));
    let best = &tried[0];
    let possible = theirs.len().min(ours.len());
    if best.n_pairs < MIN_PAIRS || 2 * best.n_pairs < possible {
        return Err(clocks_cannot_be_compared(
            "with no difference between them do most standstills of the two files fall together",
        ));
    }
    let pairs = paired(ours, &theirs, best.offset_s, 0.0);
    let contradicts = |other: &&Tried| {
        let others = paired(ours, &theirs, other.offset_s, 0.0);
        let mut both = pairs.iter().zip(&others).filter_map(|(a, b)| a.zip(*b));
        both.any(|(a, b)| a != b)
    };
    let mut offsets_s = vec![best.offset_s];
    for other in tried.iter().filter(|other| best.is_rivalled_by(other)) {
        let is_new = |known: &f64| (known - other.offset_s).abs() > SAME_OFFSET_S;
        if offsets_s.iter().all(is_new) && contradicts(&other) {
            offsets_s.push(other.offset_s);
        }
        if offsets_s.len() > MAX_TIES {
            break;
        }
    }
    if offsets_s.len() > 1 {
        let n_pairs = |offset_s| n_paired(&paired(ours, all_theirs, offset_s, 0.0));
        return Err(several_offsets(offsets_s, &n_pairs));
    }
    Ok(centred(ours, &theirs, best.offset_s, &pairs))
}

/// Refines a clock difference: with it, the median of the differences between beginnings, and between ends, is zero.
fn centred(
    ours: &[Standstill],
    theirs: &[Standstill],
    offset_s: f64,
    pairs: &[Option<usize>],
) -> f64 {
    let pairs = theirs.iter().zip(pairs);
    let pairs = pairs.filter_map(|(one, pair)| Some((&ours[(*pair)?], one)));
    let mut edges_s: Vec<f64> = pairs
        .flat_map(|(own, one)| match own.to_s > own.from_s {
            true => vec![own.from_s - one.from_s, own.to_s - one.to_s],
            false => vec![own.from_s - (one.from_s + one.to_s) / 2.0],
        })
        .collect();
    edges_s.sort_by(f64::total_cmp);
    edges_s.get(edges_s.len() / 2).copied().unwrap_or(offset_s)
}

/// Pairs the standstills of an instrument's log with those of the robot.
///
/// # Errors
/// As [`offset_from_standstills`], and `join_unclear` if a stated clock difference pairs too few of them.
pub fn offset_and_pairs(
    ours: &[Standstill],
    theirs: &[Standstill],
    options: &JoinOptions,
    tolerance_s: f64,
) -> Result<(f64, Vec<Option<usize>>), JoinError> {
    let pairs = |offset_s| paired(ours, theirs, offset_s, tolerance_s);
    let offset_s = stated_or_found(
        options,
        tolerance_s,
        ours.len().min(theirs.len()),
        |offset_s| n_paired(&pairs(offset_s)),
        || offset_from_standstills(ours, theirs),
    )?;
    Ok((offset_s, pairs(offset_s)))
}
