//! `kincal import`: makes a robot file from a URDF or a table.

use super::files::{cannot_be_used, read};
use super::terminal::{Output, plain};
use super::usage::Usage;
use crate::operations::import::import_with;
use crate::wire::frames::Transform;
use crate::wire::import::{ImportAnswer, ImportDigits, ImportFormat};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::path::{Path, PathBuf};

/// Make a robot file from a URDF or a table of Denavit-Hartenberg parameters.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A URDF (xacro expanded), or a CSV or JSON table with a_mm, alpha_deg, d_mm, theta_offset_deg (or theta_deg), one row per link.
    #[arg(value_name = "ROBOT.urdf|TABLE.csv|TABLE.json")]
    file: PathBuf,
    /// Format of the file [default: urdf for .urdf and .xml]. A table needs it: dh is the distal convention, mdh Craig's.
    #[arg(long, env = "KINCAL_CONVENTION", value_enum)]
    convention: Option<ImportFormat>,
    /// The robot's name [default: the file's name].
    #[arg(long, env = "KINCAL_NAME")]
    name: Option<String>,
    /// The link at the end of the robot, in a URDF with several.
    #[arg(long, env = "KINCAL_TIP", value_name = "LINK")]
    tip: Option<String>,
    /// Digits of the numbers: `source` replaces angles of a URDF that are a rounded multiple of 90° by the exact multiple.
    #[arg(long, env = "KINCAL_DIGITS", value_enum, default_value = "exact")]
    digits: ImportDigits,
    #[command(flatten)]
    output: Output,
}

/// Prints the robot on standard output, and what its links cannot represent on standard error. With `--json`, the answer of `POST /v1/robot-imports` is printed:
/// the robot, and how the description was understood.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let bytes = read(&arguments.file)?;
    let format = format_of(&arguments.file, arguments.convention)?;
    let stem = arguments.file.file_stem().map_or_else(
        || "imported robot".into(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    let name = arguments.name.as_deref().unwrap_or(&stem);
    let tip = arguments.tip.as_deref();
    let imported = import_with(&bytes, format, arguments.digits, name, tip)
        .map_err(|invalid| Usage(cannot_be_used(&arguments.file, &invalid.issues)))?;
    if !arguments.output.json {
        print_notes(&imported);
    }
    arguments.output.print(&imported, || {
        serde_json::to_string_pretty(&imported.robot).unwrap_or_default()
    })
}

/// The format of a description. A table of links does not say its convention.
pub fn format_of(file: &Path, stated: Option<ImportFormat>) -> Result<ImportFormat, Usage> {
    let is_urdf = ["urdf", "xml"].iter().any(|name| {
        file.extension()
            .is_some_and(|e| e.eq_ignore_ascii_case(name))
    });
    let by_name = is_urdf.then_some(ImportFormat::Urdf);
    stated.or(by_name).ok_or_else(|| {
        Usage(format!(
            "{}: a table of links has one of two conventions: give --convention dh (Rz·Dz·Dx·Rx, distal, standard) or --convention mdh (Rx·Dx·Rz·Dz, Craig, modified)",
            file.display()
        ))
    })
}

/// Prints on standard error how the description was understood, and what the links cannot represent.
pub fn print_notes(imported: &ImportAnswer) {
    if let (Some(root), Some(tip)) = (&imported.root, &imported.tip) {
        eprintln!("note: the arm is from {} to {}", plain(root), plain(tip));
    }
    for (what, frames) in [
        (
            "fixed frames of the arm, included in its link parameters",
            &imported.fixed_frames,
        ),
        (
            "frames that are not part of the arm",
            &imported.skipped_frames,
        ),
    ] {
        if !frames.is_empty() {
            eprintln!("note: {what}: {}", plain(&frames.join(", ")));
        }
    }
    for (what, t) in [
        (
            "base of the links in the description's root",
            imported.t_root_base,
        ),
        ("tip on the links' flange", imported.t_flange_tip),
    ] {
        if t != IDENTITY {
            eprintln!("note: the {what} is {}", in_words(&t));
        }
    }
    let apart = match imported.largest_difference_mm {
        mm if mm < SAME_MM => format!("are the same to {SAME_MM} mm"),
        mm => format!("differ by at most {mm:.6} mm"),
    };
    eprintln!("note: links and description {apart} over random configurations");
}

/// Rounded to four decimals, without a negative zero.
fn rounded(value: f64) -> f64 {
    (1e4 * value).round() / 1e4 + 0.0
}

/// Translation and rotation of a frame as text.
fn in_words(t: &Transform) -> String {
    let [x, y, z] = t.translation_mm.map(rounded);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| t.rotation[i][j]));
    // The axis of a half turn is found from the quaternion only.
    let turned = match UnitQuaternion::from_rotation_matrix(&rotation).axis_angle() {
        Some((axis, rad)) => format!(
            "turned by {:.4}° about ({:.4}, {:.4}, {:.4})",
            rad.to_degrees(),
            rounded(axis.x),
            rounded(axis.y),
            rounded(axis.z)
        ),
        None => "not turned".into(),
    };
    format!("at {x:.4}, {y:.4}, {z:.4} mm, {turned}")
}

/// Smallest difference between links and description that is reported, mm.
const SAME_MM: f64 = 1e-6;
const IDENTITY: Transform = Transform {
    rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    translation_mm: [0.0, 0.0, 0.0],
};
