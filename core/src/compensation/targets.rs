//! Corrected joint targets: Gauss-Newton on the identified robot, damped along directions in which it hardly moves, and within joint limits.

use crate::compensation::anchor::{Anchor, anchor, anchor_in, contains_tool};
use crate::compensation::mode::{Base, Mode, Status};
use crate::identification::KinematicModel;
use crate::identification::corrections::corrected::{CorrectedModel, IdentifiedRobot};
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::model::MAX_LINKS;
use crate::kinematics::rotation::{between, rotation_log};
use crate::kinematics::{Link, Robot, reach_mm, t_base_flange};
use nalgebra::{
    DMatrix, IsometryMatrix3, Matrix6, Point3, Rotation3, SMatrix, SVector, Translation3, Vector3,
    Vector6,
};

/// A rotation of the tool counts as the displacement that it causes at this distance, as a share of the reach: 0.5 m on an arm of 2.5 m.
const LEVER_PER_REACH: f64 = 0.2;
/// Directions in which the tool moves by less than this share of the reach per rad of joint motion are damped. This is so within about 1.6°
/// of a wrist's singularity. On an arm of 2.5 m, such directions can amplify an error of 1 mm into more than 6° of joint motion.
const SINGULAR: f64 = 4e-3;
/// Damping if the tool does not move at all, as a share of the reach per rad.
const MAX_DAMPING: f64 = 4e-3;
/// Maximum change of a joint, in addition to the largest identified joint offset: 10°.
const MAX_CHANGE_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// A target is reached if the remaining error is at most this share of the reach (1 µm on an arm of 2.5 m) and 0.0001°.
const TOLERANCE_PER_REACH: f64 = 4e-7;
/// See [`TOLERANCE_PER_REACH`].
const REACHED_RAD: f64 = 1e-4 * std::f64::consts::PI / 180.0;
/// A target with an error above this share of the reach is not reached, even if the arm is stretched and therefore singular.
const OUT_OF_REACH: f64 = 0.01;
/// The iteration ends when all joint steps are below this.
const STEP_RAD: f64 = 1e-12;
/// Maximum number of steps; away from singularities four are enough.
const MAX_STEPS: usize = 40;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 1_000;

/// ∂(tool)/∂(controller's joint values): displacement as a share of the reach, then rotation times [`LEVER_PER_REACH`], per rad. Columns beyond the last joint
/// are 0.
type Jacobian = SMatrix<f64, 6, MAX_LINKS>;
type Joints = SVector<f64, MAX_LINKS>;

/// The tool whose position is corrected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tool {
    /// An identified target: its offset in the flange frame of the identified links (of those with corrections, if there are some), mm.
    Target(Vector3<f64>),
    /// An identified target that was measured as a pose: its pose in the same flange frame, mm.
    TargetPose(IsometryMatrix3<f64>),
    /// The tool centre point in the controller: its pose in the nominal flange frame, mm.
    Tcp(IsometryMatrix3<f64>),
}

/// One corrected target.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrected {
    /// The controller's joint values, rad.
    pub q_controller_rad: Vec<f64>,
    /// Distance of the tool from its position on the nominal robot, with the original joint values, mm.
    pub position_error_before_mm: f64,
    /// The same distance with the corrected joint values, mm.
    pub position_error_after_mm: f64,
    /// Angle between the tool and its orientation on the nominal robot, with the corrected joint values, rad.
    pub orientation_error_after_rad: f64,
    /// Result of the correction.
    pub status: Status,
}

/// A nominal robot and its identified links.
#[derive(Clone, Debug)]
pub struct Compensation<'a> {
    pub(super) nominal: &'a Robot,
    /// The links for the Jacobian, and their anchor. With corrections, they are the links that were identified together with the corrections.
    links: &'a [Link],
    anchor: Anchor,
    /// With corrections: the robot, and the anchor of its links alone. Outside the measured region, the corrections are blended into the
    /// links alone.
    fading: Option<(&'a IdentifiedRobot, Anchor)>,
    joint_rates: DMatrix<f64>,
    max_change_rad: f64,
    /// The unit of lengths in the Jacobian.
    reach_mm: f64,
}

/// The pose for the tool, and the initial joint values.
struct Goal<'g> {
    q_rad: &'g [f64],
    t_base_tool: IsometryMatrix3<f64>,
    t_flange_tool: IsometryMatrix3<f64>,
    mode: Mode,
}

/// The tool's error at some joint values.
struct PoseError {
    translation_mm: Vector3<f64>,
    rotation_rad: Vector3<f64>,
    reach_mm: f64,
}

impl<'a> Compensation<'a> {
    /// Prepares the correction of targets of `nominal`, whose identified links are `identified`, in the robot's own base frame.
    pub fn new(nominal: &'a Robot, identified: &'a [Link]) -> Self {
        Self::anchored(nominal, identified, anchor(identified, &nominal.links))
    }

