//! Compensation: computes corrected targets for an identified robot.

use crate::calibration::{INSTRUMENT_SCALE, ORIENTATION_NOT_KNOWN};
use crate::compensation::{
    Anchor, Base, Compensation, Corrected, HeldReflector, Mode, Tool, ToolError, ToolGoal,
    ToolPoint, WorkFrame,
};
use crate::identification::KinematicModel;
use crate::identification::statistics::estimate::Estimate;
use crate::kinematics::{Link, Payload, Robot};
use crate::operations::work_frame::{fitting_work_frame, misfit_warning};
use crate::release::{orientation_unknown, wrong_robot};
use crate::wire::compensate::{
    CompensateAnswer, CompensateBody, ErrorFrame, LeftOut, OWN_FRAMES, ToolPose,
};
use crate::wire::issue::Invalid;
use crate::wire::measurement::{Frame, Warning};
use crate::wire::named_frame::{WorkFrameBody, WorkFrameReference};
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::predict::unknown_target;
use crate::wire::tool::ToolBody;
use nalgebra::{IsometryMatrix3, Translation3};

/// An identified robot, with the work frame and the tool that a request refers to by name.
#[derive(Clone, Copy, Debug)]
pub struct Correctable<'a> {
    /// The nominal robot.
    pub robot: &'a Robot,
    /// The parameter set.
    pub content: &'a ParameterSetContent,
    /// Provenance of the parameter set.
    pub provenance: &'a Provenance,
    /// The estimate of the parameter set, if its uncertainty is known.
    pub estimate: Option<&'a Estimate>,
    /// The measurement set that it was identified from; `None` for a parameter set from a document.
    pub measurement_set_id: Option<&'a str>,
    /// The work frame that the request refers to.
    pub work_frame: Option<&'a WorkFrameBody>,
    /// The stored tool that the request refers to.
    pub named_tool: Option<ToolBody>,
}

/// Corrects targets: with the joint values of the answer the identified robot reaches the targets.
///
/// # Errors
/// [`Invalid`] for targets that do not fit the robot, an invalid tool, a reflector that the set does not have, `base: measured` if the base was not
/// measured, a frame that cannot be used, and for mode `pose` or a tool if the flange's rotation is not known.
pub fn compensate(
    request: &CompensateBody,
    from: Correctable<'_>,
) -> Result<CompensateAnswer, Invalid> {
    let Correctable {
        robot,
        content,
        provenance,
        ..
    } = from;
    request.check(robot.links.len())?;
    let base = chosen_base(request, provenance)?;
    check_provenance(request, provenance, robot.links.len())?;
    let target = request.target.unwrap_or(0);
    let tool_body = request.tool.or(from.named_tool);
    if tool_body.is_none() && content.target_mm(target, None).is_none() {
        return Err(unknown_target());
    }
    let as_identified = content.identified_robot(None);
    let identified = as_identified
        .clone()
        .carrying(request.payload.map(Payload::from));
    let compensation = Compensation::of(robot, &identified, base);
    let tool = tool_body.map_or_else(
        || identified_tool(content, identified.model(), target),
        |tool| Tool::Tcp(IsometryMatrix3::from(tool)),
    );
    let point = ToolPoint::of(&tool, target, tool_body.and_then(|tool| tool.std_mm));
    let has_target = |estimate: &&Estimate| match point {
        ToolPoint::Target(target) => target < estimate.model.targets_mm.len(),
        ToolPoint::Tcp { .. } => true,
    };
    let error = from.estimate.filter(has_target);
    let error = error.map(|estimate| ToolError::new(robot, estimate, &as_identified, base, point));
    let mut answer = Answer::new(base, error.is_some());
    answer.document.left_out = left_out(compensation.anchor(), base, {
        let is_measured = provenance.measuring_frame == Some(Frame::Base);
        is_measured.then(|| identified.model().t_instrument_base)
    });
    answer.document.warnings = warnings(request, provenance, robot.links.len());
    let of_length = reflector_length(request, &identified.plain, &robot.links, base);
    answer.document.warnings.extend(of_length);
    let is_extrapolated = |q_rad: &[f64]| identified.is_extrapolated(&robot.q_model_rad(q_rad));
    for q_deg in &request.q_deg {
        let q_rad = in_radians(q_deg);
        let corrected = compensation.correct(&q_rad, &tool, request.mode);
        let std_mm = error
            .as_ref()
            .map(|error| error.std_mm(&corrected.q_controller_rad, ToolGoal::AsNominal(&q_rad)));
        let extrapolated = is_extrapolated(&corrected.q_controller_rad);
        answer.add(corrected, std_mm, extrapolated);
    }
    if request.targets.is_empty() {
        return Ok(answer.document);
    }
    let frame = TargetFrame::new(request, &from, &compensation, base)?;
    answer.document.warnings.extend(frame.doubt.clone());
    for target in &request.targets {
        let t_frame_tool = IsometryMatrix3::from(target);
        let t_base_tool = frame.t_base_frame * t_frame_tool;
        let q_near_rad = in_radians(&target.q_near_deg);
        let reached = compensation.reach(&t_base_tool, &q_near_rad, &tool, request.mode);
        let q_rad = &reached.corrected.q_controller_rad;
        let pose = frame.t_base_answer.inverse() * compensation.t_nominal_tool(q_rad, &tool);
        let std_mm = error.as_ref().map(|error| {
            let of_frame = frame.work_frame.as_ref().map_or(0.0, |work_frame| {
                work_frame.position_std_mm(&t_frame_tool.translation.vector)
            });
            error.std_mm(q_rad, ToolGoal::Fixed).hypot(of_frame)
        });
        let extrapolated = is_extrapolated(q_rad);
        answer.add_pose(ToolPose::from(&pose), reached.is_far);
        answer.add(reached.corrected, std_mm, extrapolated);
    }
    Ok(answer.with_poses())
}

