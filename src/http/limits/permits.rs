//! Every limit of one server. A request over a limit is refused with 503 or 429 and `Retry-After`. It is refused at once, or after ten seconds if it
//! waits for a permit.
//!
//! A request needs, in this order:
//!
//! 1. a permit of its class, or it is refused before routing ([`Limits::admit`]). If it has a body, it takes the permit when the body has arrived,
//!    so that slow clients hold none;
//! 2. a token of its key, or of its address if the key is unknown ([`TokenBuckets`]);
//! 3. memory for its body as it arrives ([`BodyBudget`]);
//! 4. a permit to compute or to read a whole document ([`Limits::compute_permit`]), for which it waits;
//! 5. memory for a large answer until it is sent ([`Limits::answer_memory`]).
//!
//! Withdraw, rollback and cancel have permits of their own ([`RequestClass::Safety`]), so that no flood of other requests keeps them out.

use crate::config::LimitsConfig;
use crate::http::Error;
use crate::http::limits::rate::TokenBuckets;
use crate::jobs::blocking;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

/// Class of a request for limits. The table of routes states it for each route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestClass {
    /// Reads some rows.
    Read,
    /// Reads a whole document, or computes from stored data.
    CostlyRead,
    /// Computes from its body and stores nothing.
    Calculation,
    /// Withdraw, rollback and cancel, which have permits of their own.
    Safety,
    /// All other requests that are not reads.
    Write,
}

/// Largest request body, bytes: the largest upload.
pub const MAX_BODY_BYTES: usize = 32 * 1024 * 1024;
/// Lowest average rate at which a body must arrive, or a large answer must be read, after the client timeout. Slower clients are disconnected.
pub const MIN_BYTES_PER_S: f64 = 16.0 * 1024.0;
/// Concurrent reads. A read takes 0.1 ms of one of two cores, so the last one waits some 15 ms.
const MAX_READS: usize = 256;
/// Concurrent requests that compute or read a whole document, and store nothing. Other reads and writes have permits of their own, so that these
/// requests cannot block them.
const MAX_CALCULATIONS: usize = 64;
/// Concurrent writes. SQLite has one writer, so a withdrawal may wait for this many writes.
const MAX_WRITES: usize = 64;
/// Concurrent requests of [`RequestClass::Safety`]. They wait for a permit.
const MAX_SAFETY: usize = 8;
/// Longest body of [`RequestClass::Safety`]: a reason of 2,000 characters, each of them escaped. It is so small that it needs no memory permit.
const MAX_SAFETY_BYTES: usize = 64 * 1024;
/// Long polls and event streams that wait at the same time. The other connections are left for other requests.
const MAX_WAITING: usize = 2_048;
/// Memory of all bodies.
const BODIES_KIB: usize = 192 * 1024;
/// Part of [`BODIES_KIB`] that large bodies leave to small ones.
const SMALL_BODIES_KIB: usize = 64 * 1024;
/// Bodies above this size are large. A set of 60 poses has 6 KiB.
pub const LARGE_BODY_BYTES: usize = 1024 * 1024;
/// Memory of a large body, as a multiple of its size: parsing it takes more than the bytes.
const LARGE_BODY_FACTOR: usize = 2;
/// Memory of all large answers that are not sent yet. It is separate from that of bodies, so that clients that do not read their answers cannot
/// block writes. A report of 100,000 points has 45 MiB.
const ANSWERS_KIB: usize = 64 * 1024;
/// Computations for requests that store nothing, and whole documents (reports, uploads, weights) that are read from the database. Reading a document
/// takes several times its size in memory.
const MAX_COMPUTING_READS: usize = 2;
/// Computations for writes. They are separate from those for reads. Otherwise an upload would wait for dozens of pose plans.
const MAX_COMPUTING_WRITES: usize = 8;
/// Longest wait for a permit. Then the request is refused, and the client retries.
const PERMIT_TIMEOUT: Duration = Duration::from_secs(10);
/// Attempts with unknown keys per address before the answer is 429 instead of 401: burst, and rate per second.
const FAILED_ATTEMPTS: (f64, f64) = (20.0, 0.5);