    fn anchored(nominal: &'a Robot, identified: &'a [Link], anchor: Anchor) -> Self {
        let offset = |(a, b): (&Link, &Link)| (a.theta_offset_rad - b.theta_offset_rad).abs();
        let inner = 1..identified.len().saturating_sub(1).max(1);
        let worst = identified[inner.clone()]
            .iter()
            .zip(&nominal.links[inner])
            .map(offset)
            .fold(0.0, f64::max);
        Self {
            nominal,
            links: identified,
            anchor,
            fading: None,
            joint_rates: nominal.joint_rates(),
            max_change_rad: MAX_CHANGE_RAD + worst,
            reach_mm: reach_mm(&nominal.links).max(f64::MIN_POSITIVE),
        }
    }

    /// As [`Self::new`], in the given frame, with the corrections of the identified robot if it has some.
    pub fn of(nominal: &'a Robot, identified: &'a IdentifiedRobot, base: Base) -> Self {
        // Decided once, so that the blending has no jump.
        let has_tool = contains_tool(&identified.plain.links, &nominal.links);
        let anchor_of = |model: &KinematicModel| anchor_in(base, model, &nominal.links, has_tool);
        let (model, fading) = match &identified.corrected {
            None => (&identified.plain, None),
            Some(corrected) => (
                &corrected.model,
                Some((identified, anchor_of(&identified.plain))),
            ),
        };
        let mut compensation = Self::anchored(nominal, &model.links, anchor_of(model));
        compensation.fading = fading;
        if base == Base::Measured {
            // Joint 1 compensates a rotated base.
            let t_measuring_base =
                model.t_instrument_base * anchor(&model.links, &nominal.links).t_base_anchored;
            compensation.max_change_rad += t_measuring_base.rotation.angle();
        }
        compensation
    }

    /// The anchor of base and flange. Their offsets from the nominal ones are not corrected.
    pub fn anchor(&self) -> &Anchor {
        &self.anchor
    }

    /// The anchored flange in the anchored base, mm, at the model's joint values, rad. Corrections are included in the region where they hold.
    pub fn t_base_flange(&self, q_rad: &[f64]) -> IsometryMatrix3<f64> {
        let Some((identified, plain_anchor)) = &self.fading else {
            return self.anchor.anchored(&t_base_flange(self.links, q_rad));
        };
        let plain = || plain_anchor.anchored(&t_base_flange(&identified.plain.links, q_rad));
        let corrected =
            |corrected: &CorrectedModel| self.anchor.anchored(&corrected.t_base_flange(q_rad));
        match (&identified.corrected, identified.weight(q_rad)) {
            (Some(model), 1.0) => corrected(model),
            (Some(model), weight) if weight > 0.0 => between(&plain(), &corrected(model), weight),
            _ => plain(),
        }
    }

    /// Position of a target on the anchored flange, mm, from its offset in the flange frame of the links that it was identified with.
    pub fn p_anchored_mm(&self, p_flange_target_mm: &Vector3<f64>) -> Vector3<f64> {
        (self.anchor.t_anchored_flange * Point3::from(*p_flange_target_mm)).coords
    }

    /// The tool's pose in the anchored flange frame, mm.
    pub(super) fn t_flange_tool(&self, tool: &Tool) -> IsometryMatrix3<f64> {
        match tool {
            Tool::Target(p) => IsometryMatrix3::from_parts(
                Translation3::from(self.p_anchored_mm(p)),
                Rotation3::identity(),
            ),
            Tool::TargetPose(pose) => self.anchor.t_anchored_flange * pose,
            Tool::Tcp(pose) => *pose,
        }
    }

    /// The tool's pose in the base frame of the nominal robot at the controller's joint values, mm.
    pub fn t_nominal_tool(&self, q_controller_rad: &[f64], tool: &Tool) -> IsometryMatrix3<f64> {
        let q_rad = self.nominal.q_model_rad(q_controller_rad);
        t_base_flange(&self.nominal.links, &q_rad) * self.t_flange_tool(tool)
    }

    /// The controller's joint values, rad, with which the robot has its tool where the nominal robot has it at `q_controller_rad`.
    pub fn correct(&self, q_controller_rad: &[f64], tool: &Tool, mode: Mode) -> Corrected {
        let t_base_tool = self.t_nominal_tool(q_controller_rad, tool);
        let t_flange_tool = self.t_flange_tool(tool);
        self.solve_towards(q_controller_rad, t_base_tool, t_flange_tool, mode)
    }

