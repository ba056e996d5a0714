//! `kincal predict`: the tool's position for joint values, computed with identified parameters.

use super::numbers;
use super::subject::{ParameterSetArgument, post_to_parameter_set};
use super::terminal::{Output, plain};
use crate::wire::decimals::fixed;
use serde_json::{Value, json};

/// The tool's position for joint values, computed with identified parameters.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    set: ParameterSetArgument,
    /// The controller's joint values in degrees, with commas; one argument per pose. A single pose may have spaces instead of commas.
    #[arg(value_name = "Q1,Q2,…", required = true, allow_negative_numbers = true, value_parser = pose)]
    poses: Vec<Pose>,
    /// The reflector (0-based) [default: 0].
    #[arg(long, env = "KINCAL_TARGET")]
    target: Option<usize>,
    #[command(flatten)]
    output: Output,
}

/// Joint values of one pose, degrees.
#[derive(Clone, Debug)]
struct Pose(Vec<f64>);

fn pose(text: &str) -> Result<Pose, String> {
    let wrong = "numbers with commas between them, such as 10,-20,30,0,45,0";
    numbers::all(text).map(Pose).ok_or_else(|| wrong.into())
}

/// Prints one position per pose.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let mut q_deg: Vec<Vec<f64>> = arguments.poses.iter().map(|pose| pose.0.clone()).collect();
    // Single values with spaces between them (10 -20 30 …) are one pose, as in `kincal robots posture`.
    if q_deg.len() > 1 && q_deg.iter().all(|pose| pose.len() == 1) {
        q_deg = vec![q_deg.concat()];
    }
    let mut body = json!({"q_deg": q_deg});
    if let Some(target) = arguments.target {
        body["target"] = json!(target);
    }
    let set = &arguments.set;
    let answer = post_to_parameter_set(&set.server, &set.named, "/predict", &body)?;
    for warning in answer["warnings"].as_array().into_iter().flatten() {
        let [code, detail] = ["code", "detail"].map(|field| warning[field].as_str());
        let text = format!(
            "warning ({}): {}",
            code.unwrap_or_default(),
            detail.unwrap_or_default()
        );
        eprintln!("{}", plain(&text));
    }
    arguments.output.print(&answer, || {
        let extrapolated = &answer["extrapolated"];
        let positions = answer["position_mm"].as_array().into_iter().flatten();
        let line = |(i, position): (usize, &Value)| {
            let mm: Vec<String> = position
                .as_array()
                .into_iter()
                .flatten()
                .map(|mm| fixed(mm.as_f64().unwrap_or(f64::NAN), 4))
                .collect();
            let note = match extrapolated[i] == true {
                true => ",extrapolated",
                false => ",",
            };
            format!("{}{note}", mm.join(","))
        };
        let lines: Vec<String> = positions.enumerate().map(line).collect();
        format!("x_mm,y_mm,z_mm,note\n{}", lines.join("\n"))
    })
}
