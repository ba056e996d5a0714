//! Computations on blocking threads.

use tokio::task::{JoinError, spawn_blocking};

/// Runs `work` on a blocking thread. The thread holds a clone of `permit` until `work` ends, even if the caller no longer waits.
///
/// # Errors
/// If the runtime stops before `work` begins.
///
/// # Panics
/// If `work` does.
pub async fn run<T: Send + 'static>(
    permit: &(impl Clone + Send + 'static),
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, JoinError> {
    let permit = permit.clone();
    let done = spawn_blocking(move || {
        let _permit = permit;
        work()
    })
    .await;
    done.or_else(|error| match error.try_into_panic() {
        Ok(panic) => std::panic::resume_unwind(panic),
        Err(stopped) => Err(stopped),
    })
}
