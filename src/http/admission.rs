//! Limits: how much may be under way at once, and how often a key or a peer may ask. What is over a limit is refused at once,
//! with `Retry-After`, before it costs anything.

use crate::config::LimitsConfig;
use crate::http::accept::Peer;
use crate::http::auth::Caller;
use crate::http::buckets::Buckets;
use crate::http::class::{Asker, Class};
use crate::http::shares::{Room, Shares, take};
use crate::http::turns::{ASKER, Lines};
use crate::http::{App, Error, MAX_BODY_BYTES, answers};
use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;

/// Reads under way: at 0.1 ms each on two cores the last one waits some 15 ms.
const MAX_READS: usize = 256;
/// Writes under way, counted from when their body is here: at 1,000 a second the last one waits some 130 ms.
pub const MAX_WRITES: usize = 128;
/// Of what ends something: kept free for when no more writes fit, and of it for one key.
const RESERVED_ENDINGS: (usize, usize) = (16, 8);
/// Longest body of what ends something: a reason of 2,000 characters, each of them escaped.
const MAX_ENDING_BYTES: usize = 64 * 1024;
/// Long polls and event streams that wait at the same time, and those of one key.
const WAITING: (usize, usize) = (2_048, 1_024);
/// Bodies up to this size share [`SMALL_BODIES_KIB`]; larger ones need one of [`LARGE_BODIES`]. A set of 60 poses has 6 KiB.
pub const LARGE_BODY_BYTES: usize = 1024 * 1024;
/// All small bodies in memory together.
const SMALL_BODIES_KIB: usize = 64 * 1024;
/// Large bodies in memory at once, each up to [`MAX_BODY_BYTES`].
const LARGE_BODIES: usize = 2;
/// All bodies that are only computed from, and those of one key: what reads takes no room from uploads. One of the largest fits.
const COMPUTATION_BODIES_KIB: (usize, usize) = (48 * 1024, MAX_BODY_BYTES / 1024);
/// All large answers in memory that are not sent yet, and those of one key. A report of 100,000 points has 45 MiB.
const ANSWERS_KIB: (usize, usize) = (64 * 1024, 32 * 1024);
/// Documents that are read from the database at once to be answered whole, and of one key: each takes three times its size meanwhile.
const WHOLE_DOCUMENTS: (usize, usize) = (2, 1);
/// Requests for such documents under way, and those of one key: fewer than reads may be.
const WHOLE_DOCUMENTS_ADMITTED: (usize, usize) = (128, 32);
/// Last parts of the paths that answer one.
const OF_WHOLE_DOCUMENTS: [&str; 4] = ["/points", "/weights", "/report", "/convergence"];
/// Failed attempts of one address before the answer is 429 instead of 401, and how many are forgiven each second.
const FAILED_ATTEMPTS: (f64, f64) = (20.0, 0.5);

/// The limits of one server.
#[derive(Clone, Debug)]
pub struct Limits(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    reads: Arc<Semaphore>,
    writes: Arc<Semaphore>,
    waiting: Shares,
    small_bodies_kib: Arc<Semaphore>,
    large_bodies: Arc<Semaphore>,
    computation_bodies_kib: Shares,
    endings: Shares,
    answers_kib: Shares,
    whole_documents_admitted: Shares,
    whole_documents: Shares,
    lines: Lines,
    client_timeout: Duration,
    per_key: Option<Buckets<String>>,
    failures: Buckets<IpAddr>,
}

impl Limits {
    /// Nothing under way, nothing remembered. `no_auth` lifts the limits per key.
    pub fn new(config: &LimitsConfig, no_auth: bool) -> Self {
        let rate = f64::from(config.rate_per_key);
        let per_key = (!no_auth && config.rate_per_key > 0).then(|| Buckets::new(2.0 * rate, rate));
        let shares = |(all, per_key)| Shares::new(all, if no_auth { all } else { per_key });
        Self(Arc::new(Inner {
            reads: Arc::new(Semaphore::new(MAX_READS)),
            writes: Arc::new(Semaphore::new(MAX_WRITES)),
            waiting: shares(WAITING),
            small_bodies_kib: Arc::new(Semaphore::new(SMALL_BODIES_KIB)),
            large_bodies: Arc::new(Semaphore::new(LARGE_BODIES)),
            computation_bodies_kib: shares(COMPUTATION_BODIES_KIB),
            endings: shares(RESERVED_ENDINGS),
            answers_kib: shares(ANSWERS_KIB),
            whole_documents_admitted: shares(WHOLE_DOCUMENTS_ADMITTED),
            whole_documents: shares(WHOLE_DOCUMENTS),
            lines: Lines::new(MAX_WRITES, RESERVED_ENDINGS.0, no_auth),
            client_timeout: config.client_timeout(),
            per_key,
            failures: Buckets::new(FAILED_ATTEMPTS.0, FAILED_ATTEMPTS.1),
        }))
    }

