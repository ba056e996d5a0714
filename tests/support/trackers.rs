//! Simulated robots that are measured with noise that differs from direction to direction: by a tracker 4 m away, or along the axes.

use super::simulation::{Normal, poses, robot_of_the_priors};
use kincal::identification::KinematicModel;
use kincal::kinematics::Robot;
use kincal::measurement::position_noise::{InstrumentNoise, PositionNoise};
use kincal::measurement::{Frame, MeasurementSet, Point};
use nalgebra::Vector3;

/// How far the tracker stands from the robot's base, mm.
const AWAY_MM: f64 = 4000.0;
/// Its noise: 0.01 mm along the beam, 0.1 mm across it at 4 m.
pub const TRACKER: InstrumentNoise = InstrumentNoise {
    range_std_mm: 0.01,
    range_std_mm_per_m: 0.0,
    angle_std_rad: 25e-6,
};
/// Noise along the axes of another instrument, mm: a camera that looks along y.
pub const CAMERA_MM: [f64; 3] = [0.02, 0.2, 0.02];
/// Poses to identify from, and others where the robot is compared with the truth.
pub const POSES: usize = 50;
pub const UNSEEN: usize = 200;

/// Whose noise it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instrument {
    Tracker,
    Camera,
}

impl Instrument {
    pub const ALL: [Self; 2] = [Self::Tracker, Self::Camera];

    pub fn name(self) -> &'static str {
        match self {
            Self::Tracker => "tracker",
            Self::Camera => "camera",
        }
    }

    /// Its noise at a position.
    pub fn noise(self, position_mm: &Vector3<f64>) -> PositionNoise {
        match self {
            Self::Tracker => TRACKER.at(position_mm, 1e-6),
            Self::Camera => PositionNoise::of_axes(Vector3::from(CAMERA_MM)),
        }
    }
}

/// A robot, the poses at which it is measured, and its points with the noise that was stated.
pub struct Measured {
    pub truth: KinematicModel,
    pub set: MeasurementSet,
    pub unseen: Vec<Vec<f64>>,
}

impl Measured {
    /// The points without a word about their noise.
    pub fn unstated(&self) -> MeasurementSet {
        let mut set = self.set.clone();
        for point in &mut set.points {
            point.position_noise = None;
        }
        set
    }

    /// Root mean square of how far a model is from the truth at the unseen poses, mm.
    pub fn error_mm(&self, model: &KinematicModel) -> f64 {
        let off = |q: &Vec<f64>| (model.position(q, 0) - self.truth.position(q, 0)).norm_squared();
        (self.unseen.iter().map(off).sum::<f64>() / self.unseen.len() as f64).sqrt()
    }
}

/// A robot with errors as the priors say, 4 m from the instrument. `robot_mm` is what the robot itself scatters by, in each coordinate.
pub fn measured(nominal: &Robot, instrument: Instrument, robot_mm: f64, seed: u64) -> Measured {
    let mut random = Normal::new(seed);
    let mut truth = robot_of_the_priors(nominal, 1, &mut random);
    let away = Vector3::new(1.0, 0.3 * random.draw(), 0.2 * random.draw()).normalize();
    truth.t_instrument_base.translation.vector = away * AWAY_MM;
    let set = points_of(
        &truth,
        instrument,
        robot_mm,
        &poses(POSES, &mut random),
        &mut random,
    );
    Measured {
        truth,
        set,
        unseen: poses(UNSEEN, &mut random),
    }
}

/// A robot's points at some poses.
pub fn points_of(
    truth: &KinematicModel,
    instrument: Instrument,
    robot_mm: f64,
    poses: &[Vec<f64>],
    random: &mut Normal,
) -> MeasurementSet {
    let points = poses.iter().enumerate().map(|(row, q_rad)| {
        let position_mm = truth.position(q_rad, 0) + random.vector() * robot_mm;
        let noise = instrument.noise(&position_mm);
        let drawn = noise.std_mm.component_mul(&random.vector());
        let position_mm = position_mm + noise.axes * drawn;
        Point {
            q_rad: q_rad.clone(),
            // as the file has it: the instrument knows its own reading alone
            position_noise: Some(instrument.noise(&position_mm)),
            position_mm,
            ..Point::empty(6, row)
        }
    });
    MeasurementSet::new(Frame::Instrument, points.collect())
}
