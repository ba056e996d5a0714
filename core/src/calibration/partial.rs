//! Partial recalibration, for example after a collision. Only the named parameters are identified again. All others keep the values of an earlier
//! identification, and their uncertainty is propagated to the named parameters and to the tool.

use crate::calibration::calibrate::calibrate_with_problem;
use crate::calibration::preparation::observe::{model_parameters, placed};
use crate::calibration::problem::Problem;
use crate::calibration::report::{CalibrationReport, FlangeRotation, NO_FIT, Warning};
use crate::calibration::request::{CalibrationRequest, CorrectionsChoice, PreviousSession};
use crate::calibration::session_comparison::{estimate, list, stored_estimate};
use crate::calibration::solve::corrections;
use crate::calibration::stages::{quiet, stage, watched};
use crate::calibration::validation::verdict::NO_BETTER;
use crate::calibration::warnings::orientation::{self, flange_rotation};
use crate::calibration::warnings::plausibility::JOINT_MAP;
use crate::calibration::{Error, Monitor};
use crate::identification::KinematicModel;
use crate::identification::least_squares::evidence::Noise;
use crate::identification::model::objective::weighted_jacobian;
use crate::identification::model::parameters::{Parameter, Quantity, quantity_mut};
use crate::identification::statistics::changes::{Change, Estimate, compare};
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::identification::statistics::workspace::tool_uncertainty;
use crate::kinematics::{Link, Robot};
use nalgebra::{DMatrix, DMatrixView, Vector3};

/// Coverage probability of a parameter's stated interval.
const CONFIDENCE: f64 = 0.95;

/// If the scatter of the points exceeds the expected scatter by this factor, other parameters may have changed as well.
const MAX_SCATTER_RATIO: f64 = 1.5;

/// An earlier identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Its links.
    pub links: Vec<Link>,
    /// The session that it was identified from.
    pub session: PreviousSession,
}

/// As [`calibrate`](crate::calibration::calibrate()), but starts from the links of an earlier identification. "Before" in the report is the
/// robot with these links. Parameters that are not free keep their values. Their covariance is taken from the earlier session (consider
/// parameters: Schmidt 1966).
pub fn calibrate_partially(
    request: &CalibrationRequest,
    held: &Held,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    // With few free parameters, corrections would absorb the errors of the held parameters.
    let from_held = CalibrationRequest {
        robot: Robot {
            links: held.links.clone(),
            ..request.robot.clone()
        },
        corrections: Some(CorrectionsChoice::Off),
        ..request.clone()
    };
    calibrate_with_problem(&from_held, monitor, |report, problem, monitor| {
        finished(request, held, report, problem, monitor)
    })
}

/// Completes the report of a partial fit: adds the uncertainty from the held parameters, or a warning if held parameters have changed.
fn finished(
    request: &CalibrationRequest,
    held: &Held,
    mut report: CalibrationReport,
    problem: &Problem<'_>,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    if let (Some(verify), Some(told)) = (
        report.verify,
        report
            .warnings
            .iter_mut()
            .find(|told| told.code == NO_BETTER),
    ) {
        told.detail = format!(
            "on points that the fit has not seen the robot with the parameters identified anew ({:.4} mm rms) is no better than the held parameter set \
             ({:.4} mm rms): do not use it",
            verify.after.rms_mm, verify.before.rms_mm
        );
    }
    // The priors of this estimate refer to the held links, not to the nominal links.
    report.estimate = None;
    report.warnings.extend(
        corrections::are_wanted(request.corrections, request.preset)
            .then(corrections::left_out_of_a_part),
    );
    let whole = CalibrationRequest {
        model: Some(request.model()),
        frames: held.session.frames.clone(),
        ..CalibrationRequest::new(request.robot.clone(), held.session.set.clone())
    };
    let of_all_parameters = CalibrationRequest {
        set: request.set.clone(),
        frames: request.frames.clone(),
        ..whole.clone()
    };
    // Estimates of both sessions, with all parameters free.
    let (earlier, anew) = stage(monitor, "held_uncertainty", |monitor| {
        let anew = estimate(&of_all_parameters, &mut quiet(monitor))?;
        let n_targets = held.session.set.n_targets();
        let all = model_parameters(&whole, n_targets);
        let earlier = match stored_estimate(&held.session, &all) {
            Some(kept) => Some(kept.clone()),
            None => estimate(&whole, &mut quiet(monitor))?,
        };
        Ok((earlier, anew))
    })?;
    let of_held = earlier
        .as_ref()
        .and_then(|earlier| held_errors(problem, &report, earlier));
    let others_changed = earlier.as_ref().and_then(|earlier| {
        let own = problem.noise(&model_of(&report));
        others_changed(problem, &own, earlier, anew.as_ref(), of_held.as_ref())
    });
    match (others_changed, of_held, report.uncertainty.clone()) {
        (Some(warning), ..) => withhold(&mut report, warning),
        // The partial fit has no uncertainty, and the report already states why.
        (None, _, None) => {}
        (None, None, Some(_)) => withhold(&mut report, held_uncertainty_unknown()),
        (None, Some(of_held), Some(own)) => {
            let parameters = [problem.parameters.clone(), of_held.held.clone()].concat();
            state(&mut report, problem, &parameters, of_both(&own, &of_held));
        }
    }
    // Uncertainty of the flange's rotation: that of the held robot from the earlier session, combined with that of this session.
    let of_whole = match watched(monitor, |watch| Problem::new(&whole, watch)).flatten() {
        Err(Error::Cancelled) => return Err(Error::Cancelled),
        other => other.ok(),
    };
    let of_held = of_whole.and_then(|problem| {
        let n_targets = problem.screening.targets.len();
        let links = held.links.clone();
        let model = placed(problem.request, links, &problem.identify, n_targets);
        flange_rotation(&problem, &model, &[held.links.as_slice()])
    });
    let n_links = request.robot.links.len();
    let last_zero = Parameter::Link(n_links - 1, Quantity::ThetaOffset);
    let is_last_zero_free = problem.parameters.contains(&last_zero);
    let mut warnings = report.warnings.iter();
    let fits = !warnings.any(|warning| [NO_FIT, JOINT_MAP].contains(&warning.code));
    report.flange_rotation =
        of_held
            .zip(report.flange_rotation)
            .map(|(held, own)| FlangeRotation {
                by_positions_rad: libm::hypot(held.by_positions_rad, own.by_positions_rad),
                // A held joint zero has not changed since the earlier session.
                last_joint_zero_rad: match is_last_zero_free {
                    true => libm::hypot(held.last_joint_zero_rad, own.last_joint_zero_rad),
                    false => held.last_joint_zero_rad,
                },
            });
    report
        .warnings
        .retain(|warning| warning.code != orientation::NOT_KNOWN);
    if fits {
        let warning = orientation::warning(report.flange_rotation, n_links);
        report.warnings.extend(warning);
    }
    from_catalogue(&mut report, &problem.parameters, &request.robot.links);
    Ok(report)
}

