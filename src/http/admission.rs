//! Limits: how much may be under way at once, and how often a key or a peer may ask. What is over a limit is refused at once,
//! with `Retry-After`, before it costs anything.

use crate::config::LimitsConfig;
use crate::http::accept::Peer;
use crate::http::auth::Caller;
use crate::http::{App, Error, MAX_BODY_BYTES};
use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::collections::HashMap;
use std::hash::Hash;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Reads under way: at 0.1 ms each on two cores the last one waits some 15 ms.
const MAX_READS: usize = 256;
/// Writes under way, counted from when their body is here: at 1,000 a second the last one waits some 130 ms.
const MAX_WRITES: usize = 128;
/// Long polls and event streams that wait at the same time.
const MAX_WAITING: usize = 2_048;
/// Bodies up to this size share [`SMALL_BODIES_KIB`]; larger ones need one of [`LARGE_BODIES`]. A set of 60 poses has 6 KiB.
pub const LARGE_BODY_BYTES: usize = 1024 * 1024;
/// All small bodies in memory together.
const SMALL_BODIES_KIB: usize = 64 * 1024;
/// Large bodies in memory at once, each up to [`MAX_BODY_BYTES`].
const LARGE_BODIES: usize = 2;
/// Failed attempts of one address before the answer is 429 instead of 401, and how many are forgiven each second.
const FAILED_ATTEMPTS: (f64, f64) = (20.0, 0.5);
/// Addresses and keys that are remembered; beyond it those that have calmed down are forgotten.
const MAX_REMEMBERED: usize = 10_000;

/// The limits of one server.
#[derive(Clone, Debug)]
pub struct Limits(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    reads: Arc<Semaphore>,
    writes: Arc<Semaphore>,
    waiting: Arc<Semaphore>,
    small_bodies_kib: Arc<Semaphore>,
    large_bodies: Arc<Semaphore>,
    client_timeout: Duration,
    per_key: Option<Buckets<String>>,
    failures: Buckets<IpAddr>,
}

impl Limits {
    /// Nothing under way, nothing remembered. `no_auth` lifts the limit per key.
    pub fn new(config: &LimitsConfig, no_auth: bool) -> Self {
        let rate = f64::from(config.rate_per_key);
        let per_key = (!no_auth && config.rate_per_key > 0).then(|| Buckets::new(2.0 * rate, rate));
        Self(Arc::new(Inner {
            reads: Arc::new(Semaphore::new(MAX_READS)),
            writes: Arc::new(Semaphore::new(MAX_WRITES)),
            waiting: Arc::new(Semaphore::new(MAX_WAITING)),
            small_bodies_kib: Arc::new(Semaphore::new(SMALL_BODIES_KIB)),
            large_bodies: Arc::new(Semaphore::new(LARGE_BODIES)),
            client_timeout: config.client_timeout(),
            per_key,
            failures: Buckets::new(FAILED_ATTEMPTS.0, FAILED_ATTEMPTS.1),
        }))
    }

    /// How long a client may be silent.
    pub fn client_timeout(&self) -> Duration {
        self.0.client_timeout
    }

    /// What more may be under way, by kind: requests, and KiB of small bodies.
    pub fn room_left(&self) -> [(&'static str, usize); 5] {
        let all = &self.0;
        [
            ("reads", &all.reads),
            ("writes", &all.writes),
            ("waiting", &all.waiting),
            ("small_bodies_kib", &all.small_bodies_kib),
            ("large_bodies", &all.large_bodies),
        ]
        .map(|(kind, semaphore)| (kind, semaphore.available_permits()))
    }

    /// Room to wait for a job, e.g. for the life of an event stream.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn wait(&self) -> Result<OwnedSemaphorePermit, Error> {
        take(&self.0.waiting, 1)
    }

    /// One more request of this key.
    ///
    /// # Errors
    /// [`Error::RateLimited`].
    pub fn count(&self, caller: &Caller) -> Result<(), Error> {
        let allowed = self.0.per_key.as_ref().is_none_or(|buckets| buckets.take(&caller.holder));
        if allowed { Ok(()) } else { Err(Error::RateLimited("this key sends too many requests")) }
    }