/// The limits of one server; clones share them. What they do not admit is [`Error::Busy`] or [`Error::RateLimited`].
#[derive(Clone, Debug)]
pub struct Limits(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    reads: Arc<Semaphore>,
    calculations: Arc<Semaphore>,
    writes: Arc<Semaphore>,
    safety: Arc<Semaphore>,
    waiting: Arc<Semaphore>,
    bodies_kib: Arc<Semaphore>,
    answers_kib: Arc<Semaphore>,
    computing_reads: Arc<Semaphore>,
    computing_writes: Arc<Semaphore>,
    statistics: Arc<Semaphore>,
    client_timeout: Duration,
    requests_per_key: Option<TokenBuckets<String>>,
    failed_attempts: TokenBuckets<IpAddr>,
}

/// Takes `n` permits, or fails at once if fewer are free.
fn try_take(semaphore: &Arc<Semaphore>, n: usize) -> Result<OwnedSemaphorePermit, Error> {
    let n = u32::try_from(n).unwrap_or(u32::MAX);
    Arc::clone(semaphore)
        .try_acquire_many_owned(n)
        .map_err(|_| Error::Busy)
}

/// Waits at most [`PERMIT_TIMEOUT`] for a permit.
async fn wait_to_take(semaphore: &Arc<Semaphore>) -> Result<OwnedSemaphorePermit, Error> {
    match timeout(PERMIT_TIMEOUT, Arc::clone(semaphore).acquire_owned()).await {
        Ok(Ok(permit)) => Ok(permit),
        Ok(Err(_)) | Err(_) => Err(Error::Busy),
    }
}

impl Limits {
    /// Creates the limits, with all permits free. With `no_auth` there is no rate per key.
    pub fn new(config: &LimitsConfig, no_auth: bool) -> Self {
        let rate = f64::from(config.rate_per_key);
        let permits = |n| Arc::new(Semaphore::new(n));
        Self(Arc::new(Inner {
            reads: permits(MAX_READS),
            calculations: permits(MAX_CALCULATIONS),
            writes: permits(MAX_WRITES),
            safety: permits(MAX_SAFETY),
            waiting: permits(MAX_WAITING),
            bodies_kib: permits(BODIES_KIB),
            answers_kib: permits(ANSWERS_KIB),
            computing_reads: permits(MAX_COMPUTING_READS),
            computing_writes: permits(MAX_COMPUTING_WRITES),
            statistics: permits(1),
            client_timeout: config.client_timeout(),
            requests_per_key: (!no_auth && config.rate_per_key > 0)
                .then(|| TokenBuckets::new(2.0 * rate, rate)),
            failed_attempts: TokenBuckets::new(FAILED_ATTEMPTS.0, FAILED_ATTEMPTS.1),
        }))
    }

    /// How long a client may be silent.
    pub fn client_timeout(&self) -> Duration {
        self.0.client_timeout
    }

