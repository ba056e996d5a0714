//! Corrections in addition to link parameters, as part of a parameter set.

use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::CorrectedModel;
use crate::kinematics::corrections::HARMONIC_ORDERS;
use crate::kinematics::{
    Compliance, Corrections, Harmonic, Link, MeasuredRegion, Payload, ResidualNetwork,
};
use crate::wire::frames::Transform;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::target::{Target, target_position, target_rotations};
use nalgebra::{IsometryMatrix3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Version of this document. Documents of later versions are refused, because their formula differs. Version 1 has no `joint_coupling`.
pub const CORRECTIONS_VERSION: u32 = 2;
/// Largest mass of a payload, kg.
pub const MAX_PAYLOAD_KG: f64 = 10_000.0;
/// Largest absolute coordinate of a payload's centre in the flange frame, mm.
pub const MAX_PAYLOAD_OFFSET_MM: f64 = 10_000.0;

/// Corrections in addition to `links_with_corrections`, and the region in which they are valid.
///
/// M_i is the moment of gravity about the origin of frame i, expressed in frame i: M_i = R_iᵀ·Σ_{j≥i} [m_j·(o_j − o_i) + R_j·c_j] × g. It is computed
/// with the link parameters only (lengths in metres, g a unit vector). M_0 is the same moment about the base's origin, in the base frame. Then:
/// T_base_flange = Trans(net(q)) · Rot(B∘M_0) · Π [Rx(alpha)·Dx(a)·Ry(beta)·Rz(q + theta_offset + C·q + h(q))·Dz(d)·Rot(K_i∘M_i)].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CorrectionsContent {
    /// Version of the formula: 2. Version 1 has no `joint_coupling`.
    pub version: u32,
    /// Pose of the base in the measuring frame, identified together with the corrections.
    pub t_instrument_base: Transform,
    /// Positions of the reflectors in the flange frame, identified together with the corrections.
    pub targets: Vec<Target>,
    /// g: unit vector along gravity, in the base frame.
    pub gravity_in_base: [f64; 3],
    /// m: mass at the origin of each link's frame, in units of mass.
    pub masses: Vec<f64>,
    /// c: first moment of each link about that origin, in the link's frame, units of mass × metres.
    pub first_moments_m: Vec<[f64; 3]>,
    /// K: rotation of each joint's frame about its x, y and z per unit moment, degrees.
    pub joint_compliance_deg: Vec<[f64; 3]>,
    /// B: rotation of the base about x, y and z of the base frame per unit moment, degrees.
    pub base_compliance_deg: [f64; 3],
    /// Payload on the flange while the robot was measured, if it was stated. Its mass is not contained in `masses`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<PayloadBody>,
    /// Kilograms per unit of mass. This converts the mass of a payload to the unit of `masses`.
    pub mass_unit_kg: f64,
    /// C, one row per joint: joint i turns by Σ_j C_ij·q_j in addition to its own value, with the same unit of angle on both sides. Absent if no joint
    /// is coupled.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joint_coupling: Vec<Vec<f64>>,
    /// h(q) = Σ sin_deg · sin(order·q) + cos_deg · cos(order·q), for each joint. Harmonics that are not listed are 0.
    pub harmonics: Vec<HarmonicContent>,
    /// net(q): displacement of the flange in the base frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_network: Option<ResidualNetworkContent>,
    /// The measured region. Outside this region, predictions fade to those of `links`.
    pub measured: MeasuredRegionContent,
}

/// A payload on the flange.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PayloadBody {
    /// Mass, kg.
    #[schema(minimum = 0, maximum = 10000)]
    pub mass_kg: f64,
    /// Centre of mass in the flange frame, mm; default: the flange's origin.
    #[serde(default)]
    pub centre_mm: [f64; 3],
}

