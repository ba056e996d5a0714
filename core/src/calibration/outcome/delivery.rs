//! The identified robot in the form in which it is delivered. With sweeps, the fit merges z_t into d of the last link; this file separates
//! them again.

use crate::calibration::problem::Problem;
use crate::calibration::request::Model;
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::CorrectedModel;
use crate::measurement::Frame;
use nalgebra::IsometryMatrix3;

/// Links, base and targets as delivered. With sweeps, z_t is removed from d of the last link and becomes the target.
pub fn as_delivered(problem: &Problem<'_>, model: &KinematicModel) -> KinematicModel {
    let delivered = delivered(problem, model);
    KinematicModel {
        t_instrument_base: base_as_delivered(problem, &delivered.t_instrument_base),
        ..delivered
    }
}

/// As [`as_delivered`], for the links and the base of a robot with corrections.
pub fn corrected_as_delivered(problem: &Problem<'_>, corrected: &CorrectedModel) -> CorrectedModel {
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

/// The model with z_t of the sweeps moved from the last link to the targets, in the frame of the fit. Predicted positions do not change.
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
