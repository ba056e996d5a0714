//! Forward pass and back-propagation over all samples. Lanes contain samples. Every sum has a fixed order, so that the results do not depend on the
//! CPU or on the width of its registers, to the last bit.

use super::network::Network;
use super::tanh::tanh;
use multiversion::multiversion;

/// Number of samples that are computed side by side.
const LANES: usize = 8;

/// One value of eight samples.
type Lanes = [f64; LANES];

/// Number of outputs that are computed together, so that each loaded input is used more than once.
const OUTPUTS_AT_ONCE: usize = 4;

/// Values of all samples, eight samples to a block: `values[block * n_values + value][lane]`. The last block is padded with zeros.
#[derive(Clone, Debug)]
pub(super) struct Samples {
    n_values: usize,
    values: Vec<Lanes>,
}

impl Samples {
    fn zeros(n_blocks: usize, n_values: usize) -> Self {
        Self {
            n_values,
            values: vec![[0.0; LANES]; n_blocks * n_values],
        }
    }

    /// From one row per sample.
    pub fn from_rows(rows: &[Vec<f64>], n_values: usize) -> Self {
        let mut samples = Self::zeros(rows.len().div_ceil(LANES), n_values);
        for (i, row) in rows.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                samples.values[i / LANES * n_values + j][i % LANES] = *value;
            }
        }
        samples
    }

    /// The row of sample i.
    pub fn row(&self, i: usize) -> Vec<f64> {
        let block = i / LANES * self.n_values;
        self.values[block..block + self.n_values]
            .iter()
            .map(|lanes| lanes[i % LANES])
            .collect()
    }
}

/// Buffers for a pass over the samples, allocated once.
pub(super) struct Pass {
    n_samples: usize,
    n_blocks: usize,
    /// Weight of each sample's squared errors; 0 for lanes beyond the last sample.
    weights: Samples,
    hidden: Samples,
    outputs: Samples,
    /// d(error)/d(argument of the activation), output and hidden layer.
    output_deltas: Samples,
    hidden_deltas: Samples,
    /// Partial sums of a layer's weight gradient.
    sums: Vec<Lanes>,
}

/// d(error)/d(parameter), with the layout of the network.
pub(super) struct Gradient {
    pub hidden_weights: Vec<f64>,
    pub hidden_thresholds: Vec<f64>,
    pub output_weights: Vec<f64>,
    pub output_thresholds: Vec<f64>,
}

impl Gradient {
    pub fn zeros(network: &Network) -> Self {
        Self {
            hidden_weights: vec![0.0; network.hidden_weights.len()],
            hidden_thresholds: vec![0.0; network.n_hidden],
            output_weights: vec![0.0; network.output_weights.len()],
            output_thresholds: vec![0.0; network.n_outputs],
        }
    }
}

impl Pass {
    /// For samples of equal weight.
    pub fn new(network: &Network, n_samples: usize) -> Self {
        Self::weighted(network, &vec![1.0; n_samples])
    }

    /// For samples of these weights.
    pub fn weighted(network: &Network, weights: &[f64]) -> Self {
        let n_samples = weights.len();
        let n_blocks = n_samples.div_ceil(LANES);
        let weights: Vec<Vec<f64>> = weights.iter().map(|weight| vec![*weight]).collect();
        Self {
            n_samples,
            n_blocks,
            weights: Samples::from_rows(&weights, 1),
            hidden: Samples::zeros(n_blocks, network.n_hidden),
            outputs: Samples::zeros(n_blocks, network.n_outputs),
            output_deltas: Samples::zeros(n_blocks, network.n_outputs),
            hidden_deltas: Samples::zeros(n_blocks, network.n_hidden),
            sums: vec![[0.0; LANES]; network.n_hidden * network.n_inputs.max(network.n_outputs)],
        }
    }

    /// Answers for all samples [Gao 2018, eq. 12].
    pub fn forward(&mut self, network: &Network, inputs: &Samples) -> &Samples {
        forward(network, inputs, self);
        &self.outputs
    }

    /// Mean squared error over samples and outputs, after [`Self::forward`].
    pub fn error(&mut self, network: &Network, targets: &Samples) -> f64 {
        output_deltas(network, targets, self)
    }

