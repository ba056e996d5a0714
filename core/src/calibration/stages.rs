//! Stages of a calibration, as the monitor sees them.

use crate::calibration::{Error, Event, Monitor};
use crate::solvers::watch::Watch;
use std::cell::RefCell;
use std::ops::ControlFlow;

/// Runs one stage between its two events.
pub fn stage<T>(
    monitor: &mut Monitor<'_>,
    name: &str,
    run: impl FnOnce(&mut Monitor<'_>) -> Result<T, Error>,
) -> Result<T, Error> {
    tell(monitor, Event::StageStarted(name))?;
    let result = run(monitor)?;
    tell(monitor, Event::StageEnded(name))?;
    Ok(result)
}

fn tell(monitor: &mut Monitor<'_>, event: Event<'_>) -> Result<(), Error> {
    if monitor(event).is_break() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}

/// Runs code that asks the watch from time to time whether to stop.
///
/// # Errors
/// [`Error::Cancelled`] if the monitor broke. The result of `run` is then incomplete and is discarded.
pub fn watched<T>(
    monitor: &mut Monitor<'_>,
    run: impl FnOnce(&Watch<'_>) -> T,
) -> Result<T, Error> {
    let monitor = RefCell::new(monitor);
    let ask = || monitor.borrow_mut()(Event::Heartbeat).is_continue();
    let watch = Watch::new(&ask);
    let result = run(&watch);
    match watch.was_stopped() {
        true => Err(Error::Cancelled),
        false => Ok(result),
    }
}

/// A monitor for later stages. Their iterations are passed on as heartbeats, because they are not progress of the main method.
pub fn quiet<'m>(monitor: &'m mut Monitor<'_>) -> impl FnMut(Event<'_>) -> ControlFlow<()> + 'm {
    |event| match event {
        Event::Iteration { .. } => monitor(Event::Heartbeat),
        event => monitor(event),
    }
}
