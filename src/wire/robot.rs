//! JSON types of robots.

pub use crate::kinematics::Robot;
use crate::kinematics::model::MAX_LINKS;
use crate::kinematics::{Link, Mounting};
use crate::wire::issue::{Checker, Invalid};
pub use crate::wire::joint_map::JointMapBody;
use crate::wire::joint_map::matrix;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum length of a name or serial number, characters.
pub const MAX_NAME: usize = 200;
/// Maximum length of a description, characters.
pub const MAX_DESCRIPTION: usize = 10_000;
/// Largest |a| and |d|, mm. No industrial arm has a link of 10 m.
pub const MAX_LENGTH_MM: f64 = 10_000.0;
/// Largest |alpha| and |theta_offset|, degrees: a full turn.
pub const MAX_ANGLE_DEG: f64 = 360.0;
/// Largest |beta|, degrees. Beta is a small misalignment of nearly parallel axes.
pub const MAX_BETA_DEG: f64 = 45.0;
/// Largest absolute joint limit, degrees: ten turns, for wrists without end stops.
pub const MAX_JOINT_DEG: f64 = 3_600.0;
/// Largest absolute value in a coupling matrix.
pub const MAX_COUPLING: f64 = 10.0;
/// Smallest absolute determinant of a coupling matrix. With a smaller one the matrix counts as not invertible.
const MIN_COUPLING_DETERMINANT: f64 = 1e-6;
/// Largest deviation of the length of a gravity direction from 1.
pub(super) const GRAVITY_TOLERANCE: f64 = 1e-3;
/// Standard deviation of the direction of gravity for a robot on a floor, wall or ceiling, degrees.
const DEFAULT_MOUNTING_STD_DEG: f64 = 2.0;

/// A robot with its nominal (catalogue) links, from base to flange.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotBody {
    /// Name of the robot. It need not be unique.
    #[schema(min_length = 1, max_length = 200)]
    pub name: String,
    /// Serial number of the manufacturer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub serial_number: Option<String>,
    /// Free text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 10000)]
    pub description: Option<String>,
    /// Links 1..n in order, from base to flange. All joints are revolute.
    #[schema(min_items = 1, max_items = 12)]
    pub links: Vec<LinkBody>,
    /// Mounting of the robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mounting: Option<MountingBody>,
    /// The joint map, if the joint convention of the controller differs from that of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint_map: Option<JointMapBody>,
}

/// One link in modified Denavit-Hartenberg form (Craig): Rx(alpha) · Dx(a) · Ry(beta) · Rz(q + theta_offset) · Dz(d).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LinkBody {
    /// Distance from axis i-1 to axis i along x of i-1, mm.
    #[schema(minimum = -10000, maximum = 10000)]
    pub a_mm: f64,
    /// Angle from axis i-1 to axis i about x of i-1, degrees.
    #[schema(minimum = -360, maximum = 360)]
    pub alpha_deg: f64,
    /// Distance along axis i, mm.
    #[schema(minimum = -10000, maximum = 10000)]
    pub d_mm: f64,
    /// Offset that is added to the joint value, degrees.
    #[schema(minimum = -360, maximum = 360)]
    pub theta_offset_deg: f64,
    /// Hayati parameter for nearly parallel axes, degrees; default: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = -45, maximum = 45)]
    pub beta_deg: Option<f64>,
    /// Lower and upper joint limit, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint_limits_deg: Option<[f64; 2]>,
}

/// Mounting of the robot, which determines the direction of gravity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(
    untagged,
    expecting = "mounting is \"floor\", \"wall\", \"ceiling\" or {gravity_in_base: [x, y, z], std_deg}"
)]
pub enum MountingBody {
    /// One of the usual mountings.
    Named(NamedMounting),
    /// Any other mounting, given by the direction of gravity.
    Direction(GravityDirection),
}

/// Usual mountings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NamedMounting {
    /// Gravity along -z of the base frame.
    Floor,
    /// Gravity along +x of the base frame (the base is rotated by 90° about y). For a wall mounting with another orientation give `gravity_in_base`.
    Wall,
    /// Gravity along +z of the base frame.
    Ceiling,
}

