//! Events of the audit chain.

use crate::wire::names;
use std::fmt;

/// Suffix of the names of the events that create their subject. Such an event is the first entry about its subject.
pub(super) const CREATION: &str = "_created";

names! {
    /// Event of an entry in the audit chain. Its name never changes, because old entries stay.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum AuditEvent {
        /// A robot was stored.
        RobotCreated = "robot_created",
        /// A session did not fit the robot, so the state `check_robot` began.
        RobotDoesNotFit = "robot_does_not_fit",
        /// A session fitted the robot and ended the state `check_robot`.
        RobotFitsAgain = "robot_fits_again",
        /// A person gave a reason and ended the state `check_robot`.
        RobotChecked = "robot_checked",
        /// The release policy of a robot was set.
        RobotPolicyChanged = "robot_policy_changed",
        /// A column mapping was stored.
        ColumnMappingCreated = "column_mapping_created",
        /// A work frame or a tool was stored.
        NamedFrameCreated = "named_frame_created",
        /// A robot was edited.
        RobotEdited = "robot_edited",
        /// A robot, measurement set, job, parameter set or network was archived.
        Archived = "archived",
        /// An archived item was restored.
        Restored = "restored",
        /// An upload was stored.
        MeasurementSetCreated = "measurement_set_created",
        /// Sweeps were stored.
        FramesCreated = "frames_created",
        /// A job was posted.
        JobCreated = "job_created",
        /// A job ended with a report.
        JobSucceeded = "job_succeeded",
        /// A job ended with an error.
        JobFailed = "job_failed",
        /// Cancellation of a running job was requested.
        JobCancelRequested = "job_cancel_requested",
        /// A job was cancelled.
        JobCancelled = "job_cancelled",
        /// The verification facts of a job were stored.
        VerificationKept = "verification_kept",
        /// A network was stored.
        NetworkCreated = "network_created",
        /// A parameter set was stored.
        ParameterSetCreated = "parameter_set_created",
        /// A parameter set was released.
        ParameterSetReleased = "parameter_set_released",
        /// The release of another set superseded this parameter set.
        ParameterSetSuperseded = "parameter_set_superseded",
        /// A parameter set was withdrawn.
        ParameterSetWithdrawn = "parameter_set_withdrawn",
        /// An API key was created.
        KeyCreated = "key_created",
        /// An API key was revoked.
        KeyRevoked = "key_revoked",
    }
}

impl AuditEvent {
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
