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
use crate::identification::misfit;
use crate::identification::objective::{Observation, weighted_jacobian, weighted_residuals};
use crate::identification::parameters::Parameter;
use crate::identification::priors::Priors;
use crate::identification::shared::Shared;
use crate::solvers::products::{less_product, transposed_times};
use nalgebra::{DMatrix, DVector, Vector3};

/// A part of V is kept if its test is above this: the upper 5 % of a standard normal variable; its square is the upper 5 % of a
/// likelihood ratio at the boundary (Self & Liang 1987).
const KEPT_ABOVE: f64 = 1.645;
/// Ratios σm²/σe² that are tried, as powers of ten per unit feature of 1 mm: from invisible to all there is.
const LOG10_RATIO: (f64, f64) = (-8.0, 12.0);
/// Points of the grid over them, and golden sections around its best.
const GRID: usize = 81;
/// Golden sections: the bracket shrinks by 0.618 each.
const SECTIONS: usize = 40;
/// Features below this share of the largest tell nothing.
const NEGLIGIBLE: f64 = 1e-12;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 10_000;

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
    /// p × (p − rank): S·V of the combinations that the data do not see, which are off by their prior.
    pub unseen: DMatrix<f64>,
    /// Directions of gravity that the features were made with.
    pub gravity: Vec<Vector3<f64>>,
    /// Residuals less fitted combinations; where points of a configuration share errors, of the configurations' means alone, for those
    /// errors are known from them.
    pub freedom: f64,
    /// Covariance of the estimated (σe², σm²), for the degrees of freedom of a combination of the two.
    variance_of_variances: [[f64; 2]; 2],
}

/// The linear problem behind a fit: residuals and derivatives along the seen combinations, weighted.
struct Linear {
    y: DVector<f64>,
    /// 3·N × r.
    a: DMatrix<f64>,
    /// 3·N × m.
    features: DMatrix<f64>,
    shared: Shared,
}

/// How least squares comes from errors to parameters.
struct Estimator {
    /// D·R⁻¹, p × r.
    per_score: DMatrix<f64>,
    /// Q's rows of the points, 3·N × r: parameters = D·R⁻¹·Qᵀ·y.
    q: DMatrix<f64>,
    /// Root of QᵀQ, r × r; `None` where it is one.
    root: Option<DMatrix<f64>>,
    /// Root of what the errors of the priors leave, p × k.
    of_priors: DMatrix<f64>,
    /// What neither points nor priors say anything of.
    unknown: DMatrix<f64>,
}

impl Estimator {
    /// `a` are the derivatives along the seen combinations, `jacobian` those by the parameters.
    fn new(a: &DMatrix<f64>, jacobian: &DMatrix<f64>, decomposition: &Decomposition, priors: Option<&Priors>) -> Option<Self> {
        let Some(priors) = priors else {
            let (q, r) = a.clone().qr().unpack();
            let per_score = decomposition.seen_directions() * r.try_inverse()?;
            let of_priors = DMatrix::zeros(per_score.nrows(), 0);
            return Some(Self { per_score, q, root: None, of_priors, unknown: decomposition.unseen_directions() });
        };
        // a parameter that is held at a bound has scale 0
        let stds: Vec<(usize, f64)> = priors.stds().into_iter().filter(|(j, _)| decomposition.scale[*j] > 0.0).collect();
        let (directions, unknown) = decomposition.directions_with_priors(&stds);
        let n = jacobian.nrows();
        let mut rows = (jacobian * &directions).resize_vertically(n + stds.len(), 0.0);
        for (k, (j, std)) in stds.iter().enumerate() {
            rows.row_mut(n + k).copy_from(&(directions.row(*j) * (priors.scale_mm / std)));
        }
        let (q, r) = rows.qr().unpack();
        let per_score = directions * r.try_inverse()?;
        let of_priors = &per_score * q.rows(n, stds.len()).transpose() * priors.scale_mm;
        let q = q.rows(0, n).into_owned();
        let root = q.clone().qr().r().transpose();
        Some(Self { per_score, q, root: Some(root), of_priors, unknown })
    }

