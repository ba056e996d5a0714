//! Partial recalibration, as after a collision: only what is named is identified anew. The rest stays as an earlier identification has it,
//! and its uncertainty goes into what is named and into the tool.

use crate::calibration::changes::estimate;
use crate::calibration::corrections;
use crate::calibration::identify::{Problem, calibrate, placed, quiet, stage};
use crate::calibration::orientation::{self, flange_rotation_std_rad};
use crate::calibration::report::{CalibrationReport, Warning};
use crate::calibration::request::{CalibrationRequest, CorrectionsChoice, PreviousSession};
use crate::calibration::{Error, Monitor};
use crate::identification::KinematicModel;
use crate::identification::changes::Estimate;
use crate::identification::objective::weighted_jacobian;
use crate::identification::parameters::{Parameter, quantity_mut};
use crate::identification::uncertainty::Uncertainty;
use crate::identification::workspace::tool_uncertainty;
use crate::kinematics::{Link, Robot};
use nalgebra::{DMatrix, Vector3};

/// Probability with which a parameter's stated interval holds the truth.
const CONFIDENCE: f64 = 0.95;

/// An earlier identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Its links.
    pub links: Vec<Link>,
    /// The session that it was identified from.
    pub session: PreviousSession,
}

/// As [`calibrate`], from the links of an earlier identification: "before" in the report is that robot. Parameters that are not free have
/// its values; their covariance is taken from its session (consider parameters: Schmidt 1966).
///
/// # Errors
/// As [`calibrate`].
pub fn calibrate_partially(
    request: &CalibrationRequest,
    held: &Held,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    // corrections of few parameters would say what the held ones leave over
    let from_held = CalibrationRequest {
        robot: Robot {
            links: held.links.clone(),
            ..request.robot.clone()
        },
        corrections: Some(CorrectionsChoice::Off),
        ..request.clone()
    };
    let mut report = calibrate(&from_held, monitor)?;
    report.warnings.extend(
        corrections::are_wanted(request.corrections, request.preset)
            .then(corrections::left_out_of_a_part),
    );
    let whole = CalibrationRequest {
        model: Some(request.model()),
        frames: held.session.frames.clone(),
        ..CalibrationRequest::new(request.robot.clone(), held.session.set.clone())
    };
    let mut problem = Problem::new(&from_held)?;
    if report.final_fit.is_some() {
        problem = problem.over_all_points(&model_of(&report))?;
    }
    let earlier = stage(monitor, "held_uncertainty", |monitor| {
        estimate(&whole, &mut quiet(monitor))
    })?;
    let widened = earlier
        .as_ref()
        .zip(report.uncertainty.as_ref())
        .and_then(|(earlier, own)| widened(&problem, &report, earlier, own));
    match widened {
        Some((parameters, uncertainty)) => state(&mut report, &problem, &parameters, uncertainty),
        // where the part itself has no uncertainty, the report says why already
        None if report.uncertainty.is_none() => {}
        None => withhold(&mut report),
    }
    // what the earlier session shows of the held robot's flange, and what this one says against the held robot
    let of_held = Problem::new(&whole).ok().and_then(|problem| {
        let n_targets = problem.screening.targets.len();
        let links = held.links.clone();
        let model = placed(problem.request, links, &problem.identify, n_targets);
        flange_rotation_std_rad(&problem, &model, &[held.links.as_slice()])
    });
    report.flange_rotation_std_rad = of_held
        .zip(report.flange_rotation_std_rad)
        .map(|(held, own)| libm::hypot(held, own));
    report
        .warnings
        .retain(|warning| warning.code != orientation::NOT_KNOWN);
    report
        .warnings
        .extend(orientation::remark(report.flange_rotation_std_rad));
    from_catalogue(&mut report, &problem.parameters, &request.robot.links);
    Ok(report)
}

/// States none: with what was held counted as exact, each would be too small.
fn withhold(report: &mut CalibrationReport) {
    let detail = "how uncertain the parameters are that were held cannot be told from the session that they were identified from, so no \
                  uncertainty is stated";
    report.warnings.push(Warning {
        code: "held_uncertainty_unknown",
        detail: detail.into(),
        rows: vec![],
    });
    report.uncertainty_absent_because = Some(detail.into());
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
    }
}

