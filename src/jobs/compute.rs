//! Inputs and results of a worker's computation.

use std::ops::ControlFlow;

use crate::release::unread_labels;
use crate::store::known_uploads::KnownUpload;
use crate::store::{
    FramesRow, Hashed, JobRow, MeasurementSetRow, NamedDocumentRow, NetworkRow, NewNetwork,
    NewParameterSet, ParameterSetRow, Result, RobotRow, Store, VerificationRow, frames,
    job_sources, jobs, known_uploads, measurement_sets, named_documents, networks, parameter_sets,
    robot_versions, verifications,
};
use crate::wire::job::Kind;
use crate::wire::job_answer::ProgressAnswer;
use crate::wire::measurement::{MeasurementSet, from_upload};
use crate::wire::understood::Reading;
use crate::wire::verification::Verification;
use crate::wire::{Invalid, Problem};

/// Computes a job from its inputs alone. It reports progress at least once per iteration, and stops with [`JobFailure::Cancelled`] when the monitor
/// returns `Break`. It runs on a blocking thread and may panic.
pub type Compute = fn(
    &JobInputs,
    &mut dyn FnMut(ProgressAnswer) -> ControlFlow<()>,
) -> std::result::Result<JobOutcome, JobFailure>;

/// Everything a job's result depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct JobInputs {
    /// The running job.
    pub job: JobRow,
    /// Its robot.
    pub robot: RobotRow,
    /// The measurement sets to identify from, or to score: one for each session.
    pub sets: Vec<MeasurementSetInput>,
    /// Another set to verify on.
    pub verify_set: Option<MeasurementSetInput>,
    /// Frames found from sweeps.
    pub frames: Option<FramesRow>,
    /// The network to start from.
    pub network: Option<NetworkInput>,
    /// The residual network from which training continues.
    pub residual_network: Option<NetworkInput>,
    /// The parameter set to score, whose values are held, or that an identification is compared with.
    pub parameter_set: Option<ParameterSetInput>,
    /// Uploads on which the held parameters, or the training of the residual network, are based.
    pub sources: Vec<MeasurementSetInput>,
    /// The references that the sets name, with their content in JSON.
    pub references: Vec<NamedDocumentRow>,
    /// The robot's uploads that the job's points are compared with. Empty unless they were read ([`JobInputs::with_known_uploads`]). Points
    /// that repeat an earlier upload are as old as that upload.
    pub known: KnownUploads,
}

/// Uploads of the robot that a job's points are compared with: the uploads that are older than the job's own, and those that are older than the
/// robot's last session that did not fit.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct KnownUploads {
    /// Number of that session in the robot's counter; 0 if there is none.
    pub misfit_seq: i64,
    /// For each of the job's own uploads, in order: its number in the audit chain; 0 if unknown.
    pub own_uploaded_seqs: Vec<i64>,
    /// The uploads, oldest first.
    pub uploads: Vec<(KnownUpload, MeasurementSetInput)>,
    /// True if only the newest uploads are compared, because the robot has more uploads or points than the limits below, and nobody has
    /// explained that session. It is then unknown whether the points repeat an older upload.
    pub is_undecided: bool,
    /// For a check: whether a job of another kind has used its upload, or the upload is older than all that are compared.
    pub is_own_upload_used: bool,
}

/// Limits on the uploads, and on their points, that a job's points are compared with: together some hundred MB of memory. For a robot above
/// these limits, no session can end the state `check_robot`; a person has to end it (`POST /v1/robots/{id}/checked`).
const MAX_KNOWN: usize = 500;
const MAX_KNOWN_POINTS: i64 = 500_000;

/// A parameter set with the points and frames that it was identified from.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterSetInput {
    /// The parameter set.
    pub row: ParameterSetRow,
    /// The measurement sets that it was identified from: one for each session.
    pub sets: Vec<MeasurementSetInput>,
    /// Uploads on which the values that it holds, or the training of its residual network, are based.
    pub sources: Vec<MeasurementSetInput>,
    /// The frames that the identification used.
    pub frames: Option<FramesRow>,
    /// Verification facts of its identification.
    pub verification: Option<VerificationRow>,
    /// Its estimate (`wire::estimate`); `None` if none is stored, as for a set of an older version.
    pub estimate_json: Option<String>,
}

/// A measurement set with its bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSetInput {
    /// Its row.
    pub row: MeasurementSetRow,
    /// The uploaded bytes.
    pub body: Vec<u8>,
}

