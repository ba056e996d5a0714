//! Builds the report from an identified model: errors before and after, parameters with their uncertainty, warnings.

use crate::calibration::Error;
use crate::calibration::outcome::delivery::{as_delivered, corrected_as_delivered, delivered};
use crate::calibration::outcome::parameters::{identifiability, parameters};
use crate::calibration::outcome::stated_uncertainty::{
    estimated, no_redundancy_warning, stated, useless_uncertainty_reason, why_not_stated,
    with_found_misfit,
};
use crate::calibration::preparation::equations::model_rank;
use crate::calibration::preparation::observe::observe_verify_set;
use crate::calibration::preparation::stated_priors;
use crate::calibration::problem::Problem;
use crate::calibration::report::*;
use crate::calibration::request::{CalibrationRequest, Method, VerifySource};
use crate::calibration::solve::corrections;
use crate::calibration::solve::final_fit::Final;
use crate::calibration::solve::most_probable::DETERMINED;
use crate::calibration::solve::solution::Found;
use crate::calibration::upload_checks::alignment::ROTATION_SUSPECT;
use crate::calibration::upload_checks::rotations::better_reading;
use crate::calibration::validation::coverage::shows_little;
use crate::calibration::validation::errors::{self, errors};
use crate::calibration::validation::repeatability::repeatability;
use crate::calibration::validation::session_fit::SessionScatter;
use crate::calibration::validation::verdict;
use crate::calibration::validation::verification_set::refits;
use crate::calibration::validation::verification_set::{Layout, PlacedCorrected};
use crate::calibration::warnings::last_joint::{LastJoint, impossible_reflector, last_joint};
use crate::calibration::warnings::orientation::{self, flange_rotation};
use crate::calibration::warnings::overstated_noise::OverstatedNoise;
use crate::calibration::warnings::plausibility::{
    JOINT_MAP, TOOL_UNCERTAIN, base_frame_off, joint_counted_otherwise, of_following_joints,
};
use crate::calibration::warnings::refused_upload::{advised, with_unread};
use crate::calibration::warnings::screening::{
    extrapolated, of_the_verify_set, screening_warnings,
};
use crate::calibration::warnings::unobservable;
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::model::objective::Observation;
use crate::identification::statistics::workspace::tool_uncertainty;
use crate::identification::{KinematicModel, TrainedNetwork};
use crate::kinematics::{Link, Robot};
use crate::measurement::{Frame, Subset};
use crate::solvers::watch::Watch;
use std::collections::BTreeSet;

/// Prepares the separate verification set for the identified robot. `None` if the verify points belong to the identified set.
pub fn verify_layout<'a>(
    request: &'a CalibrationRequest,
    model: &KinematicModel,
    watch: &Watch<'_>,
) -> Result<Option<Layout<'a>>, Error> {
    match &request.verify {
        VerifySource::Set(set) => {
            let observed = observe_verify_set(request, set);
            let refit = refits(request, set);
            Layout::new(request, set, observed, model, refit, watch).map(Some)
        }
        _ => Ok(None),
    }
}

/// Corrections after the veto by the verify points, and the warning about the veto.
pub fn vetoed(
    problem: &Problem<'_>,
    model: &KinematicModel,
    layout: Option<&Layout<'_>>,
    found: Option<corrections::Found>,
) -> Result<(Option<corrections::Found>, Option<Warning>), Error> {
    let Some(found) = found else {
        return Ok((None, None));
    };
    let robot = IdentifiedRobot {
        plain: delivered(problem, model),
        corrected: found.corrected.clone(),
    };
    let (found, warning) = match layout {
        None => {
            let placed = of_subset(problem, &found.placed(problem), Subset::Verify);
            corrections::veto(found, &robot, &problem.observed.of(Subset::Verify), &placed)
        }
        Some(layout) => {
            let after = layout.place(model);
            let placed = layout.place_corrected(&robot, &after);
            let there = IdentifiedRobot {
                plain: after.model.clone(),
                ..placed.robot.clone()
            };
            corrections::veto(found, &there, &after.observed.all, &placed.points)
        }
    };
    Ok((Some(found), warning))
}

fn of_subset(problem: &Problem<'_>, points: &[Observation], subset: Subset) -> Vec<Observation> {
    let all = points.iter().zip(&problem.observed.subsets);
    all.filter(|(_, of)| **of == subset)
        .map(|(o, _)| o.clone())
        .collect()
}

