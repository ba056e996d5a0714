//! Corrections of effects that link parameters cannot describe, as plain data: joints and a base that deflect under gravity, joints with eccentric
//! transmissions and couplings, and a network for the rest. [`compliance`](crate::kinematics::compliance) applies them.

use crate::kinematics::Mounting;
use nalgebra::Vector3;

/// Highest multiple of a joint value among its harmonics.
pub const HARMONIC_ORDERS: usize = 2;
/// Kilograms per unit of mass, for a payload that is given in kilograms while the weight of the links is not stated.
pub const MASS_UNIT_KG: f64 = 10.0;

/// All corrections in addition to the links, for a robot of n links.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrections {
    /// Deflection under gravity.
    pub compliance: Compliance,
    /// Coupling C of the joints, n × n: joint i turns by C_ij·q_j in addition to its own value, rad/rad. Off the diagonal these are the couplings of
    /// a gear train or of parallel rods; on it, errors of a gear ratio.
    pub joint_coupling: Vec<Vec<f64>>,
    /// Harmonics of each joint, by order: the k-th entry has the phase (k + 1)·q.
    pub harmonics: Vec<Vec<Harmonic>>,
    /// Remaining displacement as a function of the joints.
    pub residual: Option<ResidualNetwork>,
}

/// Gravity, masses and compliances. Moments are in units of mass times metres (gravity counts 1), so that only the product of masses and compliances
/// has a meaning.
#[derive(Clone, Debug, PartialEq)]
pub struct Compliance {
    /// Unit vector along gravity, in the base frame.
    pub gravity_in_base: Vector3<f64>,
    /// Mass m_j at the origin of each link's frame.
    pub masses: Vec<f64>,
    /// First moment c_j of each link's mass about the origin of its frame, in that frame: mass × metres.
    pub first_moments_m: Vec<Vector3<f64>>,
    /// K_i: rotation of each joint's frame about its x, y and z per unit moment about that axis, rad.
    pub joints_rad: Vec<Vector3<f64>>,
    /// B: rotation of the base about x, y and z of the base frame per unit moment, rad.
    pub base_rad: Vector3<f64>,
    /// Payload on the flange; `None` if it is the same as at the identification, or unknown.
    pub payload: Option<Payload>,
    /// Kilograms per unit of mass.
    pub mass_unit_kg: f64,
}

/// Payload on the flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Payload {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the flange frame, mm.
    pub centre_mm: Vector3<f64>,
}

/// sin_rad · sin(k·q) + cos_rad · cos(k·q), added to a joint value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Harmonic {
    /// Amplitude of the sine, rad.
    pub sin_rad: f64,
    /// Amplitude of the cosine, rad.
    pub cos_rad: f64,
}

/// Network from joint values to the displacement of the flange in the base frame. It has a single hidden layer: y = scale · (W₂·tanh(W₁·x − T₁) − T₂)
/// with x_j = (q_j − centre_j) / half_range_j.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualNetwork {
    /// Middle of each joint's input range, rad.
    pub centre_rad: Vec<f64>,
    /// Half of each joint's input range, rad.
    pub half_range_rad: Vec<f64>,
    /// W₁: n_hidden × n_joints, row-major.
    pub hidden_weights: Vec<f64>,
    /// T₁: n_hidden.
    pub hidden_thresholds: Vec<f64>,
    /// W₂: 3 × n_hidden, row-major.
    pub output_weights: Vec<f64>,
    /// T₂: 3.
    pub output_thresholds: Vec<f64>,
    /// Unit of the outputs, mm.
    pub scale_mm: f64,
}

/// First estimate of the masses on an arm of n links: 1 at the elbow's frame, 1 at the wrist's, 0.5 at the flange's; these are links 3, 5 and 6 of a
/// six-axis arm. Mainly their ratios matter: the compliances absorb the rest.
pub fn usual_masses(n_links: usize) -> Vec<f64> {
    let mut masses = vec![0.0; n_links];
    // A seventh axis is in the upper arm, so the elbow is one link further out.
    let elbow = if n_links > 6 { 3 } else { 2.min(n_links - 1) };
    masses[elbow] += 1.0;
    masses[n_links.saturating_sub(2)] += 1.0;
    masses[n_links - 1] += 0.5;
    masses
}

impl Corrections {
    /// No corrections: the robot is described by its links.
    pub fn none(n_links: usize, mounting: &Mounting) -> Self {
        Self {
            compliance: Compliance {
                gravity_in_base: mounting.gravity_in_base,
                masses: usual_masses(n_links),
                first_moments_m: vec![Vector3::zeros(); n_links],
                joints_rad: vec![Vector3::zeros(); n_links],
                base_rad: Vector3::zeros(),
                payload: None,
                mass_unit_kg: MASS_UNIT_KG,
            },
            joint_coupling: vec![vec![0.0; n_links]; n_links],
            harmonics: vec![vec![Harmonic::default(); HARMONIC_ORDERS]; n_links],
            residual: None,
        }
    }

    /// What is added to a joint's value: its coupling to all joints, and its harmonics, rad.
    pub fn joint_error_rad(&self, joint: usize, q_rad: &[f64]) -> f64 {
        let followed = self.joint_coupling[joint].iter().zip(q_rad);
        let of_coupling = followed.fold(0.0, |sum, (ratio, q)| sum + ratio * q);
        self.harmonics[joint]
            .iter()
            .enumerate()
            .fold(of_coupling, |sum, (k, harmonic)| {
                let (s, c) = libm::sincos((k + 1) as f64 * q_rad[joint]);
                sum + harmonic.sin_rad * s + harmonic.cos_rad * c
            })
    }
}

impl ResidualNetwork {
    /// Displacement of the flange, and so of every target, in the base frame, mm.
    pub fn displacement_mm(&self, q_rad: &[f64]) -> Vector3<f64> {
        let n_inputs = self.centre_rad.len();
        let inputs: Vec<f64> = q_rad
            .iter()
            .zip(self.centre_rad.iter().zip(&self.half_range_rad))
            .map(|(q, (centre, half))| (q - centre) / half)
            .collect();
        let hidden: Vec<f64> = self
            .hidden_weights
            .chunks_exact(n_inputs)
            .zip(&self.hidden_thresholds)
            .map(|(weights, threshold)| {
                libm::tanh(weights.iter().zip(&inputs).map(|(w, x)| w * x).sum::<f64>() - threshold)
            })
            .collect();
        let output = |k: usize| {
            let weights = &self.output_weights[k * hidden.len()..(k + 1) * hidden.len()];
            weights.iter().zip(&hidden).map(|(w, h)| w * h).sum::<f64>() - self.output_thresholds[k]
        };
        Vector3::new(output(0), output(1), output(2)) * self.scale_mm
    }
}
