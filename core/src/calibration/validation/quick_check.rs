//! `kind: "check"`: whether the released set is still valid, from a few poses. The points are scored as in a verification. In addition, one
//! test compares their errors with those expected from the set's own estimate, and the smallest detectable changes are computed.

use crate::calibration::method::{After, CheckVerdict};
use crate::calibration::preparation::observe::observe_to_verify;
use crate::calibration::quick_check::{
    CHECK_CANNOT_TELL, CHECK_CHANGED, CheckTest, DetectableChange, FEW_CAUSES, LikeliestCause,
    QuickCheck,
};
use crate::calibration::report::{BASE_NOT_CHECKED, CalibrationReport, DOES_NOT_FIT, Warning};
use crate::calibration::request::{CalibrationRequest, Estimate};
use crate::calibration::validation::check_in_words::{Found, ZERO_HIDDEN, reason, what_next};
use crate::calibration::validation::enough_points::{check_verify, is_placed_anew};
use crate::calibration::validation::session_fit::{error_ratio, smallest_reported_error_mm};
use crate::calibration::validation::verdict::{
    MISSES_SESSION, NO_BETTER, SET_FAR_OFF, WORSE_THAN_IDENTIFIED,
};
use crate::calibration::validation::verification_set::n_stations;
use crate::calibration::validation::verify::verify;
use crate::calibration::{Error, Monitor, unusable};
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::least_squares::start::fit_base_and_targets;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::{Parameter, Quantity};
use crate::identification::statistics::changes::{Change, FALSE_ALARMS};
use crate::identification::statistics::quick_check::{
    Causes, Checked, Detectable, LEVEL, POWER, Poses, Untestable, quick_check,
};
use crate::kinematics::reach_mm;
use crate::measurement::Point;
use std::cmp::Ordering;

/// Minimum number of configurations of a check.
pub const MIN_CONFIGURATIONS: usize = 5;
/// The usual number of configurations.
const USUAL_CONFIGURATIONS: usize = 10;
/// Maximum number of points of a check. The test uses the joint covariance of all their coordinates, and a larger set is a session to verify on.
pub const MAX_POINTS: usize = 300;
/// Two robots are the same if their flange positions differ by less than this share of the reach.
const SAME_ROBOT_PER_REACH: f64 = 1e-9;

/// The released set that is checked.
#[derive(Clone, Copy, Debug)]
pub struct ReleasedSet<'a> {
    /// Its robot.
    pub robot: &'a IdentifiedRobot,
    /// The estimate that was stored with it.
    pub estimate: Option<&'a Estimate>,
    /// What happened to the robot before the check, if stated.
    pub after: Option<After>,
    /// True if the points were measured after the robot's other uploads and do not repeat one of them.
    pub is_measured_anew: bool,
    /// True if the upload was refused and the uploader insisted.
    pub is_insisted_on: bool,
}

/// The checks of [`check_released`] that need no fit.
///
/// # Errors
/// As [`check_verify`], and [`Error::Unusable`] with code `under_determined` for too few configurations or several stations, and `too_many_points`.
pub fn check_quick_check(
    request: &CalibrationRequest,
    identified: &KinematicModel,
) -> Result<(), Error> {
    let n = request.set.n_distinct_configurations();
    if n < MIN_CONFIGURATIONS {
        let more = MIN_CONFIGURATIONS - n;
        return Err(unusable(
            "under_determined",
            format!(
                "a quick check takes at least {MIN_CONFIGURATIONS} arm configurations ({USUAL_CONFIGURATIONS} are usual), and this set has {n}: measure at \
                 least {more} more, with every joint moving"
            ),
        ));
    }
    let n_points = request.set.points.len();
    if n_points > MAX_POINTS {
        return Err(unusable(
            "too_many_points",
            format!(
                "a quick check takes at most {MAX_POINTS} points, and this set has {n_points}: a verification says more"
            ),
        ));
    }
    let stations = n_stations(&request.set);
    if stations > 1 {
        return Err(unusable(
            "under_determined",
            format!(
                "a quick check takes points from one station of the instrument, and these are from {stations}: upload those of one station, or verify \
                 the set on them"
            ),
        ));
    }
    check_verify(request, Some(identified))
}

