//! How far identified parameters, and the tool, may be from the truth.
//!
//! The identified robot is the most probable one among links alone. How wrong it may be is judged in a wider problem, linear about it:
//!
//! `residual = J·δ + Φ·u + c + e`
//!
//! - δ, deviations of the parameters from the identified ones, with the priors of the estimate;
//! - u, what links cannot say: the features Φ of [`misfit`](super::misfit), each normal about 0 with standard deviation σm;
//! - c, what all points of one configuration share, σc;
//! - e, white noise of the instrument and of the robot's repeatability, σ. Where it differs from direction to direction, all rows are whitened
//!   first.
//!
//! σ and σm are the most probable ones [MacKay 1992], σm with a half-Cauchy prior [Gelman 2006]; σc comes from an analysis of variance. The
//! posterior of δ and u has a mean and a covariance. The identified robot has δ = 0 and u = 0, so the mean is an error of it, and it counts as
//! one standard deviation beside those of the covariance. With many poses, u is known and the error tends to the mean: it
//! neither vanishes nor grows.

use crate::identification::KinematicModel;
use crate::identification::distributions::{f_tail, t_half_width};
use crate::identification::estimate::evidence_at;
use crate::identification::evidence::{Evidence, Posterior, Triangle};
use crate::identification::misfit::Misfit;
use crate::identification::objective::{Observation, weighted_jacobian};
use crate::identification::parameters::Parameter;
use crate::identification::problem::Problem;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Scale of the half-Cauchy prior of σm, rad: joints that turn by 0.3 mrad under the weight of an arm's end are usual.
const USUAL_MISFIT_RAD: f64 = 3e-4;
/// Searches of σm, each with the noise of the one before.
const SEARCHES: usize = 3;
/// What configurations share counts where chance would show as much in fewer cases than these.
const CHANCE: f64 = 0.05;
/// σc²/σ² where the points of a configuration agree to the last bit.
const MOST_SHARED: f64 = 1e6;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 1000;
/// Points that are reduced to a triangle at once: memory does not grow with the points.
const POINTS_AT_ONCE: usize = 200;

/// The points of a session at its fit.
pub struct Session<'a> {
    /// The identified robot.
    pub model: &'a KinematicModel,
    /// Its problem, with the priors of its parameters.
    pub problem: &'a Problem<'a>,
    /// The problem's observations, every one with some weight. A pose is two of them, three rows each: its position without, then the same with
    /// its rotation.
    pub observations: &'a [Observation],
    /// The number of each observation's configuration.
    pub configurations: &'a [usize],
    /// The instrument's station of each observation, from 0; `None` for the one in whose frame the model stands.
    pub stations: &'a [Option<usize>],
    /// What links cannot say.
    pub misfit: Misfit,
    /// Asked between parts of the work; once it says no, the answer is of no use.
    pub watch: &'a Watch<'a>,
}

/// Errors of an identification, one standard deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// σ, mm: white noise of one coordinate of a point of weight 1.
    pub noise_std_mm: f64,
    /// σc, mm: what points of one configuration share; 0 where it does not stand out.
    pub configuration_std_mm: f64,
    /// σm, rad per unit feature; 0 where it does not stand out.
    pub misfit_std_rad: f64,
    /// Root of the mean square error, (p + m) × k: the p parameters in mm or rad, then the m features in rad (none where σm is 0). Each column is
    /// one standard deviation of an independent cause; the last one is the mean of the posterior.
    pub root: DMatrix<f64>,
    /// How the noise alone moves the most probable values, (p + m) × k.
    pub of_noise: DMatrix<f64>,
    /// One standard deviation of the prior of each parameter and feature, mm or rad.
    pub prior_std: Vec<f64>,
    /// What the features were made of.
    pub features: Misfit,
    /// Number of parameters, p.
    pub n_parameters: usize,
    /// Rows less the coordinates that they determine; of the configurations' means where configurations share errors.
    pub freedom: f64,
    /// How far the identified robot is from the minimum of its cost, in its own standard deviations (root mean square over the combinations that
    /// the points determine): what is said here is said of that minimum.
    pub stds_from_minimum: f64,
}

/// The columns of the wider problem.
struct Columns {
    n_parameters: usize,
    n_stations: usize,
    n_features: usize,
}

impl Columns {
    fn without_features(&self) -> usize {
        self.n_parameters + 6 * self.n_stations
    }

    fn all(&self) -> usize {
        self.without_features() + self.n_features
    }
}

/// Where the three rows of an observation are: the block of its measurement, and the first of them there.
struct Place {
    block: usize,
    first: usize,
}

