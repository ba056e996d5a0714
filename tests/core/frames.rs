//! Preliminary frames from sweeps: compared with the known truth and with planted robots; refused sweeps.

use crate::data::{paper_path, paper_robot};
use kincal::frames::{Error, PreliminaryFrames, preliminary_frames};
use kincal::identification::KinematicModel;
use kincal::kinematics::Robot;
use kincal::measurement::table::own_form;
use kincal::measurement::{Frame, MeasurementSet, Point};
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Noise of `sweeps_instrument.csv`, mm per axis (`sweeps_truth.json`).
const SWEEP_NOISE_MM: f64 = 0.005;
/// Limit in standard deviations of the simulated errors: one of 15,000 normal draws exceeds it.
const SIGMAS: f64 = 4.0;

fn sweeps() -> MeasurementSet {
    own_form::parse(
        &std::fs::read(paper_path("sweeps_instrument.csv")).unwrap(),
        Frame::Instrument,
        6,
    )
    .unwrap()
}

fn truth() -> (IsometryMatrix3<f64>, f64) {
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(paper_path("sweeps_truth.json")).unwrap()).unwrap();
    let rotation = Matrix3::from_fn(|row, column| json["rotation"][row][column].as_f64().unwrap());
    let translation = Vector3::from_fn(|axis, _| json["translation_mm"][axis].as_f64().unwrap());
    let t = IsometryMatrix3::from_parts(
        Translation3::from(translation),
        Rotation3::from_matrix_unchecked(rotation),
    );
    (t, json["z_t_mm"].as_f64().unwrap())
}

/// The same sweeps measured on a known robot, with fresh noise.
fn simulated(
    robot: &Robot,
    truth: &(IsometryMatrix3<f64>, f64),
    like: &MeasurementSet,
    noise_mm: f64,
    seed: u64,
) -> MeasurementSet {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // The sum of twelve uniform numbers is nearly normal (Irwin-Hall).
    let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    let model = KinematicModel {
        t_instrument_base: truth.0,
        links: robot.links.clone(),
        targets_mm: vec![Vector3::new(0.0, 0.0, truth.1)],
        target_rotations: vec![],
    };
    let measured = |p: &Point| {
        let noise = Vector3::new(normal(), normal(), normal()) * noise_mm;
        Point {
            position_mm: model.position(&robot.q_model_rad(&p.q_rad), 0) + noise,
            ..p.clone()
        }
    };
    MeasurementSet::new(
        Frame::Instrument,
        like.points.clone().iter().map(measured).collect(),
    )
}

/// Errors against the truth: base origin, mm; base rotation, rad; z_t, mm.
fn misses(found: &PreliminaryFrames, truth: &(IsometryMatrix3<f64>, f64)) -> [f64; 3] {
    let turn = found.t_instrument_base.rotation.inverse() * truth.0.rotation;
    let origin = found.t_instrument_base.translation.vector - truth.0.translation.vector;
    // For a small angle the skew part is the rotation vector; the arc cosine would lose half of the digits.
    let m = turn.matrix();
    let skew = Vector3::new(
        m[(2, 1)] - m[(1, 2)],
        m[(0, 2)] - m[(2, 0)],
        m[(1, 0)] - m[(0, 1)],
    ) / 2.0;
    [
        origin.norm(),
        skew.norm(),
        (found.z_tool_mm - truth.1).abs(),
    ]
}

#[test]
fn the_measured_sweeps_give_base_pose_and_z_t_within_what_their_noise_allows() {
    let (robot, like, truth) = (paper_robot(), sweeps(), truth());
    let found = misses(&preliminary_frames(&robot, &like).unwrap(), &truth);
    let runs: Vec<[f64; 3]> = (0..200)
        .map(|seed| {
            misses(
                &preliminary_frames(
                    &robot,
                    &simulated(&robot, &truth, &like, SWEEP_NOISE_MM, seed),
                )
                .unwrap(),
                &truth,
            )
        })
        .collect();
    for (k, what) in ["base origin, mm", "base rotation, rad", "z_t, mm"]
        .into_iter()
        .enumerate()
    {
        let rms = (runs.iter().map(|run| run[k] * run[k]).sum::<f64>() / runs.len() as f64).sqrt();
        println!(
            "{what}: off by {:.2e}; noise of {SWEEP_NOISE_MM} mm allows {rms:.2e} rms over 200 simulated sweeps",
            found[k]
        );
        assert!(
            found[k] <= SIGMAS * rms,
            "{what}: {} against {rms}",
            found[k]
        );
    }
}

