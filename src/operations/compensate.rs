//! Corrects joint targets.

use crate::calibration::ORIENTATION_NOT_KNOWN;
use crate::compensation::{Anchor, Base, Compensation, Mode, Tool};
use crate::kinematics::{Payload, Robot};
use crate::release::{orientation_unknown, wrong_robot};
use crate::wire::angle::{to_degrees, to_radians};
use crate::wire::compensate::{CompensateAnswer, CompensateBody, ErrorFrame, LeftOut};
use crate::wire::issue::Invalid;
use crate::wire::measurement::{Frame, Warning};
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::predict::unknown_target;
use nalgebra::IsometryMatrix3;

/// Corrects targets: with the answered joint values the identified robot reaches them.
///
/// # Errors
/// [`Invalid`] for joint values that do not fit the robot, an invalid tool, a target that the set does not have, `base: measured` although the
/// base was not measured, or a pose or tool although the flange's rotation is unknown.
pub fn compensate(
    request: &CompensateBody,
    robot: &Robot,
    content: &ParameterSetContent,
    provenance: &Provenance,
) -> Result<CompensateAnswer, Invalid> {
    request.check(robot.links.len())?;
    let base = chosen_base(request, provenance)?;
    check_provenance(request, provenance, robot.links.len())?;
    let target = request.target.unwrap_or(0);
    if request.tool.is_none() && content.target_mm(target, None).is_none() {
        return Err(unknown_target());
    }
    let identified = content
        .identified_robot(None)
        .carrying(request.payload.map(Payload::from));
    let compensation = Compensation::of(robot, &identified, base);
    let tool = request.tool.map_or_else(
        || Tool::Target(identified.target_mm(target)),
        |tool| Tool::Tcp(IsometryMatrix3::from(tool)),
    );
    let mut answer = CompensateAnswer::with_capacity(request.q_deg.len(), ErrorFrame::from(base));
    let t_nominal_base = (provenance.measuring_frame == Some(Frame::Base))
        .then(|| identified.model().t_instrument_base);
    answer.left_out = left_out(compensation.anchor(), base, t_nominal_base);
    // Positions of the measured reflector are right even if the flange's rotation is unknown.
    if request.tool.is_some() || request.mode == Mode::Pose {
        answer.warnings = provenance.warnings.clone();
    } else if orientation_unknown(provenance, robot.links.len()).is_some() {
        let detail = "the place of the reflector on the flange is known no better than the rotation of the flange: the answer holds for the \
                      reflector as it was identified (`targets` of the parameter set). If the program's tool has it elsewhere, its position is off \
                      by the difference";
        answer.warnings.push(Warning {
            code: ORIENTATION_NOT_KNOWN.into(),
            detail: detail.into(),
            rows: vec![],
        });
    }
    for q_deg in &request.q_deg {
        let q_rad: Vec<f64> = q_deg.iter().map(|deg| to_radians(*deg)).collect();
        let corrected = compensation.correct(&q_rad, &tool, request.mode);
        answer.q_deg.push(
            corrected
                .q_controller_rad
                .iter()
                .map(|rad| to_degrees(*rad))
                .collect(),
        );
        answer
            .position_error_before_mm
            .push(corrected.position_error_before_mm);
        answer
            .position_error_after_mm
            .push(corrected.position_error_after_mm);
        answer
            .orientation_error_after_deg
            .push(to_degrees(corrected.orientation_error_after_rad));
        answer.status.push(corrected.status);
        answer
            .extrapolated
            .push(identified.is_extrapolated(&robot.q_model_rad(&corrected.q_controller_rad)));
    }
    Ok(answer)
}

/// Refuses a set that does not fit its own points. If the flange's rotation is unknown, only positions of the measured reflector can be
/// corrected: refuses poses and other tools.
fn check_provenance(
    request: &CompensateBody,
    provenance: &Provenance,
    n_links: usize,
) -> Result<(), Invalid> {
    if let Some((code, detail)) = wrong_robot(provenance) {
        let detail = format!("no target is corrected with this set: {detail}");
        return Err(Invalid::at("", code, detail));
    }
    if request.tool.is_none() && request.mode == Mode::Position {
        return Ok(());
    }
    let pointer = if request.tool.is_some() {
        "/tool"
    } else {
        "/mode"
    };
    orientation_unknown(provenance, n_links).map_or(Ok(()), |why| {
        let detail = format!("{why}; mode position of a measured reflector is given all the same");
        Err(Invalid::at(pointer, ORIENTATION_NOT_KNOWN, detail))
    })
}

/// Requested base, or the default for the frame of the measured positions.
fn chosen_base(request: &CompensateBody, provenance: &Provenance) -> Result<Base, Invalid> {
    let is_measured = provenance.measuring_frame == Some(Frame::Base);
    match request.base {
        Some(Base::Robot) => Ok(Base::Robot),
        Some(Base::Measured) if !is_measured => Err(Invalid::at(
            "/base",
            "base_not_measured",
            "the positions of this set were not measured in the base frame, so that nothing is known of where the nominal base is in it: \
             take base robot, or identify from positions in the base frame",
        )),
        None if !is_measured => Ok(Base::Robot),
        Some(Base::Measured) | None => Ok(Base::Measured),
    }
}

/// `t_nominal_base`: the base of the identified links in the nominal base frame, if it is known.
fn left_out(anchor: &Anchor, base: Base, t_nominal_base: Option<IsometryMatrix3<f64>>) -> LeftOut {
    let flange = &anchor.t_anchored_flange;
    let base = match (base, t_nominal_base) {
        (Base::Measured, _) => IsometryMatrix3::identity(),
        (Base::Robot, Some(t_nominal_base)) => t_nominal_base * anchor.t_base_anchored,
        (Base::Robot, None) => anchor.t_base_anchored,
    };
    LeftOut {
        base_turn_deg: to_degrees(base.rotation.angle()),
        base_shift_mm: base.translation.vector.norm(),
        flange_turn_deg: to_degrees(flange.rotation.angle()),
        flange_shift_mm: flange.translation.vector.norm(),
    }
}
