//! From an identified model to the report: errors before and after, parameters with their uncertainty, remarks.

use crate::calibration::check::n_equations;
use crate::calibration::corrections;
use crate::calibration::identify::{Found, Problem};
use crate::calibration::judged::judged;
use crate::calibration::observe::{Observed, observe_verify_set};
use crate::calibration::placing::Layout;
use crate::calibration::remarks::{extrapolated, of_the_verify_set, remarks};
use crate::calibration::repeatability::repeatability;
use crate::calibration::report::*;
use crate::calibration::request::{Method, Model, Preset, VerifySource};
use crate::calibration::verify::refits;
use crate::calibration::{Error, known, plausibility, unseen};
use crate::identification::corrected::{CorrectedModel, IdentifiedRobot};
use crate::identification::misfit::gravity_directions;
use crate::identification::multistart::FOUND_MM;
use crate::identification::objective::{Observation, residuals};
use crate::identification::parameters::{Parameter, Quantity, deviation_from, quantity_mut};
use crate::identification::search_space::decomposition_at;
use crate::identification::uncertainty::{Uncertainty, uncertainty};
use crate::identification::workspace::tool_uncertainty;
use crate::identification::{KinematicModel, TrainedNetwork};
use crate::measurement::{Frame, Subset};
use nalgebra::{IsometryMatrix3, Vector3};
use std::collections::BTreeSet;

/// Probability with which a parameter's stated interval holds the truth.
const CONFIDENCE: f64 = 0.95;

/// A parameter whose part in the combinations that nothing is known of is below this, in priors, is known.
const TAKES_PART: f64 = 1e-3;

/// Mean, standard deviation, rms and largest of |residual|; `None` for no points.
pub fn errors(model: &KinematicModel, observations: &[Observation]) -> Option<Errors> {
    statistics(
        &residuals(model, observations)
            .iter()
            .map(Vector3::norm)
            .collect::<Vec<f64>>(),
    )
}

/// As [`errors`], of a robot with corrections.
pub fn corrected_errors(robot: &IdentifiedRobot, observations: &[Observation]) -> Option<Errors> {
    let size = |o: &Observation| (o.position_mm - robot.position(&o.q_rad, o.target)).norm();
    statistics(&observations.iter().map(size).collect::<Vec<f64>>())
}

fn statistics(sizes: &[f64]) -> Option<Errors> {
    if sizes.is_empty() {
        return None;
    }
    let n = sizes.len() as f64;
    let mean_mm = sizes.iter().sum::<f64>() / n;
    let rms_mm = (sizes.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
    let std_mm = (sizes
        .iter()
        .map(|e| (e - mean_mm) * (e - mean_mm))
        .sum::<f64>()
        / n)
        .sqrt();
    Some(Errors {
        mean_mm,
        std_mm,
        rms_mm,
        max_mm: sizes.iter().fold(0.0, |m, e| m.max(*e)),
    })
}

/// Another set to verify on, laid out for the robot that was identified; `None` where the points are of the fit's own set.
fn verify_layout<'a>(
    problem: &'a Problem<'_>,
    model: &KinematicModel,
) -> Result<Option<Layout<'a>>, Error> {
    match &problem.request.verify {
        VerifySource::Set(set) => {
            let observed = observe_verify_set(problem.request, set);
            Layout::new(
                problem.request,
                set,
                observed,
                model,
                refits(problem.request, set),
            )
            .map(Some)
        }
        _ => Ok(None),
    }
}

/// Errors of a model on the verify points.
pub fn verify_errors(problem: &Problem<'_>, model: &KinematicModel) -> Option<Errors> {
    match verify_layout(problem, model).ok()? {
        Some(layout) => layout.place(model).ok()?.errors(),
        None => errors(model, &problem.observed.of(Subset::Verify)),
    }
}

