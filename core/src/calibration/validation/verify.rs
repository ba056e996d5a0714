//! `kind: "verify"`: how well a parameter set predicts points that it was not identified from. No robot parameter is fitted. If the points are not in
//! the base frame, base and targets are fitted, separately for the nominal and for the identified robot.

use crate::calibration::point_errors::PointErrors;
use crate::calibration::preparation::observe::{observe, observe_to_verify};
use crate::calibration::report::{
    BASE_NOT_CHECKED, CalibrationReport, Identifiability, SubsetErrors, Warning,
};
use crate::calibration::request::{CalibrationRequest, VerifySource};
use crate::calibration::stages::{stage, watched};
use crate::calibration::validation::coverage::shows_little;
use crate::calibration::validation::enough_points::{
    base_is_known, check_verify, few_verify_points, n_refitted,
};
use crate::calibration::validation::errors::{of_subset, per_point, verify_without};
use crate::calibration::validation::session_fit::{SessionScatter, nominal_fit};
use crate::calibration::validation::verdict::{NO_BETTER, Session, Verdict};
use crate::calibration::validation::verification_set::{Layout, Placed, PlacedCorrected};
use crate::calibration::warnings::plausibility::instrument_scale;
use crate::calibration::warnings::screening::screening_warnings;
use crate::calibration::{Error, Monitor, unusable};
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::model::objective::cost;
use crate::measurement::{Frame, MeasurementSet, Subset};
use crate::solvers::watch::Watch;
use nalgebra::IsometryMatrix3;
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// Reason if the points are in the base frame, but the base was fitted anew.
const BASE_PLACED_ANEW: &str = "the positions are in the base frame, but the base was placed anew (several stations, a target that the parameter set \
                                does not have, or something that moved), so that a wrong base does not show: no evidence. Measure the targets of the \
                                parameter set from one station";
/// Reason if points in the instrument's frame are scored on a set whose base was identified in the base frame.
const BASE_NOT_MEASURED: &str = "the parameter set was identified from positions in the base frame, and these are in the instrument's frame, where the \
                                 base is placed anew: they show the links, and a wrong base does not show. No evidence for a release. Measure the \
                                 base frame anew and upload a session in the frame base, or identify in the instrument's frame, where no base is used";

/// A parameter set and the nominal robot, scored on a request's points.
struct Scored {
    before: Placed,
    after: Placed,
    /// The robot with corrections, if a parameter set was scored.
    corrected: Option<PlacedCorrected>,
    /// Number of refitted base and target parameters.
    n_refitted: usize,
    /// Why an error of the base does not show, if the set has a base and it was fitted anew.
    base_hidden_because: Option<&'static str>,
    /// Warnings about outliers and steps.
    remarks: Vec<Warning>,
    /// Rows of the named outliers.
    outliers: BTreeSet<usize>,
    /// Rows that are left out of comparisons.
    left_out: Vec<usize>,
}

/// Scores `identified` (or the nominal robot if there is none) on all points of the request's set.
///
/// # Errors
/// As [`check_verify`], and [`Error::Cancelled`].
pub fn verify(
    request: &CalibrationRequest,
    identified: Option<&IdentifiedRobot>,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    check_verify(request, identified.map(|robot| &robot.plain))?;
    let scored = stage(monitor, "verify", |monitor| {
        watched(monitor, |watch| score(request, identified, watch)).flatten()
    })?;
    let mut per_point = per_point(
        (&scored.before.observed, &scored.before.model),
        (&scored.after.observed, &scored.after.model),
        scored.corrected.as_ref().map(PlacedCorrected::at_points),
    );
    for row in &scored.left_out {
        per_point[*row].is_outlier = true;
    }
    let Some(errors) = of_subset(&per_point, Subset::Verify) else {
        return Err(unusable("under_determined", "the set has no points"));
    };
    Ok(report(
        request,
        identified.is_some(),
        scored,
        per_point,
        errors,
    ))
}

/// Why fitting the base anew hides an error of the base of `identified`; `None` if that set has no base of its own.
fn base_hidden_because(
    request: &CalibrationRequest,
    identified: &KinematicModel,
) -> Option<&'static str> {
    if base_is_known(request, identified) {
        Some(BASE_PLACED_ANEW)
    } else if request.scored_frame == Some(Frame::Base) {
        Some(BASE_NOT_MEASURED)
    } else {
        None
    }
}

