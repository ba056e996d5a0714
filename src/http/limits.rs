//! Limits of one server: concurrent requests, memory of bodies and answers, and the rate per key and per address. A request over a limit is
//! refused at once with 503 or 429 and `Retry-After`.

use crate::config::LimitsConfig;
use crate::http::Error;
use crate::http::rate::TokenBuckets;
use crate::http::request_class::RequestClass;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// Largest request body, bytes: ten times the largest campaign.
pub const MAX_BODY_BYTES: usize = 32 * 1024 * 1024;
/// Concurrent reads. A read takes 0.1 ms of one of two cores, so the last one waits some 15 ms.
const MAX_READS: usize = 256;
/// Concurrent requests that compute or read a whole document, and store nothing. Cheap reads have their own permits.
const MAX_CALCULATIONS: usize = 64;
/// Concurrent writes. A write counts from the moment when its body has arrived. SQLite has one writer: the last write, or a withdrawal behind it,
/// waits for all the others.
const MAX_WRITES: usize = 64;
/// Further permits for [`RequestClass::Safety`], used when no permit of [`MAX_WRITES`] is free.
const SAFETY_RESERVE: usize = 16;
/// Longest body of [`RequestClass::Safety`]: a reason of 2,000 characters, each of them escaped. It is so small that it needs no memory permit.
const MAX_SAFETY_BYTES: usize = 64 * 1024;
/// Long polls and event streams that wait at the same time.
const MAX_WAITING: usize = 2_048;
/// Bodies above this size need one of [`LARGE_BODIES`]; smaller ones share [`SMALL_BODIES_KIB`]. A set of 60 poses has 6 KiB.
pub const LARGE_BODY_BYTES: usize = 1024 * 1024;
/// Memory of all small bodies together.
const SMALL_BODIES_KIB: usize = 64 * 1024;
/// Large bodies in memory at once, each up to [`MAX_BODY_BYTES`]. Parsing one takes several times its size.
const LARGE_BODIES: usize = 2;
/// Memory of all large answers that are not sent yet, KiB. A report of 100,000 points has 45 MiB.
const ANSWERS_KIB: usize = 64 * 1024;
/// Whole documents (reports, uploads, weights) that are read from the database at once. Reading one takes three times its size in memory.
const DOCUMENTS: usize = 2;
/// Concurrent computations for reads, for writes, and for [`RequestClass::Safety`]. More would be slower each and take more memory.
const COMPUTING: [usize; 3] = [4, 8, 2];
/// Longest wait for a permit to compute or to read a document; then the request is refused, and clients retry.
const PERMIT_TIMEOUT: Duration = Duration::from_secs(10);
/// Attempts with unknown keys per address before the answer is 429 instead of 401: burst, and rate per second.
const FAILED_ATTEMPTS: (f64, f64) = (20.0, 0.5);

/// The limits of one server; clones share them.
#[derive(Clone, Debug)]
pub struct Limits(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    reads: Arc<Semaphore>,
    calculations: Arc<Semaphore>,
    writes: Arc<Semaphore>,
    safety_reserve: Arc<Semaphore>,
    waiting: Arc<Semaphore>,
    small_bodies_kib: Arc<Semaphore>,
    large_bodies: Arc<Semaphore>,
    answers_kib: Arc<Semaphore>,
    documents: Arc<Semaphore>,
    /// Permits to compute for reads, for writes and for [`RequestClass::Safety`], in this order.
    computing: [Arc<Semaphore>; 3],
    client_timeout: Duration,
    requests_per_key: Option<TokenBuckets<String>>,
    failed_attempts: TokenBuckets<IpAddr>,
}

/// Takes `n` permits, or fails at once if fewer are free.
fn take(semaphore: &Arc<Semaphore>, n: usize) -> Result<OwnedSemaphorePermit, Error> {
    let n = u32::try_from(n).unwrap_or(u32::MAX);
    Arc::clone(semaphore)
        .try_acquire_many_owned(n)
        .map_err(|_| Error::Busy)
}