impl JobInputs {
    /// Names the columns of the fitted sets that are not read although they may identify the reflector or the set-up of a row.
    pub fn unread_labels(&self) -> Option<String> {
        let mut sets = self.sets.iter();
        sets.find_map(|set| unread_labels(&set.stated_reading()?))
    }

    /// Stated time of measurement; with several sessions, that of the last one.
    pub fn measured_at(&self) -> Option<String> {
        self.sets.last()?.stated_reading()?.record?.measured_at
    }
}

impl MeasurementSetInput {
    /// How the upload was interpreted. `None` if this cannot be parsed; the job then fails when its points are parsed.
    fn stated_reading(&self) -> Option<Reading> {
        let reading = self.row.reading_json.as_deref()?;
        serde_json::from_str(reading).ok()
    }

    /// Reads a stored set.
    pub async fn read(store: &Store, id: &str) -> Result<Self> {
        Ok(Self {
            row: measurement_sets::get(store, id).await?,
            body: measurement_sets::body(store, id).await?,
        })
    }

    /// Reads the stored sets that a job fits or scores.
    pub async fn read_of(store: &Store, job: &JobRow) -> Result<Vec<Self>> {
        let mut sets = Vec::new();
        for id in job.set_ids() {
            sets.push(Self::read(store, id).await?);
        }
        Ok(sets)
    }

    /// Parses the points.
    ///
    /// # Errors
    /// If the bytes cannot be read. This does not happen, because they were accepted once.
    pub fn parse(&self, n_joints: usize) -> std::result::Result<MeasurementSet, Invalid> {
        let reading = self.row.reading_json.as_deref();
        from_upload(
            &self.row.content_type,
            reading,
            &self.body,
            self.row.frame,
            n_joints,
        )
    }
}

/// A network with its weights.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkInput {
    /// Its row.
    pub row: NetworkRow,
    /// The weights in safetensors format.
    pub weights: Vec<u8>,
}

/// Result of a computation.
#[derive(Clone, Debug, PartialEq)]
pub struct JobOutcome {
    /// The whole report.
    pub report_json: Hashed<String>,
    /// Its summary, `wire::report_summary`.
    pub summary_json: String,
    /// The convergence curve.
    pub convergence_json: Hashed<String>,
    /// SHA-256 of the result, hexadecimal.
    pub result_sha256: String,
    /// The parameter set, if one was identified.
    pub parameter_set: Option<NewParameterSet>,
    /// The network, if one was trained.
    pub network: Option<NewNetwork>,
    /// The residual network, if the corrections use one.
    pub residual_network: Option<NewNetwork>,
    /// Verification facts of the parameter set that was identified or scored, if there is one.
    pub verification: Option<Verification>,
}

/// Why a computation has no result.
#[derive(Clone, Debug, PartialEq)]
pub enum JobFailure {
    /// The monitor returned `Break`.
    Cancelled,
    /// The job cannot be computed, and another attempt would not help.
    Failed(Box<Problem>),
}

impl JobFailure {
    /// Fails the job with this problem for the client.
    pub(super) fn failed(problem: Problem) -> Self {
        Self::Failed(Box::new(problem))
    }

    /// Failure for a stored document that cannot be read or written: an internal error, not the client's.
    pub(super) fn internal(cause: impl std::fmt::Display) -> Self {
        tracing::error!(%cause, "a job's stored documents cannot be read or written");
        Self::failed(Problem::new(
            500,
            "internal",
            "a stored document of this job cannot be read or written; the log has the cause",
        ))
    }
}

pub(super) fn problem_json(problem: &Problem) -> String {
    serde_json::json!(problem).to_string()
}

impl JobInputs {
    /// Reads a job and everything that it names.
    pub async fn load(store: &Store, job_id: &str) -> Result<JobInputs> {
        JobInputs::load_for(store, jobs::get(store, job_id).await?).await
    }

    /// Reads everything that the job names.
    pub async fn load_for(store: &Store, job: JobRow) -> Result<JobInputs> {
        // Reads concurrently; each read takes its own connection.
        let (robot, sets, verify_set, frames, network, residual_network, parameter_set, sources) =
            tokio::try_join!(
                robot_versions::robot_at(store, &job.robot_id, job.robot_version),
                MeasurementSetInput::read_of(store, &job),
                load(
                    job.verify_set_id.as_deref(),
                    |id| MeasurementSetInput::read(store, id)
                ),
                load(job.frames_id.as_deref(), |id| frames::get(store, id)),
                load(job.network_input_id.as_deref(), |id| load_network(
                    store, id
                )),
                load(job.residual_network_input_id.as_deref(), |id| load_network(
                    store, id
                )),
                load(job.parameter_set_input_id.as_deref(), |id| {
                    load_parameter_set(store, id)
                }),
                load_sources(store, &job.id),
            )?;
        let references = load_references(store, &sets).await?;
        Ok(JobInputs {
            job,
            robot,
            references,
            sets,
            verify_set,
            frames,
            network,
            residual_network,
            parameter_set,
            sources,
            known: KnownUploads::default(),
        })
    }

