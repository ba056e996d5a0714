//! Every limit on requests, memory and rate. [`permits`] has the numbers and hands out permits by the class of a request ([`RequestClass`]).

mod permits;
mod rate;
pub mod response_memory;

pub use permits::{
    BodyBudget, ComputePermit, LARGE_BODY_BYTES, Limits, MAX_BODY_BYTES, MIN_BYTES_PER_S,
    RequestClass,
};
