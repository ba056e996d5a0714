//! Exports as documents: JSON, YAML, CSV, mastering offsets and UR kinematics.

use super::Source;
use crate::compensation::Base;
use crate::exchange::refit::{Refit, is_mastered};
use crate::exchange::universal_robots::{FRAMES, UrArm};
use crate::exchange::{Chain, ChainJoint, Origin, pose_of};
use crate::kinematics::{Link, Robot};
use crate::wire::compensate::ErrorFrame;
use crate::wire::export::{ExportDocument, MasteringDocument, MasteringOffset, RemainingError};
use crate::wire::parameter_set::IdentifiedLink;
use nalgebra::{DVector, Vector3};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// The export document of a parameter set. With `remaining_error_mm` its links are replaced by `links`.
pub fn export_document(
    source: &Source<'_>,
    links: &[Link],
    remaining_error_mm: Option<RemainingError>,
) -> ExportDocument {
    let mut content = source.content.clone();
    if remaining_error_mm.is_some() {
        content.links = links.iter().map(IdentifiedLink::from).collect();
    }
    ExportDocument {
        parameter_set_id: source.id.into(),
        robot: source.body.clone(),
        content,
        remaining_error_mm,
        provenance: source.provenance.clone(),
    }
}

/// The joint offsets of links that were refitted in the frame of `base`: δq_controller = (coupling · sign)⁻¹ · δtheta_offset.
pub fn mastering_document(robot: &Robot, refit: &Refit, base: Base) -> MasteringDocument {
    let n = robot.links.len();
    let change = DVector::from_fn(n, |i, _| {
        refit.links[i].theta_offset_rad - robot.links[i].theta_offset_rad
    });
    let offsets = robot.joint_rates().lu().solve(&change).unwrap_or(change);
    let joint = |i: usize| MasteringOffset {
        joint: i + 1,
        offset_deg: f64::to_degrees(offsets[i]),
        determined: is_mastered(i, n, base),
    };
    MasteringDocument {
        joints: (0..n).map(joint).collect(),
        remaining_error_mm: RemainingError::from(refit),
        frame: ErrorFrame::from(base),
    }
}

/// A CSV table with one row per link. `kincal import` reads it as a table in Craig's convention.
pub fn csv_text(links: &[Link]) -> String {
    let mut text = String::from("link,a_mm,alpha_deg,d_mm,theta_offset_deg,beta_deg\n");
    for (i, link) in links.iter().map(IdentifiedLink::from).enumerate() {
        let IdentifiedLink {
            a_mm,
            alpha_deg,
            d_mm,
            theta_offset_deg,
            beta_deg,
        } = link;
        let _ = writeln!(
            text,
            "{},{a_mm},{alpha_deg},{d_mm},{theta_offset_deg},{beta_deg}",
            i + 1
        );
    }
    text
}

/// The origins of the joints in the format of `kinematics:` in a UR description: x, y, z in metres, roll, pitch, yaw in rad. The hash in the file is
/// not that of a controller, so the driver will print a warning.
pub fn ur_kinematics(arm: &UrArm, sha256: &str, remarks: &[String]) -> String {
    let remarks: String = remarks
        .iter()
        .map(|remark| format!("# {remark}\n"))
        .collect();
    let mut text = format!(
        "# Joint origins of the identified robot, in place of those in ur_description (default_kinematics.yaml).\n\
         # The shoulder's origin is in base_link_inertia: the Base of the teach pendant, and base_link turned by 180 degrees about z.\n\
         # The robot's links, and positions in its base frame, begin in: {}.\n\
         {remarks}\
         kinematics:\n",
        arm.base.name()
    );
    for (name, origin) in FRAMES.iter().zip(arm.chain.origins()) {
        let Origin {
            xyz_mm: [x, y, z],
            rpy_rad: [roll, pitch, yaw],
        } = origin;
        let _ = writeln!(text, "  {name}:");
        for (key, value) in [
            ("x", x / 1e3),
            ("y", y / 1e3),
            ("z", z / 1e3),
            ("roll", roll),
            ("pitch", pitch),
            ("yaw", yaw),
        ] {
            let _ = writeln!(text, "    {key}: {:?}", value + 0.0);
        }
    }
    let _ = writeln!(text, "  hash: kincal_{sha256}");
    text
}

#[derive(Deserialize)]
struct UrFile {
    kinematics: BTreeMap<String, UrEntry>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum UrEntry {
    Frame {
        x: f64,
        y: f64,
        z: f64,
        roll: f64,
        pitch: f64,
        yaw: f64,
    },
    Hash(#[allow(dead_code, reason = "read and left")] String),
}

/// Reads the chain that a file of [`ur_kinematics`] describes.
///
/// # Errors
/// A description of the problem, if the text is not such a file.
pub fn read_ur_kinematics(text: &str) -> Result<Chain, String> {
    let file: UrFile = yaml_serde::from_str(text).map_err(|e| e.to_string())?;
    let joint = |name: &str| match file.kinematics.get(name) {
        Some(UrEntry::Frame {
            x,
            y,
            z,
            roll,
            pitch,
            yaw,
        }) => {
            let origin = Origin {
                xyz_mm: [x * 1e3, y * 1e3, z * 1e3],
                rpy_rad: [*roll, *pitch, *yaw],
            };
            Ok(ChainJoint {
                name: name.into(),
                t_parent_joint: pose_of(&origin),
                axis: Some(Vector3::z()),
                limits_rad: None,
            })
        }
        _ => Err(format!("no frame {name}")),
    };
    Ok(Chain {
        joints: FRAMES
            .iter()
            .map(|name| joint(name))
            .collect::<Result<_, _>>()?,
    })
}
