//! Pose plans of twenty robots against random poses of the same number, and against the best that any plan can be.

use crate::robots;
use crate::simulation::Normal;
use kincal::identification::model::identifiability::prior_scales;
use kincal::identification::model::objective::{Observation, weighted_jacobian};
use kincal::identification::model::parameters::{Parameter, complete_parameters};
use kincal::identification::statistics::workspace::random_configurations;
use kincal::identification::{KinematicModel, Model};
use kincal::kinematics::{Link, Robot, reach_mm};
use kincal::planning::{Noise, PlanRequest, Room, SetUp, plan};
use nalgebra::{DMatrix, Vector3};
use rand::RngExt;
use std::f64::consts::FRAC_PI_2;
use std::time::Instant;

const ROBOTS: usize = 20;
const POSES: [usize; 6] = [10, 12, 15, 20, 30, 50];
const TARGET_MM: Vector3<f64> = Vector3::new(80.0, 0.0, 100.0);
const NOISE_MM: f64 = 0.05;
/// Draws of random poses, of which the median counts.
const DRAWS: u64 = 20;
/// Poses that the weights are put on, and poses that the bound is proved on.
const WEIGHTED: usize = 4_000;
const PROVED_ON: usize = 20_000;
/// Rounds of the multiplicative algorithm for the first number of poses, and for each after it.
const ROUNDS: (usize, usize) = (300, 60);

/// Standard deviation of the tool over the workspace (root of the mean variance), mm.
struct Found {
    planned_mm: f64,
    random_mm: f64,
    bound_mm: f64,
    seconds: f64,
}

/// Derivatives of a robot's tool.
struct Tool<'a> {
    robot: &'a Robot,
    parameters: Vec<Parameter>,
    interest: DMatrix<f64>,
}

impl<'a> Tool<'a> {
    fn new(robot: &'a Robot) -> Self {
        let tool = Self {
            robot,
            parameters: complete_parameters(robot.links.len(), 1),
            interest: DMatrix::zeros(0, 0),
        };
        let workspace = tool.rows(&random_configurations(robot, 256, 0), 1.0);
        Self {
            interest: workspace.tr_mul(&workspace) / 256.0,
            ..tool
        }
    }

    /// Three rows a pose, by parameters in units of their priors.
    fn rows(&self, q: &[Vec<f64>], std_mm: f64) -> DMatrix<f64> {
        let model = KinematicModel {
            targets_mm: vec![TARGET_MM],
            ..KinematicModel::nominal(&self.robot.links, 0)
        };
        let seen = |q: &Vec<f64>| Observation {
            q_rad: q.clone(),
            position_mm: Vector3::zeros(),
            target: 0,
            weight: 1.0,
            whitening: None,
            rotation: None,
            station: None,
        };
        let mut rows = weighted_jacobian(
            &model,
            &self.parameters,
            &q.iter().map(seen).collect::<Vec<_>>(),
            &Vector3::zeros(),
        );
        let scales = prior_scales(&self.parameters, reach_mm(&model.links));
        rows.column_iter_mut()
            .zip(scales)
            .for_each(|(mut column, scale)| column *= scale / std_mm);
        rows
    }

    fn covariance(&self, information: DMatrix<f64>) -> DMatrix<f64> {
        let n = self.parameters.len();
        (information + DMatrix::identity(n, n))
            .cholesky()
            .unwrap()
            .inverse()
    }

    fn std_mm(&self, q: &[Vec<f64>]) -> f64 {
        let rows = self.rows(q, NOISE_MM);
        (self.covariance(rows.tr_mul(&rows)) * &self.interest)
            .trace()
            .sqrt()
    }

    fn random_mm(&self, n: usize) -> f64 {
        let mut drawn: Vec<f64> = (0..DRAWS)
            .map(|seed| self.std_mm(&random_configurations(self.robot, n, 7_000 + seed)))
            .collect();
        drawn.sort_by(f64::total_cmp);
        drawn[drawn.len() / 2]
    }

    /// Poses within the limits, every second one pushed towards them.
    fn poses(&self, n: usize, seed: u64) -> Vec<Vec<f64>> {
        let mut all = random_configurations(self.robot, n, seed);
        for q in all.iter_mut().step_by(2) {
            for (q, limits) in q.iter_mut().zip(&self.robot.joint_limits_rad) {
                let (low, high) = limits.unwrap();
                let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
                *q = middle + half * (FRAC_PI_2 * (*q - middle) / half).sin();
            }
        }
        all
    }

    /// Below this no choice of n poses gets, whole or in parts: the mean variance is convex in the weights (approximate design theory), so it
    /// falls from near the best weights no further than its steepest slope towards any one pose says (Kiefer & Wolfowitz 1960).
    fn bounds_mm(&self) -> Vec<f64> {
        let (weighted, fresh) = (
            self.rows(&self.poses(WEIGHTED, 91), NOISE_MM),
            self.rows(&self.poses(PROVED_ON, 92), NOISE_MM),
        );
        let mut weights = vec![1.0 / WEIGHTED as f64; WEIGHTED];
        let bound = |(i, n): (usize, &usize)| {
            let n = *n as f64;
            let covariance_at = |weights: &[f64]| {
                let mut scaled = weighted.clone();
                for (row, mut values) in scaled.row_iter_mut().enumerate() {
                    values *= (n * weights[row / 3]).sqrt();
                }
                self.covariance(scaled.tr_mul(&scaled))
            };
            for _ in 0..if i == 0 { ROUNDS.0 } else { ROUNDS.1 } {
                let gains = self.gains(&weighted, &covariance_at(&weights));
                weights
                    .iter_mut()
                    .zip(&gains)
                    .for_each(|(w, gain)| *w *= gain.sqrt());
                let sum: f64 = weights.iter().sum();
                weights.iter_mut().for_each(|w| *w /= sum);
            }
            let covariance = covariance_at(&weights);
            let variance = (&covariance * &self.interest).trace();
            let own = self.gains(&weighted, &covariance);
            let mean: f64 = own.iter().zip(&weights).map(|(gain, w)| gain * w).sum();
            let steepest = self
                .gains(&fresh, &covariance)
                .into_iter()
                .chain(own)
                .fold(0.0, f64::max);
            (variance - n * (steepest - mean)).max(0.0).sqrt()
        };
        // from many poses to few, each from the weights of the last
        let mut found: Vec<f64> = POSES.iter().rev().enumerate().map(bound).collect();
        found.reverse();
        found
    }

