//! Checks, before any fit, whether there are enough points for a verification: what the points can be used for, and how many parameters of
//! base and targets are fitted to them.

use crate::calibration::preparation::arrangement::MIN_OF_SETUP;
use crate::calibration::preparation::equations::n_equations;
use crate::calibration::preparation::observe::{observe_to_verify, observe_verify_set};
use crate::calibration::report::{FEW_VERIFY_POINTS, MIN_TO_PROVE, Warning};
use crate::calibration::request::CalibrationRequest;
use crate::calibration::validation::coverage::shows_little;
use crate::calibration::validation::verification_set::{
    in_base_frame, n_placed_where, n_stations, refits,
};
use crate::calibration::{Error, unusable};
use crate::identification::KinematicModel;
use crate::identification::least_squares::start::fit_base_and_targets;
use crate::identification::model::objective::Observation;
use crate::measurement::set::n_shared_points;
use crate::measurement::{Frame, MeasurementSet};
use nalgebra::IsometryMatrix3;

/// Minimum share of the squared error that stays visible. If p parameters are fitted to m equations, the share 1 − p/m remains on average.
/// Below one third a set is refused; with as many equations as parameters, every robot fits. For positions of one target, nine parameters
/// are fitted, so five points (15 equations) are enough.
const MIN_SHARE_SEEN: (usize, usize) = (1, 3);
/// At most one in this many points of a verification set may be identical, bit for bit, to an identified point. A pose that was measured
/// twice may repeat by chance. In a file that was uploaded twice, every row repeats.
const MAX_SHARED: usize = 10;
/// Below this number of residuals per fitted parameter, the fit hides a large part of the error.
const FEW_RESIDUALS: usize = 3;

/// The checks of [`verify`](crate::calibration::validation::verify::verify) that need no fit.
///
/// # Errors
/// [`Error::Unusable`] with code `under_determined` or `model_mismatch`.
pub fn check_verify(
    request: &CalibrationRequest,
    identified: Option<&KinematicModel>,
) -> Result<(), Error> {
    let n_links = request.robot.links.len();
    if identified.is_some_and(|model| model.links.len() != n_links) {
        return Err(unusable(
            "model_mismatch",
            format!("the parameter set is not of this robot: the robot has {n_links} links"),
        ));
    }
    check_enough(
        &observe_to_verify(request).all,
        &request.set,
        n_refitted(request, identified) > 0,
    )
}

/// What a job of kind verify can use a set of points for.
#[derive(Clone, Debug, PartialEq)]
pub enum Serves {
    /// It is evidence for or against a parameter set.
    Evidence,
    /// A set can be scored on it, but that is no evidence; with the reason.
    Scores(String),
    /// Nothing can be scored on it; with the reason.
    Nothing(String),
}

/// What the request's set can be used for. `refit`: base and targets are fitted to it instead of taken from the parameter set.
pub fn serves(request: &CalibrationRequest, refit: bool) -> Serves {
    let set = &request.set;
    let points = observe_to_verify(request).all;
    if let Err(error) = check_enough(&points, set, refit) {
        return Serves::Nothing(error.to_string());
    }
    // A single placement for all stations would place the reflector wrongly.
    let is_placed = refit && n_stations(set) == 1;
    let nominal =
        is_placed.then(|| fit_base_and_targets(&request.robot.links, &points, set.n_targets()));
    let n_placed = n_placed_where(refit, set);
    let n_points = set.points.len();
    let needed = (FEW_RESIDUALS * n_placed).div_ceil(3).max(MIN_TO_PROVE);
    let is_few = few_verify_points(n_points, n_placed).is_some()
        || set.n_distinct_configurations() < MIN_TO_PROVE;
    let of_targets = match set.n_targets() {
        1 => format!("{needed} configurations are"),
        _ => format!("{needed} points from at least {MIN_TO_PROVE} configurations are"),
    };
    if is_few {
        Serves::Scores(format!(
            "so few points are no evidence for a release: {of_targets}"
        ))
    } else if let Some(warning) = shows_little(
        &request.robot,
        set,
        nominal.as_ref().map(|model| (model, &points[..])),
    ) {
        Serves::Scores(warning.detail)
    } else if set.frame == Frame::Base && n_placed > 0 {
        Serves::Scores("its base is placed anew, so that a wrong base does not show".into())
    } else {
        Serves::Evidence
    }
}

