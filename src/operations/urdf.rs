//! URDF: parses the chain of joints to a tip link, and replaces only the joint origins in an existing text.

use crate::exchange::{Chain, ChainJoint, Origin, origin_of, pose_of};
use crate::operations::xml_limits;
use crate::wire::issue::Invalid;
use nalgebra::Vector3;
use roxmltree::{Document, Node, ParsingOptions};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Maximum size of a URDF, bytes. Descriptions with meshes in separate files have about a hundred KiB.
pub const MAX_URDF_BYTES: usize = 4 * 1024 * 1024;
/// Maximum number of XML nodes: elements, texts between them, and comments.
const MAX_NODES: u32 = 250_000;
/// Maximum number of joints of a file. Whole production cells have some hundred joints.
const MAX_JOINTS: usize = 5_000;
/// Maximum number of joints from root to tip.
const MAX_CHAIN: usize = 200;
/// Maximum number of skipped links that are listed. Arms with a hand and cameras have some tens of such links.
const MAX_FRAMES: usize = 200;
/// Maximum number of items that an error lists.
const MAX_LISTED: usize = 10;
/// Maximum length of the text of an error, characters.
const MAX_DETAIL_CHARS: usize = 500;
/// Millimetres in a metre.
const MM: f64 = 1e3;

/// A parsed URDF.
pub struct Urdf<'t> {
    text: &'t str,
    joints: Vec<UrdfJoint>,
}

/// A joint, with the position of its origin in the text.
struct UrdfJoint {
    name: String,
    kind: String,
    parent: String,
    child: String,
    joint: ChainJoint,
    place: OriginPlace,
    /// Byte at which its element begins.
    start: usize,
    /// Why a chain with this joint is refused. The message is written only if it is needed: it counts the lines before the joint.
    fault: Option<&'static str>,
}

/// Position of an `<origin>` element in the text: the ranges of the values of its attributes, and the place where an attribute or the element would
/// be inserted.
#[derive(Clone)]
struct OriginPlace {
    xyz: Option<Range<usize>>,
    rpy: Option<Range<usize>>,
    /// After the name in `<origin`; or, if the joint has no `<origin>`, after the opening tag of the joint.
    insert_at: usize,
    has_element: bool,
}

/// The joints from the root to a tip.
pub struct UrdfChain {
    /// Geometry of the joints, mm and rad.
    pub chain: Chain,
    /// Indices of the joints in the file.
    indices: Vec<usize>,
}

/// The links of a file, grouped by their relation to a chain.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UrdfFrames {
    /// The link at which the chain begins.
    pub root: Option<String>,
    /// The link at which the chain ends.
    pub tip: Option<String>,
    /// Links of the chain that are rigidly attached to the previous link.
    pub fixed: Vec<String>,
    /// Links that are not part of the chain.
    pub skipped: Vec<String>,
}

/// The first [`MAX_LISTED`] items as text, with the number of further items.
fn listed<T: AsRef<str>>(all: &[T]) -> String {
    let shown: Vec<&str> = all.iter().take(MAX_LISTED).map(AsRef::as_ref).collect();
    let more = all.len() - shown.len();
    let tail = if more > 0 {
        format!(" and {more} more")
    } else {
        String::new()
    };
    shown.join(", ") + &tail
}

/// An error whose text is cut to [`MAX_DETAIL_CHARS`], because names and values may be as long as the file.
fn invalid(code: &'static str, detail: impl Into<String>) -> Invalid {
    let mut detail = detail.into();
    if let Some((end, _)) = detail.char_indices().nth(MAX_DETAIL_CHARS) {
        detail.truncate(end);
        detail.push('…');
    }
    Invalid::at("", code, detail)
}

impl<'t> Urdf<'t> {
    /// Parses a URDF.
    ///
    /// # Errors
    /// [`Invalid`] with position and cause, if the bytes are not a URDF.
    pub fn parse(bytes: &'t [u8]) -> Result<Self, Invalid> {
        if bytes.len() > MAX_URDF_BYTES {
            return Err(invalid(
                "too_large",
                format!(
                    "the URDF has {} bytes; at most {MAX_URDF_BYTES} are read",
                    bytes.len()
                ),
            ));
        }
        let text = std::str::from_utf8(bytes)
            .map_err(|e| invalid("not_utf8", format!("the URDF is not UTF-8: {e}")))?;
        xml_limits::check(text)?;
        let options = ParsingOptions {
            nodes_limit: MAX_NODES,
            ..ParsingOptions::default()
        };
        let document = Document::parse_with_options(text, options)
            .map_err(|e| invalid("not_xml", format!("the URDF is not well-formed XML: {e}")))?;
        let robot = document.root_element();
        if robot.tag_name().name() != "robot" {
            let detail = format!(
                "the root element is <{}>; a URDF has <robot>",
                robot.tag_name().name()
            );
            return Err(invalid("not_a_urdf", detail));
        }
        let joints: Vec<Node<'_, '_>> = robot
            .children()
            .filter(|node| node.has_tag_name("joint"))
            .collect();
        if joints.len() > MAX_JOINTS {
            let detail = format!(
                "the URDF has {} joints; at most {MAX_JOINTS} are read",
                joints.len()
            );
            return Err(invalid("too_many_joints", detail));
        }
        let joints = joints
            .into_iter()
            .map(|node| joint(text, node))
            .collect::<Result<_, _>>()?;
        Ok(Self { text, joints })
    }

