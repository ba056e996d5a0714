//! Forecast of the next calibration: a straight line through the errors of the released parameter set over time.

use crate::identification::statistics::distributions::t_half_width;
use crate::wire::history::Trend;
use crate::wire::time::epoch_ms;
use crate::wire::understood::Reading;
use crate::wire::verification::{Fit, Verification, VerificationKind};
use std::collections::BTreeSet;

/// Maximum number of sessions in a trend; older ones are left out.
const MAX_SESSIONS: usize = 200;
/// Milliseconds of a day.
const DAY_MS: f64 = 86_400_000.0;
/// Minimum number of sessions of a trend: the line has two parameters, and its interval needs more points than that.
const MIN_SESSIONS: usize = 4;
/// Shortest time between the first and the last session, days.
const MIN_DAYS: f64 = 1.0;
/// Confidence of the stated interval.
const CONFIDENCE: f64 = 0.95;
/// Growth of the error that counts as drift if the robot's policy has no tolerance.
pub const GROWTH: f64 = 1.5;
/// Longest forecast, days.
const MAX_DAYS: f64 = 3_650.0;

/// The error of a session and its day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredSession {
    /// Days since a fixed moment.
    pub day: f64,
    /// The error, mm.
    pub rms_mm: f64,
}

/// A job that scored the released set.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoredJob {
    /// When its points were measured ([`measured_at_ms`]), milliseconds since the epoch.
    pub measured_at_ms: i64,
    /// Its measurement set.
    pub measurement_set_id: String,
    /// Its verification facts.
    pub verification: Verification,
}

/// Time of measurement that the uploader stated. It is shown, and the trend uses it. No gate uses it, because nobody checks it.
pub fn stated_time(reading_json: Option<&str>) -> Option<String> {
    let reading: Reading = serde_json::from_str(reading_json?).ok()?;
    reading.record?.measured_at
}

/// The time of measurement that was stated for an upload, or else the time at which it was stored; milliseconds since the epoch.
pub fn measured_at_ms(reading_json: Option<&str>, uploaded_at_ms: i64) -> i64 {
    let stated = stated_time(reading_json);
    let stated_ms = stated.and_then(|time| epoch_ms(&time));
    stated_ms.unwrap_or(uploaded_at_ms)
}

/// Whether a released set can have a trend after this number of later sessions. Its own held-out points count as one more session.
pub fn may_have_trend(n_later_sessions: i64) -> bool {
    n_later_sessions + 1 >= MIN_SESSIONS as i64
}

/// The errors of the released set on its own held-out points and on later sessions; the newest `MAX_SESSIONS` if there are more. `own_uploads` are
/// the uploads with which the set was identified and verified. Each upload counts once, with its first score. Points that do not fit the robot do not
/// count.
pub fn scored_sessions(jobs: &[ScoredJob], own_uploads: &[String]) -> Vec<ScoredSession> {
    let mut uploads: BTreeSet<&str> = own_uploads.iter().map(String::as_str).collect();
    let mut scored = Vec::new();
    for job in jobs {
        let found = &job.verification;
        if found.kind == VerificationKind::Session && !uploads.insert(&job.measurement_set_id) {
            continue;
        }
        let counts = found.fit != Fit::DoesNotFit && found.n_points > 0;
        let rms_mm = found.after_rms_mm.filter(|_| counts);
        scored.extend(rms_mm.map(|rms_mm| ScoredSession {
            day: job.measured_at_ms as f64 / DAY_MS,
            rms_mm,
        }));
    }
    // Sessions from before the identification show nothing about the robot since then.
    let mut own = jobs
        .iter()
        .filter(|job| job.verification.kind != VerificationKind::Session);
    if let Some(own) = own.next() {
        let own_day = own.measured_at_ms as f64 / DAY_MS;
        scored.retain(|session: &ScoredSession| session.day >= own_day);
    }
    scored.sort_by(|a, b| a.day.total_cmp(&b.day));
    let newest = scored.len().saturating_sub(MAX_SESSIONS);
    scored.split_off(newest)
}

/// The straight line through the errors by least squares. `limit_mm` comes from the robot's policy, if it has one.
pub fn trend(scored: &[ScoredSession], limit_mm: Option<f64>) -> Trend {
    let mut scored = scored.to_vec();
    scored.sort_by(|a, b| a.day.total_cmp(&b.day));
    let n = scored.len() as f64;
    let none = |detail: String| Trend {
        n_sessions: scored.len(),
        rms_mm_per_day: None,
        interval_95: None,
        limit_mm,
        days_to_limit: None,
        detail,
    };
    let Some((first, last)) = scored.first().zip(scored.last()) else {
        return none("not enough data: no released parameter set, or it was never scored".into());
    };
    let span = last.day - first.day;
    if scored.len() < MIN_SESSIONS || span < MIN_DAYS {
        let sessions = if scored.len() == 1 {
            "1 session".into()
        } else {
            format!("{} sessions over {span:.1} days", scored.len())
        };
        return none(format!(
            "not enough data: {sessions}; a trend takes {MIN_SESSIONS} over a day at least. Verify the released set on new points"
        ));
    }
    let limit = limit_mm.unwrap_or(GROWTH * first.rms_mm);
    let (mean_day, mean_mm) = (
        scored.iter().map(|s| s.day).sum::<f64>() / n,
        scored.iter().map(|s| s.rms_mm).sum::<f64>() / n,
    );
    let spread: f64 = scored
        .iter()
        .map(|s| (s.day - mean_day) * (s.day - mean_day))
        .sum();
    let slope = scored
        .iter()
        .map(|s| (s.day - mean_day) * (s.rms_mm - mean_mm))
        .sum::<f64>()
        / spread;
    let residual = |s: &ScoredSession| s.rms_mm - mean_mm - slope * (s.day - mean_day);
    let variance = scored
        .iter()
        .map(|s| residual(s) * residual(s))
        .sum::<f64>()
        / (n - 2.0);
    let half_width = t_half_width(CONFIDENCE, n - 2.0) * (variance / spread).sqrt();
    let at_last = mean_mm + slope * (last.day - mean_day);
    let days = ((limit - at_last) / slope).max(0.0);
    let grows = slope - half_width > 0.0;
    let days_to_limit = (grows && days <= MAX_DAYS).then_some(days);
    let detail = match (grows, days_to_limit) {
        (false, _) => format!("the error does not grow beyond chance over {span:.0} days"),
        (true, Some(days)) if days > 0.0 => format!(
            "at this rate the error reaches {limit:.3} mm in {days:.0} days: calibrate before"
        ),
        (true, Some(_)) => format!("the error has reached {limit:.3} mm: calibrate now"),
        (true, None) => {
            format!("the error grows, but will not reach {limit:.3} mm within ten years")
        }
    };
    Trend {
        n_sessions: scored.len(),
        rms_mm_per_day: Some(slope),
        interval_95: Some([slope - half_width, slope + half_width]),
        limit_mm: Some(limit),
        days_to_limit,
        detail,
    }
}
