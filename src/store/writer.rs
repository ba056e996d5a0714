//! Group commit on SQLite: writers that wait at the same moment share one transaction, and so one fsync.
//!
//! The first writer opens the transaction. Who is done while others wait leaves the group open to them, and puts its end behind all who wait
//! already; who is done while nobody waits ends it at once. Each writer works behind a savepoint, which moves on when the next one joins, so
//! that one can fail without the others; none is answered before the common commit. A client that goes away in the middle leaves no half-open
//! transaction: between two statements of this module there is nothing to wait for, and an end that others wait for is a task of its own.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use futures_util::FutureExt;
use sqlx::FromRow;
use tokio::runtime::Handle;
use tokio::sync::{Mutex, OwnedMutexGuard, oneshot};
use tokio::time::Instant;

use super::audit::{self, AuditHead, AuditRow, Note};
use super::connection::Connection as On;
use super::sqlite::{Connection, Pool, aside};
use super::{Error, Result};

/// The one writer of a SQLite database.
#[derive(Clone, Debug)]
pub(super) struct Writer {
    pool: Arc<Pool>,
    state: Arc<Mutex<State>>,
    /// Writers that wait for the state.
    n_waiting: Arc<AtomicUsize>,
    /// Where the ends of groups run: it has to outlive all who wait for them.
    runtime: Handle,
}

#[derive(Debug, Default)]
struct State {
    group: Option<Group>,
    /// The connection of the last group, for the next one. The writers' own: readers' connections forget the pages that they know when another
    /// one has written.
    idle: Option<Connection>,
    /// When opening a group failed last: those who waited then need not find out for themselves.
    failed: Option<(Instant, Arc<sqlx::Error>)>,
}

/// An open transaction, and those who wait for its end.
#[derive(Debug)]
struct Group {
    connection: Connection,
    /// Where the audit chain ends with the members so far.
    head: AuditHead,
    /// The members' entries in it, written as the last act.
    entries: Vec<AuditRow>,
    /// Whether what the last member did is to stay: the savepoint stands before it still.
    is_kept: bool,
    /// Those who are done. While there are any, the group's end stands in line.
    waiting: Vec<oneshot::Sender<Verdict>>,
}

type Verdict = Result<(), Arc<sqlx::Error>>;

/// One writer's share of a group. Dropped, it is undone.
#[derive(Debug)]
pub(super) struct Member {
    writer: Writer,
    /// Holds the group; none once this member is done.
    state: Option<OwnedMutexGuard<State>>,
}

const ENTER: &[&str] = &["savepoint member"];
const NEXT: &[&str] = &["release member", "savepoint member"];
const UNDO: &[&str] = &["rollback to member"];
const LEAVE: &[&str] = &["release member"];
const COMMIT: &[&str] = &["commit"];
const ABANDON: &[&str] = &["rollback"];

impl Writer {
    /// For the runtime of the caller, which has to outlive all others who write.
    pub(super) fn new(pool: Arc<Pool>) -> Self {
        Self {
            pool,
            state: Arc::default(),
            n_waiting: Arc::default(),
            runtime: Handle::current(),
        }
    }

    /// Closes the writers' connection. The pool has to be closed already, or another one is opened when it is needed.
    pub(super) async fn close(&self) {
        let connection = self.state.lock().await.idle.take();
        // the last connection folds the log into the database's file, which may take long
        let _ = self.runtime.spawn_blocking(|| drop(connection)).await;
    }

    /// Waits for its turn in the group that is open, or opens one.
    pub(super) async fn join(&self) -> Result<Member> {
        let asked = Instant::now();
        let mut state = {
            let _one_more = Counted::one_more(&self.n_waiting);
            Arc::clone(&self.state).lock_owned().await
        };
        if state.group.is_none() {
            if let Some((_, error)) = state.failed.as_ref().filter(|(when, _)| *when > asked) {
                return Err(Error::NotCommitted(Arc::clone(error)));
            }
            match open(&self.pool, state.idle.take()) {
                Ok(group) => state.group = Some(group),
                Err(Error::Database(error)) => {
                    let error = Arc::new(error);
                    state.failed = Some((Instant::now(), Arc::clone(&error)));
                    return Err(Error::NotCommitted(error));
                }
                Err(error) => return Err(error),
            }
        }
        step_over_what_is_kept(&mut state)?;
        Ok(Member {
            writer: self.clone(),
            state: Some(state),
        })
    }

    /// Ends the group, or leaves it to those who wait and waits with them for its end.
    async fn leave(&self, mut state: OwnedMutexGuard<State>) -> Result<()> {
        if self.n_waiting.load(Ordering::SeqCst) == 0 {
            return self.end(&mut state).await;
        }
        let Some(group) = state.group.as_mut() else {
            return Err(broken());
        };
        let (sender, verdict) = oneshot::channel();
        if group.waiting.is_empty() {
            let (writer, mut turn) = (self.clone(), Box::pin(Arc::clone(&self.state).lock_owned()));
            // asked once, it stands in line behind those who wait already
            let held_here = (&mut turn).now_or_never().is_none();
            debug_assert!(held_here, "nobody else has the state");
            self.runtime
                .spawn(async move { writer.end(&mut *turn.await).await });
        }
        group.waiting.push(sender);
        drop(state);
        match verdict.await {
            Ok(verdict) => verdict.map_err(Error::NotCommitted),
            Err(_) => Err(broken()),
        }
    }

