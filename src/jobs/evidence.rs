//! Gathers the evidence for a release: the facts of every job about a parameter set, and the points to compare it with the active one.

use crate::calibration::request::VerifySource;
use crate::calibration::{CalibrationRequest, repeats, tool_differences};
use crate::jobs::request::parse_request;
use crate::jobs::{JobInputs, MeasurementSetInput};
use crate::release::comparison::{
    self, Compared, HeldOutPoints, compare_on_set, held_out_points, sessions_to_compare,
};
use crate::release::facts::verify_errors_mm;
use crate::release::guard_band::rule_in_force;
use crate::release::independence::{effective_evidence, hides_base};
use crate::release::{Comparison, LastMisfit, PointsSeq, Session, UnscoredSession, has_changed};
use crate::store::verifications::LaterSession;
use crate::store::{
    ParameterSetRow, PolicyRow, Result, Store, VerificationRow, jobs, parameter_sets,
    report_summaries, verifications,
};
use crate::wire::measurement::{Frame, MeasurementSet};
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::policy::PolicyBody;
use crate::wire::report_shape::Evidence;
use crate::wire::report_summary::{ReportPoints, ReportSummary};
use crate::wire::verification::{Verification, VerificationKind};

/// A stored document that cannot be read, and why.
#[derive(Debug, thiserror::Error)]
#[error("the evidence for a release cannot be read: {0}")]
pub struct Unreadable(pub String);

/// Description of the points on which a set was verified when it was identified.
const HELD_OUT: &str = "the points held out";
/// Maximum number of later sessions without a score that are read. One such session is enough to refuse a set.
pub(super) const MAX_LATER: usize = 20;

/// Stored rows about a parameter set, not parsed yet.
#[derive(Debug)]
pub struct EvidenceRows {
    n_verifications: i64,
    rows: Vec<VerificationRow>,
    later: Vec<LaterSession>,
    n_without_facts: i64,
    last_misfit: Option<LastMisfit>,
    points_seq: PointsSeq,
    inputs: JobInputs,
    summary: String,
    content: String,
    active: Option<ActiveSet>,
}

/// The active set: its content, and the uploads that it was identified from.
#[derive(Debug)]
struct ActiveSet {
    content: String,
    uploads: Vec<MeasurementSetInput>,
}

/// Parsed evidence for the gates.
#[derive(Debug)]
pub struct ParsedEvidence {
    /// The job that identified the set.
    pub job_id: String,
    /// The summary of the identification's report.
    pub report: ReportSummary,
    /// Verification facts of the identification.
    pub identification: Verification,
    /// Number of the identification in the robot's counter.
    pub identification_seq: i64,
    /// Age of the separate upload that the identification verified on; 0 for none.
    pub verify_set_seq: i64,
    /// Whether that upload is older than the last event after which the robot may have changed.
    is_verify_set_outdated: bool,
    /// Age of the points that the set was identified from.
    pub points_seq: i64,
    /// The robot's last session that did not fit.
    pub last_misfit: Option<LastMisfit>,
    /// Content of the set.
    pub content: ParameterSetContent,
    /// Content of the active set.
    pub active: Option<ParameterSetContent>,
    /// The points that the active set was identified from.
    active_points: Vec<MeasurementSet>,
    /// Whether the active set was identified from the same points, as far as this is known. The points held out for this set may then have
    /// been fitted by the active one.
    is_active_of_same_points: bool,
    /// Every session on which the set was scored, in order.
    pub sessions: Vec<Session>,
    /// Later sessions on which it was not scored, first those that found a change. Some may repeat its own upload.
    pub unscored: Vec<UnscoredSession>,
    request: CalibrationRequest,
}

