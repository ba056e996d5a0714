//! The rows of the wider problem of [`uncertainty`](super::uncertainty).

use crate::identification::KinematicModel;
use crate::identification::corrections::Fitted;
use crate::identification::least_squares::evidence::{Posterior, Triangle};
use crate::identification::least_squares::problem::Problem;
use crate::identification::model::objective::Observation;
use crate::identification::statistics::distributions::f_tail;
use crate::identification::statistics::misfit::Misfit;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector, Matrix3, MatrixXx3, Vector3};
use std::ops::Range;

/// Significance level for errors that configurations share.
const SIGNIFICANCE_LEVEL: f64 = 0.05;
/// Maximum of σc²/σ², for points of a configuration that agree to the last bit.
const MAX_SHARED: f64 = 1e6;
/// Number of points that are reduced to a triangle at once, so that memory does not grow with the number of points.
const POINTS_AT_ONCE: usize = 200;

/// The points of a session at its fit.
pub struct Session<'a> {
    /// The identified robot.
    pub model: &'a KinematicModel,
    /// Its problem, with the priors of its parameters.
    pub problem: &'a Problem<'a>,
    /// The observations of the problem, all with nonzero weight.
    pub observations: &'a [Observation],
    /// Configuration number of each observation.
    pub configurations: &'a [usize],
    /// The fit of links and corrections, if the problem has corrections. Their terms are its last variables. What a residual network corrects
    /// counts as misfit and noise.
    pub corrections: Option<&'a Fitted>,
    /// The misfit of the links, or of links and corrections.
    pub misfit: Misfit,
    /// Asked between parts of the work whether to stop. After a stop the result is not valid.
    pub watch: &'a Watch<'a>,
}

/// The columns of the wider problem: the variables of the session's problem, then the features of the misfit.
pub(super) struct Columns {
    pub(super) n_parameters: usize,
    stations: Range<usize>,
    /// Terms of the corrections.
    pub(super) n_terms: usize,
    /// Features of the misfit: pairs of joints that may follow each other, harmonics of higher orders than the first, and the usual ones.
    pub(super) n_followings: usize,
    n_higher: usize,
    n_usual: usize,
}

impl Columns {
    pub(super) fn stations(&self) -> Range<usize> {
        self.stations.clone()
    }

    /// Number of variables of the session's problem.
    pub(super) fn without_features(&self) -> usize {
        self.stations.end + self.n_terms
    }

    pub(super) fn higher(&self) -> Range<usize> {
        let first = self.without_features() + self.n_followings;
        first..first + self.n_higher
    }

    pub(super) fn usual(&self) -> Range<usize> {
        let first = self.higher().end;
        first..first + self.n_usual
    }

    fn all(&self) -> usize {
        self.usual().end
    }
}

/// Three rows of an observation: its position, or the rotation of a pose.
#[derive(Clone, Copy)]
struct Point {
    observation: usize,
    is_rotation: bool,
}

/// The rows of a session, with the identified robot's coordinates and the points of each configuration.
pub(super) struct Rows<'a> {
    pub(super) session: &'a Session<'a>,
    pub(super) columns: Columns,
    pub(super) x: Vec<f64>,
    /// The points of each configuration; positions and rotations form configurations of their own.
    points_of: Vec<Vec<Point>>,
}

/// Effect of the error that the points of a configuration share on their rows: rows = A·c, with one 3 × 3 block of A per point, the square root of its
/// weight times its whitening matrix.
struct Common {
    /// Orthonormal columns that span those of A, 3·N × 3.
    along: MatrixXx3<f64>,
    /// The eigenvalues of AᵀA.
    weights: Vector3<f64>,
}

/// Error that the points of configurations share.
#[derive(Clone, Copy)]
pub(super) struct Shared {
    /// σc²/σ².
    pub(super) ratio: f64,
    /// Degrees of freedom of the means of all configurations.
    pub(super) freedom: f64,
}

