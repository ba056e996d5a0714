//! Measured robots of the studies, with their sets.

use crate::data::robot;
use kincal::kinematics::Robot;
use kincal::measurement::table::own_form;
use kincal::measurement::{Frame, MeasurementSet, Point, Subset};
use std::path::Path;

/// A set in the frame of an instrument, of a robot of six joints.
pub fn set(path: &Path) -> MeasurementSet {
    own_form::parse(&std::fs::read(path).unwrap(), Frame::Instrument, 6).unwrap()
}

/// The robots with their sets; the two visits are measured in one instrument frame and are one set.
pub fn robots(root: &Path) -> Vec<(&'static str, Robot, MeasurementSet)> {
    let motoman = root.join("motoman_ma1400");
    let points: Vec<Point> = ["visit_1.csv", "visit_2.csv"]
        .iter()
        .flat_map(|file| set(&motoman.join(file)).points)
        .collect();
    let points = points
        .into_iter()
        .enumerate()
        .map(|(row, p)| Point {
            sequence: row as i64,
            ..p
        })
        .collect();
    vec![
        (
            "motoman_ma1400",
            robot(&motoman.join("robot.json")),
            MeasurementSet::new(Frame::Instrument, points),
        ),
        (
            "qkm_hl6",
            robot(&root.join("qkm_hl6/robot.json")),
            set(&root.join("qkm_hl6/set.csv")),
        ),
    ]
}

/// The set with a subset for each row.
pub fn with_split(
    set: &MeasurementSet,
    subset_of: impl Fn(usize, &Point) -> Subset,
) -> MeasurementSet {
    let mut set = set.clone();
    set.points
        .iter_mut()
        .enumerate()
        .for_each(|(row, p)| p.subset = Some(subset_of(row, p)));
    set
}