/// Reads the rows. They contain uploads, so the caller needs a permit to compute.
pub async fn load(
    store: &Store,
    set: &ParameterSetRow,
    active: Option<&ParameterSetRow>,
) -> Result<EvidenceRows> {
    Ok(EvidenceRows {
        // Read first: if a job adds facts after this, the release fails with `ChecksOutdated`.
        n_verifications: verifications::count(store, &set.id).await?,
        later: verifications::later_sessions(store, &set.id, MAX_LATER as i64).await?,
        rows: verifications::of_set(store, &set.id).await?,
        n_without_facts: verifications::n_without_facts(store, &set.id).await?,
        last_misfit: last_misfit(store, &set.robot_id).await?,
        points_seq: points_seq(store, set, active).await?,
        inputs: JobInputs::load(store, &set.job_id).await?,
        summary: report_summaries::of_job(store, &set.job_id).await?,
        content: set.body_json.clone(),
        active: match active {
            None => None,
            Some(active) => {
                let job = jobs::get(store, &active.job_id).await?;
                Some(ActiveSet {
                    content: active.body_json.clone(),
                    uploads: MeasurementSetInput::read_of(store, &job).await?,
                })
            }
        },
    })
}

/// A stored policy with the decision rule that is in force.
pub fn policy_in_force(stored: &PolicyRow) -> PolicyBody {
    PolicyBody {
        tolerance_mm: stored.tolerance_mm,
        decision_rule: rule_in_force(stored.decision_rule, stored.version > 0),
        independent_session_required: stored.independent_session_required,
        second_person_required: stored.second_person_required,
    }
}

/// Uploads of the points of the set, of the active set, and of the last session that did not fit and that nobody has explained.
async fn points_seq(
    store: &Store,
    set: &ParameterSetRow,
    active: Option<&ParameterSetRow>,
) -> Result<PointsSeq> {
    let counters = verifications::robot_counters(store, &set.robot_id).await?;
    let last = match counters.misfit_seq > counters.checked_seq {
        true => verifications::job_at(store, &set.robot_id, counters.misfit_seq).await?,
        false => None,
    };
    let mut points_seq = PointsSeq::default();
    for (job_id, seq) in [
        (Some(&set.job_id), &mut points_seq.own),
        (active.map(|active| &active.job_id), &mut points_seq.active),
        (last.as_ref(), &mut points_seq.last_misfit),
    ] {
        if let Some(job_id) = job_id {
            let row = verifications::of_job(store, job_id).await?;
            *seq = row.map_or(0, |row| row.points_seq);
        }
    }
    Ok(points_seq)
}

async fn last_misfit(store: &Store, robot_id: &str) -> Result<Option<LastMisfit>> {
    let counters = verifications::robot_counters(store, robot_id).await?;
    let seq = counters.misfit_seq;
    let job_id = verifications::job_at(store, robot_id, seq).await?;
    Ok(job_id.map(|job_id| LastMisfit { seq, job_id }))
}

impl EvidenceRows {
    /// Number of jobs that have identified or scored sets of the robot.
    pub fn n_verifications(&self) -> i64 {
        self.n_verifications
    }
}

fn parsed<T: serde::de::DeserializeOwned>(json: &str) -> std::result::Result<T, Unreadable> {
    serde_json::from_str(json).map_err(|error| Unreadable(error.to_string()))
}

