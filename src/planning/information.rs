//! Information of configurations about the parameters, and the resulting uncertainty of the tool. Parameters are in units of their prior scale.

use crate::identification::KinematicModel;
use crate::identification::identifiability::prior_scales;
use crate::identification::objective::{Observation, weighted_jacobian};
use crate::identification::parameters::Parameter;
use crate::identification::workspace::ToolUncertainty;
use crate::kinematics::reach_mm;
use crate::planning::request::{PlanRequest, nominal, parameters};
use nalgebra::{DMatrix, Vector3};

/// The reflector on the nominal robot, and the parameters of its position.
#[derive(Debug)]
pub struct Tool {
    /// The nominal robot.
    pub model: KinematicModel,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
}

impl Tool {
    /// The tool of a request.
    pub fn new(request: &PlanRequest<'_>) -> Self {
        Self {
            model: nominal(request.robot, vec![request.target_mm]),
            parameters: parameters(request.robot, request.model, 1),
        }
    }

    /// Number of parameters.
    pub fn n(&self) -> usize {
        self.parameters.len()
    }

    /// A point of a possible measurement.
    pub fn observation(&self, q_rad: &[f64], target: usize) -> Observation {
        Observation {
            q_rad: q_rad.to_vec(),
            position_mm: Vector3::zeros(),
            target,
            weight: 1.0,
            whitening: None,
            rotation: None,
        }
    }

    /// ∂(position)/∂(parameter in units of its prior scale) / `std_mm` at each configuration: 3 rows each.
    pub fn scaled_rows(&self, q_rad: &[Vec<f64>], std_mm: f64) -> DMatrix<f64> {
        let observations: Vec<Observation> = q_rad.iter().map(|q| self.observation(q, 0)).collect();
        scaled_rows(&self.model, &self.parameters, &observations, std_mm)
    }

    /// Mean of JᵀJ over configurations, p × p.
    pub fn mean_information(&self, q_rad: &[Vec<f64>], std_mm: f64) -> DMatrix<f64> {
        let rows = self.scaled_rows(q_rad, std_mm);
        rows.tr_mul(&rows) / q_rad.len().max(1) as f64
    }

    /// The tool's standard deviation over the workspace for a given information.
    pub fn uncertainty(
        &self,
        information: &DMatrix<f64>,
        workspace: &[Vec<f64>],
    ) -> ToolUncertainty {
        let rows = self.scaled_rows(workspace, 1.0);
        // J·M⁻¹·Jᵀ = |L⁻¹·Jᵀ|² with M = L·Lᵀ
        let whitened = information
            .clone()
            .cholesky()
            .and_then(|root| root.l().solve_lower_triangular(&rows.transpose()));
        let Some(whitened) = whitened else {
            return ToolUncertainty {
                mean_mm: f64::INFINITY,
                max_mm: f64::INFINITY,
            };
        };
        let std = |i: usize| whitened.columns(3 * i, 3).norm_squared().sqrt();
        let all: Vec<f64> = (0..workspace.len()).map(std).collect();
        ToolUncertainty {
            mean_mm: all.iter().sum::<f64>() / all.len().max(1) as f64,
            max_mm: all.iter().fold(0.0, |m, s| m.max(*s)),
        }
    }
}

fn scaled_rows(
    model: &KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
    std_mm: f64,
) -> DMatrix<f64> {
    let mut rows = weighted_jacobian(model, parameters, observations, &Vector3::zeros());
    let scales = prior_scales(parameters, reach_mm(&model.links));
    rows.column_iter_mut()
        .zip(scales)
        .for_each(|(mut column, scale)| column *= scale / std_mm);
    rows
}

/// Information of an earlier session about the links. Its base and targets may have been different, so they are eliminated (Schur complement).
pub fn of_measured(request: &PlanRequest<'_>, tool: &Tool, points: &[Observation]) -> DMatrix<f64> {
    let n_targets = points.iter().map(|o| o.target + 1).max().unwrap_or(0);
    let parameters = parameters(request.robot, request.model, n_targets);
    let model = nominal(request.robot, vec![request.target_mm; n_targets]);
    let rows = scaled_rows(&model, &parameters, points, request.noise_std_mm);
    let whole = rows.tr_mul(&rows);
    let is_link = |i: &usize| parameters[*i].is_link();
    let (links, others): (Vec<usize>, Vec<usize>) = (0..parameters.len()).partition(is_link);
    let part =
        |a: &[usize], b: &[usize]| DMatrix::from_fn(a.len(), b.len(), |i, j| whole[(a[i], b[j])]);
    let mut of_links = part(&links, &links);
    let placement = part(&others, &others) + DMatrix::identity(others.len(), others.len());
    if let Some(root) = placement.cholesky() {
        let between = part(&others, &links);
        of_links -= between.tr_mul(&root.solve(&between));
    }
    let position = |i: usize| {
        links
            .iter()
            .position(|link| parameters[*link] == tool.parameters[i])
    };
    let at: Vec<Option<usize>> = (0..tool.n()).map(position).collect();
    DMatrix::from_fn(tool.n(), tool.n(), |i, j| {
        at[i].zip(at[j]).map_or(0.0, |(i, j)| of_links[(i, j)])
    })
}
