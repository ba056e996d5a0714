//! Evidence for a release: reads the facts of every job about a parameter set, and compares the set with the active one on the same points.

use crate::calibration::request::VerifySource;
use crate::calibration::{self, CalibrationRequest, judged};
use crate::jobs::execution::request_of;
use crate::jobs::{JobInputs, MeasurementSetInput};
use crate::release::facts::repeats;
use crate::release::{Comparison, Session};
use crate::store::{ParameterSetRow, Result, Store, VerificationRow, jobs, verifications};
use crate::wire::Problem;
use crate::wire::measurement::MeasurementSet;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::report_shape::{Evidence, Report};
use crate::wire::verification::Verification;

/// Stored rows about a parameter set, not parsed yet.
#[derive(Debug)]
pub struct EvidenceRows {
    rows: Vec<VerificationRow>,
    n_without_facts: i64,
    last_check: Option<(i64, String)>,
    identification: (JobInputs, String),
    content: String,
    active: Option<ActiveSet>,
}

/// The active set: its content, and the upload that it was identified from.
#[derive(Debug)]
struct ActiveSet {
    content: String,
    upload: MeasurementSetInput,
}

/// Parsed evidence for the gates.
#[derive(Debug)]
pub struct ParsedEvidence {
    /// The identification's report.
    pub report: Report,
    /// Verification facts of the identification.
    pub identification: Verification,
    /// Number of the identification in the robot's counter.
    pub identification_seq: i64,
    /// Number and job of the robot's last session that did not fit.
    pub last_check: Option<(i64, String)>,
    /// Content of the set.
    pub content: ParameterSetContent,
    /// Content of the active set.
    pub active: Option<ParameterSetContent>,
    /// Whether the active set was identified from the same points, as far as can be told: those held out here may have been fitted there.
    is_active_of_same_points: bool,
    /// Every session on which the set was scored, in order.
    pub sessions: Vec<Session>,
    /// Job and measurement set of each upload on which the set is compared with the active one.
    pub to_compare: Vec<(String, String)>,
    request: CalibrationRequest,
}

/// Reads the rows. They contain one report and one upload, so the caller needs a permit to compute.
///
/// # Errors
/// [`crate::store::Error`].
pub async fn load(
    store: &Store,
    set: &ParameterSetRow,
    active: Option<&ParameterSetRow>,
) -> Result<EvidenceRows> {
    Ok(EvidenceRows {
        // Read first: if a job adds facts after this, the release fails with `ChecksOutdated`.
        rows: verifications::of_set(store, &set.id).await?,
        n_without_facts: verifications::n_without_facts(store, &set.id).await?,
        last_check: last_check(store, &set.robot_id).await?,
        identification: (
            JobInputs::load(store, &set.job_id).await?,
            jobs::report(store, &set.job_id).await?,
        ),
        content: set.body_json.clone(),
        active: match active {
            None => None,
            Some(active) => {
                let job = jobs::get(store, &active.job_id).await?;
                Some(ActiveSet {
                    content: active.body_json.clone(),
                    upload: MeasurementSetInput::read(store, &job.measurement_set_id).await?,
                })
            }
        },
    })
}

async fn last_check(store: &Store, robot_id: &str) -> Result<Option<(i64, String)>> {
    let seq = verifications::check(store, robot_id).await?.check_seq;
    let job_id = verifications::job_of(store, robot_id, seq).await?;
    Ok(job_id.map(|job_id| (seq, job_id)))
}

impl EvidenceRows {
    /// Number of jobs that have identified or scored the set.
    pub fn n_verifications(&self) -> i64 {
        self.rows.len() as i64
    }
}

fn parsed<T: serde::de::DeserializeOwned>(json: &str) -> std::result::Result<T, Box<Problem>> {
    serde_json::from_str(json).map_err(|error| broken(&error.to_string()))
}

fn broken(cause: &str) -> Box<Problem> {
    tracing::error!(cause, "the evidence for a release cannot be read");
    Box::new(Problem::new(
        500,
        "internal",
        "something that this release rests on cannot be read; the log has the cause",
    ))
}

