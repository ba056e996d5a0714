//! Points of a fixture that fit its drawing roughly but leave a doubt: one point is off, all scatter more than stated, nothing checks them,
//! or they lie in one plane and do not show a mirrored drawing.

use crate::compensation::work_frame::{FixturePoint, MIN_POINTS, WorkFrame, is_flat};
use crate::identification::statistics::distributions::{chi_square_tail, f_quantile, f_tail};
use nalgebra::{Unit, Vector3};
use std::fmt;

/// Probability of a false alarm for a fixture whose points have only noise.
const FALSE_ALARM: f64 = 1e-3;
/// Another point explains the misfit as well if the remainder without it exceeds the smallest remainder with at least this probability.
const MIN_PROBABILITY: f64 = 0.01;
/// Noise below this share of the largest residual is rounding.
const ROUNDING: f64 = 1e-6;

/// Why a measured frame is doubted.
#[derive(Clone, Debug, PartialEq)]
pub enum FixtureDoubt {
    /// Three points. Neither a point that is off along the normal of their plane nor a mirrored drawing would show.
    Unchecked {
        /// The z axis of the frame in the frame that the points were measured in.
        z: Unit<Vector3<f64>>,
    },
    /// More points in one plane: a mirrored drawing fits as well, and turns the frame upside down.
    Flat {
        /// The z axis of the frame in the frame that the points were measured in.
        z: Unit<Vector3<f64>>,
    },
    /// The fit is much better without one point. Several candidates (0-based) if it is unknown which one.
    Point {
        /// The candidates, 0-based.
        candidates: Vec<usize>,
        /// Distance of the first candidate from its position in the frame of the other points, mm.
        off_mm: f64,
    },
    /// The points scatter more than is stated.
    Scatter {
        /// Noise of one coordinate that the residuals show, mm.
        shown_mm: f64,
        /// The stated noise, mm.
        std_mm: f64,
        /// The point with the largest residual, 0-based.
        worst: usize,
        /// Its residual, mm.
        residual_mm: f64,
    },
}

/// The remaining misfit of the fit without one point.
struct Without {
    point: usize,
    squares_mm2: f64,
    off_mm: f64,
}

impl FixtureDoubt {
    /// The doubt about a frame that was fitted to these points; `None` if there is none. `std_mm` is the stated noise of a coordinate, 0 if none is.
    pub fn of(points: &[FixturePoint], frame: &WorkFrame, std_mm: f64) -> Option<Self> {
        let n = points.len();
        let z = frame.t_reference_work.rotation * Vector3::z_axis();
        if n == MIN_POINTS {
            return Some(Self::Unchecked { z });
        }
        let residuals_mm = &frame.residuals_mm;
        let all_mm2 = squares(residuals_mm);
        let worst = (0..n).max_by(|a, b| residuals_mm[*a].total_cmp(&residuals_mm[*b]))?;
        let freedom = (3 * (n - 1) - 6) as f64;
        let mut without: Vec<Without> = (0..n).filter_map(|at| without(points, at)).collect();
        without.sort_by(|a, b| a.squares_mm2.total_cmp(&b.squares_mm2));
        let rounding_mm = ROUNDING * residuals_mm[worst];
        let floor_mm2 = (std_mm * std_mm).max(rounding_mm * rounding_mm);
        if let Some(best) = without.first() {
            let variance_mm2 = (best.squares_mm2 / freedom).max(floor_mm2);
            let of_point = (all_mm2 - best.squares_mm2) / 3.0;
            let chance = f_tail(of_point / variance_mm2.max(f64::MIN_POSITIVE), 3.0, freedom);
            if all_mm2 > 0.0 && chance * (n as f64) < FALSE_ALARM {
                let as_good =
                    f_quantile(MIN_PROBABILITY, freedom, freedom) * freedom * variance_mm2;
                let candidates = without.iter().filter(|other| other.squares_mm2 <= as_good);
                return Some(Self::Point {
                    candidates: candidates.map(|other| other.point).collect(),
                    off_mm: best.off_mm,
                });
            }
        }
        let freedom = (3 * n - 6) as f64;
        let is_told =
            std_mm > 0.0 && chi_square_tail(all_mm2 / (std_mm * std_mm), freedom) < FALSE_ALARM;
        if is_told {
            return Some(Self::Scatter {
                shown_mm: (all_mm2 / freedom).sqrt(),
                std_mm,
                worst,
                residual_mm: residuals_mm[worst],
            });
        }
        let noise_mm = std_mm.max((all_mm2 / freedom).sqrt());
        is_flat(points, noise_mm).then_some(Self::Flat { z })
    }

    /// Code of the warning.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Unchecked { .. } => "work_frame_not_checked",
            Self::Flat { .. } => "work_frame_flat",
            Self::Point { .. } => "work_frame_point_off",
            Self::Scatter { .. } => "work_frame_scatters",
        }
    }

    /// The points that it names, 0-based.
    pub fn points(&self) -> Vec<usize> {
        match self {
            Self::Unchecked { .. } | Self::Flat { .. } => vec![],
            Self::Point { candidates, .. } => candidates.clone(),
            Self::Scatter { worst, .. } => vec![*worst],
        }
    }
}

/// A direction as three numbers.
struct Direction<'a>(&'a Unit<Vector3<f64>>);

impl fmt::Display for Direction<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(d) = self;
        write!(f, "({:.2}, {:.2}, {:.2})", d.x, d.y, d.z)
    }
}

fn squares(residuals_mm: &[f64]) -> f64 {
    residuals_mm.iter().map(|r| r * r).sum()
}

/// The fit without a point; `None` if the others give no frame.
fn without(points: &[FixturePoint], point: usize) -> Option<Without> {
    let mut others = points.to_vec();
    let left_out = others.remove(point);
    let frame = WorkFrame::measured(&others, 0.0).ok()?;
    let t = &frame.t_reference_work;
    let there = t.rotation * left_out.nominal_mm + t.translation.vector;
    Some(Without {
        point,
        squares_mm2: squares(&frame.residuals_mm),
        off_mm: (left_out.measured_mm - there).norm(),
    })
}

impl fmt::Display for FixtureDoubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unchecked { z } => write!(
                f,
                "three points place the frame, and nothing checks them: a point that is off along the normal of their plane tilts the frame and does not \
                 show, and two exchanged points turn it over. Its z axis points along {} of the frame that they were measured in. Measure a fourth point, \
                 off the plane of the others",
                Direction(z)
            ),
            Self::Flat { z } => write!(
                f,
                "all points lie in one plane, so a drawing with a mirrored axis fits as well and turns the frame upside down. Its z axis points along {} \
                 of the frame that they were measured in: is that right? A point off the plane would show it",
                Direction(z)
            ),
            Self::Point { candidates, off_mm } => {
                let names: Vec<String> = candidates.iter().map(usize::to_string).collect();
                let which = match names.as_slice() {
                    [one] => format!("point {one}"),
                    _ => format!("one of the points {}", names.join(", ")),
                };
                write!(
                    f,
                    "the points agree much better without {which} (0 is the first), which is {off_mm:.2} mm away from where the others have it: measure it \
                     again, or correct the drawing. Until then the frame is off by part of that"
                )
            }
            Self::Scatter {
                shown_mm,
                std_mm,
                worst,
                residual_mm,
            } => write!(
                f,
                "the points scatter by {shown_mm:.3} mm (one standard deviation of a coordinate), and {std_mm:.3} mm is stated; the largest residual is \
                 {residual_mm:.2} mm at point {worst} (0 is the first). The larger figure counts: check the points and the drawing"
            ),
        }
    }
}