    /// The joints from the root to the link `tip`. Without `tip`: the chain with `n_moving` moving joints. Without `n_moving` too: the chain with the
    /// most moving joints.
    ///
    /// # Errors
    /// [`Invalid`] if there is no such chain, if there are several that differ, or if a moving joint in it is not revolute.
    pub fn chain(&self, tip: Option<&str>, n_moving: Option<usize>) -> Result<UrdfChain, Invalid> {
        let by_child: BTreeMap<&str, usize> = self
            .joints
            .iter()
            .enumerate()
            .map(|(i, joint)| (joint.child.as_str(), i))
            .collect();
        let indices = match tip {
            Some(tip) if by_child.contains_key(tip) => self.path(tip, &by_child)?,
            Some(tip) => {
                return Err(invalid(
                    "unknown_link",
                    format!("no joint leads to a link {tip:?}"),
                ));
            }
            None => self.longest(&by_child, n_moving)?,
        };
        for index in &indices {
            let UrdfJoint {
                name,
                kind,
                fault,
                start,
                ..
            } = &self.joints[*index];
            if let Some(fault) = fault {
                return Err(wrong_joint(self.text, *start, name, fault));
            }
            if !["revolute", "continuous", "fixed"].contains(&kind.as_str()) {
                let detail = format!(
                    "joint {name:?} is {kind}: only revolute, continuous and fixed joints can be calibrated; name another tip"
                );
                return Err(invalid("unsupported_joint", detail));
            }
        }
        Ok(UrdfChain {
            chain: Chain {
                joints: indices
                    .iter()
                    .map(|i| self.joints[*i].joint.clone())
                    .collect(),
            },
            indices,
        })
    }

    fn path(&self, tip: &str, by_child: &BTreeMap<&str, usize>) -> Result<Vec<usize>, Invalid> {
        let (mut link, mut path) = (tip, Vec::new());
        while let Some(index) = by_child.get(link) {
            path.push(*index);
            if path.len() > MAX_CHAIN {
                return Err(invalid(
                    "no_root",
                    format!(
                        "more than {MAX_CHAIN} joints lead to {tip:?}, or they go round in a circle"
                    ),
                ));
            }
            link = &self.joints[*index].parent;
        }
        path.reverse();
        Ok(path)
    }

    fn longest(
        &self,
        by_child: &BTreeMap<&str, usize>,
        n_moving: Option<usize>,
    ) -> Result<Vec<usize>, Invalid> {
        let parents: BTreeSet<&str> = self.joints.iter().map(|j| j.parent.as_str()).collect();
        let is_leaf = |joint: &&UrdfJoint| !parents.contains(joint.child.as_str());
        let paths = self
            .joints
            .iter()
            .filter(is_leaf)
            .map(|joint| self.path(&joint.child, by_child))
            .collect::<Result<Vec<_>, _>>()?;
        let moving = |path: &Vec<usize>| -> Vec<usize> {
            path.iter()
                .copied()
                .filter(|i| self.joints[*i].joint.axis.is_some())
                .collect()
        };
        let most = n_moving
            .or_else(|| paths.iter().map(|path| moving(path).len()).max())
            .filter(|n| *n > 0);
        let Some(most) = most else {
            let detail = match paths.is_empty() && !self.joints.is_empty() {
                true => {
                    "the URDF's joints form a loop: each link is the parent of another one, so no link is the tip. State the tip, and break the loop"
                }
                false => "no joint of the URDF moves",
            };
            return Err(invalid("no_joints", detail));
        };
        let candidates: Vec<&Vec<usize>> = paths
            .iter()
            .filter(|path| moving(path).len() == most)
            .collect();
        let Some(longest) = candidates.iter().max_by_key(|path| path.len()) else {
            let found: BTreeSet<usize> = paths.iter().map(|path| moving(path).len()).collect();
            let found: Vec<String> = found.iter().map(usize::to_string).collect();
            let detail = format!(
                "no chain has {most} joints that move (there are chains with {}): name the tip link",
                listed(&found)
            );
            return Err(invalid("no_chain", detail));
        };
        let of_longest = moving(longest);
        if candidates.iter().any(|path| moving(path) != of_longest) {
            let ends: Vec<&str> = candidates
                .iter()
                .filter_map(|path| path.last())
                .map(|i| self.joints[*i].child.as_str())
                .collect();
            let detail = format!(
                "several chains have {most} joints that move, ending at {}: name the tip link",
                listed(&ends)
            );
            return Err(invalid("several_chains", detail));
        }
        Ok((*longest).clone())
    }