/// Errors of a model on the verify points. `layout` is the separate verification set, if there is one.
pub fn verify_errors(
    problem: &Problem<'_>,
    model: &KinematicModel,
    layout: Option<&Layout<'_>>,
) -> Option<Errors> {
    match layout {
        Some(layout) => {
            let placed = layout.place(model);
            errors(&placed.model, &placed.observed.all)
        }
        None => errors(model, &problem.observed.of(Subset::Verify)),
    }
}

/// Reason for stating no uncertainty if the method ended at its iteration limit and no refinement followed.
const UNFINISHED: &str = "the method did not converge: it ended at its limit of iterations, and nothing refined its answer. Calibrate again with \
                          refine, or with method auto";

/// What a calibration found.
pub struct Answer<'a> {
    /// The method that ran.
    pub method: Method,
    /// Why that method.
    pub method_reason: String,
    /// The model that it found.
    pub found: Found,
    /// Results of the other methods.
    pub comparison: Vec<MethodComparison>,
    /// The network trained on the run.
    pub network: Option<TrainedNetwork>,
    /// Corrections after the veto by the verify points; `None` if none were searched.
    pub corrections: Option<corrections::Found>,
    /// The fit to all points; `None` if the verified parameters themselves are delivered.
    pub delivered: Option<&'a Final<'a>>,
}

/// Warning if the robot was identified in the base frame, but the base was fitted again to the verification set.
fn base_not_checked(request: &CalibrationRequest, layout: &Layout<'_>) -> Option<Warning> {
    (request.set.frame == Frame::Base && layout.is_placed_anew).then(|| Warning {
        code: BASE_NOT_CHECKED,
        detail: "the base was placed anew, and the robot was identified from positions in the base frame: these points show the links, and a wrong \
                 base does not show. Verify on a set in the base frame, of the same targets, from one station"
            .into(),
        rows: vec![],
    })
}

