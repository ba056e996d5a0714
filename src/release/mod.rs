//! Conditions under which a parameter set may move a robot: pure functions over facts. `jobs` gathers the facts, `store` stores them. The schema's
//! triggers enforce the most important conditions whatever the code does.

mod check_state;
pub mod comparison;
mod decision;
mod equivalence;
pub mod facts;
mod gate_facts;
mod gates;
pub mod guard_band;
pub mod independence;
pub mod needs;
mod orientation;
mod provenance;
mod robot_gates;
mod session_gates;
mod sessions;
mod suspicions;
mod texts;
mod tolerance_gates;
mod trend;
mod unread_labels;
mod verdict;

pub use check_state::{CheckStateChange, check_state_change};
pub use comparison::Comparison;
pub use decision::{Decision, decide};
pub use equivalence::{is_compared_with_withdrawn, is_equivalent};
pub use gate_facts::{ArchivedItem, Facts, KeyHolder, LastMisfit, StoredFacts, WithdrawnSource};
pub use gates::first_refusal;
pub use provenance::{orientation_unknown, provenance, wrong_robot};
pub use sessions::{PointsSeq, Session, SessionVerdict, UnscoredSession, has_changed};
pub use suspicions::{AcceptedMisfit, accept_misfit, accept_rotations};
pub use trend::{
    ScoredJob, ScoredSession, may_have_trend, measured_at_ms, scored_sessions, stated_time, trend,
};
pub use unread_labels::unread_labels;
pub use verdict::{
    INSISTED, UNUSABLE_WARNINGS, headline, insisted_code, insisted_warning, is_usable,
    unusable_because, why_no_evidence, why_same_upload,
};
