//! The pool of workers and its signals, on each engine: what must happen within a time, and at once rather than at the next poll.

mod pool;
mod signals;
