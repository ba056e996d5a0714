//! Planning of the poses to be measured next.

mod design;
mod information;
mod order;
mod request;
mod room;

pub use request::{Noise, PlanRequest, SetUp};
pub use room::{AcceptanceCone, AlignedBox, BaseCylinder, LineOfSight, Room};

use crate::identification::model::identifiability::{
    Decomposition, VISIBLE_PER_REACH, decompose, prior_scales,
};
use crate::identification::model::objective::{Observation, weighted_jacobian};
use crate::identification::statistics::workspace::{ToolUncertainty, random_configurations};
use crate::kinematics::reach_mm;
use design::Design;
use information::{Tool, is_base};
use nalgebra::{DMatrix, Vector3};

/// Number of configurations that represent the workspace. They differ from the candidates.
const N_WORKSPACE: usize = 256;
/// Seed of these configurations. It is the same for every plan, so that plans can be compared.
const WORKSPACE_SEED: u64 = 0;
/// Number of random configurations that are tried for each required candidate.
const TRIES_PER_CANDIDATE: usize = 20;
/// Number of times that each of several set-ups is planned, given the present plans of the others.
const ROUNDS: usize = 3;

/// One configuration of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// The controller's joint values, rad.
    pub q_controller_rad: Vec<f64>,
    /// Index of the set-up from which it is measured.
    pub set_up: usize,
    /// Index of the configuration in the plan that it repeats.
    pub repeats: Option<usize>,
}

/// A plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The configurations in the order in which they should be measured, set-up by set-up.
    pub configurations: Vec<Planned>,
    /// Number of equations from different configurations.
    pub n_equations: usize,
    /// Number of parameter combinations that measurements of this kind from these set-ups can determine.
    pub n_combinations: usize,
    /// O1 of the planned configurations (Borm & Menq 1991).
    pub observability_index_o1: f64,
    /// Predicted uncertainty of the tool over the workspace, from earlier measurements and the whole plan, for each set-up in its frame.
    pub predicted: Vec<ToolUncertainty>,
    /// The same, with the first random candidates instead of the plan.
    pub predicted_random: Vec<ToolUncertainty>,
}

/// Too few configurations are allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "only {found} of {tried} random configurations within the joint limits keep the tool in its boxes, clear of the obstacles and in sight of the \
     instrument; {wanted} are wanted: widen the boxes, or plan fewer configurations"
)]
pub struct TooLittleRoom {
    /// Index of the set-up.
    pub set_up: usize,
    /// Number of allowed configurations.
    pub found: usize,
    /// Number of configurations that were tried.
    pub tried: usize,
    /// Number of configurations that are required.
    pub wanted: usize,
}

/// Selects configurations that minimise the mean variance of the tool over the workspace (I-optimal design). Candidates are added one by
/// one, each time the best one. Then each is exchanged for a better one as long as this improves the plan (Fedorov 1972), with updates of
/// the covariance. Parameters have the priors of a new robot. Several set-ups share links and target; each is planned [`ROUNDS`] times,
/// given the plans of the others.
///
/// # Errors
/// [`TooLittleRoom`].
pub fn plan(request: &PlanRequest<'_>) -> Result<Plan, TooLittleRoom> {
    let tool = Tool::new(request);
    let candidates = (0..request.set_ups.len())
        .map(|set_up| candidates(request, set_up))
        .collect::<Result<Vec<_>, _>>()?;
    let prior = request
        .measured
        .iter()
        .fold(DMatrix::identity(tool.n(), tool.n()), |sum, points| {
            sum + tool.information_of_measured(request, points)
        });
    let workspace: Vec<Vec<f64>> =
        random_configurations(request.robot, N_WORKSPACE, WORKSPACE_SEED)
            .iter()
            .map(|q| request.robot.q_model_rad(q))
            .collect();
    let chosen = choose(request, &tool, &candidates, &prior, &workspace);
    let q_model = |of: &dyn Fn(usize) -> Vec<usize>| -> Vec<Vec<Vec<f64>>> {
        let of_set_up = |set_up: usize| candidates[set_up].q_model(request, &of(set_up));
        (0..candidates.len()).map(of_set_up).collect()
    };
    let planned = q_model(&|set_up| chosen[set_up].clone());
    let random = q_model(&|set_up| {
        let n = chosen[set_up].len();
        candidates[set_up].even.iter().copied().take(n).collect()
    });
    let n_rows = if request.is_of_poses { 6 } else { 3 };
    let n_distinct = |set_up: &SetUp| set_up.n_configurations - set_up.n_repeated();
    Ok(Plan {
        n_equations: n_rows * request.set_ups.iter().map(n_distinct).sum::<usize>(),
        n_combinations: decomposition(request, &tool, &vec![workspace.clone(); planned.len()])
            .rank(),
        observability_index_o1: decomposition(request, &tool, &planned).observability_index_o1(),
        predicted: predicted(&tool, &prior, &planned, &workspace),
        predicted_random: predicted(&tool, &prior, &random, &workspace),
        configurations: in_order(request, &candidates, &chosen),
    })
}

