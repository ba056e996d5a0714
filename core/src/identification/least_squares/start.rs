//! Initial base pose and targets from nominal kinematics. The user need not state a starting guess.

use crate::identification::KinematicModel;
use crate::identification::least_squares::hand_eye::{base_and_target_rotation, target_rotation};
use crate::identification::least_squares::problem::Problem;
use crate::identification::model::objective::{Observation, posed_targets};
use crate::kinematics::rotation::nearest_rotation;
use crate::kinematics::{Link, t_base_flange};
use crate::solvers::least_squares::{Options, minimize};
use nalgebra::{
    DMatrix, DVector, IsometryMatrix3, Matrix3, Point3, Rotation3, Translation3, Vector3,
};
use std::ops::ControlFlow;

/// Maximum number of observations of each target for the closed form. The least-squares fit that follows uses all.
const START_OBSERVATIONS: usize = 200;
/// Iteration limit of a singular value decomposition.
const SVD_ITERATIONS: usize = 10_000;

/// Base pose and target offsets that best fit `observations`, with the links held.
pub fn fit_base_and_targets(
    links: &[Link],
    observations: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    let flanges = flanges(links, observations);
    place(links, &flanges, observations, n_targets)
}

/// Flange in the base frame at each observation.
fn flanges(links: &[Link], observations: &[Observation]) -> Vec<IsometryMatrix3<f64>> {
    let flange = |o: &Observation| t_base_flange(links, &o.q_rad);
    observations.iter().map(flange).collect()
}

/// Target positions that best fit `observations`, with the links held and the base at the measuring frame: the mean of each target's points
/// in the flange frame. A target without points is placed at the flange.
pub fn fit_targets(
    links: &[Link],
    observations: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    let mut model = KinematicModel::nominal(links, n_targets);
    let mut weights = vec![0.0; n_targets];
    let flanges = flanges(links, observations);
    for (o, flange) in observations.iter().zip(&flanges) {
        let in_flange = flange.inverse() * Point3::from(o.position_mm);
        model.targets_mm[o.target] += in_flange.coords * o.weight;
        weights[o.target] += o.weight;
    }
    for (target, weight) in model.targets_mm.iter_mut().zip(weights) {
        if weight > 0.0 {
            *target /= weight;
        }
    }
    let base = Rotation3::identity();
    model.target_rotations = target_rotations(&flanges, observations, n_targets, &base);
    model
}

/// Flange in the base frame and target in the measuring frame at each pose of a target.
fn pairs_of(
    target: usize,
    flanges: &[IsometryMatrix3<f64>],
    observations: &[Observation],
) -> Vec<(Rotation3<f64>, Rotation3<f64>)> {
    let of_target = observations.iter().zip(flanges);
    of_target
        .filter(|(o, _)| o.target == target && o.weight > 0.0)
        .filter_map(|(o, flange)| Some((flange.rotation, o.rotation?.rotation)))
        .collect()
}

/// Rotations of targets for a given rotation of the base; empty if no pose was measured.
fn target_rotations(
    flanges: &[IsometryMatrix3<f64>],
    observations: &[Observation],
    n_targets: usize,
    base: &Rotation3<f64>,
) -> Vec<Rotation3<f64>> {
    if posed_targets(observations).is_empty() {
        return vec![];
    }
    let of = |target| target_rotation(base, &pairs_of(target, flanges, observations));
    (0..n_targets)
        .map(|target| of(target).unwrap_or_else(Rotation3::identity))
        .collect()
}

/// Rotation of the base from the poses of the target with the most poses; `None` without poses.
fn base_rotation_of_poses(
    flanges: &[IsometryMatrix3<f64>],
    observations: &[Observation],
) -> Option<Rotation3<f64>> {
    let pairs = posed_targets(observations)
        .into_iter()
        .map(|target| pairs_of(target, flanges, observations))
        .max_by_key(Vec::len)?;
    base_and_target_rotation(&pairs).map(|(base, _)| base)
}

