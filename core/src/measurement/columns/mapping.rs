//! Column mapping: what a caller states about the columns of a file that the file itself does not state.

use crate::measurement::conventions::Decimal;

/// Column separator.
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
    /// All separators.
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

    /// The separator with this name.
    pub fn parse(name: &str) -> Option<Self> {
        let named = |separator: &Self| separator.as_str() == name;
        Self::ALL.into_iter().find(named).or(match name {
            "\t" => Some(Self::Tab),
            " " => Some(Self::Spaces),
            _ => None,
        })
    }

    /// The byte at which the reader splits. Runs of spaces are replaced by tabs before.
    pub fn byte(self) -> u8 {
        match self {
            Self::Comma => b',',
            Self::Semicolon => b';',
            Self::Tab | Self::Spaces => b'\t',
            Self::Pipe => b'|',
        }
    }
}

/// Reference to a column of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ColumnRef {
    /// By the text in its header.
    Header(String),
    /// By its number, counted from 1.
    Number(usize),
}

/// Where the names of the columns are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeaderRow {
    /// On this line of the file, counted from 1.
    Line(usize),
    /// The file has no header: all lines are data, and columns are referred to by number.
    None,
}

/// What a caller states about a file. Everything else is taken from the file, if it is unambiguous.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mapping {
    /// Meanings with units (`q1_deg`, `x_mm`, `station`, `name` …), each with its column.
    pub columns: Vec<(String, ColumnRef)>,
    /// Columns to ignore although their names are known.
    pub ignore: Vec<ColumnRef>,
    /// The decimal mark.
    pub decimal: Option<Decimal>,
    /// The column separator.
    pub separator: Option<Separator>,
    /// Where the header is.
    pub header_row: Option<HeaderRow>,
    /// Whether lines that begin with `#`, `%`, `!` or `//` are comments.
    pub comments: Option<bool>,
    /// The sheet of a workbook.
    pub sheet: Option<String>,
    /// Unit of joint values in columns without a unit: `deg` or `rad`.
    pub joint_unit: Option<&'static str>,
    /// Unit of positions in columns without a unit, one of [`LENGTHS`](crate::measurement::columns::names::LENGTHS).
    pub position_unit: Option<&'static str>,
    /// The groups of points to read; empty for all. Only for files with positions.
    pub groups: Vec<String>,
    /// With `is_complete`: whether unclosed quotes are plain characters. False for files of earlier versions, which are read as those
    /// versions read them.
    pub plain_quotes: bool,
    /// If true, `columns` is complete: no further column is recognised by its name.
    pub is_complete: bool,
}

impl Mapping {
    /// Whether the mapping refers to a column with this header.
    pub fn names(&self, header: &str) -> bool {
        let columns = self.columns.iter().map(|(_, column)| column);
        columns.chain(&self.ignore).any(|column| match column {
            ColumnRef::Header(text) => same_header(text, header),
            ColumnRef::Number(_) => false,
        })
    }
}

/// Whether two headers are equal, ignoring letter case and surrounding spaces.
pub fn same_header(a: &str, b: &str) -> bool {
    a.trim().to_lowercase() == b.trim().to_lowercase()
}

/// Which columns a file must have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// Joint values and positions.
    Points,
    /// Joint values: the robot's file, if there are two files.
    Joints,
    /// Positions: the instrument's file, if there are two files.
    Positions,
}