/// The rows of a session: the identified robot's coordinates, and the points of each configuration.
struct Rows<'a> {
    session: &'a Session<'a>,
    columns: Columns,
    x: Vec<f64>,
    points_of: Vec<Vec<usize>>,
    /// Where each observation's rows are.
    places: Vec<Place>,
}

/// How a station that is turned turns a pose that was measured from it, by its rotation rows; `None` of positions.
fn turned_by_station(model: &KinematicModel, o: &Observation) -> Option<Matrix3<f64>> {
    let measured = o.rotation.as_ref()?;
    let predicted = model.rotation(&o.q_rad, o.target)?;
    Some(predicted.matrix().transpose() * (o.weight.sqrt() * measured.mm_per_rad))
}

/// How what the points of a configuration share enters their rows: rows = A·c, A = one block of 3 × 3 a point.
enum Common {
    /// A block is the square root of the point's weight times 1.
    Alike { roots: Vec<f64>, weight: f64 },
    /// Or that times what whitens the point's noise. Columns of `along`, 3·N × 3, are orthonormal and span those of A; `weights` are the
    /// eigenvalues of AᵀA.
    Uneven {
        along: DMatrix<f64>,
        weights: Vector3<f64>,
    },
}

impl Common {
    /// Weight of the mean, of an axis.
    fn weight(&self) -> f64 {
        match self {
            Self::Alike { weight, .. } => *weight,
            Self::Uneven { weights, .. } => weights.sum() / 3.0,
        }
    }

    /// Rows that take the three means of some rows: 3 × 3·N, orthonormal.
    fn means(&self, n_rows: usize) -> DMatrix<f64> {
        match self {
            Self::Alike { roots, weight } => {
                let mut along = DMatrix::zeros(3, n_rows);
                for (k, root) in roots.iter().enumerate() {
                    (0..3).for_each(|axis| along[(axis, 3 * k + axis)] = root / weight.sqrt());
                }
                along
            }
            Self::Uneven { along, .. } => along.transpose(),
        }
    }
}

/// What the points of several configurations share.
#[derive(Clone, Copy)]
struct Shared {
    /// σc²/σ².
    ratio: f64,
    /// Degrees of freedom of the means of all configurations.
    freedom: f64,
}

impl<'a> Rows<'a> {
    fn new(session: &'a Session<'a>) -> Self {
        let Session {
            model,
            problem,
            configurations,
            stations,
            misfit,
            ..
        } = session;
        let n_configurations = configurations.iter().map(|c| c + 1).max().unwrap_or(0);
        let mut points_of = vec![vec![]; n_configurations];
        for (point, configuration) in configurations.iter().enumerate() {
            points_of[*configuration].push(point);
        }
        points_of.retain(|points| !points.is_empty());
        let columns = Columns {
            n_parameters: problem.variables.len(),
            n_stations: stations.iter().flatten().map(|s| s + 1).max().unwrap_or(0),
            n_features: misfit.features(model, [].into_iter()).ncols(),
        };
        let mut n_blocks = 0;
        let place = |o: &Observation| {
            n_blocks += usize::from(o.rotation.is_none());
            Place {
                block: n_blocks - 1,
                first: if o.rotation.is_some() { 3 } else { 0 },
            }
        };
        Self {
            session,
            columns,
            x: problem.coordinates(model),
            places: session.observations.iter().map(place).collect(),
            points_of,
        }
    }