    /// Root of the covariance that white noise of unit variance leaves.
    fn noise(&self) -> DMatrix<f64> {
        self.root.as_ref().map_or_else(|| self.per_score.clone(), |root| &self.per_score * root)
    }
}

/// The uncertainty of the least-squares answer `model`. `clusters` numbers each observation's configuration; `None` where there are no
/// more residuals than combinations. Priors are measurements of parameters: what they say is as uncertain as they state.
pub fn uncertainty(
    model: &KinematicModel,
    parameters: &[Parameter],
    (decomposition, priors): (&Decomposition, Option<&Priors>),
    observations: &[Observation],
    clusters: &[usize],
    gravity: &[Vector3<f64>],
) -> Option<Uncertainty> {
    let directions = decomposition.seen_directions();
    let n_free = 3 * observations.len() as i64 - directions.ncols() as i64;
    if n_free <= 0 || directions.ncols() == 0 {
        return None;
    }
    let poses = observations.iter().map(|o| (o.q_rad.as_slice(), o.target, o.weight));
    let jacobian = weighted_jacobian(model, parameters, observations, &Vector3::zeros());
    let linear = Linear {
        y: weighted_residuals(model, observations),
        a: &jacobian * &directions,
        features: misfit::features(model, poses, gravity),
        shared: Shared::new(observations, clusters),
    };
    let ratio = shared_ratio(&linear)?;
    let estimator = Estimator::new(&linear.a, &jacobian, decomposition, priors)?;
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
    let kept = |root: DMatrix<f64>, std: f64| if std > 0.0 { root * std } else { DMatrix::zeros(per_score.nrows(), 0) };
    let shared = kept(through_shared, configuration_std_mm);
    let misfit = kept(through_features, misfit_std_rad);
    let noise = beside(&beside(&(estimator.noise() * noise_std_mm), &shared), &estimator.of_priors);
    let finite = noise.iter().chain(misfit.iter()).all(|v| v.is_finite());
    finite.then(|| Uncertainty {
        noise_std_mm,
        configuration_std_mm,
        misfit_std_rad,
        noise,
        misfit,
        unseen: estimator.unknown,
        gravity: gravity.to_vec(),
        freedom,
        variance_of_variances,
    })
}

fn beside(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = DMatrix::zeros(left.nrows(), left.ncols() + right.ncols());
    both.columns_mut(0, left.ncols()).copy_from(left);
    both.columns_mut(left.ncols(), right.ncols()).copy_from(right);
    both
}

/// What the columns of `m` leave outside the span of the orthonormal columns of `q`.
fn outside(q: &DMatrix<f64>, m: &DMatrix<f64>) -> DMatrix<f64> {
    less_product(m, q, &transposed_times(q, m))
}

/// ρ by moments: with P the projection out of the span of A, E[yᵀPBPy] = σe²·(tr PB + ρ·tr PBPB) and
/// E[yᵀPy] = σe²·(tr P + ρ·tr PB). ZᵀPZ = L − WᵀW, with L the squared lengths of Z's columns and W = QᵀZ, is never written out.
fn shared_ratio(linear: &Linear) -> Option<f64> {
    if linear.shared.ncols() == 0 {
        return Some(0.0);
    }
    let q = linear.a.clone().qr().q();
    let w = linear.shared.transpose_times(&q).transpose();
    let lengths = linear.shared.squared_lengths();
    let y = outside(&q, &DMatrix::from_column_slice(linear.y.len(), 1, linear.y.as_slice()));
    let n_free = (linear.a.nrows() - linear.a.ncols()) as f64;
    let trace = lengths.iter().sum::<f64>() - w.norm_squared();
    let crossed: f64 = lengths.iter().zip(w.column_iter()).map(|(l, w)| l * (l - 2.0 * w.norm_squared())).sum();
    let trace_of_square = crossed + (&w * w.transpose()).norm_squared();
    let whole = y.norm_squared();
    if whole <= 0.0 {
        return Some(0.0);
    }
    let ratio = linear.shared.transpose_times(&y).norm_squared() / whole * n_free;
    let spread = (2.0 * (trace_of_square - trace * trace / n_free)).max(0.0).sqrt();
    if ratio - trace <= KEPT_ABOVE * spread {
        return Some(0.0);
    }
    let below = trace_of_square - ratio * trace / n_free;
    (below > 0.0).then(|| (ratio - trace) / below).or(Some(MOST_SHARED))
}