impl<'a> Rows<'a> {
    pub(super) fn new(session: &'a Session<'a>) -> Self {
        let Session {
            model,
            problem,
            configurations,
            corrections,
            misfit,
            ..
        } = session;
        let n_configurations = configurations.iter().map(|c| c + 1).max().unwrap_or(0);
        let mut points_of = vec![vec![]; 2 * n_configurations];
        for (observation, configuration) in configurations.iter().enumerate() {
            let is_pose = session.observations[observation].rotation.is_some();
            for is_rotation in [false, true].into_iter().take(1 + usize::from(is_pose)) {
                let first = usize::from(is_rotation) * n_configurations;
                points_of[first + configuration].push(Point {
                    observation,
                    is_rotation,
                });
            }
        }
        points_of.retain(|points| !points.is_empty());
        let n_features = misfit.features(model, [].into_iter()).ncols();
        let n_higher = misfit.n_higher_harmonics(model.links.len());
        let n_terms = corrections.as_ref().map_or(0, |of| of.terms.len());
        let columns = Columns {
            n_parameters: problem.station_variables().start,
            stations: problem.station_variables(),
            n_terms,
            n_followings: misfit.followings.len(),
            n_higher,
            n_usual: n_features - misfit.followings.len() - n_higher,
        };
        let value = |term: &_| corrections.map_or(0.0, |fitted| fitted.value(term));
        Self {
            session,
            columns,
            x: problem.coordinates_with(model, value),
            points_of,
        }
    }

    /// Number of all points.
    pub(super) fn n_points(&self) -> usize {
        self.points_of.iter().map(Vec::len).sum()
    }

    /// Derivatives of some points' residuals by all columns, and the residuals.
    fn of(&self, points: &[Point]) -> (DMatrix<f64>, Vec<f64>) {
        let Session {
            model,
            observations,
            misfit,
            ..
        } = self.session;
        let mut matrix = DMatrix::zeros(3 * points.len(), self.columns.all());
        let poses = points.iter().map(|point| {
            let o = &observations[point.observation];
            (o.q_rad.as_slice(), o.target, o.weight)
        });
        let mut features = -misfit.features(model, poses);
        for (k, point) in points.iter().enumerate() {
            if let Some(w) = observations[point.observation].whitening {
                let mut rows = features.rows_mut(3 * k, 3);
                rows.copy_from(&(w * &rows));
            }
        }
        matrix
            .columns_mut(self.columns.without_features(), features.ncols())
            .copy_from(&features);
        let residuals = self.of_model(points, &mut matrix);
        for (k, point) in points.iter().enumerate() {
            let o = &observations[point.observation];
            // Positions at a lever depend on rotations too.
            let coupling = o.coupling().filter(|_| !point.is_rotation);
            if point.is_rotation || coupling.is_some() {
                let turns = -misfit.turns(model, o);
                let first = (3 * k, self.columns.without_features());
                let mut here = matrix.view_mut(first, turns.shape());
                match coupling {
                    Some(coupling) => here += coupling * turns,
                    None => here.copy_from(&turns),
                }
            }
        }
        (matrix, residuals)
    }

    /// Fills the columns of the problem's variables, and returns the residuals.
    fn of_model(&self, points: &[Point], matrix: &mut DMatrix<f64>) -> Vec<f64> {
        let (problem, p) = (self.session.problem, self.columns.without_features());
        let mut residuals = Vec::with_capacity(matrix.nrows());
        let part = problem.part(points.iter().map(|point| point.observation));
        let mut of_blocks = DMatrix::zeros(part.n_rows(), p);
        let mut left = vec![0.0; part.n_rows()];
        part.evaluate(&self.x, &mut left, Some(&mut of_blocks));
        for (k, point) in points.iter().enumerate() {
            let first = part.rows_of(k).start + 3 * usize::from(point.is_rotation);
            residuals.extend_from_slice(&left[first..first + 3]);
            let mut to = matrix.view_mut((3 * k, 0), (3, p));
            to.copy_from(&of_blocks.rows(first, 3));
        }
        residuals
    }