fn score(
    request: &CalibrationRequest,
    robot: Option<&IdentifiedRobot>,
    watch: &Watch<'_>,
) -> Result<Scored, Error> {
    let identified = robot.map(|robot| &robot.plain);
    let nominal = KinematicModel::nominal(&request.robot.links, request.set.n_targets());
    let mut after = identified.cloned().unwrap_or_else(|| nominal.clone());
    if let (None, Some(frames)) = (identified, &request.frames) {
        after.targets_mm[0].z = frames.z_tool_mm;
    }
    // The nominal robot's base is the base frame.
    let t_instrument_base = match identified.is_some_and(|model| base_is_known(request, model)) {
        true => IsometryMatrix3::identity(),
        false => after.t_instrument_base,
    };
    let before = KinematicModel {
        links: nominal.links,
        t_instrument_base,
        ..after.clone()
    };
    let refit = n_refitted(request, identified) > 0;
    let layout = Layout::new(
        request,
        &request.set,
        observe_to_verify(request),
        &after,
        refit,
        watch,
    )?;
    let (before, after) = (layout.place(&before), layout.place(&after));
    let corrected = robot.map(|robot| layout.place_corrected(robot, &after));
    let remarks = screening_warnings(&layout.screening, &after.observed, None, None);
    let outliers = layout
        .screening
        .outliers
        .iter()
        .map(|outlier| outlier.row)
        .collect();
    Ok(Scored {
        before,
        after,
        corrected,
        n_refitted: layout.n_refitted(),
        base_hidden_because: identified
            .filter(|_| layout.is_placed_anew)
            .and_then(|model| base_hidden_because(request, model)),
        remarks,
        outliers,
        left_out: layout.screening.rows_left_out().collect(),
    })
}

fn report(
    request: &CalibrationRequest,
    is_identified: bool,
    scored: Scored,
    per_point: Vec<PointErrors>,
    verify: SubsetErrors,
) -> CalibrationReport {
    let session = Session {
        points: &per_point,
        order: request.set.measuring_order(),
        scatter: SessionScatter {
            model: &scored.after.model,
            observations: &scored.after.observed.all,
        },
        refused_as: request.refused_as.as_deref(),
    };
    let verdict = match is_identified {
        true => Verdict::of_set(&session, request.held_out, &request.robot),
        false => {
            let (model, points) = (&scored.after.model, &scored.after.observed.all);
            let fit = nominal_fit(&request.robot, model, points, scored.n_refitted);
            Verdict::of_nominal(&session, fit)
        }
    };
    CalibrationReport {
        method: request.method,
        method_reason: verdict.in_words(),
        model: request.model(),
        preset: request.preset,
        seed: request.seed,
        termination: "verified",
        cost_mm2: cost(&scored.after.model, &scored.after.observed.all),
        verify: Some(verify),
        verify_without_outliers: verify_without(&per_point, &scored.outliers),
        per_point,
        instrument_scale: request.scale_at_reach(),
        // Without equations, O1 is 0.
        identifiability: Identifiability {
            observability_index_o1: Some(0.0),
            ..Identifiability::default()
        },
        warnings: warnings(request, &verdict, &scored, &verify),
        links: scored.after.model.links,
        t_instrument_base: scored.after.model.t_instrument_base,
        target_segments: scored.after.segments,
        targets_mm: scored.after.model.targets_mm,
        target_rotations: scored.after.model.target_rotations,
        corrected: scored.corrected.and_then(|placed| placed.robot.corrected),
        ..CalibrationReport::default()
    }
}

fn warnings(
    request: &CalibrationRequest,
    verdict: &Verdict,
    scored: &Scored,
    verify: &SubsetErrors,
) -> Vec<Warning> {
    let after = &scored.after;
    let placed = (scored.n_refitted > 0).then_some((&after.model, &after.observed.all[..]));
    let shows_little = shows_little(&request.robot, &request.set, placed);
    // Points that show little of the robot cannot show either that the set is no better than nominal.
    let told = verdict.warning();
    let told = told.filter(|told| told.code != NO_BETTER || shows_little.is_none());
    let mut warnings: Vec<Warning> = told.into_iter().collect();
    warnings.extend(shows_little);
    warnings.extend(request.scale_at_reach().and_then(instrument_scale));
    if let Some(detail) = scored.base_hidden_because {
        warnings.push(Warning::new(BASE_NOT_CHECKED, detail));
    }
    warnings.extend(few_verify_points(verify.n_points, scored.n_refitted));
    warnings.extend(scored.remarks.iter().cloned());
    warnings
}

/// Errors of another robot at each verify point, mm, for a request whose verify points are from its own upload. Base and targets are fitted
/// to all points of the upload, as for the identified robot, not to the verify points alone.
pub fn errors_on_verify_subset_mm(
    request: &CalibrationRequest,
    robot: &IdentifiedRobot,
) -> Result<Vec<f64>, Error> {
    let subsets = observe(request)?.subsets;
    let errors = errors_mm(request, &request.set, robot)?.into_iter();
    let of_verify = errors.zip(subsets).filter(|(_, s)| *s == Subset::Verify);
    Ok(of_verify.map(|(error, _)| error).collect())
}

/// Errors of a robot at all points of `set`, mm: with links alone or with corrections, whichever are larger. Base and targets are fitted
/// anew as in [`verify`].
pub fn errors_mm(
    request: &CalibrationRequest,
    set: &MeasurementSet,
    robot: &IdentifiedRobot,
) -> Result<Vec<f64>, Error> {
    let request = CalibrationRequest {
        set: set.clone(),
        verify: VerifySource::Default,
        ..request.clone()
    };
    let report = verify(&request, Some(robot), &mut |_| ControlFlow::Continue(()))?;
    let verify = report
        .verify
        .ok_or_else(|| unusable("under_determined", "there are no points to verify on"))?;
    let is_links = verify.worse() == verify.after;
    Ok(report
        .per_point
        .iter()
        .map(PointErrors::errors_mm)
        .map(|[_, links, corrected]| if is_links { links } else { corrected })
        .collect())
}
