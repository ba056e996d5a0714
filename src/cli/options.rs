//! Options that several commands share.

use crate::wire::job::{FinalFit, JobRequestBody, Method, Model, Preset};
use crate::wire::measurement::Frame;
use crate::wire::suspicion::Insist;

/// Interpretation of a measurement set.
#[derive(Debug, clap::Args)]
pub struct SetOptions {
    /// Frame of the measured positions.
    #[arg(long, env = "KINCAL_FRAME", value_enum, default_value_t = Frame::Base)]
    pub frame: Frame,
    /// Accept a set that the upload check refuses with this code, e.g. frame_suspect; it cannot lead to a release.
    #[arg(long, env = "KINCAL_INSIST", value_name = "CODE", value_enum)]
    pub insist: Option<Insist>,
}

/// Settings of the identification.
#[derive(Debug, clap::Args)]
pub struct IdentifyOptions {
    /// Method of identification.
    #[arg(long, env = "KINCAL_METHOD", value_enum, default_value_t = Method::Auto)]
    pub method: Method,
    /// Model whose parameters are identified [default: complete; paper with frames, and with preset paper].
    #[arg(long, env = "KINCAL_MODEL", value_enum)]
    pub model: Option<Model>,
    /// Default values of the method's options.
    #[arg(long, env = "KINCAL_PRESET", value_enum, default_value_t = Preset::Default)]
    pub preset: Preset,
    /// Points to which the delivered parameters are fitted after the verification [default: all; identify_subset with preset paper].
    #[arg(long, env = "KINCAL_FINAL_FIT", value_enum)]
    pub final_fit: Option<FinalFit>,
    /// Seed of every random number.
    #[arg(long, env = "KINCAL_SEED", default_value_t = 0)]
    pub seed: u64,
}

impl IdentifyOptions {
    /// The request of a job that identifies from this set.
    pub fn request(&self, measurement_set_id: &str) -> JobRequestBody {
        JobRequestBody {
            method: self.method,
            model: self.model,
            preset: self.preset,
            final_fit: self.final_fit,
            seed: self.seed,
            ..JobRequestBody::for_set(measurement_set_id)
        }
    }
}
