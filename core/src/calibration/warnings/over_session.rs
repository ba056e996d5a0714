//! Text about errors over a session: backlash of joints, errors that the points of a visit share, drift.

use crate::calibration::preparation::all_fit::SessionErrors;
use crate::calibration::report::Warning;
use crate::identification::screening::backlash::{Backlash, ShownBy};
use crate::identification::screening::drift::{Course, Drift};
use crate::identification::screening::settling::SharedErrors;

pub(super) fn over_session(errors: &SessionErrors) -> impl Iterator<Item = Warning> {
    let played = errors.backlash.iter().map(played);
    let shared = errors.shared.as_ref().map(share_errors);
    let drifted = errors.drift.as_ref().map(drifted);
    played.chain(shared).chain(drifted)
}

fn played(play: &Backlash) -> Warning {
    let names: Vec<String> = play.joints.iter().map(|j| (j + 1).to_string()).collect();
    let joint = names.join(" or ");
    let (degrees, effect) = (play.backlash_rad.abs().to_degrees(), play.effect_mm);
    let detail = match play.shown_by {
        ShownBy::Order if play.backlash_rad < 0.0 => format!(
            "where the pose before has another value of joint {joint}, the arm stands farther on by {degrees:.4}\u{b0} between both sides ({effect:.3} mm, rms of a \
             coordinate): joint values that were read before the arm had settled look like that. Read them once the arm stands still"
        ),
        ShownBy::Order => format!(
            "where the arm stands depends on the side from which joint {joint} came, by {degrees:.4}\u{b0} ({effect:.3} mm, rms of a coordinate): play. \
             Approach all poses from one side, in measuring and in programs, or have the gear looked at"
        ),
        ShownBy::Repeats { n_poses } => format!(
            "visits of one pose differ along the motion of joint {joint} and hardly across it, at {n_poses} poses: by {degrees:.4}\u{b0} between both sides \
             ({effect:.3} mm, rms of a coordinate): play, or joint values that were read before the joint had settled. The order of the rows does not show \
             the sides: approach all poses from one side, and compare"
        ),
    };
    Warning::new("backlash", detail)
}

fn share_errors(shared: &SharedErrors) -> Warning {
    let SharedErrors {
        shared_mm,
        own_mm,
        joints_rad,
    } = shared;
    let like = match joints_rad {
        Some(rad) => format!(
            "joint values that are off by {:.4}\u{b0} explain it: read before the arm had settled, or errors that links cannot say. Read the joint values \
             again once the arm stands still, or take the commanded ones, and compare",
            rad.to_degrees()
        ),
        None => "one shift per visit explains it better than joint values: look whether the instrument or the base moves between the visits".into(),
    };
    Warning::new(
        "configurations_err_together",
        format!(
            "the points of one visit err together by {shared_mm:.4} mm (one standard deviation of a coordinate), each by itself by {own_mm:.4} mm: {like}"
        ),
    )
}

fn drifted(drift: &Drift) -> Warning {
    let v = drift.vector_mm;
    let (code, how) = match drift.course {
        Course::Steady => ("drift", "steadily".to_owned()),
        Course::WarmUp { time_constant } => (
            "warm_up",
            format!(
                "fast at first and then slower, 63 % of it in the first {:.0} % of the session, as of something that warms up",
                100.0 * time_constant
            ),
        ),
        Course::Wandering => ("drift", "to and fro".to_owned()),
    };
    let repeats = drift.by_repeats_mm.map_or_else(
        || "no pose was visited twice to show it by itself".to_owned(),
        |(n_rows, r)| {
            format!(
                "the {n_rows} rows of poses that were visited several times alone say ({:.3}, {:.3}, {:.3}) mm",
                r.x, r.y, r.z
            )
        },
    );
    Warning::new(
        code,
        format!(
            "from the first row to the last one the measured points moved by ({:.3}, {:.3}, {:.3}) mm in the measuring frame, {:.3} mm long (standard deviation \
             {:.3} mm), {how}; {repeats}. Base or instrument drifted: let both warm up, fix them, and measure a pose again from time to time",
            v.x,
            v.y,
            v.z,
            v.norm(),
            drift.std_mm
        ),
    )
}
