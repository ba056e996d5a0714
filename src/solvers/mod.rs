//! Optimisers over plain vectors. They have never heard of a robot.

pub mod bpnn;
pub mod least_squares;
pub mod loss;
pub mod orthonormal;
pub mod products;
pub mod pso;
pub mod qr;
pub mod random;
pub mod watch;
