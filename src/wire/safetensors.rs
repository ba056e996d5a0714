//! Files of trained networks: safetensors with 64-bit floats, which NumPy and PyTorch can read.
//!
//! Tensors of a network of link parameters: `hidden_weights [h, n]`, `hidden_thresholds [h]`, `output_weights [n, h]`, `output_thresholds [n]`,
//! `scale [n]`, `answer [n]`.
//!
//! Tensors of a residual network: `centre_rad [n]`, `half_range_rad [n]`, `hidden_weights [h, n]`, `hidden_thresholds [h]`, `output_weights [3, h]`,
//! `output_thresholds [3]`, `scale_mm [1]`.
//!
//! The metadata has only one key, `kincal`, because several keys would be written in random order. Its value is canonical JSON. The hash covers only
//! the tensors, in the order of their names: name, zero byte, then the data (little-endian 64-bit floats).

use crate::identification::TrainedNetwork;
use crate::kinematics::ResidualNetwork;
use crate::wire::canonical;
use crate::wire::job::{Model, Preset};
use crate::wire::network::NetworkKind;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;

/// The only metadata key.
const METADATA_KEY: &str = "kincal";
/// Maximum number of inputs of a network. A robot with twelve links has fewer parameters.
const MAX_INPUTS: usize = 500;
/// Maximum number of hidden nodes.
const MAX_HIDDEN: usize = 1_000;

/// Content of the metadata key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NetworkMetadata {
    /// Kind of network.
    #[serde(default, skip_serializing_if = "is_link_parameters")]
    pub kind: NetworkKind,
    /// Names of inputs and outputs, in order.
    pub parameter_names: Vec<String>,
    /// The model that was identified.
    pub model: Model,
    /// The preset of the job.
    pub preset: Preset,
    /// Number of hidden nodes.
    pub n_hidden: usize,
    /// Mean squared training error, in scaled units.
    pub training_error: f64,
    /// Mean squared error on the held-out particles, in scaled units.
    pub validation_error: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde hands a reference")]
fn is_link_parameters(kind: &NetworkKind) -> bool {
    *kind == NetworkKind::default()
}

/// The metadata of a residual network that the network itself does not contain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualOrigin {
    /// The model that was identified.
    pub model: Model,
    /// The preset.
    pub preset: Preset,
    /// Mean squared error of the training points with all corrections, mm².
    pub training_error: f64,
    /// Cross-validated mean squared error, mm².
    pub validation_error: f64,
}

/// The stored form of a network.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredNetwork {
    /// The safetensors file.
    pub bytes: Vec<u8>,
    /// Its metadata.
    pub metadata: NetworkMetadata,
    /// SHA-256 of the tensors, lower-case hexadecimal.
    pub sha256: String,
}

/// Why a network cannot be read or written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The file is not a safetensors file, or it has no metadata of kincal.
    #[error("not a network of kincal: {0}")]
    Format(String),
    /// A tensor is missing, or its type or size does not match the metadata.
    #[error("tensor {name} should hold {expected} 64-bit floats in shape {shape:?}")]
    Tensor {
        /// Name of the tensor.
        name: &'static str,
        /// Expected number of values.
        expected: usize,
        /// Expected shape.
        shape: Vec<usize>,
    },
}

/// Writes a network of link parameters.
///
/// # Errors
/// [`Error`] if the sizes in the network do not match, or if the metadata contain numbers that JSON cannot represent.
pub fn write(network: &TrainedNetwork) -> Result<StoredNetwork, Error> {
    let metadata = metadata_of(network);
    let tensors = tensors_of(network, metadata.n_hidden);
    file_of(metadata, &tensors)
}

