//! `kincal work-frames` and `kincal tools`: frames and tools of a robot, kept under a name.

use super::files::read;
use super::numbers::{exactly, three_angles, three_mm};
use super::subject::{RobotArgument, named};
use super::terminal::{columns, shown_items};
use super::usage::Usage;
use crate::wire::decimals::fixed;
use crate::wire::named_frame::{FixturePointBody, WorkFrameBody, WorkFrameReference};
use crate::wire::posture::ShownOrientation;
use crate::wire::tool::{ToolBody, quaternion};
use anyhow::Context;
use nalgebra::{Matrix3, Rotation3};
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Work frames of a robot: Cartesian targets are programmed in them.
#[derive(Debug, clap::Args)]
pub struct WorkFrameArguments {
    #[command(subcommand)]
    command: WorkFrameCommand,
}

#[derive(Debug, clap::Subcommand)]
enum WorkFrameCommand {
    /// List a robot's work frames, or show one.
    List(ListArguments),
    /// Keep a work frame under a name: typed, or fitted to measured points.
    Set(SetWorkFrame),
}

/// Tools of a robot: tool centre points with their orientation in the flange frame.
#[derive(Debug, clap::Args)]
pub struct ToolArguments {
    #[command(subcommand)]
    command: ToolCommand,
}

#[derive(Debug, clap::Subcommand)]
enum ToolCommand {
    /// List a robot's tools, or show one.
    List(ListArguments),
    /// Keep a tool under a name.
    Set(SetTool),
}

#[derive(Debug, clap::Args)]
struct ListArguments {
    #[command(flatten)]
    robot: RobotArgument,
    /// Show only the one with this name.
    #[arg(value_name = "NAME")]
    name: Option<String>,
}

#[derive(Debug, clap::Args)]
struct NamedItemArguments {
    #[command(flatten)]
    robot: RobotArgument,
    /// The name to keep it under.
    #[arg(value_name = "NAME")]
    name: String,
}

#[derive(Debug, clap::Args)]
struct SetTool {
    #[command(flatten)]
    named: NamedItemArguments,
    /// Tool centre point in the flange frame: X,Y,Z in mm.
    #[arg(long, value_name = "X,Y,Z", value_parser = three_mm, allow_hyphen_values = true)]
    mm: [f64; 3],
    #[command(flatten)]
    turned: OrientationArguments,
    /// Standard uncertainty of one coordinate, mm, of a tool that was measured with this robot [default: it is known relative to the flange, as from a drawing].
    #[arg(long, value_name = "MM")]
    std_mm: Option<f64>,
}

/// Orientation of a tool in the flange frame [default: as the flange], in the convention of the controller that shows it.
#[derive(Debug, clap::Args)]
#[group(multiple = false)]
struct OrientationArguments {
    /// Quaternion W,X,Y,Z (q1 to q4 of ABB) of the orientation in the flange frame [default: as the flange].
    #[arg(long, value_name = "W,X,Y,Z", value_parser = four, allow_hyphen_values = true)]
    quaternion: Option<[f64; 4]>,
    /// A,B,C of the orientation, as a KUKA controller shows them, degrees.
    #[arg(long, value_name = "A,B,C", value_parser = three_angles, allow_hyphen_values = true)]
    abc_deg: Option<[f64; 3]>,
    /// W,P,R of the orientation, as FANUC shows them, or Rx,Ry,Rz of Yaskawa, degrees.
    #[arg(long, value_name = "W,P,R", value_parser = three_angles, allow_hyphen_values = true)]
    wpr_deg: Option<[f64; 3]>,
    /// Rotation vector RX,RY,RZ of the orientation, as Universal Robots show it, rad.
    #[arg(long, value_name = "RX,RY,RZ", value_parser = three_angles, allow_hyphen_values = true)]
    rotation_vector_rad: Option<[f64; 3]>,
}

