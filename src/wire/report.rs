//! Converts the core's report to the report of the API, and computes the hash of the result.

use crate::calibration::point_errors::PointErrors;
use crate::calibration::report::{self, MethodComparison};
use crate::calibration::{CalibrationReport, ROBOT_CHANGED};
use crate::identification::statistics::workspace::ToolUncertainty;
use crate::measurement::Subset;
use crate::wire::canonical;
use crate::wire::measurement::Warning;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::report_shape::{
    ComparisonReport, Convergence, Evidence, PointReport, Report, ToolUncertaintyReport,
};

/// Facts about a run that the core does not know.
#[derive(Clone, Debug)]
pub struct RunContext<'a> {
    /// The job.
    pub job_id: &'a str,
    /// The parameter set that was verified, whose values were held, or that was compared with.
    pub parameter_set_from: Option<&'a str>,
    /// Wall time without the comparison of methods, ms.
    pub duration_ms: f64,
    /// Wall time of each compared method, in the order of `comparison`, ms.
    pub comparison_ms: Vec<f64>,
    /// Strength of the verification.
    pub evidence: Evidence,
    /// SHA-256 of the trained network's tensors.
    pub network_sha256: Option<&'a str>,
    /// The warning that the uploader of the points overrode a suspicion with `insist`.
    pub insisted: Option<Warning>,
}

/// Version of kincal that is written into every report.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Codes of the warnings that result from a comparison with earlier sessions.
const ABOUT_EARLIER_SESSIONS: [&str; 2] = [ROBOT_CHANGED, "placement_changed"];

/// Builds the report of the API, with its hash.
pub fn build(core: &CalibrationReport, run: &RunContext<'_>) -> Result<Report, serde_json::Error> {
    let mut report = without_hash(core, run);
    report.result_sha256 = result_sha256(&report, core, run.network_sha256)?;
    Ok(report)
}

fn without_hash(core: &CalibrationReport, run: &RunContext<'_>) -> Report {
    Report {
        job_id: run.job_id.into(),
        parameter_set_from: run.parameter_set_from.map(Into::into),
        measured_at: None,
        method: core.method,
        method_reason: core.method_reason.clone(),
        model: core.model,
        preset: core.preset,
        seed: core.seed,
        version: VERSION.into(),
        termination: core.termination.into(),
        n_iterations: core.n_iterations,
        n_evaluations: core.n_evaluations,
        duration_ms: run.duration_ms,
        cost_mm2: core.cost_mm2,
        identify: core.identify,
        verify: core.verify,
        verify_without_outliers: core.verify_without_outliers,
        final_fit: core.final_fit,
        per_point: core.per_point.iter().map(Into::into).collect(),
        parameters: core.parameters.clone(),
        reference: core.instrument_scale.map(Into::into),
        tool_uncertainty_mm: core
            .tool_uncertainty
            .filter(|t| t.max_mm.is_finite())
            .map(Into::into),
        tool_uncertainty_corrected_mm: core
            .corrected_tool_uncertainty
            .filter(|t| t.max_mm.is_finite())
            .map(Into::into),
        tool_uncertainty_absent_because: core.uncertainty_absent_because.clone(),
        flange_rotation_std_deg: core
            .flange_rotation
            .map(|found| f64::to_degrees(found.std_rad())),
        last_joint_zero_std_deg: core
            .flange_rotation
            .map(|found| found.last_joint_zero_rad.to_degrees()),
        error_model: core.error_model,
        identifiability: core.identifiability.clone(),
        comparison: core
            .comparison
            .iter()
            .enumerate()
            .map(|(i, c)| comparison(c, run.comparison_ms.get(i)))
            .collect(),
        corrections: core.corrections.clone(),
        repeatability: core.repeatability.clone(),
        changed: core.changes.as_ref().map(|changes| changes.all.clone()),
        pooled: core.pooled.clone(),
        check: core.quick_check.clone(),
        evidence: run.evidence,
        warnings: run
            .insisted
            .iter()
            .cloned()
            .chain(core.warnings.iter().map(|warning| named(warning, core)))
            .collect(),
        result_sha256: String::new(),
    }
}

