//! `kincal openapi`.

use super::terminal;

/// Print the OpenAPI document.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// As JSON, not YAML.
    #[arg(long, env = "KINCAL_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Prints it.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let text = if arguments.json { crate::http::json() } else { crate::http::yaml() };
    terminal::whole(text.map_err(anyhow::Error::msg)?);
    Ok(())
}