/// Warning: the uncertainty of the held parameters is unknown. Without it, every stated uncertainty would be too small.
fn held_uncertainty_unknown() -> Warning {
    let detail = "how uncertain the parameters are that were held cannot be told from the session that they were identified from, so no \
                  uncertainty is stated";
    Warning::new("held_uncertainty_unknown", detail)
}

/// Warning if parameters other than the identified ones have changed. If the new session determines all parameters, the two sessions are compared:
/// held parameters must not differ. Otherwise the scatter of the points must not exceed what the earlier session and the uncertainty of the held
/// parameters explain.
fn others_changed(
    problem: &Problem<'_>,
    own: &Noise,
    earlier: &Estimate,
    anew: Option<&Estimate>,
    of_held: Option<&HeldErrors>,
) -> Option<Warning> {
    let found = match anew {
        Some(anew) => {
            let was_held = |change: &&Change| {
                let mut may_be = change.parameters.iter();
                !may_be.any(|parameter| problem.parameters.contains(parameter))
            };
            let changes = compare(earlier, anew)?.robot.changes;
            let others: Vec<&Change> = changes.iter().filter(was_held).collect();
            (!others.is_empty()).then(|| list(&others))?
        }
        None => {
            let expected = Noise {
                std_mm: libm::hypot(earlier.noise.std_mm, of_held?.scatter_mm),
                ..earlier.noise
            };
            let is_more =
                own.std_mm > MAX_SCATTER_RATIO * expected.std_mm && own.is_more_than(&expected);
            is_more.then(|| {
                format!(
                    "the points scatter by {:.4} mm (one standard deviation of a coordinate), where {:.4} mm are expected",
                    own.std_mm, expected.std_mm
                )
            })?
        }
    };
    let detail = format!(
        "other parameters have changed than those that were identified: {found}. The identified values make up for what was held, so no \
         uncertainty is stated. Identify what has changed, or leave `parameters` out"
    );
    Some(Warning::new("other_parameters_changed", detail))
}

/// Removes the uncertainty from the report and records why.
fn withhold(report: &mut CalibrationReport, why: Warning) {
    report.uncertainty_absent_because = Some(why.detail.clone());
    report.warnings.push(why);
    for outcome in &mut report.parameters {
        (outcome.std_uncertainty, outcome.interval_95) = (None, None);
        if let Some(prior) = &mut outcome.prior {
            prior.share = None;
        }
    }
    (
        report.tool_uncertainty,
        report.uncertainty,
        report.error_model,
    ) = (None, None, None);
}

/// The model of a report, as it was fitted.
fn model_of(report: &CalibrationReport) -> KinematicModel {
    KinematicModel {
        t_instrument_base: report.t_instrument_base,
        links: report.links.clone(),
        targets_mm: report.targets_mm.clone(),
        target_rotations: report.target_rotations.clone(),
    }
}

