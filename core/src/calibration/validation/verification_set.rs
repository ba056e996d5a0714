//! Points to verify on, prepared for scoring. Base and targets are fitted anew for each compared robot. Stations, and points before and
//! after a step, are separated. Outliers are named.
//!
//! Steps are searched with the links held at the robot that fits best. No robot parameter is taken from these points.

use crate::calibration::Error;
use crate::calibration::preparation::arrangement::{Arrangement, MIN_OF_SETUP};
use crate::calibration::preparation::motions::fit_motions;
use crate::calibration::preparation::observe::Observed;
use crate::calibration::preparation::placed_weights::weigh_placed;
use crate::calibration::preparation::row_weights::is_by_direction;
use crate::calibration::preparation::screening::{Screening, screen};
use crate::calibration::request::{CalibrationRequest, Model, ParameterChoice};
use crate::calibration::solve::corrections::placed_anew;
use crate::calibration::validation::errors::RobotAtPoints;
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::least_squares::start::{fit_base_and_targets, rigid_motion};
use crate::identification::model::objective::{Observation, with_weight};
use crate::kinematics::reach_mm;
use crate::measurement::Frame;
use crate::measurement::{MeasurementSet, Subset};
use crate::solvers::watch::Watch;

/// Number of rounds of placement and weighting. Noise by direction needs two. Poses start with the usual weight of rotations, which may be
/// far off.
const WEIGHTING_ROUNDS: usize = 4;
/// Minimum number of residuals per fitted parameter for judging single points.
const MIN_RESIDUALS_PER_NUMBER: usize = 2;

/// The points of a verification set, prepared for scoring.
pub struct Layout<'a> {
    request: &'a CalibrationRequest,
    set: &'a MeasurementSet,
    /// The points as measured.
    measured: Observed,
    arrangement: Arrangement,
    /// Result of the screening.
    pub screening: Screening,
    /// True if base and targets are fitted anew.
    pub is_placed_anew: bool,
}

/// A robot placed on points.
pub struct Placed {
    /// The robot with base and targets placed.
    pub model: KinematicModel,
    /// The points, transformed into one frame, each with the target of its segment.
    pub observed: Observed,
    /// (target, segment) of each of the model's targets; segments count from 0.
    pub segments: Vec<(usize, usize)>,
}

/// A robot with corrections, and the points in its placement.
pub struct PlacedCorrected {
    /// The robot, with base and targets on the points.
    pub robot: IdentifiedRobot,
    /// The points.
    pub points: Vec<Observation>,
}

impl PlacedCorrected {
    /// The robot at its points.
    pub fn at_points(&self) -> RobotAtPoints<'_> {
        (&self.robot, &self.points)
    }
}

/// Maximum number of rounds that alternately place the set-ups, and base and targets. Each round halves the remaining error.
const SET_UP_ROUNDS: usize = 30;
/// The set-ups have converged if they move the points by less than this share of the reach: a micrometre on an arm of 1.7 m.
const FOUND_PER_REACH: f64 = 1e-3 / 1700.0;

impl<'a> Layout<'a> {
    /// `observed` are the points of `set`, and `model` is the robot that is expected to fit them best. `refit`: base and targets are
    /// unknown for these points. With several stations or with steps, base and targets are fitted anew in any case.
    ///
    /// # Errors
    /// [`Error::Unusable`] if the points cannot be placed.
    pub fn new(
        request: &'a CalibrationRequest,
        set: &'a MeasurementSet,
        observed: Observed,
        model: &KinematicModel,
        refit: bool,
        watch: &Watch<'_>,
    ) -> Result<Self, Error> {
        let placing = placing(request, set, model);
        let mut fitted = observed.clone();
        fitted.subsets.fill(Subset::Identify);
        let (screening, arrangement) = match 3 * set.points.len()
            > MIN_RESIDUALS_PER_NUMBER * (6 * n_stations(set) + 3 * set.n_targets())
        {
            true => screen(&placing, &mut fitted, watch)?,
            false => {
                let arrangement = Arrangement::of(&placing);
                (
                    Screening {
                        targets: arrangement.fitted_targets(&fitted),
                        ..Screening::default()
                    },
                    arrangement,
                )
            }
        };
        let is_placed_anew =
            refit || n_stations(set) > 1 || screening.steps.iter().any(|step| !step.is_one_point);
        let mut measured = observed;
        for (row, weight) in fitted.all.iter().map(|o| o.weight).enumerate() {
            measured.all[row].weight = weight;
        }
        Ok(Self {
            request,
            set,
            measured,
            arrangement,
            screening,
            is_placed_anew,
        })
    }

