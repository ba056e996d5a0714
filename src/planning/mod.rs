//! Planning of the poses to be measured next.

mod design;
mod information;
mod order;
mod request;
mod room;

pub use request::PlanRequest;
pub use room::{BaseCylinder, Room};

use crate::identification::identifiability::{VISIBLE_PER_REACH, decompose, prior_scales};
use crate::identification::objective::{Observation, weighted_jacobian};
use crate::identification::workspace::{ToolUncertainty, random_configurations};
use crate::kinematics::reach_mm;
use design::Design;
use information::{Tool, of_measured};
use nalgebra::{DMatrix, Vector3};

/// Number of configurations that represent the workspace. They differ from the candidates.
const N_WORKSPACE: usize = 256;
/// Seed of these configurations. It is the same for every plan, so that plans can be compared.
const WORKSPACE_SEED: u64 = 0;
/// Number of random configurations that are tried for each required candidate.
const TRIES: usize = 20;

/// One configuration of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// The controller's joint values, rad.
    pub q_controller_rad: Vec<f64>,
    /// Index of the configuration in the plan that it repeats.
    pub repeats: Option<usize>,
}

/// A plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The configurations in the order in which they should be measured.
    pub configurations: Vec<Planned>,
    /// O1 of the planned configurations (Borm & Menq 1991).
    pub observability_index_o1: f64,
    /// Predicted uncertainty of the tool over the workspace, from earlier measurements and the plan.
    pub predicted: ToolUncertainty,
    /// The same, with the first random candidates instead of the plan.
    pub predicted_random: ToolUncertainty,
}

/// Too few configurations are allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "only {found} of {tried} random configurations within the joint limits keep the tool in its boxes and clear of the obstacles; \
     {wanted} are wanted: widen the boxes, or plan fewer configurations"
)]
pub struct TooLittleRoom {
    /// Number of allowed configurations.
    pub found: usize,
    /// Number of configurations that were tried.
    pub tried: usize,
    /// Number of configurations that are required.
    pub wanted: usize,
}

/// Selects configurations that minimise the mean variance of the tool over the workspace (I-optimal design). The best of all candidates is added one
/// after the other. Then each is exchanged for a better one as long as that helps (Fedorov 1972), with rank-3 updates of the covariance. Parameters
/// have the priors of a new robot.
///
/// # Errors
/// [`TooLittleRoom`].
pub fn plan(request: &PlanRequest<'_>) -> Result<Plan, TooLittleRoom> {
    let tool = Tool::new(request);
    let Candidates {
        q: candidates,
        even,
    } = candidates(request)?;
    let q_model: Vec<Vec<f64>> = candidates
        .iter()
        .map(|q| request.robot.q_model_rad(q))
        .collect();
    let prior = request
        .measured
        .iter()
        .fold(DMatrix::identity(tool.n(), tool.n()), |sum, set| {
            sum + of_measured(request, &tool, set)
        });
    let workspace: Vec<Vec<f64>> =
        random_configurations(request.robot, N_WORKSPACE, WORKSPACE_SEED)
            .iter()
            .map(|q| request.robot.q_model_rad(q))
            .collect();
    let interest = tool.mean_information(&workspace, 1.0);
    let n_repeats = request.n_repeats.min(request.n_configurations / 2);
    let n_distinct = request.n_configurations - n_repeats;
    let rows = tool.scaled_rows(&q_model, request.noise_std_mm);
    let chosen = Design::new(rows, &prior, &interest).choose(n_distinct);
    let ordered = order::short_moves(chosen, &candidates);
    let all: Vec<usize> = ordered
        .iter()
        .copied()
        .chain(ordered[..n_repeats].iter().copied())
        .collect();
    let after = |chosen: &[usize]| {
        let q: Vec<Vec<f64>> = chosen.iter().map(|i| q_model[*i].clone()).collect();
        let gained = tool.mean_information(&q, request.noise_std_mm) * chosen.len() as f64;
        tool.uncertainty(&(&prior + gained), &workspace)
    };
    let random: Vec<usize> = even.into_iter().take(all.len()).collect();
    Ok(Plan {
        observability_index_o1: observability(request, &tool, &all, &q_model),
        predicted: after(&all),
        predicted_random: after(&random),
        configurations: all
            .iter()
            .enumerate()
            .map(|(i, candidate)| Planned {
                q_controller_rad: candidates[*candidate].clone(),
                repeats: i.checked_sub(n_distinct),
            })
            .collect(),
    })
}

/// Random configurations that are allowed, the controller's joint values, rad.
struct Candidates {
    q: Vec<Vec<f64>>,
    /// Indices of those that were drawn uniformly.
    even: Vec<usize>,
}

/// Half of the candidates are drawn uniformly, the others towards the limits, where parameters have the largest effect.
fn candidates(request: &PlanRequest<'_>) -> Result<Candidates, TooLittleRoom> {
    let wanted = request.n_configurations;
    let n = request.n_candidates.max(wanted);
    let mut found = Candidates {
        q: Vec::with_capacity(n),
        even: vec![],
    };
    let mut tried = 0;
    for batch in 0..TRIES as u64 {
        let drawn = random_configurations(
            request.robot,
            n,
            request.seed.wrapping_mul(TRIES as u64).wrapping_add(batch),
        );
        for (i, q) in drawn.into_iter().enumerate() {
            let is_even = i % 2 == 0;
            let q = if is_even {
                q
            } else {
                room::towards_limits(request.robot, q)
            };
            tried += 1;
            if request.room.holds(request.robot, &q, &request.target_mm) {
                found.even.extend(is_even.then_some(found.q.len()));
                found.q.push(q);
                if found.q.len() == n {
                    return Ok(found);
                }
            }
        }
    }
    if found.q.len() < wanted {
        Err(TooLittleRoom {
            found: found.q.len(),
            tried,
            wanted,
        })
    } else {
        Ok(found)
    }
}

fn observability(
    request: &PlanRequest<'_>,
    tool: &Tool,
    chosen: &[usize],
    q_model: &[Vec<f64>],
) -> f64 {
    let scale = prior_scales(&tool.parameters, reach_mm(&request.robot.links));
    let observations: Vec<Observation> = chosen
        .iter()
        .map(|i| tool.observation(&q_model[*i], 0))
        .collect();
    let mut jacobian = weighted_jacobian(
        &tool.model,
        &tool.parameters,
        &observations,
        &Vector3::zeros(),
    );
    let root = (request.n_configurations.max(1) as f64).sqrt();
    jacobian
        .column_iter_mut()
        .zip(&scale)
        .for_each(|(mut column, s)| column *= s / root);
    let visible_mm = VISIBLE_PER_REACH * reach_mm(&request.robot.links);
    decompose(jacobian, &scale, visible_mm).observability_index_o1()
}
