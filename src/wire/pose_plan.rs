//! Pose plans: which poses to measure next.

use crate::planning::{AlignedBox, BaseCylinder};
use crate::wire::id;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::job::Model;
use crate::wire::measurement::Frame;
use crate::wire::report_shape::ToolUncertaintyReport;
use crate::wire::robot::{MAX_LENGTH_MM, MAX_NAME};
use crate::wire::warning::Warning;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use utoipa::ToSchema;

/// Maximum number of configurations of a plan. This is more than can be measured in a day.
pub const MAX_PLANNED: usize = 300;
/// Maximum number of candidates for positions. Poses have twice the rows, so half as many are allowed.
pub const MAX_CANDIDATES: usize = 50_000;
/// Maximum number of set-ups.
pub const MAX_SET_UPS: usize = 10;
/// Minimum number of configurations of a set-up. An identification needs as many to find the base.
const MIN_PER_SET_UP: usize = 6;
/// Maximum number of boxes.
pub const MAX_BOXES: usize = 32;
/// Maximum number of measurement sets in `measured`.
pub const MAX_MEASURED: usize = 20;
/// Allowed range of the noise, mm.
pub(super) const NOISE_MM: RangeInclusive<f64> = 1e-4..=10.0;
/// Allowed range of the noise of rotations, degrees.
pub(super) const NOISE_ROTATION_DEG: RangeInclusive<f64> = 1e-5..=5.0;
/// Allowed range of an acceptance cone's half angle, degrees.
pub(super) const HALF_ANGLE_DEG: RangeInclusive<f64> = 1.0..=180.0;
const LENGTHS: &str = "lengths are in millimetres";
/// Minimum length of a direction.
const SHORTEST_AXIS: f64 = 1e-6;

/// What is measured at each configuration of a plan.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum PlanKind {
    /// Positions of a reflector.
    #[default]
    Position,
    /// Poses of a 6D target.
    Pose,
}

/// Request for a pose plan. Only `n_configurations` is required.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PosePlanBody {
    /// Number of configurations to measure, including repeats.
    #[schema(minimum = 1, maximum = 300)]
    pub n_configurations: usize,
    /// Seed of the random candidates.
    #[serde(default)]
    pub seed: u64,
    /// The model that will be identified; default: complete.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<Model>,
    /// The frame of the planned measurement; default: instrument.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Frame>,
    /// Position of the reflector in the flange frame, mm; default: [80, 0, 100], with model paper [0, 0, 100].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_mm: Option<[f64; 3]>,
    /// What is measured at each configuration; default: positions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<PlanKind>,
    /// Standard deviation of a measured coordinate, mm; default 0.05.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_std_mm: Option<f64>,
    /// Standard deviation of a component of the measured rotation vector, degrees; default 0.02. For poses of the plan and of the sets in `measured`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_std_rotation_deg: Option<f64>,
    /// Number of random configurations from which the plan is chosen, for all set-ups together; default: 10,000, at most 50,000, for poses 25,000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 50000)]
    pub n_candidates: Option<usize>,
    /// Number of configurations from the beginning of the plan that are repeated at the end, to detect drift. Default: 3; for plans with less than 20
    /// configurations 0. With set-ups it holds for each of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_repeats: Option<usize>,
    /// Boxes in the base frame. The reflector must be inside one of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 32)]
    pub boxes: Vec<BoxBody>,
    /// Boxes in the base frame that the arm must stay outside of: the straight lines from the axis of joint 2 over the link origins and the flange to the
    /// reflector. With `instrument_mm`, the line of sight does not cross them either.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 32)]
    pub keep_out: Vec<BoxBody>,
    /// Place of the instrument in the base frame, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument_mm: Option<[f64; 3]>,
    /// The direction in which the reflector looks, in the flange frame. With it, the plan has only configurations in which the instrument is within the
    /// reflector's acceptance cone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_axis: Option<[f64; 3]>,
    /// Half angle of the acceptance cone about `target_axis`, degrees; default 30.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_half_angle_deg: Option<f64>,
    /// Set-ups of the instrument. The configurations are distributed evenly over them, and each has its own unknown base. Without set-ups the
    /// instrument stays where it is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 10)]
    pub set_ups: Vec<SetUpBody>,
    /// Height in the base frame that reflector, flange, wrist and elbow must stay above, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub floor_z_mm: Option<f64>,
    /// Cylinder that reflector, flange, wrist and elbow must stay outside of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_cylinder: Option<BaseCylinderBody>,
    /// Measurement sets of this robot that already exist. The plan is optimised as an addition to them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 20)]
    pub measured: Vec<String>,
}

