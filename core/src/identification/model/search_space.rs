//! The coordinates of a search: raw parameters, or the singular directions of the scaled identification Jacobian.

use crate::identification::KinematicModel;
use crate::identification::model::parameters::{Parameter, apply_into};
use crate::identification::model::priors::PriorRows;
use multiversion::multiversion;
use nalgebra::{DMatrix, DVector, Vector3};

/// deviation = directions · coordinates, relative to the reference. In a search box every coordinate is between −1 and 1.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchSpace {
    /// Reference of the deviations.
    pub reference: KinematicModel,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// p × r.
    directions: DMatrix<f64>,
    /// The scale of each parameter (half-width of the box), mm or rad.
    pub scale: Vec<f64>,
    /// True if each coordinate is one parameter.
    is_raw: bool,
    /// Priors and bounds, relative to the reference.
    known: PriorRows,
}

impl SearchSpace {
    /// One coordinate per parameter: deviation = scale · coordinate. This is the paper's search.
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

    /// As [`Self::singular`], along given directions, p × r. Their columns are orthonormal after each parameter is divided by its scale.
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

    /// The space with priors and bounds: deviations stop at a bound, and priors add to the cost.
    pub fn with_priors(self, known: PriorRows) -> Self {
        Self { known, ..self }
    }

    /// Priors and bounds.
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
        for prior in &self.known.all {
            deviation[prior.parameter] = prior.within(deviation[prior.parameter]);
        }
    }

    /// The coordinates with the nearest deviation (in scaled parameters): Vᵀ·S⁻¹·deviation.
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

    /// The model at the given coordinates.
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

    /// The rotation vector of the base in some deviations, relative to the reference.
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