/// Checks the released set: [`verify`], with the verdict in `quick_check`.
///
/// # Errors
/// As [`check_quick_check`], and [`Error::Cancelled`].
pub fn check_released(
    request: &CalibrationRequest,
    released: &ReleasedSet<'_>,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    check_quick_check(request, &released.robot.plain)?;
    let mut report = verify(request, Some(released.robot), monitor)?;
    // The test below compares these few points with the errors that the set predicts. A fit to them alone would leave too few equations.
    report.warnings.retain(|w| w.code != MISSES_SESSION);
    let found = verdict_of(request, released, &report);
    let code = match found.verdict {
        CheckVerdict::Holds => None,
        CheckVerdict::Changed => Some(CHECK_CHANGED),
        CheckVerdict::CannotTell => Some(CHECK_CANNOT_TELL),
    };
    report.method_reason = format!("nothing was identified: {}", found.reason);
    let warning =
        code.map(|code| Warning::new(code, format!("{}. Next: {}", found.reason, found.next)));
    report.warnings.splice(0..0, warning);
    report.quick_check = Some(found);
    Ok(report)
}

/// The points as the test uses them: the model and its observations.
struct Points {
    model: KinematicModel,
    observations: Vec<Observation>,
    is_placed_anew: bool,
}

/// The positions, with targets numbered as in the model. `None` if the stored estimate does not belong to the released set.
fn points(request: &CalibrationRequest, plain: &KinematicModel, kept: &Estimate) -> Option<Points> {
    let observed = observe_to_verify(request).all;
    // A camera on the robot measures the position of the board in the camera's frame; this depends on the rotation.
    let with_weight = |o: Observation| match o.coupling() {
        Some(_) => o,
        None => o.position_alone(),
    };
    let mut observations: Vec<Observation> = observed.into_iter().map(with_weight).collect();
    let nearest = SAME_ROBOT_PER_REACH * reach_mm(&plain.links);
    let is_same = plain.links.len() == kept.model.links.len()
        && observations.iter().all(|o| {
            let flange = |model: &KinematicModel| {
                let bare = KinematicModel::nominal(&model.links, 1);
                bare.position(&o.q_rad, 0)
            };
            (flange(plain) - flange(&kept.model)).norm() <= nearest
        });
    if !is_same {
        return None;
    }
    if is_placed_anew(request, Some(plain)) {
        let n_targets = request.set.n_targets();
        return Some(Points {
            model: fit_base_and_targets(&plain.links, &observations, n_targets),
            observations,
            is_placed_anew: true,
        });
    }
    for observation in &mut observations {
        // The model has one target per segment of a target that moved during the measurement.
        let own = plain.targets_mm.get(observation.target)?;
        let mut kept = kept.model.targets_mm.iter();
        observation.target = kept.position(|target| (target - own).norm() <= nearest)?;
    }
    Some(Points {
        model: kept.model.clone(),
        observations,
        is_placed_anew: false,
    })
}

/// The test and the uncertainty that it uses, or why there is no test.
fn tested(
    request: &CalibrationRequest,
    released: &ReleasedSet<'_>,
) -> Result<(Checked, bool), String> {
    let Some(kept) = released.estimate else {
        return Err(
            "no uncertainty was kept with the set (an older version made it, priors were stated, or none could be stated)"
                .into(),
        );
    };
    let points = points(request, &released.robot.plain, kept)
        .ok_or("the uncertainty that was kept is not that of these links and targets")?;
    let stated = request.set.points.iter();
    let poses = Poses {
        before: kept,
        model: &points.model,
        observations: &points.observations,
        configurations: &request.set.configuration_numbers(),
        stated_std_mm: &stated
            .map(|point| point.position_std_mm().unwrap_or(0.0))
            .collect::<Vec<_>>(),
        is_placed_anew: points.is_placed_anew,
    };
    let checked = quick_check(&poses).map_err(|why| match why {
        Untestable::NothingLeft => "base and reflector take up every equation of these poses",
        Untestable::NoiseUnknown => "the set's own session had too few points to tell its noise",
        Untestable::Singular => "the equations cannot be solved",
    })?;
    Ok((checked, points.is_placed_anew))
}

