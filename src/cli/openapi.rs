//! `kincal openapi`.

use super::terminal::{self, Output};

/// Print the OpenAPI document, as YAML or as JSON.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    output: Output,
}

/// Prints the document.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let text = if arguments.output.json {
        crate::http::json()
    } else {
        crate::http::yaml()
    };
    terminal::raw(text.map_err(anyhow::Error::msg)?);
    Ok(())
}
