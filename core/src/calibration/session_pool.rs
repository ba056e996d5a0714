//! Several sessions of one job: whether they may be fitted together, and the weight of each.
//!
//! Each session is first identified alone, from all of its points. All pairs of these estimates are compared ([`crate::identification::statistics::changes`]).
//! The false-alarm rate of all pairs together equals that of a single comparison. If any pair differs, nothing is fitted together.

use crate::calibration::point_errors::PointErrors;
use crate::calibration::preparation::check;
use crate::calibration::preparation::observe::model_parameters;
use crate::calibration::report::{PooledSession, PooledSessions};
use crate::calibration::request::{
    CalibrationRequest, Method, Model, ParameterChoice, VerifySource,
};
use crate::calibration::session_comparison::{estimate_with_noise, list, scale_remark};
use crate::calibration::stages::{quiet, stage};
use crate::calibration::validation::repeated_rows::is_anew;
use crate::calibration::warning::probability_in_words;
use crate::calibration::warnings::overstated_noise::{NOISE_OVERSTATED, OverstatedNoise};
use crate::calibration::{Error, Monitor, unusable};
use crate::identification::least_squares::evidence::Noise;
use crate::identification::model::parameters::Parameter;
use crate::identification::statistics::changes::{
    Estimate, FALSE_ALARMS, Tested, compare, compare_base, compare_target,
};
use crate::measurement::csv::MAX_TARGETS;
use crate::measurement::sessions::{first_rows, name, shared_targets};
use crate::measurement::split::has_column;
use crate::measurement::{Frame, MeasurementSet, Subset};
use std::collections::BTreeSet;

/// Refusal code: the sessions are not of one robot in one state.
pub const SESSIONS_DIFFER: &str = "sessions_differ";
/// Refusal code: a target of the same name is at different places on the tool.
const TARGET_MOUNTED_ANEW: &str = "target_mounted_anew";
/// Minimum redundancy for a session's own noise estimate. With less, the pooled noise of all sessions is used.
const MIN_REDUNDANT: f64 = 10.0;
/// Lower limit of a session's noise as a share of the largest one, so that no session decides alone.
const MIN_NOISE_SHARE: f64 = 0.1;

/// The checks of `calibrate` that need no fit. They also run when a job is posted. For several sessions, each must be identifiable alone, and none
/// may repeat another.
///
/// # Errors
/// [`Error::Unusable`] as [`check::check`], and with code `mixed_frames`, `model_mismatch`, `bad_subset`, `too_many_targets`, `session_repeated`.
pub fn check(request: &CalibrationRequest) -> Result<(), Error> {
    check_sessions(request)?;
    for (session, set) in request.sessions.iter().enumerate() {
        check::check(&alone(request, set)).map_err(|error| of_session(session, error))?;
    }
    check::check(request)
}

fn check_sessions(request: &CalibrationRequest) -> Result<(), Error> {
    let sessions = &request.sessions;
    let Some(first) = sessions.first() else {
        return Ok(());
    };
    if let Some(other) = sessions.iter().position(|set| set.frame != first.frame) {
        let detail = format!(
            "{} is in the frame {} and {} in the frame {}: sessions that are fitted together have to be in one frame",
            name(0),
            first.frame.as_str(),
            name(other),
            sessions[other].frame.as_str()
        );
        return Err(unusable("mixed_frames", detail));
    }
    if request.model() == Model::Paper {
        let detail = "model \"paper\" knows one base and one target, and each session has its own: ask for model \"complete\" and leave frames_id \
                      out, or name one measurement set";
        return Err(unusable("model_mismatch", detail));
    }
    let takes_column = matches!(request.verify, VerifySource::Default | VerifySource::Subset);
    let has_none = |set: &MeasurementSet| !has_column(set);
    if let (true, Some(without)) = (takes_column, sessions.iter().position(has_none))
        && sessions.iter().any(has_column)
    {
        let detail = format!(
            "{} names no subset and others do: name it in every session, or ask for verify {{\"source\": \"fraction\", \"fraction\": 0.5}}",
            name(without)
        );
        return Err(unusable("bad_subset", detail));
    }
    let n_targets = request.set.n_targets();
    if n_targets > MAX_TARGETS {
        let detail = format!(
            "{n_targets} targets in all, those of one target_name counted once; {MAX_TARGETS} are allowed in one job: leave sessions out"
        );
        return Err(unusable("too_many_targets", detail));
    }
    let is_copy = |(earlier, later): &(usize, usize)| {
        !is_anew(&request.robot, &sessions[*earlier], &sessions[*later])
    };
    if let Some((earlier, later)) = pairs(sessions.len()).find(is_copy) {
        let detail = format!(
            "{} repeats rows of {}, and nothing shows that they were measured anew: fitted together they would count twice. Leave one of them out, or \
             measure other poses",
            name(later),
            name(earlier)
        );
        return Err(unusable("session_repeated", detail));
    }
    Ok(())
}