fn verdict_of(
    request: &CalibrationRequest,
    released: &ReleasedSet<'_>,
    report: &CalibrationReport,
) -> QuickCheck {
    let has = |code| report.warnings.iter().any(|w| w.code == code);
    let tested = tested(request, released);
    let verified_rms_mm = request.held_out.map(|held_out| held_out.identified_rms_mm);
    let rms_mm = report.verify.map_or(0.0, |verify| verify.worse().rms_mm);
    let checked = tested.as_ref().ok().map(|(checked, _)| checked);
    let is_placed_anew = tested.as_ref().is_ok_and(|(_, anew)| *anew);
    let detectable = checked.map_or(vec![], detectable);
    let limit_mm =
        verified_rms_mm.map(|verified| smallest_reported_error_mm(verified, &request.robot.links));
    let times = |change: &DetectableChange| Some(change.tool_mm? / limit_mm?);
    // A zero that is invisible in these poses although other poses would show it.
    let last = request.robot.links.len().saturating_sub(1);
    let is_missed = |joint: usize| {
        let never = is_placed_anew && (joint == 0 || joint == last);
        let found = checked.and_then(|checked| checked.joints.get(joint));
        !never
            && found.is_some_and(|found| {
                found.change.is_none() && limit_mm.is_some_and(|limit| found.unseen_tool_mm > limit)
            })
    };
    let is_blind = |(place, change): &(usize, &DetectableChange)| {
        times(change).is_some_and(|times| times > 1.0) || is_missed(*place)
    };
    let is_hidden = |(place, change): &(usize, &DetectableChange)| {
        change.change.is_none() && change.unit == "deg" && !is_missed(*place)
    };
    let places = || detectable.iter().enumerate();
    let blind: Vec<_> = places().filter(is_blind).map(|(_, c)| c).collect();
    let hidden: Vec<_> = places().filter(is_hidden).map(|(_, c)| c).collect();
    // Mastering and the exchange of a motor change zeros. The set cannot be confirmed if one of these zeros is invisible.
    let changes_zeros = matches!(released.after, Some(After::Mastering | After::Motor));
    let is_far = has(DOES_NOT_FIT) || has(SET_FAR_OFF);
    let is_alarm = |p: f64| p.partial_cmp(&LEVEL).is_none_or(Ordering::is_lt);
    let alarms = checked.is_some_and(|checked| is_alarm(checked.probability));
    let is_worse = verified_rms_mm
        .is_some_and(|verified| error_ratio(rms_mm, verified, &request.robot.links).is_some());
    // Reasons why points that fit the set do not prove that it is valid; the most serious one first.
    let doubts = [
        (
            !released.is_measured_anew,
            "these points repeat an earlier upload, and nothing shows whether they were measured since: measure other poses",
        ),
        (
            released.is_insisted_on,
            "the upload was refused and somebody insisted on it",
        ),
        (
            verified_rms_mm.is_none(),
            "no points were held out when the set was identified, so nothing says how large an error matters",
        ),
        (
            has(NO_BETTER),
            "on these points it is no better than the nominal robot",
        ),
        (
            is_worse || has(WORSE_THAN_IDENTIFIED),
            "it is several times worse than when it was verified, within what its own uncertainty lets expect",
        ),
        (
            has(BASE_NOT_CHECKED),
            "the base of the set rests on positions in the base frame, and was placed anew on these points, so a base that moved would not show",
        ),
        (changes_zeros && !hidden.is_empty(), ZERO_HIDDEN),
    ];
    let doubt = doubts.into_iter().find(|(is, _)| *is).map(|(_, why)| why);
    let verdict = if is_far || alarms {
        CheckVerdict::Changed
    } else if tested.is_err() || !blind.is_empty() || doubt.is_some() {
        CheckVerdict::CannotTell
    } else {
        CheckVerdict::Holds
    };
    let likeliest = match (verdict, checked) {
        (CheckVerdict::Changed, Some(checked)) => likeliest(checked, released.after),
        _ => vec![],
    };
    let n_configurations = request.set.n_distinct_configurations();
    let found = Found {
        verdict,
        after: released.after,
        tested: tested.as_ref().map(|_| ()).map_err(String::as_str),
        probability: checked.map(|checked| checked.probability),
        doubt,
        is_far,
        rms_mm,
        verified_rms_mm,
        likeliest: &likeliest,
        blind: &blind,
        hidden: &hidden,
        largest_missed_error_ratio: blind.iter().filter_map(|c| times(c)).fold(1.0, f64::max),
        n_configurations,
        largest_configuration: checked.and_then(|checked| {
            let numbers = request.set.distinct_configurations();
            let outstanding = checked.largest_configuration?;
            let is_outstanding =
                |point: &&Point| numbers[point.configuration.as_str()] == outstanding;
            let found = request.set.points.iter().find(is_outstanding);
            found.map(|point| point.configuration.as_str())
        }),
        n_links: request.robot.links.len(),
        n_targets: request.set.n_targets(),
        is_placed_anew,
        is_repeat: !released.is_measured_anew,
        is_base_hidden: has(BASE_NOT_CHECKED),
    };
    let (reason, next) = (reason(&found), what_next(&found));
    QuickCheck {
        verdict,
        reason,
        after: released.after,
        n_configurations,
        level: LEVEL,
        power: POWER,
        rms_mm,
        verified_rms_mm,
        test: checked.map(|checked| CheckTest {
            statistic: checked.statistic,
            n_combinations: checked.n_combinations,
            freedom: checked.freedom,
            probability: checked.probability,
            expected_rms_mm: checked.expected_mm,
        }),
        likeliest,
        next,
        detectable,
    }
}

