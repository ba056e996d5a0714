//! Input of a calibration: complete, and only plain data.

pub use crate::calibration::method::{
    After, CheckVerdict, CorrectionsChoice, FinalFit, Loss, Method,
};
use crate::calibration::reference::{InstrumentScale, ScaleAtReach};
use crate::calibration::validation::session_fit::HeldOut;
use crate::frames::PreliminaryFrames;
pub use crate::identification::statistics::estimate::Estimate;
pub use crate::identification::{Model, Preset};

use crate::identification::TrainedNetwork;
use crate::kinematics::{Payload, ResidualNetwork, Robot};
use crate::measurement::{Frame, MeasurementSet, Point};
use crate::solvers::median::median;

/// Which of the model's parameters are free. Names are `a_1`, `alpha_1`, `d_1`, `theta_offset_1`, `beta_1`, ….
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum ParameterChoice {
    /// All parameters of the model.
    #[default]
    All,
    /// All but these.
    Hold(Vec<String>),
    /// Only these.
    Identify(Vec<String>),
}

/// Prior knowledge of a parameter, in the unit of the report (mm or degrees).
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterPrior {
    /// Its name.
    pub name: String,
    /// One standard deviation about the mean.
    pub std: f64,
    /// Expected value; `None`: the nominal value of the report.
    pub mean: Option<f64>,
    /// Smallest value allowed.
    pub min: Option<f64>,
    /// Largest value allowed.
    pub max: Option<f64>,
}

/// Where the verify points come from.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum VerifySource {
    /// The `subset` column if there is one, else a seeded half by configuration.
    #[default]
    Default,
    /// The `subset` column.
    Subset,
    /// A seeded share of the configurations.
    Fraction(f64),
    /// Another set of the same robot.
    Set(MeasurementSet),
}

/// Search options; `None` takes the preset's value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SearchOptions {
    /// Particles in the swarm.
    pub n_particles: Option<usize>,
    /// Limit of swarm updates.
    pub n_iterations: Option<usize>,
    /// w of [Gao 2018, eq. 9].
    pub inertia_weight: Option<f64>,
    /// c1 of [Gao 2018, eq. 9].
    pub cognitive: Option<f64>,
    /// c2 of [Gao 2018, eq. 9].
    pub social: Option<f64>,
    /// Half-width of the search box for lengths, mm.
    pub search_half_width_mm: Option<f64>,
    /// Half-width of the search box for angles, degrees.
    pub search_half_width_deg: Option<f64>,
    /// Stop once F on the identify subset is at or below this, mm².
    pub stop_at_cost_mm2: Option<f64>,
    /// Loss of a residual.
    pub loss: Option<Loss>,
}