    /// Reads the robot's uploads too, with which the points are compared.
    pub async fn with_known_uploads(self, store: &Store) -> Result<JobInputs> {
        let known = load_known(store, &self.job).await?;
        Ok(JobInputs { known, ..self })
    }
}

/// Loads an optional reference.
async fn load<'a, T, F: Future<Output = Result<T>>>(
    id: Option<&'a str>,
    get: impl FnOnce(&'a str) -> F,
) -> Result<Option<T>> {
    match id {
        Some(id) => get(id).await.map(Some),
        None => Ok(None),
    }
}

async fn load_network(store: &Store, id: &str) -> Result<NetworkInput> {
    Ok(NetworkInput {
        row: networks::get(store, id).await?,
        weights: networks::weights(store, id).await?,
    })
}

async fn load_parameter_set(store: &Store, id: &str) -> Result<ParameterSetInput> {
    let row = parameter_sets::get(store, id).await?;
    let job = jobs::get(store, &row.job_id).await?;
    let frames = load(job.frames_id.as_deref(), |id| frames::get(store, id)).await?;
    Ok(ParameterSetInput {
        sets: MeasurementSetInput::read_of(store, &job).await?,
        verification: verifications::of_job(store, &row.job_id).await?,
        estimate_json: parameter_sets::estimate(store, id).await?,
        sources: load_sources(store, &row.job_id).await?,
        row,
        frames,
    })
}

/// The references that the sets name.
async fn load_references(
    store: &Store,
    sets: &[MeasurementSetInput],
) -> Result<Vec<NamedDocumentRow>> {
    let mut references = Vec::new();
    for set in sets {
        if let Some(reference) = set.stated_reading().and_then(|reading| reading.reference) {
            references.push(named_documents::get(store, &reference.id).await?);
        }
    }
    Ok(references)
}

/// The uploads of the earlier jobs on which a job's result is based.
async fn load_sources(store: &Store, job_id: &str) -> Result<Vec<MeasurementSetInput>> {
    let mut sources = Vec::new();
    for upload in job_sources::uploads(store, job_id).await? {
        sources.push(MeasurementSetInput::read(store, &upload.measurement_set_id).await?);
    }
    Ok(sources)
}

async fn load_known(store: &Store, job: &JobRow) -> Result<KnownUploads> {
    let counters = verifications::robot_counters(store, &job.robot_id).await?;
    let (robot_id, is_session) = (&job.robot_id, job.kind == Kind::Verify);
    let limit = MAX_KNOWN as i64 + 1;
    let found = known_uploads::newest(store, robot_id, counters.misfit_seq, is_session, limit);
    let mut found: Vec<KnownUpload> = found.await?;
    let n_found = found.len();
    found.truncate(MAX_KNOWN);
    let mut n_points = 0;
    found.retain(|upload| {
        n_points += upload.n_points;
        n_points <= MAX_KNOWN_POINTS
    });
    let is_cut = found.len() < n_found;
    let is_own = |upload: &KnownUpload| job.set_ids().any(|id| id == upload.id);
    let seq_of = |id: &str| {
        let own = found.iter().find(|upload| upload.id == id);
        own.map_or(0, |upload| upload.uploaded_seq)
    };
    let own_uploaded_seqs: Vec<i64> = job.set_ids().map(seq_of).collect();
    let is_own_upload_used = job.kind == Kind::Check
        && (!found.iter().any(is_own)
            || known_uploads::is_used(store, robot_id, &job.measurement_set_id).await?);
    let newest_own = own_uploaded_seqs.iter().copied().max().unwrap_or(0);
    let is_compared = |upload: &KnownUpload| {
        upload.uploaded_seq < newest_own || upload.is_before_misfit || is_own(upload)
    };
    let mut uploads = Vec::new();
    for upload in found.into_iter().rev().filter(is_compared) {
        let input = MeasurementSetInput::read(store, &upload.id).await?;
        uploads.push((upload, input));
    }
    Ok(KnownUploads {
        misfit_seq: counters.misfit_seq,
        own_uploaded_seqs,
        uploads,
        is_undecided: is_cut && counters.misfit_seq > counters.checked_seq,
        is_own_upload_used,
    })
}
