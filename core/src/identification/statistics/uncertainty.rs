//! Uncertainty of the identified parameters, and of the tool.
//!
//! The identified robot is the maximum a posteriori estimate with links alone. Its errors are estimated in a wider problem, linearised about it:
//!
//! `residual = J·δ + Φ·u + c + e`
//!
//! - δ: deviations of the parameters from the identified ones, with the priors of the estimate;
//! - u: effects that links cannot describe: the features Φ of [`misfit`](super::misfit), each normal about 0 with standard deviation σm.
//!   Harmonics of orders above 1 have their own σm. A joint that follows another one has no prior, and is included only if it is significant;
//! - c: the error that all points of one configuration share, σc;
//! - e: white noise of the instrument and of the robot's repeatability, σ. If it differs between directions, all rows are whitened first.
//!
//! σ and σm are the most probable ones [MacKay 1992], σm with a half-Cauchy prior [Gelman 2006]; σc comes from an analysis of variance. The
//! posterior of δ and u has a mean and a covariance. The identified robot has δ = 0 and u = 0, so the mean is its error, which counts as
//! one more standard deviation in addition to those of the covariance. With many poses, u becomes known and the stated error tends to the
//! mean; it neither vanishes nor grows without limit.
//!
//! The uncertainty of a robot with corrections is computed from the same problem at the fit of links and corrections: δ then includes the
//! terms of the corrections, and u is the remaining misfit.

use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::{evidence_at, posterior_at};
use crate::identification::model::objective::{Observation, weighted_jacobian};
use crate::identification::model::parameters::Parameter;
use crate::identification::statistics::distributions::t_half_width;
use crate::identification::statistics::misfit::Misfit;
use crate::identification::statistics::uncertainty_problem::Rows;
pub use crate::identification::statistics::uncertainty_problem::Session;
use crate::identification::statistics::uncertainty_solution::Solved;
use nalgebra::{DMatrix, Vector3};

/// Errors of an identification, as standard deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// σ, mm: white noise of one coordinate of a point of weight 1.
    pub noise_std_mm: f64,
    /// σc, mm: error that points of one configuration share; 0 if it is not significant.
    pub configuration_std_mm: f64,
    /// σm, rad per unit feature, the larger of both; 0 if none is significant.
    pub misfit_std_rad: f64,
    /// Root of the mean square error, (p + t + m) × k: rows for the p parameters in mm or rad, the t terms of corrections, and the m
    /// features in rad (without those that are not significant). Each column is one standard deviation of an independent cause. The last
    /// column is the mean of the posterior.
    pub root: DMatrix<f64>,
    /// Effect of the noise alone on the most probable values, (p + m) × k.
    pub of_noise: DMatrix<f64>,
    /// Prior standard deviation of each parameter and feature, mm or rad.
    pub prior_std: Vec<f64>,
    /// The misfit of these features: the joints that were found to follow others, and the other sources unless σm is 0.
    pub features: Misfit,
    /// Number of parameters, p.
    pub n_parameters: usize,
    /// Number of terms of corrections, whose rows follow those of the parameters; 0 for links alone.
    pub n_terms: usize,
    /// Degrees of freedom: number of rows minus the number of coordinates that they determine. If configurations share errors, the means of
    /// configurations count instead of rows.
    pub freedom: f64,
    /// Distance of the identified robot from the minimum of its cost, in its own standard deviations (root mean square over the combinations that the
    /// points determine). The uncertainty holds at that minimum.
    pub stds_from_minimum: f64,
}

