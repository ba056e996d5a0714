//! Conditions under which a parameter set may move a robot: pure functions over facts. `jobs` gathers the facts, `store` stores them. The schema's
//! triggers enforce the most important conditions whatever the code does.

pub mod facts;
mod gates;
mod robot_gates;
mod session_gates;
mod texts;
mod trend;

pub use facts::{Comparison, Facts, Session, supports};
pub use gates::gates;
pub use trend::{ScoredSession, trend};
