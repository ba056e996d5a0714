//! One joint of a URDF: its parsed values, their places in the text, and faults that matter only if the joint is part of the arm.

use crate::exchange::{ChainJoint, Origin, pose_of};
use crate::operations::import_digits::degrees_of_rad;
use crate::wire::issue::{Invalid, Issue};
use crate::wire::robot::{MAX_JOINT_DEG, MAX_LENGTH_MM};
use nalgebra::Vector3;
use roxmltree::Node;
use std::ops::Range;

/// Maximum length of the text of an error, characters.
const MAX_DETAIL_CHARS: usize = 500;
/// Kinds of joints that can be part of a calibrated arm.
pub(super) const CALIBRATED_KINDS: [&str; 3] = ["revolute", "continuous", "fixed"];
/// Millimetres in a metre.
pub(super) const MM: f64 = 1e3;

/// A joint, with the position of its origin in the text.
pub(super) struct UrdfJoint {
    pub(super) name: String,
    pub(super) kind: String,
    pub(super) parent: String,
    pub(super) child: String,
    pub(super) joint: ChainJoint,
    pub(super) place: OriginPlace,
    /// Byte at which its element begins.
    pub(super) start: usize,
    /// Its lower and upper limit as the file has them, rad.
    pub(super) limits: Option<(f64, f64)>,
    /// Why a chain with this joint is refused. The full message is made only when needed, because it counts the lines before the joint.
    pub(super) fault: Option<&'static str>,
}

/// Position of an `<origin>` element in the text: the ranges of the values of its attributes, and the place where an attribute or the element would
/// be inserted.
#[derive(Clone)]
pub(super) struct OriginPlace {
    pub(super) xyz: Option<Range<usize>>,
    pub(super) rpy: Option<Range<usize>>,
    /// After the name in `<origin`; or, if the joint has no `<origin>`, after the opening tag of the joint.
    pub(super) insert_at: usize,
    pub(super) has_element: bool,
}

/// An error whose text is cut to [`MAX_DETAIL_CHARS`], because names and values may be as long as the file.
pub(super) fn invalid(code: &'static str, detail: impl Into<String>) -> Invalid {
    Invalid::at("", code, cut(detail.into()))
}

fn cut(mut detail: String) -> String {
    if let Some((end, _)) = detail.char_indices().nth(MAX_DETAIL_CHARS) {
        detail.truncate(end);
        detail.push('…');
    }
    detail
}

/// The refusal of a joint whose element begins at byte `start`.
pub(super) fn wrong_joint(text: &str, start: usize, name: &str, what: &str) -> Invalid {
    invalid("invalid_joint", at_line(text, start, name, what))
}

fn at_line(text: &str, start: usize, name: &str, what: &str) -> String {
    let line = 1 + text[..start].matches('\n').count();
    cut(format!("line {line}: joint {name:?} {what}"))
}

impl UrdfJoint {
    /// Whether an arm with this joint can be calibrated.
    pub(super) fn is_usable(&self) -> bool {
        self.fault.is_none() && CALIBRATED_KINDS.contains(&self.kind.as_str())
    }

    /// The issue of limits in the wrong order. Equal limits mean that there are none.
    pub(super) fn reversed_limits(&self, text: &str) -> Option<Issue> {
        let (low, high) = self.limits.filter(|(low, high)| low > high)?;
        let what = format!(
            "has the limits lower={low} and upper={high}: the lower one is above the upper one; swap them"
        );
        Some(self.issue(text, "limits_reversed", &what))
    }

    /// The issues of values that are impossible in metres and radians, the units of a URDF.
    pub(super) fn other_units(&self, text: &str) -> Vec<Issue> {
        let mut found = Vec::new();
        let largest_mm = self.joint.t_parent_joint.translation.vector.amax();
        if let Some(xyz) = self
            .place
            .xyz
            .clone()
            .filter(|_| largest_mm > MAX_LENGTH_MM)
        {
            let what = format!(
                "has xyz={:?}: a URDF is in metres, and so this is {} m. If the file is in millimetres, divide its lengths by 1000",
                &text[xyz],
                largest_mm / MM
            );
            found.push(self.issue(text, "not_in_metres", &what));
        }
        let limits = self
            .limits
            .iter()
            .flat_map(|(low, high)| [("lower", low), ("upper", high)]);
        for (name, rad) in limits.filter(|(_, rad)| rad.to_degrees().abs() > MAX_JOINT_DEG) {
            let what = format!(
                "has {name}={rad}: a URDF is in radians, and so this is {:.0}°. If the file is in degrees, write {:.6}",
                rad.to_degrees(),
                rad.to_radians()
            );
            found.push(self.issue(text, "not_in_radians", &what));
        }
        found
    }

