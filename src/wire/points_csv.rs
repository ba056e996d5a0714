//! The points of a measurement set as a CSV in the form of the documentation, whatever files they were uploaded in.

use crate::measurement::{MeasurementSet, Point, Subset};
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Form in which the points of a set are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PointsFormat {
    /// The points as they were read, in one table with the columns of the documentation.
    Csv,
}

/// The text of a cell of one point; `None` if the point has no such value.
type Cell<'c> = Box<dyn Fn(&Point) -> Option<String> + 'c>;

/// Writes the points, one row each, in their order. The columns `name` and `line` say where a point stands in its file. A column that no point has is
/// left out, and so is the noise of positions if the instrument states it for all points (`has_own_noise` is false).
///
/// # Errors
/// Those of the CSV writer.
pub fn write(set: &MeasurementSet, has_own_noise: bool) -> Result<Vec<u8>, csv::Error> {
    let columns: Vec<(String, Cell<'_>)> = columns(set, has_own_noise)
        .into_iter()
        .filter(|(_, cell)| set.points.iter().any(|point| cell(point).is_some()))
        .collect();
    let mut rows = csv::Writer::from_writer(vec![]);
    rows.write_record(columns.iter().map(|(name, _)| name))?;
    for point in &set.points {
        rows.write_record(
            columns
                .iter()
                .map(|(_, cell)| cell(point).unwrap_or_default()),
        )?;
    }
    rows.into_inner().map_err(|error| error.into_error().into())
}

fn columns<'c>(set: &MeasurementSet, has_own_noise: bool) -> Vec<(String, Cell<'c>)> {
    let mut all: Vec<(String, Cell<'c>)> = Vec::new();
    let mut column = |name: &str, cell: Cell<'c>| all.push((name.to_owned(), cell));
    column("line", Box::new(|p| Some(p.line?.to_string())));
    column("name", Box::new(|p| p.name.clone()));
    column("configuration", Box::new(|p| Some(p.configuration.clone())));
    for joint in 0..set.points.first().map_or(0, |point| point.q_rad.len()) {
        let cell = move |p: &Point| Some(degrees(p.q_rad[joint]).to_string());
        column(&format!("q{}_deg", joint + 1), Box::new(cell));
    }
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let cell = move |p: &Point| Some(p.position_mm[axis].to_string());
        column(&format!("{name}_mm"), Box::new(cell));
    }
    for (part, name) in ["w", "x", "y", "z"].into_iter().enumerate() {
        let cell = move |p: &Point| {
            let q = UnitQuaternion::from_rotation_matrix(p.rotation.as_ref()?);
            Some([q.w, q.i, q.j, q.k][part].to_string())
        };
        column(&format!("quat_{name}"), Box::new(cell));
    }
    // The names of targets determine their numbers.
    let has_names = set.points.iter().any(|p| p.target_name.is_some());
    if !has_names && set.n_targets() > 1 {
        column("target", Box::new(|p| Some(p.target.to_string())));
    }
    column("target_name", Box::new(|p| p.target_name.clone()));
    column("subset", Box::new(|p| Some(subset(p.subset?))));
    if has_own_noise {
        noise_columns(&mut column);
    }
    let rotation = |p: &Point| Some(p.std_rotation_rad?.to_degrees().to_string());
    column("std_rotation_deg", Box::new(rotation));
    column("station", Box::new(|p| p.station.clone()));
    column("session", Box::new(|p| p.session.clone()));
    let is_ordered = |(row, p): (usize, &Point)| p.sequence == row as i64;
    if !set.points.iter().enumerate().all(is_ordered) {
        column("sequence", Box::new(|p| Some(p.sequence.to_string())));
    }
    column("measured_at", Box::new(|p| p.measured_at.clone()));
    let temperature = |p: &Point| Some(p.temperature_c?.to_string());
    column("temperature_c", Box::new(temperature));
    all
}

/// The columns of the noise of positions that a file states for each point.
fn noise_columns<'c>(column: &mut impl FnMut(&str, Cell<'c>)) {
    column("std_mm", Box::new(|p| Some(p.std_mm?.to_string())));
    for (row, column_of, name) in [
        (0, 0, "xx"),
        (0, 1, "xy"),
        (0, 2, "xz"),
        (1, 1, "yy"),
        (1, 2, "yz"),
        (2, 2, "zz"),
    ] {
        let cell =
            move |p: &Point| Some(p.position_noise?.covariance_mm2()[(row, column_of)].to_string());
        column(&format!("cov_{name}_mm2"), Box::new(cell));
    }
}

fn subset(subset: Subset) -> String {
    match subset {
        Subset::Identify => "identify".into(),
        Subset::Verify => "verify".into(),
    }
}

/// The angle in degrees with the shortest text.
fn degrees(angle_rad: f64) -> f64 {
    let degrees = angle_rad.to_degrees();
    let rounded = (degrees * 1e9).round() / 1e9;
    match rounded.to_radians() == angle_rad {
        true => rounded,
        false => degrees,
    }
}