/// The report of a finished calibration.
pub fn report(
    problem: &Problem<'_>,
    method: Method,
    method_reason: String,
    found: Found,
    comparison: Vec<MethodComparison>,
    network: Option<TrainedNetwork>,
    corrections: Option<corrections::Found>,
) -> Result<CalibrationReport, Error> {
    let request = problem.request;
    let model = &found.model;
    // in the frame of the fit
    let robot = corrections.as_ref().map(|c| IdentifiedRobot {
        plain: delivered(problem, model),
        corrected: c.corrected.clone(),
    });
    let both = |points: &[Observation],
                before: &KinematicModel,
                after: &KinematicModel,
                robot: Option<&IdentifiedRobot>| {
        let (before, after) = (errors(before, points)?, errors(after, points)?);
        let corrected = robot.and_then(|robot| {
            if robot.corrected.is_some() {
                corrected_errors(robot, points)
            } else {
                Some(after)
            }
        });
        Some(SubsetErrors {
            n_points: points.len(),
            before,
            after,
            corrected,
        })
    };
    let Some(identify) = both(&problem.identify, &problem.nominal, model, robot.as_ref()) else {
        return Err(crate::calibration::unusable(
            "under_determined",
            "the identify subset has no points",
        ));
    };
    let repeatability = repeatability(problem, model, robot.as_ref());
    let mut per_point = self::per_point(
        (&problem.observed, &problem.nominal),
        (&problem.observed, model),
        robot.as_ref(),
    );
    let layout = verify_layout(problem, model)?;
    let (verify, of_verify_set);
    if let Some(layout) = &layout {
        let (before, after) = (layout.place(&problem.nominal)?, layout.place(model)?);
        let robot_there = robot
            .as_ref()
            .map(|robot| layout.place_corrected(robot, &after));
        let corrected = robot_there
            .as_ref()
            .and_then(|robot| match robot.corrected {
                Some(_) => corrected_errors(robot, &after.observed.all),
                None => after.errors(),
            });
        let n_points = after.observed.all.len();
        verify = before
            .errors()
            .zip(after.errors())
            .map(|(before, after)| SubsetErrors {
                n_points,
                before,
                after,
                corrected,
            });
        per_point.extend(self::per_point(
            (&before.observed, &before.model),
            (&after.observed, &after.model),
            robot_there.as_ref(),
        ));
        of_verify_set = remarks(&layout.screening, &after.observed, None);
    } else {
        verify = both(
            &problem.observed.of(Subset::Verify),
            &problem.nominal,
            model,
            robot.as_ref(),
        );
        of_verify_set = vec![];
    }
    let (links, t_instrument_base, targets_mm) = as_delivered(problem, model);
    let uncertainty = uncertainty_of(problem, model);
    let beyond = uncertainty
        .as_ref()
        .and_then(|u| extrapolated(problem, model, u, identify.after.rms_mm));
    let mut report = CalibrationReport {
        method,
        method_reason,
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
        per_point,
        parameters: parameters(problem, model, uncertainty.as_ref()),
        tool_uncertainty: uncertainty.as_ref().map(|u| {
            tool_uncertainty(
                &request.robot,
                model,
                &problem.parameters,
                &problem.identify,
                u,
            )
        }),
        error_model: uncertainty.as_ref().map(ErrorModel::of),
        uncertainty,
        changes: None,
        identifiability: identifiability(problem),
        comparison,
        warnings: vec![],
        links,
        t_instrument_base,
        targets_mm,
        target_segments: problem.screening.targets.segments.clone(),
        corrected: corrections
            .as_ref()
            .and_then(|c| c.corrected.as_ref())
            .map(|c| corrected_as_delivered(problem, c)),
        corrections: corrections.map(|c| c.evidence),
        repeatability,
        network,
    };
    report.warnings = warnings(&report, &problem.request.robot.links);
    report.warnings.extend(nothing_left(problem));
    report.warnings.extend(unseen::remark(
        problem,
        model,
        report.uncertainty.as_ref(),
        report.identify.after.rms_mm,
    ));
    report.warnings.extend(known::remarks(problem, model));
    report.warnings.extend(remarks(
        &problem.screening,
        &problem.observed,
        request.options.loss,
    ));
    report.warnings.extend(beyond);
    report.warnings.extend(of_the_verify_set(of_verify_set));
    Ok(report)
}