/// One harmonic of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HarmonicContent {
    /// 1-based.
    pub joint: usize,
    /// Multiple of the joint value, from 1.
    pub order: usize,
    /// Amplitude of the sine, degrees.
    pub sin_deg: f64,
    /// Amplitude of the cosine, degrees.
    pub cos_deg: f64,
}

/// Network with a single hidden layer: y = scale_mm · (W2·tanh(W1·x − T1) − T2), x_j = (q_j − centre_j) / half_range_j. q are the model's joint
/// values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ResidualNetworkContent {
    /// Middle of each joint's range, degrees.
    pub centre_deg: Vec<f64>,
    /// Half of each joint's range, degrees.
    pub half_range_deg: Vec<f64>,
    /// W1, row by row: hidden × joints.
    pub hidden_weights: Vec<f64>,
    /// T1.
    pub hidden_thresholds: Vec<f64>,
    /// W2, row by row: 3 × hidden.
    pub output_weights: Vec<f64>,
    /// T2.
    pub output_thresholds: Vec<f64>,
    /// Unit of the outputs, mm.
    pub scale_mm: f64,
}

/// Region of joint values in which the robot was measured. Joint values are those of the model, i.e. after the joint map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MeasuredRegionContent {
    /// Smallest value of each joint, degrees.
    pub q_lowest_deg: Vec<f64>,
    /// Largest value of each joint, degrees.
    pub q_highest_deg: Vec<f64>,
    /// Mean value of each joint, degrees.
    pub q_mean_deg: Vec<f64>,
    /// Lower triangle of the Cholesky factor of the covariance of the joint values, row by row, degrees.
    pub q_spread_deg: Vec<f64>,
    /// Largest squared Mahalanobis distance of a measured pose from the others.
    pub farthest: f64,
}

fn degrees(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| v.to_degrees()).collect()
}

fn radians(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| v.to_radians()).collect()
}

fn degrees3(v: &Vector3<f64>) -> [f64; 3] {
    [v.x.to_degrees(), v.y.to_degrees(), v.z.to_degrees()]
}

fn radians3(v: &[f64; 3]) -> Vector3<f64> {
    Vector3::from(v.map(f64::to_radians))
}

impl PayloadBody {
    /// Reports values that are out of range.
    pub fn check(&self, pointer: &str, checker: &mut Checker) {
        let mass = format!("{pointer}/mass_kg");
        checker.within(mass, self.mass_kg, 0.0..=MAX_PAYLOAD_KG, "kg");
        let hint = "the payload's centre, mm from the flange";
        let centre = format!("{pointer}/centre_mm");
        checker.magnitudes(&centre, &self.centre_mm, MAX_PAYLOAD_OFFSET_MM, hint);
    }
}

impl From<PayloadBody> for Payload {
    fn from(payload: PayloadBody) -> Self {
        Self {
            mass_kg: payload.mass_kg,
            centre_mm: Vector3::from(payload.centre_mm),
        }
    }
}

impl From<&Payload> for PayloadBody {
    fn from(payload: &Payload) -> Self {
        Self {
            mass_kg: payload.mass_kg,
            centre_mm: payload.centre_mm.into(),
        }
    }
}

impl From<&ResidualNetwork> for ResidualNetworkContent {
    fn from(network: &ResidualNetwork) -> Self {
        Self {
            centre_deg: degrees(&network.centre_rad),
            half_range_deg: degrees(&network.half_range_rad),
            hidden_weights: network.hidden_weights.clone(),
            hidden_thresholds: network.hidden_thresholds.clone(),
            output_weights: network.output_weights.clone(),
            output_thresholds: network.output_thresholds.clone(),
            scale_mm: network.scale_mm,
        }
    }
}

impl From<&ResidualNetworkContent> for ResidualNetwork {
    fn from(content: &ResidualNetworkContent) -> Self {
        Self {
            centre_rad: radians(&content.centre_deg),
            half_range_rad: radians(&content.half_range_deg),
            hidden_weights: content.hidden_weights.clone(),
            hidden_thresholds: content.hidden_thresholds.clone(),
            output_weights: content.output_weights.clone(),
            output_thresholds: content.output_thresholds.clone(),
            scale_mm: content.scale_mm,
        }
    }
}

