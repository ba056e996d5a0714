//! Events of the audit chain.

use std::fmt;

/// Suffix of the names of the events that create their subject. Such an event is the first entry about its subject.
pub(super) const CREATION: &str = "_created";

/// Event of an entry in the audit chain. Its name never changes, because old entries stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AuditEvent {
    /// A robot was stored.
    RobotCreated,
    /// A session did not fit the robot, so the state `check_robot` began.
    RobotDoesNotFit,
    /// A session fitted the robot and ended the state `check_robot`.
    RobotFitsAgain,
    /// A person gave a reason and ended the state `check_robot`.
    RobotChecked,
    /// The release policy of a robot was set.
    RobotPolicyChanged,
    /// A column mapping was stored.
    ColumnMappingCreated,
    /// A work frame or a tool was stored.
    NamedFrameCreated,
    /// A robot was edited.
    RobotEdited,
    /// A robot, measurement set, job, parameter set or network was archived.
    Archived,
    /// An archived item was restored.
    Restored,
    /// An upload was stored.
    MeasurementSetCreated,
    /// Sweeps were stored.
    FramesCreated,
    /// A job was posted.
    JobCreated,
    /// A job ended with a report.
    JobSucceeded,
    /// A job ended with an error.
    JobFailed,
    /// Cancellation of a running job was requested.
    JobCancelRequested,
    /// A job was cancelled.
    JobCancelled,
    /// The verification facts of a job were stored.
    VerificationKept,
    /// A network was stored.
    NetworkCreated,
    /// A parameter set was stored.
    ParameterSetCreated,
    /// A parameter set was released.
    ParameterSetReleased,
    /// The release of another set superseded this parameter set.
    ParameterSetSuperseded,
    /// A parameter set was withdrawn.
    ParameterSetWithdrawn,
    /// An API key was created.
    KeyCreated,
    /// An API key was revoked.
    KeyRevoked,
}

impl AuditEvent {
    /// Its name in the chain.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::RobotCreated => "robot_created",
            Self::RobotDoesNotFit => "robot_does_not_fit",
            Self::RobotFitsAgain => "robot_fits_again",
            Self::RobotChecked => "robot_checked",
            Self::RobotPolicyChanged => "robot_policy_changed",
            Self::ColumnMappingCreated => "column_mapping_created",
            Self::NamedFrameCreated => "named_frame_created",
            Self::RobotEdited => "robot_edited",
            Self::Archived => "archived",
            Self::Restored => "restored",
            Self::MeasurementSetCreated => "measurement_set_created",
            Self::FramesCreated => "frames_created",
            Self::JobCreated => "job_created",
            Self::JobSucceeded => "job_succeeded",
            Self::JobFailed => "job_failed",
            Self::JobCancelRequested => "job_cancel_requested",
            Self::JobCancelled => "job_cancelled",
            Self::VerificationKept => "verification_kept",
            Self::NetworkCreated => "network_created",
            Self::ParameterSetCreated => "parameter_set_created",
            Self::ParameterSetReleased => "parameter_set_released",
            Self::ParameterSetSuperseded => "parameter_set_superseded",
            Self::ParameterSetWithdrawn => "parameter_set_withdrawn",
            Self::KeyCreated => "key_created",
            Self::KeyRevoked => "key_revoked",
        }
    }

    /// Whether this event creates its subject, and so is the first entry about it.
    pub(super) fn is_creation(self) -> bool {
        self.as_str().ends_with(CREATION)
    }
}

impl fmt::Display for AuditEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
