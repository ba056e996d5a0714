//! Options that several commands share.

use super::numbers;
use crate::wire::corrections::PayloadBody;
use crate::wire::instrument::InstrumentBody;
use crate::wire::job::{
    CorrectionsChoice, FinalFit, JobRequestBody, Method, Model, ParametersBody, Preset, Prior,
    VerifyBody,
};
use crate::wire::measurement::Frame;
use crate::wire::session_record::SessionRecord;
use crate::wire::suspicion::Insist;
use std::path::PathBuf;

/// Interpretation of a measurement set.
#[derive(Debug, clap::Args)]
pub struct SetOptions {
    /// Frame of the measured positions.
    #[arg(long, env = "KINCAL_FRAME", value_enum, default_value_t = Frame::Base)]
    pub frame: Frame,
    /// Accept a set that the upload check refuses with this code, e.g. frame_suspect. Parameters that are identified from it cannot be released.
    #[arg(long, env = "KINCAL_INSIST", value_name = "CODE", value_enum)]
    pub insist: Option<Insist>,
    #[command(flatten)]
    pub noise: NoiseOptions,
    #[command(flatten)]
    pub record: RecordOptions,
    /// The poses are those of a fixed board as a camera on the arm sees it: invert them; with --frame instrument.
    #[arg(long, env = "KINCAL_INVERSE_POSES", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    pub inverse_poses: bool,
}

/// When, by whom and with what a session was measured, for its report.
#[derive(Debug, clap::Args)]
pub struct RecordOptions {
    /// When the session was measured, e.g. 2026-03-01T08:15:30Z.
    #[arg(long, env = "KINCAL_MEASURED_AT", value_name = "TIME")]
    pub measured_at: Option<String>,
    /// Instrument: maker, model, serial number.
    #[arg(long, env = "KINCAL_INSTRUMENT_NAME", value_name = "TEXT")]
    pub instrument_name: Option<String>,
    /// Certificate of the instrument: number, valid until.
    #[arg(long, env = "KINCAL_INSTRUMENT_CERTIFICATE", value_name = "TEXT")]
    pub instrument_certificate: Option<String>,
    /// Who measured.
    #[arg(long, env = "KINCAL_OPERATOR", value_name = "TEXT")]
    pub operator: Option<String>,
}

impl RecordOptions {
    /// The record with the stated options.
    pub fn record(&self) -> SessionRecord {
        SessionRecord {
            measured_at: self.measured_at.clone(),
            measured_at_of_points: false,
            instrument_name: self.instrument_name.clone(),
            instrument_certificate: self.instrument_certificate.clone(),
            operator: self.operator.clone(),
        }
    }
}

/// Noise and level of an instrument at the origin of the measuring frame.
#[derive(Debug, clap::Args)]
pub struct NoiseOptions {
    /// Standard uncertainty of a length that a tracker at the frame's origin measures, mm; with --angle-std-deg and --frame instrument.
    #[arg(long, env = "KINCAL_RANGE_STD_MM", value_name = "MM")]
    pub range_std_mm: Option<f64>,
    /// Part of that uncertainty that grows with the length, mm per m [default: 0].
    #[arg(long, env = "KINCAL_RANGE_STD_MM_PER_M", value_name = "MM")]
    pub range_std_mm_per_m: Option<f64>,
    /// Standard uncertainty of each of the tracker's angles, degrees.
    #[arg(long, env = "KINCAL_ANGLE_STD_DEG", value_name = "DEG")]
    pub angle_std_deg: Option<f64>,
    /// The instrument was levelled: gravity is −z of its frame; with --frame instrument.
    #[arg(long, env = "KINCAL_INSTRUMENT_LEVELLED")]
    pub instrument_levelled: bool,
}

impl NoiseOptions {
    /// The instrument, if one is stated.
    pub fn instrument(&self) -> Option<InstrumentBody> {
        InstrumentBody::from_parameters(
            self.range_std_mm,
            self.range_std_mm_per_m,
            self.angle_std_deg,
            self.instrument_levelled.then_some(true),
        )
    }
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
    /// Parameters to hold at nominal, with commas, e.g. a_1,theta_offset_3.
    #[arg(
        long,
        env = "KINCAL_HOLD",
        value_name = "NAMES",
        value_delimiter = ',',
        conflicts_with = "only"
    )]
    pub hold: Vec<String>,
    /// The only parameters to identify, with commas.
    #[arg(
        id = "only",
        long = "identify",
        env = "KINCAL_IDENTIFY",
        value_name = "NAMES",
        value_delimiter = ','
    )]
    pub only: Vec<String>,
    /// Prior of a parameter, in mm or degrees: NAME=STD, the standard deviation around nominal, and optionally :mean=X, :min=X and :max=X. These are
    /// values of the parameter itself, not of its change, e.g. a_2=0.1 or, for a link of 330 mm, a_2=0.1:mean=330.2:min=329:max=331. Once per
    /// parameter.
    #[arg(long, env = "KINCAL_PRIOR", value_name = "PRIOR", value_parser = prior, value_delimiter = ',', allow_hyphen_values = true)]
    pub prior: Vec<Prior>,
    /// Corrections beyond link parameters [default: auto; off with preset paper].
    #[arg(long, env = "KINCAL_CORRECTIONS", value_enum)]
    pub corrections: Option<CorrectionsChoice>,
    /// Mass on the flange while it was measured, and optionally its centre in the flange frame: KG or KG,X,Y,Z with mm.
    #[arg(long, env = "KINCAL_PAYLOAD", value_name = "KG,X,Y,Z", value_parser = payload, allow_hyphen_values = true)]
    pub payload: Option<PayloadBody>,
    /// Share of the configurations to hold out for the verification, between 0 and 1 [default: the subset column, else 0.5].
    #[arg(long, env = "KINCAL_VERIFY_FRACTION", value_name = "SHARE")]
    pub verify_fraction: Option<f64>,
}

