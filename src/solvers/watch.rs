//! Whether a long computation should go on.

use std::cell::Cell;

/// Asks between parts of a computation whether it should go on. Once the answer is no, it stays no. Loops then end early, and what they return
/// is of no use: whoever started them asks [`Watch::was_stopped`] before anything is done with it.
pub struct Watch<'a> {
    ask: Option<&'a dyn Fn() -> bool>,
    is_over: Cell<bool>,
}

impl<'a> Watch<'a> {
    /// Of somebody who answers whether to go on.
    pub fn new(ask: &'a dyn Fn() -> bool) -> Self {
        Self {
            ask: Some(ask),
            is_over: Cell::new(false),
        }
    }

    /// Of a computation that nobody stops.
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

    /// Whether somebody said no; asks nobody.
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
