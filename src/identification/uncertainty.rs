//! How far identified parameters, and the tool, may be from the truth.
//!
//! The errors of the weighted residuals have three parts, V = σe²·(I + ρ·B) + σm²·Φ·Φᵀ:
//!
//! - white noise of the instrument and the robot's repeatability, σe;
//! - what all points of one arm configuration share (B: ones within a configuration, axis by axis), where there are several;
//! - the misfit of the model, a random function of the joint values with the features Φ of [`misfit`], σm in rad.
//!
//! ρ is found by moments, σm by restricted maximum likelihood (Patterson & Thompson 1971); each is kept only where white noise alone
//! would show as much in at most one of twenty cases. The parameters are those of least squares, E·y with E = D·(AᵀA)⁻¹·Aᵀ, so their
//! covariance is E·V·Eᵀ; intervals use Student's t with the degrees of freedom of Satterthwaite (1946). A covariance summed from the
//! configurations' own scores is not used: with about as many configurations as parameters it has not full rank.

use crate::identification::KinematicModel;
use crate::identification::distributions::t_half_width;
use crate::identification::identifiability::Decomposition;
use crate::identification::misfit::Misfit;
use crate::identification::objective::{Observation, weighted_jacobian, weighted_residuals};
use crate::identification::parameters::Parameter;
use crate::identification::priors::Priors;
use crate::identification::problem::reach_mm;
use crate::identification::shared::Shared;
use crate::identification::variance::{
    Linear, UndeterminedMisfit, freedom, misfit_components, shared_ratio, whitened,
};
use nalgebra::{DMatrix, DVector, Vector3};

/// Errors of an identification, one standard deviation, as roots: covariance = root · rootᵀ.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// σe, mm: white noise of one coordinate of a point of weight 1.
    pub noise_std_mm: f64,
    /// σe·sqrt(ρ), mm: what points of one configuration share.
    pub configuration_std_mm: f64,
    /// σm, rad: misfit of a joint per unit feature.
    pub misfit_std_rad: f64,
    /// p × k, mm or rad: what comes from noise, and from the errors of priors; independent from one session to the next.
    pub noise: DMatrix<f64>,
    /// p × m, mm or rad: what comes from the misfit, by feature; sessions of one robot share the features' values. No columns without.
    pub misfit: DMatrix<f64>,
    /// What the features were made of.
    pub features: Misfit,
    /// Residuals less fitted combinations; where points of a configuration share errors, of the configurations' means alone, for those
    /// errors are known from them.
    pub freedom: f64,
    /// How far the answer is from the minimum of the cost, in its own standard deviations (root mean square over the fitted combinations):
    /// what is said here is said of that minimum.
    pub stds_from_minimum: f64,
    /// Where the misfit is not determined, and with it what it makes of parameters and tool.
    pub undetermined_misfit: Option<UndeterminedMisfit>,
    /// Covariance of the estimated (σe², σm²), for the degrees of freedom of a combination of the two.
    variance_of_variances: [[f64; 2]; 2],
}

/// How least squares comes from errors to parameters.
struct Estimator {
    /// D·R⁻¹, p × r.
    per_score: DMatrix<f64>,
    /// Q's rows of the points, 3·N × r: parameters = D·R⁻¹·Qᵀ·y.
    q: DMatrix<f64>,
    /// Qᵀ·y of points and priors: the step to the minimum, in units of the standard deviation of a residual.
    step: DVector<f64>,
    /// Root of QᵀQ, r × r.
    root: DMatrix<f64>,
    /// Root of what the errors of the priors leave, p × k.
    of_priors: DMatrix<f64>,
}

