//! Jobs: the queue's rules, the workers, and the signals of their progress.
//!
//! The life of a job: [`queue::enqueue`] in the request's transaction, [`JobSignals::job_enqueued`] after its commit. A worker of the
//! [`WorkerPool`] claims it with a lease, computes it on a blocking thread while another task renews the lease, and ends it. All these writes are
//! fenced by (owner, attempt). If the worker dies, the lease expires and the job is computed again.

pub mod backfill;
pub mod blocking;
mod compute;
pub mod estimate;
pub mod evidence;
pub mod execution;
mod heartbeat;
mod measurement_age;
mod pool;
mod progress;
pub mod queue;
pub mod release_check;
pub mod request;
mod run_alone;
mod worker;

pub use compute::{
    Compute, JobFailure, JobInputs, JobOutcome, KnownUploads, MeasurementSetInput, NetworkInput,
    ParameterSetInput,
};
pub use pool::{AttemptLimits, WorkerPool};
pub use progress::JobSignals;
pub use worker::{WorkerContext, run_next_job};
