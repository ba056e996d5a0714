//! Counters of this process, in Prometheus's text format.

use axum::http::{Method, StatusCode};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Upper bounds of the histogram of answer times, s.
const BOUNDS_S: [f64; 9] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 1.0, 10.0];

/// Counts since the process started. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Metrics(Arc<Mutex<Counts>>);

#[derive(Debug, Default)]
struct Counts {
    requests: BTreeMap<(&'static str, String, u16), u64>,
    durations: BTreeMap<String, Histogram>,
    errors: BTreeMap<String, u64>,
}

#[derive(Clone, Debug, Default)]
struct Histogram {
    at_most: [u64; BOUNDS_S.len()],
    count: u64,
    sum_s: f64,
}

impl Metrics {
    /// Counts one answer. `route` is a template, so that the number of series is bounded.
    pub fn record_answer(
        &self,
        method: &Method,
        route: &str,
        status: StatusCode,
        code: Option<&str>,
        duration: Duration,
    ) {
        let method = ["GET", "HEAD", "POST"]
            .into_iter()
            .find(|known| *known == method.as_str())
            .unwrap_or("other");
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *counts
            .requests
            .entry((method, route.to_owned(), status.as_u16()))
            .or_default() += 1;
        if let Some(code) = code {
            *counts.errors.entry(code.to_owned()).or_default() += 1;
        }
        let seconds = duration.as_secs_f64();
        let histogram = counts.durations.entry(route.to_owned()).or_default();
        histogram.count += 1;
        histogram.sum_s += seconds;
        for (bound, at_most) in BOUNDS_S.iter().zip(&mut histogram.at_most) {
            *at_most += u64::from(seconds <= *bound);
        }
    }

    /// Counts a connection that was refused, or whose request could not be read.
    pub fn record_refused_connection(&self, code: &str) {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *counts.errors.entry(code.to_owned()).or_default() += 1;
    }

    pub(super) fn write(&self, out: &mut PrometheusText) {
        let counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut requests = out.family("kincal_requests_total", "counter", "Requests answered.");
        for ((method, route, status), n) in &counts.requests {
            let status = status.to_string();
            let labels = [("method", *method), ("route", route), ("status", &status)];
            requests.sample(&labels, *n as f64);
        }
        let stored = ("POST", "/v1/robots/{robot_id}/measurement-sets".into(), 201);
        let n_stored = counts.requests.get(&stored).copied().unwrap_or(0) as f64;
        out.family(
            "kincal_uploads_total",
            "counter",
            "Measurement sets stored.",
        )
        .sample(&[], n_stored);
        let what = "Problems answered, by their code.";
        let mut errors = out.family("kincal_errors_total", "counter", what);
        for (code, n) in &counts.errors {
            errors.sample(&[("code", code)], *n as f64);
        }
        let what = "Time from the request's header to the answer's header.";
        let mut durations = out.family("kincal_request_duration_seconds", "histogram", what);
        for (route, histogram) in &counts.durations {
            let count = histogram.count as f64;
            for (bound, at_most) in BOUNDS_S.iter().zip(histogram.at_most) {
                let bound = bound.to_string();
                let labels = [("route", route.as_str()), ("le", &bound)];
                durations.sample_with_suffix("_bucket", &labels, at_most as f64);
            }
            durations.sample_with_suffix("_bucket", &[("route", route), ("le", "+Inf")], count);
            durations.sample_with_suffix("_sum", &[("route", route)], histogram.sum_s);
            durations.sample_with_suffix("_count", &[("route", route)], count);
        }
    }
}

/// Text of the answer, built line by line.
#[derive(Default)]
pub(super) struct PrometheusText(pub(super) String);

/// The samples of one metric.
pub(super) struct Family<'t> {
    text: &'t mut String,
    name: &'static str,
}

impl PrometheusText {
    pub(super) fn family(&mut self, name: &'static str, kind: &str, help: &str) -> Family<'_> {
        let text = &mut self.0;
        // Writing to a String does not fail.
        let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
        Family { text, name }
    }

    pub(super) fn gauge(&mut self, name: &'static str, help: &str, value: f64) {
        self.family(name, "gauge", help).sample(&[], value);
    }
}

impl Family<'_> {
    pub(super) fn sample(&mut self, labels: &[(&str, &str)], value: f64) {
        self.sample_with_suffix("", labels, value);
    }

    /// A sample whose name has a suffix.
    pub(super) fn sample_with_suffix(&mut self, suffix: &str, labels: &[(&str, &str)], value: f64) {
        let quoted = |(key, value): &(&str, &str)| {
            let value = value
                .replace('\\', "\\\\")
                .replace('"', "\\\"")
                .replace('\n', "\\n");
            format!("{key}=\"{value}\"")
        };
        let labels = labels.iter().map(quoted).collect::<Vec<_>>().join(",");
        let labels = if labels.is_empty() {
            labels
        } else {
            format!("{{{labels}}}")
        };
        let _ = writeln!(self.text, "{}{suffix}{labels} {value}", self.name);
    }
}

#[cfg(test)]
mod tests {
    use super::{Metrics, PrometheusText};
    use axum::http::{Method, StatusCode};
    use std::time::Duration;

    #[test]
    fn answers_are_counted_by_route_status_and_code() {
        let metrics = Metrics::default();
        for ms in [2, 30] {
            metrics.record_answer(
                &Method::GET,
                "/a",
                StatusCode::OK,
                None,
                Duration::from_millis(ms),
            );
        }
        metrics.record_answer(
            &Method::from_bytes(b"BREW").unwrap(),
            "-",
            StatusCode::NOT_FOUND,
            Some("no_such_route"),
            Duration::ZERO,
        );
        let mut out = PrometheusText::default();
        metrics.write(&mut out);
        for line in [
            "kincal_requests_total{method=\"GET\",route=\"/a\",status=\"200\"} 2",
            "kincal_requests_total{method=\"other\",route=\"-\",status=\"404\"} 1",
            "kincal_errors_total{code=\"no_such_route\"} 1",
            "kincal_request_duration_seconds_bucket{route=\"/a\",le=\"0.001\"} 0",
            "kincal_request_duration_seconds_bucket{route=\"/a\",le=\"0.0025\"} 1",
            "kincal_request_duration_seconds_bucket{route=\"/a\",le=\"0.05\"} 2",
            "kincal_request_duration_seconds_bucket{route=\"/a\",le=\"+Inf\"} 2",
            "kincal_request_duration_seconds_count{route=\"/a\"} 2",
        ] {
            assert!(
                out.0.lines().any(|found| found == line),
                "{line} is not in\n{}",
                out.0
            );
        }
    }
}