/// Parses a prior: its name and standard deviation, then other fields.
fn prior(text: &str) -> Result<Prior, String> {
    let wrong = || "NAME=STD, and optionally :mean=X, :min=X and :max=X".to_owned();
    let mut parts = text.split(':');
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wrong());
    let (name, std) = parts
        .next()
        .and_then(|first| first.split_once('='))
        .ok_or_else(wrong)?;
    let mut prior = Prior {
        name: name.trim().into(),
        std: number(std)?,
        mean: None,
        min: None,
        max: None,
    };
    for part in parts {
        let (field, value) = part.split_once('=').ok_or_else(wrong)?;
        let value = Some(number(value)?);
        match field.trim() {
            "mean" => prior.mean = value,
            "min" => prior.min = value,
            "max" => prior.max = value,
            _ => return Err(wrong()),
        }
    }
    Ok(prior)
}

/// Parses a payload: its mass, and optionally its centre.
fn payload(text: &str) -> Result<PayloadBody, String> {
    let (mass_kg, centre_mm) = match numbers::all(text).as_deref() {
        Some([mass_kg]) => (*mass_kg, [0.0; 3]),
        Some([mass_kg, x, y, z]) => (*mass_kg, [*x, *y, *z]),
        _ => return Err("a mass in kg, or KG,X,Y,Z with the centre in mm".into()),
    };
    Ok(PayloadBody { mass_kg, centre_mm })
}

/// Further sessions of a job.
#[derive(Debug, clap::Args)]
pub struct SessionOptions {
    /// A further session of the same robot, with its own base, targets and noise; may be given several times. All sessions are fitted together. They
    /// are refused if the robot has changed between them.
    #[arg(
        long,
        env = "KINCAL_SESSION",
        value_name = "SET.csv",
        value_delimiter = ',',
        conflicts_with_all = ["instrument_export", "instrument"]
    )]
    pub session: Vec<PathBuf>,
}

impl IdentifyOptions {
    /// The request of a job that identifies from these sets: one, or those of several sessions.
    pub fn request(&self, measurement_set_ids: &[String]) -> JobRequestBody {
        let of_sets = match measurement_set_ids {
            [id] => JobRequestBody::for_set(id),
            several => JobRequestBody::for_sets(several.to_vec()),
        };
        JobRequestBody {
            method: self.method,
            model: self.model,
            preset: self.preset,
            final_fit: self.final_fit,
            seed: self.seed,
            parameters: self.parameters(),
            corrections: self.corrections,
            payload: self.payload,
            verify: self
                .verify_fraction
                .map(|fraction| VerifyBody::Fraction { fraction }),
            ..of_sets
        }
    }

    fn parameters(&self) -> Option<ParametersBody> {
        fn given<T: Clone>(list: &[T]) -> Option<Vec<T>> {
            (!list.is_empty()).then(|| list.to_vec())
        }
        let parameters = ParametersBody {
            hold: given(&self.hold),
            identify: given(&self.only),
            rest: None,
            priors: given(&self.prior),
        };
        (parameters != ParametersBody::default()).then_some(parameters)
    }
}

#[cfg(test)]
mod tests {
    use super::{payload, prior};

    #[test]
    fn priors_and_payloads_are_read_as_they_are_written() {
        let read = prior("a_2=0.1:mean=-0.3:max=1").unwrap();
        assert_eq!((read.name.as_str(), read.std), ("a_2", 0.1));
        assert_eq!(
            (read.mean, read.min, read.max),
            (Some(-0.3), None, Some(1.0))
        );
        for wrong in ["a_2", "a_2=x", "a_2=1:mode=2", "a_2=1:mean"] {
            assert!(prior(wrong).is_err(), "{wrong}");
        }
        assert_eq!(payload("12.5").unwrap().centre_mm, [0.0; 3]);
        assert_eq!(payload("5,0,-10,80").unwrap().centre_mm, [0.0, -10.0, 80.0]);
        assert!(payload("5,1").is_err());
    }
}