/// Parses the rows. It takes long, so call it on a blocking thread.
pub fn parse(stored: EvidenceRows) -> std::result::Result<ParsedEvidence, Unreadable> {
    if stored.n_without_facts > 0 {
        return Err(Unreadable(
            "some jobs about this set have no stored facts".into(),
        ));
    }
    let request = parse_request(&stored.inputs)
        .map_err(|_| Unreadable(format!("the inputs of {}", stored.inputs.job.id)))?;
    let points_seq = stored.points_seq;
    let mut identification = None;
    let mut sessions: Vec<Session> = Vec::new();
    for row in stored.rows {
        match row.found.kind {
            VerificationKind::Identification => identification = Some(row),
            VerificationKind::Session => {
                sessions.push(session(request.set.frame, points_seq, row));
            }
        }
    }
    let identified =
        identification.ok_or_else(|| Unreadable("no facts of the identification".into()))?;
    let (identification_seq, verify_set_seq) = (identified.seq, identified.scored_seq);
    let is_base_hidden = matches!(&request.verify, VerifySource::Set(set) if hides_base(request.set.frame, set.frame));
    let is_outdated = verify_set_seq > 0 && points_seq.is_outdated(verify_set_seq);
    let identification = Verification {
        evidence: effective_evidence(&identified.found, is_base_hidden || is_outdated),
        ..identified.found
    };
    let of_active = stored.active.iter().flat_map(|active| &active.uploads);
    let active_points: Vec<MeasurementSet> = of_active
        .map(|upload| parse_upload(&request, upload))
        .collect::<std::result::Result<_, _>>()?;
    let is_active_of_same_points = {
        let mut own = request.uploads().iter();
        own.any(|upload| repeats(&request.robot, &active_points, upload))
    };
    let later = stored.later.into_iter().map(unscored);
    let mut unscored = later.collect::<std::result::Result<Vec<_>, _>>()?;
    unscored.sort_by_key(|session| !session.has_changed);
    Ok(ParsedEvidence {
        unscored,
        job_id: stored.inputs.job.id,
        report: parsed(&stored.summary)?,
        identification,
        identification_seq,
        verify_set_seq,
        is_verify_set_outdated: is_outdated,
        points_seq: identified.points_seq,
        last_misfit: stored.last_misfit,
        content: parsed(&stored.content)?,
        active_points,
        is_active_of_same_points,
        active: stored
            .active
            .map(|active| parsed(&active.content))
            .transpose()?,
        sessions,
        request,
    })
}

fn unscored(later: LaterSession) -> std::result::Result<UnscoredSession, Unreadable> {
    // Reports of older versions have no summary.
    let has_changed = match later.summary_json.as_str() {
        "" => later.is_unusable,
        text => later.is_unusable || has_changed(&parsed(text)?),
    };
    Ok(UnscoredSession {
        job_id: later.job_id,
        measurement_set_id: later.measurement_set_id,
        has_changed,
    })
}

/// Every session on which a set was scored, in order.
pub async fn scored_sessions(store: &Store, set: &ParameterSetRow) -> Result<Vec<Session>> {
    let active = parameter_sets::active(store, &set.robot_id).await?;
    let other = active.filter(|active| active.id != set.id);
    let points_seq = points_seq(store, set, other.as_ref()).await?;
    let rows = verifications::of_set(store, &set.id).await?;
    let (sessions, identified): (Vec<_>, Vec<_>) = rows
        .into_iter()
        .partition(|row| row.found.kind == VerificationKind::Session);
    // Without the facts of the identification, the frame `base` is assumed. A session in the instrument's frame then hides the base.
    let frame = identified.first().map_or(Frame::Base, |row| row.frame);
    let sessions = sessions.into_iter();
    Ok(sessions
        .map(|row| session(frame, points_seq, row))
        .collect())
}

/// Whether an upload repeats the points of a session that the set was identified from. Such an upload was not measured later.
pub fn repeats_own_upload(
    parsed: &ParsedEvidence,
    upload: &MeasurementSetInput,
) -> std::result::Result<bool, Unreadable> {
    let request = &parsed.request;
    let set = parse_upload(request, upload)?;
    Ok(repeats(&request.robot, request.uploads(), &set))
}

fn parse_upload(
    request: &CalibrationRequest,
    upload: &MeasurementSetInput,
) -> std::result::Result<MeasurementSet, Unreadable> {
    upload
        .parse(request.robot.links.len())
        .map_err(|_| Unreadable(format!("the upload {}", upload.row.id)))
}

