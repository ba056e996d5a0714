//! The coordinates that a search runs in: raw parameters, or the singular directions of the scaled identification Jacobian.

use crate::identification::KinematicModel;
use crate::identification::parameters::{Parameter, apply_into};
use crate::identification::priors::PriorRows;
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
    known: PriorRows,
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
            known: PriorRows::default(),
        }
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
            known: PriorRows::default(),
        }
    }

    /// With what is known beforehand: deviations beyond a limit stop at it, and pulls add to the cost.
    pub fn with_priors(self, known: PriorRows) -> Self {
        Self { known, ..self }
    }

    /// What is known beforehand.
    pub fn prior_rows(&self) -> &PriorRows {
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
