//! BPNN-PSO [Gao 2018, section 3.2, figures 4 and 5]: a network trained on one swarm's run moves the particles of the next one.
//!
//! The inputs are a particle's initial position, the outputs are the optimum that the run ended with. Both are link parameter deviations divided by
//! the half-width of the search box. Cost and update rule of the swarm do not change.
//!
//! Positions are relative to the middle of the box, answers are relative to the nominal robot. So a swarm that searched around other joint
//! offsets can train the network for a swarm whose box is elsewhere.

use crate::identification::model::parameters::{Parameter, deviation_from};
use crate::identification::model::search_space::SearchSpace;
use crate::identification::{KinematicModel, Model, Preset, TrainedNetwork};
use crate::kinematics::rotation::within_half_a_turn;
use crate::solvers::bpnn::{self, Network};
use crate::solvers::pso::{self, Positions};

/// Mean squared error, in half-widths of the search box, at which training ends. The paper prints no value. If the network gave exactly the
/// same answer for every particle, the swarm, which starts at rest, could not move: the spread that the network leaves is the region in
/// which the follow-up searches. With the paper's preset, any value from 1e-5 to 1e-2 gives about the same result (all under 15 of 404
/// iterations); a network trained for 10,000 epochs needs 44 to 85.
const TARGET_ERROR_PAPER: f64 = 1e-4;
/// As [`TARGET_ERROR_PAPER`], for the default preset. A smaller value is better for an unchanged robot, a larger one for a changed robot.
const TARGET_ERROR_DEFAULT: f64 = 5e-6;

/// Maximum number of particles that the network learns from: the paper's swarm. More take longer and add no information, because all have the same
/// answer.
const MAX_SAMPLES: usize = 200;

/// Trains the robot's network on a finished swarm: 200 particles, all with the same answer.
pub fn train(
    space: &SearchSpace,
    nominal: &KinematicModel,
    swarm: &pso::Summary,
    seed: u64,
    model: Model,
    preset: Preset,
) -> TrainedNetwork {
    let links = link_indices(&space.parameters);
    let scale: Vec<f64> = links.iter().map(|i| space.scale[*i]).collect();
    let scaled = |coordinates: &[f64]| -> Vec<f64> {
        let deviation = space.deviation(coordinates);
        links
            .iter()
            .map(|i| deviation[*i] / space.scale[*i])
            .collect()
    };
    let n = swarm.initial_positions.n_particles.min(MAX_SAMPLES);
    let inputs: Vec<Vec<f64>> = (0..n)
        .map(|i| scaled(&swarm.initial_positions.particle(i)))
        .collect();
    let answer = scaled(&swarm.best_position);
    let targets = vec![answer.clone(); n];
    let target_error = match preset {
        Preset::Paper => TARGET_ERROR_PAPER,
        Preset::Default => TARGET_ERROR_DEFAULT,
    };
    let options = bpnn::Options {
        seed,
        target_error,
        ..bpnn::Options::default()
    };
    let (network, trained) = bpnn::choose_size_and_train(&inputs, &targets, &options);
    let middle = links_from_nominal(space, nominal);
    let from_nominal = |scaled: &[f64], sign: f64| -> Vec<f64> {
        links
            .iter()
            .zip(scaled)
            .zip(&scale)
            .map(|((i, value), s)| value + sign * middle[*i] / s)
            .collect()
    };
    TrainedNetwork {
        hidden_weights: network.hidden_weights,
        hidden_thresholds: network.hidden_thresholds,
        output_weights: network.output_weights,
        // Outputs are sums minus thresholds.
        output_thresholds: from_nominal(&network.output_thresholds, -1.0),
        model,
        preset,
        parameter_names: links.iter().map(|i| space.parameters[*i].name()).collect(),
        answer: from_nominal(&answer, 1.0)
            .iter()
            .zip(&scale)
            .map(|(a, s)| a * s)
            .collect(),
        scale,
        training_error: trained.training_error,
        validation_error: trained.validation_error,
    }
}

/// Moves every particle to the network's prediction. Base and targets are unknown to the network and stay as the particle has them.
pub fn move_particles(
    space: &SearchSpace,
    nominal: &KinematicModel,
    network: &TrainedNetwork,
    positions: &mut Positions,
) {
    let links = link_indices(&space.parameters);
    let middle = links_from_nominal(space, nominal);
    let deviations: Vec<Vec<f64>> = (0..positions.n_particles)
        .map(|i| space.deviation(&positions.particle(i)))
        .collect();
    let scaled = |deviation: &Vec<f64>| {
        links
            .iter()
            .zip(&network.scale)
            .map(|(i, s)| deviation[*i] / s)
            .collect()
    };
    let inputs: Vec<Vec<f64>> = deviations.iter().map(scaled).collect();
    for (particle, (mut deviation, output)) in deviations
        .into_iter()
        .zip(layers(network).evaluate_all(&inputs))
        .enumerate()
    {
        for ((i, y), s) in links.iter().zip(output).zip(&network.scale) {
            deviation[*i] = y * s - middle[*i];
        }
        positions.set_particle(particle, &space.coordinates(&deviation));
    }
}

/// Deviation of the links at the middle of the box from nominal, mm or rad, with angles within half a turn; zero for base and targets.
pub fn links_from_nominal(space: &SearchSpace, nominal: &KinematicModel) -> Vec<f64> {
    let from_nominal = |p: &Parameter| match (p.is_link(), p.is_angle()) {
        (true, true) => within_half_a_turn(deviation_from(nominal, &space.reference, p)),
        (true, false) => deviation_from(nominal, &space.reference, p),
        (false, _) => 0.0,
    };
    space.parameters.iter().map(from_nominal).collect()
}

/// True if the network was trained on exactly these link parameters, in this order.
pub fn fits(network: &TrainedNetwork, parameters: &[Parameter]) -> bool {
    let names = parameters
        .iter()
        .filter(|p| p.is_link())
        .map(Parameter::name);
    names.eq(network.parameter_names.iter().cloned())
}

/// The network's two layers in the solver's form.
fn layers(network: &TrainedNetwork) -> Network {
    Network {
        n_inputs: network.parameter_names.len(),
        n_hidden: network.hidden_thresholds.len(),
        n_outputs: network.parameter_names.len(),
        hidden_weights: network.hidden_weights.clone(),
        hidden_thresholds: network.hidden_thresholds.clone(),
        output_weights: network.output_weights.clone(),
        output_thresholds: network.output_thresholds.clone(),
    }
}

fn link_indices(parameters: &[Parameter]) -> Vec<usize> {
    parameters
        .iter()
        .enumerate()
        .filter(|(_, p)| p.is_link())
        .map(|(i, _)| i)
        .collect()
}
