//! The tokio runtime of commands that wait for a server or a database.

use std::time::Duration;

/// Longest wait for running computations when a command ends. Then they are abandoned; their jobs were already handed back to the queue.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Runs a future to its end.
pub fn block_on<T>(work: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    let result = runtime.block_on(work);
    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
    result
}
