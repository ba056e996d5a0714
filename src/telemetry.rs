//! Logs: text for people at a terminal, JSON for everything else, always on standard error.

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// Starts logging once per process. `KINCAL_LOG` takes filters such as `kincal=debug`; default `info`.
pub fn start() {
    let filter = EnvFilter::try_from_env("KINCAL_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false);
    // A log that cannot be written must not end what it tells of: told on standard error, it would.
    let builder = builder.log_internal_errors(false);
    // A second start, e.g. by several servers in one test process, keeps the first.
    let started = if std::io::stderr().is_terminal() {
        builder.try_init()
    } else {
        builder.json().flatten_event(true).try_init()
    };
    drop(started);
}
