//! Checks whether a session fits the robot at all, before the parameter set that is scored on it is judged.
//!
//! A file in a wrong frame, of another robot, or measured after a collision says nothing about a parameter set: if both errors are metres,
//! chance decides which is smaller. The expected errors are known from the set's identification, where the set and the nominal robot were
//! scored on held-out points. Errors above a share of the robot's reach ([`FITS`]) never fit, even if nothing is known about the set and
//! however few the points are.

use crate::calibration::point_errors::PointErrors;
use crate::calibration::upload_checks::alignment::FITS;
use crate::calibration::validation::fit::Fit;
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::estimate;
use crate::identification::least_squares::problem::Problem;
use crate::identification::least_squares::start::{fit_base_and_targets, fit_targets};
use crate::identification::model::objective::{Observation, residual_mm};
use crate::identification::model::parameters::complete_parameters;
use crate::kinematics::{Link, Robot, reach_mm};
use crate::solvers::median::median;
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// A valid set's error on another session is below this multiple of its error on its own held-out points.
const MAX_ERROR_RATIO: f64 = 10.0;
/// An error above this multiple is reported. Between sessions of the measured robots the ratio is 1.0 to 1.5. Other poses or another
/// temperature may double it.
const REPORTED_ERROR_RATIO: f64 = 3.0;
/// The nominal robot's errors depend on the poses. Between two sessions of one robot they differ by less than this factor.
const MAX_NOMINAL_RATIO: f64 = 2.0;
/// Smallest error that serves as a reference, as a share of the robot's reach: neither robots nor trackers repeat a pose better.
pub const MIN_REFERENCE_PER_REACH: f64 = 1e-5;
/// Ratio of rms to median of the length of a 3-D normal error: √3 over 1.5382. A few outliers do not move a median.
const RMS_OVER_MEDIAN: f64 = 1.126;
/// The errors of a [`FarRun`] are above this multiple of the session's own typical error as well.
const FAR_OF_TYPICAL: f64 = 3.0;
/// Minimum number of successive configurations of a [`FarRun`].
const MIN_OF_RUN: usize = 4;
/// Maximum number of points for estimating the scatter of a session.
const MAX_FITTED: usize = 2_000;
/// The fit of a session is assumed to leave at least this share of its equations free, because priors determine what few points do not.
const MIN_FREE_SHARE: f64 = 0.25;
/// Minimum number of equations per fitted number for estimating the scatter of a session.
const EQUATIONS_PER_NUMBER: usize = 2;

/// Errors at the points on which a parameter set was verified when it was identified, rms, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOut {
    /// Error of the nominal robot.
    pub nominal_rms_mm: f64,
    /// Error of the parameter set.
    pub identified_rms_mm: f64,
}

/// Ratio of a set's error on a session to its error when it was identified, both rms, mm. `None` below [`REPORTED_ERROR_RATIO`]: such ratios occur between sessions
/// of an unchanged robot.
pub fn error_ratio(session_mm: f64, identified_mm: f64, links: &[Link]) -> Option<f64> {
    let times = session_mm / identified_mm.max(MIN_REFERENCE_PER_REACH * reach_mm(links));
    (times >= REPORTED_ERROR_RATIO).then_some(times)
}

/// Ratio of a set's error on a session to that of a robot fitted to this session alone (`scatter_mm`, 0 if there are too few points), both rms, mm.
/// `None` below [`REPORTED_ERROR_RATIO`].
fn scatter_ratio(session_mm: f64, scatter_mm: f64, links: &[Link]) -> Option<f64> {
    let times = session_mm / scatter_mm.max(MIN_REFERENCE_PER_REACH * reach_mm(links));
    (scatter_mm > 0.0 && times >= REPORTED_ERROR_RATIO).then_some(times)
}

/// [`own_scatter_mm`] as expected at points that were not fitted, from at most [`MAX_FITTED`] points.
fn expected_scatter_mm(model: &KinematicModel, observations: &[Observation]) -> f64 {
    let step = observations.len().div_ceil(MAX_FITTED).max(1);
    let some: Vec<Observation> = observations.iter().step_by(step).cloned().collect();
    let n_numbers = complete_parameters(model.links.len(), model.targets_mm.len()).len();
    let left = 1.0 - n_numbers as f64 / (3 * some.len()).max(1) as f64;
    own_scatter_mm(model, &some) / left.max(MIN_FREE_SHARE).sqrt()
}

/// Smallest error that [`error_ratio`] reports, mm.
pub fn smallest_reported_error_mm(identified_mm: f64, links: &[Link]) -> f64 {
    REPORTED_ERROR_RATIO * identified_mm.max(MIN_REFERENCE_PER_REACH * reach_mm(links))
}