    /// Notes a request whose key is not known. Only such requests are ever refused for it: a good key works from any address.
    ///
    /// # Errors
    /// [`Error::RateLimited`] after too many.
    pub fn failed_attempt(&self, peer: Option<Peer>) -> Result<(), Error> {
        let address = peer.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |peer| peer.0);
        if self.0.failures.take(&address) { Ok(()) } else { Err(Error::RateLimited("too many attempts without a valid key")) }
    }

    /// Whether one more write could begin now. Decides nothing: what is let through is counted when its body is here.
    pub fn room_to_write(&self) -> bool {
        self.0.writes.available_permits() > 0
    }

    /// Room for a body that begins to arrive.
    ///
    /// # Errors
    /// [`Error::Busy`] if as much is under way already.
    pub fn body(&self, declared_bytes: Option<usize>) -> Result<BodyRoom, Error> {
        if !self.room_to_write() {
            return Err(Error::Busy);
        }
        let mut room = BodyRoom { limits: self.clone(), reserved_bytes: 0, permits: Vec::new() };
        room.grow(declared_bytes.filter(|bytes| *bytes > LARGE_BODY_BYTES).unwrap_or(1))?;
        Ok(room)
    }
}

/// Memory that is set aside for one body, until it is dropped.
#[derive(Debug)]
pub struct BodyRoom {
    limits: Limits,
    reserved_bytes: usize,
    permits: Vec<OwnedSemaphorePermit>,
}

impl BodyRoom {
    /// Makes room for a body of this size. It grows with what came, not with what was announced: announcing is free.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn grow(&mut self, to_bytes: usize) -> Result<(), Error> {
        if to_bytes <= self.reserved_bytes {
            return Ok(());
        }
        if to_bytes > LARGE_BODY_BYTES {
            let large = take(&self.limits.0.large_bodies, 1)?;
            self.permits = vec![large];
            self.reserved_bytes = MAX_BODY_BYTES;
            return Ok(());
        }
        // Doubling, so that a body takes few permits.
        let size = to_bytes.max(2 * self.reserved_bytes).next_multiple_of(8 * 1024).min(LARGE_BODY_BYTES);
        self.permits.push(take(&self.limits.0.small_bodies_kib, (size - self.reserved_bytes).div_ceil(1024))?);
        self.reserved_bytes = size;
        Ok(())
    }

    /// The body is here: now it counts among the writes.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn arrived(mut self) -> Result<Vec<OwnedSemaphorePermit>, Error> {
        self.permits.push(take(&self.limits.0.writes, 1)?);
        Ok(self.permits)
    }
}

fn take(semaphore: &Arc<Semaphore>, n: usize) -> Result<OwnedSemaphorePermit, Error> {
    let n = u32::try_from(n).unwrap_or(u32::MAX);
    Arc::clone(semaphore).try_acquire_many_owned(n).map_err(|_| Error::Busy)
}

/// Keeps what is under way within the limits. Requests with a body are counted when it is here, see [`BodyRoom`].
pub async fn bound(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let kind = kind(&request, &app.limits);
    request.extensions_mut().insert(app.limits.clone());
    match kind.map(|semaphore| take(semaphore, 1)).transpose() {
        Ok(_permit) => next.run(request).await,
        Err(busy) => busy.into_response(),
    }
}

fn kind<'a>(request: &Request, limits: &'a Limits) -> Option<&'a Arc<Semaphore>> {
    let template = request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str);
    let waits = template == "/v1/jobs/{id}" && request.uri().query().is_some_and(|query| query.contains("wait_s"));
    match (request.method(), template) {
        (_, "/healthz" | "/readyz" | "/metrics") => None,
        (&Method::POST, "/v1/jobs/{id}/cancel") => Some(&limits.0.writes),
        (&Method::POST, _) => None,
        _ if waits => Some(&limits.0.waiting),
        _ => Some(&limits.0.reads),
    }
}

