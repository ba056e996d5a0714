//! Imports robots from URDF files and tables of parameters.

use crate::exchange::dh::links_of_distal;
use crate::exchange::{ImportedLinks, links_of_chain};
use crate::identification::statistics::workspace::random_configurations;
use crate::kinematics::model::MAX_LINKS;
use crate::kinematics::{Link, Robot, t_base_flange};
use crate::operations::import_digits::{clean, with_right_angles};
use crate::operations::import_table::{Table, table_of_any};
use crate::operations::urdf::{Urdf, UrdfFrames};
use crate::wire::frames::Transform;
use crate::wire::import::{ImportAnswer, ImportDigits, ImportFormat};
use crate::wire::issue::{Invalid, Issue};
use crate::wire::robot::{LinkBody, RobotBody};
use nalgebra::IsometryMatrix3;

/// Number of configurations at which an import is compared with its source.
const N_CONFIGURATIONS: usize = 100;
/// Largest allowed difference between import and source, mm.
const SAME_MM: f64 = 1e-9;

/// As [`import_with`], with [`ImportDigits::Exact`].
pub fn import(
    bytes: &[u8],
    format: ImportFormat,
    name: &str,
    tip: Option<&str>,
) -> Result<ImportAnswer, Invalid> {
    import_with(bytes, format, ImportDigits::Exact, name, tip)
}

/// Imports a robot from a description.
///
/// # Errors
/// [`Invalid`] with row and column if the description cannot be read, or if kincal cannot represent the robot.
pub fn import_with(
    bytes: &[u8],
    format: ImportFormat,
    digits: ImportDigits,
    name: &str,
    tip: Option<&str>,
) -> Result<ImportAnswer, Invalid> {
    match format {
        ImportFormat::Urdf => {
            let urdf = Urdf::parse(bytes)?;
            let found = urdf.chain(tip, None)?;
            let reversed = urdf.reversed_limits(&found);
            if !reversed.is_empty() {
                return Err(invalid_values(reversed));
            }
            let in_degrees = urdf.angles_in_degrees(&found);
            if !in_degrees.is_empty() {
                return Err(invalid_values(in_degrees));
            }
            let frames = urdf.frames(&found);
            let other_units = urdf.other_units(&found);
            let chain = found.chain;
            if chain.n_moving() > MAX_LINKS {
                let detail = format!(
                    "{} joints move; at most {MAX_LINKS} are allowed: name a tip link further in",
                    chain.n_moving()
                );
                return Err(Invalid::at("", "wrong_length", detail));
            }
            let moving = chain.joints.iter().filter(|joint| joint.axis.is_some());
            let (joints, limits): (Vec<String>, Vec<_>) = moving
                .map(|joint| (joint.name.clone(), joint.limits_rad))
                .unzip();
            let meant = match digits {
                ImportDigits::Exact => chain.clone(),
                ImportDigits::Source => with_right_angles(&chain),
            };
            let imported = links_of_chain(&meant);
            let described = |q: &[f64]| meant.t_root_tip(q);
            let found = answer(name, joints, &imported, limits, &described);
            let mut found = found.map_err(|refusal| {
                let is_too_large = refusal.issues.iter().any(|i| i.code == "out_of_range");
                match is_too_large && !other_units.is_empty() {
                    true => invalid_values(other_units),
                    false => refusal,
                }
            })?;
            if digits == ImportDigits::Source {
                let robot = Robot::try_from(&found.robot)?;
                let written = |q: &[f64]| chain.t_root_tip(q);
                found.largest_difference_mm = largest_difference(&robot, &imported, &written);
            }
            let UrdfFrames {
                root,
                tip,
                fixed,
                skipped,
            } = frames;
            Ok(ImportAnswer {
                root,
                tip,
                fixed_frames: fixed,
                skipped_frames: skipped,
                ..found
            })
        }
        ImportFormat::Dh => {
            let Table {
                links: rows,
                limits_rad,
            } = table_of_any(bytes)?;
            if let Some(row) = rows.iter().position(|row| row.beta_rad != 0.0) {
                return Err(Invalid {
                    code: "invalid_table",
                    issues: vec![Issue {
                        row: Some(row),
                        column: Some("beta_deg".into()),
                        code: "unused".into(),
                        detail: "a distal table has no beta".into(),
                        ..Issue::default()
                    }],
                });
            }
            answer(name, vec![], &links_of_distal(&rows), limits_rad, &|q| {
                distal(&rows, q)
            })
        }
        ImportFormat::Mdh => {
            let Table { links, limits_rad } = table_of_any(bytes)?;
            let identity = IsometryMatrix3::identity();
            let imported = ImportedLinks {
                t_root_base: identity,
                links: links.clone(),
                t_flange_tip: identity,
            };
            answer(name, vec![], &imported, limits_rad, &|q| {
                t_base_flange(&links, q)
            })
        }
    }
}

