//! URDF: parses the chain of joints to a tip link, and replaces only the joint origins in an existing text.

use crate::exchange::{Chain, Origin, origin_of};
use crate::operations::urdf_joint::{CALIBRATED_KINDS, MM, UrdfJoint, invalid, joint, wrong_joint};
use crate::operations::xml_limits;
use crate::wire::issue::{Invalid, Issue, MAX_ISSUES};
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
/// Tips that are nearer to each other than this are at the same place, mm: the resolution of a URDF.
const SAME_PLACE_MM: f64 = 1e-3;

/// A parsed URDF.
pub struct Urdf<'t> {
    text: &'t str,
    joints: Vec<UrdfJoint>,
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
            if !CALIBRATED_KINDS.contains(&kind.as_str()) {
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
        let moving = |path: &[usize]| -> Vec<usize> {
            path.iter()
                .copied()
                .filter(|i| self.joints[*i].joint.axis.is_some())
                .collect()
        };
        if paths.is_empty() && !self.joints.is_empty() {
            let detail = "the URDF's joints form a loop: each link is the parent of another one, so no link is the tip. State the tip, and break the loop";
            return Err(invalid("no_joints", detail));
        }
        let most = n_moving
            .or_else(|| paths.iter().map(|path| moving(path).len()).max())
            .filter(|n| *n > 0);
        let Some(most) = most else {
            return Err(invalid("no_joints", "no joint of the URDF moves"));
        };
        let candidates: Vec<&[usize]> = paths
            .iter()
            .filter(|path| moving(path).len() == most)
            .map(Vec::as_slice)
            .collect();
        let Some(longest) = candidates.iter().max_by_key(|path| path.len()) else {
            if paths.is_empty() {
                return Err(invalid("no_joints", "the URDF has no joints"));
            }
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
            let detail = format!(
                "several chains have {most} joints that move, ending at {}: {}",
                listed(&self.ends(&candidates)),
                self.tips_to_name(&candidates)
            );
            return Err(invalid("several_chains", detail));
        }
        let as_long: Vec<&[usize]> = candidates
            .iter()
            .copied()
            .filter(|path| path.len() == longest.len())
            .collect();
        if n_moving.is_none() && !self.end_at_one_place(&as_long) {
            let detail = format!(
                "several fixed links are equally far from the last joint that moves: {}. Name the tip link",
                listed(&self.ends(&as_long))
            );
            return Err(invalid("several_tips", detail));
        }
        Ok(longest.to_vec())
    }

    fn ends(&self, paths: &[&[usize]]) -> Vec<&str> {
        let last = paths.iter().filter_map(|path| path.last());
        last.map(|i| self.joints[*i].child.as_str()).collect()
    }

    /// Whether chains with the same moving joints end at the same place. Their tips may differ in orientation, as `flange` and `tool0`
    /// usually do.
    fn end_at_one_place(&self, paths: &[&[usize]]) -> bool {
        let tip_mm = |path: &&[usize]| {
            let joints = path.iter().map(|i| self.joints[*i].joint.clone()).collect();
            let chain = Chain { joints };
            chain
                .t_root_tip(&vec![0.0; chain.n_moving()])
                .translation
                .vector
        };
        let mut tips_mm = paths.iter().map(tip_mm);
        let first_mm = tips_mm.next().unwrap_or_default();
        tips_mm.all(|mm| (mm - first_mm).norm() < SAME_PLACE_MM)
    }

    /// The tip links that can be named instead of the ends of these chains. If the ends are moving fingers, these are the links before the
    /// fingers.
    fn tips_to_name(&self, paths: &[&[usize]]) -> String {
        let mut before: Vec<&str> = Vec::new();
        for path in paths {
            let Some(finger) = path.iter().position(|i| !self.joints[*i].is_usable()) else {
                return "name the tip link".into();
            };
            let arm = &path[..finger];
            let is_fixed = |i: &&usize| self.joints[**i].joint.axis.is_none();
            let n_fixed = arm.iter().rev().take_while(is_fixed).count();
            for i in &arm[arm.len() - n_fixed.max(1).min(arm.len())..] {
                let link = self.joints[*i].child.as_str();
                if !before.contains(&link) {
                    before.push(link);
                }
            }
        }
        match before.is_empty() {
            true => "name the tip link".into(),
            false => format!(
                "their last joints cannot be calibrated. Name a link before them as the tip: {}",
                listed(&before)
            ),
        }
    }

    /// Joints of a chain whose limits are in the wrong order.
    pub fn reversed_limits(&self, chain: &UrdfChain) -> Vec<Issue> {
        let joints = chain.indices.iter().map(|i| &self.joints[*i]);
        joints
            .filter_map(|joint| joint.reversed_limits(self.text))
            .take(MAX_ISSUES)
            .collect()
    }

    /// The issues of values that are impossible in metres and radians, the units of a URDF.
    pub fn other_units(&self, chain: &UrdfChain) -> Vec<Issue> {
        let joints = chain.indices.iter().map(|i| &self.joints[*i]);
        joints
            .flat_map(|joint| joint.other_units(self.text))
            .take(MAX_ISSUES)
            .collect()
    }

    /// The issues of angles in a chain that are right angles if read as degrees.
    pub fn angles_in_degrees(&self, chain: &UrdfChain) -> Vec<Issue> {
        let joints = chain.indices.iter().map(|i| &self.joints[*i]);
        joints
            .filter_map(|joint| joint.angles_in_degrees(self.text))
            .take(MAX_ISSUES)
            .collect()
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
