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
    pub fn answered(
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
    pub fn refused_connection(&self, code: &str) {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *counts.errors.entry(code.to_owned()).or_default() += 1;
    }

    pub(super) fn write(&self, out: &mut PrometheusText) {
        let counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        out.family("kincal_requests_total", "counter", "Requests answered.");
        for ((method, route, status), n) in &counts.requests {
            out.sample(
                "kincal_requests_total",
                &[
                    ("method", method),
                    ("route", route),
                    ("status", &status.to_string()),
                ],
                *n as f64,
            );
        }
        out.family(
            "kincal_uploads_total",
            "counter",
            "Measurement sets stored.",
        );
        let stored = (
            "POST",
            "/v1/robots/{robot_id}/measurement-sets".to_owned(),
            201,
        );
        out.sample(
            "kincal_uploads_total",
            &[],
            counts.requests.get(&stored).copied().unwrap_or(0) as f64,
        );
        out.family(
            "kincal_errors_total",
            "counter",
            "Problems answered, by their code.",
        );
        for (code, n) in &counts.errors {
            out.sample("kincal_errors_total", &[("code", code)], *n as f64);
        }
        out.family(
            "kincal_request_duration_seconds",
            "histogram",
            "Time from the request's header to the answer's header.",
        );
        for (route, histogram) in &counts.durations {
            let name = "kincal_request_duration_seconds_bucket";
            for (bound, at_most) in BOUNDS_S.iter().zip(histogram.at_most) {
                out.sample(
                    name,
                    &[("route", route), ("le", &bound.to_string())],
                    at_most as f64,
                );
            }
            out.sample(
                name,
                &[("route", route), ("le", "+Inf")],
                histogram.count as f64,
            );
            out.sample(
                "kincal_request_duration_seconds_sum",
                &[("route", route)],
                histogram.sum_s,
            );
            out.sample(
                "kincal_request_duration_seconds_count",
                &[("route", route)],
                histogram.count as f64,
            );
        }
    }
}

/// Text of the answer, built line by line.
#[derive(Default)]
pub(super) struct PrometheusText(pub(super) String);

impl PrometheusText {
    pub(super) fn family(&mut self, name: &str, kind: &str, help: &str) {
        // Writing to a String does not fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    pub(super) fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
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
        let _ = writeln!(self.0, "{name}{labels} {value}");
    }

    pub(super) fn gauge(&mut self, name: &str, help: &str, labels: &[(&str, &str)], value: f64) {
        self.family(name, "gauge", help);
        self.sample(name, labels, value);
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
            metrics.answered(
                &Method::GET,
                "/a",
                StatusCode::OK,
                None,
                Duration::from_millis(ms),
            );
        }
        metrics.answered(
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