impl Estimator {
    /// `linear` has the residuals of `model` and their derivatives along the seen combinations, `jacobian` has those by the parameters.
    fn new(
        (model, linear): (&KinematicModel, &Linear),
        jacobian: &DMatrix<f64>,
        decomposition: &Decomposition,
        priors: &Priors,
    ) -> Option<Self> {
        // a parameter that is held at a bound has scale 0
        let stds: Vec<(usize, f64)> = priors
            .stds()
            .into_iter()
            .filter(|(j, _)| decomposition.scale[*j] > 0.0)
            .collect();
        let free: Vec<usize> = (0..decomposition.scale.len())
            .filter(|j| decomposition.scale[*j] > 0.0)
            .collect();
        let all = DMatrix::from_diagonal(&DVector::from_column_slice(&decomposition.scale));
        let directions = all.select_columns(&free);
        let n = jacobian.nrows();
        let mut rows = (jacobian * &directions).resize_vertically(n + stds.len(), 0.0);
        for (k, (j, std)) in stds.iter().enumerate() {
            rows.row_mut(n + k)
                .copy_from(&(directions.row(*j) * (priors.scale_mm / std)));
        }
        let mut right = linear.y.clone().resize_vertically(n + stds.len(), 0.0);
        let of_priors = priors.from(model).rows;
        let held = of_priors
            .iter()
            .filter(|row| decomposition.scale[row.parameter] > 0.0);
        for (k, row) in held.enumerate() {
            right[n + k] = row.weight * row.mean;
        }
        let (q, r) = rows.qr().unpack();
        let step = q.tr_mul(&right);
        let per_score = directions * r.try_inverse()?;
        let of_priors = &per_score * q.rows(n, stds.len()).transpose() * priors.scale_mm;
        let q = q.rows(0, n).into_owned();
        let root = q.clone().qr().r().transpose();
        Some(Self {
            per_score,
            q,
            step,
            root,
            of_priors,
        })
    }

    /// Root of the covariance that white noise of unit variance leaves.
    fn noise(&self) -> DMatrix<f64> {
        &self.per_score * &self.root
    }
}

/// The uncertainty of the least-squares answer `model`. `clusters` numbers each observation's configuration; `None` where there are no
/// more residuals than combinations. Priors are measurements of parameters: what they say is as uncertain as they state.
pub fn uncertainty(
    model: &KinematicModel,
    parameters: &[Parameter],
    (decomposition, priors): (&Decomposition, &Priors),
    observations: &[Observation],
    clusters: &[usize],
    misfit: Misfit,
) -> Option<Uncertainty> {
    let directions = decomposition.seen_directions();
    let n_free = 3 * observations.len() as i64 - directions.ncols() as i64;
    if n_free <= 0 || directions.ncols() == 0 {
        return None;
    }
    let poses = observations
        .iter()
        .map(|o| (o.q_rad.as_slice(), o.target, o.weight));
    let jacobian = weighted_jacobian(model, parameters, observations, &Vector3::zeros());
    let linear = Linear {
        y: weighted_residuals(model, observations),
        a: &jacobian * &directions,
        features: misfit.features(model, poses),
        shared: Shared::new(observations, clusters),
    };
    let ratio = shared_ratio(&linear)?;
    let estimator = Estimator::new((model, &linear), &jacobian, decomposition, priors)?;
    let rounding_mm = ROUNDING_PER_REACH * reach_mm(&model.links, observations.iter());
    let stds_from_minimum = stds_from_minimum(&linear, &estimator.step, n_free as f64, rounding_mm);
    let freedom = freedom(&linear, ratio);
    let Estimator { per_score, q, .. } = &estimator;
    let through_shared = per_score * linear.shared.transpose_times(q).transpose();
    let through_features = per_score * (q.transpose() * &linear.features);
    let components = misfit_components(&whitened(linear, ratio), n_free as f64)?;
    let noise_std_mm = components.noise_variance.sqrt();
    let configuration_std_mm = noise_std_mm * ratio.sqrt();
    let misfit_std_rad = components.misfit_variance.sqrt();
    let mut variance_of_variances = components.variance_of_variances;
    variance_of_variances[0][0] *= n_free as f64 / freedom;
    let kept = |root: DMatrix<f64>, std: f64| {
        if std > 0.0 {
            root * std
        } else {
            DMatrix::zeros(per_score.nrows(), 0)
        }
    };
    let shared = kept(through_shared, configuration_std_mm);
    let of_misfit = kept(through_features, misfit_std_rad);
    let noise = beside(
        &beside(&(estimator.noise() * noise_std_mm), &shared),
        &estimator.of_priors,
    );
    let finite = noise.iter().chain(of_misfit.iter()).all(|v| v.is_finite());
    finite.then(|| Uncertainty {
        noise_std_mm,
        configuration_std_mm,
        misfit_std_rad,
        noise,
        misfit: of_misfit,
        features: misfit,
        freedom,
        stds_from_minimum,
        undetermined_misfit: components
            .undetermined
            .filter(|misfit| misfit.found_mm > rounding_mm),
        variance_of_variances,
    })
}

