//! Messages about a program that is corrected: how it was read, and where its errors are.

use super::failure::ServerProblem;
use super::files::{self, cannot_be_used};
use super::usage::Usage;
use crate::measurement::RotationConvention;
use crate::operations::program::{Poses, Program};
use crate::wire::columns::ColumnsBody;
use crate::wire::issue::{Invalid, Issue};
use std::path::Path;

/// Reads a program. `columns` states the meaning of columns whose names do not show it; `rotation` is the convention of the angles.
pub fn parse(
    path: &Path,
    bytes: &[u8],
    columns: &ColumnsBody,
    rotation: Option<RotationConvention>,
) -> anyhow::Result<Program> {
    let unusable = |invalid: Invalid| Usage(cannot_be_used(path, &invalid.issues));
    Ok(Program::parse(bytes, columns, rotation).map_err(unusable)?)
}

/// Notes for the user about how the program was read.
pub fn notes(program: &Program) -> Vec<String> {
    let of_poses = match program.poses() {
        Poses::Quaternions => ", and the position and quaternion of each target",
        Poses::Angles => ", and the position and angles of each target",
        Poses::Positions => ", and the position of each target",
        Poses::None => "",
    };
    let joints = program.joints.join(", ");
    let mut notes = vec![format!("corrected columns: {joints}{of_poses}")];
    if !program.other_poses.is_empty() {
        notes.push(format!(
            "warning (poses_left): columns {} stay as they are: they are the pose of the joint values before the correction",
            program.other_poses.join(", ")
        ));
    }
    if program.is_workbook {
        notes.push("the workbook is written as text with tabs between its columns".into());
    }
    notes
}

/// Line numbers in the program of these targets. Targets are counted from 0.
pub fn lines(program: &Program, targets: &[usize]) -> String {
    let of_targets = program.lines();
    let lines = targets.iter().filter_map(|target| of_targets.get(*target));
    let lines: Vec<String> = lines.map(usize::to_string).collect();
    lines.join(", ")
}

/// Rewrites an error in terms of the program's lines and columns, and of options. `first` is the first target of the request.
pub fn with_file_rows(
    program: &Program,
    error: anyhow::Error,
    path: &Path,
    first: usize,
) -> anyhow::Error {
    let issues = match (
        error.downcast_ref::<ServerProblem>(),
        error.downcast_ref::<Invalid>(),
    ) {
        (Some(refused), _) if refused.is_usage() => &refused.problem.errors,
        (_, Some(invalid)) => &invalid.issues,
        _ => return error,
    };
    if issues.is_empty() {
        return error;
    }
    let faults: Vec<String> = program.placed(issues, first).iter().map(fault).collect();
    Usage(format!("{}: {}", path.display(), faults.join("\n  "))).into()
}

fn fault(issue: &Issue) -> String {
    let pointer = issue.pointer.as_deref().unwrap_or_default();
    let option = match pointer.split('/').nth(1) {
        None if issue.line.is_some() => return issue.detail.clone(),
        None => return files::issue_in_words(issue),
        Some("frame") => "--frame",
        Some("tool_name") => "--tool",
        Some("mode") => "--mode",
        Some("base") => "--base",
        Some("target") => "--target",
        Some("tool") => "--tool-mm",
        Some(_) => return files::issue_in_words(issue),
    };
    format!("{option}: {}", issue.detail)
}
