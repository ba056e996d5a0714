//! Converts a stored job to its answer.

use crate::http::Error;
use crate::store::JobRow;
use crate::wire::job::JobRequestBody;
use crate::wire::job_answer::JobAnswer;
use crate::wire::time::rfc3339;

impl TryFrom<&JobRow> for JobAnswer {
    type Error = Error;

    fn try_from(row: &JobRow) -> Result<Self, Error> {
        let request: JobRequestBody = serde_json::from_str(&row.request_json)?;
        Ok(Self {
            id: row.id.clone(),
            robot_id: row.robot_id.clone(),
            measurement_set_id: row.measurement_set_id.clone(),
            kind: request.kind,
            method: request.method,
            request,
            status: row.status,
            attempt: u32::try_from(row.attempt).unwrap_or(u32::MAX),
            progress: row
                .progress_json
                .as_deref()
                .map(serde_json::from_str)
                .transpose()?,
            error: row
                .error_json
                .as_deref()
                .map(serde_json::from_str)
                .transpose()?,
            parameter_set_from: row.parameter_set_input_id.clone(),
            parameter_set_id: row.parameter_set_id.clone(),
            network_id: row.network_id.clone(),
            residual_network_from: row.residual_network_input_id.clone(),
            residual_network_id: row.residual_network_id.clone(),
            created_at: rfc3339(row.created_at_ms),
            started_at: row.started_at_ms.map(rfc3339),
            finished_at: row.finished_at_ms.map(rfc3339),
            robot_version: (row.robot_version > 1).then_some(row.robot_version),
            archived_at: row.archived_at_ms.map(rfc3339),
            measurement_set_name: row.measurement_set_name.clone(),
            nominal_rms_mm: row.before_rms_mm,
            rms_mm: row.after_rms_mm,
            finding: row.finding,
        })
    }
}