    /// Free permits by kind.
    pub fn free(&self) -> [(&'static str, usize); 9] {
        let all = &self.0;
        [
            ("reads", &all.reads),
            ("calculations", &all.calculations),
            ("writes", &all.writes),
            ("safety", &all.safety),
            ("waiting", &all.waiting),
            ("bodies_kib", &all.bodies_kib),
            ("answers_kib", &all.answers_kib),
            ("computing_reads", &all.computing_reads),
            ("computing_writes", &all.computing_writes),
        ]
        .map(|(kind, semaphore)| (kind, semaphore.available_permits()))
    }

    /// Admits a request before it is routed. A read takes its permit now. A request with a body takes it when the body has arrived
    /// ([`BodyBudget::take_class_permit`]), but is refused now if none is free. [`RequestClass::Safety`] takes its permit when its key is known
    /// ([`Limits::compute_permit`]), so that nobody without a key can use them up.
    pub fn admit(&self, class: RequestClass) -> Result<Option<OwnedSemaphorePermit>, Error> {
        let refuse_if_none_free = |semaphore: &Semaphore| match semaphore.available_permits() {
            0 => Err(Error::Busy),
            _ => Ok(None),
        };
        match class {
            RequestClass::Read => try_take(&self.0.reads, 1).map(Some),
            RequestClass::CostlyRead => try_take(&self.0.calculations, 1).map(Some),
            RequestClass::Calculation => refuse_if_none_free(&self.0.calculations),
            RequestClass::Write => refuse_if_none_free(&self.0.writes),
            RequestClass::Safety => Ok(None),
        }
    }

    /// A permit to write, for signing in and out. They are reads before routing, so that a browser can always be told to forget its cookie.
    pub fn write_permit(&self) -> Result<OwnedSemaphorePermit, Error> {
        try_take(&self.0.writes, 1)
    }

    /// A permit to wait for a job, for a long poll or an event stream.
    pub fn waiting_permit(&self) -> Result<OwnedSemaphorePermit, Error> {
        try_take(&self.0.waiting, 1)
    }

    /// Waits at most [`PERMIT_TIMEOUT`] for a permit to compute, or to read a whole document from the database. Acquire it before reading large
    /// inputs or documents: waiting requests then hold none in memory, and few database connections read documents. Each connection that reads
    /// one keeps memory for it. A request of [`RequestClass::Safety`] acquires its only permit here.
    pub async fn compute_permit(&self, class: RequestClass) -> Result<ComputePermit, Error> {
        let permits = match class {
            RequestClass::Read | RequestClass::CostlyRead | RequestClass::Calculation => {
                &self.0.computing_reads
            }
            RequestClass::Write => &self.0.computing_writes,
            RequestClass::Safety => &self.0.safety,
        };
        Ok(ComputePermit(Arc::new(wait_to_take(permits).await?)))
    }

    /// Waits for the one permit to count all jobs. The metrics take no other permit, and counting a million jobs takes 0.3 s.
    pub async fn statistics_permit(&self) -> Result<OwnedSemaphorePermit, Error> {
        wait_to_take(&self.0.statistics).await
    }

    /// A permit for the memory of a large answer until it is sent. A single answer beyond the budget takes all of it.
    pub fn answer_memory(&self, bytes: u64) -> Result<OwnedSemaphorePermit, Error> {
        let kib = usize::try_from(bytes.div_ceil(1024)).unwrap_or(usize::MAX);
        try_take(&self.0.answers_kib, kib.min(ANSWERS_KIB))
    }

    /// Counts one more request of this key.
    pub fn count_request(&self, holder: &str) -> Result<(), Error> {
        match &self.0.requests_per_key {
            Some(buckets) if !buckets.take(&holder.to_owned()) => {
                Err(Error::RateLimited("this key sends too many requests"))
            }
            _ => Ok(()),
        }
    }

    /// Counts a request with an unknown key. The limit refuses only such requests: a valid key works from any address.
    ///
    /// # Errors
    /// [`Error::RateLimited`] after too many.
    pub fn count_failed_attempt(&self, address: Option<IpAddr>) -> Result<(), Error> {
        let address = address.unwrap_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED));
        if self.0.failed_attempts.take(&address) {
            Ok(())
        } else {
            Err(Error::RateLimited("too many attempts without a valid key"))
        }
    }

    /// Reserves memory for a body that begins to arrive. If the announced size is large, all memory is reserved at once.
    pub fn body_budget(
        &self,
        class: RequestClass,
        announced_bytes: Option<usize>,
    ) -> Result<BodyBudget, Error> {
        let mut budget = BodyBudget {
            limits: self.clone(),
            class,
            reserved_bytes: 0,
            reserved_kib: 0,
            permits: Vec::new(),
        };
        let large = announced_bytes.filter(|bytes| *bytes > LARGE_BODY_BYTES);
        budget.grow(large.unwrap_or(1))?;
        Ok(budget)
    }
}

/// A permit to compute. A computation keeps it even if its client disconnects.
#[derive(Clone, Debug)]
pub struct ComputePermit(Arc<OwnedSemaphorePermit>);

impl ComputePermit {
    /// Runs `work` on a blocking thread.
    ///
    /// # Errors
    /// Those of `work`; [`Error::Internal`] if the server stops before `work` begins.
    ///
    /// # Panics
    /// If `work` does.
    pub async fn run<T, E>(
        &self,
        work: impl FnOnce() -> Result<T, E> + Send + 'static,
    ) -> Result<T, Error>
    where
        T: Send + 'static,
        E: Into<Error> + Send + 'static,
    {
        blocking::run(&self.0, work)
            .await
            .map_err(|error| Error::Internal(error.to_string()))?
            .map_err(Into::into)
    }
}

