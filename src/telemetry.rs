//! Logs on standard error: text at a terminal, otherwise JSON.

use std::io::IsTerminal;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Starts logging, once per process. `KINCAL_LOG` sets levels by target, such as `info,kincal::jobs=debug`; the default is `info`.
pub fn start() {
    let asked = std::env::var("KINCAL_LOG").ok();
    let filter = asked.and_then(|levels| levels.parse::<Targets>().ok());
    let filter = filter.unwrap_or_else(|| Targets::new().with_default(LevelFilter::INFO));
    let layer = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_target(false);
    // A failed write of a log line must not end the server: reporting it on standard error would panic.
    let layer = layer.log_internal_errors(false);
    let registry = tracing_subscriber::registry().with(filter);
    // A second start, e.g. by several servers in one test process, keeps the first.
    let started = if std::io::stderr().is_terminal() {
        registry.with(layer).try_init()
    } else {
        registry.with(layer.json().flatten_event(true)).try_init()
    };
    drop(started);
}
