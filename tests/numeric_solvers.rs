//! The solvers against closed forms, certified problems and second implementations.

#[path = "numeric_solvers/bits.rs"]
mod bits;
#[path = "numeric_solvers/bpnn.rs"]
mod bpnn;
#[path = "numeric_solvers/least_squares.rs"]
mod least_squares;
#[path = "numeric_solvers/nist.rs"]
mod nist;
#[path = "numeric_solvers/pso.rs"]
mod pso;
#[path = "numeric_solvers/random.rs"]
mod random;
