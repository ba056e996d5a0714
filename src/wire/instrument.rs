//! Noise model of a measuring instrument at the origin of the measuring frame, as stated in uploads and in the summary of a set.

use crate::measurement::columns::pose::{MAX_STD_ROTATION_RAD, MIN_STD_ROTATION_RAD};
use crate::measurement::csv::{MAX_STD_MM, MIN_STD_MM};
use crate::measurement::position_noise::InstrumentNoise;
use crate::measurement::{Frame, MeasurementSet};
use crate::wire::issue::{Invalid, Issue};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Noise and level of an instrument that measures a range and two angles, such as a laser tracker. Each noise is one standard deviation. Along the beam
/// it is `range_std_mm` + `range_std_mm_per_m` · range; across the beam it is range · `angle_std_deg`. The instrument is at the origin of the
/// measuring frame; each station has its own measuring frame. `range_std_mm` and `angle_std_deg` must be given together; `levelled` may stand alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Instrument)]
pub struct InstrumentBody {
    /// Standard uncertainty of the range, mm: the part that does not depend on the range.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1e-6, maximum = 1000)]
    pub range_std_mm: Option<f64>,
    /// Standard uncertainty of the range: the part that grows with the range, mm per m; default 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1000)]
    pub range_std_mm_per_m: Option<f64>,
    /// Standard uncertainty of each angle, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 90)]
    pub angle_std_deg: Option<f64>,
    /// True if the instrument was levelled: gravity is −z of the measuring frame. The sag of the arm is then found with the direction of gravity known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub levelled: Option<bool>,
}

/// The noise of an instrument, and where it is stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatedInstrument {
    /// The stated noise.
    pub instrument: InstrumentBody,
    /// True if it is stated in a JSON body, under `/instrument`; false if it is stated in the query parameters.
    pub in_body: bool,
}

/// Codes of issues.
const OUT_OF_RANGE: &str = "out_of_range";
const INCOMPLETE: &str = "incomplete_instrument";
const IN_BASE_FRAME: &str = "instrument_in_base_frame";
/// Code of an issue: the noise is stated both by the points and by their instrument, or twice by a point.
pub const NOISE_STATED_TWICE: &str = "noise_stated_twice";

impl InstrumentBody {
    /// From the parameters of a query; `None` if no parameter is given.
    pub fn from_parameters(
        range_std_mm: Option<f64>,
        range_std_mm_per_m: Option<f64>,
        angle_std_deg: Option<f64>,
        levelled: Option<bool>,
    ) -> Option<Self> {
        let instrument = Self {
            range_std_mm,
            range_std_mm_per_m,
            angle_std_deg,
            levelled,
        };
        (instrument != Self::default()).then_some(instrument)
    }

    /// Names and values of the given parameters, for a query.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static str, String)> {
        let noise = self.noise_numbers();
        let noise = noise.map(|(name, value)| (name, value.to_string()));
        let levelled = self.levelled;
        noise.chain(levelled.map(|levelled| ("instrument_levelled", levelled.to_string())))
    }

    /// Whether the noise of the points is that of the file, not of the instrument.
    pub fn states_no_noise(&self) -> bool {
        self.noise_numbers().next().is_none()
    }

    /// Names and values of the given noise parameters.
    fn noise_numbers(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let all = [
            ("range_std_mm", self.range_std_mm),
            ("range_std_mm_per_m", self.range_std_mm_per_m),
            ("angle_std_deg", self.angle_std_deg),
        ];
        all.into_iter()
            .filter_map(|(name, value)| Some((name, value?)))
    }
}

/// The instrument that the body states, or the one that the query parameters state.
///
/// # Errors
/// [`Invalid`] if both state an instrument.
pub fn resolve(
    body: Option<InstrumentBody>,
    in_query: Option<InstrumentBody>,
) -> Result<Option<StatedInstrument>, Invalid> {
    let stated = |in_body| {
        move |instrument| StatedInstrument {
            instrument,
            in_body,
        }
    };
    match (body, in_query) {
        (Some(_), Some(_)) => Err(Invalid::at(
            "/instrument",
            NOISE_STATED_TWICE,
            "the body states the instrument, and so do parameters beside it: leave one of them out",
        )),
        (body, in_query) => Ok(body.map(stated(true)).or(in_query.map(stated(false)))),
    }
}