    /// Derivatives of some points' residuals by all columns, and the residuals.
    fn of(&self, points: &[usize]) -> (DMatrix<f64>, Vec<f64>) {
        let Session {
            model,
            problem,
            observations,
            stations,
            misfit,
            ..
        } = self.session;
        let mut matrix = DMatrix::zeros(3 * points.len(), self.columns.all());
        let poses = points.iter().map(|point| {
            let o = &observations[*point];
            (o.q_rad.as_slice(), o.target, o.weight)
        });
        let mut features = -misfit.features(model, poses);
        for (k, point) in points.iter().enumerate() {
            if let Some(w) = observations[*point].whitening {
                let mut rows = features.rows_mut(3 * k, 3);
                rows.copy_from(&(w * &rows));
            }
        }
        matrix
            .columns_mut(self.columns.without_features(), self.columns.n_features)
            .copy_from(&features);
        let mut blocks: Vec<usize> = points.iter().map(|p| self.places[*p].block).collect();
        blocks.dedup();
        let part = problem.part(blocks.iter().copied());
        let mut of_blocks = DMatrix::zeros(part.n_rows(), self.columns.n_parameters);
        let mut left = vec![0.0; part.n_rows()];
        part.evaluate(&self.x, &mut left, Some(&mut of_blocks));
        let mut residuals = Vec::with_capacity(matrix.nrows());
        let mut at = 0;
        for (k, point) in points.iter().enumerate() {
            let o = &observations[*point];
            let place = &self.places[*point];
            at += usize::from(blocks[at] != place.block);
            let first = part.rows_of(at).start + place.first;
            residuals.extend_from_slice(&left[first..first + 3]);
            matrix
                .view_mut((3 * k, 0), (3, self.columns.n_parameters))
                .copy_from(&of_blocks.rows(first, 3));
            if o.rotation.is_some() {
                matrix
                    .view_mut(
                        (3 * k, self.columns.without_features()),
                        (3, self.columns.n_features),
                    )
                    .copy_from(&-misfit.turns(model, o));
            }
            // a station that stands elsewhere moves what was measured from it
            if let Some(station) = stations[*point] {
                let first = self.columns.n_parameters + 6 * station;
                if let Some(turned) = turned_by_station(model, o) {
                    matrix
                        .fixed_view_mut::<3, 3>(3 * k, first + 3)
                        .copy_from(&turned);
                    continue;
                }
                let from_base = o.position_mm - model.t_instrument_base.translation.vector;
                for axis in 0..3 {
                    let along = Vector3::ith(axis, o.weight.sqrt());
                    let mut put = |column, v: Vector3<f64>| {
                        let v = o.whitened(v);
                        matrix.fixed_view_mut::<3, 1>(3 * k, column).copy_from(&v)
                    };
                    put(first + axis, along * problem.reach_mm);
                    put(first + 3 + axis, along.cross(&from_base));
                }
            }
        }
        (matrix, residuals)
    }

    /// As [`Self::of`] for the points of a configuration, with what they share whitened: along their mean, rows are divided by sqrt(1 + ρ·L), L
    /// the sum of their weights.
    fn whitened(&self, points: &[usize], ratio: f64) -> (DMatrix<f64>, Vec<f64>) {
        let (mut matrix, mut residuals) = self.of(points);
        if ratio == 0.0 {
            return (matrix, residuals);
        }
        let columns = matrix.as_mut_slice().chunks_exact_mut(3 * points.len());
        let columns = columns.chain([residuals.as_mut_slice()]);
        match self.common(points) {
            Common::Alike { roots, weight } => {
                let less = (1.0 - 1.0 / (1.0 + ratio * weight).sqrt()) / weight;
                for column in columns {
                    for axis in 0..3 {
                        let along: f64 = (0..roots.len())
                            .map(|k| roots[k] * column[3 * k + axis])
                            .sum();
                        (0..roots.len())
                            .for_each(|k| column[3 * k + axis] -= roots[k] * along * less);
                    }
                }
            }
            // V = 1 + ρ·A·Aᵀ, whose eigenvectors beside 1 are `along`
            Common::Uneven { along, weights } => {
                let less = weights.map(|weight| 1.0 - 1.0 / (1.0 + ratio * weight).sqrt());
                for column in columns {
                    let rows = DVector::from_column_slice(column);
                    let mut means = along.tr_mul(&rows);
                    means.component_mul_assign(&less);
                    column.copy_from_slice((rows - &along * means).as_slice());
                }
            }
        }
        (matrix, residuals)
    }

