//! Imports robots from URDF files and tables of parameters.

use crate::exchange::dh::links_of_distal;
use crate::exchange::{ImportedLinks, links_of_chain};
use crate::identification::workspace::random_configurations;
use crate::kinematics::model::MAX_LINKS;
use crate::kinematics::{Link, Robot, t_base_flange};
use crate::operations::import_digits::{clean, with_right_angles};
use crate::operations::import_json::{csv_of_json, is_json};
use crate::operations::urdf::{Urdf, UrdfFrames};
use crate::wire::angle::{to_degrees, to_radians};
use crate::wire::frames::Transform;
use crate::wire::import::{ImportAnswer, ImportDigits, ImportFormat};
use crate::wire::issue::{Invalid, Issue};
use crate::wire::robot::{LinkBody, RobotBody};
use nalgebra::IsometryMatrix3;

/// Number of configurations at which an import is compared with its source.
const N_CONFIGURATIONS: usize = 100;
/// Maximum size of a table, bytes. A dozen rows with nine columns have two KiB.
const MAX_TABLE_BYTES: usize = 64 * 1024;
/// Largest allowed difference between import and source, mm.
const SAME_MM: f64 = 1e-9;

/// A table of link parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The numbers of the table, in the convention of the table.
    pub links: Vec<Link>,
    /// Lower and upper limit of each joint, rad, if given.
    pub limits_rad: Vec<Option<(f64, f64)>>,
}

/// As [`import_with`], with [`ImportDigits::Exact`].
///
/// # Errors
/// As [`import_with`].
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
            let frames = urdf.frames(&found);
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
            let mut found = answer(name, joints, &imported, limits, &described)?;
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
                    issues: vec![at(
                        Some(row),
                        "beta_deg",
                        "unused",
                        "a distal table has no beta",
                    )],
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
        alpha_deg: clean(to_degrees(link.alpha_rad)),
        d_mm: clean(link.d_mm),
        theta_offset_deg: clean(to_degrees(link.theta_offset_rad)),
        beta_deg: (link.beta_rad != 0.0).then(|| to_degrees(link.beta_rad)),
        joint_limits_deg: limits
            .map(|(low, high)| [clean(to_degrees(low)), clean(to_degrees(high))]),
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
            "links and description differ by {largest_difference_mm:.1e} mm: two neighbouring axes may be too near to each other"
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

/// Parses a table in CSV or JSON.
fn table_of_any(bytes: &[u8]) -> Result<Table, Invalid> {
    if bytes.len() <= MAX_TABLE_BYTES && is_json(bytes) {
        table(&csv_of_json(bytes)?)
    } else {
        table(bytes)
    }
}