/// A robot with these links, whose flange in its base frame is known at each observation. Base pose and target positions are fitted by
/// least squares.
///
/// Starts are a closed form (linear in the rotation's entries, which are then projected onto the rotations), Kabsch's fit with the targets
/// at the flange and, for poses, the closed form of their rotations. If none of them gives a good fit, the 24 rotations of the cube are
/// tried too. Each start is refined by least squares, and the lowest cost wins.
pub fn place(
    links: &[Link],
    flanges: &[IsometryMatrix3<f64>],
    observations: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    let polish = |rotation: Rotation3<f64>| {
        let start = with_rotation(links, observations, flanges, n_targets, rotation);
        polished(start, flanges, observations)
    };
    let best = |candidates: Vec<Rotation3<f64>>| {
        candidates
            .into_iter()
            .map(polish)
            .min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let (few, few_flanges) = thinned(observations, flanges, n_targets);
    let origins: Vec<_> = flanges.iter().map(|f| f.translation.vector).collect();
    let measured: Vec<_> = observations.iter().map(|o| o.position_mm).collect();
    let direct = [
        linear_rotation(&few, &few_flanges, n_targets),
        Some(rigid_motion(&origins, &measured).rotation),
    ];
    let of_poses = base_rotation_of_poses(flanges, observations);
    let first = best(
        of_poses
            .into_iter()
            .chain(direct.into_iter().flatten())
            .collect(),
    );
    let found = match first {
        Some((cost_mm2, model)) if is_good(cost_mm2, observations) => Some(model),
        first => {
            let both = first.into_iter().chain(best(cube_rotations()));
            let best = both.min_by(|a, b| a.0.total_cmp(&b.0));
            best.map(|(_, model)| model)
        }
    };
    found.unwrap_or_else(|| KinematicModel::nominal(links, n_targets))
}

/// As [`place`], with the stations of the instrument placed too. Also returns their motions ([`Problem::station_motions`]). A station of fewer
/// than `least` observations stays where it is.
pub fn place_with_stations(
    links: &[Link],
    flanges: &[IsometryMatrix3<f64>],
    observations: &[Observation],
    n_targets: usize,
    least: usize,
) -> (KinematicModel, Vec<IsometryMatrix3<f64>>) {
    let model = place(links, flanges, observations, n_targets);
    let problem = Problem::of_placement(model.clone(), flanges, observations);
    let problem = problem.with_stations(observations, least);
    if problem.station_variables().is_empty() {
        return (model, vec![]);
    }
    let (_, x) = least_squares_of(&problem);
    let links = model.links;
    let placed = problem.model(&x);
    let model = KinematicModel { links, ..placed };
    (model, problem.station_motions(&x))
}

/// Least squares of base and targets. Returns the cost, mm², and the model.
fn polished(
    start: KinematicModel,
    flanges: &[IsometryMatrix3<f64>],
    observations: &[Observation],
) -> (f64, KinematicModel) {
    let links = start.links.clone();
    let problem = Problem::of_placement(start, flanges, observations);
    let (cost, x) = least_squares_of(&problem);
    let placed = problem.model(&x);
    (cost, KinematicModel { links, ..placed })
}

/// Least squares of the rows alone, from the reference. Returns the cost, mm², and the coordinates.
fn least_squares_of(problem: &Problem<'_>) -> (f64, Vec<f64>) {
    let mut rows =
        |x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>| {
            problem.evaluate(x, residuals.as_mut_slice(), jacobian);
        };
    let x0 = vec![0.0; problem.variables.len()];
    let (n_rows, options) = (problem.n_rows(), Options::default());
    let fit = minimize(&mut rows, n_rows, &x0, &options, &mut |_| {
        ControlFlow::Continue(())
    });
    (fit.cost, fit.x)
}

/// Centre of the measured positions, mm.
pub fn centre_mm(observations: &[Observation]) -> Vector3<f64> {
    let sum: Vector3<f64> = observations.iter().map(|o| o.position_mm).sum();
    sum / observations.len().max(1) as f64
}

/// Root mean square distance of the measured positions from their centre, mm.
pub fn spread_mm(observations: &[Observation], centre_mm: &Vector3<f64>) -> f64 {
    let squares = observations
        .iter()
        .map(|o| (o.position_mm - centre_mm).norm_squared());
    (squares.sum::<f64>() / observations.len().max(1) as f64).sqrt()
}

/// True if the cost of a placement is so small, relative to the spread of the points, that the placement cannot be wrong.
fn is_good(cost_mm2: f64, observations: &[Observation]) -> bool {
    let centre = centre_mm(observations);
    let spread_mm2: f64 = observations
        .iter()
        .map(|o| o.weight * (o.position_mm - centre).norm_squared())
        .sum();
    cost_mm2 <= MAX_LEFT_SHARE * MAX_LEFT_SHARE * spread_mm2
}

/// Base pose and targets in closed form, without refinement: accurate to some millimetres if the data are right. With `is_base_known` the base is
/// only shifted. `None` if there are too few points, or if they are too similar.
pub fn align_in_closed_form(
    links: &[Link],
    observations: &[Observation],
    n_targets: usize,
    is_base_known: bool,
) -> Option<KinematicModel> {
    let flanges = flanges(links, observations);
    let rotation = match is_base_known {
        true => Rotation3::identity(),
        false => linear_rotation(observations, &flanges, n_targets)?,
    };
    Some(with_rotation(
        links,
        observations,
        &flanges,
        n_targets,
        rotation,
    ))
}

/// Weight of a target's offset relative to that of the base. A common shift of base and target along parallel axes is unobservable, and
/// this weight assigns it to the base. If it were divided evenly, a target could be placed a metre off, depending on the position of the
/// instrument.
const BASE_FIRST: f64 = 100.0;
/// Singular values below this share of the largest are rounding.
const ROUNDING_SHARE: f64 = 1e-9;

/// Residuals of a closed form above this share of the points' spread indicate a wrong solution; the cube's rotations are then tried too.
/// Nominal kinematics leave less than a hundredth of the spread, even with an unmastered joint.
const MAX_LEFT_SHARE: f64 = 0.01;

/// With a given rotation, base translation and targets are linear: measured = R·A + R·B·target + t.
fn with_rotation(
    links: &[Link],
    observations: &[Observation],
    flanges: &[IsometryMatrix3<f64>],
    n_targets: usize,
    rotation: Rotation3<f64>,
) -> KinematicModel {
    let unknowns = 3 + 3 * n_targets;
    let mut normal = DMatrix::<f64>::zeros(unknowns, unknowns);
    let mut right = DVector::<f64>::zeros(unknowns);
    for (o, flange) in observations.iter().zip(flanges) {
        let b = rotation.matrix() * flange.rotation.matrix();
        let y = o.position_mm - rotation * flange.translation.vector;
        let at = 3 + 3 * o.target;
        let mut add = |row: usize, column: usize, m: &Matrix3<f64>| {
            let mut block = normal.fixed_view_mut::<3, 3>(row, column);
            block += m * o.weight;
        };
        add(0, 0, &(Matrix3::identity() * (BASE_FIRST * BASE_FIRST)));
        add(0, at, &(b * BASE_FIRST));
        add(at, 0, &(b.transpose() * BASE_FIRST));
        add(at, at, &Matrix3::identity());
        let (top, bottom) = (y * (o.weight * BASE_FIRST), b.transpose() * y * o.weight);
        (0..3).for_each(|axis| {
            right[axis] += top[axis];
            right[at + axis] += bottom[axis];
        });
    }
    let solved = normal
        .try_svd(true, true, f64::EPSILON, SVD_ITERATIONS)
        .and_then(|svd| {
            svd.solve(
                &right,
                ROUNDING_SHARE / (BASE_FIRST * BASE_FIRST) * svd.singular_values[0],
            )
            .ok()
        });
    let x = solved.unwrap_or_else(|| DVector::zeros(unknowns));
    let vector = |at: usize| Vector3::new(x[at], x[at + 1], x[at + 2]);
    KinematicModel {
        t_instrument_base: IsometryMatrix3::from_parts(
            Translation3::from(vector(0) * BASE_FIRST),
            rotation,
        ),
        links: links.to_vec(),
        targets_mm: (0..n_targets)
            .map(|target| vector(3 + 3 * target))
            .collect(),
        target_rotations: target_rotations(flanges, observations, n_targets, &rotation),
    }
}

/// Rᵀ·m − B·target − u = A is linear in the nine entries of Rᵀ, the targets and u = Rᵀ·t; the entries are then projected onto the rotations.
fn linear_rotation(
    observations: &[Observation],
    flanges: &[IsometryMatrix3<f64>],
    n_targets: usize,
) -> Option<Rotation3<f64>> {
    let unknowns = 12 + 3 * n_targets;
    if 3 * observations.len() < unknowns {
        return None;
    }
    let centroid = centre_mm(observations);
    let size = spread_mm(observations, &centroid).max(1e-9);
    let mut design = DMatrix::<f64>::zeros(3 * observations.len(), unknowns);
    let mut right = DVector::<f64>::zeros(3 * observations.len());
    for (i, (o, flange)) in observations.iter().zip(flanges).enumerate() {
        let m = (o.position_mm - centroid) / size;
        for axis in 0..3 {
            let row = 3 * i + axis;
            for k in 0..3 {
                design[(row, 3 * axis + k)] = m[k];
                design[(row, 12 + 3 * o.target + k)] = -flange.rotation.matrix()[(axis, k)];
            }
            design[(row, 9 + axis)] = -1.0;
            right[row] = flange.translation.vector[axis] / size;
        }
    }
    let svd = design.try_svd(true, true, f64::EPSILON, SVD_ITERATIONS)?;
    let x = svd.solve(&right, 1e-9 * svd.singular_values[0]).ok()?;
    let transposed = Matrix3::from_fn(|row, column| x[3 * row + column]);
    nearest_rotation(&transposed.transpose())
}

/// Evenly selected observations of each target for the closed form, which builds a dense matrix of them.
fn thinned(
    observations: &[Observation],
    flanges: &[IsometryMatrix3<f64>],
    n_targets: usize,
) -> (Vec<Observation>, Vec<IsometryMatrix3<f64>>) {
    let mut of_target = vec![Vec::new(); n_targets];
    observations
        .iter()
        .enumerate()
        .for_each(|(i, o)| of_target[o.target].push(i));
    let evenly = |rows: &Vec<usize>| -> Vec<usize> {
        rows.iter()
            .copied()
            .step_by(rows.len().div_ceil(START_OBSERVATIONS).max(1))
            .collect()
    };
    of_target
        .iter()
        .flat_map(evenly)
        .map(|i| (observations[i].clone(), flanges[i]))
        .unzip()
}

/// The rigid motion that best maps `from` to `to` (Kabsch 1976).
pub fn rigid_motion(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> IsometryMatrix3<f64> {
    let n = from.len().max(1) as f64;
    let (centre_from, centre_to) = (
        from.iter().sum::<Vector3<f64>>() / n,
        to.iter().sum::<Vector3<f64>>() / n,
    );
    let covariance: Matrix3<f64> = from
        .iter()
        .zip(to)
        .map(|(f, t)| (t - centre_to) * (f - centre_from).transpose())
        .sum();
    let rotation = nearest_rotation(&covariance).unwrap_or_else(Rotation3::identity);
    IsometryMatrix3::from_parts(
        Translation3::from(centre_to - rotation * centre_from),
        rotation,
    )
}

/// The 24 rotations that map the axes onto axes.
fn cube_rotations() -> Vec<Rotation3<f64>> {
    let units: Vec<Vector3<f64>> = (0..3)
        .flat_map(|axis| [Vector3::ith(axis, 1.0), Vector3::ith(axis, -1.0)])
        .collect();
    let mut rotations = Vec::new();
    for x in &units {
        for y in units.iter().filter(|y| x.dot(y) == 0.0) {
            rotations.push(Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[
                *x,
                *y,
                x.cross(y),
            ])));
        }
    }
    rotations
}
