//! Exports identified links in the formats of controllers and of other software. Each exported text is read back and compared before it is returned.

mod check;
mod documents;
mod error;
mod source;
mod urdf;

pub use documents::mastering_document;
pub use error::Error;
pub use source::Source;

use crate::exchange::{refit, universal_robots};
use crate::kinematics::{Link, Robot};
use crate::operations::{import_table, robot_models};
use crate::release::{INSISTED, wrong_robot};
use crate::wire::export::{BetaChoice, ExportDocument, ExportFormat, RemainingError};
use crate::wire::issue::Invalid;
use crate::wire::robot_model::RobotModel;

/// An exported text.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// Its media type.
    pub content_type: &'static str,
    /// Extension of its file name.
    pub extension: &'static str,
    /// The text.
    pub text: String,
    /// Remaining error, if the format cannot represent all identified parameters.
    pub remaining: Option<RemainingError>,
}

/// Exports a parameter set.
pub fn export(
    source: &Source<'_>,
    format: ExportFormat,
    beta: BetaChoice,
) -> Result<Exported, Error> {
    if !matches!(format, ExportFormat::Json | ExportFormat::Yaml) {
        refuse_wrong_robot(source)?;
    }
    let (links, remaining) = exported_links(source, beta);
    let same_document = |format, back: &ExportDocument| {
        check::same_links(
            format,
            source.robot,
            &links,
            &back.content.kinematic_links(),
        )
    };
    let (content_type, extension, text) = match format {
        ExportFormat::Json => {
            let document = documents::export_document(source, &links, remaining);
            let text =
                serde_json::to_string_pretty(&document).map_err(|e| unreadable("json", e))?;
            let back = serde_json::from_str(&text).map_err(|e| unreadable("json", e))?;
            same_document("json", &back)?;
            ("application/json", "json", text)
        }
        ExportFormat::Yaml => {
            let document = documents::export_document(source, &links, remaining);
            let text = yaml_serde::to_string(&document).map_err(|e| unreadable("yaml", e))?;
            let back = yaml_serde::from_str(&text).map_err(|e| unreadable("yaml", e))?;
            same_document("yaml", &back)?;
            ("application/yaml", "yaml", text)
        }
        ExportFormat::Csv => {
            let text = documents::csv_text(&links);
            let table =
                import_table::table(text.as_bytes()).map_err(|e| unreadable("csv", e.summary()))?;
            check::same_links("csv", source.robot, &links, &table.links)?;
            ("text/csv", "csv", text)
        }
        ExportFormat::Urdf => {
            let text = urdf::written_text(source, &links);
            check::same_chain("urdf", source.robot, &links, text.as_bytes())?;
            ("application/xml", "urdf", text)
        }
        ExportFormat::UrKinematics => {
            let makers_arms = arms_of_universal_robots()?;
            let described = universal_robots::described(source.robot, &links, &makers_arms);
            let arm = described.map_err(|reason| {
                let detail = format!(
                    "ur_kinematics is for the robots of Universal Robots, with links that begin in the robot's own Base or in base_link of its \
                     description, and this robot is none: {reason}. Take format=urdf, or post the URDF that you use to this path with format=urdf"
                );
                Invalid::at("/format", "not_a_universal_robot", detail)
            })?;
            let sha256 = source
                .content
                .sha256()
                .map_err(|e| unreadable("ur_kinematics", e))?;
            let text = documents::ur_kinematics(&arm, &sha256, &source.remarks());
            let back =
                documents::read_ur_kinematics(&text).map_err(|e| unreadable("ur_kinematics", e))?;
            check::same_description(source.robot, &links, &back, arm.base)?;
            ("application/yaml", "yaml", text)
        }
        ExportFormat::Mastering => return mastering(source),
    };
    Ok(Exported {
        content_type,
        extension,
        text,
        remaining,
    })
}

/// Refuses formats that move a robot, if the set does not fit the robot or its points were refused. Documents with provenance and warnings
/// are still written.
fn refuse_wrong_robot(source: &Source<'_>) -> Result<(), Error> {
    let mut warnings = source.provenance.warnings.iter();
    let insisted = warnings.find(|warning| warning.code == INSISTED);
    let insisted = insisted.map(|warning| (INSISTED, warning.detail.as_str()));
    match wrong_robot(source.provenance).or(insisted) {
        None => Ok(()),
        Some((code, detail)) => {
            let detail = format!("this parameter set is not for a controller: {detail}");
            Err(Invalid::at("/format", code, detail).into())
        }
    }
}

/// The robots of Universal Robots in the library of robot models.
fn arms_of_universal_robots() -> Result<Vec<Robot>, Error> {
    let unreadable_arms = |error: &str| unreadable("ur_kinematics", error);
    let arms = robot_models::find("", Some("Universal Robots")).map_err(unreadable_arms)?;
    let of_model = |model: &&RobotModel| Robot::try_from(&model.robot).map_err(Error::Invalid);
    arms.iter().map(of_model).collect()
}

/// Writes the joint origins of the identified robot into the user's own URDF.
///
/// # Errors
/// [`Error`] if the URDF cannot be read, or does not describe the nominal robot.
pub fn patch_urdf(source: &Source<'_>, bytes: &[u8], tip: Option<&str>) -> Result<Exported, Error> {
    refuse_wrong_robot(source)?;
    let links = source.content.kinematic_links();
    let text = urdf::patched_text(source, &links, bytes, tip)?;
    Ok(Exported {
        content_type: "application/xml",
        extension: "urdf",
        text,
        remaining: None,
    })
}

/// The identified links with beta, or refitted links without beta and their remaining error.
fn exported_links(source: &Source<'_>, beta: BetaChoice) -> (Vec<Link>, Option<RemainingError>) {
    let links = source.content.kinematic_links();
    if beta == BetaChoice::Keep {
        return (links, None);
    }
    let refit = refit::without_beta(source.robot, &links);
    let remaining = RemainingError::from(&refit);
    (refit.links, Some(remaining))
}

fn mastering(source: &Source<'_>) -> Result<Exported, Error> {
    let (identified, base) = (
        source.content.identified_robot(None).plain,
        source.mastering_base(),
    );
    let refit = refit::mastering(source.robot, &identified, base);
    let document = mastering_document(source.robot, &refit, base);
    let offsets_rad = document.offsets_rad();
    let shifted = |q: &[f64]| -> Vec<f64> {
        q.iter()
            .zip(&offsets_rad)
            .map(|(q, offset)| q + offset)
            .collect()
    };
    let nominal = |q_controller: &[f64]| {
        crate::kinematics::t_base_flange(
            &source.robot.links,
            &source.robot.q_model_rad(&shifted(q_controller)),
        )
    };
    check::same_at_controller("mastering", source.robot, &refit.links, &nominal)?;
    let text = serde_json::to_string_pretty(&document).map_err(|e| unreadable("mastering", e))?;
    Ok(Exported {
        content_type: "application/json",
        extension: "json",
        text,
        remaining: Some(document.remaining_error_mm),
    })
}

fn unreadable(format: &'static str, cause: impl std::fmt::Display) -> Error {
    Error::ReadBack {
        format,
        cause: cause.to_string(),
    }
}
