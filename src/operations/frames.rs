//! Computes base and tool frame from sweeps (section 2.2 of the paper).

use crate::frames::preliminary_frames;
use crate::kinematics::Robot;
use crate::wire::frames::FramesContent;
use crate::wire::issue::Invalid;
use crate::wire::measurement::{Frame, from_table};

/// Parses sweeps and computes base and tool frame.
///
/// # Errors
/// [`Invalid`] for a file that cannot be read, or sweeps that do not determine the frames (parallel axes, too short an arc).
pub fn frames_from_sweeps(bytes: &[u8], robot: &Robot) -> Result<FramesContent, Invalid> {
    let set = from_table(bytes, Frame::Instrument, robot.links.len())?;
    let frames = preliminary_frames(robot, &set)
        .map_err(|error| Invalid::at("", error.code(), error.to_string()))?;
    Ok(FramesContent::from(&frames))
}