/// Memory that is reserved for one body, until it is dropped.
#[derive(Debug)]
pub struct BodyBudget {
    limits: Limits,
    class: RequestClass,
    reserved_bytes: usize,
    reserved_kib: usize,
    permits: Vec<OwnedSemaphorePermit>,
}

impl BodyBudget {
    /// Reserves memory for a body of this size. Call it with the bytes that have arrived: a small announced size reserves nothing.
    ///
    /// # Errors
    /// [`Error::Busy`]; [`Error::TooLarge`] for [`RequestClass::Safety`], which has a small limit instead of a reservation.
    pub fn grow(&mut self, to_bytes: usize) -> Result<(), Error> {
        if self.class == RequestClass::Safety {
            return if to_bytes > MAX_SAFETY_BYTES {
                Err(Error::TooLarge {
                    limit: MAX_SAFETY_BYTES,
                    advice: "shorten the reason",
                })
            } else {
                Ok(())
            };
        }
        if to_bytes <= self.reserved_bytes {
            return Ok(());
        }
        // Doubles, so that a body takes few permits.
        let bytes = to_bytes
            .max(2 * self.reserved_bytes)
            .next_multiple_of(8 * 1024)
            .min(MAX_BODY_BYTES);
        let is_large = bytes > LARGE_BODY_BYTES;
        let kib = bytes.div_ceil(1024) * if is_large { LARGE_BODY_FACTOR } else { 1 };
        let more_kib = kib - self.reserved_kib;
        let all = &self.limits.0.bodies_kib;
        if is_large && all.available_permits() < more_kib + SMALL_BODIES_KIB {
            return Err(Error::Busy);
        }
        self.permits.push(try_take(all, more_kib)?);
        self.reserved_bytes = bytes;
        self.reserved_kib = kib;
        Ok(())
    }

    /// Takes the request's permit, once the whole body has arrived. The caller must keep all permits as long as the bytes.
    pub fn take_class_permit(mut self) -> Result<Vec<OwnedSemaphorePermit>, Error> {
        match self.class {
            RequestClass::Calculation => {
                self.permits.push(try_take(&self.limits.0.calculations, 1)?)
            }
            RequestClass::Write => self.permits.push(try_take(&self.limits.0.writes, 1)?),
            // `admit` or `compute_permit` gives these their permit.
            RequestClass::Read | RequestClass::CostlyRead | RequestClass::Safety => {}
        }
        Ok(self.permits)
    }
}

#[cfg(test)]
mod tests {
    use super::{
        BODIES_KIB, LARGE_BODY_BYTES, LARGE_BODY_FACTOR, Limits, MAX_BODY_BYTES, MAX_SAFETY,
        MAX_SAFETY_BYTES, MAX_WRITES, RequestClass, SMALL_BODIES_KIB, try_take,
    };
    use crate::config::LimitsConfig;
    use crate::http::Error;

    fn limits() -> Limits {
        Limits::new(&LimitsConfig::default(), false)
    }

    fn used_kib(limits: &Limits) -> usize {
        BODIES_KIB - limits.0.bodies_kib.available_permits()
    }

    #[test]
    fn bodies_take_memory_as_they_grow_and_give_it_back() {
        let limits = limits();
        let large_kib = |bytes: usize| LARGE_BODY_FACTOR * bytes / 1024;
        let mut budget = limits
            .body_budget(RequestClass::Write, Some(MAX_BODY_BYTES))
            .unwrap();
        assert_eq!(
            used_kib(&limits),
            large_kib(MAX_BODY_BYTES),
            "an announced large body takes its memory at once"
        );
        budget.grow(MAX_BODY_BYTES).unwrap();
        assert_eq!(used_kib(&limits), large_kib(MAX_BODY_BYTES));
        drop(budget);
        assert_eq!(used_kib(&limits), 0);
        let mut budget = limits.body_budget(RequestClass::Write, None).unwrap();
        budget.grow(LARGE_BODY_BYTES).unwrap();
        assert_eq!(used_kib(&limits), LARGE_BODY_BYTES / 1024);
        budget.grow(LARGE_BODY_BYTES + 1).unwrap();
        assert_eq!(used_kib(&limits), large_kib(2 * LARGE_BODY_BYTES));
        drop(budget);
        assert_eq!(used_kib(&limits), 0);
    }

