//! Checks of the stored sets of a job with several sessions, before their points are read.

use crate::store::MeasurementSetRow;
use crate::wire::Invalid;
use crate::wire::job::JobRequestBody;
use crate::wire::measurement::MAX_POINTS;

/// Refuses sets that cannot be fitted together: of different frames, with different serial numbers, or too many points in all.
///
/// # Errors
/// [`Invalid`]: `mixed_frames`, `robot_mismatch`, `too_many_points`.
pub fn check(request: &JobRequestBody, sets: &[MeasurementSetRow]) -> Result<(), Invalid> {
    let [first, further @ ..] = sets else {
        return Ok(());
    };
    let stated = sets.iter().find_map(|set| set.serial_number.as_ref());
    for (place, set) in (1..).zip(further) {
        let at = request.set_pointer(place);
        if set.frame != first.frame {
            let detail = format!(
                "this set is in the frame {} and the first in the frame {}: fit sessions of one frame together, or upload this one in the other frame",
                set.frame.as_str(),
                first.frame.as_str()
            );
            return Err(Invalid::at(&at, "mixed_frames", detail));
        }
        let own = set.serial_number.as_ref().zip(stated);
        if let Some((own, other)) = own.filter(|(own, other)| own != other) {
            let detail = format!(
                "this set was uploaded for the serial number {own:?} and an earlier one for {other:?}: two robots are never fitted together, leave one out"
            );
            return Err(Invalid::at(&at, "robot_mismatch", detail));
        }
    }
    let n_points: i64 = sets.iter().map(|set| set.n_points).sum();
    if sets.len() > 1 && n_points > MAX_POINTS as i64 {
        let detail = format!(
            "{n_points} points in all; {MAX_POINTS} are allowed in one job: leave sessions out"
        );
        return Err(Invalid::at(
            "/measurement_set_ids",
            "too_many_points",
            detail,
        ));
    }
    Ok(())
}
