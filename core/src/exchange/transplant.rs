//! Writes the identified kinematics into a chain with the user's own frames. Joints, axes and tip of the chain stay the same ones.

use crate::exchange::chain::{Axis, Chain, ChainJoint};
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::{Link, Robot};
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};

/// A chain describes the nominal robot if its axes are within this distance of the nominal ones. Descriptions are rounded.
const SAME_MM: f64 = 1.0;
/// As [`SAME_MM`], for the angle of axes: 0.1°.
const SAME_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// A chain is a corrected description and not the nominal one if its worst axis is nearer to the identified robot by this factor. Its
/// distance from the nominal robot must also exceed [`ROUNDING`].
const CORRECTED_TO_NOMINAL: f64 = 0.5;
/// Rounding of a description: 0.01 mm or 0.001°, as a share of [`SAME_MM`] and [`SAME_RAD`].
const ROUNDING: f64 = 0.01;
/// Below this sine the axes are parallel, and the position along their common direction is not determined.
const HELD: f64 = 1e-6;
/// Iteration limit of a singular value decomposition.
const SVD_ITERATIONS: usize = 1_000;

/// Why a chain does not describe the robot.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Mismatch {
    /// The number of moving joints is different.
    #[error("it has {found} joints that move between root and tip, the robot has {expected}")]
    JointCount {
        /// Number in the chain.
        found: usize,
        /// Number of the robot.
        expected: usize,
    },
    /// An axis is somewhere else.
    #[error(
        "the axis of joint {name:?} is {distance_mm:.3} mm and {angle_deg:.4}° from where the nominal robot has it, all joints at 0"
    )]
    Axis {
        /// The joint.
        name: String,
        /// Its distance, mm.
        distance_mm: f64,
        /// Its angle, degrees.
        angle_deg: f64,
    },
    /// The chain has already been corrected.
    #[error(
        "it is the identified robot's already, or that of an identification before: the axis of joint {name:?} is {distance_mm:.3} mm and \
         {angle_deg:.4}° from where the nominal robot has it, and nearer to the identified one; take the description that the robot came with"
    )]
    Corrected {
        /// The joint.
        name: String,
        /// Distance from the nominal axis, mm.
        distance_mm: f64,
        /// Angle from the nominal axis, degrees.
        angle_deg: f64,
    },
}

/// Relation of the chain's joint values to the model's: q_model = sign · q + offset.
struct Convention {
    sign: Vec<f64>,
    offset_rad: Vec<f64>,
}

/// The chain with new frames for its moving joints, so that it moves like the identified links. Fixed joints do not change. Each frame
/// keeps its place on its own link, up to the rounding of the description. The meaning of the joint values does not change: they are the
/// controller's values, or the model's if the chain uses those.
pub fn transplanted(
    chain: &Chain,
    nominal: &Robot,
    identified: &[Link],
) -> Result<Chain, Mismatch> {
    let (found, expected) = (chain.n_moving(), nominal.links.len());
    if found != expected {
        return Err(Mismatch::JointCount { found, expected });
    }
    let Some((convention, t_root_base, worst)) = best_alignment(chain, nominal) else {
        return Ok(chain.clone());
    };
    let (name, distance_mm, angle_rad) = &worst;
    if !(*distance_mm <= SAME_MM && *angle_rad <= SAME_RAD) {
        return Err(Mismatch::Axis {
            name: name.clone(),
            distance_mm: *distance_mm,
            angle_deg: angle_rad.to_degrees(),
        });
    }
    let corrected = Robot {
        links: identified.to_vec(),
        ..nominal.clone()
    };
    let nearer = best_alignment(chain, &corrected).is_some_and(|(.., of_corrected)| {
        misfit(&of_corrected) < CORRECTED_TO_NOMINAL * misfit(&worst)
    });
    if nearer && misfit(&worst) > ROUNDING {
        return Err(Mismatch::Corrected {
            name: name.clone(),
            distance_mm: *distance_mm,
            angle_deg: angle_rad.to_degrees(),
        });
    }
    Ok(moved(chain, nominal, identified, &convention, &t_root_base))
}

/// The nominal robot with the controller's joint values at 0: its axes and its flange in the base of its links. `None` if joints are coupled.
pub fn nominal_at_zero(nominal: &Robot) -> Option<(Vec<Axis>, IsometryMatrix3<f64>)> {
    let convention = controllers(nominal)?;
    let t_base_flange = *nominal_frames(nominal, &convention).last()?;
    Some((nominal_axes(nominal, &convention), t_base_flange))
}

