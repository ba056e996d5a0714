//! The only place in the core that starts threads. It is used for swarms so large that one core would be the bottleneck of a job.
//!
//! The result of a thread does not depend on the other threads or on their number, and nothing is summed across threads. The results are therefore
//! the same to the last bit on any number of cores. Threads end before the call returns.

use std::thread;

/// Cores of this machine that this process may use.
pub fn n_cores() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Runs all work items in parallel, the first one on this thread.
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