    /// The joint values near `q_rad` with which the robot has its tool at a pose in the anchored base frame.
    pub(super) fn solve_towards(
        &self,
        q_rad: &[f64],
        t_base_tool: IsometryMatrix3<f64>,
        t_flange_tool: IsometryMatrix3<f64>,
        mode: Mode,
    ) -> Corrected {
        let goal = Goal {
            q_rad,
            t_base_tool,
            t_flange_tool,
            mode,
        };
        let before = self.miss(&goal, &Joints::zeros());
        let (change, status) = self.within_limits(&goal);
        let after = self.miss(&goal, &change);
        Corrected {
            q_controller_rad: q_rad
                .iter()
                .zip(change.iter())
                .map(|(q, dq)| q + dq)
                .collect(),
            position_error_before_mm: before.translation_mm.norm(),
            position_error_after_mm: after.translation_mm.norm(),
            orientation_error_after_rad: after.rotation_rad.norm(),
            status: match status {
                Status::Ok if !after.is_reached(mode) => Status::NotReached,
                Status::NearSingular if after.is_out_of_reach() => Status::NotReached,
                _ => status,
            },
        }
    }

    /// Solves the problem; if a joint exceeds its limit, holds it there and solves for the others.
    fn within_limits(&self, goal: &Goal<'_>) -> (Joints, Status) {
        let mut held = [None; MAX_LINKS];
        let is_beyond = |(q, limit): (&f64, &Option<(f64, f64)>)| {
            limit.is_some_and(|(low, high)| *q < low || *q > high)
        };
        let mut is_limited = goal
            .q_rad
            .iter()
            .zip(&self.nominal.joint_limits_rad)
            .any(is_beyond);
        for _ in 0..=goal.q_rad.len() {
            let (change, is_singular) = self.solve(goal, &held);
            let beyond = (0..goal.q_rad.len())
                .find_map(|joint| Some((joint, self.beyond(goal, joint, change[joint])?)));
            let Some((joint, change_to_limit)) = beyond.filter(|(joint, _)| held[*joint].is_none())
            else {
                let reached = self.miss(goal, &change).is_reached(goal.mode);
                let status = match (is_limited, is_singular && !reached) {
                    (true, _) => Status::JointLimit,
                    (_, true) => Status::NearSingular,
                    _ => Status::Ok,
                };
                return (change, status);
            };
            (held[joint], is_limited) = (Some(change_to_limit), true);
        }
        (Joints::zeros(), Status::JointLimit)
    }

    /// The change up to the joint's limit; `None` unless `change_rad` exceeds it. A joint that was commanded beyond its limit moves no
    /// further.
    fn beyond(&self, goal: &Goal<'_>, joint: usize, change_rad: f64) -> Option<f64> {
        let (low, high) = self.nominal.joint_limits_rad[joint]?;
        let (low, high) = (
            low.min(goal.q_rad[joint]) - goal.q_rad[joint],
            high.max(goal.q_rad[joint]) - goal.q_rad[joint],
        );
        (change_rad < low || change_rad > high).then(|| change_rad.clamp(low, high))
    }

    /// The change of the joints, and whether a direction was damped or the change was limited. With J = U·Σ·Vᵀ at the current change Δ and the error
    /// e, the next change is V·F·Uᵀ·(J·Δ + e), F = σ/(σ² + λ²). It is the smallest change that reaches the goal or, if λ > 0, the least-squares
    /// solution for error and damped change (Chiaverini, Siciliano & Egeland 1994, eq. 16, direction by direction).
    fn solve(&self, goal: &Goal<'_>, held: &[Option<f64>; MAX_LINKS]) -> (Joints, bool) {
        let mut change = Joints::from_fn(|joint, _| held[joint].unwrap_or(0.0));
        let (mut best, mut best_cost, mut is_singular) = (change, f64::INFINITY, false);
        for _ in 0..MAX_STEPS {
            let miss = self.miss(goal, &change);
            let cost = miss.weighted(goal.mode).norm_squared();
            if cost < best_cost {
                (best, best_cost) = (change, cost);
            }
            let jacobian = self.jacobian(goal, &change, held);
            let free = Joints::from_fn(|joint, _| {
                if held[joint].is_some() {
                    0.0
                } else {
                    change[joint]
                }
            });
            let wanted = jacobian * free + miss.weighted(goal.mode);
            let Some((solution, damped)) =
                damped_solution(&jacobian, &wanted, self.n_directions(goal.mode, held))
            else {
                break;
            };
            let mut next = Joints::from_fn(|joint, _| held[joint].unwrap_or(solution[joint]));
            let largest = next.amax();
            is_singular = damped || largest > self.max_change_rad;
            if largest > self.max_change_rad {
                next *= self.max_change_rad / largest;
            }
            let step = (next - change).amax();
            change = next;
            if step < STEP_RAD {
                // A damped solution balances error and change, so the last one is used even if an earlier step had a smaller error.
                return (change, is_singular);
            }
        }
        (best, is_singular)
    }

