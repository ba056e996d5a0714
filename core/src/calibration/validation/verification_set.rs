//! Points to verify on, prepared for scoring. Base and targets are fitted anew for each compared robot. Stations, and points before and
//! after a step, are separated. Outliers are named.
//!
//! Steps are searched with the links held at the robot that fits best. No robot parameter is taken from these points.

use crate::calibration::Error;
use crate::calibration::preparation::arrangement::{Arrangement, MIN_OF_SETUP};
use crate::calibration::preparation::motions::place_setups;
use crate::calibration::preparation::observe::Observed;
use crate::calibration::preparation::placed_weights::weigh_placed;
use crate::calibration::preparation::row_weights::is_by_direction;
use crate::calibration::preparation::screening::{Screening, screen};
use crate::calibration::request::{CalibrationRequest, Model, ParameterChoice};
use crate::calibration::validation::errors::RobotAtPoints;
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::least_squares::start::place_with_stations;
use crate::identification::model::objective::{Observation, with_stations_moved, with_weight};
use crate::kinematics::{Link, t_base_flange};
use crate::measurement::Frame;
use crate::measurement::{MeasurementSet, Subset};
use crate::solvers::watch::Watch;
use nalgebra::IsometryMatrix3;

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
                let mut arrangement = Arrangement::of(&placing);
                place_setups(&placing, &mut fitted, &mut arrangement, watch)?;
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
    pub fn place(&self, model: &KinematicModel) -> Placed {
        let mut observed = self.measured.clone();
        if !self.is_placed_anew {
            let segments = (0..model.targets_mm.len())
                .map(|target| (target, 0))
                .collect();
            return Placed {
                model: model.clone(),
                observed,
                segments,
            };
        }
        let mut arrangement = self.arrangement.clone();
        let place = |observed: &mut Observed, arrangement: &mut Arrangement| {
            arrangement.apply(observed);
            let segments = arrangement.fitted_targets(observed).segments;
            let flange = |o: &Observation| t_base_flange(&model.links, &o.q_rad);
            let (placed, motions) = placed_at(&model.links, &flange, &observed.all, segments.len());
            arrangement.move_stations(&motions);
            arrangement.apply(observed);
            (placed, segments)
        };
        let (mut placed, mut segments) = place(&mut observed, &mut arrangement);
        if is_by_direction(self.request, self.set) || self.set.has_poses() {
            for _ in 0..WEIGHTING_ROUNDS {
                let n_placed = self.n_refitted();
                let laid_out = (&arrangement, self.screening.outliers.as_slice());
                weigh_placed(self.set, &mut observed, laid_out, &placed, n_placed);
                (placed, segments) = place(&mut observed, &mut arrangement);
            }
        }
        Placed {
            model: placed,
            observed,
            segments,
        }
    }

    /// Places a robot with corrections on the same points as its links alone, with the same weights.
    pub fn place_corrected(
        &self,
        robot: &IdentifiedRobot,
        links_alone: &Placed,
    ) -> PlacedCorrected {
        let mut placed = PlacedCorrected {
            robot: IdentifiedRobot {
                plain: links_alone.model.clone(),
                corrected: robot.corrected.clone(),
            },
            points: links_alone.observed.all.clone(),
        };
        let corrected = placed.robot.corrected.as_mut();
        if let Some(corrected) = corrected.filter(|_| self.is_placed_anew) {
            let flange = |o: &Observation| corrected.t_base_flange(&o.q_rad);
            let (links, n_targets) = (&corrected.model.links, links_alone.segments.len());
            let (model, motions) = placed_at(links, &flange, &placed.points, n_targets);
            corrected.model = model;
            placed.points = with_stations_moved(&placed.points, &motions);
        }
        placed
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

/// Places a robot, whose flange is known at each observation, on the points with weight: base, targets and stations, by one least-squares fit.
/// Also returns the motions of the stations.
fn placed_at(
    links: &[Link],
    flange: &dyn Fn(&Observation) -> IsometryMatrix3<f64>,
    observations: &[Observation],
    n_targets: usize,
) -> (KinematicModel, Vec<IsometryMatrix3<f64>>) {
    let points = with_weight(observations);
    let flanges: Vec<IsometryMatrix3<f64>> = points.iter().map(flange).collect();
    place_with_stations(links, &flanges, &points, n_targets, MIN_OF_SETUP)
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
