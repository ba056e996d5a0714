//! The coordinates that a search runs in: raw parameters, or the singular directions of the scaled identification Jacobian.

use crate::identification::KinematicModel;
use crate::identification::identifiability::{Decomposition, decompose};
use crate::identification::linearisation::Linearisation;
use crate::identification::objective::{Observation, weighted_jacobian};
use crate::identification::parameters::{Parameter, apply_into};
use crate::identification::priors::{Known, Priors};
use multiversion::multiversion;
use nalgebra::{DMatrix, DVector, Vector3};

/// deviation = directions · coordinates, counted from the reference. In a search box every coordinate runs from −1 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchSpace {
    /// What deviations are counted from.
    pub reference: KinematicModel,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// p × r.
    directions: DMatrix<f64>,
    /// The scale of each parameter (half-width of the box), mm or rad.
    pub scale: Vec<f64>,
    /// Each coordinate is one parameter.
    is_raw: bool,
    /// What is known beforehand, counted from the reference.
    known: Known,
}

impl SearchSpace {
    /// One coordinate per parameter: deviation = scale · coordinate. The paper's search.
    pub fn raw(reference: KinematicModel, parameters: Vec<Parameter>, scale: Vec<f64>) -> Self {
        let directions = DMatrix::from_diagonal(&DVector::from_column_slice(&scale));
        Self {
            reference,
            parameters,
            directions,
            scale,
            is_raw: true,
            known: Known::default(),
        }
    }

    /// One coordinate per combination that the data see: deviation = S·V·coordinate, with J·S = U·Σ·Vᵀ at the reference. The box of
    /// these coordinates is the parameters' box turned (a uniform cube's spread is the same in every direction).
    pub fn singular(
        reference: KinematicModel,
        parameters: Vec<Parameter>,
        scale: Vec<f64>,
        observations: &[Observation],
    ) -> Self {
        let decomposition = decomposition_at(&reference, &parameters, &scale, observations);
        Self::along(
            reference,
            parameters,
            scale,
            decomposition.seen_directions(),
        )
    }

    /// As [`Self::singular`], of the points and the priors together: one coordinate per combination that either says something of.
    pub fn singular_knowing(
        reference: KinematicModel,
        parameters: Vec<Parameter>,
        scale: Vec<f64>,
        observations: &[Observation],
        priors: &Priors,
    ) -> Self {
        let decomposition = decomposition_at(&reference, &parameters, &scale, observations);
        let (directions, _) = decomposition.directions_with_priors(&priors.stds());
        let known = priors.from(&reference);
        let rows = rows_along(&reference, &parameters, &directions, observations, &known);
        let turned = &directions * decompose(rows, &vec![1.0; directions.ncols()]).directions;
        Self::along(reference, parameters, scale, turned).knowing(known)
    }

    /// As [`Self::singular`], along directions that were found elsewhere, p × r: their columns, each parameter divided by its scale, are
    /// orthonormal.
    pub fn along(
        reference: KinematicModel,
        parameters: Vec<Parameter>,
        scale: Vec<f64>,
        directions: DMatrix<f64>,
    ) -> Self {
        Self {
            reference,
            parameters,
            directions,
            scale,
            is_raw: false,
            known: Known::default(),
        }
    }

    /// With what is known beforehand: deviations beyond a limit stop at it, and pulls add to the cost.
    pub fn knowing(self, known: Known) -> Self {
        Self { known, ..self }
    }

    /// What is known beforehand.
    pub fn known(&self) -> &Known {
        &self.known
    }

    /// True if every coordinate is one parameter, scaled.
    pub fn is_raw(&self) -> bool {
        self.is_raw
    }

    /// Number of coordinates.
    pub fn n_coordinates(&self) -> usize {
        self.directions.ncols()
    }

    /// p × r: deviation = directions · coordinates.
    pub fn directions(&self) -> &DMatrix<f64> {
        &self.directions
    }

    /// Deviations of the parameters, mm or rad.
    pub fn deviation(&self, coordinates: &[f64]) -> Vec<f64> {
        let mut deviation = vec![0.0; self.parameters.len()];
        self.deviation_into(coordinates, &mut deviation);
        deviation
    }

