//! The estimate that is stored with a parameter set, for comparisons with later sessions. No route of the API returns it.

use crate::calibration::request::Model;
use crate::identification::KinematicModel;
use crate::identification::least_squares::evidence::Noise;
use crate::identification::model::correction_terms::Term;
use crate::identification::model::parameters::{
    Parameter, complete_parameters, target_rotation_parameters,
};
use crate::identification::statistics::estimate::CorrectedErrors;
use crate::identification::statistics::estimate::Estimate;
use crate::identification::statistics::misfit::{Following, Misfit};
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::kinematics::corrections::HARMONIC_ORDERS;
use crate::kinematics::{Link, Mounting};
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
    /// Errors of the robot with corrections; absent without corrections, and in estimates of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    corrected: Option<StoredCorrectedErrors>,
}

/// Stored form of [`CorrectedErrors`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct StoredCorrectedErrors {
    terms: Vec<Term>,
    gravity_in_base: [f64; 3],
    gravity_std_rad: f64,
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
    #[serde(default, skip_serializing_if = "is_zero")]
    n_terms: usize,
    freedom: f64,
    stds_from_minimum: f64,
}

fn is_zero(n: &usize) -> bool {
    *n == 0
}

/// Default for estimates of older versions, which stored no orders of harmonics: they had only the first harmonic.
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
            corrected,
            noise,
        } = estimate;
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
            uncertainty: StoredUncertainty::from(uncertainty),
            corrected: corrected.as_ref().map(StoredCorrectedErrors::from),
        })
    }
}

fn names(parameters: &[Parameter]) -> Vec<String> {
    parameters.iter().map(Parameter::name).collect()
}

impl From<&Uncertainty> for StoredUncertainty {
    fn from(uncertainty: &Uncertainty) -> Self {
        let features = &uncertainty.features;
        let followings = features.followings.iter().map(|f| (f.joint, f.followed));
        Self {
            noise_std_mm: uncertainty.noise_std_mm,
            configuration_std_mm: uncertainty.configuration_std_mm,
            misfit_std_rad: uncertainty.misfit_std_rad,
            root: Rows::from(&uncertainty.root),
            of_noise: Rows::from(&uncertainty.of_noise),
            prior_std: uncertainty.prior_std.clone(),
            gravity: features.gravity.iter().map(|g| (*g).into()).collect(),
            followings: followings.collect(),
            harmonics: features.harmonics.clone(),
            held: names(&features.held),
            n_parameters: uncertainty.n_parameters,
            n_terms: uncertainty.n_terms,
            freedom: uncertainty.freedom,
            stds_from_minimum: uncertainty.stds_from_minimum,
        }
    }
}

impl StoredUncertainty {
    /// `all` are the parameters in which names are looked up.
    fn uncertainty(
        &self,
        all: &[Parameter],
        model: &KinematicModel,
    ) -> Result<Uncertainty, String> {
        let (root, of_noise) = (self.root.matrix()?, self.of_noise.matrix()?);
        let n = self.prior_std.len();
        let n_identified = self.n_parameters.saturating_add(self.n_terms);
        if root.nrows() != n || of_noise.nrows() != n || n_identified > n {
            return Err("the matrices have another number of rows than there are priors".into());
        }
        let n_joints = model.links.len();
        let followings = self.followings.iter();
        let followings = followings.map(|&(joint, followed)| Following { joint, followed });
        let mut features = Misfit {
            gravity: self.gravity.iter().map(|g| Vector3::from(*g)).collect(),
            followings: followings.collect(),
            harmonics: self.harmonics.clone(),
            held: named(&self.held, all)?,
        };
        let has_links = |f: &Following| f.joint < n_joints && f.followed < n_joints;
        if !features.followings.iter().all(has_links) {
            return Err("a joint follows another one that the robot does not have".into());
        }
        if n == n_identified {
            // Older versions stored the features of a misfit even if it was not significant.
            features = Misfit {
                gravity: vec![],
                followings: vec![],
                harmonics: vec![],
                held: vec![],
            };
        }
        if features.features(model, [].into_iter()).ncols() != n - n_identified {
            return Err("the matrices have another number of rows than the misfit".into());
        }
        Ok(Uncertainty {
            noise_std_mm: self.noise_std_mm,
            configuration_std_mm: self.configuration_std_mm,
            misfit_std_rad: self.misfit_std_rad,
            root,
            of_noise,
            prior_std: self.prior_std.clone(),
            features,
            n_parameters: self.n_parameters,
            n_terms: self.n_terms,
            freedom: self.freedom,
            stds_from_minimum: self.stds_from_minimum,
        })
    }
}

fn named(names: &[String], all: &[Parameter]) -> Result<Vec<Parameter>, String> {
    let of_name = |name: &String| {
        let found = all.iter().find(|parameter| parameter.name() == *name);
        found.copied().ok_or(format!("no parameter {name}"))
    };
    names.iter().map(of_name).collect()
}

impl From<&CorrectedErrors> for StoredCorrectedErrors {
    fn from(errors: &CorrectedErrors) -> Self {
        Self {
            terms: errors.terms.clone(),
            gravity_in_base: errors.mounting.gravity_in_base.into(),
            gravity_std_rad: errors.mounting.std_rad,
            uncertainty: StoredUncertainty::from(&errors.uncertainty),
        }
    }
}

impl StoredCorrectedErrors {
    fn errors(&self, all: &[Parameter], model: &KinematicModel) -> Result<CorrectedErrors, String> {
        let uncertainty = self.uncertainty.uncertainty(all, model)?;
        let is_known = |term: &Term| is_of_robot(term, model.links.len());
        if uncertainty.n_terms != self.terms.len() || !self.terms.iter().all(is_known) {
            return Err("the corrections have other terms than their errors".into());
        }
        Ok(CorrectedErrors {
            terms: self.terms.clone(),
            mounting: Mounting {
                gravity_in_base: self.gravity_in_base.into(),
                std_rad: self.gravity_std_rad,
            },
            uncertainty,
        })
    }
}

/// True if a robot of `n_links` links has the joints and links of a term.
fn is_of_robot(term: &Term, n_links: usize) -> bool {
    match *term {
        Term::Joint(link, axis) | Term::FirstMoment(link, axis) => link < n_links && axis < 3,
        Term::Base(axis) => axis < 3,
        Term::Mass(link) => link < n_links,
        Term::Coupling(joint, other) => joint < n_links && other < n_links,
        Term::Gravity(axis) => axis < 2,
        Term::Harmonic(joint, order, phase) => {
            joint < n_links && order < HARMONIC_ORDERS && phase < 2
        }
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
        let corrected = stored.corrected.as_ref();
        let model = KinematicModel {
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
        };
        let parameters = named(&stored.parameters, &all)?;
        let uncertainty = stored.uncertainty.uncertainty(&all, &model)?;
        if parameters.len() != uncertainty.n_parameters {
            return Err("the matrices belong to another number of parameters".into());
        }
        Ok(Self {
            parameters,
            uncertainty,
            corrected: corrected
                .map(|errors| errors.errors(&all, &model))
                .transpose()?,
            model,
            noise: Noise {
                std_mm: stored.noise_std_mm,
                freedom: stored.noise_freedom,
            },
        })
    }
}
