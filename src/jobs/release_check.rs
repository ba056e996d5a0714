//! Checks whether a parameter set may be released: gathers the facts, compares the set with the active one, and runs the gates.

use crate::jobs::evidence::{self, MAX_LATER, ParsedEvidence, Unreadable, policy_in_force};
use crate::jobs::{MeasurementSetInput, blocking};
use crate::release::comparison::HeldOutPoints;
use crate::release::{
    ArchivedItem, Comparison, Decision, Facts, KeyHolder, StoredFacts, UnscoredSession,
    WithdrawnSource, decide, is_compared_with_withdrawn, is_equivalent,
};
use crate::store::withdrawals::{self, WithdrawnSet};
use crate::store::{
    self, AuditEvent, CheckedState, MeasurementSetRow, ParameterSetRow, ParameterSetStatus,
    PolicyRow, Release, RobotRow, Store, api_keys, audit, job_sources, jobs, measurement_sets,
    parameter_sets, policies, robots, verifications,
};
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::release::Gate;
use crate::wire::robot::{Robot, RobotBody};
use crate::wire::verification::VerificationKind;
use crate::wire::{Issue, json};
use std::sync::Arc;
use tokio::task::JoinError;

/// Maximum number of withdrawn sets of a robot with which a set is compared, newest first.
const MAX_WITHDRAWN: i64 = 200;

/// A release to be checked.
#[derive(Debug)]
pub struct ReleaseRequest {
    /// The parameter set.
    pub set: ParameterSetRow,
    /// The key that releases.
    pub approver: String,
    /// Purpose of the check.
    pub purpose: Purpose,
}

/// Purpose of a release check. A superseded set that is released again must pass all gates. In a rollback these gates only warn:
/// `improved_on_active`, `change_plausible`, `orientation_known`, and `scored_on_later_sessions` unless that session found a change.
#[derive(Debug, PartialEq, Eq)]
pub enum Purpose {
    /// The set becomes the active one.
    Release {
        /// Stated reason for a large change.
        change_reason: Option<String>,
    },
    /// The active set is withdrawn, and the set that it superseded replaces it. That set is not compared with withdrawn sets.
    Rollback,
}

impl Purpose {
    fn change_reason(&self) -> Option<&str> {
        match self {
            Self::Release { change_reason } => change_reason.as_deref(),
            Self::Rollback => None,
        }
    }
}

