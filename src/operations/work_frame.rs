//! Named work frames: their pose, and whether their points fit.

use crate::compensation::{FixtureDoubt, FixtureMisfit, FixturePoint, WorkFrame, WorkFrameError};
use crate::measurement::{Frame, MeasurementSet};
use crate::wire::frames::Transform;
use crate::wire::issue::Invalid;
use crate::wire::named_frame::{WorkFrameAnswer, WorkFrameBody};
use crate::wire::tool::rotation;
use crate::wire::warning::Warning;
use nalgebra::{IsometryMatrix3, Translation3, Vector3};
use std::collections::BTreeSet;

/// Checks the body and computes the work frame.
///
/// # Errors
/// [`Invalid`] for values out of range, and for points that give no frame.
fn work_frame(body: &WorkFrameBody) -> Result<WorkFrame, Invalid> {
    body.check()?;
    if body.points.is_none() {
        let origin = Vector3::from(body.translation_mm.unwrap_or_default());
        return Ok(WorkFrame::typed(IsometryMatrix3::from_parts(
            Translation3::from(origin),
            rotation(body.quaternion, body.rotation),
        )));
    }
    let std_mm = body.std_mm.unwrap_or(0.0);
    WorkFrame::measured(&fixture_points(body), std_mm).map_err(|unfit: WorkFrameError| {
        Invalid::at("/points", "points_give_no_frame", unfit.to_string())
    })
}

/// The work frame. Refuses points that do not fit, at `pointer`. Frames that were stored before this check can still be listed.
///
/// # Errors
/// [`Invalid`] for values out of range, and for points that give no frame or do not fit.
pub fn fitting_work_frame(body: &WorkFrameBody, pointer: &str) -> Result<WorkFrame, Invalid> {
    let frame = work_frame(body)?;
    let std_mm = body.std_mm.unwrap_or(0.0);
    match FixtureMisfit::of(&fixture_points(body), &frame, std_mm) {
        Some(misfit) => {
            let code = "work_frame_does_not_fit";
            Err(Invalid::at(pointer, code, misfit.to_string()))
        }
        None => Ok(frame),
    }
}

/// The warning about a frame whose points do not fit well; `None` if they fit, and for a frame whose pose was entered.
pub(super) fn misfit_warning(body: &WorkFrameBody, frame: &WorkFrame) -> Option<Warning> {
    body.points.as_ref()?;
    let std_mm = body.std_mm.unwrap_or(0.0);
    let doubt = FixtureDoubt::of(&fixture_points(body), frame, std_mm)?;
    Some(Warning {
        code: doubt.code().into(),
        detail: doubt.to_string(),
        rows: doubt.points(),
        points: vec![],
    })
}

/// Refuses a new work frame that cannot be used: its points do not fit, or `std_mm` is given for a frame whose pose was entered. The stated
/// uncertainties of targets would not include that `std_mm`. Frames that were stored before this check stay usable.
///
/// # Errors
/// As [`fitting_work_frame`], and [`Invalid`] for that `std_mm`.
pub fn check_new_work_frame(body: &WorkFrameBody) -> Result<(), Invalid> {
    fitting_work_frame(body, "/points")?;
    if body.points.is_some() || body.std_mm.is_none() {
        return Ok(());
    }
    let detail = "std_mm is the uncertainty of measured points, and this frame is typed. Stated uncertainties of targets take a typed frame as \
                  exact: remove it";
    Err(Invalid::at("/std_mm", "mixed_kinds", detail))
}

/// Checks that the numbers of a work frame are in the measuring frame of parameters that are identified from the set. For a set with several stations,
/// this is the frame of the last station. In the base frame it is that of the first station.
///
/// # Errors
/// [`Invalid`] if the set has several stations and the body states another station or none.
pub fn check_station(body: &WorkFrameBody, set: &MeasurementSet) -> Result<(), Invalid> {
    let order = set.measuring_order();
    let stations = order.iter();
    let stations: Vec<&str> = stations
        .filter_map(|row| set.points[*row].station.as_deref())
        .collect();
    let of_parameters = match set.frame {
        Frame::Instrument => stations.last(),
        Frame::Base => stations.first(),
    };
    let stated = body.station.as_deref();
    let Some(of_parameters) = of_parameters else {
        return match stated {
            Some(_) => Err(Invalid::at(
                "/station",
                "not_applicable",
                "the set has no stations: remove it",
            )),
            None => Ok(()),
        };
    };
    let all: BTreeSet<&str> = stations.iter().copied().collect();
    if stated == Some(*of_parameters) || stated.is_none() && all.len() == 1 {
        return Ok(());
    }
    let detail = format!(
        "the set has the stations {}, and parameters identified from it are in the frame of {of_parameters}: measure the work frame from there, and say \
         so with station: {of_parameters:?}",
        all.into_iter().collect::<Vec<_>>().join(", ")
    );
    Err(Invalid::at("/station", "other_station", detail))
}

fn fixture_points(body: &WorkFrameBody) -> Vec<FixturePoint> {
    body.points.iter().flatten().map(Into::into).collect()
}

/// The answer for a stored work frame.
///
/// # Errors
/// [`Invalid`] for values out of range, and for points that give no frame.
pub fn work_frame_answer(
    body: WorkFrameBody,
    name: String,
    created_at: String,
) -> Result<WorkFrameAnswer, Invalid> {
    let frame = work_frame(&body)?;
    let is_measured = !frame.residuals_mm.is_empty();
    Ok(WorkFrameAnswer {
        name,
        reference: body.reference,
        t_reference_work: Transform::from(&frame.t_reference_work),
        rms_mm: is_measured.then(|| frame.rms_mm()),
        origin_std_mm: is_measured.then(|| frame.position_std_mm(&Vector3::zeros())),
        warnings: misfit_warning(&body, &frame).into_iter().collect(),
        measurement_set_id: body.measurement_set_id,
        residuals_mm: frame.residuals_mm,
        created_at,
    })
}
