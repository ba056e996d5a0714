//! What the measured positions do not determine about the flange. The identified robot predicts the measured reflector correctly in any
//! case. With another tool, or for rotations of the flange, it may be wrong.

use crate::calibration::problem::Problem;
use crate::calibration::report::{FlangeRotation, Warning};
use crate::compensation::anchor;
use crate::identification::KinematicModel;
use crate::identification::model::parameters::{Parameter, apply};
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::identification::statistics::workspace::random_configurations;
use crate::kinematics::rotation::rotation_log;
use crate::kinematics::{Robot, reach_mm, t_base_flange};
use nalgebra::DMatrix;

/// Number of configurations that represent the workspace.
pub const N_CONFIGURATIONS: usize = 64;
/// Smaller shifts of the flange are rounding, as a share of the reach: 1 µm on an arm of 1.7 m. They come from redundant parameters of the
/// model, such as d of links with parallel axes.
const NOTICED_PER_REACH: f64 = 1e-3 / 1700.0;
/// Smaller rotations of the flange are rounding, as for [`NOTICED_PER_REACH`]; 0.001°.
const NOTICED_RAD: f64 = 1e-3 * std::f64::consts::PI / 180.0;
/// Share of a scale at which unobservable directions are evaluated, see [`unseen`].
const FIRST_ORDER: f64 = 1e-3;
/// Distance between the reflector and the tool point for which the warning is decided, as a share of the reach (100 mm of 1.7 m).
const TOOL_PER_REACH: f64 = 100.0 / 1700.0;
/// The warning is given if the uncertainty of this tool point exceeds this multiple of the scatter of the points.
const MIN_TIMES_SCATTER: f64 = 5.0;
/// Unobservable directions that move this tool point by less than this share of the scatter do not matter.
const NEGLIGIBLE_SHARE: f64 = 0.1;
/// Limit of the first-order standard deviations. A rotation above it (20°) only means that the rotation is unknown.
const SMALL_TURN_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Uncertainty of the identified robot's flange, one standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AtFlange {
    /// Shift of its origin, mm.
    pub shift_mm: f64,
    /// Rotation, rad.
    pub turn_rad: f64,
}

/// The warning, if unobservable or poorly determined parameters move the flange on its anchored base (see [`anchor`]), or if the points do not show
/// the direction of the last joint. `scatter_mm` is the rms length of the residuals. `with_priors` is the uncertainty of the flange's rotation that
/// includes prior knowledge of robots.
pub fn warning(
    problem: &Problem<'_>,
    model: &KinematicModel,
    uncertainty: Option<&Uncertainty>,
    scatter_mm: f64,
    with_priors: Option<FlangeRotation>,
    may_be_reversed: bool,
) -> Option<Warning> {
    let flange = |roots: &[&DMatrix<f64>]| {
        at_flange(&problem.request.robot, model, &problem.parameters, roots)
    };
    let all = match uncertainty {
        Some(found) => flange(&[&found.of_parameters()]),
        None => unseen(problem, model),
    };
    let reach_mm = reach_mm(&problem.request.robot.links);
    let is_seen = match uncertainty {
        Some(_) => TOOL_PER_REACH * reach_mm * all.turn_rad < MIN_TIMES_SCATTER * scatter_mm,
        None => {
            let tool_mm = all.shift_mm + TOOL_PER_REACH * reach_mm * all.turn_rad;
            let is_rounding =
                all.shift_mm < NOTICED_PER_REACH * reach_mm && all.turn_rad < NOTICED_RAD;
            is_rounding || tool_mm < NEGLIGIBLE_SHARE * scatter_mm
        }
    };
    if is_seen && !may_be_reversed {
        return None;
    }
    let reversed = match may_be_reversed {
        true => format!(
            " They fit as well with joint {} counted the other way round: turn it at the controller and compare the nominal robot before a pose is \
             corrected.",
            problem.request.robot.links.len()
        ),
        false => String::new(),
    };
    let by_positions = match all.turn_rad < SMALL_TURN_RAD {
        true => format!(
            "it may be turned by {:.3}° and shifted by {:.3} mm from where the identified robot has it (one standard deviation; what they do not show at \
             all counts as off by 1 mm or 0.3°)",
            all.turn_rad.to_degrees(),
            all.shift_mm
        ),
        false => "it may be turned and shifted by any amount".into(),
    };
    let with_priors = with_priors.map_or_else(String::new, |known| {
        format!(
            ", and with what is known of robots beforehand by {:.2}° (flange_rotation_std_deg)",
            known.std_rad().to_degrees()
        )
    });
    let detail = format!(
        "the measured positions hardly show how the flange stands: by them alone {by_positions}{with_priors}. The measured reflector is right all the same; \
         corrected poses, and another tool than that reflector, need not be. Measure a reflector off the last axis, or two, at poses that move every \
         joint.{reversed}"
    );
    Some(Warning::new("pose_not_seen", detail))
}

/// First-order effect of the directions that the points do not determine at all. For poses these directions also rotate base and target,
/// and second-order terms would be visible at a whole scale. The directions are therefore evaluated at a small share of a scale.
fn unseen(problem: &Problem<'_>, model: &KinematicModel) -> AtFlange {
    let share = match problem.request.set.has_poses() {
        true => FIRST_ORDER,
        false => 1.0,
    };
    let directions = problem.decomposition.unobservable_directions() * share;
    let robot = &problem.request.robot;
    let found = at_flange(robot, model, &problem.parameters, &[&directions]);
    AtFlange {
        shift_mm: found.shift_mm / share,
        turn_rad: found.turn_rad / share,
    }
}

/// Effect of parameter deviations on the anchored flange. Each column of `roots` is a deviation of one standard deviation. The result is the root of
/// the sum of squares over the columns: root mean square over random configurations of the joint space.
pub fn at_flange(
    robot: &Robot,
    model: &KinematicModel,
    parameters: &[Parameter],
    roots: &[&DMatrix<f64>],
) -> AtFlange {
    let (mut shift_mm2, mut turn_rad2) = (0.0, 0.0);
    let configurations = random_configurations(robot, N_CONFIGURATIONS, 0);
    let here = anchor(&model.links, &robot.links);
    for deviation in roots.iter().flat_map(|root| root.column_iter()) {
        let deviation: Vec<f64> = deviation.iter().copied().collect();
        let moved = apply(model, parameters, &deviation);
        let there = anchor(&moved.links, &robot.links);
        for q_controller_rad in &configurations {
            let q_rad = robot.q_model_rad(q_controller_rad);
            let (a, b) = (
                here.anchored(&t_base_flange(&model.links, &q_rad)),
                there.anchored(&t_base_flange(&moved.links, &q_rad)),
            );
            shift_mm2 += (b.translation.vector - a.translation.vector).norm_squared();
            turn_rad2 += rotation_log(&(b.rotation * a.rotation.inverse())).norm_squared();
        }
    }
    let n = N_CONFIGURATIONS as f64;
    AtFlange {
        shift_mm: (shift_mm2 / n).sqrt(),
        turn_rad: (turn_rad2 / n).sqrt(),
    }
}
