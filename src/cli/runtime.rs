//! The runtime under commands that wait for a server or a database.

use std::time::Duration;

/// Computations that are still at work when a command ends are left behind after this long: their jobs have been handed back.
const LEAVE_BEHIND_AFTER: Duration = Duration::from_secs(1);

/// Runs something asynchronous to its end.
pub fn block_on<T>(work: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    let result = runtime.block_on(work);
    runtime.shutdown_timeout(LEAVE_BEHIND_AFTER);
    result
}