/// As [`transplanted`], for a chain made for this robot, with the controller's joint values. `t_root_base` is the base of the links in the chain's
/// root. `None` if joints are coupled.
pub fn placed(
    chain: &Chain,
    nominal: &Robot,
    identified: &[Link],
    t_root_base: &IsometryMatrix3<f64>,
) -> Option<Chain> {
    let convention = controllers(nominal)?;
    Some(moved(chain, nominal, identified, &convention, t_root_base))
}

/// A joint, and the distance and angle of its axis from the robot's, mm and rad.
type OffAxis = (String, f64, f64);

/// Best fit of a robot to a chain: the joint convention, the base in the chain's root, and the worst axis.
fn best_alignment(
    chain: &Chain,
    robot: &Robot,
) -> Option<(Convention, IsometryMatrix3<f64>, OffAxis)> {
    let placed = conventions(robot).into_iter().map(|convention| {
        let t_root_base = place(chain, robot, &convention);
        let worst = worst_axis(chain, robot, &convention, &t_root_base);
        (convention, t_root_base, worst)
    });
    placed.min_by(|a, b| misfit(&a.2).total_cmp(&misfit(&b.2)))
}

/// The possible joint conventions of a chain: the controller's, if it is possible, and the model's.
fn conventions(nominal: &Robot) -> Vec<Convention> {
    let model = Convention::model(nominal.links.len());
    match (&nominal.joint_map, controllers(nominal)) {
        (Some(_), Some(controllers)) => vec![controllers, model],
        _ => vec![model],
    }
}

/// The controller's joint convention; `None` if joints are coupled.
fn controllers(nominal: &Robot) -> Option<Convention> {
    match &nominal.joint_map {
        None => Some(Convention::model(nominal.links.len())),
        Some(map) => map.coupling.is_identity(0.0).then(|| Convention {
            sign: map.sign.clone(),
            offset_rad: map.offset_rad.clone(),
        }),
    }
}

impl Convention {
    /// The model's own joint convention.
    fn model(n: usize) -> Self {
        Self {
            sign: vec![1.0; n],
            offset_rad: vec![0.0; n],
        }
    }
}

fn misfit((_, distance_mm, angle_rad): &OffAxis) -> f64 {
    (distance_mm / SAME_MM).max(angle_rad / SAME_RAD)
}

/// Frames 1..n of the nominal links with the chain's joints at 0.
fn nominal_frames(nominal: &Robot, convention: &Convention) -> Vec<IsometryMatrix3<f64>> {
    let mut t = IsometryMatrix3::identity();
    let frame = |(link, q): (&Link, &f64)| {
        t *= t_previous_link(link, *q);
        t
    };
    nominal
        .links
        .iter()
        .zip(&convention.offset_rad)
        .map(frame)
        .collect()
}

fn nominal_axes(nominal: &Robot, convention: &Convention) -> Vec<Axis> {
    let z = |t: &IsometryMatrix3<f64>| t.rotation * Vector3::z();
    let frames = nominal_frames(nominal, convention);
    frames
        .iter()
        .zip(&convention.sign)
        .map(|(t, sign)| Axis {
            point_mm: t.translation.vector,
            direction: z(t) * *sign,
        })
        .collect()
}

/// The base frame in the chain's root: the rigid motion from the nominal axes to the chain's (Kabsch 1976 for the directions, then least squares of
/// the distances between the lines).
fn place(chain: &Chain, nominal: &Robot, convention: &Convention) -> IsometryMatrix3<f64> {
    let (theirs, ours) = (chain.axes(), nominal_axes(nominal, convention));
    let mut correlation = Matrix3::zeros();
    for (a, b) in directions(&ours).into_iter().zip(directions(&theirs)) {
        correlation += b * a.transpose();
    }
    let rotation = correlation
        .try_svd(true, true, f64::EPSILON, SVD_ITERATIONS)
        .and_then(|svd| Some((svd.u?, svd.v_t?)));
    let rotation = rotation.map_or_else(Matrix3::identity, |(u, v_t)| {
        let hand = (u * v_t).determinant().signum();
        u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, hand)) * v_t
    });
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (ours, theirs) in ours.iter().zip(&theirs) {
        let across = Matrix3::identity() - theirs.direction * theirs.direction.transpose();
        normal += across;
        right += across * (theirs.point_mm - rotation * ours.point_mm);
    }
    let along = theirs[0].direction;
    if (normal * along).norm() < HELD {
        normal += along * along.transpose();
        right += along * along.dot(&(theirs[0].point_mm - rotation * ours[0].point_mm));
    }
    let translation = normal
        .try_inverse()
        .map_or_else(Vector3::zeros, |inverse| inverse * right);
    IsometryMatrix3::from_parts(
        Translation3::from(translation),
        Rotation3::from_matrix_unchecked(rotation),
    )
}

