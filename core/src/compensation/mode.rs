//! Choices of a compensation: what is corrected, and in which frame. Also the result for a target.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What of the tool is kept.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum,
)]
#[schema(as = CompensateMode)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Mode {
    /// Position and orientation.
    #[default]
    Pose,
    /// The position, with the smallest change of the joints.
    Position,
}

/// The frame in which targets are met.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[schema(as = CompensateBase)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Base {
    /// The measuring frame, which is the nominal base frame: what turned or shifted the base is corrected too. Only for sets whose positions
    /// were measured in the base frame.
    Measured,
    /// The robot's own base frame, wherever it stands: `left_out` says how far that is from the nominal one.
    Robot,
}

/// How a target came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = CompensateStatus)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Reached within 4e-7 of the reach (1 µm on an arm of 2.5 m) and 0.0001°.
    Ok,
    /// Near a singularity: the closest without a large motion of the joints.
    NearSingular,
    /// A joint is at or beyond its limit: the closest that the others get.
    JointLimit,
    /// The robot cannot have its tool there: a pose on fewer than six joints, or a place that it leaves by more than 1 % of its reach.
    NotReached,
}