    /// Places a robot on these points. Its links stay unchanged; base and targets stay too, or are fitted anew.
    pub fn place(&self, model: &KinematicModel) -> Result<Placed, Error> {
        let mut observed = self.measured.clone();
        if !self.is_placed_anew {
            let segments = (0..model.targets_mm.len())
                .map(|target| (target, 0))
                .collect();
            return Ok(Placed {
                model: model.clone(),
                observed,
                segments,
            });
        }
        let (placing, mut arrangement) = (
            placing(self.request, self.set, model),
            self.arrangement.clone(),
        );
        observed.subsets.fill(Subset::Identify);
        let mut fit = |observed: &mut Observed| {
            fit_motions(
                &placing,
                observed,
                &mut arrangement,
                Some(Subset::Identify),
                &Watch::nobody(),
            )?;
            arrangement.apply(observed);
            let segments = arrangement.fitted_targets(observed).segments;
            let mut placed = Placed {
                model: model.clone(),
                observed: observed.clone(),
                segments,
            };
            placed.observed.subsets.fill(Subset::Verify);
            let points = with_weight(&placed.observed.all);
            placed.model = fit_base_and_targets(&model.links, &points, placed.segments.len());
            Ok::<_, Error>((placed, arrangement.clone()))
        };
        let (mut placed, mut arranged) = fit(&mut observed)?;
        if is_by_direction(self.request, self.set) || self.set.has_poses() {
            for _ in 0..WEIGHTING_ROUNDS {
                let n_placed = self.n_refitted();
                let laid_out = (&arranged, self.screening.outliers.as_slice());
                weigh_placed(self.set, &mut observed, laid_out, &placed.model, n_placed);
                (placed, arranged) = fit(&mut observed)?;
            }
        }
        Ok(placed)
    }

    /// Places a robot with corrections on the same points as its links alone. The set-ups of the instrument are placed anew for it too,
    /// alternately with base and targets.
    pub fn place_corrected(
        &self,
        robot: &IdentifiedRobot,
        links_alone: &Placed,
    ) -> PlacedCorrected {
        let mut placed = PlacedCorrected {
            robot: robot.clone(),
            points: links_alone.observed.all.clone(),
        };
        if !self.is_placed_anew {
            return placed;
        }
        placed.robot = placed_anew(robot, &with_weight(&placed.points));
        for _ in 0..SET_UP_ROUNDS {
            if !self.move_set_ups(&mut placed) {
                break;
            }
            placed.robot = placed_anew(robot, &with_weight(&placed.points));
        }
        placed
    }

    /// Moves the points of each set-up but the reference onto the robot with corrections. Returns false if nothing moved.
    fn move_set_ups(&self, placed: &mut PlacedCorrected) -> bool {
        let Some(corrected) = &placed.robot.corrected else {
            return false;
        };
        let reference_setup = self.arrangement.reference_setup();
        let smallest_mm = FOUND_PER_REACH * reach_mm(&corrected.model.links);
        let mut is_moved = false;
        for set_up in (0..self.arrangement.motions.len()).filter(|at| *at != reference_setup) {
            let rows: Vec<usize> = (0..placed.points.len())
                .filter(|row| self.arrangement.setups[*row] == set_up)
                .collect();
            let fitted = rows.iter().map(|row| &placed.points[*row]);
            let fitted = fitted.filter(|o| o.weight > 0.0);
            let (measured, predicted): (Vec<_>, Vec<_>) = fitted
                .map(|o| (o.position_mm, corrected.position(&o.q_rad, o.target)))
                .unzip();
            if measured.len() < MIN_OF_SETUP {
                continue;
            }
            let motion = rigid_motion(&measured, &predicted);
            for row in rows {
                let moved = placed.points[row].moved(&motion);
                let shift = moved.position_mm - placed.points[row].position_mm;
                is_moved |= shift.norm() > smallest_mm;
                placed.points[row] = moved;
            }
        }
        is_moved
    }

    /// Number of base and target parameters that are fitted anew.
    pub fn n_refitted(&self) -> usize {
        if !self.is_placed_anew {
            return 0;
        }
        let n_targets = self.screening.targets.len().max(self.set.n_targets());
        let n_turned = 3 * self.set.posed_targets().len();
        6 * self.arrangement.motions.len() + 3 * n_targets + n_turned
    }
}

/// Stations that a set was measured from.
pub fn n_stations(set: &MeasurementSet) -> usize {
    set.points
        .iter()
        .map(|p| &p.station)
        .collect::<std::collections::BTreeSet<_>>()
        .len()
}

/// The request that fits only base and targets, with the links of a model.
fn placing(
    request: &CalibrationRequest,
    set: &MeasurementSet,
    model: &KinematicModel,
) -> CalibrationRequest {
    let mut robot = request.robot.clone();
    robot.links.clone_from(&model.links);
    CalibrationRequest {
        model: Some(Model::Complete),
        parameters: ParameterChoice::Identify(vec![]),
        ..CalibrationRequest::new(robot, set.clone())
    }
}

/// True if base and targets are fitted anew to another set. They are not if both sets are in the base frame and have the same targets, with
/// known rotations if poses are scored.
pub fn refits(request: &CalibrationRequest, set: &MeasurementSet) -> bool {
    let same_frame = set.frame == Frame::Base && in_base_frame(request);
    let is_turned = !set.has_poses() || request.set.has_poses();
    !same_frame || set.n_targets() > request.set.n_targets() || !is_turned
}

/// Number of base and target parameters that are fitted to the points of a verification set.
pub fn n_placed(request: &CalibrationRequest, set: &MeasurementSet) -> usize {
    n_placed_where(refits(request, set), set)
}

/// As [`n_placed`], if it is known whether base and targets are fitted anew. With several stations they always are.
pub fn n_placed_where(is_placed_anew: bool, set: &MeasurementSet) -> usize {
    let stations = n_stations(set);
    match is_placed_anew || stations > 1 {
        true => 6 * stations + 3 * set.n_targets(),
        false => 0,
    }
}

/// True if the positions are in the base frame, so that nothing has to be placed.
pub fn in_base_frame(request: &CalibrationRequest) -> bool {
    request.set.frame == Frame::Base
        || (request.model() == Model::Paper && request.frames.is_some())
}
