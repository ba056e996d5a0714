//! The robot's state `check_robot`, in which no set may be released.

use crate::release::sessions::supports;
use crate::wire::verification::{Fit, Verification, VerificationKind};

/// Effect of a job's facts on the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckStateChange {
    /// The robot has to be checked.
    Begins,
    /// The robot is in order again.
    Ends,
}

/// The state begins with points that do not fit the robot, or with a session on which the set is far off. It ends with a session that
/// supports a release, unless its points repeat an upload from before the state began.
pub fn check_state_change(found: &Verification) -> Option<CheckStateChange> {
    let misses_session = found.kind == VerificationKind::Session && found.fit == Fit::SetFarOff;
    if found.fit == Fit::DoesNotFit || misses_session {
        Some(CheckStateChange::Begins)
    } else if supports(found) && !found.is_repeat {
        Some(CheckStateChange::Ends)
    } else {
        None
    }
}