/// Each pair of sessions, the earlier first.
fn pairs(n_sessions: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n_sessions).flat_map(|later| (0..later).map(move |earlier| (earlier, later)))
}

/// The request that identifies a session alone, from all of its points.
fn alone(request: &CalibrationRequest, set: &MeasurementSet) -> CalibrationRequest {
    let alone = CalibrationRequest {
        model: Some(request.model()),
        method: Method::LeastSquares,
        verify: VerifySource::Fraction(0.0),
        ..CalibrationRequest::new(request.robot.clone(), set.clone())
    };
    let model = model_parameters(&alone, set.n_targets());
    let known: BTreeSet<String> = model.iter().map(Parameter::name).collect();
    // The names of other sessions' targets do not exist in this session.
    let of_session = |names: &[String]| {
        names
            .iter()
            .filter(|n| known.contains(*n))
            .cloned()
            .collect()
    };
    let parameters = match &request.parameters {
        ParameterChoice::All => ParameterChoice::All,
        ParameterChoice::Hold(names) => ParameterChoice::Hold(of_session(names)),
        ParameterChoice::Identify(names) => ParameterChoice::Identify(of_session(names)),
    };
    CalibrationRequest {
        parameters,
        ..alone
    }
}

fn of_session(session: usize, error: Error) -> Error {
    match error {
        Error::Unusable { code, detail } => Error::Unusable {
            code,
            detail: format!(
                "{} by itself, as it is compared with the others before all are fitted together: {detail}",
                name(session)
            ),
        },
        Error::Cancelled => Error::Cancelled,
    }
}

/// Result of the comparison of sessions.
#[derive(Clone, Debug, PartialEq)]
pub struct Pool {
    /// Test of the two least similar sessions.
    chi_square: f64,
    n_combinations: usize,
    probability: f64,
    /// Noise of each session, mm.
    pub noise_mm: Vec<f64>,
}

