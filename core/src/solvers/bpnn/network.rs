//! A network with one hidden layer.

/// A trained or untrained network.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Number of inputs.
    pub n_inputs: usize,
    /// Number of hidden neurons.
    pub n_hidden: usize,
    /// Number of outputs.
    pub n_outputs: usize,
    /// Weights of the hidden layer, `n_hidden` × `n_inputs`, row-major.
    pub hidden_weights: Vec<f64>,
    /// Thresholds T of the hidden layer.
    pub hidden_thresholds: Vec<f64>,
    /// Weights of the output layer, `n_outputs` × `n_hidden`, row-major.
    pub output_weights: Vec<f64>,
    /// Thresholds T of the output layer.
    pub output_thresholds: Vec<f64>,
}
