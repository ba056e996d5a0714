//! Options and errors of the join of two files.

use crate::measurement::join::name_parts::LeftOut;

/// The key by which rows of two files are paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JoinBy {
    /// The points' names.
    Name,
    /// The points' numbers.
    Number,
    /// The time, corrected by the difference between the two clocks.
    Time,
    /// The order of the rows. Only used if the caller requests it.
    Order,
}

impl JoinBy {
    /// All keys, in the order in which they are tried.
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

/// What a caller states about the join.
#[derive(Clone, Debug, PartialEq)]
pub struct JoinOptions {
    /// The key to pair by; none to try all keys except the order.
    pub by: Option<JoinBy>,
    /// Largest difference between the times of a pair, s.
    pub tolerance_s: Option<f64>,
    /// The robot's clock minus the instrument's clock, s.
    pub clock_offset_s: Option<f64>,
    /// Whether names may differ in punctuation, spaces and leading zeros, numbers may be used as names, and names may agree by their numbers alone.
    pub loose_names: bool,
    /// By time: whether the instrument's file is a continuous log, of which only the standstills are used. `None`: detected from the time between its
    /// rows.
    pub instrument_log: Option<bool>,
    /// For stored uploads: what was left out of the names. Of new ones it is found.
    pub left_out: Option<LeftOut>,
    /// By time: whether slow parts of motions in a log count as no standstills, and the standstills of two logs are compared as a whole. False for uploads
    /// that earlier versions stored.
    pub settled_standstills: bool,
    /// Whether these are refused: positions with the same name that are too far apart, and tables that occur twice in a file. False for
    /// stored uploads, which were accepted once.
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
            left_out: None,
            settled_standstills: true,
            refuse_apart: true,
        }
    }
}

/// Why two files cannot be joined.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{detail}")]
pub struct JoinError {
    /// Machine-readable code; it never changes.
    pub code: &'static str,
    /// What is unclear, and what to state.
    pub detail: String,
}

pub fn error(code: &'static str, detail: impl Into<String>) -> JoinError {
    JoinError {
        code,
        detail: detail.into(),
    }
}

/// For each row of the instrument's file, the row of the robot's file that it is paired with.
pub type Pairs = Vec<Option<usize>>;

/// Number of rows that have a partner.
pub fn n_paired(pairs: &[Option<usize>]) -> usize {
    pairs.iter().flatten().count()
}
