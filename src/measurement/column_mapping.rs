//! What a caller says about the columns of a file, once, where the file does not say it itself.

use crate::measurement::conventions::Decimal;

/// What stands between two columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separator {
    /// `,`
    Comma,
    /// `;`
    Semicolon,
    /// Tabs.
    Tab,
    /// `|`
    Pipe,
    /// One or several spaces or tabs.
    Spaces,
}

impl Separator {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Comma,
        Self::Semicolon,
        Self::Tab,
        Self::Pipe,
        Self::Spaces,
    ];

    /// Its name in answers and mappings: the character, `tab` or `spaces`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Comma => ",",
            Self::Semicolon => ";",
            Self::Tab => "tab",
            Self::Pipe => "|",
            Self::Spaces => "spaces",
        }
    }

    /// The one of this name.
    pub fn parse(name: &str) -> Option<Self> {
        let named = |separator: &Self| separator.as_str() == name;
        Self::ALL.into_iter().find(named).or(match name {
            "\t" => Some(Self::Tab),
            " " => Some(Self::Spaces),
            _ => None,
        })
    }

    /// The byte that the reader splits at. Runs of spaces become tabs before.
    pub(super) fn byte(self) -> u8 {
        match self {
            Self::Comma => b',',
            Self::Semicolon => b';',
            Self::Tab | Self::Spaces => b'\t',
            Self::Pipe => b'|',
        }
    }
}

/// A column of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ColumnRef {
    /// By the text in its header.
    Header(String),
    /// By its number, counted from 1.
    Number(usize),
}

/// Where the names of the columns stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeaderRow {
    /// On this line of the file, counted from 1.
    Line(usize),
    /// Nowhere: all lines are data, and columns have numbers.
    None,
}

/// What a caller says about a file. What it does not say is read from the file, if there is one reading only.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mapping {
    /// Meaning with unit (`q1_deg`, `x_mm`, `station`, `name` …) and the column that has it.
    pub columns: Vec<(String, ColumnRef)>,
    /// Columns to leave aside although their names are known.
    pub ignore: Vec<ColumnRef>,
    /// The decimal mark.
    pub decimal: Option<Decimal>,
    /// What separates columns.
    pub separator: Option<Separator>,
    /// Where the header is.
    pub header_row: Option<HeaderRow>,
    /// Whether lines that begin with `#`, `%`, `!` or `//` are comments.
    pub comments: Option<bool>,
    /// The sheet of a workbook.
    pub sheet: Option<String>,
    /// Unit of joint values whose columns name none: `deg` or `rad`.
    pub joint_unit: Option<&'static str>,
    /// Unit of positions whose columns name none, one of [`LENGTHS`](crate::measurement::column_names::LENGTHS).
    pub position_unit: Option<&'static str>,
    /// Nothing is added from the names of columns: all that is meant is in `columns`.
    pub is_complete: bool,
}

impl Mapping {
    /// Whether a header has a text that the mapping names.
    pub(super) fn names(&self, header: &str) -> bool {
        let columns = self.columns.iter().map(|(_, column)| column);
        columns.chain(&self.ignore).any(|column| match column {
            ColumnRef::Header(text) => same_header(text, header),
            ColumnRef::Number(_) => false,
        })
    }
}

/// Whether two headers are the same text, letter case and spaces around aside.
pub(super) fn same_header(a: &str, b: &str) -> bool {
    a.trim().to_lowercase() == b.trim().to_lowercase()
}

/// Which columns a file must have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// Joint values and positions.
    Points,
    /// Joint values: the robot's file of two.
    Joints,
    /// Positions: the instrument's file of two.
    Positions,
}