/// Scatter of a session about a robot fitted to this session alone. It is computed only if the result depends on it.
pub struct SessionScatter<'a> {
    /// The scored robot, placed on the session.
    pub model: &'a KinematicModel,
    /// The session's points.
    pub observations: &'a [Observation],
}

impl SessionScatter<'_> {
    /// See [`own_scatter_mm`].
    pub fn own_mm(&self) -> f64 {
        own_scatter_mm(self.model, self.observations)
    }

    /// See [`scatter_ratio`]; `None` for errors below the resolution of instruments.
    pub fn times(&self, session_mm: f64, links: &[Link]) -> Option<f64> {
        if session_mm < smallest_reported_error_mm(0.0, links) {
            return None;
        }
        let scatter_mm = expected_scatter_mm(self.model, self.observations);
        scatter_ratio(session_mm, scatter_mm, links)
    }
}

/// Whether the points fit the robot and the set. `errors_mm` are each point's errors of the nominal robot, of the set's links, and of its links with
/// corrections.
pub fn session_fit(
    errors_mm: &[[f64; 3]],
    held_out: Option<&HeldOut>,
    robot: &Robot,
    own_scatter_mm: impl FnOnce() -> f64,
) -> Fit {
    let typical = |of: usize| typical_mm(errors_mm.iter().map(|errors| errors[of]));
    let set_mm = typical(1).max(typical(2));
    let farthest_mm = FITS * reach_mm(&robot.links);
    if set_mm.min(typical(0)) > farthest_mm {
        return Fit::DoesNotFit;
    }
    let Some(held_out) = held_out else {
        return match set_mm > farthest_mm {
            true => Fit::SetFarOff,
            false => Fit::Fits,
        };
    };
    let finest_mm = MIN_REFERENCE_PER_REACH * reach_mm(&robot.links);
    let nominal_mm = held_out.nominal_rms_mm.max(finest_mm);
    let expected_mm = held_out.identified_rms_mm.max(finest_mm);
    if set_mm <= MAX_ERROR_RATIO * expected_mm {
        return Fit::Fits;
    }
    // If the session's own scatter is much larger than the set's error on held-out points, the session cannot distinguish a good set from a
    // bad one. The cause is a coarse instrument, rounded joint values or backlash. The scatter is limited to the nominal robot's error on
    // held-out points, because the scatter of a file that no robot fits explains nothing.
    let scatter_mm = own_scatter_mm().min(nominal_mm);
    if set_mm <= MAX_ERROR_RATIO * scatter_mm {
        Fit::DoesNotFit
    } else if typical(0) <= MAX_NOMINAL_RATIO * nominal_mm {
        Fit::SetFarOff
    } else {
        Fit::DoesNotFit
    }
}

/// Whether the nominal robot fits the points. If `n_refitted` is 0, its targets are fitted in the base frame. Otherwise `n_refitted`
/// parameters of base and targets were already fitted to the points.
pub fn nominal_fit(
    robot: &Robot,
    nominal: &KinematicModel,
    observations: &[Observation],
    n_refitted: usize,
) -> Fit {
    let (model, n_fitted) = match n_refitted {
        0 => {
            let targets: BTreeSet<usize> = observations.iter().map(|o| o.target).collect();
            let n_targets = nominal.targets_mm.len();
            let placed = fit_targets(&nominal.links, observations, n_targets);
            (placed, 3 * targets.len())
        }
        n => (nominal.clone(), n),
    };
    let n_equations = 3 * observations.len();
    // With few points, the fitted parameters absorb a large part of the errors.
    let shrunk = (n_equations as f64 / n_equations.saturating_sub(n_fitted).max(1) as f64).sqrt();
    let errors_mm: Vec<[f64; 3]> = observations
        .iter()
        .map(|o| [shrunk * residual_mm(&model, o).norm(); 3])
        .collect();
    session_fit(&errors_mm, None, robot, || 0.0)
}

/// The session's own scatter, rms, mm: the error that remains after fitting links, base and targets to it. 0 if there are too few points.
pub fn own_scatter_mm(model: &KinematicModel, observations: &[Observation]) -> f64 {
    let Some(fitted) = fitted_to_session(&model.links, observations) else {
        return 0.0;
    };
    typical_mm(observations.iter().map(|o| residual_mm(&fitted, o).norm()))
}

/// The robot with links, base and targets fitted; `None` if there are too few points.
pub fn fitted_to_session(links: &[Link], observations: &[Observation]) -> Option<KinematicModel> {
    let n_targets = observations.iter().map(|o| o.target + 1).max().unwrap_or(0);
    let n_equations = 3 * observations.len();
    if n_equations < EQUATIONS_PER_NUMBER * (6 + 3 * n_targets) {
        return None;
    }
    // Only the scatter of positions is used, even if poses were measured.
    let observations: Vec<Observation> = observations
        .iter()
        .map(Observation::position_alone)
        .collect();
    let fitted = fit_base_and_targets(links, &observations, n_targets);
    let parameters = complete_parameters(links.len(), n_targets);
    let problem = Problem::new(fitted, &parameters, &observations);
    let start = vec![0.0; parameters.len()];
    let go_on = &mut |_| ControlFlow::Continue(());
    Some(estimate(&problem, &start, 0.0, go_on).model)
}