/// Waits for one permit, at most [`PERMIT_TIMEOUT`].
async fn wait_for(semaphore: &Arc<Semaphore>) -> Result<OwnedSemaphorePermit, Error> {
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
            safety_reserve: permits(SAFETY_RESERVE),
            waiting: permits(MAX_WAITING),
            small_bodies_kib: permits(SMALL_BODIES_KIB),
            large_bodies: permits(LARGE_BODIES),
            answers_kib: permits(ANSWERS_KIB),
            documents: permits(DOCUMENTS),
            computing: COMPUTING.map(permits),
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

    /// Free permits by kind: requests, and KiB of bodies and answers.
    pub fn free(&self) -> [(&'static str, usize); 9] {
        let all = &self.0;
        [
            ("reads", &all.reads),
            ("calculations", &all.calculations),
            ("writes", &all.writes),
            ("safety_reserve", &all.safety_reserve),
            ("waiting", &all.waiting),
            ("small_bodies_kib", &all.small_bodies_kib),
            ("large_bodies", &all.large_bodies),
            ("answers_kib", &all.answers_kib),
            ("documents", &all.documents),
        ]
        .map(|(kind, semaphore)| (kind, semaphore.available_permits()))
    }

    /// Admits a request before it is routed. A read takes its permit now. A request with a body takes it when the body has arrived
    /// ([`BodyBudget::arrived`]), but is refused now if none is free. [`RequestClass::Safety`] takes its permit when its key is known
    /// ([`Limits::safety`]), so that nobody without a key can use up the reserve.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn admit(&self, class: RequestClass) -> Result<Option<OwnedSemaphorePermit>, Error> {
        match class {
            RequestClass::Read => take(&self.0.reads, 1).map(Some),
            RequestClass::CostlyRead => take(&self.0.calculations, 1).map(Some),
            RequestClass::Calculation => self.refuse_if_none_free(&self.0.calculations),
            RequestClass::Write => self.refuse_if_none_free(&self.0.writes),
            RequestClass::Safety => Ok(None),
        }
    }

    fn refuse_if_none_free(
        &self,
        semaphore: &Semaphore,
    ) -> Result<Option<OwnedSemaphorePermit>, Error> {
        if semaphore.available_permits() > 0 {
            Ok(None)
        } else {
            Err(Error::Busy)
        }
    }

    /// A permit for [`RequestClass::Safety`]: one for writes, or else one of the reserve.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn safety(&self) -> Result<OwnedSemaphorePermit, Error> {
        take(&self.0.writes, 1).or_else(|_| take(&self.0.safety_reserve, 1))
    }

    /// A permit to wait for a job, for a long poll or an event stream.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn waiting(&self) -> Result<OwnedSemaphorePermit, Error> {
        take(&self.0.waiting, 1)
    }

    /// Waits for a permit to read a whole document from the database.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub async fn document(&self) -> Result<OwnedSemaphorePermit, Error> {
        wait_for(&self.0.documents).await
    }

    /// A permit for the memory of an answer of this size until it is sent.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn answer(&self, bytes: u64) -> Result<OwnedSemaphorePermit, Error> {
        let kib = usize::try_from(bytes.div_ceil(1024)).unwrap_or(usize::MAX);
        take(&self.0.answers_kib, kib.min(ANSWERS_KIB))
    }

    /// Waits for a permit to compute. Take it before reading large inputs from the database, so that waiting requests hold none in memory.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub async fn compute(&self, class: RequestClass) -> Result<ComputePermit, Error> {
        let [reads, writes, safety] = &self.0.computing;
        let semaphore = match class {
            RequestClass::Read | RequestClass::CostlyRead | RequestClass::Calculation => reads,
            RequestClass::Write => writes,
            RequestClass::Safety => safety,
        };
        Ok(ComputePermit(Arc::new(wait_for(semaphore).await?)))
    }

    /// Counts one more request of this key.
    ///
    /// # Errors
    /// [`Error::RateLimited`].
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

    /// Reserves memory for a body that begins to arrive. A body that is announced as large takes its permit at once.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn body(
        &self,
        class: RequestClass,
        announced_bytes: Option<usize>,
    ) -> Result<BodyBudget, Error> {
        let mut budget = BodyBudget {
            limits: self.clone(),
            class,
            reserved_bytes: 0,
            permits: Vec::new(),
        };
        let large = announced_bytes.filter(|bytes| *bytes > LARGE_BODY_BYTES);
        budget.grow(large.unwrap_or(1))?;
        Ok(budget)
    }
}

/// A permit to compute. The computation keeps it even if its client disconnects.
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
        let permit = Arc::clone(&self.0);
        let done = spawn_blocking(move || {
            let _permit = permit;
            work()
        })
        .await;
        match done {
            Ok(result) => result.map_err(Into::into),
            Err(error) => match error.try_into_panic() {
                Ok(panic) => std::panic::resume_unwind(panic),
                Err(error) => Err(Error::Internal(error.to_string())),
            },
        }
    }
}

/// Memory that is reserved for one body, until it is dropped.
#[derive(Debug)]
pub struct BodyBudget {
    limits: Limits,
    class: RequestClass,
    reserved_bytes: usize,
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
        let limits = &self.limits.0;
        if to_bytes > LARGE_BODY_BYTES {
            self.permits = vec![take(&limits.large_bodies, 1)?];
            self.reserved_bytes = MAX_BODY_BYTES;
            return Ok(());
        }
        // Doubles, so that a body takes few permits.
        let size = to_bytes
            .max(2 * self.reserved_bytes)
            .next_multiple_of(8 * 1024)
            .min(LARGE_BODY_BYTES);
        let more_kib = (size - self.reserved_bytes).div_ceil(1024);
        self.permits.push(take(&limits.small_bodies_kib, more_kib)?);
        self.reserved_bytes = size;
        Ok(())
    }

    /// Takes the request's permit, once the whole body has arrived. The caller keeps all permits as long as the bytes.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn arrived(mut self) -> Result<Vec<OwnedSemaphorePermit>, Error> {
        match self.class {
            RequestClass::Calculation => self.permits.push(take(&self.limits.0.calculations, 1)?),
            RequestClass::Write => self.permits.push(take(&self.limits.0.writes, 1)?),
            // `admit` or `safety` gives these their permit.
            RequestClass::Read | RequestClass::CostlyRead | RequestClass::Safety => {}
        }
        Ok(self.permits)
    }
}

