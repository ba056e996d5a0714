//! A parameter set: the identified parameters for a controller, with a hash for checking them.

use crate::calibration::CalibrationReport;
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::kinematics::Link;
use crate::wire::canonical;
use crate::wire::corrections::CorrectionsContent;
use crate::wire::frames::Transform;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::measurement::{Frame, Warning};
use crate::wire::names;
use crate::wire::release::Gate;
pub use crate::wire::release::{MAX_REASON, ReasonBody};
pub use crate::wire::target::Target;
use crate::wire::target::{target_position, target_rotations};
use crate::wire::tool::quaternion;
use nalgebra::{IsometryMatrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The content of a parameter set that is covered by its `sha256`. This is the SHA-256 of the object's canonical JSON (RFC 8785), in lower-case
/// hexadecimal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterSetContent {
    /// Identified links, base to flange.
    pub links: Vec<IdentifiedLink>,
    /// Pose of the base in the measuring frame. It is the identity if the positions are in the base frame and the model is `paper`.
    pub t_instrument_base: Transform,
    /// Positions of the reflectors in the flange frame.
    pub targets: Vec<Target>,
    /// Links that were identified together with `corrections`; absent if no correction is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub links_with_corrections: Option<Vec<IdentifiedLink>>,
    /// Corrections in addition to link parameters; absent if no correction is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrections: Option<CorrectionsContent>,
}

/// Provenance of a parameter set, and warnings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Provenance {
    /// The frame of the measured positions; absent in documents of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measuring_frame: Option<Frame>,
    /// One standard deviation of the flange's rotation, degrees; absent if it was not computed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flange_rotation_std_deg: Option<f64>,
    /// The part of `flange_rotation_std_deg` that position measurements cannot determine: the zero of the last joint, degrees. Absent in documents of
    /// older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_joint_zero_std_deg: Option<f64>,
    /// Warnings.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
}

/// One identified link: Rx(alpha) · Dx(a) · Ry(beta) · Rz(q + theta_offset) · Dz(d).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct IdentifiedLink {
    /// mm.
    pub a_mm: f64,
    /// Degrees.
    pub alpha_deg: f64,
    /// mm.
    pub d_mm: f64,
    /// Degrees.
    pub theta_offset_deg: f64,
    /// Degrees.
    pub beta_deg: f64,
}

names! {
    /// Status of a parameter set.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
    #[serde(rename_all = "snake_case")]
    pub enum ParameterSetStatus {
        /// Identified, not released.
        Candidate = "candidate",
        /// The robot's active set.
        Released = "released",
        /// Was released and then replaced by the release of another set.
        Superseded = "superseded",
        /// Withdrawn.
        Withdrawn = "withdrawn",
    }
}

/// A parameter set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterSetAnswer {
    /// Opaque identifier.
    pub id: String,
    /// The robot.
    pub robot_id: String,
    /// The job that identified it.
    pub job_id: String,
    /// Its status.
    pub status: ParameterSetStatus,
    /// Identified links, base to flange.
    pub links: Vec<IdentifiedLink>,
    /// Pose of the base in the measuring frame. It is the identity if the positions are in the base frame and the model is `paper`.
    pub t_instrument_base: Transform,
    /// Positions of the reflectors in the flange frame.
    pub targets: Vec<Target>,
    /// Links that were identified together with `corrections`; absent if no correction is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub links_with_corrections: Option<Vec<IdentifiedLink>>,
    /// Corrections in addition to link parameters; absent if no correction is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrections: Option<CorrectionsContent>,
    /// SHA-256 of the canonical JSON (RFC 8785) of an object with links, t_instrument_base and targets and, if present, links_with_corrections and
    /// corrections.
    pub sha256: String,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub released_at: Option<String>,
    /// Reason of the last release.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub release_reason: Option<String>,
    /// Id of the key that last released it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub released_by: Option<String>,
    /// Name of this key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub released_by_name: Option<String>,
    /// RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withdrawn_at: Option<String>,
    /// Reason of the withdrawal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withdraw_reason: Option<String>,
    /// Id of the key that withdrew it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withdrawn_by: Option<String>,
    /// Name of this key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withdrawn_by_name: Option<String>,
    /// The gates of the last release and their results. A gate with `warning` passed, but a person should look at it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub release_checks: Option<Vec<Gate>>,
    /// When it was archived: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<String>,
    /// When the job that identified it was archived: RFC 3339, UTC. Such a set waits for no decision.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_archived_at: Option<String>,
}

impl From<&CalibrationReport> for ParameterSetContent {
    fn from(report: &CalibrationReport) -> Self {
        Self {
            links: report.links.iter().map(IdentifiedLink::from).collect(),
            t_instrument_base: Transform::from(&report.t_instrument_base),
            targets: targets(report, &report.targets_mm, &report.target_rotations),
            links_with_corrections: report
                .corrected
                .as_ref()
                .map(|c| c.model.links.iter().map(IdentifiedLink::from).collect()),
            corrections: report.corrected.as_ref().map(|c| {
                CorrectionsContent::new(
                    c,
                    targets(report, &c.model.targets_mm, &c.model.target_rotations),
                )
            }),
        }
    }
}

