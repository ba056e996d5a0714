//! Failed requests: their messages, and whether a retry makes sense.

use super::files;
use super::remedy::in_commands;
use crate::wire::Problem;
use reqwest::header::{HeaderMap, RETRY_AFTER};
use std::time::Duration;

/// Longest wait before a retry, even if `Retry-After` is longer: a person is waiting.
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// Wait before a retry without a `Retry-After`, or after a lost connection.
const RETRY_DELAY: Duration = Duration::from_secs(1);

/// Why a request failed.
#[derive(Debug)]
pub enum RequestError {
    /// No connection could be made.
    Unreachable(anyhow::Error),
    /// The connection broke before the answer was complete.
    Lost(anyhow::Error),
    /// The server cannot take the request now; a retry after this time may succeed.
    Busy(Duration, anyhow::Error),
    /// A retry would give the same answer.
    Final(anyhow::Error),
}

impl RequestError {
    /// An error while a request was sent to `url`.
    pub fn sending(url: &str, error: &reqwest::Error) -> Self {
        let is_final = error.is_builder() || advice(&cause(error)).is_some();
        let reason = unreachable(url, error);
        match error.is_connect() {
            _ if is_final => Self::Final(reason),
            true => Self::Unreachable(reason),
            false => Self::Lost(reason),
        }
    }

    /// An error while the answer was read.
    pub fn reading(url: &str, error: &reqwest::Error) -> Self {
        Self::Lost(anyhow::anyhow!(
            "the connection to {url} was lost during an answer: {}",
            cause(error)
        ))
    }

    /// An answer with an error status. A proxy answers 502 and 504 while the server behind it restarts.
    pub fn answer(status: u16, headers: &HeaderMap, body: &[u8]) -> Self {
        let error = match serde_json::from_slice::<Problem>(body) {
            Ok(problem) => ServerProblem { status, problem }.into(),
            Err(_) => anyhow::anyhow!("the server answered {status}"),
        };
        if matches!(status, 429 | 502..=504) {
            Self::Busy(retry_delay(headers), error)
        } else {
            Self::Final(error)
        }
    }

    /// The wait before a retry, if a retry makes sense.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Unreachable(_) | Self::Lost(_) => Some(RETRY_DELAY),
            Self::Busy(after, _) => Some(*after),
            Self::Final(_) => None,
        }
    }
}

impl From<RequestError> for anyhow::Error {
    fn from(failed: RequestError) -> Self {
        match failed {
            RequestError::Unreachable(error)
            | RequestError::Lost(error)
            | RequestError::Busy(_, error)
            | RequestError::Final(error) => error,
        }
    }
}

fn retry_delay(headers: &HeaderMap) -> Duration {
    let retry_after = headers
        .get(RETRY_AFTER)
        .and_then(|value| value.to_str().ok()?.trim().parse().ok());
    retry_after
        .map_or(RETRY_DELAY, Duration::from_secs)
        .min(LONGEST_WAIT)
}

fn unreachable(url: &str, error: &reqwest::Error) -> anyhow::Error {
    let cause = cause(error);
    if let Some(advice) = advice(&cause) {
        return anyhow::anyhow!("the server {url} is not trusted: {cause}\nnext: {advice}");
    }
    let reason = if error.is_timeout() {
        "it did not answer in time".to_owned()
    } else {
        cause
    };
    anyhow::anyhow!(
        "the server {url} cannot be reached: {reason}; is it running, and is --server right?"
    )
}