/// Every point's error before and after: of two robots, each with the points as they are laid out for it; and with corrections, of the second
/// robot with those that it has.
pub fn per_point(
    (observed, before): (&Observed, &KinematicModel),
    (observed_after, after): (&Observed, &KinematicModel),
    robot: Option<&IdentifiedRobot>,
) -> Vec<PointErrors> {
    let (before, after) = (
        residuals(before, &observed.all),
        residuals(after, &observed_after.all),
    );
    let corrected = |i: usize| {
        let o = &observed_after.all[i];
        robot.map(|robot| {
            if robot.corrected.is_some() {
                o.position_mm - robot.position(&o.q_rad, o.target)
            } else {
                after[i]
            }
        })
    };
    (0..observed.all.len())
        .map(|i| PointErrors {
            configuration: observed.configurations[i].clone(),
            target: observed.targets[i],
            subset: observed.subsets[i],
            before_mm: before[i].norm(),
            after_mm: after[i].norm(),
            position_mm: observed.positions_mm[i],
            before_vector_mm: before[i],
            after_vector_mm: after[i],
            corrected_vector_mm: corrected(i),
        })
        .collect()
}

/// Links, base and targets as the cell gets them: with sweeps, z_t is taken out of d of the last link again and becomes the target.
fn as_delivered(
    problem: &Problem<'_>,
    model: &KinematicModel,
) -> (
    Vec<crate::kinematics::Link>,
    IsometryMatrix3<f64>,
    Vec<Vector3<f64>>,
) {
    let KinematicModel {
        links,
        t_instrument_base,
        targets_mm,
    } = delivered(problem, model);
    (
        links,
        base_as_delivered(problem, &t_instrument_base),
        targets_mm,
    )
}

fn corrected_as_delivered(problem: &Problem<'_>, corrected: &CorrectedModel) -> CorrectedModel {
    let mut corrected = corrected.clone();
    corrected.model.t_instrument_base =
        base_as_delivered(problem, &corrected.model.t_instrument_base);
    corrected
}

fn base_as_delivered(problem: &Problem<'_>, fitted: &IsometryMatrix3<f64>) -> IsometryMatrix3<f64> {
    match (
        problem.request.model(),
        &problem.request.frames,
        problem.request.set.frame,
    ) {
        (Model::Paper, Some(frames), Frame::Instrument) => frames.t_instrument_base,
        _ => *fitted,
    }
}

/// The model with z_t of the sweeps taken out of the last link and put into the targets, in the frame of the fit: positions stay.
pub fn delivered(problem: &Problem<'_>, model: &KinematicModel) -> KinematicModel {
    let mut model = model.clone();
    if let (Model::Paper, Some(frames)) = (problem.request.model(), &problem.request.frames) {
        let last = model.links.len() - 1;
        model.links[last].d_mm -= frames.z_tool_mm;
        model
            .targets_mm
            .iter_mut()
            .for_each(|target| target.z += frames.z_tool_mm);
    }
    model
}

/// Nominal and identified value of each free parameter, in mm and degrees.
fn parameters(
    problem: &Problem<'_>,
    model: &KinematicModel,
    uncertainty: Option<&Uncertainty>,
) -> Vec<ParameterOutcome> {
    let identifiable = problem.decomposition.identifiable();
    let stated = stated(problem, model, uncertainty);
    let outcome = |(i, parameter): (usize, &Parameter)| {
        let (nominal, identified) = (
            problem.reported(&problem.nominal, parameter),
            problem.reported(model, parameter),
        );
        let to_wire = |value: f64| {
            if parameter.is_angle() {
                value.to_degrees()
            } else {
                value
            }
        };
        let known = uncertainty.filter(|_| stated[i]);
        let interval = |u: &Uncertainty| {
            let half_width = u.half_width(i, CONFIDENCE);
            [
                to_wire(identified - half_width),
                to_wire(identified + half_width),
            ]
        };
        ParameterOutcome {
            name: problem.screening.targets.name(parameter),
            link: if let Parameter::Link(link, _) = parameter {
                Some(link + 1)
            } else {
                None
            },
            unit: if parameter.is_angle() { "deg" } else { "mm" },
            nominal: to_wire(nominal),
            identified: to_wire(identified),
            delta: to_wire(identified - nominal),
            std_uncertainty: known.map(|u| to_wire(u.std(i))),
            interval_95: known.map(interval),
            identifiable: identifiable[i],
            prior: known::outcome_of(problem, model, i, uncertainty),
        }
    };
    problem.parameters.iter().enumerate().map(outcome).collect()
}