#[test]
fn noiseless_sweeps_of_other_robots_are_solved_exactly() {
    let truth = truth();
    let mut intersecting = paper_robot();
    intersecting.links[1].a_mm = 0.0;
    let mut mirrored = paper_robot();
    mirrored.links[1].alpha_rad = -mirrored.links[1].alpha_rad;
    mirrored.links[0] = kincal::kinematics::Link {
        a_mm: 30.0,
        alpha_rad: 0.2,
        d_mm: 400.0,
        theta_offset_rad: 0.5,
        beta_rad: 0.0,
    };
    let mut reversed = paper_robot();
    reversed.joint_map = Some(kincal::kinematics::JointMap {
        sign: vec![-1.0, -1.0, 1.0, 1.0, -1.0, 1.0],
        offset_rad: vec![0.1, 0.0, 0.0, 0.0, 0.2, 0.0],
        coupling: nalgebra::DMatrix::identity(6, 6),
    });
    for robot in [intersecting, mirrored, reversed] {
        let set = simulated(&robot, &truth, &sweeps(), 0.0, 0);
        let [origin, rotation, z_t] = misses(&preliminary_frames(&robot, &set).unwrap(), &truth);
        // Circles of a metre, fitted to rounding.
        assert!(
            origin < 1e-6 && rotation < 1e-9 && z_t < 1e-6,
            "{origin} {rotation} {z_t}"
        );
    }
}

fn without(set: &MeasurementSet, keep: impl Fn(&Point) -> bool) -> MeasurementSet {
    MeasurementSet::new(
        set.frame,
        set.points.iter().filter(|p| keep(p)).cloned().collect(),
    )
}

#[test]
fn sweeps_that_the_nominal_robot_does_not_come_near_are_refused() {
    let (robot, set) = (paper_robot(), sweeps());
    type Change = fn(&Vector3<f64>) -> Vector3<f64>;
    let changes: [(&str, Change); 4] = [
        ("metres", |p| p / 1000.0),
        ("mirrored", |p| Vector3::new(p.x, p.y, -p.z)),
        ("a scale of 1.05", |p| p * 1.05),
        ("axes exchanged", |p| Vector3::new(p.y, p.x, p.z)),
    ];
    for (what, change) in changes {
        let mut set = set.clone();
        set.points
            .iter_mut()
            .for_each(|p| p.position_mm = change(&p.position_mm));
        let refused = preliminary_frames(&robot, &set).unwrap_err();
        assert_eq!(refused.code(), "far_from_nominal", "{what}: {refused}");
    }
}

#[test]
fn unusable_sweeps_are_refused_with_their_reason() {
    let (robot, set) = (paper_robot(), sweeps());
    let code =
        |robot: &Robot, set: &MeasurementSet| preliminary_frames(robot, set).unwrap_err().code();
    assert_eq!(
        code(&robot, &without(&set, |p| p.sweep_joint != Some(2))),
        "missing_sweep"
    );
    assert_eq!(
        code(
            &robot,
            &without(&set, |p| p.sweep_joint != Some(1) || p.q_rad[0].abs() < 0.3)
        ),
        "too_few_points"
    );
    let first = |p: &Point| p.sweep_joint != Some(2) || p.q_rad[1] < -0.5;
    assert!(matches!(
        preliminary_frames(&robot, &without(&set, first)),
        Err(Error::ShortArc { joint: 2, .. })
    ));
    let mut parallel = paper_robot();
    parallel.links[1].alpha_rad = 0.0;
    let measured = simulated(&parallel, &truth(), &set, 0.0, 0);
    assert_eq!(code(&parallel, &measured), "parallel_axes");
    let mut mislabelled = set.clone();
    mislabelled.points.iter_mut().for_each(|p| {
        p.sweep_joint = if p.sweep_joint == Some(1) {
            Some(2)
        } else {
            p.sweep_joint
        }
    });
    assert_eq!(code(&robot, &mislabelled), "missing_sweep");
    let mut moved = set.clone();
    moved.points[3].q_rad[3] += 0.01;
    assert_eq!(code(&robot, &moved), "other_joint_moved");
    let mut stretched = set.clone();
    stretched
        .points
        .iter_mut()
        .filter(|p| p.sweep_joint == Some(5))
        .for_each(|p| p.q_rad[4] *= 0.5);
    assert_eq!(code(&robot, &stretched), "arc_mismatch");
}