    /// How long a client may be silent.
    pub fn client_timeout(&self) -> Duration {
        self.0.client_timeout
    }

    /// What more may be under way, by kind: requests, and KiB of bodies and answers.
    pub fn room_left(&self) -> [(&'static str, usize); 9] {
        let all = &self.0;
        [
            ("reads", all.reads.available_permits()),
            ("writes", all.writes.available_permits()),
            ("endings", all.endings.left()),
            ("computations", all.lines.room_to_read()),
            ("waiting", all.waiting.left()),
            ("small_bodies_kib", all.small_bodies_kib.available_permits()),
            ("large_bodies", all.large_bodies.available_permits()),
            ("computation_bodies_kib", all.computation_bodies_kib.left()),
            ("answers_kib", all.answers_kib.left()),
        ]
    }

    /// Who computes when.
    pub fn lines(&self) -> &Lines {
        &self.0.lines
    }

    /// Room for a key to wait for a job, e.g. for the life of an event stream.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn wait(&self, holder: &str) -> Result<Room, Error> {
        self.0.waiting.take(holder, 1)
    }

    /// One more request of this key.
    ///
    /// # Errors
    /// [`Error::RateLimited`].
    pub fn count(&self, caller: &Caller) -> Result<(), Error> {
        let allowed = self
            .0
            .per_key
            .as_ref()
            .is_none_or(|buckets| buckets.take(&caller.holder));
        if allowed {
            Ok(())
        } else {
            Err(Error::RateLimited("this key sends too many requests"))
        }
    }

    /// Notes a request whose key is not known. Only such requests are ever refused for it: a good key works from any address.
    ///
    /// # Errors
    /// [`Error::RateLimited`] after too many.
    pub fn failed_attempt(&self, peer: Option<Peer>) -> Result<(), Error> {
        let address = peer.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |peer| peer.0);
        if self.0.failures.take(&address) {
            Ok(())
        } else {
            Err(Error::RateLimited("too many attempts without a valid key"))
        }
    }

    /// Whether one more request of this class could begin now. Decides nothing: what is let through is counted when its body is here.
    pub fn has_room(&self, class: Class) -> bool {
        let writes = self.0.writes.available_permits() > 0;
        match class {
            Class::Read => true,
            Class::Computation => self.0.lines.room_to_read() > 0,
            Class::Ending => writes || self.0.endings.left() > 0,
            Class::Write => writes,
        }
    }

    /// Room for a body that begins to arrive.
    ///
    /// # Errors
    /// [`Error::Busy`] if as much is under way already.
    pub fn body(&self, asker: &Asker, declared_bytes: Option<usize>) -> Result<BodyRoom, Error> {
        if !self.has_room(asker.class) {
            return Err(Error::Busy);
        }
        let mut room = BodyRoom {
            limits: self.clone(),
            asker: asker.clone(),
            reserved_bytes: 0,
            held: Vec::new(),
            is_reserve: false,
        };
        room.grow(
            declared_bytes
                .filter(|bytes| *bytes > LARGE_BODY_BYTES)
                .unwrap_or(1),
        )?;
        Ok(room)
    }

    /// Room among the writes; where there is none, what ends something has a reserve.
    fn ending(&self, holder: &str) -> Result<Room, Error> {
        take(&self.0.writes, 1).or_else(|_| self.0.endings.take(holder, 1))
    }
}

/// Memory that is set aside for one body, until it is dropped.
#[derive(Debug)]
pub struct BodyRoom {
    limits: Limits,
    asker: Asker,
    reserved_bytes: usize,
    held: Vec<Room>,
    /// Whether the reserve for endings has been taken: it counts as a write, too.
    is_reserve: bool,
}

impl BodyRoom {
    /// Makes room for a body of this size. It grows with what came, not with what was announced: announcing is free.
    ///
    /// # Errors
    /// [`Error::Busy`], [`Error::TooLarge`].
    pub fn grow(&mut self, to_bytes: usize) -> Result<(), Error> {
        if to_bytes <= self.reserved_bytes {
            return Ok(());
        }
        // Doubling, so that a body takes few permits.
        let size = to_bytes
            .max(2 * self.reserved_bytes)
            .next_multiple_of(8 * 1024);
        match self.asker.class {
            Class::Computation => self.grow_computation(size.min(MAX_BODY_BYTES)),
            Class::Ending => self.grow_ending(to_bytes),
            Class::Write | Class::Read if to_bytes > LARGE_BODY_BYTES => {
                let large = take(&self.limits.0.large_bodies, 1)?;
                self.held = vec![large];
                self.reserved_bytes = MAX_BODY_BYTES;
                Ok(())
            }
            Class::Write | Class::Read => {
                let size = size.min(LARGE_BODY_BYTES);
                self.held.push(take(
                    &self.limits.0.small_bodies_kib,
                    (size - self.reserved_bytes).div_ceil(1024),
                )?);
                self.reserved_bytes = size;
                Ok(())
            }
        }
    }