    /// Number of directions in which the free joints can move the tool.
    fn n_directions(&self, mode: Mode, held: &[Option<f64>; MAX_LINKS]) -> usize {
        let n_free = held[..self.links.len()]
            .iter()
            .filter(|h| h.is_none())
            .count();
        n_free.min(if mode == Mode::Pose { 6 } else { 3 })
    }

    fn q_model_rad(&self, goal: &Goal<'_>, change: &Joints) -> Vec<f64> {
        let q: Vec<f64> = goal
            .q_rad
            .iter()
            .zip(change.iter())
            .map(|(q, dq)| q + dq)
            .collect();
        self.nominal.q_model_rad(&q)
    }

    fn miss(&self, goal: &Goal<'_>, change: &Joints) -> PoseError {
        let t = self.t_base_flange(&self.q_model_rad(goal, change)) * goal.t_flange_tool;
        PoseError {
            translation_mm: goal.t_base_tool.translation.vector - t.translation.vector,
            rotation_rad: rotation_log(&(goal.t_base_tool.rotation * t.rotation.inverse())),
            reach_mm: self.reach_mm,
        }
    }

    /// Columns z × lever and z of the identified links' axes, with respect to the controller's joints. The derivatives of corrections are neglected;
    /// the iteration accounts for them through the error.
    fn jacobian(
        &self,
        goal: &Goal<'_>,
        change: &Joints,
        held: &[Option<f64>; MAX_LINKS],
    ) -> Jacobian {
        let n = self.links.len();
        let mut chain = [IsometryMatrix3::identity(); MAX_LINKS];
        let mut t = self.anchor.t_base_anchored.inverse();
        for (joint, q) in self.q_model_rad(goal, change).iter().enumerate() {
            t *= t_previous_link(&self.links[joint], *q);
            chain[joint] = t;
        }
        let tool = t * self.anchor.t_anchored_flange.inverse() * goal.t_flange_tool;
        let mut by_model = Jacobian::zeros();
        for (joint, t_base_link) in chain[..n].iter().enumerate() {
            let axis: Vector3<f64> = t_base_link.rotation.matrix().column(2).into();
            let along = axis.cross(&(tool.translation.vector - t_base_link.translation.vector));
            by_model
                .fixed_view_mut::<3, 1>(0, joint)
                .copy_from(&(along / self.reach_mm));
            if goal.mode == Mode::Pose {
                by_model
                    .fixed_view_mut::<3, 1>(3, joint)
                    .copy_from(&(axis * LEVER_PER_REACH));
            }
        }
        let mut by_controller = Jacobian::zeros();
        for joint in (0..n).filter(|joint| held[*joint].is_none()) {
            for model in 0..n {
                let rate = self.joint_rates[(model, joint)];
                if rate != 0.0 {
                    by_controller
                        .column_mut(joint)
                        .axpy(rate, &by_model.column(model), 1.0);
                }
            }
        }
        by_controller
    }
}

impl PoseError {
    fn weighted(&self, mode: Mode) -> Vector6<f64> {
        let (t, r) = (
            self.translation_mm / self.reach_mm,
            if mode == Mode::Pose {
                self.rotation_rad * LEVER_PER_REACH
            } else {
                Vector3::zeros()
            },
        );
        Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z)
    }

    fn is_out_of_reach(&self) -> bool {
        self.translation_mm.norm() > OUT_OF_REACH * self.reach_mm
    }

    fn is_reached(&self, mode: Mode) -> bool {
        self.translation_mm.norm() <= TOLERANCE_PER_REACH * self.reach_mm
            && (mode == Mode::Position || self.rotation_rad.norm() <= REACHED_RAD)
    }
}

/// V·F·Uᵀ·wanted. Also returns whether one of the `n_directions` in which the tool should be able to move is damped.
fn damped_solution(
    jacobian: &Jacobian,
    wanted: &Vector6<f64>,
    n_directions: usize,
) -> Option<(Joints, bool)> {
    let square: Matrix6<f64> = jacobian * jacobian.transpose();
    let eigen = square.try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS)?;
    let mut scaled = eigen.eigenvectors.transpose() * wanted;
    for k in 0..6 {
        let square = eigen.eigenvalues[k].max(0.0);
        let nearness = 1.0 - square / (SINGULAR * SINGULAR);
        let damping = if nearness > 0.0 {
            MAX_DAMPING * MAX_DAMPING * nearness
        } else {
            0.0
        };
        scaled[k] /= square + damping;
    }
    let n_free = eigen
        .eigenvalues
        .iter()
        .filter(|e| **e > SINGULAR * SINGULAR)
        .count();
    Some((
        jacobian.transpose() * (eigen.eigenvectors * scaled),
        n_free < n_directions,
    ))
}