/// The refusal of a URDF for values of its joints.
fn invalid_values(issues: Vec<Issue>) -> Invalid {
    Invalid {
        code: "invalid_joint",
        issues,
    }
}

/// Pose of the flange in the distal convention: product of Rz(q + theta)·Dz(d)·Dx(a)·Rx(alpha) over the rows.
fn distal(rows: &[Link], q_rad: &[f64]) -> IsometryMatrix3<f64> {
    use crate::kinematics::forward::t_previous_link;
    rows.iter()
        .zip(q_rad)
        .fold(IsometryMatrix3::identity(), |t, (row, q)| {
            let about_z = Link {
                a_mm: 0.0,
                alpha_rad: 0.0,
                ..*row
            };
            // Dx(a) and Rx(alpha) commute: Dx(a)·Rx(alpha) = Rx(alpha)·Dx(a).
            t * t_previous_link(&about_z, *q)
                * t_previous_link(
                    &Link {
                        a_mm: row.a_mm,
                        alpha_rad: row.alpha_rad,
                        ..Link::default()
                    },
                    0.0,
                )
        })
}

fn answer(
    name: &str,
    joints: Vec<String>,
    imported: &ImportedLinks,
    limits_rad: Vec<Option<(f64, f64)>>,
    described: &dyn Fn(&[f64]) -> IsometryMatrix3<f64>,
) -> Result<ImportAnswer, Invalid> {
    let link = |(link, limits): (&Link, &Option<(f64, f64)>)| LinkBody {
        a_mm: clean(link.a_mm),
        alpha_deg: clean(link.alpha_rad.to_degrees()),
        d_mm: clean(link.d_mm),
        theta_offset_deg: clean(link.theta_offset_rad.to_degrees()),
        beta_deg: (link.beta_rad != 0.0).then(|| link.beta_rad.to_degrees()),
        joint_limits_deg: limits
            .map(|(low, high)| [clean(low.to_degrees()), clean(high.to_degrees())]),
    };
    let robot = RobotBody {
        name: name.into(),
        serial_number: None,
        description: None,
        links: imported.links.iter().zip(&limits_rad).map(link).collect(),
        mounting: None,
        joint_map: None,
    };
    let core = Robot::try_from(&robot)?;
    let largest_difference_mm = largest_difference(&core, imported, described);
    if largest_difference_mm.is_nan() || largest_difference_mm > SAME_MM {
        let detail = format!(
            "links and description differ by {largest_difference_mm:.1e} mm: the description's digits may be rounded. Import with digits=source \
             (kincal import --digits source), which restores right angles and states how far that moves the tip; or write more digits"
        );
        return Err(Invalid::at("", "not_expressible", detail));
    }
    let (t_root_base, t_flange_tip) = (
        Transform::from(&imported.t_root_base),
        Transform::from(&imported.t_flange_tip),
    );
    Ok(ImportAnswer {
        robot,
        joints,
        t_root_base,
        t_flange_tip,
        largest_difference_mm,
        root: None,
        tip: None,
        fixed_frames: vec![],
        skipped_frames: vec![],
    })
}

fn largest_difference(
    robot: &Robot,
    imported: &ImportedLinks,
    described: &dyn Fn(&[f64]) -> IsometryMatrix3<f64>,
) -> f64 {
    let difference = |q: Vec<f64>| {
        let ours = imported.t_root_base * t_base_flange(&robot.links, &q) * imported.t_flange_tip;
        let theirs = described(&q);
        // Rotation differences are converted to mm at a distance of one metre.
        let turn = (ours.rotation.matrix() - theirs.rotation.matrix()).amax() * 1e3;
        (ours.translation.vector - theirs.translation.vector)
            .norm()
            .max(turn)
    };
    random_configurations(robot, N_CONFIGURATIONS, 0)
        .into_iter()
        .map(difference)
        .fold(0.0, f64::max)
}
