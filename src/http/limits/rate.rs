//! Token buckets: limit the rate of requests per key or address.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Maximum number of buckets. When it is reached, full buckets are removed; if none is full, all are removed.
const MAX_REMEMBERED: usize = 10_000;

/// Token buckets, one for each key or address.
#[derive(Debug)]
pub struct TokenBuckets<K> {
    capacity: f64,
    per_s: f64,
    levels: Mutex<HashMap<K, (f64, Instant)>>,
}

impl<K: Clone + Eq + Hash> TokenBuckets<K> {
    /// Buckets of this capacity, full at first, that are refilled at this rate.
    pub fn new(capacity: f64, per_s: f64) -> Self {
        Self {
            capacity,
            per_s,
            levels: Mutex::new(HashMap::new()),
        }
    }

    /// Takes a token; false if the bucket is empty.
    pub fn take(&self, key: &K) -> bool {
        self.take_at(key, Instant::now())
    }

    fn take_at(&self, key: &K, now: Instant) -> bool {
        let mut levels = self.levels.lock().unwrap_or_else(PoisonError::into_inner);
        let filled = |(level, at): (f64, Instant)| {
            (level + self.per_s * now.saturating_duration_since(at).as_secs_f64())
                .min(self.capacity)
        };
        if levels.len() >= MAX_REMEMBERED && !levels.contains_key(key) {
            levels.retain(|_, bucket| filled(*bucket) < self.capacity);
            if levels.len() >= MAX_REMEMBERED {
                levels.clear();
            }
        }
        let level = filled(levels.get(key).copied().unwrap_or((self.capacity, now)));
        let allowed = level >= 1.0;
        levels.insert(
            key.clone(),
            (if allowed { level - 1.0 } else { level }, now),
        );
        allowed
    }
}

#[cfg(test)]
mod tests {
    use super::{MAX_REMEMBERED, TokenBuckets};
    use std::time::{Duration, Instant};

    #[test]
    fn a_bucket_gives_its_capacity_at_once_and_then_its_rate() {
        let buckets = TokenBuckets::new(3.0, 2.0);
        let begin = Instant::now();
        let taken = |at_ms| {
            (0..10)
                .filter(|_| buckets.take_at(&"a", begin + Duration::from_millis(at_ms)))
                .count()
        };
        assert_eq!(
            [taken(0), taken(1_000), taken(1_400), taken(100_000)],
            [3, 2, 0, 3]
        );
        assert!(buckets.take_at(&"b", begin), "another key has its own");
    }

    #[test]
    fn a_bucket_remembers_no_more_than_its_limit() {
        let buckets = TokenBuckets::new(1.0, 0.0);
        let now = Instant::now();
        (0..3 * MAX_REMEMBERED).for_each(|key| assert!(buckets.take_at(&key, now)));
        assert!(buckets.levels.lock().unwrap().len() <= MAX_REMEMBERED);
    }
}