    fn grow_computation(&mut self, size: usize) -> Result<(), Error> {
        let more_kib = (size - self.reserved_bytes).div_ceil(1024);
        self.held.push(
            self.limits
                .0
                .computation_bodies_kib
                .take(&self.asker.holder, more_kib)?,
        );
        self.reserved_bytes = size;
        Ok(())
    }

    /// All at once, from what bodies share or from the reserve.
    fn grow_ending(&mut self, to_bytes: usize) -> Result<(), Error> {
        if to_bytes > MAX_ENDING_BYTES {
            return Err(Error::TooLarge {
                limit: MAX_ENDING_BYTES,
                advice: "shorten the reason",
            });
        }
        let shared = take(&self.limits.0.small_bodies_kib, MAX_ENDING_BYTES / 1024);
        self.is_reserve = shared.is_err();
        self.held
            .push(shared.or_else(|_| self.limits.0.endings.take(&self.asker.holder, 1))?);
        self.reserved_bytes = MAX_ENDING_BYTES;
        Ok(())
    }

    /// The body is here: now what writes counts among the writes.
    ///
    /// # Errors
    /// [`Error::Busy`].
    pub fn arrived(mut self) -> Result<Vec<Room>, Error> {
        match self.asker.class {
            Class::Computation => {}
            Class::Ending if self.is_reserve => {}
            Class::Ending => self.held.push(self.limits.ending(&self.asker.holder)?),
            Class::Write | Class::Read => self.held.push(take(&self.limits.0.writes, 1)?),
        }
        Ok(self.held)
    }
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
    let template = request
        .extensions()
        .get::<MatchedPath>()
        .map_or("", MatchedPath::as_str);
    match (request.method(), template) {
        (_, "/healthz" | "/readyz" | "/metrics") => None,
        (&Method::POST, _) => None,
        _ if may_wait(request) => None,
        _ => Some(&limits.0.reads),
    }
}

/// Whether a request may be a long poll, however its query is written: those have room of their own, see [`ask`].
fn may_wait(request: &Request) -> bool {
    let is_of_job = request
        .extensions()
        .get::<MatchedPath>()
        .is_some_and(|path| path.as_str() == "/v1/jobs/{id}");
    is_of_job && request.method() == Method::GET && request.uri().query().is_some()
}

/// Says further in who asks for what, and counts what has no body and what is large of the answers. Comes after authentication: what is
/// kept for some is taken by nobody without a key.
pub async fn ask(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let class = Class::of(request.method(), request.uri().path());
    let holder = request
        .extensions()
        .get::<Caller>()
        .map(|caller| caller.holder.clone())
        .unwrap_or_default();
    let has_no_body = request
        .extensions()
        .get::<MatchedPath>()
        .is_some_and(|path| path.as_str() == "/v1/jobs/{id}/cancel");
    let counted = (class == Class::Ending && has_no_body)
        .then(|| app.limits.ending(&holder))
        .transpose();
    let counted = counted.and_then(|ending| {
        Ok((
            ending,
            may_wait(&request)
                .then(|| app.limits.wait(&holder))
                .transpose()?,
        ))
    });
    let is_whole = class == Class::Read
        && OF_WHOLE_DOCUMENTS
            .iter()
            .any(|end| request.uri().path().ends_with(end));
    // Those that wait hold room of reads, which no key may have all of.
    let admitted = is_whole
        .then(|| app.limits.0.whole_documents_admitted.take(&holder, 1))
        .transpose();
    let _turn = if is_whole && admitted.is_ok() {
        app.limits.0.whole_documents.wait(&holder).await.ok()
    } else {
        None
    };
    let counted = counted.and_then(|counted| Ok((counted, admitted?)));
    let asker = Asker { class, holder };
    request.extensions_mut().insert(asker.clone());
    let response = match &counted {
        Ok(_) => ASKER.scope(asker.clone(), next.run(request)).await,
        Err(_) => Error::Busy.into_response(),
    };
    answers::account(
        response,
        &app.limits.0.answers_kib,
        &asker.holder,
        app.limits.client_timeout(),
    )
    .await
}

