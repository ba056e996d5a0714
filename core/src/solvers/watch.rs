//! Cancellation of long computations.

use std::cell::Cell;
use std::ops::ControlFlow;

/// Asks between the parts of a computation whether to continue. After the first "no", the answer stays "no". Loops then end early and their
/// results are not valid, so the caller must check [`Watch::was_stopped`] before using them.
pub struct Watch<'a> {
    ask: Option<&'a dyn Fn() -> bool>,
    is_over: Cell<bool>,
}

impl<'a> Watch<'a> {
    /// A watch that calls `ask`.
    pub fn new(ask: &'a dyn Fn() -> bool) -> Self {
        Self {
            ask: Some(ask),
            is_over: Cell::new(false),
        }
    }

    /// A watch for a computation that is never stopped.
    pub fn nobody() -> Self {
        Self {
            ask: None,
            is_over: Cell::new(false),
        }
    }

    /// Asks whether to go on.
    pub fn goes_on(&self) -> bool {
        if !self.is_over.get() && self.ask.is_some_and(|ask| !ask()) {
            self.is_over.set(true);
        }
        !self.is_over.get()
    }

    /// As [`Self::goes_on`], for the monitor of a solver.
    pub fn flow(&self) -> ControlFlow<()> {
        match self.goes_on() {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        }
    }

    /// True if an answer was "no". Does not ask again.
    pub fn was_stopped(&self) -> bool {
        self.is_over.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_no_is_remembered_and_nobody_is_asked_again() {
        let asked = Cell::new(0);
        let ask = || {
            asked.set(asked.get() + 1);
            asked.get() < 3
        };
        let watch = Watch::new(&ask);
        assert!(watch.goes_on() && watch.goes_on() && !watch.was_stopped());
        assert!(!watch.goes_on() && !watch.goes_on() && watch.was_stopped());
        assert_eq!(asked.get(), 3);
        assert!(Watch::nobody().goes_on());
    }
}