/// Token buckets, one for each key or address.
#[derive(Debug)]
struct Buckets<K> {
    capacity: f64,
    per_s: f64,
    levels: Mutex<HashMap<K, (f64, Instant)>>,
}

impl<K: Clone + Eq + Hash> Buckets<K> {
    fn new(capacity: f64, per_s: f64) -> Self {
        Self { capacity, per_s, levels: Mutex::new(HashMap::new()) }
    }

    fn take(&self, key: &K) -> bool {
        self.take_at(key, Instant::now())
    }

    fn take_at(&self, key: &K, now: Instant) -> bool {
        let mut levels = self.levels.lock().unwrap_or_else(PoisonError::into_inner);
        let filled =
            |(level, at): (f64, Instant)| (level + self.per_s * now.saturating_duration_since(at).as_secs_f64()).min(self.capacity);
        if levels.len() >= MAX_REMEMBERED && !levels.contains_key(key) {
            levels.retain(|_, bucket| filled(*bucket) < self.capacity);
            if levels.len() >= MAX_REMEMBERED {
                levels.clear();
            }
        }
        let level = filled(levels.get(key).copied().unwrap_or((self.capacity, now)));
        let allowed = level >= 1.0;
        levels.insert(key.clone(), (if allowed { level - 1.0 } else { level }, now));
        allowed
    }
}

#[cfg(test)]
mod tests {
    use super::{Buckets, LARGE_BODIES, LARGE_BODY_BYTES, Limits, MAX_REMEMBERED};
    use crate::config::LimitsConfig;
    use crate::http::MAX_BODY_BYTES;
    use std::time::{Duration, Instant};

    #[test]
    fn a_bucket_gives_its_capacity_at_once_and_then_its_rate() {
        let buckets = Buckets::new(3.0, 2.0);
        let begin = Instant::now();
        let taken = |at_ms| (0..10).filter(|_| buckets.take_at(&"a", begin + Duration::from_millis(at_ms))).count();
        assert_eq!([taken(0), taken(1_000), taken(1_400), taken(100_000)], [3, 2, 0, 3]);
        assert!(buckets.take_at(&"b", begin), "another key has its own");
    }

    #[test]
    fn a_bucket_remembers_no_more_than_its_limit() {
        let buckets = Buckets::new(1.0, 0.0);
        let now = Instant::now();
        (0..3 * MAX_REMEMBERED).for_each(|key| assert!(buckets.take_at(&key, now)));
        assert!(buckets.levels.lock().unwrap().len() <= MAX_REMEMBERED);
    }

    #[test]
    fn bodies_take_room_as_they_grow_and_give_it_back() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let free = limits.0.small_bodies_kib.available_permits();
        let mut room = limits.body(Some(MAX_BODY_BYTES)).unwrap();
        assert_eq!(limits.0.large_bodies.available_permits(), LARGE_BODIES - 1, "an announced large body takes its place at once");
        room.grow(MAX_BODY_BYTES).unwrap();
        drop(room);
        let mut room = limits.body(None).unwrap();
        room.grow(LARGE_BODY_BYTES).unwrap();
        assert_eq!(free - limits.0.small_bodies_kib.available_permits(), LARGE_BODY_BYTES / 1024);
        room.grow(LARGE_BODY_BYTES + 1).unwrap();
        assert_eq!(limits.0.small_bodies_kib.available_permits(), free);
        drop(room);
        assert_eq!(limits.0.large_bodies.available_permits(), LARGE_BODIES);
    }

    #[test]
    fn a_large_body_too_many_is_refused_at_once() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let _rooms: Vec<_> = (0..LARGE_BODIES).map(|_| limits.body(Some(MAX_BODY_BYTES)).unwrap()).collect();
        assert!(matches!(limits.body(Some(MAX_BODY_BYTES)), Err(crate::http::Error::Busy)));
        assert!(limits.body(Some(6_000)).is_ok(), "small ones go on");
    }
}
