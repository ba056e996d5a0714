//! `calibrate(request, monitor) -> report`: the paper's flow chart as one function over plain data.

mod calibrate;
mod method;
mod outcome;
pub mod partial;
pub mod point_errors;
mod preparation;
mod problem;
pub mod quick_check;
pub mod reference;
pub mod report;
pub mod request;
pub mod session_comparison;
pub mod session_pool;
mod settings;
mod solve;
mod stages;
pub mod upload_checks;
mod validation;
mod warning;
mod warnings;

pub use crate::compensation::tool_differences;
pub use calibrate::calibrate;
pub use preparation::check::network_fits;
pub use preparation::observe::DEFAULT_VERIFY_FRACTION;
pub use preparation::stated_priors::{PriorFault, prior_faults};
pub use report::{CalibrationReport, DOES_NOT_FIT, Errors, NO_FIT};
pub use request::{After, CalibrationRequest, CheckVerdict, Method, Model, Preset};
pub use session_comparison::ROBOT_CHANGED;
pub use session_pool::{SESSIONS_DIFFER, check};
pub use solve::corrections::are_wanted as corrections_are_wanted;
pub use solve::larger_model::MODEL_TOO_SMALL;
pub use validation::enough_points::check_verify;
pub use validation::fit::Fit;
pub use validation::quick_check::{ReleasedSet, check_quick_check, check_released};
pub use validation::repeated_rows::{RepeatedRows, is_anew, repeats};
pub use validation::robust_comparison::{RobustComparison, after_errors_mm, robust_comparison};
pub use validation::session_fit::{HeldOut, MIN_REFERENCE_PER_REACH, error_ratio, session_fit};
pub use validation::verdict::{MISSES_SESSION, NO_BETTER, SET_FAR_OFF, WORSE_THAN_IDENTIFIED};
pub use validation::verification_set::{n_placed, n_placed_where};
pub use validation::verify::{errors_mm, errors_on_verify_subset_mm, verify};
pub use warnings::orientation::{MAX_FLANGE_ROTATION_STD_RAD, NOT_KNOWN as ORIENTATION_NOT_KNOWN};
pub use warnings::orientation::{last_joint_zero_remedy, last_joint_zero_unknown};
pub use warnings::overstated_noise::NOISE_OVERSTATED;
pub use warnings::plausibility::{BASE_FRAME_OFF, INSTRUMENT_SCALE, instrument_scale};
pub use warnings::plausibility::{
    JOINT_MAP, POSITIONS_COMPUTED, TOOL_UNCERTAIN, implausible_changes,
};
pub use warnings::refused_upload::remedy as remedy_of_refusal;

use std::ops::ControlFlow;

/// Events that the monitor receives while a calibration runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event<'a> {
    /// A named stage begins. A job with several sessions begins with `compare_sessions`. The stages of a calibration are `screening`, then
    /// `least_squares`, `pso` or `bpnn_pso` for the main method, then `train_network`, `refine`, `corrections`, `compare_least_squares`,
    /// `compare_pso`, `compare_warm_start`, `final_fit`, `uncertainty`, `compare_sessions`. A job that scores a parameter set has only the
    /// stage `verify`. A partial recalibration ends with `held_uncertainty`.
    StageStarted(&'a str),
    /// A stage other than the main method is running. The monitor can stop the calibration.
    Heartbeat,
    /// The stage of that name ended.
    StageEnded(&'a str),
    /// One iteration of the main method is done.
    Iteration {
        /// Iterations done so far.
        iteration: usize,
        /// Maximum number of iterations.
        n_iterations: usize,
        /// Smallest F so far, mm².
        best_cost_mm2: f64,
    },
}

/// Reports progress and allows cancellation: the only interface between the core and the service.
/// Called at least once per iteration. `Break` ends the calibration with [`Error::Cancelled`].
pub type Monitor<'a> = dyn FnMut(Event<'_>) -> ControlFlow<()> + 'a;

/// Why a calibration could not be done.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The monitor stopped the calibration.
    #[error("the calibration was cancelled")]
    Cancelled,
    /// Something in the request does not fit together. `code` is stable and goes to the client as it is.
    #[error("{detail}")]
    Unusable {
        /// Machine-readable reason (`under_determined`, `network_mismatch`, `too_much_work`, …); it never changes.
        code: &'static str,
        /// What is wrong, where, and how to correct it.
        detail: String,
    },
}

fn unusable(code: &'static str, detail: impl Into<String>) -> Error {
    Error::Unusable {
        code,
        detail: detail.into(),
    }
}
