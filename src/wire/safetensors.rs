//! Networks on disk: safetensors with 64-bit floats, readable by NumPy and PyTorch.
//!
//! Tensors: `hidden_weights [h, n]`, `hidden_thresholds [h]`, `output_weights [n, h]`, `output_thresholds [n]`, `scale [n]`,
//! `answer [n]`. The metadata has one key, `kincal`, holding canonical JSON, because the format writes a map of several keys
//! in random order. The hash covers the tensors alone, in the order of their names: name, zero byte, then the data
//! (little-endian 64-bit floats).

use crate::identification::TrainedNetwork;
use crate::wire::canonical;
use crate::wire::job::{Model, Preset};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;

/// The one metadata key.
const METADATA_KEY: &str = "kincal";
/// Most inputs a network may have: more than twelve links have parameters.
const MAX_INPUTS: usize = 500;
/// Most hidden nodes.
const MAX_HIDDEN: usize = 1_000;

/// What the metadata key holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NetworkMetadata {
    /// Names of inputs and outputs, in order.
    pub parameter_names: Vec<String>,
    /// The model it belongs to.
    pub model: Model,
    /// The preset it belongs to.
    pub preset: Preset,
    /// Hidden nodes.
    pub n_hidden: usize,
    /// Mean squared training error, in scaled units.
    pub training_error: f64,
    /// Mean squared error on the particles held out, in scaled units.
    pub validation_error: f64,
}

/// A network as it is stored.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredNetwork {
    /// The safetensors file.
    pub bytes: Vec<u8>,
    /// Its metadata.
    pub metadata: NetworkMetadata,
    /// SHA-256 of the tensors, lower-case hexadecimal.
    pub sha256: String,
}

/// Why bytes are not a network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// Not a safetensors file, or one without our metadata.
    #[error("not a network of kincal: {0}")]
    Format(String),
    /// A tensor is missing, or of another type or size than the others say.
    #[error("tensor {name} should hold {expected} 64-bit floats in shape {shape:?}")]
    Tensor {
        /// Which.
        name: &'static str,
        /// How many values it should have.
        expected: usize,
        /// In which shape.
        shape: Vec<usize>,
    },
}

/// The file of a network.
///
/// # Errors
/// [`Error`] if the network's own sizes do not fit together, or it holds numbers that JSON cannot.
pub fn write(network: &TrainedNetwork) -> Result<StoredNetwork, Error> {
    let metadata = metadata_of(network);
    let tensors = tensors_of(network, metadata.n_hidden);
    let mut hash = Sha256::new();
    let mut named = Vec::new();
    for (name, shape, values) in &tensors {
        check_size(name, shape, values.len())?;
        let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        hash.update(name.as_bytes());
        hash.update([0]);
        hash.update(&data);
        named.push((*name, shape.clone(), data));
    }
    let views =
        named.iter().map(|(name, shape, data)| Ok((*name, TensorView::new(Dtype::F64, shape.clone(), data).map_err(format_error)?)));
    let views = views.collect::<Result<Vec<_>, Error>>()?;
    let json = canonical::to_canonical_json(&metadata).map_err(format_error)?;
    let info = HashMap::from([(METADATA_KEY.to_owned(), json)]);
    let bytes = safetensors::serialize(views, Some(info)).map_err(format_error)?;
    Ok(StoredNetwork { bytes, metadata, sha256: canonical::hex(&hash.finalize()) })
}

/// The network of a file, every size checked.
///
/// # Errors
/// [`Error`] saying what does not fit.
pub fn read(bytes: &[u8]) -> Result<TrainedNetwork, Error> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(format_error)?;
    let json = header.metadata().as_ref().and_then(|map| map.get(METADATA_KEY)).ok_or_else(|| Error::Format("no metadata".into()))?;
    let metadata: NetworkMetadata = serde_json::from_str(json).map_err(format_error)?;
    let (n, h) = (metadata.parameter_names.len(), metadata.n_hidden);
    if n > MAX_INPUTS || h > MAX_HIDDEN {
        return Err(Error::Format(format!("{n} inputs and {h} hidden nodes are more than {MAX_INPUTS} and {MAX_HIDDEN}")));
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(format_error)?;
    Ok(TrainedNetwork {
        hidden_weights: floats(&tensors, "hidden_weights", &[h, n])?,
        hidden_thresholds: floats(&tensors, "hidden_thresholds", &[h])?,
        output_weights: floats(&tensors, "output_weights", &[n, h])?,
        output_thresholds: floats(&tensors, "output_thresholds", &[n])?,
        scale: floats(&tensors, "scale", &[n])?,
        answer: floats(&tensors, "answer", &[n])?,
        parameter_names: metadata.parameter_names,
        training_error: metadata.training_error,
        validation_error: metadata.validation_error,
        model: metadata.model.to_core(),
        preset: metadata.preset.to_core(),
    })
}