/// Remedy for a refused certificate. `cause` contains the name of rustls's error.
fn advice(cause: &str) -> Option<&'static str> {
    let reason = cause.split_once("invalid peer certificate: ")?.1;
    // BadSignature: the trusted certificate has the right name and another key, e.g. from before a renewal.
    Some(
        if reason.contains("UnknownIssuer") || reason.contains("BadSignature") {
            "give the certificate of the authority that signed the server's, or the server's own if it is self-signed, as it is now, \
             by --ca-cert FILE or KINCAL_CA_CERT"
        } else if reason.contains("CaUsedAsEndEntity") {
            "the server's certificate is that of an authority (CA:TRUE); \
             make one for the server with basicConstraints=CA:FALSE: docs/operations.md, TLS"
        } else if reason.to_lowercase().contains("not valid for") && reason.contains("name") {
            "name the server in --server as its certificate does, or make one whose subjectAltName has this name or address"
        } else if reason.contains("expired") || reason.contains("not valid yet") {
            "renew the server's certificate and restart the server, or correct the clock of this machine"
        } else {
            "make a certificate that works: see docs/operations.md, TLS"
        },
    )
}

/// The innermost error: only its text tells a refused connection, an unknown host and an untrusted certificate apart.
fn cause(error: &dyn std::error::Error) -> String {
    let mut innermost = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    innermost.to_string()
}

/// A problem document that the server sent.
#[derive(Debug, thiserror::Error)]
#[error("{}", self.in_words())]
pub struct ServerProblem {
    status: u16,
    /// The server's problem document.
    pub problem: Problem,
}

impl ServerProblem {
    /// True if a file or an option has to be corrected. `kincal calibrate` has the same exit code for the same file.
    pub fn is_usage(&self) -> bool {
        matches!(self.status, 400 | 415 | 422)
    }

    /// The message: what, why, and what to do next. For invalid input, `detail` repeats the first fault; the message states it once.
    fn in_words(&self) -> String {
        let Problem {
            detail,
            code,
            errors,
            ..
        } = &self.problem;
        let faults: Vec<String> = errors.iter().map(files::issue_in_words).collect();
        let more = files::issues_in_words(errors);
        let is_repeated = errors
            .first()
            .is_some_and(|first| detail.starts_with(&first.in_words()));
        let text = match faults.as_slice() {
            [fault] if is_repeated => format!("{fault} ({code})"),
            several if is_repeated => format!("{} faults ({code}){more}", several.len()),
            _ => format!("{} ({code}){more}", in_commands(code, detail)),
        };
        let next = match self.status {
            401 => "\nnext: give the key with --key or in KINCAL_KEY",
            404 if detail.contains("robot") => "\nnext: kincal robots lists those that are there",
            404 if code == "not_found" => {
                "\nnext: ids are listed by kincal params, jobs, sets or networks, each with --robot ROBOT"
            }
            _ => "",
        };
        text + next
    }
}

#[cfg(test)]
mod tests {
    use super::{RequestError, ServerProblem};
    use crate::wire::{Issue, Problem};
    use reqwest::header::{HeaderMap, HeaderValue, RETRY_AFTER};
    use std::time::Duration;

    #[test]
    fn only_what_may_pass_is_asked_again_and_not_too_late() {
        let after = |status, retry_after: Option<&'static str>| {
            let headers: HeaderMap = retry_after
                .map(|retry_after| (RETRY_AFTER, HeaderValue::from_static(retry_after)))
                .into_iter()
                .collect();
            RequestError::answer(status, &headers, b"{}").retry_after()
        };
        for status in [400, 401, 403, 404, 409, 422, 500, 507] {
            assert_eq!(after(status, Some("1")), None, "{status}");
        }
        for (retry_after, seconds) in [
            (None, 1),
            (Some("3"), 3),
            (Some("86400"), 5),
            (Some("Fri, 31 Dec 1999 23:59:59 GMT"), 1),
        ] {
            assert_eq!(
                after(503, retry_after),
                Some(Duration::from_secs(seconds)),
                "{retry_after:?}"
            );
        }
    }

    #[test]
    fn a_single_fault_is_said_once() {
        let issue = Issue {
            row: Some(0),
            detail: "row 0 has 20 cells".into(),
            code: "wrong_cell_count".into(),
            ..Issue::default()
        };
        let mut problem = Problem::new(422, "invalid_measurements", issue.in_words());
        problem.errors = vec![issue];
        let words = ServerProblem {
            status: 422,
            problem,
        }
        .to_string();
        assert_eq!(words, "row 0 has 20 cells (invalid_measurements)");
    }
}
