//! Optimisers over plain vectors, independent of robots.

pub mod bpnn;
pub mod least_squares;
pub mod loss;
pub mod median;
pub mod orthonormal;
pub mod products;
pub mod pso;
pub mod qr;
pub mod random;
pub mod watch;
