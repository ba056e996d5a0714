//! Placement of a robot with given links: base and targets are fitted where the request leaves them unknown.

use crate::calibration::request::{CalibrationRequest, Model};
use crate::identification::KinematicModel;
use crate::identification::least_squares::start::{fit_base_and_targets, fit_targets};
use crate::identification::model::objective::Observation;
use crate::kinematics::Link;
use crate::measurement::Frame;

/// The nominal robot in the frame of the fit. With sweeps, z_t is merged into d of the last link [Gao 2018, section 2.2].
pub fn nominal_model(
    request: &CalibrationRequest,
    identify: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    let mut links = request.robot.links.clone();
    let frames = request.frames.as_ref();
    if let (Model::Paper, Some(frames), Some(last)) = (request.model(), frames, links.last_mut()) {
        last.d_mm += frames.z_tool_mm;
    }
    let counting: Vec<Observation> = identify
        .iter()
        .filter(|o| o.weight > 0.0)
        .cloned()
        .collect();
    placed(request, links, &counting, n_targets)
}

/// A robot with these links. Base and targets are fitted where the request's model and frame leave them unknown.
pub fn placed(
    request: &CalibrationRequest,
    links: Vec<Link>,
    observations: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    match (request.model(), request.set.frame) {
        (Model::Paper, _) => KinematicModel::nominal(&links, n_targets),
        (Model::Complete, Frame::Base) => fit_targets(&links, observations, n_targets),
        (Model::Complete, Frame::Instrument) => {
            fit_base_and_targets(&links, observations, n_targets)
        }
    }
}
