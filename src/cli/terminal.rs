//! Output to the terminal: text and JSON. Text from other sources is escaped.

use serde::Serialize;
use serde_json::Value;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// Like `println!`, but a closed output is no error (`kincal robots | head -1`).
macro_rules! say {
    ($($text:tt)*) => { $crate::cli::terminal::line(format_args!($($text)*)) };
}

/// Prints a line on standard output. If the output is closed, the command still does its work to the end.
pub fn line(text: std::fmt::Arguments<'_>) {
    ignore_closed_output(writeln!(std::io::stdout().lock(), "{text}"));
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
            return json(answer);
        }
        say!("{}", text());
        Ok(())
    }

    /// Prints a list: as JSON with `--json`, else as a table with these columns, or as a text if it is empty.
    pub fn table(
        &self,
        answer: &impl Serialize,
        names: &[&str],
        rows: &[Vec<String>],
        empty: &str,
    ) -> anyhow::Result<()> {
        if self.json || rows.is_empty() {
            return self.print(answer, || empty.to_owned());
        }
        raw(columns(names, rows));
        Ok(())
    }
}

/// Prints an answer as JSON.
pub fn json(answer: &impl Serialize) -> anyhow::Result<()> {
    say!("{}", serde_json::to_string_pretty(answer)?);
    Ok(())
}

/// Prints text or bytes unchanged on standard output.
pub fn raw(text: impl AsRef<[u8]>) {
    ignore_closed_output(std::io::stdout().lock().write_all(text.as_ref()));
}

fn ignore_closed_output(written: std::io::Result<()>) {
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

/// Replaces control characters and changes of writing direction, because names and messages from other sources may contain them and the
/// terminal must not interpret them. Line endings stay.
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

/// A table whose columns are as wide as their widest cell.
pub fn columns(names: &[&str], rows: &[Vec<String>]) -> String {
    let width = |at: usize| {
        rows.iter()
            .map(|row| row[at].chars().count())
            .chain([names[at].len()])
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..names.len()).map(width).collect();
    let line = |cells: Vec<&str>| {
        let padded: Vec<String> = cells
            .iter()
            .zip(&widths)
            .map(|(cell, width)| format!("{cell:<width$}"))
            .collect();
        format!("{}\n", padded.join("  ").trim_end())
    };
    let body: String = rows
        .iter()
        .map(|row| line(row.iter().map(String::as_str).collect()))
        .collect();
    line(names.to_vec()) + &body
}

/// The items of a list, or the single item of an answer, formatted by `in_words`.
pub fn shown_items(answer: &Value, in_words: fn(&[Value]) -> String) -> String {
    match answer["items"].as_array() {
        Some(items) if items.is_empty() => "none".into(),
        Some(items) => in_words(items),
        None => in_words(std::slice::from_ref(answer)),
    }
}

/// The items of a list.
pub fn items(answer: &Value) -> impl Iterator<Item = &Value> {
    answer["items"].as_array().into_iter().flatten()
}

/// An item's values in the order of the columns.
pub fn cells(item: &Value, columns: &[&str]) -> Vec<String> {
    let cell = |value: &Value| match value {
        Value::Null => "–".to_owned(),
        Value::String(text) => plain(text).replace('\n', "\u{fffd}"),
        Value::Array(items) if items.iter().all(Value::is_string) => {
            let texts: Vec<&str> = items.iter().filter_map(Value::as_str).collect();
            plain(&texts.join(",")).replace('\n', "\u{fffd}")
        }
        other => other.to_string(),
    };
    columns.iter().map(|column| cell(&item[*column])).collect()
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
