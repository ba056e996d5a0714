//! The gates that depend on other sessions, both those that fit the robot and those that do not.

use crate::release::gate_facts::{Facts, LastMisfit, StoredFacts};
use crate::release::sessions::Session;
use crate::release::texts::{CHECKED, errors_in_words, sessions};
use crate::wire::release::Gate;
use crate::wire::verification::Fit;

/// Refuses every set while the robot is in the state `check_robot`. Until a session fits or somebody gives a reason, it is unknown whether
/// the robot has changed.
pub fn check_robot(facts: &StoredFacts<'_>) -> Gate {
    let name = "check_robot";
    match facts.check_job_id {
        None => Gate::new(name, true, "no session is in doubt"),
        Some(job_id) => Gate::new(
            name,
            false,
            format!(
                "the session of job {job_id} speaks against this robot or its parameter set: is the file in another frame, has the robot changed, \
                 or is that set wrong? Check the robot, then verify this set on this or a new session, \
                 or {CHECKED}"
            ),
        ),
    }
}

/// After a session that did not fit, the robot may have changed. A set that was identified before, or from points measured before, needs a later
/// session of its own; a later session that fits another set is no evidence for it. The schema's triggers enforce this too.
pub fn measured_since_check(facts: &StoredFacts<'_>) -> Gate {
    let name = "measured_since_check";
    let Some(LastMisfit { seq, job_id }) = facts.last_misfit else {
        return Gate::new(name, true, "every session fitted the robot");
    };
    if *seq <= facts.checked_seq {
        let detail = "somebody has said why a session did not fit the robot";
        return Gate::new(name, true, detail);
    }
    if facts.check_job_id.is_some() {
        return Gate::new(name, true, "see check_robot");
    }
    if facts.identification_seq > *seq && !facts.identification.is_repeat {
        let detail = format!(
            "identified from what was measured since the file of job {job_id} did not fit the robot"
        );
        return Gate::new(name, true, detail);
    }
    let mut sessions = facts.sessions.iter();
    match sessions.find(|session| session.supports_since(*seq)) {
        Some(session) => Gate::new(
            name,
            true,
            format!(
                "fits the session of job {}, measured since the file of job {job_id} did not fit the robot",
                session.job_id
            ),
        ),
        None => Gate::new(
            name,
            false,
            format!(
                "the points of this set are older than the file of job {job_id}, which did not fit the robot, and no later session shows \
                 that the set still holds: measure one and verify this set on it, or {CHECKED}"
            ),
        ),
    }
}

/// A session in which the set is far off blocks the set until somebody gives a reason, whatever sessions follow. A session that did not fit the
/// robot at all blocks the set until the set fits a later session.
pub fn sessions_fit(facts: &StoredFacts<'_>) -> Gate {
    let name = "sessions_fit";
    let is_answered = |session: &Session| match session.verification.fit {
        Fit::Fits => true,
        Fit::SetFarOff => false,
        Fit::DoesNotFit => {
            let mut sessions = facts.sessions.iter();
            sessions.any(|later| later.supports_since(session.seq))
        }
    };
    let is_open = |session: &&Session| session.seq > facts.checked_seq && !is_answered(session);
    match facts.sessions.iter().rev().find(is_open) {
        None => Gate::new(name, true, "no session missed the set by far"),
        Some(session) => Gate::new(
            name,
            false,
            format!(
                "the set does not fit the session of job {}: rms {}; when it was identified: {}. Identify again, \
                 or {CHECKED}",
                session.job_id,
                errors_in_words(&session.verification),
                errors_in_words(facts.identification)
            ),
        ),
    }
}

/// The set must have been scored on every session that was measured after its points, also on one from which another set was identified or on which
/// another set was scored. Otherwise it is unknown whether the set still holds. For a rollback the gate only warns, unless the job of that session
/// found that the robot has changed.
pub fn scored_on_later_sessions(facts: &Facts<'_>) -> Gate {
    let name = "scored_on_later_sessions";
    let Some(session) = facts.unscored else {
        return Gate::new(
            name,
            true,
            "it was scored on every session that was measured after its points",
        );
    };
    let (set, job) = (&session.measurement_set_id, &session.job_id);
    let (found, or) = match session.has_changed {
        true => (
            ", and that job found that the robot has changed, or that the points fit no robot like it",
            format!(". If that file is no measurement of this robot, {CHECKED}"),
        ),
        false => ("", String::new()),
    };
    let detail = format!(
        "the session of job {job} was measured after the points of this set{found}. Verify this set on that session ({set}){or}"
    );
    let only_warns = facts.is_rollback && !session.has_changed;
    Gate::new(name, only_warns, detail).with_warning(only_warns)
}

/// Refuses a set that was no better than nominal in a session that is evidence. The gate fails closed: an error that cannot be compared does not count
/// as smaller.
pub fn better_than_nominal(facts: &StoredFacts<'_>) -> Gate {
    let name = "sessions_better_than_nominal";
    let n = facts.counted_sessions().count();
    match facts
        .counted_sessions()
        .find(|session| session.is_evidence && !session.verification.is_better)
    {
        Some(session) => {
            let detail = format!(
                "job {} scored the set on another session: {}; the set is no better than nominal there. It is {}",
                session.job_id,
                errors_in_words(&session.verification),
                match session.verification.fit {
                    Fit::SetFarOff =>
                        "not released until somebody gives a reason and it fits a later session",
                    _ => "never released",
                }
            );
            Gate::new(name, false, detail)
        }
        None if facts.sessions.is_empty() => {
            Gate::new(name, true, "no other session has been scored on it")
        }
        None if n == 0 => Gate::new(
            name,
            true,
            "no session that fits the robot has been scored on it",
        ),
        None => Gate::new(
            name,
            true,
            format!(
                "{}, none of them shows that the set is no better than nominal",
                sessions(n)
            ),
        ),
    }
}