/// Direction of gravity in the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GravityDirection {
    /// Unit vector along gravity, in the base frame.
    pub gravity_in_base: [f64; 3],
    /// One standard deviation of the direction, degrees.
    #[schema(minimum = 0, maximum = 90)]
    pub std_deg: f64,
}

/// A robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotAnswer {
    /// Opaque identifier.
    pub id: String,
    /// Its name.
    pub name: String,
    /// Serial number of the manufacturer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial_number: Option<String>,
    /// Free text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub description: Option<String>,
    /// Links 1..n in order, from base to flange.
    pub links: Vec<LinkBody>,
    /// Mounting of the robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mounting: Option<MountingBody>,
    /// The joint map from the controller's joint values to those of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint_map: Option<JointMapBody>,
    /// `ok`, or `check_robot`: a session did not fit the robot. In the state `check_robot` no parameter set can be released until a session fits or a
    /// person gives a reason.
    pub state: RobotStateName,
    /// In the state `check_robot`: the job whose measurement set does not fit the robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub check_job_id: Option<String>,
    /// The last reason that was given for why the robot is in order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checked: Option<CheckedAnswer>,
    /// Version: 1 for a new robot; each edit adds 1.
    #[schema(minimum = 1)]
    pub version: i64,
    /// When it was archived: RFC 3339, UTC. An archived robot accepts no uploads, jobs and releases.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<String>,
    /// RFC 3339, UTC.
    pub created_at: String,
}

/// Whether parameter sets of a robot can be released.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RobotStateName {
    /// All sessions fit the robot, or a reason was given.
    Ok,
    /// A session did not fit the robot.
    CheckRobot,
}

/// The reason that a person gave for why the robot is in order although a session did not fit it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CheckedAnswer {
    /// The reason.
    pub reason: String,
    /// Id of the key that gave the reason.
    pub by: String,
    /// RFC 3339, UTC.
    pub at: String,
}

/// Makes all checks and converts the body. The error lists every invalid field.
impl TryFrom<&RobotBody> for Robot {
    type Error = Invalid;

    fn try_from(body: &RobotBody) -> Result<Self, Invalid> {
        let mut checker = Checker::default();
        body.check(&mut checker);
        checker.finish("invalid_robot")?;
        Ok(Self {
            links: body.links.iter().map(Link::from).collect(),
            joint_limits_rad: body
                .links
                .iter()
                .map(|l| {
                    l.joint_limits_deg
                        .map(|[lo, hi]| (lo.to_radians(), hi.to_radians()))
                })
                .collect(),
            joint_map: body
                .joint_map
                .as_ref()
                .map(|map| map.joint_map(body.links.len())),
            mounting: body.mounting.map(Mounting::from),
        })
    }
}

impl RobotBody {
    fn check(&self, checker: &mut Checker) {
        checker.text("/name", &self.name, MAX_NAME);
        if let Some(serial_number) = &self.serial_number {
            checker.text("/serial_number", serial_number, MAX_NAME);
        }
        if let Some(description) = &self.description {
            checker.text("/description", description, MAX_DESCRIPTION);
        }
        let n = self.links.len();
        let links = "links, from base to flange";
        checker.count("/links", n, 1..=MAX_LINKS, links);
        if !(1..=MAX_LINKS).contains(&n) {
            return;
        }
        self.links
            .iter()
            .enumerate()
            .for_each(|(i, link)| link.check(&format!("/links/{i}"), checker));
        if let Some(map) = &self.joint_map {
            map.check(n, checker);
        }
        if let Some(MountingBody::Direction(direction)) = &self.mounting {
            direction.check(checker);
        }
    }
}

impl From<&LinkBody> for Link {
    fn from(link: &LinkBody) -> Self {
        Self {
            a_mm: link.a_mm,
            alpha_rad: link.alpha_deg.to_radians(),
            d_mm: link.d_mm,
            theta_offset_rad: link.theta_offset_deg.to_radians(),
            beta_rad: f64::to_radians(link.beta_deg.unwrap_or(0.0)),
        }
    }
}