    /// The issue of angles of the origin that exceed a turn and are right angles if read as degrees.
    pub(super) fn angles_in_degrees(&self, text: &str) -> Option<Issue> {
        let rpy = &text[self.place.rpy.clone()?];
        let mut angles = rpy
            .split_whitespace()
            .filter_map(|angle| angle.parse().ok());
        let is_in_degrees =
            |angle: &f64| angle.abs() > std::f64::consts::TAU + 0.01 && angle % 90.0 == 0.0;
        let deg: f64 = angles.find(is_in_degrees)?;
        let what = format!(
            "has rpy={rpy:?}: a URDF is in radians, and so this is {:.0}°. If the file is in degrees, write {:.6} for {deg}",
            deg.to_degrees(),
            deg.to_radians()
        );
        Some(self.issue(text, "not_in_radians", &what))
    }

    fn issue(&self, text: &str, code: &str, what: &str) -> Issue {
        Issue::at("", code, at_line(text, self.start, &self.name, what))
    }
}

/// Reads a joint.
///
/// # Errors
/// [`Invalid`] if a value that any joint needs cannot be read.
pub(super) fn joint(text: &str, node: Node<'_, '_>) -> Result<UrdfJoint, Invalid> {
    let name = node.attribute("name").unwrap_or_default().to_owned();
    let start = node.range().start;
    let wrong = |what: &str| wrong_joint(text, start, &name, what);
    let child = |tag: &str| node.children().find(|child| child.has_tag_name(tag));
    let link = |tag: &str| {
        child(tag)
            .and_then(|n| n.attribute("link"))
            .map(str::to_owned)
            .ok_or_else(|| wrong(&format!("has no {tag} link")))
    };
    let kind = node.attribute("type").unwrap_or_default().to_owned();
    let origin = child("origin");
    let three = |node: Option<Node<'_, '_>>, name: &str, default: [f64; 3]| match node
        .and_then(|n| n.attribute(name))
    {
        None => Ok(default),
        Some(value) => three_numbers(value).ok_or_else(|| {
            wrong(&format!(
                "has {name}={value:?}, which is not three numbers; expand xacro first"
            ))
        }),
    };
    let xyz_m = three(origin, "xyz", [0.0; 3])?;
    let rpy_rad = three(origin, "rpy", [0.0; 3])?;
    let axis = Vector3::from(three(child("axis"), "xyz", [1.0, 0.0, 0.0])?);
    let is_moving = kind != "fixed";
    let fault = match is_moving {
        true if axis.norm() < 1e-6 => Some("has an axis of no length"),
        true if child("mimic").is_some() => {
            Some("mimics another: such couplings cannot be calibrated from a URDF")
        }
        _ => None,
    };
    let limit = |name: &str| {
        let text = child("limit").and_then(|n| n.attribute(name))?.trim();
        Some((text.parse::<f64>().ok()?, degrees_of_rad(text)?))
    };
    let limits = match kind.as_str() {
        "revolute" => limit("lower").zip(limit("upper")),
        _ => None,
    };
    let limits_rad = limits
        .filter(|(low, high)| low.0 < high.0)
        .map(|(low, high)| (low.1.to_radians(), high.1.to_radians()));
    let chain_joint = ChainJoint {
        name: name.clone(),
        t_parent_joint: pose_of(&Origin {
            xyz_mm: xyz_m.map(|m| m * MM),
            rpy_rad,
        }),
        axis: is_moving.then(|| axis.normalize()),
        limits_rad,
    };
    let value = |name: &str| {
        origin
            .and_then(|n| n.attribute_node(name))
            .map(|attribute| inside_quotes(text, attribute.range()))
    };
    let insert_at = match origin {
        Some(element) => after_name(text, element.range()),
        None => opening_tag_end(text, node),
    };
    let place = OriginPlace {
        xyz: value("xyz"),
        rpy: value("rpy"),
        insert_at,
        has_element: origin.is_some(),
    };
    Ok(UrdfJoint {
        parent: link("parent")?,
        child: link("child")?,
        name,
        kind,
        joint: chain_joint,
        place,
        start,
        limits: limits.map(|(low, high)| (low.0, high.0)),
        fault,
    })
}

/// Range of the value in `name="value"`. The range that roxmltree gives is wrong after very long names or many spaces.
fn inside_quotes(text: &str, attribute: Range<usize>) -> Range<usize> {
    let to_quote = text[attribute.clone()].find(['"', '\'']).unwrap_or(0);
    attribute.start + to_quote + 1..attribute.end - 1
}

/// Position after the name in the opening tag of an element. The name may have a namespace prefix.
fn after_name(text: &str, element: Range<usize>) -> usize {
    let ends = |c: char| c.is_ascii_whitespace() || matches!(c, '/' | '>');
    let length = text[element.clone()].find(ends);
    length.map_or(element.end, |length| element.start + length)
}

/// Position after the `>` of the opening tag of an element. The element has children, so this is the start of its first child.
fn opening_tag_end(text: &str, node: Node<'_, '_>) -> usize {
    node.first_child()
        .map_or_else(|| text.len(), |child| child.range().start)
}

fn three_numbers(text: &str) -> Option<[f64; 3]> {
    let numbers = text
        .split_whitespace()
        .map(|number| number.parse::<f64>().ok().filter(|n| n.is_finite()));
    numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()
}