/// Selected candidates of each set-up in the order of measuring, repeats included.
fn choose(
    request: &PlanRequest<'_>,
    tool: &Tool,
    candidates: &[Candidates],
    prior: &DMatrix<f64>,
    workspace: &[Vec<f64>],
) -> Vec<Vec<usize>> {
    let workspace_information = tool.mean_position_information(workspace);
    let rows: Vec<DMatrix<f64>> = candidates
        .iter()
        .map(|of_set_up| tool.measured_rows(&of_set_up.all_q_model(request)))
        .collect();
    let mut chosen: Vec<Vec<usize>> = vec![vec![]; candidates.len()];
    let rounds = if candidates.len() > 1 { ROUNDS } else { 1 };
    for _ in 0..rounds {
        for (set_up, wanted) in request.set_ups.iter().enumerate() {
            let others = (0..candidates.len()).filter(|other| *other != set_up);
            let known = others.fold(prior.clone(), |sum, other| {
                let q = candidates[other].q_model(request, &chosen[other]);
                sum + tool.information_from_another_base(&q)
            });
            let rows = &rows[set_up];
            let n = wanted.n_configurations - wanted.n_repeated();
            chosen[set_up] = if request.is_of_poses {
                Design::<6>::new(rows, &known, &workspace_information).choose(n)
            } else {
                Design::<3>::new(rows, &known, &workspace_information).choose(n)
            };
        }
    }
    let with_repeats = |(set_up, chosen): (usize, Vec<usize>)| {
        let mut ordered = order::short_moves(chosen, &candidates[set_up].q);
        ordered.extend_from_within(..request.set_ups[set_up].n_repeated());
        ordered
    };
    chosen.into_iter().enumerate().map(with_repeats).collect()
}

fn in_order(
    request: &PlanRequest<'_>,
    candidates: &[Candidates],
    chosen: &[Vec<usize>],
) -> Vec<Planned> {
    let mut configurations = vec![];
    for (set_up, chosen) in chosen.iter().enumerate() {
        let first = configurations.len();
        let n_distinct = chosen.len() - request.set_ups[set_up].n_repeated();
        let planned = chosen.iter().enumerate().map(|(i, candidate)| Planned {
            q_controller_rad: candidates[set_up].q[*candidate].clone(),
            set_up,
            repeats: i.checked_sub(n_distinct).map(|i| first + i),
        });
        configurations.extend(planned);
    }
    configurations
}

/// The tool's uncertainty in the frame of each set-up, with the configurations of all.
fn predicted(
    tool: &Tool,
    prior: &DMatrix<f64>,
    q_model: &[Vec<Vec<f64>>],
    workspace: &[Vec<f64>],
) -> Vec<ToolUncertainty> {
    let in_frame_of = |set_up: usize| {
        let of = |(other, q): (usize, &Vec<Vec<f64>>)| {
            if other == set_up {
                tool.information(q)
            } else {
                tool.information_from_another_base(q)
            }
        };
        let gained = q_model.iter().enumerate().map(of);
        tool.uncertainty(
            &gained.fold(prior.clone(), |sum, more| sum + more),
            workspace,
        )
    };
    (0..q_model.len()).map(in_frame_of).collect()
}

