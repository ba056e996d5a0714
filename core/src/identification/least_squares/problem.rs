//! The least-squares problem that every estimate solves: variables with their priors, and blocks of rows that depend on them.
//!
//! Coordinate x_j is the deviation of variable j from the reference, in units of its width, so that all coordinates are of similar size. The
//! variables are the parameters of base, links and targets; then, if requested, the motions of the instrument's stations and the terms of the
//! corrections. A block has the rows of one measurement; only the block knows their number. A row is sqrt(weight) · W · (measured −
//! predicted), in mm, where W whitens noise that differs between directions. A pose has three more rows: the rotation vector between the
//! predicted and the measured target, times a length in mm/rad. The priors are rows too;
//! [`crate::identification::least_squares::estimate`] adds them.

use crate::identification::KinematicModel;
use crate::identification::least_squares::block::{Block, State, StationMotion};
pub use crate::identification::least_squares::variables::*;
use crate::identification::model::correction_terms::{Term, corrections_at};
use crate::identification::model::objective::{Observation, posed_targets};
use crate::identification::model::parameters::{
    Parameter, apply_into, deviation_from, placement_parameters, target_rotation_parameters,
};
use crate::kinematics::{Corrections, Link, Mounting, Payload};
use crate::measurement::split::MIN_OF_STATION;
use crate::solvers::median::median;
use nalgebra::{DMatrix, IsometryMatrix3, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Variables and blocks.
#[derive(Clone, Debug)]
pub struct Problem<'a> {
    /// Reference of the deviations: nominal links, and base and targets as first placed.
    pub reference: KinematicModel,
    /// The variables.
    pub variables: Vec<Variable>,
    /// Radius of the workspace, mm.
    pub reach_mm: f64,
    /// Minimum noise of a row of weight 1, mm: the instrument's stated noise, else [`MIN_SIGMA`] of the reach.
    pub least_sigma_mm: f64,
    /// Prior for the noise of a row, mm; only for poses. A few poses are fitted without residuals, which then show nothing about the noise.
    pub usual_sigma_mm: Option<f64>,
    parameters: Vec<Parameter>,
    blocks: Vec<Block<'a>>,
    /// Gravity and payload of a robot with corrections; `None` for links alone.
    corrected: Option<Corrected>,
}

/// What is known of a robot with corrections before its points are used.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Corrected {
    mounting: Mounting,
    payload: Option<Payload>,
}

/// Radius of the workspace, mm: the sum of the links' lengths. For a robot whose links have no length, it is the median distance of the
/// measured points from their centre, if that is larger.
pub fn reach_mm<'a>(
    links: &[Link],
    observations: impl Iterator<Item = &'a Observation> + Clone,
) -> f64 {
    let of_links: f64 = links.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum();
    let positions = observations.map(|o| o.position_mm);
    let along = |axis: usize| median(positions.clone().map(|p| p[axis]));
    let middle = Vector3::from_fn(|axis, _| along(axis).unwrap_or(0.0));
    let of_points = median(positions.clone().map(|p| (p - middle).norm())).unwrap_or(0.0);
    of_links.max(of_points).max(f64::MIN_POSITIVE)
}

/// The stations whose motions are variables. The reference station stays where it is, and so does a station with fewer than `least` observations. If
/// the reference has too few to place the base, the last station that has enough stays too.
pub fn moving_stations(observations: &[Observation], least: usize) -> BTreeSet<usize> {
    let mut n_of: BTreeMap<Option<usize>, usize> = BTreeMap::new();
    for o in observations {
        *n_of.entry(o.station).or_default() += 1;
    }
    let has_enough = |station: &&Option<usize>| n_of[*station] >= MIN_OF_STATION;
    let of_reference = n_of.keys().filter(|station| station.is_none());
    let mut first = of_reference.chain(n_of.keys().rev());
    let held = first.find(has_enough).copied();
    n_of.retain(|station, n| *n >= least && Some(*station) != held);
    n_of.into_keys().flatten().collect()
}

