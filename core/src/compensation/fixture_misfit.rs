//! Points of a fixture that do not fit its drawing, and the one mistake that explains it.

use crate::compensation::work_frame::{FixturePoint, WorkFrame};
use nalgebra::Vector3;
use std::fmt;

/// Threshold of the rms as a share of the spread of the measured points: their rms distance from their centre. Noise of this size turns the
/// frame by some tenths of a degree. The check of uploads uses the same share of the reach.
const FITS_PER_REACH: f64 = 0.01;
/// Threshold of the rms in units of the stated standard uncertainty of a coordinate, if that is larger. Noise alone gives at most √3.
const FITS_STD: f64 = 5.0;
/// A mistake is named only if the rms is smaller by this factor without it.
const MIN_IMPROVEMENT: f64 = 5.0;
/// Exchanged points are searched only among this many points with the largest residuals.
const MAX_EXCHANGED: usize = 20;
const MM_PER_INCH: f64 = 25.4;
const MM_PER_M: f64 = 1000.0;

/// Points that do not fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixtureMisfit {
    /// Root mean square of the residuals, mm.
    pub rms_mm: f64,
    /// The largest rms that is accepted, mm.
    pub accepted_mm: f64,
    /// The mistake without which the points fit much better, and the rms that then remains, mm.
    pub mistake: Option<(FixtureMistake, f64)>,
}

/// A mistake in the points of a fixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FixtureMistake {
    /// Two points are exchanged, 0-based.
    Exchanged(usize, usize),
    /// One axis of the drawing is reversed. It is unknown which one, because the frame rotates with it.
    Mirrored,
    /// The drawing has to be multiplied by this factor to have the unit of the measured points.
    Scaled(f64),
}

impl FixtureMisfit {
    /// The misfit of the points to the frame that was fitted to them; `None` if they fit. `std_mm` is their stated uncertainty, 0 if none is.
    pub fn of(points: &[FixturePoint], frame: &WorkFrame, std_mm: f64) -> Option<Self> {
        let rms_mm = frame.rms_mm();
        let accepted_mm = (FITS_PER_REACH * spread_mm(points)).max(FITS_STD * std_mm);
        if rms_mm <= accepted_mm {
            return None;
        }
        let without = |mistake: FixtureMistake| {
            let frame = WorkFrame::measured(&mistake.undone(points), 0.0).ok()?;
            Some((mistake, frame.rms_mm()))
        };
        let mistake = mistakes(frame)
            .into_iter()
            .filter_map(without)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|(_, left_mm)| MIN_IMPROVEMENT * left_mm <= rms_mm);
        Some(Self {
            rms_mm,
            accepted_mm,
            mistake,
        })
    }
}

/// Root mean square distance of the measured points from their centre, mm.
fn spread_mm(points: &[FixturePoint]) -> f64 {
    let n = points.len().max(1) as f64;
    let centre = points.iter().map(|p| p.measured_mm).sum::<Vector3<f64>>() / n;
    let squares = points
        .iter()
        .map(|p| (p.measured_mm - centre).norm_squared());
    (squares.sum::<f64>() / n).sqrt()
}

/// The mistakes that are tried.
fn mistakes(frame: &WorkFrame) -> Vec<FixtureMistake> {
    let units = [MM_PER_INCH, MM_PER_M, 1.0 / MM_PER_INCH, 1.0 / MM_PER_M];
    let mut mistakes = units.map(FixtureMistake::Scaled).to_vec();
    mistakes.push(FixtureMistake::Mirrored);
    let residuals_mm = &frame.residuals_mm;
    let mut worst: Vec<usize> = (0..residuals_mm.len()).collect();
    worst.sort_by(|a, b| residuals_mm[*b].total_cmp(&residuals_mm[*a]));
    worst.truncate(MAX_EXCHANGED);
    worst.sort_unstable();
    for (k, first) in worst.iter().enumerate() {
        let pairs = worst[k + 1..].iter();
        mistakes.extend(pairs.map(|second| FixtureMistake::Exchanged(*first, *second)));
    }
    mistakes
}

impl FixtureMistake {
    /// The points without the mistake.
    fn undone(self, points: &[FixturePoint]) -> Vec<FixturePoint> {
        let mut points = points.to_vec();
        match self {
            Self::Exchanged(a, b) => {
                let nominal_mm = points[a].nominal_mm;
                points[a].nominal_mm = points[b].nominal_mm;
                points[b].nominal_mm = nominal_mm;
            }
            Self::Mirrored => points.iter_mut().for_each(|p| p.nominal_mm.x *= -1.0),
            Self::Scaled(factor) => points.iter_mut().for_each(|p| p.nominal_mm *= factor),
        }
        points
    }
}

impl fmt::Display for FixtureMistake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Exchanged(a, b) => write!(f, "points {a} and {b} exchanged (0 is the first)"),
            Self::Mirrored => f.write_str("one axis of the drawing mirrored"),
            Self::Scaled(factor) => {
                let unit = if (1.0 / MM_PER_INCH..=MM_PER_INCH).contains(&factor) {
                    "inches"
                } else {
                    "metres"
                };
                let what = if factor > 1.0 {
                    "drawing"
                } else {
                    "measured points"
                };
                write!(f, "the {what} read in {unit}")
            }
        }
    }
}

impl fmt::Display for FixtureMisfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            rms_mm,
            accepted_mm,
            ..
        } = self;
        write!(
            f,
            "the points miss the drawing by {rms_mm:.3} mm rms, and at most {accepted_mm:.3} mm is accepted (1 % of their spread, or 5 times std_mm): "
        )?;
        match self.mistake {
            Some((mistake, left_mm)) => write!(f, "with {mistake} they miss it by {left_mm:.3} mm"),
            None => f.write_str(
                "no exchange of two points, mirrored axis or unit explains it; check each point, or state std_mm if they are that uncertain",
            ),
        }
    }
}
