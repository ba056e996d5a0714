//! What a release rests on: the sessions that a parameter set was verified on, and the active set on the same points.

use crate::calibration::{self, CalibrationRequest, judged};
use crate::jobs::JobInputs;
use crate::jobs::execution::{is_anew, request_of};
use crate::store::{ParameterSetRow, Result, Store, jobs, sessions};
use crate::wire::Problem;
use crate::wire::measurement::MeasurementSet;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::release::{Comparison, Session};
use crate::wire::report_shape::{Evidence, Report};

/// Sessions that are weighed: the newest. Whether one shows the set to be no better than nominal is asked of all of them.
const MAX_SESSIONS: i64 = 8;
/// Fewer configurations than this in a session prove nothing, however often each was read.
const MIN_CONFIGURATIONS: usize = 5;

/// What is stored about a parameter set, read and not yet weighed.
#[derive(Debug)]
pub struct Stored {
    identification: (JobInputs, String),
    sessions: Vec<(JobInputs, String)>,
    content: String,
    active: Option<String>,
    no_better_than_nominal: Option<String>,
    /// How many sessions there are.
    pub n_sessions: i64,
}

/// What the gates need of it.
#[derive(Debug)]
pub struct Weighed {
    /// The identification's report.
    pub report: Report,
    /// Whether that job's verify points are another session's.
    pub verified_elsewhere: bool,
    /// The set.
    pub content: ParameterSetContent,
    /// The active set.
    pub active: Option<ParameterSetContent>,
    /// What it was scored on: the newest.
    pub sessions: Vec<Session>,
    /// Of all sessions, the job that showed it to be no better than nominal.
    pub no_better_than_nominal: Option<String>,
    /// Against the active set.
    pub comparisons: Vec<Comparison>,
}

/// Reads all of it: up to nine uploads with their reports, so in a turn of its own.
///
/// # Errors
/// [`crate::store::Error`].
pub async fn load(
    store: &Store,
    set: &ParameterSetRow,
    active: Option<&ParameterSetRow>,
) -> Result<Stored> {
    // Counted first: a session that comes in between makes the release ask again.
    let n_sessions = sessions::count(store, &set.id).await?;
    let no_better_than_nominal = sessions::no_better_than_nominal(store, &set.id).await?;
    let mut read = Vec::new();
    for session in sessions::newest(store, &set.id, MAX_SESSIONS).await? {
        read.push((
            JobInputs::load(store, &session.job_id).await?,
            session.report_json,
        ));
    }
    Ok(Stored {
        identification: (
            JobInputs::load(store, &set.job_id).await?,
            jobs::report(store, &set.job_id).await?,
        ),
        sessions: read,
        content: set.body_json.clone(),
        active: active.map(|active| active.body_json.clone()),
        no_better_than_nominal,
        n_sessions,
    })
}

fn parsed<T: serde::de::DeserializeOwned>(json: &str) -> std::result::Result<T, Box<Problem>> {
    serde_json::from_str(json).map_err(|error| broken(&error.to_string()))
}

fn broken(cause: &str) -> Box<Problem> {
    tracing::error!(cause, "what a release rests on cannot be read");
    Box::new(Problem::new(
        500,
        "internal",
        "something that this release rests on cannot be read; the log has the cause",
    ))
}

/// Weighs it; computes, so on a thread of its own.
///
/// # Errors
/// A problem where stored documents cannot be read any more.
pub fn weigh(stored: Stored) -> std::result::Result<Weighed, Box<Problem>> {
    let Stored {
        identification: (inputs, report),
        sessions,
        content,
        active,
        no_better_than_nominal,
        ..
    } = stored;
    let (report, content): (Report, ParameterSetContent) = (parsed(&report)?, parsed(&content)?);
    let active: Option<ParameterSetContent> = active.as_deref().map(parsed).transpose()?;
    let own = request(&inputs)?;
    let own_verify = points("the points held out", &own);
    let verified_elsewhere = report.evidence == Evidence::IndependentSession
        && own_verify
            .1
            .as_ref()
            .is_ok_and(|points| is_anew(&own.set, points));
    let mut weighed = Vec::new();
    let mut compared = Vec::new();
    for (inputs, report) in &sessions {
        let request = request(inputs)?;
        let session = session(&own.set, &request, inputs, &parsed(report)?);
        if session.is_independent {
            compared.push((
                format!("session of job {}", session.job_id),
                Ok(request.set.clone()),
            ));
        }
        weighed.push(session);
    }
    if compared.is_empty() {
        compared.push(own_verify);
    }
    let comparisons = match &active {
        Some(active) => compared
            .into_iter()
            .map(|on| compare(&own, on, &content, active))
            .collect(),
        None => Vec::new(),
    };
    Ok(Weighed {
        report,
        verified_elsewhere,
        content,
        active,
        sessions: weighed,
        no_better_than_nominal,
        comparisons,
    })
}

type Points = (String, std::result::Result<MeasurementSet, String>);

fn request(inputs: &JobInputs) -> std::result::Result<CalibrationRequest, Box<Problem>> {
    request_of(inputs).map_err(|_| broken(&format!("the inputs of {}", inputs.job.id)))
}

fn points(name: &str, request: &CalibrationRequest) -> Points {
    (
        name.into(),
        calibration::verify_points_of(request).map_err(|error| error.to_string()),
    )
}

fn session(
    identified_from: &MeasurementSet,
    request: &CalibrationRequest,
    inputs: &JobInputs,
    report: &Report,
) -> Session {
    let is_small = request.set.configurations().len() < MIN_CONFIGURATIONS
        || report
            .warnings
            .iter()
            .any(|warning| warning.code == "few_verify_points");
    Session {
        job_id: inputs.job.id.clone(),
        n_points: report.verify.map_or(0, |verify| verify.n_points),
        judged: report.judged(),
        is_independent: !is_small && is_anew(identified_from, &request.set),
    }
}

fn compare(
    request: &CalibrationRequest,
    (points, set): Points,
    own: &ParameterSetContent,
    active: &ParameterSetContent,
) -> Comparison {
    let errors_mm = |set: &MeasurementSet, content: &ParameterSetContent| {
        calibration::errors_mm(request, set, &content.robot_to_core(None))
            .map_err(|error| error.to_string())
    };
    let rms_mm = set.and_then(|set| {
        let (own, active) = (errors_mm(&set, own)?, errors_mm(&set, active)?);
        let judged = judged(
            &active
                .iter()
                .zip(&own)
                .map(|(active, own)| [*active, *own, *own])
                .collect::<Vec<_>>(),
        );
        Ok((judged.after_rms_mm, judged.before_rms_mm))
    });
    Comparison { points, rms_mm }
}
