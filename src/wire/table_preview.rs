//! Preview of a table before it is uploaded.

use crate::wire::columns::ColumnsBody;
use crate::wire::issue::Issue;
use crate::wire::understood::{JoinBody, UnderstoodBody};
use serde::Serialize;
use utoipa::ToSchema;

/// How the files of an upload are interpreted.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = TablePreview)]
pub struct PreviewAnswer {
    /// The only file, or the robot's file and the instrument's file.
    pub files: Vec<FilePreview>,
    /// How two files are joined, if both can be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub join: Option<JoinBody>,
    /// Number of points, if all rows can be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_points: Option<usize>,
    /// Why the upload cannot be read yet; empty if it can be read.
    pub errors: Vec<Issue>,
}

/// How one file is interpreted.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct FilePreview {
    /// `table`, `robot` or `instrument`.
    pub part: String,
    /// How the file is interpreted so far; absent if not even its columns can be separated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub understood: Option<UnderstoodBody>,
    /// The cells of the line above the names of the columns, which may group them (Nominal, Measured); absent if there is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub above: Vec<String>,
    /// The names of its columns.
    pub header: Vec<String>,
    /// Its first rows.
    pub rows: Vec<Vec<String>>,
    /// Required meanings that no column has.
    pub missing: Vec<String>,
    /// A proposed column mapping. It is used only if the caller confirms it.
    pub proposed: ColumnsBody,
}
