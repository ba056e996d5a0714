//! `calibrate(request, monitor) -> report`: the paper's flow chart as one function over plain data.

pub mod alignment;
mod arrangement;
pub mod changes;
mod check;
mod choice;
mod corrections;
mod coverage;
mod final_fit;
mod identify;
mod judged;
mod known;
mod larger_model;
mod method;
mod most_probable;
mod motions;
mod observe;
mod orientation;
mod outcome;
mod parameter_outcomes;
pub mod partial;
mod placing;
mod plausibility;
mod remarks;
mod repeatability;
mod repeated_rows;
pub mod report;
pub mod request;
mod rescoring;
mod robust;
mod screening;
mod session_fit;
mod settings;
mod stated_uncertainty;
mod swarms;
mod unseen;
pub mod upload;
mod verdict;
mod verify;

pub use crate::compensation::tool_differences;
pub use check::{check, network_fits};
pub use corrections::are_wanted as corrections_are_wanted;
pub use identify::calibrate;
pub use judged::{Judged, judged};
pub use known::{PriorFault, prior_faults};
pub use larger_model::MODEL_TOO_SMALL;
pub use orientation::{MAX_FLANGE_ROTATION_STD_RAD, NOT_KNOWN as ORIENTATION_NOT_KNOWN};
pub use plausibility::{JOINT_MAP, implausible_changes};
pub use repeated_rows::{is_anew, repeated_rows};
pub use report::{CalibrationReport, Errors};
pub use request::{CalibrationRequest, Method, Model, Preset};
pub use rescoring::{errors_mm, errors_on_verify_subset_mm};
pub use session_fit::{HeldOut, SessionFit, session_fit};
pub use verdict::{DOES_NOT_FIT, NO_BETTER, NO_FIT, SET_FAR_OFF};
pub use verify::{check_verify, verify};

use std::ops::ControlFlow;

/// What the monitor is told while a calibration runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event<'a> {
    /// A named stage begins: `screening`, then `least_squares`, `pso` or `bpnn_pso` for the main method, then `train_network`, `refine`,
    /// `corrections`, `compare_least_squares`, `compare_pso`, `compare_warm_start`, `final_fit`, `uncertainty`, `compare_sessions`. A job of kind verify has
    /// `verify` alone, a partial recalibration ends with `held_uncertainty`.
    StageStarted(&'a str),
    /// Nothing to report: a stage other than the main method is at work and asks whether to stop.
    Heartbeat,
    /// The stage of that name ended.
    StageEnded(&'a str),
    /// One iteration of the main method is done.
    Iteration {
        /// Iterations done so far.
        iteration: usize,
        /// The limit.
        n_iterations: usize,
        /// Smallest F so far, mm².
        best_cost_mm2: f64,
    },
}

/// Progress out, cancellation in: the only seam between the core and the service.
/// Called at least once per iteration; `Break` ends the calibration with [`Error::Cancelled`].
pub type Monitor<'a> = dyn FnMut(Event<'_>) -> ControlFlow<()> + 'a;

/// Why a calibration could not be done.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The monitor asked to stop.
    #[error("the calibration was cancelled")]
    Cancelled,
    /// Something in the request does not fit together. `code` is stable and goes to the client as it is.
    #[error("{detail}")]
    Unusable {
        /// Machine-readable reason (`under_determined`, `network_mismatch`, `not_available`, …).
        code: &'static str,
        /// What, where and how to mend it.
        detail: String,
    },
}

fn unusable(code: &'static str, detail: impl Into<String>) -> Error {
    Error::Unusable {
        code,
        detail: detail.into(),
    }
}
