//! Searches for corrections of effects that links cannot describe, after the links are identified. The identified links do not change.

use crate::calibration::outcome::delivery::delivered;
use crate::calibration::preparation::observe::stated_scale_mm;
use crate::calibration::problem::Problem;
use crate::calibration::report::Warning;
use crate::calibration::request::{CalibrationRequest, CorrectionsChoice, Preset};
use crate::calibration::validation::robust_comparison::robust_comparison;
use crate::calibration::{Event, Monitor};
use crate::identification::corrections::corrected::{CorrectedModel, IdentifiedRobot};
use crate::identification::corrections::{COMPLIANCE, Evidence, Fitted, Setting, select};
use crate::identification::model::correction_terms::Term;
use crate::identification::model::objective::{
    Observation, weighted_residuals, with_stations_moved,
};
use crate::identification::model::pose_rows::rotation_residual_rad;
use crate::identification::{self, KinematicModel};
use crate::kinematics::compliance::{moments, rigid_chain};
use crate::kinematics::{MeasuredRegion, Mounting, reach_mm};
use crate::measurement::{Frame, Subset};
use nalgebra::Vector3;

/// Uncertainty of the gravity direction if no mounting is stated, rad: a robot on a floor that is level to 2°.
const USUAL_MOUNTING_STD_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Uncertainty of the gravity direction in the base frame if the instrument was levelled, rad. The level itself is accurate to thousandths
/// of a degree; the rotation of the base, from the nominal robot placed on the points, is accurate to a tenth of a degree.
const LEVELLED_STD_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// Gravity contradicts the mounting if it deviates by more than this number of its standard deviations, and by more than `MIN_TILT_RAD` (0.5°).
const CONTRADICTED_SIGMAS: f64 = 3.0;
const MIN_TILT_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// The direction of gravity counts as unknown if the mounting's standard deviation is larger, rad (30°).
const ANY_MOUNTING_RAD: f64 = std::f64::consts::FRAC_PI_6;
/// Maximum number of points for identifying corrections, evenly selected: many more than there are unknowns.
const MAX_POINTS: usize = 3_000;
/// An rms of residuals below this share of the reach is rounding, with nothing to explain: 1 µm on an arm of 1.7 m.
const EXACT_PER_REACH: f64 = 1e-3 / 1700.0;

/// Result of the search for corrections.
pub struct Found {
    /// Corrections that were tried.
    pub evidence: Vec<Evidence>,
    /// The robot with the kept corrections, in the frame of the fit.
    pub corrected: Option<CorrectedModel>,
    /// The fit of the kept corrections.
    pub fitted: Option<Fitted>,
}

impl Found {
    /// All points of the problem, placed for the robot with corrections. Set-ups of the instrument other than the reference have other
    /// motions than for the links alone.
    pub fn placed(&self, problem: &Problem<'_>) -> Vec<Observation> {
        let fitted = self.fitted.as_ref();
        let motions = fitted.map_or(&[][..], |fitted| &fitted.station_motions);
        with_stations_moved(&problem.observed.all, motions)
    }
}

/// Points with nonzero weight, at a fitted model.
pub(super) struct Points {
    pub(super) observations: Vec<Observation>,
    /// The number of each point's configuration, from 0.
    pub(super) clusters: Vec<usize>,
    sessions: Vec<Option<String>>,
}

impl Points {
    /// The identify points with the weights of the request's loss, thinned evenly to [`MAX_POINTS`].
    pub(super) fn new(problem: &Problem<'_>, model: &KinematicModel) -> Self {
        let weighted = problem.loss.reweighted(model, &problem.identify);
        let clusters = problem.observed.clusters(Subset::Identify);
        let rows = (0..problem.observed.all.len())
            .filter(|row| problem.observed.subsets[*row] == Subset::Identify);
        let all = weighted.into_iter().zip(clusters).zip(rows);
        let with_weight: Vec<_> = all.filter(|((o, _), _)| o.weight > 0.0).collect();
        let step = with_weight.len().div_ceil(MAX_POINTS).max(1);
        let taken: Vec<_> = with_weight.into_iter().step_by(step).collect();
        let session = |row: usize| problem.request.set.points[row].session.clone();
        Self {
            clusters: renumbered(taken.iter().map(|((_, cluster), _)| *cluster)),
            sessions: taken.iter().map(|(_, row)| session(*row)).collect(),
            observations: taken.into_iter().map(|((o, _), _)| o).collect(),
        }
    }

