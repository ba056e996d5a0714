//! Verdict of the points on an identified or scored robot: whether it fits them, and whether it is better than the nominal one.

use crate::calibration::point_errors::{PointErrors, counted_errors_mm};
use crate::calibration::report::{CalibrationReport, DOES_NOT_FIT, SubsetErrors, Warning};
use crate::calibration::request::{CalibrationRequest, Method};
use crate::calibration::upload_checks::alignment::FITS;
use crate::calibration::validation::fit::Fit;
use crate::calibration::validation::robust_comparison::{RobustComparison, robust_comparison};
use crate::calibration::validation::session_fit::{
    FarRun, HeldOut, SessionScatter, error_ratio, far_run, session_fit,
};
use crate::calibration::warnings::plausibility;
use crate::calibration::warnings::refused_upload::advice;
use crate::identification::least_squares::multistart::STATED_STDS;
use crate::kinematics::{Link, Robot, reach_mm};
use crate::measurement::Subset;
use crate::solvers::median::median;

/// Warning: a parameter set is far off at points that fit the nominal robot.
pub const SET_FAR_OFF: &str = "set_far_off";
/// Warning: the nominal robot is as good on the verify points.
pub const NO_BETTER: &str = "no_better_than_nominal";
/// Warning: a parameter set fits a session, but is several times worse there than when it was identified.
pub const WORSE_THAN_IDENTIFIED: &str = "worse_than_identified";
/// Warning: a parameter set misses a session by several times the error of a robot that is fitted to that session alone.
pub const MISSES_SESSION: &str = "misses_session";
const WHY_NOT: &str = "Is it in another frame (a tracker's own frame is the frame instrument), with joints counted otherwise, or of another robot";

/// Verdict of the points on the parameter set.
pub struct Verdict {
    /// True if a parameter set was scored; false if only the nominal robot was.
    pub is_identified: bool,
    /// The errors of both robots.
    pub comparison: RobustComparison,
    /// Whether points, robot and set fit together.
    pub fit: Fit,
    /// Errors on held-out points when the set was identified.
    pub held_out: Option<HeldOut>,
    /// Configurations at which the set is far off, although it fits the session as a whole. `fit` is then [`Fit::SetFarOff`].
    pub far_run: Option<FarRun>,
    /// See [`error_ratio`]; `None` if the set's errors at its identification are unknown.
    pub error_ratio: Option<f64>,
    /// See [`SessionScatter::times`].
    pub scatter_ratio: Option<f64>,
    /// Code with which the points were refused, if the uploader insisted.
    pub refused_as: Option<String>,
}

/// A session that a parameter set was scored on.
pub struct Session<'a> {
    /// Errors of all its points.
    pub points: &'a [PointErrors],
    /// The points in measuring order.
    pub order: Vec<usize>,
    /// Its scatter about a robot that is fitted to it alone.
    pub scatter: SessionScatter<'a>,
    /// Code with which it was refused, if the uploader insisted.
    pub refused_as: Option<&'a str>,
}

impl Verdict {
    /// The verdict of a session on a parameter set with these errors at its identification.
    pub fn of_set(session: &Session<'_>, held_out: Option<HeldOut>, robot: &Robot) -> Self {
        let (links, scatter) = (&robot.links, &session.scatter);
        let errors_mm = counted_errors_mm(session.points);
        let comparison = robust_comparison(&errors_mm);
        let fit = session_fit(&errors_mm, held_out.as_ref(), robot, || scatter.own_mm());
        let of_run = held_out.as_ref().filter(|_| fit == Fit::Fits);
        let far_run =
            of_run.and_then(|known| far_run(session.points, &session.order, known, links));
        let after_mm = comparison.after_rms_mm;
        Self {
            is_identified: true,
            fit: fit.with_run(far_run.is_some()),
            far_run,
            error_ratio: held_out
                .and_then(|known| error_ratio(after_mm, known.identified_rms_mm, links)),
            scatter_ratio: scatter.times(after_mm, links),
            comparison,
            held_out,
            refused_as: session.refused_as.map(str::to_owned),
        }
    }

    /// The verdict on a nominal robot with this fit.
    pub fn of_nominal(session: &Session<'_>, fit: Fit) -> Self {
        Self {
            is_identified: false,
            comparison: robust_comparison(&counted_errors_mm(session.points)),
            fit,
            held_out: None,
            far_run: None,
            error_ratio: None,
            scatter_ratio: None,
            refused_as: session.refused_as.map(str::to_owned),
        }
    }