/// For each parameter: true if its uncertainty can be stated. Where nothing is known beforehand that is what the data see alone; a prior
/// may say what they do not, and where a bound ended the fit there is no interval.
fn stated(
    problem: &Problem<'_>,
    model: &KinematicModel,
    uncertainty: Option<&Uncertainty>,
) -> Vec<bool> {
    let (Some(known), Some(uncertainty)) = (&problem.priors, uncertainty) else {
        return problem.decomposition.identifiable();
    };
    let at_bounds = known.priors.at_bounds(model);
    let is_free = |j: &usize| at_bounds.iter().all(|(k, _)| k != j);
    let is_known =
        |j: usize| uncertainty.unseen.row(j).amax() < TAKES_PART * problem.decomposition.scale[j];
    (0..problem.parameters.len())
        .map(|j| is_free(&j) && is_known(j))
        .collect()
}

/// A parameter's value in a model, mm or rad.
pub fn value_of(model: &KinematicModel, parameter: &Parameter) -> f64 {
    match *parameter {
        Parameter::Link(link, quantity) => *quantity_mut(&mut model.links[link].clone(), quantity),
        Parameter::BaseTranslation(axis) => model.t_instrument_base.translation.vector[axis],
        Parameter::BaseRotation(_) => 0.0,
        Parameter::Target(target, axis) => model.targets_mm[target][axis],
    }
}

impl Problem<'_> {
    /// A parameter's value as the report has it, mm or rad: the base's turn from its first estimate, and d of the last link without the
    /// tool that sweeps merged into it.
    pub fn reported(&self, model: &KinematicModel, parameter: &Parameter) -> f64 {
        let last_d = Parameter::Link(model.links.len() - 1, Quantity::D);
        match parameter {
            Parameter::BaseRotation(_) => deviation_from(&self.nominal, model, parameter),
            p if *p == last_d => {
                let frames = self
                    .request
                    .frames
                    .as_ref()
                    .filter(|_| self.request.model() == Model::Paper);
                value_of(model, p) - frames.map_or(0.0, |frames| frames.z_tool_mm)
            }
            p => value_of(model, p),
        }
    }
}

/// What the residuals say about the errors of parameters and tool.
pub fn uncertainty_of(problem: &Problem<'_>, model: &KinematicModel) -> Option<Uncertainty> {
    if without_redundancy(problem).is_some() {
        return None;
    }
    let gravity = gravity_directions(
        problem
            .request
            .robot
            .mounting
            .as_ref()
            .map(|m| &m.gravity_in_base),
    );
    let clusters = problem.observed.clusters(Subset::Identify);
    let counting: Vec<usize> = (0..clusters.len())
        .filter(|i| problem.identify[*i].weight > 0.0)
        .collect();
    let points = problem.loss.as_squares(model, &problem.identify);
    let mut known = BTreeSet::new();
    // a row that stands in the file twice, to the last digit, was measured once
    let bits = |o: &Observation| -> Vec<u64> {
        o.q_rad
            .iter()
            .chain(o.position_mm.iter())
            .map(|x| x.to_bits())
            .collect()
    };
    let counting: Vec<usize> = counting
        .into_iter()
        .filter(|i| known.insert((problem.identify[*i].target, bits(&problem.identify[*i]))))
        .collect();
    let observations: Vec<Observation> = counting.iter().map(|i| points[*i].clone()).collect();
    let clusters: Vec<usize> = counting.iter().map(|i| clusters[*i]).collect();
    let priors = problem.fitting().priors;
    let at_bounds = priors.map_or(vec![], |priors| priors.at_bounds(model));
    let mut decomposition = problem.decomposition.clone();
    if !at_bounds.is_empty() {
        at_bounds
            .iter()
            .for_each(|(parameter, _)| decomposition.scale[*parameter] = 0.0);
        decomposition = decomposition_at(
            &problem.nominal,
            &problem.parameters,
            &decomposition.scale,
            &problem.identify,
        );
    }
    uncertainty(
        model,
        &problem.parameters,
        (&decomposition, priors),
        &observations,
        &clusters,
        &gravity,
    )
}

