//! Identified links in the formats of controllers and of other software. Each text is read back and compared before it is handed out.

mod check;
mod documents;
mod urdf;

pub use documents::{
    ExportAnswer, ExportDocument, MasteringDocument, MasteringOffset, RemainingError,
};

use crate::exchange::refit;
use crate::kinematics::{Link, Robot};
use crate::wire::issue::Invalid;
use crate::wire::measurement::Warning;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::robot::RobotBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How a parameter set is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExportFormat {
    /// The nominal robot and what was identified; `kincal compensate` reads it.
    #[default]
    Json,
    /// The same.
    Yaml,
    /// One row per link.
    Csv,
    /// A description for simulation and planning.
    Urdf,
    /// Joint origins as the drivers of Universal Robots read them; six joints.
    UrKinematics,
    /// Joint offsets for controllers that take nothing else.
    Mastering,
}

/// What becomes of Hayati's beta.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BetaChoice {
    /// It stays.
    #[default]
    Keep,
    /// The links with beta 0 that come nearest over the workspace, and how far they are off.
    Refit,
}

/// A text to hand out.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// Its media type.
    pub content_type: &'static str,
    /// Ending of a file name for it.
    pub extension: &'static str,
    /// The text.
    pub text: String,
    /// What is lost with it, where something is.
    pub remaining: Option<RemainingError>,
}

/// Why there is no export.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The robot or the URDF cannot be written that way.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// What was written reads back as another robot: a fault of ours.
    #[error("the {format} export does not read back: {cause}")]
    ReadBack {
        /// The format.
        format: &'static str,
        /// How.
        cause: String,
    },
}

/// What is exported.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// The parameter set's id.
    pub id: &'a str,
    /// The nominal robot as it was given.
    pub body: &'a RobotBody,
    /// The same for the core.
    pub robot: &'a Robot,
    /// What was identified.
    pub content: &'a ParameterSetContent,
    /// What one should know before using it.
    pub warnings: &'a [Warning],
}

/// The text of a parameter set.
///
/// # Errors
/// [`Error`].
pub fn export(
    source: &Source<'_>,
    format: ExportFormat,
    beta: BetaChoice,
) -> Result<Exported, Error> {
    let (links, remaining) = links_of(source, beta);
    match format {
        ExportFormat::Json => {
            let document = ExportDocument::new(source, &links, remaining);
            let text =
                serde_json::to_string_pretty(&document).map_err(|e| unreadable("json", e))?;
            let back: ExportDocument =
                serde_json::from_str(&text).map_err(|e| unreadable("json", e))?;
            check::same_links("json", source.robot, &links, &back.content.links_to_core())?;
            Ok(Exported {
                content_type: "application/json",
                extension: "json",
                text,
                remaining,
            })
        }
        ExportFormat::Yaml => {
            let document = ExportDocument::new(source, &links, remaining);
            let text = yaml_serde::to_string(&document).map_err(|e| unreadable("yaml", e))?;
            let back: ExportDocument =
                yaml_serde::from_str(&text).map_err(|e| unreadable("yaml", e))?;
            check::same_links("yaml", source.robot, &links, &back.content.links_to_core())?;
            Ok(Exported {
                content_type: "application/yaml",
                extension: "yaml",
                text,
                remaining,
            })
        }
        ExportFormat::Csv => {
            let text = documents::csv_of(&links);
            let table = crate::wire::import::table(text.as_bytes())
                .map_err(|e| unreadable("csv", e.summary()))?;
            check::same_links("csv", source.robot, &links, &table.links)?;
            Ok(Exported {
                content_type: "text/csv",
                extension: "csv",
                text,
                remaining,
            })
        }
        ExportFormat::Urdf => {
            let text = urdf::written(source, &links);
            check::same_chain("urdf", source.robot, &links, text.as_bytes())?;
            Ok(Exported {
                content_type: "application/xml",
                extension: "urdf",
                text,
                remaining,
            })
        }
        ExportFormat::UrKinematics => {
            if links.len() != 6 {
                let detail = format!(
                    "UR kinematics have six joints; this robot has {}: take urdf or json",
                    links.len()
                );
                return Err(Invalid::at("", "not_six_joints", detail).into());
            }
            let sha256 = source
                .content
                .sha256()
                .map_err(|e| unreadable("ur_kinematics", e))?;
            let text = documents::ur_kinematics(&links, &sha256);
            let back =
                documents::read_ur_kinematics(&text).map_err(|e| unreadable("ur_kinematics", e))?;
            check::same_poses("ur_kinematics", source.robot, &links, &|q| {
                back.t_root_tip(q)
            })?;
            Ok(Exported {
                content_type: "application/yaml",
                extension: "yaml",
                text,
                remaining,
            })
        }
        ExportFormat::Mastering => mastering(source),
    }
}

/// The user's own URDF with the joint origins of the identified robot.
///
/// # Errors
/// [`Error`]: the URDF cannot be read, or is not the nominal robot.
pub fn patch_urdf(source: &Source<'_>, bytes: &[u8], tip: Option<&str>) -> Result<Exported, Error> {
    let links = source.content.links_to_core();
    let text = urdf::patched(source, &links, bytes, tip)?;
    Ok(Exported {
        content_type: "application/xml",
        extension: "urdf",
        text,
        remaining: None,
    })
}

/// The identified links, with or without beta, and what is lost without.
fn links_of(source: &Source<'_>, beta: BetaChoice) -> (Vec<Link>, Option<RemainingError>) {
    let links = source.content.links_to_core();
    if beta == BetaChoice::Keep {
        return (links, None);
    }
    let refit = refit::without_beta(source.robot, &links);
    (
        refit.links,
        Some(RemainingError {
            mean: refit.mean_mm,
            max: refit.max_mm,
        }),
    )
}

fn mastering(source: &Source<'_>) -> Result<Exported, Error> {
    let refit = refit::mastering(source.robot, &source.content.links_to_core());
    let document = MasteringDocument::new(source.robot, &refit);
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
