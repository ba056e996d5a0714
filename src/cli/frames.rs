//! `kincal frames`: base and tool frame from sweeps of single joints, for jobs with `frames_id`.

use super::client::ServerArguments;
use super::files::read;
use super::runtime::block_on;
use super::subject::item;
use super::terminal::Output;
use super::usage::Usage;
use std::path::PathBuf;

/// Base and tool frame from sweeps.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot that was swept: its id, name or serial number.
    #[arg(long, env = "KINCAL_ROBOT", value_name = "ROBOT")]
    robot: Option<String>,
    /// A file of sweeps (a measurement set in the instrument's frame with the column sweep_joint), or the id of stored frames.
    #[arg(value_name = "SWEEPS.csv|ID")]
    sweeps: PathBuf,
    #[command(flatten)]
    output: Output,
}

/// Uploads the sweeps and prints the frames, or prints stored frames.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let stored = arguments
        .sweeps
        .to_str()
        .filter(|id| id.starts_with("frm_"));
    let frames = match (stored, &arguments.robot) {
        (Some(id), _) => arguments.server.get(&item("frames", id, "")?)?,
        (None, None) => {
            let text = "say which robot was swept: --robot";
            return Err(Usage(text.into()).into());
        }
        (None, Some(robot)) => {
            let bytes = read(&arguments.sweeps)?;
            block_on(async {
                let client = arguments.server.client()?;
                let robot = client.robot_id(robot).await?;
                let path = format!("/v1/robots/{robot}/frames");
                client.post(&path, "text/csv", bytes).await
            })?
        }
    };
    arguments.output.print(&frames, || {
        format!(
            "{}: base at {} mm in the instrument's frame, tool at {} mm along the flange axis",
            frames["id"].as_str().unwrap_or_default(),
            frames["t_instrument_base"]["translation_mm"],
            frames["z_tool_mm"]
        )
    })
}