/// The uncertainty of a session's identification. `None` if the equations cannot be solved.
pub fn uncertainty(session: Session<'_>) -> Option<Uncertainty> {
    let rows = Rows::new(&session);
    let (columns, x) = (&rows.columns, &rows.x);
    let of_fit = session
        .corrections
        .and_then(|fitted| fitted.evidence.clone());
    let (priors, at_fit) = match of_fit {
        Some(evidence) => {
            let posterior = posterior_at(session.problem, x, &evidence);
            (evidence, posterior)
        }
        None => evidence_at(session.problem, x),
    };
    let mut solved = rows.solve(&priors, 0.0);
    let mut freedom = solved.triangle.freedom(&solved.posterior);
    let shared = rows.shared(&solved.columns, &solved.posterior, solved.evidence.sigma_mm);
    if shared.ratio > 0.0 {
        solved = rows.solve(&priors, shared.ratio);
        freedom = shared.freedom;
    }
    let Solved {
        followings,
        triangle,
        evidence,
        posterior,
        usual_std_rad,
        higher_std_rad,
        ..
    } = solved;
    let usual = usual_std_rad > 0.0;
    let features = Misfit {
        followings: followings
            .iter()
            .map(|k| session.misfit.followings[*k])
            .collect(),
        harmonics: session
            .misfit
            .harmonics
            .iter()
            .copied()
            .filter(|order| match order {
                1 => usual,
                _ => higher_std_rad > 0.0,
            })
            .collect(),
        gravity: if usual {
            session.misfit.gravity.clone()
        } else {
            vec![]
        },
        held: if usual {
            session.misfit.held.clone()
        } else {
            vec![]
        },
    };
    // The placements of stations are not needed by the caller.
    let stations = columns.stations();
    let kept: Vec<usize> = (0..posterior.step.len())
        .filter(|j| !stations.contains(j))
        .collect();
    let variables = &session.problem.variables;
    let unit = |j: usize| variables.get(j).map_or(1.0, |variable| variable.width);
    let in_units = |matrix: &DMatrix<f64>| {
        DMatrix::from_fn(kept.len(), matrix.ncols(), |i, k| {
            matrix[(kept[i], k)] * unit(kept[i])
        })
    };
    let n = posterior.root.ncols();
    let mut root = posterior.root.clone().resize_horizontally(n + 1, 0.0);
    root.column_mut(n).copy_from_slice(&posterior.step);
    let root = in_units(&root);
    root.iter().all(|v| v.is_finite()).then(|| Uncertainty {
        noise_std_mm: evidence.sigma_mm,
        configuration_std_mm: evidence.sigma_mm * shared.ratio.sqrt(),
        misfit_std_rad: usual_std_rad.max(higher_std_rad),
        of_noise: in_units(&triangle.by_noise(&posterior, evidence.sigma_mm)),
        root,
        prior_std: kept
            .iter()
            .map(|j| evidence.widths[*j] * unit(*j))
            .collect(),
        n_parameters: columns.n_parameters,
        n_terms: columns.n_terms,
        freedom: freedom.max(1.0),
        stds_from_minimum: at_fit.stds_from_fit(),
        features,
    })
}

impl Uncertainty {
    /// Covariance of the posterior, (p + m)².
    pub fn covariance(&self) -> DMatrix<f64> {
        let root = self.root.columns(0, self.root.ncols() - 1);
        root * root.transpose()
    }

    /// Difference between the most probable value of a parameter or feature and the identified one, mm or rad.
    pub fn mean(&self, parameter: usize) -> f64 {
        self.root[(parameter, self.root.ncols() - 1)]
    }

    /// Standard deviation of the posterior of a parameter or feature, mm or rad. The mean is not counted.
    pub fn posterior_std(&self, row: usize) -> f64 {
        self.root.row(row).columns(0, self.root.ncols() - 1).norm()
    }

    /// Change of a parameter's most probable value if another parameter changes by 1: an entry of I − C·P⁻¹.
    pub fn shown(&self, parameter: usize, changed: usize) -> f64 {
        let root = self.root.columns(0, self.root.ncols() - 1);
        let covariance = root.row(parameter).dot(&root.row(changed));
        let own = if parameter == changed { 1.0 } else { 0.0 };
        own - covariance / (self.prior_std[changed] * self.prior_std[changed])
    }

    /// Root of the mean square error of the parameters alone, p × p.
    pub fn of_parameters(&self) -> DMatrix<f64> {
        let r = self.root.rows(0, self.n_parameters).transpose().qr().r();
        r.transpose()
    }

    /// Standard deviation of a parameter, mm or rad.
    pub fn std(&self, parameter: usize) -> f64 {
        self.root.row(parameter).norm()
    }

    /// Half-width of the interval that contains the parameter with probability `confidence`, mm or rad.
    pub fn half_width(&self, parameter: usize, confidence: f64) -> f64 {
        t_half_width(confidence, self.freedom) * self.std(parameter)
    }

    /// Standard deviation (3-D: the root of the sum of three variances) of the target position predicted by `model`, mm.
    pub fn position_std_mm(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        q_rad: &[f64],
        target: usize,
    ) -> f64 {
        self.position_errors_mm(model, parameters, q_rad, target)
            .norm()
    }

    /// Displacement of a target by each cause, mm: 3 × k, in the measuring frame.
    pub fn position_errors_mm(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        q_rad: &[f64],
        target: usize,
    ) -> DMatrix<f64> {
        let here = [Observation::at(q_rad.to_vec(), Vector3::zeros(), target)];
        let jacobian = weighted_jacobian(model, parameters, &here, &Vector3::zeros());
        let pose = [(q_rad, target, 1.0)].into_iter();
        let features = self.features.features(model, pose);
        self.displacements_mm([&jacobian, &DMatrix::zeros(3, 0), &features])
    }

    /// Displacement by each cause, mm: 3 × k, from the derivatives by the parameters, by the terms, and by the features.
    pub fn displacements_mm(&self, derivatives: [&DMatrix<f64>; 3]) -> DMatrix<f64> {
        let mut errors = DMatrix::zeros(3, self.root.ncols());
        let mut first = 0;
        for by in derivatives {
            errors += by * self.root.rows(first, by.ncols());
            first += by.ncols();
        }
        errors
    }
}