/// One set-up of the instrument.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SetUpBody {
    /// Its name: the `station` of the measured rows.
    #[schema(min_length = 1, max_length = 200)]
    pub name: String,
    /// Place of the instrument in the base frame, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument_mm: Option<[f64; 3]>,
    /// Boxes in the base frame. The reflector must be inside one of them. Without boxes, those of the request hold.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 32)]
    pub boxes: Vec<BoxBody>,
}

/// A box aligned with the axes of the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BoxBody {
    /// Corner with the smallest coordinates, mm.
    pub min_mm: [f64; 3],
    /// Corner with the largest coordinates, mm.
    pub max_mm: [f64; 3],
}

/// A cylinder about the z axis of the base frame: the robot's own base.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BaseCylinderBody {
    /// mm.
    pub radius_mm: f64,
    /// Height of its top above the origin of the base frame, mm.
    pub height_mm: f64,
}

/// A pose plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PosePlanAnswer {
    /// The configurations, in the order in which they should be measured.
    pub configurations: Vec<PlannedConfiguration>,
    /// Observability index O1 of the planned configurations.
    pub observability_index_o1: f64,
    /// Predicted standard deviation of the tool position over the workspace, with the sets in `measured` and the plan together. With several set-ups, each
    /// in its own frame: the largest mean, and the largest maximum.
    pub predicted_std_mm: ToolUncertaintyReport,
    /// Predicted standard deviation with the same number of random configurations instead of the plan.
    pub predicted_std_mm_random: ToolUncertaintyReport,
    /// Warnings. `under_determined`: no job can identify from so few configurations, or none that holds out half of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
    /// The set-ups of the request.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub set_ups: Vec<PlannedSetUp>,
}

/// One set-up of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlannedSetUp {
    /// Its name.
    pub name: String,
    /// Number of its configurations.
    pub n_configurations: usize,
    /// Predicted standard deviation of the tool position in its frame, with all set-ups together.
    pub predicted_std_mm: ToolUncertaintyReport,
}

/// One configuration of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlannedConfiguration {
    /// The controller's joint values, degrees.
    pub q_deg: Vec<f64>,
    /// Name of the set-up from which it is measured, if the request has set-ups.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_up: Option<String>,
    /// Number of the configuration that this one repeats (0-based).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<usize>,
}

impl PosePlanBody {
    /// A request for a plan with `n_configurations`, with defaults for all other fields.
    pub fn new(n_configurations: usize) -> Self {
        Self {
            n_configurations,
            ..Self::default()
        }
    }

    /// Number of configurations of each set-up: equal shares, with the remainder on the first ones. One number without set-ups.
    pub fn shares(&self) -> Vec<usize> {
        let n = self.set_ups.len().max(1);
        let more = self.n_configurations % n;
        (0..n)
            .map(|i| self.n_configurations / n + usize::from(i < more))
            .collect()
    }