/// Successive configurations at all of whose points a set is far off, while it fits the other points. This shows that the robot changed
/// during the session.
#[derive(Clone, Debug, PartialEq)]
pub struct FarRun {
    /// Name of the first point, or the label of its configuration.
    pub first: String,
    /// Number of configurations.
    pub n_configurations: usize,
    /// Errors of the set at their points, rms, mm.
    pub rms_mm: f64,
    /// Their rows, in measuring order.
    pub rows: Vec<usize>,
}

/// The longest run of at least [`MIN_OF_RUN`] configurations whose errors are all above [`MAX_ERROR_RATIO`] times the error on held-out
/// points. `order` has the rows of `points` in measuring order. Single wrong rows, e.g. after an interrupted beam, are outliers and no run.
pub fn far_run(
    points: &[PointErrors],
    order: &[usize],
    held_out: &HeldOut,
    links: &[Link],
) -> Option<FarRun> {
    let error_mm = |row: &usize| {
        let [_, links_mm, corrected_mm] = points[*row].errors_mm();
        links_mm.min(corrected_mm)
    };
    let expected_mm = held_out
        .identified_rms_mm
        .max(MIN_REFERENCE_PER_REACH * reach_mm(links));
    // In a coarse session, single points are far off by its scatter.
    let limit_mm = (MAX_ERROR_RATIO * expected_mm)
        .max(FAR_OF_TYPICAL * typical_mm(order.iter().map(error_mm)));
    let runs = order.chunk_by(|a, b| (error_mm(a) > limit_mm) == (error_mm(b) > limit_mm));
    let far = runs.filter(|rows| error_mm(&rows[0]) > limit_mm);
    let run = |rows: &[usize]| {
        let labels = rows.iter().map(|row| points[*row].configuration.as_str());
        let squares: f64 = rows.iter().map(|row| error_mm(row) * error_mm(row)).sum();
        FarRun {
            first: points[rows[0]].configuration.clone(),
            n_configurations: labels.collect::<BTreeSet<_>>().len(),
            rms_mm: (squares / rows.len() as f64).sqrt(),
            rows: rows.to_vec(),
        }
    };
    far.map(run)
        .filter(|run| run.n_configurations >= MIN_OF_RUN)
        .max_by_key(|run| run.n_configurations)
}

/// rms of normal errors with the median of `errors_mm`.
fn typical_mm(errors_mm: impl Iterator<Item = f64>) -> f64 {
    RMS_OVER_MEDIAN * median(errors_mm).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::{Fit, HeldOut, session_fit};
    use crate::kinematics::{Link, Robot};

    fn robot() -> Robot {
        let link = Link {
            a_mm: 300.0,
            alpha_rad: 1.5,
            d_mm: 400.0,
            theta_offset_rad: 0.0,
            beta_rad: 0.0,
        };
        Robot {
            links: vec![link; 6],
            joint_limits_rad: vec![None; 6],
            joint_map: None,
            mounting: None,
        }
    }

    const HELD_OUT: HeldOut = HeldOut {
        nominal_rms_mm: 1.1,
        identified_rms_mm: 0.05,
    };

    fn fit(nominal_mm: f64, set_mm: f64, scatter_mm: f64) -> Fit {
        let errors = vec![[nominal_mm, set_mm, set_mm]; 20];
        session_fit(&errors, Some(&HELD_OUT), &robot(), || scatter_mm)
    }

    #[test]
    fn a_session_fits_by_what_the_set_missed_before_and_by_its_own_scatter() {
        assert_eq!(fit(1.1, 0.06, 0.05), Fit::Fits);
        assert_eq!(fit(2634.2, 2634.0, 0.1), Fit::DoesNotFit, "a frame");
        assert_eq!(fit(3.4, 2.9, 0.05), Fit::DoesNotFit, "a collision");
        assert_eq!(fit(1.1, 0.95, 0.9), Fit::DoesNotFit, "a coarse file");
        assert_eq!(fit(230.0, 230.0, 200.0), Fit::DoesNotFit, "garbage");
        assert_eq!(fit(0.0, 1.1, 0.0), Fit::SetFarOff, "a bad set");
        assert_eq!(fit(1.1, 1.9, 0.05), Fit::SetFarOff, "a bad set");
        let mut errors = vec![[1.1, 0.06, 0.06]; 20];
        errors[..4].fill([90.0; 3]);
        let fit = session_fit(&errors, Some(&HELD_OUT), &robot(), || 0.0);
        assert_eq!(fit, Fit::Fits, "a few outliers");
    }
}