    #[test]
    fn a_large_body_too_many_is_refused_and_small_ones_go_on() {
        let limits = limits();
        let large = || limits.body_budget(RequestClass::Write, Some(MAX_BODY_BYTES));
        let held: Vec<_> = (0..2).map(|_| large().unwrap()).collect();
        assert!(matches!(large(), Err(Error::Busy)));
        assert!(limits.body_budget(RequestClass::Write, Some(6_000)).is_ok());
        assert!(
            BODIES_KIB - used_kib(&limits) >= SMALL_BODIES_KIB,
            "large bodies leave memory for small ones"
        );
        drop(held);
    }

    #[tokio::test]
    async fn withdraw_rollback_and_cancel_have_a_reserve_where_writes_have_nothing() {
        let limits = limits();
        let write = || {
            limits
                .body_budget(RequestClass::Write, None)
                .unwrap()
                .take_class_permit()
        };
        let held: Vec<_> = (0..MAX_WRITES).map(|_| write().unwrap()).collect();
        assert!(matches!(write(), Err(Error::Busy)));
        assert!(matches!(
            limits.admit(RequestClass::Write),
            Err(Error::Busy)
        ));
        assert!(limits.admit(RequestClass::Safety).is_ok());
        let free_kib = limits.0.bodies_kib.available_permits();
        let all_memory = try_take(&limits.0.bodies_kib, free_kib);
        assert!(matches!(
            limits.body_budget(RequestClass::Read, None),
            Err(Error::Busy)
        ));
        let mut reason = limits.body_budget(RequestClass::Safety, None).unwrap();
        reason.grow(MAX_SAFETY_BYTES).unwrap();
        assert!(matches!(
            reason.grow(MAX_SAFETY_BYTES + 1),
            Err(Error::TooLarge { .. })
        ));
        drop(all_memory);
        let mut reserve = Vec::new();
        for _ in 0..MAX_SAFETY {
            reserve.push(limits.compute_permit(RequestClass::Safety).await.unwrap());
        }
        assert_eq!(limits.0.safety.available_permits(), 0);
        assert!(
            limits.admit(RequestClass::Read).is_ok()
                && limits.admit(RequestClass::Calculation).is_ok(),
            "reads have permits of their own"
        );
        drop((held, reserve));
        assert_eq!(limits.0.writes.available_permits(), MAX_WRITES);
    }

    #[tokio::test]
    async fn one_request_at_a_time_counts_the_jobs() {
        let limits = limits();
        let first = limits.statistics_permit().await.unwrap();
        let mut second = std::pin::pin!(limits.statistics_permit());
        let is_ready = tokio::select! {
            biased;
            _ = &mut second => true,
            () = std::future::ready(()) => false,
        };
        assert!(!is_ready);
        drop(first);
        assert!(second.await.is_ok());
    }

    #[tokio::test]
    async fn a_computation_keeps_its_permit_when_its_client_goes_away() {
        let limits = limits();
        let semaphore = &limits.0.safety;
        let (begun, has_begun) = tokio::sync::oneshot::channel();
        let (end, ends) = std::sync::mpsc::channel::<()>();
        let permit = limits.compute_permit(RequestClass::Safety).await.unwrap();
        let request = tokio::spawn(async move {
            permit
                .run(move || {
                    let _ = begun.send(());
                    let _ = ends.recv();
                    Ok::<_, Error>(())
                })
                .await
        });
        has_begun.await.unwrap();
        request.abort();
        assert!(request.await.unwrap_err().is_cancelled());
        assert_eq!(semaphore.available_permits(), MAX_SAFETY - 1);
        drop(end);
        let _all_again = semaphore.acquire_many(MAX_SAFETY as u32).await.unwrap();
        assert!(try_take(semaphore, 1).is_err());
    }
}