#[cfg(test)]
mod tests {
    use super::{
        LARGE_BODIES, LARGE_BODY_BYTES, Limits, MAX_BODY_BYTES, MAX_SAFETY_BYTES, MAX_WRITES,
        RequestClass, SAFETY_RESERVE, take,
    };
    use crate::config::LimitsConfig;
    use crate::http::Error;

    fn limits() -> Limits {
        Limits::new(&LimitsConfig::default(), false)
    }

    #[test]
    fn bodies_take_memory_as_they_grow_and_give_it_back() {
        let limits = limits();
        let before = limits.free();
        let small = &limits.0.small_bodies_kib;
        let free = small.available_permits();
        let mut budget = limits
            .body(RequestClass::Write, Some(MAX_BODY_BYTES))
            .unwrap();
        assert_eq!(
            limits.0.large_bodies.available_permits(),
            LARGE_BODIES - 1,
            "an announced large body takes its permit at once"
        );
        budget.grow(MAX_BODY_BYTES).unwrap();
        drop(budget);
        let mut budget = limits.body(RequestClass::Write, None).unwrap();
        budget.grow(LARGE_BODY_BYTES).unwrap();
        assert_eq!(free - small.available_permits(), LARGE_BODY_BYTES / 1024);
        budget.grow(LARGE_BODY_BYTES + 1).unwrap();
        assert_eq!(small.available_permits(), free);
        drop(budget);
        assert_eq!(limits.free(), before);
    }

    #[test]
    fn a_large_body_too_many_is_refused_and_small_ones_go_on() {
        let limits = limits();
        let large = || limits.body(RequestClass::Write, Some(MAX_BODY_BYTES));
        let _held: Vec<_> = (0..LARGE_BODIES).map(|_| large().unwrap()).collect();
        assert!(matches!(large(), Err(Error::Busy)));
        assert!(limits.body(RequestClass::Write, Some(6_000)).is_ok());
    }

    #[test]
    fn withdraw_rollback_and_cancel_have_a_reserve_where_writes_have_nothing() {
        let limits = limits();
        let write = || limits.body(RequestClass::Write, None).unwrap().arrived();
        let held: Vec<_> = (0..MAX_WRITES).map(|_| write().unwrap()).collect();
        assert!(matches!(write(), Err(Error::Busy)));
        assert!(matches!(
            limits.admit(RequestClass::Write),
            Err(Error::Busy)
        ));
        assert!(limits.admit(RequestClass::Safety).is_ok());
        let all_memory = take(
            &limits.0.small_bodies_kib,
            limits.0.small_bodies_kib.available_permits(),
        );
        assert!(matches!(
            limits.body(RequestClass::Read, None),
            Err(Error::Busy)
        ));
        let mut reason = limits.body(RequestClass::Safety, None).unwrap();
        reason.grow(MAX_SAFETY_BYTES).unwrap();
        assert!(matches!(
            reason.grow(MAX_SAFETY_BYTES + 1),
            Err(Error::TooLarge { .. })
        ));
        drop(all_memory);
        let reserve: Vec<_> = (0..SAFETY_RESERVE)
            .map(|_| limits.safety().unwrap())
            .collect();
        assert!(matches!(limits.safety(), Err(Error::Busy)));
        assert!(
            limits.admit(RequestClass::Read).is_ok()
                && limits.admit(RequestClass::Calculation).is_ok(),
            "what reads has its own"
        );
        drop((held, reserve));
        assert_eq!(limits.0.writes.available_permits(), MAX_WRITES);
    }

    #[tokio::test]
    async fn a_computation_keeps_its_permit_when_its_client_goes_away() {
        let limits = limits();
        let semaphore = &limits.0.computing[2];
        let all = semaphore.available_permits();
        let (begun, has_begun) = tokio::sync::oneshot::channel();
        let (end, ends) = std::sync::mpsc::channel::<()>();
        let permit = limits.compute(RequestClass::Safety).await.unwrap();
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
        assert_eq!(semaphore.available_permits(), all - 1);
        drop(end);
        let _all_again = semaphore.acquire_many(all as u32).await.unwrap();
        assert!(take(semaphore, 1).is_err());
    }
}