    /// Makes all checks that need only the request.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        self.check_numbers(&mut checker);
        self.check_sight(&mut checker);
        self.check_set_ups(&mut checker);
        check_boxes("/boxes", &self.boxes, &mut checker);
        check_boxes("/keep_out", &self.keep_out, &mut checker);
        if let Some(cylinder) = &self.base_cylinder {
            let BaseCylinderBody {
                radius_mm,
                height_mm,
            } = *cylinder;
            checker.magnitude(
                "/base_cylinder/radius_mm",
                radius_mm,
                MAX_LENGTH_MM,
                LENGTHS,
            );
            checker.magnitude(
                "/base_cylinder/height_mm",
                height_mm,
                MAX_LENGTH_MM,
                LENGTHS,
            );
        }
        checker.count("/measured", self.measured.len(), 0..=MAX_MEASURED, "sets");
        checker.finish("invalid_plan")?;
        self.measured
            .iter()
            .enumerate()
            .try_for_each(|(i, id)| id::check(&format!("/measured/{i}"), id, "measurement set"))
    }

    fn check_numbers(&self, checker: &mut Checker) {
        let is_pose = self.kind.unwrap_or_default() == PlanKind::Pose;
        checker.within(
            "/n_configurations",
            self.n_configurations,
            1..=MAX_PLANNED,
            "configurations of a plan",
        );
        checker.within(
            "/n_candidates",
            self.n_candidates,
            1..=MAX_CANDIDATES / if is_pose { 2 } else { 1 },
            "candidates of a plan",
        );
        let fewest = self.shares().into_iter().min().unwrap_or(0);
        if self.n_repeats.is_some_and(|repeats| repeats > fewest / 2) {
            checker.add(
                "/n_repeats",
                "out_of_range",
                "at most half of the configurations can be repeats of the others",
            );
        }
        let noise = "the standard deviation of the noise";
        checker.within("/noise_std_mm", self.noise_std_mm, NOISE_MM, noise);
        checker.within(
            "/noise_std_rotation_deg",
            self.noise_std_rotation_deg,
            NOISE_ROTATION_DEG,
            noise,
        );
        if is_pose && self.model == Some(Model::Paper) {
            let detail = "the paper's model is identified from positions: remove the model, or plan positions";
            checker.add("/kind", "mixed_kinds", detail);
        }
        check_place("/target_mm", self.target_mm, checker);
        let floor_z_mm = self.floor_z_mm.unwrap_or(0.0);
        checker.magnitude("/floor_z_mm", floor_z_mm, MAX_LENGTH_MM, LENGTHS);
    }

    fn check_sight(&self, checker: &mut Checker) {
        check_place("/instrument_mm", self.instrument_mm, checker);
        let has_instrument = self.instrument_mm.is_some()
            || self
                .set_ups
                .iter()
                .any(|set_up| set_up.instrument_mm.is_some());
        if let Some(axis) = self.target_axis {
            let hint =
                "a direction has components from -1 to 1: [0, 0, 1] is along the flange's z axis";
            checker.magnitudes("/target_axis", &axis, 1.0, hint);
            if Vector3::from(axis).norm() < SHORTEST_AXIS {
                checker.add("/target_axis", "out_of_range", format!("zero: {hint}"));
            }
            if !has_instrument {
                let detail = "a direction counts only for an instrument whose place is known: add instrument_mm, or remove it";
                checker.add("/target_axis", "missing", detail);
            }
        }
        checker.within(
            "/target_half_angle_deg",
            self.target_half_angle_deg,
            HALF_ANGLE_DEG,
            "half the opening of the cone",
        );
        if self.target_half_angle_deg.is_some() && self.target_axis.is_none() {
            let detail = "the cone needs its axis: add target_axis, or remove the angle";
            checker.add("/target_half_angle_deg", "missing", detail);
        }
    }

    fn check_set_ups(&self, checker: &mut Checker) {
        let n = self.set_ups.len();
        checker.count("/set_ups", n, 0..=MAX_SET_UPS, "set-ups");
        if n > MAX_SET_UPS {
            return;
        }
        let fewest = self.shares().into_iter().min().unwrap_or(0);
        if n > 0 && fewest < MIN_PER_SET_UP {
            let detail = format!(
                "{} configurations for {n} set-ups: they take at least {}, {MIN_PER_SET_UP} each, because each of them has a base to find",
                self.n_configurations,
                n * MIN_PER_SET_UP
            );
            checker.add("/set_ups", "too_few_configurations", detail);
        }
        if n > 0 && self.instrument_mm.is_some() {
            let detail = "each set-up has its own instrument_mm: write it there";
            checker.add("/instrument_mm", "mixed_kinds", detail);
        }
        for (i, set_up) in self.set_ups.iter().enumerate() {
            let at = format!("/set_ups/{i}");
            checker.words(&format!("{at}/name"), &set_up.name, MAX_NAME);
            if self.set_ups[..i]
                .iter()
                .any(|other| other.name == set_up.name)
            {
                let detail = format!("{:?} is the name of two set-ups", set_up.name);
                checker.add(format!("{at}/name"), "duplicate", detail);
            }
            check_place(
                &format!("{at}/instrument_mm"),
                set_up.instrument_mm,
                checker,
            );
            check_boxes(&format!("{at}/boxes"), &set_up.boxes, checker);
        }
    }
}

fn check_place(at: &str, place_mm: Option<[f64; 3]>, checker: &mut Checker) {
    checker.magnitudes(
        at,
        place_mm.as_slice().as_flattened(),
        MAX_LENGTH_MM,
        LENGTHS,
    );
}

fn check_boxes(at: &str, boxes: &[BoxBody], checker: &mut Checker) {
    checker.count(at, boxes.len(), 0..=MAX_BOXES, "boxes");
    for (i, b) in boxes.iter().take(MAX_BOXES).enumerate() {
        check_place(&format!("{at}/{i}/min_mm"), Some(b.min_mm), checker);
        check_place(&format!("{at}/{i}/max_mm"), Some(b.max_mm), checker);
        if (0..3).any(|k| b.min_mm[k] >= b.max_mm[k]) {
            let detail = "min_mm is the lowest corner and max_mm the highest";
            checker.add(format!("{at}/{i}"), "corners_reversed", detail);
        }
    }
}

impl From<&BoxBody> for AlignedBox {
    fn from(b: &BoxBody) -> Self {
        (Vector3::from(b.min_mm), Vector3::from(b.max_mm))
    }
}

impl From<&BaseCylinderBody> for BaseCylinder {
    fn from(c: &BaseCylinderBody) -> Self {
        Self {
            radius_mm: c.radius_mm,
            height_mm: c.height_mm,
        }
    }
}