#[cfg(test)]
mod tests {
    use super::{
        LARGE_BODIES, LARGE_BODY_BYTES, Limits, MAX_ENDING_BYTES, MAX_WRITES, RESERVED_ENDINGS,
    };
    use crate::config::LimitsConfig;
    use crate::http::class::{Asker, Class};
    use crate::http::{Error, MAX_BODY_BYTES};

    fn asker(class: Class) -> Asker {
        Asker {
            class,
            holder: "a".into(),
        }
    }

    #[test]
    fn bodies_take_room_as_they_grow_and_give_it_back() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let free = limits.0.small_bodies_kib.available_permits();
        let mut room = limits
            .body(&asker(Class::Write), Some(MAX_BODY_BYTES))
            .unwrap();
        assert_eq!(
            limits.0.large_bodies.available_permits(),
            LARGE_BODIES - 1,
            "an announced large body takes its place at once"
        );
        room.grow(MAX_BODY_BYTES).unwrap();
        drop(room);
        let mut room = limits.body(&asker(Class::Write), None).unwrap();
        room.grow(LARGE_BODY_BYTES).unwrap();
        assert_eq!(
            free - limits.0.small_bodies_kib.available_permits(),
            LARGE_BODY_BYTES / 1024
        );
        room.grow(LARGE_BODY_BYTES + 1).unwrap();
        assert_eq!(limits.0.small_bodies_kib.available_permits(), free);
        drop(room);
        assert_eq!(limits.0.large_bodies.available_permits(), LARGE_BODIES);
    }

    #[test]
    fn a_large_body_too_many_is_refused_at_once() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let _rooms: Vec<_> = (0..LARGE_BODIES)
            .map(|_| {
                limits
                    .body(&asker(Class::Write), Some(MAX_BODY_BYTES))
                    .unwrap()
            })
            .collect();
        assert!(matches!(
            limits.body(&asker(Class::Write), Some(MAX_BODY_BYTES)),
            Err(Error::Busy)
        ));
        assert!(
            limits.body(&asker(Class::Write), Some(6_000)).is_ok(),
            "small ones go on"
        );
    }

    #[test]
    fn what_ends_something_has_room_where_writes_and_bodies_have_none() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let arrive = |class| {
            limits
                .body(&asker(class), None)
                .and_then(super::BodyRoom::arrived)
        };
        let mut held: Vec<_> = (0..MAX_WRITES)
            .map(|_| arrive(Class::Write).unwrap())
            .collect();
        assert!(!limits.has_room(Class::Write) && matches!(arrive(Class::Write), Err(Error::Busy)));
        held.push(vec![
            super::take(
                &limits.0.small_bodies_kib,
                limits.0.small_bodies_kib.available_permits(),
            )
            .unwrap(),
        ]);
        let share = RESERVED_ENDINGS.1;
        held.extend((0..share).map(|i| {
            if i % 2 == 0 {
                arrive(Class::Ending).unwrap()
            } else {
                vec![limits.ending("a").unwrap()]
            }
        }));
        assert!(
            matches!(arrive(Class::Ending), Err(Error::Busy)),
            "a key has its share"
        );
        assert!(
            limits.has_room(Class::Ending) && limits.ending("b").is_ok(),
            "another key has its own"
        );
        let too_large = limits.body(
            &Asker {
                holder: "b".into(),
                ..asker(Class::Ending)
            },
            Some(2 * LARGE_BODY_BYTES),
        );
        assert!(matches!(
            too_large,
            Err(Error::TooLarge {
                limit: MAX_ENDING_BYTES,
                ..
            })
        ));
        assert!(arrive(Class::Computation).is_ok(), "what reads has its own");
        drop(held);
        assert_eq!(limits.0.writes.available_permits(), MAX_WRITES);
    }

    #[test]
    fn bodies_that_are_computed_from_take_nothing_from_uploads() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let before = limits.room_left();
        let mut room = limits
            .body(&asker(Class::Computation), Some(MAX_BODY_BYTES))
            .unwrap();
        room.grow(MAX_BODY_BYTES).unwrap();
        assert!(
            matches!(
                limits.body(&asker(Class::Computation), None),
                Err(Error::Busy)
            ),
            "the key's share is taken"
        );
        assert!(
            limits
                .body(
                    &Asker {
                        holder: "b".into(),
                        ..asker(Class::Computation)
                    },
                    None
                )
                .is_ok()
        );
        let held = room.arrived().unwrap();
        let taken: Vec<_> = before
            .iter()
            .zip(limits.room_left())
            .filter(|(before, now)| before.1 != now.1)
            .map(|(kind, _)| kind.0)
            .collect();
        assert_eq!(taken, ["computation_bodies_kib"]);
        drop(held);
        assert_eq!(limits.room_left(), before);
    }
}