/// Degrees of freedom of the noise. Where configurations share errors these are known from the configurations' means (the mean square
/// between groups of an analysis of variance): tr P·Z·(ZᵀZ)⁻¹·Zᵀ.
fn freedom(linear: &Linear, ratio: f64) -> f64 {
    let n_free = (linear.a.nrows() - linear.a.ncols()) as f64;
    if ratio == 0.0 {
        return n_free;
    }
    let w = linear.shared.transpose_times(&linear.a.clone().qr().q());
    let lengths = linear.shared.squared_lengths();
    let between: f64 = lengths.iter().zip(w.row_iter()).map(|(l, w)| 1.0 - w.norm_squared() / l).sum();
    between.clamp(1.0, n_free)
}

/// ρ where nothing but what a configuration shares can be seen.
const MOST_SHARED: f64 = 1e6;

/// The problem with (I + ρ·B)^(-1/2) from the left. Z's columns are orthogonal: along each, of squared length l, the factor is
/// 1/sqrt(1 + ρ·l).
fn whitened(linear: Linear, ratio: f64) -> Linear {
    if ratio == 0.0 {
        return linear;
    }
    let lengths = linear.shared.squared_lengths();
    let shrink = |m: &DMatrix<f64>| {
        let mut along = linear.shared.transpose_times(m);
        for (mut row, l) in along.row_iter_mut().zip(&lengths) {
            row *= (1.0 - 1.0 / (1.0 + ratio * l).sqrt()) / l;
        }
        m - linear.shared.times(&along)
    };
    let (a, features) = (shrink(&linear.a), shrink(&linear.features));
    let y = shrink(&DMatrix::from_column_slice(linear.y.len(), 1, linear.y.as_slice())).column(0).into();
    Linear { y, a, features, shared: linear.shared }
}

/// σe², σm² and how well they are known.
struct Components {
    noise_variance: f64,
    misfit_variance: f64,
    variance_of_variances: [[f64; 2]; 2],
}

/// The residuals along the eigenvectors of P·Φ·Φᵀ·P: their squares, the eigenvalues there, and the rest.
struct Spectrum {
    squares: Vec<f64>,
    eigenvalues: Vec<f64>,
    rest: f64,
    n_free: f64,
}

impl Spectrum {
    /// σe² for a ratio λ = σm²/σe².
    fn noise_variance(&self, ratio: f64) -> f64 {
        let along: f64 = self.squares.iter().zip(&self.eigenvalues).map(|(z, s)| z / (1.0 + ratio * s)).sum();
        (along + self.rest) / self.n_free
    }

    /// −2 · log of the restricted likelihood, σe² profiled out, up to a constant.
    fn deviance(&self, ratio: f64) -> f64 {
        let volume: f64 = self.eigenvalues.iter().map(|s| libm::log1p(ratio * s)).sum();
        self.n_free * libm::log(self.noise_variance(ratio).max(f64::MIN_POSITIVE)) + volume
    }