/// Writes a residual network.
pub fn write_residual(
    network: &ResidualNetwork,
    origin: ResidualOrigin,
) -> Result<StoredNetwork, Error> {
    let (n, h) = (network.centre_rad.len(), network.hidden_thresholds.len());
    let metadata = NetworkMetadata {
        kind: NetworkKind::Residual,
        parameter_names: (1..=n).map(|joint| format!("q_{joint}")).collect(),
        model: origin.model,
        preset: origin.preset,
        n_hidden: h,
        training_error: origin.training_error,
        validation_error: origin.validation_error,
    };
    let scale = [network.scale_mm];
    let tensors: [NamedTensor<'_>; 7] = [
        ("centre_rad", vec![n], &network.centre_rad),
        ("half_range_rad", vec![n], &network.half_range_rad),
        ("hidden_thresholds", vec![h], &network.hidden_thresholds),
        ("hidden_weights", vec![h, n], &network.hidden_weights),
        ("output_thresholds", vec![3], &network.output_thresholds),
        ("output_weights", vec![3, h], &network.output_weights),
        ("scale_mm", vec![1], &scale),
    ];
    file_of(metadata, &tensors)
}

/// A tensor: name, shape, values.
type NamedTensor<'a> = (&'static str, Vec<usize>, &'a [f64]);

/// Writes a file with these tensors. The tensors must be sorted by name.
fn file_of(metadata: NetworkMetadata, tensors: &[NamedTensor<'_>]) -> Result<StoredNetwork, Error> {
    let mut hash = Sha256::new();
    let mut named = Vec::new();
    for (name, shape, values) in tensors {
        check_size(name, shape, values.len())?;
        let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        hash.update(name.as_bytes());
        hash.update([0]);
        hash.update(&data);
        named.push((*name, shape.clone(), data));
    }
    let views = named.iter().map(|(name, shape, data)| {
        Ok((
            *name,
            TensorView::new(Dtype::F64, shape.clone(), data).map_err(format_error)?,
        ))
    });
    let views = views.collect::<Result<Vec<_>, Error>>()?;
    let json = canonical::to_canonical_json(&metadata).map_err(format_error)?;
    let info = HashMap::from([(METADATA_KEY.to_owned(), json)]);
    let bytes = safetensors::serialize(views, Some(info)).map_err(format_error)?;
    Ok(StoredNetwork {
        bytes,
        metadata,
        sha256: canonical::hex(&hash.finalize()),
    })
}

/// Reads a network of link parameters and checks all sizes.
pub fn read(bytes: &[u8]) -> Result<TrainedNetwork, Error> {
    let metadata = read_metadata(bytes, NetworkKind::LinkParameters)?;
    let (n, h) = (metadata.parameter_names.len(), metadata.n_hidden);
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
        model: metadata.model,
        preset: metadata.preset,
    })
}

/// Reads a residual network and checks all sizes.
pub fn read_residual(bytes: &[u8]) -> Result<ResidualNetwork, Error> {
    let metadata = read_metadata(bytes, NetworkKind::Residual)?;
    let (n, h) = (metadata.parameter_names.len(), metadata.n_hidden);
    let tensors = SafeTensors::deserialize(bytes).map_err(format_error)?;
    Ok(ResidualNetwork {
        centre_rad: floats(&tensors, "centre_rad", &[n])?,
        half_range_rad: floats(&tensors, "half_range_rad", &[n])?,
        hidden_weights: floats(&tensors, "hidden_weights", &[h, n])?,
        hidden_thresholds: floats(&tensors, "hidden_thresholds", &[h])?,
        output_weights: floats(&tensors, "output_weights", &[3, h])?,
        output_thresholds: floats(&tensors, "output_thresholds", &[3])?,
        scale_mm: floats(&tensors, "scale_mm", &[1])?[0],
    })
}

fn read_metadata(bytes: &[u8], kind: NetworkKind) -> Result<NetworkMetadata, Error> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(format_error)?;
    let json = header
        .metadata()
        .as_ref()
        .and_then(|map| map.get(METADATA_KEY))
        .ok_or_else(|| Error::Format("no metadata".into()))?;
    let metadata: NetworkMetadata = serde_json::from_str(json).map_err(format_error)?;
    if metadata.kind != kind {
        return Err(Error::Format(format!(
            "it is of kind {:?}, not {kind:?}",
            metadata.kind
        )));
    }
    let (n, h) = (metadata.parameter_names.len(), metadata.n_hidden);
    if n > MAX_INPUTS || h > MAX_HIDDEN {
        return Err(Error::Format(format!(
            "{n} inputs and {h} hidden nodes are more than {MAX_INPUTS} and {MAX_HIDDEN}"
        )));
    }
    Ok(metadata)
}

