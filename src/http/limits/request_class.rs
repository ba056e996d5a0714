//! Classes of requests with different limits.

/// Class of a request for limits. The table of routes states it for each route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestClass {
    /// Reads some rows.
    Read,
    /// Reads a whole document, or computes from stored data.
    CostlyRead,
    /// Computes from its body and stores nothing.
    Calculation,
    /// Withdraw, rollback and cancel, which have permits of their own.
    Safety,
    /// All other requests that are not reads.
    Write,
}