impl OrientationArguments {
    /// The quaternion as it was typed, or that of the angles.
    fn quaternion(&self) -> Option<[f64; 4]> {
        let angles = ShownOrientation {
            kuka_abc_deg: self.abc_deg,
            fanuc_wpr_deg: self.wpr_deg,
            ur_rotation_vector_rad: self.rotation_vector_rad,
            quaternion: None,
        };
        let has_angles = angles != ShownOrientation::default();
        self.quaternion
            .or_else(|| has_angles.then(|| quaternion(&angles.rotation())))
    }
}

#[derive(Debug, clap::Args)]
struct SetWorkFrame {
    #[command(flatten)]
    named: NamedItemArguments,
    /// Origin of the work frame: X,Y,Z in mm.
    #[arg(long, value_name = "X,Y,Z", value_parser = three_mm, allow_hyphen_values = true, conflicts_with = "points")]
    origin_mm: Option<[f64; 3]>,
    /// Orientation of the work frame [default: as the frame that it is given in].
    #[arg(long, value_name = "W,X,Y,Z", value_parser = four, allow_hyphen_values = true, conflicts_with = "points")]
    quaternion: Option<[f64; 4]>,
    /// Measured points: a CSV file with the columns nominal_x_mm nominal_y_mm nominal_z_mm (in the work frame, as drawn) and x_mm y_mm z_mm (as
    /// measured).
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Standard uncertainty of one coordinate of a measured point, mm.
    #[arg(long, value_name = "MM", requires = "points")]
    std_mm: Option<f64>,
    /// The numbers are given in the measuring frame of this measurement set [default: in the robot's base frame].
    #[arg(long, value_name = "SET")]
    measured_with: Option<String>,
    /// With a measurement set of several stations: the station from which the numbers were measured.
    #[arg(long, value_name = "STATION", requires = "measured_with")]
    station: Option<String>,
}

fn four(text: &str) -> Result<[f64; 4], String> {
    exactly(text, "four numbers with commas between them are needed")
}

/// Lists work frames, or keeps one.
pub fn work_frames(arguments: &WorkFrameArguments) -> anyhow::Result<()> {
    match &arguments.command {
        WorkFrameCommand::List(list) => show(list, "work-frames"),
        WorkFrameCommand::Set(set) => {
            let points = set.points.as_deref().map(fixture_points).transpose()?;
            let reference = match set.measured_with {
                Some(_) => WorkFrameReference::Measuring,
                None => WorkFrameReference::Base,
            };
            let body = WorkFrameBody {
                reference,
                measurement_set_id: set.measured_with.clone(),
                station: set.station.clone(),
                translation_mm: set.origin_mm,
                quaternion: set.quaternion,
                rotation: None,
                points,
                std_mm: set.std_mm,
            };
            keep(&set.named, "work-frames", &body)
        }
    }
}

/// Lists tools, or keeps one.
pub fn tools(arguments: &ToolArguments) -> anyhow::Result<()> {
    match &arguments.command {
        ToolCommand::List(list) => show(list, "tools"),
        ToolCommand::Set(set) => {
            let body = ToolBody {
                translation_mm: set.mm,
                quaternion: set.turned.quaternion(),
                std_mm: set.std_mm,
                ..ToolBody::default()
            };
            keep(&set.named, "tools", &body)
        }
    }
}

fn show(list: &ListArguments, kind: &str) -> anyhow::Result<()> {
    let below = match &list.name {
        Some(name) => named(kind, name)?,
        None => format!("/{kind}"),
    };
    let answer = list.robot.get(&below)?;
    list.robot
        .output
        .print(&answer, || shown_items(&answer, in_words))
}

fn keep(kept: &NamedItemArguments, kind: &str, body: &impl Serialize) -> anyhow::Result<()> {
    let below = named(kind, &kept.name)?;
    let answer = kept.robot.send(reqwest::Method::PUT, &below, body)?;
    kept.robot.output.print(&answer, || {
        in_words(std::slice::from_ref(&answer)) + &points_in_words(&answer)
    })
}