    /// How what some points share enters their rows.
    fn common(&self, points: &[usize]) -> Common {
        let all = self.session.observations;
        let root = |point: &usize| all[*point].weight.sqrt();
        let roots: Vec<f64> = points.iter().map(root).collect();
        let whitening = |point: &usize| match &all[*point] {
            o if o.rotation.is_some() => None,
            o => o.whitening,
        };
        if points.iter().all(|point| whitening(point).is_none()) {
            let weight: f64 = roots.iter().map(|root| root * root).sum();
            return Common::Alike { roots, weight };
        }
        let mut a = DMatrix::zeros(3 * points.len(), 3);
        for (k, point) in points.iter().enumerate() {
            let block = whitening(point).unwrap_or_else(Matrix3::identity) * roots[k];
            a.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&block);
        }
        let square: Matrix3<f64> = a.tr_mul(&a).fixed_view::<3, 3>(0, 0).into();
        let Some(eigen) = square.try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS) else {
            let weight = square.trace() / 3.0;
            return Common::Alike { roots, weight };
        };
        // blocks are invertible, so that the eigenvalues are positive
        let over = eigen.eigenvalues.map(|weight| 1.0 / weight.sqrt());
        let along = a * (eigen.eigenvectors * Matrix3::from_diagonal(&over));
        Common::Uneven {
            along: DMatrix::from_column_slice(along.nrows(), 3, along.as_slice()),
            weights: eigen.eigenvalues,
        }
    }

    fn triangle(&self, ratio: f64) -> Triangle {
        let mut triangle = Triangle::empty(self.columns.all());
        let mut some: Vec<(DMatrix<f64>, Vec<f64>)> = Vec::new();
        let mut n_points = 0;
        for points in &self.points_of {
            some.push(self.whitened(points, ratio));
            n_points += points.len();
            if n_points >= POINTS_AT_ONCE {
                if !self.session.watch.goes_on() {
                    break;
                }
                triangle.append(&some);
                (some, n_points) = (vec![], 0);
            }
        }
        triangle.append(&some);
        triangle.expect(self.session.problem);
        triangle
    }

    /// Analysis of variance of what is left: between the means of configurations, and within them.
    fn shared(&self, solved: &Solved) -> Shared {
        let posterior = &solved.posterior;
        let n = posterior.step.len();
        let step = DVector::from_column_slice(&posterior.step);
        let root = &posterior.root / solved.evidence.sigma_mm;
        let (mut between_mm2, mut within_mm2) = (0.0, 0.0);
        let (mut n_between, mut n_within, mut n_configurations) = (0.0, 0.0, 0.0);
        let (mut weights, mut n_means) = (0.0, 0.0);
        for (k, points) in self.points_of.iter().enumerate() {
            if k % POINTS_AT_ONCE == 0 && !self.session.watch.goes_on() {
                break;
            }
            let (matrix, residuals) = self.of(points);
            let matrix = matrix.columns(0, n);
            let left = DVector::from_vec(residuals) + matrix * &step;
            let taken = matrix * &root;
            let common = self.common(points);
            let along = common.means(left.len());
            let taken_by_means = (&along * &taken).norm_squared();
            n_means += 3.0 - taken_by_means;
            if points.len() < 2 {
                continue;
            }
            let means = (&along * &left).norm_squared();
            between_mm2 += means;
            within_mm2 += left.norm_squared() - means;
            n_between += 3.0 - taken_by_means;
            n_within += left.len() as f64 - 3.0 - (taken.norm_squared() - taken_by_means);
            weights += common.weight();
            n_configurations += 1.0;
        }
        let n_points = self.session.observations.len() as f64;
        let none = Shared {
            ratio: 0.0,
            freedom: 3.0 * n_points,
        };
        if n_between < 1.0 || n_within < 1.0 || between_mm2 <= 0.0 {
            return none;
        }
        let (between, within) = (between_mm2 / n_between, within_mm2.max(0.0) / n_within);
        if f_tail(between / within, n_between, n_within) >= CHANCE {
            return none;
        }
        let of_one = weights / n_configurations;
        Shared {
            ratio: ((between / within - 1.0) / of_one).min(MOST_SHARED),
            freedom: n_means,
        }
    }
}

/// The wider problem, solved.
struct Solved {
    triangle: Triangle,
    evidence: Evidence,
    posterior: Posterior,
    misfit_std_rad: f64,
}

impl Rows<'_> {
    /// The posterior, with σm and σ. `links` has the widths that the estimate of links alone has found.
    fn solve(&self, links: &Evidence, ratio: f64) -> Solved {
        let (columns, problem) = (&self.columns, self.session.problem);
        let least_mm = problem.least_sigma_mm;
        let mut x = problem.coordinates(self.session.model);
        x.resize(columns.all(), 0.0);
        let without = columns.without_features();
        let triangle = self.triangle(ratio);
        let of_links = triangle.leading(without);
        let mut evidence = links.clone();
        evidence.widths.resize(without, Evidence::FLAT);
        let mut posterior = of_links.solve(&x[..without], &evidence);
        evidence.sigma_mm = of_links.noise_mm(&posterior).max(least_mm);
        let mut misfit_std_rad = 0.0;
        for _ in 0..SEARCHES {
            let Some(spectrum) = triangle.spectrum(&x, &evidence, without) else {
                break;
            };
            misfit_std_rad = spectrum.most_probable(USUAL_MISFIT_RAD, evidence.sigma_mm);
            if misfit_std_rad == 0.0 {
                evidence.widths.truncate(without);
                posterior = of_links.solve(&x[..without], &evidence);
                evidence.sigma_mm = of_links.noise_mm(&posterior).max(least_mm);
                break;
            }
            evidence.widths.resize(columns.all(), misfit_std_rad);
            evidence.widths[without..].fill(misfit_std_rad);
            posterior = triangle.solve(&x, &evidence);
            evidence.sigma_mm = triangle.noise_mm(&posterior).max(least_mm);
        }
        let triangle = match misfit_std_rad > 0.0 {
            true => triangle,
            false => of_links,
        };
        evidence.widths.truncate(triangle.n_coordinates());
        let posterior = triangle.solve(&x[..triangle.n_coordinates()], &evidence);
        Solved {
            triangle,
            evidence,
            posterior,
            misfit_std_rad,
        }
    }
}

