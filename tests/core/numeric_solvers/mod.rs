//! The solvers, compared with closed forms, certified problems and second implementations.

mod bits;
mod bpnn;
mod least_squares;
mod nist;
mod pso;
mod random;
