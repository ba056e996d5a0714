//! Messages for the case that joint values and positions are in two separate files: if one of the files is missing, or if the files are swapped.

use crate::measurement::column_mapping::Needs;
use crate::measurement::column_names::{Known, Unit, recognise};

/// For a file that has only joint values or only positions, but not what it needs: a message that says where the missing part may be. `names` are its
/// columns, each with the unit below it.
pub(super) fn other_half(
    names: &[(&str, Option<Unit>)],
    n_joints: usize,
    needs: Needs,
) -> Option<&'static str> {
    let count = |is_wanted: fn(&Known) -> bool| {
        let known = names.iter().map(|(name, below)| recognise(name, *below));
        known.filter(is_wanted).count()
    };
    let found_joints = count(|known| matches!(known, Known::Joint(..)));
    let found_axes = count(|known| matches!(known, Known::Position(..)));
    match (needs, found_joints, found_axes) {
        (Needs::Joints, 0, 3..) => Some(
            "it has positions and no joint values. Of two files: are they exchanged? The robot's is the first, the instrument's the second. A program of \
             Cartesian targets needs the joint values near each target in columns of its own",
        ),
        (Needs::Positions, joints, 0) if joints >= n_joints => Some(
            "it has joint values and no positions: are the two files exchanged? The robot's is the first, the instrument's the second",
        ),
        (Needs::Points, joints, 0) if joints >= n_joints => Some(
            "the file has joint values and no positions that are known: if the instrument wrote them into a file of its own, give both files, the \
             robot's first; if they are in this one, say where in the column mapping: {\"x_mm\": \"COLUMN\"}",
        ),
        (Needs::Points, 0, 3..) => Some(
            "the file has positions and no joint values that are known: if the robot wrote them into a file of its own, give both files, the robot's \
             first; if they are in this one, say where in the column mapping: {\"q1_deg\": \"COLUMN\"}",
        ),
        _ => None,
    }
}