/// Text about the measured points: the residual of each, and the warnings.
fn points_in_words(item: &Value) -> String {
    let residuals = item["residuals_mm"].as_array().into_iter().flatten();
    let residuals: Vec<String> = residuals
        .filter_map(Value::as_f64)
        .map(|mm| format!("{mm:.3}"))
        .collect();
    let mut text = match residuals.is_empty() {
        true => String::new(),
        false => format!("\nresidual of each point, mm: {}", residuals.join(" ")),
    };
    for warning in item["warnings"].as_array().into_iter().flatten() {
        let detail = warning["detail"].as_str().unwrap_or_default();
        text += &format!("\nwarning: {detail}");
    }
    text
}

/// A table: name, origin, and how well measured points agree.
fn in_words(items: &[Value]) -> String {
    let row = |item: &Value| {
        let is_tool = item["t_flange_tool"].is_object();
        let t = &item[if is_tool {
            "t_flange_tool"
        } else {
            "t_reference_work"
        }];
        let mm = |axis: usize| fixed(t["translation_mm"][axis].as_f64().unwrap_or(f64::NAN), 3);
        let frame = if is_tool {
            "flange"
        } else {
            item["reference"].as_str().unwrap_or_default()
        };
        let rms = item["rms_mm"]
            .as_f64()
            .map_or("".into(), |mm| format!("{mm:.3}"));
        let name = item["name"].as_str().unwrap_or_default().to_owned();
        let turned = turned_in_words(&t["rotation"]);
        vec![name, frame.to_owned(), mm(0), mm(1), mm(2), turned, rms]
    };
    let names = [
        "name",
        "in frame",
        "x mm",
        "y mm",
        "z mm",
        "turned by",
        "rms of points mm",
    ];
    columns(&names, &items.iter().map(row).collect::<Vec<_>>())
}

/// A rotation matrix as its angle and axis.
fn turned_in_words(rotation: &Value) -> String {
    let rotation = Matrix3::from_fn(|row, column| rotation[row][column].as_f64().unwrap_or(0.0));
    match Rotation3::from_matrix_unchecked(rotation).axis_angle() {
        Some((axis, rad)) => format!(
            "{:.3}° about {} {} {}",
            rad.to_degrees(),
            fixed(axis.x, 3),
            fixed(axis.y, 3),
            fixed(axis.z, 3)
        ),
        None => "0°".into(),
    }
}

/// Points of a fixture from a CSV file.
fn fixture_points(file: &Path) -> anyhow::Result<Vec<FixturePointBody>> {
    let bytes = read(file)?;
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let header = reader.headers().context("the file has no header")?.clone();
    let column = |name: &str| {
        header.iter().position(|h| h.trim() == name).ok_or_else(|| {
            Usage(format!("{}: it has no column {name}; its columns are nominal_x_mm nominal_y_mm nominal_z_mm x_mm y_mm z_mm", file.display()))
        })
    };
    let columns = |prefix: &str| -> Result<[usize; 3], Usage> {
        Ok([
            column(&format!("{prefix}x_mm"))?,
            column(&format!("{prefix}y_mm"))?,
            column(&format!("{prefix}z_mm"))?,
        ])
    };
    let (nominal, measured) = (columns("nominal_")?, columns("")?);
    let mut points = Vec::new();
    for (row, record) in reader.records().enumerate() {
        let record = record?;
        let cell = |column: usize| {
            let text = record.get(column).unwrap_or_default().trim();
            text.parse::<f64>().map_err(|_| {
                Usage(format!(
                    "{}: row {row}, column {}: {text:?} is not a number",
                    file.display(),
                    &header[column]
                ))
            })
        };
        let vector = |[x, y, z]: [usize; 3]| Ok::<_, Usage>([cell(x)?, cell(y)?, cell(z)?]);
        points.push(FixturePointBody {
            nominal_mm: vector(nominal)?,
            measured_mm: vector(measured)?,
        });
    }
    Ok(points)
}