/// Free and held parameters with the uncertainty of both: with δ_free = −E·J_held·δ_held, E the least-squares inverse of J_free along what
/// the points see, each cause of an error of what is held also moves what is free.
fn widened(
    problem: &Problem<'_>,
    report: &CalibrationReport,
    earlier: &Estimate,
    own: &Uncertainty,
) -> Option<(Vec<Parameter>, Uncertainty)> {
    let is_held = |i: &usize| {
        earlier.parameters[*i].is_link() && !problem.parameters.contains(&earlier.parameters[*i])
    };
    let at: Vec<usize> = (0..earlier.parameters.len()).filter(is_held).collect();
    let held: Vec<Parameter> = at.iter().map(|i| earlier.parameters[*i]).collect();
    let (model, at_fit) = (model_of(report), Vector3::zeros());
    let jacobian = |parameters: &[Parameter]| {
        weighted_jacobian(&model, parameters, &problem.identify, &at_fit)
    };
    let directions = problem.decomposition.seen_directions();
    let (q, r) = (jacobian(&problem.parameters) * &directions).qr().unpack();
    let inverse = directions * r.try_inverse()? * q.transpose();
    let roots = [&earlier.uncertainty.noise, &earlier.uncertainty.misfit];
    let n_causes: usize = roots.iter().map(|root| root.ncols()).sum();
    let mut causes = DMatrix::zeros(held.len(), n_causes);
    let mut column = 0;
    for root in roots {
        for k in 0..root.ncols() {
            at.iter()
                .enumerate()
                .for_each(|(row, i)| causes[(row, column)] = root[(*i, k)]);
            column += 1;
        }
    }
    let moved = inverse * (jacobian(&held) * &causes) * -1.0;
    let (n_free, n_own) = (problem.parameters.len(), own.noise.ncols());
    let mut both = own.clone();
    both.noise = DMatrix::zeros(n_free + held.len(), n_own + n_causes);
    both.noise
        .view_mut((0, 0), (n_free, n_own))
        .copy_from(&own.noise);
    both.noise
        .view_mut((0, n_own), (n_free, n_causes))
        .copy_from(&moved);
    both.noise
        .view_mut((n_free, n_own), (held.len(), n_causes))
        .copy_from(&causes);
    both.misfit = own
        .misfit
        .clone()
        .resize_vertically(n_free + held.len(), 0.0);
    both.noise.iter().all(|v| v.is_finite()).then(|| {
        (
            problem.parameters.iter().copied().chain(held).collect(),
            both,
        )
    })
}

/// States it: parameter by parameter, and of the tool.
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
        let to_wire = |value: f64| {
            if parameter.is_angle() {
                value.to_degrees()
            } else {
                value
            }
        };
        if outcome.identifiable {
            let half_width = to_wire(uncertainty.half_width(i, CONFIDENCE));
            outcome.std_uncertainty = Some(to_wire(uncertainty.std(i)));
            outcome.interval_95 = Some([
                outcome.identified - half_width,
                outcome.identified + half_width,
            ]);
        }
    }
    let robot = &problem.request.robot;
    report.tool_uncertainty = Some(tool_uncertainty(
        robot,
        &model_of(report),
        parameters,
        &problem.identify,
        &uncertainty,
    ));
    report.uncertainty = Some(uncertainty);
}

/// Nominal values are the catalogue's, as in every report.
fn from_catalogue(report: &mut CalibrationReport, parameters: &[Parameter], nominal: &[Link]) {
    for (outcome, parameter) in report.parameters.iter_mut().zip(parameters) {
        if let Parameter::Link(link, quantity) = *parameter {
            let value = *quantity_mut(&mut nominal[link].clone(), quantity);
            outcome.nominal = if parameter.is_angle() {
                value.to_degrees()
            } else {
                value
            };
            outcome.delta = outcome.identified - outcome.nominal;
        }
    }
}