/// `None` where the equations cannot be solved.
pub fn uncertainty(session: Session<'_>) -> Option<Uncertainty> {
    let rows = Rows::new(&session);
    let columns = &rows.columns;
    let (links, alone) = evidence_at(session.problem, session.model);
    let mut solved = rows.solve(&links, 0.0);
    let mut freedom = solved.triangle.freedom(&solved.posterior);
    let shared = rows.shared(&solved);
    if shared.ratio > 0.0 {
        solved = rows.solve(&links, shared.ratio);
        freedom = shared.freedom;
    }
    let Solved {
        triangle,
        evidence,
        posterior,
        misfit_std_rad,
    } = solved;
    // where stations stand is of no use to others
    let stations = columns.n_parameters..columns.without_features();
    let kept: Vec<usize> = (0..posterior.step.len())
        .filter(|j| !stations.contains(j))
        .collect();
    let unit = |j: usize| match session.problem.variables.get(j) {
        Some(variable) => variable.width,
        None => 1.0,
    };
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
        misfit_std_rad,
        of_noise: in_units(&triangle.by_noise(&posterior, evidence.sigma_mm)),
        root,
        prior_std: kept
            .iter()
            .map(|j| evidence.widths[*j] * unit(*j))
            .collect(),
        n_parameters: columns.n_parameters,
        freedom: freedom.max(1.0),
        stds_from_minimum: alone.stds_from_fit(),
        features: session.misfit.clone(),
    })
}

impl Uncertainty {
    /// Covariance of the posterior, (p + m)².
    pub fn covariance(&self) -> DMatrix<f64> {
        let root = self.root.columns(0, self.root.ncols() - 1);
        root * root.transpose()
    }

    /// How far the most probable value of a parameter is from the identified one, mm or rad.
    pub fn mean(&self, parameter: usize) -> f64 {
        self.root[(parameter, self.root.ncols() - 1)]
    }

    /// By how much the most probable value of a parameter follows when another one changes by 1: an entry of I − C·P⁻¹.
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

    /// One standard deviation of a parameter, mm or rad.
    pub fn std(&self, parameter: usize) -> f64 {
        self.root.row(parameter).norm()
    }

    /// Half-width of the interval that holds the parameter with probability `confidence`, mm or rad.
    pub fn half_width(&self, parameter: usize, confidence: f64) -> f64 {
        t_half_width(confidence, self.freedom) * self.std(parameter)
    }

    /// One standard deviation (3-D: the root of the three variances' sum) of where `model` predicts a target, mm.
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

    /// Half-width, along each axis of the measuring frame, of the interval that holds where a target is with probability `confidence`, mm.
    pub fn position_half_widths_mm(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        (q_rad, target): (&[f64], usize),
        confidence: f64,
    ) -> [f64; 3] {
        let errors = self.position_errors_mm(model, parameters, q_rad, target);
        let half = t_half_width(confidence, self.freedom);
        [0, 1, 2].map(|axis| half * errors.row(axis).norm())
    }

    /// What each cause moves a target by, mm: 3 × k, in the measuring frame.
    fn position_errors_mm(
        &self,
        model: &KinematicModel,
        parameters: &[Parameter],
        q_rad: &[f64],
        target: usize,
    ) -> DMatrix<f64> {
        let here = [Observation {
            q_rad: q_rad.to_vec(),
            position_mm: Vector3::zeros(),
            target,
            weight: 1.0,
            whitening: None,
            rotation: None,
        }];
        let p = self.n_parameters;
        let jacobian = weighted_jacobian(model, parameters, &here, &Vector3::zeros());
        let mut errors = jacobian * self.root.rows(0, p);
        if self.root.nrows() > p {
            let pose = [(q_rad, target, 1.0)].into_iter();
            errors +=
                self.features.features(model, pose) * self.root.rows(p, self.root.nrows() - p);
        }
        errors
    }
}
