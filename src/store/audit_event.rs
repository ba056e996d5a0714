//! Events of the audit chain.

use crate::wire::names;
use std::fmt;

/// Suffix of the names of the events that create their subject. Such an event is the first entry about its subject.
pub(super) const CREATION: &str = "_created";

names! {
    /// Event of an entry in the audit chain. Its name never changes, because old entries stay.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[allow(missing_docs)] // most names say it
    pub enum AuditEvent {
        RobotCreated = "robot_created",
        /// A session did not fit the robot, so the state `check_robot` began.
        RobotDoesNotFit = "robot_does_not_fit",
        /// A session fitted the robot and ended the state `check_robot`.
        RobotFitsAgain = "robot_fits_again",
        /// A person gave a reason and ended the state `check_robot`.
        RobotChecked = "robot_checked",
        /// The release policy of a robot was set.
        RobotPolicyChanged = "robot_policy_changed",
        ColumnMappingCreated = "column_mapping_created",
        /// A work frame or a tool was stored.
        NamedFrameCreated = "named_frame_created",
        RobotEdited = "robot_edited",
        /// A robot, measurement set, job, parameter set or network was archived.
        Archived = "archived",
        Restored = "restored",
        MeasurementSetCreated = "measurement_set_created",
        FramesCreated = "frames_created",
        JobCreated = "job_created",
        JobSucceeded = "job_succeeded",
        JobFailed = "job_failed",
        /// Cancellation of a running job was requested.
        JobCancelRequested = "job_cancel_requested",
        JobCancelled = "job_cancelled",
        /// The verification facts of a job were stored.
        VerificationKept = "verification_kept",
        NetworkCreated = "network_created",
        ParameterSetCreated = "parameter_set_created",
        ParameterSetReleased = "parameter_set_released",
        /// The release of another set superseded this parameter set.
        ParameterSetSuperseded = "parameter_set_superseded",
        ParameterSetWithdrawn = "parameter_set_withdrawn",
        KeyCreated = "key_created",
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
