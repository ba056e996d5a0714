//! Suspicions about an upload: refusals, and the codes with which a caller overrides them.

use crate::calibration::upload_checks::alignment::Suspicion;
use crate::wire::issue::Issue;
use crate::wire::names;
use crate::wire::robot::JointMapBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Code of the suspicion that the caller overrides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Insist {
    /// Joints or positions seem to be in other units.
    UnitSuspect,
    /// Columns or rows seem to be exchanged.
    ColumnSuspect,
    /// The positions seem to be in another frame.
    FrameSuspect,
    /// The controller seems to use another joint convention.
    JointMapSuspect,
    /// It seems to have been measured on another robot of this server.
    RobotMismatch,
    /// No hypothesis brings the robot near the points.
    PoorAlignment,
    /// The rotations seem to be written by another convention.
    RotationSuspect,
}

names!(Insist {
    UnitSuspect = "unit_suspect", ColumnSuspect = "column_suspect", FrameSuspect = "frame_suspect",
    JointMapSuspect = "joint_map_suspect", RobotMismatch = "robot_mismatch",
    PoorAlignment = "poor_alignment", RotationSuspect = "rotation_suspect",
});

impl Insist {
    /// Parses a code.
    pub fn parse(code: &str) -> Option<Self> {
        serde_json::from_value(code.into()).ok()
    }
}

/// The issue of a refusal.
impl From<&Suspicion> for Issue {
    fn from(suspicion: &Suspicion) -> Self {
        Self {
            column: suspicion.columns.clone(),
            code: suspicion.code.into(),
            detail: suspicion.refusal(),
            joint_map: suspicion
                .joint_map
                .as_ref()
                .map(|map| serde_json::json!(JointMapBody::from(map))),
            ..Self::default()
        }
    }
}