impl LinkBody {
    fn check(&self, at: &str, checker: &mut Checker) {
        let degrees = "angles are in degrees";
        for (name, value, limit, hint) in [
            (
                "a_mm",
                self.a_mm,
                MAX_LENGTH_MM,
                "lengths are in millimetres",
            ),
            (
                "d_mm",
                self.d_mm,
                MAX_LENGTH_MM,
                "lengths are in millimetres",
            ),
            ("alpha_deg", self.alpha_deg, MAX_ANGLE_DEG, degrees),
            (
                "theta_offset_deg",
                self.theta_offset_deg,
                MAX_ANGLE_DEG,
                degrees,
            ),
            (
                "beta_deg",
                self.beta_deg.unwrap_or(0.0),
                MAX_BETA_DEG,
                "beta is a small misalignment",
            ),
        ] {
            checker.magnitude(format!("{at}/{name}"), value, limit, hint);
        }
        let Some([lo, hi]) = self.joint_limits_deg else {
            return;
        };
        let limits = format!("{at}/joint_limits_deg");
        checker.magnitudes(&limits, &[lo, hi], MAX_JOINT_DEG, degrees);
        if lo >= hi {
            checker.add(
                format!("{at}/joint_limits_deg"),
                "limits_reversed",
                format!("[{lo}, {hi}]: the lower limit comes first"),
            );
        }
    }
}

impl JointMapBody {
    fn check(&self, n: usize, checker: &mut Checker) {
        if let Some(sign) = &self.sign {
            checker.length("/joint_map/sign", sign.len(), n, "one sign per link");
            for (i, s) in sign.iter().enumerate().filter(|(_, s)| s.abs() != 1.0) {
                checker.add(
                    format!("/joint_map/sign/{i}"),
                    "out_of_range",
                    format!("{s} is neither 1 nor -1"),
                );
            }
        }
        if let Some(offsets) = &self.offset_deg {
            checker.length(
                "/joint_map/offset_deg",
                offsets.len(),
                n,
                "one offset per link",
            );
            let hint = "angles are in degrees";
            checker.magnitudes("/joint_map/offset_deg", offsets, MAX_ANGLE_DEG, hint);
        }
        if let Some(coupling) = &self.coupling {
            check_coupling(coupling, n, checker);
        }
    }
}

fn check_coupling(rows: &[Vec<f64>], n: usize, checker: &mut Checker) {
    let at = "/joint_map/coupling";
    if !checker.length(at, rows.len(), n, "one row per link") {
        return;
    }
    let mut square = true;
    for (i, row) in rows.iter().enumerate() {
        let at = format!("{at}/{i}");
        square &= checker.length(&at, row.len(), n, "one column per link");
        let hint = "couplings are ratios of joint angles";
        checker.magnitudes(&at, row, MAX_COUPLING, hint);
    }
    if square && matrix(rows).determinant().abs() < MIN_COUPLING_DETERMINANT {
        checker.add(
            at,
            "not_invertible",
            "the matrix cannot be inverted; a robot without couplings has the identity",
        );
    }
}

impl GravityDirection {
    fn check(&self, checker: &mut Checker) {
        let length = Vector3::from(self.gravity_in_base).norm();
        if length.is_nan() || (length - 1.0).abs() > GRAVITY_TOLERANCE {
            let detail = format!(
                "its length is {length}; give the unit vector along which things fall, e.g. [0, 0, -1] for a robot on the floor"
            );
            checker.add("/mounting/gravity_in_base", "not_a_direction", detail);
        }
        checker.within("/mounting/std_deg", self.std_deg, 0.0..=90.0, "degrees");
    }
}

impl From<MountingBody> for Mounting {
    fn from(mounting: MountingBody) -> Self {
        use MountingBody::{Direction, Named};
        let (gravity, std_deg) = match mounting {
            Named(NamedMounting::Floor) => ([0.0, 0.0, -1.0], DEFAULT_MOUNTING_STD_DEG),
            Named(NamedMounting::Wall) => ([1.0, 0.0, 0.0], DEFAULT_MOUNTING_STD_DEG),
            Named(NamedMounting::Ceiling) => ([0.0, 0.0, 1.0], DEFAULT_MOUNTING_STD_DEG),
            Direction(direction) => (direction.gravity_in_base, direction.std_deg),
        };
        Self {
            gravity_in_base: Vector3::from(gravity).normalize(),
            std_rad: std_deg.to_radians(),
        }
    }
}