fn metadata_of(network: &TrainedNetwork) -> NetworkMetadata {
    NetworkMetadata {
        parameter_names: network.parameter_names.clone(),
        model: Model::from_core(network.model),
        preset: Preset::from_core(network.preset),
        n_hidden: network.hidden_thresholds.len(),
        training_error: network.training_error,
        validation_error: network.validation_error,
    }
}

/// In the order of their names, which is the order of the hash.
fn tensors_of(network: &TrainedNetwork, h: usize) -> [(&'static str, Vec<usize>, &[f64]); 6] {
    let n = network.parameter_names.len();
    [
        ("answer", vec![n], &network.answer),
        ("hidden_thresholds", vec![h], &network.hidden_thresholds),
        ("hidden_weights", vec![h, n], &network.hidden_weights),
        ("output_thresholds", vec![n], &network.output_thresholds),
        ("output_weights", vec![n, h], &network.output_weights),
        ("scale", vec![n], &network.scale),
    ]
}

fn check_size(name: &'static str, shape: &[usize], found: usize) -> Result<(), Error> {
    let expected = shape.iter().product();
    if found == expected { Ok(()) } else { Err(Error::Tensor { name, expected, shape: shape.to_vec() }) }
}

fn floats(tensors: &SafeTensors<'_>, name: &'static str, shape: &[usize]) -> Result<Vec<f64>, Error> {
    let wrong = || Error::Tensor { name, expected: shape.iter().product(), shape: shape.to_vec() };
    let view = tensors.tensor(name).map_err(|_| wrong())?;
    if view.dtype() != Dtype::F64 || view.shape() != shape {
        return Err(wrong());
    }
    let (values, rest) = view.data().as_chunks::<8>();
    if rest.is_empty() { Ok(values.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()) } else { Err(wrong()) }
}

fn format_error(error: impl std::fmt::Display) -> Error {
    Error::Format(error.to_string())
}

#[cfg(test)]
mod tests {
    use super::{Error, read, write};
    use crate::calibration::{Model, Preset};
    use crate::identification::TrainedNetwork;

    fn network() -> TrainedNetwork {
        TrainedNetwork {
            parameter_names: vec!["a_1".into(), "alpha_1".into(), "d_1".into()],
            scale: vec![1.0, 0.01, 1.0],
            hidden_weights: vec![0.1, -0.0, 1e-300, 4.0, 5.0, f64::MIN_POSITIVE],
            hidden_thresholds: vec![0.5, -0.5],
            output_weights: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
            output_thresholds: vec![0.0, 0.1, 0.2],
            answer: vec![0.1, 0.2, 0.3],
            training_error: 1e-9,
            validation_error: 2e-9,
            model: Model::Paper,
            preset: Preset::Default,
        }
    }

    #[test]
    fn a_network_comes_back_bit_for_bit_and_always_as_the_same_file() {
        let stored = write(&network()).unwrap();
        assert_eq!(read(&stored.bytes).unwrap(), network());
        for _ in 0..20 {
            assert_eq!(write(&network()).unwrap(), stored);
        }
    }

    #[test]
    fn the_hash_covers_every_weight() {
        let mut other = network();
        other.hidden_weights[1] = 0.0;
        assert_ne!(write(&other).unwrap().sha256, write(&network()).unwrap().sha256);
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused_on_both_sides() {
        let mut short = network();
        short.scale.pop();
        assert!(matches!(write(&short), Err(Error::Tensor { name: "scale", expected: 3, .. })));
        let mut bytes = write(&network()).unwrap().bytes;
        bytes.truncate(bytes.len() - 1);
        assert!(matches!(read(&bytes), Err(Error::Format(_))));
        assert!(matches!(read(b"PK\x03\x04 something else entirely"), Err(Error::Format(_))));
    }
}