    /// Commits the group, if there is one still, and tells everybody in it.
    async fn end(&self, state: &mut State) -> Result<()> {
        let Some(mut group) = state.group.take() else {
            return Err(broken());
        };
        match group.commit().await {
            Ok(()) => {
                tell(&mut group.waiting, &Ok(()));
                state.idle = Some(group.connection).filter(|_| !self.pool.is_closed());
                Ok(())
            }
            Err(error) => Err(Error::NotCommitted(group.fail(error))),
        }
    }
}

/// One of those who wait, until it is dropped.
struct Counted<'a>(&'a AtomicUsize);

impl<'a> Counted<'a> {
    fn one_more(all: &'a AtomicUsize) -> Self {
        all.fetch_add(1, Ordering::SeqCst);
        Self(all)
    }
}

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Fails with its connection: the transaction may be open.
fn open(pool: &Pool, idle: Option<Connection>) -> Result<Group> {
    let mut connection = idle
        .filter(|_| !pool.is_closed())
        .map_or_else(|| pool.connect(), Ok)?;
    connection.begin_to_write(pool.patience())?;
    connection.run_all(ENTER)?;
    let begun = connection.run(audit::HEAD, None, 1)?;
    let head = AuditHead::from_row(begun.rows.first().ok_or(sqlx::Error::RowNotFound)?)?;
    Ok(Group {
        connection,
        head,
        entries: Vec::new(),
        is_kept: false,
        waiting: Vec::new(),
    })
}

impl Group {
    async fn commit(&mut self) -> Result<()> {
        // The savepoint first: it fails where the engine has given up the transaction, and entries would be written by themselves.
        self.connection.run_all(LEAVE)?;
        audit::write(On::sqlite(&mut self.connection), &self.entries).await?;
        Ok(aside(|| self.connection.run_all(COMMIT))?)
    }

    /// The transaction is not to be trusted any more: it goes down with its connection.
    fn fail(mut self, error: Error) -> Arc<sqlx::Error> {
        let error = match error {
            Error::Database(error) => Arc::new(error),
            Error::NotCommitted(error) => error,
            other => Arc::new(sqlx::Error::Protocol(other.to_string())),
        };
        drop(self.connection);
        tell(&mut self.waiting, &Err(Arc::clone(&error)));
        error
    }
}

fn tell(waiting: &mut Vec<oneshot::Sender<Verdict>>, verdict: &Verdict) {
    for waiting in waiting.drain(..) {
        // Nobody listens where the client has gone.
        let _ = waiting.send(verdict.clone());
    }
}

impl Member {
    pub(super) fn connection(&mut self) -> Option<&mut Connection> {
        self.state
            .as_mut()?
            .group
            .as_mut()
            .map(|group| &mut group.connection)
    }

    /// Leaves this member's writes and its audit entries to the group, and waits until the group is committed.
    pub(super) async fn commit(mut self, actor: String, notes: Vec<Note>) -> Result<()> {
        // before anything is taken: should this panic, the member is still undone
        let entries = match self.state.as_ref().map(|state| state.group.as_ref()) {
            Some(Some(group)) => audit::entries(&group.head, &actor, notes),
            _ => return Err(broken()),
        };
        let Some(mut state) = self.state.take() else {
            return Err(broken());
        };
        let Some(group) = state.group.as_mut() else {
            return Err(broken());
        };
        if let Some(last) = entries.last() {
            group.head.follow(last);
        }
        group.entries.extend(entries);
        group.is_kept = true;
        self.writer.leave(state).await
    }

    /// Undoes what this member did. What it saw may have been others' writes, so it waits for them too.
    pub(super) async fn rollback(mut self) -> Result<()> {
        match self.undo() {
            Some(state) => self.writer.leave(state).await,
            None => Ok(()),
        }
    }

    /// Back to the savepoint. The group is left to those who wait for it, its end stands in line; where there are none, it is over.
    fn undo(&mut self) -> Option<OwnedMutexGuard<State>> {
        let mut state = self.state.take()?;
        undo(&mut state);
        let Some(mut group) = state.group.take_if(|group| group.waiting.is_empty()) else {
            return Some(state);
        };
        if group.connection.run_all(ABANDON).is_ok() {
            state.idle = Some(group.connection).filter(|_| !self.writer.pool.is_closed());
        }
        None
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        self.undo();
    }
}

/// Puts the savepoint behind everything done so far, or nothing of it would be certain.
fn step_over_what_is_kept(state: &mut State) -> Result<()> {
    let Some(group) = state.group.as_mut().filter(|group| group.is_kept) else {
        return Ok(());
    };
    match group.connection.run_all(NEXT) {
        Ok(()) => {
            group.is_kept = false;
            Ok(())
        }
        Err(error) => {
            let error = Arc::new(error);
            if let Some(group) = state.group.take() {
                group.fail(Error::NotCommitted(Arc::clone(&error)));
            }
            Err(Error::NotCommitted(error))
        }
    }
}

/// Back to the savepoint. If that fails, the engine has given up the whole transaction (disk full, I/O error), and with it all
/// members before.
fn undo(state: &mut State) {
    let Some(group) = state.group.as_mut() else {
        return;
    };
    if let Err(error) = group.connection.run_all(UNDO)
        && let Some(group) = state.group.take()
    {
        group.fail(error.into());
    }
}

fn broken() -> Error {
    Error::NotCommitted(Arc::new(sqlx::Error::WorkerCrashed))
}
