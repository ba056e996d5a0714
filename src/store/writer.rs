//! Group commit on SQLite: writers that wait at the same moment share one transaction, and so one fsync.
//!
//! The first writer opens the transaction and queues its end behind all who wait already; each writer works behind a savepoint, which
//! moves on when the next one joins, so that one can fail without the others; none is answered before the common commit. What is not a writer's
//! own statement runs in a task of its own: a client that goes away in the middle leaves no half-open transaction.

use std::sync::Arc;

use sqlx::{AnyConnection, AnyPool, Connection, FromRow};
use tokio::sync::{Mutex, OwnedMutexGuard, oneshot};
use tokio::time::Instant;

use super::audit::{self, AuditHead, AuditRow, Note};
use super::{Error, Result};

/// The one writer of a SQLite database.
#[derive(Debug)]
pub(super) struct Writer {
    pool: AnyPool,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    group: Option<Group>,
    /// The connection of the last group, for the next one. The writers' own: given back to the pool it would be tried out each time, and the
    /// pages that it knows would be forgotten for what another connection wrote.
    idle: Option<AnyConnection>,
    /// When opening a group failed last: those who waited then need not find out for themselves.
    failed: Option<(Instant, Arc<sqlx::Error>)>,
}

/// An open transaction, and those who wait for its end.
#[derive(Debug)]
struct Group {
    connection: AnyConnection,
    /// Where the audit chain ends with the members so far.
    head: AuditHead,
    /// The members' entries in it, written as the last act.
    entries: Vec<AuditRow>,
    /// Whether what the last member did is to stay: the savepoint stands before it still.
    is_kept: bool,
    waiting: Vec<oneshot::Sender<Verdict>>,
}

type Verdict = Result<(), Arc<sqlx::Error>>;

/// One writer's share of a group. Dropped, it is undone.
#[derive(Debug)]
pub(super) struct Member {
    /// Holds the group; none once this member is done.
    state: Option<OwnedMutexGuard<State>>,
}

// Each execution is a trip to the connection's thread and back, which costs more than most statements: what belongs together goes in one.
// SQLite takes several statements at a time; their $1, $2, … are numbered through.
const BEGIN: &str = concat!("begin immediate; savepoint member; ", audit::head_text!());
const NEXT: &str = "release member; savepoint member";
const UNDO: &str = "rollback to member";
// The savepoint first: it fails where the engine has given up the transaction, and entries would be written by themselves.
const NOTE_AND_COMMIT: &str = concat!("release member; ", audit::insert_all_and_move_head_text!(), "; commit");
const COMMIT: &str = "release member; commit";

impl Writer {
    pub(super) fn new(pool: AnyPool) -> Self {
        Self { pool, state: Arc::default() }
    }

    /// Closes the writers' connection. The pool has to be closed already, or another one is opened when it is needed.
    pub(super) async fn close(&self) {
        if let Some(connection) = self.state.lock().await.idle.take() {
            // what was committed is in the log, whatever happens to the connection
            let _ = connection.close().await;
        }
    }

    /// Waits for its turn in the group that is open, or opens one.
    pub(super) async fn join(&self) -> Result<Member> {
        in_a_task(enter(self.pool.clone(), Arc::clone(&self.state), Instant::now())).await
    }
}

async fn enter(pool: AnyPool, state: Arc<Mutex<State>>, asked: Instant) -> Result<Member> {
    let mut guard = Arc::clone(&state).lock_owned().await;
    if guard.group.is_none() {
        if let Some((_, error)) = guard.failed.as_ref().filter(|(when, _)| *when > asked) {
            return Err(Error::NotCommitted(Arc::clone(error)));
        }
        let idle = guard.idle.take();
        match open(&pool, idle).await {
            Ok(group) => guard.group = Some(group),
            Err(Error::Database(error)) => {
                let error = Arc::new(error);
                guard.failed = Some((Instant::now(), Arc::clone(&error)));
                return Err(Error::NotCommitted(error));
            }
            Err(error) => return Err(error),
        }
        tokio::spawn(async move { end(&mut *state.lock_owned().await, &pool).await });
    }
    step_over_what_is_kept(&mut guard).await?;
    Ok(Member { state: Some(guard) })
}

/// Fails with its connection: the transaction may be open.
async fn open(pool: &AnyPool, idle: Option<AnyConnection>) -> Result<Group> {
    let mut connection = match idle.filter(|_| !pool.is_closed()) {
        Some(connection) => connection,
        None => pool.acquire().await?.detach(),
    };
    let begun = sqlx::query(BEGIN).fetch_all(&mut connection).await?;
    let head = AuditHead::from_row(begun.first().ok_or(sqlx::Error::RowNotFound)?)?;
    Ok(Group { connection, head, entries: Vec::new(), is_kept: false, waiting: Vec::new() })
}

