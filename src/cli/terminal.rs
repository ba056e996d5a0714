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
    #[arg(long, env = "KINCAL_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
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

/// Remedies as the HTTP interface words them, and their replacements with commands and options.
const COMMANDS: [(&str, &str); 19] = [
    (
        "post a job of kind verify with measurement_set_id ",
        "kincal submit --verify --robot ROBOT ",
    ),
    (" and parameter_set_id ", " --parameters "),
    (
        "post a job of kind verify with parameter_set_id ",
        "kincal submit --verify --robot ROBOT SET.csv --parameters ",
    ),
    (
        "POST /v1/robots/{robot_id}/checked with the reason",
        "kincal checked ROBOT --reason TEXT",
    ),
    (
        "POST /v1/robots/{robot_id}/checked",
        "kincal checked ROBOT --reason TEXT",
    ),
    (
        "POST /v1/parameter-sets/{id}/release",
        "kincal release ID --reason TEXT",
    ),
    (
        "with POST /v1/robots/{robot_id}/restore",
        "with kincal restore ID",
    ),
    ("POST /v1/robots/", "kincal restore "),
    ("POST /v1/measurement-sets/", "kincal restore "),
    ("POST /v1/parameter-sets/", "kincal restore "),
    ("POST /v1/networks/", "kincal restore "),
    (" (--decimal comma)", ""),
    (" (--decimal point)", ""),
    ("?decimal=point", "--decimal point"),
    ("?decimal=comma", "--decimal-comma"),
    ("?frame=", "--frame "),
    ("?insist=", "--insist "),
    ("frame=instrument", "--frame instrument"),
    ("frame=base", "--frame base"),
];

/// Rewrites the remedies in a text of the server or the core as commands and options.
pub fn in_commands(text: &str) -> String {
    let replace = |text: String, (http, command): &(&str, &str)| text.replace(http, command);
    let text = COMMANDS.iter().fold(without_mappings(text), replace);
    restored(text)
}

/// Shortens `?columns={…} (--column …)`, which names a mapping for both interfaces, to the option alone.
fn without_mappings(text: &str) -> String {
    let (mut found, mut rest) = (String::new(), text);
    while let Some(at) = rest.find("?columns=") {
        let Some(option) = rest[at..].find(" (--").map(|offset| at + offset + 2) else {
            break;
        };
        // A quoted header may contain brackets.
        let mut is_quoted = false;
        let mut before = ' ';
        let end = rest[option..].char_indices().find(|(_, c)| {
            is_quoted ^= *c == '"' && before != '\\';
            before = *c;
            *c == ')' && !is_quoted
        });
        let Some((length, _)) = end else { break };
        found += &rest[..at];
        found += &rest[option..option + length];
        rest = &rest[option + length + 1..];
    }
    found + rest
}

/// Removes the `/restore` that the HTTP route leaves in `kincal restore ID/restore`.
fn restored(text: String) -> String {
    let mut parts = text.split("kincal restore ");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| {
        let id = part
            .find(|c: char| !c.is_ascii_alphanumeric() && c != '_')
            .unwrap_or(part.len());
        let rest = part[id..].strip_prefix("/restore").unwrap_or(&part[id..]);
        format!("{text}kincal restore {}{rest}", &part[..id])
    })
}

#[cfg(test)]
mod tests {
    use super::{in_commands, plain};

    #[test]
    fn remedies_are_commands_and_options() {
        assert_eq!(
            in_commands(
                "say so by ?columns={\"x_mm\": \"X (mm)\"} (--column x_mm=\"X (mm)\"). The table has \"X (mm)\""
            ),
            "say so by --column x_mm=\"X (mm)\". The table has \"X (mm)\""
        );
        assert_eq!(
            in_commands(
                "archived: restore it first, with POST /v1/robots/rob_1/restore (archived)"
            ),
            "archived: restore it first, with kincal restore rob_1 (archived)"
        );
        assert_eq!(
            in_commands(
                "post a job of kind verify with measurement_set_id set_1 and parameter_set_id par_1. If not: POST /v1/robots/{robot_id}/checked with the reason"
            ),
            "kincal submit --verify --robot ROBOT set_1 --parameters par_1. If not: kincal checked ROBOT --reason TEXT"
        );
    }

    #[test]
    fn a_terminal_gets_no_commands_and_no_other_direction() {
        assert_eq!(
            plain("a\u{1b}[2J\u{7}\u{9b}31m\u{202e}b\rc\nd 関節"),
            "a\u{fffd}[2J\u{fffd}\u{fffd}31m\u{fffd}b\u{fffd}c\nd 関節"
        );
    }
}