/// The tool at an identified target. If only the position of the target is known, the tool has the flange's orientation.
fn identified_tool(
    content: &ParameterSetContent,
    identified: &KinematicModel,
    target: usize,
) -> Tool {
    let p_flange_target = identified.targets_mm[target];
    let mut of_target = content.targets.iter().filter(|of| of.target == target);
    let is_pose = of_target.any(|of| of.quaternion.is_some());
    match identified.target_rotations.get(target).filter(|_| is_pose) {
        Some(rotation) => Tool::TargetPose(IsometryMatrix3::from_parts(
            Translation3::from(p_flange_target),
            *rotation,
        )),
        None => Tool::Target(p_flange_target),
    }
}

/// The answer, to which the targets are added one by one.
struct Answer {
    document: CompensateAnswer,
    poses: Vec<ToolPose>,
    /// Targets whose solution is far from their `q_near_deg`.
    far: Vec<usize>,
}

impl Answer {
    fn new(base: Base, has_std: bool) -> Self {
        let document = CompensateAnswer {
            frame: ErrorFrame::from(base),
            position_std_mm: has_std.then(Vec::new),
            ..CompensateAnswer::default()
        };
        Self {
            document,
            poses: vec![],
            far: vec![],
        }
    }

    fn add_pose(&mut self, pose: ToolPose, is_far: bool) {
        if is_far {
            self.far.push(self.poses.len());
        }
        self.poses.push(pose);
    }

    fn with_poses(self) -> CompensateAnswer {
        let mut document = self.document;
        document.poses = Some(self.poses);
        if !self.far.is_empty() {
            document.warnings.push(Warning {
                code: "far_from_q_near".into(),
                detail: "a joint is more than 90° from q_near_deg in the nearest posture that was found: look at the way there, or give joint \
                         values nearer to the target"
                    .into(),
                rows: self.far,
                points: vec![],
            });
        }
        document
    }