    /// The verdict in one sentence.
    pub fn in_words(&self) -> String {
        let (before, after) = (self.comparison.before_rms_mm, self.comparison.after_rms_mm);
        let remark = self.comparison.remark();
        let said = match (self.is_identified, self.fit, self.comparison.is_better()) {
            (false, Fit::DoesNotFit, _) => format!(
                "this file does not fit this robot ({before:.4} mm rms of the nominal robot{remark})"
            ),
            (false, ..) => format!(
                "the nominal robot was scored, {before:.4} mm rms{remark}; no parameter set was named and none is released"
            ),
            (true, Fit::DoesNotFit, _) => format!(
                "this file does not fit this robot ({after:.4} mm rms, the nominal robot {before:.4} mm{remark}), so nothing is said of the parameter set"
            ),
            (true, _, true) => format!(
                "the parameter set was scored, {after:.4} mm rms against {before:.4} mm of the nominal robot{remark}"
            ),
            (true, _, false) => format!(
                "the parameter set was scored, and with {after:.4} mm rms the calibrated robot is no better than the nominal one ({before:.4} mm{remark})"
            ),
        };
        format!("nothing was identified: {said}")
    }

    /// Warning to be read before a release.
    pub fn warning(&self) -> Option<Warning> {
        let (before, after) = (self.comparison.before_rms_mm, self.comparison.after_rms_mm);
        let remark = self.comparison.remark();
        let at_identification = self.held_out.map_or(String::new(), |held_out| {
            format!(
                "; when the parameter set was identified it was {:.4} mm and {:.4} mm",
                held_out.identified_rms_mm, held_out.nominal_rms_mm
            )
        });
        let refused = self.refused_as.as_deref();
        let refused = refused.map(|code| advice(code) + ".");
        let (code, detail) = match self.fit {
            Fit::DoesNotFit if !self.is_identified => (
                "session_does_not_fit",
                format!(
                    "this file does not fit this robot: the nominal robot misses its points by {before:.4} mm rms, and with base and tool placed as well \
                     as can be by more than {} % of its reach, twice what robots from the factory do. {} It is no evidence for anything",
                    100.0 * FITS,
                    refused.unwrap_or_else(|| format!("{WHY_NOT}?"))
                ),
            ),
            Fit::DoesNotFit => (
                "session_does_not_fit",
                format!(
                    "this file does not fit this robot: the calibrated robot misses its points by {after:.4} mm rms and the nominal one by {before:.4} \
                     mm{at_identification}. {} It is no evidence for or against the parameter set",
                    refused.unwrap_or_else(|| format!("{WHY_NOT}, or did the robot collide?"))
                ),
            ),
            _ if !self.is_identified => return None,
            Fit::SetFarOff if let Some(run) = &self.far_run => {
                return Some(Warning {
                    code: SET_FAR_OFF,
                    detail: format!(
                        "at {} successive configurations, from {:?} on, the calibrated robot misses by {:.4} mm rms; at most of the others it \
                         fits{at_identification}: the robot, its tool or the instrument has changed during the session. Check the robot, and measure a \
                         session anew",
                        run.n_configurations, run.first, run.rms_mm
                    ),
                    rows: run.rows.clone(),
                });
            }
            Fit::SetFarOff => (
                SET_FAR_OFF,
                format!(
                    "on these points the calibrated robot misses by {after:.4} mm rms, the nominal robot by {before:.4} mm{at_identification}: the \
                     robot, its tool or its base has changed, or the parameter set holds only near the poses that it was identified from"
                ),
            ),
            _ if !self.comparison.is_better() => (
                "no_better_than_nominal",
                format!(
                    "on these points{remark} the calibrated robot ({after:.4} mm rms) is no better than the nominal one ({before:.4} mm rms): do not use it"
                ),
            ),
            Fit::Fits if self.error_ratio.is_none() => {
                let times = self.scatter_ratio?;
                let detail = format!(
                    "on these points{remark} the calibrated robot misses by {after:.4} mm rms, {times:.1} times what is left where a robot is fitted to \
                     these points alone{at_identification}: the parameter set is not right for the robot as it was here. Too few parameters were \
                     identified, its own points were coarse, or it holds only near the poses that it was identified from"
                );
                (MISSES_SESSION, detail)
            }
            Fit::Fits => {
                let times = self.error_ratio?;
                let detail = format!(
                    "on these points{remark} the calibrated robot misses by {after:.4} mm rms, {times:.1} times what it missed by when it was \
                     identified{at_identification}: the robot, its tool or its base has changed, the instrument is coarser, or the parameter set holds \
                     only near the poses that it was identified from"
                );
                (WORSE_THAN_IDENTIFIED, detail)
            }
        };
        Some(Warning::new(code, detail))
    }
}

/// Limit of [`no_fit_mm`]: ten times the error of real arms after identification, as a share of the reach.
const NO_FIT_PER_REACH: f64 = 1.5e-3;

