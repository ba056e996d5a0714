//! A program that is corrected as a file.

use crate::wire::compensate::CompensateAnswer;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A corrected program, and what was found for each of its targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CorrectedProgram {
    /// The program with corrected targets, in base64. Everything else stays as it was, to the byte; a workbook becomes text with tabs between its
    /// columns.
    pub program_base64: String,
    /// True if the program was a workbook.
    pub is_workbook: bool,
    /// Names of the columns with the joint values, joint 1 first.
    pub joint_columns: Vec<String>,
    /// Names of columns with poses of the joint values before the correction. They stay as they are.
    pub left_columns: Vec<String>,
    /// The line of each target, counted from 1.
    pub lines: Vec<usize>,
    /// Joint values of each target in the program, degrees; of Cartesian targets those near the solution.
    pub program_q_deg: Vec<Vec<f64>>,
    /// The corrected targets, in the order of the program.
    pub corrected: CompensateAnswer,
}