    /// The ratio of smallest deviance: a grid over its logarithm, then golden sections.
    fn best_ratio(&self) -> f64 {
        let at = |log10: f64| self.deviance(libm::pow(10.0, log10));
        let step = (LOG10_RATIO.1 - LOG10_RATIO.0) / (GRID - 1) as f64;
        let grid = (0..GRID).map(|i| LOG10_RATIO.0 + step * i as f64).map(|log10| (log10, at(log10)));
        let best = grid.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(LOG10_RATIO.0, |(log10, _)| log10);
        let (mut low, mut high) = (best - step, best + step);
        for _ in 0..SECTIONS {
            let third = 0.381_966 * (high - low);
            if at(low + third) < at(high - third) {
                high -= third;
            } else {
                low += third;
            }
        }
        libm::pow(10.0, 0.5 * (low + high))
    }

    /// Inverse of the Fisher information of (σe², σm²).
    fn variance_of_variances(&self, noise: f64, misfit: f64) -> [[f64; 2]; 2] {
        let rest = self.n_free - self.eigenvalues.len() as f64;
        let (mut ee, mut em, mut mm) = (rest.max(0.0) / (noise * noise), 0.0, 0.0);
        for s in &self.eigenvalues {
            let weight = 1.0 / ((noise + misfit * s) * (noise + misfit * s));
            (ee, em, mm) = (ee + weight, em + s * weight, mm + s * s * weight);
        }
        if misfit == 0.0 {
            return [[2.0 / ee, 0.0], [0.0, 0.0]];
        }
        let determinant = (ee * mm - em * em).max(f64::MIN_POSITIVE);
        [[2.0 * mm / determinant, -2.0 * em / determinant], [-2.0 * em / determinant, 2.0 * ee / determinant]]
    }
}

fn misfit_components(linear: &Linear, n_free: f64) -> Option<Components> {
    let spectrum = spectrum(linear, n_free)?;
    let white = |noise_variance: f64| Components {
        noise_variance,
        misfit_variance: 0.0,
        variance_of_variances: spectrum.variance_of_variances(noise_variance, 0.0),
    };
    let alone = spectrum.noise_variance(0.0);
    if alone <= 0.0 {
        return Some(Components { noise_variance: 0.0, misfit_variance: 0.0, variance_of_variances: [[0.0; 2]; 2] });
    }
    let ratio = spectrum.best_ratio();
    if spectrum.deviance(0.0) - spectrum.deviance(ratio) <= KEPT_ABOVE * KEPT_ABOVE {
        return Some(white(alone));
    }
    let noise_variance = spectrum.noise_variance(ratio);
    let misfit_variance = ratio * noise_variance;
    let variance_of_variances = spectrum.variance_of_variances(noise_variance, misfit_variance);
    Some(Components { noise_variance, misfit_variance, variance_of_variances })
}

fn spectrum(linear: &Linear, n_free: f64) -> Option<Spectrum> {
    spectrum_outside(&linear.y, &linear.a.clone().qr().q(), &linear.features, n_free)
}

fn spectrum_outside(y: &DVector<f64>, q: &DMatrix<f64>, features: &DMatrix<f64>, n_free: f64) -> Option<Spectrum> {
    let y = y - q * q.tr_mul(y);
    let features = outside(q, features);
    let eigen = transposed_times(&features, &features).try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS)?;
    let scores = eigen.eigenvectors.tr_mul(&features.tr_mul(&y));
    let smallest = NEGLIGIBLE * eigen.eigenvalues.max();
    let mut kept: Vec<usize> = (0..scores.len()).filter(|k| eigen.eigenvalues[*k] > smallest).collect();
    kept.sort_by(|i, j| eigen.eigenvalues[*j].total_cmp(&eigen.eigenvalues[*i]).then(i.cmp(j)));
    kept.truncate(n_free as usize);
    let squares: Vec<f64> = kept.iter().map(|k| scores[*k] * scores[*k] / eigen.eigenvalues[*k]).collect();
    let rest = (y.norm_squared() - squares.iter().sum::<f64>()).max(0.0);
    Some(Spectrum { squares, eigenvalues: kept.iter().map(|k| eigen.eigenvalues[*k]).collect(), rest, n_free })
}