/// Told where the fit can follow any error of the points.
fn nothing_left(problem: &Problem<'_>) -> Option<Warning> {
    let (equations, rank) = without_redundancy(problem)?;
    let detail = format!(
        "{equations} equations from distinct configurations to identify from fix {rank} combinations of parameters: the fit can follow any error \
         of the points, and what is left of them says nothing of how far the robot is off. Measure more configurations, or hold parameters"
    );
    Some(Warning {
        code: "nothing_left_to_judge",
        detail,
        rows: vec![],
    })
}

/// Equations and rank where there are no more of the former. Poses that are repeated say how well they repeat, and no more.
fn without_redundancy(problem: &Problem<'_>) -> Option<(usize, usize)> {
    let counting: Vec<Observation> = problem
        .identify
        .iter()
        .filter(|o| o.weight > 0.0)
        .cloned()
        .collect();
    let rank = problem.decomposition.rank();
    let equations = n_equations(&counting, rank + 1);
    (equations <= rank).then_some((equations, rank))
}

fn identifiability(problem: &Problem<'_>) -> Identifiability {
    let names = |group: Vec<usize>| {
        group
            .into_iter()
            .map(|i| problem.screening.targets.name(&problem.parameters[i]))
            .collect()
    };
    Identifiability {
        n_parameters: problem.parameters.len(),
        rank: problem.decomposition.rank(),
        n_by_priors: problem.priors.as_ref().map(|known| {
            let (with, _) = problem
                .decomposition
                .directions_with_priors(&known.priors.stds());
            with.ncols() - problem.decomposition.rank()
        }),
        condition_number: problem.decomposition.condition_number(),
        unidentifiable: problem
            .decomposition
            .unseen_groups()
            .into_iter()
            .map(names)
            .collect(),
        observability_index_o1: problem.decomposition.observability_index_o1(),
    }
}

fn warnings(report: &CalibrationReport, nominal: &[crate::kinematics::Link]) -> Vec<Warning> {
    let warning = |code, detail: String| Warning {
        code,
        detail,
        rows: vec![],
    };
    let mut warnings = Vec::new();
    match &report.verify {
        None => warnings.push(warning(
            "no_verify_points",
            "no points were kept to verify: the errors after are those of the fit itself".into(),
        )),
        Some(_) => {
            let to_verify = report
                .per_point
                .iter()
                .filter(|point| point.subset == Subset::Verify);
            let judged = judged(
                &to_verify
                    .map(|point| [point.before_mm, point.after_mm, point.after_mm])
                    .collect::<Vec<_>>(),
            );
            if !judged.is_better() {
                let detail = format!(
                    "on points that the fit has not seen{} the identified robot ({:.4} mm rms) is no better than the nominal one ({:.4} mm rms)",
                    judged.remark(),
                    judged.after_rms_mm,
                    judged.before_rms_mm
                );
                warnings.push(warning("no_better_than_nominal", detail));
            }
        }
    }
    let mut after_mm: Vec<f64> = report
        .per_point
        .iter()
        .map(|point| point.after_mm)
        .collect();
    after_mm.sort_by(f64::total_cmp);
    if let Some(median_mm) = after_mm
        .get(after_mm.len() / 2)
        .filter(|mm| **mm > FOUND_MM)
    {
        let detail = format!(
            "half of the points are {median_mm:.3} mm or more from where the identified robot has them: that is no fit. Do joints and positions of a \
             row belong together, and is it this robot? It cannot be released"
        );
        warnings.push(warning("no_fit", detail));
    }
    let unseen = &report.identifiability.unidentifiable;
    if !unseen.is_empty() {
        let groups: Vec<String> = unseen.iter().map(|group| group.join(" with ")).collect();
        let stay = match (report.method, report.preset) {
            (Method::Pso | Method::BpnnPso, Preset::Paper) => {
                "what the swarm left them at has no meaning one by one"
            }
            _ => "what the data do not see of them stays nominal",
        };
        let detail = format!(
            "these cannot be told apart or seen from the measured positions; {stay}: {}",
            groups.join("; ")
        );
        warnings.push(warning("unidentifiable_parameters", detail));
    }
    warnings.extend(plausibility::warnings(report, nominal));
    if report.method == Method::LeastSquares
        && matches!(report.termination, "iteration_limit" | "not_finite")
    {
        warnings.push(warning(
            "not_converged",
            "least squares did not converge; check joint offsets and wild points, or try method \"pso\"".into(),
        ));
    }
    warnings
}