/// A warning with the names of its points. The points of a separate verification set come after all others.
fn named(warning: &report::Warning, core: &CalibrationReport) -> Warning {
    let is_own = |point: &&PointErrors| point.subset == Subset::Identify;
    let first = match warning.is_of_the_verify_set() {
        true => core.per_point.iter().filter(is_own).count(),
        false => 0,
    };
    Warning::from(warning).with_point_names(|row| core.per_point.get(first + row)?.name.as_deref())
}

/// SHA-256 of the report, the parameter set, the convergence curve and the network's hash. Identifiers, names of points, times, durations and comparisons
/// with earlier sessions are removed first, because they are not part of the result.
fn result_sha256(
    report: &Report,
    core: &CalibrationReport,
    network_sha256: Option<&str>,
) -> Result<String, serde_json::Error> {
    let mut value = serde_json::to_value(report)?;
    if let Some(fields) = value.as_object_mut() {
        fields.retain(|name, _| {
            ![
                "job_id",
                "parameter_set_from",
                "measured_at",
                "duration_ms",
                "result_sha256",
                "changed",
            ]
            .contains(&name.as_str())
        });
        if let Some(warnings) = fields
            .get_mut("warnings")
            .and_then(|warnings| warnings.as_array_mut())
        {
            warnings.retain(|warning| {
                !ABOUT_EARLIER_SESSIONS.contains(&warning["code"].as_str().unwrap_or_default())
            });
        }
        // Removes the duration of a comparison, and the names of points.
        for (rows, field) in [
            ("/comparison", "duration_ms"),
            ("/per_point", "name"),
            ("/repeatability/poses", "name"),
            ("/warnings", "points"),
        ] {
            let rows = value.pointer_mut(rows).and_then(|rows| rows.as_array_mut());
            for row in rows.into_iter().flatten() {
                row.as_object_mut().map(|row| row.remove(field));
            }
        }
    }
    let (parameter_set, convergence) = (ParameterSetContent::from(core), convergence(core));
    let content = serde_json::Map::from_iter([
        ("report".to_owned(), value),
        (
            "parameter_set".to_owned(),
            serde_json::to_value(parameter_set)?,
        ),
        ("convergence".to_owned(), serde_json::to_value(convergence)?),
        (
            "network_sha256".to_owned(),
            serde_json::to_value(network_sha256)?,
        ),
    ]);
    Ok(canonical::sha256_hex(
        canonical::canonical_text(&content.into())?.as_bytes(),
    ))
}

/// The convergence curve.
pub fn convergence(core: &CalibrationReport) -> Convergence {
    Convergence {
        iteration: (0..core.convergence_mm2.len()).collect(),
        best_cost_mm2: core.convergence_mm2.clone(),
    }
}

impl From<&PointErrors> for PointReport {
    fn from(p: &PointErrors) -> Self {
        Self {
            configuration: p.configuration.clone(),
            name: p.name.clone(),
            target: p.target,
            subset: p.subset,
            before_mm: p.before_mm,
            after_mm: p.after_mm,
            corrected_mm: p.corrected_vector_mm.map(|v| v.norm()),
            position_mm: Some(p.position_mm.into()),
            before_vector_mm: Some(p.before_vector_mm.into()),
            after_vector_mm: Some(p.after_vector_mm.into()),
            corrected_vector_mm: p.corrected_vector_mm.map(Into::into),
            before_rotation_deg: p.rotation_rad.map(|both| f64::to_degrees(both[0])),
            after_rotation_deg: p.rotation_rad.map(|both| f64::to_degrees(both[1])),
            outlier: p.is_outlier,
        }
    }
}

impl From<ToolUncertainty> for ToolUncertaintyReport {
    fn from(t: ToolUncertainty) -> Self {
        Self {
            mean: t.mean_mm,
            max: t.max_mm,
        }
    }
}

fn comparison(c: &MethodComparison, duration_ms: Option<&f64>) -> ComparisonReport {
    ComparisonReport {
        method: c.method.to_string(),
        n_iterations: c.n_iterations,
        n_evaluations: c.n_evaluations,
        duration_ms: duration_ms.copied().unwrap_or(0.0),
        cost_mm2: c.cost_mm2,
        verify_after: c.verify_after,
    }
}