/// Parses a CSV table with one row per link, from base to flange. Required columns: `a_mm` or `a_m`, `alpha_deg` or `alpha_rad`, `d_mm` or `d_m`,
/// `theta_offset_deg` or `theta_offset_rad`. Optional columns: `beta_deg` or `beta_rad`, `min_deg` and `max_deg` (or `_rad`), `link`.
///
/// # Errors
/// [`Invalid`] with the row and column of each error.
pub fn table(bytes: &[u8]) -> Result<Table, Invalid> {
    if bytes.len() > MAX_TABLE_BYTES {
        let detail = format!(
            "the table has {} bytes; at most {MAX_TABLE_BYTES} are read",
            bytes.len()
        );
        return Err(Invalid::at("", "too_large", detail));
    }
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(bytes);
    let unreadable =
        |e: csv::Error| Invalid::at("", "unreadable_table", format!("the table is not CSV: {e}"));
    let header: Vec<String> = reader
        .headers()
        .map_err(unreadable)?
        .iter()
        .map(|name| name.trim_start_matches('\u{feff}').to_owned())
        .collect();
    let columns = columns(&header)?;
    let (mut table, mut issues) = (
        Table {
            links: vec![],
            limits_rad: vec![],
        },
        Vec::new(),
    );
    for (i, record) in reader.records().take(MAX_LINKS + 1).enumerate() {
        let record = record.map_err(unreadable)?;
        let mut values = [None; 7];
        for (index, (quantity, factor)) in columns
            .iter()
            .enumerate()
            .filter_map(|(index, c)| Some((index, (*c)?)))
        {
            let text = record.get(index).unwrap_or_default();
            match text.parse::<f64>() {
                Ok(number) if number.is_finite() => {
                    values[quantity] = Some(if factor == 0.0 {
                        to_radians(number)
                    } else {
                        number * factor
                    })
                }
                _ if text.is_empty() && quantity >= 4 => {}
                _ => issues.push(at(
                    Some(i),
                    &header[index],
                    "not_a_number",
                    &format!("{text:?} is not a number"),
                )),
            }
        }
        let [a_mm, alpha, d_mm, theta, beta, low, high] = values;
        table.links.push(Link {
            a_mm: a_mm.unwrap_or(0.0),
            alpha_rad: alpha.unwrap_or(0.0),
            d_mm: d_mm.unwrap_or(0.0),
            theta_offset_rad: theta.unwrap_or(0.0),
            beta_rad: beta.unwrap_or(0.0),
        });
        table.limits_rad.push(low.zip(high));
    }
    if table.links.is_empty() || table.links.len() > MAX_LINKS {
        issues.push(Issue {
            code: "wrong_length".into(),
            detail: format!("1 to {MAX_LINKS} rows are allowed, one per link"),
            ..Issue::default()
        });
    }
    if issues.is_empty() {
        Ok(table)
    } else {
        Err(Invalid {
            code: "invalid_table",
            issues,
        })
    }
}

/// The quantity of each column, and the factor from its unit to mm or rad (0 for degrees).
fn columns(header: &[String]) -> Result<Vec<Option<(usize, f64)>>, Invalid> {
    const NAMES: [(&str, &str); 7] = [
        ("a", "mm"),
        ("alpha", "deg"),
        ("d", "mm"),
        ("theta_offset", "deg"),
        ("beta", "deg"),
        ("min", "deg"),
        ("max", "deg"),
    ];
    let mut found = [false; 7];
    let mut of = |name: &String| -> Result<Option<(usize, f64)>, Invalid> {
        if name == "link" {
            return Ok(None);
        }
        let known = NAMES.iter().enumerate().find_map(|(i, (quantity, kind))| {
            let unit = name.strip_prefix(quantity)?.strip_prefix('_')?;
            let factor = match (*kind, unit) {
                ("mm", "mm") | ("deg", "rad") => 1.0,
                ("mm", "m") => 1e3,
                ("deg", "deg") => 0.0,
                _ => return None,
            };
            Some((i, factor))
        });
        let Some((i, factor)) = known else {
            let detail = format!(
                "the column {name:?} is not known; a table has a_mm, alpha_deg, d_mm, theta_offset_deg (or _m, _rad), and may have beta_deg, min_deg, max_deg, link"
            );
            return Err(Invalid {
                code: "invalid_table",
                issues: vec![at(None, name, "unknown_column", &detail)],
            });
        };
        if std::mem::replace(&mut found[i], true) {
            return Err(Invalid {
                code: "invalid_table",
                issues: vec![at(
                    None,
                    name,
                    "repeated_column",
                    "this quantity stands in two columns",
                )],
            });
        }
        Ok(Some((i, factor)))
    };
    let columns = header.iter().map(&mut of).collect::<Result<Vec<_>, _>>()?;
    let missing: Vec<Issue> = (0..4)
        .filter(|i| !found[*i])
        .map(|i| {
            at(
                None,
                &format!("{}_{}", NAMES[i].0, NAMES[i].1),
                "missing_column",
                "this column is needed",
            )
        })
        .collect();
    if missing.is_empty() {
        Ok(columns)
    } else {
        Err(Invalid {
            code: "invalid_table",
            issues: missing,
        })
    }
}

fn at(row: Option<usize>, column: &str, code: &str, detail: &str) -> Issue {
    Issue {
        row,
        column: Some(column.into()),
        code: code.into(),
        detail: detail.into(),
        ..Issue::default()
    }
}
