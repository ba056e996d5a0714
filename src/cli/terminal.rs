//! Output to the terminal: text, JSON, and the escaping of texts from elsewhere.

use serde::Serialize;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// As `println!`, but a closed output is no failure (`kincal robots | head -1`).
macro_rules! say {
    ($($text:tt)*) => { $crate::cli::terminal::line(format_args!($($text)*)) };
}

/// Prints a line on standard output. If the output is closed, the command still does its work to the end.
pub fn line(text: std::fmt::Arguments<'_>) {
    unless_closed(writeln!(std::io::stdout().lock(), "{text}"));
}

/// Format of a command's output.
#[derive(Debug, clap::Args)]
pub struct Output {
    /// Print only JSON on standard output.
    #[arg(long, env = "KINCAL_JSON", display_order = 900, value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    pub json: bool,
}

impl Output {
    /// Prints an answer: as JSON with `--json`, else as text.
    pub fn print(
        &self,
        answer: &impl Serialize,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        if self.json {
            say!("{}", serde_json::to_string_pretty(answer)?);
        } else {
            say!("{}", text());
        }
        Ok(())
    }
}

/// Prints text or bytes unchanged on standard output.
pub fn raw(text: impl AsRef<[u8]>) {
    unless_closed(std::io::stdout().lock().write_all(text.as_ref()));
}

fn unless_closed(written: std::io::Result<()>) {
    if let Err(error) = written.and_then(|()| std::io::stdout().lock().flush())
        && error.kind() != ErrorKind::BrokenPipe
    {
        eprintln!("kincal: cannot write: {error}");
        INCOMPLETE.store(true, Ordering::Relaxed);
    }
}

/// Set if output could not be written, e.g. on a full disk.
static INCOMPLETE: AtomicBool = AtomicBool::new(false);

/// True if all output was written.
pub fn is_complete() -> bool {
    !INCOMPLETE.load(Ordering::Relaxed)
}

/// Replaces control characters and changes of writing direction in a text from elsewhere, because names and messages may contain anything and the
/// terminal must not interpret it. Line endings stay.
pub fn plain(text: &str) -> String {
    let is_control = |c: char| {
        c != '\n'
            && (c.is_control()
                || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}'))
    };
    text.chars()
        .map(|c| if is_control(c) { '\u{fffd}' } else { c })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn a_terminal_gets_no_commands_and_no_other_direction() {
        assert_eq!(
            plain("a\u{1b}[2J\u{7}\u{9b}31m\u{202e}b\rc\nd 関節"),
            "a\u{fffd}[2J\u{fffd}\u{fffd}31m\u{fffd}b\u{fffd}c\nd 関節"
        );
    }
}
