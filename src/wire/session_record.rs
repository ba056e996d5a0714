//! When, by whom and with what a session was measured: facts for quality records. The trend of a robot uses the time. No gate and no
//! evidence uses these facts, because nobody checks them.

use crate::measurement::MeasurementSet;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::robot::MAX_NAME;
use crate::wire::time::in_utc;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// When, by whom and with what a session was measured, as the upload or its points state it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionRecord {
    /// When the session was measured: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_at: Option<String>,
    /// True if the upload did not state `measured_at`: it is the earliest `measured_at` of its points.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub measured_at_of_points: bool,
    /// Instrument: maker, model, serial number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument_name: Option<String>,
    /// Certificate of the instrument: number, valid until.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument_certificate: Option<String>,
    /// Who measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
}

impl SessionRecord {
    /// Checks every value and converts the time to UTC; `None` if no value is stated.
    pub fn checked(mut self) -> Result<Option<Self>, Invalid> {
        let mut checker = Checker::default();
        for (at, text) in [
            ("/instrument_name", &self.instrument_name),
            ("/instrument_certificate", &self.instrument_certificate),
            ("/operator", &self.operator),
        ] {
            if let Some(text) = text {
                checker.text(at, text, MAX_NAME);
            }
        }
        if let Some(time) = &mut self.measured_at {
            match in_utc(time) {
                Some(utc) => *time = utc,
                None => {
                    let detail = format!(
                        "{time:?} is not a time: write date, time and offset from UTC, as in 2026-03-01T08:15:30Z"
                    );
                    checker.add("/measured_at", "not_a_time", detail);
                }
            }
        }
        checker.finish("invalid_session_record")?;
        Ok((self != Self::default()).then_some(self))
    }

    /// The record of an upload; `None` if neither the record nor a point states anything. If the record has no time, the earliest time of
    /// the points is taken.
    pub fn for_set(stated: Option<Self>, set: &MeasurementSet) -> Option<Self> {
        if stated.as_ref().is_some_and(|of| of.measured_at.is_some()) {
            return stated;
        }
        let times = set.points.iter().filter_map(|p| p.measured_at.as_deref());
        // In UTC all texts have the same length, so their alphabetical order is the order in time.
        let Some(first) = times.filter_map(in_utc).min() else {
            return stated;
        };
        Some(Self {
            measured_at: Some(first),
            measured_at_of_points: true,
            ..stated.unwrap_or_default()
        })
    }

    /// Names and values of the stated fields, for a query.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static str, String)> {
        let texts = [
            ("measured_at", &self.measured_at),
            ("instrument_name", &self.instrument_name),
            ("instrument_certificate", &self.instrument_certificate),
            ("operator", &self.operator),
        ];
        texts
            .into_iter()
            .filter_map(|(name, text)| Some((name, text.clone()?)))
    }
}