    /// The links of a chain, and the links of the file that are not part of it.
    pub fn frames(&self, chain: &UrdfChain) -> UrdfFrames {
        let of_chain = |index: &usize| &self.joints[*index];
        let on_way: BTreeSet<&str> = chain
            .indices
            .iter()
            .map(of_chain)
            .flat_map(|joint| [joint.parent.as_str(), joint.child.as_str()])
            .collect();
        let is_fixed = |joint: &&UrdfJoint| joint.joint.axis.is_none();
        let mut told: BTreeSet<&str> = on_way;
        let all = self.joints.iter().flat_map(|j| [&j.parent, &j.child]);
        let skipped = all
            .filter(|link| told.insert(link))
            .take(MAX_FRAMES)
            .cloned()
            .collect();
        let first = chain.indices.first().map(of_chain);
        let last = chain.indices.last().map(of_chain);
        UrdfFrames {
            root: first.map(|joint| joint.parent.clone()),
            tip: last.map(|joint| joint.child.clone()),
            fixed: chain
                .indices
                .iter()
                .map(of_chain)
                .filter(is_fixed)
                .map(|joint| joint.child.clone())
                .collect(),
            skipped,
        }
    }

    /// The text of the URDF, with the origins of the moving joints of `old` replaced by those of `new`. The rest of the text stays unchanged.
    pub fn with_origins(&self, old: &UrdfChain, new: &Chain) -> String {
        let mut edits: Vec<(Range<usize>, String)> = Vec::new();
        for (index, joint) in old
            .indices
            .iter()
            .zip(&new.joints)
            .filter(|(_, joint)| joint.axis.is_some())
        {
            let (place, origin) = (&self.joints[*index].place, origin_of(&joint.t_parent_joint));
            let (xyz, rpy) = (xyz_text(&origin), rpy_text(&origin));
            let at = place.insert_at..place.insert_at;
            if !place.has_element {
                edits.push((at, format!("<origin xyz=\"{xyz}\" rpy=\"{rpy}\"/>")));
                continue;
            }
            for (name, range, value) in [("xyz", &place.xyz, xyz), ("rpy", &place.rpy, rpy)] {
                edits.push(match range {
                    Some(range) => (range.clone(), value),
                    None => (at.clone(), format!(" {name}=\"{value}\"")),
                });
            }
        }
        // Edits are made from the end, so that earlier positions stay valid. Two edits at one position keep their order.
        edits.reverse();
        edits.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
        let mut text = self.text.to_owned();
        for (range, replacement) in edits {
            text.replace_range(range, &replacement);
        }
        text
    }
}

/// The refusal of a joint whose element begins at byte `start`.
fn wrong_joint(text: &str, start: usize, name: &str, what: &str) -> Invalid {
    let line = 1 + text[..start].matches('\n').count();
    invalid(
        "invalid_joint",
        format!("line {line}: joint {name:?} {what}"),
    )
}

fn joint(text: &str, node: Node<'_, '_>) -> Result<UrdfJoint, Invalid> {
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
        child("limit")
            .and_then(|n| n.attribute(name))
            .and_then(|v| v.trim().parse::<f64>().ok())
    };
    let limits_rad = if kind == "revolute" {
        limit("lower")
            .zip(limit("upper"))
            .filter(|(low, high)| low < high)
    } else {
        None
    };
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

/// Three lengths in metres, with enough digits to read back the same floats.
pub fn xyz_text(origin: &Origin) -> String {
    three_text(origin.xyz_mm.map(|mm| mm / MM))
}

/// Three angles in rad.
pub fn rpy_text(origin: &Origin) -> String {
    three_text(origin.rpy_rad)
}

fn three_text([a, b, c]: [f64; 3]) -> String {
    // Adding 0.0 turns a negative zero into a positive one.
    format!("{} {} {}", a + 0.0, b + 0.0, c + 0.0)
}

/// Escapes text for elements and attributes. Characters that XML cannot represent, not even as references, become U+FFFD.
pub fn escaped(text: &str) -> String {
    let is_xml = |c: char| matches!(c, '\t' | '\n' | '\r' | ' '..='\u{fffd}' | '\u{10000}'..);
    let text: String = text
        .chars()
        .map(|c| {
            if is_xml(c) {
                c
            } else {
                char::REPLACEMENT_CHARACTER
            }
        })
        .collect();
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