/// The model with link parameters only, without corrections. A target that moved during the measurement has its last position.
impl From<&ParameterSetContent> for KinematicModel {
    fn from(content: &ParameterSetContent) -> Self {
        content.links_without_corrections(None)
    }
}

impl ParameterSetContent {
    /// The identified robot: links, and corrections if there are any. A target that moved during the measurement has its position in `segment`;
    /// without `segment` it has its last position.
    pub fn identified_robot(&self, segment: Option<u32>) -> IdentifiedRobot {
        let with_corrections = self
            .links_with_corrections
            .as_ref()
            .zip(self.corrections.as_ref());
        IdentifiedRobot {
            plain: self.links_without_corrections(segment),
            corrected: with_corrections.map(|(links, corrections)| {
                corrections.corrected_model(links.iter().map(Link::from).collect(), segment)
            }),
        }
    }

    fn links_without_corrections(&self, segment: Option<u32>) -> KinematicModel {
        let n_targets = self.targets.iter().map(|t| t.target + 1).max().unwrap_or(0);
        let target_mm = |target| {
            self.target_mm(target, segment)
                .or_else(|| self.target_mm(target, None))
                .unwrap_or_else(Vector3::zeros)
        };
        KinematicModel {
            t_instrument_base: IsometryMatrix3::from(&self.t_instrument_base),
            links: self.kinematic_links(),
            targets_mm: (0..n_targets).map(target_mm).collect(),
            target_rotations: target_rotations(&self.targets, segment),
        }
    }

    /// Checks a document from outside the service (a parameter set in a file) against a robot with `n_links` links.
    pub fn check(&self, n_links: usize) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.length(
            "/links",
            self.links.len(),
            n_links,
            "one per link of the robot",
        );
        if let Some(links) = &self.links_with_corrections {
            checker.length(
                "/links_with_corrections",
                links.len(),
                n_links,
                "one per link of the robot",
            );
        }
        if self.links_with_corrections.is_some() != self.corrections.is_some() {
            checker.add(
                "/corrections",
                "incomplete",
                "links_with_corrections and corrections belong together",
            );
        }
        checker.finish("invalid_parameter_set")?;
        self.corrections
            .as_ref()
            .map_or(Ok(()), |corrections| corrections.check(n_links))
    }

    /// The hash of the content, which the PC of a robot cell can check.
    pub fn sha256(&self) -> Result<String, serde_json::Error> {
        canonical::canonical_sha256(self)
    }

    /// The identified links, angles in radians.
    pub fn kinematic_links(&self) -> Vec<Link> {
        self.links.iter().map(Link::from).collect()
    }

    /// Position of a target in the flange frame, in this segment; without `segment`, in the last segment.
    pub fn target_mm(&self, target: usize, segment: Option<u32>) -> Option<Vector3<f64>> {
        target_position(&self.targets, target, segment)
    }
}

/// All targets in order, with one entry per segment for targets that moved.
fn targets(
    report: &CalibrationReport,
    targets_mm: &[Vector3<f64>],
    rotations: &[Rotation3<f64>],
) -> Vec<Target> {
    let moved = |target: usize| {
        report
            .target_segments
            .iter()
            .filter(|(t, _)| *t == target)
            .count()
            > 1
    };
    let of = |((target, segment), position): (&(usize, usize), &Vector3<f64>)| Target {
        target: *target,
        segment: moved(*target).then_some(*segment as u32),
        position_mm: (*position).into(),
        quaternion: None,
    };
    let mut targets: Vec<Target> = report
        .target_segments
        .iter()
        .zip(targets_mm)
        .map(of)
        .collect();
    for (target, rotation) in targets.iter_mut().zip(rotations) {
        target.quaternion = Some(quaternion(rotation));
    }
    targets.sort_by_key(|t| (t.target, t.segment));
    targets
}

impl From<&Link> for IdentifiedLink {
    fn from(link: &Link) -> Self {
        Self {
            a_mm: link.a_mm,
            alpha_deg: link.alpha_rad.to_degrees(),
            d_mm: link.d_mm,
            theta_offset_deg: link.theta_offset_rad.to_degrees(),
            beta_deg: link.beta_rad.to_degrees(),
        }
    }
}

impl From<&IdentifiedLink> for Link {
    fn from(link: &IdentifiedLink) -> Self {
        Self {
            a_mm: link.a_mm,
            alpha_rad: link.alpha_deg.to_radians(),
            d_mm: link.d_mm,
            theta_offset_rad: link.theta_offset_deg.to_radians(),
            beta_rad: link.beta_deg.to_radians(),
        }
    }
}
