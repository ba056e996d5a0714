//! What has to hold before a parameter set may move a robot: pure functions over facts. The facts are gathered by `jobs` and kept by `store`; the
//! schema's triggers keep the most important rules whatever the code does.

pub mod facts;
mod gates;
mod robot_gates;
mod session_gates;
mod texts;
mod trend;

pub use facts::{Comparison, Facts, Session};
pub use gates::gates;
pub use trend::{Scored, trend};
