//! Jobs: the queue's rules, the workers that compute, and how others hear of their progress.
//!
//! The life of a job: [`queue::enqueue`] in the request's own transaction, [`JobSignals::job_enqueued`] after its commit;
//! a worker of the [`WorkerPool`] claims it with a lease, computes on a blocking thread while a task of its own renews the
//! lease, and ends it, all fenced by (owner, attempt). If the worker dies, the lease runs out and the job is computed again.

mod compute;
pub mod evidence;
pub mod execution;
pub mod facts;
mod heartbeat;
mod pool;
mod progress;
pub mod queue;
mod relay;
mod run_alone;
mod worker;

pub use compute::{
    Compute, Earlier, JobFailure, JobInputs, JobOutcome, MeasurementSetInput, NetworkInput,
    ParameterSetInput, Progress,
};
pub use pool::{Rules, WorkerPool};
pub use progress::JobSignals;
pub use worker::{WorkerContext, run_next_job, run_pending_jobs};
