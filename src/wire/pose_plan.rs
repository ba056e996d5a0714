//! Pose plans: which poses to measure next.

use crate::planning::{BaseCylinder, Planned, Room};
use crate::wire::angle::to_degrees;
use crate::wire::id;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::job::Model;
use crate::wire::measurement::Frame;
use crate::wire::report_shape::ToolUncertaintyReport;
use crate::wire::robot::MAX_LENGTH_MM;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of configurations of a plan. This is more than can be measured in a day.
pub const MAX_PLANNED: usize = 300;
/// Default number of candidates.
pub const DEFAULT_CANDIDATES: usize = 10_000;
/// Maximum number of candidates.
pub const MAX_CANDIDATES: usize = 50_000;
/// Maximum number of boxes.
pub const MAX_BOXES: usize = 32;
/// Maximum number of measurement sets in `measured`.
pub const MAX_MEASURED: usize = 20;
/// Allowed range of the noise, mm.
pub(super) const NOISE_MM: (f64, f64) = (1e-4, 10.0);

/// Request for a pose plan. Only `n_configurations` is required.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
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
    /// Standard deviation of a measured coordinate, mm; default 0.05.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_std_mm: Option<f64>,
    /// Number of random configurations from which the plan is chosen; default: 10,000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 50000)]
    pub n_candidates: Option<usize>,
    /// Number of configurations from the beginning of the plan that are repeated at the end, to detect drift. Default: 3; for plans with less than 20
    /// configurations 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_repeats: Option<usize>,
    /// Boxes in the base frame. The reflector must be inside one of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 32)]
    pub boxes: Vec<BoxBody>,
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
    /// Predicted standard deviation of the tool position over the workspace, with the sets in `measured` and the plan together.
    pub predicted_std_mm: ToolUncertaintyReport,
    /// Predicted standard deviation with the same number of random configurations instead of the plan.
    pub predicted_std_mm_random: ToolUncertaintyReport,
}

/// One configuration of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlannedConfiguration {
    /// The controller's joint values, degrees.
    pub q_deg: Vec<f64>,
    /// Number of the configuration that this one repeats (0-based).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<usize>,
}

impl PosePlanBody {
    /// A request for a plan with `n_configurations`, with defaults for all other fields.
    pub fn new(n_configurations: usize) -> Self {
        Self {
            n_configurations,
            seed: 0,
            model: None,
            frame: None,
            target_mm: None,
            noise_std_mm: None,
            n_candidates: None,
            n_repeats: None,
            boxes: vec![],
            floor_z_mm: None,
            base_cylinder: None,
            measured: vec![],
        }
    }

    /// Makes all checks that need only the request.
    ///
    /// # Errors
    /// [`Invalid`] with a JSON pointer to each error.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        let mut within = |at: &str, value: usize, most: usize| {
            if value == 0 || value > most {
                checker.note(
                    at,
                    "out_of_range",
                    format!("{value}; 1 to {most} are allowed"),
                );
            }
        };
        within("/n_configurations", self.n_configurations, MAX_PLANNED);
        within(
            "/n_candidates",
            self.n_candidates.unwrap_or(DEFAULT_CANDIDATES),
            MAX_CANDIDATES,
        );
        if self
            .n_repeats
            .is_some_and(|repeats| repeats > self.n_configurations / 2)
        {
            checker.note(
                "/n_repeats",
                "out_of_range",
                "at most half of the configurations can be repeats of the others",
            );
        }
        if self
            .noise_std_mm
            .is_some_and(|std| !(NOISE_MM.0..=NOISE_MM.1).contains(&std))
        {
            checker.note(
                "/noise_std_mm",
                "out_of_range",
                format!("{} to {} mm are allowed", NOISE_MM.0, NOISE_MM.1),
            );
        }
        for (k, value) in self.target_mm.iter().flatten().enumerate() {
            checker.magnitude(
                format!("/target_mm/{k}"),
                *value,
                MAX_LENGTH_MM,
                "lengths are in millimetres",
            );
        }
        if let Some(floor_z_mm) = self.floor_z_mm {
            checker.magnitude(
                "/floor_z_mm",
                floor_z_mm,
                MAX_LENGTH_MM,
                "lengths are in millimetres",
            );
        }
        if self.boxes.len() > MAX_BOXES {
            checker.note(
                "/boxes",
                "wrong_length",
                format!("{} boxes; at most {MAX_BOXES}", self.boxes.len()),
            );
        }
        for (i, b) in self.boxes.iter().take(MAX_BOXES).enumerate() {
            for k in 0..3 {
                checker.magnitude(
                    format!("/boxes/{i}/min_mm/{k}"),
                    b.min_mm[k],
                    MAX_LENGTH_MM,
                    "lengths are in millimetres",
                );
                checker.magnitude(
                    format!("/boxes/{i}/max_mm/{k}"),
                    b.max_mm[k],
                    MAX_LENGTH_MM,
                    "lengths are in millimetres",
                );
                if b.min_mm[k] >= b.max_mm[k] {
                    checker.note(
                        format!("/boxes/{i}"),
                        "corners_reversed",
                        "min_mm is the lowest corner and max_mm the highest",
                    );
                }
            }
        }
        if let Some(cylinder) = &self.base_cylinder {
            checker.magnitude(
                "/base_cylinder/radius_mm",
                cylinder.radius_mm,
                MAX_LENGTH_MM,
                "lengths are in millimetres",
            );
            checker.magnitude(
                "/base_cylinder/height_mm",
                cylinder.height_mm,
                MAX_LENGTH_MM,
                "lengths are in millimetres",
            );
        }
        if self.measured.len() > MAX_MEASURED {
            checker.note(
                "/measured",
                "wrong_length",
                format!("{} sets; at most {MAX_MEASURED}", self.measured.len()),
            );
        }
        checker.finish("invalid_plan")?;
        self.measured
            .iter()
            .enumerate()
            .try_for_each(|(i, id)| id::check(&format!("/measured/{i}"), id, "measurement set"))
    }
}

/// The space in which the robot may move.
impl From<&PosePlanBody> for Room {
    fn from(body: &PosePlanBody) -> Self {
        let corners = |b: &BoxBody| (Vector3::from(b.min_mm), Vector3::from(b.max_mm));
        Self {
            boxes_mm: body.boxes.iter().map(corners).collect(),
            floor_z_mm: body.floor_z_mm,
            base_cylinder: body.base_cylinder.map(|c| BaseCylinder {
                radius_mm: c.radius_mm,
                height_mm: c.height_mm,
            }),
        }
    }
}

impl From<&Planned> for PlannedConfiguration {
    fn from(planned: &Planned) -> Self {
        let q_deg = planned.q_controller_rad.iter().map(|rad| to_degrees(*rad));
        Self {
            q_deg: q_deg.collect(),
            repeats: planned.repeats,
        }
    }
}