/// Median distance above which the identification has found nothing, mm.
pub fn no_fit_mm(request: &CalibrationRequest) -> f64 {
    f64::max(
        NO_FIT_PER_REACH * reach_mm(&request.robot.links),
        STATED_STDS * request.stated_position_std_mm(),
    )
}
/// Median angle above which the identified robot does not fit measured rotations, rad (2°). It is far above the noise of trackers.
const NO_FIT_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// Warning if the identified robot does not fit the points of its upload, whether fitted or held out: their positions or, for poses, their
/// rotations.
pub fn no_fit(per_point: &[PointErrors], request: &CalibrationRequest) -> Option<Warning> {
    let missed = |error: &dyn Fn(&PointErrors) -> Option<f64>, limit: f64| {
        let of = |subset: Subset| {
            let of_subset = per_point.iter().filter(|point| point.subset == subset);
            median(of_subset.filter_map(error)).filter(|median| *median > limit)
        };
        match of(Subset::Identify) {
            Some(median) => Some(("the points that it was identified from", median)),
            None => Some(("the points to verify", of(Subset::Verify)?)),
        }
    };
    let by_position = missed(&|point| Some(point.after_mm), no_fit_mm(request));
    let no_fit_rad = NO_FIT_RAD.max(STATED_STDS * request.set.stated_rotation_std_rad());
    let by_rotation = || missed(&|point| Some(point.rotation_rad?[1]), no_fit_rad);
    let detail = if let Some((which, median_mm)) = by_position {
        format!(
            "half of {which} are {median_mm:.3} mm or more from where the identified robot has them: that is no fit. Do joints and positions of a \
             row belong together, is it this robot, and is the model large enough? It cannot be released"
        )
    } else {
        let (which, median_rad) = by_rotation()?;
        format!(
            "half of {which} are turned by {:.2}° or more from where the identified robot has them: that is no fit. Do positions and rotations of a row \
             belong together, are both in the same frame, and is the convention of the rotations right? It cannot be released",
            median_rad.to_degrees()
        )
    };
    Some(Warning::new("no_fit", detail))
}

/// Warning of an identification that is verified on another session: the session does not fit the robot, or it fits and the set is far off
/// on it. `fitted` are the errors of the points that the robot was identified from.
pub fn of_another_session(
    session: &Session<'_>,
    fitted: &SubsetErrors,
    robot: &Robot,
) -> Option<Warning> {
    let held_out = HeldOut {
        nominal_rms_mm: fitted.before.rms_mm,
        identified_rms_mm: fitted.after.rms_mm,
    };
    let verdict = Verdict::of_set(session, Some(held_out), robot);
    verdict.warning().filter(|told| told.code != NO_BETTER)
}

/// Warnings of a finished identification. `fit` is the warning about the fit, if there is one already.
pub fn warnings(
    report: &CalibrationReport,
    nominal: &[Link],
    fit: Option<Warning>,
) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let is_evidence = fit.as_ref().is_none_or(|told| told.code != DOES_NOT_FIT);
    warnings.extend(fit);
    match &report.verify {
        None => warnings.push(Warning::new(
            "no_verify_points",
            "no points were kept to verify: the errors after are those of the fit itself",
        )),
        Some(_) if is_evidence => {
            let to_verify = report
                .per_point
                .iter()
                .filter(|point| point.subset == Subset::Verify && !point.is_outlier);
            let comparison = robust_comparison(
                &to_verify
                    .map(|point| [point.before_mm, point.after_mm, point.after_mm])
                    .collect::<Vec<_>>(),
            );
            if !comparison.is_better() {
                let detail = format!(
                    "on points that the fit has not seen{} the identified robot ({:.4} mm rms) is no better than the nominal one ({:.4} mm rms): do \
                     not use it",
                    comparison.remark(),
                    comparison.after_rms_mm,
                    comparison.before_rms_mm
                );
                warnings.push(Warning::new("no_better_than_nominal", detail));
            }
        }
        Some(_) => {}
    }
    let unseen = &report.identifiability.unidentifiable;
    // Combinations that no pose can show belong to the complete model. They are no fault of these points.
    if report.identifiability.rank < report.model_rank {
        let groups: Vec<String> = unseen.iter().map(|group| group.join(" with ")).collect();
        let detail = format!(
            "the measured poses show {} combinations of parameters, and other poses of this robot {}. These cannot be told apart or seen from the measured \
             positions, and the value of a single one says nothing by itself: {}",
            report.identifiability.rank,
            report.model_rank,
            groups.join("; ")
        );
        warnings.push(Warning::new("unidentifiable_parameters", detail));
    }
    warnings.extend(plausibility::warnings(report, nominal));
    if report.method == Method::LeastSquares
        && matches!(report.termination, "iteration_limit" | "not_finite")
    {
        warnings.push(Warning::new(
            "not_converged",
            "least squares did not converge; check joint offsets and wild points, or try method \"pso\"",
        ));
    }
    warnings
}
