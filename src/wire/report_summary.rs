//! The summary of a report: the report without its lists of points. A report with 20,000 points has 9 MB; its summary has a few KB. The summary is
//! stored in addition to the report, for readers that need only some facts.

use crate::wire::measurement::Warning;
use crate::wire::reference::ReferenceReport;
use crate::wire::report_shape::{
    ChangeReport, FinalFitReport, ParameterReport, PointReport, SubsetReport,
};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// The facts that are read from a summary. The fields are as in [`crate::wire::report_shape::Report`]. A whole report can also be read as a summary.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[allow(missing_docs)] // as in the report
pub struct ReportSummary {
    pub verify: Option<SubsetReport>,
    pub verify_without_outliers: Option<SubsetReport>,
    #[serde(rename = "final")]
    pub final_fit: Option<FinalFitReport>,
    pub parameters: Vec<ParameterReport>,
    pub reference: Option<ReferenceReport>,
    pub tool_uncertainty_absent_because: Option<String>,
    pub flange_rotation_std_deg: Option<f64>,
    pub last_joint_zero_std_deg: Option<f64>,
    pub changed: Option<Vec<ChangeReport>>,
    pub warnings: Vec<Warning>,
}

/// The points of a report. A summary does not contain them; only a comparison with the active set reads them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ReportPoints {
    /// Every point.
    pub per_point: Vec<PointReport>,
}

/// All fields of a report. The points are skipped during parsing and never collected.
#[derive(Deserialize, Serialize)]
struct Fields {
    #[serde(default, skip_serializing)]
    #[allow(dead_code)]
    per_point: IgnoredAny,
    #[serde(flatten)]
    rest: Map<String, Value>,
}

/// The summary of a stored report: all its fields except `per_point`, the poses of `repeatability` and the rows of `warnings`.
///
/// # Errors
/// If the text is not a JSON object.
pub fn summary_json(report_json: &str) -> Result<String, serde_json::Error> {
    let mut fields: Fields = serde_json::from_str(report_json)?;
    let repeatability = fields.rest.get_mut("repeatability");
    if let Some(repeatability) = repeatability.and_then(Value::as_object_mut) {
        repeatability.remove("poses");
    }
    let warnings = fields.rest.get_mut("warnings");
    let warnings = warnings.and_then(Value::as_array_mut);
    for warning in warnings.into_iter().flatten() {
        warning
            .as_object_mut()
            .map(|warning| warning.remove("rows"));
    }
    serde_json::to_string(&fields)
}

#[cfg(test)]
mod tests {
    use super::summary_json;
    use serde_json::{Value, json};

    #[test]
    fn a_summary_has_every_field_but_lists_over_points_and_every_number_bit_for_bit() {
        let whole = json!({
            "job_id": "job_1", "seed": u64::MAX, "cost_mm2": 1e-300, "verify": null,
            "identify": {"rms_mm": 0.1 + 0.2, "worst": -0.0, "n_points": 2},
            "per_point": [{"before_mm": 1.0}, {"before_mm": 2.0}],
            "repeatability": {"n_poses": 1, "rp_mm": 0.30000000000000004, "poses": [{"rows": [0, 1]}]},
            "warnings": [{"code": "outliers", "detail": "two", "rows": [0, 1]}, {"code": "other", "detail": "none"}],
        });
        let expected = json!({
            "job_id": "job_1", "seed": u64::MAX, "cost_mm2": 1e-300, "verify": null,
            "identify": {"rms_mm": 0.1 + 0.2, "worst": -0.0, "n_points": 2},
            "repeatability": {"n_poses": 1, "rp_mm": 0.30000000000000004},
            "warnings": [{"code": "outliers", "detail": "two"}, {"code": "other", "detail": "none"}],
        });
        let summary = summary_json(&whole.to_string()).unwrap();
        assert_eq!(
            serde_json::from_str::<Value>(&summary).unwrap().to_string(),
            expected.to_string()
        );
    }

    #[test]
    fn the_summary_of_a_summary_is_itself() {
        let summary = summary_json(r#"{"per_point":[1],"seed":1,"warnings":[]}"#).unwrap();
        assert_eq!(summary, r#"{"seed":1,"warnings":[]}"#);
        assert_eq!(summary_json(&summary).unwrap(), summary);
        assert!(summary_json("no report").is_err());
    }
}
