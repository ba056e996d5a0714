//! The estimate that is stored with a parameter set, for comparisons with later sessions. No route of the API returns it.

use crate::calibration::request::Model;
use crate::identification::KinematicModel;
use crate::identification::least_squares::evidence::Noise;
use crate::identification::model::parameters::{
    Parameter, complete_parameters, target_rotation_parameters,
};
use crate::identification::statistics::changes::Estimate;
use crate::identification::statistics::misfit::{Following, Misfit};
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::kinematics::Link;
use crate::wire::canonical::canonical_sha256;
use crate::wire::robot::RobotBody;
use nalgebra::{DMatrix, IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

/// An estimate, with the model and the robot geometry that it belongs to. All numbers are written so that they read back bit for bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredEstimate {
    /// The model that was identified.
    pub model: Model,
    /// Hash of the robot's links and joint map, see [`geometry_sha256`].
    pub geometry_sha256: String,
    /// Names of the free parameters. The rows of the matrices below have the same order.
    parameters: Vec<String>,
    /// Rotation from base to measuring frame, row by row.
    rotation: [[f64; 3]; 3],
    /// Position of the base in the measuring frame, mm.
    translation_mm: [f64; 3],
    /// a (mm), alpha (rad), d (mm), theta_offset (rad), beta (rad) of each link.
    links: Vec<[f64; 5]>,
    /// Targets in the flange frame, mm.
    targets_mm: Vec<[f64; 3]>,
    /// Rotations of the targets in the flange frame, row by row; empty unless poses were measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    target_rotations: Vec<[[f64; 3]; 3]>,
    /// Noise (standard deviation) of one coordinate, mm. `noise_freedom` is its degrees of freedom.
    noise_std_mm: f64,
    noise_freedom: f64,
    uncertainty: StoredUncertainty,
}

/// Stored form of [`Uncertainty`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct StoredUncertainty {
    noise_std_mm: f64,
    configuration_std_mm: f64,
    misfit_std_rad: f64,
    root: Rows,
    of_noise: Rows,
    prior_std: Vec<f64>,
    gravity: Vec<[f64; 3]>,
    /// Joint and followed joint, from 0.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    followings: Vec<(usize, usize)>,
    #[serde(default = "first_harmonics")]
    harmonics: Vec<usize>,
    held: Vec<String>,
    n_parameters: usize,
    freedom: f64,
    stds_from_minimum: f64,
}

/// What versions covered that stored no orders of harmonics.
fn first_harmonics() -> Vec<usize> {
    vec![1]
}

/// A matrix, row by row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Rows {
    n_columns: usize,
    rows: Vec<Vec<f64>>,
}

/// Hash of the part of a robot that an estimate depends on: the nominal links without joint limits, and the joint map.
pub fn geometry_sha256(robot: &RobotBody) -> Result<String, serde_json::Error> {
    let mut links = robot.links.clone();
    links
        .iter_mut()
        .for_each(|link| link.joint_limits_deg = None);
    canonical_sha256(&(links, &robot.joint_map))
}

impl StoredEstimate {
    /// The stored form of an estimate.
    pub fn new(
        estimate: &Estimate,
        model: Model,
        robot: &RobotBody,
    ) -> Result<Self, serde_json::Error> {
        let Estimate {
            parameters,
            model: found,
            uncertainty,
            noise,
        } = estimate;
        let names = |parameters: &[Parameter]| parameters.iter().map(Parameter::name).collect();
        let link = |l: &Link| [l.a_mm, l.alpha_rad, l.d_mm, l.theta_offset_rad, l.beta_rad];
        let rows = |r: &Rotation3<f64>| [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)]));
        Ok(Self {
            model,
            geometry_sha256: geometry_sha256(robot)?,
            parameters: names(parameters),
            rotation: rows(&found.t_instrument_base.rotation),
            translation_mm: found.t_instrument_base.translation.vector.into(),
            links: found.links.iter().map(link).collect(),
            targets_mm: found.targets_mm.iter().map(|t| (*t).into()).collect(),
            target_rotations: found.target_rotations.iter().map(rows).collect(),
            noise_std_mm: noise.std_mm,
            noise_freedom: noise.freedom,
            uncertainty: StoredUncertainty {
                noise_std_mm: uncertainty.noise_std_mm,
                configuration_std_mm: uncertainty.configuration_std_mm,
                misfit_std_rad: uncertainty.misfit_std_rad,
                root: Rows::from(&uncertainty.root),
                of_noise: Rows::from(&uncertainty.of_noise),
                prior_std: uncertainty.prior_std.clone(),
                gravity: uncertainty
                    .features
                    .gravity
                    .iter()
                    .map(|g| (*g).into())
                    .collect(),
                followings: uncertainty
                    .features
                    .followings
                    .iter()
                    .map(|f| (f.joint, f.followed))
                    .collect(),
                harmonics: uncertainty.features.harmonics.clone(),
                held: names(&uncertainty.features.held),
                n_parameters: uncertainty.n_parameters,
                freedom: uncertainty.freedom,
                stds_from_minimum: uncertainty.stds_from_minimum,
            },
        })
    }
}

