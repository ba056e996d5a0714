//! Predicts target positions with an identified robot.

use crate::identification::statistics::estimate::Estimate;
use crate::kinematics::{Payload, Robot};
use crate::wire::issue::Invalid;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::predict::{PredictAnswer, PredictBody, unknown_target};

/// Predicts the positions of a target with the joint map, the identified links, the corrections and the pose of the base in the measuring
/// frame. With an estimate, also the uncertainty of the positions, including that of the corrections.
///
/// # Errors
/// [`Invalid`] for poses that do not fit the robot, or a target that the set does not have.
pub fn predict(
    request: &PredictBody,
    robot: &Robot,
    content: &ParameterSetContent,
    estimate: Option<&Estimate>,
) -> Result<PredictAnswer, Invalid> {
    request.check(robot.links.len())?;
    if content.target_mm(request.target, request.segment).is_none() {
        return Err(unknown_target());
    }
    let identified = content
        .identified_robot(request.segment)
        .carrying(request.payload.map(Payload::from));
    let estimate = estimate.filter(|e| request.target < e.model.targets_mm.len());
    let std_mm = |estimate: &Estimate, q_deg: &Vec<f64>| {
        let q_rad: Vec<f64> = q_deg.iter().map(|deg| deg.to_radians()).collect();
        estimate.predicted_std_mm(&identified, &robot.q_model_rad(&q_rad), request.target)
    };
    let predicted = |q_deg: &Vec<f64>| -> ([f64; 3], bool) {
        let q_rad: Vec<f64> = q_deg.iter().map(|deg| deg.to_radians()).collect();
        let q_rad = robot.q_model_rad(&q_rad);
        (
            identified.position(&q_rad, request.target).into(),
            identified.is_extrapolated(&q_rad),
        )
    };
    let (position_mm, extrapolated) = request.q_deg.iter().map(predicted).unzip();
    Ok(PredictAnswer {
        warnings: vec![],
        position_mm,
        extrapolated,
        position_std_mm: estimate
            .map(|estimate| request.q_deg.iter().map(|q| std_mm(estimate, q)).collect()),
    })
}