impl<'a> Problem<'a> {
    /// The problem of the observations with nonzero weight, with the parameters' own priors.
    pub fn new(
        reference: KinematicModel,
        parameters: &[Parameter],
        observations: &'a [Observation],
    ) -> Self {
        Self::of_blocks(
            reference,
            parameters,
            observations.iter().map(|o| (o, None)),
        )
    }

    /// The problem of base and targets alone, for a robot whose flange is known in its base frame at each observation.
    pub fn of_placement(
        start: KinematicModel,
        flanges: &'a [IsometryMatrix3<f64>],
        observations: &'a [Observation],
    ) -> Self {
        let reference = KinematicModel {
            links: vec![],
            ..start
        };
        let mut parameters = placement_parameters(reference.targets_mm.len());
        if !reference.target_rotations.is_empty() {
            let posed = posed_targets(observations);
            parameters.extend(target_rotation_parameters(&posed));
        }
        let known = observations.iter().zip(flanges.iter().map(Some));
        Self::of_blocks(reference, &parameters, known)
    }

    fn of_blocks(
        reference: KinematicModel,
        parameters: &[Parameter],
        measured: impl Iterator<Item = (&'a Observation, Option<&'a IsometryMatrix3<f64>>)> + Clone,
    ) -> Self {
        let reach_mm = reach_mm(&reference.links, measured.clone().map(|(o, _)| o));
        let mut first = 0;
        let block = |(measured, flange): (&'a Observation, _)| {
            let rows = first..first + measured.n_rows(&reference);
            first = rows.end;
            Block {
                rows,
                measured,
                flange,
                station: None,
            }
        };
        let with_weight = measured.filter(|(o, _)| o.weight > 0.0);
        let blocks: Vec<Block<'a>> = with_weight.map(block).collect();
        let is_posed = blocks.iter().any(|block| block.rows.len() == 6);
        Self {
            reference,
            variables: parameters.iter().map(|p| variable(*p, reach_mm)).collect(),
            reach_mm,
            least_sigma_mm: MIN_SIGMA * reach_mm,
            usual_sigma_mm: is_posed.then(|| usual_length_mm(reach_mm)),
            parameters: parameters.to_vec(),
            blocks,
            corrected: None,
        }
    }

    /// The same problem with the motions of the instrument's stations as further variables ([`moving_stations`]). `observations` are those of the
    /// problem, with or without weight.
    pub fn with_stations(mut self, observations: &[Observation], least: usize) -> Self {
        let moving = moving_stations(observations, least);
        for block in &mut self.blocks {
            block.station = block.measured.station.filter(|s| moving.contains(s));
        }
        for station in &moving {
            let axes = (0..6).map(|axis| station_variable(*station, axis, self.reach_mm));
            self.variables.extend(axes);
        }
        self
    }

    /// The same problem of a robot with corrections: their terms are further variables.
    pub fn with_corrections(
        mut self,
        (mounting, payload): (Mounting, Option<Payload>),
        terms: &[Term],
        widths: CorrectionWidths,
    ) -> Self {
        let variable = |term: &Term| correction_variable(*term, &mounting, self.reach_mm, widths);
        self.variables.extend(terms.iter().map(variable));
        self.corrected = Some(Corrected { mounting, payload });
        self
    }

    /// The same problem with a base that is known to be at the reference, with standard deviations of 1 mm and 0.05°. Its prior has heavy
    /// tails like those of links: the error of a badly set up base frame may be centimetres, and link 1 must not absorb it.
    pub fn with_known_base(mut self) -> Self {
        for variable in &mut self.variables {
            let (width, kind) = match variable.unknown {
                Unknown::Parameter(Parameter::BaseTranslation(_)) => (BASE_MM, Kind::BasePosition),
                Unknown::Parameter(Parameter::BaseRotation(_)) => (BASE_RAD, Kind::BaseRotation),
                _ => continue,
            };
            (variable.width, variable.prior) = (width, Prior::OfKind(kind));
        }
        self
    }