impl ResidualNetworkContent {
    fn check(&self, n: usize, checker: &mut Checker) {
        let hidden = self.hidden_thresholds.len();
        let sizes = [
            ("centre_deg", self.centre_deg.len(), n),
            ("half_range_deg", self.half_range_deg.len(), n),
            ("hidden_weights", self.hidden_weights.len(), hidden * n),
            ("output_weights", self.output_weights.len(), 3 * hidden),
            ("output_thresholds", self.output_thresholds.len(), 3),
        ];
        for (name, found, expected) in sizes {
            checker.length(
                format!("/corrections/residual_network/{name}"),
                found,
                expected,
                "a network of joints → position",
            );
        }
    }
}

impl CorrectionsContent {
    /// The corrections of an identified robot. `targets` are its targets in the form of the parameter set.
    pub fn new(corrected: &CorrectedModel, targets: Vec<Target>) -> Self {
        let Corrections {
            compliance,
            joint_coupling,
            harmonics,
            residual,
        } = &corrected.corrections;
        let region = &corrected.region;
        let listed = |(joint, orders): (usize, &Vec<Harmonic>)| {
            let content = move |(k, h): (usize, &Harmonic)| HarmonicContent {
                joint: joint + 1,
                order: k + 1,
                sin_deg: h.sin_rad.to_degrees(),
                cos_deg: h.cos_rad.to_degrees(),
            };
            orders
                .iter()
                .enumerate()
                .filter(|(_, h)| **h != Harmonic::default())
                .map(content)
                .collect::<Vec<_>>()
        };
        Self {
            version: CORRECTIONS_VERSION,
            t_instrument_base: Transform::from(&corrected.model.t_instrument_base),
            targets,
            gravity_in_base: compliance.gravity_in_base.into(),
            masses: compliance.masses.clone(),
            first_moments_m: compliance
                .first_moments_m
                .iter()
                .map(|c| (*c).into())
                .collect(),
            joint_compliance_deg: compliance.joints_rad.iter().map(degrees3).collect(),
            base_compliance_deg: degrees3(&compliance.base_rad),
            payload: compliance.payload.as_ref().map(PayloadBody::from),
            mass_unit_kg: compliance.mass_unit_kg,
            joint_coupling: match joint_coupling.iter().flatten().all(|ratio| *ratio == 0.0) {
                true => vec![],
                false => joint_coupling.clone(),
            },
            harmonics: harmonics.iter().enumerate().flat_map(listed).collect(),
            residual_network: residual.as_ref().map(ResidualNetworkContent::from),
            measured: MeasuredRegionContent {
                q_lowest_deg: degrees(&region.lowest_rad),
                q_highest_deg: degrees(&region.highest_rad),
                q_mean_deg: degrees(&region.mean_rad),
                q_spread_deg: degrees(&region.spread_rad),
                farthest: region.farthest,
            },
        }
    }