/// Warning if there are few points for the number of refitted base and target parameters. Such points are no evidence.
pub fn few_verify_points(n_points: usize, n_refitted: usize) -> Option<Warning> {
    (3 * n_points < FEW_RESIDUALS * n_refitted).then(|| {
        let detail = format!(
            "{n_points} points, from which {n_refitted} numbers of base and targets were refitted: the errors are smaller than they would be elsewhere"
        );
        Warning::new(FEW_VERIFY_POINTS, detail)
    })
}

/// Checks of a separate verification set: the job can score it, and it differs from the identified points.
///
/// # Errors
/// [`Error::Unusable`] with code `under_determined` or `verify_overlaps_identify`.
pub fn check_verify_set(request: &CalibrationRequest, set: &MeasurementSet) -> Result<(), Error> {
    let n_same = n_shared_points(&request.set, set);
    if MAX_SHARED * n_same > set.points.len() {
        let detail = format!(
            "{n_same} of the verify set's {} points are in the set to identify from as well, joints and positions: that proves nothing. Upload \
             points that were measured anew",
            set.points.len()
        );
        return Err(unusable("verify_overlaps_identify", detail));
    }
    check_enough(
        &observe_verify_set(request, set).all,
        set,
        refits(request, set),
    )
}

/// Refuses points that leave too little to verify after base and targets are fitted, with one base per station.
fn check_enough(
    observations: &[Observation],
    set: &MeasurementSet,
    refit: bool,
) -> Result<(), Error> {
    let (n_targets, n_stations) = (set.n_targets(), n_stations(set));
    let n_refitted = match n_placed_where(refit, set) {
        0 => 0,
        n_placed => n_placed + 3 * set.posed_targets().len(),
    };
    if let Some(target) = (0..n_targets)
        .find(|target| n_refitted > 0 && !observations.iter().any(|o| o.target == *target))
    {
        let detail = format!(
            "target {target} has no row among the points to verify on; number targets from 0 without gaps"
        );
        return Err(unusable("under_determined", detail));
    }
    let of_station =
        |station: &Option<String>| set.points.iter().filter(|p| p.station == *station).count();
    let small = set
        .points
        .iter()
        .map(|p| &p.station)
        .find(|station| n_stations > 1 && of_station(station) < MIN_OF_SETUP);
    if let Some(station) = small {
        let detail = format!(
            "station {:?} has {} points to verify on, its base takes at least {MIN_OF_SETUP}: measure more there, or leave it out",
            station.as_deref().unwrap_or(""),
            of_station(station)
        );
        return Err(unusable("under_determined", detail));
    }
    // 1 − p/m ≥ a/b, in integers
    let (a, b) = MIN_SHARE_SEEN;
    let needed = (b * n_refitted).div_ceil(b - a).max(1);
    let found = n_equations(observations, needed);
    if found < needed {
        let detail = format!(
            "{found} equations from distinct configurations cannot place base and targets anew ({n_refitted} numbers) and still verify; measure at \
             least {} more configurations",
            (needed - found).div_ceil(3)
        );
        return Err(unusable("under_determined", detail));
    }
    Ok(())
}

/// True if the base of `identified` is known in the frame of the points: both were measured in the base frame.
pub fn base_is_known(request: &CalibrationRequest, identified: &KinematicModel) -> bool {
    in_base_frame(request)
        && (request.scored_frame == Some(Frame::Base)
            || identified.t_instrument_base == IsometryMatrix3::identity())
}

/// True if base and targets are fitted anew to the request's points, even without steps.
pub fn is_placed_anew(request: &CalibrationRequest, identified: Option<&KinematicModel>) -> bool {
    n_refitted(request, identified) > 0
}

/// Number of base and target parameters that are fitted to the points; 0 if both are known.
pub fn n_refitted(request: &CalibrationRequest, identified: Option<&KinematicModel>) -> usize {
    let n_targets = request.set.n_targets();
    let is_placed = match identified {
        // The numbering of targets is known only for the identified targets.
        Some(model) => {
            let is_turned = !request.set.has_poses() || !model.target_rotations.is_empty();
            base_is_known(request, model) && n_targets <= model.targets_mm.len() && is_turned
        }
        None => in_base_frame(request) && n_targets <= 1 && !request.set.has_poses(),
    };
    if is_placed {
        0
    } else {
        6 + 3 * n_targets + 3 * request.set.posed_targets().len()
    }
}
