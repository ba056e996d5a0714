//! Errors of the store.

use sqlx::error::ErrorKind;

use crate::wire::job_answer::JobStatus;

/// The store's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of the store.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no such row.
    #[error("not found")]
    NotFound,
    /// The request conflicts with the stored state.
    #[error(transparent)]
    Conflict(#[from] Conflict),
    /// The database cannot be opened.
    #[error("{detail}")]
    Open {
        /// What is wrong and how to correct it.
        detail: String,
    },
    /// The database failed; see [`Error::is_unavailable`].
    #[error("the database failed")]
    Database(#[source] sqlx::Error),
    /// The disk is nearly full. The remaining space is reserved for ending jobs, releasing and withdrawing.
    #[error("only {free_mib} MiB are left on the disk")]
    LowDiskSpace {
        /// Free space, MiB.
        free_mib: u64,
    },
}

/// Conflicts with the stored state.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Conflict {
    /// The worker has lost the job: its lease expired, or another process ended the job.
    #[error("the lease on this job is lost")]
    LeaseLost,
    /// The robot already has the maximum number of waiting jobs.
    #[error("{limit} jobs of this robot are waiting already")]
    QueueFull {
        /// The limit.
        limit: i64,
    },
    /// The job is not in the state that the operation needs.
    #[error("the job is {}", .status.as_str())]
    JobStatus {
        /// Its state.
        status: JobStatus,
    },
    /// A withdrawn parameter set cannot be released.
    #[error("the parameter set was withdrawn")]
    Withdrawn,
    /// The active set has changed since the release checks.
    #[error("another parameter set was released in the meantime")]
    ActiveChanged,
    /// The robot, its policy, its state or the sessions of the set have changed since the release checks.
    #[error("the robot, its policy or the set's sessions changed in the meantime")]
    ChecksOutdated,
    /// A trigger of the schema refused the release. Normally the release checks refuse it earlier.
    #[error("{why}")]
    RefusedBySchema {
        /// Message of the trigger.
        why: String,
    },
    /// The robot is archived.
    #[error("the robot is archived")]
    RobotArchived,
    /// Something that a job refers to was archived in the meantime. The server may have chosen it, so the request need not name it.
    #[error("the {what} {id} was archived in the meantime")]
    Archived {
        /// Its kind in words.
        what: String,
        /// Its id.
        id: String,
    },
    /// The item must stay in use and cannot be archived.
    #[error("{why}")]
    NotArchivable {
        /// Message of the trigger.
        why: String,
    },
    /// Another request edited the robot in the meantime.
    #[error("the robot was edited in the meantime")]
    RobotChanged,
    /// The joint map cannot be changed, because a parameter set was released with it.
    #[error("a parameter set was released with the joint map of this robot")]
    JointMapReleased,
    /// The robot has no set to roll back to.
    #[error("the robot has no superseded parameter set to go back to")]
    NothingToRollBackTo,
    /// A row with the same unique value exists already.
    #[error("it exists already")]
    Duplicate,
}

impl Error {
    pub(super) fn open(detail: impl Into<String>) -> Self {
        let detail = detail.into();
        Self::Open { detail }
    }

    /// Whether a later attempt may succeed (busy, out of connections, disk full, restarting). The HTTP status is then 503 instead of 500.
    pub fn is_unavailable(&self) -> bool {
        match self {
            Error::Database(error) => temporary_reason(error).is_some(),
            _ => false,
        }
    }

    /// Description of a database failure without internals, for clients and `/readyz`.
    pub fn reason(&self) -> &'static str {
        match self {
            Error::Database(error) => temporary_reason(error).unwrap_or(match error {
                sqlx::Error::Database(_) => "it reports a fault",
                _ => "it reported an unexpected error",
            }),
            Error::LowDiskSpace { .. } => "its disk is nearly full",
            _ => "it reported an unexpected error",
        }
    }

    /// The error with its cause, for the log.
    pub fn cause(&self) -> String {
        match self {
            Error::Database(source) => format!("{self}: {source}"),
            _ => self.to_string(),
        }
    }
}

/// Description of a temporary failure; none if the failure is permanent.
fn temporary_reason(error: &sqlx::Error) -> Option<&'static str> {
    Some(match error {
        sqlx::Error::PoolTimedOut => "no connection to it became free in time",
        sqlx::Error::PoolClosed => "the server is stopping",
        sqlx::Error::Io(error) if error.kind() == std::io::ErrorKind::NotFound => {
            "its data directory was moved or removed"
        }
        sqlx::Error::Io(_) => "the connection to it failed",
        sqlx::Error::WorkerCrashed => "a connection to it broke",
        sqlx::Error::Database(error) => return reason_of_code(&error.code()?),
        _ => return None,
    })
}

/// Description of a temporary failure, from the engine's error code; none if the failure is permanent. PostgreSQL's SQLSTATE has five characters.
/// SQLite's extended result codes are numbers of at most four digits; the low byte is the primary code.
fn reason_of_code(code: &str) -> Option<&'static str> {
    if code.len() == 5 {
        let classes = [
            ("08", "the connection to it failed"),
            ("55P03", "another connection locks it"),
            (
                "25P03",
                "it ended a transaction that this server had left idle",
            ),
            ("53", "it is out of connections, memory or disk"),
            ("57P", "it is shutting down or starting"),
            ("40", "another transaction writes the same rows"),
            ("3D", "it does not exist"),
        ];
        return classes
            .into_iter()
            .find(|(class, _)| code.starts_with(class))
            .map(|(_, reason)| reason);
    }
    Some(match code.parse::<u32>().ok()? & 0xff {
        5 | 6 => "another program locks it",
        8 => "its disk is read-only",
        10 => "its disk has an I/O error",
        13 => "its disk is full",
        14 => "its file cannot be opened",
        _ => return None,
    })
}

/// Error codes of a refusal by a trigger: SQLite's `raise(abort)` (1811) and PostgreSQL's exceptions from the functions `kincal_refuse…`.
const BY_TRIGGER: [&str; 3] = ["1811", "23000", "P0001"];

impl Error {
    /// Converts a trigger's refusal to the conflict that `conflict` makes from the trigger's message. Other errors stay as they are.
    pub(super) fn into_conflict_of_trigger(
        self,
        conflict: impl FnOnce(String) -> Conflict,
    ) -> Self {
        match &self {
            Self::Database(sqlx::Error::Database(refusal))
                if refusal
                    .code()
                    .is_some_and(|code| BY_TRIGGER.contains(&&*code)) =>
            {
                conflict(refusal.message().to_owned()).into()
            }
            _ => self,
        }
    }
}

impl From<sqlx::Error> for Error {
    fn from(error: sqlx::Error) -> Self {
        match &error {
            sqlx::Error::RowNotFound => Error::NotFound,
            sqlx::Error::Database(database) => match database.kind() {
                ErrorKind::UniqueViolation => Conflict::Duplicate.into(),
                ErrorKind::ForeignKeyViolation => Error::NotFound,
                _ => Error::Database(error),
            },
            _ => Error::Database(error),
        }
    }
}