impl StatedInstrument {
    /// Checks the values and converts them to the core's noise model.
    pub fn noise(&self, frame: Frame) -> Result<InstrumentNoise, Invalid> {
        let InstrumentBody {
            range_std_mm,
            range_std_mm_per_m,
            angle_std_deg,
            ..
        } = self.instrument;
        let mut issues = Vec::new();
        for (name, value, other) in [
            ("range_std_mm", range_std_mm, "angle_std_deg"),
            ("angle_std_deg", angle_std_deg, "range_std_mm"),
        ] {
            if value.is_none() {
                let detail = format!(
                    "an instrument states range_std_mm and angle_std_deg, and {name} is missing: add it, or leave {other} out and state the noise of each point (std_mm, \
                     or std_x_mm std_y_mm std_z_mm)"
                );
                issues.push(self.issue(name, INCOMPLETE, detail));
            }
        }
        let mut check = |name, value: Option<f64>, allowed: &dyn Fn(f64) -> bool, range: String| {
            if let Some(value) = value.filter(|value| !allowed(*value)) {
                issues.push(self.issue(name, OUT_OF_RANGE, format!("{value}: {range}")));
            }
        };
        check(
            "range_std_mm",
            range_std_mm,
            &|v| (MIN_STD_MM..=MAX_STD_MM).contains(&v),
            format!("a standard uncertainty is {MIN_STD_MM} to {MAX_STD_MM} mm"),
        );
        check(
            "range_std_mm_per_m",
            range_std_mm_per_m,
            &|v| (0.0..=MAX_STD_MM).contains(&v),
            format!(
                "a standard uncertainty that grows with the length is 0 to {MAX_STD_MM} mm per m"
            ),
        );
        let (least_deg, most_deg) = (
            MIN_STD_ROTATION_RAD.to_degrees(),
            MAX_STD_ROTATION_RAD.to_degrees(),
        );
        check(
            "angle_std_deg",
            angle_std_deg,
            &|v| (least_deg..=most_deg).contains(&v),
            "a standard uncertainty of an angle is above 0 and at most 90°".into(),
        );
        if frame == Frame::Base {
            let named = self.instrument.noise_numbers().next();
            let name = named.map_or("range_std_mm", |(name, _)| name);
            let detail = "range and angle are those of an instrument at the origin of the measuring frame, and these positions are in the robot's base \
                          frame: state the frame instrument and upload them as the instrument measured them, or state the noise of each point (std_x_mm \
                          std_y_mm std_z_mm)";
            issues.push(self.issue(name, IN_BASE_FRAME, detail.into()));
        }
        match (range_std_mm, angle_std_deg) {
            (Some(range_std_mm), Some(angle_std_deg)) if issues.is_empty() => Ok(InstrumentNoise {
                range_std_mm,
                range_std_mm_per_m: range_std_mm_per_m.unwrap_or(0.0),
                angle_std_rad: angle_std_deg.to_radians(),
            }),
            _ => Err(Invalid {
                code: "invalid_instrument",
                issues,
            }),
        }
    }

    /// Sets the level of a measurement set, and the noise of every point.
    ///
    /// # Errors
    /// As [`Self::noise`]; if the points state their own noise; and if a level is given for positions in the base frame.
    pub fn apply_to(&self, set: &mut MeasurementSet) -> Result<(), Invalid> {
        set.is_levelled = self.instrument.levelled == Some(true);
        if set.is_levelled && set.frame == Frame::Base {
            let detail = "a levelled instrument says where gravity is in its own frame, and these positions are in the robot's base frame: state \
                          the frame instrument and upload them as the instrument measured them, or state the robot's mounting";
            let name = match self.in_body {
                true => "levelled",
                false => "instrument_levelled",
            };
            return Err(Invalid {
                code: "invalid_instrument",
                issues: vec![self.issue(name, IN_BASE_FRAME, detail.into())],
            });
        }
        if self.instrument.states_no_noise() && self.instrument.levelled.is_some() {
            return Ok(());
        }
        self.apply_noise(set)
    }

    fn apply_noise(&self, set: &mut MeasurementSet) -> Result<(), Invalid> {
        let noise = self.noise(set.frame)?;
        let own = set
            .points
            .iter()
            .position(|p| p.std_mm.is_some() || p.position_noise.is_some());
        if let Some(row) = own {
            let column = match set.points[row].std_mm {
                Some(_) => "std_mm",
                None => "std_x_mm",
            };
            let detail = "the points state their own noise, and so does their instrument (range_std_mm, angle_std_deg): leave one of them out";
            let issue = match self.in_body {
                true => Issue::at("/instrument", NOISE_STATED_TWICE, detail),
                false => Issue {
                    row: Some(row),
                    column: Some(column.into()),
                    code: NOISE_STATED_TWICE.into(),
                    detail: detail.into(),
                    ..Issue::default()
                },
            };
            return Err(Invalid {
                code: "invalid_instrument",
                issues: vec![issue],
            });
        }
        for point in &mut set.points {
            point.position_noise = Some(noise.at(&point.position_mm, MIN_STD_MM));
        }
        Ok(())
    }

    fn issue(&self, name: &str, code: &str, detail: String) -> Issue {
        match self.in_body {
            true => Issue::at(format!("/instrument/{name}"), code, detail),
            false => Issue {
                column: Some(name.into()),
                code: code.into(),
                detail,
                ..Issue::default()
            },
        }
    }
}