    fn add(&mut self, corrected: Corrected, std_mm: Option<f64>, extrapolated: bool) {
        let answer = &mut self.document;
        let q_deg = corrected.q_controller_rad.iter();
        answer
            .q_deg
            .push(q_deg.map(|rad| rad.to_degrees()).collect());
        answer
            .position_error_before_mm
            .push(corrected.position_error_before_mm);
        answer
            .position_error_after_mm
            .push(corrected.position_error_after_mm);
        answer
            .orientation_error_after_deg
            .push(corrected.orientation_error_after_rad.to_degrees());
        answer.status.push(corrected.status);
        answer.extrapolated.push(extrapolated);
        if let (Some(all), Some(std_mm)) = (&mut answer.position_std_mm, std_mm) {
            all.push(std_mm);
        }
    }
}

/// The frame of Cartesian targets.
struct TargetFrame {
    /// Pose of the targets' frame in the frame in which the corrected targets are exact (see [`Base`]).
    t_base_frame: IsometryMatrix3<f64>,
    /// Pose of the frame of the poses in the answer, in the controller's base frame.
    t_base_answer: IsometryMatrix3<f64>,
    work_frame: Option<WorkFrame>,
    /// Warning about the points of a measured work frame.
    doubt: Option<Warning>,
}

impl TargetFrame {
    fn new(
        request: &CompensateBody,
        from: &Correctable<'_>,
        compensation: &Compensation<'_>,
        base: Base,
    ) -> Result<Self, Invalid> {
        let identity = IsometryMatrix3::identity();
        // Pose of the measuring frame in the frame in which the corrected targets are exact.
        let t_base_measuring = match base {
            Base::Measured => identity,
            Base::Robot => {
                let identified = from.content.identified_robot(None);
                let t_instrument_base = identified.model().t_instrument_base;
                (t_instrument_base * compensation.anchor().t_base_anchored).inverse()
            }
        };
        let name = request.frame.as_deref().unwrap_or(OWN_FRAMES[0]);
        let Some(body) = from.work_frame else {
            let [base_frame, measuring_frame] = OWN_FRAMES;
            if ![base_frame, measuring_frame].contains(&name) {
                let detail = format!(
                    "{name} is no frame here: take base or measuring; work frames are kept with a robot on the server"
                );
                return Err(Invalid::at("/frame", "unknown_frame", detail));
            }
            let t_base_frame = match name == measuring_frame {
                true => t_base_measuring,
                false => identity,
            };
            return Ok(Self {
                t_base_frame,
                t_base_answer: identity,
                work_frame: None,
                doubt: None,
            });
        };
        let work_frame = fitting_work_frame(body, "/frame")?;
        let doubt = misfit_warning(body, &work_frame);
        let is_measuring = body.reference == WorkFrameReference::Measuring;
        let is_own = body.measurement_set_id.as_deref() == from.measurement_set_id;
        if is_measuring && !is_own && from.provenance.measuring_frame != Some(Frame::Base) {
            let detail = format!(
                "{name} was measured in the measuring frame of another set than the one that this parameter set was identified from, and the \
                 instrument may have stood elsewhere: measure the frame's points with the calibration, or give the frame in the base frame"
            );
            return Err(Invalid::at("/frame", "other_measuring_frame", detail));
        }
        let t_base_reference = if is_measuring {
            t_base_measuring
        } else {
            identity
        };
        let t_base_work = t_base_reference * work_frame.t_reference_work;
        Ok(Self {
            t_base_frame: t_base_work,
            t_base_answer: t_base_work,
            work_frame: Some(work_frame),
            doubt,
        })
    }
}

fn in_radians(q_deg: &[f64]) -> Vec<f64> {
    q_deg.iter().map(|deg| deg.to_radians()).collect()
}

