//! The worker pool and its signals, on each engine: events that must happen within a time, and at once instead of at the next poll.

mod pool;
mod signals;
