//! Information of configurations about the parameters, and the resulting uncertainty of the tool. Parameters are in units of their prior scale.

use crate::identification::KinematicModel;
use crate::identification::model::identifiability::prior_scales;
use crate::identification::model::objective::{Observation, weighted_jacobian};
use crate::identification::model::parameters::Parameter;
use crate::identification::model::pose_rows::MeasuredRotation;
use crate::identification::statistics::workspace::ToolUncertainty;
use crate::kinematics::reach_mm;
use crate::planning::request::{Noise, PlanRequest, nominal, parameters};
use nalgebra::{DMatrix, Rotation3, Vector3};

/// The target on the nominal robot, and the parameters of its position or pose.
#[derive(Debug)]
pub struct Tool {
    /// The nominal robot.
    pub model: KinematicModel,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    noise: Noise,
    is_of_poses: bool,
}

impl Tool {
    /// The tool of a request.
    pub fn new(request: &PlanRequest<'_>) -> Self {
        let mut tool = Self {
            model: nominal(request.robot, vec![request.target_mm]),
            parameters: vec![],
            noise: request.noise,
            is_of_poses: request.is_of_poses,
        };
        let one = tool.observation(&vec![0.0; request.robot.links.len()]);
        tool.parameters = parameters(request.robot, request.model, 1, &[one]);
        tool
    }

    /// Number of parameters.
    pub fn n(&self) -> usize {
        self.parameters.len()
    }

    /// A possible measurement.
    pub fn observation(&self, q_rad: &[f64]) -> Observation {
        let mut observation = position(q_rad);
        if self.is_of_poses {
            let mm_per_rad = self.noise.mm_per_rad();
            observation.rotation = predicted_rotation(&self.model, &observation, mm_per_rad);
        }
        observation
    }

    /// ∂(rows)/∂(parameter in units of its prior scale) / noise at each configuration: three rows for a position, six for a pose.
    pub fn measured_rows(&self, q_rad: &[Vec<f64>]) -> DMatrix<f64> {
        let observations: Vec<Observation> = q_rad.iter().map(|q| self.observation(q)).collect();
        let rows = scaled_rows(&self.model, &self.parameters, &observations);
        rows / self.noise.position_std_mm
    }

    /// Information of configurations, p × p.
    pub fn information(&self, q_rad: &[Vec<f64>]) -> DMatrix<f64> {
        let rows = self.measured_rows(q_rad);
        rows.tr_mul(&rows)
    }

    /// Information of configurations that were measured with another base, about the links and the target.
    pub fn information_from_another_base(&self, q_rad: &[Vec<f64>]) -> DMatrix<f64> {
        let is_shared = |p: &Parameter| !is_base(p);
        let shared = without(&self.information(q_rad), &self.parameters, is_shared);
        self.placed(&shared, &self.parameters, is_shared)
    }

    /// Mean of JᵀJ of the tool's position over configurations, mm², p × p.
    pub fn mean_position_information(&self, q_rad: &[Vec<f64>]) -> DMatrix<f64> {
        let rows = self.position_rows(q_rad);
        rows.tr_mul(&rows) / q_rad.len().max(1) as f64
    }

    /// The tool's standard deviation over the workspace for a given information.
    pub fn uncertainty(
        &self,
        information: &DMatrix<f64>,
        workspace: &[Vec<f64>],
    ) -> ToolUncertainty {
        let rows = self.position_rows(workspace);
        // J·M⁻¹·Jᵀ = |L⁻¹·Jᵀ|² with M = L·Lᵀ.
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

    /// Information of an earlier session or station about the links. Its base and targets may have been different.
    pub fn information_of_measured(
        &self,
        request: &PlanRequest<'_>,
        points: &[Observation],
    ) -> DMatrix<f64> {
        let n_targets = points.iter().map(|o| o.target + 1).max().unwrap_or(0);
        let model = nominal(request.robot, vec![request.target_mm; n_targets]);
        // Only the derivatives matter, so each pose is placed where the nominal robot has it.
        let points: Vec<Observation> = points
            .iter()
            .map(|o| Observation {
                rotation: o
                    .rotation
                    .and_then(|_| predicted_rotation(&model, o, self.noise.mm_per_rad())),
                ..o.clone()
            })
            .collect();
        let parameters = parameters(request.robot, request.model, n_targets, &points);
        let rows = scaled_rows(&model, &parameters, &points) / self.noise.position_std_mm;
        let of_links = without(&rows.tr_mul(&rows), &parameters, Parameter::is_link);
        self.placed(&of_links, &parameters, Parameter::is_link)
    }

    fn position_rows(&self, q_rad: &[Vec<f64>]) -> DMatrix<f64> {
        let observations: Vec<Observation> = q_rad.iter().map(|q| position(q)).collect();
        scaled_rows(&self.model, &self.parameters, &observations)
    }

    /// Expands the information about some kept parameters to all parameters of the tool, in their order, with zeros for the others.
    fn placed(
        &self,
        information: &DMatrix<f64>,
        parameters: &[Parameter],
        is_kept: impl Fn(&Parameter) -> bool,
    ) -> DMatrix<f64> {
        let kept: Vec<&Parameter> = parameters.iter().filter(|p| is_kept(p)).collect();
        let at: Vec<Option<usize>> = self
            .parameters
            .iter()
            .map(|own| kept.iter().position(|p| *p == own))
            .collect();
        DMatrix::from_fn(self.n(), self.n(), |i, j| {
            at[i].zip(at[j]).map_or(0.0, |(i, j)| information[(i, j)])
        })
    }
}

/// True for the parameters of the base.
pub fn is_base(parameter: &Parameter) -> bool {
    matches!(
        parameter,
        Parameter::BaseTranslation(_) | Parameter::BaseRotation(_)
    )
}

fn position(q_rad: &[f64]) -> Observation {
    Observation::at(q_rad.to_vec(), Vector3::zeros(), 0)
}

fn predicted_rotation(
    model: &KinematicModel,
    o: &Observation,
    mm_per_rad: f64,
) -> Option<MeasuredRotation> {
    let rotation: Rotation3<f64> = model.rotation(&o.q_rad, o.target)?;
    Some(MeasuredRotation {
        rotation,
        mm_per_rad,
        lever_mm: Vector3::zeros(),
    })
}

/// The Jacobian with each parameter in units of its prior scale, mm.
fn scaled_rows(
    model: &KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
) -> DMatrix<f64> {
    let mut rows = weighted_jacobian(model, parameters, observations, &Vector3::zeros());
    let scales = prior_scales(parameters, reach_mm(&model.links));
    rows.column_iter_mut()
        .zip(scales)
        .for_each(|(mut column, scale)| column *= scale);
    rows
}

/// Information about the kept parameters. The others, which have their priors, are eliminated (Schur complement).
fn without(
    whole: &DMatrix<f64>,
    parameters: &[Parameter],
    is_kept: impl Fn(&Parameter) -> bool,
) -> DMatrix<f64> {
    let (kept, others): (Vec<usize>, Vec<usize>) =
        (0..parameters.len()).partition(|i| is_kept(&parameters[*i]));
    let part =
        |a: &[usize], b: &[usize]| DMatrix::from_fn(a.len(), b.len(), |i, j| whole[(a[i], b[j])]);
    let mut of_kept = part(&kept, &kept);
    let eliminated = part(&others, &others) + DMatrix::identity(others.len(), others.len());
    if let Some(root) = eliminated.cholesky() {
        let between = part(&others, &kept);
        of_kept -= between.tr_mul(&root.solve(&between));
    }
    of_kept
}