fn metadata_of(network: &TrainedNetwork) -> NetworkMetadata {
    NetworkMetadata {
        kind: NetworkKind::LinkParameters,
        parameter_names: network.parameter_names.clone(),
        model: network.model,
        preset: network.preset,
        n_hidden: network.hidden_thresholds.len(),
        training_error: network.training_error,
        validation_error: network.validation_error,
    }
}

/// The tensors sorted by name. This is the order in which they are hashed.
fn tensors_of(network: &TrainedNetwork, h: usize) -> [NamedTensor<'_>; 6] {
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
    if found == expected {
        Ok(())
    } else {
        Err(Error::Tensor {
            name,
            expected,
            shape: shape.to_vec(),
        })
    }
}

fn floats(
    tensors: &SafeTensors<'_>,
    name: &'static str,
    shape: &[usize],
) -> Result<Vec<f64>, Error> {
    let wrong = || Error::Tensor {
        name,
        expected: shape.iter().product(),
        shape: shape.to_vec(),
    };
    let view = tensors.tensor(name).map_err(|_| wrong())?;
    if view.dtype() != Dtype::F64 || view.shape() != shape {
        return Err(wrong());
    }
    let (values, rest) = view.data().as_chunks::<8>();
    if rest.is_empty() {
        Ok(values
            .iter()
            .map(|bytes| f64::from_le_bytes(*bytes))
            .collect())
    } else {
        Err(wrong())
    }
}

fn format_error(error: impl std::fmt::Display) -> Error {
    Error::Format(error.to_string())
}

#[cfg(test)]
mod tests {
    use super::{Error, ResidualOrigin, read, read_residual, write, write_residual};
    use crate::calibration::{Model, Preset};
    use crate::identification::TrainedNetwork;
    use crate::kinematics::ResidualNetwork;
    use crate::wire;

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
    fn a_residual_network_comes_back_bit_for_bit_and_is_not_taken_for_the_other_kind() {
        let residual = ResidualNetwork {
            centre_rad: vec![0.1, -0.2],
            half_range_rad: vec![1.0, 1e-300],
            hidden_weights: vec![0.1, -0.0, 5.0, f64::MIN_POSITIVE, 1.0, 2.0],
            hidden_thresholds: vec![0.5, -0.5, 0.0],
            output_weights: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
            output_thresholds: vec![0.0, 0.1, 0.2],
            scale_mm: 0.07,
        };
        let origin = ResidualOrigin {
            model: wire::job::Model::Complete,
            preset: wire::job::Preset::Default,
            training_error: 1e-3,
            validation_error: 2e-3,
        };
        let stored = write_residual(&residual, origin).unwrap();
        assert_eq!(read_residual(&stored.bytes).unwrap(), residual);
        assert!(matches!(read(&stored.bytes), Err(Error::Format(_))));
        assert!(matches!(
            read_residual(&write(&network()).unwrap().bytes),
            Err(Error::Format(_))
        ));
        let short = ResidualNetwork {
            output_weights: vec![1.0],
            ..residual
        };
        assert!(matches!(
            write_residual(&short, origin),
            Err(Error::Tensor {
                name: "output_weights",
                expected: 9,
                ..
            })
        ));
    }

    #[test]
    fn the_hash_covers_every_weight() {
        let mut other = network();
        other.hidden_weights[1] = 0.0;
        assert_ne!(
            write(&other).unwrap().sha256,
            write(&network()).unwrap().sha256
        );
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused_on_both_sides() {
        let mut short = network();
        short.scale.pop();
        assert!(matches!(
            write(&short),
            Err(Error::Tensor {
                name: "scale",
                expected: 3,
                ..
            })
        ));
        let mut bytes = write(&network()).unwrap().bytes;
        bytes.truncate(bytes.len() - 1);
        assert!(matches!(read(&bytes), Err(Error::Format(_))));
        assert!(matches!(
            read(b"PK\x03\x04 something else entirely"),
            Err(Error::Format(_))
        ));
    }
}
