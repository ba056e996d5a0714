//! The only place of the core that starts threads: for swarms so large that one core would be the bottleneck of a job.
//!
//! What a thread computes does not depend on the others or on how many there are, and nothing is added across threads: the bits are the
//! same on any number of cores. Threads end before the call returns.

use std::thread;

/// Cores of this machine that this process may use.
pub fn n_cores() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Does all of it, the first on this thread.
pub fn in_parallel<F: FnOnce() + Send>(mut work: impl Iterator<Item = F>) {
    let (first, second) = (work.next(), work.next());
    let on_this_thread = || first.into_iter().for_each(|first| first());
    if second.is_none() {
        return on_this_thread();
    }
    thread::scope(|scope| {
        for other in second.into_iter().chain(work) {
            scope.spawn(other);
        }
        on_this_thread();
    });
}