/// Builds the report of a finished calibration. `layout` is the separate verification set, if there is one.
pub fn report(
    problem: &Problem<'_>,
    answer: Answer<'_>,
    layout: Option<&Layout<'_>>,
    watch: &Watch<'_>,
) -> Result<CalibrationReport, Error> {
    let Answer {
        found,
        corrections,
        delivered: final_fit,
        ..
    } = answer;
    let request = problem.request;
    let model = &found.model;
    // In the frame of the fit.
    let robot = corrections.as_ref().map(|c| IdentifiedRobot {
        plain: delivered(problem, model),
        corrected: c.corrected.clone(),
    });
    let placed = corrections.as_ref().map(|found| found.placed(problem));
    let robot_at_points = robot.as_ref().zip(placed.as_deref());
    let repeatability = repeatability(problem, model, robot_at_points);
    let mut per_point = errors::per_point(
        (&problem.observed, &problem.nominal),
        (&problem.observed, model),
        robot_at_points,
    );
    for row in problem.screening.rows_left_out() {
        per_point[row].is_outlier = true;
    }
    let Some(identify) = errors::of_subset(&per_point, Subset::Identify) else {
        return Err(crate::calibration::unusable(
            "under_determined",
            "the identify subset has no points",
        ));
    };
    // Errors are those of the verified fit. Everything else in the report describes the delivered fit.
    let (delivered_problem, delivered_model) = match final_fit {
        Some(last) => (&last.problem, &last.model),
        None => (problem, model),
    };
    let identifiability = identifiability(delivered_problem);
    let data_share = delivered_problem.data_share(delivered_model);
    let mut fit = verdict::no_fit(&per_point, request).or_else(|| {
        let named = problem.parameters.iter().zip(&data_share);
        let unseen: BTreeSet<String> = named
            .filter(|(_, share)| **share < DETERMINED)
            .map(|(parameter, _)| parameter.name())
            .collect();
        joint_counted_otherwise(&model.links, &request.robot.links, &unseen)
    });
    let direction = last_joint(problem, model);
    if let LastJoint::Otherwise(warning) = &direction {
        fit = fit.or_else(|| Some(warning.clone()));
    }
    fit = fit.or_else(|| impossible_reflector(delivered_model, &request.robot.links));
    let (verify, of_verify_set);
    let mut outliers: BTreeSet<usize> = problem.screening.outliers.iter().map(|w| w.row).collect();
    if let Some(layout) = layout {
        let (before, after) = (layout.place(&problem.nominal), layout.place(model));
        let robot_there = robot
            .as_ref()
            .map(|robot| layout.place_corrected(robot, &after));
        let robot_there = robot_there.as_ref().map(PlacedCorrected::at_points);
        let mut there = errors::per_point(
            (&before.observed, &before.model),
            (&after.observed, &after.model),
            robot_there,
        );
        for row in layout.screening.rows_left_out() {
            there[row].is_outlier = true;
        }
        verify = errors::of_subset(&there, Subset::Verify);
        let fitted = errors::without_outliers(&per_point, Subset::Identify).unwrap_or(identify);
        fit = fit.or_else(|| {
            let session = verdict::Session {
                points: &there,
                order: match &request.verify {
                    VerifySource::Set(set) => set.measuring_order(),
                    _ => (0..there.len()).collect(),
                },
                scatter: SessionScatter {
                    model: &after.model,
                    observations: &after.observed.all,
                },
                refused_as: request.refused_as.as_deref(),
            };
            verdict::of_another_session(&session, &fitted, &request.robot)
        });
        let of_set = layout.screening.outliers.iter();
        outliers.extend(of_set.map(|outlier| per_point.len() + outlier.row));
        per_point.extend(there);
        of_verify_set = match &request.verify {
            VerifySource::Set(set) => {
                let placed =
                    (layout.n_refitted() > 0).then_some((&after.model, &after.observed.all[..]));
                shows_little(&request.robot, set, placed)
            }
            _ => None,
        }
        .into_iter()
        .chain(base_not_checked(request, layout))
        .chain(screening_warnings(
            &layout.screening,
            &after.observed,
            None,
            None,
        ))
        .collect();
    } else {
        verify = errors::of_subset(&per_point, Subset::Verify);
        of_verify_set = vec![];
    }
    let fit = fit
        .map(|told| with_unread(told, request.unread_labels.as_deref()))
        .map(|told| advised(told, request.refused_as.as_deref()));
    let as_delivered = as_delivered(problem, delivered_model);
    let misfit = fit
        .as_ref()
        .map(|told| told.code)
        .filter(|code| [NO_FIT, JOINT_MAP].contains(code));
    let fits = misfit.is_none();
    let estimated = match final_fit {
        Some(last) => last.uncertainty.clone(),
        None => estimated(problem, model, watch),
    };
    let tool = estimated.as_ref().map(|estimated| {
        let (robot, points) = (&request.robot, &delivered_problem.identify);
        let parameters = &problem.parameters;
        let n_targets = delivered_model.targets_mm.len();
        let of_links = tool_uncertainty(robot, points, n_targets, |q_rad, target| {
            estimated.position_std_mm(delivered_model, parameters, q_rad, target)
        });
        with_found_misfit(of_links, &identify)
    });
    let corrected_tool = final_fit.and_then(Final::corrected_tool_uncertainty);
    let instrument_scale = request.scale_at_reach();
    let mut not_determined = None;
    // No least-squares fit has converged. The answer has not reached a minimum, and the weakest parameter combinations are furthest from it.
    let is_unfinished = found.termination == "iteration_limit"
        && (answer.method == Method::LeastSquares || !problem.settings.refine);
    let why_not_stated = match misfit {
        Some(code) => Some(format!(
            "the identified robot does not fit the points ({code})"
        )),
        None => why_not_stated(delivered_problem, estimated.as_ref())
            .or_else(|| is_unfinished.then(|| UNFINISHED.into()))
            .or_else(|| {
                not_determined = useless_uncertainty_reason(delivered_problem, tool.as_ref()?);
                not_determined.clone()
            }),
    };
    let followings: Vec<Warning> = (estimated.iter().filter(|_| misfit.is_none()))
        .flat_map(of_following_joints)
        .collect();
    let uncertainty = estimated.filter(|_| why_not_stated.is_none());
    // The uncertainty of the verified fit matters only if there are verify points.
    let is_verified = problem.observed.subsets.contains(&Subset::Verify);
    let of_verified = match final_fit {
        Some(_) if is_verified => stated(problem, model, watch),
        Some(_) => None,
        None => uncertainty.clone(),
    };
    let beyond = of_verified
        .as_ref()
        .and_then(|u| extrapolated(problem, model, u, identify.after.rms_mm));
    let corrected = match final_fit {
        Some(last) => last.corrected.as_ref(),
        None => corrections.as_ref().and_then(|c| c.corrected.as_ref()),
    };
    let of_both: Vec<&[Link]> = std::iter::once(&delivered_model.links)
        .chain(corrected.map(|corrected| &corrected.model.links))
        .map(Vec::as_slice)
        .collect();
    let mut report = CalibrationReport {
        method: answer.method,
        method_reason: answer.method_reason,
        model: request.model(),
        preset: request.preset,
        seed: request.seed,
        termination: found.termination,
        n_iterations: found.n_iterations,
        n_evaluations: found.n_evaluations,
        cost_mm2: problem.cost(model),
        convergence_mm2: found.convergence,
        identify,
        verify,
        verify_without_outliers: errors::verify_without(&per_point, &outliers),
        final_fit: final_fit.map(|last| last.errors),
        per_point,
        parameters: parameters(
            delivered_problem,
            delivered_model,
            uncertainty.as_ref(),
            &data_share,
        ),
        tool_uncertainty: tool
            .filter(|_| uncertainty.is_some())
            .map(|tool| instrument_scale.map_or(tool, |scale| scale.added_to(tool))),
        corrected_tool_uncertainty: corrected_tool
            .filter(|_| uncertainty.is_some())
            .map(|tool| instrument_scale.map_or(tool, |scale| scale.added_to(tool))),
        instrument_scale,
        error_model: uncertainty.as_ref().map(ErrorModel::of),
        uncertainty,
        estimate: None,
        uncertainty_absent_because: why_not_stated,
        changes: None,
        flange_rotation: fits
            .then(|| flange_rotation(delivered_problem, delivered_model, &of_both))
            .flatten(),
        identifiability,
        model_rank: model_rank(
            &request.robot,
            &delivered_problem.parameters,
            delivered_problem.screening.targets.len(),
        ),
        comparison: answer.comparison,
        warnings: vec![],
        links: as_delivered.links,
        t_instrument_base: as_delivered.t_instrument_base,
        targets_mm: as_delivered.targets_mm,
        target_rotations: as_delivered.target_rotations,
        target_segments: problem.screening.targets.segments.clone(),
        corrected: corrected.map(|c| corrected_as_delivered(problem, c)),
        corrections: corrections.map(|c| c.evidence),
        repeatability,
        pooled: None,
        quick_check: None,
        network: answer.network,
    };
    report.warnings = verdict::warnings(&report, &problem.request.robot.links, fit);
    report.warnings.extend(not_determined.map(|detail| Warning {
        code: TOOL_UNCERTAIN,
        detail,
        rows: vec![],
    }));
    report
        .warnings
        .extend(no_redundancy_warning(delivered_problem));
    if fits {
        report.warnings.extend(unobservable::warning(
            delivered_problem,
            delivered_model,
            report.uncertainty.as_ref(),
            report.identify.after.rms_mm,
            report.flange_rotation,
            matches!(direction, LastJoint::NotShown),
        ));
    }
    if fits {
        let n_links = request.robot.links.len();
        let warning = orientation::warning(report.flange_rotation, n_links);
        report.warnings.extend(warning);
    }
    report.warnings.extend(followings);
    let is_base_frame = request.set.frame == Frame::Base;
    report.warnings.extend(
        is_base_frame
            .then(|| base_frame_off(&report.t_instrument_base))
            .flatten(),
    );
    report
        .warnings
        .extend(stated_priors::warnings(delivered_problem, delivered_model));
    report.warnings.extend(screening_warnings(
        &problem.screening,
        &problem.observed,
        request.options.loss,
        Some(&problem.arrangement),
    ));
    // With the identified robot, a wrong rotation convention shows even if the nominal robot is too far off to show it.
    if request.set.has_poses() {
        let identified = Robot {
            links: delivered_model.links.clone(),
            ..request.robot.clone()
        };
        let told = better_reading(&identified, &request.set);
        let told = told.map(|detail| Warning::new(ROTATION_SUSPECT, detail));
        report.warnings.extend(told);
    }
    let overstated = OverstatedNoise::of(delivered_problem, delivered_model);
    report
        .warnings
        .extend(overstated.map(|overstated| overstated.warning()));
    report.warnings.extend(beyond);
    report.warnings.extend(of_the_verify_set(of_verify_set));
    Ok(report)
}
