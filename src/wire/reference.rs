//! References of a robot's instruments: lengths with a certificate, as the instrument measured them.

use crate::calibration::reference::{InstrumentScale, ReferenceLength, ScaleAtReach};
use crate::wire::issue::{Checker, Invalid};
use crate::wire::robot::MAX_NAME;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of lengths of a reference.
pub const MAX_LENGTHS: usize = 100;
/// Longest text about the instrument and its certificate.
pub const MAX_INSTRUMENT: usize = 500;
/// Largest relative difference between a measured length and its certificate. A larger one is a wrong unit or a wrong pair.
const MAX_RELATIVE_ERROR: f64 = 0.01;
/// Smallest length, mm: a short gauge block. A shorter length does not determine a scale.
const MIN_LENGTH_MM: f64 = 0.5;
const MAX_LENGTH_MM: f64 = 100_000.0;
const MIN_STD_MM: f64 = 1e-6;
const MAX_STD_MM: f64 = 10.0;
/// Name of a reference without a name.
const DEFAULT_NAME: &str = "reference";

/// A reference: a scale bar or other lengths with a certificate, and what the instrument measured of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewReference)]
pub struct ReferenceBody {
    /// Its name, default `reference`. A new reference under the same name replaces the earlier one for later uploads.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub name: Option<String>,
    /// The lengths.
    #[schema(min_items = 1, max_items = 100)]
    pub items: Vec<ReferenceLengthBody>,
    /// The instrument and its certificate, as text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 500)]
    pub instrument: Option<String>,
}

/// A length of a reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ReferenceLength)]
pub struct ReferenceLengthBody {
    /// Its name, for example that of the scale bar.
    #[schema(min_length = 1, max_length = 200)]
    pub name: String,
    /// Length of the certificate, mm.
    #[schema(minimum = 0.5, maximum = 100000)]
    pub nominal_mm: f64,
    /// Measured length, mm. It differs from `nominal_mm` by at most 1 %.
    #[schema(exclusive_minimum = 0, maximum = 101000)]
    pub measured_mm: f64,
    /// Standard uncertainty of their difference, mm: of certificate and measurement together.
    #[schema(minimum = 1e-6, maximum = 10)]
    pub std_mm: f64,
}

impl From<&ReferenceLengthBody> for ReferenceLength {
    fn from(body: &ReferenceLengthBody) -> Self {
        Self {
            nominal_mm: body.nominal_mm,
            measured_mm: body.measured_mm,
            std_mm: body.std_mm,
        }
    }
}

impl ReferenceBody {
    /// Its name.
    pub fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(DEFAULT_NAME)
    }

    /// The scale of the instrument; `None` without lengths.
    pub fn scale(&self) -> Option<InstrumentScale> {
        let lengths: Vec<ReferenceLength> = self.items.iter().map(Into::into).collect();
        InstrumentScale::of(&lengths)
    }

    /// Checks names, lengths and uncertainties.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.text("/name", self.name(), MAX_NAME);
        if let Some(instrument) = &self.instrument {
            checker.text("/instrument", instrument, MAX_INSTRUMENT);
        }
        let n = self.items.len();
        checker.within("/items", n, 1..=MAX_LENGTHS, "the number of lengths");
        for (i, item) in self.items.iter().enumerate().take(MAX_LENGTHS) {
            let at = format!("/items/{i}");
            checker.text(&format!("{at}/name"), &item.name, MAX_NAME);
            let nominal = format!("{at}/nominal_mm");
            let lengths = MIN_LENGTH_MM..=MAX_LENGTH_MM;
            checker.within(nominal, item.nominal_mm, lengths, "a length, mm");
            let is_off = (item.measured_mm / item.nominal_mm - 1.0).abs() > MAX_RELATIVE_ERROR;
            if item.nominal_mm > 0.0 && is_off {
                let detail = format!(
                    "{} mm were measured of {} mm: more than 1 % off. Check the unit, and that both are of the same length",
                    item.measured_mm, item.nominal_mm
                );
                checker.add(format!("{at}/measured_mm"), "implausible_length", detail);
            }
            let std = format!("{at}/std_mm");
            let what = "a standard uncertainty, mm";
            checker.within(std, item.std_mm, MIN_STD_MM..=MAX_STD_MM, what);
        }
        checker.finish("invalid_reference")
    }
}

/// A stored reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Reference)]
pub struct ReferenceAnswer {
    /// `ref_…`
    pub id: String,
    /// Its robot.
    pub robot_id: String,
    /// Its name.
    pub name: String,
    /// Version, from 1. Uploads that name the reference take the highest one.
    pub version: i64,
    /// The lengths.
    pub items: Vec<ReferenceLengthBody>,
    /// The instrument and its certificate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument: Option<String>,
    /// Relative error of the instrument's lengths, ppm (µm per m): positive if it measures too long.
    pub scale_error_ppm: f64,
    /// Standard uncertainty of `scale_error_ppm`.
    pub scale_std_ppm: f64,
    /// True if the error exceeds twice its standard uncertainty.
    pub is_off: bool,
    /// When it was stored.
    pub created_at: String,
}

/// The reference that an upload names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SetReference {
    /// `ref_…`
    pub id: String,
    /// Its name.
    pub name: String,
}

/// The reference of a report: the scale of the instrument that measured the points. Of several sessions it is the one with the largest error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReferenceReport {
    /// Relative error of the instrument's lengths, ppm (µm per m). The positions are not corrected for it.
    pub scale_error_ppm: f64,
    /// Standard uncertainty of `scale_error_ppm`.
    pub scale_std_ppm: f64,
    /// Standard uncertainty that error and uncertainty of the scale give at the arm's reach, mm. `tool_uncertainty_mm` contains it (root of the sum of
    /// squares).
    pub at_reach_std_mm: f64,
}

/// Parts per million.
pub const PPM: f64 = 1e6;

impl From<ScaleAtReach> for ReferenceReport {
    fn from(of: ScaleAtReach) -> Self {
        Self {
            scale_error_ppm: PPM * of.scale.error,
            scale_std_ppm: PPM * of.scale.std,
            at_reach_std_mm: of.std_mm,
        }
    }
}