/// Effect of errors of the held parameters. Each column is one standard deviation of an independent cause.
struct HeldErrors {
    held: Vec<Parameter>,
    /// Errors of the held parameters, one row per held parameter.
    errors: DMatrix<f64>,
    /// Resulting errors of the free parameters, one row per free parameter.
    moved: DMatrix<f64>,
    /// Scatter that these errors leave in the points' residuals: one standard deviation of a coordinate, mm.
    scatter_mm: f64,
}

/// Propagates errors of the held parameters to the free ones: δ_free = −E·J_held·δ_held. E is the least-squares inverse of J_free along the
/// directions that the points determine.
fn held_errors(
    problem: &Problem<'_>,
    report: &CalibrationReport,
    earlier: &Estimate,
) -> Option<HeldErrors> {
    let is_held = |i: &usize| {
        earlier.parameters[*i].is_link() && !problem.parameters.contains(&earlier.parameters[*i])
    };
    let at: Vec<usize> = (0..earlier.parameters.len()).filter(is_held).collect();
    let held: Vec<Parameter> = at.iter().map(|i| earlier.parameters[*i]).collect();
    let (model, at_fit) = (model_of(report), Vector3::zeros());
    let jacobian = |parameters: &[Parameter]| {
        weighted_jacobian(&model, parameters, &problem.identify, &at_fit)
    };
    let errors = earlier.uncertainty.root.select_rows(&at);
    let directions = problem.decomposition.observable_directions();
    let of_free = jacobian(&problem.parameters);
    let (q, r) = (&of_free * &directions).qr().unpack();
    let inverse = directions * r.try_inverse()? * q.transpose();
    let at_points = jacobian(&held) * &errors;
    let moved = inverse * &at_points * -1.0;
    let left = at_points + of_free * &moved;
    let scatter_mm = (left.norm_squared() / left.nrows().max(1) as f64).sqrt();
    moved
        .iter()
        .chain(&errors)
        .all(|v| v.is_finite())
        .then_some(HeldErrors {
            held,
            errors,
            moved,
            scatter_mm,
        })
}

/// Uncertainty of the free parameters, with rows of the held parameters below them.
fn of_both(own: &Uncertainty, of_held: &HeldErrors) -> Uncertainty {
    let (n_free, n_held) = (own.n_parameters, of_held.held.len());
    let (n_own, n_errors) = (own.root.ncols(), of_held.errors.ncols());
    let n_features = own.root.nrows() - n_free;
    let mut root = DMatrix::zeros(n_free + n_held + n_features, n_own + n_errors);
    let mut put = |row: usize, column: usize, part: DMatrixView<'_, f64>| {
        root.view_mut((row, column), part.shape()).copy_from(&part)
    };
    put(0, 0, own.root.rows(0, n_free));
    put(0, n_own, of_held.moved.as_view());
    put(n_free, n_own, of_held.errors.as_view());
    put(n_free + n_held, 0, own.root.rows(n_free, n_features));
    Uncertainty {
        root,
        n_parameters: n_free + n_held,
        ..own.clone()
    }
}

/// Writes the uncertainty of each parameter and of the tool into the report.
fn state(
    report: &mut CalibrationReport,
    problem: &Problem<'_>,
    parameters: &[Parameter],
    uncertainty: Uncertainty,
) {
    for (i, (outcome, parameter)) in report
        .parameters
        .iter_mut()
        .zip(&problem.parameters)
        .enumerate()
    {
        if outcome.identifiable {
            let half_width = parameter.in_unit(uncertainty.half_width(i, CONFIDENCE));
            outcome.std_uncertainty = Some(parameter.in_unit(uncertainty.std(i)));
            outcome.interval_95 = Some([
                outcome.identified - half_width,
                outcome.identified + half_width,
            ]);
        }
    }
    let robot = &problem.request.robot;
    let model = model_of(report);
    let n_targets = model.targets_mm.len();
    let of_links = tool_uncertainty(robot, &problem.identify, n_targets, |q_rad, target| {
        uncertainty.position_std_mm(&model, parameters, q_rad, target)
    });
    let scale = report.instrument_scale;
    report.tool_uncertainty = Some(scale.map_or(of_links, |scale| scale.added_to(of_links)));
    report.uncertainty = Some(uncertainty);
}

/// Sets nominal values to those of the catalogue, as in every report.
fn from_catalogue(report: &mut CalibrationReport, parameters: &[Parameter], nominal: &[Link]) {
    for (outcome, parameter) in report.parameters.iter_mut().zip(parameters) {
        if let Parameter::Link(link, quantity) = *parameter {
            let value = *quantity_mut(&mut nominal[link].clone(), quantity);
            outcome.nominal = parameter.in_unit(value);
            outcome.delta = outcome.identified - outcome.nominal;
        }
    }
}