/// Random configurations that are allowed, the controller's joint values, rad.
struct Candidates {
    q: Vec<Vec<f64>>,
    /// Indices of those that were drawn uniformly.
    even: Vec<usize>,
}

impl Candidates {
    /// The model's joint values of some candidates, rad.
    fn q_model(&self, request: &PlanRequest<'_>, of: &[usize]) -> Vec<Vec<f64>> {
        of.iter()
            .map(|i| request.robot.q_model_rad(&self.q[*i]))
            .collect()
    }

    fn all_q_model(&self, request: &PlanRequest<'_>) -> Vec<Vec<f64>> {
        self.q_model(request, &(0..self.q.len()).collect::<Vec<_>>())
    }
}

/// Random candidates. Half are drawn uniformly, the others towards the limits, where parameters have the largest effect.
fn candidates(request: &PlanRequest<'_>, set_up: usize) -> Result<Candidates, TooLittleRoom> {
    let wanted = request.set_ups[set_up].n_configurations;
    let room = &request.set_ups[set_up].room;
    let n = request.n_candidates.max(wanted);
    let mut found = Candidates {
        q: Vec::with_capacity(n),
        even: vec![],
    };
    let mut tried = 0;
    for batch in 0..TRIES_PER_CANDIDATE as u64 {
        let drawn = random_configurations(
            request.robot,
            n,
            request
                .seed
                .wrapping_mul(TRIES_PER_CANDIDATE as u64)
                .wrapping_add(batch),
        );
        for (i, q) in drawn.into_iter().enumerate() {
            let is_even = i % 2 == 0;
            let q = if is_even {
                q
            } else {
                room::towards_limits(request.robot, q)
            };
            tried += 1;
            if room.holds(request.robot, &q, &request.target_mm) {
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
            set_up,
            found: found.q.len(),
            tried,
            wanted,
        })
    } else {
        Ok(found)
    }
}

/// Decomposition of what the configurations of all set-ups determine together. Each set-up has its own base.
fn decomposition(
    request: &PlanRequest<'_>,
    tool: &Tool,
    q_model: &[Vec<Vec<f64>>],
) -> Decomposition {
    let reach_mm = reach_mm(&request.robot.links);
    let (base, shared): (Vec<usize>, Vec<usize>) =
        (0..tool.n()).partition(|i| is_base(&tool.parameters[*i]));
    let n_bases = base.len() * q_model.len();
    let observations: Vec<Observation> = q_model
        .iter()
        .flatten()
        .map(|q| tool.observation(q))
        .collect();
    let own = weighted_jacobian(
        &tool.model,
        &tool.parameters,
        &observations,
        &Vector3::zeros(),
    );
    let rows_each = own.nrows() / observations.len().max(1);
    let root = (observations.len().max(1) as f64).sqrt();
    let own_scale = prior_scales(&tool.parameters, reach_mm);
    let mut jacobian = DMatrix::zeros(own.nrows(), n_bases + shared.len());
    let mut scale = vec![0.0; jacobian.ncols()];
    let mut row = 0;
    for (set_up, q) in q_model.iter().enumerate() {
        let n = rows_each * q.len();
        let columns = base
            .iter()
            .enumerate()
            .map(|(k, from)| (*from, base.len() * set_up + k))
            .chain(
                shared
                    .iter()
                    .enumerate()
                    .map(|(k, from)| (*from, n_bases + k)),
            );
        for (from, to) in columns {
            scale[to] = own_scale[from];
            let column = own.view((row, from), (n, 1)) * (own_scale[from] / root);
            jacobian.view_mut((row, to), (n, 1)).copy_from(&column);
        }
        row += n;
    }
    let visible_mm = VISIBLE_PER_REACH * reach_mm;
    decompose(jacobian, &scale, visible_mm)
}
