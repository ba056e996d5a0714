//! What a terminal may be shown, and how.

use serde::Serialize;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// As `println!`, for an output that may be closed before its end: `kincal robots | head -1` is no failure.
macro_rules! say {
    ($($text:tt)*) => { $crate::cli::terminal::line(format_args!($($text)*)) };
}

/// A line on standard output. Whoever closed it has seen enough, and the command does its work to the end.
pub fn line(text: std::fmt::Arguments<'_>) {
    unless_closed(writeln!(std::io::stdout().lock(), "{text}"));
}

/// What a command's answer looks like.
#[derive(Debug, clap::Args)]
pub struct Output {
    /// Print JSON, and nothing else, on standard output.
    #[arg(long, env = "KINCAL_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    pub json: bool,
}

impl Output {
    /// Prints an answer: the JSON of it if that was asked for, else words.
    pub fn told(
        &self,
        answer: &impl Serialize,
        words: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        if self.json {
            say!("{}", serde_json::to_string_pretty(answer)?);
        } else {
            say!("{}", words());
        }
        Ok(())
    }
}

/// Text as it is on standard output.
pub fn whole(text: impl AsRef<[u8]>) {
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

/// Whether something that was to be shown is not, as on a full disk.
static INCOMPLETE: AtomicBool = AtomicBool::new(false);

/// Whether all that was to be shown was.
pub fn is_complete() -> bool {
    !INCOMPLETE.load(Ordering::Relaxed)
}

/// A text that came from elsewhere, as a terminal may have it: names and messages may hold anything, and a terminal must neither obey it
/// nor write backwards. Ends of lines stay.
pub fn plain(text: &str) -> String {
    let is_obeyed = |c: char| {
        c != '\n'
            && (c.is_control()
                || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}'))
    };
    text.chars()
        .map(|c| if is_obeyed(c) { '\u{fffd}' } else { c })
        .collect()
}

/// Remedies as whoever asks by HTTP is told them, and the commands and options for the same.
const COMMANDS: [(&str, &str); 8] = [
    (
        "post a job of kind verify with parameter_set_id ",
        "kincal submit --verify --robot ROBOT SET.csv --parameters ",
    ),
    (
        "POST /v1/robots/{robot_id}/checked",
        "kincal checked ROBOT --reason TEXT",
    ),
    (
        "POST /v1/parameter-sets/{id}/release",
        "kincal release ID --reason TEXT",
    ),
    ("?decimal=comma", "--decimal-comma"),
    ("?frame=", "--frame "),
    ("?insist=", "--insist "),
    ("frame=instrument", "--frame instrument"),
    ("frame=base", "--frame base"),
];

/// A text of a server or of the core with its remedies as commands and options.
pub fn in_commands(text: &str) -> String {
    let replace = |text: String, (http, command): &(&str, &str)| text.replace(http, command);
    COMMANDS.iter().fold(text.to_owned(), replace)
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