    /// σ² of the links alone, mm²; `None` if nothing is left to explain.
    fn variance(&self, problem: &Problem<'_>, model: &KinematicModel) -> Option<f64> {
        let rows = weighted_residuals(model, &self.observations);
        let n_unknowns = problem.decomposition.rank() + problem.n_station_variables();
        let freedom = rows.len() as f64 - n_unknowns as f64;
        let variance = rows.norm_squared() / freedom;
        let noise_mm =
            stated_scale_mm(&problem.request.set).max(EXACT_PER_REACH * reach_mm(&model.links));
        (freedom > 0.0 && variance > noise_mm * noise_mm).then_some(variance)
    }
}

/// Everything that stays the same in all fits of corrections.
pub(super) fn setting<'a>(problem: &Problem<'_>, points: &'a Points) -> Setting<'a> {
    let request = problem.request;
    let nominal = delivered(problem, &problem.nominal);
    let mounting = by_level(request, &nominal)
        .or(request.robot.mounting)
        .unwrap_or(Mounting {
            gravity_in_base: -Vector3::z(),
            std_rad: USUAL_MOUNTING_STD_RAD,
        });
    let mut links = problem.rows(&points.observations, &[]);
    links.reference = nominal;
    Setting {
        links,
        mounting,
        payload: request.payload,
        observations: &points.observations,
    }
}

/// Gravity in the base frame from the level of the instrument, if it was levelled. `nominal` is the nominal robot, placed on the points.
fn by_level(request: &CalibrationRequest, nominal: &KinematicModel) -> Option<Mounting> {
    let is_known = request.set.is_levelled && request.set.frame == Frame::Instrument;
    is_known.then(|| Mounting {
        gravity_in_base: nominal.t_instrument_base.rotation.inverse() * -Vector3::z(),
        std_rad: LEVELLED_STD_RAD,
    })
}

/// Warning if the stated mounting deviates from the instrument's level by more than the uncertainty of both allows.
pub fn level_contradicts_mounting(problem: &Problem<'_>) -> Option<Warning> {
    let stated = problem.request.robot.mounting?;
    let by_level = by_level(problem.request, &problem.nominal)?;
    let tilt_rad = stated.gravity_in_base.angle(&by_level.gravity_in_base);
    let std_rad = libm::hypot(stated.std_rad, by_level.std_rad);
    let sigmas = tilt_rad / std_rad;
    (sigmas > CONTRADICTED_SIGMAS && tilt_rad > MIN_TILT_RAD).then(|| {
        let detail = format!(
            "by the level of the instrument gravity is {:.1}° from the mounting as it is stated: {sigmas:.1} times the {:.2}° (one standard deviation) \
             to which both are known. Check how the robot is mounted, and whether the instrument was levelled (instrument_levelled)",
            tilt_rad.to_degrees(),
            std_rad.to_degrees()
        );
        Warning::new("mounting_contradicted", detail)
    })
}

fn region(observations: &[Observation], n_joints: usize) -> MeasuredRegion {
    MeasuredRegion::of(observations.iter().map(|o| o.q_rad.as_slice()), n_joints)
}

/// True if corrections are searched for. The default is yes, except in the paper's preset.
pub fn are_wanted(choice: Option<CorrectionsChoice>, preset: Preset) -> bool {
    match choice {
        Some(choice) => choice == CorrectionsChoice::Auto,
        None => preset == Preset::Default,
    }
}

/// Warning if the fitted gravity direction deviates from the known one (the instrument's level, else the mounting) by more than its uncertainty allows.
pub fn mounting_contradicted(problem: &Problem<'_>, found: &Found) -> Option<Warning> {
    let fitted = found.fitted.as_ref()?;
    let of_gravity = fitted.terms.iter().zip(&fitted.values);
    let squares: f64 = of_gravity
        .filter(|(term, _)| matches!(term, Term::Gravity(_)))
        .map(|(_, tilt)| tilt * tilt)
        .sum();
    // the fitted direction is normalised to a unit vector, so the tilt is an arctangent
    let tilt_rad = libm::atan(squares.sqrt());
    let by_level = by_level(problem.request, &problem.nominal);
    let stated = by_level.or(problem.request.robot.mounting);
    let std_rad = stated.map_or(USUAL_MOUNTING_STD_RAD, |m| m.std_rad);
    let sigmas = tilt_rad / std_rad.max(f64::MIN_POSITIVE);
    let as_known = match stated {
        Some(_) if by_level.is_some() => "gravity by the level of the instrument",
        Some(_) => "the mounting as it is stated",
        None => "a floor, on which a robot stands where no mounting is stated",
    };
    if std_rad < ANY_MOUNTING_RAD && gives_against_gravity(problem, found) {
        let detail = format!(
            "the robot gives way against {as_known}: it hangs the other way round, or a counterbalance or the controller lifts it by more than it sags. Check how \
             it is mounted, and state it with the robot"
        );
        return Some(Warning::new("mounting_contradicted", detail));
    }
    (sigmas > CONTRADICTED_SIGMAS && tilt_rad > MIN_TILT_RAD).then(|| {
        let detail = format!(
            "the robot sags as if it hung at least {:.1}° from {as_known}: {sigmas:.1} times the {:.2}° (one standard deviation) to which that is known, and \
             that holds the figure back. Check how it is mounted, and state it with the robot",
            tilt_rad.to_degrees(),
            std_rad.to_degrees()
        );
        Warning::new("mounting_contradicted", detail)
    })
}

