//! Measurement sets that were uploaded here lately, as they were understood then. A job is posted right after its upload as a rule, and to read
//! the upload once more takes longer than all else that is looked at then. Sets never change, so that what is kept is never out of date.

use crate::store::MeasurementSetRow;
use crate::wire::measurement::MeasurementSet;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// So many sets are kept, the newest,
const MOST: usize = 64;
/// of so many points each at most: less than 10 MiB in all.
const MOST_POINTS: usize = 500;

/// A stored set, and what its bytes mean.
#[derive(Debug)]
pub struct RecentSet {
    /// As it is stored.
    pub row: MeasurementSetRow,
    /// What [`from_upload`](crate::wire::measurement::from_upload) makes of its bytes.
    pub set: MeasurementSet,
}

/// The newest sets, shared between requests.
#[derive(Clone, Debug, Default)]
pub struct RecentSets(Arc<Mutex<VecDeque<Arc<RecentSet>>>>);

impl RecentSets {
    /// Keeps a set that is stored now, and forgets the oldest.
    pub fn keep(&self, row: MeasurementSetRow, set: MeasurementSet) {
        let mut sets = self.sets();
        sets.push_back(Arc::new(RecentSet { row, set }));
        if sets.len() > MOST {
            sets.pop_front();
        }
    }

    /// A copy of a set, to be kept once it is stored; none of a large one.
    pub fn copy_of(set: &MeasurementSet) -> Option<MeasurementSet> {
        (set.points.len() <= MOST_POINTS).then(|| set.clone())
    }

    /// The set with this id, if it is one of the newest.
    pub fn find(&self, id: &str) -> Option<Arc<RecentSet>> {
        self.sets()
            .iter()
            .rev()
            .find(|recent| recent.row.id == id)
            .cloned()
    }

    fn sets(&self) -> MutexGuard<'_, VecDeque<Arc<RecentSet>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
