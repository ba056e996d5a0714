//! Text about the results of the screening.

use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::observe::Observed;
use crate::calibration::preparation::screening::{Outlier, Screening};
use crate::calibration::problem::Problem;
use crate::calibration::report::Warning;
use crate::calibration::request::Loss;
use crate::calibration::warnings::over_session::over_session;
use crate::identification::KinematicModel;
use crate::identification::model::objective::Observation;
use crate::identification::screening::steps::{Moved, Step};
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::measurement::Subset;

/// Maximum number of points listed with their sizes in a detail; `rows` has all of them.
const LISTED: usize = 20;
/// A verify point is an extrapolation if the identified robot's uncertainty there exceeds this multiple of the largest at the fitted points.
const EXTRAPOLATION_RATIO: f64 = 2.0;
/// A warning is given if more than this share of the verify points are extrapolations.
const MAX_EXTRAPOLATED_SHARE: f64 = 0.1;

/// The warnings about outliers, steps, and errors over the session. `asked` is the loss that the request states. `delivered` is the
/// arrangement of the points from which a base is identified; `None` for points that only verify.
pub fn screening_warnings(
    screening: &Screening,
    observed: &Observed,
    asked: Option<Loss>,
    delivered: Option<&Arrangement>,
) -> Vec<Warning> {
    let base = delivered
        .and_then(|arrangement| delivered_base(screening, arrangement))
        .unwrap_or_default();
    let mut warnings: Vec<Warning> = screening.steps.iter().map(|s| moved(s, &base)).collect();
    warnings.extend(over_session(&screening.over_session));
    if !screening.unfitted_rows.is_empty() {
        let detail = "no point to identify lies in the segment after a step: these rows are scored as if nothing had moved";
        warnings.push(Warning {
            code: "stretch_without_identify_points",
            detail: detail.into(),
            rows: screening.unfitted_rows.clone(),
        });
    }
    warnings.extend(outliers(screening, observed, asked.is_some()));
    warnings
}

/// Warning about verify points at which the identified robot is far less certain than at any fitted point, and by more than the scatter of the
/// points. The identify points do not determine the robot there. `scatter_mm` is the rms length of the residuals in the fit.
pub fn extrapolated(
    problem: &Problem<'_>,
    model: &KinematicModel,
    uncertainty: &Uncertainty,
    scatter_mm: f64,
) -> Option<Warning> {
    let observed = &problem.observed;
    let stds = |subset: Subset| -> Vec<(usize, f64)> {
        let rows = (0..observed.all.len())
            .filter(|row| observed.subsets[*row] == subset && observed.all[*row].weight > 0.0);
        let at = |o: &Observation| {
            uncertainty.position_std_mm(model, &problem.parameters, &o.q_rad, o.target)
        };
        rows.map(|row| (row, at(&observed.all[row]))).collect()
    };
    let largest = |stds: &[(usize, f64)]| stds.iter().map(|(_, std)| *std).fold(0.0, f64::max);
    let (fitted, to_verify) = (largest(&stds(Subset::Identify)), stds(Subset::Verify));
    let limit_mm = (EXTRAPOLATION_RATIO * fitted).max(scatter_mm);
    let beyond: Vec<(usize, f64)> = to_verify
        .iter()
        .copied()
        .filter(|(_, std)| *std > limit_mm)
        .collect();
    let detail = format!(
        "{} of {} points to verify lie beyond what the identify subset fixes: the identified robot is uncertain there by up to {:.3} mm (one standard \
         deviation), at the fitted points by {fitted:.3} mm at most. Their errors are those of an extrapolation; identify from points of \
         that part of the workspace as well, or use the robot only where it was measured",
        beyond.len(),
        to_verify.len(),
        largest(&beyond),
    );
    let rows: Vec<usize> = beyond.iter().map(|(row, _)| *row).collect();
    let are_many = rows.len() as f64 > MAX_EXTRAPOLATED_SHARE * to_verify.len() as f64;
    are_many.then_some(Warning {
        code: "verify_extrapolates",
        detail,
        rows,
    })
}

/// The warnings of a separate verification set, marked as such.
pub fn of_the_verify_set(warnings: Vec<Warning>) -> impl Iterator<Item = Warning> {
    warnings.into_iter().map(Warning::of_the_verify_set)
}