    /// As [`Self::of`] for the points of a configuration, with their shared error whitened: V = 1 + ρ·A·Aᵀ has the eigenvectors [`Common::along`], and
    /// all other eigenvalues are 1.
    fn whitened(&self, points: &[Point], ratio: f64) -> (DMatrix<f64>, Vec<f64>) {
        let (mut matrix, mut residuals) = self.of(points);
        if ratio == 0.0 {
            return (matrix, residuals);
        }
        let Common { along, weights } = self.common(points);
        let less = weights.map(|weight| 1.0 - 1.0 / (1.0 + ratio * weight).sqrt());
        let columns = matrix.as_mut_slice().chunks_exact_mut(3 * points.len());
        for column in columns.chain([residuals.as_mut_slice()]) {
            let rows = DVector::from_column_slice(column);
            let means = along.tr_mul(&rows).component_mul(&less);
            column.copy_from_slice((rows - &along * means).as_slice());
        }
        (matrix, residuals)
    }

    /// Effect of the error that some points share on their rows.
    fn common(&self, points: &[Point]) -> Common {
        let mut a = MatrixXx3::zeros(3 * points.len());
        for (k, point) in points.iter().enumerate() {
            let o = &self.session.observations[point.observation];
            let whitening = o.whitening.filter(|_| !point.is_rotation);
            let block = whitening.unwrap_or_else(Matrix3::identity) * o.weight.sqrt();
            a.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&block);
        }
        let eigen = a.tr_mul(&a).symmetric_eigen();
        // The blocks are invertible, so the eigenvalues are positive.
        let over = eigen.eigenvalues.map(|weight| 1.0 / weight.sqrt());
        Common {
            along: a * (eigen.eigenvectors * Matrix3::from_diagonal(&over)),
            weights: eigen.eigenvalues,
        }
    }

    pub(super) fn triangle(&self, ratio: f64) -> Triangle {
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
        triangle.expect(self.session.problem, self.columns.without_features());
        triangle.expect_zero(self.columns.higher());
        triangle.expect_zero(self.columns.usual());
        triangle
    }

    /// Analysis of variance of the residuals: between the means of configurations, and within configurations.
    /// `columns` are those of the solution.
    pub(super) fn shared(&self, columns: &[usize], posterior: &Posterior, sigma_mm: f64) -> Shared {
        let step = DVector::from_column_slice(&posterior.step);
        let root = &posterior.root / sigma_mm;
        let (mut between_mm2, mut within_mm2) = (0.0, 0.0);
        let (mut n_between, mut n_within, mut n_configurations) = (0.0, 0.0, 0.0);
        let (mut weights, mut n_means) = (0.0, 0.0);
        for (k, points) in self.points_of.iter().enumerate() {
            if k % POINTS_AT_ONCE == 0 && !self.session.watch.goes_on() {
                break;
            }
            let (matrix, residuals) = self.of(points);
            let matrix = matrix.select_columns(columns);
            let left = DVector::from_vec(residuals) + &matrix * &step;
            let taken = matrix * &root;
            let common = self.common(points);
            let along = common.along.transpose();
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
            weights += common.weights.mean();
            n_configurations += 1.0;
        }
        let n_points = self.n_points() as f64;
        let none = Shared {
            ratio: 0.0,
            freedom: 3.0 * n_points,
        };
        if n_between < 1.0 || n_within < 1.0 || between_mm2 <= 0.0 {
            return none;
        }
        let (between, within) = (between_mm2 / n_between, within_mm2.max(0.0) / n_within);
        if f_tail(between / within, n_between, n_within) >= SIGNIFICANCE_LEVEL {
            return none;
        }
        let of_one = weights / n_configurations;
        Shared {
            ratio: ((between / within - 1.0) / of_one).min(MAX_SHARED),
            freedom: n_means,
        }
    }
}