/// True if gravity does negative work on the joints over all points, Σ M·(K∘M) < 0. Elastic deflection follows the load, so this is
/// impossible. It is said only where compliance clearly reduces the error of points that were not fitted.
fn gives_against_gravity(problem: &Problem<'_>, found: &Found) -> bool {
    let is_clear = |tried: &Evidence| {
        let least_mm2 = CONTRADICTED_SIGMAS * tried.standard_error_mm2;
        tried.kept && tried.kind == COMPLIANCE && tried.gain_mm2 > least_mm2
    };
    let Some(corrected) = found.corrected.as_ref() else {
        return false;
    };
    let compliance = &corrected.corrections.compliance;
    let of_pose = |o: &Observation| -> f64 {
        let moments = moments(&rigid_chain(&corrected.model.links, &o.q_rad), compliance);
        let joints = compliance.joints_rad.iter().zip(&moments.joints);
        joints.map(|(k, m)| k.component_mul(m).dot(m)).sum()
    };
    found.evidence.iter().any(is_clear) && problem.identify.iter().map(of_pose).sum::<f64>() < 0.0
}

/// Warning: no corrections were searched for, because bounds are stated.
pub fn left_out_for_bounds() -> Warning {
    let detail = "what links cannot say (sag, couplings, harmonics, the residual network) was not looked for, because parameters have bounds: \
                  `links_with_corrections` would not keep to them. The set predicts by its links alone; leave `min` and `max` out to have corrections";
    Warning::new("corrections_left_out", detail)
}

/// Warning: no corrections were searched for in a partial recalibration.
pub fn left_out_of_a_part() -> Warning {
    let detail = "what links cannot say (sag, couplings, harmonics, the residual network) was not looked for, because most parameters were held: \
                  corrections would say what those leave over. The set predicts by its links alone; identify all parameters to have corrections";
    Warning::new("corrections_left_out", detail)
}

/// Veto by the verify points. It selects nothing: it keeps all corrections, or drops all of them if the robot with corrections is further
/// from these points than its links alone. The links of `robot` are placed at `points`. The robot with corrections is placed at
/// `corrected_points`, which are the same points.
pub fn veto(
    found: Found,
    robot: &IdentifiedRobot,
    points: &[Observation],
    corrected_points: &[Observation],
) -> (Found, Option<Warning>) {
    if robot.corrected.is_none() {
        return (found, None);
    }
    let size = |predicted_mm: Vector3<f64>, o: &Observation| (o.position_mm - predicted_mm).norm();
    let errors_mm: Vec<[f64; 3]> = points
        .iter()
        .zip(corrected_points)
        .map(|(o, of_corrected)| {
            let links_mm = size(robot.plain.position(&o.q_rad, o.target), o);
            let corrected_mm = size(robot.position(&o.q_rad, o.target), of_corrected);
            [links_mm, corrected_mm, corrected_mm]
        })
        .collect();
    // Points that both predictions miss by far are left out.
    let comparison = robust_comparison(&errors_mm);
    let (links_mm, corrected_mm) = (comparison.before_rms_mm, comparison.after_rms_mm);
    let [links_rad, corrected_rad] = rotation_rms_rad(robot, points, corrected_points);
    if (corrected_mm <= links_mm && corrected_rad <= links_rad) || errors_mm.is_empty() {
        return (found, None);
    }
    let drop = |tried: Evidence| Evidence {
        kept: false,
        dropped_because: tried.kept.then(|| "worse_on_verify_points".into()),
        ..tried
    };
    let found = Found {
        evidence: found.evidence.into_iter().map(drop).collect(),
        corrected: None,
        fitted: None,
    };
    let turned = match corrected_rad > links_rad {
        true => format!(
            " (its tool is turned by {:.4}° with them and {:.4}° without)",
            corrected_rad.to_degrees(),
            links_rad.to_degrees()
        ),
        false => String::new(),
    };
    let detail = format!(
        "corrections won on the identify points, but on the {} points to verify{} the robot is {corrected_mm:.4} mm rms off with them and {links_mm:.4} mm \
         with its links alone{turned}: all were dropped, and the set predicts by its links alone. Identify from poses that cover the workspace of \
         the points to verify, and check that payload and mounting are as stated",
        points.len(),
        comparison.remark()
    );
    let warning = Warning::new("corrections_worse_on_verify_points", detail);
    (found, Some(warning))
}