    /// Mean squared error and its gradient, by back-propagation, after [`Self::forward`].
    pub fn backward(
        &mut self,
        network: &Network,
        inputs: &Samples,
        targets: &Samples,
        gradient: &mut Gradient,
    ) -> f64 {
        let error = output_deltas(network, targets, self);
        backward(network, inputs, self, gradient);
        error
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn forward(network: &Network, inputs: &Samples, pass: &mut Pass) {
    layer(
        &network.hidden_weights,
        &network.hidden_thresholds,
        inputs,
        &mut pass.hidden,
    );
    activate(&mut pass.hidden.values);
    layer(
        &network.output_weights,
        &network.output_thresholds,
        &pass.hidden,
        &mut pass.outputs,
    );
}

/// Σ_j w_ij x_j − T_i for all samples, weights row-major.
#[inline(always)]
fn layer(weights: &[f64], thresholds: &[f64], inputs: &Samples, outputs: &mut Samples) {
    let (n_in, n_out) = (inputs.n_values, outputs.n_values);
    for (x, y) in inputs
        .values
        .chunks_exact(n_in)
        .zip(outputs.values.chunks_exact_mut(n_out))
    {
        let mut first = 0;
        while first + OUTPUTS_AT_ONCE <= n_out {
            let rows: [&[f64]; OUTPUTS_AT_ONCE] =
                std::array::from_fn(|r| &weights[(first + r) * n_in..(first + r + 1) * n_in]);
            let mut sums: [Lanes; OUTPUTS_AT_ONCE] =
                std::array::from_fn(|r| [-thresholds[first + r]; LANES]);
            for (j, x) in x.iter().enumerate() {
                for (row, sum) in rows.iter().zip(&mut sums) {
                    add_product(row[j], x, sum);
                }
            }
            y[first..first + OUTPUTS_AT_ONCE].copy_from_slice(&sums);
            first += OUTPUTS_AT_ONCE;
        }
        for i in first..n_out {
            let mut sum = [-thresholds[i]; LANES];
            for (weight, x) in weights[i * n_in..(i + 1) * n_in].iter().zip(x) {
                add_product(*weight, x, &mut sum);
            }
            y[i] = sum;
        }
    }
}

#[inline(always)]
fn add_product(factor: f64, x: &Lanes, sum: &mut Lanes) {
    for lane in 0..LANES {
        sum[lane] = factor.mul_add(x[lane], sum[lane]);
    }
}

#[inline(always)]
fn activate(values: &mut [Lanes]) {
    for lanes in values {
        for value in lanes {
            *value = tanh(*value);
        }
    }
}

/// Weighted mean squared error. Its derivative by the arguments of the output activation is stored in `pass`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn output_deltas(network: &Network, targets: &Samples, pass: &mut Pass) -> f64 {
    let n_outputs = network.n_outputs;
    let share = 1.0 / (pass.n_samples * n_outputs) as f64;
    let mut squares = [0.0; LANES];
    for block in 0..pass.n_blocks {
        let weights = &pass.weights.values[block];
        for value in block * n_outputs..(block + 1) * n_outputs {
            let (answer, target) = (&pass.outputs.values[value], &targets.values[value]);
            let delta = &mut pass.output_deltas.values[value];
            for lane in 0..LANES {
                let error = answer[lane] - target[lane];
                let weighted = error * weights[lane];
                squares[lane] = weighted.mul_add(error, squares[lane]);
                delta[lane] = 2.0 * share * weighted;
            }
        }
    }
    share * sum_lanes(&squares)
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn backward(network: &Network, inputs: &Samples, pass: &mut Pass, gradient: &mut Gradient) {
    propagate(
        &network.output_weights,
        &pass.output_deltas,
        &pass.hidden,
        &mut pass.hidden_deltas,
    );
    weight_gradient(
        &pass.output_deltas,
        &pass.hidden,
        &mut pass.sums,
        &mut gradient.output_weights,
    );
    threshold_gradient(&pass.output_deltas, &mut gradient.output_thresholds);
    weight_gradient(
        &pass.hidden_deltas,
        inputs,
        &mut pass.sums,
        &mut gradient.hidden_weights,
    );
    threshold_gradient(&pass.hidden_deltas, &mut gradient.hidden_thresholds);
}

/// Hidden deltas: (1 − h²) Σ_o w_oh δ_o.
#[inline(always)]
fn propagate(weights: &[f64], deltas: &Samples, hidden: &Samples, hidden_deltas: &mut Samples) {
    let (n_out, n_hidden) = (deltas.n_values, hidden.n_values);
    let blocks = deltas
        .values
        .chunks_exact(n_out)
        .zip(hidden.values.chunks_exact(n_hidden));
    for ((delta, h), back) in blocks.zip(hidden_deltas.values.chunks_exact_mut(n_hidden)) {
        let mut first = 0;
        while first + OUTPUTS_AT_ONCE <= n_hidden {
            let mut sums = [[0.0; LANES]; OUTPUTS_AT_ONCE];
            for (o, delta) in delta.iter().enumerate() {
                let row = &weights[o * n_hidden + first..o * n_hidden + first + OUTPUTS_AT_ONCE];
                for (weight, sum) in row.iter().zip(&mut sums) {
                    add_product(*weight, delta, sum);
                }
            }
            back[first..first + OUTPUTS_AT_ONCE].copy_from_slice(&sums);
            first += OUTPUTS_AT_ONCE;
        }
        for i in first..n_hidden {
            let mut sum = [0.0; LANES];
            for (o, delta) in delta.iter().enumerate() {
                add_product(weights[o * n_hidden + i], delta, &mut sum);
            }
            back[i] = sum;
        }
        for (back, h) in back.iter_mut().zip(h) {
            for lane in 0..LANES {
                back[lane] *= (-h[lane]).mul_add(h[lane], 1.0);
            }
        }
    }
}

/// Σ over samples of δ_i x_j, for all i and j: first eight partial sums each, in `sums`, then their totals.
///
/// If the totals are formed directly, LLVM vectorises the last additions instead of the lanes, which takes three times as long.
#[inline(always)]
fn weight_gradient(deltas: &Samples, inputs: &Samples, sums: &mut [Lanes], gradient: &mut [f64]) {
    let n_in = inputs.n_values;
    for (i, row) in sums[..gradient.len()].chunks_exact_mut(n_in).enumerate() {
        let mut tiles = row.chunks_exact_mut(OUTPUTS_AT_ONCE);
        for (tile, j) in (&mut tiles).zip((0..).step_by(OUTPUTS_AT_ONCE)) {
            tile.copy_from_slice(&correlate::<OUTPUTS_AT_ONCE>(deltas, i, inputs, j));
        }
        for (sum, j) in tiles
            .into_remainder()
            .iter_mut()
            .zip(n_in - n_in % OUTPUTS_AT_ONCE..)
        {
            [*sum] = correlate::<1>(deltas, i, inputs, j);
        }
    }
    sum_all_lanes(sums, gradient);
}

/// Σ over samples of δ_i x_j … δ_i x_(j + N − 1), in eight partial sums each.
#[inline(always)]
fn correlate<const N: usize>(deltas: &Samples, i: usize, inputs: &Samples, j: usize) -> [Lanes; N] {
    let mut sums = [[0.0; LANES]; N];
    for (delta, x) in deltas
        .values
        .chunks_exact(deltas.n_values)
        .zip(inputs.values.chunks_exact(inputs.n_values))
    {
        let delta = &delta[i];
        for (x, sum) in x[j..j + N].iter().zip(&mut sums) {
            for lane in 0..LANES {
                sum[lane] = delta[lane].mul_add(x[lane], sum[lane]);
            }
        }
    }
    sums
}

#[inline(never)]
fn sum_all_lanes(lanes: &[Lanes], sums: &mut [f64]) {
    for (lanes, sum) in lanes.iter().zip(sums) {
        *sum = sum_lanes(lanes);
    }
}

/// −Σ over samples of δ_i: a threshold is subtracted.
#[inline(always)]
fn threshold_gradient(deltas: &Samples, gradient: &mut [f64]) {
    for (i, gradient) in gradient.iter_mut().enumerate() {
        let mut sum = [0.0; LANES];
        for block in deltas.values.chunks_exact(deltas.n_values) {
            for lane in 0..LANES {
                sum[lane] += block[i][lane];
            }
        }
        *gradient = -sum_lanes(&sum);
    }
}

#[inline(always)]
fn sum_lanes(lanes: &Lanes) -> f64 {
    let [a, b, c, d, e, f, g, h] = *lanes;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}