    /// tr(J·A·W·A·Jᵀ) of each pose.
    fn gains(&self, rows: &DMatrix<f64>, covariance: &DMatrix<f64>) -> Vec<f64> {
        let root = self.interest.clone().symmetric_eigen();
        let scaled = DMatrix::from_fn(
            root.eigenvectors.nrows(),
            root.eigenvectors.ncols(),
            |i, j| root.eigenvectors[(i, j)] * root.eigenvalues[j].max(0.0).sqrt(),
        );
        let seen = rows * (covariance * scaled);
        (0..rows.nrows() / 3)
            .map(|pose| seen.rows(3 * pose, 3).norm_squared())
            .collect()
    }
}

fn planned(tool: &Tool<'_>, n: usize, seed: u64) -> (f64, f64) {
    let request = PlanRequest {
        robot: tool.robot,
        model: Model::Complete,
        target_mm: TARGET_MM,
        set_ups: vec![SetUp {
            n_configurations: n,
            // as the service does it
            n_repeats: if n < 20 { 0 } else { 3 },
            room: Room::default(),
        }],
        n_candidates: 10_000,
        noise: Noise {
            position_std_mm: NOISE_MM,
            rotation_std_rad: 3e-4,
        },
        is_of_poses: false,
        seed,
        measured: vec![],
    };
    let since = Instant::now();
    let plan = plan(&request).expect("room enough");
    let seconds = since.elapsed().as_secs_f64();
    let q: Vec<Vec<f64>> = plan
        .configurations
        .into_iter()
        .map(|c| c.q_controller_rad)
        .collect();
    (tool.std_mm(&q), seconds)
}

pub fn table() {
    let models = robots::models();
    let mut all: Vec<Vec<Found>> = Vec::new();
    for i in 0..ROBOTS {
        let (name, robot) = &models[i % models.len()];
        let robot = another(robot, &mut Normal::new(500 + i as u64));
        let tool = Tool::new(&robot);
        let bounds = tool.bounds_mm();
        let found = POSES.iter().zip(bounds).map(|(n, bound_mm)| {
            let (planned_mm, seconds) = planned(&tool, *n, i as u64);
            Found {
                planned_mm,
                random_mm: tool.random_mm(*n),
                bound_mm,
                seconds,
            }
        });
        let found: Vec<Found> = found.collect();
        let gains: Vec<String> = found
            .iter()
            .map(|f| {
                format!(
                    "{:.2} of {:.2}",
                    f.random_mm / f.planned_mm,
                    f.random_mm / f.bound_mm
                )
            })
            .collect();
        eprintln!("{name:10} {}", gains.join("  "));
        all.push(found);
    }
    println!(
        "| poses | random, mm | planned, mm | gain: median (smallest to largest) | robots with 1.5 or more | gain of the bound: median (smallest to largest) | bound of 1.5 or more | seconds at most |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (k, n) in POSES.iter().enumerate() {
        let of = |value: fn(&Found) -> f64| {
            let mut values: Vec<f64> = all.iter().map(|robot| value(&robot[k])).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let spread = |v: &[f64]| {
            format!(
                "{:.2} ({:.2} to {:.2})",
                0.5 * (v[ROBOTS / 2 - 1] + v[ROBOTS / 2]),
                v[0],
                v[ROBOTS - 1]
            )
        };
        let reached = |v: &[f64]| v.iter().filter(|gain| **gain >= 1.5).count();
        let (gains, bounds) = (
            of(|f| f.random_mm / f.planned_mm),
            of(|f| f.random_mm / f.bound_mm),
        );
        let (random, planned, seconds) =
            (of(|f| f.random_mm), of(|f| f.planned_mm), of(|f| f.seconds));
        println!(
            "| {n} | {:.4} | {:.4} | {} | {} | {} | {} | {:.2} |",
            random[ROBOTS / 2],
            planned[ROBOTS / 2],
            spread(&gains),
            reached(&gains),
            spread(&bounds),
            reached(&bounds),
            seconds[ROBOTS - 1]
        );
    }
}

/// A robot of the same kind: lengths up to 20 % other, limits of 60° to 170° to both sides.
fn another(robot: &Robot, random: &mut Normal) -> Robot {
    let mut stretched = |mm: f64| mm * (0.8 + 0.4 * random.0.random::<f64>());
    let links: Vec<Link> = robot
        .links
        .iter()
        .map(|l| Link {
            a_mm: stretched(l.a_mm),
            d_mm: stretched(l.d_mm),
            ..*l
        })
        .collect();
    let limits = (0..links.len()).map(|_| {
        Some((
            -(60.0 + 110.0 * random.0.random::<f64>()),
            60.0 + 110.0 * random.0.random::<f64>(),
        ))
    });
    let limits = limits
        .map(|l| l.map(|(low, high)| (low.to_radians(), high.to_radians())))
        .collect();
    Robot {
        joint_limits_rad: limits,
        ..Robot::from_links(links)
    }
}