/// Warnings of the answer. For positions of the measured reflector the answer is valid even if the flange's rotation is not known, so only a warning
/// is needed.
fn warnings(request: &CompensateBody, provenance: &Provenance, n_links: usize) -> Vec<Warning> {
    if has_tool(request) || request.mode == Mode::Pose {
        return provenance.warnings.clone();
    }
    let scale = provenance
        .warnings
        .iter()
        .filter(|warning| warning.code == INSTRUMENT_SCALE);
    let told = orientation_unknown(provenance, n_links).map(|_| {
        let detail = "the place of the reflector on the flange is known no better than the rotation of the flange: the answer holds for the reflector as \
                 it was identified (`targets` of the parameter set). If the program's tool has it elsewhere, its position is off by the difference";
        Warning::new(ORIENTATION_NOT_KNOWN, detail)
    });
    told.into_iter().chain(scale.cloned()).collect()
}

/// Warning that positions do not show the length of a reflector that was held at the flange. It does not apply to Cartesian targets of the
/// reflector itself, which do not depend on the position of the flange.
fn reflector_length(
    request: &CompensateBody,
    identified: &KinematicModel,
    nominal: &[Link],
    base: Base,
) -> Option<Warning> {
    let is_of_flange = !request.q_deg.is_empty() || has_tool(request);
    if base == Base::Robot || !is_of_flange {
        return None;
    }
    let held = HeldReflector::of(identified, nominal)?;
    let (counts, otherwise) = match held.is_length {
        true => (
            "the reflector's length, because links are not off by so much",
            "the flange is off by the error of the link",
        ),
        false => (
            "an error of the link",
            "reflector and tools are off by that length if the reflector is ahead of the flange by it",
        ),
    };
    Some(Warning::new(
        "reflector_length",
        format!(
            "d of the last link is {:+.3} mm from nominal. The model holds the reflector at the flange's origin, so an error of this link cannot be \
             told from a reflector that is ahead of the flange. It counts as {counts}; {otherwise}. `position_std_mm` contains {:.3} mm for this: \
             measure how far the reflector's centre is from the flange",
            held.change_mm,
            held.flange_error_mm()
        ),
    ))
}

fn has_tool(request: &CompensateBody) -> bool {
    request.tool.is_some() || request.tool_name.is_some()
}

/// Refuses a parameter set that does not fit its own points. If the flange's rotation is not known, also refuses mode `pose` and other tools, because
/// only positions of the measured reflector can then be corrected.
fn check_provenance(
    request: &CompensateBody,
    provenance: &Provenance,
    n_links: usize,
) -> Result<(), Invalid> {
    if let Some((code, detail)) = wrong_robot(provenance) {
        let detail = format!("no target is corrected with this set: {detail}");
        return Err(Invalid::at("", code, detail));
    }
    if !has_tool(request) && request.mode == Mode::Position {
        return Ok(());
    }
    let pointer = match (request.tool, &request.tool_name) {
        (Some(_), _) => "/tool",
        (None, Some(_)) => "/tool_name",
        (None, None) => "/mode",
    };
    orientation_unknown(provenance, n_links).map_or(Ok(()), |why| {
        let detail = format!("{why}; mode position of a measured reflector is given all the same");
        Err(Invalid::at(pointer, ORIENTATION_NOT_KNOWN, detail))
    })
}

/// The requested base, or the default, which depends on the frame of the measured positions.
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

/// The identified errors that are not corrected. `t_nominal_base` is the pose of the identified base in the nominal base frame, if it is known.
fn left_out(anchor: &Anchor, base: Base, t_nominal_base: Option<IsometryMatrix3<f64>>) -> LeftOut {
    let flange = &anchor.t_anchored_flange;
    let base = match (base, t_nominal_base) {
        (Base::Measured, _) => IsometryMatrix3::identity(),
        (Base::Robot, Some(t_nominal_base)) => t_nominal_base * anchor.t_base_anchored,
        (Base::Robot, None) => anchor.t_base_anchored,
    };
    LeftOut {
        base_turn_deg: f64::to_degrees(base.rotation.angle()),
        base_shift_mm: base.translation.vector.norm(),
        flange_turn_deg: f64::to_degrees(flange.rotation.angle()),
        flange_shift_mm: flange.translation.vector.norm(),
    }
}
