//! Suspicions about an upload: the refusals, and the codes with which a caller overrides them.

use crate::calibration::upload_checks::alignment::Suspicion;
use crate::wire::issue::Issue;
use crate::wire::names;
use crate::wire::robot::JointMapBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

names! {
    /// Code of a suspicion that the caller overrides.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
    #[serde(rename_all = "snake_case")]
    #[value(rename_all = "snake_case")]
    pub enum Insist {
        /// Joints or positions seem to be in other units.
        UnitSuspect = "unit_suspect",
        /// Columns or rows seem to be swapped.
        ColumnSuspect = "column_suspect",
        /// The positions seem to be in another frame.
        FrameSuspect = "frame_suspect",
        /// The controller seems to use another joint convention.
        JointMapSuspect = "joint_map_suspect",
        /// The upload seems to have been measured on another robot of this server.
        RobotMismatch = "robot_mismatch",
        /// The robot does not fit the points, and none of the other suspicions explains it.
        PoorAlignment = "poor_alignment",
        /// The rotations seem to be written in another convention.
        RotationSuspect = "rotation_suspect",
    }
}

impl Insist {
    /// Parses a code.
    pub fn parse(code: &str) -> Option<Self> {
        serde_json::from_value(code.into()).ok()
    }
}

/// Converts a suspicion to the issue of a refusal.
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