    /// The core's model with these corrections and links. `segment` selects the positions of targets that moved; default: the last segment.
    pub fn corrected_model(&self, links: Vec<Link>, segment: Option<u32>) -> CorrectedModel {
        let n_targets = self.targets.iter().map(|t| t.target + 1).max().unwrap_or(0);
        let target_mm = |target| {
            target_position(&self.targets, target, segment)
                .or_else(|| target_position(&self.targets, target, None))
        };
        let mut harmonics = vec![vec![Harmonic::default(); HARMONIC_ORDERS]; links.len()];
        let joint_coupling = match self.joint_coupling.is_empty() {
            true => vec![vec![0.0; links.len()]; links.len()],
            false => self.joint_coupling.clone(),
        };
        for h in &self.harmonics {
            harmonics[h.joint - 1][h.order - 1] = Harmonic {
                sin_rad: h.sin_deg.to_radians(),
                cos_rad: h.cos_deg.to_radians(),
            };
        }
        CorrectedModel {
            model: KinematicModel {
                t_instrument_base: IsometryMatrix3::from(&self.t_instrument_base),
                links,
                targets_mm: (0..n_targets)
                    .map(|target| target_mm(target).unwrap_or_else(Vector3::zeros))
                    .collect(),
                target_rotations: target_rotations(&self.targets, segment),
            },
            corrections: Corrections {
                compliance: Compliance {
                    gravity_in_base: Vector3::from(self.gravity_in_base),
                    masses: self.masses.clone(),
                    first_moments_m: self
                        .first_moments_m
                        .iter()
                        .map(|c| Vector3::from(*c))
                        .collect(),
                    joints_rad: self.joint_compliance_deg.iter().map(radians3).collect(),
                    base_rad: radians3(&self.base_compliance_deg),
                    payload: self.payload.map(Payload::from),
                    mass_unit_kg: self.mass_unit_kg,
                },
                joint_coupling,
                harmonics,
                residual: self.residual_network.as_ref().map(ResidualNetwork::from),
            },
            region: MeasuredRegion {
                lowest_rad: radians(&self.measured.q_lowest_deg),
                highest_rad: radians(&self.measured.q_highest_deg),
                mean_rad: radians(&self.measured.q_mean_deg),
                spread_rad: radians(&self.measured.q_spread_deg),
                farthest: self.measured.farthest,
            },
        }
    }

    /// Checks a document from outside the service (a parameter set in a file) against a robot with `n` links.
    pub fn check(&self, n: usize) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        if !(1..=CORRECTIONS_VERSION).contains(&self.version) {
            let detail = format!(
                "version {} is not known; this version of kincal reads 1 to {CORRECTIONS_VERSION}",
                self.version
            );
            checker.add("/corrections/version", "unknown_version", detail);
        }
        let sizes = [
            ("masses", self.masses.len(), n),
            ("first_moments_m", self.first_moments_m.len(), n),
            ("joint_compliance_deg", self.joint_compliance_deg.len(), n),
            ("measured/q_lowest_deg", self.measured.q_lowest_deg.len(), n),
            (
                "measured/q_highest_deg",
                self.measured.q_highest_deg.len(),
                n,
            ),
            ("measured/q_mean_deg", self.measured.q_mean_deg.len(), n),
            (
                "measured/q_spread_deg",
                self.measured.q_spread_deg.len(),
                n * (n + 1) / 2,
            ),
        ];
        for (name, found, expected) in sizes {
            checker.length(
                format!("/corrections/{name}"),
                found,
                expected,
                "one value per link of the robot",
            );
        }
        let coupled = "one row per joint, with one value per joint";
        if !self.joint_coupling.is_empty() {
            let rows = self.joint_coupling.len();
            checker.length("/corrections/joint_coupling".to_owned(), rows, n, coupled);
        }
        for (i, row) in self.joint_coupling.iter().enumerate() {
            let pointer = format!("/corrections/joint_coupling/{i}");
            checker.length(pointer, row.len(), n, coupled);
        }
        for (i, h) in self.harmonics.iter().enumerate() {
            if !(1..=n).contains(&h.joint) || !(1..=HARMONIC_ORDERS).contains(&h.order) {
                let detail = format!(
                    "joint {} order {}: joints are 1 to {n}, orders 1 to {HARMONIC_ORDERS}",
                    h.joint, h.order
                );
                checker.add(
                    format!("/corrections/harmonics/{i}"),
                    "out_of_range",
                    detail,
                );
            }
        }
        if let Some(network) = &self.residual_network {
            network.check(n, &mut checker);
        }
        checker.finish("invalid_corrections")
    }
}