/// Parses the rows. It takes long, so call it on a blocking thread.
///
/// # Errors
/// A problem if stored documents cannot be parsed.
pub fn parse(stored: EvidenceRows) -> std::result::Result<ParsedEvidence, Box<Problem>> {
    let (inputs, report) = &stored.identification;
    if stored.n_without_facts > 0 {
        return Err(broken("jobs about this set of which no facts were kept"));
    }
    let mut identification = None;
    let mut sessions: Vec<Session> = Vec::new();
    let mut to_compare: Vec<(String, String)> = Vec::new();
    for row in &stored.rows {
        let found = verification(row);
        if !found.is_session {
            identification = Some((row.seq, found));
            continue;
        }
        let is_new = to_compare
            .iter()
            .all(|(_, set)| *set != row.measurement_set_id);
        if found.evidence != Evidence::None && is_new {
            to_compare.push((row.job_id.clone(), row.measurement_set_id.clone()));
        }
        sessions.push(Session {
            job_id: row.job_id.clone(),
            seq: row.seq,
            verification: found,
        });
    }
    let (identification_seq, identification) =
        identification.ok_or_else(|| broken("no facts of the identification"))?;
    let request =
        request_of(inputs).map_err(|_| broken(&format!("the inputs of {}", inputs.job.id)))?;
    let is_active_of_same_points = match &stored.active {
        None => false,
        Some(active) => {
            let earlier = active
                .upload
                .parse(request.robot.links.len())
                .map_err(|_| broken(&format!("the upload {}", active.upload.row.id)))?;
            repeats(&request.robot, &[earlier], &request.set)
        }
    };
    Ok(ParsedEvidence {
        report: parsed(report)?,
        identification,
        identification_seq,
        last_check: stored.last_check,
        content: parsed(&stored.content)?,
        is_active_of_same_points,
        active: stored
            .active
            .map(|active| parsed(&active.content))
            .transpose()?,
        sessions,
        to_compare,
        request,
    })
}

fn verification(row: &VerificationRow) -> Verification {
    Verification {
        is_session: row.is_session(),
        n_points: usize::try_from(row.n_points).unwrap_or(0),
        before_rms_mm: row.before_rms_mm,
        after_rms_mm: row.after_rms_mm,
        is_better: row.is_better == 1,
        fit: row.fit,
        evidence: row.evidence,
        is_repeat: row.is_repeat == 1,
        check_seq: row.check_seq,
        uncertainty_mm: row.uncertainty_mm,
    }
}

/// Errors of the set and of the active one on a session's points; `None` if no other set is active.
///
/// # Errors
/// A problem if the upload cannot be parsed.
pub fn compare_on(
    parsed: &ParsedEvidence,
    job_id: &str,
    upload: &MeasurementSetInput,
) -> std::result::Result<Option<Comparison>, Box<Problem>> {
    let set = upload
        .parse(parsed.request.robot.links.len())
        .map_err(|_| broken(&format!("the upload {}", upload.row.id)))?;
    Ok(compare(parsed, format!("session of job {job_id}"), &set))
}

/// Errors of both on the points that were held out when the set was identified. If these are of the same upload, the set's are those of the fit
/// that had not seen them; unless the active set was identified from these points too: then each is scored as it is delivered.
pub fn compare_on_held_out(parsed: &ParsedEvidence) -> Option<Comparison> {
    let points = "the points held out".to_string();
    if let VerifySource::Set(set) = &parsed.request.verify {
        return compare(parsed, points, set);
    }
    let active = parsed.active.as_ref()?;
    let errors_mm = |content: &ParameterSetContent| {
        let robot = content.identified_robot(None);
        calibration::errors_on_verify_subset_mm(&parsed.request, &robot)
            .map_err(|error| error.to_string())
    };
    let both = || {
        let active_mm = errors_mm(active)?;
        let own_mm = match parsed.is_active_of_same_points {
            true => errors_mm(&parsed.content)?
                .into_iter()
                .map(|e| [e, e])
                .collect(),
            false => parsed
                .report
                .verify_errors_mm()
                .into_iter()
                .map(|[_, links, corrected]| [links, corrected])
                .collect::<Vec<_>>(),
        };
        let pairs = active_mm.into_iter().zip(own_mm);
        Ok(robust_rms_mm(pairs.map(|(active, [links, corrected])| {
            [active, links, corrected]
        })))
    };
    let rms_mm = both();
    Some(Comparison { points, rms_mm })
}

fn compare(parsed: &ParsedEvidence, points: String, set: &MeasurementSet) -> Option<Comparison> {
    let active = parsed.active.as_ref()?;
    let errors_mm = |content: &ParameterSetContent| {
        calibration::errors_mm(&parsed.request, set, &content.identified_robot(None))
            .map_err(|error| error.to_string())
    };
    let both = || {
        let errors_mm = errors_mm(active)?
            .into_iter()
            .zip(errors_mm(&parsed.content)?);
        Ok(robust_rms_mm(
            errors_mm.map(|(active, own)| [active, own, own]),
        ))
    };
    let rms_mm = both();
    Some(Comparison { points, rms_mm })
}

/// rms of the set and of the active one, mm, from each point's errors: of the active set, of the set's links, and of those with corrections.
fn robust_rms_mm(errors_mm: impl Iterator<Item = [f64; 3]>) -> (f64, f64) {
    let judged = judged(&errors_mm.collect::<Vec<_>>());
    (judged.after_rms_mm, judged.before_rms_mm)
}
