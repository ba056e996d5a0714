//! Why sweeps cannot be used.

/// Why sweeps cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The robot has too few joints for the method.
    #[error(
        "base and tool frame need sweeps of joints 1, 2 and n-1, so at least 3 joints; the robot has {n_joints}"
    )]
    TooFewJoints {
        /// The robot's joints.
        n_joints: usize,
    },
    /// No rows for a joint.
    #[error(
        "there is no sweep of joint {joint}: add rows with sweep_joint {joint} in which only that joint moves"
    )]
    MissingSweep {
        /// 1-based joint.
        joint: usize,
    },
    /// Not enough rows for a joint.
    #[error("the sweep of joint {joint} has {found} points, at least {needed} are needed")]
    TooFewPoints {
        /// 1-based joint.
        joint: usize,
        /// Rows found.
        found: usize,
        /// Rows needed.
        needed: usize,
    },
    /// A joint moved that should have stood still.
    #[error("joint {other} moved during the sweep of joint {joint}; only the swept joint may move")]
    OtherJointMoved {
        /// 1-based joint of the sweep.
        joint: usize,
        /// 1-based joint that moved.
        other: usize,
    },
    /// The arc is too short to determine an axis.
    #[error(
        "the sweep of joint {joint} covers {arc_deg:.1}°, at least {needed_deg:.0}° are needed to find its axis"
    )]
    ShortArc {
        /// 1-based joint.
        joint: usize,
        /// Arc of the sweep, degrees.
        arc_deg: f64,
        /// Required arc, degrees.
        needed_deg: f64,
    },
    /// Points do not span a circle.
    #[error("the points of the sweep of joint {joint} do not lie on a circle")]
    DegenerateSweep {
        /// 1-based joint.
        joint: usize,
    },
    /// The points do not lie on one circle.
    #[error(
        "the points of the sweep of joint {joint} lie {rms_mm:.2} mm rms off one circle, at most {limit_mm:.2} mm are allowed; look for a wild point, a \
         reflector that slipped, or two reflectors in one sweep"
    )]
    PoorCircle {
        /// 1-based joint.
        joint: usize,
        /// Distance of the points from the circle, rms, mm.
        rms_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// The sweeps are of more than one reflector.
    #[error(
        "the sweeps are of several reflectors ({targets:?}); measure one reflector, on the flange's axis, in all three sweeps"
    )]
    SeveralTargets {
        /// Targets found.
        targets: Vec<usize>,
    },
    /// The measured arc is not the arc of the joint.
    #[error(
        "the points of the sweep of joint {joint} turn by {measured_deg:.1}°, the joint by {arc_deg:.1}°; is sweep_joint right?"
    )]
    ArcMismatch {
        /// 1-based joint.
        joint: usize,
        /// The joint's arc, degrees.
        arc_deg: f64,
        /// The points' arc, degrees.
        measured_deg: f64,
    },
    /// Axes 1 and 2 are parallel.
    #[error(
        "axes 1 and 2 stand at {angle_deg:.1}°; they must cross at 10° or more for the base frame to be found from them"
    )]
    ParallelAxes {
        /// Angle between them, degrees.
        angle_deg: f64,
    },
    /// With base and tool from the sweeps, the nominal robot does not fit the sweeps.
    #[error(
        "the points lie {rms_mm:.1} mm rms from where the nominal robot would be with the base and the tool found from them, at most {limit_mm:.1} mm are \
         allowed: check the unit and the axes of the positions, the mastering of the joints, and that it is this robot"
    )]
    FarFromNominal {
        /// Root mean square distance, mm.
        rms_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// The tool sweep does not determine z_t.
    #[error("the sweep of joint {joint} cannot show the target's distance from the flange")]
    ToolNotVisible {
        /// 1-based joint.
        joint: usize,
    },
}
