//! `kincal completions`: what makes the Tab key work.

use super::terminal;
use clap_complete::Shell;

/// Print the completions of a shell.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Which shell.
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Prints those of `command`, which is all of kincal.
pub fn run(arguments: &Arguments, mut command: clap::Command) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "kincal", &mut script);
    terminal::whole(script);
    Ok(())
}