impl From<&DMatrix<f64>> for Rows {
    fn from(matrix: &DMatrix<f64>) -> Self {
        Self {
            n_columns: matrix.ncols(),
            rows: matrix
                .row_iter()
                .map(|row| row.iter().copied().collect())
                .collect(),
        }
    }
}

impl Rows {
    fn matrix(&self) -> Result<DMatrix<f64>, String> {
        if self.rows.iter().any(|row| row.len() != self.n_columns) {
            return Err("rows of a matrix differ in length".into());
        }
        let entries = self.rows.iter().flatten().copied();
        Ok(DMatrix::from_row_iterator(
            self.rows.len(),
            self.n_columns,
            entries,
        ))
    }
}

impl TryFrom<&StoredEstimate> for Estimate {
    type Error = String;

    fn try_from(stored: &StoredEstimate) -> Result<Self, String> {
        let n_targets = stored.targets_mm.len();
        let turned: Vec<usize> = (0..n_targets).collect();
        let all: Vec<Parameter> = complete_parameters(stored.links.len(), n_targets)
            .into_iter()
            .chain(target_rotation_parameters(&turned))
            .collect();
        let parameters = |names: &[String]| -> Result<Vec<Parameter>, String> {
            let of_name = |name: &String| {
                let found = all.iter().find(|parameter| parameter.name() == *name);
                found.copied().ok_or(format!("no parameter {name}"))
            };
            names.iter().map(of_name).collect()
        };
        let link = |[a_mm, alpha_rad, d_mm, theta_offset_rad, beta_rad]: [f64; 5]| Link {
            a_mm,
            alpha_rad,
            d_mm,
            theta_offset_rad,
            beta_rad,
        };
        let rotation = |rows: &[[f64; 3]; 3]| {
            Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| rows[i][j]))
        };
        let found = &stored.uncertainty;
        let root = found.root.matrix()?;
        let of_noise = found.of_noise.matrix()?;
        let n = found.prior_std.len();
        if root.nrows() != n || of_noise.nrows() != n || found.n_parameters > n {
            return Err("the matrices have another number of rows than there are priors".into());
        }
        Ok(Self {
            parameters: parameters(&stored.parameters)?,
            model: KinematicModel {
                t_instrument_base: IsometryMatrix3::from_parts(
                    Translation3::from(Vector3::from(stored.translation_mm)),
                    rotation(&stored.rotation),
                ),
                links: stored.links.iter().copied().map(link).collect(),
                targets_mm: stored
                    .targets_mm
                    .iter()
                    .map(|t| Vector3::from(*t))
                    .collect(),
                target_rotations: stored.target_rotations.iter().map(rotation).collect(),
            },
            uncertainty: Uncertainty {
                noise_std_mm: found.noise_std_mm,
                configuration_std_mm: found.configuration_std_mm,
                misfit_std_rad: found.misfit_std_rad,
                root,
                of_noise,
                prior_std: found.prior_std.clone(),
                features: Misfit {
                    gravity: found.gravity.iter().map(|g| Vector3::from(*g)).collect(),
                    followings: found
                        .followings
                        .iter()
                        .map(|&(joint, followed)| Following { joint, followed })
                        .collect(),
                    harmonics: found.harmonics.clone(),
                    held: parameters(&found.held)?,
                },
                n_parameters: found.n_parameters,
                freedom: found.freedom,
                stds_from_minimum: found.stds_from_minimum,
            },
            noise: Noise {
                std_mm: stored.noise_std_mm,
                freedom: stored.noise_freedom,
            },
        })
    }
}