/// A session from its facts. `frame` is that of the points that the set was identified from.
pub fn session(frame: Frame, points: PointsSeq, row: VerificationRow) -> Session {
    let is_base_hidden = hides_base(frame, row.frame);
    Session {
        job_id: row.job_id,
        measurement_set_id: row.measurement_set_id,
        seq: row.seq,
        is_base_hidden,
        measured_seq: row.scored_seq,
        is_outdated: points.is_outdated(row.scored_seq),
        is_evidence: row.found.evidence != Evidence::None,
        verification: Verification {
            evidence: effective_evidence(&row.found, is_base_hidden),
            ..row.found
        },
    }
}

impl ParsedEvidence {
    /// The sessions on which the set is compared with the active one, if there is one.
    pub fn sessions_to_compare(&self) -> Vec<Session> {
        match self.active {
            Some(_) => sessions_to_compare(&self.sessions),
            None => vec![],
        }
    }

    /// The points for the comparison with the active set if no session can be used.
    pub fn held_out_points(&self) -> HeldOutPoints {
        match self.active {
            // An outdated session does not show the robot as it is now.
            Some(_) if self.is_verify_set_outdated => HeldOutPoints::None,
            Some(_) => held_out_points(
                &self.identification,
                &self.request.verify,
                self.is_active_of_same_points,
            ),
            None => HeldOutPoints::None,
        }
    }

    /// Mean difference of the tool of this set and of another over the workspace, mm; `None` if they have different numbers of links.
    pub fn tool_difference_mm(&self, other: &ParameterSetContent) -> Option<f64> {
        let robot = &self.request.robot;
        let has_links = |content: &ParameterSetContent| content.links.len() == robot.links.len();
        (has_links(&self.content) && has_links(other)).then(|| {
            let [own, other] = [&self.content, other].map(|set| set.identified_robot(None));
            tool_differences(robot, &own, &other).mean_mm
        })
    }

    /// The set and the active one, if there is one.
    fn compared(&self) -> Option<Compared<'_>> {
        Some(Compared {
            request: &self.request,
            content: &self.content,
            active: self.active.as_ref()?,
        })
    }
}

/// Errors of the set and of the active one on a session's points; `None` if no other set is active, or if it was identified from these points.
pub fn compare_on_session(
    parsed: &ParsedEvidence,
    session: &Session,
    upload: &MeasurementSetInput,
) -> std::result::Result<Option<Comparison>, Unreadable> {
    let set = parse_upload(&parsed.request, upload)?;
    if repeats(&parsed.request.robot, &parsed.active_points, &set) {
        return Ok(None);
    }
    let points = format!("session of job {}", session.job_id);
    Ok(parsed
        .compared()
        .map(|compared| compare_on_set(compared, points, &set)))
}

/// Errors of the set and of the active one on the separate upload on which the set was verified when it was identified; `None` if there is no such
/// upload, or if no other set is active.
pub fn compare_on_verify_set(evidence: &ParsedEvidence) -> Option<Comparison> {
    let VerifySource::Set(set) = &evidence.request.verify else {
        return None;
    };
    let compared = evidence.compared()?;
    Some(compare_on_set(compared, HELD_OUT.into(), set))
}

/// Errors of the set and of the active one on the points of the set's own upload that were held out; `None` if no other set is active. With `report`,
/// the report of the identification, the set's errors are those of the fit that did not use these points.
pub fn compare_on_verify_subset(
    evidence: &ParsedEvidence,
    report: Option<&str>,
) -> std::result::Result<Option<Comparison>, Unreadable> {
    let Some(compared) = evidence.compared() else {
        return Ok(None);
    };
    let report: Option<ReportPoints> = report.map(parsed).transpose()?;
    let verified_mm = report.map(|report| {
        let errors_mm = verify_errors_mm(&report.per_point);
        let without_nominal = |[_, links, corrected]: [f64; 3]| [links, corrected];
        errors_mm.into_iter().map(without_nominal).collect()
    });
    Ok(Some(comparison::compare_on_verify_subset(
        compared,
        HELD_OUT.into(),
        verified_mm,
    )))
}