    /// As [`Self::deviation`], without allocating.
    pub fn deviation_into(&self, coordinates: &[f64], deviation: &mut [f64]) {
        if self.is_raw {
            for ((to, z), s) in deviation.iter_mut().zip(coordinates).zip(&self.scale) {
                *to = z * s;
            }
        } else {
            combine(self.directions.as_slice(), coordinates, deviation);
        }
        for limit in &self.known.limits {
            deviation[limit.parameter] = limit.within(deviation[limit.parameter]);
        }
    }

    /// The coordinates whose deviation is nearest (in scaled parameters): Vᵀ·S⁻¹·deviation.
    pub fn coordinates(&self, deviation: &[f64]) -> Vec<f64> {
        let scaled = |row: usize| deviation[row] / self.scale[row];
        if self.is_raw {
            return (0..deviation.len()).map(scaled).collect();
        }
        let along = |column: nalgebra::DVectorView<'_, f64>| {
            column
                .iter()
                .enumerate()
                .map(|(row, v)| v / self.scale[row] * scaled(row))
                .sum()
        };
        self.directions.column_iter().map(along).collect()
    }

    /// The model at some coordinates.
    pub fn model(&self, coordinates: &[f64]) -> KinematicModel {
        let mut model = self.reference.clone();
        apply_into(
            &self.reference,
            &self.parameters,
            &self.deviation(coordinates),
            &mut model,
        );
        model
    }

    /// The rotation vector among some deviations: how far the base is turned from the reference.
    pub fn base_rotation(&self, deviation: &[f64]) -> Vector3<f64> {
        let mut rotation = Vector3::zeros();
        for (parameter, value) in self.parameters.iter().zip(deviation) {
            if let Parameter::BaseRotation(axis) = parameter {
                rotation[*axis] = *value;
            }
        }
        rotation
    }
}

/// Derivatives of points and priors along some directions, weighted, mm.
fn rows_along(
    reference: &KinematicModel,
    parameters: &[Parameter],
    directions: &DMatrix<f64>,
    observations: &[Observation],
    known: &Known,
) -> DMatrix<f64> {
    let of_points =
        weighted_jacobian(reference, parameters, observations, &Vector3::zeros()) * directions;
    let n = of_points.nrows();
    let mut rows = of_points.resize_vertically(n + known.pulls.len(), 0.0);
    for (k, pull) in known.pulls.iter().enumerate() {
        rows.row_mut(n + k)
            .copy_from(&(directions.row(pull.parameter) * pull.weight));
    }
    rows
}

/// directions · coordinates.
#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma"))]
fn combine(directions: &[f64], coordinates: &[f64], deviation: &mut [f64]) {
    deviation.fill(0.0);
    for (column, z) in directions
        .chunks_exact(deviation.len().max(1))
        .zip(coordinates)
    {
        for (to, v) in deviation.iter_mut().zip(column) {
            *to = v.mul_add(*z, *to);
        }
    }
}

/// The scaled identification Jacobian at a model, taken apart.
pub fn decomposition_at(
    model: &KinematicModel,
    parameters: &[Parameter],
    scale: &[f64],
    observations: &[Observation],
) -> Decomposition {
    decompose(
        scaled_jacobian_at(model, parameters, scale, observations),
        scale,
    )
}

/// The identification Jacobian at a model: mm that points move for one scale of each parameter, over sqrt(N points).
pub fn scaled_jacobian_at(
    model: &KinematicModel,
    parameters: &[Parameter],
    scale: &[f64],
    observations: &[Observation],
) -> DMatrix<f64> {
    let per_point = 1.0 / (observations.len().max(1) as f64).sqrt();
    let shares = scale.iter().map(|s| s * per_point).collect();
    let space = SearchSpace::raw(model.clone(), parameters.to_vec(), shares);
    let mut linearisation = Linearisation::new(&space, observations);
    let n_rows = linearisation.n_rows();
    let mut scaled = DMatrix::zeros(n_rows, parameters.len());
    linearisation.linearise(
        &vec![0.0; parameters.len()],
        &mut vec![0.0; n_rows],
        scaled.as_mut_slice(),
    );
    scaled
}