    /// Removes the links' own priors. This gives plain least squares, in which unobservable combinations stay at the reference.
    pub fn without_own_priors(&mut self) {
        for variable in &mut self.variables {
            if matches!(variable.unknown, Unknown::Parameter(p) if p.is_link()) {
                variable.prior = Prior::Flat;
            }
        }
    }

    /// Makes a parameter's prior flat. In the paper's model, this is used for the last d, which contains the reflector's height above the
    /// flange.
    pub fn free(&mut self, parameter: Parameter) {
        let unknown = Unknown::Parameter(parameter);
        let found = self.variables.iter_mut().find(|v| v.unknown == unknown);
        if let Some(variable) = found {
            (variable.width, variable.prior) = (self.reach_mm, Prior::Flat);
        }
    }

    /// States a normal prior of a variable: its mean as a deviation from the reference, and its standard deviation, mm or rad.
    pub fn state(&mut self, variable: usize, mean: f64, std: f64) {
        let variable = &mut self.variables[variable];
        variable.prior = Prior::Stated {
            mean: mean / variable.width,
            std: std / variable.width,
        };
    }

    /// Prior mean of a coordinate.
    pub fn expected(&self, variable: usize) -> f64 {
        match self.variables[variable].prior {
            Prior::Stated { mean, .. } => mean,
            Prior::OfKind(_) | Prior::Flat => 0.0,
        }
    }

    /// Number of blocks.
    pub fn n_blocks(&self) -> usize {
        self.blocks.len()
    }

    /// The rows of a block.
    pub fn rows_of(&self, block: usize) -> Range<usize> {
        self.blocks[block].rows.clone()
    }

    /// The same problem with only some of the blocks, in the given order.
    pub fn part(&self, blocks: impl Iterator<Item = usize>) -> Self {
        let mut n_rows = 0;
        let mut after_the_last = |i: usize| {
            let block = &self.blocks[i];
            let first = n_rows;
            n_rows += block.rows.len();
            Block {
                rows: first..n_rows,
                ..block.clone()
            }
        };
        Self {
            reference: self.reference.clone(),
            variables: self.variables.clone(),
            reach_mm: self.reach_mm,
            least_sigma_mm: self.least_sigma_mm,
            usual_sigma_mm: self.usual_sigma_mm,
            parameters: self.parameters.clone(),
            blocks: blocks.map(&mut after_the_last).collect(),
            corrected: self.corrected,
        }
    }

    /// Number of rows of all blocks.
    pub fn n_rows(&self) -> usize {
        self.blocks.last().map_or(0, |block| block.rows.end)
    }

    /// Coordinates of a model. Those of stations and corrections are 0.
    pub fn coordinates(&self, model: &KinematicModel) -> Vec<f64> {
        self.coordinates_with(model, |_| 0.0)
    }

    /// Coordinates of a model with corrections, from the value of each term. Those of stations are 0.
    pub fn coordinates_with(
        &self,
        model: &KinematicModel,
        value: impl Fn(&Term) -> f64,
    ) -> Vec<f64> {
        let coordinate = |v: &Variable| {
            let deviation = match &v.unknown {
                Unknown::Parameter(parameter) => deviation_from(&self.reference, model, parameter),
                Unknown::Station(..) => 0.0,
                Unknown::Correction(term) => value(term),
            };
            deviation / v.width
        };
        self.variables.iter().map(coordinate).collect()
    }

    /// Deviations from the reference, mm or rad.
    pub fn deviation(&self, x: &[f64]) -> Vec<f64> {
        x.iter()
            .zip(&self.variables)
            .map(|(x, variable)| x * variable.width)
            .collect()
    }