/// Length of a Gauss-Newton step in units of its own standard deviation, per combination. The variance of a coordinate is that of the residuals
/// at the minimum.
fn stds_from_minimum(linear: &Linear, step: &DVector<f64>, n_free: f64, rounding_mm: f64) -> f64 {
    let q = linear.a.clone().qr().q();
    let left = linear.y.norm_squared() - q.tr_mul(&linear.y).norm_squared();
    let variance = (left / n_free).max(rounding_mm * rounding_mm);
    (step.norm_squared() / variance / step.len() as f64).sqrt()
}

/// Residuals below this share of the reach are rounding, and a step of their size is none: a nanometre on an arm of 1.7 m.
const ROUNDING_PER_REACH: f64 = 1e-6 / 1700.0;

fn beside(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = DMatrix::zeros(left.nrows(), left.ncols() + right.ncols());
    both.columns_mut(0, left.ncols()).copy_from(left);
    both.columns_mut(left.ncols(), right.ncols())
        .copy_from(right);
    both
}

impl Uncertainty {
    /// One standard deviation of a parameter, mm or rad, as far as the data see it.
    pub fn std(&self, parameter: usize) -> f64 {
        (self.noise.row(parameter).norm_squared() + self.misfit.row(parameter).norm_squared())
            .sqrt()
    }

    /// Half-width of the interval that holds the parameter with probability `confidence`, mm or rad.
    pub fn half_width(&self, parameter: usize, confidence: f64) -> f64 {
        let (noise, misfit) = (
            self.noise.row(parameter).norm_squared(),
            self.misfit.row(parameter).norm_squared(),
        );
        t_half_width(confidence, self.freedom_of(noise, misfit)) * (noise + misfit).sqrt()
    }

    /// Degrees of freedom of a variance that is `noise` by noise and `misfit` by misfit (Satterthwaite 1946): 2·v²/var(v).
    pub fn freedom_of(&self, noise: f64, misfit: f64) -> f64 {
        let share = |part: f64, std: f64| if std > 0.0 { part / (std * std) } else { 0.0 };
        let (a, b) = (
            share(noise, self.noise_std_mm),
            share(misfit, self.misfit_std_rad),
        );
        let [[ee, em], [_, mm]] = self.variance_of_variances;
        let variance = a * a * ee + 2.0 * a * b * em + b * b * mm;
        let freedom = 2.0 * (noise + misfit) * (noise + misfit) / variance;
        if freedom.is_finite() {
            freedom.clamp(1.0, self.freedom)
        } else {
            self.freedom
        }
    }

    /// One standard deviation (3-D: the root of the three variances' sum) of where `model` predicts a target, mm: J·C·Jᵀ with C of
    /// noise and priors, and of the misfit both at the measured poses and at this one.
    pub fn position_std_mm(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        q_rad: &[f64],
        target: usize,
    ) -> f64 {
        let variances = self.position_variances_mm2(model, parameters, q_rad, target);
        variances
            .iter()
            .map(|[known, misfit]| known + misfit)
            .sum::<f64>()
            .sqrt()
    }

    /// Half-width, along each axis of the measuring frame, of the interval that holds where a target is with probability `confidence`, mm.
    pub fn position_half_widths_mm(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        (q_rad, target): (&[f64], usize),
        confidence: f64,
    ) -> [f64; 3] {
        let half_width = |[known, misfit]: [f64; 2]| {
            t_half_width(confidence, self.freedom_of(known, misfit)) * (known + misfit).sqrt()
        };
        self.position_variances_mm2(model, parameters, q_rad, target)
            .map(half_width)
    }

    /// Variances along each axis of the measuring frame: from noise and priors, and from the misfit.
    fn position_variances_mm2(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        q_rad: &[f64],
        target: usize,
    ) -> [[f64; 2]; 3] {
        let here = [Observation {
            q_rad: q_rad.to_vec(),
            position_mm: Vector3::zeros(),
            target,
            weight: 1.0,
        }];
        let jacobian = weighted_jacobian(model, parameters, &here, &Vector3::zeros());
        let noise = &jacobian * &self.noise;
        let mut misfit = &jacobian * &self.misfit;
        if misfit.ncols() > 0 {
            misfit -= self
                .features
                .features(model, [(q_rad, target, 1.0)].into_iter())
                * self.misfit_std_rad;
        }
        let along = |axis: usize| {
            [
                noise.row(axis).norm_squared(),
                misfit.row(axis).norm_squared(),
            ]
        };
        [along(0), along(1), along(2)]
    }
}