/// σm²/σe² by restricted maximum likelihood: how much more than white noise the residuals of a fit follow the features of the misfit.
/// `basis` spans what the fit can change, with orthonormal columns.
pub fn misfit_ratio(residuals: &DVector<f64>, basis: &DMatrix<f64>, features: &DMatrix<f64>) -> f64 {
    let n_free = residuals.len() as f64 - basis.ncols() as f64;
    spectrum_outside(residuals, basis, features, n_free).map_or(0.0, |spectrum| spectrum.best_ratio())
}

impl Uncertainty {
    /// One standard deviation of a parameter, mm or rad, as far as the data see it.
    pub fn std(&self, parameter: usize) -> f64 {
        (self.noise.row(parameter).norm_squared() + self.misfit.row(parameter).norm_squared()).sqrt()
    }

    /// Half-width of the interval that holds the parameter with probability `confidence`, mm or rad.
    pub fn half_width(&self, parameter: usize, confidence: f64) -> f64 {
        let (noise, misfit) = (self.noise.row(parameter).norm_squared(), self.misfit.row(parameter).norm_squared());
        t_half_width(confidence, self.freedom_of(noise, misfit)) * (noise + misfit).sqrt()
    }

    /// Degrees of freedom of a variance that is `noise` by noise and `misfit` by misfit (Satterthwaite 1946): 2·v²/var(v).
    pub fn freedom_of(&self, noise: f64, misfit: f64) -> f64 {
        let share = |part: f64, std: f64| if std > 0.0 { part / (std * std) } else { 0.0 };
        let (a, b) = (share(noise, self.noise_std_mm), share(misfit, self.misfit_std_rad));
        let [[ee, em], [_, mm]] = self.variance_of_variances;
        let variance = a * a * ee + 2.0 * a * b * em + b * b * mm;
        let freedom = 2.0 * (noise + misfit) * (noise + misfit) / variance;
        if freedom.is_finite() { freedom.clamp(1.0, self.freedom) } else { self.freedom }
    }

    /// One standard deviation (3-D: the root of the three variances' sum) of where `model` predicts a target, mm: J·C·Jᵀ with C of
    /// noise, of the combinations that the data do not see, and of the misfit both at the measured poses and at this one.
    pub fn position_std_mm(&self, model: &KinematicModel, parameters: &[Parameter], q_rad: &[f64], target: usize) -> f64 {
        let variances = self.position_variances_mm2(model, parameters, q_rad, target);
        variances.iter().map(|[known, misfit]| known + misfit).sum::<f64>().sqrt()
    }

    /// Half-width, along each axis of the measuring frame, of the interval that holds where a target is with probability `confidence`, mm.
    pub fn position_half_widths_mm(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        (q_rad, target): (&[f64], usize),
        confidence: f64,
    ) -> [f64; 3] {
        let half_width = |[known, misfit]: [f64; 2]| t_half_width(confidence, self.freedom_of(known, misfit)) * (known + misfit).sqrt();
        self.position_variances_mm2(model, parameters, q_rad, target).map(half_width)
    }

    /// Variances along each axis of the measuring frame: from noise and the unseen, and from the misfit.
    fn position_variances_mm2(&self, model: &KinematicModel, parameters: &[Parameter], q_rad: &[f64], target: usize) -> [[f64; 2]; 3] {
        let here = [Observation { q_rad: q_rad.to_vec(), position_mm: Vector3::zeros(), target, weight: 1.0 }];
        let jacobian = weighted_jacobian(model, parameters, &here, &Vector3::zeros());
        let (noise, unseen) = (&jacobian * &self.noise, &jacobian * &self.unseen);
        let mut misfit = &jacobian * &self.misfit;
        if misfit.ncols() > 0 {
            misfit -= misfit::features(model, [(q_rad, target, 1.0)].into_iter(), &self.gravity) * self.misfit_std_rad;
        }
        let along = |axis: usize| [noise.row(axis).norm_squared() + unseen.row(axis).norm_squared(), misfit.row(axis).norm_squared()];
        [along(0), along(1), along(2)]
    }
}