/// One calibration, complete.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationRequest {
    /// The robot with its nominal links.
    pub robot: Robot,
    /// The measured points.
    pub set: MeasurementSet,
    /// The sessions that `set` joins ([`crate::measurement::sessions`]), as each was uploaded; empty for a single upload.
    pub sessions: Vec<MeasurementSet>,
    /// Noise of each session, estimated from the session alone: standard deviation of a coordinate of a point of weight 1, mm. Empty: all
    /// sessions count alike.
    pub session_noise_mm: Vec<f64>,
    /// Method of identification.
    pub method: Method,
    /// Model to identify; `None`: complete for a set with poses, else [`default_model`].
    pub model: Option<Model>,
    /// Source of unset options.
    pub preset: Preset,
    /// Free parameters.
    pub parameters: ParameterChoice,
    /// Priors of the parameters.
    pub priors: Vec<ParameterPrior>,
    /// Base and tool frame from sweeps, for `model: paper` on a set in the instrument frame.
    pub frames: Option<PreliminaryFrames>,
    /// The robot's trained network. It is used by `bpnn_pso`, and by `auto` if least squares from nominal does not find the robot.
    pub network: Option<TrainedNetwork>,
    /// Seed of every random number.
    pub seed: u64,
    /// Levenberg-Marquardt after the swarm; `None` takes the preset's value.
    pub refine: Option<bool>,
    /// Where the verify points come from.
    pub verify: VerifySource,
    /// Search options.
    pub options: SearchOptions,
    /// Points that the delivered parameters are fitted to. `None`: all points, except that it is the identify subset with the paper's preset
    /// and for a swarm that is not refined.
    pub final_fit: Option<FinalFit>,
    /// Whether corrections are searched; `None`: yes, except in the paper's preset.
    pub corrections: Option<CorrectionsChoice>,
    /// Payload on the flange during the measurement, if known.
    pub payload: Option<Payload>,
    /// Frame in which the verified parameter set was measured; `None` if nothing is verified.
    pub scored_frame: Option<Frame>,
    /// Scale of the instrument that measured the points, if lengths with a certificate were measured with it.
    pub instrument_scale: Option<InstrumentScale>,
    /// Errors of the verified parameter set on its own held-out points: the reference for judging whether a session fits the robot.
    pub held_out: Option<HeldOut>,
    /// Code with which an upload of the request was refused; set if the uploader insisted on it.
    pub refused_as: Option<String>,
    /// Names the columns of the files that are not read although they may identify the reflector or the set-up of a row.
    pub unread_labels: Option<String>,
    /// Residual network of the robot's last identification. Training of a new one starts from it.
    pub residual_network: Option<ResidualNetwork>,
    /// Session of the robot's last identification, for comparison.
    pub previous: Option<PreviousSession>,
}

/// An earlier session of the same robot.
#[derive(Clone, Debug, PartialEq)]
pub struct PreviousSession {
    /// Its points.
    pub set: MeasurementSet,
    /// The preliminary frames of its identification.
    pub frames: Option<PreliminaryFrames>,
    /// The stored estimate of its identification, if there is one.
    pub estimate: Option<Estimate>,
}

impl CalibrationRequest {
    /// Median of the stated standard uncertainties of one coordinate of a position, mm. A point that states none counts as 0.
    pub fn stated_position_std_mm(&self) -> f64 {
        let stated = self.set.points.iter().map(Point::position_std_mm);
        median(stated.map(|std_mm| std_mm.unwrap_or(0.0))).unwrap_or(0.0)
    }

    /// A request with every default, for `robot` and `set`.
    pub fn new(robot: Robot, set: MeasurementSet) -> Self {
        Self {
            robot,
            set,
            sessions: vec![],
            session_noise_mm: vec![],
            method: Method::Auto,
            model: None,
            preset: Preset::Default,
            parameters: ParameterChoice::All,
            priors: vec![],
            frames: None,
            network: None,
            seed: 0,
            refine: None,
            verify: VerifySource::Default,
            options: SearchOptions::default(),
            final_fit: None,
            corrections: None,
            payload: None,
            scored_frame: None,
            instrument_scale: None,
            held_out: None,
            refused_as: None,
            unread_labels: None,
            residual_network: None,
            previous: None,
        }
    }

    /// The uploads that are fitted, each as it was measured.
    pub fn uploads(&self) -> &[MeasurementSet] {
        match self.sessions.as_slice() {
            [] => std::slice::from_ref(&self.set),
            sessions => sessions,
        }
    }

    /// The scale of the instrument, and its effect at the robot's reach.
    pub fn scale_at_reach(&self) -> Option<ScaleAtReach> {
        let scale = self.instrument_scale?;
        Some(ScaleAtReach::new(scale, &self.robot.links))
    }

    /// The model that is identified: the requested one, or [`default_model`].
    pub fn model(&self) -> Model {
        let default = match self.set.has_poses() {
            true => Model::Complete,
            false => default_model(self.preset, self.set.frame, self.frames.is_some()),
        };
        self.model.unwrap_or(default)
    }
}

/// The default model. It is the paper's if there are sweeps, or in the base frame with the paper's preset; otherwise the complete one.
pub fn default_model(preset: Preset, frame: Frame, has_frames: bool) -> Model {
    if has_frames || (preset == Preset::Paper && frame == Frame::Base) {
        Model::Paper
    } else {
        Model::Complete
    }
}
