//! URDF of the identified robot: either a new file, or the user's own URDF with new joint origins.

use super::{Error, Source, check};
use crate::exchange::transplant::transplanted;
use crate::exchange::{Chain, origin_of};
use crate::identification::statistics::workspace::random_configurations;
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::{Link, t_base_flange};
use crate::operations::urdf::{Urdf, escaped, rpy_text, xyz_text};
use crate::wire::issue::Invalid;
use nalgebra::{IsometryMatrix3, Vector3};
use std::fmt::Write;

/// Number of configurations at which a patched URDF is compared.
const N_CONFIGURATIONS: usize = 50;

/// Writes a new URDF with `base_link`, `link_1` … `link_n` (the flange) and all reflectors. Its joint values are those of the controller, or those of
/// the model if the joint map couples joints.
pub fn written_text(source: &Source<'_>, links: &[Link]) -> String {
    let map = source.robot.joint_map.as_ref();
    let uncoupled = map.filter(|map| map.coupling.is_identity(0.0));
    let is_controllers = map.is_none() || uncoupled.is_some();
    let mut text = String::from("<?xml version=\"1.0\"?>\n");
    let _ = writeln!(text, "<robot name=\"{}\">", escaped(&source.body.name));
    if !is_controllers {
        text += "  <!-- joint values are those of kincal's model: the controller's are coupled, which a URDF cannot say -->\n";
    }
    for remark in source.remarks() {
        let _ = writeln!(text, "  <!-- {remark} -->");
    }
    text += "  <link name=\"base_link\"/>\n";
    for (i, link) in links.iter().enumerate() {
        let (sign, offset) = uncoupled.map_or((1.0, 0.0), |map| (map.sign[i], map.offset_rad[i]));
        let origin = origin_of(&t_previous_link(link, offset));
        let limits = source.robot.joint_limits_rad[i].filter(|_| is_controllers);
        let kind = if limits.is_some() {
            "revolute"
        } else {
            "continuous"
        };
        let parent = if i == 0 {
            "base_link".to_owned()
        } else {
            format!("link_{i}")
        };
        let _ = writeln!(
            text,
            "  <link name=\"link_{}\"/>\n  <joint name=\"joint_{}\" type=\"{kind}\">",
            i + 1,
            i + 1
        );
        let _ = writeln!(
            text,
            "    <parent link=\"{parent}\"/>\n    <child link=\"link_{}\"/>",
            i + 1
        );
        let _ = writeln!(
            text,
            "    <origin xyz=\"{}\" rpy=\"{}\"/>\n    <axis xyz=\"0 0 {sign}\"/>",
            xyz_text(&origin),
            rpy_text(&origin)
        );
        if let Some((low, high)) = limits {
            let _ = writeln!(
                text,
                "    <limit lower=\"{low}\" upper=\"{high}\" effort=\"0\" velocity=\"0\"/>"
            );
        }
        text += "  </joint>\n";
    }
    for target in source
        .content
        .targets
        .iter()
        .filter(|target| target.segment.is_none())
    {
        let [x, y, z] = target.position_mm.map(|mm| mm / 1e3);
        let (n, number) = (links.len(), target.target);
        let _ = writeln!(
            text,
            "  <link name=\"target_{number}\"/>\n  <joint name=\"target_{number}_joint\" type=\"fixed\">"
        );
        let _ = writeln!(
            text,
            "    <parent link=\"link_{n}\"/>\n    <child link=\"target_{number}\"/>\n    <origin xyz=\"{x} {y} {z}\" rpy=\"0 0 0\"/>\n  </joint>"
        );
    }
    text += "</robot>\n";
    text
}

/// Replaces the origins of the moving joints in the user's URDF, reads the result back and compares it.
pub fn patched_text(
    source: &Source<'_>,
    links: &[Link],
    bytes: &[u8],
    tip: Option<&str>,
) -> Result<String, Error> {
    let urdf = Urdf::parse(bytes)?;
    let old = urdf.chain(tip, Some(links.len()))?;
    let new = transplanted(&old.chain, source.robot, links).map_err(|mismatch| {
        let detail = format!("the URDF is not this robot: {mismatch}; is it the same type, and are the nominal links right?");
        Invalid::at("", "urdf_mismatch", detail)
    })?;
    let text = urdf.with_origins(&old, &new);
    let back = Urdf::parse(text.as_bytes())?
        .chain(tip, Some(links.len()))?
        .chain;
    let unlike = |cause: String| Error::ReadBack {
        format: "urdf",
        cause,
    };
    let (mm, turn) = largest_difference(&new, &back, source);
    if !(mm <= check::SAME_MM && turn <= check::SAME_MM) {
        return Err(unlike(format!(
            "the tip is {mm:.1e} mm away from what was meant"
        )));
    }
    let mm = worst_against_links(&back, source, links);
    if mm > check::SAME_MM {
        Err(unlike(format!(
            "it moves {mm:.1e} mm unlike the identified links"
        )))
    } else {
        Ok(text)
    }
}

fn largest_difference(a: &Chain, b: &Chain, source: &Source<'_>) -> (f64, f64) {
    let apart = |q: Vec<f64>| {
        let (a, b) = (a.t_root_tip(&q), b.t_root_tip(&q));
        (
            (a.translation.vector - b.translation.vector).norm(),
            (a.rotation.matrix() - b.rotation.matrix()).amax(),
        )
    };
    let all = random_configurations(source.robot, N_CONFIGURATIONS, 2)
        .into_iter()
        .map(apart);
    all.fold((0.0, 0.0), |worst: (f64, f64), at| {
        (worst.0.max(at.0), worst.1.max(at.1))
    })
}

/// Largest difference between the motions of a chain and of links, mm. Constant transformations before the chain and after it (tool Y) are ignored.
/// Between configurations q and p the tip moves by Y⁻¹·F(q)⁻¹·F(p)·Y. The angle of this motion and the distance along its axis do not depend on Y, so
/// these two are compared.
fn worst_against_links(chain: &Chain, source: &Source<'_>, links: &[Link]) -> f64 {
    let screw = |a: &IsometryMatrix3<f64>, b: &IsometryMatrix3<f64>| {
        let t = a.inverse() * b;
        let m = t.rotation.matrix();
        let axis = Vector3::new(
            m[(2, 1)] - m[(1, 2)],
            m[(0, 2)] - m[(2, 0)],
            m[(1, 0)] - m[(0, 1)],
        );
        (m.trace(), axis.dot(&t.translation.vector))
    };
    let configurations = random_configurations(source.robot, N_CONFIGURATIONS, 3);
    let differences = |to_model: &dyn Fn(&[f64]) -> Vec<f64>| {
        let pair = |pair: &[Vec<f64>]| {
            let theirs = screw(&chain.t_root_tip(&pair[0]), &chain.t_root_tip(&pair[1]));
            let ours = screw(
                &t_base_flange(links, &to_model(&pair[0])),
                &t_base_flange(links, &to_model(&pair[1])),
            );
            // Rotation differences are multiplied by 1000 mm: a rotation error of 1e-15 moves a point at one metre by 1e-12 mm.
            ((theirs.0 - ours.0).abs() * 1e3).max((theirs.1 - ours.1).abs())
        };
        configurations.windows(2).map(pair).fold(0.0, f64::max)
    };
    differences(&|q| source.robot.q_model_rad(q)).min(differences(&<[f64]>::to_vec))
}