/// Directions that rotate with a set of axes: the axes themselves and, between parallel neighbours, the direction from one to the next.
fn directions(axes: &[Axis]) -> Vec<Vector3<f64>> {
    let mut all: Vec<Vector3<f64>> = axes.iter().map(|axis| axis.direction).collect();
    for pair in axes.windows(2) {
        let between = pair[1].point_mm - pair[0].point_mm;
        let across = between - pair[0].direction * between.dot(&pair[0].direction);
        let is_parallel = pair[0].direction.cross(&pair[1].direction).norm() < SAME_RAD;
        all.push(if is_parallel && across.norm() > SAME_MM {
            across.normalize()
        } else {
            Vector3::zeros()
        });
    }
    all
}

/// The joint whose axis is furthest from the nominal one: name, mm, rad.
fn worst_axis(
    chain: &Chain,
    nominal: &Robot,
    convention: &Convention,
    t_root_base: &IsometryMatrix3<f64>,
) -> OffAxis {
    let names = chain
        .joints
        .iter()
        .filter(|joint| joint.axis.is_some())
        .map(|joint| joint.name.clone());
    let lines = chain
        .axes()
        .into_iter()
        .zip(nominal_axes(nominal, convention));
    let off = |(name, (theirs, ours)): (String, (Axis, Axis))| {
        let direction = t_root_base.rotation * ours.direction;
        let between =
            theirs.point_mm - (t_root_base * nalgebra::Point3::from(ours.point_mm)).coords;
        let distance = (between - theirs.direction * between.dot(&theirs.direction)).norm();
        (
            name,
            distance,
            libm::atan2(
                direction.cross(&theirs.direction).norm(),
                direction.dot(&theirs.direction),
            ),
        )
    };
    let all = names.zip(lines).map(off);
    all.max_by(|a, b| misfit(a).total_cmp(&misfit(b)))
        .unwrap_or_else(|| (String::new(), 0.0, 0.0))
}

/// With U_i the chain's frame i and F_i the nominal one, U_i = X·F_i·G_i, where G_i keeps the axis: Rz(s·q)·G_i = G_i·Rot(axis, q). Then X·F'_i·G_i
/// moves as the identified frames F'_i do. Each joint's origin is the transform from one such frame to the next.
fn moved(
    chain: &Chain,
    nominal: &Robot,
    identified: &[Link],
    convention: &Convention,
    t_root_base: &IsometryMatrix3<f64>,
) -> Chain {
    let nominal_frames = nominal_frames(nominal, convention);
    let frames = chain.frames(&vec![0.0; identified.len()]);
    let mut joints: Vec<ChainJoint> = Vec::with_capacity(chain.joints.len());
    let mut i = 0;
    // The frame before the next moving joint, in frame i of the links.
    let mut from_link = t_root_base.inverse();
    for (joint, t_root_joint) in chain.joints.iter().zip(&frames) {
        let Some(axis) = &joint.axis else {
            from_link *= joint.t_parent_joint;
            joints.push(joint.clone());
            continue;
        };
        let seen = (t_root_base * nominal_frames[i]).inverse() * t_root_joint;
        let on_link = keeping_axis(&seen, axis, convention.sign[i]);
        let t_parent_joint = from_link.inverse()
            * t_previous_link(&identified[i], convention.offset_rad[i])
            * on_link;
        joints.push(ChainJoint {
            t_parent_joint,
            ..joint.clone()
        });
        from_link = on_link;
        i += 1;
    }
    Chain { joints }
}

/// The pose closest to `seen` that maps `axis` to ±z exactly: Dz(h)·Rz(φ)·R0 with R0·axis = sign·z.
fn keeping_axis(
    seen: &IsometryMatrix3<f64>,
    axis: &Vector3<f64>,
    sign: f64,
) -> IsometryMatrix3<f64> {
    let z = axis * sign;
    let other = if z.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let x = (other - z * other.dot(&z)).normalize();
    let to_z = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
    let turn = seen.rotation.matrix() * to_z.transpose();
    let angle = libm::atan2(turn[(1, 0)] - turn[(0, 1)], turn[(0, 0)] + turn[(1, 1)]);
    let about_z = Link {
        theta_offset_rad: angle,
        d_mm: seen.translation.vector.z,
        ..Link::default()
    };
    t_previous_link(&about_z, 0.0)
        * IsometryMatrix3::from_parts(
            Translation3::identity(),
            Rotation3::from_matrix_unchecked(to_z),
        )
}