/// The segment for which the delivered base is valid, as text; `None` if the base did not move.
fn delivered_base(screening: &Screening, arrangement: &Arrangement) -> Option<String> {
    let is_of_base = |s: &&Step| s.moved == Moved::Base && !s.is_one_point;
    let steps = screening.steps.iter().filter(is_of_base);
    let place = |s: &&Step| arrangement.order.iter().position(|point| *point == s.first);
    Some(if arrangement.is_last_reference {
        let row = steps.max_by_key(place)?.first;
        format!(
            ". The delivered base is that of the rows from row {row} on: predictions and corrected targets hold for the robot as it stands now"
        )
    } else {
        let row = steps.min_by_key(place)?.first;
        format!(
            ". The delivered base is that of the rows before row {row}, because the base frame is known for these: predictions and corrected targets hold for \
             the robot as it stood then. If it still stands where it moved to, set up the base frame and measure again"
        )
    })
}

/// `delivered_base` is added to the warning about a base.
fn moved(step: &Step, delivered_base: &str) -> Warning {
    let v = step.shift_mm;
    let vector = format!(
        "({:.3}, {:.3}, {:.3}) mm, {:.3} mm long",
        v.x,
        v.y,
        v.z,
        v.norm()
    );
    let (code, what) = match step.moved {
        Moved::Target(target) if v.norm() == 0.0 => (
            "target_moved",
            format!(
                "target {target} was turned on the flange by {:.4}\u{b0}",
                step.turn_rad.norm().to_degrees()
            ),
        ),
        Moved::Target(target) => (
            "target_moved",
            format!("target {target} moved by {vector}, in the flange frame"),
        ),
        Moved::Base => {
            let turn = step.turn_rad.norm().to_degrees();
            (
                "base_moved",
                format!(
                    "the base moved against the instrument by {vector}, and by {turn:.4}\u{b0}, in the measuring frame"
                ),
            )
        }
    };
    let consequence = match step.is_one_point {
        true => {
            "it is one point alone, which may have slipped or may be wild: it was left out where it was to be fitted"
        }
        false => "the stretches before and after it were fitted apart",
    };
    let delivered = match step.moved {
        Moved::Base if !step.is_one_point => delivered_base,
        _ => "",
    };
    Warning {
        code,
        detail: format!(
            "before row {}, {what}; {consequence}{delivered}",
            step.first
        ),
        rows: vec![step.first],
    }
}

fn outliers(screening: &Screening, observed: &Observed, asked: bool) -> Option<Warning> {
    if screening.outliers.is_empty() {
        return None;
    }
    let rows: Vec<usize> = screening.outliers.iter().map(|w| w.row).collect();
    let n_fitted = rows
        .iter()
        .filter(|row| observed.subsets[**row] == Subset::Identify)
        .count();
    let what = format!(
        "{} of {} points do not belong to the others, which scatter by {:.4} mm (one standard deviation of a coordinate): {}",
        rows.len(),
        observed.all.len(),
        screening.scale_mm,
        listed(&screening.outliers)
    );
    let is_left_out = screening.is_down_weighted;
    let (code, consequence) = match (screening.is_for_review, asked) {
        (false, false) if n_fitted == 0 => {
            ("outliers", "base and targets were placed without them; all stay in the statistics, as measured".into())
        }
        (false, false) => {
            let counts = if n_fitted == 1 { "the one of them that was to be fitted counts" } else { "those that were to be fitted count" };
            ("outliers", format!("{counts} nothing; all stay in the statistics, as measured"))
        }
        (false, true) => ("outliers", "they count as the loss that was asked for has it".into()),
        (true, true) => ("outliers_review", "look at them: more than a twentieth; they count as the loss that was asked for has it".into()),
        (true, false) if is_left_out => (
            "outliers_review",
            "look at them: they are more than a twentieth of the points. Those that were to be fitted count nothing; all stay in the statistics, as measured"
                .into(),
        ),
        (true, false) => (
            "outliers_review",
            "look at them: they are more than a tenth of the points, so none was left out; Huber's loss keeps them from pulling hard".into(),
        ),
    };
    Some(Warning {
        code,
        detail: format!("{what}; {consequence}"),
        rows,
    })
}

fn listed(outliers: &[Outlier]) -> String {
    let mut names: Vec<String> = outliers
        .iter()
        .take(LISTED)
        .map(|w| match w.angle_rad {
            Some(angle_rad) => format!("row {}, turned by {:.2}°", w.row, angle_rad.to_degrees()),
            None => format!("row {} by {:.3} mm", w.row, w.size_mm),
        })
        .collect();
    if outliers.len() > LISTED {
        names.push(format!("and {} more", outliers.len() - LISTED));
    }
    names.join(", ")
}
