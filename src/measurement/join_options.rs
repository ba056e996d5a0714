//! What a caller says about the join of two files, and why it may fail.

/// What rows of two files are paired by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JoinBy {
    /// The points' names.
    Name,
    /// The points' numbers.
    Number,
    /// The time, after the difference of the two clocks was found.
    Time,
    /// The order of the rows; only if the caller says so.
    Order,
}

impl JoinBy {
    /// All of them, in the order in which they are tried.
    pub const ALL: [Self; 4] = [Self::Name, Self::Number, Self::Time, Self::Order];

    /// Its name in mappings and answers.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Name => "name",
            Self::Number => "number",
            Self::Time => "time",
            Self::Order => "order",
        }
    }
}

/// What a caller says about the join.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JoinOptions {
    /// What to pair by.
    pub by: Option<JoinBy>,
    /// How far apart the times of a pair may be, s.
    pub tolerance_s: Option<f64>,
    /// The robot's clock minus the instrument's, s.
    pub clock_offset_s: Option<f64>,
    /// Whether names may differ in signs, spaces and leading zeros, and a name may be a number.
    pub loose_names: bool,
    /// By time: whether the instrument's file is a log, of which the standstills count; not stated: if its rows follow each other as fast as a log's.
    pub instrument_log: Option<bool>,
    /// Whether positions under one name that lie apart are refused. Not for uploads that were accepted once.
    pub refuse_apart: bool,
}

impl Default for JoinOptions {
    fn default() -> Self {
        Self {
            by: None,
            tolerance_s: None,
            clock_offset_s: None,
            loose_names: true,
            instrument_log: None,
            refuse_apart: true,
        }
    }
}

/// Why two files cannot be joined.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{detail}")]
pub struct JoinError {
    /// Stable code.
    pub code: &'static str,
    /// What is unclear, and what to state.
    pub detail: String,
}

pub(super) fn error(code: &'static str, detail: impl Into<String>) -> JoinError {
    JoinError {
        code,
        detail: detail.into(),
    }
}

/// For each row of the instrument's file the row of the robot's.
pub(super) type Pairs = Vec<Option<usize>>;