/// Compares the sessions of a request; `None` for a single upload.
///
/// # Errors
/// [`Error::Unusable`] with code `sessions_differ` if they are not one robot in one state, `target_mounted_anew` if a target of the same
/// name was mounted anew between them, `noise_overstated` if a session states far too much noise for a comparison, `session_not_comparable`
/// if a session cannot be compared; [`Error::Cancelled`].
pub fn compare_sessions(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Pool>, Error> {
    if request.sessions.is_empty() {
        return Ok(None);
    }
    let pool = stage(monitor, "compare_sessions", |monitor| {
        check(request)?;
        let mut estimates = Vec::new();
        for (session, set) in request.sessions.iter().enumerate() {
            let found = estimate_with_noise(&alone(request, set), &mut quiet(monitor))?;
            let (estimate, overstated) = found.ok_or_else(|| not_comparable(session))?;
            if let Some(overstated) = overstated {
                return Err(too_coarse(session, &overstated));
            }
            estimates.push(estimate);
        }
        let alarm = share_of_alarms(request);
        shared_targets_agree(request, &estimates, alarm)?;
        bases_agree(request, &estimates, alarm)?;
        pooled(&estimates, alarm).map_err(|error| match error {
            Error::Unusable { code, detail } => Error::Unusable {
                code,
                detail: detail + &scale_remark(request),
            },
            other => other,
        })
    });
    pool.map(Some)
}

fn not_comparable(session: usize) -> Error {
    let detail = format!(
        "{} cannot be identified from by itself, so nothing shows that the robot was then as it was in the others: measure more poses there, or leave it \
         out",
        name(session)
    );
    unusable("session_not_comparable", detail)
}

fn too_coarse(session: usize, overstated: &OverstatedNoise) -> Error {
    let detail = format!(
        "in {} {}: with such a noise two different robots look the same, so nothing shows that the robot was then as it was in the others. State the \
         instrument's noise in mm, or leave it out",
        name(session),
        overstated.in_words()
    );
    unusable(NOISE_OVERSTATED, detail)
}

/// Significance level of each single test, such that all tests together have the stated probability of a false alarm. For each pair of
/// sessions there are tests of the robot, of the base (in one frame), and of the shared targets.
fn share_of_alarms(request: &CalibrationRequest) -> f64 {
    let sets = &request.sessions;
    let of_base = usize::from(request.set.frame == Frame::Base);
    let of_targets = |(a, b): (usize, usize)| shared_targets(&sets[a], &sets[b]).count();
    let n_tests: usize = pairs(sets.len())
        .map(|pair| 1 + of_base + of_targets(pair))
        .sum();
    FALSE_ALARMS / n_tests.max(1) as f64
}

/// Text about the changes that a test found.
fn changes_of(tested: &Tested) -> String {
    match tested.changes.is_empty() {
        true => "no single number explains the difference".into(),
        false => list(&tested.changes.iter().collect::<Vec<_>>()),
    }
}

/// Refuses sessions in which a target of the same name was not at the same place on the tool.
fn shared_targets_agree(
    request: &CalibrationRequest,
    estimates: &[Estimate],
    alarm: f64,
) -> Result<(), Error> {
    let sets = &request.sessions;
    for (earlier, later) in pairs(sets.len()) {
        for (target, in_earlier, in_later) in shared_targets(&sets[earlier], &sets[later]) {
            let (before, after) = (&estimates[earlier], &estimates[later]);
            let tested = compare_target(before, in_earlier, after, in_later);
            let Some(tested) = tested.filter(|tested| tested.probability < alarm) else {
                continue;
            };
            let detail = format!(
                "target {target:?} is at different places of the tool in {} and {}, so it was mounted anew or the tool is another one: {} (chi-square {:.1} of {} \
                 combinations; an unchanged mounting shows as much with probability {}). Give it another target_name in one of the sessions, or none",
                name(earlier),
                name(later),
                changes_of(&tested),
                tested.chi_square,
                tested.n_combinations,
                probability_in_words(tested.probability)
            );
            return Err(unusable(TARGET_MOUNTED_ANEW, detail));
        }
    }
    Ok(())
}

/// Refuses sessions in the base frame if the base moved between them, because corrected targets are valid for one base only.
fn bases_agree(
    request: &CalibrationRequest,
    estimates: &[Estimate],
    alarm: f64,
) -> Result<(), Error> {
    if request.set.frame != Frame::Base {
        return Ok(());
    }
    for (earlier, later) in pairs(estimates.len()) {
        let tested = compare_base(&estimates[earlier], &estimates[later]);
        let Some(tested) = tested.filter(|tested| tested.probability < alarm) else {
            continue;
        };
        let detail = format!(
            "the base is elsewhere in {} than in {}, though both are in the base frame: {} (chi-square {:.1} of {} combinations; an unmoved base shows as \
             much with probability {}). The robot was moved, or the frame was set up anew. Identify the last session alone; or upload them with \
             frame=instrument, where each session has its own base",
            name(later),
            name(earlier),
            changes_of(&tested),
            tested.chi_square,
            tested.n_combinations,
            probability_in_words(tested.probability)
        );
        return Err(unusable(SESSIONS_DIFFER, detail));
    }
    Ok(())
}

fn names_of_shared_targets(sets: &[MeasurementSet]) -> Vec<String> {
    let names: BTreeSet<&str> = pairs(sets.len())
        .flat_map(|(a, b)| shared_targets(&sets[a], &sets[b]))
        .map(|(name, ..)| name)
        .collect();
    names.into_iter().map(str::to_owned).collect()
}

fn pooled(estimates: &[Estimate], alarm: f64) -> Result<Pool, Error> {
    let mut least_alike: Option<(usize, usize, Tested)> = None;
    for (earlier, later) in pairs(estimates.len()) {
        let tested = compare(&estimates[earlier], &estimates[later])
            .ok_or_else(|| not_comparable(later))?
            .robot;
        let is_less_alike = |(_, _, least): &(usize, usize, Tested)| {
            (tested.probability, -tested.chi_square) < (least.probability, -least.chi_square)
        };
        if least_alike.as_ref().is_none_or(is_less_alike) {
            least_alike = Some((earlier, later, tested));
        }
    }
    let (earlier, later, tested) = least_alike.ok_or_else(|| not_comparable(0))?;
    if tested.probability < alarm {
        return Err(differ(earlier, later, &tested, alarm));
    }
    Ok(Pool {
        chi_square: tested.chi_square,
        n_combinations: tested.n_combinations,
        probability: tested.probability,
        noise_mm: noises_mm(&estimates.iter().map(|e| e.noise).collect::<Vec<_>>()),
    })
}

fn differ(earlier: usize, later: usize, tested: &Tested, alarm: f64) -> Error {
    let detail = format!(
        "{} and {} are not one robot in one state, so nothing was fitted to both: from the one to the other {} (chi-square {:.1} of {} combinations that both see; \
         an unchanged robot shows as much with probability {}, and sessions are refused at less than {}). Identify each by itself, and find out what happened \
         to the robot between them",
        name(earlier),
        name(later),
        changes_of(tested),
        tested.chi_square,
        tested.n_combinations,
        probability_in_words(tested.probability),
        probability_in_words(alarm)
    );
    unusable(SESSIONS_DIFFER, detail)
}

/// Noise of each session, mm: its own if it has enough redundancy, else the pooled noise. Empty if all noise is zero.
fn noises_mm(sessions: &[Noise]) -> Vec<f64> {
    let freedom: f64 = sessions.iter().map(|noise| noise.freedom).sum();
    let squares = sessions
        .iter()
        .map(|noise| noise.freedom * noise.std_mm * noise.std_mm);
    let of_all_mm = (squares.sum::<f64>() / freedom).sqrt();
    let own = |noise: &Noise| match noise.freedom < MIN_REDUNDANT {
        true => of_all_mm,
        false => noise.std_mm,
    };
    let all: Vec<f64> = sessions.iter().map(own).collect();
    let least_mm = MIN_NOISE_SHARE * all.iter().copied().fold(0.0, f64::max);
    match least_mm > 0.0 {
        true => all
            .into_iter()
            .map(|noise_mm| noise_mm.max(least_mm))
            .collect(),
        false => vec![],
    }
}

impl Pool {
    /// The entry in the report. `points` are those of the joined set, in its order.
    pub fn report(&self, request: &CalibrationRequest, points: &[PointErrors]) -> PooledSessions {
        let rows = first_rows(&request.sessions);
        let session = |session: usize| {
            let first_row = rows[session];
            let points = &points[first_row..rows[session + 1]];
            let rms_mm = |subset: Subset| {
                let of_subset = points.iter().filter(|point| point.subset == subset);
                let sizes: Vec<f64> = of_subset.map(|point| point.after_mm).collect();
                let squares: f64 = sizes.iter().map(|mm| mm * mm).sum();
                (!sizes.is_empty()).then(|| (squares / sizes.len() as f64).sqrt())
            };
            PooledSession {
                first_row,
                n_points: points.len(),
                noise_std_mm: self.noise_mm.get(session).copied(),
                identify_rms_mm: rms_mm(Subset::Identify),
                verify_rms_mm: rms_mm(Subset::Verify),
            }
        };
        PooledSessions {
            sessions: (0..request.sessions.len()).map(session).collect(),
            chi_square: self.chi_square,
            n_combinations: self.n_combinations,
            probability: self.probability,
            shared_targets: names_of_shared_targets(&request.sessions),
        }
    }
}
