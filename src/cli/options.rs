//! Options that several commands share.

use crate::wire::job::{JobRequestBody, Method, Model, Preset};
use crate::wire::measurement::{Frame, Insist};

/// How a measurement set is understood.
#[derive(Debug, clap::Args)]
pub struct SetOptions {
    /// Frame of the measured positions.
    #[arg(long, env = "KINCAL_FRAME", value_enum, default_value_t = Frame::Base)]
    pub frame: Frame,
    /// Go on with a set that the check of uploads refuses with this code, e.g. frame_suspect; no release rests on it.
    #[arg(long, env = "KINCAL_INSIST", value_name = "CODE", value_enum)]
    pub insist: Option<Insist>,
}

/// How parameters are identified.
#[derive(Debug, clap::Args)]
pub struct IdentifyOptions {
    /// How.
    #[arg(long, env = "KINCAL_METHOD", value_enum, default_value_t = Method::Auto)]
    pub method: Method,
    /// Which parameters exist [default: paper for frame base, else complete].
    #[arg(long, env = "KINCAL_MODEL", value_enum)]
    pub model: Option<Model>,
    /// Where options come from.
    #[arg(long, env = "KINCAL_PRESET", value_enum, default_value_t = Preset::Default)]
    pub preset: Preset,
    /// Seed of every random number.
    #[arg(long, env = "KINCAL_SEED", default_value_t = 0)]
    pub seed: u64,
}

impl IdentifyOptions {
    /// The request for a job that identifies from this set.
    pub fn request(&self, measurement_set_id: &str) -> JobRequestBody {
        JobRequestBody {
            method: self.method,
            model: self.model,
            preset: self.preset,
            seed: self.seed,
            ..JobRequestBody::for_set(measurement_set_id)
        }
    }
}