    /// Scales the rows of a matrix, one per coordinate, to the units of the parameters, mm or rad.
    pub fn in_units(&self, mut of_coordinates: DMatrix<f64>) -> DMatrix<f64> {
        for (mut row, variable) in of_coordinates.row_iter_mut().zip(&self.variables) {
            row *= variable.width;
        }
        of_coordinates
    }

    /// The model at the given coordinates.
    pub fn model(&self, x: &[f64]) -> KinematicModel {
        self.at(x).model
    }

    /// The corrections at the given coordinates; `None` for links alone.
    pub fn corrections(&self, x: &[f64]) -> Option<Corrections> {
        self.at(x).corrections.map(|(corrections, _)| corrections)
    }

    /// The motion of each station at the given coordinates: it moves the station's measured points from where they are to the robot. Empty
    /// without stations.
    pub fn station_motions(&self, x: &[f64]) -> Vec<IsometryMatrix3<f64>> {
        let stations = self.at(x).stations;
        let of_measured = |predicted: &StationMotion| predicted.isometry().inverse();
        stations.iter().map(of_measured).collect()
    }

    /// Indices of the stations' variables.
    pub fn station_variables(&self) -> Range<usize> {
        let is_of_station = |v: &&Variable| matches!(v.unknown, Unknown::Station(..));
        let n = self.variables.iter().filter(is_of_station).count();
        self.parameters.len()..self.parameters.len() + n
    }

    /// Everything that the rows depend on.
    fn at(&self, x: &[f64]) -> State {
        let deviation = self.deviation(x);
        let mut base_rotation_rad = Vector3::zeros();
        let n_turned = self.reference.target_rotations.len();
        let mut target_rotations_rad = vec![Vector3::zeros(); n_turned];
        for (parameter, value) in self.parameters.iter().zip(&deviation) {
            match parameter {
                Parameter::BaseRotation(axis) => base_rotation_rad[*axis] = *value,
                Parameter::TargetRotation(target, axis) => {
                    target_rotations_rad[*target][*axis] = *value;
                }
                _ => {}
            }
        }
        let mut model = self.reference.clone();
        apply_into(&self.reference, &self.parameters, &deviation, &mut model);
        let (mut stations, mut terms, mut values) = (vec![], vec![], vec![]);
        let more = self.variables.iter().zip(&deviation);
        for (variable, value) in more.skip(self.parameters.len()) {
            match variable.unknown {
                Unknown::Parameter(_) => {}
                Unknown::Station(station, axis) => {
                    stations.resize(
                        station + 1,
                        StationMotion {
                            shift_mm: Vector3::zeros(),
                            rotation_rad: Vector3::zeros(),
                            about_mm: self.reference.t_instrument_base.translation.vector,
                        },
                    );
                    let motion: &mut StationMotion = &mut stations[station];
                    match axis {
                        0..3 => motion.shift_mm[axis] = *value,
                        _ => motion.rotation_rad[axis - 3] = *value,
                    }
                }
                Unknown::Correction(term) => {
                    terms.push(term);
                    values.push(*value);
                }
            }
        }
        let corrections = self.corrected.map(|Corrected { mounting, payload }| {
            let n_links = model.links.len();
            let mut corrections = corrections_at(n_links, &mounting, &terms, &values);
            corrections.compliance.payload = payload;
            (corrections, mounting)
        });
        State {
            model,
            base_rotation_rad,
            target_rotations_rad,
            corrections,
            stations,
        }
    }

    /// Fills the residuals of all blocks, mm, into the first [`Self::n_rows`] rows. If requested, also fills their derivatives by the coordinates,
    /// one column of the Jacobian each.
    pub fn evaluate(
        &self,
        x: &[f64],
        residuals: &mut [f64],
        mut jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let state = self.at(x);
        for block in &self.blocks {
            block.fill(&self.variables, &state, residuals, jacobian.as_deref_mut());
        }
    }
}