/// Commits the group, if there is one, and tells everybody in it.
async fn end(state: &mut State, pool: &AnyPool) {
    let Some(mut group) = state.group.take() else { return };
    match group.commit().await {
        Ok(()) => {
            tell(&mut group.waiting, &Ok(()));
            state.idle = Some(group.connection).filter(|_| !pool.is_closed());
        }
        Err(error) => group.fail(error),
    }
}

impl Group {
    async fn commit(&mut self) -> Result<()> {
        let query = match self.entries.is_empty() {
            true => sqlx::query(COMMIT),
            false => sqlx::query(NOTE_AND_COMMIT).bind(audit::as_list(&self.entries)?).bind(self.head.seq).bind(&self.head.sha256),
        };
        query.execute(&mut self.connection).await?;
        Ok(())
    }

    /// The transaction is not to be trusted any more: it goes down with its connection.
    fn fail(mut self, error: Error) {
        let error = match error {
            Error::Database(error) => Arc::new(error),
            Error::NotCommitted(error) => error,
            other => Arc::new(sqlx::Error::Protocol(other.to_string())),
        };
        drop(self.connection);
        tell(&mut self.waiting, &Err(error));
    }
}

fn tell(waiting: &mut Vec<oneshot::Sender<Verdict>>, verdict: &Verdict) {
    for waiting in waiting.drain(..) {
        // Nobody listens where the client has gone.
        let _ = waiting.send(verdict.clone());
    }
}

impl Member {
    pub(super) fn connection(&mut self) -> Option<&mut AnyConnection> {
        self.state.as_mut()?.group.as_mut().map(|group| &mut group.connection)
    }

    /// Leaves this member's writes and its audit entries to the group, and waits until the group is committed.
    pub(super) async fn commit(mut self, actor: String, notes: Vec<Note>) -> Result<()> {
        let Some(mut state) = self.state.take() else { return Ok(()) };
        in_a_task(async move {
            let Some(group) = state.group.as_mut() else { return Err(broken()) };
            let entries = audit::entries(&group.head, &actor, notes);
            if let Some(last) = entries.last() {
                group.head.follow(last);
            }
            group.entries.extend(entries);
            group.is_kept = true;
            wait_for_the_group(state).await
        })
        .await
    }

    /// Undoes what this member did. What it saw may have been others' writes, so it waits for them too.
    pub(super) async fn rollback(mut self) -> Result<()> {
        let Some(mut state) = self.state.take() else { return Ok(()) };
        in_a_task(async move {
            undo(&mut state).await;
            wait_for_the_group(state).await
        })
        .await
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        let Some(mut state) = self.state.take() else { return };
        match tokio::runtime::Handle::try_current() {
            Ok(runtime) => drop(runtime.spawn(async move { undo(&mut state).await })),
            Err(_) => {
                if let Some(group) = state.group.take() {
                    group.fail(broken());
                }
            }
        }
    }
}

/// Puts the savepoint behind everything done so far, or nothing of it would be certain.
async fn step_over_what_is_kept(state: &mut State) -> Result<()> {
    let Some(group) = state.group.as_mut().filter(|group| group.is_kept) else { return Ok(()) };
    match sqlx::query(NEXT).execute(&mut group.connection).await {
        Ok(_) => {
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
async fn undo(state: &mut State) {
    let Some(group) = state.group.as_mut() else { return };
    if let Err(error) = sqlx::query(UNDO).execute(&mut group.connection).await
        && let Some(group) = state.group.take()
    {
        group.fail(error.into());
    }
}

async fn wait_for_the_group(mut state: OwnedMutexGuard<State>) -> Result<()> {
    let Some(group) = state.group.as_mut() else { return Err(broken()) };
    let (sender, verdict) = oneshot::channel();
    group.waiting.push(sender);
    drop(state);
    match verdict.await {
        Ok(verdict) => verdict.map_err(Error::NotCommitted),
        Err(_) => Err(broken()),
    }
}

fn broken() -> Error {
    Error::NotCommitted(Arc::new(sqlx::Error::WorkerCrashed))
}

/// Runs to its end even if whoever waits for it goes away.
async fn in_a_task<T: Send + 'static>(work: impl Future<Output = Result<T>> + Send + 'static) -> Result<T> {
    tokio::spawn(work).await.unwrap_or_else(|_| Err(broken()))
}