fn detectable(checked: &Checked) -> Vec<DetectableChange> {
    let of_joint = |(joint, found): (usize, &Detectable)| DetectableChange {
        name: Parameter::Link(joint, Quantity::ThetaOffset).name(),
        unit: "deg".into(),
        change: found.change.map(f64::to_degrees),
        tool_mm: found.tool_mm,
    };
    let shift = |name: String, found: &Detectable| DetectableChange {
        name,
        unit: "mm".into(),
        change: found.change,
        tool_mm: found.tool_mm,
    };
    let joints = checked.joints.iter().enumerate().map(of_joint);
    let targets = checked.targets.iter().enumerate();
    let targets = targets.map(|(t, found)| shift(format!("target_{t}"), found));
    joints
        .chain([shift("base".into(), &checked.base)])
        .chain(targets)
        .collect()
}

/// Likely causes: the first group of causes in which few changes explain the points; otherwise the changes of all parameters.
fn likeliest(checked: &Checked, after: Option<After>) -> Vec<LikeliestCause> {
    let is_zero = |p: &Parameter| matches!(p, Parameter::Link(_, Quantity::ThetaOffset));
    let of_zeros = || checked.causes(is_zero);
    let of_zeros_and_placement = || checked.causes(|p| is_zero(p) || !p.is_link());
    let explains =
        |causes: &Causes| causes.changes.len() <= FEW_CAUSES && causes.leaves >= FALSE_ALARMS;
    let zeros_first = matches!(after, Some(After::Mastering | After::Motor));
    let found = Some(of_zeros())
        .filter(|causes| zeros_first && explains(causes))
        .or_else(|| Some(of_zeros_and_placement()).filter(explains))
        .unwrap_or_else(|| checked.causes(|_| true));
    found.changes.iter().map(named).collect()
}

fn named(change: &Change) -> LikeliestCause {
    let first = &change.parameters[0];
    LikeliestCause {
        name: change.name(),
        unit: first.unit().into(),
        delta: first.in_unit(change.delta),
        sigmas: change.sigmas,
    }
}
