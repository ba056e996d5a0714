//! Who computes when. What computes waits in one of three lines, so that neither those who only read nor a flood of uploads keep a bad
//! parameter set in force. Each line is bounded: beyond it the answer is 503.

use crate::http::Error;
use crate::http::class::{Asker, Class};
use crate::http::shares::{Room, Shares};
use crate::store::aside;

/// Computing for writes at the same time; more only makes each slower and memory larger.
const WRITING: usize = 8;
/// Computing for reads at the same time, and of it for one key: plans of 300 configurations take six seconds each.
const READING: (usize, usize) = (8, 4);
/// Computing or waiting to, for reads, and of it for one key: fewer than reads may be under way.
const READING_ADMITTED: (usize, usize) = (128, 32);
/// Computing for what ends something.
const ENDING: usize = 2;

tokio::task_local! {
    /// Who sent the request that this task works on.
    pub static ASKER: Asker;
}

/// The lines of one server.
#[derive(Debug)]
pub struct Lines {
    writing: Line,
    reading: Line,
    ending: Line,
}

#[derive(Debug)]
struct Line {
    admitted: Shares,
    running: Shares,
}

impl Line {
    fn new(admitted: (usize, usize), running: (usize, usize)) -> Self {
        Self {
            admitted: Shares::new(admitted.0, admitted.1),
            running: Shares::new(running.0, running.1),
        }
    }
}

impl Lines {
    /// Nobody computes. `max_writes` may be under way, endings among them, and `max_endings` more; with `no_auth` all are one key, and it
    /// has everything.
    pub fn new(max_writes: usize, max_endings: usize, no_auth: bool) -> Self {
        let shared = |(all, per_key)| (all, if no_auth { all } else { per_key });
        let even = |n| (n, n);
        Self {
            writing: Line::new(even(max_writes), even(WRITING)),
            reading: Line::new(shared(READING_ADMITTED), shared(READING)),
            ending: Line::new(even(max_writes + max_endings), even(ENDING)),
        }
    }

    /// How many more that read may compute or wait to.
    pub fn room_to_read(&self) -> usize {
        self.reading.admitted.left()
    }

    /// A turn to compute, for the request that this task works on.
    ///
    /// # Errors
    /// [`Error::Busy`] if too many wait already.
    pub async fn turn(&self) -> Result<Turn, Error> {
        let (class, holder) = ASKER
            .try_with(|asker| (asker.class, asker.holder.clone()))
            .unwrap_or((Class::Read, String::new()));
        let line = match class {
            Class::Read | Class::Computation => &self.reading,
            Class::Ending => &self.ending,
            Class::Write => &self.writing,
        };
        let admitted = line.admitted.take(&holder, 1)?;
        Ok(Turn {
            _admitted: admitted,
            _running: line.running.wait(&holder).await?,
        })
    }
}

/// One's turn to compute, until it is dropped.
#[derive(Debug)]
pub struct Turn {
    _admitted: Room,
    _running: Room,
}

impl Turn {
    /// Runs something that computes, here and now, for to wake another thread and to be woken by it takes as long as most of it. This thread's
    /// other tasks go to another one meanwhile. Where the client has gone away it still comes to its end, and keeps its turn so long.
    pub fn run<T>(&self, work: impl FnOnce() -> T) -> T {
        aside(work)
    }

    /// As [`Turn::run`], or as it is, where that is known to be over sooner than another thread has woken.
    pub fn run_soon<T>(&self, is_short: bool, work: impl FnOnce() -> T) -> T {
        if is_short { work() } else { self.run(work) }
    }
}
