//! Compares a job's own points with the robot's other uploads. Finds the upload in which the points appeared first, and whether it is older than the
//! robot's last session that did not fit.

use crate::calibration::{CalibrationRequest, RepeatedRows};
use crate::jobs::JobInputs;
use crate::release::facts::MeasurementAge;
use crate::store::known_uploads::KnownUpload;
use crate::wire::job::Kind;
use crate::wire::measurement::MeasurementSet;
use crate::wire::robot::Robot;

/// An upload of the robot, and its points.
struct KnownPoints<'a> {
    upload: &'a KnownUpload,
    sha256: &'a str,
    points: &'a MeasurementSet,
}

/// An upload that the job fits or scores.
struct OwnPoints<'a> {
    id: &'a str,
    sha256: &'a str,
    uploaded_seq: i64,
    points: &'a MeasurementSet,
}

/// Result of comparing one of the job's own uploads with the known uploads.
struct UploadAge {
    /// Number in the audit chain of the upload in which its points appeared first.
    measured_seq: i64,
    /// Whether this upload repeats an upload that it must not repeat, or is itself one of those: see [`measurement_age`].
    is_repeat: bool,
}

/// Finds the age of a job's points, and whether they repeat an upload that they must not repeat. The points of a check must repeat no earlier
/// upload, and no other kind of job may have used its upload. The points of other jobs must not repeat the uploads from before the last session that
/// did not fit.
pub(super) fn measurement_age(inputs: &JobInputs, request: &CalibrationRequest) -> MeasurementAge {
    let is_check = inputs.job.kind == Kind::Check;
    let known = &inputs.known;
    // Uploads that this version can no longer parse are left out of the comparison.
    let n_joints = request.robot.links.len();
    let parsed = known.uploads.iter().filter_map(|(upload, input)| {
        let points = input.parse(n_joints).ok()?;
        Some((upload, input.row.sha256.as_str(), points))
    });
    let parsed: Vec<(&KnownUpload, &str, MeasurementSet)> = parsed.collect();
    let known_uploads = parsed.iter().map(|(upload, sha256, points)| KnownPoints {
        upload,
        sha256,
        points,
    });
    let known_uploads: Vec<KnownPoints<'_>> = known_uploads.collect();
    let mut age = MeasurementAge {
        misfit_seq: known.misfit_seq,
        is_repeat: known.is_own_upload_used || (known.is_undecided && !is_check),
        measured_seq: 0,
    };
    let own = inputs
        .sets
        .iter()
        .zip(request.uploads())
        .zip(&known.own_uploaded_seqs);
    for ((input, points), uploaded_seq) in own {
        let own = OwnPoints {
            id: &input.row.id,
            sha256: &input.row.sha256,
            uploaded_seq: *uploaded_seq,
            points,
        };
        let found = compare(&request.robot, &own, &known_uploads, is_check);
        age.is_repeat |= found.is_repeat;
        age.measured_seq = age.measured_seq.max(found.measured_seq);
    }
    age
}

fn compare(
    robot: &Robot,
    own: &OwnPoints<'_>,
    known: &[KnownPoints<'_>],
    is_check: bool,
) -> UploadAge {
    let is_itself = |other: &KnownPoints<'_>| other.upload.id == own.id;
    let is_earlier = |other: &KnownPoints<'_>| other.upload.uploaded_seq < own.uploaded_seq;
    let must_not_repeat = |other: &KnownPoints<'_>| match is_check {
        true => is_earlier(other),
        false => other.upload.is_before_misfit,
    };
    let others: Vec<&KnownPoints<'_>> = known
        .iter()
        .filter(|other| !is_itself(other) && (is_earlier(other) || must_not_repeat(other)))
        .collect();
    let repeated = RepeatedRows::find(robot, others.iter().map(|other| other.points), own.points);
    let indices = |counts: &dyn Fn(&KnownPoints<'_>) -> bool| -> Vec<usize> {
        (0..others.len()).filter(|i| counts(others[*i])).collect()
    };
    let mut itself = known.iter().filter(|other| is_itself(other));
    // A file with the same bytes is a copy even if it has too few points to compare.
    let has_same_bytes = |other: &KnownPoints<'_>| is_earlier(other) && other.sha256 == own.sha256;
    let copied = indices(&has_same_bytes).into_iter();
    // The known uploads are sorted by age, so the smallest index is the oldest.
    let first = copied.chain(repeated.first(indices(&is_earlier))).min();
    UploadAge {
        measured_seq: first.map_or(own.uploaded_seq, |i| others[i].upload.uploaded_seq),
        is_repeat: itself.any(must_not_repeat) || repeated.repeats(indices(&must_not_repeat)),
    }
}
