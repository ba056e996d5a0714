//! What a table looks like before it is uploaded.

use crate::wire::columns::ColumnsBody;
use crate::wire::issue::Issue;
use crate::wire::understood::{JoinBody, UnderstoodBody};
use serde::Serialize;
use utoipa::ToSchema;

/// How the files of an upload are understood.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = TablePreview)]
pub struct PreviewAnswer {
    /// The only file, or the robot's and the instrument's.
    pub files: Vec<FilePreview>,
    /// How two files are joined, if they can be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub join: Option<JoinBody>,
    /// Number of points, if all can be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_points: Option<usize>,
    /// Why it cannot be read yet; empty if it can.
    pub errors: Vec<Issue>,
}

/// How a file is understood.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct FilePreview {
    /// `table`, `robot` or `instrument`.
    pub part: String,
    /// How it is understood so far; none if not even its columns can be told apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub understood: Option<UnderstoodBody>,
    /// The names of its columns.
    pub header: Vec<String>,
    /// Its first rows.
    pub rows: Vec<Vec<String>>,
    /// Meanings that no column has.
    pub missing: Vec<String>,
    /// A mapping that may be meant. It is never used unless a caller confirms it.
    pub proposed: ColumnsBody,
}