/// Why a release check gives no release.
#[derive(Debug, thiserror::Error)]
pub enum ReleaseCheckError {
    /// The database.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// A stored document.
    #[error(transparent)]
    Unreadable(#[from] Unreadable),
    /// The runtime stops.
    #[error(transparent)]
    Stopped(#[from] JoinError),
    /// The gates that failed.
    #[error("gates failed")]
    Refused(Vec<Issue>),
}

/// The decision, and everything else that a release writes except its reason.
#[derive(Debug)]
pub struct ReleaseCheck {
    /// Results of the gates.
    pub decision: Decision,
    id: String,
    checked: CheckedState,
    approver: String,
}

impl ReleaseCheck {
    /// The release to be written, if every gate is passed.
    pub fn release(self, reason: String) -> Result<Release, ReleaseCheckError> {
        if !self.decision.is_releasable() {
            let failed = self.decision.failed().map(Gate::issue);
            return Err(ReleaseCheckError::Refused(failed.collect()));
        }
        Ok(Release {
            id: self.id,
            checked: self.checked,
            reason,
            checks_json: serde_json::to_string(&self.decision.gates)
                .map_err(|error| Unreadable(error.to_string()))?,
            n_passed: self.decision.n_passed() as i64,
            n_failed: self.decision.n_failed() as i64,
            released_by: self.approver,
            evidence: self.decision.evidence,
            uncertainty_mm: self.decision.uncertainty_mm,
        })
    }
}

/// Inputs of the gates besides the evidence.
struct GateInputs {
    request: ReleaseRequest,
    robot: RobotRow,
    policy: PolicyRow,
    /// The measurement sets that the parameter set was identified from.
    sets: Vec<MeasurementSetRow>,
    /// Keys that uploaded the points of the identification, the points on which its held values are based and, if its job used sweeps, the sweeps.
    /// `None` for an unknown key.
    uploaders: Vec<Option<KeyHolder>>,
    approver: KeyHolder,
    /// [`StoredFacts::insisted_on`].
    insisted_on: Option<String>,
    /// A withdrawn parameter set whose values this set holds, or which is equivalent to this set ([`equivalent_withdrawn_set`]).
    withdrawn_source: Option<WithdrawnSource>,
}

/// Reads the evidence of a release and runs the gates on it. It computes on blocking threads, which hold clones of `permit`.
///
/// # Errors
/// [`ReleaseCheckError`], except [`ReleaseCheckError::Refused`].
pub async fn check(
    store: &Store,
    permit: &(impl Clone + Send + 'static),
    request: ReleaseRequest,
) -> Result<ReleaseCheck, ReleaseCheckError> {
    let row = &request.set;
    let robot = robots::get(store, &row.robot_id).await?;
    let policy = policies::get(store, &row.robot_id).await?;
    let active = parameter_sets::active(store, &row.robot_id).await?;
    let job = jobs::get(store, &row.job_id).await?;
    let mut sets = Vec::new();
    for id in job.set_ids() {
        sets.push(measurement_sets::get(store, id).await?);
    }
    let mut uploaders: Vec<_> = sets.iter().map(|set| set.uploaded_by.clone()).collect();
    let mut insisted_on = sets.iter().find_map(|set| set.insisted_on.clone());
    if let Some(id) = &job.verify_set_id {
        let verify_set = measurement_sets::get(store, id).await?;
        insisted_on = insisted_on.or(verify_set.insisted_on);
    }
    for upload in job_sources::uploads(store, &job.id).await? {
        let source = measurement_sets::get(store, &upload.measurement_set_id).await?;
        insisted_on = insisted_on.or(source.insisted_on);
        if upload.is_held {
            uploaders.push(source.uploaded_by);
        }
    }
    let n_withdrawn = withdrawals::count(store, &row.robot_id).await?;
    let held_withdrawn = withdrawals::held(store, &job.id).await?;
    let is_rollback = request.purpose == Purpose::Rollback;
    let withdrawn = match is_compared_with_withdrawn(row.status, is_rollback) {
        true => withdrawals::of_robot(store, &row.robot_id, MAX_WITHDRAWN).await?,
        false => Vec::new(),
    };
    if let Some(frames_id) = &job.frames_id {
        uploaders.push(audit::actor(store, frames_id, AuditEvent::FramesCreated).await?);
    }
    let mut holders = Vec::new();
    for id in uploaders {
        holders.push(match id {
            Some(id) => Some(key_holder(store, id).await?),
            None => None,
        });
    }
    let other = active.as_ref().filter(|active| active.id != row.id);
    let stored = evidence::load(store, row, other).await?;
    let checked = CheckedState {
        active: active.as_ref().map(|active| active.id.clone()),
        policy_version: policy.version,
        n_verifications: stored.n_verifications(),
        robot: robot.check(),
        n_withdrawn,
    };
    let parsed = blocking::run(permit, || evidence::parse(stored)).await??;
    let parsed = Arc::new(parsed);
    let withdrawn_id = match held_withdrawn {
        Some(id) => Some(id),
        None => {
            let mut points_seq = Vec::new();
            for set in &withdrawn {
                let row = verifications::of_job(store, &set.job_id).await?;
                points_seq.push(row.map_or(0, |row| row.points_seq));
            }
            let parsed = Arc::clone(&parsed);
            let find = move || equivalent_withdrawn_set(&parsed, &withdrawn, &points_seq);
            blocking::run(permit, find).await??
        }
    };
    let withdrawn_source = match withdrawn_id {
        None => None,
        Some(id) => {
            let rows = verifications::of_set(store, &id).await?;
            let of_sessions = rows
                .iter()
                .filter(|row| row.found.kind == VerificationKind::Session);
            let scored_seqs = rows.iter().map(|row| row.scored_seq);
            Some(WithdrawnSource {
                id,
                scored_sets: of_sessions
                    .map(|row| row.measurement_set_id.clone())
                    .collect(),
                scored_seq: scored_seqs.filter(|seq| *seq > 0).collect(),
            })
        }
    };
    let comparisons = match request.purpose {
        Purpose::Release { .. } => compare(store, permit, &parsed).await?,
        Purpose::Rollback => Vec::new(),
    };
    let unscored = unscored_session(store, permit, &parsed).await?;
    let (id, approver) = (row.id.clone(), request.approver.clone());
    let inputs = GateInputs {
        request,
        robot,
        policy,
        sets,
        uploaders: holders,
        approver: key_holder(store, approver.clone()).await?,
        insisted_on,
        withdrawn_source,
    };
    let decision = blocking::run(permit, move || {
        run_gates(&parsed, &comparisons, unscored.as_ref(), &inputs)
    })
    .await??;
    Ok(ReleaseCheck {
        decision,
        id,
        checked,
        approver,
    })
}

/// The holder of a key. Without a key, as on a server without keys, the id is also the name.
async fn key_holder(store: &Store, id: String) -> store::Result<KeyHolder> {
    let name = match api_keys::get(store, &id).await {
        Ok(key) => key.name,
        Err(store::Error::NotFound) => id.clone(),
        Err(error) => return Err(error),
    };
    Ok(KeyHolder { id, name })
}

/// Id of the withdrawn set that is equivalent to this one ([`is_equivalent`]), if there is one. `points_seq` has the age of the points of each
/// withdrawn set.
fn equivalent_withdrawn_set(
    parsed: &ParsedEvidence,
    withdrawn: &[WithdrawnSet],
    points_seq: &[i64],
) -> Result<Option<String>, Unreadable> {
    let unreadable = |cause: serde_json::Error| Unreadable(cause.to_string());
    let own = serde_json::to_value(&parsed.content).map_err(unreadable)?;
    let verified_rms_mm = parsed.identification.after_rms_mm;
    for (set, seq) in withdrawn.iter().zip(points_seq) {
        let other: ParameterSetContent =
            serde_json::from_str(&set.body_json).map_err(unreadable)?;
        let is_of_same_points = *seq > 0 && *seq == parsed.points_seq;
        let difference_mm = || parsed.tool_difference_mm(&other);
        let values = serde_json::to_value(&other).map_err(unreadable)?;
        if is_equivalent(
            &own,
            verified_rms_mm,
            &values,
            is_of_same_points,
            difference_mm,
        ) {
            return Ok(Some(set.id.clone()));
        }
    }
    Ok(None)
}

/// Compares the set with the active one. Reads one upload or one report at a time.
async fn compare(
    store: &Store,
    permit: &(impl Clone + Send + 'static),
    parsed: &Arc<ParsedEvidence>,
) -> Result<Vec<Comparison>, ReleaseCheckError> {
    let mut comparisons = Vec::new();
    for session in parsed.sessions_to_compare() {
        let upload = MeasurementSetInput::read(store, &session.measurement_set_id).await?;
        let parsed = Arc::clone(parsed);
        let compare = move || evidence::compare_on_session(&parsed, &session, &upload);
        comparisons.extend(blocking::run(permit, compare).await??);
    }
    if !comparisons.is_empty() {
        return Ok(comparisons);
    }
    match parsed.held_out_points() {
        HeldOutPoints::VerifySet => {
            let parsed = Arc::clone(parsed);
            let compare = move || evidence::compare_on_verify_set(&parsed);
            comparisons.extend(blocking::run(permit, compare).await?);
        }
        HeldOutPoints::VerifySubset {
            is_fitted_by_active,
        } => {
            let report = match is_fitted_by_active {
                true => None,
                false => Some(jobs::report(store, &parsed.job_id).await?),
            };
            let parsed = Arc::clone(parsed);
            let compare = move || evidence::compare_on_verify_subset(&parsed, report.as_deref());
            comparisons.extend(blocking::run(permit, compare).await??);
        }
        HeldOutPoints::None => {}
    }
    Ok(comparisons)
}

/// The first later session on which the set was not scored. Copies of the set's own upload are skipped. If [`MAX_LATER`] sessions were read and
/// all are copies, the last one counts, because there may be further sessions. Reads one upload at a time.
async fn unscored_session(
    store: &Store,
    permit: &(impl Clone + Send + 'static),
    parsed: &Arc<ParsedEvidence>,
) -> Result<Option<UnscoredSession>, ReleaseCheckError> {
    for session in &parsed.unscored {
        let upload = MeasurementSetInput::read(store, &session.measurement_set_id).await?;
        let parsed = Arc::clone(parsed);
        let is_copy = move || evidence::repeats_own_upload(&parsed, &upload);
        if !blocking::run(permit, is_copy).await?? {
            return Ok(Some(session.clone()));
        }
    }
    Ok(parsed.unscored.get(MAX_LATER - 1).cloned())
}

fn run_gates(
    parsed: &ParsedEvidence,
    comparisons: &[Comparison],
    unscored: Option<&UnscoredSession>,
    inputs: &GateInputs,
) -> Result<Decision, Unreadable> {
    let GateInputs {
        request,
        robot,
        policy,
        sets,
        uploaders,
        approver,
        insisted_on,
        withdrawn_source,
    } = inputs;
    let unreadable = |cause: String| Unreadable(format!("robot {}: {cause}", robot.id));
    let body: RobotBody =
        json::parse(robot.body_json.as_bytes()).map_err(|error| unreadable(error.to_string()))?;
    let stored = StoredFacts {
        robot: &Robot::try_from(&body).map_err(|error| unreadable(error.to_string()))?,
        check_job_id: robot.check_job_id.as_deref(),
        last_misfit: parsed.last_misfit.as_ref(),
        checked_seq: robot.checked_seq,
        identification: &parsed.identification,
        identification_seq: parsed.identification_seq,
        sessions: &parsed.sessions,
        has_other_joint_map: request.set.joint_map_version != robot.joint_map_version,
        insisted_on: insisted_on.as_deref(),
        policy: &policy_in_force(policy),
        report: &parsed.report,
    };
    let stated_serial_numbers: Vec<_> = sets
        .iter()
        .map(|set| set.serial_number.as_deref())
        .collect();
    Ok(decide(&Facts {
        stored,
        verify_set_seq: parsed.verify_set_seq,
        content: &parsed.content,
        active: parsed.active.as_ref(),
        unscored,
        comparisons,
        archived: match (request.set.archived_at_ms, robot.archived_at_ms) {
            (Some(_), _) => Some(ArchivedItem::ParameterSet),
            (None, Some(_)) => Some(ArchivedItem::Robot),
            (None, None) => None,
        },
        is_withdrawn: request.set.status == ParameterSetStatus::Withdrawn,
        withdrawn_source: withdrawn_source.as_ref(),
        is_rollback: request.purpose == Purpose::Rollback,
        serial_number: body.serial_number.as_deref(),
        stated_serial_numbers: &stated_serial_numbers,
        uploaders,
        approver,
        change_reason: request.purpose.change_reason(),
    }))
}
