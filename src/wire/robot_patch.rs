//! Edits of a robot.

use crate::kinematics::{JointMap, Robot};
use crate::wire::issue::Invalid;
use crate::wire::joint_map::JointMapBody;
use crate::wire::robot::{MountingBody, RobotBody};
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

/// Changes of a robot. An absent field keeps its value; null removes the value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotPatchBody {
    /// Its name.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_non_null"
    )]
    #[schema(value_type = String, min_length = 1, max_length = 200, required = false)]
    pub name: Option<String>,
    /// Serial number of the manufacturer.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_nullable"
    )]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 200)]
    pub serial_number: Option<Option<String>>,
    /// Free text.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_nullable"
    )]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 10000)]
    pub description: Option<Option<String>>,
    /// Mounting of the robot. Earlier results keep the mounting that they were computed with.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_nullable"
    )]
    #[schema(value_type = Option<MountingBody>)]
    pub mounting: Option<Option<MountingBody>>,
    /// Lower and upper limit of each joint, degrees; null for a joint without limits.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_non_null"
    )]
    #[schema(value_type = Vec<Option<[f64; 2]>>, min_items = 1, max_items = 12, required = false)]
    pub joint_limits_deg: Option<Vec<Option<[f64; 2]>>>,
    /// The joint map. A change is refused (409) if a parameter set was already released.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_nullable"
    )]
    #[schema(value_type = Option<JointMapBody>)]
    pub joint_map: Option<Option<JointMapBody>>,
}

/// A robot after an edit.
#[derive(Clone, Debug, PartialEq)]
pub struct EditedRobot {
    /// The robot.
    pub body: RobotBody,
    /// Names of the fields that have changed.
    pub changed: Vec<&'static str>,
    /// Whether the joint map has changed, so that the controller's joint values now have another meaning.
    pub changes_joint_map: bool,
}

/// Deserialises a field that may be absent but not null.
fn deserialize_non_null<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// Deserialises a field so that null (`Some(None)`) differs from an absent field (`None`).
fn deserialize_nullable<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

impl RobotPatchBody {
    /// Applies the changes to a robot.
    ///
    /// # Errors
    /// [`Invalid`] if the number of joint limits differs from the number of joints, or if the edited robot is not valid.
    pub fn apply(self, before: &RobotBody) -> Result<EditedRobot, Invalid> {
        let mut body = before.clone();
        if let Some(name) = self.name {
            body.name = name;
        }
        if let Some(serial_number) = self.serial_number {
            body.serial_number = serial_number;
        }
        if let Some(description) = self.description {
            body.description = description;
        }
        if let Some(mounting) = self.mounting {
            body.mounting = mounting;
        }
        if let Some(joint_map) = self.joint_map {
            body.joint_map = joint_map;
        }
        if let Some(limits) = self.joint_limits_deg {
            let (n, expected) = (limits.len(), body.links.len());
            if n != expected {
                let detail = format!(
                    "{n} limits for {expected} joints: one [lower, upper] or null per joint"
                );
                return Err(Invalid::at("/joint_limits_deg", "wrong_length", detail));
            }
            for (link, limits) in body.links.iter_mut().zip(limits) {
                link.joint_limits_deg = limits;
            }
        }
        let robot = Robot::try_from(&body).map_err(at_patched_fields)?;
        let is_changed = [
            ("name", body.name != before.name),
            ("serial_number", body.serial_number != before.serial_number),
            ("description", body.description != before.description),
            ("mounting", body.mounting != before.mounting),
            ("joint_limits_deg", body.links != before.links),
            ("joint_map", body.joint_map != before.joint_map),
        ];
        Ok(EditedRobot {
            changed: is_changed
                .into_iter()
                .filter_map(|(field, is_changed)| is_changed.then_some(field))
                .collect(),
            changes_joint_map: effective_map(&robot) != effective_map(&Robot::try_from(before)?),
            body,
        })
    }
}

/// Converts JSON pointers of a robot to pointers into the patch. A robot has its joint limits inside its links, the patch in a separate
/// field.
fn at_patched_fields(mut invalid: Invalid) -> Invalid {
    for issue in &mut invalid.issues {
        let Some(pointer) = &mut issue.pointer else {
            continue;
        };
        let of_link = pointer.strip_prefix("/links/");
        if let Some((link, rest)) = of_link.and_then(|at| at.split_once("/joint_limits_deg")) {
            *pointer = format!("/joint_limits_deg/{link}{rest}");
        }
    }
    invalid
}

/// The joint map of a robot; the identity if it has none.
fn effective_map(robot: &Robot) -> JointMap {
    let identity = JointMapBody {
        sign: None,
        offset_deg: None,
        coupling: None,
    };
    robot
        .joint_map
        .clone()
        .unwrap_or_else(|| identity.joint_map(robot.links.len()))
}

impl RobotBody {
    /// This robot with the joint limits, the name and the serial number of `now`. A result keeps the kinematic model that it was computed with, but
    /// the current joint limits apply.
    pub fn with_limits_of(mut self, now: &Self) -> Self {
        for (link, now) in self.links.iter_mut().zip(&now.links) {
            link.joint_limits_deg = now.joint_limits_deg;
        }
        self.name.clone_from(&now.name);
        self.serial_number.clone_from(&now.serial_number);
        self
    }
}