/// Rotation errors of measured poses by the links alone and with corrections: root mean squares, rad; 0 without poses.
fn rotation_rms_rad(
    robot: &IdentifiedRobot,
    points: &[Observation],
    corrected_points: &[Observation],
) -> [f64; 2] {
    let (mut sums, mut n) = ([0.0; 2], 0.0f64);
    for (o, of_corrected) in points.iter().zip(corrected_points) {
        let (Some(measured), Some(measured_there), Some(plain), Some(corrected)) = (
            o.rotation.as_ref(),
            of_corrected.rotation.as_ref(),
            robot.plain.rotation(&o.q_rad, o.target),
            robot.rotation(&o.q_rad, o.target),
        ) else {
            continue;
        };
        sums[0] += rotation_residual_rad(&plain, measured).norm_squared();
        sums[1] += rotation_residual_rad(&corrected, measured_there).norm_squared();
        n += 1.0;
    }
    sums.map(|sum| (sum / n.max(1.0)).sqrt())
}

/// Searches for corrections of the identified `model`. Returns nothing if the monitor breaks.
pub fn corrections(
    problem: &Problem<'_>,
    model: &KinematicModel,
    monitor: &mut Monitor<'_>,
) -> Found {
    let request = problem.request;
    let nothing = Found {
        evidence: vec![],
        corrected: None,
        fitted: None,
    };
    let points = Points::new(problem, model);
    let observations = &points.observations;
    let Some(variance) = points.variance(problem, model) else {
        return nothing;
    };
    let setting = setting(problem, &points);
    let n_links = setting.links.reference.links.len();
    let start = Fitted::of_links(delivered(problem, model), variance);
    let mut go_on = || monitor(Event::Heartbeat).is_continue();
    let Some(selected) = select(
        &setting,
        &start,
        &points.clusters,
        &points.sessions,
        request.residual_network.as_ref(),
        request.seed,
        &mut go_on,
    ) else {
        return nothing;
    };
    let is_kept = selected.evidence.iter().any(|tried| tried.kept);
    let corrected = is_kept.then(|| CorrectedModel {
        model: selected.fitted.model.clone(),
        corrections: selected.corrections,
        region: region(observations, n_links),
    });
    Found {
        evidence: selected.evidence,
        corrected,
        fitted: is_kept.then_some(selected.fitted),
    }
}

/// Fits the kept corrections again, together with `model`, to all identify points of another problem. `None` if no correction was kept, or
/// if the equations cannot be solved.
pub fn refit(
    problem: &Problem<'_>,
    model: &KinematicModel,
    found: &Found,
    monitor: &mut Monitor<'_>,
) -> Option<(CorrectedModel, Fitted)> {
    let (fitted, kept) = (found.fitted.as_ref()?, found.corrected.as_ref()?);
    let points = Points::new(problem, model);
    let mut go_on = || monitor(Event::Heartbeat).is_continue();
    let (fitted, corrections) = identification::corrections::refit(
        &setting(problem, &points),
        fitted,
        kept.corrections.residual.is_some(),
        problem.request.residual_network.as_ref(),
        problem.request.seed,
        &mut go_on,
    )?;
    let corrected = CorrectedModel {
        model: fitted.model.clone(),
        corrections,
        region: region(&points.observations, fitted.model.links.len()),
    };
    Some((corrected, fitted))
}

/// Numbers from 0 in order of first appearance.
fn renumbered(labels: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut known = std::collections::BTreeMap::new();
    let mut number = |label| {
        let next = known.len();
        *known.entry(label).or_insert(next)
    };
    labels.map(&mut number).collect()
}
