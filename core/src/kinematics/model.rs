//! Plain data that describes a robot of 1 to 12 revolute links.

use nalgebra::{DMatrix, Vector3};

/// Maximum number of links of a robot: more than any industrial arm on a track with a wrist extension has.
pub const MAX_LINKS: usize = 12;

/// One link in modified Denavit-Hartenberg form (Craig), with Hayati's second tilt beta:
/// `T_{i-1,i} = Rx(alpha) · Dx(a) · Ry(beta) · Rz(q + theta_offset) · Dz(d)`. With beta 0 it is [Gao 2018, eq. 3].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Link {
    /// Distance from axis i-1 to axis i along x_{i-1}, mm.
    pub a_mm: f64,
    /// Angle from axis i-1 to axis i about x_{i-1}, rad.
    pub alpha_rad: f64,
    /// Distance from x_{i-1} to x_i along axis i, mm.
    pub d_mm: f64,
    /// Offset added to the joint value q_i, rad.
    pub theta_offset_rad: f64,
    /// Second tilt of the axis: the angle about y after the shift by a, rad; nominally 0.
    pub beta_rad: f64,
}

/// Conversion of the controller's joint values to the model's: `q_model = coupling · (sign ∘ q_controller) + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct JointMap {
    /// +1 or -1 for each joint.
    pub sign: Vec<f64>,
    /// Added last, rad.
    pub offset_rad: Vec<f64>,
    /// n × n, invertible; the identity if joints are not coupled.
    pub coupling: DMatrix<f64>,
}

impl JointMap {
    /// The model's joint values for the controller's, rad.
    pub fn to_model(&self, q_controller_rad: &[f64]) -> Vec<f64> {
        let n = self.sign.len();
        (0..n)
            .map(|i| {
                (0..n)
                    .map(|j| self.coupling[(i, j)] * self.sign[j] * q_controller_rad[j])
                    .sum::<f64>()
                    + self.offset_rad[i]
            })
            .collect()
    }

    /// ∂q_model/∂q_controller, n × n: the coupling with the signs on its columns.
    pub fn rates(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.sign.len(), self.sign.len(), |i, j| {
            self.coupling[(i, j)] * self.sign[j]
        })
    }
}

/// Mounting of the robot: the direction of gravity in the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    /// Unit vector along gravity, in the base frame.
    pub gravity_in_base: Vector3<f64>,
    /// Uncertainty of that direction, rad (one standard deviation).
    pub std_rad: f64,
}

/// A robot with its nominal (catalogue) links, base to flange.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Links 1..n in order, base to flange.
    pub links: Vec<Link>,
    /// Lower and upper limit of each joint, rad, if known.
    pub joint_limits_rad: Vec<Option<(f64, f64)>>,
    /// The controller's joint convention, if it differs from the model's.
    pub joint_map: Option<JointMap>,
    /// Gravity in the base frame, if known.
    pub mounting: Option<Mounting>,
}

/// Reach for which comments convert a share of the reach to millimetres.
pub const USUAL_REACH_MM: f64 = 1700.0;

/// Length of an arm along its links, mm: sum of |a| + |d|. It is the unit of every length that is a threshold. An arm without lengths, for example
/// one whose axes meet in a point, has all of its reach in tool and targets, which the links do not contain. Its reach counts as [`USUAL_REACH_MM`].
pub fn reach_mm(links: &[Link]) -> f64 {
    match links.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum() {
        0.0 => USUAL_REACH_MM,
        reach_mm => reach_mm,
    }
}

impl Robot {
    /// The model's joint values for the controller's, rad, through the joint map if there is one.
    pub fn q_model_rad(&self, q_controller_rad: &[f64]) -> Vec<f64> {
        match &self.joint_map {
            Some(map) => map.to_model(q_controller_rad),
            None => q_controller_rad.to_vec(),
        }
    }

    /// ∂q_model/∂q_controller, n × n; the identity without a joint map.
    pub fn joint_rates(&self) -> DMatrix<f64> {
        self.joint_map.as_ref().map_or_else(
            || DMatrix::identity(self.links.len(), self.links.len()),
            JointMap::rates,
        )
    }

    /// A robot without limits, joint map or mounting.
    pub fn from_links(links: Vec<Link>) -> Self {
        let joint_limits_rad = vec![None; links.len()];
        Self {
            links,
            joint_limits_rad,
            joint_map: None,
            mounting: None,
        }
    }
}
