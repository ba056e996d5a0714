//! Particle swarms, and the network of the paper's section 3.2 that moves them.

pub mod anchor;
pub mod bpnn_pso;
pub mod fit;
mod parallel;
pub mod swarm;
